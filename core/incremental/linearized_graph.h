#pragma once
// A growing pose graph, linearised: every measurement that takes part has a slot in the block system, every pose a
// linearisation point and an offset d from it; the estimate is the point retracted by d. Nothing else writes the
// Cholesky factor, so that costs, slots and points always belong to it.
//
// Numberings: a pose has an id (the user's) and an index (order of arrival), which is its variable in the block system.
// A measurement has an id (order of arrival, never used again) and, while it takes part, a slot (used again). The
// anchor and the priors of fixed poses have slots but no id.

#include <algorithm>
#include <chrono>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "incremental/point_map.h"
#include "terse/core/batch_solver.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/gauge.h"
#include "terse/core/graph_update.h"
#include "terse/core/incremental_options.h"
#include "terse/core/pose_graph.h"
#include "terse/core/state_file.h"
#include "terse/core/step_report.h"

namespace terse::internal {

template <class Pose>
struct UpdatePlan;

// A d + r of a linear factor. offset(variable) points to the variable's d, or is null where that is zero.
template <int B, class OffsetOf>
Vector<B> LinearResidual(const LinearFactor<B>& factor, const OffsetOf& offset) {
  Vector<B> r = factor.residual;
  const auto add = [&](int variable, const Matrix<B, B>& A) {
    if (variable < 0) return;
    if (const double* d = offset(variable)) r += A * Eigen::Map<const Vector<B>>(d);
  };
  add(factor.first, factor.A_first);
  add(factor.second, factor.A_second);
  return r;
}

// How the map as a whole lies.
template <class Pose>
struct MapFrame {
  Gauge<Pose> gauge;  // what the anchor holds
  int found_at = 0;   // how many absolute measurements there were
  AbsoluteFactors absolute;
};

template <class Pose>
class LinearizedGraph {
 public:
  static constexpr int B = Pose::kDof;
  using Clock = std::chrono::steady_clock;
  using Replacements = typename BlockSystem<B>::Replaced;
  using Changes = typename BlockCholesky<B>::Changes;
  using UpdateReport = typename BlockCholesky<B>::UpdateReport;
  using Steps = std::map<int, Vector<B>>;  // by variable

  const PoseGraph<Pose>& Graph() const { return graph_; }
  const std::vector<Pose>& Points() const { return points_; }
  const BlockCholesky<B>& Cholesky() const { return cholesky_; }
  const MapFrame<Pose>& Frame() const { return frame_; }
  const PhaseSeconds& Seconds() const { return seconds_; }
  PhaseSeconds& Seconds() { return seconds_; }
  // So far, empty ones among them; the one at hand counts once it has been added, so the first is 1.
  long Updates() const { return updates_; }
  void SetThreads(int threads) { cholesky_.SetThreads(threads); }
  void LimitReordering(double flops) { cholesky_.LimitReordering(flops); }

  Eigen::Map<const Vector<B>> OffsetOf(int index) const {
    return Eigen::Map<const Vector<B>>(cholesky_.Solution().data() + static_cast<std::size_t>(index) * B);
  }
  Pose EstimateAt(int index) const { return points_.at(static_cast<std::size_t>(index)).Retract(OffsetOf(index)); }
  std::vector<Pose> Estimates() const;
  // Of the measurements themselves, at the estimate and without weights.
  double Chi2() const;
  double Chi2Of(FactorId id) const;

  // Slots so far, free ones among them.
  int Slots() const { return static_cast<int>(slots_.size()); }
  FactorId IdAt(int slot) const { return slots_[static_cast<std::size_t>(slot)].id; }  // -1: an anchor, or free
  int SlotOf(FactorId id) const { return slot_of_factor_[static_cast<std::size_t>(id.value)]; }  // -1: takes no part
  int AnchorSlot() const { return anchor_slot_; }
  // The square root of the measurement's information, its weight included.
  const Matrix<B, B>& RootAt(int slot) const { return slots_[static_cast<std::size_t>(slot)].W; }
  void SetRoot(int slot, const Matrix<B, B>& W) { slots_[static_cast<std::size_t>(slot)].W = W; }

  // A slot's measurement at other points, point(variable); those of all slots on some poses.
  template <class PointOf>
  LinearFactor<Pose::kDof> LinearizeSlot(int slot, const PointOf& point) const {
    const LinearFactor<B>& was = cholesky_.LinearFactorAt(slot);
    return LinearizeSlot(slot, point(was.first), point(was.second < 0 ? was.first : was.second));
  }
  LinearFactor<Pose::kDof> LinearizeSlot(int slot, const Pose& T_world_first, const Pose& T_world_second) const;
  std::vector<int> SlotsOn(const PointMap<Pose>& points) const;
  Replacements LinearizeAround(const PointMap<Pose>& points) const;
  // A d + r at the present d.
  Vector<Pose::kDof> LinearResidual(int slot) const;

  // Of the linearised system: its least chi2; by how much the present d is above that; scalars measured beyond those
  // estimated (at least one); and what changes of chi2 are measured by: chi2 itself, with a floor for measurements that
  // fit to rounding.
  double MinimumCost() const { return cost_.at_points - cholesky_.NewtonDecrement(); }
  double RemainingDecrease() const { return std::max(0.0, cost_.at_offsets - MinimumCost()); }
  double DegreesOfFreedom() const;
  double CostUnit() const { return std::max(MinimumCost(), 1e-6 * DegreesOfFreedom()); }

  // What a step does. Where the report's ok is false the system would not be positive definite, and nothing changed.
  UpdateReport Add(const GraphUpdate<Pose>& update, const UpdatePlan<Pose>& plan, StepReport& report);
  // Loops that come in, with their weights in them, and slots that go; their measurements stay in the graph.
  UpdateReport Exchange(const std::vector<LinearFactor<B>>& in, const std::vector<int>& out, StepReport& report);
  void Bind(int slot, FactorId id, const Matrix<B, B>& W);
  // Slots that were bound since this was asked last.
  std::vector<int> TakeBound() { return std::exchange(bound_, {}); }
  void Release(FactorId id);
  // New linearisation points and the slots' measurements at them; their offsets become zero. The slots' costs are
  // counted by CountCost, one after the other.
  bool Relinearize(const PointMap<Pose>& points, Replacements replaced, StepReport& report);
  // The same in pieces, while the map goes on (BlockCholesky::Prepare). The offsets become those from the new points to
  // the present estimates; `slots` are those that were prepared.
  void Prepare(const Replacements& replaced) { cholesky_.Prepare(replaced); }
  PreparationProgress Advance(Clock::time_point deadline);
  void EndPreparedStep() { cholesky_.EndPreparedStep(); }
  void ForgetPrepared() { cholesky_.ForgetPrepared(); }
  bool RelinearizePrepared(const PointMap<Pose>& points, std::vector<int>& slots, StepReport& report);
  void CountCost(int slot) { AddCosts(cholesky_.LinearFactorAt(slot), cost_); }
  // All points, and the gauge that goes with them.
  bool MoveTo(const std::vector<Pose>& T_world_body, const Gauge<Pose>& gauge);

  // The offsets: those of all poses that a step reaches, up to the deadline; the poses that moved. Or of new poses
  // only, each to the minimum of its factors with everything before it held.
  std::vector<int> Solve(double threshold, std::optional<Clock::time_point> deadline, StepReport& report);
  void PlaceNewPoses(int new_poses, StepReport& report);
  // The Gauss-Newton step of the variables in scope (null: of all that propagation reaches); offsets are zero before
  // and after.
  Steps TakeStep(const std::vector<int>* scope, double threshold, StepReport& report);

  // Poses whose estimates changed since this was asked last, some more than once, if somebody wants to know.
  void WatchPoses() { is_watched_ = true; }
  std::vector<int> TakeTouched() { return std::exchange(touched_, {}); }

  // But for Seconds().
  template <class Archive>
  void Serialize(Archive& archive);
  std::string FindStateDefect() const;

 private:
  struct Slot {
    FactorId id;
    Matrix<B, B> W;
  };
  struct Costs {
    double at_points = 0, at_offsets = 0;
  };
  template <class Update>
  UpdateReport UpdateCholesky(const Changes& changes, StepReport& report, const Update& update);
  void AddCosts(const LinearFactor<B>& factor, Costs& costs) const;
  void RecountCosts();
  void Touch(int index) {
    if (is_watched_) touched_.push_back(index);
  }
  void Commit(const GraphUpdate<Pose>& update, const UpdatePlan<Pose>& plan, const std::vector<int>& added_slots,
              StepReport& report);

  PoseGraph<Pose> graph_;
  std::vector<Pose> points_;
  BlockCholesky<B> cholesky_;
  std::vector<int> slot_of_factor_;  // by factor id; -1: takes no part
  std::vector<Slot> slots_;
  int anchor_slot_ = -1;
  MapFrame<Pose> frame_;
  Costs cost_;  // of the linearised system
  long measured_scalars_ = 0;
  long updates_ = 0;
  bool is_watched_ = false;
  std::vector<int> touched_;
  std::vector<int> bound_;  // empty between updates
  PhaseSeconds seconds_;
};

template <int B>
double SquaredResiduals(const std::vector<std::pair<int, LinearFactor<B>>>& replaced) {
  double sum = 0;
  for (const auto& change : replaced) sum += change.second.residual.squaredNorm();
  return sum;
}

}  // namespace terse::internal
