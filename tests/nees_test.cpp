// Are the covariances those of the errors? NEES over 200 simulated runs against its 95 % interval.

#include <gtest/gtest.h>

#include <numeric>

#include "simulation.h"
#include "terse/core/batch_solver.h"
#include "terse/core/incremental_solver.h"
#include "terse/covariance/incremental_marginals.h"
#include "terse/covariance/marginals.h"
#include "testing_incremental.h"

namespace terse {
namespace {

using testing::Nees;
using testing::Simulation;
using testing::SimulationOptions;

constexpr int kRuns = 200;

template <class Pose>
class NeesTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(NeesTest, Groups);

// Sums by name. The means of the main ones are held against their 95 % intervals. Of many true statements at 95 % one
// in twenty fails by chance: the others are held against the intervals in which they all lie with 95 % (Sidak).
class NeesSums {
 public:
  void AddMain(const std::string& name, double nees, int dof) { Add(name, nees, dof).main = true; }
  void AddOther(const std::string& name, double nees, int dof) { Add(name, nees, dof); }
  void ExpectInIntervals() const {
    const auto others = std::count_if(sums_.begin(), sums_.end(), [](const auto& s) { return !s.second.main; });
    for (const auto& [name, sum] : sums_) {
      ASSERT_EQ(sum.runs, kRuns) << name;
      const double probability = sum.main ? 0.95 : std::pow(0.95, 1.0 / static_cast<double>(others));
      const auto interval = testing::NeesInterval(kRuns, sum.dof, probability);
      const double mean = sum.nees / kRuns;
      EXPECT_TRUE(interval.Contains(mean))
          << name << ": mean NEES " << mean << ", interval [" << interval.low << ", " << interval.high << "]";
    }
  }

 private:
  struct Sum {
    double nees = 0;
    int dof = 0, runs = 0;
    bool main = false;
  };
  Sum& Add(const std::string& name, double nees, int dof) {
    Sum& sum = sums_[name];
    sum.nees += nees;
    sum.dof = dof;
    ++sum.runs;
    return sum;
  }
  std::map<std::string, Sum> sums_;
};

// Main ones: the newest pose, all poses jointly, a relative pose across the loops.
template <class Pose, class Estimate>
void AddAll(const Simulation<Pose>& run, const PoseMarginals<Pose>& marginals, const Estimate& estimate_of,
            NeesSums& sums) {
  constexpr int B = Pose::kDof;
  const int newest = static_cast<int>(run.truth.size()) - 1;
  const auto error_of = [&](int k) { return estimate_of(k).Local(run.truth[static_cast<std::size_t>(k)]); };
  const auto joint = [&](const std::vector<int>& chosen) {
    Eigen::VectorXd e(B * static_cast<Eigen::Index>(chosen.size()));
    std::vector<PoseId> ids;
    for (const int k : chosen) {
      e.segment<B>(B * static_cast<Eigen::Index>(ids.size())) = error_of(k);
      ids.push_back(PoseId{k});
    }
    return Nees(e, marginals.Joint(ids));
  };
  const auto relative = [&](int a, int b) {
    const Pose T_a_b = run.truth[static_cast<std::size_t>(a)].Inverse() * run.truth[static_cast<std::size_t>(b)];
    return Nees((estimate_of(a).Inverse() * estimate_of(b)).Local(T_a_b), marginals.Relative(PoseId{a}, PoseId{b}));
  };
  std::vector<int> all(static_cast<std::size_t>(newest));
  std::iota(all.begin(), all.end(), 1);
  sums.AddMain("newest pose", Nees(error_of(newest), marginals.Marginal(PoseId{newest})), B);
  sums.AddMain("all poses", joint(all), B * newest);
  sums.AddMain("newest pose from pose 10", relative(10, newest), B);
  sums.AddOther("pose 3", Nees(error_of(3), marginals.Marginal(PoseId{3})), B);
  sums.AddOther("pose 20", Nees(error_of(20), marginals.Marginal(PoseId{20})), B);
  sums.AddOther("four poses", joint({5, 13, 20, newest - 1}), 4 * B);
  sums.AddOther("pose 21 from pose 20", relative(20, 21), B);
}

TYPED_TEST(NeesTest, BatchOptimum) {
  for (const bool priors : {false, true}) {
    SCOPED_TRACE(priors ? "priors" : "first pose anchored");
    NeesSums sums;
    for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
      SimulationOptions options;
      options.priors = priors;
      const auto run = testing::Simulate<TypeParam>(seed, options);
      const auto result = SolveBatch(run.graph, run.initial);
      ASSERT_TRUE(result.Converged()) << result.message;
      const Marginals<TypeParam> marginals(run.graph, result.T_world_body, result.cholesky);
      const auto estimate_of = [&](int k) { return result.T_world_body[static_cast<std::size_t>(k)]; };
      AddAll<TypeParam>(run, marginals, estimate_of, sums);
    }
    sums.ExpectInIntervals();
  }
}

// As they are while the map grows: before the first loop, among loops, and at the end.
TYPED_TEST(NeesTest, IncrementalSteps) {
  NeesSums sums;
  for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
    const auto run = testing::Simulate<TypeParam>(seed);
    IncrementalSolver<TypeParam> solver;
    IncrementalMarginals<TypeParam> marginals(solver);
    int newest = 0;
    for (const auto& update : testing::OnePosePerUpdate(run.graph, true)) {
      solver.Update(update);
      marginals.Update();
      if (newest == 15 || newest == 30) {
        const TypeParam T = solver.EstimateAt(newest);
        sums.AddOther("newest pose at step " + std::to_string(newest),
                      Nees(T.Local(run.truth[static_cast<std::size_t>(newest)]), marginals.Newest()), TypeParam::kDof);
      }
      ++newest;
    }
    AddAll<TypeParam>(
        run, marginals, [&](int k) { return solver.EstimateAt(k); }, sums);
  }
  sums.ExpectInIntervals();
}

// The test has teeth: where the factors state a tenth more information than the noise has, it fails.
TYPED_TEST(NeesTest, NoticesOverstatedInformation) {
  constexpr int B = TypeParam::kDof;
  double sum = 0;
  for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
    auto run = testing::Simulate<TypeParam>(seed);
    PoseGraph<TypeParam> graph;
    for (const auto& node : run.graph.Poses()) graph.AddPose(node.id, node.T_world_body);
    for (const auto& node : run.graph.Factors()) {
      auto f = std::get<RelativePoseFactor<TypeParam>>(node.factor);
      f.information *= 1.1;
      graph.AddFactor(f);
    }
    const auto result = SolveBatch(graph, run.initial);
    const Marginals<TypeParam> marginals(graph, result.T_world_body, result.cholesky);
    Eigen::VectorXd e(B * 40);
    std::vector<PoseId> ids;
    for (int k = 1; k <= 40; ++k) {
      ids.push_back(PoseId{k});
      const auto at = static_cast<std::size_t>(k);
      e.segment<B>(B * (k - 1)) = result.T_world_body[at].Local(run.truth[at]);
    }
    sum += Nees(e, marginals.Joint(ids));
  }
  EXPECT_GT(sum / kRuns, testing::NeesInterval(kRuns, 40 * B).high);
}

TEST(Nees, QuantilesAreThoseOfTables) {
  EXPECT_NEAR(testing::NormalQuantile(0.975), 1.959963984540054, 1e-12);
  EXPECT_NEAR(testing::NormalQuantile(0.001), -3.090232306167813, 1e-12);
  EXPECT_NEAR(testing::ChiSquareQuantile(100, 0.025), 74.222, 0.01);
  EXPECT_NEAR(testing::ChiSquareQuantile(100, 0.975), 129.561, 0.01);
  EXPECT_NEAR(testing::ChiSquareQuantile(1000, 0.025), 914.257, 0.01);
  EXPECT_NEAR(testing::ChiSquareQuantile(1000, 0.975), 1089.531, 0.01);
}

// The measurement makes the residual at the truth the drawn noise exactly.
TYPED_TEST(NeesTest, NoiseIsTheResidualAtTheTruth) {
  testing::Random rng(3);
  const auto T = testing::RandomMotion<TypeParam>(rng, 5, 1);
  const typename TypeParam::Tangent n = 0.3 * testing::NormalVector<TypeParam::kDof>(rng);
  EXPECT_LT((testing::Measured(T, n).Local(T) - n).norm(), 1e-14);
}

}  // namespace
}  // namespace terse
