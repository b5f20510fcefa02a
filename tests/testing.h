#pragma once
// Oracles and seeded generators that several tests share, compiled once for all of them (testing.cpp).

#include <Eigen/Core>
#include <cmath>
#include <map>
#include <random>
#include <set>
#include <vector>

#include "dense_algebra.h"
#include "slow_build.h"
#include "terse/core/gauge.h"
#include "terse/core/linear_factor.h"
#include "terse/core/pose_graph.h"

namespace terse::testing {

using Random = std::mt19937_64;

double Uniform(Random& rng, double low, double high);
double Normal(Random& rng);

template <int N>
Vector<N> NormalVector(Random& rng) {
  Vector<N> v;
  for (int i = 0; i < N; ++i) v[i] = Normal(rng);
  return v;
}

// Dense, symmetric positive definite, condition about 100. N = 2, 3, 4, 6.
template <int N>
Matrix<N, N> RandomInformation(Random& rng, double scale = 1);

template <class Pose>
Pose RandomMotion(Random& rng, double metres, double radians);

// A trajectory with odometry, loops to random earlier poses, and optionally priors and duplicates; measurements with
// noise.
struct RandomGraphOptions {
  int poses = 30;
  double loops_per_pose = 0.5;
  double noise = 0.02;  // metres and radians
  bool priors = false;
  std::int64_t id_stride = 1;  // > 1: non-contiguous ids
};

template <class Pose>
struct RandomGraph {
  PoseGraph<Pose> graph;    // with the true values plus a perturbation as pose values
  std::vector<Pose> truth;  // by pose index
};

template <class Pose>
RandomGraph<Pose> MakeRandomGraph(Random& rng, const RandomGraphOptions& options);

// H = A'A and b = -A'r of the whole graph at given values, gauge anchor included, as plain dense matrices.
struct DenseSystem {
  Eigen::MatrixXd H;
  Eigen::VectorXd b;
};

template <int B>
void AddDense(DenseSystem& system, const LinearFactor<B>& f);

template <class Pose>
DenseSystem MakeDenseSystem(const PoseGraph<Pose>& graph, const std::vector<Pose>& values,
                            const Gauge<Pose>* gauge = nullptr);

template <class A, class C>
double RelativeError(const Eigen::MatrixBase<A>& actual, const Eigen::MatrixBase<C>& expected) {
  return (actual - expected).norm() / std::max(expected.norm(), 1e-300);
}

}  // namespace terse::testing
