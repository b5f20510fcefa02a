#pragma once
// Compact pose SLAM with a stereo camera: StereoOdometry and LoopVerifier bound to CompactPoseSlam.
//
// Every frame is offered to the map with the odometry since the frame before it, also where tracking was lost (then by
// constant velocity, with an inflated covariance). The map searches by distance and information (compact_pose_slam.h);
// what it wants to link goes to the verifier, best first. The features of a pose are stored when it is kept, and
// forgotten when it retires. For a run without an end, CompactOptions::most_dropped bounds what is remembered of the
// frames: memory then grows with the map alone.
//
// What is registered: with kBounded, kFpfl and kApfl, the candidates in range that promise more than min_loop_gain,
// best first, until `most_verifications` of them have got beyond comparing descriptors. With kApal, all poses are kept,
// every pose in range but the one before is registered, and every link that the verifier takes is added, whatever it
// tells; the innovation test does not apply. With an AppearanceSearch given, the candidates are instead the keyframes
// that look alike, all poses are kept and all verified links added.
//
// A place that looks like another one is verified as well as the same one, and a map hears of a loop once, when it
// comes. At the end of a run LookBack judges all of them together.
//
// Deterministic. Not thread-safe.

#include <memory>
#include <vector>

#include "terse/compact/compact_graph.h"
#include "terse/compact/compact_pose_slam.h"
#include "terse/frontend/appearance_search.h"
#include "terse/frontend/loop_verifier.h"
#include "terse/frontend/stereo_odometry.h"

namespace terse {

// Thresholds for a vehicle's stereo camera at ten frames a second: range 3 m aside and in height, 8 m along the view,
// 40 degrees; link covariance as verified loops have it. With kBounded a link costs no pose, but starts the chain anew
// with what odometry did not measure: there it has to tell half as much.
CompactOptions<SE3> StereoCompactOptions(Strategy strategy = Strategy::kBounded);

struct StereoSlamOptions {
  CompactOptions<SE3> compact = StereoCompactOptions();
  StereoOdometryOptions odometry;
  LoopVerifierOptions verifier;
  int most_verifications = 4;  // of a frame, beyond comparing descriptors; kApal has no such bound
  // Errors of odometry that persist from frame to frame (calibration, the texture of the street) add up faster than the
  // covariances of single frames say: such a part of the motion's length, and of its angle, is added to the standard
  // deviations. Found on rendered sequences: with 0.01 of the angle true loops are refused after corners, with 0.03 of
  // the length every pose seems worth keeping.
  double odometry_length_part = 0.01, odometry_angle_part = 0.03;
  // Features of so many keyframes at most are stored within place_radius (metres) and place_angle (radians) of each
  // other, the oldest are forgotten: driving the same street again and again needs no more memory.
  int most_per_place = 4;
  double place_radius = 2, place_angle = 0.35;
  LogSink log;  // log.h; the map's and the odometry's too, unless they have their own
};

// One candidate that was compared with a frame.
struct LoopAttempt {
  PoseId candidate, current;
  LoopVerification verification;
  double milliseconds = 0;
};

// Milliseconds of wall time.
struct StereoSlamTimes {
  double odometry = 0, features = 0, verification = 0, search = 0, map = 0;
  double Total() const { return odometry + features + verification + search + map; }
};

struct StereoSlamStep {
  PoseId id;  // the frame's index
  OdometryStep odometry;
  Decision decision;
  std::vector<LoopAttempt> attempts;  // those that were verified were offered to the map
  StereoSlamTimes times;
};

// What came of judging all loops together.
struct LookedBack {
  std::string why;                               // they were judged; "": there was no reason to
  std::vector<std::pair<PoseId, PoseId>> wrong;  // candidate and frame of those that are wrong
  std::vector<Decision> decisions;               // where there are any: of all frames, in place of those before
};

class StereoSlam {
 public:
  // Throws std::invalid_argument if the camera or an option makes no sense. `appearance`: candidates by appearance.
  explicit StereoSlam(const StereoCamera& camera, const StereoSlamOptions& options = {},
                      std::optional<AppearanceSearch> appearance = std::nullopt);
  ~StereoSlam();
  StereoSlam(StereoSlam&&) noexcept;
  StereoSlam& operator=(StereoSlam&&) noexcept;

  // Indices are those of new poses, each only once. Throws std::invalid_argument if not so, or if an image has the
  // wrong type or size; nothing is changed then. After any other exception the frame counts as not added; the odometry
  // has passed it, and the next frame's link spans both.
  StereoSlamStep AddFrame(const StereoFrame& frame);

  // Where the map refuses many of the verified loops, leaves them out by its kernel, or was bent by one that no other
  // bears out, all are judged together (LoopJury), and if some are wrong the map is made anew of what was measured
  // without them: `decisions` are those that AddFrame returned, `after_step` hears of every frame again. At the end of
  // a run: of poses that only the new map keeps there are no features. Nothing with a kernel other than kGnc, or where
  // frames are forgotten (CompactOptions::most_dropped) or AddFrame threw for one that the map has, for it takes what
  // was measured of all. Frames are to have come by ascending index. Throws as AddFrame does for the map, which is as
  // before then.
  LookedBack LookBack(const std::vector<Decision>& decisions, const AfterStep<SE3>& after_step = nullptr);
  // Poses retire as at the end of a run (CompactPoseSlam::Retire), and their features go.
  std::vector<RetiredPose> Retire();
  // Iterates the map to its optimum.
  BatchResult<SE3> Finish() { return map_.Finish(); }
  const StereoSlamOptions& Options() const { return options_; }
  const CompactPoseSlam<SE3>& Map() const { return map_; }
  const LoopVerifier& Verifier() const { return verifier_; }
  // The odometry alone: T_first_frame of the frames that the map remembers, in order of arrival.
  std::vector<SE3> OdometryTrajectory() const;

 private:
  CompactInput<SE3> MakeInput(const StereoFrame& frame, const OdometryStep& step) const;
  std::optional<RelativePoseFactor<SE3>> Register(PoseId candidate, PoseId current, StereoSlamStep& step);
  void StoreFeatures(PoseId id);
  void DropFeatures(const std::vector<RetiredPose>& retired);
  void NoteOdometry(PoseId id, const std::optional<RelativePoseFactor<SE3>>& measured);
  bool MayLookBack() const;
  void NoteMeasured(const StereoSlamStep& step, const std::optional<RelativePoseFactor<SE3>>& odometry);

  StereoSlamOptions options_;
  StereoOdometry odometry_;
  LoopVerifier verifier_;
  CompactPoseSlam<SE3> map_;
  std::optional<AppearanceSearch> appearance_;
  std::optional<PoseId> previous_;
  std::optional<UncertainPose<SE3>> pending_;  // what odometry measured from it to frames that the map refused
  std::vector<PoseId> stored_;                 // in the order of arrival
  struct OdometryPose {
    PoseId id;
    SE3 T_first_frame;
  };
  std::vector<OdometryPose> odometry_poses_;  // of the frames that the map remembers
  long forgotten_ = 0;                        // poses of the map, when these were last looked through
  PoseGraph<SE3> measured_;                   // odometry and verified loops, where no frame is forgotten
};

}  // namespace terse
