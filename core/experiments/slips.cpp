#include "terse/core/slips.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>
#include <string>
#include <variant>

#include "experiments/arrivals.h"
#include "experiments/wrong_loop_draw.h"
#include "terse/core/random.h"

namespace terse {
namespace {

using internal::Arrival;
using internal::Arrivals;
using internal::Below;
using internal::Random;

// Streams of their own, one per slip.
constexpr std::uint64_t kStream = 0xBF58476D1CE4E5B9u;
constexpr double kLeastTurn = 10, kMostTurn = 60;  // degrees
constexpr double kLeastShare = 1, kMostShare = 5, kLeastLength = 0.1;

template <int N>
Vector<N> Direction(Random& random) {
  Vector<N> v;
  for (int i = 0; i < N; ++i) v[i] = random.Normal();
  return v.normalized();
}

}  // namespace

template <class Pose>
Slips<Pose>::Slips(long poses, long count, std::uint64_t seed) : seed_(seed) {
  if (count < 0) throw std::invalid_argument("the number of slips must not be negative");
  if (count > std::max(0L, poses - 1)) {
    throw std::invalid_argument(std::to_string(count) + " slips asked for, and only " +
                                std::to_string(std::max(0L, poses - 1)) + " steps between poses");
  }
  Random random((seed + 1) * kStream);
  std::set<long> places;  // Floyd's: any set of so many is as likely
  for (long last = poses - count; last < poses; ++last) {
    const long place = 1 + static_cast<long>(Below(random, static_cast<std::size_t>(last)));
    places.insert(places.count(place) > 0 ? last : place);
  }
  places_.assign(places.begin(), places.end());
}

template <class Pose>
bool Slips<Pose>::Apply(long place, RelativePoseFactor<Pose>& odometry) const {
  if (!std::binary_search(places_.begin(), places_.end(), place)) return false;
  Random random((seed_ + 1) * kStream ^ static_cast<std::uint64_t>(place));
  constexpr int kTurns = Pose::kDof - Pose::kDim;
  const double turn = (kLeastTurn + (kMostTurn - kLeastTurn) * random.Uniform()) * std::acos(-1) / 180;
  const double share = kLeastShare + (kMostShare - kLeastShare) * random.Uniform();
  const double length = share * std::max(kLeastLength, odometry.T_from_to.Translation().norm());
  Vector<Pose::kDof> d;
  d.template head<Pose::kDim>() = length * Direction<Pose::kDim>(random);
  d.template tail<kTurns>() = turn * Direction<kTurns>(random);
  odometry.T_from_to = odometry.T_from_to.Retract(d);
  return true;
}

template <class Pose>
GraphWithSlips<Pose> AddSlips(const PoseGraph<Pose>& graph, long count, std::uint64_t seed) {
  const Slips<Pose> slips(static_cast<long>(graph.Poses().size()), count, seed);
  GraphWithSlips<Pose> out;
  for (const auto& node : graph.Poses()) {
    out.graph.AddPose(node.id, node.T_world_body);
    out.graph.SetFixed(node.id, node.fixed);
  }
  PoseId previous;
  long place = 0;
  for (const Arrival<Pose>& arrival : Arrivals(graph)) {
    const PoseId id = graph.Poses()[static_cast<std::size_t>(arrival.pose)].id;
    bool is_step_due = place > 0;
    for (const int f : arrival.factors) {
      Factor<Pose> factor = graph.Factors()[static_cast<std::size_t>(f)].factor;
      auto* edge = std::get_if<RelativePoseFactor<Pose>>(&factor);
      const bool is_step = is_step_due && edge != nullptr && (edge->from == previous || edge->to == previous);
      const bool slips_here = is_step && slips.Apply(place, *edge);
      is_step_due = is_step_due && !is_step;
      const FactorId added = out.graph.AddFactor(factor);
      if (slips_here) out.slipped.push_back(added);
    }
    previous = id;
    ++place;
  }
  return out;
}

#define TERSE_INSTANTIATE(Pose) \
  template class Slips<Pose>;   \
  template GraphWithSlips<Pose> AddSlips(const PoseGraph<Pose>&, long, std::uint64_t);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
