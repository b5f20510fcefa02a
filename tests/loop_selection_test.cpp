// Loops told apart for a batch solve, those first that others bear out.

#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "shared_data.h"
#include "terse/core/batch_solver.h"
#include "terse/core/graph_file.h"
#include "terse/core/incremental_solver.h"
#include "terse/core/outliers.h"
#include "terse/core/replay.h"
#include "testing_scene.h"

namespace terse {
namespace {

// What the log says of loops without support; nothing if they did not come into it.
struct Heard {
  std::string said;
  LogSink Sink() {
    return [this](LogLevel, std::string_view line) {
      if (line.find("loops have no support") != std::string_view::npos) said = std::string(line);
    };
  }
};

template <class Pose>
void ExpectToldApart(const GraphWithWrongLoops<Pose>& with, const std::vector<double>& weights, double most_true_lost,
                     const std::string& what) {
  long wrong_in = 0, true_out = 0, loops = 0;
  std::size_t k = 0;
  const std::vector<FactorId> candidates = LoopFactors(with.graph);
  for (const auto& node : with.graph.Factors()) {
    const double weight = weights[k++];
    if (!std::binary_search(candidates.begin(), candidates.end(), node.id)) continue;
    const bool is_wrong = std::count(with.wrong.begin(), with.wrong.end(), node.id) > 0;
    wrong_in += is_wrong && weight > 0;
    true_out += !is_wrong && weight == 0;
    loops += !is_wrong;
  }
  EXPECT_EQ(wrong_in, 0) << what;
  EXPECT_LE(static_cast<double>(true_out), most_true_lost * static_cast<double>(loops)) << what;
}

template <class Pose>
class LoopSelection : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(LoopSelection, Groups);

// One in two, nine in ten.
TYPED_TEST(LoopSelection, WrongOnesAreOutWhateverTheirShare) {
  using Pose = TypeParam;
  const Scene scene = Pose::kDof == 3 ? Scene::kManhattan : Scene::kSphere;
  for (const double percent : kSlowBuild ? std::vector<double>{100} : std::vector<double>{100, 900}) {
    const auto [graph, truth] = testing::MakeScene<Pose>(scene, 300, 7);
    const auto with = AddWrongLoops(graph, truth, percent, 7, OutlierKind::kRandom);
    Heard heard;
    BatchOptions options;
    options.robust.kernel = RobustKernel::kGnc;
    options.log = heard.Sink();
    const BatchResult<Pose> result = SolveBatch(with.graph, options);
    ExpectToldApart(with, result.weights, 0.03, std::to_string(percent));
    EXPECT_FALSE(heard.said.empty()) << percent;
  }
}

// Nothing bears them out, and most of what is explained stands alone.
TYPED_TEST(LoopSelection, TrueOnesMayStandAlone) {
  using Pose = TypeParam;
  const Scene scene = Pose::kDof == 3 ? Scene::kManhattan : Scene::kSphere;
  auto [graph, truth] = testing::MakeScene<Pose>(scene, 300, 8);
  PoseId last{-100};
  for (const FactorId id : LoopFactors(graph)) {
    const auto& loop = std::get<RelativePoseFactor<Pose>>(graph.FindFactor(id)->factor);
    const PoseId later = std::max(loop.from, loop.to);
    if (later.value < last.value + 15) {
      graph.RemoveFactor(id);
    } else {
      last = later;
    }
  }
  ASSERT_GE(LoopFactors(graph).size(), 8U);
  const auto with = AddWrongLoops(graph, truth, 100, 8, OutlierKind::kRandom);
  BatchOptions options;
  options.robust.kernel = RobustKernel::kGnc;
  const BatchResult<Pose> result = SolveBatch(with.graph, options);
  ExpectToldApart(with, result.weights, 0.13, "alone");
}

// Two wrong loops that nothing contradicts yet, within the first eighty poses, bend the sphere for good: with them in
// true ones fit badly, but fit.
TEST(LoopSelectionAtTheEnd, FinishHealsTheMap) {
  TERSE_NEEDS(path, "graphs/3d/sphere2500.g2o");
  const PoseGraph<SE3> graph = std::get<PoseGraph<SE3>>(ReadGraph(path).graph);
  const auto whole = AddWrongLoops(graph, SolveBatch(graph).T_world_body, 100, 21, OutlierKind::kRandom);
  GraphWithWrongLoops<SE3> with{testing::FirstPoses(whole.graph, 400), {}};
  std::set<std::pair<PoseId, PoseId>> wrong;
  const auto ends = [](const auto& graph, FactorId id) {
    const auto& loop = std::get<RelativePoseFactor<SE3>>(graph.FindFactor(id)->factor);
    return std::make_pair(loop.from, loop.to);
  };
  for (const FactorId id : whole.wrong) wrong.insert(ends(whole.graph, id));
  for (const auto& node : with.graph.Factors()) {
    if (wrong.count(ends(with.graph, node.id)) > 0) with.wrong.push_back(node.id);
  }
  IncrementalOptions options;
  options.robust.kernel = RobustKernel::kGnc;
  IncrementalSolver<SE3> solver(options);
  Replay<SE3>(with.graph, ReplayOptions(), solver, [](const ReplayStep&) { return true; });
  const double before = solver.RobustChi2();
  const BatchResult<SE3> finished = solver.Finish();
  EXPECT_LT(finished.robust_cost, 0.5 * before) << "or it was not misled";
  std::vector<double> weights;
  for (const auto& node : with.graph.Factors()) weights.push_back(solver.WeightOf(node.id));
  ExpectToldApart(with, weights, 0.03, "finished");
  EXPECT_NEAR(solver.RobustChi2(), finished.robust_cost, 1e-6 * finished.robust_cost);
}

// Nothing can be replayed where a prior alone holds a pose; half of the loops are out all the same.
TEST(LoopSelectionAtTheEnd, APoseThatOnlyAPriorHolds) {
  const auto [graph, truth] = testing::MakeScene<SE2>(Scene::kManhattan, 150, 11);
  const auto with = AddWrongLoops(graph, truth, 100, 11, OutlierKind::kRandom);
  IncrementalOptions options;
  options.robust.kernel = RobustKernel::kGnc;
  IncrementalSolver<SE2> solver(options);
  Replay<SE2>(with.graph, ReplayOptions(), solver, [](const ReplayStep&) { return true; });
  GraphUpdate<SE2> update;
  update.poses.push_back({PoseId{9000}, SE2()});
  update.factors.push_back(PosePriorFactor<SE2>{PoseId{9000}, SE2(), Matrix<3, 3>::Identity()});
  update.factors.push_back(PosePriorFactor<SE2>{graph.Poses().front().id, SE2(), Matrix<3, 3>::Identity()});
  solver.Update(update);
  EXPECT_TRUE(solver.Finish().Converged());
}

}  // namespace
}  // namespace terse
