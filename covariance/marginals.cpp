#include "terse/covariance/marginals.h"

#include <stdexcept>

#include "terse/core/batch_solver.h"
#include "terse/core/pose_name.h"

namespace terse {

using std::size_t;

namespace {

template <class Pose>
BatchResult<Pose> RequireFactor(BatchResult<Pose> result) {
  if (result.termination != Termination::kNotPositiveDefinite) return result;
  if (!result.free_motions.empty()) throw UnobservableError(result.message, result.free_motions);
  throw NumericalError(result.message);
}

}  // namespace

template <class Pose>
Marginals<Pose>::Marginals(const PoseGraph<Pose>& graph, BatchResult<Pose> result)
    : Marginals(RequireFactor(std::move(result)), graph) {}

template <class Pose>
Marginals<Pose>::Marginals(BatchResult<Pose>&& result, const PoseGraph<Pose>& graph)
    : Marginals(graph, std::move(result.T_world_body), std::move(result.cholesky)) {}

template <class Pose>
Marginals<Pose>::Marginals(const PoseGraph<Pose>& graph, std::vector<Pose> T_world_body)
    : Marginals(graph, T_world_body, CholeskyAt(graph, T_world_body)) {}

template <class Pose>
Marginals<Pose>::Marginals(const PoseGraph<Pose>& graph, std::vector<Pose> T_world_body,
                           BlockCholesky<Pose::kDof> cholesky)
    : Marginals(graph, std::move(T_world_body), std::move(cholesky), {}) {}

template <class Pose>
Marginals<Pose>::Marginals(const PoseGraph<Pose>& graph, std::vector<Pose> T_world_body,
                           BlockCholesky<Pose::kDof> cholesky, std::vector<Pose> linearization_points)
    : T_world_body_(std::move(T_world_body)),
      points_(std::move(linearization_points)),
      cholesky_(std::make_unique<BlockCholesky<Pose::kDof>>(std::move(cholesky))),
      inverse_(*cholesky_) {
  if (T_world_body_.size() != graph.Poses().size() ||
      cholesky_->Variables() != static_cast<int>(T_world_body_.size()) ||
      (!points_.empty() && points_.size() != T_world_body_.size())) {
    throw std::invalid_argument("the graph, its values and the factor differ in size");
  }
  for (const auto& node : graph.Poses()) index_.emplace(node.id.value, static_cast<int>(index_.size()));
}

template <class Pose>
int Marginals<Pose>::IndexOf(PoseId id) const {
  const auto it = index_.find(id.value);
  if (it == index_.end()) throw std::invalid_argument(Name(id) + " is not in the graph");
  return it->second;
}

template <class Pose>
std::vector<typename Pose::Jacobian> Marginals<Pose>::DiagonalBlocks(const std::vector<int>& indices) const {
  return inverse_.Diagonals(indices);
}

template class Marginals<SE2>;
template class Marginals<SE3>;

}  // namespace terse
