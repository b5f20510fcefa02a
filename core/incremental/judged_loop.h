#pragma once
// A loop, or odometry, under judgement: its measurement at the map as it is.

#include "incremental/linearized_graph.h"
#include "terse/core/front_paths.h"
#include "terse/core/residual.h"

namespace terse::internal {

// How a relative pose errs that was composed over a long way, T Exp(d), d normal, holds for large d too; the Jacobian
// of a residual that is large does not. So a loop that is out is compared in the exponential chart, with covariances
// at the predicted relative pose brought over by the adjoint: from T_from_to^-1 T, e = Log and d e = Ad(Exp(e)) d.
// T_to_from: where the covariances are linearised.
template <class Pose>
void CompareExponentially(const RelativePoseFactor<Pose>& loop, const typename Pose::Jacobian& W,
                          const Pose& T_world_from, const Pose& T_world_to, const Pose& T_to_from,
                          LinearFactor<Pose::kDof>& linear) {
  const Pose difference = (T_world_from * loop.T_from_to).Inverse() * T_world_to;
  linear.A_second = W * difference.Adjoint();
  linear.A_first = -linear.A_second * T_to_from.Adjoint();
  linear.residual = W * difference.Log();
}

template <class Pose>
struct JudgedLoop {
  static constexpr int B = Pose::kDof;
  FactorId id;
  int slot;                // -1: out
  Matrix<B, B> W;          // without weight, as the next two
  LinearFactor<B> linear;  // of one that is in, its linear factor; of one that is out, see below
  Vector<B> residual;      // at the estimate
  double weight = 1;       // that it is to have
  bool is_new = false;     // its innovation has not been noted
  PathColumns<B> z;

  JudgedLoop(FactorId loop_id, const LinearizedGraph<Pose>& map) : id(loop_id), slot(map.SlotOf(loop_id)) {
    const auto& factor = map.Graph().FindFactor(id)->factor;
    const FactorPoses ends = PosesOf(factor);
    const int a = map.Graph().IndexOf(ends.first), b = map.Graph().IndexOf(ends.second);
    W = SquareRootInformation(factor);
    linear = LinearizeAtPoints(map);
    residual = W * Residual(factor, map.EstimateAt(a), map.EstimateAt(b));
    const auto* relative = std::get_if<RelativePoseFactor<Pose>>(&factor);
    if (slot >= 0 || relative == nullptr) return;
    const auto& points = map.Points();
    const Pose T_to_from = points[static_cast<std::size_t>(b)].Inverse() * points[static_cast<std::size_t>(a)];
    CompareExponentially(*relative, W, map.EstimateAt(a), map.EstimateAt(b), T_to_from, linear);
    residual = linear.residual;
  }

  // As the map takes it in, with all its weight.
  LinearFactor<B> LinearizeAtPoints(const LinearizedGraph<Pose>& map) const {
    const auto& factor = map.Graph().FindFactor(id)->factor;
    const FactorPoses ends = PosesOf(factor);
    const int a = map.Graph().IndexOf(ends.first), b = map.Graph().IndexOf(ends.second);
    return Linearize(factor, W, a, b, map.Points()[static_cast<std::size_t>(a)],
                     map.Points()[static_cast<std::size_t>(b)]);
  }
};

}  // namespace terse::internal
