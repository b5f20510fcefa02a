// Poses that retire while a map grows (CompactOptions::retire_share).

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>

#include <limits>
#include <set>

#include "slow_build.h"
#include "terse/compact/compact_graph.h"
#include "terse/covariance/marginals.h"
#include "testing_bounded.h"

namespace terse {
namespace {

using testing::Copy;
using testing::Laps;
using testing::LapsOptions;
using testing::Picture;

template <class Pose>
class CompactRetiringTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactRetiringTest, Groups);

// A first lap that nothing tells where the robot is, so that most of its poses are kept, and two that know better.
LapsOptions LongLaps(double noise = 1) {
  LapsOptions options;
  options.laps = 3;
  options.per_lap = kSlowBuild ? 130 : 220;
  options.noise = noise;
  return options;
}

template <class Pose>
std::set<PoseId> KeptBy(const CompactPoseSlam<Pose>& slam) {
  std::set<PoseId> out;
  for (const auto& node : slam.Solver().Graph().Poses()) out.insert(node.id);
  return out;
}

template <class Pose>
std::map<FactorId, typename CompactMap<Pose>::Edge> EdgesOf(const CompactPoseSlam<Pose>& slam) {
  std::map<FactorId, typename CompactMap<Pose>::Edge> out;
  for (const auto& edge : slam.Export().edges) out.emplace(edge.factor, edge);
  return out;
}

// What goes on is what the decisions say: which poses are kept, and edges that a pose which retired did not have.
TYPED_TEST(CompactRetiringTest, DecisionsTellWhoRetires) {
  using Pose = TypeParam;
  std::size_t retired = 0, in_run = 0;
  for (const std::uint64_t seed : testing::Seeds(1, 2)) {
    SCOPED_TRACE(seed);
    const Laps<Pose> laps(seed, LongLaps());
    CompactPoseSlam<Pose> slam(laps.options);
    std::set<PoseId> kept;
    for (const auto& input : laps.replay.Inputs()) {
      const auto before = EdgesOf(slam);
      const Decision decision = slam.AddPose(input);
      if (decision.Kept()) kept.insert(input.id);
      kept.insert(decision.revived.begin(), decision.revived.end());
      std::set<PoseId> gone;
      for (const RetiredPose& pose : decision.retired) {
        EXPECT_EQ(kept.erase(pose.id), 1u) << pose.id.value;
        EXPECT_LE(pose.loss, laps.options.retire_share * laps.options.thresholds.min_loop_gain);
        gone.insert(pose.id);
      }
      in_run += gone.size();
      if (gone.empty()) continue;
      ASSERT_EQ(KeptBy(slam), kept) << input.id.value;
      ASSERT_EQ(FindDefect(slam.Export()), "");
      for (const auto& [id, edge] : EdgesOf(slam)) {
        const auto was = before.find(id);
        if (was == before.end()) continue;
        EXPECT_EQ(edge.measured.from, was->second.measured.from);
        EXPECT_EQ(edge.measured.to, was->second.measured.to);
        if (edge.parts.size() == was->second.parts.size()) {
          EXPECT_EQ(testing::Bits(edge.measured.T_from_to), testing::Bits(was->second.measured.T_from_to)) << id.value;
        }
      }
      for (const auto& [id, edge] : before) {
        if (gone.count(edge.measured.from) + gone.count(edge.measured.to) > 0) {
          EXPECT_EQ(EdgesOf(slam).count(id), 0u) << id.value;
        }
      }
    }
    EXPECT_EQ(KeptBy(slam), kept);
    const double most_loss = laps.options.thresholds.min_loop_gain;
    for (const RetiredPose& pose : slam.Retire(most_loss)) retired += kept.erase(pose.id);
    EXPECT_EQ(KeptBy(slam), kept);
    const auto solved = SolveBatch(slam.Solver().Graph());
    EXPECT_NEAR(slam.Finish().chi2, solved.chi2, 1e-6 * (1 + solved.chi2));
    EXPECT_EQ(slam.Trajectory().size(), laps.replay.Inputs().size());
  }
  EXPECT_GT(in_run, 10u);
  EXPECT_GT(retired, 0u);
}

// The map is smaller by far and hardly worse.
TYPED_TEST(CompactRetiringTest, ASmallerMapIsAsGood) {
  using Pose = TypeParam;
  std::size_t kept = 0, kept_without = 0;
  double error = 0, error_without = 0;
  for (const std::uint64_t seed : testing::Seeds(11, 16)) {
    Laps<Pose> laps(seed, LongLaps());
    const auto run = [&](double share, std::size_t& poses, double& squared) {
      laps.options.retire_share = share;
      const auto done = RunCompact(CompactPoseSlam<Pose>(laps.options), laps.replay);
      poses += done.slam.Solver().Graph().Poses().size();
      const Pose T_truth_world = laps.scene.truth[0] * done.slam.Estimate(PoseId{0}).Inverse();
      for (const auto& pose : done.slam.Trajectory()) {
        const Pose& truth = laps.scene.truth[static_cast<std::size_t>(pose.id.value)];
        squared += ((T_truth_world * pose.T_world_body).Translation() - truth.Translation()).squaredNorm();
      }
    };
    run(0.3, kept, error);
    run(0, kept_without, error_without);
  }
  std::printf("%zu poses instead of %zu, mean square error %.3f of theirs\n", kept, kept_without,
              error / error_without);
  EXPECT_LT(kept, 0.75 * static_cast<double>(kept_without));
  if (kSlowBuild) return;  // too few seeds to say what it costs
  EXPECT_LT(error, 1.5 * error_without);
}

// Each measurement enters once, at most: nowhere is the map surer than the graph with all poses and links. Exact
// measurements, so that both are linearised at the true poses.
TYPED_TEST(CompactRetiringTest, NowhereSurerThanAllPosesAndLinks) {
  using Pose = TypeParam;
  for (const double share : {0.0, 0.3}) {
    SCOPED_TRACE(share);
    LapsOptions options = LongLaps(0);
    options.per_lap = 110;
    Laps<Pose> laps(21, options);
    laps.options.retire_share = share;
    const auto run = RunCompact(CompactPoseSlam<Pose>(laps.options), laps.replay);
    EXPECT_EQ(run.retired.empty(), share == 0);
    const Marginals<Pose> all(laps.scene.graph, laps.scene.truth);
    double least = std::numeric_limits<double>::max(), most = 0;
    for (const auto& node : run.slam.Solver().Graph().Poses()) {
      if (node.id == PoseId{0}) continue;
      const Eigen::MatrixXd of_all = all.Marginal(node.id), of_map = run.slam.Covariance(node.id);
      const Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd> ratio(of_map, of_all, Eigen::EigenvaluesOnly);
      least = std::min(least, ratio.eigenvalues().minCoeff());
      most = std::max(most, ratio.eigenvalues().maxCoeff());
    }
    std::printf("variances %.4f to %.1f of those with all poses and links\n", least, most);
    EXPECT_GT(least, 1 - 1e-6);
  }
}

TYPED_TEST(CompactRetiringTest, ASavedRunRetiresAsTheOneSaved) {
  using Pose = TypeParam;
  const Laps<Pose> laps(3, LongLaps());
  const auto inputs = laps.replay.Inputs();
  CompactPoseSlam<Pose> slam(laps.options);
  std::size_t k = 0;
  // Saved just before poses retire, and just after.
  while (k < inputs.size()) {
    CompactPoseSlam<Pose> before = k % 8 == 0 ? Copy(slam) : CompactPoseSlam<Pose>(laps.options);
    const bool is_saved = k % 8 == 0;
    std::size_t gone = 0;
    for (int n = 0; n < 8 && k < inputs.size(); ++n, ++k) gone += slam.AddPose(inputs[k]).retired.size();
    if (!is_saved || gone == 0) continue;
    for (std::size_t j = k - 8; j < k; ++j) before.AddPose(inputs[j]);
    ASSERT_EQ(Picture(before), Picture(slam));
    break;
  }
  ASSERT_LT(k, inputs.size()) << "nothing retired";
  CompactPoseSlam<Pose> after = Copy(slam);
  for (; k < inputs.size(); ++k) {
    slam.AddPose(inputs[k]);
    after.AddPose(inputs[k]);
  }
  slam.Retire();
  after.Retire();
  EXPECT_EQ(Picture(after), Picture(slam));
}

// Links that are in the map come out by id as ever; what went into factors of a retired pose is no link any more.
TYPED_TEST(CompactRetiringTest, LinksComeOutById) {
  using Pose = TypeParam;
  const Laps<Pose> laps(4, LongLaps());
  CompactPoseSlam<Pose> slam(laps.options);
  std::set<FactorId> links;
  std::size_t retired = 0;
  for (const auto& input : laps.replay.Inputs()) {
    const Decision decision = slam.AddPose(input);
    for (const auto& candidate : decision.candidates) {
      if (candidate.factor) links.insert(*candidate.factor);
    }
    retired += decision.retired.size();
  }
  retired += slam.Retire().size();
  ASSERT_GT(retired, 0u);
  int removed = 0, gone = 0;
  for (const FactorId id : links) {
    const auto edges = EdgesOf(slam);
    const auto it = edges.find(id);
    const std::string before = Picture(slam);
    if (it == edges.end() && !std::any_of(edges.begin(), edges.end(), [&](const auto& e) {
          return std::any_of(e.second.parts.begin(), e.second.parts.end(), [&](const auto& p) { return p.id == id; });
        })) {
      EXPECT_THROW(slam.RemoveLink(id), std::invalid_argument);
      EXPECT_EQ(Picture(slam), before);
      ++gone;
      continue;
    }
    try {
      slam.RemoveLink(id);
      ++removed;
      EXPECT_EQ(FindDefect(slam.Export()), "");
    } catch (const NumericalError&) {  // the map needs it
      EXPECT_EQ(Picture(slam), before);
    }
  }
  EXPECT_GT(removed, 3);
  EXPECT_GT(gone, 0);
  slam.Finish();
}

TYPED_TEST(CompactRetiringTest, OnlyWhereItMay) {
  using Pose = TypeParam;
  const Laps<Pose> laps(5, LongLaps());
  const auto retired = [&](const auto& change) {
    CompactOptions<Pose> options = laps.options;
    change(options);
    GraphReplay<Pose> replay(laps.scene.graph);
    const auto run = RunCompact(CompactPoseSlam<Pose>(options), replay);
    std::size_t count = run.retired.size();
    for (const Decision& decision : run.decisions) count += decision.retired.size();
    return count;
  };
  EXPECT_GT(retired([](auto&) {}), 10u);
  EXPECT_EQ(retired([](auto& options) { options.retire_share = 0; }), 0u);
  EXPECT_EQ(retired([](auto& options) { options.strategy = Strategy::kFpfl; }), 0u);
  EXPECT_EQ(retired([](auto& options) { options.budget.error = 1.5; }), 0u);
  EXPECT_EQ(retired([](auto& options) { options.solver.robust.kernel = RobustKernel::kHuber; }), 0u);
  CompactOptions<Pose> options = laps.options;
  for (const double share : {-0.1, std::numeric_limits<double>::quiet_NaN()}) {
    options.retire_share = share;
    EXPECT_THROW(CompactPoseSlam<Pose>{options}, std::invalid_argument);
  }
}

TYPED_TEST(CompactRetiringTest, OnDemandWithAnyStrategy) {
  using Pose = TypeParam;
  for (const Strategy strategy : {Strategy::kFpfl, Strategy::kApal, Strategy::kBounded}) {
    SCOPED_TRACE(Name(strategy));
    LapsOptions options;
    options.laps = 2;
    Laps<Pose> laps(6, options, strategy);
    CompactPoseSlam<Pose> slam = laps.Run();
    const std::string before = Picture(slam);
    EXPECT_THROW(slam.Retire(-1), std::invalid_argument);
    EXPECT_THROW(slam.Retire(std::numeric_limits<double>::quiet_NaN()), std::invalid_argument);
    EXPECT_EQ(Picture(slam), before);
    const std::size_t kept = KeptBy(slam).size();
    const std::vector<RetiredPose> out = slam.Retire(5);
    EXPECT_GT(out.size(), 0u);
    EXPECT_EQ(KeptBy(slam).size() + out.size(), kept);
    EXPECT_EQ(FindDefect(slam.Export()), "");
    EXPECT_TRUE(slam.Finish().Converged());
  }
}

}  // namespace
}  // namespace terse
