// The incremental solver against a dense batch system after every step.

#include "terse/core/incremental_solver.h"

#include <gtest/gtest.h>

#include "terse/core/error.h"
#include "testing_incremental.h"

namespace terse {
namespace {

using testing::Exact;
using testing::ExpectEqualsDense;
using testing::OnePosePerUpdate;
using testing::Random;

template <class Pose>
class IncrementalSolverTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(IncrementalSolverTest, Groups);

template <class Pose>
Pose NotFinite() {
  typename Pose::Tangent d = Pose::Tangent::Zero();
  d[0] = std::numeric_limits<double>::quiet_NaN();
  return Pose().Retract(d);
}

TYPED_TEST(IncrementalSolverTest, EqualsDenseAfterEveryStep) {
  for (const std::uint64_t seed : testing::Seeds(1, 6)) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random rng(seed);
    testing::RandomGraphOptions options;
    options.poses = 35;
    options.noise = 0.05;
    options.priors = seed % 2 == 0;
    options.id_stride = 3;
    const auto random = testing::MakeRandomGraph<TypeParam>(rng, options);
    IncrementalOptions incremental = Exact();
    incremental.relinearize_interval = seed % 3 == 0 ? 4 : 1;
    IncrementalSolver<TypeParam> solver(incremental);
    int relinearised = 0;
    for (auto& update : OnePosePerUpdate(random.graph)) {
      testing::MaybeRemove(rng, solver.Graph(), options.id_stride, update);
      const auto summary = solver.Update(update);
      relinearised += summary.variables_relinearised;
      EXPECT_EQ(summary.factor_ids.size(), update.factors.size());
      // A map that moved as a whole to its first priors may have nothing left to gain.
      ExpectEqualsDense(solver, summary.gate_open);
      if (this->HasFatalFailure()) return;
    }
    EXPECT_GT(relinearised, 0);
  }
}

TYPED_TEST(IncrementalSolverTest, FinishReachesTheBatchOptimum) {
  for (const bool priors : {false, true}) {
    Random rng(21);
    testing::RandomGraphOptions options;
    options.poses = 60;
    options.priors = priors;
    const auto random = testing::MakeRandomGraph<TypeParam>(rng, options);
    IncrementalSolver<TypeParam> solver(Exact());
    for (const auto& update : OnePosePerUpdate(random.graph)) solver.Update(update);
    const auto batch = SolveBatch(random.graph, random.truth);
    ASSERT_TRUE(batch.Converged());
    EXPECT_LT(solver.Chi2(), 1.01 * batch.chi2);
    const auto finished = solver.Finish();
    EXPECT_NEAR(finished.chi2, batch.chi2, 1e-8 * batch.chi2);
    EXPECT_NEAR(solver.Chi2(), batch.chi2, 1e-8 * batch.chi2);
    ExpectEqualsDense(solver);
  }
}

// These ids and so many more for its factors.
template <class Pose>
GraphUpdate<Pose> WithIds(GraphUpdate<Pose> update, const std::vector<std::int64_t>& ids, int more) {
  for (const std::int64_t id : ids) update.factor_ids.push_back({id});
  for (int k = 0; k < more; ++k) update.factor_ids.push_back({5000 + k});
  return update;
}

TYPED_TEST(IncrementalSolverTest, FailedUpdateLeavesEverythingAsItWas) {
  Random rng(31);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {12, 0.5, 0.02});
  IncrementalSolver<TypeParam> solver(Exact());
  for (const auto& update : OnePosePerUpdate(random.graph)) solver.Update(update);
  const auto before = solver.Estimates();
  const double log_det = solver.LogDeterminant();
  const PoseId known = solver.Graph().Poses().front().id, fresh{999}, other{998};
  const auto edge = [&](PoseId a, PoseId b) {
    return RelativePoseFactor<TypeParam>{a, b, TypeParam(), TypeParam::Jacobian::Identity()};
  };
  auto indefinite = edge(known, fresh);
  indefinite.information(0, 0) = -1;
  auto infinite = edge(known, fresh);
  infinite.information(0, 0) = std::numeric_limits<double>::infinity();

  using Update = GraphUpdate<TypeParam>;
  const std::vector<Update> bad = {
      {{{known}}, {}, {}},                                        // taken
      {{{fresh}, {fresh}}, {edge(known, fresh)}, {}},             // twice
      {{{fresh}}, {}, {}},                                        // no value
      {{{fresh, TypeParam()}}, {}, {}},                           // a value, but nothing measures it
      {{{fresh}, {other}}, {edge(fresh, other)}, {}},             // two that know only each other
      {{{fresh}}, {edge(known, known)}, {}},                      // to itself
      {{{fresh}}, {edge(known, fresh), edge(known, other)}, {}},  // unknown end
      {{{fresh}}, {indefinite}, {}},
      {{{fresh, NotFinite<TypeParam>()}}, {edge(known, fresh)}, {}},
      {{{fresh}}, {infinite}, {}},
      {{}, {}, {FactorId{12345}}},
      WithIds<TypeParam>({{{fresh}}, {edge(known, fresh)}, {}}, {}, 2),   // more ids than factors
      WithIds<TypeParam>({{{fresh}}, {edge(known, fresh)}, {}}, {0}, 0),  // taken
      WithIds<TypeParam>({{{fresh}}, {edge(known, fresh), edge(fresh, known)}, {}}, {1001, 1000}, 0),
      {{}, {}, {FactorId{0}}},  // the only link of the first pose: the rest would float
  };
  for (std::size_t k = 0; k < bad.size(); ++k) {
    SCOPED_TRACE("bad update " + std::to_string(k));
    if (k + 1 == bad.size()) {
      IncrementalSolver<TypeParam> two;
      two.Update({{{known}, {fresh}}, {edge(known, fresh)}, {}});
      EXPECT_THROW(two.Update(bad[k]), NumericalError);
      EXPECT_EQ(two.Graph().Factors().size(), 1U);
      continue;
    }
    EXPECT_ANY_THROW(solver.Update(bad[k]));
    EXPECT_EQ(solver.Graph().Poses().size(), before.size());
    EXPECT_EQ(solver.Graph().Factors().size(), random.graph.Factors().size());
    EXPECT_EQ(solver.LogDeterminant(), log_det);
    for (std::size_t i = 0; i < before.size(); ++i) {
      EXPECT_EQ(before[i].Translation(), solver.EstimateAt(static_cast<int>(i)).Translation());
    }
  }
  solver.Update({{{fresh}}, {edge(known, fresh)}, {}});
  ExpectEqualsDense(solver);
}

// A solver put together again has the factors by the ids they had, and what was counted before.
TYPED_TEST(IncrementalSolverTest, TakesTheIdsThatItIsGiven) {
  Random rng(33);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {12, 0.5, 0.02});
  IncrementalSolver<TypeParam> solver(Exact());
  GraphUpdate<TypeParam> all;
  std::int64_t id = 3;
  for (const auto& node : random.graph.Poses()) all.poses.push_back({node.id, node.T_world_body});
  FactorId loop{-1};
  for (const auto& node : random.graph.Factors()) {
    all.factors.push_back(node.factor);
    all.factor_ids.push_back({id});
    const auto ends = PosesOf(node.factor);
    if (random.graph.IndexOf(ends.second) - random.graph.IndexOf(ends.first) > 1) loop = {id};
    id += 2;
  }
  EXPECT_EQ(solver.Update(all).factor_ids, all.factor_ids);
  EXPECT_EQ(solver.Graph().NextFactorId().value, id - 1);
  ExpectEqualsDense(solver);
  solver.Finish();
  solver.Update({{}, {}, {loop}});
  EXPECT_THROW(solver.Update({{}, {}, {loop}}), std::invalid_argument);
  ExpectEqualsDense(solver);

  IncrementalSolver<TypeParam> again(Exact());
  again.Update(all);
  const double own = again.Seconds().factor;
  again.CountOnFrom(solver);
  EXPECT_EQ(again.Seconds().factor, own + solver.Seconds().factor);
  EXPECT_EQ(again.Restarts(), solver.Restarts());
}

TYPED_TEST(IncrementalSolverTest, PriorsReplaceTheAnchorAndItComesBack) {
  Random rng(41);
  IncrementalSolver<TypeParam> solver(Exact());
  const auto prior = [](std::int64_t id, double x) {
    PositionPriorFactor<TypeParam> f;
    f.pose = PoseId{id};
    f.p_world.setZero();
    f.p_world[0] = x;
    f.information.setIdentity();
    return f;
  };
  GraphUpdate<TypeParam> update;
  for (int k = 0; k < 6; ++k) {
    update.poses.push_back({PoseId{k}});
    if (k > 0) {
      update.factors.push_back(RelativePoseFactor<TypeParam>{
          PoseId{k - 1}, PoseId{k}, testing::RandomMotion<TypeParam>(rng, 1, 0.3), TypeParam::Jacobian::Identity()});
    }
  }
  solver.Update(update);
  std::vector<FactorId> ids;
  for (int k = 0; k < 6; k += 2) {
    const auto summary = solver.Update({{}, {prior(k, 10.0 + k)}, {}});
    ids.push_back(summary.factor_ids[0]);
    ExpectEqualsDense(solver);
  }
  // Three position priors and no anchor: the map has moved to them.
  EXPECT_GT(solver.Finish().T_world_body[0].Translation().norm(), 5);
  for (const FactorId id : ids) {
    solver.Update({{}, {}, {id}});
    ExpectEqualsDense(solver);
  }
}

// The largest error of a pose in standard deviations of its own.
template <class Pose>
double LargestError(const PoseGraph<Pose>& graph, const std::vector<Pose>& estimates,
                    const std::vector<Pose>& optimum) {
  const Eigen::MatrixXd covariance = testing::MakeDenseSystem(graph, optimum).H.inverse();
  double largest = 0;
  for (std::size_t i = 1; i < optimum.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i) * Pose::kDof;
    const Eigen::VectorXd d = optimum[i].Local(estimates[i]);
    const Eigen::MatrixXd block = covariance.block(at, at, Pose::kDof, Pose::kDof);
    largest = std::max(largest, std::sqrt(d.dot(block.ldlt().solve(d))));
  }
  return largest;
}

struct RestRun {
  int relinearised = 0;
  double error = 0, gap = 0;  // the largest, in standard deviations, and above the least chi2
};

// With the information multiplied: the map, and every share of chi2, stay the same (far above the floor of CostUnit).
template <class Pose>
RestRun RunScaled(const PoseGraph<Pose>& unscaled, double times) {
  PoseGraph<Pose> graph;
  for (const auto& node : unscaled.Poses()) graph.AddPose(node.id);
  for (const auto& node : unscaled.Factors()) {
    auto f = std::get<RelativePoseFactor<Pose>>(node.factor);
    f.information *= times;
    graph.AddFactor(f);
  }
  IncrementalSolver<Pose> solver;
  RestRun out;
  int step = 0;
  for (const auto& update : OnePosePerUpdate(graph)) {
    out.relinearised += solver.Update(update).variables_relinearised;
    if (++step % 10 != 0 || step < 30) continue;
    const auto optimum = SolveBatch(solver.Graph(), solver.Estimates());
    out.error = std::max(out.error, LargestError(solver.Graph(), solver.Estimates(), optimum.T_world_body));
    out.gap = std::max(out.gap, solver.Chi2() / optimum.chi2 - 1);
  }
  return out;
}

// Where residuals are far below what the information promises, errors far below a standard deviation are left, but
// none that the map's own scale would show much of.
TYPED_TEST(IncrementalSolverTest, RestsWhereResidualsAreFarBelowTheirInformation) {
  for (const std::uint64_t seed : testing::Seeds(1, 3)) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random rng(seed);
    const auto graph = testing::MakeRandomGraph<TypeParam>(rng, {70, 0.6, 0.03}).graph;
    const RestRun strict = RunScaled(graph, 1e2), stricter = RunScaled(graph, 1e4), rests = RunScaled(graph, 1e-4);
    EXPECT_NEAR(strict.relinearised, stricter.relinearised, 0.02 * strict.relinearised);
    EXPECT_LT(rests.relinearised, 0.8 * strict.relinearised);
    EXPECT_LT(rests.error, 1e-3);
    EXPECT_LT(rests.gap, 2e-2);
  }
}

// Two poses held ten apart, and an edge that says one: what gives way is the edge.
TYPED_TEST(IncrementalSolverTest, FixedPosesStayThroughManyRelinearisations) {
  IncrementalOptions options = Exact();
  options.relinearize_metres = options.relinearize_radians = 0;
  options.relinearize_interval = 1;
  IncrementalSolver<TypeParam> solver(options);
  typename TypeParam::Tangent d = TypeParam::Tangent::Zero();
  d[0] = 10;
  const TypeParam far = TypeParam().Retract(d);
  d[0] = 1;
  const TypeParam near = TypeParam().Retract(d);
  const RelativePoseFactor<TypeParam> edge{PoseId{0}, PoseId{1}, near, 1e4 * TypeParam::Jacobian::Identity()};
  GraphUpdate<TypeParam> first;
  first.poses = {{PoseId{0}, TypeParam(), true}, {PoseId{1}, far, true}};
  first.factors = {edge};
  solver.Update(first);
  for (int k = 0; k < 50; ++k) solver.Update({});
  // Information 1e4 against 1e8 on either side moves each by a ten-thousandth of the misfit.
  EXPECT_NEAR(solver.Estimate(PoseId{1}).Translation()[0], 10 - 9e-4, 1e-5);
  solver.Finish();
  EXPECT_NEAR(solver.Estimate(PoseId{1}).Translation()[0], 10 - 9e-4, 1e-5);
}

// A fixed pose that comes in when there are others: its prior is the last factor of all.
TYPED_TEST(IncrementalSolverTest, FixedPoseComesInLater) {
  for (const int interval : {1, 3}) {
    IncrementalOptions options = Exact();
    options.relinearize_interval = interval;
    IncrementalSolver<TypeParam> solver(options);
    Random rng(51);
    const auto motion = [&] { return testing::RandomMotion<TypeParam>(rng, 1, 0.5); };
    const auto edge = [&](std::int64_t a, std::int64_t b) {
      return RelativePoseFactor<TypeParam>{PoseId{a}, PoseId{b}, motion(), TypeParam::Jacobian::Identity()};
    };
    solver.Update({{{PoseId{0}}, {PoseId{1}}}, {edge(0, 1)}, {}});
    for (std::int64_t k = 2; k < 6; ++k) {
      const TypeParam held = motion();
      solver.Update({{{PoseId{k}, held, true}}, {edge(k - 1, k), edge(0, k)}, {}});
      ExpectEqualsDense(solver);
      for (int more = 0; more < 8; ++more) solver.Update({});
      ExpectEqualsDense(solver);
      if (this->HasFatalFailure()) return;
      EXPECT_LT(held.Local(solver.Estimate(PoseId{k})).norm(), 1e-4);
    }
    const double chi2 = solver.Chi2();
    EXPECT_NEAR(solver.Finish().chi2, chi2, 1e-2 * (1 + chi2));
  }
}

// A wrong link must not throw the map to where no optimiser finds back from.
TYPED_TEST(IncrementalSolverTest, WrongLinksDoNotMakeItDiverge) {
  for (const std::uint64_t seed : testing::Seeds(1, 10)) {
    Random rng(seed);
    auto random = testing::MakeRandomGraph<TypeParam>(rng, {150, 0.3, 0.02});
    for (const auto& [i, j] : {std::pair{20, 90}, {5, 140}}) {
      random.graph.AddFactor(RelativePoseFactor<TypeParam>{PoseId{100 + i}, PoseId{100 + j},
                                                           testing::RandomMotion<TypeParam>(rng, 3, 1),
                                                           100 * TypeParam::Jacobian::Identity()});
    }
    IncrementalSolver<TypeParam> solver;
    for (const auto& update : OnePosePerUpdate(random.graph)) solver.Update(update);
    const auto batch = SolveBatch(random.graph, random.truth);
    // Steps of about a metre: nothing can be farther away than 150 m by much.
    for (const TypeParam& T : solver.Estimates()) EXPECT_LT(T.Translation().norm(), 500) << "seed " << seed;
    EXPECT_LT(solver.Finish().chi2, 2 * batch.chi2) << "seed " << seed;
  }
}

}  // namespace
}  // namespace terse
