// What links are worth against dense matrices, and the choice of links against chance and brute force.

#include "terse/compact/link_choice.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <set>

#include "terse/compact/near_links.h"
#include "terse/core/batch_solver.h"
#include "terse/core/parallel.h"
#include "testing.h"

namespace terse {
namespace {

using internal::ChoiceOptions;
using internal::LinkChoice;
using internal::LinkSystem;
using internal::LinkWorth;
using testing::Random;

constexpr SparsifyCriterion kGreedy[] = {SparsifyCriterion::kPosition, SparsifyCriterion::kInformation};

template <class Pose>
struct ChoiceScene {
  PoseGraph<Pose> graph;
  std::vector<Pose> values;
  LinkSystem<Pose> system;
};

template <class Pose>
ChoiceScene<Pose> MakeScene(std::uint64_t seed, int poses, double loops_per_pose, bool priors = false,
                            FixedEdges fixed = FixedEdges::kOdometry) {
  Random rng(seed);
  testing::RandomGraphOptions options;
  options.poses = poses;
  options.loops_per_pose = loops_per_pose;
  options.priors = priors;
  ChoiceScene<Pose> scene;
  scene.graph = testing::MakeRandomGraph<Pose>(rng, options).graph;
  scene.values = SolveBatch(scene.graph).T_world_body;
  scene.system = internal::MakeLinkSystem(scene.graph, scene.values, fixed);
  return scene;
}

template <class Pose>
double Total(const LinkSystem<Pose>& system, SparsifyCriterion criterion, const std::vector<char>& kept) {
  return LinkWorth<Pose>(system, criterion, kept, false).Total();
}

// By what the total becomes without it, or with it.
template <class Pose>
double WorthByTotals(const LinkSystem<Pose>& system, SparsifyCriterion criterion, std::vector<char> kept, int link) {
  char& toggled = kept[static_cast<std::size_t>(link)];
  toggled = 0;
  const double without = Total(system, criterion, kept);
  toggled = 1;
  const double with = Total(system, criterion, kept);
  return criterion == SparsifyCriterion::kPosition ? without - with : (with - without) / 2;
}

std::vector<char> EveryOther(std::size_t links) {
  std::vector<char> kept(links);
  for (std::size_t k = 0; k < links; ++k) kept[k] = static_cast<char>(k % 2);
  return kept;
}

std::vector<int> All(std::size_t links) {
  std::vector<int> all(links);
  std::iota(all.begin(), all.end(), 0);
  return all;
}

template <class Pose>
class LinkChoiceTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(LinkChoiceTest, Groups);

// Few poses: the directions that are sampled are all there are, and nothing is left to chance.
TYPED_TEST(LinkChoiceTest, WorthIsWhatTheTotalLosesOrGains) {
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    for (const bool priors : {false, true}) {
      const auto scene = MakeScene<TypeParam>(seed, 10, 1.0, priors);
      const auto kept = EveryOther(scene.system.links.size());
      for (const auto criterion : kGreedy) {
        LinkWorth<TypeParam> worth(scene.system, criterion, kept, false);
        worth.Sample();
        worth.Evaluate(All(kept.size()));
        for (const int link : All(kept.size())) {
          const double expected = WorthByTotals(scene.system, criterion, kept, link);
          EXPECT_NEAR(worth.Worth(link), expected, 1e-6 * std::abs(expected) + 1e-9 * std::abs(worth.Total()))
              << "seed " << seed << ", link " << link << ", criterion " << static_cast<int>(criterion);
        }
      }
    }
  }
}

TYPED_TEST(LinkChoiceTest, WorthStaysTrueWhileLinksComeAndGo) {
  const auto scene = MakeScene<TypeParam>(5, 10, 1.5);
  const auto all = All(scene.system.links.size());
  for (const auto criterion : kGreedy) {
    LinkWorth<TypeParam> worth(scene.system, criterion, std::vector<char>(all.size(), 0), false);
    worth.Sample();
    worth.Evaluate(all);
    for (const int link : {1, 4, 7}) worth.Keep(link, all);
    for (const int link : all) {
      const double expected = WorthByTotals(scene.system, criterion, worth.Kept(), link);
      EXPECT_NEAR(worth.Worth(link), expected, 1e-6 * std::abs(expected) + 1e-9 * std::abs(worth.Total())) << link;
    }
    ASSERT_TRUE(worth.Drop(4));
    EXPECT_EQ(worth.KeptCount(), 2);
    EXPECT_FALSE(worth.IsFresh(0));
    std::vector<char> kept(all.size(), 0);
    kept[1] = kept[7] = 1;
    EXPECT_NEAR(worth.Total(), Total(scene.system, criterion, kept), 1e-9 * std::abs(worth.Total()));
  }
}

// By explicit covariances and a rigid motion's effect on the positions by differences.
TYPED_TEST(LinkChoiceTest, TotalIsTheExpectedErrorAfterAlignment) {
  constexpr int B = TypeParam::kDof, D = TypeParam::kDim;
  const auto scene = MakeScene<TypeParam>(6, 25, 0.6);
  const int n = scene.system.poses;
  const Eigen::MatrixXd Sigma = testing::Inverse(testing::MakeDenseSystem(scene.graph, scene.values).H);
  Eigen::MatrixXd E = Eigen::MatrixXd::Zero(D * n, B * n), G(D * n, B);
  for (int v = 0; v < n; ++v) {
    const TypeParam& T = scene.values[static_cast<std::size_t>(v)];
    for (int k = 0; k < B; ++k) {
      typename TypeParam::Tangent d = TypeParam::Tangent::Zero();
      d[k] = 1e-6;
      E.block(D * v, B * v + k, D, 1) = (T.Retract(d).Translation() - T.Retract(-d).Translation()) / 2e-6;
      const TypeParam there = TypeParam().Retract(d), back = TypeParam().Retract(-d);
      G.block(D * v, k, D, 1) = ((there * T).Translation() - (back * T).Translation()) / 2e-6;
    }
  }
  const Eigen::MatrixXd P =
      Eigen::MatrixXd::Identity(D * n, D * n) - G * testing::Solve(G.transpose() * G, G.transpose());
  const double expected = (P * E * Sigma * E.transpose() * P).trace();
  const std::vector<char> kept(scene.system.links.size(), 1);
  EXPECT_NEAR(Total(scene.system, SparsifyCriterion::kPosition, kept), expected, 1e-6 * expected);
}

TYPED_TEST(LinkChoiceTest, BeatsTheBestOfManyDraws) {
  for (const auto criterion : kGreedy) {
    const bool is_position = criterion == SparsifyCriterion::kPosition;
    for (std::uint64_t seed = 11; seed <= 13; ++seed) {
      const auto scene = MakeScene<TypeParam>(seed, 80, 1.0);
      ChoiceOptions options;
      options.links = 12;
      options.criterion = criterion;
      const LinkChoice choice = internal::ChooseLinks(scene.system, options);
      ASSERT_EQ(std::count(choice.kept.begin(), choice.kept.end(), 1), 12);
      EXPECT_EQ(choice.course.front().links, 0);
      EXPECT_EQ(choice.course.back().links, 12);
      const double chosen = Total(scene.system, criterion, choice.kept);
      EXPECT_NEAR(choice.course.back().total, chosen, 1e-8 * std::abs(chosen));
      options.criterion = SparsifyCriterion::kRandom;
      for (options.seed = 1; options.seed <= 20; ++options.seed) {
        const auto drawn = internal::ChooseLinks(scene.system, options).kept;
        ASSERT_EQ(std::count(drawn.begin(), drawn.end(), 1), 12);
        const double total = Total(scene.system, criterion, drawn);
        EXPECT_LT(is_position ? chosen : total, is_position ? total : chosen) << "seed " << seed;
      }
    }
  }
}

// Of all choices of three the greedy one with exchanges is the best or close to it.
TYPED_TEST(LinkChoiceTest, IsCloseToTheBestOfAllChoices) {
  double worst = 1;
  for (std::uint64_t seed = 21; seed <= 26; ++seed) {
    const auto scene = MakeScene<TypeParam>(seed, 10, 1.0);
    const int links = static_cast<int>(scene.system.links.size());
    ASSERT_GE(links, 6);
    double best = std::numeric_limits<double>::infinity();
    for (int code = 0; code < 1 << links; ++code) {
      std::vector<char> kept(static_cast<std::size_t>(links));
      for (int k = 0; k < links; ++k) kept[static_cast<std::size_t>(k)] = static_cast<char>(code >> k & 1);
      if (std::count(kept.begin(), kept.end(), 1) != 3) continue;
      best = std::min(best, Total(scene.system, SparsifyCriterion::kPosition, kept));
    }
    ChoiceOptions options;
    options.links = 3;
    worst = std::max(worst, internal::ChooseLinks(scene.system, options).course.back().total / best);
  }
  EXPECT_LT(worst, 1.2);
}

// With the worth of all links kept up to date at every choice, which the choice itself does for the first ones only.
template <class Pose>
std::vector<char> ChooseExactly(const LinkSystem<Pose>& system, SparsifyCriterion criterion, int links) {
  LinkWorth<Pose> worth(system, criterion, system.in_tree, false);
  const auto all = All(system.links.size());
  for (int k = 0; k < links; ++k) {
    if (k % 64 == 0) {
      worth.Refresh();
      worth.Sample();
      worth.Evaluate(all);
    }
    int best = -1;
    for (const int link : all) {
      if (worth.Kept()[static_cast<std::size_t>(link)]) continue;
      if (best < 0 || worth.Worth(link) > worth.Worth(best)) best = link;
    }
    worth.Keep(best, all);
  }
  return worth.Kept();
}

TYPED_TEST(LinkChoiceTest, RoundsBySamplesAreAsGoodAsExactOnes) {
  const int poses = kSlowBuild ? 50 : 400, links = kSlowBuild ? 30 : 350;  // beyond those that are chosen exactly
  const auto scene = MakeScene<TypeParam>(32, poses, 1.5);
  for (const auto criterion : kGreedy) {
    ChoiceOptions options;
    options.links = links;
    options.criterion = criterion;
    const LinkChoice choice = internal::ChooseLinks(scene.system, options);
    ASSERT_EQ(std::count(choice.kept.begin(), choice.kept.end(), 1), links);
    const double chosen = Total(scene.system, criterion, choice.kept);
    const double exact = Total(scene.system, criterion, ChooseExactly(scene.system, criterion, links));
    const double none = Total(scene.system, criterion, scene.system.in_tree);
    if (criterion == SparsifyCriterion::kPosition) {
      EXPECT_LT(chosen, 1.03 * exact);
    } else {
      EXPECT_GT(chosen - none, 0.99 * (exact - none));
    }
  }
}

// Of 32 samples most of what two links seem to have in common is noise.
TYPED_TEST(LinkChoiceTest, KeepingBySamplesDoesNotInventWhatLinksHaveInCommon) {
  const auto scene = MakeScene<TypeParam>(34, 150, 1.5);
  const auto all = All(scene.system.links.size());
  const auto kept = EveryOther(all.size());
  std::vector<int> first, others;
  for (const int link : all) {
    if (!kept[static_cast<std::size_t>(link)]) (link % 8 == 0 ? first : others).push_back(link);
  }
  for (const auto criterion : kGreedy) {
    LinkWorth<TypeParam> worth(scene.system, criterion, kept, false);
    worth.Sample();
    for (const int link : first) worth.KeepBySamples(link, others);
    double by_samples = 0, exact = 0;
    for (const int link : others) by_samples += worth.Worth(link);
    worth.Refresh();
    worth.Sample();
    worth.Evaluate(others);
    for (const int link : others) exact += worth.Worth(link);
    if (criterion == SparsifyCriterion::kPosition) {
      EXPECT_GT(by_samples / exact, 0.8);
      EXPECT_LT(by_samples / exact, 2.2);
    } else {
      EXPECT_NEAR(by_samples / exact, 1, 0.2);
    }
  }
}

TYPED_TEST(LinkChoiceTest, KeepingBySamplesTakesItsWorthFromALinkThatSaysTheSame) {
  auto scene = MakeScene<TypeParam>(35, 60, 1.0);
  auto& system = scene.system;
  const int links = static_cast<int>(system.links.size());
  for (const int link : All(system.links.size())) {
    system.links.push_back(system.links[static_cast<std::size_t>(link)]);
    system.in_tree.push_back(0);
  }
  std::vector<char> kept = EveryOther(system.links.size());
  std::fill(kept.begin() + links, kept.end(), static_cast<char>(0));
  for (const auto criterion : kGreedy) {
    double exact = 0, by_samples = 0, before = 0;
    for (int link = 0; link < links; link += 2) {
      const int twin = link + links;
      LinkWorth<TypeParam> sampled(system, criterion, kept, false), evaluated(system, criterion, kept, false);
      sampled.Sample();
      before += sampled.Worth(twin);
      sampled.KeepBySamples(link, {twin});
      by_samples += sampled.Worth(twin);
      evaluated.Sample();
      evaluated.Evaluate({link, twin});
      evaluated.Keep(link, {twin});
      exact += evaluated.Worth(twin);
    }
    EXPECT_LT(by_samples, 0.6 * before) << exact;
    EXPECT_GT(by_samples, 0.5 * exact);
    EXPECT_LT(by_samples, 2 * exact);
  }
}

TYPED_TEST(LinkChoiceTest, NearLinksAreThoseOfTheNearestPoses) {
  const auto scene = MakeScene<TypeParam>(33, 60, 1.0);
  const auto& system = scene.system;
  const auto kept = EveryOther(system.links.size());
  std::vector<std::vector<int>> joined(static_cast<std::size_t>(system.poses));
  const auto join = [&](const auto& f) {
    if (f.second < 0) return;
    joined[static_cast<std::size_t>(f.first)].push_back(f.second);
    joined[static_cast<std::size_t>(f.second)].push_back(f.first);
  };
  for (const auto& f : system.fixed) join(f);
  for (std::size_t k = 0; k < kept.size(); ++k) {
    if (kept[k]) join(system.links[k]);
  }
  internal::NearLinks near(system, kept);
  for (const int link : All(kept.size())) {
    // The poses within one edge of the ends are the first ones whatever the order among them.
    const auto& f = system.links[static_cast<std::size_t>(link)];
    std::set<int> within{f.first, f.second};
    for (const int end : {f.first, f.second}) {
      for (const int pose : joined[static_cast<std::size_t>(end)]) within.insert(pose);
    }
    std::vector<int> expected;
    for (const int other : All(kept.size())) {
      const auto& g = system.links[static_cast<std::size_t>(other)];
      const bool is_near = within.count(g.first) + within.count(g.second) > 0;
      if (other != link && !kept[static_cast<std::size_t>(other)] && is_near) expected.push_back(other);
    }
    std::vector<int> found = near.Of(link, static_cast<int>(within.size()));
    std::sort(found.begin(), found.end());
    EXPECT_EQ(found, expected) << link;
  }
}

// Where all links are at one pose, looking at all of them for each of them would be quadratic.
TEST(LinkChoice, AHubIsNotLookedThroughForEachOfItsLinks) {
  LinkSystem<SE2> system;
  system.poses = 5000;
  LinearFactor<3> f;
  for (int v = 1; v < system.poses; ++v) {
    f.first = v - 1, f.second = v;
    system.fixed.push_back(f);
    f.first = 0;
    system.links.push_back(f);
  }
  internal::NearLinks near(system, std::vector<char>(system.links.size(), 0));
  for (const int link : {0, 17, 4998}) {
    EXPECT_GE(near.Of(link, 8).size(), 8u);
    EXPECT_LE(near.Of(link, 8).size(), 8u * 16);
  }
}

TYPED_TEST(LinkChoiceTest, ThreadsDoNotChangeIt) {
  const auto scene = MakeScene<TypeParam>(31, kSlowBuild ? 100 : 300, 1.2);
  for (const auto criterion : kGreedy) {
    ChoiceOptions options;
    options.links = kSlowBuild ? 20 : 280;  // beyond those that are chosen exactly
    options.criterion = criterion;
    const LinkChoice one = internal::ChooseLinks(scene.system, options);
    options.parallel = true;
    LinkChoice two;
    internal::WithThreads(2, [&] { two = internal::ChooseLinks(scene.system, options); });
    EXPECT_EQ(one.kept, two.kept);
    EXPECT_EQ(one.worth, two.worth);
  }
}

TYPED_TEST(LinkChoiceTest, HoldsEveryPoseWithNothingFixed) {
  for (const auto criterion : kGreedy) {
    const auto scene = MakeScene<TypeParam>(41, 60, 1.0, false, FixedEdges::kNone);
    ChoiceOptions options;
    options.links = 10;
    options.criterion = criterion;
    const LinkChoice choice = internal::ChooseLinks(scene.system, options);
    EXPECT_EQ(std::count(choice.kept.begin(), choice.kept.end(), 1), 59 + 10);
    PoseGraph<TypeParam> graph = scene.graph;
    for (std::size_t k = 0; k < choice.kept.size(); ++k) {
      if (!choice.kept[k]) graph.RemoveFactor(scene.system.ids[k]);
    }
    EXPECT_EQ(ConnectedComponents(graph).size(), 1u);
  }
}

TYPED_TEST(LinkChoiceTest, EndsWhereTheErrorIsSmallEnough) {
  const auto scene = MakeScene<TypeParam>(51, 80, 1.0);
  const double whole = TotalsOf(scene.system, std::vector<char>(scene.system.links.size(), 1)).position;
  ChoiceOptions options;
  options.most_total = 1.2 * whole;
  const LinkChoice choice = internal::ChooseLinks(scene.system, options);
  const auto count = static_cast<int>(std::count(choice.kept.begin(), choice.kept.end(), 1));
  EXPECT_LE(Total(scene.system, SparsifyCriterion::kPosition, choice.kept), 1.2 * whole);
  EXPECT_LT(count, static_cast<int>(scene.system.links.size()));
  options.most_total.reset();
  options.links = count - 2;
  EXPECT_GT(internal::ChooseLinks(scene.system, options).course.back().total, 1.2 * whole);
}

TYPED_TEST(LinkChoiceTest, GivesUpWhenAsked) {
  const auto scene = MakeScene<TypeParam>(61, 40, 1.0);
  ChoiceOptions options;
  options.links = 10;
  options.progress = [](double share) { return share < 0.5; };
  EXPECT_THROW(internal::ChooseLinks(scene.system, options), internal::ChoiceStopped);
}

}  // namespace
}  // namespace terse
