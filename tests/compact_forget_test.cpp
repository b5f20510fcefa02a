// Runs without an end: dropped poses that are forgotten (CompactOptions::most_dropped).

#include <gtest/gtest.h>

#include "terse/compact/compact_pose_slam.h"
#include "terse/compact/measurement_stream.h"
#include "testing_bounded.h"
#include "testing_files.h"
#include "testing_state.h"

namespace terse {
namespace {

using testing::Bits;
using testing::Copy;
using testing::Laps;
using testing::LapsOptions;
using testing::Picture;

template <class Pose>
class CompactForgetTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactForgetTest, Groups);

LapsOptions ManyLaps() {
  LapsOptions options;
  options.laps = 20;
  return options;
}

// A loop leads to the same kept poses, or to none.
template <class Pose>
std::string Kept(const CompactPoseSlam<Pose>& slam) {
  std::string out = Bits(slam.LinksKept()) + Bits(slam.PosesSeen()) + Bits(slam.Solver().LogDeterminant());
  for (const Pose& pose : slam.Solver().Estimates()) out += Bits(pose);
  return out;
}

TYPED_TEST(CompactForgetTest, MemoryIsThatOfTheMap) {
  using Pose = TypeParam;
  for (const std::uint64_t seed : testing::Seeds(1, 3)) {
    SCOPED_TRACE(seed);
    Laps<Pose> laps(seed, ManyLaps());
    laps.options.most_dropped = 40;
    CompactPoseSlam<Pose> slam(laps.options);
    std::size_t most = 0, most_of_first_half = 0;
    int forgotten_loops = 0;
    for (const auto& input : laps.replay.Inputs()) {
      const Decision decision = slam.AddPose(input);
      forgotten_loops += decision.loops_forgotten;
      const std::size_t remembered = slam.Trajectory().size();
      most = std::max(most, remembered);
      if (2 * slam.PosesSeen() <= static_cast<int>(laps.replay.Inputs().size())) most_of_first_half = most;
      EXPECT_TRUE(slam.HasSeen(input.id));
      EXPECT_FALSE(slam.HasForgotten(input.id));
      for (const auto& node : slam.Solver().Graph().Poses()) ASSERT_TRUE(slam.HasSeen(node.id)) << node.id.value;
    }
    const int seen = static_cast<int>(laps.replay.Inputs().size());
    EXPECT_EQ(slam.PosesSeen(), seen);
    // The laps along which kept poses hang together, the newest 40, and half as many again until the next look.
    EXPECT_LE(most, 1.5 * (2.5 * 30 + 40) + 2);
    EXPECT_LE(most, 1.1 * most_of_first_half);
    EXPECT_LT(most, 0.3 * seen);
    EXPECT_GT(forgotten_loops, 20);
    int remembered = 0;
    for (const auto& input : laps.replay.Inputs()) {
      EXPECT_NE(slam.HasSeen(input.id), slam.HasForgotten(input.id)) << input.id.value;
      remembered += slam.HasSeen(input.id);
    }
    EXPECT_EQ(static_cast<std::size_t>(remembered), slam.Trajectory().size());
  }
}

// What is forgotten is what nothing needs: loops to it aside, the run is the same to the last bit, and so is what it
// says of the poses that it remembers and whose chain it has whole.
TYPED_TEST(CompactForgetTest, NothingElseChanges) {
  using Pose = TypeParam;
  for (const std::uint64_t seed : testing::Seeds(4, 3)) {
    SCOPED_TRACE(seed);
    Laps<Pose> laps(seed, ManyLaps());
    CompactOptions<Pose> options = laps.options;
    CompactPoseSlam<Pose> all(options);
    options.most_dropped = 30;
    CompactPoseSlam<Pose> few(options);
    int left_out = 0, compared = 0;
    for (CompactInput<Pose> input : laps.replay.Inputs()) {
      // Spent chains carry nothing, and a chain whose end is forgotten is: loops along those go too.
      std::vector<RelativePoseFactor<Pose>> loops;
      for (const auto& loop : *input.loops) {
        const PoseId other = loop.from == input.id ? loop.to : loop.from;
        if (few.HasSeen(other) && few.KeptBase(other) == other) loops.push_back(loop);
        left_out += few.HasForgotten(other);
      }
      input.loops = loops;
      all.AddPose(input);
      few.AddPose(input);
      ASSERT_EQ(Kept(all), Kept(few)) << input.id.value;
    }
    for (const auto& pose : few.Export().poses) {
      if (!pose.kept && !pose.next_kept) continue;
      ++compared;
      EXPECT_EQ(Bits(all.Estimate(pose.id, Recovery::kV2)), Bits(few.Estimate(pose.id, Recovery::kV2)));
      EXPECT_EQ(Bits(all.Covariance(pose.id)), Bits(few.Covariance(pose.id))) << pose.id.value;
    }
    EXPECT_GT(left_out, 20);
    EXPECT_GT(compared, 40);
  }
}

// States and maps of a run that forgot go on as it does.
TYPED_TEST(CompactForgetTest, IsSavedAndRestored) {
  using Pose = TypeParam;
  Laps<Pose> laps(7, ManyLaps());
  laps.options.most_dropped = 25;
  CompactPoseSlam<Pose> slam(laps.options);
  const std::size_t half = laps.replay.Inputs().size() / 2;
  for (std::size_t k = 0; k < half; ++k) slam.AddPose(laps.replay.Inputs()[k]);
  ASSERT_TRUE(slam.HasForgotten(PoseId{static_cast<std::int64_t>(half) / 2}));
  CompactPoseSlam<Pose> loaded = Copy(slam);
  slam.Finish();
  const CompactMap<Pose> map = slam.Export();
  EXPECT_EQ(FindDefect(map), "");
  EXPECT_EQ(map.forgotten + static_cast<long>(map.poses.size()), static_cast<long>(half));
  CompactPoseSlam<Pose> restored = CompactPoseSlam<Pose>::Restore(map, laps.options);
  EXPECT_EQ(restored.PosesSeen(), static_cast<int>(half));
  CompactPoseSlam<Pose> finished = Copy(slam);
  loaded.Finish();
  ASSERT_EQ(Kept(finished), Kept(loaded));
  for (std::size_t k = half; k < laps.replay.Inputs().size(); ++k) {
    finished.AddPose(laps.replay.Inputs()[k]);
    loaded.AddPose(laps.replay.Inputs()[k]);
    restored.AddPose(laps.replay.Inputs()[k]);
    ASSERT_TRUE(Picture(finished) == Picture(loaded)) << k;
  }
  // The restored one looks for what to forget at other times, so that other loops are left out.
  EXPECT_EQ(restored.PosesSeen(), finished.PosesSeen());
  EXPECT_LE(restored.Trajectory().size(), 1.5 * (2 * 30 + 25) + 2);

  CompactMap<Pose> wrong = map;
  wrong.forgotten = 0;
  EXPECT_NE(FindDefect(wrong), "");
}

TYPED_TEST(CompactForgetTest, WhatIsForgottenIsSaidToBe) {
  using Pose = TypeParam;
  Laps<Pose> laps(8, ManyLaps());
  laps.options.most_dropped = 1;
  CompactPoseSlam<Pose> slam(laps.options);
  for (const auto& input : laps.replay.Inputs()) slam.AddPose(input);
  PoseId lost{0};
  while (!slam.HasForgotten(lost)) ++lost.value;
  const auto expect_says = [&](const std::function<void()>& call) {
    const std::string before = Picture(slam);
    try {
      call();
      ADD_FAILURE() << "nothing was thrown";
    } catch (const std::invalid_argument& error) {
      EXPECT_NE(std::string(error.what()).find("forgotten"), std::string::npos) << error.what();
    }
    EXPECT_TRUE(Picture(slam) == before);
  };
  const PoseId newest = laps.replay.Inputs().back().id, next{newest.value + 1};
  const RelativePoseFactor<Pose> link{lost, newest, Pose(), Pose::Jacobian::Identity()};
  expect_says([&] { slam.AddLink(link); });
  expect_says([&] { slam.Estimate(lost); });
  expect_says([&] { slam.AddPrior(PosePriorFactor<Pose>{lost, Pose(), Pose::Jacobian::Identity()}); });
  expect_says([&] { slam.AddPose(lost, link); });
  expect_says([&] { slam.AddPose(next, RelativePoseFactor<Pose>{lost, next, Pose(), Pose::Jacobian::Identity()}); });

  MeasurementStream<Pose> stream(slam);
  expect_says([&] { stream.Add(RelativePoseFactor<Pose>{lost, next, Pose(), Pose::Jacobian::Identity()}); });
  expect_says([&] { stream.Add(PosePriorFactor<Pose>{lost, Pose(), Pose::Jacobian::Identity()}); });
  EXPECT_THROW(stream.SetValue(lost, Pose()), std::invalid_argument);
  const auto late = stream.Add(link);
  ASSERT_EQ(late.size(), 1u);
  EXPECT_TRUE(std::get<LateLink>(late[0]).forgotten);
  EXPECT_FALSE(std::get<LateLink>(late[0]).decision.accepted);
  // To the pose at hand it is one of its loops.
  stream.Add(RelativePoseFactor<Pose>{newest, next, Pose(), Pose::Jacobian::Identity()});
  stream.Add(RelativePoseFactor<Pose>{lost, next, Pose(), Pose::Jacobian::Identity()});
  const auto closed = stream.Flush();
  EXPECT_EQ(std::get<Decision>(closed.at(0)).loops_forgotten, 1);
}

// Where ids do not ascend none could be told from one that never came: nothing is forgotten.
TYPED_TEST(CompactForgetTest, NotWhereIdsDoNotAscend) {
  using Pose = TypeParam;
  Laps<Pose> laps(9, ManyLaps());
  laps.options.most_dropped = 1;
  CompactPoseSlam<Pose> slam(laps.options);
  const auto turned = [](PoseId id) { return PoseId{-id.value}; };
  for (CompactInput<Pose> input : laps.replay.Inputs()) {
    input.id = turned(input.id);
    const auto turn = [&](RelativePoseFactor<Pose>& edge) {
      edge.from = turned(edge.from);
      edge.to = turned(edge.to);
    };
    if (input.odometry) turn(*input.odometry);
    for (auto& loop : *input.loops) turn(loop);
    slam.AddPose(input);
  }
  EXPECT_EQ(slam.Trajectory().size(), laps.replay.Inputs().size());
  laps.options.most_dropped = 0;
  EXPECT_THROW(CompactPoseSlam<Pose>{laps.options}, std::invalid_argument);
}

}  // namespace
}  // namespace terse
