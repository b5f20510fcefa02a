#include "terse/core/definite.h"

#include <Eigen/Cholesky>
#include <limits>

namespace terse {

template <int N>
bool IsDefinite(const Eigen::Matrix<double, N, N>& M) {
  return M.llt().info() == Eigen::Success;
}

template <int N>
Eigen::Matrix<double, N, N> LowerCholesky(const Eigen::Matrix<double, N, N>& M) {
  return M.llt().matrixL();
}

template <int N>
Eigen::Matrix<double, N, N> InverseOfDefinite(const Eigen::Matrix<double, N, N>& M) {
  return M.llt().solve(Eigen::Matrix<double, N, N>::Identity());
}

template <int N>
Eigen::Matrix<double, N, 1> SolveDefinite(const Eigen::Matrix<double, N, N>& M, const Eigen::Matrix<double, N, 1>& b) {
  return M.llt().solve(b);
}

template <int N>
double MahalanobisSquared(const Eigen::Matrix<double, N, N>& covariance, const Eigen::Matrix<double, N, 1>& error) {
  const Eigen::LLT<Eigen::Matrix<double, N, N>> llt(covariance);
  if (llt.info() != Eigen::Success) return std::numeric_limits<double>::infinity();
  return llt.matrixL().solve(error).squaredNorm();
}

#define TERSE_INSTANTIATE(N)                                                                     \
  template bool IsDefinite<N>(const Eigen::Matrix<double, N, N>&);                               \
  template Eigen::Matrix<double, N, N> LowerCholesky<N>(const Eigen::Matrix<double, N, N>&);     \
  template Eigen::Matrix<double, N, N> InverseOfDefinite<N>(const Eigen::Matrix<double, N, N>&); \
  template Eigen::Matrix<double, N, 1> SolveDefinite<N>(const Eigen::Matrix<double, N, N>&,      \
                                                        const Eigen::Matrix<double, N, 1>&);     \
  template double MahalanobisSquared<N>(const Eigen::Matrix<double, N, N>&, const Eigen::Matrix<double, N, 1>&);
TERSE_INSTANTIATE(1)
TERSE_INSTANTIATE(2)
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse
