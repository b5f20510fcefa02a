#pragma once
// Covariances of a solved pose graph, at the given values: pose_marginals.h says what can be asked.
//
//     const Marginals<SE3> marginals(graph, SolveBatch(graph));
//     const Matrix<6, 6> covariance = marginals.Marginal(PoseId{7});

#include <memory>
#include <unordered_map>
#include <vector>

#include "terse/core/batch_solver.h"
#include "terse/covariance/pose_marginals.h"
#include "terse/covariance/selected_inverse.h"

namespace terse {

template <class Pose>
class Marginals final : public PoseMarginals<Pose> {
 public:
  using Jacobian = typename Pose::Jacobian;

  // At the result of an optimisation of this graph, with its factor, robust weights included: nothing is factored
  // again. Move the result in if it is not needed any more. Throws UnobservableError or NumericalError if its system
  // was singular.
  Marginals(const PoseGraph<Pose>& graph, BatchResult<Pose> result);
  // Factors the graph at the values (by pose index). Throws NumericalError if the system is singular.
  Marginals(const PoseGraph<Pose>& graph, std::vector<Pose> T_world_body);
  // Takes a factor at hand (variable = pose index), as BatchResult holds it; an IncrementalSolver's is linearised at
  // its LinearizationPoints(), which then have to be given too. Throws std::invalid_argument if the sizes differ.
  Marginals(const PoseGraph<Pose>& graph, std::vector<Pose> T_world_body, BlockCholesky<Pose::kDof> cholesky);
  Marginals(const PoseGraph<Pose>& graph, std::vector<Pose> T_world_body, BlockCholesky<Pose::kDof> cholesky,
            std::vector<Pose> linearization_points);

 private:
  Marginals(BatchResult<Pose>&& result, const PoseGraph<Pose>& graph);
  int IndexOf(PoseId id) const override;
  Pose ValueAt(int index) const override { return T_world_body_[static_cast<std::size_t>(index)]; }
  Pose PointAt(int index) const override {
    return points_.empty() ? ValueAt(index) : points_[static_cast<std::size_t>(index)];
  }
  const BlockCholesky<Pose::kDof>& CholeskyOfAll() const override { return *cholesky_; }
  std::vector<Jacobian> DiagonalBlocks(const std::vector<int>& indices) const override;
  std::vector<Jacobian> AllDiagonalBlocks() const override { return inverse_.AllDiagonals(); }

  std::unordered_map<std::int64_t, int> index_;
  std::vector<Pose> T_world_body_;
  std::vector<Pose> points_;  // where the factor is linearised; empty: at the values
  std::unique_ptr<BlockCholesky<Pose::kDof>> cholesky_;
  SelectedInverse<Pose::kDof> inverse_;
};

extern template class Marginals<SE2>;
extern template class Marginals<SE3>;

}  // namespace terse
