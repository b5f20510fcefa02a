#include "terse/core/dense_kernels.h"

#include <cstdlib>
#include <cstring>

namespace terse::internal {

#define TERSE_DECLARE_KERNELS(set)                                                                                   \
  namespace set {                                                                                                    \
  int FactorPanel(double* panel, int ld, int rows, int pivots);                                                      \
  void SubtractProduct(double* c, int ldc, const double* a, const double* b, int ld, int rows, int columns,          \
                       int depth);                                                                                   \
  void SetNegativeSquare(double* c, int ldc, const double* a, int ld, int rows, int columns, int depth);             \
  void RankUpdate(double* panel, int ld, int rows, int pivots, double* w, int ldw, int columns);                     \
  void BackSubstitute(const double* panel, int rows, int pivots, double* x);                                         \
  void NormalBlocks(const double* a, const double* b, const double* r, int size, double* H_first, double* H_second,  \
                    double* H_cross, double* b_first, double* b_second);                                             \
  void ExtendAdd(double* to, int ldt, const double* from, int ldf, const int* at, const int* run_end, int first,     \
                 int last, int blocks, int rhs, int size);                                                           \
  void AddRectangle(double* c, int ldc, const double* a, int lda, const double* b, int ldb, int rows, int columns,   \
                    int depth);                                                                                      \
  void SetRectangle(double* c, int ldc, const double* a, int lda, const double* b, int ldb, int rows, int columns,   \
                    int depth);                                                                                      \
  void SubstituteForward(const double* panel, int ld, int rows, int pivots, double* x, int stride);                  \
  void SubstituteBackward(const double* panel, int ld, int rows, int pivots, double* x, int stride);                 \
  void SubtractRows(double* y, int ldy, const double* x, int ldx, const double* t, int ldt, int rows, int depth,     \
                    int width);                                                                                      \
  void TransformRows(double* y, int stride, const double* t, int rows, int depth);                                   \
  void SubtractCongruences(double* s, const double* y, int stride, const double* m, int count, int size, int depth); \
  constexpr DenseKernels kKernels = {#set,         FactorPanel,    SubtractProduct,    SetNegativeSquare,            \
                                     RankUpdate,   BackSubstitute, NormalBlocks,       ExtendAdd,                    \
                                     AddRectangle, SetRectangle,   SubstituteForward,  SubstituteBackward,           \
                                     SubtractRows, TransformRows,  SubtractCongruences};                             \
  }
TERSE_DECLARE_KERNELS(baseline)
#ifdef TERSE_X86_KERNELS
TERSE_DECLARE_KERNELS(avx2)
TERSE_DECLARE_KERNELS(avx512)
#endif
#undef TERSE_DECLARE_KERNELS

std::vector<DenseKernels> AvailableKernels() {
  std::vector<DenseKernels> out = {baseline::kKernels};
#ifdef TERSE_X86_KERNELS
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
    out.push_back(avx2::kKernels);
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl")) {
      out.push_back(avx512::kKernels);
    }
  }
#endif
  return out;
}

const DenseKernels& Kernels() {
  static const DenseKernels chosen = [] {
    const std::vector<DenseKernels> available = AvailableKernels();
    const char* const name = std::getenv("TERSE_KERNELS");
    for (const DenseKernels& kernels : available) {
      if (name != nullptr && std::strcmp(kernels.name, name) == 0) return kernels;
    }
    return available.back();
  }();
  return chosen;
}

}  // namespace terse::internal
