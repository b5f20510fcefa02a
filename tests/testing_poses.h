#pragma once
// Seeded random rotations and poses.

#include <cmath>
#include <random>

#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse::testing {

inline constexpr double kPi = 3.14159265358979323846;

class PoseRandom {
 public:
  explicit PoseRandom(unsigned seed) : engine_(seed) {}
  double Uniform(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine_); }
  double LogUniform(double low, double high) { return std::exp(Uniform(std::log(low), std::log(high))); }
  double Normal() { return std::normal_distribution<double>()(engine_); }
  template <int N>
  Vector<N> NormalVector() {
    Vector<N> v;
    for (int i = 0; i < N; ++i) v[i] = Normal();
    return v;
  }
  // Every fifth is within 1e-9 .. 1e-2 of pi, the others log-uniform from 1e-12 to pi.
  double Angle() { return Uniform(0, 1) < 0.2 ? kPi - LogUniform(1e-9, 1e-2) : LogUniform(1e-12, kPi); }
  Vector<3> RotationVector(double angle) { return angle * NormalVector<3>().normalized(); }
  double Sign() { return Uniform(0, 1) < 0.5 ? -1 : 1; }
  // Symmetric positive definite and dense, condition number of some tens.
  template <int N>
  Matrix<N, N> Information() {
    Matrix<N, N> A;
    for (int i = 0; i < N; ++i) A.col(i) = NormalVector<N>();
    const Matrix<N, N> information = A * A.transpose() + 0.3 * Matrix<N, N>::Identity();
    return (information + information.transpose()) / 2;
  }

 private:
  std::mt19937_64 engine_;
};

// Tangents with |rho| around `size` metres and Angle() radians.
template <class Pose>
typename Pose::Tangent RandomTangent(PoseRandom& random, double size);
template <>
inline SE2::Tangent RandomTangent<SE2>(PoseRandom& random, double size) {
  const Vector<2> rho = size * random.NormalVector<2>();
  return SE2::Tangent(rho.x(), rho.y(), random.Sign() * random.Angle());
}
template <>
inline SE3::Tangent RandomTangent<SE3>(PoseRandom& random, double size) {
  SE3::Tangent d;
  d << size * random.NormalVector<3>(), random.RotationVector(random.Angle());
  return d;
}

template <class Pose>
Pose RandomPose(PoseRandom& random, double size) {
  return Pose::Exp(RandomTangent<Pose>(random, size));
}

}  // namespace terse::testing
