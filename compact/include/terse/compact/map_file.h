#pragma once
// A compact map as a JSON file, graph.json of a run's folder: docs/outputs.md. Numbers read back to the last bit.
//
//     const CompactMapFile file = ReadCompactMap("run/graph.json");
//     CompactOptions<SE3> options;
//     options.thresholds = ReadThresholds<SE3>("run/thresholds.json");  // thresholds_file.h
//     auto slam = CompactPoseSlam<SE3>::Restore(std::get<CompactMap<SE3>>(file.map), options);
//     ...
//     WriteCompactMap(slam.Export(), options.strategy, "run/graph.json", file.information_scale);

#include <optional>
#include <string>
#include <variant>

#include "terse/compact/compact_map.h"
#include "terse/compact/compact_options.h"
#include "terse/covariance/information_scale.h"

namespace terse {

using AnyCompactMap = std::variant<CompactMap<SE2>, CompactMap<SE3>>;

struct CompactMapFile {
  AnyCompactMap map;
  std::optional<Strategy> strategy;  // that made it, if the file says so
  // By which its measurements' standard deviations differ from those of the input: what comes later is to be scaled
  // likewise (ScaleInformation).
  InformationScale information_scale;
};

// Throws FileError, also for a map that contradicts itself: it says where in the file ("poses[3].base"), what is there
// and what was expected.
CompactMapFile ReadCompactMap(const std::string& path);
// Written whole or not at all. Throws FileError; NumericalError if an estimate is not finite.
template <class Pose>
void WriteCompactMap(const CompactMap<Pose>& map, Strategy strategy, const std::string& path,
                     const InformationScale& information_scale = {});

}  // namespace terse
