#include "terse/core/linear_factor.h"

#include <Eigen/Cholesky>

#include "terse/core/residual.h"

namespace terse {
namespace {

// W J. Of SE(3) the lower left 3x3 blocks of both are zero.
void Whiten(const Matrix<3, 3>& W, const Matrix<3, 3>& J, Matrix<3, 3>& out) { out.noalias() = W * J; }
void Whiten(const Matrix<6, 6>& W, const Matrix<6, 6>& J, Matrix<6, 6>& out) {
  const auto top = W.topLeftCorner<3, 3>();
  out.topLeftCorner<3, 3>().noalias() = top * J.topLeftCorner<3, 3>();
  out.topRightCorner<3, 3>().noalias() = top * J.topRightCorner<3, 3>();
  out.topRightCorner<3, 3>().noalias() += W.topRightCorner<3, 3>() * J.bottomRightCorner<3, 3>();
  out.bottomRightCorner<3, 3>().noalias() = W.bottomRightCorner<3, 3>() * J.bottomRightCorner<3, 3>();
}

}  // namespace

template <class Pose>
Matrix<Pose::kDof, Pose::kDof> SquareRootInformation(const Factor<Pose>& factor) {
  constexpr int B = Pose::kDof, D = Pose::kDim;
  if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor)) return f->information.llt().matrixU();
  if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor)) return f->information.llt().matrixU();
  Matrix<B, B> W = Matrix<B, B>::Zero();
  W.template topLeftCorner<D, D>() = std::get<PositionPriorFactor<Pose>>(factor).information.llt().matrixU();
  return W;
}

template <class Pose>
LinearFactor<Pose::kDof> Linearize(const Factor<Pose>& factor, const Matrix<Pose::kDof, Pose::kDof>& W, int first,
                                   int second, const Pose& T_world_first, const Pose& T_world_second) {
  constexpr int D = Pose::kDim;
  LinearFactor<Pose::kDof> out;
  out.first = first;
  if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor)) {
    const auto e = EvaluateRelative(f->T_from_to, T_world_first, T_world_second);
    out.second = second;
    Whiten(W, e.J_residual_from, out.A_first);
    Whiten(W, e.J_residual_to, out.A_second);
    out.residual.noalias() = W * e.residual;
  } else if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor)) {
    const auto e = EvaluatePrior(f->T_world_body, T_world_first);
    Whiten(W, e.J_residual_pose, out.A_first);
    out.residual.noalias() = W * e.residual;
  } else {
    const auto e = EvaluatePosition(std::get<PositionPriorFactor<Pose>>(factor), T_world_first);
    out.A_first.template topRows<D>() = W.template topLeftCorner<D, D>() * e.J_residual_pose;
    out.residual.template head<D>() = W.template topLeftCorner<D, D>() * e.residual;
  }
  return out;
}

template <class Pose>
LinearFactor<Pose::kDof> Linearize(const Factor<Pose>& factor, int first, int second, const Pose& T_world_first,
                                   const Pose& T_world_second) {
  return Linearize(factor, SquareRootInformation(factor), first, second, T_world_first, T_world_second);
}

template <class Pose>
Vector<Pose::kDof> Residual(const Factor<Pose>& factor, const Pose& T_world_first, const Pose& T_world_second) {
  if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor)) {
    return RelativeError(f->T_from_to, T_world_first, T_world_second);
  }
  if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor)) return f->T_world_body.Local(T_world_first);
  Vector<Pose::kDof> out = Vector<Pose::kDof>::Zero();
  const auto& prior = std::get<PositionPriorFactor<Pose>>(factor);
  out.template head<Pose::kDim>() = T_world_first * prior.p_body - prior.p_world;
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

#define TERSE_INSTANTIATE(Pose)                                                                                      \
  template Matrix<Pose::kDof, Pose::kDof> SquareRootInformation<Pose>(const Factor<Pose>&);                          \
  template LinearFactor<Pose::kDof> Linearize<Pose>(const Factor<Pose>&, int, int, const Pose&, const Pose&);        \
  template LinearFactor<Pose::kDof> Linearize<Pose>(const Factor<Pose>&, const Matrix<Pose::kDof, Pose::kDof>&, int, \
                                                    int, const Pose&, const Pose&);                                  \
  template LinearFactor<Pose::kDof> Anchor<Pose::kDof>(int, const Vector<Pose::kDof>&);                              \
  template Vector<Pose::kDof> Residual<Pose>(const Factor<Pose>&, const Pose&, const Pose&);                         \
  template int Dimension<Pose>(const Factor<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
