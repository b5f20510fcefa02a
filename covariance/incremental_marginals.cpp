#include "terse/covariance/incremental_marginals.h"

#include <stdexcept>

#include "terse/covariance/selected_inverse.h"

namespace terse {

using std::size_t;

const char* Name(CovariancePath path) {
  switch (path) {
    case CovariancePath::kNone: return "none";
    case CovariancePath::kPropagated: return "propagated";
    case CovariancePath::kDowndated: return "downdated";
    case CovariancePath::kRecursion: return "recursion";
  }
  return "";
}

template <class Pose>
struct IncrementalMarginals<Pose>::Kept {
  explicit Kept(const BlockCholesky<Pose::kDof>& factor) : inverse(factor) {}
  SelectedInverse<Pose::kDof> inverse;
};

template <class Pose>
IncrementalMarginals<Pose>::IncrementalMarginals(const IncrementalSolver<Pose>& solver,
                                                 const CovarianceOptions& options)
    : solver_(&solver), options_(options), kept_(std::make_unique<Kept>(solver.Factor())) {}

template <class Pose>
IncrementalMarginals<Pose>::~IncrementalMarginals() = default;

template <class Pose>
CovarianceReport IncrementalMarginals<Pose>::Update() {
  if (solver_->Graph().Poses().empty()) throw std::invalid_argument("the solver has no pose yet");
  CovarianceReport report;
  report.path = CovariancePath::kRecursion;
  return report;
}

template <class Pose>
typename Pose::Jacobian IncrementalMarginals<Pose>::Newest(const CovarianceConvention& convention) const {
  if (solver_->Graph().Poses().empty()) throw std::invalid_argument("the solver has no pose yet");
  return this->Marginal(solver_->Graph().Poses().back().id, convention);
}

template <class Pose>
std::vector<typename Pose::Jacobian> IncrementalMarginals<Pose>::NewestColumn(
    const CovarianceConvention& convention) const {
  if (solver_->Graph().Poses().empty()) throw std::invalid_argument("the solver has no pose yet");
  std::vector<PoseId> ids;
  for (const auto& node : solver_->Graph().Poses()) ids.push_back(node.id);
  return this->Column(ids.back(), ids, convention);
}

template <class Pose>
size_t IncrementalMarginals<Pose>::CacheBytes() const {
  return 0;
}

template <class Pose>
size_t IncrementalMarginals<Pose>::KeptBytes() const {
  return 0;
}

template <class Pose>
std::vector<typename Pose::Jacobian> IncrementalMarginals<Pose>::DiagonalBlocks(const std::vector<int>& indices) const {
  return kept_->inverse.Diagonals(indices);
}

template <class Pose>
std::vector<typename Pose::Jacobian> IncrementalMarginals<Pose>::AllDiagonalBlocks() const {
  return kept_->inverse.AllDiagonals();
}

template <class Pose>
std::vector<typename Pose::Jacobian> IncrementalMarginals<Pose>::ColumnBlocks(int of,
                                                                              const std::vector<int>& indices) const {
  return PoseMarginals<Pose>::ColumnBlocks(of, indices);
}

template class IncrementalMarginals<SE2>;
template class IncrementalMarginals<SE3>;

}  // namespace terse
