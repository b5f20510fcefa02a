#include "terse/core/outliers.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "experiments/arrivals.h"
#include "experiments/wrong_loop_draw.h"

namespace terse {
namespace {

using internal::Arrival;
using internal::Arrivals;
using internal::Below;
using internal::Random;

constexpr std::size_t kSampleSize = 1000;

// Streams of their own: the scene's starts from the seed itself.
constexpr std::uint64_t kSurveyStream = 0x9E3779B97F4A7C15u, kDrawStream = 0xD1B54A32D192ED03u;
std::uint64_t StreamSeed(std::uint64_t seed, std::uint64_t stream) { return (seed + 1) * stream ^ (stream >> 7); }

template <class Pose>
PoseId OtherEnd(const RelativePoseFactor<Pose>& edge, PoseId id) {
  if (edge.from != id && edge.to != id) {
    throw std::invalid_argument("an edge does not touch pose " + std::to_string(id.value) + ", with which it came");
  }
  return edge.from == id ? edge.to : edge.from;
}

// The earlier poses that the edges of `id` join it to, each once, ascending.
template <class Pose>
std::vector<PoseId> LinkedTo(PoseId id, const std::vector<RelativePoseFactor<Pose>>& edges) {
  std::vector<PoseId> linked;
  linked.reserve(edges.size());
  for (const auto& edge : edges) linked.push_back(OtherEnd(edge, id));
  std::sort(linked.begin(), linked.end());
  linked.erase(std::unique(linked.begin(), linked.end()), linked.end());
  return linked;
}

}  // namespace

template <class Pose>
struct LoopSurvey<Pose>::State {
  Random random;
  std::vector<RelativePoseFactor<Pose>> sample;
  PoseId previous;
  long poses = 0, loops = 0, linked_pairs = 0;
};

template <class Pose>
LoopSurvey<Pose>::LoopSurvey(std::uint64_t seed)
    : state_(new State{Random(StreamSeed(seed, kSurveyStream)), {}, {}, 0, 0, 0}) {}
template <class Pose>
LoopSurvey<Pose>::~LoopSurvey() = default;
template <class Pose>
LoopSurvey<Pose>::LoopSurvey(LoopSurvey&&) noexcept = default;
template <class Pose>
LoopSurvey<Pose>& LoopSurvey<Pose>::operator=(LoopSurvey&&) noexcept = default;

template <class Pose>
void LoopSurvey<Pose>::Arrive(PoseId id, const std::vector<RelativePoseFactor<Pose>>& edges) {
  State& s = *state_;
  s.linked_pairs += static_cast<long>(LinkedTo(id, edges).size());
  for (const auto& edge : edges) {
    if (OtherEnd(edge, id) == s.previous) continue;
    ++s.loops;
    // Reservoir sampling: the n-th loop takes a place with probability size / n.
    if (s.sample.size() < kSampleSize) {
      s.sample.push_back(edge);
    } else if (const std::size_t k = Below(s.random, static_cast<std::size_t>(s.loops)); k < kSampleSize) {
      s.sample[k] = edge;
    }
  }
  s.previous = id;
  ++s.poses;
}

template <class Pose>
long LoopSurvey<Pose>::Poses() const {
  return state_->poses;
}
template <class Pose>
long LoopSurvey<Pose>::Loops() const {
  return state_->loops;
}
template <class Pose>
long LoopSurvey<Pose>::LinkedPairs() const {
  return state_->linked_pairs;
}
template <class Pose>
const std::vector<RelativePoseFactor<Pose>>& LoopSurvey<Pose>::Sample() const {
  return state_->sample;
}

template <class Pose>
struct WrongLoops<Pose>::State {
  internal::WrongLoopDraw<Pose> draw;
  std::vector<typename internal::WrongLoopDraw<Pose>::Due> due;
  std::size_t placed = 0;
  PoseId highest{std::numeric_limits<std::int64_t>::min()};
};

template <class Pose>
WrongLoops<Pose>::WrongLoops(const LoopSurvey<Pose>& survey, double percent, std::uint64_t seed, OutlierKind kind)
    : state_(new State{
          {survey.Sample(), kind, static_cast<std::size_t>(survey.Poses()), Random(StreamSeed(seed, kDrawStream))},
          {}}) {
  if (!(percent >= 0) || !std::isfinite(percent)) {
    throw std::invalid_argument("the percentage of wrong loops must not be negative");
  }
  if (percent == 0) return;
  if (survey.Loops() == 0) throw std::invalid_argument("there are no loops: nothing to take a percentage of");
  const double wanted = std::round(percent / 100 * static_cast<double>(survey.Loops()));
  const double poses = static_cast<double>(survey.Poses());
  const double free = poses * (poses - 1) / 2 - static_cast<double>(survey.LinkedPairs());
  if (wanted > free) {
    throw std::invalid_argument(std::to_string(static_cast<long>(std::min(wanted, 1e18))) +
                                " wrong loops asked for, and only " + std::to_string(static_cast<long>(free)) +
                                " pairs of poses without a link");
  }
  state_->due = state_->draw.Schedule(wanted);
}

template <class Pose>
WrongLoops<Pose>::~WrongLoops() = default;
template <class Pose>
WrongLoops<Pose>::WrongLoops(WrongLoops&&) noexcept = default;
template <class Pose>
WrongLoops<Pose>& WrongLoops<Pose>::operator=(WrongLoops&&) noexcept = default;

template <class Pose>
std::vector<RelativePoseFactor<Pose>> WrongLoops<Pose>::Arrive(PoseId id, const Pose& T_world_body_true,
                                                               const std::vector<RelativePoseFactor<Pose>>& edges) {
  State& s = *state_;
  std::vector<RelativePoseFactor<Pose>> out;
  std::vector<PoseId> linked = LinkedTo(id, edges);
  // A pose that has waited for another one's edges could come in earlier by a wrong loop.
  const bool has_waited = id < s.highest;
  const auto is_due = [&] { return s.placed < s.due.size() && s.due[s.placed].place <= s.draw.Poses(); };
  while (!has_waited && !linked.empty() && is_due()) {
    const auto wrong = s.draw.Draw(id, T_world_body_true, linked, s.due[s.placed].group);
    if (!wrong) break;
    const PoseId other = OtherEnd(*wrong, id);
    linked.insert(std::lower_bound(linked.begin(), linked.end(), other), other);
    out.push_back(*wrong);
    ++s.placed;
  }
  s.draw.Add(id, T_world_body_true);
  s.highest = std::max(s.highest, id);
  return out;
}

template <class Pose>
void WrongLoops<Pose>::ExpectDone() const {
  const std::size_t left = state_->due.size() - state_->placed;
  if (left == 0) return;
  throw std::invalid_argument(std::to_string(left) + " of " + std::to_string(state_->due.size()) +
                              " wrong loops find no place: too few pairs of poses are without a link and far enough "
                              "from what the loops measure");
}

template <class Pose>
GraphWithWrongLoops<Pose> AddWrongLoops(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body,
                                        double percent, std::uint64_t seed, OutlierKind kind) {
  if (T_world_body.size() != graph.Poses().size()) throw std::invalid_argument("one value per pose is needed");
  const auto id = [&](int pose) { return graph.Poses()[static_cast<std::size_t>(pose)].id; };
  const std::vector<Arrival<Pose>> arrivals = Arrivals(graph);
  LoopSurvey<Pose> survey(seed);
  for (const auto& arrival : arrivals) survey.Arrive(id(arrival.pose), arrival.edges);
  WrongLoops<Pose> wrong_loops(survey, percent, seed, kind);
  GraphWithWrongLoops<Pose> out;
  for (const auto& node : graph.Poses()) {
    out.graph.AddPose(node.id, node.T_world_body);
    out.graph.SetFixed(node.id, node.fixed);
  }
  for (const auto& arrival : arrivals) {
    for (const int f : arrival.factors) out.graph.AddFactor(graph.Factors()[static_cast<std::size_t>(f)].factor);
    const Pose& T = T_world_body[static_cast<std::size_t>(arrival.pose)];
    for (const auto& wrong : wrong_loops.Arrive(id(arrival.pose), T, arrival.edges)) {
      out.wrong.push_back(out.graph.AddFactor(wrong));
    }
  }
  wrong_loops.ExpectDone();
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                                                                    \
  template class LoopSurvey<Pose>;                                                                                 \
  template class WrongLoops<Pose>;                                                                                 \
  template GraphWithWrongLoops<Pose> AddWrongLoops<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&, double, \
                                                         std::uint64_t, OutlierKind);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
