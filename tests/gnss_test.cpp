// Position priors in a growing map: what a first fix does to it, and what is known of its heading.

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdio>

#include "simulation.h"
#include "terse/compact/thresholds.h"
#include "terse/core/batch_solver.h"
#include "terse/core/generate.h"
#include "terse/core/initial_values.h"
#include "terse/covariance/incremental_marginals.h"
#include "terse/covariance/marginals.h"
#include "testing_compact.h"
#include "testing_incremental.h"

namespace terse {
namespace {

constexpr double kExact = 1e8;  // 0.1 mm

struct FixedLaps {
  PoseGraph<SE3> graph;
  std::vector<SE3> truth;
};

FixedLaps FixedEllipseLaps(int laps) {
  FixedLaps out;
  GenerateOptions options;
  options.scene = Scene::kEllipseN;
  options.laps = laps;
  GenerateSink<SE3> sink;
  sink.pose = [&](PoseId id, const SE3& T) {
    out.graph.AddPose(id, id.value == 0 ? std::optional<SE3>(T) : std::nullopt);
    out.truth.push_back(T);
  };
  sink.edge = [&](const RelativePoseFactor<SE3>& edge) { out.graph.AddFactor(edge); };
  Generate(options, sink);
  return out;
}

PositionPriorFactor<SE3> Fix(const FixedLaps& laps, std::int64_t id, double information = kExact) {
  return {PoseId{id}, laps.truth[static_cast<std::size_t>(id)].Translation(), information * Matrix<3, 3>::Identity()};
}

IncrementalSolver<SE3> Grown(const PoseGraph<SE3>& graph) {
  IncrementalSolver<SE3> solver;
  for (const auto& update : testing::OnePosePerUpdate(graph)) solver.Update(update);
  return solver;
}

double WorstRelative(const PoseMarginals<SE3>& a, const PoseMarginals<SE3>& b, const PoseGraph<SE3>& graph) {
  double worst = 0;
  const auto n = static_cast<std::int64_t>(graph.Poses().size());
  for (std::int64_t i = 0; i < n; i += 17) {
    for (std::int64_t j = i + 1; j < n; j += 23) {
      const auto expected = b.Relative(PoseId{i}, PoseId{j});
      worst = std::max(worst, (a.Relative(PoseId{i}, PoseId{j}) - expected).norm() / expected.norm());
    }
  }
  return worst;
}

TEST(GnssEllipseTest, RelativeCovariancesAgreeWithTheBatchOptimums) {
  const FixedLaps laps = FixedEllipseLaps(2);
  for (const std::vector<std::int64_t>& fixes :
       std::vector<std::vector<std::int64_t>>{{}, {40}, {40, 150}, {40, 100, 200}}) {
    SCOPED_TRACE(std::to_string(fixes.size()) + " fixes");
    PoseGraph<SE3> graph = laps.graph;
    for (const auto id : fixes) graph.AddFactor(Fix(laps, id));
    const IncrementalSolver<SE3> solver = Grown(graph);
    const auto batch = SolveBatch(graph, ComputeInitialValues(graph, InitialValues::kCompose));
    ASSERT_TRUE(batch.Converged()) << batch.message;
    const Marginals<SE3> optimum(graph, batch.T_world_body, CholeskyAt(graph, batch.T_world_body));
    const IncrementalMarginals<SE3> grown(solver);
    const double worst = WorstRelative(grown, optimum, graph);
    // What the offsets leave of the linearisation, with a fix as without; 1 % of a standard deviation.
    EXPECT_LT(worst, 0.025);
    std::printf("%zu fixes: relative covariances differ by %.2e at most\n", fixes.size(), worst);
  }
}

TEST(GnssEllipseTest, OneExactFixHardlyChangesTheCompactMap) {
  const FixedLaps laps = FixedEllipseLaps(2);
  const Thresholds<SE3> chosen = SelectThresholds(laps.graph).thresholds;
  const auto sizes = [&](const std::vector<std::int64_t>& fixes) {
    PoseGraph<SE3> graph = laps.graph;
    for (const auto id : fixes) graph.AddFactor(Fix(laps, id));
    GraphReplay<SE3> replay(graph);
    auto options = testing::OptionsFor(replay, Strategy::kFpfl);
    options.thresholds = chosen;
    auto run = testing::RunReplay(replay, options);
    return std::make_pair(static_cast<double>(run.slam->Solver().Graph().Poses().size()), run.slam->LinksKept());
  };
  const auto without = sizes({});
  ASSERT_GT(without.second, 10);
  for (const std::vector<std::int64_t>& fixes : std::vector<std::vector<std::int64_t>>{{40}, {0}, {205}}) {
    SCOPED_TRACE(fixes.front());
    const auto with = sizes(fixes);
    EXPECT_LE(std::abs(with.first - without.first), 0.1 * without.first);
    EXPECT_LE(std::abs(with.second - without.second), 0.1 * without.second);
    std::printf("%.0f poses, %d links; with the fix %.0f, %d\n", without.first, without.second, with.first,
                with.second);
  }
}

template <class Pose>
class GnssTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(GnssTest, Groups);

// A circle in twenty steps of a metre, twice around and closed, in the frame of its first pose; the world is turned and
// far away. Odometry of 1 cm and 5 mrad.
template <class Pose>
struct Circle {
  static constexpr int B = Pose::kDof, D = Pose::kDim;
  explicit Circle(std::uint64_t seed = 1, double turn = 2.5) {
    testing::Random rng(seed);
    typename Pose::Tangent to_world = Pose::Tangent::Zero();
    to_world.template head<D>().setConstant(1000);
    to_world[B - 1] = turn;
    T_world_map = Pose::Exp(to_world);
    typename Pose::Tangent step = Pose::Tangent::Zero();
    step[0] = 1;
    step[B - 1] = M_PI / 10;
    if (D == 3) step[D] = 0.05;
    Vector<B> sigma = Vector<B>::Constant(0.01);
    sigma.template tail<B - D>().setConstant(0.005);
    information = sigma.cwiseAbs2().cwiseInverse().asDiagonal();
    const auto measure = [&](int i, int j) {
      const Pose T = truth[std::size_t(i)].Inverse() * truth[std::size_t(j)];
      const typename Pose::Tangent noise = testing::NormalVector<B>(rng).cwiseProduct(sigma);
      graph.AddFactor(RelativePoseFactor<Pose>{PoseId{i}, PoseId{j}, T * Pose().Retract(noise), information});
    };
    for (int k = 0; k < 40; ++k) {
      truth.push_back(k == 0 ? Pose() : truth.back() * Pose().Retract(step));
      graph.AddPose(PoseId{k}, k == 0 ? std::optional<Pose>(Pose()) : std::nullopt);
      if (k > 0) measure(k - 1, k);
      if (k >= 20 && k % 4 == 0) measure(k - 20, k);
    }
    for (Pose& T : truth) T = T_world_map * T;
  }
  PositionPriorFactor<Pose> Fix(int k, double sigma = 0.1) const {
    return {PoseId{k}, truth[std::size_t(k)].Translation(), Matrix<D, D>::Identity() / (sigma * sigma)};
  }
  double Error(const IncrementalSolver<Pose>& solver) const {
    double worst = 0;
    for (std::size_t k = 0; k < solver.Graph().Poses().size(); ++k) {
      const Pose T = solver.Estimate(PoseId{static_cast<std::int64_t>(k)});
      worst = std::max(worst, (T.Translation() - truth[k].Translation()).norm());
    }
    return worst;
  }
  PoseGraph<Pose> graph;
  std::vector<Pose> truth;
  Pose T_world_map;
  typename Pose::Jacobian information;
};

// Whenever the fixes come, and however the map was turned: no step has to turn it.
TYPED_TEST(GnssTest, TheMapGoesToItsFixesAndHeadingIsSaidToBeUnknownBefore) {
  using Pose = TypeParam;
  for (const double turn : {0.3, 1.6, 3.1}) {
    SCOPED_TRACE(turn);
    const Circle<Pose> circle(1, turn);
    IncrementalSolver<Pose> solver = [&] {
      IncrementalSolver<Pose> out;
      for (const auto& update : testing::OnePosePerUpdate(circle.graph)) out.Update(update);
      return out;
    }();
    EXPECT_EQ(solver.DescribeUndetermined(), "");
    std::vector<std::string> log;
    solver.SetLog([&](LogLevel level, std::string_view text) {
      if (level >= LogLevel::kInfo) log.emplace_back(text);
    });
    const double chi2 = solver.Chi2();
    const auto add = [&](int k) {
      GraphUpdate<Pose> update;
      update.factors.push_back(circle.Fix(k));
      return solver.Update(update).factor_ids.front();
    };
    const std::vector<Pose> before = solver.Estimates();
    add(3);
    EXPECT_EQ(solver.DescribeUndetermined().find("heading"), 0u) << solver.DescribeUndetermined();
    EXPECT_NEAR(solver.Chi2(), chi2, 1e-3 * chi2) << "a fix alone costs nothing";
    EXPECT_LT((solver.Estimate(PoseId{3}).Translation() - circle.truth[3].Translation()).norm(), 1e-6);
    for (std::size_t k = 0; k < before.size(); ++k) {
      const Pose moved = before[0].Inverse() * before[k],
                 now = solver.EstimateAt(0).Inverse() * solver.EstimateAt(int(k));
      ASSERT_LT(moved.Local(now).norm(), 1e-4) << "moved as a whole";
    }
    const bool said = std::any_of(log.begin(), log.end(), [](const std::string& line) {
      return line.find("not determined by the priors yet") != std::string::npos;
    });
    EXPECT_TRUE(said);
    const FactorId second = add(13);
    EXPECT_EQ(solver.CurrentGauge().free_turns, Pose::kDim == 2 ? 0 : 1);
    add(8);
    EXPECT_TRUE(solver.CurrentGauge().IsDetermined());
    EXPECT_EQ(solver.DescribeUndetermined(), "");
    EXPECT_LT(circle.Error(solver), 0.5) << "without Finish";
    const double at_once = solver.Chi2();
    const auto result = solver.Finish();
    EXPECT_TRUE(result.Converged());
    EXPECT_NEAR(at_once, result.chi2, 0.02 * result.chi2);
    // What is removed is not known any more.
    GraphUpdate<Pose> removal;
    removal.removed.push_back(second);
    solver.Update(removal);
    removal.removed = {FactorId{second.value + 1}};
    solver.Update(removal);
    EXPECT_EQ(solver.CurrentGauge().free_turns, Gauge<Pose>::kTurns);
    EXPECT_NE(solver.DescribeUndetermined(), "");
  }
}

// The same map whenever they come, within what the incremental solver leaves; covariances agree with batch at any time.
TYPED_TEST(GnssTest, PriorsAtAnyTime) {
  using Pose = TypeParam;
  const Circle<Pose> circle;
  const auto measured = [&](int kind) {
    std::vector<Factor<Pose>> priors;
    if (kind == 0) priors = {circle.Fix(0), circle.Fix(11), circle.Fix(27), circle.Fix(35)};
    if (kind == 1) priors = {PosePriorFactor<Pose>{PoseId{25}, circle.truth[25], circle.information}};
    if (kind == 2) priors = {circle.Fix(2, 1), PosePriorFactor<Pose>{PoseId{25}, circle.truth[25], circle.information}};
    return priors;
  };
  for (const int kind : {0, 1, 2}) {
    SCOPED_TRACE("kind " + std::to_string(kind));
    PoseGraph<Pose> full = circle.graph;
    for (const auto& prior : measured(kind)) full.AddFactor(prior);
    const auto batch = SolveBatch(full, ComputeInitialValues(full, InitialValues::kCompose));
    ASSERT_TRUE(batch.Converged()) << batch.message;
    const Marginals<Pose> optimum(full, batch.T_world_body, CholeskyAt(full, batch.T_world_body));
    for (const auto carry : {Carry::kOffset, Carry::kPoint}) {
      for (const bool late : {false, true}) {
        SCOPED_TRACE(std::string(late ? "late" : "with the pose") + (carry == Carry::kPoint ? ", points" : ""));
        IncrementalOptions options;
        options.carry = carry;
        options.max_iterations = 10;
        IncrementalSolver<Pose> solver(options);
        for (const auto& update : testing::OnePosePerUpdate(late ? circle.graph : full)) solver.Update(update);
        for (const auto& prior : late ? measured(kind) : std::vector<Factor<Pose>>{}) {
          GraphUpdate<Pose> update;
          update.factors.push_back(prior);
          solver.Update(update);
        }
        EXPECT_NEAR(solver.Chi2(), batch.chi2, 0.01 * batch.chi2);
        const IncrementalMarginals<Pose> grown(solver);
        for (const int k : {0, 7, 39}) {
          const PoseId a{k}, b{(k + 17) % 40};
          const auto expected = optimum.Relative(a, b);
          EXPECT_LT((grown.Relative(a, b) - expected).norm(), 0.01 * expected.norm());
          const auto marginal = optimum.Marginal(a);
          EXPECT_LT((grown.Marginal(a) - marginal).norm(), 0.01 * marginal.norm());
        }
      }
    }
  }
}

// A pose held at a value that contradicts the frame so far.
TYPED_TEST(GnssTest, AFixedPoseTakesTheMapAlong) {
  using Pose = TypeParam;
  const Circle<Pose> circle;
  auto updates = testing::OnePosePerUpdate(circle.graph);
  updates[30].poses.front().T_world_body = circle.truth[30];
  updates[30].poses.front().fixed = true;
  IncrementalSolver<Pose> solver;
  for (const auto& update : updates) solver.Update(update);
  EXPECT_LT(circle.Error(solver), 0.5);
  EXPECT_LT(solver.Estimate(PoseId{30}).Local(circle.truth[30]).norm(), 1e-4);
  EXPECT_TRUE(solver.CurrentGauge().IsDetermined());
}

// A refused update moves nothing.
TYPED_TEST(GnssTest, FixesAreAtomic) {
  using Pose = TypeParam;
  const Circle<Pose> circle;
  IncrementalSolver<Pose> solver;
  for (const auto& update : testing::OnePosePerUpdate(circle.graph)) solver.Update(update);
  const std::vector<Pose> before = solver.Estimates();
  GraphUpdate<Pose> update;
  update.factors.push_back(circle.Fix(5));
  update.poses.push_back({PoseId{77}, Pose(), false});  // nothing holds it
  EXPECT_THROW(solver.Update(update), std::runtime_error);
  for (std::size_t k = 0; k < before.size(); ++k) EXPECT_EQ(solver.EstimateAt(int(k)).Local(before[k]).norm(), 0);
  EXPECT_EQ(solver.DescribeUndetermined(), "");
}

// Five poses on a line of which the middle ones are dropped.
template <class Pose>
std::unique_ptr<CompactPoseSlam<Pose>> LineWithDropped(double information) {
  CompactOptions<Pose> options;
  options.strategy = Strategy::kFpfl;
  options.thresholds.range.setConstant(100);
  options.thresholds.range[Pose::kDim] = 3;
  options.thresholds.min_pose_gain = 1e3;  // nothing but a prior keeps a pose
  options.thresholds.link_covariance = 1e-4 * Pose::Jacobian::Identity();
  auto slam = std::make_unique<CompactPoseSlam<Pose>>(options);
  typename Pose::Tangent step = Pose::Tangent::Zero();
  step[0] = 1;
  step[Pose::kDof - 1] = 0.2;
  for (int k = 0; k < 5; ++k) {
    CompactInput<Pose> input;
    input.id = PoseId{k};
    if (k > 0) {
      input.odometry = RelativePoseFactor<Pose>{PoseId{k - 1}, PoseId{k}, Pose().Retract(step),
                                                information * Pose::Jacobian::Identity()};
    }
    slam->AddPose(input, nullptr);
  }
  return slam;
}

TYPED_TEST(GnssTest, ALatePositionOnADroppedPoseGoesThroughItsChain) {
  using Pose = TypeParam;
  constexpr int D = Pose::kDim;
  auto slam = LineWithDropped<Pose>(1e4);
  ASSERT_EQ(slam->Solver().Graph().Poses().size(), 1u);
  const Pose T_world_map = testing::Measured(Pose(), [] {
    typename Pose::Tangent t = Pose::Tangent::Zero();
    t.setConstant(0.5);
    return t;
  }());
  std::vector<Pose> truth;
  for (int k = 0; k < 5; ++k) truth.push_back(T_world_map * slam->Estimate(PoseId{k}));
  typename Pose::Position lever = Pose::Position::Zero();
  lever[1] = 0.3;
  const auto fix = [&](int k) {
    PositionPriorFactor<Pose> prior{PoseId{k}, truth[std::size_t(k)] * lever, 1e4 * Matrix<D, D>::Identity()};
    prior.p_body = lever;
    return prior;
  };
  for (const int k : {1, 4, 0, 2}) slam->AddPrior(fix(k));
  EXPECT_EQ(slam->Solver().DescribeUndetermined(), "");
  slam->Finish();
  // Exact measurements: the map is where they say, dropped poses included.
  for (int k = 0; k < 5; ++k) EXPECT_LT(slam->Estimate(PoseId{k}).Local(truth[std::size_t(k)]).norm(), 1e-6) << k;
  // Each counts as much as its own and its chain's covariance together allow.
  const auto& factors = slam->Solver().Graph().Factors();
  const auto& carried = std::get<PositionPriorFactor<Pose>>(factors[3].factor);  // of pose 2, heading known
  EXPECT_EQ(carried.pose, PoseId{0});
  UncertainPose<Pose> chain;
  for (int k = 0; k < 2; ++k) {
    chain = Compose(chain, UncertainPose<Pose>{truth[0].Inverse() * truth[1], 1e-4 * Pose::Jacobian::Identity()});
  }
  EXPECT_LT((carried.p_body - chain.T_a_b * lever).norm(), 1e-9);
  testing::Random rng(3);
  Eigen::Matrix<double, D, D> sampled = Eigen::Matrix<double, D, D>::Zero();
  constexpr int kDraws = 20000;
  const Eigen::LLT<Eigen::Matrix<double, Pose::kDof, Pose::kDof>> llt(chain.covariance);
  for (int draw = 0; draw < kDraws; ++draw) {
    const typename Pose::Tangent d = llt.matrixL() * testing::NormalVector<Pose::kDof>(rng);
    const typename Pose::Position e = (truth[0] * chain.T_a_b * Pose::Exp(d)) * lever - truth[2] * lever;
    sampled += e * e.transpose() / kDraws;
  }
  sampled += 1e-4 * Eigen::Matrix<double, D, D>::Identity();
  const Eigen::Matrix<double, D, D> stated = carried.information.inverse();
  EXPECT_LT((stated - sampled).norm(), 0.05 * sampled.norm());
}

TYPED_TEST(GnssTest, WhileHeadingIsUnknownTheChainCountsWithItsLargestVariance) {
  using Pose = TypeParam;
  constexpr int D = Pose::kDim;
  auto slam = LineWithDropped<Pose>(1e4);
  slam->AddPrior(PositionPriorFactor<Pose>{PoseId{3}, Pose::Position::Ones(), 1e4 * Matrix<D, D>::Identity()});
  const auto& carried = std::get<PositionPriorFactor<Pose>>(slam->Solver().Graph().Factors()[0].factor);
  EXPECT_LT((carried.information - carried.information(0, 0) * Matrix<D, D>::Identity()).norm(), 1e-6);
  EXPECT_LT(carried.information(0, 0), 0.4e4);
  EXPECT_EQ(slam->Solver().DescribeUndetermined().find("heading"), 0u);
}

}  // namespace
}  // namespace terse
