// Stereo odometry and loop verification bound to the compact map, on a few rendered frames.

#include "terse/frontend/stereo_slam.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/core.hpp>
#include <set>
#include <stdexcept>

#include "terse/core/evaluate.h"
#include "testing_street.h"

namespace terse {
namespace {

using testing::ThereAndBack;

class StereoSlamTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() { scene_ = new ThereAndBack(testing::MakeThereAndBack(0, 13)); }
  static void TearDownTestSuite() {
    delete scene_;
    scene_ = nullptr;
  }
  // Thresholds so low that a few metres of drift are worth a loop.
  static StereoSlamOptions Eager(Strategy strategy) {
    StereoSlamOptions options;
    options.compact.strategy = strategy;
    options.compact.thresholds.min_loop_gain = 1;
    options.compact.thresholds.min_pose_gain = 2;
    return options;
  }
  // Round and round the same street, for ever.
  static StereoFrame FrameOfRounds(int index) {
    StereoFrame frame = scene_->frames[static_cast<std::size_t>(index) % scene_->frames.size()];
    frame.index = index;
    frame.time = 0.1 * index;
    return frame;
  }
  static double AteMetres(const StereoSlam& slam) {
    std::vector<SE3> estimate;
    for (const auto& pose : slam.Map().Trajectory()) estimate.push_back(pose.T_world_body);
    return Evaluate(estimate, scene_->T_world_camera).ate.translation_m;
  }
  static std::size_t Kept(const StereoSlam& slam) { return slam.Map().Solver().Graph().Poses().size(); }

  static ThereAndBack* scene_;
};

ThereAndBack* StereoSlamTest::scene_ = nullptr;

TEST_F(StereoSlamTest, KeepsFewPosesAndClosesLoops) {
  StereoSlam slam(scene_->camera, Eager(Strategy::kFpfl));
  int accepted = 0;
  for (const StereoFrame& frame : scene_->frames) {
    const StereoSlamStep step = slam.AddFrame(frame);
    accepted += step.decision.links_accepted;
    EXPECT_EQ(step.id.value, frame.index);
    EXPECT_EQ(slam.Verifier().Has(step.id), step.decision.Kept());
    EXPECT_LE(step.decision.links_accepted, static_cast<int>(step.attempts.size()));
  }
  EXPECT_TRUE(slam.Finish().Converged());
  EXPECT_GE(accepted, 1);
  EXPECT_EQ(slam.Map().LinksKept(), accepted);
  EXPECT_LT(Kept(slam), scene_->frames.size());
  EXPECT_EQ(slam.Map().Trajectory().size(), scene_->frames.size());
  EXPECT_EQ(slam.OdometryTrajectory().size(), scene_->frames.size());
  EXPECT_LT(AteMetres(slam), 0.15);
}

// The way back adds no poses: there the camera is found again.
TEST_F(StereoSlamTest, TheDefaultIsBounded) {
  ASSERT_EQ(StereoCompactOptions().strategy, Strategy::kBounded);
  EXPECT_EQ(StereoCompactOptions(Strategy::kFpfl).strategy, Strategy::kFpfl);
  EXPECT_LT(StereoCompactOptions().thresholds.min_loop_gain,
            StereoCompactOptions(Strategy::kFpfl).thresholds.min_loop_gain)
      << "its links cost no poses";
  StereoSlam slam(scene_->camera, Eager(StereoCompactOptions().strategy)), few(scene_->camera, Eager(Strategy::kFpfl));
  int anchored = 0;
  for (const StereoFrame& frame : scene_->frames) {
    const StereoSlamStep step = slam.AddFrame(frame);
    few.AddFrame(frame);
    anchored += step.decision.verdict == PoseVerdict::kAnchored;
    EXPECT_EQ(slam.Verifier().Has(step.id), step.decision.Kept());
  }
  EXPECT_TRUE(slam.Finish().Converged());
  EXPECT_GE(anchored, 1);
  EXPECT_LE(Kept(slam), Kept(few));
  EXPECT_EQ(slam.Map().Trajectory().size(), scene_->frames.size());
  EXPECT_LT(AteMetres(slam), 0.15);
}

// Round and round the same street with links so cheap that poses stay for them: some retire, and with them go their
// features, no others.
TEST_F(StereoSlamTest, ThePosesThatRetireTakeTheirFeaturesWithThem) {
  StereoSlamOptions options = Eager(Strategy::kBounded);
  options.compact.thresholds.min_loop_gain = 0.01;
  options.compact.retire_share = 100;  // a nat
  options.most_per_place = 1000;
  StereoSlam slam(scene_->camera, options);
  std::set<std::int64_t> in_map;
  std::size_t retired = 0;
  for (int frames = 0; frames < 84; ++frames) {
    const StereoSlamStep step = slam.AddFrame(FrameOfRounds(frames));
    if (step.decision.Kept()) in_map.insert(step.id.value);
    ASSERT_TRUE(step.decision.revived.empty()) << "no features are stored of those";
    for (const RetiredPose& pose : step.decision.retired) {
      EXPECT_EQ(in_map.erase(pose.id.value), 1u);
      EXPECT_TRUE(slam.Map().HasSeen(pose.id));
      ++retired;
    }
    EXPECT_EQ(slam.Verifier().Kept(), in_map.size());
    for (int k = 0; k <= frames; ++k) EXPECT_EQ(slam.Verifier().Has({k}), in_map.count(k) == 1) << frames << ' ' << k;
  }
  EXPECT_GT(retired, 0u);
  EXPECT_EQ(Kept(slam), in_map.size());
  // And at the end.
  const std::vector<RetiredPose> at_end = slam.Retire();
  EXPECT_FALSE(at_end.empty());
  for (const RetiredPose& pose : at_end) {
    EXPECT_EQ(in_map.erase(pose.id.value), 1u);
    EXPECT_FALSE(slam.Verifier().Has(pose.id));
  }
  EXPECT_EQ(slam.Verifier().Kept(), in_map.size());
  EXPECT_EQ(Kept(slam), in_map.size());
}

// What is held of frames that the map has forgotten goes, and the rest stays as it would have been.
TEST_F(StereoSlamTest, ARunWithoutAnEndHoldsWhatTheMapRemembers) {
  constexpr int kFrames = 60;
  StereoSlamOptions options = Eager(Strategy::kBounded);
  StereoSlam all(scene_->camera, options);
  options.compact.most_dropped = 4;
  StereoSlam slam(scene_->camera, options);
  std::size_t most = 0;
  for (int k = 0; k < kFrames; ++k) {
    all.AddFrame(FrameOfRounds(k));
    slam.AddFrame(FrameOfRounds(k));
    const auto poses = slam.Map().Trajectory();
    const std::vector<SE3> odometry = slam.OdometryTrajectory(), whole = all.OdometryTrajectory();
    ASSERT_EQ(odometry.size(), poses.size());
    ASSERT_EQ(whole.size(), static_cast<std::size_t>(k) + 1);
    for (std::size_t i = 0; i < poses.size(); ++i) {
      EXPECT_TRUE(odometry[i].Translation() == whole[static_cast<std::size_t>(poses[i].id.value)].Translation()) << i;
    }
    EXPECT_EQ(slam.Map().PosesForgotten() + static_cast<long>(poses.size()), k + 1);
    most = std::max(most, poses.size());
  }
  EXPECT_EQ(all.Map().PosesForgotten(), 0);
  EXPECT_LT(most, kFrames / 2u);
}

TEST_F(StereoSlamTest, AllPosesAllLinksRegistersWhateverIsInRange) {
  StereoSlam slam(scene_->camera, Eager(Strategy::kApal));
  std::size_t verified = 0;
  for (const StereoFrame& frame : scene_->frames) {
    const StereoSlamStep step = slam.AddFrame(frame);
    EXPECT_EQ(step.attempts.size(), static_cast<std::size_t>(step.decision.registrations_tried));
    for (const LoopAttempt& attempt : step.attempts) verified += attempt.verification.Verified();
  }
  EXPECT_EQ(Kept(slam), scene_->frames.size());
  EXPECT_EQ(static_cast<std::size_t>(slam.Map().LinksKept()), verified);
  EXPECT_GT(verified, scene_->frames.size());
  EXPECT_LT(AteMetres(slam), 0.15);
}

TEST_F(StereoSlamTest, CandidatesByAppearance) {
  AppearanceOptions appearance;
  appearance.words = 60;
  appearance.most_trained = 1500;
  appearance.gap = 4;
  std::vector<BinaryDescriptor> descriptors;
  LoopVerifier features(scene_->camera);
  for (const int k : {0, 3, 6}) {
    features.SetCurrent(scene_->frames[static_cast<std::size_t>(k)]);
    const auto& found = features.CurrentFeatures().descriptors;
    descriptors.insert(descriptors.end(), found.begin(), found.end());
  }
  StereoSlam slam(scene_->camera, Eager(Strategy::kFpfl), AppearanceSearch(descriptors, appearance));
  for (const StereoFrame& frame : scene_->frames) {
    const StereoSlamStep step = slam.AddFrame(frame);
    for (const LoopAttempt& attempt : step.attempts) EXPECT_LT(attempt.candidate.value, frame.index - 4);
  }
  EXPECT_EQ(slam.Map().Options().strategy, Strategy::kApal);
  EXPECT_GE(slam.Map().LinksKept(), 1);
  EXPECT_LT(AteMetres(slam), 0.15);
}

TEST_F(StereoSlamTest, FramesThatShowNothingLeaveTheMapWhole) {
  StereoSlam slam(scene_->camera, Eager(Strategy::kFpfl));
  int lost = 0;
  for (StereoFrame frame : scene_->frames) {
    if (frame.index == 4) {
      frame.left = cv::Mat::zeros(frame.left.size(), CV_8U);
      frame.right = frame.left;
    }
    const StereoSlamStep step = slam.AddFrame(frame);
    if (step.odometry.status != TrackingStatus::kLost) continue;
    ++lost;
    EXPECT_FALSE(step.odometry.reason.empty());
  }
  EXPECT_GE(lost, 1);
  EXPECT_EQ(slam.Map().Trajectory().size(), scene_->frames.size());
  EXPECT_TRUE(slam.Finish().Converged());
  EXPECT_LT(AteMetres(slam), 0.5);
}

TEST_F(StereoSlamTest, TheSamePlaceAgainAndAgainNeedsNoMoreFeatures) {
  StereoSlamOptions options = Eager(Strategy::kFpfl);
  options.compact.thresholds.min_pose_gain = 0;  // keep every pose
  options.most_per_place = 2;
  options.place_radius = 100;
  options.place_angle = 3;
  StereoSlam slam(scene_->camera, options);
  for (const StereoFrame& frame : scene_->frames) slam.AddFrame(frame);
  EXPECT_EQ(slam.Verifier().Kept(), 2u);
  EXPECT_TRUE(slam.Verifier().Has({scene_->frames.back().index})) << "the newest stay";
}

TEST_F(StereoSlamTest, WrongInputLeavesTheStateAsItWas) {
  StereoSlam slam(scene_->camera, Eager(Strategy::kFpfl));
  slam.AddFrame(scene_->frames[0]);
  EXPECT_THROW(slam.AddFrame(scene_->frames[0]), std::invalid_argument);
  StereoFrame small = scene_->frames[1];
  small.left = small.left.colRange(0, 100);
  EXPECT_THROW(slam.AddFrame(small), std::invalid_argument);
  EXPECT_EQ(slam.Map().PosesSeen(), 1);
  EXPECT_EQ(slam.AddFrame(scene_->frames[1]).odometry.status, TrackingStatus::kTracked);
  StereoSlamOptions options;
  options.compact.strategy = Strategy::kGiven;
  EXPECT_THROW(StereoSlam(scene_->camera, options), std::invalid_argument);
  options = {};
  options.most_per_place = 0;
  EXPECT_THROW(StereoSlam(scene_->camera, options), std::invalid_argument);
}

}  // namespace
}  // namespace terse
