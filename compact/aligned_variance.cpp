#include "terse/compact/aligned_variance.h"

#include <algorithm>

#include "terse/core/at.h"

namespace terse::internal {

template <class Pose>
void AlignedVariance<Pose>::Refresh() {
  const std::vector<Pose>& points = solver_.LinearizationPoints();
  if (version_ == solver_.Cholesky().Version() && ids_.size() == points.size()) return;
  version_ = solver_.Cholesky().Version();
  total_ = -1;
  ids_.clear();
  for (const auto& node : solver_.Graph().Poses()) ids_.push_back(node.id);
  motions_ = RigidMotions<Pose>(points);
}

template <class Pose>
double AlignedVariance<Pose>::Total() {
  Refresh();
  if (total_ >= 0) return total_;
  double sum = 0;
  for (const Jacobian& Sigma : marginals_.MarginalsOf(ids_)) {
    sum += Sigma.template topLeftCorner<Pose::kDim, Pose::kDim>().trace();  // in the body frame: a trace does not care
  }
  total_ = std::max(0.0, sum - marginals_.Combination(motions_.Terms(ids_)).trace());
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
  std::vector<typename RigidMotions<Pose>::Block> cross;
  cross.reserve(ids_.size());
  for (std::size_t k = 0; k < ids_.size(); ++k)
    cross.push_back(motions_.ToWorld(k, of_b[k] - of_a[k] * Ad.transpose()));
  motions_.TakeOut(cross);
  Jacobian gram = Jacobian::Zero();
  for (const auto& rest : cross) gram += rest.transpose() * rest;
  const Jacobian S = marginals_.Relative(a, b) + Sigma_a_b;
  return S.llt().solve(gram).trace() / Total();
}

template class AlignedVariance<SE2>;
template class AlignedVariance<SE3>;

}  // namespace terse::internal
