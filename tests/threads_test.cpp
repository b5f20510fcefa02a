// Any number of threads gives the same bits, and the same failures.

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include "terse/core/batch_solver.h"
#include "terse/core/incremental_solver.h"
#include "terse/core/initial_values.h"
#include "testing_files.h"
#include "testing_scene.h"

namespace terse {
namespace {

// Four threads even where there are fewer processors.
const tbb::global_control kAllowed(tbb::global_control::max_allowed_parallelism, 4);

const int kOnDisk = setenv("TMPDIR", testing::DiskFolder().c_str(), 1);

// Large enough that the tree is spread over threads, with fronts large enough to be shared.
template <class Pose>
PoseGraph<Pose> MakeLargeGraph() {
  if constexpr (Pose::kDof == 3) {
    return testing::MakeScene<Pose>(Scene::kManhattan, 1500).graph;
  } else {
    return testing::MakeScene<Pose>(Scene::kSphere, 1500).graph;
  }
}

template <class Pose>
void ExpectSameBits(const std::vector<Pose>& a, const std::vector<Pose>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t k = 0; k < a.size(); ++k) {
    ASSERT_EQ(a[k].Translation(), b[k].Translation()) << "pose " << k;
    if constexpr (Pose::kDof == 3) {
      ASSERT_EQ(a[k].Theta(), b[k].Theta()) << "pose " << k;
    } else {
      ASSERT_EQ(a[k].Rotation().Unit().coeffs(), b[k].Rotation().Unit().coeffs()) << "pose " << k;
    }
  }
}

template <class Pose>
class ThreadsTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(ThreadsTest, Groups);

template <class Pose>
void ExpectSameBatch(const PoseGraph<Pose>& graph) {
  const auto initial = ComputeInitialValues(graph, InitialValues::kCompose);
  BatchOptions options;
  options.max_iterations = 5;
  const auto one = SolveBatch(graph, initial, options);
  for (const auto& [threads, most_factor_bytes] : {std::pair(2, 0), std::pair(4, 0), std::pair(4, 1)}) {
    SCOPED_TRACE(std::to_string(threads) + " threads, a factor of at most (0: any) " +
                 std::to_string(most_factor_bytes) + " bytes in memory");
    options.threads = threads;
    options.most_factor_bytes = static_cast<std::uint64_t>(most_factor_bytes);
    const auto many = SolveBatch(graph, initial, options);
    EXPECT_EQ(many.termination, one.termination);
    EXPECT_EQ(many.iterations, one.iterations);
    EXPECT_EQ(many.chi2, one.chi2);
    EXPECT_EQ(many.log_determinant, one.log_determinant);
    EXPECT_EQ(many.gradient_norm, one.gradient_norm);
    EXPECT_EQ(many.cholesky.Solution(), one.cholesky.Solution());
    ExpectSameBits(many.T_world_body, one.T_world_body);
  }
}

TYPED_TEST(ThreadsTest, BatchIsTheSame) {
  for (const std::uint64_t seed : testing::Seeds(1, 3)) {
    testing::Random rng(seed);
    testing::RandomGraphOptions options;
    options.poses = seed == 1 ? 1000 : 200;
    options.priors = seed == 2;
    ExpectSameBatch(testing::MakeRandomGraph<TypeParam>(rng, options).graph);
  }
  ExpectSameBatch(MakeLargeGraph<TypeParam>());
}

// All poses but the last few at once, then the rest one by one with loops far back: large steps and small ones.
TYPED_TEST(ThreadsTest, IncrementalIsTheSame) {
  testing::Random rng(7);
  testing::RandomGraphOptions random;
  random.poses = TypeParam::kDof == 3 ? 1100 : 500;
  const auto graph = testing::MakeRandomGraph<TypeParam>(rng, random).graph;
  std::vector<GraphUpdate<TypeParam>> updates(1 + 20);
  const int first = random.poses - 20;
  for (int k = 0; k < random.poses; ++k) {
    updates[static_cast<std::size_t>(std::max(0, k - first + 1))].poses.push_back(
        {graph.Poses()[static_cast<std::size_t>(k)].id});
  }
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    const int last = std::max(graph.IndexOf(ends.first), graph.IndexOf(ends.second));
    updates[static_cast<std::size_t>(std::max(0, last - first + 1))].factors.push_back(node.factor);
  }
  std::vector<std::vector<TypeParam>> expected;
  std::vector<double> log_determinants;
  for (const int threads : {1, 2, 4}) {
    SCOPED_TRACE(std::to_string(threads) + " threads");
    IncrementalOptions options;
    options.threads = threads;
    IncrementalSolver<TypeParam> solver(options);
    double largest = 0;
    for (std::size_t k = 0; k < updates.size(); ++k) {
      largest = std::max(largest, solver.Update(updates[k]).flops);
      if (threads == 1) {
        expected.push_back(solver.Estimates());
        log_determinants.push_back(solver.LogDeterminant());
      } else {
        ExpectSameBits(solver.Estimates(), expected[k]);
        EXPECT_EQ(solver.LogDeterminant(), log_determinants[k]);
      }
      if (this->HasFatalFailure()) return;
    }
    EXPECT_GT(largest, 3e7) << "too little to be shared";
  }
}

// Where two poses hang in the air, the same one is named.
TYPED_TEST(ThreadsTest, FailuresAreTheSame) {
  auto graph = MakeLargeGraph<TypeParam>();
  auto initial = ComputeInitialValues(graph, InitialValues::kCompose);
  for (const std::int64_t id : {1000001, 1000002}) {
    graph.AddPose(PoseId{id});
    initial.push_back(TypeParam());
  }
  const auto one = SolveBatch(graph, initial);
  EXPECT_EQ(one.termination, Termination::kNotPositiveDefinite);
  for (const int threads : {2, 4}) {
    BatchOptions options;
    options.threads = threads;
    const auto many = SolveBatch(graph, initial, options);
    EXPECT_EQ(many.termination, one.termination);
    EXPECT_EQ(many.message, one.message);
  }
}

TYPED_TEST(ThreadsTest, LessThanOneIsMisuse) {
  testing::Random rng(1);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {5});
  BatchOptions batch;
  batch.threads = 0;
  EXPECT_THROW(SolveBatch(random.graph, random.truth, batch), std::invalid_argument);
  IncrementalOptions incremental;
  incremental.threads = 0;
  EXPECT_THROW(IncrementalSolver<TypeParam>{incremental}, std::invalid_argument);
  EXPECT_THROW(BlockCholesky<3>().SetThreads(-1), std::invalid_argument);
}

}  // namespace
}  // namespace terse
