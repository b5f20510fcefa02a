#pragma once
// ln det of a symmetric positive definite matrix; NaN of another.

#include "terse/lie/types.h"

namespace terse::internal {

double LogDeterminant(const Matrix<3, 3>& S);
double LogDeterminant(const Matrix<6, 6>& S);
double LogDeterminant(const Eigen::MatrixXd& S);

}  // namespace terse::internal
