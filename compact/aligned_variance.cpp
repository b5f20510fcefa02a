#include "terse/compact/aligned_variance.h"

#include <Eigen/Eigenvalues>
#include <cmath>

#include "terse/core/at.h"

namespace terse::internal {
namespace {

Matrix<2, 2> RotationOf(const SE2& T) { return T.Rotation(); }
Matrix<3, 3> RotationOf(const SE3& T) { return T.Rotation().Rotation(); }

// Columns: how p moves when the map turns about its axes.
Eigen::Matrix<double, 2, 1> TurnOf(const Vector<2>& p) { return Vector<2>(-p.y(), p.x()); }
Eigen::Matrix<double, 3, 3> TurnOf(const Vector<3>& p) {
  Eigen::Matrix<double, 3, 3> turn;
  for (int axis = 0; axis < 3; ++axis) turn.col(axis) = Vector<3>(Vector<3>::Unit(axis)).cross(p);
  return turn;
}

}  // namespace

template <class Pose>
void AlignedVariance<Pose>::Refresh() {
  const std::vector<Pose>& points = solver_.LinearizationPoints();
  if (version_ == solver_.Cholesky().Version() && ids_.size() == points.size()) return;
  version_ = solver_.Cholesky().Version();
  total_ = -1;
  ids_.clear();
  R_world_body_.clear();
  turns_.clear();
  Vector<D> middle = Vector<D>::Zero();
  for (const Pose& point : points) middle += point.Translation() / static_cast<double>(points.size());
  using Gram = Eigen::Matrix<double, kTurns, kTurns>;
  Gram gram = Gram::Zero();
  for (size_t k = 0; k < points.size(); ++k) {
    ids_.push_back(solver_.Graph().Poses()[k].id);
    R_world_body_.push_back(RotationOf(points[k]));
    turns_.push_back(TurnOf(Vector<D>(points[k].Translation() - middle)));
    gram += turns_.back().transpose() * turns_.back();
  }
  // Positions on a line cannot be turned about it.
  const Eigen::SelfAdjointEigenSolver<Gram> eigen(gram);
  Gram whiten = eigen.eigenvectors();
  for (int axis = 0; axis < kTurns; ++axis) {
    const double squared = eigen.eigenvalues()[axis];
    whiten.col(axis) *= squared > 1e-9 * eigen.eigenvalues()[kTurns - 1] && squared > 0 ? 1 / std::sqrt(squared) : 0;
  }
  for (Turn& turn : turns_) turn = turn * whiten;
}

template <class Pose>
double AlignedVariance<Pose>::Total() {
  Refresh();
  if (total_ >= 0) return total_;
  double sum = 0;
  std::vector<typename PoseMarginals<Pose>::Term> motions;
  const std::vector<Jacobian> marginals = marginals_.MarginalsOf(ids_);
  for (size_t k = 0; k < ids_.size(); ++k) {
    sum += marginals[k].template topLeftCorner<D, D>().trace();  // in the body frame: a trace does not care
    Jacobian A = Jacobian::Zero();
    A.template block<D, D>(0, 0) = R_world_body_[k] / std::sqrt(static_cast<double>(ids_.size()));
    A.template block<kTurns, D>(D, 0) = turns_[k].transpose() * R_world_body_[k];
    motions.push_back({ids_[k], A});
  }
  total_ = std::max(0.0, sum - marginals_.Combination(motions).trace());
  return total_;
}

template <class Pose>
double AlignedVariance<Pose>::ShareTold(PoseId a, PoseId b, const Jacobian& Sigma_a_b) {
  if (a == b || !(Total() > 0)) return 0;
  const std::vector<Pose>& points = solver_.LinearizationPoints();
  const int at_a = solver_.Graph().IndexOf(a), at_b = solver_.Graph().IndexOf(b);
  const auto of_a = marginals_.Column(a, ids_), of_b = marginals_.Column(b, ids_);
  // The displacement's perturbation is d_b - Ad(T_b_a) d_a.
  const Jacobian Ad = (points[At(at_b)].Inverse() * points[At(at_a)]).Adjoint();
  std::vector<Block> cross(ids_.size());
  Block mean = Block::Zero();
  Eigen::Matrix<double, kTurns, B> turned = Eigen::Matrix<double, kTurns, B>::Zero();
  for (size_t k = 0; k < ids_.size(); ++k) {
    const Jacobian with_d = of_b[k] - of_a[k] * Ad.transpose();
    cross[k] = R_world_body_[k] * with_d.template topRows<D>();
    mean += cross[k] / static_cast<double>(ids_.size());
    turned += turns_[k].transpose() * cross[k];
  }
  Jacobian gram = Jacobian::Zero();
  for (size_t k = 0; k < ids_.size(); ++k) {
    const Block rest = cross[k] - mean - turns_[k] * turned;
    gram += rest.transpose() * rest;
  }
  const Jacobian S = marginals_.Relative(a, b) + Sigma_a_b;
  return S.llt().solve(gram).trace() / Total();
}

template class AlignedVariance<SE2>;
template class AlignedVariance<SE3>;

}  // namespace terse::internal
