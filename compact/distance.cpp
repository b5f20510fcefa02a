#include "terse/compact/distance.h"

#include <Eigen/Eigenvalues>
#include <cmath>

namespace terse {
namespace {

constexpr double kPi = 3.14159265358979323846;

double NormalCdf(double x) { return std::erfc(-x / std::sqrt(2.0)) / 2; }

double ProbabilityWithin(double mean, double sigma, double low, double high) {
  if (sigma <= 0) return mean >= low && mean <= high ? 1 : 0;
  // On the lower tail, whichever side the interval is on: the upper one would cancel.
  if (low > mean) return NormalCdf((mean - low) / sigma) - NormalCdf((mean - high) / sigma);
  return NormalCdf((high - mean) / sigma) - NormalCdf((low - mean) / sigma);
}

// That a wrapped normal angle is within +-limit, limit < pi.
double AngleProbabilityWithin(double mean, double sigma, double limit) {
  if (sigma > 2 * kPi) return limit / kPi;  // uniform to 1e-8
  const double period = 2 * kPi;
  const double nearest = std::remainder(mean, period);
  const int turns = 1 + static_cast<int>(std::ceil(6 * sigma / period));
  double sum = 0;
  for (int k = -turns; k <= turns; ++k) {
    sum += ProbabilityWithin(nearest, sigma, k * period - limit, k * period + limit);
  }
  return sum;
}

// d angle / d phi (right perturbation) for the angle between e and R e, with the covariance of phi at hand to
// choose a direction where the gradient has none.
Vector<3> AngleGradient(const SO3& R, const Vector<3>& e, const Matrix<3, 3>& Sigma_phi) {
  // R Exp(phi) e = R (e + phi x e): in body coordinates the axis moves by phi x e, across e only.
  const Vector<3> seen = R.Inverse() * e;  // the other axis in body coordinates
  const Vector<3> across = e.cross(seen);
  if (across.norm() > 1e-6) {
    // Turning about (seen x e) moves e away from `seen`.
    return -across.normalized();
  }
  const Matrix<3, 3> P = Matrix<3, 3>::Identity() - e * e.transpose();
  const Eigen::Matrix3d projected = P * Sigma_phi * P;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(projected);
  return P * eigen.eigenvectors().col(2);  // without variance across e any direction comes, e itself too
}

}  // namespace

template <>
Vector<3> DisplacementMean<SE2>(const SE2& T_i_n, const Vector<3>&) {
  return {T_i_n.Translation().x(), T_i_n.Translation().y(), T_i_n.Theta()};
}

template <>
Vector<4> DisplacementMean<SE3>(const SE3& T_i_n, const Vector<3>& view_axis) {
  const Vector<3> e = view_axis.normalized();
  const Vector<3> seen = T_i_n.Rotation() * e;
  Vector<4> out;
  out << T_i_n.Translation(), std::atan2(e.cross(seen).norm(), e.dot(seen));
  return out;
}

template <>
Displacement<SE2> ComputeDisplacement<SE2>(const UncertainPose<SE2>& T_i_n, const Vector<3>&) {
  Displacement<SE2> out;
  out.mean = DisplacementMean<SE2>(T_i_n.T_a_b);
  const Matrix<3, 3> J = SE2::LocalJacobian(out.mean);
  out.covariance = J * T_i_n.covariance * J.transpose();
  return out;
}

template <>
Displacement<SE3> ComputeDisplacement<SE3>(const UncertainPose<SE3>& T_i_n, const Vector<3>& view_axis) {
  const SO3& R = T_i_n.T_a_b.Rotation();
  const Vector<3> e = view_axis.normalized();
  Displacement<SE3> out;
  out.mean = DisplacementMean<SE3>(T_i_n.T_a_b, view_axis);
  Matrix<4, 6> J = Matrix<4, 6>::Zero();
  J.topLeftCorner<3, 3>() = R.Rotation();
  J.bottomRightCorner<1, 3>() = AngleGradient(R, e, T_i_n.covariance.bottomRightCorner<3, 3>()).transpose();
  out.covariance = J * T_i_n.covariance * J.transpose();
  return out;
}

template <class Pose>
Vector<Displacement<Pose>::kSize> RangeProbabilities(const Displacement<Pose>& displacement,
                                                     const Vector<Displacement<Pose>::kSize>& range) {
  constexpr int kSize = Displacement<Pose>::kSize;
  Vector<kSize> out;
  for (int k = 0; k < kSize; ++k) {
    const double sigma = std::sqrt(displacement.covariance(k, k));
    const double mean = displacement.mean[k], limit = range[k];
    if (k < Pose::kDim) {
      out[k] = ProbabilityWithin(mean, sigma, -limit, limit);
    } else if (limit >= kPi) {
      out[k] = 1;
    } else {
      out[k] = AngleProbabilityWithin(mean, sigma, limit);
    }
  }
  return out;
}

double AngleProbabilityBound(double mean, double sigma, double range) {
  const double angle = std::abs(mean);
  if (angle <= range) return 1;
  // All that is in range lies beyond one of the two nearest ends; both tails grow with sigma.
  return NormalCdf((range - angle) / sigma) + NormalCdf((angle + range - 2 * kPi) / sigma);
}

double DeviationsBeyondRange(double probability) {
  // Bisection on the tail: monotone, and called once per run.
  double low = 0, high = 40;
  if (probability >= 0.5) return 0;
  if (probability <= 0) return high;
  for (int k = 0; k < 80; ++k) {
    const double middle = (low + high) / 2;
    (NormalCdf(-middle) > probability ? low : high) = middle;
  }
  return high;
}

template Vector<3> RangeProbabilities<SE2>(const Displacement<SE2>&, const Vector<3>&);
template Vector<4> RangeProbabilities<SE3>(const Displacement<SE3>&, const Vector<4>&);

}  // namespace terse
