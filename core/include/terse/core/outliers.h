#pragma once
// Wrong loops: links that look like the true ones of a data set but join the wrong poses, to test what must survive
// them.
//
// A wrong loop joins two poses that no edge joins. It has the direction and information of a true loop, drawn evenly,
// and noise of that information. What the true poses do not contradict by a chi-square of kWrongChi2PerDof per degree
// of freedom is drawn again. A wrong loop is never the link that brings its later pose in: the order of arrival
// (arrival.h) stays what it was.
//
// Two passes over the same data in online order, so that only the poses are held: LoopSurvey counts and samples,
// WrongLoops draws. Same data, percentage and seed, same wrong loops, on every machine.

#include <cstdint>
#include <memory>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse {

// Five standard deviations in every direction.
constexpr double kWrongChi2PerDof = 25;

// kRandom: between two poses drawn evenly, with a true loop's measurement. kLocal: the same between poses 20 to 50
// apart in order of arrival. kGrouped: 3 to 10 of consecutive poses that agree with each other, each leading to a pose
// up to two from where the last one led, or fewer where the two paths part; the first is as kRandom. kAliased: a place
// is taken for another one, up to 20 times from wherever a true loop could be measured there; the first time is as
// kRandom.
enum class OutlierKind { kRandom, kLocal, kGrouped, kAliased };

// A relative factor is a loop unless it joins poses that arrive one right after the other.
template <class Pose>
class LoopSurvey {
 public:
  explicit LoopSurvey(std::uint64_t seed = 1);
  ~LoopSurvey();
  LoopSurvey(LoopSurvey&&) noexcept;
  LoopSurvey& operator=(LoopSurvey&&) noexcept;

  // The next pose and the edges that join it to earlier ones.
  void Arrive(PoseId id, const std::vector<RelativePoseFactor<Pose>>& edges);
  long Poses() const;
  long Loops() const;
  // Pairs of poses that at least one edge joins.
  long LinkedPairs() const;
  // Loops drawn evenly from all, 1000 if there are as many.
  const std::vector<RelativePoseFactor<Pose>>& Sample() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

template <class Pose>
class WrongLoops {
 public:
  // `percent` of the survey's loops, rounded to the nearest number; more than 100 is fine. Throws
  // std::invalid_argument if it is negative or not finite, if there are no loops to take a share of, and if fewer
  // pairs are free.
  WrongLoops(const LoopSurvey<Pose>& survey, double percent, std::uint64_t seed,
             OutlierKind kind = OutlierKind::kRandom);
  ~WrongLoops();
  WrongLoops(WrongLoops&&) noexcept;
  WrongLoops& operator=(WrongLoops&&) noexcept;

  // The wrong loops that arrive with this pose, after its edges. One that finds no place here waits for the next.
  std::vector<RelativePoseFactor<Pose>> Arrive(PoseId id, const Pose& T_world_body_true,
                                               const std::vector<RelativePoseFactor<Pose>>& edges);
  // After the last pose. Throws std::invalid_argument if some have found no place.
  void ExpectDone() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

template <class Pose>
struct GraphWithWrongLoops {
  PoseGraph<Pose> graph;
  std::vector<FactorId> wrong;  // in order of arrival
};

// The graph with its factors in online order and the wrong loops among them; poses, values, fixed ones and the
// factors themselves as they were. `T_world_body`: the true poses, or the best known, by pose index. Throws
// std::invalid_argument as WrongLoops does, for a graph that is not connected and for another number of values.
template <class Pose>
GraphWithWrongLoops<Pose> AddWrongLoops(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body,
                                        double percent, std::uint64_t seed, OutlierKind kind = OutlierKind::kRandom);

}  // namespace terse
