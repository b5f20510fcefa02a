#pragma once
// Simulated runs with noise drawn from the covariance that the factors state, and what is expected of their errors.
//
// Normalised estimation error squared (NEES): e' Sigma^-1 e, e = Local(estimate, truth) in the body frame. If Sigma is
// the covariance of e, it is chi-square distributed with as many degrees of freedom as e has scalars, and so is the sum
// over independent runs (Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking and Navigation, 5.4.2).

#include <Eigen/Cholesky>

#include "testing.h"

namespace terse::testing {

struct SimulationOptions {
  double noise = 1;          // times 1 cm and 5 mrad per edge, or some times that: ScaledInformation
  bool priors = false;       // noisy absolute measurements instead of an anchored first pose
  int poses = 41, lap = 20;  // two laps, loops between them
};

template <class Pose>
struct Simulation {
  PoseGraph<Pose> graph;      // ids 0, 1, ...; the first pose has its true value, the others none
  std::vector<Pose> truth;    // by pose index
  std::vector<Pose> initial;  // the odometry, composed
};

// n ~ N(0, Omega^-1).
template <int N>
Vector<N> NoiseOf(Random& rng, const Matrix<N, N>& information) {
  const Eigen::Matrix<double, N, N> U = Eigen::Matrix<double, N, N>(information).llt().matrixU();
  return U.template triangularView<Eigen::Upper>().solve(Eigen::Matrix<double, N, 1>(NormalVector<N>(rng)));
}

// Correlated; standard deviations are the ones asked for times 1.4 in the median, 3.2 at most.
template <int N>
Matrix<N, N> ScaledInformation(Random& rng, int translations, double metres, double radians) {
  Vector<N> scale = Vector<N>::Constant(1 / radians);
  scale.head(translations).setConstant(1 / metres);
  const Matrix<N, N> information = scale.asDiagonal() * RandomInformation<N>(rng, 0.5) * scale.asDiagonal();
  return (information + information.transpose()) / 2;
}

// A closed course of 20 poses, about 1 m apart, which in space rises, falls and banks: the same for all seeds.
inline SE2 TrueMotion(const SE2*, int k, int lap) {
  return SE2(1 + 0.2 * std::sin(k), 0.1 * std::cos(2.0 * k), 2 * M_PI / lap);
}
inline SE3 TrueMotion(const SE3*, int k, int lap) {
  Vector<6> d;
  d << 1 + 0.2 * std::sin(k), 0.1 * std::cos(2.0 * k), 0.3 * std::cos(2 * M_PI * k / lap),
      0.2 * std::cos(4 * M_PI * k / lap), 0.1 * std::sin(2 * M_PI * k / lap), 2 * M_PI / lap;
  return SE3::Exp(d);
}

// Z with Local(Z^-1 T) = n exactly.
template <class Pose>
Pose Measured(const Pose& T, const typename Pose::Tangent& n) {
  return T * Pose().Retract(n).Inverse();
}

template <class Pose>
Simulation<Pose> Simulate(std::uint64_t seed, const SimulationOptions& options = {}) {
  Random rng(seed);
  Simulation<Pose> out;
  const double metres = 0.01 * options.noise, radians = 0.005 * options.noise;
  const auto id = [](int k) { return PoseId{k}; };
  const auto measure = [&](int i, int j) {
    const Pose T_i_j = out.truth[static_cast<std::size_t>(i)].Inverse() * out.truth[static_cast<std::size_t>(j)];
    const auto information = ScaledInformation<Pose::kDof>(rng, Pose::kDim, metres, radians);
    const RelativePoseFactor<Pose> f{id(i), id(j), Measured(T_i_j, NoiseOf<Pose::kDof>(rng, information)), information};
    out.graph.AddFactor(f);
    return f.T_from_to;
  };
  for (int k = 0; k < options.poses; ++k) {
    out.truth.push_back(k == 0 ? Pose() : out.truth.back() * TrueMotion(static_cast<Pose*>(nullptr), k, options.lap));
    out.graph.AddPose(id(k), k == 0 ? std::optional<Pose>(out.truth.front()) : std::nullopt);
    out.initial.push_back(k == 0 ? out.truth.front() : out.initial.back() * measure(k - 1, k));
    if (k >= options.lap && k % 3 == 0) measure(k - options.lap, k);
    if (!options.priors) continue;
    const Pose& T = out.truth.back();
    if (k % 10 == 5) {
      const auto information = ScaledInformation<Pose::kDof>(rng, Pose::kDim, 5 * metres, 5 * radians);
      out.graph.AddFactor(
          PosePriorFactor<Pose>{id(k), Measured(T, NoiseOf<Pose::kDof>(rng, information)), information});
    } else if (k % 4 == 2) {
      const auto information = ScaledInformation<Pose::kDim>(rng, Pose::kDim, 3 * metres, 1);
      out.graph.AddFactor(
          PositionPriorFactor<Pose>{id(k), T.Translation() - NoiseOf<Pose::kDim>(rng, information), information});
    }
  }
  return out;
}

inline double Nees(const Eigen::VectorXd& e, const Eigen::MatrixXd& Sigma) { return e.dot(Sigma.llt().solve(e)); }

// Of the standard normal distribution.
inline double NormalQuantile(double probability) {
  double low = -40, high = 40;
  for (int k = 0; k < 60; ++k) {
    const double z = (low + high) / 2;
    (std::erfc(-z / std::sqrt(2)) / 2 < probability ? low : high) = z;
  }
  return (low + high) / 2;
}

// After Wilson and Hilferty; good to 1e-4 of itself from 100 degrees of freedom on.
inline double ChiSquareQuantile(double dof, double probability) {
  const double a = 2 / (9 * dof);
  return dof * std::pow(1 - a + NormalQuantile(probability) * std::sqrt(a), 3);
}

struct Interval {
  double low, high;
  bool Contains(double x) const { return low < x && x < high; }
};

// Where the mean NEES over `runs` runs with `dof` scalars each lies with this probability.
inline Interval NeesInterval(int runs, int dof, double probability = 0.95) {
  const double outside = (1 - probability) / 2;
  return {ChiSquareQuantile(1.0 * runs * dof, outside) / runs, ChiSquareQuantile(1.0 * runs * dof, 1 - outside) / runs};
}

}  // namespace terse::testing
