// Places that look alike, and all verified loops judged together at the end of a stereo run.
//
// The street is a lap whose second half looks like the first, house by house, and the map takes the whole of it to be
// in range: what is verified across half a lap is wrong.

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "terse/core/evaluate.h"
#include "terse/frontend/stereo_slam.h"
#include "terse/frontend/street_sequence.h"

namespace terse {
namespace {

struct TwinDrive {
  explicit TwinDrive(RobustKernel kernel, std::optional<int> most_dropped = std::nullopt)
      : slam(Street().Camera(), Options(kernel, most_dropped)) {}

  static const StreetSequence& Street() {
    static const StreetSequence street = [] {
      StreetOptions options;
      options.laps = 1;
      options.frames = 180;
      options.width = 306;
      options.height = 92;
      options.twins = true;
      return StreetSequence(options);
    }();
    return street;
  }
  static StereoSlamOptions Options(RobustKernel kernel, std::optional<int> most_dropped) {
    StereoSlamOptions options;
    options.compact.thresholds.range = {200, 200, 200, 3.2};
    options.compact.most_dropped = most_dropped;
    options.compact.solver.robust = MapRobust({kernel}, options.compact);
    return options;
  }
  static double Metres(PoseId a, PoseId b) {
    const auto position = [](PoseId id) { return Street().T_world_camera(static_cast<int>(id.value)).Translation(); };
    return (position(a) - position(b)).norm();
  }

  void AddFrames(int begin, int end) {
    for (int k = begin; k < end; ++k) {
      StereoFrame frame = Street().Render(k % Street().Options().frames);
      frame.index = k;
      frame.time = 0.1 * k;
      const StereoSlamStep step = slam.AddFrame(frame);
      decisions.push_back(step.decision);
      for (const LoopAttempt& a : step.attempts) {
        if (a.verification.Verified()) verified.emplace(a.candidate, a.current);
      }
    }
  }
  double AteMetres(const std::vector<SE3>& trajectory) const {
    std::vector<SE3> truth;
    for (std::size_t k = 0; k < trajectory.size(); ++k) {
      truth.push_back(Street().T_world_camera(static_cast<int>(k) % Street().Options().frames));
    }
    return Evaluate(trajectory, truth).ate.translation_m;
  }
  double AteMetres() const {
    std::vector<SE3> poses;
    for (const auto& pose : slam.Map().Trajectory()) poses.push_back(pose.T_world_body);
    return AteMetres(poses);
  }

  StereoSlam slam;
  std::vector<Decision> decisions;
  std::set<std::pair<PoseId, PoseId>> verified;
};

TEST(LookBack, PlacesThatLookAlikeAreFoundOut) {
  TwinDrive drive(RobustKernel::kGnc);
  drive.AddFrames(0, 180);
  long steps = 0;
  const LookedBack back = drive.slam.LookBack(drive.decisions, [&](const CompactPoseSlam<SE3>& map, const Decision&,
                                                                   double) { EXPECT_EQ(map.PosesSeen(), ++steps); });
  EXPECT_NE(back.why.find(" loops contradict the map"), std::string::npos) << back.why;
  ASSERT_EQ(back.decisions.size(), 180u);
  EXPECT_EQ(steps, 180);
  const auto is_far = [](const auto& ends) { return TwinDrive::Metres(ends.first, ends.second) > 20; };
  const auto far = std::count_if(drive.verified.begin(), drive.verified.end(), is_far);
  EXPECT_GT(far, 5) << "the two halves do not look alike";
  const auto far_wrong = std::count_if(back.wrong.begin(), back.wrong.end(), is_far);
  EXPECT_GE(static_cast<double>(far_wrong), 0.9 * static_cast<double>(far));
  EXPECT_LE(back.wrong.size() - static_cast<std::size_t>(far_wrong), 1u);
  EXPECT_TRUE(drive.slam.Finish().Converged());
  EXPECT_LE(drive.AteMetres(), 2 * drive.AteMetres(drive.slam.OdometryTrajectory()));
  // Features are of poses of the map that it now is; and on it goes.
  for (int k = 0; k < 180; ++k) {
    EXPECT_TRUE(!drive.slam.Verifier().Has({k}) || drive.slam.Map().KeptBase({k}) == PoseId{k}) << k;
  }
  drive.decisions = back.decisions;
  drive.AddFrames(180, 184);
  EXPECT_LE(drive.AteMetres(), 2 * drive.AteMetres(drive.slam.OdometryTrajectory()));
  const LookedBack again = drive.slam.LookBack(drive.decisions);
  EXPECT_TRUE(again.decisions.empty() || again.decisions.size() == 184u);
}

// Without the kernel all are believed, and frames that are forgotten cannot be looked back at.
TEST(LookBack, OnlyWhereItMay) {
  TwinDrive all(RobustKernel::kNone);
  all.AddFrames(0, 180);
  EXPECT_EQ(all.slam.LookBack(all.decisions).why, "");
  EXPECT_GT(all.AteMetres(), 10);
  TwinDrive forgets(RobustKernel::kGnc, 20);
  forgets.AddFrames(0, 180);
  EXPECT_GT(forgets.slam.Map().PosesForgotten(), 0);
  const LookedBack back = forgets.slam.LookBack(forgets.decisions);
  EXPECT_TRUE(back.why.empty() && back.wrong.empty() && back.decisions.empty());
}

}  // namespace
}  // namespace terse
