#include "terse/compact/information.h"

#include <Eigen/Cholesky>
#include <cmath>

namespace terse {

template <int B>
double InformationGain(const Matrix<B, B>& Sigma_d, const Matrix<B, B>& Sigma_y) {
  // ln |Sigma_y + Sigma_d| - ln |Sigma_y|, from the Cholesky diagonals.
  const auto half_log_det = [](const Matrix<B, B>& S) {
    const Eigen::LLT<Matrix<B, B>> llt(S);
    double sum = 0;
    for (int k = 0; k < B; ++k) sum += std::log(llt.matrixLLT()(k, k));
    return sum;
  };
  return half_log_det(Sigma_y + Sigma_d) - half_log_det(Sigma_y);
}

template double InformationGain<3>(const Matrix<3, 3>&, const Matrix<3, 3>&);
template double InformationGain<6>(const Matrix<6, 6>&, const Matrix<6, 6>&);

}  // namespace terse
