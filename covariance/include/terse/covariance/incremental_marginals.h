#pragma once
// Covariances of a growing map, brought up to date with every step of an IncrementalSolver.
//
// Covariances are those at the solver's linearisation points; values for frame conversions are its estimates.
// pose_marginals.h says what can be asked; every query is exact at any time. Update(), called after a step of the
// solver, keeps all diagonal blocks and the newest pose's block column at hand, so that asking for them costs nothing:
// that pays for who needs them all at every step. Who needs few of them just asks.
//
// Not thread-safe for writing (Update, steps of the solver); const functions may run concurrently. The solver must
// outlive the object and is never changed.

#include <cstddef>
#include <memory>
#include <vector>

#include "terse/core/incremental_solver.h"
#include "terse/covariance/pose_marginals.h"

namespace terse {

// How the kept blocks came up to date (Ila et al., IJRR 2017, section 3.4).
enum class CovariancePath {
  kNone,        // nothing had changed
  kPropagated,  // appended poses: no older block changes, new ones follow by composition
  kDowndated,   // Woodbury: changed factors at fixed linearisation points (Eqs. 14-15)
  kRecursion,   // all blocks anew from the factor (Eqs. 9-13)
};
const char* Name(CovariancePath path);

struct CovarianceOptions {
  // kCheapest: by a cost model, flops times what a flop was measured to take. The others where they can, for tests and
  // benchmarks.
  enum class Method { kCheapest, kDowndate, kRecursion };
  Method method = Method::kCheapest;
  // Of the blocks of single fronts that queries leave for later ones. Least recently used ones go first.
  std::size_t cache_bytes = std::size_t{256} << 20;
  // Relative error that repeated downdates may leave in a kept block before all are computed anew.
  double max_drift = 1e-9;
};

struct CovarianceReport {
  CovariancePath path = CovariancePath::kNone;
  int columns = 0;   // columns of H^-1 that a downdate took
  double flops = 0;  // multiplications and additions
  double seconds = 0;
  double downdate_seconds = 0;  // what the cost model expected; 0: not considered
  double recursion_seconds = 0;
  double drift = 0;           // bound on the relative error of the kept blocks due to downdates
  double measured_drift = 0;  // largest found in the blocks that were looked at
  bool refreshed = false;     // recursion because the drift grew too large
};

template <class Pose>
class IncrementalMarginals final : public PoseMarginals<Pose> {
 public:
  using Jacobian = typename Pose::Jacobian;

  explicit IncrementalMarginals(const IncrementalSolver<Pose>& solver, const CovarianceOptions& options = {});
  ~IncrementalMarginals() override;

  // Throws std::invalid_argument if the solver has no pose yet.
  CovarianceReport Update();

  // Of the pose that was added last.
  Jacobian Newest(const CovarianceConvention& convention = {}) const;
  // Cov(d_i, d_newest) for every pose index i.
  std::vector<Jacobian> NewestColumn(const CovarianceConvention& convention = {}) const;

  // Bytes of the cache now, never more than CovarianceOptions::cache_bytes; and of the blocks that Update keeps.
  std::size_t CacheBytes() const;
  std::size_t KeptBytes() const;

 private:
  struct Kept;
  int IndexOf(PoseId id) const override { return solver_->Graph().IndexOf(id); }
  Pose ValueAt(int index) const override { return solver_->EstimateAt(index); }
  const BlockCholesky<Pose::kDof>& FactorOfAll() const override { return solver_->Factor(); }
  std::vector<Jacobian> DiagonalBlocks(const std::vector<int>& indices) const override;
  std::vector<Jacobian> AllDiagonalBlocks() const override;
  std::vector<Jacobian> ColumnBlocks(int of, const std::vector<int>& indices) const override;

  const IncrementalSolver<Pose>* solver_;
  CovarianceOptions options_;
  std::unique_ptr<Kept> kept_;
};

extern template class IncrementalMarginals<SE2>;
extern template class IncrementalMarginals<SE3>;

}  // namespace terse
