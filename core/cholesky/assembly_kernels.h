#pragma once
// The dense kernels that bring fronts together: normal equations and update matrices; part of dense_kernels_impl.h.

#include "cholesky/kernel_tiles.h"

namespace terse::internal {
namespace {

// The rows of a square matrix, side by side in lanes; what is beyond them is zero.
template <int N>
struct MatrixRows {
  static constexpr int kPadded = N <= 4 ? 4 : 8;
  double row[N][kPadded] = {};

  explicit MatrixRows(const double* matrix) {
    for (int k = 0; k < N; ++k) {
      for (int i = 0; i < N; ++i) row[k][i] = matrix[i * N + k];
    }
  }
  // sign M' x.
  void Times(const double* x, double sign, double* out) const {
    double sum[kPadded] = {};
    for (int k = 0; k < N; ++k) {
      for (int i = 0; i < kPadded; ++i) sum[i] += row[k][i] * x[k];
    }
    for (int i = 0; i < N; ++i) out[i] = sign * sum[i];
  }
  // M' X.
  void TimesMatrix(const double* x, double* out) const {
    for (int j = 0; j < N; ++j) Times(x + j * N, 1, out + j * N);
  }
};

template <int N>
void FactorNormalBlocks(const double* a, const double* b, const double* r, double* H_first, double* H_second,
                        double* H_cross, double* b_first, double* b_second) {
  const MatrixRows<N> A(a);
  A.TimesMatrix(a, H_first);
  A.Times(r, -1, b_first);
  if (b == nullptr) return;
  const MatrixRows<N> B(b);
  B.TimesMatrix(b, H_second);
  B.TimesMatrix(a, H_cross);
  B.Times(r, -1, b_second);
}

template <int kLanes>
inline void AddLanes(double* to, const double* from) {
  typedef double Lanes __attribute__((vector_size(kLanes * sizeof(double)), aligned(8), may_alias));
  *reinterpret_cast<Lanes*>(to) += *reinterpret_cast<const Lanes*>(from);
}

// to += from, n of each. Runs are short: what is left goes by halves.
inline void AddRun(double* to, const double* from, int n) {
  int k = 0;
  for (; k + kWidth <= n; k += kWidth) AddLanes<kWidth>(to + k, from + k);
  if (kWidth > 4 && k + 4 <= n) AddLanes<4>(to + k, from + k), k += 4;
  for (; k + 2 <= n; k += 2) AddLanes<2>(to + k, from + k);
  if (k < n) to[k] += from[k];
}

template <int B>
void AddBlocks(double* to, long ldt, const double* from, long ldf, const int* at, const int* run_end, int first,
               int last, int blocks, int rhs) {
  for (int j = first; j < last; ++j) {
    const double* source = from + j * B * ldf;
    double* target = to + at[j] * ldt;
    int end = run_end[j];
    for (int c = 0; c < B; ++c) {
      AddRun(target + c * ldt + at[j] + c, source + c * ldf + j * B + c, (end - j) * B - c);
    }
    for (int i = end; i < blocks; i = end) {
      end = run_end[i];
      for (int c = 0; c < B; ++c) AddRun(target + c * ldt + at[i], source + c * ldf + i * B, (end - i) * B);
    }
    for (int c = 0; c < B; ++c) target[c * ldt + rhs] += source[c * ldf + blocks * B];
  }
}

}  // namespace

namespace TERSE_KERNEL_NAMESPACE {

void NormalBlocks(const double* a, const double* b, const double* r, int size, double* H_first, double* H_second,
                  double* H_cross, double* b_first, double* b_second) {
  const auto blocks = size == 6 ? FactorNormalBlocks<6> : FactorNormalBlocks<3>;
  blocks(a, b, r, H_first, H_second, H_cross, b_first, b_second);
}

void ExtendAdd(double* to, int ldt, const double* from, int ldf, const int* at, const int* run_end, int first, int last,
               int blocks, int rhs, int size) {
  const auto add = size == 6 ? AddBlocks<6> : AddBlocks<3>;
  add(to, ldt, from, ldf, at, run_end, first, last, blocks, rhs);
}

}  // namespace TERSE_KERNEL_NAMESPACE
}  // namespace terse::internal
