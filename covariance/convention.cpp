#include "terse/covariance/convention.h"

namespace terse {
namespace {

// What maps the library's tangent vector of T to the wanted one.
template <class Pose>
typename Pose::Jacobian Transformation(const Pose& T, const CovarianceConvention& to) {
  using Jacobian = typename Pose::Jacobian;
  const Jacobian A = to.frame == CovarianceFrame::kWorld ? Jacobian(T.Adjoint()) : Jacobian(Jacobian::Identity());
  if (to.order == TangentOrder::kTranslationFirst) return A;
  constexpr int kRotation = Pose::kDof - Pose::kDim;
  Jacobian swapped;
  swapped.template topRows<kRotation>() = A.template bottomRows<kRotation>();
  swapped.template bottomRows<Pose::kDim>() = A.template topRows<Pose::kDim>();
  return swapped;
}

}  // namespace

template <class Pose>
typename Pose::Jacobian ConvertCovariance(const typename Pose::Jacobian& covariance, const Pose& T,
                                          const CovarianceConvention& to) {
  const typename Pose::Jacobian out = ConvertCrossCovariance(covariance, T, T, to);
  return (out + out.transpose()) / 2;  // the product may differ in the last bits
}

template <class Pose>
typename Pose::Jacobian ConvertCrossCovariance(const typename Pose::Jacobian& covariance, const Pose& T_a,
                                               const Pose& T_b, const CovarianceConvention& to) {
  if (to.IsNative()) return covariance;
  return Transformation(T_a, to) * covariance * Transformation(T_b, to).transpose();
}

#define TERSE_INSTANTIATE(Pose)                                                                                     \
  template Pose::Jacobian ConvertCovariance<Pose>(const Pose::Jacobian&, const Pose&, const CovarianceConvention&); \
  template Pose::Jacobian ConvertCrossCovariance<Pose>(const Pose::Jacobian&, const Pose&, const Pose&,             \
                                                       const CovarianceConvention&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
