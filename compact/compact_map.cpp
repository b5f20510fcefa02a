// The compact map as a value, and back.

#include "terse/compact/compact_map.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <set>
#include <stdexcept>
#include <unordered_map>

#include "compact_pose_slam_parts.h"
#include "fused_edges.h"
#include "terse/core/at.h"
#include "terse/core/error.h"
#include "terse/core/require_optimum.h"

namespace terse {
namespace {

using internal::At;
using std::size_t;

std::string Text(PoseId id) { return "pose " + std::to_string(id.value); }

template <class Pose>
bool IsCovariance(const UncertainPose<Pose>& pose) {
  const auto& S = pose.covariance;
  return S.allFinite() && (S - S.transpose()).norm() <= 1e-9 * S.norm() && (S.diagonal().array() >= 0).all();
}

// Looks a map through, in the order of its members.
template <class Pose>
class Inspection {
 public:
  explicit Inspection(const CompactMap<Pose>& map) : map_(map) {}

  std::string Run() {
    for (size_t k = 0; k < map_.poses.size() && defect_.empty(); ++k) {
      where_ = "poses[" + std::to_string(k) + "].";
      CheckPose(map_.poses[k]);
      at_.emplace(map_.poses[k].id.value, k);
    }
    for (size_t k = 0; k < map_.poses.size() && defect_.empty(); ++k) {
      where_ = "poses[" + std::to_string(k) + "].";
      CheckNext(map_.poses[k]);
    }
    for (size_t k = 0; k < map_.edges.size() && defect_.empty(); ++k) {
      where_ = "edges[" + std::to_string(k) + "].";
      const auto& edge = map_.edges[k];
      CheckFactor(edge.factor);
      ExpectKept(edge.measured.from, "from");
      ExpectKept(edge.measured.to, "to");
      if (at_.count(edge.added_at.value) == 0) Fail("added_at", Text(edge.added_at) + " is none of the poses");
      CheckMeasured(Factor<Pose>(edge.measured));
      CheckParts(edge.parts, "edges[" + std::to_string(k) + "].");
    }
    for (size_t k = 0; k < map_.priors.size() && defect_.empty(); ++k) {
      where_ = "priors[" + std::to_string(k) + "].";
      CheckFactor(map_.priors[k].factor);
      const FactorPoses ends = PosesOf(map_.priors[k].measured);
      if (ends.count != 1) Fail("measurement", "a link, expected a prior");
      ExpectKept(ends.first, "pose");
      CheckMeasured(map_.priors[k].measured);
    }
    std::set<PoseId> fixed;
    for (size_t k = 0; k < map_.fixed.size() && defect_.empty(); ++k) {
      where_ = "fixed[" + std::to_string(k) + "].";
      ExpectKept(map_.fixed[k].pose, "pose");
      if (!fixed.insert(map_.fixed[k].pose).second) Fail("pose", Text(map_.fixed[k].pose) + " is there twice");
      if (!IsFinite(map_.fixed[k].T_world_body)) Fail("T_world_body", "not finite");
    }
    for (size_t k = 0; k < map_.refused.size() && defect_.empty(); ++k) {
      where_ = "refused[" + std::to_string(k) + "].";
      const auto& link = map_.refused[k];
      ExpectKept(link.candidate, "candidate");
      if (at_.count(link.seen.value) == 0) Fail("seen", Text(link.seen) + " is none of the poses");
      CheckChain(link.T_candidate_seen, "T_candidate_seen", "covariance");
    }
    for (size_t k = 0; k < map_.failed.size() && defect_.empty(); ++k) {
      where_ = "failed[" + std::to_string(k) + "].";
      ExpectKept(map_.failed[k].candidate, "candidate");
      if (at_.count(map_.failed[k].seen.value) == 0) Fail("seen", Text(map_.failed[k].seen) + " is none of the poses");
    }
    return defect_;
  }

 private:
  using SeenPose = typename CompactMap<Pose>::SeenPose;

  void Fail(const std::string& key, const std::string& cause) {
    if (defect_.empty()) defect_ = where_ + key + ": " + cause;
  }
  const SeenPose* Earlier(PoseId id) const {
    const auto it = at_.find(id.value);
    return it == at_.end() ? nullptr : &map_.poses[it->second];
  }
  void CheckChain(const UncertainPose<Pose>& chain, const char* key, const char* covariance) {
    if (!IsFinite(chain.T_a_b)) Fail(key, "not finite");
    if (!IsCovariance(chain)) Fail(covariance, "no covariance: expected finite, symmetric, variances not negative");
  }
  void CheckPose(const SeenPose& pose) {
    if (at_.count(pose.id.value) != 0) Fail("id", Text(pose.id) + " is there twice");
    if (!IsFinite(pose.T_world_body)) Fail("T_world_body", "not finite");
    if (!IsFinite(pose.T_world_body_when_seen)) Fail("T_world_body_when_seen", "not finite");
    const bool is_first = at_.empty();
    if (is_first && !pose.kept) Fail("kept", "false, but the first pose is always kept");
    if (is_first != !pose.previous) Fail("previous", is_first ? "the first pose has none" : "missing, expected an id");
    const SeenPose* previous = pose.previous ? Earlier(*pose.previous) : nullptr;
    if (pose.previous && previous == nullptr) {
      Fail("previous", Text(*pose.previous) + " is none of the poses before");
      return;
    }
    const SeenPose* parent = pose.anchored_to ? Earlier(*pose.anchored_to) : previous;
    if (pose.anchored_to && parent == nullptr) {
      Fail("anchored_to", Text(*pose.anchored_to) + " is none of the poses before");
      return;
    }
    const PoseId base = pose.kept || parent == nullptr ? pose.id : parent->base;
    if (pose.base != base) Fail("base", Text(pose.base) + ", expected " + Text(base));
    if (!pose.kept) CheckChain(pose.T_base_pose, "T_base_pose", "covariance");
  }
  void CheckNext(const SeenPose& pose) {
    if (pose.kept || !pose.next_kept) {
      if (pose.ended_by) Fail("ended_by", "the chain of the pose has not ended at a kept pose");
      return;
    }
    ExpectKept(*pose.next_kept, "next_kept");
    CheckChain(pose.T_base_next, "T_base_next", "covariance_next");
    if (!pose.ended_by) return;
    const SeenPose* end = Earlier(*pose.ended_by);
    if (end != nullptr && at_.at(end->id.value) <= at_.at(pose.id.value)) {
      Fail("ended_by", Text(*pose.ended_by) + " does not come after the pose");
    } else if (end == nullptr || !end->anchored_to) {
      Fail("ended_by", Text(*pose.ended_by) + (end == nullptr ? " is none of the poses" : " was not anchored"));
    }
  }
  void ExpectKept(PoseId id, const char* key) {
    const SeenPose* pose = Earlier(id);
    if (pose == nullptr || !pose->kept) {
      Fail(key, Text(id) + (pose == nullptr ? " is none of the poses" : " was dropped, expected a kept one"));
    }
  }
  void CheckParts(const std::vector<typename CompactMap<Pose>::Part>& parts, const std::string& edge) {
    for (size_t k = 0; k < parts.size() && defect_.empty(); ++k) {
      where_ = edge + "parts[" + std::to_string(k) + "].";
      if (at_.count(parts[k].added_at.value) == 0) Fail("added_at", Text(parts[k].added_at) + " is none of the poses");
      const std::int64_t id = parts[k].id.value, limit = std::int64_t{1} << 60;
      if (id < -limit || (id < -1 && !parts_.insert(parts[k].id).second))
        Fail("id", std::to_string(id) + (id < -limit ? " is out of range" : " is there twice"));
      if (parts[k].measurements < 1 || parts[k].measurements > limit) Fail("measurements", "expected 1 or more");
      if (!std::isfinite(parts[k].gain)) Fail("gain_nats", "not finite");
      CheckChain(parts[k].T_from_to, "T_from_to", "covariance");
      const bool is_definite = parts[k].T_from_to.covariance.llt().info() == Eigen::Success;
      if (!is_definite) Fail("covariance", "not positive definite");
    }
  }
  void CheckFactor(FactorId id) {
    if (id.value < 0) Fail("factor", std::to_string(id.value) + ", expected 0 or more");
    if (!factors_.insert(id).second) Fail("factor", std::to_string(id.value) + " is there twice");
  }
  void CheckMeasured(const Factor<Pose>& measured) {
    const std::string defect = FindDefect(measured);
    if (!defect.empty()) Fail("measurement", defect);
  }

  const CompactMap<Pose>& map_;
  std::string where_, defect_;
  std::unordered_map<std::int64_t, size_t> at_;  // of those looked through
  std::set<FactorId> factors_, parts_;
};

}  // namespace

template <class Pose>
std::string FindDefect(const CompactMap<Pose>& map) {
  return Inspection<Pose>(map).Run();
}

// The poses that an odometry edge between kept poses was concatenated over, its ends included; empty for one
// measurement.
template <class Pose>
std::vector<PoseId> CompactPoseSlam<Pose>::ComposedOf(const RelativePoseFactor<Pose>& edge) const {
  const int newer = std::max(index_.at(edge.from.value), index_.at(edge.to.value));
  int k = history_[At(newer)].parent;
  if (k < 0 || history_[At(k)].kept) return {};
  std::vector<PoseId> chain = {history_[At(newer)].id};
  for (; k >= 0; k = history_[At(k)].parent) {
    chain.push_back(history_[At(k)].id);
    if (history_[At(k)].kept) break;
  }
  std::reverse(chain.begin(), chain.end());
  return chain;
}

template <class Pose>
CompactMap<Pose> CompactPoseSlam<Pose>::Export(Recovery recovery) const {
  CompactMap<Pose> map;
  const std::vector<RecoveredPose<Pose>> trajectory = Trajectory(recovery);
  for (size_t k = 0; k < history_.size(); ++k) {
    const Seen& seen = history_[k];
    typename CompactMap<Pose>::SeenPose pose;
    pose.id = seen.id;
    pose.kept = seen.kept;
    pose.T_world_body = trajectory[k].T_world_body;
    pose.T_world_body_when_seen = seen.T_world_body_when_seen;
    if (seen.previous >= 0) pose.previous = history_[At(seen.previous)].id;
    pose.base = seen.base;
    pose.T_base_pose = seen.T_base_pose;
    pose.next_kept = seen.next_kept;
    pose.T_base_next = seen.T_base_next;
    if (seen.anchored) pose.anchored_to = history_[At(seen.parent)].id;
    if (seen.ended_by >= 0) pose.ended_by = history_[At(seen.ended_by)].id;
    pose.carried = seen.stretch >= 0 && history_[At(seen.stretch)].carried;
    map.poses.push_back(std::move(pose));
  }
  auto link = links_.begin();
  for (const auto& node : solver_->Graph().Factors()) {
    const auto* measured = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (measured == nullptr) {
      map.priors.push_back({node.id, node.factor});
      continue;
    }
    typename CompactMap<Pose>::Edge edge;
    edge.factor = node.id;
    edge.measured = *measured;
    while (link != links_.end() && link->factor < node.id) ++link;
    if (link != links_.end() && link->factor == node.id) {
      edge.is_loop = true;
      edge.added_at = link->added_at;
      edge.gain = link->gain;
    } else {
      edge.added_at = index_.at(measured->from.value) > index_.at(measured->to.value) ? measured->from : measured->to;
      edge.composed_of = ComposedOf(*measured);
    }
    const auto* fused = fused_->Find(FusedEdges<Pose>::Ordered(measured->from, measured->to));
    if (fused != nullptr && fused->factor == node.id) edge.parts = fused->parts;
    map.edges.push_back(std::move(edge));
  }
  for (const auto& node : solver_->Graph().Poses()) {
    if (node.fixed) map.fixed.push_back({node.id, *node.T_world_body});
  }
  for (const Refused& refused : refused_) {
    map.refused.push_back({refused.candidate, refused.seen, refused.T_candidate_seen});
  }
  for (const Failed& failed : failed_) map.failed.push_back({failed.candidate, failed.seen});
  return map;
}

template <class Pose>
CompactPoseSlam<Pose> CompactPoseSlam<Pose>::Restore(const CompactMap<Pose>& map, const CompactOptions<Pose>& options) {
  const std::string defect = FindDefect(map);
  if (!defect.empty()) throw std::invalid_argument(defect);
  CompactPoseSlam slam(options);
  slam.TakeHistory(map);
  if (map.poses.empty()) return slam;
  GraphUpdate<Pose> update;
  std::unordered_map<std::int64_t, size_t> place;  // in the update
  for (const auto& pose : map.poses) {
    if (!pose.kept) continue;
    place[pose.id.value] = update.poses.size();
    update.poses.push_back({pose.id, pose.T_world_body, false});
  }
  for (const auto& fixed : map.fixed) {
    update.poses[place.at(fixed.pose.value)] = {fixed.pose, fixed.T_world_body, true};
  }
  // In order of arrival, as the ids were given.
  std::vector<std::pair<FactorId, const typename CompactMap<Pose>::Edge*>> order;
  std::unordered_map<std::int64_t, const Factor<Pose>*> prior;
  for (const auto& edge : map.edges) order.emplace_back(edge.factor, &edge);
  for (const auto& p : map.priors) {
    order.emplace_back(p.factor, nullptr);
    prior[p.factor.value] = &p.measured;
  }
  std::sort(order.begin(), order.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  for (const auto& [id, edge] : order) {
    if (edge != nullptr && !edge->is_loop) update.odometry.push_back(update.factors.size());
    update.factors.push_back(edge != nullptr ? Factor<Pose>(edge->measured) : *prior.at(id.value));
  }
  const StepReport report = slam.solver_->Update(update);
  for (size_t k = 0; k < order.size(); ++k) {
    const auto* edge = order[k].second;
    if (edge == nullptr) continue;
    slam.RestoreEdge(*edge, report.factor_ids[k]);
    if (!edge->is_loop) {
      const int ends[] = {slam.index_.at(edge->measured.from.value), slam.index_.at(edge->measured.to.value)};
      slam.history_[At(std::max(ends[0], ends[1]))].odometry = report.factor_ids[k];
      continue;
    }
    slam.links_.push_back({report.factor_ids[k], edge->added_at, edge->gain});
  }
  // Not from the solver's estimates: with its gate closed it has placed all poses one after the other, as new ones.
  std::vector<Pose> T_world_body;
  for (const auto& pose : map.poses) {
    if (pose.kept) T_world_body.push_back(pose.T_world_body);
  }
  const BatchResult<Pose> result = slam.solver_->FinishFrom(T_world_body);
  slam.UpdateCovariances();
  RequireOptimum(result);
  T_world_body.clear();
  for (const auto& pose : map.poses) T_world_body.push_back(pose.T_world_body);
  slam.gains_->Resume(options, static_cast<int>(slam.solver_->Graph().Poses().size()), slam.LinksKept(), T_world_body);
  return slam;
}

// What the factor of an edge is made of. A part that was a factor itself has the id of the edge from now on: no other
// has it.
template <class Pose>
void CompactPoseSlam<Pose>::RestoreEdge(const typename CompactMap<Pose>::Edge& edge, FactorId factor) {
  RememberEdge(edge.measured, factor, !edge.is_loop);
  const auto ends = FusedEdges<Pose>::Ordered(edge.measured.from, edge.measured.to);
  if (options_.strategy != Strategy::kBounded || edge.parts.empty()) return;
  auto parts = edge.parts;
  for (auto& part : parts) {
    if (part.id.value >= 0) part.id = factor;
    fused_->Reserve(part.id);
  }
  fused_->Set(ends, {factor, !edge.is_loop, std::move(parts)});
}

template <class Pose>
void CompactPoseSlam<Pose>::TakeHistory(const CompactMap<Pose>& map) {
  for (const auto& pose : map.poses) {
    Seen seen;
    seen.id = pose.id;
    seen.kept = pose.kept;
    seen.base = pose.base;
    seen.T_world_body_when_seen = pose.T_world_body_when_seen;
    if (pose.previous) seen.previous = seen.parent = index_.at(pose.previous->value);
    seen.anchored = pose.anchored_to.has_value();
    if (seen.anchored) seen.parent = index_.at(pose.anchored_to->value);
    const int at = static_cast<int>(history_.size());
    if (!seen.kept) seen.stretch = StretchBehind(seen.parent, seen.anchored, at);
    seen.carried = pose.carried && seen.stretch == at;
    if (!pose.kept) {
      seen.T_base_pose = pose.T_base_pose;
      seen.next_kept = pose.next_kept;
      if (pose.next_kept) seen.T_base_next = pose.T_base_next;
    }
    if (seen.parent >= 0) ++history_[At(seen.parent)].successors;
    index_[seen.id.value] = at;
    history_.push_back(std::move(seen));
  }
  for (const auto& pose : map.poses) {
    if (pose.ended_by) history_[At(index_.at(pose.id.value))].ended_by = index_.at(pose.ended_by->value);
  }
  for (const auto& refused : map.refused) {
    refused_.push_back({refused.candidate, refused.seen, refused.T_candidate_seen});
  }
  for (const auto& failed : map.failed) failed_.push_back({failed.candidate, failed.seen});
}

#define TERSE_INSTANTIATE(Pose)                                                                                        \
  template std::string FindDefect<Pose>(const CompactMap<Pose>&);                                                      \
  template std::vector<PoseId> CompactPoseSlam<Pose>::ComposedOf(const RelativePoseFactor<Pose>&) const;               \
  template CompactMap<Pose> CompactPoseSlam<Pose>::Export(Recovery) const;                                             \
  template CompactPoseSlam<Pose> CompactPoseSlam<Pose>::Restore(const CompactMap<Pose>&, const CompactOptions<Pose>&); \
  template void CompactPoseSlam<Pose>::RestoreEdge(const typename CompactMap<Pose>::Edge&, FactorId);                  \
  template void CompactPoseSlam<Pose>::TakeHistory(const CompactMap<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
