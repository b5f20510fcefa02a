// Edges chosen by algebraic connectivity, against dense eigenvalues and all subsets.

#include "terse/compact/connectivity.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "terse/core/at.h"
#include "terse/core/random.h"

namespace terse::internal {
namespace {

using Eigen::MatrixXd, Eigen::VectorXd;
using Edges = std::vector<WeightedEdge>;

const double kPi = std::acos(-1.0);

MatrixXd Laplacian(int nodes, const Edges& edges) {
  MatrixXd L = MatrixXd::Zero(nodes, nodes);
  for (const WeightedEdge& edge : edges) {
    L(edge.a, edge.a) += edge.weight;
    L(edge.b, edge.b) += edge.weight;
    L(edge.a, edge.b) -= edge.weight;
    L(edge.b, edge.a) -= edge.weight;
  }
  return L;
}

Edges Chain(int nodes, double weight = 1) {
  Edges edges;
  for (int i = 0; i + 1 < nodes; ++i) edges.push_back({i, i + 1, weight});
  return edges;
}

Edges Join(Edges edges, const Edges& others) {
  edges.insert(edges.end(), others.begin(), others.end());
  return edges;
}

int Draw(Random& random, int count) { return static_cast<int>(random.Uniform() * count); }

Edges RandomEdges(int nodes, int count, Random& random) {
  Edges edges;
  while (static_cast<int>(edges.size()) < count) {
    const int a = Draw(random, nodes), b = Draw(random, nodes);
    if (a != b) edges.push_back({a, b, 0.2 + random.Uniform()});
  }
  return edges;
}

// Between neighbouring rows of a chain that goes to and fro over a square, as loops of a robot's run are.
Edges BetweenRows(int side, int count, Random& random) {
  Edges edges;
  for (int k = 0; k < count; ++k) {
    const int row = Draw(random, side - 1), column = Draw(random, side);
    edges.push_back({row * side + column, (row + 2) * side - 1 - column, 0.5 + random.Uniform()});
  }
  return edges;
}

Edges Chosen(const Edges& fixed, const Edges& candidates, const std::vector<char>& chosen) {
  Edges edges = fixed;
  for (std::size_t e = 0; e < chosen.size(); ++e) {
    if (chosen[e]) edges.push_back(candidates[e]);
  }
  return edges;
}

// Of k candidates drawn at random.
double FiedlerOfRandom(int nodes, const Edges& fixed, const Edges& candidates, int k, Random& random) {
  std::vector<char> chosen(candidates.size(), 0);
  for (int count = 0; count < k;) {
    char& one = chosen[At(Draw(random, static_cast<int>(candidates.size())))];
    count += one ? 0 : 1;
    one = 1;
  }
  return FindFiedlerPair(nodes, Chosen(fixed, candidates, chosen)).value;
}

void ExpectPair(int nodes, const Edges& edges, const FiedlerPair& pair) {
  const MatrixXd L = Laplacian(nodes, edges);
  const VectorXd values = Eigen::SelfAdjointEigenSolver<MatrixXd>(L).eigenvalues();
  const double largest = values(nodes - 1);
  EXPECT_NEAR(pair.value, values(1), 1e-9 * values(1) + 1e-13 * largest);
  EXPECT_NEAR(pair.vector.norm(), 1, 1e-12);
  EXPECT_NEAR(pair.vector.sum(), 0, 1e-10);
  EXPECT_LE((L * pair.vector - pair.value * pair.vector).norm(), 1e-5 * pair.value + 1e-13 * largest);
}

TEST(FiedlerPairTest, EqualsDenseEigenvaluesOfRandomGraphs) {
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    SCOPED_TRACE(seed);
    Random random(seed);
    const int nodes = seed <= 10 ? 1 + static_cast<int>(seed) : 20 + Draw(random, 130);
    if (nodes == 1) continue;
    Edges edges = Join(Chain(nodes), RandomEdges(nodes, Draw(random, 3 * nodes), random));
    if (seed % 2 == 0) {
      for (WeightedEdge& edge : edges) edge.weight *= std::pow(10, 4 * random.Uniform());
    }
    ExpectPair(nodes, edges, FindFiedlerPair(nodes, edges));
  }
}

TEST(FiedlerPairTest, IsAsWrittenForLongChains) {
  for (const int nodes : {2, 3, 100, 15000}) {
    const FiedlerPair pair = FindFiedlerPair(nodes, Chain(nodes, 3));
    const double expected = 12 * std::pow(std::sin(kPi / (2 * nodes)), 2);
    EXPECT_NEAR(pair.value, expected, 1e-10 * expected) << nodes;
    for (int i = 0; i < nodes; i += 1 + nodes / 7) {
      EXPECT_NEAR(pair.vector(i), std::sqrt(2.0 / nodes) * std::cos(kPi * (i + 0.5) / nodes), 1e-7) << nodes;
    }
  }
}

TEST(FiedlerPairTest, FindsTheWeakBridge) {
  Random random(7);
  for (const double bridge : {1e-2, 1e-6, 1e-10}) {
    Edges edges = Join(Chain(40), RandomEdges(40, 120, random));
    for (WeightedEdge edge : Join(Chain(50), RandomEdges(50, 150, random))) {
      edges.push_back({edge.a + 40, edge.b + 40, edge.weight});
    }
    edges.push_back({3, 70, bridge});
    const FiedlerPair pair = FindFiedlerPair(90, edges);
    ExpectPair(90, edges, pair);
    for (int i = 0; i < 90; ++i) EXPECT_EQ(pair.vector(i) > 0, i < 40);
    if (bridge < 1e-5) {  // nearly the cut's quotient, which bounds it
      const double cut = bridge * (1 / 40.0 + 1 / 50.0);
      EXPECT_LE(pair.value, cut * (1 + 1e-12));
      EXPECT_GE(pair.value, cut * (1 - 10 * bridge));
    }
  }
}

TEST(FiedlerPairTest, IsOneOfTheEigenspaceIfTheValueIsDouble) {
  for (const int nodes : {3, 8, 97, 4000}) {
    const Edges ring = Join(Chain(nodes), {{nodes - 1, 0, 1.0}});
    const FiedlerPair pair = FindFiedlerPair(nodes, ring);
    const double expected = 4 * std::pow(std::sin(kPi / nodes), 2);
    EXPECT_NEAR(pair.value, expected, 1e-10 * expected);
    if (nodes < 100) ExpectPair(nodes, ring, pair);
  }
}

// A random graph of that size has too dense a factor, and gets that of a part.
TEST(FiedlerPairTest, HoldsForRandomGraphsWithDenseFactors) {
  Random random(3);
  const int nodes = 3000;
  const Edges edges = Join(Chain(nodes), RandomEdges(nodes, 9000, random));
  const FiedlerPair pair = FindFiedlerPair(nodes, edges);
  VectorXd residual = -pair.value * pair.vector;
  for (const WeightedEdge& edge : edges) {
    const double flow = edge.weight * (pair.vector(edge.a) - pair.vector(edge.b));
    residual(edge.a) += flow;
    residual(edge.b) -= flow;
  }
  EXPECT_LE(residual.norm(), 1e-4 * pair.value);
  // Nothing is smaller: a start elsewhere ends there as well.
  const MatrixXd start = MatrixXd::NullaryExpr(nodes, 5, [&] { return random.Normal(); });
  EXPECT_NEAR(FindFiedlerPair(nodes, edges, &start).value, pair.value, 1e-8 * pair.value);
}

TEST(FiedlerPairTest, StartsFromVectorsOfAnyKind) {
  Random random(5);
  const Edges edges = Join(Chain(120), RandomEdges(120, 60, random));
  const FiedlerPair pair = FindFiedlerPair(120, edges);
  const MatrixXd eigenvectors = Eigen::SelfAdjointEigenSolver<MatrixXd>(Laplacian(120, edges)).eigenvectors();
  for (const MatrixXd& start :
       {MatrixXd(pair.vector), MatrixXd(MatrixXd::Ones(120, 2)), MatrixXd(120, 0), eigenvectors,
        MatrixXd(eigenvectors.rightCols(3)), MatrixXd(eigenvectors.col(2)), MatrixXd(eigenvectors.middleCols(2, 6))}) {
    const FiedlerPair again = FindFiedlerPair(120, edges, &start);
    EXPECT_NEAR(again.value, pair.value, 1e-9 * pair.value);
    EXPECT_LE((again.vector - pair.vector).norm(), 1e-4);
  }
}

TEST(FiedlerPairTest, IsZeroIfNotConnected) {
  const FiedlerPair pair = FindFiedlerPair(4, {{0, 2, 1.0}, {1, 3, 2.0}});
  EXPECT_EQ(pair.value, 0);
  EXPECT_LE((pair.vector - Eigen::Vector4d(0.5, -0.5, 0.5, -0.5)).norm(), 1e-15);
  EXPECT_EQ(FindFiedlerPair(2, {}).value, 0);
  const FiedlerPair single = FindFiedlerPair(1, {});
  EXPECT_EQ(single.value, 0);
  EXPECT_EQ(single.vector.size(), 1);
}

TEST(ConnectivityTest, BoundsTheBestOfAllSubsets) {
  double nearest_share = 0, best_share = 0;
  constexpr int kSeeds = 12;
  for (std::uint64_t seed = 1; seed <= kSeeds; ++seed) {
    SCOPED_TRACE(seed);
    Random random(seed);
    const int nodes = 6 + Draw(random, 10), m = 8 + Draw(random, 3), k = 1 + Draw(random, m - 1);
    const Edges fixed = Chain(nodes);
    Edges candidates = RandomEdges(nodes, m, random);
    if (seed % 3 == 0) candidates[1] = candidates[0];
    double best = 0;
    for (unsigned set = 0; set < 1u << m; ++set) {
      std::vector<char> chosen;
      for (int e = 0; e < m; ++e) chosen.push_back((set >> e & 1u) != 0 ? 1 : 0);
      if (std::accumulate(chosen.begin(), chosen.end(), 0) != k) continue;
      const MatrixXd L = Laplacian(nodes, Chosen(fixed, candidates, chosen));
      best = std::max(best, Eigen::SelfAdjointEigenSolver<MatrixXd>(L, Eigen::EigenvaluesOnly).eigenvalues()(1));
    }
    double highest = 0;
    for (const Rounding rounding : {Rounding::kNearest, Rounding::kMadow, Rounding::kBest}) {
      const ConnectivityChoice choice = ChooseByConnectivity(nodes, fixed, candidates, k, rounding, seed);
      EXPECT_EQ(std::accumulate(choice.chosen.begin(), choice.chosen.end(), 0), k);
      EXPECT_GE(choice.upper_bound, best * (1 - 1e-9));
      EXPECT_LE(choice.fiedler, best * (1 + 1e-9));
      const VectorXd values =
          Eigen::SelfAdjointEigenSolver<MatrixXd>(Laplacian(nodes, Chosen(fixed, candidates, choice.chosen)))
              .eigenvalues();
      EXPECT_NEAR(choice.fiedler, values(1), 1e-9 * values(1));
      if (rounding == Rounding::kNearest) nearest_share += choice.fiedler / best / kSeeds;
      if (rounding == Rounding::kBest) {
        EXPECT_NEAR(choice.fiedler, highest, 1e-11 * highest);
        best_share += choice.fiedler / best / kSeeds;
      }
      highest = std::max(highest, choice.fiedler);
    }
  }
  std::printf("of the best choice: nearest %.3f, best rounding %.3f\n", nearest_share, best_share);
  EXPECT_GE(best_share, 0.85);
}

TEST(ConnectivityTest, IsBetterThanChance) {
  constexpr int kSide = 10, kNodes = kSide * kSide, kCandidates = 80, kChosen = 16, kSeeds = 20;
  int wins = 0;
  double nearest = 0, mean = 0;
  for (std::uint64_t seed = 1; seed <= kSeeds; ++seed) {
    Random random(seed);
    const Edges fixed = Chain(kNodes), candidates = BetweenRows(kSide, kCandidates, random);
    const double value = ChooseByConnectivity(kNodes, fixed, candidates, kChosen, Rounding::kNearest).fiedler;
    double chance = 0;
    for (int draw = 0; draw < 10; ++draw) chance += FiedlerOfRandom(kNodes, fixed, candidates, kChosen, random) / 10;
    wins += value > chance ? 1 : 0;
    nearest += value / kSeeds;
    mean += chance / kSeeds;
  }
  std::printf("nearest %.3e, random subsets %.3e, better for %d of %d\n", nearest, mean, wins, kSeeds);
  EXPECT_GE(nearest, 1.5 * mean);
  EXPECT_GE(wins, 15);
}

// Over many seeds what is chosen differs, and always is so many.
TEST(ConnectivityTest, SamplesExactlySoMany) {
  Random random(2);
  const Edges fixed = Chain(64), candidates = BetweenRows(8, 50, random);
  for (const int k : {1, 7, 25}) {
    std::vector<int> often(candidates.size(), 0);
    double bound = 0;
    for (std::uint64_t seed = 1; seed <= 40; ++seed) {
      const ConnectivityChoice choice = ChooseByConnectivity(64, fixed, candidates, k, Rounding::kMadow, seed);
      EXPECT_EQ(std::accumulate(choice.chosen.begin(), choice.chosen.end(), 0), k);
      EXPECT_GE(choice.upper_bound, choice.fiedler);
      if (seed == 1) bound = choice.upper_bound;
      EXPECT_EQ(choice.upper_bound, bound);  // the seed is that of the rounding alone
      for (std::size_t e = 0; e < often.size(); ++e) often[e] += choice.chosen[e];
    }
    EXPECT_TRUE(std::any_of(often.begin(), often.end(), [](int n) { return n != 0 && n != 40; })) << k;
  }
}

TEST(ConnectivityTest, RepeatsBitByBitAndInTies) {
  Edges ring = Join(Chain(48), {{47, 0, 1.0}}), chords;
  for (int i = 0; i < 24; ++i) chords.push_back({i, i + 24, 1.0});
  for (const Rounding rounding : {Rounding::kNearest, Rounding::kMadow, Rounding::kBest}) {
    const ConnectivityChoice one = ChooseByConnectivity(48, ring, chords, 6, rounding, 9);
    const ConnectivityChoice two = ChooseByConnectivity(48, ring, chords, 6, rounding, 9);
    EXPECT_EQ(one.chosen, two.chosen);
    EXPECT_EQ(one.fiedler, two.fiedler);
    EXPECT_EQ(one.upper_bound, two.upper_bound);
    EXPECT_EQ(one.iterations, two.iterations);
    EXPECT_LE(one.iterations, 20);
  }
  // Parallel ones are as good as each other; the first ones are taken.
  const ConnectivityChoice choice =
      ChooseByConnectivity(20, Chain(20), Edges(5, WeightedEdge{0, 19, 1.0}), 2, Rounding::kNearest);
  EXPECT_EQ(choice.chosen, (std::vector<char>{1, 1, 0, 0, 0}));
  EXPECT_NEAR(choice.upper_bound, choice.fiedler, 1e-3 * choice.fiedler);
}

TEST(ConnectivityTest, TakesNoneOrAll) {
  Random random(4);
  const Edges fixed = Chain(30), candidates = RandomEdges(30, 9, random);
  const ConnectivityChoice none = ChooseByConnectivity(30, fixed, candidates, 0, Rounding::kBest);
  EXPECT_EQ(none.chosen, std::vector<char>(9, 0));
  EXPECT_EQ(none.fiedler, FindFiedlerPair(30, fixed).value);
  EXPECT_EQ(none.upper_bound, none.fiedler);
  const ConnectivityChoice all = ChooseByConnectivity(30, fixed, candidates, 9, Rounding::kBest);
  EXPECT_EQ(all.chosen, std::vector<char>(9, 1));
  EXPECT_EQ(all.fiedler, FindFiedlerPair(30, Join(fixed, candidates)).value);
  EXPECT_EQ(all.iterations, 0);
  EXPECT_EQ(ChooseByConnectivity(1, {}, {}, 0, Rounding::kBest).fiedler, 0);
  EXPECT_EQ(ChooseByConnectivity(2, Chain(2), {{1, 0, 1.0}, {0, 1, 5.0}}, 1, Rounding::kNearest).chosen,
            (std::vector<char>{0, 1}));
}

TEST(ConnectivityTest, RefusesWhatIsNoGraph) {
  const Edges candidates{{0, 2, 1.0}};
  const auto choose = [&](int nodes, const Edges& fixed, const Edges& others, int k) {
    return ChooseByConnectivity(nodes, fixed, others, k, Rounding::kNearest);
  };
  EXPECT_THROW(choose(4, Chain(3), candidates, 1), std::invalid_argument);
  EXPECT_THROW(choose(3, Chain(2), candidates, 1), std::invalid_argument);  // candidates do not count
  EXPECT_THROW(choose(3, Chain(3), candidates, 2), std::invalid_argument);
  EXPECT_THROW(choose(3, Chain(3), candidates, -1), std::invalid_argument);
  EXPECT_THROW(choose(0, {}, {}, 0), std::invalid_argument);
  EXPECT_THROW(choose(3, Chain(3), {{0, 3, 1.0}}, 1), std::invalid_argument);
  EXPECT_THROW(choose(3, Chain(3), {{-1, 2, 1.0}}, 1), std::invalid_argument);
  EXPECT_THROW(choose(3, Chain(3), {{1, 1, 1.0}}, 1), std::invalid_argument);
  for (const double weight : {0.0, -1.0, std::nan(""), std::numeric_limits<double>::infinity()}) {
    EXPECT_THROW(choose(3, Chain(3), {{0, 2, weight}}, 1), std::invalid_argument);
    EXPECT_THROW(FindFiedlerPair(3, Chain(3, weight)), std::invalid_argument);
  }
  const MatrixXd start = MatrixXd::Ones(2, 1);
  EXPECT_THROW(FindFiedlerPair(3, Chain(3), &start), std::invalid_argument);
}

}  // namespace
}  // namespace terse::internal
