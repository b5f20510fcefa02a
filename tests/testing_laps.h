#pragma once
// Two laps of a circle, measured to millimetres, with the unit matrix for information: what exported graphs look like.

#include <algorithm>
#include <cstdint>
#include <vector>

#include "terse/core/pose_graph.h"
#include "testing.h"

namespace terse::testing {

template <class Pose>
struct Laps {
  PoseGraph<Pose> graph;
  std::vector<Pose> truth;
  int wrong = 0;
};

// 300 poses a lap, a metre apart; on the second every third has a loop to the first. One in so many poses has
// a wrong one, to 50 m away and more; 0: none.
template <class Pose>
Laps<Pose> TwoLaps(std::uint64_t seed, int wrong_every) {
  constexpr int kLap = 300;
  Random rng(seed);
  Laps<Pose> laps;
  typename Pose::Tangent twist = Pose::Tangent::Zero();
  twist[0] = 1;
  twist[Pose::kDof - 1] = 2 * 3.14159265358979 / kLap;
  const auto link = [&](int from, int to, const Pose& T) {
    laps.graph.AddFactor(RelativePoseFactor<Pose>{PoseId{from}, PoseId{to}, T, Pose::Jacobian::Identity()});
  };
  const auto link_true = [&](int from, int to) {
    const Pose T = laps.truth[static_cast<std::size_t>(from)].Inverse() * laps.truth[static_cast<std::size_t>(to)];
    link(from, to, T * RandomMotion<Pose>(rng, 0.003, 0.003));
  };
  for (int k = 0; k < 2 * kLap; ++k) {
    laps.graph.AddPose(PoseId{k});
    laps.truth.push_back(k == 0 ? Pose() : laps.truth.back() * Pose::Exp(twist));
    if (k > 0) link_true(k - 1, k);
    if (k >= kLap && k % 3 == 0) link_true(k - kLap, k);
    if (wrong_every > 0 && k > 60 && k % wrong_every == 0) {
      const int apart = 50 + static_cast<int>(rng() % static_cast<unsigned>(std::min(k - 50, 200)));
      link(k - apart, k, RandomMotion<Pose>(rng, 1, 0.3));
      ++laps.wrong;
    }
  }
  return laps;
}

}  // namespace terse::testing
