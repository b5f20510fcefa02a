#pragma once
// The folder of a compact run, read back: what compact, kitti and table leave behind (docs/outputs.md).

#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "terse/lie/se3.h"

namespace terse {

// A loop of the kept map; poses by their place in the order of arrival.
struct RunLink {
  int from, to;
  int step;                                // the pose at which it was accepted
  std::optional<double> gain, innovation;  // nats; squared Mahalanobis distance
};

// Odometry of the kept map.
struct RunChain {
  int from, to;
  int dropped;  // poses in between whose odometry was composed
};

struct RunCovariance {
  int pose;
  Matrix<3, 3> position;  // m^2, world frame
};

struct RunFolder {
  std::string path, name;  // name: the last part of the path
  int dimension = 3;
  // In order of arrival. 2D poses lie in the plane z = 0.
  std::vector<std::int64_t> ids;
  std::vector<char> kept;
  std::vector<SE3> T_world_body;
  // Laid over the estimate, where the run was given the true poses.
  std::optional<std::vector<SE3>> T_world_body_true;
  std::vector<RunLink> links;
  std::vector<RunChain> chain;
  std::vector<RunCovariance> covariances;
  nlohmann::json decisions;                          // list of the objects in decisions.jsonl
  std::map<std::string, std::vector<double>> steps;  // columns of steps.csv, nan where a cell is empty
  nlohmann::ordered_json thresholds, stats;
};

// Throws FileError if a file is missing, defective, or of another run than graph.json.
RunFolder ReadRunFolder(const std::string& path);
// One or two, to compare: their names differ.
std::vector<RunFolder> ReadRunFolders(const std::vector<std::string>& paths);

}  // namespace terse
