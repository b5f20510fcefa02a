#pragma once
// What `terse sweep` without a threshold to scale prints, writes and draws.

#include <string>

#include "run/frontier.h"

namespace terse {

void PrintFrontier(const Frontier& frontier);
void WriteFrontierCsv(const Frontier& frontier, const std::string& path);
// `name`: of the graph.
void WriteFrontierChart(const Frontier& frontier, const std::string& name, const std::string& path);

}  // namespace terse
