#pragma once
// A loop, or odometry, under judgement: its measurement at the map as it is.

#include "incremental/linearized_graph.h"
#include "terse/core/front_paths.h"
#include "terse/core/residual.h"

namespace terse::internal {

template <class Pose>
struct JudgedLoop {
  static constexpr int B = Pose::kDof;
  FactorId id;
  int slot;                // -1: out
  Matrix<B, B> W;          // without weight, as the next two
  LinearFactor<B> linear;  // at the linearisation points
  Vector<B> residual;      // at the estimate
  double weight = 1;       // that it is to have
  PathColumns<B> z;

  JudgedLoop(FactorId loop_id, const LinearizedGraph<Pose>& map) : id(loop_id), slot(map.SlotOf(loop_id)) {
    const auto& factor = map.Graph().FindFactor(id)->factor;
    const FactorPoses ends = PosesOf(factor);
    const int a = map.Graph().IndexOf(ends.first), b = map.Graph().IndexOf(ends.second);
    W = SquareRootInformation(factor);
    linear = Linearize(factor, W, a, b, map.Points()[static_cast<std::size_t>(a)],
                       map.Points()[static_cast<std::size_t>(b)]);
    residual = W * Residual(factor, map.EstimateAt(a), map.EstimateAt(b));
  }
};

}  // namespace terse::internal
