// Covariances of a growing map against the dense inverse after every step, on every path.

#include "terse/covariance/incremental_marginals.h"

#include <gtest/gtest.h>

#include <set>
#include <thread>

#include "terse/core/front_tree.h"
#include "testing_incremental.h"

namespace terse {
namespace {

using testing::Exact;
using testing::OnePosePerUpdate;
using testing::Random;
using testing::RelativeError;
using Update = CovarianceOptions::Method;

template <class Pose>
class IncrementalMarginalsTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(IncrementalMarginalsTest, Groups);

// In extended precision: the plain inverse is only good to about 1e-9 where the anchor (1e8) meets informations of 10.
template <class Pose>
Eigen::MatrixXd DenseCovariance(const IncrementalSolver<Pose>& solver) {
  return testing::Inverse(
      testing::MakeDenseSystem(solver.Graph(), solver.LinearizationPoints(), &solver.CurrentGauge()).H);
}

template <class Pose>
struct Against {
  static constexpr int B = Pose::kDof;
  const IncrementalSolver<Pose>& solver;
  Eigen::MatrixXd Sigma = DenseCovariance(solver);

  auto Block(int i, int j) const { return Sigma.block<B, B>(i * B, j * B); }
  // Cross-covariances are measured by the geometric mean of the marginals: their own norm may vanish.
  double Scale(int i, int j) const { return std::sqrt(Block(i, i).norm() * Block(j, j).norm()); }

  void ExpectEqual(const IncrementalMarginals<Pose>& marginals, double tolerance = 1e-9) const {
    const int n = static_cast<int>(solver.Graph().Poses().size());
    const auto all = marginals.AllMarginals();
    const auto column = marginals.NewestColumn();
    ASSERT_EQ(all.size(), static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) {
      const auto& block = all[static_cast<std::size_t>(i)];
      ASSERT_LT(RelativeError(block, Block(i, i)), tolerance) << "pose " << i << " of " << n;
      ASSERT_EQ(block, block.transpose());
      ASSERT_TRUE(testing::IsPositiveDefinite(block));
      ASSERT_LT((column[static_cast<std::size_t>(i)] - Block(i, n - 1)).norm(), tolerance * Scale(i, n - 1));
    }
    ASSERT_LT(RelativeError(marginals.Newest(), Block(n - 1, n - 1)), tolerance);
  }
};

struct Mode {
  const char* name;
  CovarianceOptions options;
  bool update;  // or everything by queries
};

std::vector<Mode> Modes() {
  CovarianceOptions cheapest, downdate, recursion, solve, lazy, capped;
  downdate.method = Update::kDowndate;
  recursion.method = Update::kRecursion;
  solve.diagonal_method = DiagonalMethod::kSolve;
  lazy.diagonal_method = DiagonalMethod::kRecursion;
  capped.diagonal_method = DiagonalMethod::kRecursion;
  capped.cache_bytes = 5000;
  return {{"cheapest", cheapest, true}, {"downdate", downdate, true}, {"recursion", recursion, true},
          {"solve", solve, false},      {"lazy", lazy, false},        {"capped", capped, false}};
}

TYPED_TEST(IncrementalMarginalsTest, EqualTheDenseInverseAfterEveryStepOnEveryPath) {
  std::map<std::string, std::set<CovariancePath>> seen;
  for (const std::uint64_t seed : testing::Seeds(1, 6)) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random rng(seed);
    testing::RandomGraphOptions options;
    options.poses = TypeParam::kDof == 3 ? 40 : 26;
    options.loops_per_pose = seed % 2 == 0 ? 1.0 : 0.3;
    options.noise = 0.05;
    options.priors = seed % 3 == 0;
    options.id_stride = 3;
    const auto random = testing::MakeRandomGraph<TypeParam>(rng, options);
    IncrementalOptions incremental = Exact();
    incremental.relinearize_interval = 4;
    IncrementalSolver<TypeParam> solver(incremental);
    const std::vector<Mode> modes = Modes();
    std::vector<std::unique_ptr<IncrementalMarginals<TypeParam>>> marginals;
    for (const Mode& mode : modes) {
      marginals.push_back(std::make_unique<IncrementalMarginals<TypeParam>>(solver, mode.options));
    }
    for (auto& update : OnePosePerUpdate(random.graph)) {
      testing::MaybeRemove(rng, solver.Graph(), options.id_stride, update);
      solver.Update(update);
      const auto before = solver.Estimates();
      const Against<TypeParam> dense{solver};
      const double tolerance = 1e-9;
      for (std::size_t k = 0; k < modes.size(); ++k) {
        SCOPED_TRACE(modes[k].name);
        if (modes[k].update) seen[modes[k].name].insert(marginals[k]->Update().path);
        dense.ExpectEqual(*marginals[k], tolerance);
        if (this->HasFatalFailure()) return;
        // Some that have been asked for before, and some twice.
        std::vector<PoseId> ids;
        std::vector<int> indices;
        for (int draw = 0; draw < 5; ++draw) {
          indices.push_back(static_cast<int>(rng() % solver.Graph().Poses().size()));
          ids.push_back(solver.Graph().Poses()[static_cast<std::size_t>(indices.back())].id);
        }
        const auto some = marginals[k]->MarginalsOf(ids);
        for (std::size_t i = 0; i < ids.size(); ++i) {
          ASSERT_LT(RelativeError(some[i], dense.Block(indices[i], indices[i])), tolerance);
        }
        ASSERT_LE(marginals[k]->CacheBytes(), modes[k].options.cache_bytes);
      }
      const auto after = solver.Estimates();
      for (std::size_t i = 0; i < before.size(); ++i) ASSERT_EQ(before[i].Local(after[i]).norm(), 0);
    }
  }
  // Every way was gone.
  EXPECT_EQ(seen["recursion"], std::set<CovariancePath>{CovariancePath::kRecursion});
  EXPECT_EQ(seen["downdate"].count(CovariancePath::kPropagated), 1u);
  EXPECT_EQ(seen["downdate"].count(CovariancePath::kDowndated), 1u);
  EXPECT_EQ(seen["cheapest"].count(CovariancePath::kPropagated), 1u);
  EXPECT_EQ(seen["cheapest"].count(CovariancePath::kDowndated), 1u);
}

// Updates that bring several poses, come without any, or are followed by Update only now and then.
TYPED_TEST(IncrementalMarginalsTest, CatchUpAfterSeveralSteps) {
  for (const std::uint64_t seed : testing::Seeds(11, 14)) {
    Random rng(seed);
    const auto random = testing::MakeRandomGraph<TypeParam>(rng, {TypeParam::kDof == 3 ? 50 : 30, 0.6, 0.05});
    const auto updates = OnePosePerUpdate(random.graph);
    IncrementalSolver<TypeParam> solver(Exact());
    CovarianceOptions options;
    options.method = Update::kDowndate;
    IncrementalMarginals<TypeParam> marginals(solver, options);
    for (std::size_t k = 0; k < updates.size();) {
      GraphUpdate<TypeParam> update;
      for (std::size_t many = 1 + rng() % 3; many > 0 && k < updates.size(); --many, ++k) {
        update.poses.insert(update.poses.end(), updates[k].poses.begin(), updates[k].poses.end());
        update.factors.insert(update.factors.end(), updates[k].factors.begin(), updates[k].factors.end());
      }
      solver.Update(update);
      if (rng() % 3 == 0) continue;
      EXPECT_THROW(marginals.KeptMarginals(), std::logic_error);
      marginals.Update();
      Against<TypeParam>{solver}.ExpectEqual(marginals);
      if (this->HasFatalFailure()) return;
      EXPECT_EQ(marginals.Update().path, CovariancePath::kNone);
      EXPECT_EQ(marginals.KeptMarginals().size(), solver.Graph().Poses().size());
    }
  }
}

// The solver may move, finish or start anew under the same address.
TYPED_TEST(IncrementalMarginalsTest, NoticeAnotherFactor) {
  Random rng(41);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {20, 0.6, 0.05});
  const auto other = testing::MakeRandomGraph<TypeParam>(rng, {20, 0.6, 0.05});
  IncrementalSolver<TypeParam> solver(Exact()), second(Exact());
  for (const auto& update : OnePosePerUpdate(other.graph)) second.Update(update);
  for (const auto& update : OnePosePerUpdate(random.graph)) solver.Update(update);
  CovarianceOptions lazy;
  lazy.diagonal_method = DiagonalMethod::kRecursion;
  IncrementalMarginals<TypeParam> kept(solver), queried(solver, lazy);
  const auto expect_equal = [&] {
    const Against<TypeParam> dense{solver};
    dense.ExpectEqual(queried);
    dense.ExpectEqual(kept);
    kept.Update();
    dense.ExpectEqual(kept);
  };
  expect_equal();
  solver.Finish();
  expect_equal();
  solver = second;
  expect_equal();
}

TYPED_TEST(IncrementalMarginalsTest, JointCrossAndRelativeEqualDense) {
  constexpr int B = TypeParam::kDof;
  Random rng(51);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {60, 0.4, 0.02});
  IncrementalSolver<TypeParam> solver(Exact());
  IncrementalMarginals<TypeParam> marginals(solver);
  for (const auto& update : OnePosePerUpdate(random.graph)) solver.Update(update);
  const Against<TypeParam> dense{solver};
  const auto& poses = solver.Graph().Poses();
  for (int size = 2; size <= 20; size += 3) {
    std::set<int> chosen;
    while (static_cast<int>(chosen.size()) < size) chosen.insert(static_cast<int>(rng() % poses.size()));
    std::vector<int> indices(chosen.begin(), chosen.end());
    std::shuffle(indices.begin(), indices.end(), rng);
    std::vector<PoseId> ids;
    for (const int i : indices) ids.push_back(poses[static_cast<std::size_t>(i)].id);
    const MatrixX joint = marginals.Joint(ids);
    ASSERT_EQ(joint, joint.transpose());
    ASSERT_TRUE(testing::IsPositiveDefinite(joint));
    const auto column = marginals.Column(ids.front(), ids);
    for (int r = 0; r < size; ++r) {
      const int i = indices[static_cast<std::size_t>(r)];
      ASSERT_LT((column[static_cast<std::size_t>(r)] - dense.Block(i, indices[0])).norm(),
                1e-9 * dense.Scale(i, indices[0]));
      for (int c = 0; c < size; ++c) {
        const int j = indices[static_cast<std::size_t>(c)];
        const Matrix<B, B> block = joint.block<B, B>(r * B, c * B);
        ASSERT_LT((block - dense.Block(i, j)).norm(), 1e-9 * dense.Scale(i, j));
      }
    }
    const TypeParam T = solver.Estimate(ids[0]).Inverse() * solver.Estimate(ids[1]);
    // Put together where the system is linearised, and moved to the estimate.
    const auto& points = solver.LinearizationPoints();
    const TypeParam T_point =
        points[static_cast<std::size_t>(indices[0])].Inverse() * points[static_cast<std::size_t>(indices[1])];
    const auto at_point =
        RelativeCovariance<TypeParam>(T_point, dense.Block(indices[0], indices[0]), dense.Block(indices[0], indices[1]),
                                      dense.Block(indices[1], indices[1]));
    const auto expected = MoveCovariance<TypeParam>(at_point, T_point, T);
    ASSERT_LT((marginals.Relative(ids[0], ids[1]) - expected).norm(), 1e-9 * dense.Scale(indices[0], indices[1]));
    const auto world = marginals.Relative(ids[0], ids[1], {CovarianceFrame::kWorld, TangentOrder::kTranslationFirst});
    const typename TypeParam::Jacobian Ad = T.Adjoint();
    ASSERT_LT(RelativeError(world, Ad * expected * Ad.transpose()), 1e-7);
  }
}

// Loops that take nearly all uncertainty away make earlier rounding errors large beside what is left: the bound has to
// notice, and the blocks stay right.
TYPED_TEST(IncrementalMarginalsTest, DriftIsBoundedAndRefreshed) {
  constexpr int B = TypeParam::kDof;
  int refreshed = 0;
  for (const std::uint64_t seed : testing::Seeds(61, 63)) {
    Random rng(seed);
    IncrementalSolver<TypeParam> solver(Exact());
    CovarianceOptions options;
    options.method = Update::kDowndate;
    options.max_drift = 1e-11;
    IncrementalMarginals<TypeParam> marginals(solver, options);
    TypeParam truth;
    GraphUpdate<TypeParam> first;
    first.poses.push_back({PoseId{0}, truth});
    solver.Update(first);
    typename TypeParam::Jacobian information = TypeParam::Jacobian::Identity();
    std::vector<TypeParam> truths = {truth};
    for (int k = 1; k <= 40; ++k) {
      const TypeParam step = testing::RandomMotion<TypeParam>(rng, 1, 0.3);
      truths.push_back(truths.back() * step);
      GraphUpdate<TypeParam> update;
      update.poses.push_back({PoseId{k}});
      update.factors.push_back(RelativePoseFactor<TypeParam>{PoseId{k - 1}, PoseId{k}, step, information});
      // Weak odometry, then very strong loops.
      if (k % 10 == 0) {
        const int to = k - 10;
        update.factors.push_back(RelativePoseFactor<TypeParam>{
            PoseId{to}, PoseId{k}, truths[static_cast<std::size_t>(to)].Inverse() * truths.back(), 1e7 * information});
      }
      solver.Update(update);
      const auto report = marginals.Update();
      refreshed += report.refreshed ? 1 : 0;
      if (report.path == CovariancePath::kDowndated) {
        EXPECT_GT(report.drift, 0);
        EXPECT_LE(std::max(report.drift, report.measured_drift), options.max_drift);
      }
      const Against<TypeParam> dense{solver};
      const auto all = marginals.AllMarginals();
      for (int i = 0; i <= k; ++i) {
        // 1e-9 beside the condition of H, 1e7.
        ASSERT_LT((all[static_cast<std::size_t>(i)] - dense.Block(i, i)).norm(), 1e-8 * dense.Block(i, i).norm());
      }
    }
  }
  EXPECT_GT(refreshed, 0);
  static_assert(B > 0);
}

// Components that only priors hold: a pose's column is zero outside its own.
TYPED_TEST(IncrementalMarginalsTest, SeveralComponents) {
  for (const std::uint64_t seed : testing::Seeds(81, 84)) {
    Random rng(seed);
    IncrementalSolver<TypeParam> solver(Exact());
    const std::vector<Mode> modes = Modes();
    std::vector<std::unique_ptr<IncrementalMarginals<TypeParam>>> marginals;
    for (const Mode& mode : modes) {
      marginals.push_back(std::make_unique<IncrementalMarginals<TypeParam>>(solver, mode.options));
    }
    const int components = 2 + static_cast<int>(seed % 3);
    std::vector<std::vector<PoseId>> poses(static_cast<std::size_t>(components));
    std::map<std::int64_t, TypeParam> truth;
    for (int k = 0; k < 36; ++k) {
      auto& chain = poses[rng() % poses.size()];
      const PoseId id{k};
      GraphUpdate<TypeParam> update;
      const auto measure = [&](PoseId from) {
        update.factors.push_back(RelativePoseFactor<TypeParam>{
            from, id, truth[from.value].Inverse() * truth[id.value] * testing::RandomMotion<TypeParam>(rng, 0.02, 0.02),
            testing::RandomInformation<TypeParam::kDof>(rng, 100)});
      };
      if (chain.empty()) {
        truth[k] = testing::RandomMotion<TypeParam>(rng, 5, 1);
        update.poses.push_back({id, truth[k]});
        update.factors.push_back(
            PosePriorFactor<TypeParam>{id, truth[k], testing::RandomInformation<TypeParam::kDof>(rng, 100)});
      } else {
        truth[k] = truth[chain.back().value] * testing::RandomMotion<TypeParam>(rng, 1, 0.3);
        update.poses.push_back({id});
        measure(chain.back());
        if (chain.size() > 2 && rng() % 2 == 0) measure(chain[rng() % (chain.size() - 1)]);
      }
      chain.push_back(id);
      solver.Update(update);
      const Against<TypeParam> dense{solver};
      for (std::size_t m = 0; m < modes.size(); ++m) {
        SCOPED_TRACE(std::string(modes[m].name) + ", pose " + std::to_string(k) + ", seed " + std::to_string(seed));
        if (modes[m].update) marginals[m]->Update();
        dense.ExpectEqual(*marginals[m]);
        if (this->HasFatalFailure()) return;
      }
    }
    EXPECT_GT(solver.Cholesky().Tree().Roots().size(), 1u);
  }
}

// The column is not at hand when a pose is joined to another than the newest: it is solved for, and the downdate holds.
TYPED_TEST(IncrementalMarginalsTest, DowndatesWithASolvedColumn) {
  Random rng(91);
  IncrementalOptions still = Exact();
  still.relinearize_interval = 1000000;
  still.max_iterations = 1;
  IncrementalSolver<TypeParam> solver(still);
  CovarianceOptions options;
  options.method = Update::kDowndate;
  IncrementalMarginals<TypeParam> marginals(solver, options);
  std::vector<TypeParam> truth = {TypeParam()};
  GraphUpdate<TypeParam> first;
  first.poses.push_back({PoseId{0}, truth[0]});
  solver.Update(first);
  marginals.Update();
  int downdated = 0, refreshed = 0;
  for (int k = 1; k <= 40; ++k) {
    const std::size_t joined = rng() % truth.size();
    truth.push_back(truth[joined] * testing::RandomMotion<TypeParam>(rng, 1, 0.3));
    GraphUpdate<TypeParam> update;
    update.poses.push_back({PoseId{k}});
    for (std::size_t i = 0; i < 1 + rng() % 3; ++i) {
      const std::size_t other = i == 0 ? joined : rng() % (truth.size() - 1);
      update.factors.push_back(RelativePoseFactor<TypeParam>{PoseId{static_cast<std::int64_t>(other)}, PoseId{k},
                                                             truth[other].Inverse() * truth.back(),
                                                             testing::RandomInformation<TypeParam::kDof>(rng, 100)});
    }
    solver.Update(update);
    const auto report = marginals.Update();
    EXPECT_LT(report.measured_drift, 1e-10);
    refreshed += report.refreshed ? 1 : 0;  // now and then, where the estimate is careful
    downdated += report.path == CovariancePath::kDowndated ? 1 : 0;
    Against<TypeParam>{solver}.ExpectEqual(marginals);
    if (this->HasFatalFailure()) return;
  }
  EXPECT_GT(downdated, 10);
  EXPECT_LT(refreshed, 4);
}

// Of many poses at once, whatever way is chosen; and of neighbours far from the anchor, whose own covariances are
// large.
TYPED_TEST(IncrementalMarginalsTest, LongChain) {
  constexpr int kPoses = 3000;
  IncrementalSolver<TypeParam> solver;
  typename TypeParam::Tangent step = TypeParam::Tangent::Zero();
  step[0] = 1;
  step[TypeParam::kDof - 1] = 0.01;
  typename TypeParam::Jacobian information = 1e6 * TypeParam::Jacobian::Identity();
  GraphUpdate<TypeParam> update;
  for (int k = 0; k < kPoses; ++k) {
    update.poses.push_back({PoseId{k}});
    if (k > 0) {
      update.factors.push_back(
          RelativePoseFactor<TypeParam>{PoseId{k - 1}, PoseId{k}, TypeParam().Retract(step), information});
    }
  }
  solver.Update(update);
  const IncrementalMarginals<TypeParam> marginals(solver);
  std::vector<PoseId> ids;
  for (int k = kPoses; k-- > 0;) ids.push_back(PoseId{k});
  const auto all = marginals.AllMarginals();
  const auto chosen = marginals.MarginalsOf(ids);
  for (int k = 0; k < kPoses; ++k) {
    ASSERT_LT(RelativeError(chosen[static_cast<std::size_t>(kPoses - 1 - k)], all[static_cast<std::size_t>(k)]), 1e-8);
  }
  // The measurement's own covariance; the joint blocks are 1e8 times larger.
  const auto relative = marginals.Relative(PoseId{kPoses - 2}, PoseId{kPoses - 1});
  EXPECT_LT(RelativeError(relative, testing::Inverse(information)), 1e-9);
  EXPECT_EQ(relative, relative.transpose());
}

TYPED_TEST(IncrementalMarginalsTest, ConcurrentQueriesAgree) {
  Random rng(71);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {80, 0.4, 0.02});
  IncrementalSolver<TypeParam> solver(Exact());
  CovarianceOptions options;
  options.diagonal_method = DiagonalMethod::kRecursion;
  options.cache_bytes = 20000;  // so that the threads throw out each other's blocks
  const IncrementalMarginals<TypeParam> marginals(solver, options);
  for (const auto& update : OnePosePerUpdate(random.graph)) solver.Update(update);
  const auto& poses = solver.Graph().Poses();
  const auto all = marginals.AllMarginals();
  const MatrixX joint = marginals.Joint({poses[3].id, poses[50].id});
  std::vector<std::thread> threads;
  std::vector<int> wrong(4, 0);
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      for (std::size_t k = 0; k < 200; ++k) {
        const std::size_t i = (k * 7 + static_cast<std::size_t>(t) * 13) % poses.size();
        if (RelativeError(marginals.Marginal(poses[i].id), all[i]) > 1e-9) ++wrong[static_cast<std::size_t>(t)];
        if (marginals.Joint({poses[3].id, poses[50].id}) != joint) ++wrong[static_cast<std::size_t>(t)];
      }
    });
  }
  for (auto& thread : threads) thread.join();
  EXPECT_EQ(wrong, std::vector<int>(4, 0));
}

TYPED_TEST(IncrementalMarginalsTest, Refuses) {
  IncrementalSolver<TypeParam> solver;
  IncrementalMarginals<TypeParam> marginals(solver);
  EXPECT_THROW(marginals.Update(), std::invalid_argument);
  EXPECT_THROW(marginals.Newest(), std::invalid_argument);
  EXPECT_THROW(marginals.NewestColumn(), std::invalid_argument);
  EXPECT_TRUE(marginals.AllMarginals().empty());
  GraphUpdate<TypeParam> update;
  update.poses.push_back({PoseId{7}});
  solver.Update(update);
  EXPECT_THROW(marginals.Marginal(PoseId{8}), std::invalid_argument);
  EXPECT_THROW(marginals.Joint({PoseId{7}, PoseId{8}}), std::invalid_argument);
  EXPECT_THROW(marginals.Relative(PoseId{7}, PoseId{7}), std::invalid_argument);
  EXPECT_NO_THROW(marginals.Update());
  EXPECT_TRUE(marginals.Newest().allFinite());
}

}  // namespace
}  // namespace terse
