#include "terse/core/odometry_chain.h"

#include <algorithm>
#include <cstdlib>

#include "terse/core/at.h"
#include "terse/core/definite.h"

namespace terse::internal {
namespace {

template <class Pose>
using CovarianceOf = typename Pose::Jacobian;

template <class Pose>
CovarianceOf<Pose> Turned(const Pose& T, const CovarianceOf<Pose>& covariance) {
  const CovarianceOf<Pose> Ad = T.Adjoint();
  return Ad * covariance * Ad.transpose();
}

}  // namespace

template <class Pose>
ForwardEdge<Pose> Forward(std::size_t number, int from, int to, const RelativePoseFactor<Pose>& factor) {
  const Pose& Z = factor.T_from_to;
  const CovarianceOf<Pose> covariance = InverseOfDefinite<Pose::kDof>(factor.information);
  if (from < to) return {number, from, to, Z, covariance};
  return {number, to, from, Z.Inverse(), Turned(Z, covariance)};
}

template <class Pose>
OdometryChain<Pose>::OdometryChain(const std::vector<ForwardEdge<Pose>>& edges, std::size_t poses)
    : T_(poses), covariance_(poses, Covariance::Zero()), stretch_(poses) {
  std::vector<const ForwardEdge<Pose>*> steps(poses);  // to each pose from the one before
  for (const auto& edge : edges) {
    if (edge.last - edge.first == 1 && steps[At(edge.last)] == nullptr) steps[At(edge.last)] = &edge;
  }
  for (std::size_t k = 1; k < poses; ++k) {
    is_whole_ = is_whole_ && steps[k] != nullptr;
    stretch_[k] = stretch_[k - 1] + (steps[k] != nullptr ? 0 : 1);
    T_[k] = steps[k] != nullptr ? T_[k - 1] * steps[k]->T_first_last : T_[k - 1];
    covariance_[k] = covariance_[k - 1];
    if (steps[k] != nullptr) covariance_[k] += Turned(T_[k], steps[k]->covariance);
  }
}

template <class Pose>
bool OdometryChain<Pose>::Joins(int from, int to) const {
  return stretch_[At(from)] == stretch_[At(to)];
}

template <class Pose>
Pose OdometryChain<Pose>::Way(int from, int to) const {
  return T_[At(from)].Inverse() * T_[At(to)];
}

template <class Pose>
typename Pose::Jacobian OdometryChain<Pose>::CovarianceOf(int from, int to) const {
  const auto [earlier, later] = std::minmax(from, to);
  return Turned(T_[At(to)].Inverse(), Covariance(covariance_[At(later)] - covariance_[At(earlier)]));
}

template <class Pose>
double CycleError<Pose>::Squared() const {
  return MahalanobisSquared<Pose::kDof>(covariance, error);
}

template <class Pose>
std::optional<CycleError<Pose>> CycleOf(const ForwardEdge<Pose>& first, const ForwardEdge<Pose>& second,
                                        const OdometryChain<Pose>& odometry) {
  const ForwardEdge<Pose>&a = first, &b = second;
  if (!odometry.Joins(a.first, b.first) || !odometry.Joins(a.last, b.last)) return std::nullopt;
  // From the second loop's start to the first loop's, along that, and to the second one's end.
  const Pose end = odometry.Way(a.last, b.last), along = a.T_first_last * end;
  const Pose T_first_last = odometry.Way(b.first, a.first) * along;
  return CycleError<Pose>{(b.T_first_last.Inverse() * T_first_last).Log(),
                          b.covariance + odometry.CovarianceOf(a.last, b.last) + Turned(end.Inverse(), a.covariance) +
                              Turned(along.Inverse(), odometry.CovarianceOf(b.first, a.first))};
}

template <class Pose>
std::optional<CycleError<Pose>> CycleOf(const ForwardEdge<Pose>& loop, const OdometryChain<Pose>& odometry) {
  if (!odometry.Joins(loop.first, loop.last)) return std::nullopt;
  return CycleError<Pose>{(loop.T_first_last.Inverse() * odometry.Way(loop.first, loop.last)).Log(),
                          loop.covariance + odometry.CovarianceOf(loop.first, loop.last)};
}

#define TERSE_INSTANTIATE(Pose)                                                                              \
  template ForwardEdge<Pose> Forward<Pose>(std::size_t, int, int, const RelativePoseFactor<Pose>&);          \
  template class OdometryChain<Pose>;                                                                        \
  template struct CycleError<Pose>;                                                                          \
  template std::optional<CycleError<Pose>> CycleOf<Pose>(const ForwardEdge<Pose>&, const ForwardEdge<Pose>&, \
                                                         const OdometryChain<Pose>&);                        \
  template std::optional<CycleError<Pose>> CycleOf<Pose>(const ForwardEdge<Pose>&, const OdometryChain<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
