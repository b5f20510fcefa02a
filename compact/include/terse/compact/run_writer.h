#pragma once
// What a compact run leaves behind, written: the folder of files that run_folder.h reads (docs/outputs.md).
//
// All of it but stats.json, which counts and times what its writer knows of (the command's holds processor time, memory
// and more). Files are written whole or not at all; those of an earlier run into the same folder are replaced.

#include <optional>
#include <string>
#include <vector>

#include "terse/compact/run_steps.h"
#include "terse/core/rotation_information.h"
#include "terse/core/trajectory.h"
#include "terse/covariance/information_scale.h"

namespace terse {

// Rows of a run's files, without headers, for the run that continues it.
struct RunRows {
  std::string decisions_csv, decisions_jsonl, steps_csv;
};
// Of the folder of a run over so many poses; empty where a file is missing or has another number of rows.
RunRows ReadRunRows(const std::string& folder, std::size_t poses);

// decisions.csv. `earlier`: rows, without the header, of the run that this one continues.
void WriteDecisions(const std::vector<Decision>& decisions, const std::string& path, const std::string& earlier = "");

// compact.g2o with the values of `result` and trajectory.tum.
template <class Pose>
void WriteMapAndTrajectory(const CompactPoseSlam<Pose>& slam, const BatchResult<Pose>& result, Recovery recovery,
                           RotationInformation rotation_information, const std::string& folder);

// The poses of trajectory.tum and the true ones with the same stamps.
struct RunTrajectories {
  Trajectory estimate;
  std::optional<Trajectory> truth;
};
// Of all poses seen, ids for stamps. `truth` names every one of them, or is nullptr. Throws std::invalid_argument for
// ids beyond 2^53, which are no stamps.
template <class Pose>
RunTrajectories MakeRunTrajectories(const CompactPoseSlam<Pose>& slam, Recovery recovery, const TruePoses* truth);

template <class Pose>
struct RunResults {
  const CompactPoseSlam<Pose>& slam;
  const BatchResult<Pose>& result;  // of its Finish
  const std::vector<Decision>& decisions;
  const std::vector<CompactStep>& steps;
  const RunTrajectories& trajectories;
  Recovery recovery = Recovery::kV2;
  RotationInformation rotation_information = RotationInformation::kQuaternion;
  RunRows earlier = {};
  InformationScale information_scale = {};       // of the measurements that the run saw, against those of the file
  std::vector<RetiredPose> retired_at_end = {};  // behind the last decision
};
// The folder is there (its stats.json, if any, is removed first: it is the last file of a run). Returns the seconds
// that covariances took. Throws FileError, NumericalError.
template <class Pose>
double WriteRun(const RunResults<Pose>& run, const std::string& folder);

}  // namespace terse
