#include "dense_kernels.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>

namespace terse::internal {

using Eigen::MatrixXd;

int FactorPanel(double* panel, int rows, int pivots) {
  Eigen::Map<MatrixXd> all(panel, rows, pivots);
  auto top = all.topRows(pivots);
  // The blocked factorisation reports only that it failed; the column is found below.
  Eigen::Ref<MatrixXd, 0, Eigen::OuterStride<>> in_place(top);
  Eigen::LLT<Eigen::Ref<MatrixXd, 0, Eigen::OuterStride<>>> llt(in_place);
  for (int k = 0; k < pivots; ++k) {
    const double pivot = all(k, k);
    if (!(pivot > 0) || !(pivot < 1e300)) return k;
  }
  if (llt.info() != Eigen::Success) return 0;
  if (rows > pivots) {
    auto bottom = all.bottomRows(rows - pivots);
    top.transpose().triangularView<Eigen::Upper>().solveInPlace<Eigen::OnTheRight>(bottom);
  }
  return -1;
}

void SubtractOuter(double* update, int n, const double* panel, int rows, int pivots) {
  Eigen::Map<MatrixXd> U(update, n, n);
  const Eigen::Map<const MatrixXd> all(panel, rows, pivots);
  const auto S = all.bottomRows(n);
  if (n < 24 && pivots < 24) {
    for (int j = 0; j < n; ++j) {
      U.col(j).tail(n - j).noalias() -= S.bottomRows(n - j).lazyProduct(S.row(j).transpose());
    }
    return;
  }
  U.selfadjointView<Eigen::Lower>().rankUpdate(S, -1);
}

}  // namespace terse::internal
