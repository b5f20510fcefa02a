#pragma once
// Odometry that failed: one edge that many loops contradict in the same way.
//
// A loop across a wrong odometry edge says where everything after it ought to be: moved as a whole so that the loop
// closes. If loops from different places say the same, one odometry edge that all of them cross explains what is
// otherwise as many wrong loops. No covariance is asked, for none describes a slip; both explanations are compared by
// truncated least squares at their optima, where an odometry edge that is left out costs as much as kSlipPrice loops.
// The robot did not jump there: what loops say of that step is, but for drift, no longer than ten of the longest that
// odometry measured. Two places that look alike agree on a jump in as many loops as one likes.

#include <functional>
#include <optional>
#include <vector>

#include "incremental/linearized_graph.h"

namespace terse::internal {

template <class Pose>
struct Slip {
  std::optional<FactorId> odometry;  // that is to be left out; none: loops that go are at fault
  std::vector<FactorId> comes;       // loops that contradict it
  std::vector<FactorId> goes;        // loops across it that agree with it, or led to what contradicts it
  std::vector<Pose> T_world_body;    // the optimum then, by pose index
};

// What a slip costs, in loops left out, and from how many places loops must say that there is one.
inline constexpr double kSlipPrice = 3;
inline constexpr int kLeastPlaces = 3;
// Loops whose poses came in so close to each other, at both ends, are a group.
inline constexpr int kReachOfGroup = 10;

// Loops as the judge has them: `newcomer` and `out`, which are left out, and those that are in, ascending.
struct KnownLoops {
  FactorId newcomer;
  std::vector<FactorId> out;
  std::function<std::vector<FactorId>()> in;
};

template <class Pose>
std::optional<Slip<Pose>> FindSlip(const KnownLoops& loops, double width, const LinearizedGraph<Pose>& map);

// A suspected slip, from values to start at: at its optimum if it explains what is measured, or what explains it no
// worse without a slip: a group of loops from one place, all wrong.
template <class Pose>
std::optional<Slip<Pose>> VerifySlip(const Slip<Pose>& slip, const KnownLoops& loops, double width,
                                     const LinearizedGraph<Pose>& map);

// The slot by which pose v + 1 follows pose v and that is no loop; -1: there is none.
template <class Pose>
int OdometrySlot(int v, const std::function<bool(int slot)>& is_loop, const LinearizedGraph<Pose>& map);
// From how many places loops are, kLeastPlaces at most.
template <class Pose>
int CountPlaces(const std::vector<FactorId>& loops, const LinearizedGraph<Pose>& map);
// Where the loops are from that lead from pose v or before it to pose v + 1 or behind it, kLeastPlaces at most.
template <class Pose>
int PlacesAcross(int v, const std::vector<FactorId>& loops, const LinearizedGraph<Pose>& map);

}  // namespace terse::internal
