// Poses that are eliminated, against dense marginalisation.

#include "terse/compact/pose_elimination.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "terse/compact/marginal_divergence.h"
#include "terse/compact/pose_removal.h"
#include "terse/core/batch_solver.h"
#include "terse/core/pose_values.h"
#include "testing.h"

namespace terse {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using internal::EliminatePoses;
using internal::Elimination;
using internal::EliminationOptions;
using testing::Random;

constexpr RecoveredFactors kEvery[] = {RecoveredFactors::kTree, RecoveredFactors::kSubgraph, RecoveredFactors::kDense};

template <class Pose>
std::vector<PoseId> IdsOf(const PoseGraph<Pose>& graph) {
  std::vector<PoseId> ids;
  for (const auto& node : graph.Poses()) ids.push_back(node.id);
  return ids;
}

// A random graph at its optimum.
template <class Pose>
PoseGraph<Pose> Solved(std::uint64_t seed, testing::RandomGraphOptions options) {
  Random rng(seed);
  PoseGraph<Pose> graph = testing::MakeRandomGraph<Pose>(rng, options).graph;
  // To rounding: one run ends when chi2 falls no more.
  for (int again = 0; again < 3; ++again) graph.SetPoses(SolveBatch(graph, internal::ValuesOf(graph)).T_world_body);
  return graph;
}

template <class Pose>
PoseGraph<Pose> CliqueScene(std::uint64_t seed, double loops_per_pose = 1.2, int poses = 16) {
  testing::RandomGraphOptions options;
  options.poses = poses;
  options.loops_per_pose = loops_per_pose;
  options.noise = 0.005;
  options.id_stride = 3;
  return Solved<Pose>(seed, options);
}

// Normal equations of the displacements about the values, the first pose held.
struct Held {
  MatrixXd H;
  VectorXd b;
};

template <class Pose>
Held HeldSystem(const PoseGraph<Pose>& graph) {
  constexpr int B = Pose::kDof;
  const auto system = testing::MakeDenseSystem(graph, internal::ValuesOf(graph));
  const Eigen::Index n = system.H.rows() - B;
  return {system.H.bottomRightCorner(n, n), system.b.tail(n)};
}

// The exact marginal of the kept poses, the first of which is the graph's first.
template <class Pose>
Held Marginal(const PoseGraph<Pose>& graph, const std::vector<PoseId>& kept) {
  constexpr int B = Pose::kDof;
  const Held all = HeldSystem(graph);
  const Eigen::Index n = all.H.rows(), m = B * (static_cast<Eigen::Index>(kept.size()) - 1);
  MatrixXd pick = MatrixXd::Zero(n, n);
  Eigen::Index first = 0, second = m;
  for (std::size_t k = 1; k < graph.Poses().size(); ++k) {
    const bool is_kept = std::find(kept.begin(), kept.end(), graph.Poses()[k].id) != kept.end();
    Eigen::Index& at = is_kept ? first : second;
    pick.block<B, B>(at, B * static_cast<Eigen::Index>(k - 1)).setIdentity();
    at += B;
  }
  const MatrixXd H = pick * all.H * pick.transpose();
  const VectorXd b = pick * all.b;
  if (m == n) return {H, b};
  const MatrixXd gain = testing::Solve(H.bottomRightCorner(n - m, n - m), H.bottomLeftCorner(n - m, m));
  return {H.topLeftCorner(m, m) - H.topRightCorner(m, n - m) * gain, b.head(m) - gain.transpose() * b.tail(n - m)};
}

// nats, of the information matrices.
double Divergence(const MatrixXd& exact, const MatrixXd& recovered) {
  const VectorXd share = testing::Eigenvalues(recovered, exact);
  return (share.array() - 1 - share.array().log()).sum() / 2;
}

// Elimination of this pose alone.
template <class Pose>
Elimination<Pose> EliminateOne(const PoseGraph<Pose>& graph, PoseId pose, EliminationOptions options) {
  options.stay = IdsOf(graph);
  options.stay.erase(std::find(options.stay.begin(), options.stay.end(), pose));
  return EliminatePoses(graph, options);
}

template <class Pose>
std::set<PoseId> NeighboursOf(const PoseGraph<Pose>& graph, PoseId pose) {
  std::set<PoseId> neighbours;
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    if (ends.count == 2 && ends.first == pose) neighbours.insert(ends.second);
    if (ends.count == 2 && ends.second == pose) neighbours.insert(ends.first);
  }
  return neighbours;
}

// The pose with the most neighbours, 3 to 8, of those that may go.
template <class Pose>
PoseId Busiest(const PoseGraph<Pose>& graph) {
  PoseId best = graph.Poses()[1].id;
  std::size_t most = 0;
  for (std::size_t k = 1; k + 1 < graph.Poses().size(); ++k) {
    const PoseId id = graph.Poses()[k].id;
    const std::size_t neighbours = NeighboursOf(graph, id).size();
    if (neighbours > most && neighbours <= 8) {
      most = neighbours;
      best = id;
    }
  }
  EXPECT_GE(most, 3u);
  return best;
}

// The factors among these alone.
template <class Pose>
PoseGraph<Pose> Among(const PoseGraph<Pose>& graph, const std::set<PoseId>& poses) {
  PoseGraph<Pose> out;
  for (const auto& node : graph.Poses()) {
    if (poses.count(node.id) != 0) out.AddPose(node.id, node.T_world_body);
  }
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    if (out.HasPose(ends.first) && out.HasPose(ends.second)) out.AddFactor(node.factor);
  }
  return out;
}

// What Chow and Liu make of the pose's own factors, and the others as they are.
template <class Pose>
PoseGraph<Pose> PlainChowLiu(const PoseGraph<Pose>& graph, PoseId pose) {
  const std::set<PoseId> set = NeighboursOf(graph, pose);
  const std::vector<PoseId> neighbours(set.begin(), set.end());
  const auto value = [&](PoseId id) {
    return *graph.Poses()[static_cast<std::size_t>(graph.IndexOf(id))].T_world_body;
  };
  std::vector<internal::Arm<Pose>> arms;
  for (const PoseId id : neighbours) arms.emplace_back(value(pose).Inverse() * value(id));
  PoseGraph<Pose> out;
  for (const auto& node : graph.Poses()) {
    if (node.id != pose) out.AddPose(node.id, node.T_world_body);
  }
  for (const auto& node : graph.Factors()) {
    const auto& factor = std::get<RelativePoseFactor<Pose>>(node.factor);
    if (factor.from != pose && factor.to != pose) {
      out.AddFactor(factor);
      continue;
    }
    const PoseId other = factor.from == pose ? factor.to : factor.from;
    const auto at = std::find(neighbours.begin(), neighbours.end(), other) - neighbours.begin();
    arms[static_cast<std::size_t>(at)].Add(pose, factor);
  }
  const auto tree = internal::RecoverTree(arms, std::nullopt);
  for (const auto& f : tree.value().factors) {
    out.AddFactor(RelativePoseFactor<Pose>{neighbours[static_cast<std::size_t>(f.i)],
                                           neighbours[static_cast<std::size_t>(f.j)], f.T_i_j,
                                           tree->scale * f.information});
  }
  return out;
}

template <class Pose>
class PoseEliminationTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(PoseEliminationTest, Groups);

// Long stretches between few loops.
TYPED_TEST(PoseEliminationTest, LosesNothingBetweenTwoNeighbours) {
  using Pose = TypeParam;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    SCOPED_TRACE(seed);
    const PoseGraph<Pose> graph = CliqueScene<Pose>(seed, 0.2, 24);
    EliminationOptions options;
    options.most_neighbours = 2;
    const Elimination<Pose> out = EliminatePoses(graph, options);
    ASSERT_GT(out.eliminated.size(), 8u);
    EXPECT_EQ(out.loss, 0);
    for (const auto& pose : out.eliminated) {
      EXPECT_EQ(pose.loss, 0);
      EXPECT_LE(pose.neighbours.size(), 2u);
    }
    const Held exact = Marginal(graph, IdsOf(out.graph)), now = HeldSystem(out.graph);
    EXPECT_LT(testing::RelativeError(now.H, exact.H), 1e-8);
    EXPECT_LT(testing::Solve(now.H, now.b).norm(), 1e-8);
  }
}

TYPED_TEST(PoseEliminationTest, KeepsTheOptimumAndStatesTheLoss) {
  using Pose = TypeParam;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    const PoseGraph<Pose> graph = CliqueScene<Pose>(seed);
    const PoseId pose = Busiest(graph);
    std::set<PoseId> neighbours = NeighboursOf(graph, pose), clique = neighbours;
    clique.insert(pose);
    // The held pose is one of those that stay.
    const PoseGraph<Pose> before = Among(graph, clique);
    if (before.Poses().front().id == pose) continue;
    for (const RecoveredFactors recovered : kEvery) {
      for (const bool conservative : {false, true}) {
        SCOPED_TRACE(std::to_string(seed) + (conservative ? " conservative " : " ") +
                     std::to_string(static_cast<int>(recovered)));
        EliminationOptions options;
        options.recovered = recovered;
        options.conservative = conservative;
        const Elimination<Pose> out = EliminateOne(graph, pose, options);
        ASSERT_EQ(out.eliminated.size(), 1u);
        EXPECT_EQ(out.eliminated[0].pose, pose);
        EXPECT_EQ(std::set<PoseId>(out.eliminated[0].neighbours.begin(), out.eliminated[0].neighbours.end()),
                  neighbours);
        const PoseGraph<Pose> after = Among(out.graph, neighbours);
        const Held exact = Marginal(before, IdsOf(after)), now = HeldSystem(after);
        EXPECT_GT(out.loss, 0);
        EXPECT_NEAR(out.loss, Divergence(exact.H, now.H), 1e-7 * (1 + out.loss));
        EXPECT_LT(testing::RelativeError(now.b, exact.b), 1e-6);
        const Held whole = HeldSystem(out.graph);
        EXPECT_LT(testing::Solve(whole.H, whole.b).norm(), 1e-8);
        if (conservative) {
          EXPECT_LT(testing::Eigenvalues(now.H, exact.H).maxCoeff(), 1 + 1e-8);
        }
      }
    }
  }
}

TYPED_TEST(PoseEliminationTest, DivergenceIsThatOfTheMarginal) {
  using Pose = TypeParam;
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    const PoseGraph<Pose> graph = CliqueScene<Pose>(seed, 1.2, 20);
    for (const RecoveredFactors recovered : kEvery) {
      EliminationOptions options;
      options.recovered = recovered;
      options.least_kept = 8;
      const PoseGraph<Pose> fewer = EliminatePoses(graph, options).graph;
      ASSERT_LT(fewer.Poses().size(), 18u);
      const double expected = Divergence(Marginal(graph, IdsOf(fewer)).H, HeldSystem(fewer).H);
      EXPECT_NEAR(internal::DivergenceFromMarginal(graph, internal::ValuesOf(graph), fewer), expected,
                  1e-6 * (1 + expected));
    }
    EXPECT_NEAR(internal::DivergenceFromMarginal(graph, internal::ValuesOf(graph), graph), 0, 1e-7);
  }
}

TYPED_TEST(PoseEliminationTest, LosesLessWithMoreFactors) {
  using Pose = TypeParam;
  double local[3] = {}, whole[3] = {}, chow_liu = 0;
  std::size_t factors[3] = {};
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(seed);
    const PoseGraph<Pose> graph = CliqueScene<Pose>(seed, 1.5, 12);
    const PoseId pose = Busiest(graph);
    for (std::size_t k = 0; k < 3; ++k) {
      EliminationOptions options;
      options.recovered = kEvery[k];
      const Elimination<Pose> out = EliminateOne(graph, pose, options);
      ASSERT_EQ(out.eliminated.size(), 1u);
      local[k] += out.loss;
      factors[k] += out.recovered.size();
      whole[k] += Divergence(Marginal(graph, IdsOf(out.graph)).H, HeldSystem(out.graph).H);
    }
    const PoseGraph<Pose> plain = PlainChowLiu(graph, pose);
    chow_liu += Divergence(Marginal(graph, IdsOf(plain)).H, HeldSystem(plain).H);
  }
  for (const auto* loss : {local, whole}) {
    EXPECT_LE(loss[2], loss[1] + 1e-9);
    EXPECT_LE(loss[1], loss[0] + 1e-9);
  }
  EXPECT_LE(whole[0], chow_liu + 1e-9);
  EXPECT_LE(factors[0], factors[1]);
  EXPECT_LE(factors[1], factors[2]);
  for (std::size_t k = 0; k < 3; ++k) {
    const std::string name = std::to_string(k);
    this->RecordProperty("local" + name, std::to_string(local[k]));
    this->RecordProperty("whole" + name, std::to_string(whole[k]));
  }
  this->RecordProperty("chow_liu", std::to_string(chow_liu));
}

// The descent within a clique, next to the plain tree: never worse in any single one.
TYPED_TEST(PoseEliminationTest, IsNeverWorseThanChowLiu) {
  using Pose = TypeParam;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    SCOPED_TRACE(seed);
    const PoseGraph<Pose> graph = CliqueScene<Pose>(seed, 1.5, 12);
    const PoseId pose = Busiest(graph);
    const std::set<PoseId> neighbours = NeighboursOf(graph, pose);
    std::set<PoseId> clique = neighbours;
    clique.insert(pose);
    const PoseGraph<Pose> before = Among(graph, clique);
    if (before.Poses().front().id == pose) continue;
    EliminationOptions options;
    options.recovered = RecoveredFactors::kTree;
    const double loss = EliminateOne(graph, pose, options).loss;
    const PoseGraph<Pose> plain = PlainChowLiu(before, pose);
    EXPECT_LE(loss, Divergence(Marginal(before, IdsOf(plain)).H, HeldSystem(plain).H) + 1e-8);
  }
}

TYPED_TEST(PoseEliminationTest, ConservativeIsNeverSurerThanTheWholeGraph) {
  using Pose = TypeParam;
  for (const std::uint64_t seed : testing::Seeds(1, 4)) {
    const PoseGraph<Pose> graph = CliqueScene<Pose>(seed, 0.8, 24);
    for (const RecoveredFactors recovered : kEvery) {
      SCOPED_TRACE(std::to_string(seed) + " " + std::to_string(static_cast<int>(recovered)));
      EliminationOptions options;
      options.recovered = recovered;
      options.conservative = true;
      options.least_kept = 6;
      const Elimination<Pose> out = EliminatePoses(graph, options);
      EXPECT_EQ(out.graph.Poses().size(), 6u);
      EXPECT_GT(out.loss, 0);
      const Held exact = Marginal(graph, IdsOf(out.graph)), now = HeldSystem(out.graph);
      EXPECT_LT(testing::Eigenvalues(now.H, exact.H).maxCoeff(), 1 + 1e-7);
      EXPECT_LT(testing::Solve(now.H, now.b).norm(), 1e-7);
    }
  }
}

TYPED_TEST(PoseEliminationTest, LeavesPosesThatMayNotGo) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  Random rng(1);
  PoseGraph<Pose> graph;
  const auto measure = [&](int i, int j) {
    const auto value = [&](int k) { return *graph.Poses()[static_cast<std::size_t>(k)].T_world_body; };
    graph.AddFactor(
        RelativePoseFactor<Pose>{PoseId{i}, PoseId{j}, value(i).Inverse() * value(j), 100 * Matrix<B, B>::Identity()});
  };
  for (int k = 0; k < 40; ++k) {
    graph.AddPose(PoseId{k}, testing::RandomMotion<Pose>(rng, 3, 0.5));
    if (k > 0 && k != 30) measure(k - 1, k);  // two parts, 0 to 29 and 30 to 39
  }
  for (int k = 2; k < 28; k += 2) {
    if (k < 14 || k > 16) measure(15, k);  // a hub
  }
  graph.SetFixed(PoseId{5}, true);
  graph.AddFactor(PosePriorFactor<Pose>{PoseId{7}, *graph.Poses()[7].T_world_body, Matrix<B, B>::Identity()});
  EliminationOptions options;
  options.most_neighbours = 4;
  options.stay = {PoseId{33}};
  const Elimination<Pose> out = EliminatePoses(graph, options);
  for (const int id : {0, 5, 7, 29, 30, 33, 39}) EXPECT_TRUE(out.graph.HasPose(PoseId{id})) << id;
  EXPECT_TRUE(out.graph.Poses()[static_cast<std::size_t>(out.graph.IndexOf(PoseId{5}))].fixed);
  for (const auto& pose : out.eliminated) EXPECT_LE(pose.neighbours.size(), 4u);
  options.stay = {PoseId{99}};
  EXPECT_THROW(EliminatePoses(graph, options), std::invalid_argument);
  EXPECT_EQ(ConnectedComponents(out.graph).size(), 2u);
  // Nothing is between 30, 33 and 39 any more.
  EXPECT_FALSE(out.graph.HasPose(PoseId{31}));
  EXPECT_FALSE(out.graph.HasPose(PoseId{36}));
  // A hub's leaves go; one with too many neighbours does not as long as it has these.
  options.stay.clear();
  options.most_neighbours = 2;
  EXPECT_TRUE(EliminatePoses(graph, options).graph.HasPose(PoseId{15}));
}

TYPED_TEST(PoseEliminationTest, NamesWhatItKeepsAndWhatItMakes) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  PoseGraph<Pose> graph;
  Random rng(3);
  for (int k = 0; k < 8; ++k) graph.AddPose(PoseId{k}, testing::RandomMotion<Pose>(rng, 3, 0.5));
  const auto measure = [&](int i, int j) {
    const Pose T = graph.Poses()[static_cast<std::size_t>(i)].T_world_body->Inverse() *
                   *graph.Poses()[static_cast<std::size_t>(j)].T_world_body;
    return graph.AddFactor(RelativePoseFactor<Pose>{PoseId{i}, PoseId{j}, T, Matrix<B, B>::Identity()});
  };
  for (int k = 1; k < 8; ++k) measure(k - 1, k);
  const FactorId loop = measure(4, 0), removed = measure(7, 3), last = measure(1, 3);
  graph.RemoveFactor(removed);
  EliminationOptions options;
  // 2, 5 and 6 go: 2 between 1 and 3, where there is an edge already.
  options.stay = {PoseId{1}, PoseId{3}, PoseId{4}};
  const Elimination<Pose> out = EliminatePoses(graph, options);
  EXPECT_EQ(IdsOf(out.graph), (std::vector<PoseId>{{0}, {1}, {3}, {4}, {7}}));
  ASSERT_EQ(out.recovered.size(), 2u);
  std::vector<FactorId> ids;
  for (const auto& node : out.graph.Factors()) ids.push_back(node.id);
  EXPECT_EQ(ids, (std::vector<FactorId>{{0}, {3}, loop, {last.value + 1}, {last.value + 2}}));
  for (const auto& edge : out.recovered) {
    const FactorPoses ends = PosesOf(out.graph.FindFactor(edge.factor)->factor);
    const bool is_chain = ends.first == PoseId{4} || ends.second == PoseId{4};
    EXPECT_EQ(edge.through, is_chain ? (std::vector<PoseId>{{5}, {6}}) : (std::vector<PoseId>{{2}}));
  }
  EXPECT_EQ(std::get<RelativePoseFactor<Pose>>(out.graph.FindFactor(loop)->factor).from, PoseId{4});
}

TYPED_TEST(PoseEliminationTest, EndsWhereItIsTold) {
  using Pose = TypeParam;
  const PoseGraph<Pose> graph = CliqueScene<Pose>(2, 0.6, 24);
  EliminationOptions options;
  options.least_kept = 15;
  const Elimination<Pose> whole = EliminatePoses(graph, options);
  EXPECT_EQ(whole.graph.Poses().size(), 15u);
  EXPECT_EQ(whole.eliminated.size(), 9u);
  EXPECT_FALSE(whole.stopped);
  options.progress = [](int eliminated) { return eliminated < 4; };
  const Elimination<Pose> part = EliminatePoses(graph, options);
  EXPECT_TRUE(part.stopped);
  ASSERT_EQ(part.eliminated.size(), 4u);
  EXPECT_EQ(part.graph.Poses().size(), 20u);
  for (std::size_t k = 0; k < 4; ++k) EXPECT_EQ(part.eliminated[k].pose, whole.eliminated[k].pose);
  options.least_kept = 24;
  options.progress = nullptr;
  EXPECT_TRUE(EliminatePoses(graph, options).eliminated.empty());
  EXPECT_EQ(EliminatePoses(graph, options).graph.Factors().size(), graph.Factors().size());
  PoseGraph<Pose> no_value = graph;
  no_value.AddPose(PoseId{9999});
  EXPECT_THROW(EliminatePoses(no_value, options), std::invalid_argument);
}

// Factors that contradict the estimates are not linear there.
TYPED_TEST(PoseEliminationTest, LeavesWhatIsNotLinear) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  PoseGraph<Pose> graph;
  for (int k = 0; k < 3; ++k) graph.AddPose(PoseId{k}, Pose());
  typename Pose::Tangent far = Pose::Tangent::Zero();
  far[B - 1] = 1;
  graph.AddFactor(RelativePoseFactor<Pose>{PoseId{0}, PoseId{1}, Pose(), Matrix<B, B>::Identity()});
  graph.AddFactor(RelativePoseFactor<Pose>{PoseId{1}, PoseId{2}, Pose().Retract(far), Matrix<B, B>::Identity()});
  EXPECT_TRUE(EliminatePoses(graph, {}).eliminated.empty());
}

}  // namespace
}  // namespace terse
