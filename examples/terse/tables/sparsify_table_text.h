#pragma once
// What `terse table sparsify` prints.

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tables/sparsify_table.h"

namespace terse {

std::string SparsifyGraphText(const SparsifyTableGraph& graph);
std::string SparsifySummaryText(const std::vector<SparsifyTableGraph>& graphs);  // empty without a cell
std::string SparsifyTableText(const std::vector<SparsifyTableGraph>& graphs);    // all of it
nlohmann::ordered_json SparsifyTableJson(const std::vector<SparsifyTableGraph>& graphs,
                                         const SparsifyTableOptions& options);

}  // namespace terse
