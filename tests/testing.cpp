#include "testing.h"

#include "terse/core/gauge.h"

namespace terse::testing {

double Uniform(Random& rng, double low, double high) {
  return low + (high - low) * static_cast<double>(rng() >> 11) * 0x1.0p-53;
}

double Normal(Random& rng) {
  double u = 0;
  while (u == 0) u = Uniform(rng, 0, 1);
  return std::sqrt(-2 * std::log(u)) * std::cos(2 * M_PI * Uniform(rng, 0, 1));
}

template <int N>
Matrix<N, N> RandomInformation(Random& rng, double scale) {
  Matrix<N, N> A;
  for (int i = 0; i < N; ++i) A.col(i) = NormalVector<N>(rng);
  const Matrix<N, N> information = scale * (A * A.transpose() + 0.2 * Matrix<N, N>::Identity());
  return (information + information.transpose()) / 2;
}

template <class Pose>
Pose RandomMotion(Random& rng, double metres, double radians) {
  typename Pose::Tangent d = NormalVector<Pose::kDof>(rng);
  d.template head<Pose::kDim>() *= metres;
  d.template tail<Pose::kDof - Pose::kDim>() *= radians;
  return Pose().Retract(d);
}

template <class Pose>
RandomGraph<Pose> MakeRandomGraph(Random& rng, const RandomGraphOptions& options) {
  RandomGraph<Pose> out;
  const auto id = [&](int k) { return PoseId{100 + options.id_stride * k}; };
  const auto measure = [&](int i, int j) {
    const Pose exact = out.truth[static_cast<std::size_t>(i)].Inverse() * out.truth[static_cast<std::size_t>(j)];
    RelativePoseFactor<Pose> f{id(i), id(j), exact * RandomMotion<Pose>(rng, options.noise, options.noise),
                               RandomInformation<Pose::kDof>(rng, 100)};
    return f;
  };
  for (int k = 0; k < options.poses; ++k) {
    out.truth.push_back(k == 0 ? Pose() : out.truth.back() * RandomMotion<Pose>(rng, 1.0, 0.5));
    out.graph.AddPose(id(k), out.truth.back() * RandomMotion<Pose>(rng, options.noise, options.noise));
    if (k > 0) out.graph.AddFactor(measure(k - 1, k));
    if (k > 1 && Uniform(rng, 0, 1) < options.loops_per_pose) {
      const int i = static_cast<int>(rng() % static_cast<std::uint64_t>(k));
      // Some edges backward, some double.
      out.graph.AddFactor(rng() % 2 == 0 ? measure(k, i) : measure(i, k));
      if (rng() % 4 == 0) out.graph.AddFactor(measure(i, k));
    }
    if (options.priors && rng() % 5 == 0) {
      const Pose noisy = out.truth.back() * RandomMotion<Pose>(rng, options.noise, options.noise);
      if (rng() % 2 == 0) {
        out.graph.AddFactor(PosePriorFactor<Pose>{id(k), noisy, RandomInformation<Pose::kDof>(rng, 10)});
      } else {
        out.graph.AddFactor(
            PositionPriorFactor<Pose>{id(k), noisy.Translation(), RandomInformation<Pose::kDim>(rng, 10)});
      }
    }
  }
  return out;
}

template <int B>
void AddDense(DenseSystem& system, const LinearFactor<B>& f) {
  const auto add = [&](int i, const Matrix<B, B>& Ai, int j, const Matrix<B, B>& Aj) {
    system.H.block<B, B>(B * i, B * j) += Ai.transpose() * Aj;
  };
  add(f.first, f.A_first, f.first, f.A_first);
  system.b.segment<B>(B * f.first) -= f.A_first.transpose() * f.residual;
  if (f.second < 0) return;
  add(f.first, f.A_first, f.second, f.A_second);
  add(f.second, f.A_second, f.first, f.A_first);
  add(f.second, f.A_second, f.second, f.A_second);
  system.b.segment<B>(B * f.second) -= f.A_second.transpose() * f.residual;
}

template <class Pose>
DenseSystem MakeDenseSystem(const PoseGraph<Pose>& graph, const std::vector<Pose>& values, const Gauge<Pose>* gauge) {
  constexpr int B = Pose::kDof;
  const Eigen::Index n = B * static_cast<Eigen::Index>(values.size());
  DenseSystem system{Eigen::MatrixXd::Zero(n, n), Eigen::VectorXd::Zero(n)};
  const auto at = [&](int i) { return values[static_cast<std::size_t>(i)]; };
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    const int first = graph.IndexOf(ends.first), second = graph.IndexOf(ends.second);
    AddDense(system, Linearize(node.factor, first, second, at(first), at(second)));
  }
  for (const auto& node : graph.Poses()) {
    if (!node.fixed || !node.T_world_body) continue;
    const int i = graph.IndexOf(node.id);
    AddDense(system, Linearize<Pose>(FixedPosePrior<Pose>(node.id, *node.T_world_body), i, i, at(i), at(i)));
  }
  AddDense(system, Anchor(gauge != nullptr ? *gauge : FindGauge(graph, values)));
  return system;
}

#define TERSE_INSTANTIATE(N) template Matrix<N, N> RandomInformation<N>(Random&, double)
TERSE_INSTANTIATE(2);
TERSE_INSTANTIATE(3);
TERSE_INSTANTIATE(4);
TERSE_INSTANTIATE(6);
#undef TERSE_INSTANTIATE

#define TERSE_INSTANTIATE(Pose)                                                         \
  template Pose RandomMotion<Pose>(Random&, double, double);                            \
  template RandomGraph<Pose> MakeRandomGraph<Pose>(Random&, const RandomGraphOptions&); \
  template void AddDense<Pose::kDof>(DenseSystem&, const LinearFactor<Pose::kDof>&);    \
  template DenseSystem MakeDenseSystem<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&, const Gauge<Pose>*)
TERSE_INSTANTIATE(SE2);
TERSE_INSTANTIATE(SE3);
#undef TERSE_INSTANTIATE

}  // namespace terse::testing
