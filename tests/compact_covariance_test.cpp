// Covariances of poses kept and dropped, beside the dense inverse of the graph in which the dropped ones are poses like
// all others.

#include <gtest/gtest.h>

#include <cstdio>

#include "simulation.h"
#include "terse/compact/compact_map.h"
#include "terse/core/pose_values.h"
#include "terse/covariance/marginals.h"
#include "testing_chains.h"
#include "testing_compact.h"
#include "testing_files.h"

namespace terse {
namespace {

using testing::ChainOptions;
using testing::Chains;
using testing::RelativeError;
using testing::Seeds;

template <class Pose>
class CompactCovarianceTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactCovarianceTest, Groups);

// The oracle's covariances at given values, by index of the pose.
template <class Pose>
class Dense {
 public:
  static constexpr int B = Pose::kDof;
  using Jacobian = typename Pose::Jacobian;

  Dense(const PoseGraph<Pose>& graph, std::vector<Pose> values)
      : values_(std::move(values)), Sigma_(testing::Inverse(testing::MakeDenseSystem(graph, values_).H)) {}
  Jacobian Block(int a, int b) const { return Sigma_.block<B, B>(B * a, B * b); }
  Jacobian Relative(int a, int b) const {
    const Jacobian A = (Value(b).Inverse() * Value(a)).Adjoint();
    return A * Block(a, a) * A.transpose() + Block(b, b) - A * Block(a, b) - Block(b, a) * A.transpose();
  }
  const Pose& Value(int k) const { return values_[static_cast<std::size_t>(k)]; }

 private:
  std::vector<Pose> values_;
  Eigen::MatrixXd Sigma_;
};

struct Worst {
  double marginal = 0, relative = 0;
  int dropped = 0, behind = 0, branched = 0, same_chain = 0;  // cases that there were
};

// The worst relative errors over all poses and all pairs; `sharing`: pairs whose chains share odometry are left out.
template <class Pose>
void Compare(Chains<Pose>& chains, const Dense<Pose>& dense, bool sharing, Worst& worst) {
  const CompactPoseSlam<Pose>& slam = chains.Slam();
  for (int b = 0; b < chains.Size(); ++b) {
    const auto Sigma = slam.Covariance(chains.Id(b));
    EXPECT_EQ(Sigma, Sigma.transpose());
    worst.marginal = std::max(worst.marginal, RelativeError(Sigma, dense.Block(b, b)));
    worst.dropped += !chains.IsKept(b);
    worst.behind += !chains.IsKept(b) && chains.End(b) < 0;
    worst.branched += b > 0 && chains.Parent(b) != b - 1;
    for (int a = 0; a < chains.Size(); ++a) {
      const bool both = !chains.IsKept(a) && !chains.IsKept(b);
      if (a == b || (sharing && both && chains.End(a) != chains.End(b))) continue;
      worst.same_chain += both && chains.End(a) == chains.End(b) && chains.End(a) >= 0;
      const auto relative = slam.RelativeCovariance(chains.Id(a), chains.Id(b));
      EXPECT_EQ(relative, relative.transpose());
      worst.relative = std::max(worst.relative, RelativeError(relative, dense.Relative(a, b)));
    }
  }
}

// Exact measurements: estimates are the true poses, residuals are zero, and first order is all there is.
template <class Pose>
void ExpectOracle(const ChainOptions& options, double tolerance, std::uint64_t seeds) {
  Worst worst;
  for (const std::uint64_t seed : Seeds(1, seeds)) {
    Chains<Pose> chains(seed, options);
    const auto oracle = chains.Oracle();
    Compare(chains, Dense<Pose>(oracle, internal::ValuesOf(oracle)), options.shared_odometry, worst);
  }
  EXPECT_LT(worst.marginal, tolerance);
  EXPECT_LT(worst.relative, tolerance);
  EXPECT_GT(worst.dropped, 20);
  EXPECT_GT(worst.same_chain, 20);
  std::printf("marginal %.1e, relative %.1e; %d dropped, %d behind the last kept pose, %d branched\n", worst.marginal,
              worst.relative, worst.dropped, worst.behind, worst.branched);
}

// The dense inverse beside the anchor's 1e8 and the sums of chains round to some 1e-12.
constexpr double kTolerance = 1e-9;

TYPED_TEST(CompactCovarianceTest, EqualsTheGraphWithAllPoses) { ExpectOracle<TypeParam>({}, kTolerance, 9); }

TYPED_TEST(CompactCovarianceTest, WithoutLinksAndBranches) {
  ChainOptions options;
  options.link = options.branch = 0;
  ExpectOracle<TypeParam>(options, kTolerance, 3);
}

TYPED_TEST(CompactCovarianceTest, WithPriorsAndFixedPoses) {
  ChainOptions options;
  options.prior = 0.4;
  options.fixed = 0.3;
  ExpectOracle<TypeParam>(options, kTolerance, 6);
}

// Nothing but the first pose is kept.
TYPED_TEST(CompactCovarianceTest, BehindTheOnlyKeptPose) {
  ChainOptions options;
  options.keep = 0;
  Worst worst;
  Chains<TypeParam> chains(3, options);
  const auto oracle = chains.Oracle();
  Compare(chains, Dense<TypeParam>(oracle, internal::ValuesOf(oracle)), false, worst);
  EXPECT_EQ(worst.behind, chains.Size() - 1);
  EXPECT_LT(worst.marginal, kTolerance);
  EXPECT_LT(worst.relative, kTolerance);
}

// Where a chain ends that went on from a dropped pose of another one, the map takes the odometry that both share for
// two measurements. Covariances are the map's.
TYPED_TEST(CompactCovarianceTest, ChainsThatShareOdometryAreTheMaps) {
  ChainOptions options;
  options.branch = 0.5;
  options.shared_odometry = true;
  ExpectOracle<TypeParam>(options, kTolerance, 6);
}

TYPED_TEST(CompactCovarianceTest, PosesOfChainsThatShareOdometryAreKnownWellFromEachOther) {
  using Pose = TypeParam;
  ChainOptions options;
  options.branch = 0.5;
  options.shared_odometry = true;
  int pairs = 0;
  for (const std::uint64_t seed : Seeds(1, 6)) {
    Chains<Pose> chains(seed, options);
    const CompactPoseSlam<Pose>& slam = chains.Slam();
    for (int b = 1; b < chains.Size(); ++b) {
      const int a = chains.Parent(b);
      if (chains.IsKept(a) || chains.IsKept(b) || chains.End(a) == chains.End(b)) continue;
      // The odometry between the two is what there is, whatever chains they belong to.
      ++pairs;
      const auto relative = slam.RelativeCovariance(chains.Id(a), chains.Id(b));
      EXPECT_TRUE(testing::IsPositiveDefinite(relative)) << a << ", " << b;
      const typename Pose::Jacobian A = (chains.Truth(b).Inverse() * chains.Truth(a)).Adjoint();
      const typename Pose::Jacobian if_independent =
          A * slam.Covariance(chains.Id(a)) * A.transpose() + slam.Covariance(chains.Id(b));
      EXPECT_LT(relative.trace(), if_independent.trace());
    }
  }
  EXPECT_GT(pairs, kSlowBuild ? 1 : 5);
}

// A thousand metres of one chain: neither the composed covariance nor the distance from the base drowns what a step
// adds.
TYPED_TEST(CompactCovarianceTest, ALongChain) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  constexpr int kPoses = kSlowBuild ? 101 : 201;
  testing::Random rng(5);
  CompactOptions<Pose> options;
  options.strategy = Strategy::kGiven;
  CompactPoseSlam<Pose> slam(options);
  PoseGraph<Pose> graph;
  std::vector<Pose> values;
  for (int k = 0; k < kPoses; ++k) {
    typename Pose::Tangent step = 0.02 * testing::NormalVector<B>(rng);
    step[0] = 5;
    values.push_back(k == 0 ? Pose() : values.back().Retract(step));
    graph.AddPose(PoseId{k}, values.back());
    CompactInput<Pose> input;
    input.id = PoseId{k};
    input.keep = k + 1 == kPoses;
    if (k > 0) {
      input.odometry = RelativePoseFactor<Pose>{PoseId{k - 1}, PoseId{k}, Pose().Retract(step),
                                                testing::RandomInformation<B>(rng, 1e4)};
      graph.AddFactor(*input.odometry);
    }
    slam.AddPose(input, {});
  }
  const RelativePoseFactor<Pose> loop{PoseId{0}, PoseId{kPoses - 1}, values.front().Inverse() * values.back(),
                                      testing::RandomInformation<B>(rng, 1e4)};
  slam.AddLink(loop);
  graph.AddFactor(loop);
  const Marginals<Pose> all(graph, values);
  for (int k = 1; k + 1 < kPoses; ++k) {
    EXPECT_LT(RelativeError(slam.Covariance(PoseId{k}), all.Marginal(PoseId{k})), 1e-6) << k;
    EXPECT_LT(RelativeError(slam.RelativeCovariance(PoseId{k}, PoseId{k + 1}), all.Relative(PoseId{k}, PoseId{k + 1})),
              1e-5)
        << k;
  }
}

// With noise, the difference is of second order: it shrinks with the noise.
TYPED_TEST(CompactCovarianceTest, WithNoiseToFirstOrder) {
  using Pose = TypeParam;
  for (const double deviation : {1e-3, 1e-4}) {
    ChainOptions options;
    options.noise = 1;
    options.deviation = deviation;
    Worst worst;
    for (const std::uint64_t seed : Seeds(1, 6)) {
      Chains<Pose> chains(seed, options);
      chains.Slam().Finish();
      std::vector<Pose> values;
      for (const auto& pose : chains.Slam().Trajectory()) values.push_back(pose.T_world_body);
      Compare(chains, Dense<Pose>(chains.Oracle(), std::move(values)), false, worst);
    }
    std::printf("deviation %g: marginal %.1e, relative %.1e\n", deviation, worst.marginal, worst.relative);
    EXPECT_LT(worst.marginal, 20 * deviation);
    EXPECT_LT(worst.relative, 20 * deviation);
  }
}

// The gradient of chi2 in the dropped poses vanishes, also behind a dropped pose whose chain has ended.
TYPED_TEST(CompactCovarianceTest, TheRecoveredPosesAreTheOptimumOfTheGraphWithAllPoses) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  ChainOptions options;
  options.noise = 1;
  options.deviation = 1e-4;
  double v1 = 0, v2 = 0;
  for (const std::uint64_t seed : Seeds(1, 6)) {
    Chains<Pose> chains(seed, options);
    CompactPoseSlam<Pose>& slam = chains.Slam();
    slam.Finish();
    const auto oracle = chains.Oracle();
    const auto gradient = [&](Recovery recovery) {
      std::vector<Pose> values;
      for (const auto& pose : slam.Trajectory(recovery)) {
        values.push_back(pose.T_world_body);
        EXPECT_EQ(testing::Distance(values.back(), slam.Estimate(pose.id, recovery)), 0);
      }
      const Eigen::VectorXd b = testing::MakeDenseSystem(oracle, values).b;
      double sum = 0;
      for (int k = 0; k < chains.Size(); ++k) sum += chains.IsKept(k) ? 0 : b.segment<B>(B * k).norm();
      return sum;
    };
    v1 += gradient(Recovery::kV1);
    v2 += gradient(Recovery::kV2);
  }
  EXPECT_GT(v1, 1e4);
  EXPECT_LT(v2, 1e-2 * v1);
}

TYPED_TEST(CompactCovarianceTest, ConventionsAreAppliedAtTheRecoveredPose) {
  using Pose = TypeParam;
  ChainOptions options;
  options.noise = 1;
  Chains<Pose> chains(2, options);
  const CompactPoseSlam<Pose>& slam = chains.Slam();
  const CovarianceConvention world{CovarianceFrame::kWorldAxes, TangentOrder::kRotationFirst};
  for (int b = 1; b < chains.Size(); ++b) {
    const PoseId id = chains.Id(b), other = chains.Id(b / 2);
    const Pose T = slam.Estimate(id, Recovery::kV2), T_other_b = slam.Estimate(other, Recovery::kV2).Inverse() * T;
    EXPECT_LT(RelativeError(slam.Covariance(id, world), ConvertCovariance<Pose>(slam.Covariance(id), T, world)), 1e-12);
    EXPECT_LT(RelativeError(slam.RelativeCovariance(other, id, world),
                            ConvertCovariance<Pose>(slam.RelativeCovariance(other, id), T_other_b, world)),
              1e-12);
  }
}

TYPED_TEST(CompactCovarianceTest, KeptPosesAreTheMarginalsOfTheSolver) {
  Chains<TypeParam> chains(4, {});
  const CompactPoseSlam<TypeParam>& slam = chains.Slam();
  const IncrementalMarginals<TypeParam> marginals(slam.Solver());
  const PoseId first = chains.Id(0);
  EXPECT_LT(RelativeError(slam.Covariance(first), 1e-8 * TypeParam::Jacobian::Identity()), 1e-9) << "the anchor";
  for (const auto& node : slam.Solver().Graph().Poses()) {
    EXPECT_LT(RelativeError(slam.Covariance(node.id), marginals.Marginal(node.id)), 1e-12);
    if (node.id == first) continue;
    EXPECT_LT(RelativeError(slam.RelativeCovariance(first, node.id), marginals.Relative(first, node.id)), 1e-12);
  }
}

// With the fourth order too steps of a chain add what they add. Where errors are of some tenths of a radian, too large
// for what the order leaves out, nothing indefinite comes out.
TYPED_TEST(CompactCovarianceTest, FourthOrderCompositionStaysPositive) {
  for (const double deviation : {0.01, 0.1}) {
    ChainOptions options;
    options.composition = CompositionOrder::kFourth;
    options.deviation = deviation;
    options.noise = 1;
    for (const std::uint64_t seed : Seeds(1, 3)) {
      Chains<TypeParam> chains(seed, options);
      const CompactPoseSlam<TypeParam>& slam = chains.Slam();
      for (int b = 1; b < chains.Size(); ++b) {
        const auto relative = slam.RelativeCovariance(chains.Id(chains.Parent(b)), chains.Id(b));
        for (const auto& Sigma : {slam.Covariance(chains.Id(b)), relative}) {
          EXPECT_GT(testing::Eigenvalues(Sigma)[0], deviation < 0.1 ? 0 : -1e-12 * Sigma.norm()) << b;
        }
      }
    }
  }
}

TYPED_TEST(CompactCovarianceTest, ARestoredRunAnswersTheSame) {
  ChainOptions options;
  options.noise = 1;
  Chains<TypeParam> chains(6, options);
  chains.Slam().Finish();
  const TestFile file("slam.state");
  chains.Slam().Save(file.Path());
  const auto loaded = CompactPoseSlam<TypeParam>::Load(file.Path());
  const auto restored = CompactPoseSlam<TypeParam>::Restore(chains.Slam().Export(), chains.Slam().Options());
  for (int b = 1; b < chains.Size(); ++b) {
    const PoseId id = chains.Id(b), parent = chains.Id(chains.Parent(b));
    EXPECT_EQ(loaded.Covariance(id), chains.Slam().Covariance(id));
    EXPECT_EQ(loaded.RelativeCovariance(parent, id), chains.Slam().RelativeCovariance(parent, id));
    EXPECT_LT(RelativeError(restored.Covariance(id), chains.Slam().Covariance(id)), 1e-4);
  }
}

TEST(CompactCovariance, MisuseIsNamed) {
  CompactPoseSlam<SE2> slam;
  EXPECT_THROW(slam.Covariance(PoseId{0}), std::invalid_argument);
  slam.AddPose(CompactInput<SE2>{PoseId{0}, std::nullopt, std::nullopt, false, {}}, {});
  EXPECT_EQ(slam.Covariance(PoseId{0}).rows(), 3);
  EXPECT_THROW(slam.Covariance(PoseId{1}), std::invalid_argument);
  EXPECT_THROW(slam.RelativeCovariance(PoseId{0}, PoseId{1}), std::invalid_argument);
  EXPECT_THROW(slam.RelativeCovariance(PoseId{0}, PoseId{0}), std::invalid_argument);
}

// One dropped pose of each simulated run: its error is what its covariance says, and so is that of a dropped pose seen
// from another one.
template <class Pose>
void ExpectConsistent(double noise) {
  constexpr int kRuns = kSlowBuild ? 20 : 100;
  double nees = 0, relative_nees = 0, dof = 0;
  for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
    testing::SimulationOptions simulation;
    simulation.poses = 61;
    simulation.noise = noise;
    const auto run = testing::Simulate<Pose>(seed, simulation);
    GraphReplay<Pose> replay(run.graph);
    CompactOptions<Pose> options = testing::OptionsFor(replay, Strategy::kFpfl);
    options.thresholds.min_loop_gain = 0.5 * Pose::kDof;
    options.thresholds.min_pose_gain = 1.2 * Pose::kDof;
    auto compact = testing::RunReplay(replay, options);
    compact.slam->Finish();
    std::vector<PoseId> dropped;
    for (const auto& pose : compact.slam->Trajectory()) {
      if (!pose.kept) dropped.push_back(pose.id);
    }
    ASSERT_GT(dropped.size(), 10u);
    const auto truth = [&](PoseId id) { return run.truth[static_cast<std::size_t>(id.value)]; };
    const auto estimate = [&](PoseId id) { return compact.slam->Estimate(id, Recovery::kV2); };
    const PoseId a = dropped[seed % dropped.size()], b = dropped[(seed + dropped.size() / 2) % dropped.size()];
    nees += testing::Nees(estimate(a).Local(truth(a)), compact.slam->Covariance(a));
    relative_nees += testing::Nees((estimate(a).Inverse() * estimate(b)).Local(truth(a).Inverse() * truth(b)),
                                   compact.slam->RelativeCovariance(a, b));
    dof += Pose::kDof;
  }
  std::printf("NEES / dof: %.3f, relative %.3f\n", nees / dof, relative_nees / dof);
  for (const double sum : {nees, relative_nees}) {
    EXPECT_LT(sum, testing::ChiSquareQuantile(dof, 0.995));
    EXPECT_GT(sum, testing::ChiSquareQuantile(dof, 0.005));
  }
}

TYPED_TEST(CompactCovarianceTest, DroppedPosesAreAsCertainAsTheyAreRight) { ExpectConsistent<TypeParam>(1); }

}  // namespace
}  // namespace terse
