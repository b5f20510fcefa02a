#include <algorithm>
#include <chrono>
#include <numeric>
#include <vector>

#include "bench_runs.h"
#include "terse/core/dense_kernels.h"

namespace terse::bench {
namespace {

// The fastest of several runs of `run`, seconds.
template <class Run>
double Fastest(int runs, const Run& run) {
  double fastest = 1e30;
  for (int k = 0; k < runs; ++k) {
    const auto start = std::chrono::steady_clock::now();
    run();
    fastest = std::min(fastest, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  return fastest;
}

}  // namespace

nlohmann::json MeasureRoof() {
  // Operands of 0.3 MB, in the second-level cache.
  constexpr int kRows = 192, kDepth = 96;
  std::vector<double> a(kRows * kDepth, 1e-3), c(kRows * kRows, 0.0);
  const double compute = Fastest(2000, [&] {
    internal::Kernels().subtract_product(c.data(), kRows, a.data(), a.data(), kRows, kRows, kRows, kDepth);
  });
  // Four times what third-level caches hold.
  const std::vector<double> large(std::size_t{16} << 20, 1.0);
  double sum = 0;
  const double read = Fastest(8, [&] {
    double part[8] = {};
    for (std::size_t k = 0; k < large.size(); k += 8) {
      for (std::size_t lane = 0; lane < 8; ++lane) part[lane] += large[k + lane];
    }
    sum += std::accumulate(std::begin(part), std::end(part), 0.0);
  });
  return {{"kernels", internal::Kernels().name},
          {"gflops_per_second", 1e-9 * kRows * (kRows + 1.0) * kDepth / compute},
          {"gbytes_per_second", 8e-9 * static_cast<double>(large.size()) / read},
          {"checksum", sum + c.back()}};
}

}  // namespace terse::bench
