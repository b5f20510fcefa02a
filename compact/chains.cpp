#include "chains.h"

#include <Eigen/Cholesky>

#include "terse/core/decompositions.h"
#include "terse/core/definite.h"

namespace terse::internal {

template <class Pose>
RelativePoseFactor<Pose> Measurement(PoseId from, PoseId to, const UncertainPose<Pose>& T_from_to,
                                     CompositionOrder order) {
  const typename Pose::Jacobian covariance =
      order == CompositionOrder::kFirst ? T_from_to.covariance : RetractCovariance(T_from_to);
  const typename Pose::Jacobian information = InverseOfDefinite<Pose::kDof>(covariance);
  return {from, to, T_from_to.T_a_b, (information + information.transpose()) / 2};
}

template <class Pose>
std::optional<UncertainPose<Pose>> Behind(const UncertainPose<Pose>& T_start_middle,
                                          const UncertainPose<Pose>& T_start_end) {
  using Jacobian = typename Pose::Jacobian;
  UncertainPose<Pose> out;
  out.T_a_b = T_start_middle.T_a_b.Inverse() * T_start_end.T_a_b;
  const Jacobian A = out.T_a_b.Inverse().Adjoint();
  const Jacobian before = A * T_start_middle.covariance * A.transpose();
  const Jacobian rest = T_start_end.covariance - before;
  out.covariance = (rest + rest.transpose()) / 2;
  // As seen by the whole: each direction keeps a share of its variance that is no rounding.
  const Eigen::LLT<Jacobian> whole(T_start_end.covariance);
  if (whole.info() != Eigen::Success) return std::nullopt;
  const Jacobian left = whole.matrixL().solve(out.covariance);
  const Jacobian share = whole.matrixL().solve(left.transpose());
  if (!(SymmetricEigenvalues<Pose::kDof>((share + share.transpose()) / 2)[0] > 1e-9)) return std::nullopt;
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                                                                      \
  template RelativePoseFactor<Pose> Measurement<Pose>(PoseId, PoseId, const UncertainPose<Pose>&, CompositionOrder); \
  template std::optional<UncertainPose<Pose>> Behind<Pose>(const UncertainPose<Pose>&, const UncertainPose<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
