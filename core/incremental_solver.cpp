#include "terse/core/incremental_solver.h"

#include <algorithm>
#include <map>
#include <set>
#include <stdexcept>

#include "stopwatch.h"
#include "terse/core/error.h"
#include "terse/core/gauge.h"
#include "terse/core/residual.h"

namespace terse {
namespace {

using internal::ScopedTimer;
using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }
constexpr size_t At(FactorId id) { return static_cast<size_t>(id.value); }

}  // namespace

// Everything an update will change, worked out before anything is.
template <class Pose>
struct IncrementalSolver<Pose>::Plan {
  std::map<PoseId, int> new_index;
  std::vector<Pose> new_values;                  // in the order of update.poses
  std::vector<std::pair<int, Pose>> new_points;  // relinearised: pose index, new linearisation point
  typename BlockCholesky<B>::Changes changes;
  bool adds_anchor = false;
  Vector<B> anchor_information;

  int IndexOf(PoseId id, const PoseGraph<Pose>& graph) const {
    const auto it = new_index.find(id);
    return it != new_index.end() ? it->second : graph.IndexOf(id);
  }
};

template <class Pose>
IncrementalSolver<Pose>::IncrementalSolver(const IncrementalOptions& options) : options_(options) {
  if (!(options.relinearize_metres >= 0) || !(options.relinearize_radians >= 0) || options.relinearize_interval < 1 ||
      !(options.propagation_threshold >= 0)) {
    throw std::invalid_argument("incremental options: tolerances must not be negative, the interval at least 1");
  }
}

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
  if (old == 0 && !value.empty() && !value[0]) value[0] = Pose();
  for (bool progress = true; progress;) {
    progress = false;
    for (const auto& factor : update.factors) {
      const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor);
      if (f == nullptr) continue;
      const std::optional<Pose> from = known(f->from), to = known(f->to);
      if (from && !to) offer(f->to, *from * f->T_from_to);
      if (to && !from) offer(f->from, *to * f->T_from_to.Inverse());
      progress = progress || from.has_value() != to.has_value();
    }
  }
  for (size_t k = 0; k < value.size(); ++k) {
    if (!value[k]) {
      throw std::invalid_argument("pose " + std::to_string(update.poses[k].id.value) +
                                  " has no value and no factor to a pose that has one");
    }
    plan.new_values.push_back(*value[k]);
  }
}

template <class Pose>
bool IncrementalSolver<Pose>::ExceedsTolerance(int variable) const {
  const double* d = factor_.Solution().data() + At(variable) * B;
  double metres2 = 0, radians2 = 0;
  for (int k = 0; k < Pose::kDim; ++k) metres2 += d[k] * d[k];
  for (int k = Pose::kDim; k < B; ++k) radians2 += d[k] * d[k];
  return metres2 > options_.relinearize_metres * options_.relinearize_metres ||
         radians2 > options_.relinearize_radians * options_.relinearize_radians;
}

// New linearisation points, and every factor that touches one again.
template <class Pose>
void IncrementalSolver<Pose>::PlanRelinearisation(const GraphUpdate<Pose>& update, Plan& plan) const {
  const std::set<FactorId> removed(update.removed.begin(), update.removed.end());
  std::map<int, Pose> moved;
  if ((updates_ + 1) % options_.relinearize_interval == 0) {
    for (const int v : outgrown_) {
      if (ExceedsTolerance(v)) moved.emplace(v, EstimateAt(v));
    }
  }
  const int old = static_cast<int>(graph_.Poses().size());
  const auto point = [&](int index) -> const Pose& {
    if (index >= old) return plan.new_values[At(index - old)];
    const auto it = moved.find(index);
    return it != moved.end() ? it->second : linearization_points_[At(index)];
  };
  std::set<int> slots;
  for (const auto& [v, T] : moved) {
    plan.new_points.emplace_back(v, T);
    slots.insert(factor_.SlotsOf(v).begin(), factor_.SlotsOf(v).end());
  }
  for (const int slot : slots) {
    const FactorId id = factor_of_slot_[At(slot)];
    // Anchors hold their pose so tightly that its linearisation never grows stale.
    if (id.value < 0) {
      plan.changes.replaced.emplace_back(slot, factor_.FactorAt(slot));
      continue;
    }
    if (removed.count(id) != 0) continue;
    const LinearFactor<B>& was = factor_.FactorAt(slot);
    const int second = was.second < 0 ? was.first : was.second;
    plan.changes.replaced.emplace_back(
        slot, Linearize(graph_.FindFactor(id)->factor, was.first, second, point(was.first), point(second)));
  }
  for (const auto& factor : update.factors) {
    const FactorPoses ends = PosesOf(factor);
    const int first = plan.IndexOf(ends.first, graph_), second = plan.IndexOf(ends.second, graph_);
    plan.changes.added.push_back(Linearize(factor, first, second, point(first), point(second)));
  }
  for (size_t k = 0; k < update.poses.size(); ++k) {
    if (!update.poses[k].fixed) continue;
    const int index = old + static_cast<int>(k);
    const Pose& T = plan.new_values[k];
    plan.changes.added.push_back(Linearize<Pose>(FixedPosePrior<Pose>(update.poses[k].id, T), index, index, T, T));
  }
  for (const FactorId id : update.removed) plan.changes.removed.push_back(slot_of_factor_[At(id)]);
  plan.changes.new_variables = static_cast<int>(update.poses.size());
}

template <class Pose>
AbsoluteFactors IncrementalSolver<Pose>::AbsoluteFactorsAfter(const GraphUpdate<Pose>& update) const {
  AbsoluteFactors count;
  count.pose_priors = fixed_poses_;
  for (const auto& pose : update.poses) count.pose_priors += pose.fixed ? 1 : 0;
  std::set<PoseId> positions;
  const auto add = [&](const terse::Factor<Pose>& factor) {
    if (std::holds_alternative<PosePriorFactor<Pose>>(factor)) ++count.pose_priors;
    if (const auto* f = std::get_if<PositionPriorFactor<Pose>>(&factor)) positions.insert(f->pose);
  };
  for (const FactorId id : absolute_factors_) {
    if (std::find(update.removed.begin(), update.removed.end(), id) == update.removed.end()) {
      add(graph_.FindFactor(id)->factor);
    }
  }
  for (const auto& factor : update.factors) add(factor);
  count.position_prior_poses = static_cast<int>(positions.size());
  return count;
}

template <class Pose>
void IncrementalSolver<Pose>::PlanAnchor(const GraphUpdate<Pose>& update, Plan& plan) const {
  plan.anchor_information = AnchorInformation<Pose>(AbsoluteFactorsAfter(update));
  if (anchor_slot_ < 0) {
    plan.adds_anchor = !graph_.Poses().empty() || !update.poses.empty();
    if (plan.adds_anchor) plan.changes.added.push_back(Anchor<B>(0, plan.anchor_information));
  } else if (plan.anchor_information != anchor_information_) {
    auto& replaced = plan.changes.replaced;
    replaced.erase(std::remove_if(replaced.begin(), replaced.end(),
                                  [&](const auto& change) { return change.first == anchor_slot_; }),
                   replaced.end());
    replaced.emplace_back(anchor_slot_, Anchor<B>(0, plan.anchor_information));
  }
}

template <class Pose>
UpdateSummary IncrementalSolver<Pose>::Update(const GraphUpdate<Pose>& update) {
  UpdateSummary summary;
  Validate(update);
  Plan plan;
  {
    ScopedTimer timer(seconds_.linearise);
    PlanNewPoses(update, plan);
    PlanRelinearisation(update, plan);
    PlanAnchor(update, plan);
  }
  summary.variables_relinearised = static_cast<int>(plan.new_points.size());
  typename BlockCholesky<B>::UpdateReport report;
  {
    ScopedTimer timer(seconds_.factor);
    report = factor_.Update(std::move(plan.changes));
  }
  seconds_.order += report.seconds_order;
  seconds_.factor -= report.seconds_order;
  if (!report.ok) {
    const int v = report.failed_variable;
    const int old = static_cast<int>(graph_.Poses().size());
    const PoseId id = v < old ? graph_.Poses()[At(v)].id : update.poses[At(v - old)].id;
    throw NumericalError("the update would make the system singular at pose " + std::to_string(id.value));
  }
  summary.fronts_refactored = report.fronts;
  summary.variables_refactored = report.variables;
  summary.flops = report.flops;
  Commit(update, plan, summary, report.added_slots);
  BackSubstitute(summary);
  return summary;
}

// Nothing here fails: everything was validated, and the factor holds the change already.
template <class Pose>
void IncrementalSolver<Pose>::Commit(const GraphUpdate<Pose>& update, const Plan& plan, UpdateSummary& summary,
                                     const std::vector<int>& added_slots) {
  ++updates_;
  for (const FactorId id : update.removed) {
    graph_.RemoveFactor(id);
    factor_of_slot_[At(slot_of_factor_[At(id)])] = FactorId();
    slot_of_factor_[At(id)] = -1;
    absolute_factors_.erase(std::remove(absolute_factors_.begin(), absolute_factors_.end(), id),
                            absolute_factors_.end());
  }
  for (size_t k = 0; k < update.poses.size(); ++k) {
    graph_.AddPose(update.poses[k].id, plan.new_values[k]);
    graph_.SetFixed(update.poses[k].id, update.poses[k].fixed);
    fixed_poses_ += update.poses[k].fixed ? 1 : 0;
    linearization_points_.push_back(plan.new_values[k]);
    is_outgrown_.push_back(0);
  }
  const auto bind = [&](int slot, FactorId id) {
    if (At(slot) >= factor_of_slot_.size()) factor_of_slot_.resize(At(slot) + 1);
    factor_of_slot_[At(slot)] = id;
  };
  for (size_t k = 0; k < update.factors.size(); ++k) {
    const FactorId id = graph_.AddFactor(update.factors[k]);
    summary.factor_ids.push_back(id);
    bind(added_slots[k], id);
    slot_of_factor_.resize(At(id) + 1, -1);
    slot_of_factor_[At(id)] = added_slots[k];
    if (!std::holds_alternative<RelativePoseFactor<Pose>>(update.factors[k])) absolute_factors_.push_back(id);
  }
  anchor_information_ = plan.anchor_information;
  if (plan.adds_anchor) {
    anchor_slot_ = added_slots.back();
    bind(anchor_slot_, FactorId());
  }
  for (const auto& [v, T] : plan.new_points) {
    linearization_points_[At(v)] = T;
    factor_.ClearSolution(v);
  }
}

template <class Pose>
void IncrementalSolver<Pose>::BackSubstitute(UpdateSummary& summary) {
  ScopedTimer timer(seconds_.solve);
  const std::vector<int> moved = factor_.Solve(options_.propagation_threshold);
  summary.variables_moved = static_cast<int>(moved.size());
  for (const int v : moved) {
    if (is_outgrown_[At(v)] != 0 || !ExceedsTolerance(v)) continue;
    is_outgrown_[At(v)] = 1;
    outgrown_.push_back(v);
  }
  // Those that shrank again, by themselves or by relinearisation, leave the list.
  const auto stays = [&](int v) { return ExceedsTolerance(v); };
  const auto end = std::stable_partition(outgrown_.begin(), outgrown_.end(), stays);
  for (auto it = end; it != outgrown_.end(); ++it) is_outgrown_[At(*it)] = 0;
  outgrown_.erase(end, outgrown_.end());
}

template <class Pose>
Pose IncrementalSolver<Pose>::EstimateAt(int index) const {
  const Eigen::Map<const Vector<B>> d(factor_.Solution().data() + At(index) * B);
  return linearization_points_.at(At(index)).Retract(d);
}

template <class Pose>
std::vector<Pose> IncrementalSolver<Pose>::Estimates() const {
  std::vector<Pose> out;
  out.reserve(linearization_points_.size());
  for (int v = 0; v < static_cast<int>(linearization_points_.size()); ++v) out.push_back(EstimateAt(v));
  return out;
}

template <class Pose>
double IncrementalSolver<Pose>::Chi2() const {
  const std::vector<Pose> estimates = Estimates();
  double chi2 = 0;
  for (const auto& node : graph_.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    chi2 +=
        FactorChi2(node.factor, estimates[At(graph_.IndexOf(ends.first))], estimates[At(graph_.IndexOf(ends.second))]);
  }
  return chi2;
}

template <class Pose>
BatchResult<Pose> IncrementalSolver<Pose>::Finish(const BatchOptions& options) {
  BatchResult<Pose> result = SolveBatch(graph_, Estimates(), options);
  // The factor of this solver moves to the optimum too: every linearisation point changes.
  typename BlockCholesky<B>::Changes changes;
  for (size_t slot = 0; slot < factor_of_slot_.size(); ++slot) {
    const FactorId id = factor_of_slot_[slot];
    if (id.value < 0) continue;
    const LinearFactor<B>& was = factor_.FactorAt(static_cast<int>(slot));
    const int second = was.second < 0 ? was.first : was.second;
    changes.replaced.emplace_back(static_cast<int>(slot),
                                  Linearize(graph_.FindFactor(id)->factor, was.first, second,
                                            result.T_world_body[At(was.first)], result.T_world_body[At(second)]));
  }
  if (!factor_.Update(std::move(changes)).ok) throw NumericalError("the system is singular at the optimum");
  linearization_points_ = result.T_world_body;
  for (int v = 0; v < factor_.Variables(); ++v) factor_.ClearSolution(v);
  UpdateSummary summary;
  BackSubstitute(summary);
  return result;
}

template class IncrementalSolver<SE2>;
template class IncrementalSolver<SE3>;

}  // namespace terse
