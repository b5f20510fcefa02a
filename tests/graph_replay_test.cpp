// A stored graph as the source of a compact run.

#include "terse/compact/graph_replay.h"

#include <gtest/gtest.h>

#include "testing_compact.h"

namespace terse {
namespace {

using testing::Random;

template <class Pose>
class GraphReplayTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(GraphReplayTest, Groups);

template <class Pose>
bool Same(const RelativePoseFactor<Pose>& a, const RelativePoseFactor<Pose>& b) {
  return a.from == b.from && a.to == b.to && testing::Distance(a.T_from_to, b.T_from_to) < 1e-12 &&
         a.information == b.information;
}

// Every edge of the graph exactly once, as odometry or as a link; every prior with its pose.
template <class Pose>
void ExpectAllOffered(const PoseGraph<Pose>& graph) {
  GraphReplay<Pose> replay(graph);
  const auto registration = replay.AsRegistration();
  std::vector<RelativePoseFactor<Pose>> offered;
  std::set<std::int64_t> arrived;
  std::size_t priors = 0;
  int links = 0;
  for (const auto& input : replay.Inputs()) {
    EXPECT_EQ(input.odometry.has_value(), !arrived.empty());
    if (input.odometry) {
      const auto& edge = *input.odometry;
      offered.push_back(edge);
      EXPECT_TRUE(edge.from == input.id || edge.to == input.id);
      EXPECT_EQ(arrived.count((edge.from == input.id ? edge.to : edge.from).value), 1u);
    }
    for (const PoseId other : *input.linkable) {
      EXPECT_EQ(arrived.count(other.value), 1u);
      const auto link = registration(other, input.id);
      ASSERT_TRUE(link.has_value());
      offered.push_back(*link);
      ++links;
    }
    for (const PoseId other : *input.linkable) EXPECT_FALSE(registration(other, input.id)) << "each edge once";
    ASSERT_EQ(input.loops->size(), input.linkable->size());
    for (std::size_t k = 0; k < input.loops->size(); ++k) {
      EXPECT_TRUE(Same((*input.loops)[k], offered[offered.size() - input.loops->size() + k]));
    }
    for (const auto& prior : input.priors) EXPECT_EQ(PosesOf(prior).first, input.id);
    priors += input.priors.size();
    EXPECT_TRUE(arrived.insert(input.id.value).second);
  }
  EXPECT_EQ(links, replay.LinksOffered());
  EXPECT_EQ(arrived.size(), graph.Poses().size());
  EXPECT_EQ(offered.size() + priors, graph.Factors().size());
  for (const auto& node : graph.Factors()) {
    const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (edge == nullptr) continue;
    const auto matches = std::count_if(offered.begin(), offered.end(), [&](const auto& o) { return Same(o, *edge); });
    EXPECT_EQ(matches, 1);
  }
}

template <class Pose>
void ExpectRangeCovers(const PoseGraph<Pose>& graph) {
  const GraphReplay<Pose> replay(graph);
  const auto range = replay.LinkRange();
  EXPECT_TRUE(range.allFinite());
  EXPECT_GT(range.minCoeff(), 0);
  for (const auto& node : graph.Factors()) {
    const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (edge == nullptr) continue;
    const auto is_odometry = [&](const auto& input) { return input.odometry && Same(*input.odometry, *edge); };
    const auto& inputs = replay.Inputs();
    if (replay.LinksOffered() > 0 && std::any_of(inputs.begin(), inputs.end(), is_odometry)) continue;
    for (const PoseId first : {edge->from, edge->to}) {
      const auto displacement = ComputeDisplacement<Pose>(UncertainPose<Pose>{SeenFrom(first, *edge).T_a_b});
      EXPECT_EQ(RangeProbabilities<Pose>(displacement, range).minCoeff(), 1);
    }
  }
}

TYPED_TEST(GraphReplayTest, EveryEdgeIsOfferedOnceAndInRange) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random rng(seed);
    testing::RandomGraphOptions options;  // has backward and double edges
    options.poses = seed == 1 ? 1 : seed == 2 ? 2 : 30;
    options.loops_per_pose = seed % 4 == 0 ? 0 : 0.8;
    options.priors = seed % 2 == 0;
    options.id_stride = 5;
    const auto graph = testing::MakeRandomGraph<TypeParam>(rng, options).graph;
    ExpectAllOffered(graph);
    if (seed > 1) ExpectRangeCovers(graph);
    const GraphReplay<TypeParam> replay(graph);
    EXPECT_TRUE(testing::IsPositiveDefinite(replay.LinkCovariance()));
  }
}

template <class Pose>
RelativePoseFactor<Pose> Edge(Random& rng, std::int64_t from, std::int64_t to) {
  // Every pose is the identity up to noise, so that all edges agree.
  return {PoseId{from}, PoseId{to}, testing::RandomMotion<Pose>(rng, 0.05, 0.05),
          testing::RandomInformation<Pose::kDof>(rng, 100)};
}

// No i -> i + 1, ids out of order and negative, all edges backward, odometry twice.
TYPED_TEST(GraphReplayTest, UnusualGraphs) {
  using Pose = TypeParam;
  Random rng(1);
  PoseGraph<Pose> star, backward, scattered, twice;
  for (int k = 0; k < 12; ++k) {
    for (auto* graph : {&star, &backward, &twice}) graph->AddPose(PoseId{k});
    scattered.AddPose(PoseId{(k * 5 % 12 - 6) * 1000});
  }
  for (int k = 1; k < 12; ++k) {
    star.AddFactor(Edge<Pose>(rng, 0, k));
    backward.AddFactor(Edge<Pose>(rng, k, k - 1));
    if (k > 2) backward.AddFactor(Edge<Pose>(rng, k, k - 3));
    twice.AddFactor(Edge<Pose>(rng, k - 1, k));
    twice.AddFactor(Edge<Pose>(rng, k, k - 1));
    scattered.AddFactor(Edge<Pose>(rng, (k * 5 % 12 - 6) * 1000, ((k - 1) * 5 % 12 - 6) * 1000));
  }
  for (const auto* graph : {&star, &backward, &scattered, &twice}) {
    ExpectAllOffered(*graph);
    ExpectRangeCovers(*graph);
    for (const Strategy strategy : {Strategy::kApal, Strategy::kApfl, Strategy::kFpfl}) {
      auto run = testing::RunReplay(*graph, strategy, 0.1, 2);
      EXPECT_EQ(run.slam->Trajectory().size(), 12u);
      EXPECT_TRUE(run.slam->Finish().Converged());
      if (strategy == Strategy::kApal) {
        EXPECT_EQ(run.slam->Solver().Graph().Factors().size(), graph->Factors().size());
      }
    }
  }
}

TYPED_TEST(GraphReplayTest, EmptyAndDisconnectedGraphsAreRefused) {
  PoseGraph<TypeParam> graph;
  EXPECT_THROW(GraphReplay<TypeParam>{graph}, std::invalid_argument);
  graph.AddPose(PoseId{1});
  EXPECT_EQ(GraphReplay<TypeParam>{graph}.Inputs().size(), 1u);
  graph.AddPose(PoseId{2});
  EXPECT_THROW(GraphReplay<TypeParam>{graph}, std::invalid_argument);
}

}  // namespace
}  // namespace terse
