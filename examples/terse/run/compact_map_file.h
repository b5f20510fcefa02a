#pragma once
// A compact map as a JSON file, graph.json: docs/outputs.md. Numbers read back to the last bit.

#include <optional>
#include <string>
#include <variant>

#include "terse/compact/compact_map.h"
#include "terse/compact/compact_options.h"
#include "terse/covariance/information_scale.h"

namespace terse {

using AnyCompactMap = std::variant<CompactMap<SE2>, CompactMap<SE3>>;

struct GraphJson {
  AnyCompactMap map;
  std::optional<Strategy> strategy;    // that made it, if the file says so
  InformationScale information_scale;  // by which its measurements' standard deviations differ from those of the input
};

// Throws FileError, also for a map that contradicts itself: it says where in the file ("poses[3].base"), what is there
// and what was expected.
GraphJson ReadGraphJson(const std::string& path);
// Written whole or not at all. Throws FileError; NumericalError if an estimate is not finite.
template <class Pose>
void WriteGraphJson(const CompactMap<Pose>& map, Strategy strategy, const std::string& path,
                    const InformationScale& information_scale = {});

}  // namespace terse
