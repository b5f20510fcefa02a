// How the map as a whole lies: the gauge, and the rigid motion when absolute measurements take it over.

#include <algorithm>
#include <cmath>
#include <set>

#include "incremental/update_plan.h"
#include "terse/core/at.h"
#include "terse/core/frame_alignment.h"

namespace terse::internal {
namespace {

using std::size_t;

// The gauge is found anew when so many more absolute measurements have come, as a share of those there were: what they
// determine changes with their number, and finding it takes all of them.
constexpr double kWorthFinding = 0.02;

// Whether what one anchor holds is most of what the other holds. In the tangent space of the same pose.
template <class Pose>
bool HoldTheSame(const Gauge<Pose>& a, const Gauge<Pose>& b) {
  if (a.free_shifts != b.free_shifts || a.free_turns != b.free_turns) return false;
  const double common = (a.root * b.root).trace() / kAnchorInformation;  // of projections
  return common > a.free_shifts + a.free_turns - 0.25;
}

template <class Pose>
AbsoluteFactors CountAbsoluteAfter(const GraphUpdate<Pose>& update, const LinearizedGraph<Pose>& map) {
  AbsoluteFactors count = map.Frame().absolute;
  const auto add = [&](const Factor<Pose>& factor, int sign) {
    if (std::holds_alternative<PosePriorFactor<Pose>>(factor)) count.pose_priors += sign;
    if (std::holds_alternative<PositionPriorFactor<Pose>>(factor)) count.position_priors += sign;
  };
  for (const auto& pose : update.poses) count.pose_priors += pose.fixed ? 1 : 0;
  for (const auto& factor : update.factors) add(factor, 1);
  for (const FactorId id : update.removed) add(map.Graph().FindFactor(id)->factor, -1);
  return count;
}

template <class Pose>
using Placed = std::vector<std::pair<Factor<Pose>, Pose>>;  // absolute measurements, where their poses are

// The absolute measurements that there will be, each with its pose in the frame that the map has now: a new pose is
// where a factor to a known pose puts it, if there is one.
template <class Pose>
Placed<Pose> AbsoluteAfter(const GraphUpdate<Pose>& update, const LinearizedGraph<Pose>& map,
                           const UpdatePlan<Pose>& plan) {
  const PoseGraph<Pose>& graph = map.Graph();
  const int old = static_cast<int>(graph.Poses().size());
  std::vector<Pose> in_map = plan.new_values;
  std::vector<char> is_placed(in_map.size(), 0);
  for (const auto& factor : update.factors) {
    const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor);
    if (f == nullptr) continue;
    const int from = plan.IndexOf(f->from, graph), to = plan.IndexOf(f->to, graph);
    const auto place = [&](int known, int fresh, const Pose& T_known_fresh) {
      const bool is_known = known < old || is_placed[At(known - old)] != 0;
      if (fresh < old || is_placed[At(fresh - old)] != 0 || !is_known) return;
      in_map[At(fresh - old)] = (known < old ? map.EstimateAt(known) : in_map[At(known - old)]) * T_known_fresh;
      is_placed[At(fresh - old)] = 1;
    };
    place(from, to, f->T_from_to);
    place(to, from, f->T_from_to.Inverse());
  }
  const std::set<FactorId> removed(update.removed.begin(), update.removed.end());
  Placed<Pose> out;
  for (int v = 0; v < old; ++v) {
    const auto& node = graph.Poses()[At(v)];
    if (node.fixed) out.emplace_back(FixedPosePrior<Pose>(node.id, *node.T_world_body), map.EstimateAt(v));
  }
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    if (ends.count != 1) continue;
    if (removed.count(node.id) != 0) continue;
    out.emplace_back(node.factor, map.EstimateAt(graph.IndexOf(ends.first)));
  }
  for (size_t k = 0; k < update.poses.size(); ++k) {
    if (update.poses[k].fixed) {
      out.emplace_back(FixedPosePrior<Pose>(update.poses[k].id, *update.poses[k].T_world_body), in_map[k]);
    }
  }
  for (const auto& factor : update.factors) {
    const FactorPoses ends = PosesOf(factor);
    if (ends.count != 1) continue;
    const int index = plan.IndexOf(ends.first, graph);
    out.emplace_back(factor, index < old ? map.EstimateAt(index) : in_map[At(index - old)]);
  }
  return out;
}

// Everything at T_new_old times its estimate, and linearised there. A new pose whose own measurement gave it its value
// stays there.
template <class Pose>
void PlanMotion(const GraphUpdate<Pose>& update, const Pose& T_new_old, const LinearizedGraph<Pose>& map,
                UpdatePlan<Pose>& plan) {
  std::vector<char> has_prior(update.poses.size(), 0);
  const int old = static_cast<int>(map.Graph().Poses().size());
  for (const auto& factor : update.factors) {
    const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor);
    if (f == nullptr) continue;
    const int index = plan.IndexOf(f->pose, map.Graph());
    if (index >= old) has_prior[At(index - old)] = 1;
  }
  for (size_t k = 0; k < update.poses.size(); ++k) {
    const bool is_absolute = update.poses[k].fixed || (has_prior[k] != 0 && !update.poses[k].T_world_body);
    if (is_absolute) continue;
    plan.new_values[k] = T_new_old * plan.new_values[k];
    plan.new_values[k].Normalize();
  }
  if (old == 0) return;
  for (int v = 0; v < old; ++v) {
    plan.moved_points.push_back(T_new_old * map.EstimateAt(v));
    plan.moved_points.back().Normalize();
  }
  const auto point = [&](int v) -> const Pose& { return plan.moved_points[At(v)]; };
  std::vector<char> is_removed(At(map.Slots()), 0);
  for (const FactorId id : update.removed) {
    if (map.SlotOf(id) >= 0) is_removed[At(map.SlotOf(id))] = 1;
  }
  for (int slot = 0; slot < map.Slots(); ++slot) {
    if (map.Cholesky().LinearFactorAt(slot).first < 0 || is_removed[At(slot)] != 0 || slot == map.AnchorSlot())
      continue;
    plan.changes.replaced.emplace_back(slot, map.LinearizeSlot(slot, point));
  }
}

}  // namespace

template <class Pose>
void PlanFrame(const GraphUpdate<Pose>& update, const LinearizedGraph<Pose>& map, const IncrementalOptions& options,
               UpdatePlan<Pose>& plan) {
  const MapFrame<Pose>& was = map.Frame();
  MapFrame<Pose>& frame = plan.frame;
  frame = was;
  frame.absolute = CountAbsoluteAfter(update, map);
  if (options.anchor_information) {
    frame.gauge.root = Gauge<Pose>::Root::Identity() * std::sqrt(*options.anchor_information);
    return;
  }
  const int count = frame.absolute.Count();
  const bool loses = std::any_of(update.removed.begin(), update.removed.end(),
                                 [&](FactorId id) { return PosesOf(map.Graph().FindFactor(id)->factor).count == 1; });
  const bool comes_more = count > was.found_at && count >= (1 + kWorthFinding) * was.found_at;
  // It reaches all of the graph, so the weak anchor beside position priors is no longer needed.
  const bool is_first_pose_prior = was.absolute.pose_priors == 0 && frame.absolute.pose_priors > 0;
  if (!loses && !is_first_pose_prior && (was.gauge.IsDetermined() || !comes_more)) return;
  const Placed<Pose> measurements = AbsoluteAfter(update, map, plan);
  AbsoluteInformation<Pose> information;
  for (const auto& [factor, T_world_body] : measurements) information.Add(factor, T_world_body);
  const int old = static_cast<int>(map.Graph().Poses().size());
  const Pose& T_world_first = old > 0 ? map.Points().front() : plan.new_values.front();
  const Gauge<Pose> found = information.FindGauge(T_world_first);
  frame.found_at = count;
  const bool less_is_free = found.free_shifts < was.gauge.free_shifts || found.free_turns < was.gauge.free_turns;
  const bool more_is_free = found.free_shifts > was.gauge.free_shifts || found.free_turns > was.gauge.free_turns;
  const bool stays = more_is_free || (HoldTheSame(found, was.gauge) && !is_first_pose_prior);
  if (!less_is_free && !loses && old > 0 && stays) return;
  frame.gauge = found;
  if (!less_is_free) return;
  if (const auto T_new_old = AlignToAbsolute(measurements)) PlanMotion(update, *T_new_old, map, plan);
}

template <class Pose>
std::string DescribeUndetermined(const LinearizedGraph<Pose>& map, const IncrementalOptions& options) {
  if (map.Frame().absolute.Count() == 0 || map.Graph().Poses().empty() || options.anchor_information) return "";
  return terse::DescribeUndetermined(map.Frame().gauge, map.EstimateAt(0));
}

#define TERSE_INSTANTIATE(Pose)                                                                              \
  template void PlanFrame(const GraphUpdate<Pose>&, const LinearizedGraph<Pose>&, const IncrementalOptions&, \
                          UpdatePlan<Pose>&);                                                                \
  template std::string DescribeUndetermined(const LinearizedGraph<Pose>&, const IncrementalOptions&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
