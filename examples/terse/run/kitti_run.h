#pragma once
// A KITTI sequence through stereo SLAM.

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "run/compact_stats.h"
#include "terse/compact/run_steps.h"
#include "terse/core/evaluate.h"
#include "terse/frontend/kitti_sequence.h"
#include "terse/frontend/stereo_slam.h"

namespace terse {

// Sums of milliseconds over all frames, and counts.
struct KittiTotals {
  StereoSlamTimes times;
  OdometryTimes odometry;
  double waiting = 0;     // for images that the other thread had not decoded yet
  double look_back = 0;   // at the end; not part of the others
  double vocabulary = 0;  // finding one, for candidates by appearance; not part of the others
  int frames = 0, lost = 0;
  long candidates = 0;                           // pairs of poses that the search gave
  long compared = 0;                             // by descriptors at least
  long verified = 0, accepted = 0, refused = 0;  // refused by the innovation test
  RetiredCounts retired;
  double seconds = 0;  // wall time from the first frame to the last
  double FramesPerSecond() const { return seconds > 0 ? frames / seconds : 0; }
};

// One that was lost, or tracked but unusual.
struct OddFrame {
  int frame;
  TrackingStatus status;
  std::string reason;
};

struct KittiRun {
  StereoSlam slam;
  KittiTotals totals;
  // Of the frames that the map remembers, all of them unless CompactOptions::most_dropped is set, in the order they
  // were added: indices, true poses of camera 0 if known, what was decided.
  std::vector<int> frames;
  std::vector<SE3> truth;
  std::vector<Decision> decisions;
  std::vector<CompactStep> steps;
  std::vector<OddFrame> odd;
  LookedBack looked_back;         // its decisions are above
  std::string look_back_failure;  // why there is none
  std::vector<RetiredPose> retired_at_end;
  BatchResult<SE3> result;  // of the map
};

struct KittiRunOptions {
  StereoSlamOptions slam;
  bool by_appearance = false;
  std::string label = "frames";
  bool quiet = false;
  std::vector<SE3> truth;  // T_world_camera0 of all frames, where they are known
  std::function<void(const StereoSlamStep&)> after_step;
};

// Throws FileError for images, NumericalError if the map has no optimum.
KittiRun RunKitti(const KittiSequence& sequence, const std::vector<int>& frames, const KittiRunOptions& options);

// T_world_camera0 of KittiRun::frames, which is what KITTI's ground truth is about; the first is the identity.
std::vector<SE3> MapTrajectory(const KittiRun& run, const KittiSequence& sequence);
std::vector<SE3> OdometryTrajectory(const KittiRun& run, const KittiSequence& sequence);

// True poses of the frames: line by line of a KITTI file, by time of a TUM file. Throws FileError if one is missing.
std::vector<SE3> ReadKittiTruth(const std::string& path, const KittiSequence& sequence, const std::vector<int>& frames);

}  // namespace terse
