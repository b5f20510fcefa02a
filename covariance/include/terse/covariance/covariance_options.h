#pragma once
// How the covariances of a growing map are kept up to date, and what an update reports.

#include <cstddef>

namespace terse {

// How the kept blocks came up to date (Ila et al. 2017 section 3.4).
enum class CovariancePath {
  kNone,        // nothing had changed
  kPropagated,  // appended poses: no older block changes, new ones follow by composition
  kDowndated,   // Woodbury: factors that came or went at fixed linearisation points, or few new points (Ila et al. 2017
                // Eqs. 14-15)
  kRecursion,   // all blocks anew from the Cholesky factor (Ila et al. 2017 Eqs. 9-13)
};
const char* Name(CovariancePath path);

// Where few diagonal blocks come from that are not kept. kSolve: forward substitution for each. kRecursion: the fronts
// on their paths, as far as these are stale.
enum class DiagonalMethod { kCheapest, kSolve, kRecursion };

struct CovarianceOptions {
  // kCheapest: by a cost model. The others where they can, for tests and benchmarks.
  enum class Method { kCheapest, kDowndate, kRecursion };
  Method method = Method::kCheapest;
  DiagonalMethod diagonal_method = DiagonalMethod::kCheapest;
  // Of the fronts' blocks that queries leave for later ones. The least recently used go first. A query itself needs the
  // blocks of one path to the root; with a small cache the next one computes them again.
  std::size_t cache_bytes = std::size_t{256} << 20;
  // When the drift of the kept blocks exceeds this, all are computed anew from the factor.
  double max_drift = 1e-9;
};

struct CovarianceReport {
  CovariancePath path = CovariancePath::kNone;
  int columns = 0;   // of H^-1 that were solved for
  double flops = 0;  // multiplications and additions
  double seconds = 0;
  double downdate_cost = 0;  // what the cost model expected, in flops of the recursion; 0: was not possible
  double recursion_cost = 0;
  // Relative, of the diagonal blocks: estimated from how far downdates have shrunk them since they were computed; and
  // the largest difference found in blocks that were computed again. The second includes the rounding of the factor
  // itself, which is large where variances are large beside those that the strongest information stands for.
  double drift = 0;
  double measured_drift = 0;
  bool refreshed = false;  // recursion because the drift grew too large
};

}  // namespace terse
