#pragma once
// Incremental optimisation of a growing pose graph.
//
// The estimate is the linearisation point plus d (as iSAM2, Kaess et al. 2012): every update refactors the path of the
// tree that the change touches and back-substitutes; poses whose d has outgrown the tolerances are relinearised
// together with the next update. The gauge is fixed as gauge.h describes.
//
// A new pose starts at the value given with it, else at that of its pose prior, else at T_estimate * T_from_to along
// its first factor to a known pose; the very first one may have none of these and starts at the identity. Update is
// atomic: if it throws, the solver is as before. Not thread-safe for writing; const functions may run concurrently.

#include <optional>
#include <set>
#include <vector>

#include "terse/core/batch_solver.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/gauge.h"
#include "terse/core/pose_graph.h"

namespace terse {

struct IncrementalOptions {
  // A pose is relinearised when its d exceeds either.
  double relinearize_metres = 0.01;
  double relinearize_radians = 0.01;
  // Relinearisation is considered at every n-th update, or at once when a d exceeds 30 times its tolerance: the
  // updates between touch far less, and the estimate, which includes d, hardly notices.
  int relinearize_interval = 10;
  // Back-substitution leaves a subtree alone when no scalar above it moved by more. 0 is exact.
  double propagation_threshold = 1e-5;
};

template <class Pose>
struct GraphUpdate {
  struct NewPose {
    PoseId id;
    std::optional<Pose> T_world_body = std::nullopt;  // absent: composed along a factor
    bool fixed = false;                               // anchored at its value; the anchor is not counted in chi2
  };
  std::vector<NewPose> poses;
  std::vector<Factor<Pose>> factors;
  std::vector<FactorId> removed;
};

struct UpdateSummary {
  std::vector<FactorId> factor_ids;  // one per added factor
  int fronts_refactored = 0;
  int variables_refactored = 0;
  int variables_relinearised = 0;
  int variables_moved = 0;  // whose d the back-substitution changed
  double flops = 0;         // of the refactored path: squared column counts
};

template <class Pose>
class IncrementalSolver {
 public:
  static constexpr int B = Pose::kDof;

  explicit IncrementalSolver(const IncrementalOptions& options = {});

  // Throws std::invalid_argument (unknown or duplicate ids, defective factors, a pose no factor reaches) or
  // NumericalError (the system would be singular).
  UpdateSummary Update(const GraphUpdate<Pose>& update);

  // Iterates to the batch optimum, which becomes the linearisation point. The result's poses are in the order of
  // Graph().Poses().
  BatchResult<Pose> Finish(const BatchOptions& options = {});

  // Poses and living factors; the pose values in it are the initial ones.
  const PoseGraph<Pose>& Graph() const { return graph_; }
  // Throws std::invalid_argument if the pose is unknown.
  Pose Estimate(PoseId id) const { return EstimateAt(graph_.IndexOf(id)); }
  Pose EstimateAt(int index) const;
  std::vector<Pose> Estimates() const;  // by pose index

  double Chi2() const;                                                // at the estimate, O(factors)
  double LogDeterminant() const { return factor_.LogDeterminant(); }  // ln det H at the linearisation point
  // The factor (variable = pose index) at LinearizationPoints().
  const BlockCholesky<B>& Factor() const { return factor_; }
  const std::vector<Pose>& LinearizationPoints() const { return linearization_points_; }
  const PhaseSeconds& Seconds() const { return seconds_; }

 private:
  struct Plan;
  void Validate(const GraphUpdate<Pose>& update) const;
  void PlanNewPoses(const GraphUpdate<Pose>& update, Plan& plan) const;
  void PlanRelinearisation(const std::set<FactorId>& removed, Plan& plan) const;
  void PlanFactors(const GraphUpdate<Pose>& update, Plan& plan) const;
  template <class Point>
  LinearFactor<Pose::kDof> LinearizeSlot(int slot, const Point& point) const;
  void PlanAnchor(const GraphUpdate<Pose>& update, Plan& plan) const;
  void Commit(const GraphUpdate<Pose>& update, const Plan& plan, UpdateSummary& summary,
              const std::vector<int>& added_slots);
  void BackSubstitute(UpdateSummary& summary);
  bool ExceedsTolerance(int variable, double times = 1) const;
  AbsoluteFactors AbsoluteFactorsAfter(const GraphUpdate<Pose>& update) const;

  IncrementalOptions options_;
  PoseGraph<Pose> graph_;
  std::vector<Pose> linearization_points_;
  BlockCholesky<B> factor_;
  std::vector<int> slot_of_factor_;       // by factor id; -1 when removed
  std::vector<FactorId> factor_of_slot_;  // -1: an anchor, or a free slot
  int anchor_slot_ = -1;
  Vector<B> anchor_information_ = Vector<B>::Zero();
  AbsoluteFactors absolute_;
  std::vector<int> outgrown_;      // poses whose d was seen to exceed a tolerance
  std::vector<char> is_outgrown_;  // by pose index
  long updates_ = 0;
  PhaseSeconds seconds_;
};

}  // namespace terse
