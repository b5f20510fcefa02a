#include "terse/compact/distance.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "terse/core/decompositions.h"

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
  if (!(sigma <= 2 * kPi)) return limit / kPi;  // uniform to 1e-8; so is what is not a number
  const double period = 2 * kPi;
  const double nearest = std::remainder(mean, period);
  const int turns = 1 + static_cast<int>(std::ceil(6 * sigma / period));
  double sum = 0;
  for (int k = -turns; k <= turns; ++k) {
    sum += ProbabilityWithin(nearest, sigma, k * period - limit, k * period + limit);
  }
  return sum;
}

Vector<3> UnitAxis(const Vector<3>& view_axis) { return view_axis.normalized(); }

// Between e and `seen`, exact at 0 and pi where the arc cosine is not.
double AngleBetween(const Vector<3>& e, const Vector<3>& seen) { return std::atan2(e.cross(seen).norm(), e.dot(seen)); }

Vector<3> NormalizedOrZero(const Vector<3>& v) {
  const double norm = v.norm();
  return norm > 0 ? Vector<3>(v / norm) : Vector<3>(Vector<3>::Zero());
}

double LargestEigenvalue(const Matrix<3, 3>& symmetric) { return std::max(0.0, SymmetricEigenvalues<3>(symmetric)[2]); }

// An angle's gradient in phi (right perturbation), and how much of the variance is that of a length (header).
struct AngleModel {
  Vector<3> gradient = Vector<3>::Zero();
  double first_order = 0;  // g'Sg
  double limit = 0;        // L
  double weight = 0;       // w
};

// k / (t^2 + k) with t = sine / cosine.
double LengthWeight(double sine, double cosine, double k) {
  return k > 0 ? k * cosine * cosine / (sine * sine + k * cosine * cosine) : 0;
}

AngleModel ViewAngleModel(const SO3& R, const Vector<3>& e, const Matrix<3, 3>& Sigma_phi) {
  // R Exp(phi) e = R (e + phi x e): in body coordinates the axis moves by phi x e, across e only. Turning about
  // (seen x e) moves it away from `seen`, the other axis there.
  const Vector<3> seen = R.Inverse() * e;
  const Vector<3> across = seen.cross(e);
  const Matrix<3, 3> P = Matrix<3, 3>::Identity() - e * e.transpose();
  const Matrix<3, 3> S = P * Sigma_phi * P;
  const double sine = across.norm(), cosine = e.dot(seen);
  AngleModel model;
  model.gradient = NormalizedOrZero(across);
  model.first_order = model.gradient.dot(S * model.gradient);
  model.limit = cosine > 0 ? LargestEigenvalue(S) : std::max(0.0, S.trace());
  model.weight = LengthWeight(sine, cosine, cosine > 0 ? model.limit / 2 : 8 * model.limit);
  return model;
}

AngleModel RotationAngleModel(const SO3& R, const Matrix<3, 3>& Sigma_phi) {
  const Vector<3> rotation = R.Log();
  const double half = rotation.norm() / 2;
  AngleModel model;
  model.gradient = NormalizedOrZero(rotation);
  model.first_order = model.gradient.dot(Sigma_phi * model.gradient);
  model.limit = LargestEigenvalue(Sigma_phi);
  model.weight = LengthWeight(2 * std::sin(half), std::cos(half), model.limit / 2);
  return model;
}

}  // namespace

template <>
Vector<3> DisplacementMean<SE2>(const SE2& T_i_n, const DistanceOptions&) {
  return {T_i_n.Translation().x(), T_i_n.Translation().y(), T_i_n.Theta()};
}

template <>
Vector<4> DisplacementMean<SE3>(const SE3& T_i_n, const DistanceOptions& options) {
  const Vector<3> e = UnitAxis(options.view_axis);
  Vector<4> out;
  out << T_i_n.Translation(),
      options.angle == AngleMeasure::kRotation ? T_i_n.Angle() : AngleBetween(e, T_i_n.Rotation() * e);
  return out;
}

template <>
Displacement<SE2> ComputeDisplacement<SE2>(const UncertainPose<SE2>& T_i_n, const DistanceOptions&) {
  Displacement<SE2> out;
  out.mean = DisplacementMean<SE2>(T_i_n.T_a_b);
  const Matrix<3, 3> J = SE2::LocalJacobian(out.mean);
  out.covariance = J * T_i_n.covariance * J.transpose();
  return out;
}

template <>
Displacement<SE3> ComputeDisplacement<SE3>(const UncertainPose<SE3>& T_i_n, const DistanceOptions& options) {
  const SO3& R = T_i_n.T_a_b.Rotation();
  const Matrix<3, 3> Sigma_phi = T_i_n.covariance.bottomRightCorner<3, 3>();
  const AngleModel model = options.angle == AngleMeasure::kRotation
                               ? RotationAngleModel(R, Sigma_phi)
                               : ViewAngleModel(R, UnitAxis(options.view_axis), Sigma_phi);
  Displacement<SE3> out;
  out.mean = DisplacementMean<SE3>(T_i_n.T_a_b, options);
  Matrix<4, 6> J = Matrix<4, 6>::Zero();
  J.topLeftCorner<3, 3>() = R.Rotation();
  J.bottomRightCorner<1, 3>() = (1 - model.weight) * model.gradient.transpose();
  out.covariance = J * T_i_n.covariance * J.transpose();
  out.covariance(3, 3) = model.first_order + model.weight * (model.limit - model.first_order);
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

// Coordinate descent on a convex quadratic over a box.
template <class Pose>
double DistanceToRange(const Displacement<Pose>& displacement, const Vector<Displacement<Pose>::kSize>& range,
                       double enough) {
  constexpr int kSize = Displacement<Pose>::kSize, kMostSweeps = 60;
  const auto& Sigma = displacement.covariance;
  const bool has_angle = range[Pose::kDim] < kPi && Sigma(Pose::kDim, Pose::kDim) < 1;
  const int n = has_angle ? kSize : Pose::kDim;
  using Small = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kSize, 1>;
  using Square = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kSize, kSize>;
  Small mean = displacement.mean.head(n);
  if (has_angle) mean[n - 1] = std::remainder(mean[n - 1], 2 * kPi);
  const Small limit = range.head(n);
  Small x = mean.cwiseMin(limit).cwiseMax(-limit);
  if (x == mean) return 0;
  // What is known exactly is nowhere else.
  const Eigen::LLT<Square> llt(Square(Sigma.topLeftCorner(n, n)));
  if (llt.info() != Eigen::Success) return std::numeric_limits<double>::infinity();
  const Square information = llt.solve(Square::Identity(n, n));
  double distance = (x - mean).dot(information * (x - mean));
  for (int sweep = 0; sweep < kMostSweeps && distance > enough; ++sweep) {
    for (int k = 0; k < n; ++k) {
      const double step = information.row(k).dot(x - mean) / information(k, k);
      x[k] = std::clamp(x[k] - step, -limit[k], limit[k]);
    }
    const double before = std::exchange(distance, (x - mean).dot(information * (x - mean)));
    if (!(before - distance > 1e-6 * before)) break;
  }
  return distance;
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
template double DistanceToRange<SE2>(const Displacement<SE2>&, const Vector<3>&, double);
template double DistanceToRange<SE3>(const Displacement<SE3>&, const Vector<4>&, double);

}  // namespace terse
