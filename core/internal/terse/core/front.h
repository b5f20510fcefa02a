#pragma once
// A front of the multifrontal Cholesky factor (block_cholesky.h) and how its numbers are laid out.

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "terse/core/at.h"
#include "terse/core/panel.h"

namespace terse::internal {

// update += W W': a rank-k update that has not been worked into it yet. W has a row per scalar of the first
// `separators` separators and one for the right-hand side.
struct Correction {
  int separators = 0, columns = 0;
  std::vector<double> W;  // column-major
};

template <int B>
struct Front {
  int parent = -1;
  std::vector<int> pivots, separators;  // variables in elimination order
  std::vector<int> children;
  std::vector<int> slots;  // linear factors assembled here
  Panel panel;             // (p + s + 1) x p, column-major, p = B |P|, s = B |S|; may be longer
  // (u + 1) x (u + 1), column-major, lower triangle, u = B update_separators: the first of S; may be longer.
  FrontBuffer update;
  int update_separators = 0;
  std::vector<Correction> corrections;
  double log_det = 0;                         // sum of 2 ln L_kk
  double y2 = 0;                              // sum of |y|^2
  bool fresh = true;                          // changed since the last Solve
  std::uint64_t stamp = 0;                    // the version with which the panel last changed
  int ordered_rows = 0, ordered_columns = 0;  // when it was last ordered

  // The panel is [L_PP; L_SP; y_P'], with as many rows as its leading dimension.
  int Rows() const { return B * static_cast<int>(pivots.size() + separators.size()) + 1; }
  int Columns() const { return B * static_cast<int>(pivots.size()); }
  double* Entry(int row, int column) { return panel.Buffer() + At(column) * At(Rows()) + At(row); }
  const double* Entry(int row, int column) const { return panel.Numbers() + At(column) * At(Rows()) + At(row); }
  // y_P.
  void CopyRightHandSide(double* to) const {
    const double* last = panel.Numbers() + Rows() - 1;
    for (int column = 0; column < Columns(); ++column) to[column] = last[At(column) * At(Rows())];
  }
  // The update matrix's leading dimension.
  int UpdateRows() const { return B * update_separators + 1; }

  // Scalars of L that it holds.
  double Entries() const {
    const double p = Columns(), rows = Rows() - 1;
    return p * rows - p * (p - 1) / 2;
  }
  // Of factoring it again.
  double RefactorFlops() const {
    const double rows = Rows(), s = rows - Columns();
    return (rows * rows * rows - s * s * s) / 3;
  }

  // Calls visit(variable, row of the panel) for pivots, then separators.
  template <class Visit>
  void ForEachRow(const Visit& visit) const {
    int row = 0;
    for (const int v : pivots) {
      visit(v, row);
      row += B;
    }
    for (const int v : separators) {
      visit(v, row);
      row += B;
    }
  }
};

}  // namespace terse::internal
