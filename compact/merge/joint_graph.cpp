#include "merge/joint_graph.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "terse/compact/innovation.h"
#include "terse/core/at.h"
#include "terse/core/error.h"
#include "terse/core/frame_alignment.h"
#include "terse/core/gauge.h"

namespace terse::internal {
namespace {

using std::size_t;

// Between the test of links and truncated least squares.
constexpr int kMostRounds = 10;
// A link that came in and was thrown out again so often stays out.
constexpr int kMostReturns = 2;

template <class Pose>
bool IsAbsolute(const Factor<Pose>& factor) {
  return PosesOf(factor).count == 1;
}

}  // namespace

template <class Pose>
JointGraph<Pose>::JointGraph(const std::vector<OptimalMap<Pose>>& maps, const std::vector<CarriedLink<Pose>>& links,
                             const MapPlacement<Pose>& placement, double stated_limit, int threads)
    : maps_(maps),
      links_(links),
      placement_(placement),
      stated_limit_(stated_limit),
      threads_(threads),
      limit_(stated_limit * placement.limit_share),
      states_(links.size()),
      joint_factor_(maps.size()) {
  for (const size_t l : placement.members) states_[l].in = true;
  for (const size_t l : placement.holding) states_[l].holds = true;
  for (size_t k = 1; k < maps.size(); ++k) {
    if (placement.IsJoined(k)) order_.push_back(k);
  }
  if (placement.IsJoined(0)) order_.push_back(0);
  Join();
}

// Of a map whose origin somebody chose the joint frame keeps that only if it is the reference.
template <class Pose>
bool JointGraph<Pose>::KeepsAbsolute(size_t map) const {
  return maps_[map].absolute != Absolute::kFrame || (map == placement_.reference && !placement_.has_datum);
}

template <class Pose>
void JointGraph<Pose>::Join() {
  std::vector<std::pair<Factor<Pose>, Pose>> absolute;
  for (const size_t k : order_) {
    for (const auto& node : maps_[k].graph.Poses()) {
      values_.push_back(placement_.T_joint_map[k] * *node.T_world_body);
      maps_graph_.AddPose(node.id, values_.back());
      if (node.fixed && KeepsAbsolute(k)) maps_graph_.SetFixed(node.id, true);
    }
    for (const auto& node : maps_[k].graph.Factors()) {
      if (IsAbsolute(node.factor) && !KeepsAbsolute(k)) continue;
      joint_factor_[k][node.id] = maps_graph_.AddFactor(node.factor);
      if (IsAbsolute(node.factor)) absolute.emplace_back(node.factor, ValueOf(PosesOf(node.factor).first));
    }
  }
  if (absolute.empty()) return;
  const std::optional<Pose> T_world_joint = AlignToAbsolute(absolute);
  if (!T_world_joint) return;
  for (size_t v = 0; v < values_.size(); ++v) {
    if (!maps_graph_.Poses()[v].fixed) values_[v] = *T_world_joint * values_[v];
  }
}

template <class Pose>
PoseGraph<Pose> JointGraph<Pose>::Graph() const {
  PoseGraph<Pose> graph = maps_graph_.WithPoses(values_);
  for (size_t l = 0; l < links_.size(); ++l) {
    if (states_[l].in) graph.AddFactor(links_[l].measured);
  }
  return graph;
}

template <class Pose>
bool JointGraph<Pose>::AreJoined(size_t link) const {
  return placement_.IsJoined(At(links_[link].from_map)) && placement_.IsJoined(At(links_[link].to_map));
}

template <class Pose>
BatchResult<Pose> JointGraph<Pose>::Solve(const PoseGraph<Pose>& graph, BatchOptions options) {
  options.threads = threads_;
  BatchResult<Pose> result = SolveBatch(graph, values_, options);
  if (result.cholesky.Variables() == 0) throw NumericalError("the joint map has no optimum: " + result.message);
  values_ = result.T_world_body;
  return result;
}

template <class Pose>
double JointGraph<Pose>::InnovationOf(size_t link, const Marginals<Pose>& marginals) const {
  const RelativePoseFactor<Pose>& measured = links_[link].measured;
  const UncertainPose<Pose> predicted{ValueOf(measured.from).Inverse() * ValueOf(measured.to),
                                      marginals.Relative(measured.from, measured.to)};
  return InnovationDistance(predicted, SeenFrom(measured.from, measured));
}

// True if any came in. Each link tells of the scale once.
template <class Pose>
bool JointGraph<Pose>::LetIn(BatchResult<Pose> result, bool is_first) {
  const Marginals<Pose> marginals(Graph(), std::move(result));
  std::vector<std::pair<size_t, double>> outside;  // with their innovations
  for (size_t l = 0; l < links_.size(); ++l) {
    if (states_[l].in || !AreJoined(l)) continue;
    outside.emplace_back(l, InnovationOf(l, marginals));
    if (is_first && outside.back().second <= limit_) scale_.Add(outside.back().second);
  }
  limit_ = std::min(limit_, scale_.Limit(stated_limit_, Pose::kDof));
  bool any = false;
  for (const auto& [l, innovation] : outside) {
    if (innovation > limit_ || states_[l].returns >= kMostReturns) continue;
    states_[l].in = any = true;
  }
  return any;
}

// True if any went.
template <class Pose>
bool JointGraph<Pose>::ThrowOut(bool graduate) {
  BatchOptions options;
  options.robust.kernel = RobustKernel::kGnc;
  options.robust.width = std::sqrt(limit_);
  options.graduate = graduate;
  options.robust_factors.emplace();
  std::vector<size_t> judged;
  auto id = static_cast<std::int64_t>(maps_graph_.Factors().size());
  for (size_t l = 0; l < links_.size(); ++l) {
    if (!states_[l].in) continue;
    if (!states_[l].holds) {
      options.robust_factors->push_back({id});
      judged.push_back(l);
    }
    ++id;
  }
  if (judged.empty()) return false;
  const BatchResult<Pose> result = Solve(Graph(), options);
  bool any = false;
  for (size_t k = 0; k < judged.size(); ++k) {
    if (result.weights[static_cast<size_t>((*options.robust_factors)[k].value)] > 0) continue;
    states_[judged[k]].in = false;
    ++states_[judged[k]].returns;
    any = true;
  }
  return any;
}

template <class Pose>
BatchResult<Pose> JointGraph<Pose>::Decide() {
  for (int round = 0; round < kMostRounds; ++round) {
    const bool came = LetIn(Solve(Graph(), {}), round == 0);
    const bool went = ThrowOut(round == 0);
    if (!came && !went) break;
  }
  BatchResult<Pose> result = Solve(Graph(), {});
  if (CountAbsoluteFactors(maps_graph_).Count() == 0) {
    const auto& first = maps_[placement_.reference].graph.Poses().front();
    const Pose T = *first.T_world_body * ValueOf(first.id).Inverse();
    for (Pose& value : values_) value = T * value;
    result.T_world_body = values_;  // a motion of the whole: the factor, on the right, is the same
  }
  return result;
}

template <class Pose>
CompactMap<Pose> JointGraph<Pose>::Map() const {
  CompactMap<Pose> joint;
  std::int64_t lowest_part = -1;
  for (const size_t k : order_) {
    const CompactMap<Pose>& map = maps_[k].map;
    const auto& first = maps_[k].graph.Poses().front();
    const Pose T = ValueOf(first.id) * first.T_world_body->Inverse();
    for (auto pose : map.poses) {
      pose.T_world_body = pose.kept ? ValueOf(pose.id) : T * pose.T_world_body;
      pose.T_world_body_when_seen = T * pose.T_world_body_when_seen;
      if (!pose.previous && !joint.poses.empty()) pose.previous = joint.poses.back().id;
      joint.poses.push_back(std::move(pose));
    }
    std::int64_t lowest = -1;
    for (auto edge : map.edges) {
      edge.factor = joint_factor_[k].at(edge.factor);
      for (auto& part : edge.parts) {
        if (part.id.value >= -1) continue;
        lowest = std::min(lowest, part.id.value);
        part.id.value += lowest_part + 1;
      }
      joint.edges.push_back(std::move(edge));
    }
    lowest_part += lowest + 1;
    for (const auto& prior : map.priors) {
      const auto id = joint_factor_[k].find(prior.factor);
      if (id != joint_factor_[k].end()) joint.priors.push_back({id->second, prior.measured});
    }
    if (KeepsAbsolute(k)) joint.fixed.insert(joint.fixed.end(), map.fixed.begin(), map.fixed.end());
    joint.refused.insert(joint.refused.end(), map.refused.begin(), map.refused.end());
    joint.failed.insert(joint.failed.end(), map.failed.begin(), map.failed.end());
  }
  auto id = static_cast<std::int64_t>(maps_graph_.Factors().size());
  for (size_t l = 0; l < links_.size(); ++l) {
    if (!states_[l].in) continue;
    typename CompactMap<Pose>::Edge edge;
    edge.factor = {id++};
    edge.measured = links_[l].measured;
    edge.is_loop = true;
    const bool from_is_newer = maps_graph_.IndexOf(edge.measured.from) > maps_graph_.IndexOf(edge.measured.to);
    edge.added_at = from_is_newer ? edge.measured.from : edge.measured.to;
    joint.edges.push_back(std::move(edge));
  }
  std::sort(joint.edges.begin(), joint.edges.end(), [](const auto& a, const auto& b) { return a.factor < b.factor; });
  return joint;
}

template class JointGraph<SE2>;
template class JointGraph<SE3>;

}  // namespace terse::internal
