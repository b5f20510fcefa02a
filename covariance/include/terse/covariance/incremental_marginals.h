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
#include "terse/covariance/covariance_options.h"
#include "terse/covariance/pose_marginals.h"

namespace terse {

namespace internal {
struct StateAccess;
}

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

  // All diagonal blocks as kept, without a copy: by pose index, until the next Update. Throws std::logic_error if the
  // solver changed since the last Update.
  const std::vector<Jacobian>& KeptMarginals() const;
  // Cov(d_index, d_newest) as kept, likewise.
  Jacobian KeptCross(int index) const;

  // Bytes of the cache now, at most CovarianceOptions::cache_bytes between queries; and of what Update keeps: two
  // blocks per pose, as many right-hand sides per pose as downdates took at once, and the blocks of one path.
  std::size_t CacheBytes() const;
  std::size_t KeptBytes() const;

 private:
  struct State;
  // core/state_file.h: what Update keeps; the solver is read before, the options are those of construction.
  friend struct internal::StateAccess;
  template <class Archive>
  void Serialize(Archive& archive);
  PoseId NewestId() const;
  int IndexOf(PoseId id) const override { return solver_->Graph().IndexOf(id); }
  Pose ValueAt(int index) const override { return solver_->EstimateAt(index); }
  Pose PointAt(int index) const override { return solver_->LinearizationPoints()[static_cast<std::size_t>(index)]; }
  const BlockCholesky<Pose::kDof>& CholeskyOfAll() const override { return solver_->Cholesky(); }
  std::vector<Jacobian> DiagonalBlocks(const std::vector<int>& indices) const override;
  std::vector<Jacobian> AllDiagonalBlocks() const override;
  std::vector<Jacobian> ColumnBlocks(int of, const std::vector<int>& indices) const override;

  const IncrementalSolver<Pose>* solver_;
  CovarianceOptions options_;
  std::unique_ptr<State> state_;
};

class StateWriter;
class StateReader;
extern template void IncrementalMarginals<SE2>::Serialize(StateWriter&);
extern template void IncrementalMarginals<SE2>::Serialize(StateReader&);
extern template void IncrementalMarginals<SE3>::Serialize(StateWriter&);
extern template void IncrementalMarginals<SE3>::Serialize(StateReader&);
extern template class IncrementalMarginals<SE2>;
extern template class IncrementalMarginals<SE3>;

}  // namespace terse
