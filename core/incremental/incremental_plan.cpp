// What an update brings: checked, given initial values, linearised; and entered once the factor has it.

#include <algorithm>
#include <set>
#include <stdexcept>

#include "incremental/incremental_plan.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }
constexpr size_t At(FactorId id) { return static_cast<size_t>(id.value); }

}  // namespace

template <class Pose>
void IncrementalSolver<Pose>::Validate(const GraphUpdate<Pose>& update) const {
  std::set<PoseId> fresh;
  for (const auto& pose : update.poses) {
    if (graph_.HasPose(pose.id) || !fresh.insert(pose.id).second) {
      throw std::invalid_argument("pose " + std::to_string(pose.id.value) + " is in the graph already");
    }
  }
  for (const auto& factor : update.factors) {
    const FactorPoses ends = PosesOf(factor);
    for (const PoseId id : {ends.first, ends.second}) {
      if (!graph_.HasPose(id) && fresh.count(id) == 0) {
        throw std::invalid_argument("pose " + std::to_string(id.value) + " is not in the graph");
      }
    }
    const std::string defect = FindDefect(factor);
    if (!defect.empty()) throw std::invalid_argument(defect);
  }
  std::set<FactorId> removed;
  for (const auto& pose : update.poses) {
    const bool finite = !pose.T_world_body || IsFinite(*pose.T_world_body);
    if (!finite)
      throw std::invalid_argument("pose " + std::to_string(pose.id.value) + " has a value that is not finite");
    if (pose.fixed && !pose.T_world_body) {
      throw std::invalid_argument("pose " + std::to_string(pose.id.value) + " is fixed but has no value");
    }
  }
  for (const FactorId id : update.removed) {
    if (graph_.FindFactor(id) == nullptr || !removed.insert(id).second) {
      throw std::invalid_argument("factor " + std::to_string(id.value) + " is not in the graph");
    }
  }
}

// Values for the new poses: their own, or composed along the first factor that leads to a pose with one.
template <class Pose>
void IncrementalSolver<Pose>::PlanNewPoses(const GraphUpdate<Pose>& update, Plan& plan) const {
  std::vector<std::optional<Pose>> value(update.poses.size());
  const int old = static_cast<int>(graph_.Poses().size());
  for (size_t k = 0; k < update.poses.size(); ++k) {
    plan.new_index[update.poses[k].id] = old + static_cast<int>(k);
    value[k] = update.poses[k].T_world_body;
  }
  const auto known = [&](PoseId id) -> std::optional<Pose> {
    const int index = plan.IndexOf(id, graph_);
    return index < old ? std::optional<Pose>(EstimateAt(index)) : value[At(index - old)];
  };
  const auto offer = [&](PoseId id, const Pose& T_world_body) {
    auto& slot = value[At(plan.new_index.at(id) - old)];
    if (!slot) slot = T_world_body;
  };
  for (const auto& factor : update.factors) {
    if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor)) {
      if (plan.new_index.count(f->pose) != 0) offer(f->pose, f->T_world_body);
    }
  }
  const auto has_value = [](const std::optional<Pose>& v) { return v.has_value(); };
  if (old == 0 && !value.empty() && std::none_of(value.begin(), value.end(), has_value)) value[0] = Pose();
  // Breadth first over the update's edges, from what is known.
  std::vector<std::vector<const RelativePoseFactor<Pose>*>> edges(value.size());
  std::vector<const RelativePoseFactor<Pose>*> ready;
  for (const auto& factor : update.factors) {
    const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor);
    if (f == nullptr) continue;
    for (const PoseId id : {f->from, f->to}) {
      const auto it = plan.new_index.find(id);
      if (it != plan.new_index.end()) edges[At(it->second - old)].push_back(f);
    }
    if (known(f->from).has_value() != known(f->to).has_value()) ready.push_back(f);
  }
  for (size_t k = 0; k < ready.size(); ++k) {
    const RelativePoseFactor<Pose>& f = *ready[k];
    const std::optional<Pose> from = known(f.from), to = known(f.to);
    if (from && to) continue;
    const PoseId reached = from ? f.to : f.from;
    offer(reached, from ? *from * f.T_from_to : *to * f.T_from_to.Inverse());
    const auto& onward = edges[At(plan.new_index.at(reached) - old)];
    ready.insert(ready.end(), onward.begin(), onward.end());
  }
  for (size_t k = 0; k < value.size(); ++k) {
    if (!value[k]) {
      throw std::invalid_argument("pose " + std::to_string(update.poses[k].id.value) +
                                  " has no value and no factor to a pose that has one");
    }
    plan.new_values.push_back(*value[k]);
  }
}

// New factors, linearised where their poses are.
template <class Pose>
void IncrementalSolver<Pose>::PlanFactors(const GraphUpdate<Pose>& update, Plan& plan) const {
  const int old = static_cast<int>(graph_.Poses().size());
  const std::vector<Pose>& points = plan.moved_points.empty() ? linearization_points_ : plan.moved_points;
  const auto point = [&](int v) -> const Pose& { return v < old ? points[At(v)] : plan.new_values[At(v - old)]; };
  if (IsRobust()) FindLoops(update, plan);
  for (size_t k = 0; k < update.factors.size(); ++k) {
    const terse::Factor<Pose>& factor = update.factors[k];
    const FactorPoses ends = PosesOf(factor);
    const int first = plan.IndexOf(ends.first, graph_), second = plan.IndexOf(ends.second, graph_);
    plan.W.push_back(SquareRootInformation(factor));
    if (plan.IsLoop(k)) continue;
    plan.changes.added.push_back(Linearize(factor, plan.W.back(), first, second, point(first), point(second)));
  }
  for (size_t k = 0; k < update.poses.size(); ++k) {
    if (!update.poses[k].fixed) continue;
    const int index = old + static_cast<int>(k);
    const Pose& T = plan.new_values[k];
    plan.changes.added.push_back(Linearize<Pose>(FixedPosePrior<Pose>(update.poses[k].id, T), index, index, T, T));
  }
  for (const FactorId id : update.removed) {
    if (slot_of_factor_[At(id)] >= 0) plan.changes.removed.push_back(slot_of_factor_[At(id)]);
  }
  plan.changes.new_variables = static_cast<int>(update.poses.size());
}

template <class Pose>
AbsoluteFactors IncrementalSolver<Pose>::AbsoluteFactorsAfter(const GraphUpdate<Pose>& update) const {
  AbsoluteFactors count = absolute_;
  const auto add = [&](const terse::Factor<Pose>& factor, int sign) {
    if (std::holds_alternative<PosePriorFactor<Pose>>(factor)) count.pose_priors += sign;
    if (std::holds_alternative<PositionPriorFactor<Pose>>(factor)) count.position_priors += sign;
  };
  for (const auto& pose : update.poses) count.pose_priors += pose.fixed ? 1 : 0;
  for (const auto& factor : update.factors) add(factor, 1);
  for (const FactorId id : update.removed) add(graph_.FindFactor(id)->factor, -1);
  return count;
}

// Behind the others: PlanFrame has found the gauge.
template <class Pose>
void IncrementalSolver<Pose>::PlanAnchor(const GraphUpdate<Pose>& update, Plan& plan) const {
  if (anchor_slot_ < 0) {
    plan.adds_anchor = !graph_.Poses().empty() || !update.poses.empty();
    if (plan.adds_anchor) plan.changes.added.push_back(Anchor(plan.gauge));
  } else if (plan.gauge.root != gauge_.root) {
    plan.changes.replaced.emplace_back(anchor_slot_, Anchor(plan.gauge));
  }
}

// The slot's factor is `id` (-1: a fixed pose's prior or the anchor).
template <class Pose>
void IncrementalSolver<Pose>::BindSlot(int slot, FactorId id, const Matrix<B, B>& W) {
  if (At(slot) >= factor_of_slot_.size()) {
    factor_of_slot_.resize(At(slot) + 1);
    error_of_slot_.resize(At(slot) + 1, 0.0);
    is_suspect_.resize(At(slot) + 1, 0);
    is_listed_.resize(At(slot) + 1, 0);
    W_of_slot_.resize(At(slot) + 1, Matrix<B, B>::Zero());
  }
  if (IsRobust() && At(slot) >= is_loop_.size()) {
    is_loop_.resize(At(slot) + 1, 0);
    weight_of_slot_.resize(At(slot) + 1, 1.0);
    judged_chi2_.resize(At(slot) + 1, 0.0);
  }
  factor_of_slot_[At(slot)] = id;
  if (id.value < 0) return;
  W_of_slot_[At(slot)] = W;
  slot_of_factor_[At(id)] = slot;
  measured_scalars_ += Dimension(graph_.FindFactor(id)->factor);
}

// Before the factor goes, or waits outside.
template <class Pose>
void IncrementalSolver<Pose>::ReleaseSlot(FactorId id) {
  const size_t slot = At(std::exchange(slot_of_factor_[At(id)], -1));
  measured_scalars_ -= Dimension(graph_.FindFactor(id)->factor);
  error_sum_ -= std::exchange(error_of_slot_[slot], 0.0);
  factor_of_slot_[slot] = FactorId();
  if (!IsRobust()) return;
  is_loop_[slot] = 0;
  weight_of_slot_[slot] = 1;
}

// Nothing here fails short of memory: everything was validated, and the factor holds the change already.
template <class Pose>
void IncrementalSolver<Pose>::Commit(const GraphUpdate<Pose>& update, const Plan& plan, StepReport& report,
                                     const std::vector<int>& added_slots) {
  ++updates_;
  for (const FactorId id : update.removed) {
    if (slot_of_factor_[At(id)] >= 0) ReleaseSlot(id);
    graph_.RemoveFactor(id);
    Unpark(id);
  }
  for (size_t k = 0; k < update.poses.size(); ++k) {
    graph_.AddPose(update.poses[k].id, plan.new_values[k]);
    graph_.SetFixed(update.poses[k].id, update.poses[k].fixed);
    linearization_points_.push_back(plan.new_values[k]);
    possible_of_.push_back(0);
    remembered_.emplace_back();
    remembered_in_.push_back(0);
    seen_.push_back(Vector<B>::Zero());
  }
  size_t slots = 0;
  for (size_t k = 0; k < update.factors.size(); ++k) {
    const FactorId id = graph_.AddFactor(update.factors[k]);
    report.factor_ids.push_back(id);
    slot_of_factor_.resize(At(id) + 1, -1);
    if (!plan.IsLoop(k)) BindSlot(added_slots[slots++], id, plan.W[k]);
  }
  // Priors of fixed poses and the anchor have slots, but no id.
  for (; slots < added_slots.size(); ++slots) BindSlot(added_slots[slots], FactorId(), Matrix<B, B>::Zero());
  CommitFrame(plan);
  if (plan.adds_anchor) anchor_slot_ = added_slots.back();
}

#define TERSE_INSTANTIATE(Pose)                                                                           \
  template void IncrementalSolver<Pose>::Validate(const GraphUpdate<Pose>&) const;                        \
  template void IncrementalSolver<Pose>::PlanNewPoses(const GraphUpdate<Pose>&, Plan&) const;             \
  template void IncrementalSolver<Pose>::PlanFactors(const GraphUpdate<Pose>&, Plan&) const;              \
  template void IncrementalSolver<Pose>::PlanAnchor(const GraphUpdate<Pose>&, Plan&) const;               \
  template AbsoluteFactors IncrementalSolver<Pose>::AbsoluteFactorsAfter(const GraphUpdate<Pose>&) const; \
  template void IncrementalSolver<Pose>::BindSlot(int, FactorId, const Matrix<B, B>&);                    \
  template void IncrementalSolver<Pose>::ReleaseSlot(FactorId);                                           \
  template void IncrementalSolver<Pose>::Commit(const GraphUpdate<Pose>&, const Plan&, StepReport&,       \
                                                const std::vector<int>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
