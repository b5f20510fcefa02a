#include "terse/compact/rigid_motions.h"

#include <cmath>

#include "terse/core/decompositions.h"

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
RigidMotions<Pose>::RigidMotions(const std::vector<Pose>& T_world_body) {
  Vector<D> middle = Vector<D>::Zero();
  for (const Pose& T : T_world_body) middle += T.Translation() / static_cast<double>(T_world_body.size());
  using Gram = Eigen::Matrix<double, kTurns, kTurns>;
  Gram gram = Gram::Zero();
  for (const Pose& T : T_world_body) {
    R_world_body_.push_back(RotationOf(T));
    turns_.push_back(TurnOf(Vector<D>(T.Translation() - middle)));
    gram += turns_.back().transpose() * turns_.back();
  }
  // Positions on a line cannot be turned about it.
  const SymmetricEigen<kTurns> eigen = DecomposeSymmetric(gram);
  const double most = eigen.values[kTurns - 1];
  Gram whiten = eigen.vectors;
  for (int axis = 0; axis < kTurns; ++axis) {
    const double squared = eigen.values[axis];
    whiten.col(axis) *= squared > 1e-9 * most && squared > 0 ? 1 / std::sqrt(squared) : 0;
  }
  for (auto& turn : turns_) turn = (turn * whiten).eval();
}

template <class Pose>
std::vector<typename PoseMarginals<Pose>::Term> RigidMotions<Pose>::Terms(const std::vector<PoseId>& ids) const {
  std::vector<typename PoseMarginals<Pose>::Term> terms;
  for (std::size_t k = 0; k < ids.size(); ++k) {
    typename Pose::Jacobian A = Pose::Jacobian::Zero();
    A.template block<D, D>(0, 0) = R_world_body_[k] / std::sqrt(static_cast<double>(ids.size()));
    A.template block<kTurns, D>(D, 0) = turns_[k].transpose() * R_world_body_[k];
    terms.push_back({ids[k], A});
  }
  return terms;
}

template <class Pose>
void RigidMotions<Pose>::TakeOut(std::vector<Block>& displacements) const {
  Block mean = Block::Zero();
  Eigen::Matrix<double, kTurns, B> turned = Eigen::Matrix<double, kTurns, B>::Zero();
  for (std::size_t k = 0; k < displacements.size(); ++k) {
    mean += displacements[k] / static_cast<double>(displacements.size());
    turned += turns_[k].transpose() * displacements[k];
  }
  for (std::size_t k = 0; k < displacements.size(); ++k) displacements[k] -= mean + turns_[k] * turned;
}

template class RigidMotions<SE2>;
template class RigidMotions<SE3>;

}  // namespace terse::internal
