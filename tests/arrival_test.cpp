#include "terse/core/arrival.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <set>

#include "testing_poses.h"

namespace terse {
namespace {

using Graph = PoseGraph<SE2>;

void AddEdge(Graph& graph, std::int64_t from, std::int64_t to) {
  graph.AddFactor(RelativePoseFactor<SE2>{{from}, {to}, SE2(), Matrix<3, 3>::Identity()});
}
void AddPrior(Graph& graph, std::int64_t pose) {
  graph.AddFactor(PosePriorFactor<SE2>{{pose}, SE2(), Matrix<3, 3>::Identity()});
}
Graph WithPoses(const std::vector<std::int64_t>& ids) {
  Graph graph;
  for (const auto id : ids) graph.AddPose({id});
  return graph;
}

// A connected graph whose poses have random ids in random order, and edges random directions and order. The
// spanning tree follows another random order, so that most ids wait at some time.
Graph RandomGraph(unsigned seed) {
  testing::PoseRandom random(seed);
  const int n = 1 + static_cast<int>(random.Uniform(0, 40));
  const auto pick = [&](int end) { return static_cast<int>(random.Uniform(0, end)); };
  std::set<std::int64_t> distinct;
  while (static_cast<int>(distinct.size()) < n) distinct.insert(static_cast<std::int64_t>(random.Uniform(-1e12, 1e12)));
  std::vector<std::int64_t> ids(distinct.begin(), distinct.end());
  for (int i = n - 1; i > 0; --i) std::swap(ids[std::size_t(i)], ids[std::size_t(pick(i + 1))]);
  // Half of the graphs are near online order.
  if (seed % 2 == 0) {
    std::sort(ids.begin(), ids.end());
    if (n > 3) std::swap(ids[1], ids[2]);
  }
  Graph graph = WithPoses(ids);
  std::vector<std::pair<int, int>> edges;
  for (int i = 1; i < n; ++i) edges.emplace_back(i, random.Uniform(0, 1) < 0.5 ? i - 1 : pick(i));
  for (int k = 0; n > 1 && k < n; ++k) {
    const int a = pick(n), b = pick(n);
    if (a != b) edges.emplace_back(a, b);
  }
  for (int k = 0; k < n / 4; ++k) edges.emplace_back(pick(n), -1);
  for (std::size_t i = edges.size(); i > 1; --i) std::swap(edges[i - 1], edges[std::size_t(pick(static_cast<int>(i)))]);
  for (auto [a, b] : edges) {
    if (b < 0) {
      AddPrior(graph, ids[std::size_t(a)]);
      continue;
    }
    if (random.Uniform(0, 1) < 0.5) std::swap(a, b);
    AddEdge(graph, ids[std::size_t(a)], ids[std::size_t(b)]);
  }
  return graph;
}

std::pair<int, int> Ends(const Graph& graph, int factor) {
  const FactorPoses ends = PosesOf(graph.Factors()[std::size_t(factor)].factor);
  return {graph.IndexOf(ends.first), graph.IndexOf(ends.second)};
}

std::vector<int> Ranks(const Graph& graph) {
  std::vector<int> rank(graph.Poses().size());
  for (std::size_t i = 0; i < rank.size(); ++i) {
    rank[i] = static_cast<int>(std::count_if(graph.Poses().begin(), graph.Poses().end(),
                                             [&](const auto& p) { return p.id < graph.Poses()[i].id; }));
  }
  return rank;
}

// Poses reachable from rank 0 over poses of rank <= r, by repeated sweeps.
std::set<int> ReachableUpTo(const Graph& graph, const std::vector<int>& rank, int r) {
  std::set<int> reached;
  for (std::size_t i = 0; i < rank.size(); ++i) {
    if (rank[i] == 0) reached.insert(static_cast<int>(i));
  }
  for (std::size_t before = 0; before != reached.size();) {
    before = reached.size();
    for (std::size_t f = 0; f < graph.Factors().size(); ++f) {
      const auto [a, b] = Ends(graph, static_cast<int>(f));
      if (rank[std::size_t(a)] > r || rank[std::size_t(b)] > r) continue;
      if (reached.count(a)) reached.insert(b);
      if (reached.count(b)) reached.insert(a);
    }
  }
  return reached;
}

// What both units share. Checks that everything appears once, each factor after its poses and with the later one,
// each pose but the first with a factor to an earlier one. Returns the order of the poses.
std::vector<int> CheckOrder(const Graph& graph, const std::vector<ArrivalStep>& steps) {
  std::vector<int> order, factors;
  for (const auto& step : steps) {
    order.insert(order.end(), step.poses.begin(), step.poses.end());
    for (const int f : step.factors) {
      const auto [a, b] = Ends(graph, f);
      for (const int pose : {a, b}) EXPECT_TRUE(std::count(order.begin(), order.end(), pose)) << "factor before pose";
      factors.push_back(f);
    }
  }
  std::vector<int> all_poses(graph.Poses().size()), all_factors(graph.Factors().size());
  std::iota(all_poses.begin(), all_poses.end(), 0);
  std::iota(all_factors.begin(), all_factors.end(), 0);
  EXPECT_TRUE(std::is_permutation(order.begin(), order.end(), all_poses.begin(), all_poses.end()));
  EXPECT_TRUE(std::is_permutation(factors.begin(), factors.end(), all_factors.begin(), all_factors.end()));
  // Following the factors in their order, each brings at most one new pose, and nothing unconnected.
  std::set<int> connected{order.front()};
  for (const int f : factors) {
    const auto [a, b] = Ends(graph, f);
    EXPECT_TRUE(connected.count(a) || connected.count(b)) << "factor " << f << " hangs in the air";
    connected.insert(a);
    connected.insert(b);
  }
  EXPECT_EQ(connected.size(), graph.Poses().size());
  return order;
}

TEST(Arrival, PoseStepsOfRandomGraphs) {
  for (unsigned seed = 0; seed < 300; ++seed) {
    SCOPED_TRACE(seed);
    const Graph graph = RandomGraph(seed);
    const std::vector<int> rank = Ranks(graph);
    const auto steps = ArrivalSteps(graph, ArrivalUnit::kPose);
    const std::vector<int> order = CheckOrder(graph, steps);
    EXPECT_EQ(rank[std::size_t(order.front())], 0);
    ASSERT_EQ(steps.front().poses.size(), 1u);
    for (const int f : steps.front().factors) EXPECT_EQ(Ends(graph, f).first, Ends(graph, f).second);

    std::set<int> arrived;
    for (const auto& step : steps) {
      // The newest comes first, and everything connected by it has arrived after the step: nothing waits longer.
      const int newest = rank[std::size_t(step.poses.front())];
      for (const int pose : step.poses) EXPECT_LE(rank[std::size_t(pose)], newest);
      const std::set<int> before = arrived;
      arrived.insert(step.poses.begin(), step.poses.end());
      EXPECT_EQ(arrived, ReachableUpTo(graph, rank, newest));
      std::size_t expected = 0;
      for (std::size_t f = 0; f < graph.Factors().size(); ++f) {
        const auto [a, b] = Ends(graph, static_cast<int>(f));
        expected += arrived.count(a) && arrived.count(b) && !(before.count(a) && before.count(b));
      }
      EXPECT_EQ(step.factors.size(), expected);
    }
  }
}

TEST(Arrival, EdgeStepsOfRandomGraphs) {
  for (unsigned seed = 0; seed < 300; ++seed) {
    SCOPED_TRACE(seed);
    const Graph graph = RandomGraph(seed);
    const auto steps = ArrivalSteps(graph, ArrivalUnit::kEdge);
    const std::vector<int> order = CheckOrder(graph, steps);
    std::vector<int> pose_order;
    for (const auto& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
      pose_order.insert(pose_order.end(), step.poses.begin(), step.poses.end());
    }
    EXPECT_EQ(order, pose_order);
    std::vector<int> position(order.size());
    for (std::size_t i = 0; i < order.size(); ++i) position[std::size_t(order[i])] = static_cast<int>(i);
    std::pair<int, int> last{-1, 0};
    for (std::size_t s = 0; s < steps.size(); ++s) {
      if (graph.Factors().empty()) continue;
      ASSERT_EQ(steps[s].factors.size(), 1u);
      EXPECT_LE(steps[s].poses.size(), s == 0 ? 2u : 1u);
      const auto [a, b] = Ends(graph, steps[s].factors[0]);
      // By later pose, priors after relative factors.
      const std::pair<int, int> key{std::max(position[std::size_t(a)], position[std::size_t(b)]), a == b};
      EXPECT_LE(last, key);
      last = key;
    }
  }
}

std::vector<std::vector<int>> Factors(const std::vector<ArrivalStep>& steps) {
  std::vector<std::vector<int>> out;
  for (const auto& step : steps) out.push_back(step.factors);
  return out;
}

TEST(Arrival, OdometryComesFirstOthersKeepTheirOrder) {
  Graph graph = WithPoses({0, 1, 2, 7});
  AddEdge(graph, 7, 0);  // 0: loop, stored backward
  AddPrior(graph, 7);    // 1
  AddEdge(graph, 7, 2);  // 2: odometry of 7, the ids have a gap
  AddEdge(graph, 1, 7);  // 3
  AddEdge(graph, 0, 1);  // 4
  AddEdge(graph, 1, 2);  // 5
  AddPrior(graph, 0);    // 6
  using Lists = std::vector<std::vector<int>>;
  EXPECT_EQ(Factors(ArrivalSteps(graph, ArrivalUnit::kPose)), (Lists{{6}, {4}, {5}, {2, 0, 1, 3}}));
  EXPECT_EQ(Factors(ArrivalSteps(graph, ArrivalUnit::kEdge)), (Lists{{6}, {4}, {5}, {2}, {0}, {3}, {1}}));
}

TEST(Arrival, WaitingPosesComeWithTheirConnection) {
  Graph graph = WithPoses({3, 0, 1, 2});  // indices 0 1 2 3
  AddEdge(graph, 1, 2);
  AddPrior(graph, 1);
  AddEdge(graph, 2, 3);
  AddEdge(graph, 0, 3);
  const auto steps = ArrivalSteps(graph, ArrivalUnit::kPose);
  ASSERT_EQ(steps.size(), 2u);
  EXPECT_EQ(steps[0].poses, std::vector<int>{1});
  EXPECT_EQ(steps[1].poses, (std::vector<int>{0, 3, 2}));
  EXPECT_EQ(steps[1].factors, (std::vector<int>{3, 2, 0, 1}));
}

TEST(Arrival, SmallAndUnconnectedGraphs) {
  for (const auto unit : {ArrivalUnit::kPose, ArrivalUnit::kEdge}) {
    EXPECT_TRUE(ArrivalSteps(Graph(), unit).empty());
    const auto steps = ArrivalSteps(WithPoses({5}), unit);
    ASSERT_EQ(steps.size(), 1u);
    EXPECT_EQ(steps[0].poses, std::vector<int>{0});
    EXPECT_TRUE(steps[0].factors.empty());
    EXPECT_THROW(ArrivalSteps(WithPoses({5, 6}), unit), std::invalid_argument);
  }
}

TEST(Arrival, AMillionPosesInReverse) {
  // Every pose waits for the last one. Finishes at once, or not at all if the order were quadratic.
  constexpr int kPoses = 1000000;
  Graph graph;
  for (int i = 0; i < kPoses; ++i) graph.AddPose({i});
  AddEdge(graph, 0, kPoses - 1);
  for (int i = kPoses - 1; i > 1; --i) AddEdge(graph, i, i - 1);
  const auto steps = ArrivalSteps(graph, ArrivalUnit::kPose);
  ASSERT_EQ(steps.size(), 2u);
  EXPECT_EQ(steps[1].poses.size(), kPoses - 1u);
}

}  // namespace
}  // namespace terse
