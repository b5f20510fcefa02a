#include "terse/covariance/information_probe.h"

#include <Eigen/Cholesky>
#include <cmath>

#include "terse/core/definite.h"
#include "terse/core/front_paths.h"
#include "terse/core/linear_factor.h"
#include "terse/core/random.h"

namespace terse::internal {
namespace {

template <int B>
using Rows = Eigen::Matrix<double, B, Eigen::Dynamic, Eigen::RowMajor>;

template <int B>
Eigen::Map<Rows<B>> RowsOf(std::vector<double>& X, int variable, int stride) {
  return {X.data() + At(variable) * B * At(stride), B, stride};
}

// L^-1 of the blocks of the covariance that the information states, L L' being the block: whitens one block alone.
template <class Pose>
struct BlockWhitening {
  Matrix<Pose::kDim, Pose::kDim> translation;
  Matrix<Pose::kDof - Pose::kDim, Pose::kDof - Pose::kDim> rotation;
};

template <class Pose>
BlockWhitening<Pose> MakeBlockWhitening(const typename Pose::Jacobian& information) {
  constexpr int kDim = Pose::kDim, kTurn = Pose::kDof - Pose::kDim;
  const typename Pose::Jacobian covariance = InverseOfDefinite<Pose::kDof>(information);
  const Matrix<kDim, kDim> t = covariance.template topLeftCorner<kDim, kDim>();
  const Matrix<kTurn, kTurn> r = covariance.template bottomRightCorner<kTurn, kTurn>();
  return {t.llt().matrixL().solve(Matrix<kDim, kDim>::Identity()),
          r.llt().matrixL().solve(Matrix<kTurn, kTurn>::Identity())};
}

template <class Pose, class Residual>
BlockSquares SquaresWith(const BlockWhitening<Pose>& whitening, const Residual& residual) {
  constexpr int kDim = Pose::kDim, kTurn = Pose::kDof - Pose::kDim;
  return {(whitening.translation * residual.template head<kDim>()).squaredNorm() / kDim,
          (whitening.rotation * residual.template tail<kTurn>()).squaredNorm() / kTurn};
}

}  // namespace

template <class Pose>
BlockSquares SquaresOf(const typename Pose::Tangent& residual, const typename Pose::Jacobian& information) {
  return SquaresWith<Pose>(MakeBlockWhitening<Pose>(information), residual);
}

template <class Pose>
std::vector<std::vector<BlockSquares>> DrawResiduals(const std::vector<ProbeTerm<Pose>>& terms,
                                                     const std::vector<Pose>& T_world_body,
                                                     const BlockCholesky<Pose::kDof>& factor, int draws,
                                                     std::uint64_t seed) {
  constexpr int B = Pose::kDof;
  const int stride = Stride(draws);
  std::vector<double> X(At(factor.Variables()) * B * At(stride), 0.0);
  const auto noise_of = [&](Random& random) {
    Rows<B> noise(B, stride);
    for (int k = 0; k < B; ++k) {
      for (int d = 0; d < stride; ++d) noise(k, d) = random.Normal();
    }
    return noise;
  };
  const auto linearised = [&](const ProbeTerm<Pose>& t) {
    return Linearize(Factor<Pose>(t.factor), t.first, t.second, T_world_body[At(t.first)], T_world_body[At(t.second)]);
  };
  Random random(seed);
  for (const auto& t : terms) {
    const LinearFactor<B> linear = linearised(t);
    const Rows<B> noise = t.weight * noise_of(random);
    RowsOf<B>(X, t.first, stride) -= linear.A_first.transpose() * noise;
    RowsOf<B>(X, t.second, stride) -= linear.A_second.transpose() * noise;
  }
  SolveDense<B>(factor.Tree(), X, stride);
  Random again(seed);
  std::vector<std::vector<BlockSquares>> out(terms.size(), std::vector<BlockSquares>(At(draws)));
  for (std::size_t k = 0; k < terms.size(); ++k) {
    const ProbeTerm<Pose>& t = terms[k];
    const LinearFactor<B> linear = linearised(t);
    Rows<B> left = noise_of(again);
    left += linear.A_first * RowsOf<B>(X, t.first, stride) + linear.A_second * RowsOf<B>(X, t.second, stride);
    const Matrix<B, B> W = SquareRootInformation(Factor<Pose>(t.factor));
    W.template triangularView<Eigen::Upper>().solveInPlace(left);
    const BlockWhitening<Pose> whitening = MakeBlockWhitening<Pose>(t.factor.information);
    for (int d = 0; d < draws; ++d) out[k][At(d)] = SquaresWith<Pose>(whitening, left.col(d));
  }
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                                                             \
  template BlockSquares SquaresOf<Pose>(const Pose::Tangent&, const Pose::Jacobian&);                       \
  template std::vector<std::vector<BlockSquares>> DrawResiduals<Pose>(                                      \
      const std::vector<ProbeTerm<Pose>>&, const std::vector<Pose>&, const BlockCholesky<Pose::kDof>&, int, \
      std::uint64_t);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
