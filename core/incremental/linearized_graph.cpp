#include "incremental/linearized_graph.h"

#include <algorithm>
#include <limits>
#include <stdexcept>

#include "incremental/update_plan.h"
#include "support/stopwatch.h"
#include "terse/core/definite.h"
#include "terse/core/front_paths.h"
#include "terse/core/graph_members.h"
#include "terse/core/residual.h"

namespace terse::internal {
namespace {

using std::size_t;
constexpr size_t At(FactorId id) { return static_cast<size_t>(id.value); }

}  // namespace

template <class Pose>
std::vector<Pose> LinearizedGraph<Pose>::Estimates() const {
  std::vector<Pose> out;
  out.reserve(points_.size());
  for (int v = 0; v < static_cast<int>(points_.size()); ++v) out.push_back(EstimateAt(v));
  return out;
}

template <class Pose>
double LinearizedGraph<Pose>::Chi2() const {
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
double LinearizedGraph<Pose>::Chi2Of(FactorId id) const {
  const auto& factor = graph_.FindFactor(id)->factor;
  const FactorPoses ends = PosesOf(factor);
  return FactorChi2(factor, EstimateAt(graph_.IndexOf(ends.first)), EstimateAt(graph_.IndexOf(ends.second)));
}

template <class Pose>
LinearFactor<Pose::kDof> LinearizedGraph<Pose>::LinearizeSlot(int slot, const Pose& T_world_first,
                                                              const Pose& T_world_second) const {
  const LinearFactor<B>& was = cholesky_.LinearFactorAt(slot);
  if (slot == anchor_slot_) return was;  // proximal: the same at any value
  const FactorId id = IdAt(slot);
  const int second = was.second < 0 ? was.first : was.second;
  if (id.value >= 0) {
    return Linearize(graph_.FindFactor(id)->factor, RootAt(slot), was.first, second, T_world_first, T_world_second);
  }
  const auto& fixed = graph_.Poses()[At(was.first)];
  return Linearize<Pose>(FixedPosePrior<Pose>(fixed.id, *fixed.T_world_body), was.first, was.first, T_world_first,
                         T_world_first);
}

template <class Pose>
std::vector<int> LinearizedGraph<Pose>::SlotsOn(const PointMap<Pose>& points) const {
  std::vector<int> slots;
  for (const auto& [v, T] : points) slots.insert(slots.end(), cholesky_.SlotsOf(v).begin(), cholesky_.SlotsOf(v).end());
  std::sort(slots.begin(), slots.end());
  slots.erase(std::unique(slots.begin(), slots.end()), slots.end());
  return slots;
}

template <class Pose>
typename LinearizedGraph<Pose>::Replacements LinearizedGraph<Pose>::LinearizeAround(
    const PointMap<Pose>& points) const {
  const std::vector<int> slots = SlotsOn(points);
  const auto point = [&](int v) -> const Pose& { return points.Find(v, points_[At(v)]); };
  Replacements out;
  out.reserve(slots.size());
  for (const int slot : slots) out.emplace_back(slot, LinearizeSlot(slot, point));
  return out;
}

template <class Pose>
Vector<Pose::kDof> LinearizedGraph<Pose>::LinearResidual(int slot) const {
  return internal::LinearResidual(cholesky_.LinearFactorAt(slot), [&](int v) { return OffsetOf(v).data(); });
}

template <class Pose>
double LinearizedGraph<Pose>::DegreesOfFreedom() const {
  return std::max(1.0, static_cast<double>(measured_scalars_ - B * cholesky_.Variables()));
}

template <class Pose>
void LinearizedGraph<Pose>::AddCosts(const LinearFactor<B>& factor, Costs& costs) const {
  costs.at_points += factor.residual.squaredNorm();
  const auto offset = [&](int v) { return OffsetOf(v).data(); };
  costs.at_offsets += internal::LinearResidual(factor, offset).squaredNorm();
}

template <class Pose>
void LinearizedGraph<Pose>::RecountCosts() {
  cost_ = {};
  for (int slot = 0; slot < Slots(); ++slot) {
    if (cholesky_.LinearFactorAt(slot).first >= 0) CountCost(slot);
  }
}

// `update` brings the changes into the Cholesky factor.
template <class Pose>
template <class Update>
typename LinearizedGraph<Pose>::UpdateReport LinearizedGraph<Pose>::UpdateCholesky(const Changes& changes,
                                                                                   StepReport& report,
                                                                                   const Update& update) {
  Costs gone;
  for (const int slot : changes.removed) AddCosts(cholesky_.LinearFactorAt(slot), gone);
  for (const auto& change : changes.replaced) AddCosts(cholesky_.LinearFactorAt(change.first), gone);
  UpdateReport done;
  {
    ScopedTimer timer(seconds_.factor);
    done = update();
  }
  seconds_.order += done.seconds_order;
  seconds_.factor -= done.seconds_order;
  report.fronts_updated += done.fronts_updated;
  report.fronts_refactored += done.fronts;
  report.variables_refactored += done.variables;
  report.flops += done.flops;
  if (!done.ok) return done;
  cost_.at_points -= gone.at_points;
  cost_.at_offsets -= gone.at_offsets;
  return done;
}

template <class Pose>
typename LinearizedGraph<Pose>::UpdateReport LinearizedGraph<Pose>::Add(const GraphUpdate<Pose>& update,
                                                                        const UpdatePlan<Pose>& plan,
                                                                        StepReport& report) {
  UpdateReport done = UpdateCholesky(plan.changes, report, [&] { return cholesky_.Update(plan.changes); });
  if (!done.ok) return done;
  report.path = done.path;
  for (const auto& change : plan.changes.replaced) AddCosts(change.second, cost_);
  for (const auto& factor : plan.changes.added) AddCosts(factor, cost_);
  Commit(update, plan, done.added_slots, report);
  if (!plan.moved_points.empty()) RecountCosts();  // the offsets are gone
  return done;
}

// Nothing here fails short of memory: everything was validated, and the Cholesky factor holds the change already.
template <class Pose>
void LinearizedGraph<Pose>::Commit(const GraphUpdate<Pose>& update, const UpdatePlan<Pose>& plan,
                                   const std::vector<int>& added_slots, StepReport& report) {
  ++updates_;
  for (const FactorId id : update.removed) {
    if (SlotOf(id) >= 0) Release(id);
    graph_.RemoveFactor(id);
  }
  for (size_t k = 0; k < update.poses.size(); ++k) {
    graph_.AddPose(update.poses[k].id, plan.new_values[k]);
    graph_.SetFixed(update.poses[k].id, update.poses[k].fixed);
    points_.push_back(plan.new_values[k]);
  }
  size_t slots = 0;
  for (size_t k = 0; k < update.factors.size(); ++k) {
    const FactorId id =
        graph_.AddFactor(update.factors[k], update.factor_ids.empty() ? graph_.NextFactorId() : update.factor_ids[k]);
    report.factor_ids.push_back(id);
    slot_of_factor_.resize(At(id) + 1, -1);
    if (!plan.Waits(k)) Bind(added_slots[slots++], id, plan.W[k]);
  }
  // Priors of fixed poses and the anchor have slots, but no id.
  for (; slots < added_slots.size(); ++slots) Bind(added_slots[slots], FactorId(), Matrix<B, B>::Zero());
  if (plan.adds_anchor) anchor_slot_ = added_slots.back();
  frame_ = plan.frame;
  if (plan.moved_points.empty()) return;
  std::copy(plan.moved_points.begin(), plan.moved_points.end(), points_.begin());
  for (int v = 0; v < static_cast<int>(plan.moved_points.size()); ++v) cholesky_.ClearSolution(v);
}

template <class Pose>
typename LinearizedGraph<Pose>::UpdateReport LinearizedGraph<Pose>::Exchange(const std::vector<LinearFactor<B>>& in,
                                                                             const std::vector<int>& out,
                                                                             StepReport& report) {
  Changes changes;
  changes.added = in;
  changes.removed = out;
  UpdateReport done = UpdateCholesky(changes, report, [&] { return cholesky_.Update(changes); });
  if (!done.ok) return done;
  for (const auto& factor : in) AddCosts(factor, cost_);
  return done;
}

// The slot's measurement is `id` (-1: a fixed pose's prior or the anchor).
template <class Pose>
void LinearizedGraph<Pose>::Bind(int slot, FactorId id, const Matrix<B, B>& W) {
  if (slot >= Slots()) slots_.resize(At(slot) + 1, {FactorId(), Matrix<B, B>::Zero()});
  slots_[At(slot)].id = id;
  if (id.value < 0) return;
  slots_[At(slot)].W = W;
  bound_.push_back(slot);
  slot_of_factor_[At(id)] = slot;
  measured_scalars_ += Dimension(graph_.FindFactor(id)->factor);
}

// Before the measurement goes, or waits outside.
template <class Pose>
void LinearizedGraph<Pose>::Release(FactorId id) {
  const size_t slot = At(std::exchange(slot_of_factor_[At(id)], -1));
  measured_scalars_ -= Dimension(graph_.FindFactor(id)->factor);
  slots_[slot].id = FactorId();
}

template <class Pose>
bool LinearizedGraph<Pose>::Relinearize(const PointMap<Pose>& points, Replacements replaced, StepReport& report) {
  Changes changes;
  changes.replaced = std::move(replaced);
  if (!UpdateCholesky(changes, report, [&] { return cholesky_.Update(std::move(changes)); }).ok) return false;
  for (const auto& [v, T] : points) {
    points_[At(v)] = T;
    cholesky_.ClearSolution(v);
    Touch(v);
  }
  return true;
}

template <class Pose>
PreparationProgress LinearizedGraph<Pose>::Advance(Clock::time_point deadline) {
  ScopedTimer timer(seconds_.factor);
  return cholesky_.Advance(deadline);
}

template <class Pose>
bool LinearizedGraph<Pose>::RelinearizePrepared(const PointMap<Pose>& points, std::vector<int>& slots,
                                                StepReport& report) {
  Changes changes = cholesky_.PreparedChanges();
  for (const auto& change : changes.replaced) slots.push_back(change.first);
  if (!UpdateCholesky(changes, report, [&] { return cholesky_.UpdatePrepared(std::move(changes)); }).ok) return false;
  for (const auto& [v, T] : points) {
    const Vector<B> d = T.Local(EstimateAt(v));
    points_[At(v)] = T;
    cholesky_.SetSolution(v, d);
    Touch(v);
  }
  return true;
}

template <class Pose>
bool LinearizedGraph<Pose>::MoveTo(const std::vector<Pose>& T_world_body, const Gauge<Pose>& gauge) {
  Changes changes;
  const auto point = [&](int v) -> const Pose& { return T_world_body[At(v)]; };
  for (int slot = 0; slot < Slots(); ++slot) {
    if (cholesky_.LinearFactorAt(slot).first < 0) continue;
    changes.replaced.emplace_back(slot, slot == anchor_slot_ ? Anchor(gauge) : LinearizeSlot(slot, point));
  }
  if (!cholesky_.Update(std::move(changes)).ok) return false;
  points_ = T_world_body;
  frame_.gauge = gauge;
  frame_.found_at = frame_.absolute.Count();
  for (int v = 0; v < cholesky_.Variables(); ++v) cholesky_.ClearSolution(v);
  RecountCosts();
  return true;
}

template <class Pose>
std::vector<int> LinearizedGraph<Pose>::Solve(double threshold, std::optional<Clock::time_point> deadline,
                                              StepReport& report) {
  std::vector<int> moved = cholesky_.Solve(threshold, deadline);
  cost_.at_offsets = MinimumCost();
  report.solve_flops += cholesky_.LastSolve().flops;
  report.variables_moved += static_cast<int>(moved.size());
  for (const int v : moved) Touch(v);
  return moved;
}

template <class Pose>
void LinearizedGraph<Pose>::PlaceNewPoses(int new_poses, StepReport& report) {
  const int variables = cholesky_.Variables();
  for (int v = variables - new_poses; v < variables; ++v) {
    Matrix<B, B> H = Matrix<B, B>::Zero();
    Vector<B> b = Vector<B>::Zero();
    for (const int slot : cholesky_.SlotsOf(v)) {
      const LinearFactor<B>& f = cholesky_.LinearFactorAt(slot);
      const int other = f.first == v ? f.second : f.first;
      if (other > v) continue;
      const Matrix<B, B>& A = f.first == v ? f.A_first : f.A_second;
      const Vector<B> r = internal::LinearResidual(f, [&](int u) { return u == v ? nullptr : OffsetOf(u).data(); });
      H += A.transpose() * A;
      b -= A.transpose() * r;
    }
    if (!IsDefinite<B>(H)) continue;  // held by a later pose only: stays where it was composed
    const Vector<B> d = SolveDefinite<B>(H, b);
    const auto& slots = cholesky_.SlotsOf(v);
    for (const int slot : slots) cost_.at_offsets -= LinearResidual(slot).squaredNorm();
    cholesky_.SetSolution(v, d);
    for (const int slot : slots) cost_.at_offsets += LinearResidual(slot).squaredNorm();
    ++report.variables_moved;
  }
  report.predicted_decrease -= RemainingDecrease();
}

template <class Pose>
typename LinearizedGraph<Pose>::Steps LinearizedGraph<Pose>::TakeStep(const std::vector<int>* scope, double threshold,
                                                                      StepReport& report) {
  ScopedTimer timer(seconds_.solve);
  std::vector<int> solved;
  if (scope == nullptr) {
    solved = cholesky_.Solve(threshold);
    report.solve_flops += cholesky_.LastSolve().flops;
  } else {
    FrontPaths<B> paths(cholesky_.Tree());
    for (const int v : *scope) paths.Add(v);
    SolveOn(paths, cholesky_.Solution(), [&](int v, const Vector<B>& d) {
      cholesky_.SetSolution(v, d);
      solved.push_back(v);
    });
    for (int k = 0; k < paths.Size(); ++k) report.solve_flops += 2 * paths[k].Entries();
  }
  Steps steps;
  for (const int v : scope == nullptr ? solved : *scope) steps.emplace(v, OffsetOf(v));
  for (const int v : solved) cholesky_.ClearSolution(v);
  return steps;
}

template <class Pose>
template <class Archive>
void LinearizedGraph<Pose>::Serialize(Archive& archive) {
  auto& [graph, points, cholesky, slot_of_factor, slots, anchor_slot, frame, cost, measured_scalars, updates,
         is_watched, touched, bound, seconds] = *this;
  archive(graph, points, cholesky, slot_of_factor, anchor_slot, cost.at_points, cost.at_offsets, measured_scalars,
          updates, is_watched, touched);
  archive.Each(slots, [&](Slot& slot) {
    auto& [id, W] = slot;
    archive(id, W);
  });
  auto& [gauge, found_at, absolute] = frame;
  archive(gauge, found_at, absolute);
  if constexpr (Archive::kReads) {
    const std::string defect = FindStateDefect();
    if (!defect.empty()) archive.Fail(defect);
  }
}

// Graph and block system fit together, and every list its index.
template <class Pose>
std::string LinearizedGraph<Pose>::FindStateDefect() const {
  const size_t poses = graph_.Poses().size(), slots = slots_.size();
  const auto are_below = [](const std::vector<int>& numbers, size_t n, int least = 0) {
    return std::all_of(numbers.begin(), numbers.end(), [&](int i) { return i >= least && (i < 0 || At(i) < n); });
  };
  if (points_.size() != poses || At(cholesky_.Variables()) != poses || !are_below(touched_, poses)) {
    return "lists by pose have different sizes";
  }
  // There may be free slots that no step has ever used: those of a step that failed.
  if (At(cholesky_.Slots()) < slots || !are_below(slot_of_factor_, slots, -1)) {
    return "lists by slot have different sizes";
  }
  if (static_cast<size_t>(graph_.NextFactorId().value) != slot_of_factor_.size()) return "factors without a slot";
  size_t bound = 0;
  long scalars = 0;
  for (const auto& node : graph_.Factors()) {
    const int slot = SlotOf(node.id);
    if (slot < 0) continue;  // out of the map: the loop judge knows it
    if (IdAt(slot) != node.id) return "a measurement without a slot";
    const FactorPoses ends = PosesOf(node.factor);
    const int second = ends.count == 2 ? graph_.IndexOf(ends.second) : -1;
    const LinearFactor<B>& f = cholesky_.LinearFactorAt(slot);
    if (f.first != graph_.IndexOf(ends.first) || f.second != second) return "a measurement in a slot of other poses";
    ++bound;
    scalars += Dimension(node.factor);
  }
  for (int slot = 0; slot < cholesky_.Slots(); ++slot) {
    const LinearFactor<B>& f = cholesky_.LinearFactorAt(slot);
    const bool is_bound = At(slot) < slots && IdAt(slot).value >= 0;
    if (is_bound && bound-- == 0) return "a slot without a measurement";
    if (is_bound || f.first < 0) continue;
    if (At(slot) >= slots || f.second >= 0) return "a slot without a measurement";
    const auto& node = graph_.Poses()[At(f.first)];
    if (slot != anchor_slot_ && !(node.fixed && node.T_world_body)) return "a pose is held that is not fixed";
  }
  if (anchor_slot_ < -1 || anchor_slot_ >= cholesky_.Slots() || (anchor_slot_ < 0) != (poses == 0) ||
      (anchor_slot_ >= 0 && cholesky_.LinearFactorAt(anchor_slot_).first != 0)) {
    return "the map is not anchored";
  }
  const AbsoluteFactors absolute = CountAbsoluteFactors(graph_);
  if (scalars != measured_scalars_ || absolute.pose_priors != frame_.absolute.pose_priors ||
      absolute.position_priors != frame_.absolute.position_priors || updates_ < 0 ||
      updates_ >= std::numeric_limits<long>::max() / 2) {
    return "it has miscounted";
  }
  return "";
}

#define TERSE_INSTANTIATE(Pose)                                              \
  template class LinearizedGraph<Pose>;                                      \
  template void LinearizedGraph<Pose>::Serialize<StateWriter>(StateWriter&); \
  template void LinearizedGraph<Pose>::Serialize<StateReader>(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
