#pragma once
// In which frame and order a covariance is given. The library's own is body frame, translation first.

#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse {

// Of which small error of the pose T = (R, t), metres and radians, the covariance is, to first order:
//   kBody:      d in T Exp(d).
//   kWorld:     e in Exp(e) T, e = Ad(T) d. It turns about the world's origin.
//   kWorldAxes: [u; w] in (Exp(w) R, t + u), u = R rho, w = R phi: where the body's origin is, and how the body is
//               turned, both along the world's axes. R Sigma R' on every block. What ROS's
//               geometry_msgs/PoseWithCovariance holds, with kTranslationFirst, row by row. In the plane w = phi.
// For a relative pose T_a_b "world" is frame a.
enum class CovarianceFrame { kBody, kWorld, kWorldAxes };
// [rho; phi] or [phi; rho].
enum class TangentOrder { kTranslationFirst, kRotationFirst };

struct CovarianceConvention {
  CovarianceFrame frame = CovarianceFrame::kBody;
  TangentOrder order = TangentOrder::kTranslationFirst;
  bool IsNative() const { return frame == CovarianceFrame::kBody && order == TangentOrder::kTranslationFirst; }
};

// From one convention to another; T is the pose the covariance belongs to. Exact: all are linear in d.
template <class Pose>
typename Pose::Jacobian ConvertCovariance(const typename Pose::Jacobian& covariance, const Pose& T,
                                          const CovarianceConvention& from, const CovarianceConvention& to);
// From body frame, translation first.
template <class Pose>
typename Pose::Jacobian ConvertCovariance(const typename Pose::Jacobian& covariance, const Pose& T,
                                          const CovarianceConvention& to);

// The same for Cov(d_a, d_b).
template <class Pose>
typename Pose::Jacobian ConvertCrossCovariance(const typename Pose::Jacobian& covariance, const Pose& T_a,
                                               const Pose& T_b, const CovarianceConvention& to);

}  // namespace terse
