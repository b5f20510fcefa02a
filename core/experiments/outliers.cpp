#include "terse/core/outliers.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>

#include "experiments/generate_scene.h"
#include "terse/core/arrival.h"
#include "terse/core/residual.h"

namespace terse {
namespace {

using internal::Random;

constexpr std::size_t kSampleSize = 1000;
constexpr int kDraws = 1000;  // for a place beside one pose

// Streams of their own: the scene's starts from the seed itself.
constexpr std::uint64_t kSurveyStream = 0x9E3779B97F4A7C15u, kDrawStream = 0xD1B54A32D192ED03u;
std::uint64_t StreamSeed(std::uint64_t seed, std::uint64_t stream) { return (seed + 1) * stream ^ (stream >> 7); }

// Below n, evenly.
std::size_t Below(Random& random, std::size_t n) {
  return std::min(n - 1, static_cast<std::size_t>(random.Uniform() * static_cast<double>(n)));
}

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
  for (const auto& edge : edges) linked.push_back(OtherEnd(edge, id));
  std::sort(linked.begin(), linked.end());
  linked.erase(std::unique(linked.begin(), linked.end()), linked.end());
  return linked;
}

// The measurement with an error of the covariance Omega^-1.
template <class Pose>
Pose WithNoise(const RelativePoseFactor<Pose>& loop, Random& random) {
  constexpr int N = Pose::kDof;
  Eigen::Matrix<double, N, 1> noise;
  for (int d = 0; d < N; ++d) noise[d] = random.Normal();
  const Eigen::Matrix<double, N, N> information = loop.information;
  information.llt().matrixU().solveInPlace(noise);
  return internal::Rounded(loop.T_from_to.Retract(noise));
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
  Random random;
  std::vector<RelativePoseFactor<Pose>> sample;
  std::vector<std::size_t> later;  // the place in the order of arrival of each wrong loop's later pose, ascending
  std::size_t placed = 0;
  std::vector<std::pair<PoseId, Pose>> poses;
  PoseId highest{std::numeric_limits<std::int64_t>::min()};

  bool Draw(PoseId id, const Pose& T_world_id, const std::vector<PoseId>& linked, RelativePoseFactor<Pose>& wrong);
};

// A wrong loop from `id`, the next pose, to an earlier one; false if no draw gave one.
template <class Pose>
bool WrongLoops<Pose>::State::Draw(PoseId id, const Pose& T_world_id, const std::vector<PoseId>& linked,
                                   RelativePoseFactor<Pose>& wrong) {
  for (int draw = 0; draw < kDraws; ++draw) {
    const auto& [other, T_world_other] = poses[Below(random, poses.size())];
    const RelativePoseFactor<Pose>& loop = sample[Below(random, sample.size())];
    // Closer than all its links, it would bring the pose in.
    if (!(other < linked.back()) || std::binary_search(linked.begin(), linked.end(), other)) continue;
    const bool forward = loop.from < loop.to;
    wrong.from = forward ? other : id;
    wrong.to = forward ? id : other;
    wrong.T_from_to = WithNoise(loop, random);
    wrong.information = loop.information;
    const double chi2 = forward ? FactorChi2<Pose>(wrong, T_world_other, T_world_id)
                                : FactorChi2<Pose>(wrong, T_world_id, T_world_other);
    if (chi2 >= kWrongChi2PerDof * Pose::kDof) return true;
  }
  return false;
}

template <class Pose>
WrongLoops<Pose>::WrongLoops(const LoopSurvey<Pose>& survey, double percent, std::uint64_t seed)
    : state_(new State{Random(StreamSeed(seed, kDrawStream)), survey.Sample(), {}, 0, {}}) {
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
  // The later one of two different poses.
  const std::size_t n = static_cast<std::size_t>(survey.Poses());
  for (double k = 0; k < wanted; ++k) {
    const std::size_t a = Below(state_->random, n), b = Below(state_->random, n - 1);
    state_->later.push_back(std::max(a, b < a ? b : b + 1));
  }
  std::sort(state_->later.begin(), state_->later.end());
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
  while (!has_waited && !linked.empty() && s.placed < s.later.size() && s.later[s.placed] <= s.poses.size()) {
    RelativePoseFactor<Pose> wrong;
    if (!s.Draw(id, T_world_body_true, linked, wrong)) break;
    const PoseId other = OtherEnd(wrong, id);
    linked.insert(std::lower_bound(linked.begin(), linked.end(), other), other);
    out.push_back(wrong);
    ++s.placed;
  }
  s.poses.emplace_back(id, T_world_body_true);
  s.highest = std::max(s.highest, id);
  return out;
}

template <class Pose>
void WrongLoops<Pose>::ExpectDone() const {
  const std::size_t left = state_->later.size() - state_->placed;
  if (left == 0) return;
  throw std::invalid_argument(std::to_string(left) + " of " + std::to_string(state_->later.size()) +
                              " wrong loops find no place: too few pairs of poses are without a link and far enough "
                              "from what the loops measure");
}

namespace {

// A pose of a stored graph as it would have come in online.
template <class Pose>
struct Arrival {
  int pose = 0;
  std::vector<int> factors;                     // those that arrive with it, in order
  std::vector<RelativePoseFactor<Pose>> edges;  // the relative ones of them
};

template <class Pose>
std::vector<Arrival<Pose>> Arrivals(const PoseGraph<Pose>& graph) {
  std::vector<Arrival<Pose>> out;
  std::vector<std::size_t> position(graph.Poses().size());
  for (const ArrivalStep& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
    for (const int pose : step.poses) {
      position[static_cast<std::size_t>(pose)] = out.size();
      out.push_back({pose, {}, {}});
    }
    for (const int f : step.factors) {
      const auto& factor = graph.Factors()[static_cast<std::size_t>(f)].factor;
      const FactorPoses ends = PosesOf(factor);
      const auto at = [&](PoseId id) { return position[static_cast<std::size_t>(graph.IndexOf(id))]; };
      Arrival<Pose>& arrival = out[std::max(at(ends.first), at(ends.second))];
      arrival.factors.push_back(f);
      if (ends.count == 2) arrival.edges.push_back(std::get<RelativePoseFactor<Pose>>(factor));
    }
  }
  return out;
}

}  // namespace

template <class Pose>
GraphWithWrongLoops<Pose> AddWrongLoops(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body,
                                        double percent, std::uint64_t seed) {
  if (T_world_body.size() != graph.Poses().size()) throw std::invalid_argument("one value per pose is needed");
  const auto id = [&](int pose) { return graph.Poses()[static_cast<std::size_t>(pose)].id; };
  const std::vector<Arrival<Pose>> arrivals = Arrivals(graph);
  LoopSurvey<Pose> survey(seed);
  for (const auto& arrival : arrivals) survey.Arrive(id(arrival.pose), arrival.edges);
  WrongLoops<Pose> wrong_loops(survey, percent, seed);
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
                                                         std::uint64_t);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
