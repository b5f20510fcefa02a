#include "terse/core/frame_alignment.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>

#include "terse/core/decompositions.h"
#include "terse/core/gauge.h"
#include "terse/core/linear_factor.h"
#include "terse/core/residual.h"

namespace terse::internal {
namespace {

using std::size_t;
constexpr int kSteps = 20;             // of Gauss-Newton at most
constexpr double kSettled = 1e-10;     // of the cost: a step that gains less is the last
constexpr double kWorthMoving = 1e-9;  // of the cost, or of chi2 itself: a motion that gains less is none

template <class Pose>
using Block = Eigen::Matrix<double, Pose::kDim, Pose::kDim>;

Block<SE2> RotationOf(const SE2& T) { return T.Rotation(); }
Block<SE3> RotationOf(const SE3& T) { return T.Rotation().Rotation(); }
SE2 Composed(const Block<SE2>& R, const SE2::Position& t) { return SE2(t, std::atan2(R(1, 0), R(0, 0))); }
SE3 Composed(const Block<SE3>& R, const SE3::Position& t) { return SE3(SO3::FromMatrix(R), t); }

template <class Pose>
using Measurements = std::vector<std::pair<Factor<Pose>, Pose>>;

template <class Pose>
double CostOf(const Measurements<Pose>& measurements, const Pose& T_new_old) {
  double cost = 0;
  for (const auto& [factor, T_old_body] : measurements) {
    const Pose T = T_new_old * T_old_body;
    cost += FactorChi2(factor, T, T);
  }
  return cost;
}

// The fit of all measured points; a pose prior is a point and a rotation.
template <class Pose>
Pose FitAll(const Measurements<Pose>& measurements) {
  WeightedPoints<Pose> points;
  for (const auto& [factor, T_old_body] : measurements) {
    if (const auto* prior = std::get_if<PosePriorFactor<Pose>>(&factor)) {
      points.old_frame.push_back(T_old_body.Translation());
      points.new_frame.push_back(prior->T_world_body.Translation());
      points.weights.push_back(prior->information.template topLeftCorner<Pose::kDim, Pose::kDim>().trace() /
                               Pose::kDim);
    } else if (const auto* position = std::get_if<PositionPriorFactor<Pose>>(&factor)) {
      points.old_frame.push_back(T_old_body * position->p_body);
      points.new_frame.push_back(position->p_world);
      points.weights.push_back(position->information.trace() / Pose::kDim);
    }
  }
  return FitPoints(points, 0, points.weights.size(), Pose(), kLeastTurnInformation);
}

// Onto the best pose prior, if there is one.
template <class Pose>
std::optional<Pose> OntoBestPrior(const Measurements<Pose>& measurements) {
  std::optional<Pose> best;
  double most = 0;
  for (const auto& [factor, T_old_body] : measurements) {
    const auto* prior = std::get_if<PosePriorFactor<Pose>>(&factor);
    if (prior == nullptr) continue;
    const double turns =
        prior->information.template bottomRightCorner<Gauge<Pose>::kTurns, Gauge<Pose>::kTurns>().trace();
    if (turns < kLeastTurnInformation || turns <= most) continue;
    most = turns;
    best = prior->T_world_body * T_old_body.Inverse();
  }
  return best;
}

// Gauss-Newton from `start`, in the directions that the measurements determine.
template <class Pose>
Pose Refine(const Measurements<Pose>& measurements, const Pose& start, double& cost) {
  constexpr int B = Pose::kDof, D = Pose::kDim;
  using Information = Eigen::Matrix<double, B, B>;
  Pose T_new_old = start;
  cost = CostOf(measurements, T_new_old);
  // Motions are about the first measured pose, so that turns and shifts have like scales far from the origin.
  Vector<B> shift = Vector<B>::Zero();
  shift.template head<D>() = (start * measurements.front().second).Translation();
  const Pose T_new_centre = Pose().Retract(shift);
  const Pose T_centre_new = T_new_centre.Inverse();
  AbsoluteInformation<Pose> information;
  for (const auto& [factor, T_old_body] : measurements) information.Add(factor, start * T_old_body);
  const auto held = information.FindGauge(Pose()).root;  // about that pose, in the axes of the new frame
  for (int step = 0; step < kSteps; ++step) {
    Information H = held * held;
    Vector<B> b = Vector<B>::Zero();
    for (const auto& [factor, T_old_body] : measurements) {
      const Pose T = T_new_old * T_old_body;
      const LinearFactor<B> linear = Linearize(factor, 0, 0, T, T);
      const Matrix<B, B> J = linear.A_first * (T_centre_new * T).Inverse().Adjoint();
      H += J.transpose() * J;
      b -= J.transpose() * linear.residual;
    }
    const Vector<B> xi = H.ldlt().solve(Eigen::Matrix<double, B, 1>(b));
    const Pose trial = T_new_centre * Pose().Retract(xi) * T_centre_new * T_new_old;
    const double after = CostOf(measurements, trial);
    if (!(after < cost)) break;
    const bool settled = cost - after <= kSettled * cost;
    T_new_old = trial;
    T_new_old.Normalize();
    cost = after;
    if (settled) break;
  }
  return T_new_old;
}

}  // namespace

template <class Pose>
Pose FitPoints(const WeightedPoints<Pose>& points, size_t first, size_t last, const Pose& T_preferred,
               double preference) {
  using Point = Eigen::Matrix<double, Pose::kDim, 1>;
  Point mean_old = Point::Zero(), mean_new = Point::Zero();
  double sum = 0;
  for (size_t k = first; k < last; ++k) {
    mean_old += points.weights[k] * points.old_frame[k];
    mean_new += points.weights[k] * points.new_frame[k];
    sum += points.weights[k];
  }
  if (!(sum > 0)) return T_preferred;
  mean_old /= sum;
  mean_new /= sum;
  Block<Pose> M = preference * RotationOf(T_preferred);
  for (size_t k = first; k < last; ++k) {
    M += points.weights[k] * (points.new_frame[k] - mean_new) * (points.old_frame[k] - mean_old).transpose();
  }
  const Block<Pose> R = ClosestRotation<Pose::kDim>(M);
  return Composed(R, mean_new - R * mean_old);
}

template <class Pose>
std::optional<Pose> AlignToAbsolute(const std::vector<std::pair<Factor<Pose>, Pose>>& measurements) {
  if (measurements.empty()) return std::nullopt;
  const double before = CostOf(measurements, Pose());
  double least = before;
  std::optional<Pose> best;
  const auto consider = [&](const Pose& start) {
    double cost = 0;
    const Pose T_new_old = Refine(measurements, start, cost);
    if (!(cost < least)) return;
    least = cost;
    best = T_new_old;
  };
  consider(Pose());
  consider(FitAll(measurements));
  if (const auto onto = OntoBestPrior(measurements)) consider(*onto);
  if (!best || !(before - least > kWorthMoving * (1 + before))) return std::nullopt;
  return best;
}

#define TERSE_INSTANTIATE(Pose)                                                                    \
  template Pose FitPoints<Pose>(const WeightedPoints<Pose>&, size_t, size_t, const Pose&, double); \
  template std::optional<Pose> AlignToAbsolute<Pose>(const std::vector<std::pair<Factor<Pose>, Pose>>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
