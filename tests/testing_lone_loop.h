#pragma once
// A wrong loop that nothing but odometry can contradict.

#include <utility>
#include <vector>

#include "terse/core/cycle_test.h"
#include "terse/core/pose_graph.h"
#include "testing.h"

namespace terse::testing {

// Out and back along a line, with five loops far from each other. The first is wrong by what odometry just allows: it
// is the factor returned.
inline std::pair<PoseGraph<SE2>, FactorId> OutAndBackWithOneWrong(std::uint64_t seed) {
  constexpr int kPoses = 400;
  const Matrix<3, 3> odometry = Vector<3>(400, 400, 10000).asDiagonal();
  const Matrix<3, 3> tight = Vector<3>(2500, 2500, 40000).asDiagonal();
  Random rng(seed);
  const auto measured = [&](const SE2& T, const Matrix<3, 3>& information) -> SE2 {
    return T * SE2::Exp(information.diagonal().cwiseSqrt().cwiseInverse().cwiseProduct(NormalVector<3>(rng)));
  };
  PoseGraph<SE2> graph;
  internal::CycleTest<SE2> cycles;
  std::vector<SE2> truth;
  for (int k = 0; k < kPoses; ++k) {
    const bool is_back = k >= kPoses / 2;
    truth.push_back(SE2({is_back ? kPoses - 1 - k : k, 0}, is_back ? M_PI : 0));
    graph.AddPose({k});
    if (k == 0) continue;
    const SE2 step = truth[static_cast<std::size_t>(k - 1)].Inverse() * truth.back();
    const RelativePoseFactor<SE2> edge{{k - 1}, {k}, measured(step, odometry), odometry};
    graph.AddFactor(edge);
    cycles.Extend(edge);
  }
  FactorId wrong;
  for (const int at : {220, 260, 300, 340, 380}) {
    const int to = kPoses - 1 - at;
    const SE2 between = truth[static_cast<std::size_t>(at)].Inverse() * truth[static_cast<std::size_t>(to)];
    RelativePoseFactor<SE2> loop{{at}, {to}, measured(between, tight), tight};
    const bool is_first = at == 220;
    const SE2 T = loop.T_from_to;
    for (double off = 0; is_first && cycles.Innovation(loop).value() < 17; off += 0.05) {
      loop.T_from_to = T * SE2({off, off}, 0);
    }
    const FactorId id = graph.AddFactor(loop);
    if (is_first) wrong = id;
  }
  return {std::move(graph), wrong};
}

}  // namespace terse::testing
