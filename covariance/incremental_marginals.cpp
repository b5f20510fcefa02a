#include "terse/covariance/incremental_marginals.h"

#include <numeric>
#include <stdexcept>

#include "kept_covariances.h"
#include "terse/core/state_members.h"
#include "terse/covariance/selected_inverse.h"

namespace terse {

using internal::At;
using std::size_t;

template <class Pose>
struct IncrementalMarginals<Pose>::State {
  internal::KeptCovariances<Pose::kDof> kept;
  SelectedInverse<Pose::kDof> inverse;
};

template <class Pose>
IncrementalMarginals<Pose>::IncrementalMarginals(const IncrementalSolver<Pose>& solver,
                                                 const CovarianceOptions& options)
    : solver_(&solver),
      options_(options),
      state_(new State{internal::KeptCovariances<Pose::kDof>(solver.Cholesky(), options),
                       SelectedInverse<Pose::kDof>(solver.Cholesky(), options.cache_bytes)}) {}

template <class Pose>
IncrementalMarginals<Pose>::~IncrementalMarginals() = default;

template <class Pose>
CovarianceReport IncrementalMarginals<Pose>::Update() {
  return state_->kept.Update();
}

template <class Pose>
PoseId IncrementalMarginals<Pose>::NewestId() const {
  const auto& poses = solver_->Graph().Poses();
  if (poses.empty()) throw std::invalid_argument("the solver has no pose yet");
  return poses.back().id;
}

template <class Pose>
typename Pose::Jacobian IncrementalMarginals<Pose>::Newest(const CovarianceConvention& convention) const {
  return this->Marginal(NewestId(), convention);
}

template <class Pose>
std::vector<typename Pose::Jacobian> IncrementalMarginals<Pose>::NewestColumn(
    const CovarianceConvention& convention) const {
  const int newest = IndexOf(NewestId());
  std::vector<int> all(At(newest) + 1);
  std::iota(all.begin(), all.end(), 0);
  std::vector<Jacobian> out = ColumnBlocks(newest, all);
  if (convention.IsNative()) return out;
  const Pose T_newest = ValueAt(newest);
  for (const int i : all) out[At(i)] = ConvertCrossCovariance<Pose>(out[At(i)], ValueAt(i), T_newest, convention);
  return out;
}

template <class Pose>
const std::vector<typename Pose::Jacobian>& IncrementalMarginals<Pose>::KeptMarginals() const {
  if (!state_->kept.IsCurrent()) throw std::logic_error("the solver changed since the covariances' last Update");
  return state_->kept.Diagonals();
}

template <class Pose>
typename Pose::Jacobian IncrementalMarginals<Pose>::KeptCross(int index) const {
  if (!state_->kept.IsCurrent()) throw std::logic_error("the solver changed since the covariances' last Update");
  return state_->kept.Column(index);
}

template <class Pose>
size_t IncrementalMarginals<Pose>::CacheBytes() const {
  return state_->inverse.CacheBytes();
}

template <class Pose>
size_t IncrementalMarginals<Pose>::KeptBytes() const {
  return state_->kept.Bytes();
}

template <class Pose>
std::vector<typename Pose::Jacobian> IncrementalMarginals<Pose>::DiagonalBlocks(const std::vector<int>& indices) const {
  if (!state_->kept.IsCurrent()) return state_->inverse.Diagonals(indices, options_.diagonal_method);
  std::vector<Jacobian> out;
  out.reserve(indices.size());
  for (const int i : indices) out.push_back(state_->kept.Diagonals()[At(i)]);
  return out;
}

template <class Pose>
std::vector<typename Pose::Jacobian> IncrementalMarginals<Pose>::AllDiagonalBlocks() const {
  return state_->kept.IsCurrent() ? state_->kept.Diagonals() : state_->inverse.AllDiagonals();
}

template <class Pose>
std::vector<typename Pose::Jacobian> IncrementalMarginals<Pose>::ColumnBlocks(int of,
                                                                              const std::vector<int>& indices) const {
  if (!state_->kept.IsCurrent() || of + 1 != solver_->Cholesky().Variables()) {
    return PoseMarginals<Pose>::ColumnBlocks(of, indices);
  }
  std::vector<Jacobian> out;
  out.reserve(indices.size());
  for (const int i : indices) out.push_back(state_->kept.Column(i));
  return out;
}

template <class Pose>
template <class Archive>
void IncrementalMarginals<Pose>::Serialize(Archive& archive) {
  archive(state_->kept);
}

template void IncrementalMarginals<SE2>::Serialize(StateWriter&);
template void IncrementalMarginals<SE2>::Serialize(StateReader&);
template void IncrementalMarginals<SE3>::Serialize(StateWriter&);
template void IncrementalMarginals<SE3>::Serialize(StateReader&);
template class IncrementalMarginals<SE2>;
template class IncrementalMarginals<SE3>;

}  // namespace terse
