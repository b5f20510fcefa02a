#pragma once
// What a compact run leaves behind: a folder of files, docs/outputs.md.

#include <optional>
#include <string>
#include <vector>

#include "run/compact_steps.h"
#include "run/run_statistics.h"
#include "terse/compact/compact_graph.h"
#include "terse/core/evaluate.h"
#include "terse/core/rotation_information.h"
#include "terse/covariance/information_scale.h"

namespace terse {

// Makes the folder if it is missing. Throws FileError, also if no file could be written into it.
void RequireFolder(const std::string& path);

// Rows of a run's files, without headers, for the run that continues it.
struct RunRows {
  std::string decisions_csv, decisions_jsonl, steps_csv;
};
// Of the folder of a run over so many poses; empty where a file is missing or has another number of rows.
RunRows ReadRunRows(const std::string& folder, std::size_t poses);

void WriteDecisions(const std::vector<Decision>& decisions, const std::string& path, const std::string& earlier = "");
// compact.g2o with the values of `result` and trajectory.tum.
template <class Pose>
void WriteCompactMap(const CompactPoseSlam<Pose>& slam, const BatchResult<Pose>& result, Recovery recovery,
                     RotationInformation rotation_information, const std::string& folder);

// The poses of trajectory.tum and the true ones with the same stamps.
struct RunTrajectories {
  Trajectory estimate;
  std::optional<Trajectory> truth;
};
template <class Pose>
RunTrajectories MakeRunTrajectories(const CompactPoseSlam<Pose>& slam, Recovery recovery, const TruePoses* truth);
// ATE and RPE from each pose to the next; absent without the truth of two poses at least.
std::optional<Evaluation> EvaluateRun(const RunTrajectories& trajectories, int dimension);

template <class Pose>
struct RunResults {
  const CompactPoseSlam<Pose>& slam;
  const BatchResult<Pose>& result;
  const std::vector<Decision>& decisions;
  const std::vector<CompactStep>& steps;
  const RunTrajectories& trajectories;
  Recovery recovery = Recovery::kV2;
  RotationInformation rotation_information = RotationInformation::kQuaternion;
  RunRows earlier = {};
  InformationScale information_scale = {};  // of the measurements that the run saw, against those of the file
};
// All files but stats.json. Returns the seconds that covariances took.
template <class Pose>
double WriteRun(const RunResults<Pose>& run, const std::string& folder);

// stats.json of a run over a stored graph; times but those of its steps are the caller's.
template <class Pose>
Stats MakeStats(const PoseGraph<Pose>& graph, const CompactRun<Pose>& run, const std::optional<Evaluation>& errors);

}  // namespace terse
