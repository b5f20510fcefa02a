// Certify: global optima are certified, local ones are not, and the bound holds.

#include "terse/core/certificate.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "terse/core/batch_solver.h"
#include "terse/core/outliers.h"
#include "terse/core/random.h"
#include "testing.h"

namespace terse {
namespace {

using std::size_t;

Matrix<2, 2> RotationOf(const SE2& T) { return T.Rotation(); }
Matrix<3, 3> RotationOf(const SE3& T) { return T.Rotation().Rotation(); }

template <class Pose>
PoseGraph<Pose> RandomScene(unsigned seed, int poses, double noise = 0.02) {
  testing::Random rng(seed);
  testing::RandomGraphOptions options;
  options.poses = poses;
  options.loops_per_pose = 1;
  options.noise = noise;
  return testing::MakeRandomGraph<Pose>(rng, options).graph;
}

// The chordal cost by its definition, of any matrices: row v of `positions`, blocks of `rotations`.
template <int D>
struct Unknowns {
  Eigen::Matrix<double, D, Eigen::Dynamic> positions, rotations;
};
template <class Pose>
double CostOf(const PoseGraph<Pose>& graph, const Unknowns<Pose::kDim>& x) {
  constexpr int D = Pose::kDim, Turns = Pose::kDof - D;
  double cost = 0;
  for (const auto& node : graph.Factors()) {
    const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (edge == nullptr) continue;
    const Eigen::MatrixXd covariance = Eigen::MatrixXd(edge->information).inverse();
    const double kappa = Turns / (2 * covariance.bottomRightCorner(Turns, Turns).trace());
    const double tau = D / covariance.topLeftCorner(D, D).trace();
    const int i = graph.IndexOf(edge->from), j = graph.IndexOf(edge->to);
    const Matrix<D, D> R_i = x.rotations.template middleCols<D>(D * i), R_j = x.rotations.template middleCols<D>(D * j);
    cost += kappa * (R_j - R_i * RotationOf(edge->T_from_to)).squaredNorm() +
            tau * (x.positions.col(j) - x.positions.col(i) - R_i * edge->T_from_to.Translation()).squaredNorm();
  }
  return cost;
}

// M of the quadratic cost, from the cost itself: one row of the unknowns is as good as another.
template <class Pose>
Eigen::MatrixXd QuadraticOf(const PoseGraph<Pose>& graph) {
  constexpr int D = Pose::kDim;
  const auto n = static_cast<Eigen::Index>(graph.Poses().size());
  const Eigen::Index size = n * (D + 1);
  const auto cost = [&](const Eigen::VectorXd& row) {
    Unknowns<D> x{Eigen::MatrixXd::Zero(D, n), Eigen::MatrixXd::Zero(D, D * n)};
    x.positions.row(0) = row.head(n).transpose();
    x.rotations.row(0) = row.tail(D * n).transpose();
    return CostOf(graph, x);
  };
  Eigen::MatrixXd M(size, size);
  for (Eigen::Index a = 0; a < size; ++a) {
    for (Eigen::Index b = 0; b <= a; ++b) {
      const Eigen::VectorXd e = Eigen::VectorXd::Unit(size, a), f = Eigen::VectorXd::Unit(size, b);
      M(a, b) = M(b, a) = (cost(e + f) - cost(e - f)) / 4;
    }
  }
  return M;
}

// The smallest eigenvalue of the certificate's matrix at these poses, dense, positions eliminated.
template <class Pose>
double DenseEigenvalue(const PoseGraph<Pose>& graph, const std::vector<Pose>& T) {
  constexpr int D = Pose::kDim;
  const auto n = static_cast<Eigen::Index>(T.size());
  const Eigen::MatrixXd M = QuadraticOf(graph);
  Eigen::MatrixXd Z(D, n * (D + 1));
  for (Eigen::Index v = 0; v < n; ++v) {
    Z.col(v) = T[static_cast<size_t>(v)].Translation();
    Z.middleCols(n + D * v, D) = RotationOf(T[static_cast<size_t>(v)]);
  }
  const Eigen::MatrixXd ZM = Z * M;
  Eigen::MatrixXd S = M;
  for (Eigen::Index v = 0; v < n; ++v) {
    const Eigen::MatrixXd lambda = RotationOf(T[static_cast<size_t>(v)]).transpose() * ZM.middleCols(n + D * v, D);
    S.block(n + D * v, n + D * v, D, D) -= (lambda + lambda.transpose()) / 2;
  }
  const Eigen::MatrixXd L = S.block(1, 1, n - 1, n - 1), V = S.block(1, n, n - 1, D * n);
  const Eigen::MatrixXd reduced = S.bottomRightCorner(D * n, D * n) - V.transpose() * L.lu().solve(V);
  return Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>((reduced + reduced.transpose()) / 2).eigenvalues()[0];
}

template <class Pose>
class CertificateTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CertificateTest, Groups);

TYPED_TEST(CertificateTest, TheOptimumOfALittleNoiseIsGlobal) {
  using Pose = TypeParam;
  for (const unsigned seed : {1u, 2u, 3u}) {
    const auto graph = RandomScene<Pose>(seed, 60);
    const auto result = SolveBatch(graph);
    const Certificate found = Certify(graph, result.T_world_body);
    EXPECT_TRUE(found.is_global) << "seed " << seed << ", gap " << found.gap;
    EXPECT_LE(found.bound, found.cost * (1 + 1e-9));
    EXPECT_LT(found.gap, 1e-9);
    EXPECT_LT(found.largest_turn_rad, 0.1);
    EXPECT_FALSE(found.has_absolute);
  }
}

// A ring that is wound twice instead of once: each measurement is off by the same, which is a minimum.
template <class Pose>
Pose Turned(double x, double angle) {
  typename Pose::Tangent d = Pose::Tangent::Zero();
  d[0] = x;
  d[Pose::kDof - 1] = angle;
  return Pose::Exp(d);
}

TYPED_TEST(CertificateTest, ALocalMinimumIsNot) {
  using Pose = TypeParam;
  const int n = 24;
  const double turn = 2 * 3.141592653589793 / n;
  PoseGraph<Pose> graph;
  std::vector<Pose> wound = {Pose()};
  for (int v = 0; v < n; ++v) graph.AddPose({v});
  for (int v = 0; v < n; ++v) {
    RelativePoseFactor<Pose> edge;
    edge.from = {v};
    edge.to = {(v + 1) % n};
    edge.T_from_to = Turned<Pose>(1, turn);
    edge.information = 100 * Pose::Jacobian::Identity();
    graph.AddFactor(edge);
    if (v + 1 < n) wound.push_back(wound.back() * Turned<Pose>(1, 2 * turn));
  }
  const auto right = SolveBatch(graph);
  EXPECT_TRUE(Certify(graph, right.T_world_body).is_global);
  const Certificate found = Certify(graph, wound);
  if (Pose::kDim == 2) {  // in space the ring unwinds
    EXPECT_FALSE(found.is_global);
    EXPECT_LT(found.smallest_eigenvalue, 0);
    EXPECT_GT(found.gap, 0.5);
  }
  EXPECT_LE(found.bound, 1e-9) << "the right ring costs nothing";
}

// Wrong loops: nothing is certified that is not so, whatever local optimum one starts from.
TYPED_TEST(CertificateTest, TheBoundHoldsForEveryLocalOptimum) {
  using Pose = TypeParam;
  auto scene = RandomScene<Pose>(5, 12);
  const auto clean = SolveBatch(scene);
  const PoseGraph<Pose> graph = AddWrongLoops(scene, clean.T_world_body, 50, 3).graph;
  internal::Random rng(7);
  double least = std::numeric_limits<double>::infinity(), highest_bound = -least;
  for (int trial = 0; trial < 10; ++trial) {
    std::vector<Pose> start;
    for (size_t v = 0; v < graph.Poses().size(); ++v) {
      typename Pose::Tangent d;
      for (int k = 0; k < Pose::kDof; ++k) d[k] = rng.Normal() * (trial == 0 ? 0 : 1);
      start.push_back(clean.T_world_body[v] * Pose::Exp(d));
    }
    const Certificate found = Certify(graph, SolveBatch(graph, start).T_world_body);
    least = std::min(least, found.cost);
    highest_bound = std::max(highest_bound, found.bound);
    EXPECT_GE(found.gap, 0);
    if (found.is_global) {
      EXPECT_LE(found.cost, least * (1 + 1e-4));
    }
  }
  EXPECT_LE(highest_bound, least * (1 + 1e-9));
}

TYPED_TEST(CertificateTest, TheEigenvalueIsThatOfTheDenseMatrix) {
  using Pose = TypeParam;
  // Away from the optimum the matrix is indefinite; no iterations, so that both are at the same poses.
  const auto graph = RandomScene<Pose>(6, 8);
  std::vector<Pose> T = SolveBatch(graph).T_world_body;
  internal::Random rng(8);
  for (Pose& pose : T) {
    typename Pose::Tangent d;
    for (int k = 0; k < Pose::kDof; ++k) d[k] = 0.3 * rng.Normal();
    pose = pose * Pose::Exp(d);
  }
  CertifyOptions still;
  still.max_iterations = 0;
  const double dense = DenseEigenvalue(graph, T);
  ASSERT_LT(dense, 0);
  const Certificate found = Certify(graph, T, still);
  EXPECT_NEAR(found.smallest_eigenvalue, dense, 1e-4 * std::abs(dense));
  EXPECT_FALSE(found.is_global);
}

TYPED_TEST(CertificateTest, WhatCannotBeCertifiedIsRefused) {
  using Pose = TypeParam;
  auto graph = RandomScene<Pose>(9, 10);
  const auto T = SolveBatch(graph).T_world_body;
  EXPECT_THROW(Certify(graph, std::vector<Pose>(3)), std::invalid_argument);
  EXPECT_THROW(Certify(PoseGraph<Pose>(), std::vector<Pose>()), std::invalid_argument);
  graph.SetPoses(T);
  graph.SetFixed(graph.Poses().front().id, true);
  EXPECT_TRUE(Certify(graph, T).has_absolute);
  graph.AddPose({1000000}, Pose());
  auto more = T;
  more.emplace_back();
  EXPECT_THROW(Certify(graph, more), std::invalid_argument);
  PoseGraph<Pose> alone;
  alone.AddPose({0}, Pose());
  EXPECT_TRUE(Certify(alone, std::vector<Pose>(1)).is_global);
}

}  // namespace
}  // namespace terse
