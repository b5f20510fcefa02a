#include "terse/core/linear_factor.h"

#include <Eigen/Cholesky>

#include "terse/core/residual.h"

namespace terse {
namespace {

// W with W' W = information.
template <int N>
Matrix<N, N> SquareRoot(const Matrix<N, N>& information) {
  return information.llt().matrixU();
}

}  // namespace

template <class Pose>
LinearFactor<Pose::kDof> Linearize(const Factor<Pose>& factor, int first, int second, const Pose& T_world_first,
                                   const Pose& T_world_second) {
  LinearFactor<Pose::kDof> out;
  out.first = first;
  if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor)) {
    const auto e = EvaluateRelative(f->T_from_to, T_world_first, T_world_second);
    const auto W = SquareRoot<Pose::kDof>(f->information);
    out.second = second;
    out.A_first.noalias() = W * e.J_residual_from;
    out.A_second.noalias() = W * e.J_residual_to;
    out.residual.noalias() = W * e.residual;
  } else if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor)) {
    const auto e = EvaluatePrior(f->T_world_body, T_world_first);
    const auto W = SquareRoot<Pose::kDof>(f->information);
    out.A_first.noalias() = W * e.J_residual_pose;
    out.residual.noalias() = W * e.residual;
  } else {
    const auto& p = std::get<PositionPriorFactor<Pose>>(factor);
    const auto e = EvaluatePosition<Pose>(p.p_world, T_world_first);
    const auto W = SquareRoot<Pose::kDim>(p.information);
    out.A_first.template topRows<Pose::kDim>() = W * e.J_residual_pose;
    out.residual.template head<Pose::kDim>() = W * e.residual;
  }
  return out;
}

template <class Pose>
Vector<Pose::kDof> WhitenedResidual(const Factor<Pose>& factor, const Pose& T_world_first, const Pose& T_world_second) {
  if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor)) {
    const typename Pose::Tangent r = (T_world_first * f->T_from_to).Local(T_world_second);
    return SquareRoot<Pose::kDof>(f->information) * r;
  }
  if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor)) {
    return SquareRoot<Pose::kDof>(f->information) * f->T_world_body.Local(T_world_first);
  }
  const auto& f = std::get<PositionPriorFactor<Pose>>(factor);
  Vector<Pose::kDof> out = Vector<Pose::kDof>::Zero();
  out.template head<Pose::kDim>() = SquareRoot<Pose::kDim>(f.information) * (T_world_first.Translation() - f.p_world);
  return out;
}

template <int B>
LinearFactor<B> Anchor(int variable, const Vector<B>& information) {
  LinearFactor<B> out;
  out.first = variable;
  out.A_first = information.cwiseSqrt().asDiagonal();
  return out;
}

template <class Pose>
int Dimension(const Factor<Pose>& factor) {
  return std::holds_alternative<PositionPriorFactor<Pose>>(factor) ? Pose::kDim : Pose::kDof;
}

#define TERSE_INSTANTIATE(Pose)                                                                               \
  template LinearFactor<Pose::kDof> Linearize<Pose>(const Factor<Pose>&, int, int, const Pose&, const Pose&); \
  template LinearFactor<Pose::kDof> Anchor<Pose::kDof>(int, const Vector<Pose::kDof>&);                       \
  template Vector<Pose::kDof> WhitenedResidual<Pose>(const Factor<Pose>&, const Pose&, const Pose&);          \
  template int Dimension<Pose>(const Factor<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
