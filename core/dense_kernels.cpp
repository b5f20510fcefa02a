#include "dense_kernels.h"

namespace terse::internal {

#define TERSE_DECLARE_KERNELS(set)                                                      \
  namespace set {                                                                       \
  int FactorPanel(double* panel, int rows, int pivots);                                 \
  void SubtractOuter(double* update, int n, const double* panel, int rows, int pivots); \
  }
TERSE_DECLARE_KERNELS(baseline)
#ifdef TERSE_X86_KERNELS
TERSE_DECLARE_KERNELS(avx2)
TERSE_DECLARE_KERNELS(avx512)
#endif
#undef TERSE_DECLARE_KERNELS

std::vector<DenseKernels> AvailableKernels() {
  std::vector<DenseKernels> out = {{"baseline", baseline::FactorPanel, baseline::SubtractOuter}};
#ifdef TERSE_X86_KERNELS
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
    out.push_back({"avx2", avx2::FactorPanel, avx2::SubtractOuter});
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl")) {
      out.push_back({"avx512", avx512::FactorPanel, avx512::SubtractOuter});
    }
  }
#endif
  return out;
}

const DenseKernels& Kernels() {
  static const DenseKernels best = AvailableKernels().back();
  return best;
}

}  // namespace terse::internal
