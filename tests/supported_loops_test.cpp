// Which loops others near them bear out: by hand on a straight line, and against wrong loops in generated worlds.

#include "terse/core/supported_loops.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <set>

#include "terse/core/loop_groups.h"
#include "terse/core/outliers.h"
#include "terse/core/robust.h"
#include "testing_scene.h"

namespace terse {
namespace {

using internal::UnsupportedLoops;

// There and back along a line of 50 poses, a metre apart, with centimetres and milliradians for noise: pose k and pose
// 99 - k are in one place and look opposite ways.
class Line : public ::testing::Test {
 protected:
  Line() {
    for (int k = 0; k < 100; ++k) {
      graph_.AddPose(PoseId{k});
      if (k > 0) Link(k - 1, k, TrueMotion(k - 1, k));
    }
  }
  static SE2 Place(int k) { return k < 50 ? SE2({k, 0.0}, 0) : SE2({99.0 - k, 0.0}, 3.14159265358979); }
  static SE2 TrueMotion(int from, int to) { return Place(from).Inverse() * Place(to); }
  FactorId Link(int from, int to, const SE2& T) {
    const Eigen::Vector3d information(1e4, 1e4, 1e6);
    return graph_.AddFactor(RelativePoseFactor<SE2>{PoseId{from}, PoseId{to}, T, information.asDiagonal()});
  }
  FactorId LinkTrue(int from, int to) { return Link(from, to, TrueMotion(from, to)); }

  PoseGraph<SE2> graph_;
};

TEST_F(Line, TwoTrueLoopsBearEachOtherOut) {
  LinkTrue(10, 89);
  LinkTrue(95, 6);  // from the later pose to the earlier one
  EXPECT_TRUE(UnsupportedLoops(graph_).empty());
}

TEST_F(Line, AloneALoopHasNoSupport) {
  const FactorId near = LinkTrue(10, 89), far = LinkTrue(30, 69);
  EXPECT_EQ(UnsupportedLoops(graph_), (std::vector<FactorId>{near, far})) << "20 poses apart";
}

TEST_F(Line, MeasuredTwiceIsNoSupport) {
  const FactorId first = LinkTrue(10, 89), second = LinkTrue(10, 89);
  EXPECT_EQ(UnsupportedLoops(graph_), (std::vector<FactorId>{first, second}));
}

TEST_F(Line, AWrongOneBesideTwoTrueOnes) {
  LinkTrue(10, 89);
  const FactorId wrong = Link(11, 88, TrueMotion(11, 88) * SE2({0.3, 0.0}, 0));  // sixteen standard deviations
  LinkTrue(12, 87);
  EXPECT_EQ(UnsupportedLoops(graph_), (std::vector<FactorId>{wrong}));
}

// Neither what is measured again nor what is too far to compare takes the place of what bears a loop out.
TEST_F(Line, SupportIsFoundAmongMany) {
  for (int k = 0; k < 40; ++k) LinkTrue(19, 80);
  LinkTrue(18, 81);
  for (int k = 0; k < 40; ++k) LinkTrue(0, 99 - k % 2);
  EXPECT_TRUE(UnsupportedLoops(graph_).empty());
}

// Pose 105 came in by a link to pose 50: between it and pose 99 there is no odometry.
TEST_F(Line, NoOdometryNoSupport) {
  LinkTrue(4, 95);
  graph_.AddPose(PoseId{105});
  Link(50, 105, SE2({1.0, 0.0}, 0));
  const FactorId loop = Link(3, 105, Place(3).Inverse() * Place(50) * SE2({1.0, 0.0}, 0));
  const std::vector<FactorId> unsupported = UnsupportedLoops(graph_);
  EXPECT_EQ(std::count(unsupported.begin(), unsupported.end(), loop), 1);
}

template <class Pose>
void ExpectRandomOnesFound(Scene scene, int poses, std::uint64_t seed) {
  const auto [graph, truth] = testing::MakeScene<Pose>(scene, poses, seed);
  const auto loops = static_cast<double>(LoopFactors(graph).size());
  const auto with = AddWrongLoops(graph, truth, 100, seed, OutlierKind::kRandom);
  const std::vector<FactorId> unsupported = UnsupportedLoops(with.graph);
  double wrong = 0;
  for (const FactorId id : unsupported) wrong += std::count(with.wrong.begin(), with.wrong.end(), id) > 0;
  EXPECT_GT(wrong, 0.97 * static_cast<double>(with.wrong.size())) << "seed " << seed;
  EXPECT_LT(static_cast<double>(unsupported.size()) - wrong, 0.15 * loops) << "seed " << seed;
}

TEST(SupportedLoops, RandomWrongOnesHaveNone) {
  for (const std::uint64_t seed : testing::Seeds(601, 603)) {
    ExpectRandomOnesFound<SE2>(Scene::kManhattan, 1500, seed);
    ExpectRandomOnesFound<SE3>(Scene::kSphere, 900, seed);
  }
}

// Components of the graph of loops that are near at both ends, by comparing all with all.
TEST(LoopGroups, AreTheComponentsOfNearness) {
  for (const std::uint64_t seed : testing::Seeds(1, 5)) {
    testing::Random rng(seed);
    std::vector<std::pair<int, int>> places;
    for (int k = 0; k < 150; ++k) {
      const int first = static_cast<int>(rng() % 200);
      places.emplace_back(first, first + 2 + static_cast<int>(rng() % 200));
    }
    const auto are_near = [&](std::size_t a, std::size_t b) {
      return std::abs(places[a].first - places[b].first) <= 10 && std::abs(places[a].second - places[b].second) <= 10;
    };
    std::vector<std::size_t> group(places.size());
    for (std::size_t k = 0; k < group.size(); ++k) group[k] = k;
    for (bool changed = true; changed;) {  // the smallest index of the component reaches all of it
      changed = false;
      for (std::size_t a = 0; a < group.size(); ++a) {
        for (std::size_t b = 0; b < group.size(); ++b) {
          if (!are_near(a, b) || group[a] <= group[b]) continue;
          group[a] = group[b];
          changed = true;
        }
      }
    }
    const auto found = internal::GroupLoops(places);
    std::size_t loops = 0;
    for (const auto& members : found) {
      loops += members.size();
      EXPECT_TRUE(std::is_sorted(members.begin(), members.end()));
      for (const std::size_t k : members) EXPECT_EQ(group[k], group[members.front()]) << seed;
    }
    EXPECT_EQ(loops, places.size());
    EXPECT_EQ(found.size(), std::set<std::size_t>(group.begin(), group.end()).size()) << seed;
  }
}

}  // namespace
}  // namespace terse
