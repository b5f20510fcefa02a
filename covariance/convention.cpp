#include "terse/covariance/convention.h"

namespace terse {
namespace {

// The rotation of T on both blocks of a tangent vector.
SE2::Jacobian BothTurned(const SE2& T) {
  SE2::Jacobian out = SE2::Jacobian::Identity();
  out.topLeftCorner<2, 2>() = T.Rotation();
  return out;
}

SE3::Jacobian BothTurned(const SE3& T) {
  SE3::Jacobian out = SE3::Jacobian::Zero();
  out.topLeftCorner<3, 3>() = out.bottomRightCorner<3, 3>() = T.Rotation().Rotation();
  return out;
}

// What maps d in T Exp(d) to the error that the frame is about, translation first.
template <class Pose>
typename Pose::Jacobian FromBody(const Pose& T, CovarianceFrame frame) {
  if (frame == CovarianceFrame::kWorld) return T.Adjoint();
  if (frame == CovarianceFrame::kWorldAxes) return BothTurned(T);
  return Pose::Jacobian::Identity();
}

template <class Pose>
typename Pose::Jacobian ToBody(const Pose& T, CovarianceFrame frame) {
  if (frame == CovarianceFrame::kWorld) return T.Inverse().Adjoint();
  if (frame == CovarianceFrame::kWorldAxes) return BothTurned(T).transpose();
  return Pose::Jacobian::Identity();
}

// What maps a tangent vector, translation first, to the order.
template <class Pose>
typename Pose::Jacobian Reordering(TangentOrder order) {
  using Jacobian = typename Pose::Jacobian;
  if (order == TangentOrder::kTranslationFirst) return Jacobian::Identity();
  constexpr int kRotation = Pose::kDof - Pose::kDim;
  Jacobian swapped = Jacobian::Zero();
  swapped.template topRightCorner<kRotation, kRotation>().setIdentity();
  swapped.template bottomLeftCorner<Pose::kDim, Pose::kDim>().setIdentity();
  return swapped;
}

// What maps the library's tangent vector of T to the wanted one.
template <class Pose>
typename Pose::Jacobian Transformation(const Pose& T, const CovarianceConvention& to) {
  return Reordering<Pose>(to.order) * FromBody(T, to.frame);
}

template <class Jacobian>
Jacobian Symmetric(const Jacobian& M) {
  return (M + M.transpose()) / 2;  // the product may differ in the last bits
}

}  // namespace

template <class Pose>
typename Pose::Jacobian ConvertCovariance(const typename Pose::Jacobian& covariance, const Pose& T,
                                          const CovarianceConvention& from, const CovarianceConvention& to) {
  using Jacobian = typename Pose::Jacobian;
  if (from.frame == to.frame && from.order == to.order) return covariance;
  Jacobian A = Reordering<Pose>(from.order).transpose();
  if (from.frame != to.frame) A = FromBody(T, to.frame) * ToBody(T, from.frame) * A;
  A = Reordering<Pose>(to.order) * A;
  return Symmetric<Jacobian>(A * covariance * A.transpose());
}

template <class Pose>
typename Pose::Jacobian ConvertCovariance(const typename Pose::Jacobian& covariance, const Pose& T,
                                          const CovarianceConvention& to) {
  return Symmetric<typename Pose::Jacobian>(ConvertCrossCovariance(covariance, T, T, to));
}

template <class Pose>
typename Pose::Jacobian ConvertCrossCovariance(const typename Pose::Jacobian& covariance, const Pose& T_a,
                                               const Pose& T_b, const CovarianceConvention& to) {
  if (to.IsNative()) return covariance;
  return Transformation(T_a, to) * covariance * Transformation(T_b, to).transpose();
}

#define TERSE_INSTANTIATE(Pose)                                                                                     \
  template Pose::Jacobian ConvertCovariance<Pose>(const Pose::Jacobian&, const Pose&, const CovarianceConvention&,  \
                                                  const CovarianceConvention&);                                     \
  template Pose::Jacobian ConvertCovariance<Pose>(const Pose::Jacobian&, const Pose&, const CovarianceConvention&); \
  template Pose::Jacobian ConvertCrossCovariance<Pose>(const Pose::Jacobian&, const Pose&, const Pose&,             \
                                                       const CovarianceConvention&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
