// Merge: maps whose place relative to each other is unknown become the map that one robot would have made of it all,
// and links that are wrong stay out.

#include "terse/compact/merge.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <set>

#include "simulation.h"
#include "terse/compact/compact_graph.h"
#include "terse/compact/link_consistency.h"
#include "terse/core/batch_solver.h"
#include "terse/core/error.h"
#include "terse/core/evaluate.h"
#include "terse/core/generate_robots.h"
#include "terse/core/random.h"
#include "terse/covariance/marginals.h"

namespace terse {
namespace {

std::size_t At(std::int64_t i) { return static_cast<std::size_t>(i); }

// A scene cut into runs of poses, each in a frame of its own, ids from 0; edges between them are the links.
template <class Pose>
struct Split {
  PoseGraph<Pose> whole;
  BatchResult<Pose> optimum;
  std::vector<MapToMerge<Pose>> maps;
  std::vector<MapLink<Pose>> links;
  int size = 0;  // of each map
  PoseId InWhole(int map, std::int64_t own) const { return whole.Poses()[At(map * size + own)].id; }
  std::vector<PoseGraph<Pose>> graphs;
};

template <class Pose>
Split<Pose> SplitScene(std::uint64_t seed, int maps = 2, int size = 40, double loops_per_pose = 2) {
  testing::Random rng(seed);
  testing::RandomGraphOptions options;
  options.poses = maps * size;
  options.loops_per_pose = loops_per_pose;
  Split<Pose> split;
  split.size = size;
  split.whole = testing::MakeRandomGraph<Pose>(rng, options).graph;
  split.optimum = SolveBatch(split.whole);
  split.graphs.resize(At(maps));
  for (std::int64_t v = 0; v < maps * size; ++v) split.graphs[At(v / size)].AddPose({v % size});
  for (const auto& node : split.whole.Factors()) {
    const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (edge == nullptr) continue;
    const int i = split.whole.IndexOf(edge->from), j = split.whole.IndexOf(edge->to);
    const int from = i / size, to = j / size;
    RelativePoseFactor<Pose> own = *edge;
    own.from = {i % size};
    own.to = {j % size};
    if (from == to) {
      split.graphs[At(from)].AddFactor(own);
    } else {
      split.links.push_back({from, to, own});
    }
  }
  for (int k = 0; k < maps; ++k)
    split.maps.push_back({std::string(1, static_cast<char>('a' + k)), MapOfGraph(split.graphs[At(k)])});
  return split;
}

template <class Pose>
MergeOptions<Pose> KeepAll() {
  MergeOptions<Pose> options;
  options.retire_share = 0;
  return options;
}

// A link of a right one's information that leads anywhere.
template <class Pose>
MapLink<Pose> WrongLink(const MapLink<Pose>& like, int size, internal::Random& rng) {
  MapLink<Pose> wrong = like;
  const auto any = [&] { return static_cast<std::int64_t>(rng.Uniform() * size); };
  wrong.measured.from = {any()};
  wrong.measured.to = {any()};
  typename Pose::Tangent d;
  for (int k = 0; k < Pose::kDof; ++k) d[k] = rng.Normal() * (k < Pose::kDim ? 3 : 1);
  wrong.measured.T_from_to = Pose().Retract(d);
  return wrong;
}

template <class Pose>
class MergeTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(MergeTest, Groups);

TYPED_TEST(MergeTest, TwoMapsAndTheirLinksAreTheWholeGraph) {
  using Pose = TypeParam;
  const auto split = SplitScene<Pose>(1);
  ASSERT_GT(split.links.size(), 5u);
  const auto merged = Merge(split.maps, split.links, KeepAll<Pose>());
  EXPECT_EQ(FindDefect(merged.map), "");
  EXPECT_EQ(merged.graph.Factors().size(), split.whole.Factors().size());
  EXPECT_NEAR(merged.chi2, split.optimum.chi2, 1e-6 * split.optimum.chi2);
  EXPECT_EQ(merged.maps[0].placement, Placement::kReference);
  EXPECT_EQ(merged.maps[1].placement, Placement::kLinks);
  for (const auto& link : merged.links) EXPECT_EQ(link.verdict, MapLinkVerdict::kAccepted);

  std::vector<Pose> values;
  for (const auto& node : merged.graph.Poses()) values.push_back(*node.T_world_body);
  const Marginals<Pose> joint(merged.graph, values), whole(split.whole, split.optimum.T_world_body);
  const auto value = [&](int map, std::int64_t own) {
    const PoseId id{own + merged.maps[At(map)].id_offset};
    return *merged.graph.Poses()[At(merged.graph.IndexOf(id))].T_world_body;
  };
  for (const auto& [a, b] : {std::pair(0, 39), std::pair(17, 3), std::pair(20, 20)}) {
    const PoseId in_a = split.InWhole(0, a), in_b = split.InWhole(1, b);
    const Pose expected = split.optimum.T_world_body[At(split.whole.IndexOf(in_a))].Inverse() *
                          split.optimum.T_world_body[At(split.whole.IndexOf(in_b))];
    EXPECT_LT(expected.Local(value(0, a).Inverse() * value(1, b)).norm(), 1e-5);
    const auto across = whole.Relative(in_a, in_b);
    const PoseId joint_a{a + merged.maps[0].id_offset}, joint_b{b + merged.maps[1].id_offset};
    EXPECT_LT((joint.Relative(joint_a, joint_b) - across).norm(), 1e-4 * across.norm()) << "covariances cross maps";
  }
  const auto start = whole.Relative(split.InWhole(0, 0), split.InWhole(1, 0));
  EXPECT_LT((merged.maps[1].covariance - start).norm(), 1e-4 * start.norm());
}

TYPED_TEST(MergeTest, WrongLinksStayOutAloneAndInGroups) {
  using Pose = TypeParam;
  for (const unsigned seed : {2u, 3u, 4u}) {
    auto split = SplitScene<Pose>(seed, 3);
    internal::Random rng(seed);
    std::vector<MapLink<Pose>> links = split.links;
    std::set<std::size_t> wrong;
    const auto add = [&](const MapLink<Pose>& link) {
      wrong.insert(links.size());
      links.push_back(link);
    };
    for (std::size_t k = 0; k < split.links.size(); k += 2) add(WrongLink(split.links[k], split.size, rng));
    // One mistake, five times: these agree with each other.
    const MapLink<Pose> first = WrongLink(split.links[0], split.size - 5, rng);
    const auto at = [&](int map, std::int64_t own) {
      return split.optimum.T_world_body[At(split.whole.IndexOf(split.InWhole(map, own)))];
    };
    const Pose T_mistaken = at(first.from_map, first.measured.from.value) * first.measured.T_from_to *
                            at(first.to_map, first.measured.to.value).Inverse();
    for (std::int64_t s = 0; s < 5; ++s) {
      MapLink<Pose> link = first;
      link.measured.from = {first.measured.from.value + s};
      link.measured.to = {first.measured.to.value + s};
      link.measured.T_from_to =
          at(link.from_map, link.measured.from.value).Inverse() * T_mistaken * at(link.to_map, link.measured.to.value);
      add(link);
    }
    const auto merged = Merge(split.maps, links, KeepAll<Pose>());
    for (std::size_t l = 0; l < links.size(); ++l) {
      EXPECT_EQ(merged.links[l].verdict,
                wrong.count(l) != 0 ? MapLinkVerdict::kInconsistent : MapLinkVerdict::kAccepted)
          << "seed " << seed << ", link " << l << ", innovation " << merged.links[l].innovation;
    }
    EXPECT_NEAR(merged.chi2, split.optimum.chi2, 1e-6 * split.optimum.chi2);
  }
}

// Two long chains that are linked at one end know little of each other at the other: there a wrong link agrees with the
// joint map, until right ones that came in with it say otherwise.
TYPED_TEST(MergeTest, ALinkThatCameInGoesAgainWhereOthersContradictIt) {
  using Pose = TypeParam;
  const int n = 60;
  typename Pose::Tangent ahead = Pose::Tangent::Zero();
  ahead[0] = 1;
  PoseGraph<Pose> chain;
  for (int v = 0; v < n; ++v) chain.AddPose({v});
  for (int v = 0; v + 1 < n; ++v) {
    RelativePoseFactor<Pose> step;
    step.from = {v};
    step.to = {v + 1};
    step.T_from_to = Pose::Exp(ahead);
    step.information = 100 * Pose::Jacobian::Identity();
    chain.AddFactor(step);
  }
  const std::vector<MapToMerge<Pose>> maps = {{"a", MapOfGraph(chain)}, {"b", MapOfGraph(chain)}};
  // Every third link is near the start, and these alone are compared in pairs.
  std::vector<MapLink<Pose>> links;
  for (int k = 0; k < 12; ++k) {
    MapLink<Pose> link;
    link.to_map = 1;
    const int at = k % 3 == 0 ? k / 3 : n - 1 - k;
    link.measured.from = link.measured.to = {at};
    link.measured.information = 1e4 * Pose::Jacobian::Identity();
    links.push_back(link);
  }
  const std::size_t wrong = 7;
  links[wrong].measured.T_from_to = Pose::Exp(ahead);
  MergeOptions<Pose> options = KeepAll<Pose>();
  options.most_compared = 4;
  const auto merged = Merge(maps, links, options);
  for (std::size_t l = 0; l < links.size(); ++l) {
    EXPECT_EQ(merged.links[l].agreeing, l % 3 == 0 ? 3 : -1);
    EXPECT_EQ(merged.links[l].verdict, l == wrong ? MapLinkVerdict::kInconsistent : MapLinkVerdict::kAccepted) << l;
  }
  EXPECT_LT(merged.chi2, 1e-9);
}

// Standard deviations of a hundred times what the noise is, as a unit matrix has them: wrong links agree as stated.
TYPED_TEST(MergeTest, CovariancesThatAreTooCautiousDoNotLetWrongLinksIn) {
  using Pose = TypeParam;
  auto split = SplitScene<Pose>(10, 2, 60);
  const double weaker = 1e-4;
  for (auto& map : split.maps) {
    for (auto& edge : map.map.edges) edge.measured.information *= weaker;
  }
  for (auto& link : split.links) link.measured.information *= weaker;
  const std::size_t right = split.links.size();
  internal::Random rng(10);
  for (std::size_t k = 0; k < right; k += 3) split.links.push_back(WrongLink(split.links[k], split.size, rng));
  const auto merged = Merge(split.maps, split.links, KeepAll<Pose>());
  std::size_t wrong_in = 0, right_in = 0;
  for (std::size_t l = 0; l < split.links.size(); ++l) {
    if (merged.links[l].verdict == MapLinkVerdict::kAccepted) ++(l < right ? right_in : wrong_in);
  }
  EXPECT_EQ(wrong_in, 0u) << "of " << split.links.size() - right;
  EXPECT_EQ(right_in, right);
}

TYPED_TEST(MergeTest, IdsAreKeptApartOnlyWhereMapsShareThem) {
  using Pose = TypeParam;
  auto split = SplitScene<Pose>(5);
  const auto apart = Merge(split.maps, split.links, KeepAll<Pose>());
  EXPECT_EQ(apart.maps[0].id_offset, 0);
  EXPECT_EQ(apart.maps[1].id_offset, 100);  // ids up to 39
  PoseGraph<Pose> moved;
  for (const auto& node : split.graphs[1].Poses()) moved.AddPose({node.id.value - 1000});
  for (const auto& node : split.graphs[1].Factors()) {
    auto edge = std::get<RelativePoseFactor<Pose>>(node.factor);
    edge.from.value -= 1000;
    edge.to.value -= 1000;
    moved.AddFactor(edge);
  }
  split.maps[1].map = MapOfGraph(moved);
  for (auto& link : split.links) (link.from_map == 1 ? link.measured.from : link.measured.to).value -= 1000;
  const auto distinct = Merge(split.maps, split.links, KeepAll<Pose>());
  EXPECT_EQ(distinct.maps[1].id_offset, 0);
  EXPECT_TRUE(distinct.graph.HasPose({-1000}));
  EXPECT_NEAR(distinct.chi2, apart.chi2, 1e-9 * apart.chi2);
}

// Below those of a run that forgets dropped poses: it knows which ones, and can go on forgetting.
TYPED_TEST(MergeTest, IdsAreMovedAsIsSaid) {
  using Pose = TypeParam;
  auto split = SplitScene<Pose>(5);
  split.maps[0].map.forgotten = 3;
  EXPECT_EQ(Merge(split.maps, split.links, KeepAll<Pose>()).map.forgotten, 0) << "ids do not ascend";
  split.maps[1].id_offset = -1000;
  const auto merged = Merge(split.maps, split.links, KeepAll<Pose>());
  EXPECT_EQ(merged.maps[1].id_offset, -1000);
  EXPECT_EQ(merged.map.poses.front().id.value, -1000);
  EXPECT_EQ(merged.map.forgotten, 3);
  EXPECT_EQ(FindDefect(merged.map), "");
  EXPECT_TRUE(CompactPoseSlam<Pose>::Restore(merged.map, {}).HasForgotten({-1}));
  split.maps[1].id_offset = 10;
  EXPECT_THROW(Merge(split.maps, split.links, KeepAll<Pose>()), std::invalid_argument);
  split.maps[1].id_offset = std::numeric_limits<std::int64_t>::max();
  EXPECT_THROW(Merge(split.maps, split.links, KeepAll<Pose>()), std::invalid_argument);
}

TYPED_TEST(MergeTest, AMapThatNothingHoldsStaysApartAndNoTwoThatAgreeAreAnError) {
  using Pose = TypeParam;
  auto split = SplitScene<Pose>(6, 3);
  internal::Random rng(6);
  std::vector<MapLink<Pose>> links;
  for (const auto& link : split.links) {
    if (link.to_map == 2 || link.from_map == 2) continue;
    links.push_back(link);
  }
  auto to_third = split.links.front();
  to_third.to_map = 2;
  for (int k = 0; k < 6; ++k) links.push_back(WrongLink(to_third, split.size, rng));
  const auto merged = Merge(split.maps, links, KeepAll<Pose>());
  EXPECT_EQ(merged.maps[2].placement, Placement::kApart);
  EXPECT_EQ(merged.links.back().verdict, MapLinkVerdict::kMapsApart);
  EXPECT_EQ(merged.graph.Poses().size(), 80u);
  const std::vector<MapLink<Pose>> none(links.end() - 6, links.end());
  EXPECT_THROW(Merge(split.maps, none, KeepAll<Pose>()), NumericalError);
  EXPECT_THROW(Merge(split.maps, {}, KeepAll<Pose>()), NumericalError);
  // One link and nothing else to go by.
  const auto believed = Merge<Pose>({split.maps[0], split.maps[1]}, {links.front()}, KeepAll<Pose>());
  EXPECT_EQ(believed.maps[1].placement, Placement::kUnconfirmed);
}

TYPED_TEST(MergeTest, WhatIsGivenWrongIsRefused) {
  using Pose = TypeParam;
  const auto split = SplitScene<Pose>(7);
  const auto refuse = [&](MapLink<Pose> link) {
    EXPECT_THROW(Merge(split.maps, {link}, KeepAll<Pose>()), std::invalid_argument);
  };
  MapLink<Pose> link = split.links.front();
  link.to_map = 2;
  refuse(link);
  link.to_map = link.from_map;
  refuse(link);
  link = split.links.front();
  link.measured.to = {40};
  refuse(link);
  link = split.links.front();
  link.measured.information(0, 0) = -1;
  refuse(link);
  EXPECT_THROW(Merge<Pose>({split.maps[0]}, {}, KeepAll<Pose>()), std::invalid_argument);
  auto maps = split.maps;
  maps[1].map.poses[3].base = {5};
  EXPECT_THROW(Merge(maps, split.links, KeepAll<Pose>()), std::invalid_argument);
}

// GNSS at every tenth pose: the frame of each map is estimated from it.
TYPED_TEST(MergeTest, AbsoluteMeasurementsTakeThePlaceOfLinks) {
  using Pose = TypeParam;
  auto split = SplitScene<Pose>(8);
  internal::Random rng(8);
  std::vector<MapToMerge<Pose>> maps;
  for (int k = 0; k < 2; ++k) {
    PoseGraph<Pose> graph = split.graphs[At(k)];
    for (std::int64_t own = 0; own < split.size; own += 10) {
      PositionPriorFactor<Pose> gnss;
      gnss.pose = {own};
      gnss.p_world = split.optimum.T_world_body[At(split.whole.IndexOf(split.InWhole(k, own)))].Translation();
      for (int d = 0; d < Pose::kDim; ++d) gnss.p_world[d] += 0.01 * rng.Normal();
      gnss.information.setIdentity();
      gnss.information *= 1e4;
      graph.AddFactor(gnss);
    }
    maps.push_back({"gnss", MapOfGraph(graph)});
  }
  const auto merged = Merge<Pose>(maps, {}, KeepAll<Pose>());
  for (const auto& map : merged.maps) {
    EXPECT_EQ(map.placement, Placement::kDatum);
    EXPECT_GT(map.covariance.trace(), 0) << "the frame is estimated with its uncertainty";
  }
  // With links the two say more together.
  const auto both = Merge(maps, split.links, KeepAll<Pose>());
  for (std::size_t l = 0; l < split.links.size(); ++l) EXPECT_EQ(both.links[l].verdict, MapLinkVerdict::kAccepted);
  EXPECT_LT(both.maps[1].covariance.trace(), merged.maps[1].covariance.trace());
}

TYPED_TEST(MergeTest, AnOriginThatSomebodyChoseIsNoPlaceInTheWorld) {
  using Pose = TypeParam;
  auto split = SplitScene<Pose>(9);
  std::vector<MapToMerge<Pose>> maps;
  for (auto graph : split.graphs) {
    graph.SetPose({0}, Pose());
    graph.SetFixed({0}, true);
    maps.push_back({"fixed", MapOfGraph(graph)});
  }
  const auto merged = Merge(maps, split.links, KeepAll<Pose>());
  EXPECT_NEAR(merged.chi2, split.optimum.chi2, 1e-6 * split.optimum.chi2);
}

// Five per cent of the loops of a Manhattan world between robots; compact maps, links to dropped poses carried.
TEST(MergeRobots, CompactMapsOfThreeRobotsFindTogetherAndOneGoesOn) {
  RobotsOptions team;
  team.robots = 3;
  team.poses = 500;
  team.seed = 5;
  team.link_probability = 0.3;
  team.wrong_link_percent = 20;
  const RobotsData data = GenerateRobots(team);
  std::vector<MapToMerge<SE2>> maps;
  for (std::size_t r = 0; r < data.graphs.size(); ++r)
    maps.push_back({std::to_string(r), CompactGraph(data.graphs[r]).slam.Export()});
  std::vector<MapLink<SE2>> links;
  for (const RobotLink& link : data.links) links.push_back({link.from_robot, link.to_robot, link.measured});
  const auto merged = Merge(maps, links);
  EXPECT_EQ(FindDefect(merged.map), "");
  long right = 0, taken = 0, wrong = 0;
  for (std::size_t l = 0; l < links.size(); ++l) {
    const bool is_in = merged.links[l].verdict == MapLinkVerdict::kAccepted;
    if (data.links[l].is_wrong) {
      wrong += is_in;
    } else {
      ++right;
      taken += is_in;
    }
  }
  EXPECT_EQ(wrong, 0);
  EXPECT_GE(taken, right - right / 50) << "of " << right;
  EXPECT_LT(merged.graph.Poses().size(), static_cast<std::size_t>(merged.poses_before)) << "the joint map is compacted";
  std::vector<SE3> estimate, truth;
  for (const auto& pose : merged.map.poses) {
    for (std::size_t r = 0; r < 3; ++r) {
      const std::int64_t own = pose.id.value - merged.maps[r].id_offset;
      if (own < 0 || own >= team.poses) continue;
      estimate.push_back(Lift(pose.T_world_body));
      truth.push_back(Lift(data.T_world_body_true[r][At(own)]));
    }
  }
  ASSERT_EQ(estimate.size(), 1500u);
  EXPECT_LT(AbsoluteError(estimate, truth), 0.3);

  // The first robot has received the others' maps and goes on.
  CompactOptions<SE2> options;
  options.thresholds = merged.thresholds;
  auto slam = CompactPoseSlam<SE2>::Restore(merged.map, options);
  EXPECT_EQ(merged.map.poses.back().id.value, team.poses - 1) << "its newest pose is the map's";
  for (std::int64_t k = 0; k < 5; ++k) {
    RelativePoseFactor<SE2> step;
    step.from = {team.poses - 1 + k};
    step.to = {team.poses + k};
    step.T_from_to = SE2(1, 0, 0);
    step.information = 1e3 * SE2::Jacobian::Identity();
    slam.AddPose(step.to, step);
  }
  EXPECT_EQ(slam.PosesSeen(), 1505);
}

TEST(MergeRobots, TheDataAreTheSameWithAndWithoutWrongLinks) {
  RobotsOptions team;
  team.poses = 200;
  const RobotsData clean = GenerateRobots(team);
  team.wrong_link_percent = 50;
  team.wrong_link_kind = OutlierKind::kGrouped;
  const RobotsData wrong = GenerateRobots(team);
  std::size_t next = 0;
  for (const RobotLink& link : wrong.links) {
    if (link.is_wrong) continue;
    ASSERT_LT(next, clean.links.size());
    EXPECT_EQ(link.measured.to.value, clean.links[next].measured.to.value);
    EXPECT_EQ(link.measured.T_from_to.Local(clean.links[next++].measured.T_from_to).norm(), 0);
  }
  EXPECT_EQ(next, clean.links.size());
  EXPECT_EQ(wrong.links.size(), next + static_cast<std::size_t>(std::lround(0.5 * static_cast<double>(next))));
  for (const RobotLink& link : clean.links) {  // right links are as good as they say
    const SE2 T = clean.T_world_body_true[At(link.from_robot)][At(link.measured.from.value)].Inverse() *
                  clean.T_world_body_true[At(link.to_robot)][At(link.measured.to.value)];
    EXPECT_LT(link.measured.T_from_to.Local(T).norm(), 0.2);
  }
}

bool IsClique(const std::vector<std::vector<char>>& agrees, const std::vector<int>& members) {
  for (const int a : members) {
    for (const int b : members) {
      if (a != b && agrees[At(a)][At(b)] == 0) return false;
    }
  }
  return true;
}

TEST(LargeClique, IsOneAndFindsWhatIsPlantedAmongChance) {
  internal::Random rng(11);
  for (int trial = 0; trial < 30; ++trial) {
    const int n = 60, planted = 12;
    std::vector<std::vector<char>> agrees(60, std::vector<char>(60, 0));
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < i; ++j) {
        const bool both = i % 5 == 0 && j % 5 == 0;  // twelve of them
        agrees[At(i)][At(j)] = agrees[At(j)][At(i)] = both || rng.Uniform() < 0.2 ? 1 : 0;
      }
    }
    const std::vector<int> found = internal::LargeClique(agrees, std::vector<char>(60, 1));
    EXPECT_TRUE(IsClique(agrees, found));
    EXPECT_GE(static_cast<int>(found.size()), planted);
  }
}

TEST(LargeClique, IsTheLargestOfSmallGraphsNearlyAlways) {
  internal::Random rng(12);
  int largest = 0;
  for (int trial = 0; trial < 100; ++trial) {
    const int n = 10;
    std::vector<std::vector<char>> agrees(At(n), std::vector<char>(At(n), 0));
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < i; ++j) agrees[At(i)][At(j)] = agrees[At(j)][At(i)] = rng.Uniform() < 0.5 ? 1 : 0;
    }
    std::size_t most = 0;
    for (int set = 0; set < 1 << n; ++set) {
      std::vector<int> members;
      for (int i = 0; i < n; ++i) {
        if ((set >> i & 1) != 0) members.push_back(i);
      }
      if (members.size() > most && IsClique(agrees, members)) most = members.size();
    }
    const std::vector<int> found = internal::LargeClique(agrees, std::vector<char>(At(n), 1));
    EXPECT_TRUE(IsClique(agrees, found));
    EXPECT_LE(found.size(), most);
    largest += found.size() == most;
  }
  EXPECT_GE(largest, 95);
}

}  // namespace
}  // namespace terse
