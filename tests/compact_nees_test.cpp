// Compact maps are not more certain than they are right: the errors of FPFL over simulated runs against its
// covariances.

#include <gtest/gtest.h>

#include <cstdio>

#include "simulation.h"
#include "terse/compact/compact_graph.h"
#include "terse/covariance/marginals.h"
#include "testing_bounded.h"

namespace terse {
namespace {

constexpr int kRuns = 100;

template <class Pose>
class CompactNeesTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactNeesTest, Groups);

struct Sum {
  double nees = 0, dof = 0;
  // Not above the 95 % interval of what a consistent map has. Below it would be a map that knows less than it could.
  void ExpectNotAbove(const char* what) const {
    EXPECT_LE(nees, testing::ChiSquareQuantile(dof, 0.975)) << what << ": " << nees << " for " << dof;
    EXPECT_GE(nees, 0.5 * dof) << what << ": the covariances are far too large";
  }
};

// Of the kept poses after Finish: the newest, and all jointly.
template <class Pose>
void AddRun(std::uint64_t seed, CompositionOrder composition, bool priors, Sum& newest, Sum& all, long& dropped,
            long& links) {
  constexpr int B = Pose::kDof;
  testing::SimulationOptions simulation;
  simulation.poses = 81;
  simulation.priors = priors;
  const auto run = testing::Simulate<Pose>(seed, simulation);
  GraphReplay<Pose> replay(run.graph);
  CompactOptions<Pose> options = testing::OptionsFor(replay, Strategy::kFpfl);
  options.thresholds.min_loop_gain = 0.5 * B;
  options.thresholds.min_pose_gain = 1.2 * B;
  options.composition = composition;
  auto compact = testing::RunReplay(replay, options);
  compact.slam->Finish();
  const IncrementalMarginals<Pose> marginals(compact.slam->Solver());
  const auto& kept = compact.slam->Solver().Graph().Poses();
  std::vector<PoseId> ids;
  Eigen::VectorXd e(B * static_cast<Eigen::Index>(kept.size() - 1));
  for (std::size_t k = 1; k < kept.size(); ++k) {
    const Pose& truth = run.truth[static_cast<std::size_t>(kept[k].id.value)];
    e.segment<B>(B * static_cast<Eigen::Index>(ids.size())) = compact.slam->Estimate(kept[k].id).Local(truth);
    ids.push_back(kept[k].id);
  }
  newest.nees += testing::Nees(e.tail<B>(), marginals.Marginal(ids.back()));
  newest.dof += B;
  all.nees += testing::Nees(e, marginals.Joint(ids));
  all.dof += static_cast<double>(e.size());
  dropped += static_cast<long>(run.truth.size() - kept.size());
  links += compact.slam->LinksKept();
}

TYPED_TEST(CompactNeesTest, NotAboveTheInterval) {
  for (const auto composition : {CompositionOrder::kFirst, CompositionOrder::kFourth}) {
    SCOPED_TRACE(composition == CompositionOrder::kFirst ? "first order" : "fourth order");
    Sum newest, all;
    long dropped = 0, links = 0;
    for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
      AddRun<TypeParam>(seed, composition, false, newest, all, dropped, links);
    }
    newest.ExpectNotAbove("newest kept pose");
    all.ExpectNotAbove("all kept poses");
    EXPECT_GT(dropped, 20 * kRuns) << "poses have to be dropped for this to mean anything";
    EXPECT_GT(links, kRuns);
    std::printf("NEES / dof: newest %.3f, all %.3f; %.1f dropped\n", newest.nees / newest.dof, all.nees / all.dof,
                static_cast<double>(dropped) / kRuns);
  }
}

// With noisy positions and poses from the third pose on, every pose that has one kept.
TYPED_TEST(CompactNeesTest, NotAboveTheIntervalWithPriors) {
  Sum newest, all;
  long dropped = 0, links = 0;
  for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
    AddRun<TypeParam>(seed, CompositionOrder::kFirst, true, newest, all, dropped, links);
  }
  newest.ExpectNotAbove("newest kept pose");
  all.ExpectNotAbove("all kept poses");
  EXPECT_GT(dropped, 10 * kRuns) << "poses have to be dropped for this to mean anything";
  std::printf("NEES / dof with priors: newest %.3f, all %.3f; %.1f dropped\n", newest.nees / newest.dof,
              all.nees / all.dof, static_cast<double>(dropped) / kRuns);
}

// Bounded maps, over laps and over streets that cross each other again and again: all kept poses jointly, each of them
// by itself, and dropped ones. Errors of neighbours are correlated, so the means of few runs scatter by more than
// chi-square has it; a consistent map stays below this.
constexpr double kMostBoundedNees = 1.2;

template <class Pose>
void ExpectBoundedConsistent(const char* name, int runs,
                             const std::function<testing::RandomGraph<Pose>(std::uint64_t)>& make) {
  constexpr int B = Pose::kDof;
  Sum joint, each, dropped;
  long kept_poses = 0, edges = 0;
  for (int seed = 1; seed <= runs; ++seed) {
    const auto scene = make(static_cast<std::uint64_t>(seed));
    GraphReplay<Pose> replay(scene.graph);
    CompactOptions<Pose> options;
    options.strategy = Strategy::kBounded;
    options.record = Record::kNone;
    SampleThresholds(scene.graph, options);
    auto compact = testing::RunReplay(replay, options);
    compact.slam->Finish();
    for (const Decision& decision : compact.decisions) edges += static_cast<long>(decision.edges.size());
    const IncrementalMarginals<Pose> marginals(compact.slam->Solver());
    std::vector<PoseId> ids;
    std::vector<double> e;
    int k = 0;
    for (const auto& pose : compact.slam->Trajectory()) {
      const Vector<B> error = pose.T_world_body.Local(scene.truth[static_cast<std::size_t>(pose.id.value)]);
      if (++k == 1) continue;
      if (!pose.kept && k % 5 != 0) continue;
      Sum& sum = pose.kept ? each : dropped;
      sum.nees += testing::Nees(error, compact.slam->Covariance(pose.id));
      sum.dof += B;
      if (!pose.kept) continue;
      ids.push_back(pose.id);
      e.insert(e.end(), error.data(), error.data() + B);
    }
    kept_poses += static_cast<long>(ids.size());
    joint.nees +=
        testing::Nees(Eigen::Map<Eigen::VectorXd>(e.data(), static_cast<Eigen::Index>(e.size())), marginals.Joint(ids));
    joint.dof += static_cast<double>(e.size());
  }
  std::printf("%s: NEES / dof: kept jointly %.3f, each %.3f, dropped %.3f; %ld kept, %ld composed edges per run\n",
              name, joint.nees / joint.dof, each.nees / each.dof, dropped.nees / dropped.dof, kept_poses / runs,
              edges / runs);
  for (const Sum& sum : {joint, each, dropped}) {
    EXPECT_LT(sum.nees, kMostBoundedNees * sum.dof) << name;
    EXPECT_GT(sum.nees, 0.3 * sum.dof) << name << ": the covariances are far too large";
  }
}

TEST(BoundedNeesTest, LapsOfAnEllipse) {
  ExpectBoundedConsistent<SE3>("ellipse-n", 20, [](std::uint64_t seed) {
    testing::RandomGraph<SE3> out;
    GenerateOptions options;
    options.scene = Scene::kEllipseN;
    options.laps = 5;
    options.seed = seed;
    GenerateSink<SE3> sink;
    sink.pose = [&](PoseId id, const SE3& T) {
      out.truth.push_back(T);
      out.graph.AddPose(id, T);
    };
    sink.edge = [&](const RelativePoseFactor<SE3>& edge) { out.graph.AddFactor(edge); };
    Generate(options, sink);
    return out;
  });
}

TEST(BoundedNeesTest, StreetsOfManhattan) {
  ExpectBoundedConsistent<SE2>(
      "manhattan", 20, [](std::uint64_t seed) { return testing::MakeScene<SE2>(Scene::kManhattan, 1000, seed); });
}

TYPED_TEST(CompactNeesTest, BoundedOverLaps) {
  testing::LapsOptions options;
  options.laps = 10;
  ExpectBoundedConsistent<TypeParam>("laps", 40,
                                     [&](std::uint64_t seed) { return testing::MakeLaps<TypeParam>(seed, options); });
}

}  // namespace
}  // namespace terse
