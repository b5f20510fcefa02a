// What an incremental step decides, reports and defers, against dense linear algebra.

#include <gtest/gtest.h>

#include "terse/core/residual.h"
#include "testing_incremental.h"

namespace terse {
namespace {

using testing::Exact;
using testing::ExpectEqualsDense;
using testing::OnePosePerUpdate;
using testing::Random;

constexpr Gate kGates[] = {Gate::kNewtonDecrement, Gate::kMutualInformation,
                           Gate::kLogDeterminant,  Gate::kLoopClosure,
                           Gate::kAlways,          Gate::kNever};

template <class Pose>
class IncrementalGateTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(IncrementalGateTest, Groups);

IncrementalOptions Gated(Gate gate) {
  IncrementalOptions options = Exact();
  options.gate = gate;
  options.gate_threshold = DefaultThreshold(gate);
  return options;
}

// Loops (double ones and backward ones among them), priors if asked for, and removals of what is not needed.
template <class Pose>
struct RandomRun {
  RandomRun(std::uint64_t seed, bool priors, int poses = 30) : rng(seed) {
    testing::RandomGraphOptions options;
    options.poses = poses;
    options.noise = 0.05;
    options.loops_per_pose = 0.7;
    options.priors = priors;
    options.id_stride = kIdStride;
    random = testing::MakeRandomGraph<Pose>(rng, options);
    updates = OnePosePerUpdate(random.graph);
  }

  void MaybeRemove(const PoseGraph<Pose>& graph, GraphUpdate<Pose>& update) {
    testing::MaybeRemove(rng, graph, kIdStride, update);
  }

  static constexpr std::int64_t kIdStride = 2;
  Random rng;
  testing::RandomGraph<Pose> random;
  std::vector<GraphUpdate<Pose>> updates;
};

Eigen::VectorXd Solution(const std::vector<double>& d, Eigen::Index size) {
  Eigen::VectorXd x = Eigen::VectorXd::Zero(size);
  x.head(static_cast<Eigen::Index>(d.size())) =
      Eigen::Map<const Eigen::VectorXd>(d.data(), static_cast<Eigen::Index>(d.size()));
  return x;
}

// Whether an absolute measurement took the frame over in a step: then the map has moved as a whole.
template <class Pose>
bool TookTheFrame(const Gauge<Pose>& before, const IncrementalSolver<Pose>& solver) {
  const Gauge<Pose>& now = solver.CurrentGauge();
  return before.free_shifts != now.free_shifts || before.free_turns != now.free_turns;
}

// The linearisation points before a step, and those that its new poses get.
template <class Pose>
std::vector<Pose> WithNewPoints(std::vector<Pose> before, const IncrementalSolver<Pose>& after) {
  const auto& points = after.LinearizationPoints();
  before.insert(before.end(), points.begin() + static_cast<std::ptrdiff_t>(before.size()), points.end());
  return before;
}

TYPED_TEST(IncrementalGateTest, EqualsDenseAfterEveryStepWithAnyGate) {
  for (const Gate gate : kGates) {
    int open = 0;
    for (const std::uint64_t seed : testing::Seeds(1, 4)) {
      SCOPED_TRACE("gate " + std::to_string(static_cast<int>(gate)) + ", seed " + std::to_string(seed));
      RandomRun<TypeParam> run(seed, seed % 2 == 0);
      IncrementalSolver<TypeParam> solver(Gated(gate));
      for (auto& update : run.updates) {
        run.MaybeRemove(solver.Graph(), update);
        const auto before = solver.Estimates();
        const Gauge<TypeParam> gauge = solver.CurrentGauge();
        const auto report = solver.Update(update);
        open += report.gate_open ? 1 : 0;
        ExpectEqualsDense(solver, report.gate_open);
        if (this->HasFatalFailure()) return;
        if (report.gate_open || TookTheFrame(gauge, solver)) continue;
        EXPECT_LE(report.variables_moved, static_cast<int>(update.poses.size()));
        for (std::size_t i = 0; i < before.size(); ++i) {
          ASSERT_EQ(before[i].Translation(), solver.EstimateAt(static_cast<int>(i)).Translation());
        }
      }
      const auto batch = SolveBatch(solver.Graph(), run.random.truth);
      ASSERT_TRUE(batch.Converged());
      EXPECT_NEAR(solver.Finish().chi2, batch.chi2, 1e-8 * batch.chi2);
      EXPECT_NEAR(solver.Chi2(), batch.chi2, 1e-8 * batch.chi2);
      ExpectEqualsDense(solver);
    }
    if (gate == Gate::kNever) {
      EXPECT_EQ(open, 0);
    } else {
      EXPECT_GT(open, 0) << "gate " << static_cast<int>(gate);
    }
  }
}

// With everything relinearised in every step, a step is a Gauss-Newton iteration from the estimate before it.
TYPED_TEST(IncrementalGateTest, AlwaysWithZeroTolerancesIsGaussNewton) {
  constexpr int B = TypeParam::kDof;
  IncrementalOptions options = Gated(Gate::kAlways);
  options.relinearize_tolerance = 0;
  options.relinearize_interval = 1;
  options.max_iterations = 1;
  // Errors below the rounding of their sum stay: 1e-16 of chi2, a square.
  for (const std::uint64_t seed : testing::Seeds(1, 3)) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    RandomRun<TypeParam> run(seed, seed == 2);
    for (int k = 0; k < 40; ++k) run.updates.emplace_back();
    IncrementalSolver<TypeParam> solver(options);
    for (auto& update : run.updates) {
      run.MaybeRemove(solver.Graph(), update);
      const auto points = solver.Estimates();
      const Gauge<TypeParam> gauge = solver.CurrentGauge();
      solver.Update(update);
      if (TookTheFrame(gauge, solver)) continue;
      const auto from = WithNewPoints(points, solver);
      const auto dense = testing::MakeDenseSystem(solver.Graph(), from, &solver.CurrentGauge());
      const Eigen::VectorXd x = testing::Solve(dense.H, dense.b);
      for (std::size_t i = 0; i < from.size(); ++i) {
        const Vector<B> d = x.template segment<B>(static_cast<Eigen::Index>(i) * B);
        ASSERT_LT(from[i].Retract(d).Local(solver.EstimateAt(static_cast<int>(i))).norm(), 1e-5)
            << "pose " << i << " of " << from.size();
      }
    }
    const auto batch = SolveBatch(solver.Graph(), run.random.truth);
    EXPECT_NEAR(solver.Chi2(), batch.chi2, 1e-8 * batch.chi2);
  }
}

TYPED_TEST(IncrementalGateTest, ClosedGatePlacesNewPosesOnly) {
  RandomRun<TypeParam> run(7, false);
  IncrementalSolver<TypeParam> solver(Gated(Gate::kNever));
  for (const auto& update : run.updates) {
    const auto before = solver.Estimates();
    const auto report = solver.Update(update);
    EXPECT_FALSE(report.gate_open);
    EXPECT_EQ(report.iterations, 0);
    EXPECT_EQ(report.variables_relinearised, 0);
    const auto after = solver.Estimates();
    for (std::size_t i = 0; i < before.size(); ++i) ASSERT_EQ(before[i].Translation(), after[i].Translation());
    // The new pose is at the minimum of its factors, linearised: no step of its own lowers the linear cost.
    const auto dense = testing::MakeDenseSystem(solver.Graph(), solver.LinearizationPoints(), &solver.CurrentGauge());
    const Eigen::VectorXd gradient = dense.H * Solution(solver.Cholesky().Solution(), dense.b.size()) - dense.b;
    EXPECT_LT(gradient.tail<TypeParam::kDof>().norm(), 1e-8 * (1 + dense.b.norm()));
  }
}

// What the new factors say about the old poses: the growth of the information that is left when the new ones are
// eliminated.
TYPED_TEST(IncrementalGateTest, GainIsThatOfTheOldPosesInformation) {
  constexpr int B = TypeParam::kDof;
  for (const int together : {1, 3}) {
    RandomRun<TypeParam> run(11, false);
    IncrementalOptions options = Gated(Gate::kMutualInformation);
    options.max_iterations = 1;  // new poses keep their first linearisation point for the step
    IncrementalSolver<TypeParam> solver(options);
    double largest = 0;
    for (std::size_t k = 0; k < run.updates.size(); k += static_cast<std::size_t>(together)) {
      GraphUpdate<TypeParam> update = run.updates[k];
      for (std::size_t more = k + 1; more < std::min(run.updates.size(), k + static_cast<std::size_t>(together));
           ++more) {
        update.poses.push_back(run.updates[more].poses[0]);
        update.factors.insert(update.factors.end(), run.updates[more].factors.begin(), run.updates[more].factors.end());
      }
      const auto points = solver.LinearizationPoints();
      const PoseGraph<TypeParam> graph = solver.Graph();
      const auto report = solver.Update(update);
      if (points.empty()) {
        EXPECT_EQ(report.gain_nats, 0);
        continue;
      }
      const auto before = testing::MakeDenseSystem(graph, points);
      const auto after = testing::MakeDenseSystem(solver.Graph(), WithNewPoints(points, solver));
      if (together == 1) {
        const Eigen::Index n = before.b.size();
        const Eigen::MatrixXd left =
            after.H.topLeftCorner(n, n) - after.H.topRightCorner(n, B) * testing::Solve(after.H.bottomRightCorner(B, B),
                                                                                        after.H.bottomLeftCorner(B, n));
        EXPECT_NEAR(report.gain_nats, 0.5 * (testing::LogDeterminant(left) - testing::LogDeterminant(before.H)), 1e-6);
        // Odometry says nothing about what was known.
        if (update.factors.size() == 1) {
          EXPECT_NEAR(report.gain_nats, 0, 1e-9);
        }
        EXPECT_EQ(report.gate_value, report.gain_nats);
        EXPECT_EQ(report.gate_open, report.gain_nats > 0.1);
      } else {
        const Eigen::Index m = after.b.size() - before.b.size();
        EXPECT_NEAR(report.gain_nats,
                    0.5 * (testing::LogDeterminant(after.H) - testing::LogDeterminant(before.H) -
                           testing::LogDeterminant(after.H.bottomRightCorner(m, m))),
                    1e-6);
      }
      largest = std::max(largest, report.gain_nats);
    }
    EXPECT_GT(largest, 1);
  }
}

TYPED_TEST(IncrementalGateTest, NewtonDecrementIsTheDenseLinearDecrease) {
  for (const DecreaseScale scale : {DecreaseScale::kAbsolute, DecreaseScale::kChi2, DecreaseScale::kDof}) {
    for (const double threshold : {0.0, 0.05, 1e9}) {
      SCOPED_TRACE("scale " + std::to_string(static_cast<int>(scale)) + ", threshold " + std::to_string(threshold));
      RandomRun<TypeParam> run(13, true);
      IncrementalOptions options = Gated(Gate::kNewtonDecrement);
      options.decrease_scale = scale;
      options.gate_threshold = threshold;
      options.relinearize_interval = 5;
      options.max_iterations = 1;  // new poses keep their first linearisation point for the step
      IncrementalSolver<TypeParam> solver(options);
      int open = 0;
      for (auto& update : run.updates) {
        run.MaybeRemove(solver.Graph(), update);
        const auto points = solver.LinearizationPoints();
        const auto d_before = solver.Cholesky().Solution();
        const Gauge<TypeParam> gauge = solver.CurrentGauge();
        const auto report = solver.Update(update);
        if (TookTheFrame(gauge, solver)) continue;
        const auto from = WithNewPoints(points, solver);
        const auto dense = testing::MakeDenseSystem(solver.Graph(), from, &solver.CurrentGauge());
        const Eigen::VectorXd x = testing::Solve(dense.H, dense.b);
        const Eigen::VectorXd missing = Solution(d_before, x.size()) - x;
        const double decrease = missing.dot(dense.H * missing);
        double scalars = 0, chi2 = -x.dot(dense.b);  // linearised, at the minimum
        for (const auto& node : solver.Graph().Factors()) {
          const FactorPoses ends = PosesOf(node.factor);
          scalars += Dimension(node.factor);
          chi2 += FactorChi2(node.factor, from[static_cast<std::size_t>(solver.Graph().IndexOf(ends.first))],
                             from[static_cast<std::size_t>(solver.Graph().IndexOf(ends.second))]);
        }
        const double dof = std::max(1.0, scalars - static_cast<double>(x.size()));
        double unit = 1;
        if (scale == DecreaseScale::kChi2) unit = std::max(chi2, 1e-6 * dof);
        if (scale == DecreaseScale::kDof) unit = dof;
        // The cost is a sum that goes up and down with every step.
        ASSERT_NEAR(report.gate_value * unit, decrease, 1e-6 * (1e-3 + decrease + unit * 1e-3));
        open += report.gate_open ? 1 : 0;
      }
      EXPECT_EQ(open == 0, threshold > 1e8);
    }
  }
}

TYPED_TEST(IncrementalGateTest, ReportsAreConsistent) {
  RandomRun<TypeParam> run(17, true, 60);
  IncrementalOptions options;
  options.report_cost = true;
  IncrementalSolver<TypeParam> solver(options);
  std::map<CholeskyPath, int> paths;
  for (std::size_t k = 0; k < run.updates.size() + 5; ++k) {
    GraphUpdate<TypeParam> update;
    if (k < run.updates.size()) update = run.updates[k];
    run.MaybeRemove(solver.Graph(), update);
    const int before = solver.Cholesky().Variables();
    const auto report = solver.Update(update);
    ++paths[report.path];
    ASSERT_EQ(report.factor_ids.size(), update.factors.size());
    for (std::size_t f = 0; f < update.factors.size(); ++f) {
      ASSERT_NE(solver.Graph().FindFactor(report.factor_ids[f]), nullptr);
    }
    EXPECT_EQ(report.path == CholeskyPath::kNone, k > 0 && update.factors.empty() && update.removed.empty());
    if (report.path == CholeskyPath::kRankUpdate) {
      EXPECT_GT(report.fronts_updated, 0);
    }
    if (report.path != CholeskyPath::kRankUpdate) {
      EXPECT_EQ(report.fronts_updated, 0);
    }
    if (report.path == CholeskyPath::kAppended || report.path == CholeskyPath::kRefactored) {
      EXPECT_GT(report.fronts_refactored, 0);
      EXPECT_GE(report.variables_refactored, report.fronts_refactored);
      EXPECT_GT(report.flops, 0);
    }
    if (report.variables_relinearised > 0) {
      EXPECT_GT(report.fronts_refactored, 0);
    }
    EXPECT_EQ(report.gate_open, report.iterations > 0);
    if (report.gate_open) {
      EXPECT_GT(report.solve_flops, 0);
    }
    EXPECT_LE(report.iterations, options.max_iterations);
    EXPECT_GE(report.predicted_decrease, 0);
    EXPECT_EQ(report.deferred_fronts, 0);
    EXPECT_EQ(report.deferred_relinearisations, 0);
    EXPECT_GT(report.seconds, 0);
    EXPECT_EQ(solver.Cholesky().Variables(), before + static_cast<int>(update.poses.size()));
  }
  EXPECT_GT(paths[CholeskyPath::kAppended], 0);
  EXPECT_GT(paths[CholeskyPath::kRankUpdate], 0);
  EXPECT_GT(paths[CholeskyPath::kRefactored], 0);
}

// chi2 with the step's factors before anything moves, minus that after it.
TYPED_TEST(IncrementalGateTest, ActualDecreaseIsThatOfChi2) {
  RandomRun<TypeParam> run(19, false);
  IncrementalOptions options = Exact();
  options.report_cost = true;
  IncrementalSolver<TypeParam> solver(options);
  double sum = 0;
  for (const auto& update : run.updates) {
    const auto before = solver.Estimates();
    const auto report = solver.Update(update);
    auto values = WithNewPoints(before, solver);
    double chi2 = 0;
    for (const auto& node : solver.Graph().Factors()) {
      const FactorPoses ends = PosesOf(node.factor);
      chi2 += FactorChi2(node.factor, values[static_cast<std::size_t>(solver.Graph().IndexOf(ends.first))],
                         values[static_cast<std::size_t>(solver.Graph().IndexOf(ends.second))]);
    }
    // A new pose may have been relinearised in its own step: then its first value is not known here.
    if (report.variables_relinearised == 0) {
      EXPECT_NEAR(report.actual_decrease, chi2 - solver.Chi2(), 1e-9 * (1 + chi2));
    }
    sum += report.actual_decrease;
  }
  EXPECT_GT(sum, 0);
}

// A budget that nothing fits into: the step reports what it left, and steps that bring nothing work it off.
TYPED_TEST(IncrementalGateTest, DeferredWorkIsReportedAndDoneLater) {
  for (const std::uint64_t seed : testing::Seeds(1, 3)) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    RandomRun<TypeParam> run(seed, false, 25);
    IncrementalOptions options = Exact();
    options.budget_seconds = 1e-12;
    options.relinearize_tolerance = 1e-4;
    options.relinearize_interval = 1;
    IncrementalSolver<TypeParam> solver(options);
    int fronts = 0, relinearisations = 0;
    for (const auto& update : run.updates) {
      const auto report = solver.Update(update);
      fronts += report.deferred_fronts;
      relinearisations += report.deferred_relinearisations;
      ExpectEqualsDense(solver, report.deferred_fronts == 0);
      if (this->HasFatalFailure()) return;
    }
    EXPECT_GT(fronts, 0);
    EXPECT_GT(relinearisations, 0);
    const auto batch = SolveBatch(solver.Graph(), run.random.truth);
    int steps = 0;
    bool waits = true;
    for (; steps < 20000 && waits; ++steps) {
      const auto report = solver.Update({});
      waits = report.deferred_fronts > 0 || report.deferred_relinearisations > 0;
    }
    EXPECT_FALSE(waits);
    ExpectEqualsDense(solver);
    EXPECT_NEAR(solver.Chi2(), batch.chi2, 2e-3 * batch.chi2);
  }
}

// The batch optimum is a point of rest.
TYPED_TEST(IncrementalGateTest, NothingIsLeftToDoAfterFinish) {
  RandomRun<TypeParam> run(23, false);
  IncrementalSolver<TypeParam> solver;
  for (const auto& update : run.updates) solver.Update(update);
  solver.Finish();
  for (int k = 0; k < 25; ++k) {
    const auto report = solver.Update({});
    EXPECT_EQ(report.variables_relinearised, 0);
    EXPECT_EQ(report.flops, 0);
  }
}

}  // namespace
}  // namespace terse
