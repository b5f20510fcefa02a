// How the map as a whole lies: the gauge, and the rigid motion when absolute measurements take it over.

#include <algorithm>
#include <cmath>
#include <set>

#include "graph/frame_alignment.h"
#include "incremental/incremental_plan.h"
#include "terse/core/log_message.h"

namespace terse {
namespace {

using internal::Log;
using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

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

}  // namespace

template <class Pose>
std::string IncrementalSolver<Pose>::DescribeUndetermined() const {
  if (absolute_.Count() == 0 || graph_.Poses().empty() || options_.anchor_information) return "";
  return terse::DescribeUndetermined(gauge_, EstimateAt(0));
}

// The absolute measurements that there will be, each with its pose in the frame that the map has now: a new pose is
// where a factor to a known pose puts it, if there is one.
template <class Pose>
typename IncrementalSolver<Pose>::Placed IncrementalSolver<Pose>::AbsoluteAfter(const GraphUpdate<Pose>& update,
                                                                                const Plan& plan) const {
  const int old = static_cast<int>(graph_.Poses().size());
  std::vector<Pose> in_map = plan.new_values;
  std::vector<char> is_placed(in_map.size(), 0);
  for (const auto& factor : update.factors) {
    const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor);
    if (f == nullptr) continue;
    const int from = plan.IndexOf(f->from, graph_), to = plan.IndexOf(f->to, graph_);
    const auto place = [&](int known, int fresh, const Pose& T_known_fresh) {
      const bool is_known = known < old || is_placed[At(known - old)] != 0;
      if (fresh < old || is_placed[At(fresh - old)] != 0 || !is_known) return;
      in_map[At(fresh - old)] = (known < old ? EstimateAt(known) : in_map[At(known - old)]) * T_known_fresh;
      is_placed[At(fresh - old)] = 1;
    };
    place(from, to, f->T_from_to);
    place(to, from, f->T_from_to.Inverse());
  }
  const std::set<FactorId> removed(update.removed.begin(), update.removed.end());
  Placed out;
  for (int v = 0; v < old; ++v) {
    const auto& node = graph_.Poses()[At(v)];
    if (node.fixed) out.emplace_back(FixedPosePrior<Pose>(node.id, *node.T_world_body), EstimateAt(v));
  }
  for (const auto& node : graph_.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    if (ends.count != 1) continue;
    if (removed.count(node.id) != 0) continue;
    out.emplace_back(node.factor, EstimateAt(graph_.IndexOf(ends.first)));
  }
  for (size_t k = 0; k < update.poses.size(); ++k) {
    if (update.poses[k].fixed) {
      out.emplace_back(FixedPosePrior<Pose>(update.poses[k].id, *update.poses[k].T_world_body), in_map[k]);
    }
  }
  for (const auto& factor : update.factors) {
    const FactorPoses ends = PosesOf(factor);
    if (ends.count != 1) continue;
    const int index = plan.IndexOf(ends.first, graph_);
    out.emplace_back(factor, index < old ? EstimateAt(index) : in_map[At(index - old)]);
  }
  return out;
}

// What the anchor will hold. Where it lets go, the map goes to where the measurements say before it does.
template <class Pose>
void IncrementalSolver<Pose>::PlanFrame(const GraphUpdate<Pose>& update, Plan& plan) const {
  plan.absolute = AbsoluteFactorsAfter(update);
  plan.gauge = gauge_;
  plan.gauge_found_at = gauge_found_at_;
  if (options_.anchor_information) {
    plan.gauge.root = Gauge<Pose>::Root::Identity() * std::sqrt(*options_.anchor_information);
    return;
  }
  const int count = plan.absolute.Count();
  const bool loses = std::any_of(update.removed.begin(), update.removed.end(),
                                 [&](FactorId id) { return PosesOf(graph_.FindFactor(id)->factor).count == 1; });
  const bool comes_more = count > gauge_found_at_ && count >= (1 + kWorthFinding) * gauge_found_at_;
  // It reaches all of the graph, so the weak anchor beside position priors is no longer needed.
  const bool is_first_pose_prior = absolute_.pose_priors == 0 && plan.absolute.pose_priors > 0;
  if (!loses && !is_first_pose_prior && (gauge_.IsDetermined() || !comes_more)) return;
  const Placed measurements = AbsoluteAfter(update, plan);
  AbsoluteInformation<Pose> information;
  for (const auto& [factor, T_world_body] : measurements) information.Add(factor, T_world_body);
  const int old = static_cast<int>(graph_.Poses().size());
  const Pose& T_world_first = old > 0 ? linearization_points_.front() : plan.new_values.front();
  const Gauge<Pose> found = information.FindGauge(T_world_first);
  plan.gauge_found_at = count;
  const bool less_is_free = found.free_shifts < gauge_.free_shifts || found.free_turns < gauge_.free_turns;
  const bool more_is_free = found.free_shifts > gauge_.free_shifts || found.free_turns > gauge_.free_turns;
  const bool stays = more_is_free || (HoldTheSame(found, gauge_) && !is_first_pose_prior);
  if (!less_is_free && !loses && old > 0 && stays) return;
  plan.gauge = found;
  if (!less_is_free) return;
  if (const auto T_new_old = internal::AlignToAbsolute(measurements)) PlanMotion(update, *T_new_old, plan);
}

// Everything at T_new_old times its estimate, and linearised there. A new pose whose own measurement gave it its value
// stays there.
template <class Pose>
void IncrementalSolver<Pose>::PlanMotion(const GraphUpdate<Pose>& update, const Pose& T_new_old, Plan& plan) const {
  std::vector<char> has_prior(update.poses.size(), 0);
  const int old = static_cast<int>(graph_.Poses().size());
  for (const auto& factor : update.factors) {
    const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor);
    if (f == nullptr) continue;
    const int index = plan.IndexOf(f->pose, graph_);
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
    plan.moved_points.push_back(T_new_old * EstimateAt(v));
    plan.moved_points.back().Normalize();
  }
  const auto point = [&](int v) -> const Pose& { return plan.moved_points[At(v)]; };
  std::vector<char> is_removed(factor_of_slot_.size(), 0);
  for (const FactorId id : update.removed) {
    const int slot = slot_of_factor_[static_cast<size_t>(id.value)];
    if (slot >= 0) is_removed[At(slot)] = 1;
  }
  for (int slot = 0; slot < static_cast<int>(factor_of_slot_.size()); ++slot) {
    if (factor_.FactorAt(slot).first < 0 || is_removed[At(slot)] != 0 || slot == anchor_slot_) continue;
    plan.changes.replaced.emplace_back(slot, LinearizeSlot(slot, point));
  }
}

// The factor holds the change already; the poses that were there are the first.
template <class Pose>
void IncrementalSolver<Pose>::CommitFrame(const Plan& plan) {
  const bool had_none = absolute_.Count() == 0;
  const bool is_news = plan.gauge.free_shifts != gauge_.free_shifts || plan.gauge.free_turns != gauge_.free_turns ||
                       had_none != (plan.absolute.Count() == 0);
  absolute_ = plan.absolute;
  gauge_ = plan.gauge;
  gauge_found_at_ = plan.gauge_found_at;
  if (!plan.moved_points.empty()) {
    std::copy(plan.moved_points.begin(), plan.moved_points.end(), linearization_points_.begin());
    for (int v = 0; v < static_cast<int>(plan.moved_points.size()); ++v) factor_.ClearSolution(v);
    ForgetErrors();
    ++look_;
    deferred_ = false;
    Log(options_.log, LogLevel::kInfo, "step ", updates_, ": the map moves as a whole to where its priors put it");
  }
  if (!is_news || absolute_.Count() == 0 || options_.anchor_information) return;
  const std::string words = DescribeUndetermined();
  Log(options_.log, LogLevel::kInfo, "step ", updates_, ": ",
      words.empty() ? "the priors determine where the map is and how it is turned" : words.c_str());
}

#define TERSE_INSTANTIATE(Pose)                                                            \
  template std::string IncrementalSolver<Pose>::DescribeUndetermined() const;              \
  template void IncrementalSolver<Pose>::PlanFrame(const GraphUpdate<Pose>&, Plan&) const; \
  template void IncrementalSolver<Pose>::CommitFrame(const Plan&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
