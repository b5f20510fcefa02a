#pragma once
// A factor's linearisation, a value of its own apart from any solver.
//
// The factor contributes |A_first d_first + A_second d_second + residual|^2 to the cost, whitened: W' W = Omega.
// A factor with fewer scalars than a pose has dof fills the remaining rows with zeros.

#include "terse/core/pose_graph.h"

namespace terse {

template <int B>
struct LinearFactor {
  int first = -1, second = -1;  // variables; second is -1 for a prior
  Matrix<B, B> A_first = Matrix<B, B>::Zero();
  Matrix<B, B> A_second = Matrix<B, B>::Zero();
  Vector<B> residual = Vector<B>::Zero();
};

// A_first d_first + A_second d_second: what the perturbations d, B scalars per variable, do to the residual.
template <int B, class Scalars>
Vector<B> ResidualChange(const LinearFactor<B>& f, const Scalars& d) {
  const auto block = [&](int v) {
    return Eigen::Map<const Vector<B>>(d.data() + static_cast<std::size_t>(v) * static_cast<std::size_t>(B));
  };
  Vector<B> change = f.A_first * block(f.first);
  if (f.second >= 0) change += f.A_second * block(f.second);
  return change;
}

// Linearises at the given values. `T_world_second` is ignored by priors.
template <class Pose>
LinearFactor<Pose::kDof> Linearize(const Factor<Pose>& factor, int first, int second, const Pose& T_world_first,
                                   const Pose& T_world_second);

// The residual alone, not whitened; a position prior's ends in zeros.
template <class Pose>
Vector<Pose::kDof> Residual(const Factor<Pose>& factor, const Pose& T_world_first, const Pose& T_world_second);

// W with W' W = Omega, upper triangular; a position prior's is in the upper left corner, zero elsewhere.
template <class Pose>
Matrix<Pose::kDof, Pose::kDof> SquareRootInformation(const Factor<Pose>& factor);

// The same with the factor's SquareRootInformation or a multiple of it (W is taken to be upper triangular), for those
// who linearise it again and again.
template <class Pose>
LinearFactor<Pose::kDof> Linearize(const Factor<Pose>& factor, const Matrix<Pose::kDof, Pose::kDof>& W, int first,
                                   int second, const Pose& T_world_first, const Pose& T_world_second);

// A proximal anchor: `information` on every tangent direction of `variable`, with zero residual at any value.
template <int B>
LinearFactor<B> Anchor(int variable, const Vector<B>& information);

// The scalars a factor measures: the rows of its residual.
template <class Pose>
int Dimension(const Factor<Pose>& factor);

}  // namespace terse
