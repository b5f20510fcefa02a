#pragma once
// An incremental solver against a dense batch system.

#include <gtest/gtest.h>

#include "terse/core/incremental_solver.h"
#include "testing.h"

namespace terse::testing {

// Exact back-substitution. Runs whose gates differ have other linearisation points all the same: to compare their
// estimates, iterate to rest (Carry::kPoint with step tolerances of 1e-10).
inline IncrementalOptions Exact() {
  IncrementalOptions options;
  options.propagation_tolerance = 0;
  return options;
}

// One pose per update with all factors to earlier poses, as an online user sends them.
template <class Pose>
std::vector<GraphUpdate<Pose>> OnePosePerUpdate(const PoseGraph<Pose>& graph, bool with_values = false) {
  std::vector<GraphUpdate<Pose>> updates(graph.Poses().size());
  for (std::size_t k = 0; k < graph.Poses().size(); ++k) {
    const auto& node = graph.Poses()[k];
    updates[k].poses.push_back({node.id, with_values ? node.T_world_body : std::nullopt});
  }
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    const int last = std::max(graph.IndexOf(ends.first), graph.IndexOf(ends.second));
    updates[static_cast<std::size_t>(last)].factors.push_back(node.factor);
  }
  return updates;
}

// Now and then takes away a factor that is not needed for connection: one between poses that do not follow each other.
template <class Pose>
void MaybeRemove(Random& rng, const PoseGraph<Pose>& graph, std::int64_t id_stride, GraphUpdate<Pose>& update) {
  if (update.factors.empty() || graph.Factors().size() < 6 || rng() % 4 != 0) return;
  const auto& victim = graph.Factors()[rng() % graph.Factors().size()];
  const auto* f = std::get_if<RelativePoseFactor<Pose>>(&victim.factor);
  if (f != nullptr && std::abs(f->from.value - f->to.value) > id_stride) update.removed.push_back(victim.id);
}

// Factor, predicted decrease and log-determinant equal dense ones at the solver's linearisation points; so does the
// estimate unless a closed gate left it behind.
template <class Pose>
void ExpectEqualsDense(const IncrementalSolver<Pose>& solver, bool estimate_too = true) {
  const auto dense = MakeDenseSystem(solver.Graph(), solver.LinearizationPoints(), &solver.CurrentGauge());
  const Eigen::VectorXd x = Solve(dense.H, dense.b);
  const double log_det = LogDeterminant(dense.H);
  ASSERT_NEAR(solver.LogDeterminant(), log_det, 1e-9 * std::abs(log_det));
  // |y|^2 and the anchor's 1e8 share their digits.
  ASSERT_NEAR(solver.Cholesky().NewtonDecrement(), x.dot(dense.b), 1e-8 * std::max(1.0, x.dot(dense.b)));
  if (!estimate_too) return;
  for (std::size_t i = 0; i < solver.LinearizationPoints().size(); ++i) {
    const Vector<Pose::kDof> d = x.segment<Pose::kDof>(static_cast<Eigen::Index>(i) * Pose::kDof);
    const Pose expected = solver.LinearizationPoints()[i].Retract(d);
    // The anchor (1e8) beside informations of 10..1000 costs about four digits, in both solutions.
    ASSERT_LT(expected.Local(solver.EstimateAt(static_cast<int>(i))).norm(), 1e-9);
  }
}

}  // namespace terse::testing
