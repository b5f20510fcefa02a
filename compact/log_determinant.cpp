#include "terse/compact/log_determinant.h"

#include <Eigen/Cholesky>

namespace terse::internal {
namespace {

template <class M>
double Of(const M& S) {
  return 2 * S.llt().matrixLLT().diagonal().array().log().sum();
}

}  // namespace

double LogDeterminant(const Matrix<3, 3>& S) { return Of(S); }
double LogDeterminant(const Matrix<6, 6>& S) { return Of(S); }
double LogDeterminant(const Eigen::MatrixXd& S) { return Of(S); }

}  // namespace terse::internal
