#include "simulation.h"

namespace terse::testing {
namespace {

// n ~ N(0, Omega^-1).
template <int N>
Vector<N> NoiseOf(Random& rng, const Matrix<N, N>& information) {
  const Eigen::Matrix<double, N, N> L = CholeskyFactor(information);
  return L.transpose().template triangularView<Eigen::Upper>().solve(Eigen::Matrix<double, N, 1>(NormalVector<N>(rng)));
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
SE2 TrueMotion(const SE2*, int k, int lap) {
  return SE2(1 + 0.2 * std::sin(k), 0.1 * std::cos(2.0 * k), 2 * M_PI / lap);
}
SE3 TrueMotion(const SE3*, int k, int lap) {
  Vector<6> d;
  d << 1 + 0.2 * std::sin(k), 0.1 * std::cos(2.0 * k), 0.3 * std::cos(2 * M_PI * k / lap),
      0.2 * std::cos(4 * M_PI * k / lap), 0.1 * std::sin(2 * M_PI * k / lap), 2 * M_PI / lap;
  return SE3::Exp(d);
}

}  // namespace

template <class Pose>
Simulation<Pose> Simulate(std::uint64_t seed, const SimulationOptions& options) {
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

template Simulation<SE2> Simulate<SE2>(std::uint64_t, const SimulationOptions&);
template Simulation<SE3> Simulate<SE3>(std::uint64_t, const SimulationOptions&);

double Nees(const Eigen::VectorXd& e, const Eigen::MatrixXd& Sigma) { return e.dot(Solve(Sigma, e).col(0)); }

double NormalQuantile(double probability) {
  double low = -40, high = 40;
  for (int k = 0; k < 60; ++k) {
    const double z = (low + high) / 2;
    (std::erfc(-z / std::sqrt(2)) / 2 < probability ? low : high) = z;
  }
  return (low + high) / 2;
}

// After Wilson and Hilferty; good to 1e-4 of itself from 100 degrees of freedom on.
double ChiSquareQuantile(double dof, double probability) {
  const double a = 2 / (9 * dof);
  return dof * std::pow(1 - a + NormalQuantile(probability) * std::sqrt(a), 3);
}

Interval NeesInterval(int runs, int dof, double probability) {
  const double outside = (1 - probability) / 2;
  return {ChiSquareQuantile(1.0 * runs * dof, outside) / runs, ChiSquareQuantile(1.0 * runs * dof, 1 - outside) / runs};
}

}  // namespace terse::testing
