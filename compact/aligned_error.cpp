#include "terse/compact/aligned_error.h"

#include <Eigen/QR>
#include <cmath>

#include "terse/core/at.h"
#include "terse/covariance/marginals.h"

namespace terse {
namespace {

using internal::At;

// Columns: an orthonormal basis of what rigid motions do to the positions, stacked.
template <int D>
MatrixX RigidMotions(const std::vector<Vector<D>>& positions) {
  const int n = static_cast<int>(positions.size()), turns = D == 2 ? 1 : 3;
  Vector<D> centre = Vector<D>::Zero();
  for (const Vector<D>& p : positions) centre += p / n;
  MatrixX motions = MatrixX::Zero(D * n, D + turns);
  for (int i = 0; i < n; ++i) {
    auto rows = motions.middleRows(D * i, D);
    const Vector<D> p = positions[At(i)] - centre;
    rows.template leftCols<D>().setIdentity();
    if constexpr (D == 2) {
      rows.col(D) = Vector<2>(-p.y(), p.x());
    } else {
      for (int axis = 0; axis < 3; ++axis) rows.col(D + axis) = Vector<3>::Unit(axis).cross(p);
    }
  }
  // Positions on a line cannot be turned about it.
  const Eigen::ColPivHouseholderQR<MatrixX> qr(motions);
  return qr.householderQ() * MatrixX::Identity(D * n, qr.rank());
}

}  // namespace

template <class Pose>
std::optional<double> ExpectedAlignedError(const PoseGraph<Pose>& map, const std::vector<Pose>& T_world_body,
                                           std::vector<LinearFactor<Pose::kDof>> factors) {
  constexpr int B = Pose::kDof, D = Pose::kDim;
  BlockCholesky<B> cholesky;
  typename BlockCholesky<B>::Changes changes;
  changes.new_variables = static_cast<int>(T_world_body.size());
  changes.added = std::move(factors);
  if (!cholesky.Update(changes).ok) return std::nullopt;
  const Marginals<Pose> marginals(map, T_world_body, std::move(cholesky));
  double sum = 0;
  for (const typename Pose::Jacobian& Sigma : marginals.AllMarginals()) {
    sum += Sigma.template topLeftCorner<D, D>().trace();  // in the body frame, which a trace does not depend on
  }
  std::vector<Vector<D>> positions;
  for (const Pose& T : T_world_body) positions.push_back(T.Translation());
  const MatrixX motions = RigidMotions<D>(positions);
  // Row k of the terms' sum is q_k' d, d the positions' perturbations in the world.
  std::vector<typename PoseMarginals<Pose>::Term> terms;
  for (int i = 0; i < static_cast<int>(T_world_body.size()); ++i) {
    const Pose& T = T_world_body[At(i)];
    terms.push_back({map.Poses()[At(i)].id, Pose::Jacobian::Zero()});
    for (int k = 0; k < motions.cols(); ++k) {
      const Vector<D> moved = T.Translation() + motions.template block<D, 1>(D * i, k);
      terms.back().A.row(k).template head<D>() = (T.Inverse() * moved).transpose();
    }
  }
  sum -= marginals.Combination(terms).trace();
  return std::isfinite(sum) && sum > 0 ? std::optional<double>(sum) : std::nullopt;
}

template std::optional<double> ExpectedAlignedError<SE2>(const PoseGraph<SE2>&, const std::vector<SE2>&,
                                                         std::vector<LinearFactor<3>>);
template std::optional<double> ExpectedAlignedError<SE3>(const PoseGraph<SE3>&, const std::vector<SE3>&,
                                                         std::vector<LinearFactor<6>>);

}  // namespace terse
