#pragma once
// The folder of a compact run, read back: what compact, kitti and table leave behind (docs/outputs.md).
//
//     const RunFolder run = ReadRunFolder("ellipse_fpfl");
//     for (const RunDecision& decision : run.decisions) ...
//
// To continue the map itself: map_file.h and thresholds_file.h.

#include <cstdint>
#include <map>
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
  int measurements = 1;                    // that are one edge by now
  bool composed = false;                   // of links of poses that are not kept, at least one of them
};

// Odometry of the kept map.
struct RunChain {
  int from, to;
  int dropped;  // poses in between whose odometry was composed
  int measurements = 1;
  bool composed = false;  // loops of poses that are not kept fused with it
};

struct RunCovariance {
  int pose;
  Matrix<3, 3> position;  // m^2, world frame
};

// A kept pose that a new one could be linked to (Candidate). Numbers that the file leaves open are absent.
struct RunCandidate {
  int pose;                                                // by its place in the order of arrival
  std::optional<double> probability, gain, measured_gain;  // of being in range; nats
  std::optional<double> innovation;                        // squared Mahalanobis distance
  std::optional<bool> tried, measured;                     // absent in folders of earlier versions
  bool accepted = false;
  bool anchors = false, composed = false;
};

// Between kept poses, made of links of a pose that is not kept (ComposedEdge).
struct RunComposedEdge {
  int from, to;                // by their places in the order of arrival
  std::optional<double> gain;  // about the map, nats
  bool fused = false;
};

// What was decided on a pose (Decision).
struct RunDecision {
  std::optional<std::string> verdict;  // Name(PoseVerdict); absent of poses before the decisions that are there
  std::optional<double> pose_gain;     // nats
  std::int64_t registrations_tried = 0, links_accepted = 0, links_refused = 0;
  std::vector<RunCandidate> candidates;
  std::optional<int> anchored_to;
  std::vector<RunComposedEdge> edges;
  // By their places in the order of arrival: poses that came back into the map, and those that it did without from
  // then on; of the run's last decision those, too, that retired at the end of the run.
  std::vector<int> revived, retired;
};

struct RunFolder {
  std::string path, name;  // name: the last part of the path
  int dimension = 3;
  // In order of arrival. 2D poses lie in the plane z = 0.
  std::vector<std::int64_t> ids;
  std::vector<char> kept;
  std::vector<SE3> T_world_body;
  // In a map of several robots: the places, ascending, of poses at which another one's begin; the first is none.
  std::vector<std::size_t> starts;
  // Laid over the estimate, where the run was given the true poses.
  std::optional<std::vector<SE3>> T_world_body_true;
  std::vector<RunLink> links;
  std::vector<RunChain> chain;
  std::vector<RunCovariance> covariances;
  std::vector<RunDecision> decisions;                // one per pose
  std::map<std::string, std::vector<double>> steps;  // columns of steps.csv, nan where a cell is empty
  // Of thresholds.json, nats, and of stats.json, metres, where they are numbers there.
  std::optional<double> min_loop_gain, min_pose_gain, ate_m;
  std::optional<double> range_m;            // the sensor's, greatest direction
  std::string thresholds_json, stats_json;  // the two files as they are, each a JSON object
};

// Throws FileError if a file is missing, defective, or of another run than graph.json.
RunFolder ReadRunFolder(const std::string& path);

}  // namespace terse
