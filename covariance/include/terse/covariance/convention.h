#pragma once
// In which frame and order a covariance is given. The library's own is body frame, translation first.

#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse {

// kBody: of d in T Exp(d). kWorld: of e in Exp(e) T, e = Ad(T) d. For a relative pose T_a_b "world" is frame a.
enum class CovarianceFrame { kBody, kWorld };
// [rho; phi] or [phi; rho].
enum class TangentOrder { kTranslationFirst, kRotationFirst };

struct CovarianceConvention {
  CovarianceFrame frame = CovarianceFrame::kBody;
  TangentOrder order = TangentOrder::kTranslationFirst;
  bool IsNative() const { return frame == CovarianceFrame::kBody && order == TangentOrder::kTranslationFirst; }
};

// From body frame, translation first, to another convention; T is the pose the covariance belongs to.
template <class Pose>
typename Pose::Jacobian ConvertCovariance(const typename Pose::Jacobian& covariance, const Pose& T,
                                          const CovarianceConvention& to);

// The same for Cov(d_a, d_b).
template <class Pose>
typename Pose::Jacobian ConvertCrossCovariance(const typename Pose::Jacobian& covariance, const Pose& T_a,
                                               const Pose& T_b, const CovarianceConvention& to);

}  // namespace terse
