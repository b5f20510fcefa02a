// A wrong loop that holds a part of the map in place, with nothing but odometry beside it.

#include "terse/core/hanging_loops.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "loop_weights.h"
#include "terse/core/incremental_solver.h"
#include "terse/core/replay.h"
#include "terse/core/robust.h"
#include "testing_poses.h"

namespace terse {
namespace {

constexpr int kLap = 20, kWay = 120;
constexpr int kSecond = 2 * kLap + kWay, kPoses = kSecond + 2 * kLap;
constexpr double kCaution = 5;  // information says so many times what noise is

// Two laps of one place, a way, two laps of another; each place has loops from lap to lap.
template <class Pose>
class TwoPlaces {
 public:
  explicit TwoPlaces(unsigned seed) : random_(seed) {
    for (int k = 0; k < kPoses; ++k) graph_.AddPose(PoseId{k});
    truth_.emplace_back();
    for (int k = 1; k < kPoses; ++k) {
      const bool is_on_way = k >= 2 * kLap && k < kSecond;
      truth_.push_back(truth_.back() * Motion(1, is_on_way ? 0 : 2 * testing::kPi / kLap));
      AddEdge(k - 1, k, Pose());
    }
    for (const int place : {0, kSecond}) {
      for (int k = 0; k < kLap; ++k) AddEdge(place + k, place + kLap + k, Pose());
    }
  }
  // Between the places, turned by so much.
  FactorId Join(int from, int to, double turn) { return AddEdge(from, kSecond + to, Motion(0, turn)); }
  const PoseGraph<Pose>& Graph() const { return graph_; }
  // The optimum with all of them in, whatever it takes.
  BatchResult<Pose> WithAll() const {
    const BatchResult<Pose> all = SolveBatch(graph_);
    return SolveBatch(graph_, all.T_world_body, Options());
  }
  BatchResult<Pose> Judged(const BatchResult<Pose>& solved) const {
    return internal::WithoutHangingLoops(graph_, solved, Options()).value_or(solved);
  }
  double WeightOf(FactorId id, const BatchResult<Pose>& result) const { return testing::WeightOf(graph_, id, result); }

 private:
  static Pose Motion(double metres, double turn) {
    typename Pose::Tangent d = Pose::Tangent::Zero();
    d[0] = metres;
    d[Pose::kDof - 1] = turn;
    return Pose::Exp(d);
  }
  static typename Pose::Tangent Sigma() { return Pose::Tangent::Constant(0.1); }
  FactorId AddEdge(int from, int to, const Pose& off) {
    const auto at = [&](int k) { return truth_[static_cast<std::size_t>(k)]; };
    const typename Pose::Tangent noise = Sigma().cwiseProduct(random_.NormalVector<Pose::kDof>()) / kCaution;
    const Pose measured = at(from).Inverse() * at(to) * off * Pose::Exp(noise);
    const typename Pose::Jacobian information = Sigma().cwiseAbs2().cwiseInverse().asDiagonal();
    return graph_.AddFactor(RelativePoseFactor<Pose>{PoseId{from}, PoseId{to}, measured, information});
  }
  BatchOptions Options() const {
    BatchOptions options;
    options.robust.kernel = RobustKernel::kGnc;
    options.robust.width = WidthOf(options.robust, Pose::kDof);
    options.robust_factors = LoopFactors(graph_);
    options.graduate = false;
    return options;
  }

  testing::PoseRandom random_;
  PoseGraph<Pose> graph_;
  std::vector<Pose> truth_;
};

template <class Pose>
class HangingLoops : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(HangingLoops, Groups);

TYPED_TEST(HangingLoops, AWrongOneGoes) {
  for (const unsigned seed : {1U, 2U, 3U}) {
    TwoPlaces<TypeParam> world(seed);
    const FactorId wrong = world.Join(5, 5, 1.5);
    const auto bent = world.WithAll();
    ASSERT_EQ(world.WeightOf(wrong, bent), 1) << seed;  // it costs less than the width of the kernel
    const auto judged = world.Judged(bent);
    EXPECT_EQ(world.WeightOf(wrong, judged), 0) << seed;
    const auto without = SolveBatch(WithoutFactors(world.Graph(), {wrong}));
    for (std::size_t k = 0; k < without.T_world_body.size(); ++k) {
      EXPECT_LT((without.T_world_body[k].Inverse() * judged.T_world_body[k]).Log().norm(), 1e-4) << seed << ' ' << k;
    }
  }
}

TYPED_TEST(HangingLoops, TrueOnesStay) {
  for (const unsigned seed : {4U, 5U, 6U, 7U, 8U}) {
    TwoPlaces<TypeParam> world(seed);
    const FactorId right = world.Join(5, 5, 0);
    const auto solved = world.WithAll();
    const auto judged = world.Judged(solved);
    EXPECT_EQ(world.WeightOf(right, judged), 1) << seed;
    EXPECT_EQ(judged.robust_cost, solved.robust_cost) << seed;
  }
}

// Four from place to place that agree: odometry with a spread of a radian does not outweigh them.
TYPED_TEST(HangingLoops, ManyThatAgreeStay) {
  TwoPlaces<TypeParam> world(9);
  std::vector<FactorId> loops;
  for (const int k : {4, 5, 6, 7}) loops.push_back(world.Join(k, k, 0));
  const auto judged = world.Judged(world.WithAll());
  for (const FactorId id : loops) EXPECT_EQ(world.WeightOf(id, judged), 1);
}

TYPED_TEST(HangingLoops, OnlyTheWrongOneGoes) {
  for (const unsigned seed : {10U, 11U, 12U}) {
    TwoPlaces<TypeParam> world(seed);
    const FactorId wrong = world.Join(15, 2, 1.5);
    const auto bent = world.WithAll();
    ASSERT_EQ(world.WeightOf(wrong, bent), 1) << seed;
    const auto judged = world.Judged(bent);
    EXPECT_EQ(world.WeightOf(wrong, judged), 0) << seed;
    EXPECT_EQ(std::count(judged.weights.begin(), judged.weights.end(), 0.0),
              std::count(bent.weights.begin(), bent.weights.end(), 0.0) + 1)
        << seed;
  }
}

// By defaults: batch gnc, and Finish of a run that believed it.
TYPED_TEST(HangingLoops, SolversLetItGo) {
  TwoPlaces<TypeParam> world(1);
  const FactorId wrong = world.Join(5, 5, 1.5);
  BatchOptions batch;
  batch.robust.kernel = RobustKernel::kGnc;
  EXPECT_EQ(world.WeightOf(wrong, SolveBatch(world.Graph(), batch)), 0);
  IncrementalOptions options;
  options.robust.kernel = RobustKernel::kGnc;
  IncrementalSolver<TypeParam> solver(options);
  Replay<TypeParam>(world.Graph(), ReplayOptions(), solver, [](const ReplayStep&) { return true; });
  FactorId in_run;
  for (const auto& node : solver.Graph().Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    if (ends.first == PoseId{5} && ends.second == PoseId{kSecond + 5}) in_run = node.id;
  }
  // The planar run did not believe it.
  if (TypeParam::kDof == 6) {
    ASSERT_EQ(solver.WeightOf(in_run), 1);
  }
  solver.Finish();
  EXPECT_EQ(solver.WeightOf(in_run), 0);
}

}  // namespace
}  // namespace terse
