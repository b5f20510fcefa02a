#pragma once
// The results of `terse kitti` as files: docs/outputs.md.

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "run/kitti_run.h"
#include "terse/core/atomic_file.h"

namespace terse {

// loops.csv, a row per candidate that was compared, written while the run goes on.
class LoopsFile {
 public:
  explicit LoopsFile(const std::string& path);
  void Add(const StereoSlamStep& step);
  void Commit() { file_.Commit(); }

 private:
  AtomicFile file_;
};

// Errors of the map and of the odometry alone, with KITTI's metric, over the frames that the map remembers.
struct KittiErrors {
  Evaluation map, odometry;
};
KittiErrors ComputeKittiErrors(const KittiRun& run, const KittiSequence& sequence);

// What every compact run leaves behind (compact_output.h), with the trajectories of camera 0; trajectory.kitti.txt and
// odometry.kitti.txt, unless frames are forgotten: their rows are frames by their place alone.
void WriteKittiResults(const KittiRun& run, const KittiSequence& sequence, const std::optional<KittiErrors>& errors,
                       const std::string& folder);

void PrintKittiSummary(const KittiRun& run, const std::optional<KittiErrors>& errors, const std::string& folder);
// Candidates by information and by appearance, next to each other.
void PrintSearchComparison(const KittiRun& information, const std::optional<KittiErrors>& information_errors,
                           const KittiRun& appearance, const std::optional<KittiErrors>& appearance_errors);

}  // namespace terse
