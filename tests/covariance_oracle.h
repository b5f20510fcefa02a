#pragma once
// Covariances beside CHOLMOD's inverse of the same linear system.

#include <algorithm>
#include <cmath>
#include <vector>

#include "bench/cholmod_matrix.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse::testing {

// Indices 0 .. size - 1 at equal distances, both ends among them; all if there are no more than `count`.
inline std::vector<int> EvenlySpread(int size, int count) {
  std::vector<int> out;
  if (size <= count) count = size;
  for (int k = 0; k < count; ++k)
    out.push_back(count == 1 ? size - 1 : static_cast<int>(long{k} * (size - 1) / (count - 1)));
  return out;
}

// The largest relative errors (Frobenius) of `count` diagonal blocks and of the whole newest block column, measured by
// CHOLMOD's inverse of A'A, refined in extended precision: of the kept blocks, and of CHOLMOD's inverse without
// refinement, which shows what is lost to forming and factoring H in double precision.
struct InverseErrors {
  double kept = 0, cholmod = 0;

  void Widen(const InverseErrors& other) {
    kept = std::max(kept, other.kept);
    cholmod = std::max(cholmod, other.cholmod);
  }
};

template <class Pose>
InverseErrors CompareWithCholmod(const IncrementalSolver<Pose>& solver, const IncrementalMarginals<Pose>& marginals,
                                 int count) {
  constexpr int B = Pose::kDof;
  bench::CholmodMatrix<Pose> matrix(solver.Cholesky());
  matrix.Analyze();
  matrix.Factorize();
  const std::vector<int> chosen = EvenlySpread(solver.Cholesky().Variables(), count);
  const MatrixX plain = matrix.InverseColumns(chosen, 0), refined = matrix.InverseColumns(chosen, 2);
  const auto block = [](const MatrixX& inverse, std::size_t row, std::size_t column) {
    return inverse.block<B, B>(B * static_cast<Eigen::Index>(row), B * static_cast<Eigen::Index>(column));
  };
  const auto& diagonal = marginals.KeptMarginals();
  const auto column = marginals.NewestColumn();
  InverseErrors errors;
  for (std::size_t k = 0; k < chosen.size(); ++k) {
    const auto i = static_cast<std::size_t>(chosen[k]);
    const auto exact = block(refined, i, k);
    errors.Widen({(diagonal[i] - exact).norm() / exact.norm(), (block(plain, i, k) - exact).norm() / exact.norm()});
  }
  const std::size_t newest = chosen.size() - 1;
  for (std::size_t i = 0; i < column.size(); ++i) {
    const auto exact = block(refined, i, newest);
    // By the geometric mean of the marginals: a block off the diagonal may vanish.
    const double scale = std::sqrt(diagonal[i].norm() * diagonal.back().norm());
    errors.Widen({(column[i] - exact).norm() / scale, (block(plain, i, newest) - exact).norm() / scale});
  }
  return errors;
}

}  // namespace terse::testing
