// Loops that an optimum leaves out though it knows little of what they measure.

#include "terse/core/open_loops.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "loop_weights.h"
#include "shared_data.h"
#include "terse/core/graph_file.h"
#include "terse/core/incremental_solver.h"
#include "terse/core/outliers.h"
#include "terse/core/replay.h"
#include "terse/core/robust.h"
#include "testing_poses.h"

namespace terse {
namespace {

constexpr int kPosesOfWalk = 40;

// A walk with odometry of 0.05 m and 0.02 rad, and loops of a tenth of that.
template <class Pose>
class Walk {
 public:
  explicit Walk(unsigned seed) : random_(seed) {
    for (int k = 0; k < kPosesOfWalk; ++k) graph_.AddPose(PoseId{k});
    const Pose step = Along(0, 1);
    truth_.emplace_back();
    composed_.emplace_back();
    for (int k = 1; k < kPosesOfWalk; ++k) {
      truth_.push_back(truth_.back() * step);
      const Pose measured = step * Noise(1);
      composed_.push_back(composed_.back() * measured);
      graph_.AddFactor(RelativePoseFactor<Pose>{PoseId{k - 1}, PoseId{k}, measured, Information(1)});
    }
  }
  // `off`: metres.
  FactorId AddLoop(int from, int to, double off = 0) {
    const Pose measured = truth_[Index(from)].Inverse() * truth_[Index(to)] * Along(1, off) * Noise(0.1);
    return graph_.AddFactor(RelativePoseFactor<Pose>{PoseId{from}, PoseId{to}, measured, Information(0.1)});
  }
  // From composed odometry.
  BatchOptions Options() const {
    BatchOptions options;
    options.robust.kernel = RobustKernel::kGnc;
    options.robust.width = WidthOf(options.robust, Pose::kDof);
    options.robust_factors = LoopFactors(graph_);
    options.graduate = false;
    return options;
  }
  BatchResult<Pose> Alone() const { return SolveBatch(graph_, composed_, Options()); }
  BatchResult<Pose> WithOpen() const {
    const BatchOptions options = Options();
    const auto cost = [&](const BatchResult<Pose>& result) {
      return internal::TruncatedCost(graph_, result.T_world_body, *options.robust_factors, options.robust.width);
    };
    return internal::SolveWithOpenLoops<Pose>(
        graph_, composed_, options, [&](const auto& with, const auto& before) { return cost(with) < cost(before); });
  }
  double WeightOf(FactorId id, const BatchResult<Pose>& result) const { return testing::WeightOf(graph_, id, result); }
  double Off(const BatchResult<Pose>& result, int pose) const {
    return (result.T_world_body[Index(pose)].Translation() - truth_[Index(pose)].Translation()).norm();
  }

 private:
  using Tangent = Vector<Pose::kDof>;
  static std::size_t Index(int k) { return static_cast<std::size_t>(k); }
  static Pose Along(int axis, double metres) {
    Tangent step = Tangent::Zero();
    step[axis] = metres;
    return Pose::Exp(step);
  }
  static Tangent Sigma(double scale) {
    Tangent sigma = Tangent::Constant(0.02 * scale);
    sigma.template head<Pose::kDim>().setConstant(0.05 * scale);
    return sigma;
  }
  Pose Noise(double scale) { return Pose::Exp(Sigma(scale).cwiseProduct(random_.template NormalVector<Pose::kDof>())); }
  static typename Pose::Jacobian Information(double scale) {
    return Sigma(scale).cwiseAbs2().cwiseInverse().asDiagonal();
  }

  testing::PoseRandom random_;
  PoseGraph<Pose> graph_;
  std::vector<Pose> truth_, composed_;
};

template <class Pose>
class OpenLoops : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(OpenLoops, Groups);

TYPED_TEST(OpenLoops, TrueOnesComeIn) {
  for (const unsigned seed : {1U, 2U, 3U}) {
    Walk<TypeParam> walk(seed);
    const FactorId loop = walk.AddLoop(0, kPosesOfWalk - 1);
    EXPECT_EQ(walk.WeightOf(loop, walk.Alone()), 0) << seed;
    const auto result = walk.WithOpen();
    EXPECT_EQ(walk.WeightOf(loop, result), 1) << seed;
    EXPECT_LT(walk.Off(result, kPosesOfWalk - 1), 0.1) << seed;
  }
}

// What odometry can be off by is metres; this is more.
TYPED_TEST(OpenLoops, WrongOnesStayOut) {
  for (const unsigned seed : {4U, 5U, 6U}) {
    Walk<TypeParam> walk(seed);
    const FactorId wrong = walk.AddLoop(0, kPosesOfWalk - 1, 300);
    EXPECT_EQ(walk.WeightOf(wrong, walk.WithOpen()), 0) << seed;
  }
}

// By itself it could be true; with the others it could not, which come in all the same.
TYPED_TEST(OpenLoops, AWrongOneAmongThemStaysOut) {
  for (const unsigned seed : {7U, 8U, 9U}) {
    Walk<TypeParam> walk(seed);
    std::vector<FactorId> right;
    for (const int k : {0, 1, 2, 3}) right.push_back(walk.AddLoop(k, kPosesOfWalk - 5 + k));
    const FactorId wrong = walk.AddLoop(4, kPosesOfWalk - 1, 8);
    const auto result = walk.WithOpen();
    for (const FactorId id : right) EXPECT_EQ(walk.WeightOf(id, result), 1) << seed;
    EXPECT_EQ(walk.WeightOf(wrong, result), 0) << seed;
  }
}

// intel, groups of wrong loops. The first ones were believed until loops contradicted them, and left the map in a
// wrong minimum, where all true loops fit badly but fit: it ended 10 m off. Seeds 1 and 8 are those of ten that did.
TEST(WrongMinimum, IsLeftWhenAGroupIsFoundOut) {
  TERSE_NEEDS(path, "graphs/2d/intel.g2o");
  const auto graph = ReadPoseGraph<SE2>(path);
  const std::vector<SE2> truth = SolveBatch(graph).T_world_body;
  struct Draw {
    double percent;
    std::uint64_t seed;
  };
  for (const Draw draw : {Draw{300.0 / 7, 1}, Draw{100, 8}}) {
    const auto with = AddWrongLoops(graph, truth, draw.percent, draw.seed, OutlierKind::kGrouped);
    IncrementalOptions options;
    options.robust.kernel = RobustKernel::kGnc;
    IncrementalSolver<SE2> solver(options);
    Replay<SE2>(with.graph, ReplayOptions(), solver, [](const ReplayStep&) { return true; });
    EXPECT_GE(solver.Restarts(), 1) << draw.seed;
    double off = 0;
    for (const auto& node : graph.Poses()) {
      const auto T = [&](const SE2& first, const SE2& pose) { return first.Inverse() * pose; };
      const SE2 found = T(solver.Estimate(graph.Poses().front().id), solver.Estimate(node.id));
      const SE2 wanted = T(truth.front(), truth[static_cast<std::size_t>(graph.IndexOf(node.id))]);
      off = std::max(off, (found.Translation() - wanted.Translation()).norm());
    }
    EXPECT_LT(off, 0.1) << draw.seed;
    // A replay numbers factors as the graph has them.
    for (const FactorId id : with.wrong) EXPECT_EQ(solver.WeightOf(id), 0) << draw.seed;
  }
}

}  // namespace
}  // namespace terse
