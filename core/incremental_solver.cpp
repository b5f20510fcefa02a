#include "terse/core/incremental_solver.h"

#include <algorithm>
#include <cmath>
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

// Relinearised factors may cost this many times as much as before (curved valleys climb a little) before the
// points go only part of the way, at least this share of it.
constexpr double kClimb = 4, kLeastShare = 0.05;
// A d this many times its tolerance does not wait for the interval.
constexpr double kUrgent = 30;

}  // namespace

// Everything an update will change, worked out before anything is.
template <class Pose>
struct IncrementalSolver<Pose>::Plan {
  std::map<PoseId, int> new_index;
  std::vector<Pose> new_values;    // in the order of update.poses
  std::map<int, Pose> new_points;  // relinearised: pose index, new linearisation point
  typename BlockCholesky<B>::Changes changes;
  bool adds_anchor = false;
  AbsoluteFactors absolute;
  Vector<B> anchor_information;

  const Pose& PointOf(int index, const std::vector<Pose>& present) const {
    const auto it = new_points.find(index);
    return it != new_points.end() ? it->second : present[At(index)];
  }
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

template <class Pose>
bool IncrementalSolver<Pose>::ExceedsTolerance(int variable, double times) const {
  const double* d = factor_.Solution().data() + At(variable) * B;
  double metres2 = 0, radians2 = 0;
  for (int k = 0; k < Pose::kDim; ++k) metres2 += d[k] * d[k];
  for (int k = Pose::kDim; k < B; ++k) radians2 += d[k] * d[k];
  return metres2 > std::pow(times * options_.relinearize_metres, 2) ||
         radians2 > std::pow(times * options_.relinearize_radians, 2);
}

// A slot's factor at other linearisation points.
template <class Pose>
template <class Point>
LinearFactor<Pose::kDof> IncrementalSolver<Pose>::LinearizeSlot(int slot, const Point& point) const {
  const LinearFactor<B>& was = factor_.FactorAt(slot);
  if (slot == anchor_slot_) return was;  // proximal: the same at any value
  const FactorId id = factor_of_slot_[At(slot)];
  const int second = was.second < 0 ? was.first : was.second;
  if (id.value >= 0) {
    return Linearize(graph_.FindFactor(id)->factor, was.first, second, point(was.first), point(second));
  }
  const auto& fixed = graph_.Poses()[At(was.first)];
  return Linearize<Pose>(FixedPosePrior<Pose>(fixed.id, *fixed.T_world_body), was.first, was.first, point(was.first),
                         point(was.first));
}

// Moves the linearisation points of outgrown poses to their estimates. A wrong or far link can throw an estimate to
// where the linearisation means nothing; there the points go only part of the way.
template <class Pose>
void IncrementalSolver<Pose>::PlanRelinearisation(const std::set<FactorId>& removed, Plan& plan) const {
  const bool due = (updates_ + 1) % options_.relinearize_interval == 0;
  const auto urgent = [&](int v) { return ExceedsTolerance(v, kUrgent); };
  if (!due && std::none_of(outgrown_.begin(), outgrown_.end(), urgent)) return;
  std::set<int> slots;
  for (const int v : outgrown_) {
    if (!ExceedsTolerance(v)) continue;
    plan.new_points.emplace(v, EstimateAt(v));
    slots.insert(factor_.SlotsOf(v).begin(), factor_.SlotsOf(v).end());
  }
  for (auto it = slots.begin(); it != slots.end();) {
    const FactorId id = factor_of_slot_[At(*it)];
    it = id.value >= 0 && removed.count(id) != 0 ? slots.erase(it) : std::next(it);
  }
  const auto point = [&](int v) -> const Pose& { return plan.PointOf(v, linearization_points_); };
  double before = static_cast<double>(B * slots.size());
  for (const int slot : slots) before += factor_.FactorAt(slot).residual.squaredNorm();
  for (double share = 1;; share /= 2) {
    double after = 0;
    for (const int slot : slots) {
      plan.changes.replaced.emplace_back(slot, LinearizeSlot(slot, point));
      after += plan.changes.replaced.back().second.residual.squaredNorm();
    }
    if (after <= kClimb * before || share < kLeastShare) return;
    plan.changes.replaced.clear();
    for (auto& [v, T] : plan.new_points) {
      const Eigen::Map<const Vector<B>> d(factor_.Solution().data() + At(v) * B);
      T = linearization_points_[At(v)].Retract(share / 2 * d);
    }
  }
}

// New factors, at the points that the relinearisation leaves.
template <class Pose>
void IncrementalSolver<Pose>::PlanFactors(const GraphUpdate<Pose>& update, Plan& plan) const {
  const int old = static_cast<int>(graph_.Poses().size());
  const auto point = [&](int v) -> const Pose& {
    return v < old ? plan.PointOf(v, linearization_points_) : plan.new_values[At(v - old)];
  };
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

template <class Pose>
void IncrementalSolver<Pose>::PlanAnchor(const GraphUpdate<Pose>& update, Plan& plan) const {
  plan.absolute = AbsoluteFactorsAfter(update);
  plan.anchor_information = AnchorInformation<Pose>(plan.absolute);
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
    PlanRelinearisation(std::set<FactorId>(update.removed.begin(), update.removed.end()), plan);
    PlanFactors(update, plan);
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

// Nothing here fails short of memory: everything was validated, and the factor holds the change already.
template <class Pose>
void IncrementalSolver<Pose>::Commit(const GraphUpdate<Pose>& update, const Plan& plan, UpdateSummary& summary,
                                     const std::vector<int>& added_slots) {
  ++updates_;
  for (const FactorId id : update.removed) {
    graph_.RemoveFactor(id);
    factor_of_slot_[At(slot_of_factor_[At(id)])] = FactorId();
    slot_of_factor_[At(id)] = -1;
  }
  for (size_t k = 0; k < update.poses.size(); ++k) {
    graph_.AddPose(update.poses[k].id, plan.new_values[k]);
    graph_.SetFixed(update.poses[k].id, update.poses[k].fixed);
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
  }
  absolute_ = plan.absolute;
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
  const auto point = [&](int v) -> const Pose& { return result.T_world_body[At(v)]; };
  for (int slot = 0; slot < static_cast<int>(factor_of_slot_.size()); ++slot) {
    if (factor_.FactorAt(slot).first >= 0) changes.replaced.emplace_back(slot, LinearizeSlot(slot, point));
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
