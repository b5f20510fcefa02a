#include "run/kitti_run.h"

#include <algorithm>
#include <cmath>

#include "run/progress.h"
#include "run/run_statistics.h"
#include "terse/core/error.h"
#include "terse/core/require_optimum.h"

namespace terse {
namespace {

using std::size_t;

constexpr size_t kVocabularyFrames = 100;

// A vocabulary from frames spread over the sequence.
AppearanceSearch MakeSearch(const KittiSequence& sequence, const std::vector<int>& frames,
                            const KittiRunOptions& options) {
  const size_t wanted = std::min(frames.size(), kVocabularyFrames);
  std::vector<int> spread;
  for (size_t k = 0; k < wanted; ++k) spread.push_back(frames[k * frames.size() / wanted]);
  std::vector<BinaryDescriptor> descriptors;
  Progress progress("vocabulary", static_cast<long>(wanted), options.quiet);
  KittiFrames reader = sequence.Frames(spread);
  LoopVerifier features(sequence.Camera(), options.slam.verifier);
  long done = 0;
  while (const auto frame = reader.Next()) {
    features.SetCurrent(*frame);
    const auto& found = features.CurrentFeatures().descriptors;
    descriptors.insert(descriptors.end(), found.begin(), found.end());
    progress.Update(++done);
  }
  return AppearanceSearch(descriptors);
}

void Add(const Decision& decision, KittiTotals& totals) {
  totals.accepted += decision.links_accepted;
  totals.refused += decision.links_refused;
  totals.retired.Add(decision.retired);
}

void Add(const StereoSlamStep& step, KittiTotals& totals) {
  Add(step.decision, totals);
  const StereoSlamTimes& t = step.times;
  totals.times.odometry += t.odometry;
  totals.times.features += t.features;
  totals.times.verification += t.verification;
  totals.times.search += t.search;
  totals.times.map += t.map;
  const OdometryTimes& o = step.odometry.times;
  totals.odometry.pyramids += o.pyramids;
  totals.odometry.corners += o.corners;
  totals.odometry.tracking += o.tracking;
  totals.odometry.stereo += o.stereo;
  totals.odometry.motion += o.motion;
  totals.odometry.window += o.window;
  ++totals.frames;
  totals.lost += step.odometry.status == TrackingStatus::kLost;
  totals.candidates += static_cast<long>(step.decision.candidates.size());
  totals.compared += static_cast<long>(step.attempts.size());
  for (const LoopAttempt& attempt : step.attempts) totals.verified += attempt.verification.Verified();
}

// As seen from camera 0, if the poses are those of the left camera of another pair.
std::vector<SE3> OfCamera0(std::vector<SE3> T_world_left, const SE3& T_camera0_left) {
  if (T_world_left.empty()) return T_world_left;
  const SE3 T_left_camera0 = T_camera0_left.Inverse();
  const SE3 T_camera0_world = T_camera0_left * T_world_left.front().Inverse();
  for (SE3& T : T_world_left) T = T_camera0_world * T * T_left_camera0;
  return T_world_left;
}

// Of the left camera, which the map's poses are of.
TruePoses TrueLeftPoses(const KittiSequence& sequence, const std::vector<int>& frames, const std::vector<SE3>& truth) {
  TruePoses out;
  for (size_t k = 0; k < truth.size(); ++k) out[frames[k]] = truth[k] * sequence.T_camera0_left();
  return out;
}

// What is held of frames that the map has forgotten.
void DropForgotten(KittiRun& run) {
  const CompactPoseSlam<SE3>& map = run.slam.Map();
  const auto erase = [&](auto& list, auto&& id_of) {
    const auto is_forgotten = [&](const auto& item) { return !map.HasSeen(id_of(item)); };
    list.erase(std::remove_if(list.begin(), list.end(), is_forgotten), list.end());
  };
  erase(run.frames, [](int frame) { return PoseId{frame}; });
  erase(run.decisions, [](const Decision& decision) { return decision.id; });
}

// All loops at once; where some are wrong what is told of the map is of the one made without them.
void LookBack(KittiRun& run, const TruePoses* truth) {
  const double before = SecondsNow();
  StepRecorder<SE3> recorder(static_cast<int>(run.frames.size()), truth);
  const auto record = [&](const CompactPoseSlam<SE3>& map, const Decision& decision, double seconds) {
    recorder.Add(map, decision, seconds);
  };
  try {
    run.looked_back = run.slam.LookBack(run.decisions, record);
  } catch (const std::exception& error) {  // the run stands without
    run.look_back_failure = error.what();
  }
  run.totals.look_back = 1000 * (SecondsNow() - before);
  if (run.looked_back.wrong.empty()) return;
  run.decisions = std::move(run.looked_back.decisions);
  run.steps = recorder.Steps();
  run.totals.accepted = run.totals.refused = 0;
  run.totals.retired = {};
  for (const Decision& decision : run.decisions) Add(decision, run.totals);
}

}  // namespace

KittiRun RunKitti(const KittiSequence& sequence, const std::vector<int>& frames, const KittiRunOptions& options) {
  double before = SecondsNow();
  std::optional<AppearanceSearch> search;
  double vocabulary = 0;
  if (options.by_appearance) {
    search = MakeSearch(sequence, frames, options);
    vocabulary = SecondsNow() - before;
  }
  KittiRun run{StereoSlam(sequence.Camera(), options.slam, std::move(search)), {}, {}, {}, {}, {}, {}, {}, {}, {}, {}};
  const TruePoses truth = TrueLeftPoses(sequence, frames, options.truth);
  StepRecorder<SE3> recorder(static_cast<int>(frames.size()), truth.empty() ? nullptr : &truth);
  long forgotten = 0;
  KittiTotals& totals = run.totals;
  totals.vocabulary = 1000 * vocabulary;
  {
    Progress progress(options.label, static_cast<long>(frames.size()), options.quiet);
    const double start = SecondsNow();
    KittiFrames reader = sequence.Frames(frames);
    while (true) {
      before = SecondsNow();
      const auto frame = reader.Next();
      totals.waiting += 1000 * (SecondsNow() - before);
      if (!frame) break;
      const StereoSlamStep step = run.slam.AddFrame(*frame);
      Add(step, totals);
      run.frames.push_back(frame->index);
      run.decisions.push_back(step.decision);
      if (run.slam.Map().PosesForgotten() != forgotten) {
        forgotten = run.slam.Map().PosesForgotten();
        DropForgotten(run);
      }
      recorder.Add(run.slam.Map(), step.decision, step.times.map / 1000);
      if (!step.odometry.reason.empty()) run.odd.push_back({frame->index, step.odometry.status, step.odometry.reason});
      if (options.after_step) options.after_step(step);
      progress.Update(totals.frames);
    }
    totals.seconds = SecondsNow() - start;
  }
  run.steps = recorder.Steps();
  LookBack(run, truth.empty() ? nullptr : &truth);
  if (!options.truth.empty()) {
    for (const int frame : run.frames) run.truth.push_back(truth.at(frame) * sequence.T_camera0_left().Inverse());
  }
  run.retired_at_end = run.slam.Retire();
  totals.retired.Add(run.retired_at_end);
  run.result = run.slam.Finish();
  RequireOptimum(run.result);
  return run;
}

std::vector<SE3> MapTrajectory(const KittiRun& run, const KittiSequence& sequence) {
  std::vector<SE3> out;
  for (const RecoveredPose<SE3>& pose : run.slam.Map().Trajectory()) out.push_back(pose.T_world_body);
  return OfCamera0(std::move(out), sequence.T_camera0_left());
}

std::vector<SE3> OdometryTrajectory(const KittiRun& run, const KittiSequence& sequence) {
  return OfCamera0(run.slam.OdometryTrajectory(), sequence.T_camera0_left());
}

std::vector<SE3> ReadKittiTruth(const std::string& path, const KittiSequence& sequence,
                                const std::vector<int>& frames) {
  const Trajectory truth = ReadTrajectory(path);
  std::vector<SE3> out;
  for (const int frame : frames) {
    const double stamp = truth.format == TrajectoryFormat::kTum ? sequence.Time(frame) : frame;
    const auto it = std::lower_bound(truth.stamps.begin(), truth.stamps.end(), stamp - 0.01);
    if (it == truth.stamps.end() || std::abs(*it - stamp) > 0.01) {
      throw FileError(
          path, 0, "there is no pose for frame " + std::to_string(frame) + ", expected one for every frame of the run");
    }
    out.push_back(truth.T_world_body[static_cast<size_t>(it - truth.stamps.begin())]);
  }
  return out;
}

}  // namespace terse
