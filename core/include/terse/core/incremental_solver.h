#pragma once
// Incremental optimisation of a growing pose graph.
//
// Every update adds its factors to the block factor, along the paths of the tree that they touch. The gate decides
// whether the map is optimised for them, the options how (incremental_options.h). The gauge is fixed as gauge.h
// describes. When absolute measurements come to determine where the map is or how it is turned, the map as a whole is
// moved to where they say before its anchor lets go: all linearisation points together, so that no step has to turn it.
// What they have determined once stays theirs until one is removed.
//
// With a robust kernel (robust.h) loops enter with the weight that their innovation deserves, and their weights follow
// the estimate; with RobustKernel::kGnc they are in or out of the factor, judged again where the estimate changes
// (incremental_robust.cpp).
//
// A new pose starts at the value given with it, else at that of its pose prior, else at T_estimate * T_from_to along
// its first factor to a known pose; the very first one may have none of these and starts at the identity. Update is
// atomic: if it throws, the solver is as before. Not thread-safe for writing; const functions may run concurrently.

#include <chrono>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <unordered_set>
#include <utility>
#include <vector>

#include "terse/core/batch_solver.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/gauge.h"
#include "terse/core/incremental_options.h"
#include "terse/core/pose_graph.h"

namespace terse {

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
  // Positions in `factors` of relative factors that a robust kernel is not for, whatever they join: odometry. (Those
  // that bring a new pose are none of the kernel's in any case.)
  std::vector<std::size_t> odometry = {};
};

template <class Pose>
class IncrementalSolver {
 public:
  static constexpr int B = Pose::kDof;

  explicit IncrementalSolver(const IncrementalOptions& options = {});

  // Throws std::invalid_argument (unknown or duplicate ids, defective factors, a pose no factor reaches),
  // UnobservableError (the system would be singular; it says what would be free) or NumericalError (not finite).
  StepReport Update(const GraphUpdate<Pose>& update);

  // Iterates to the batch optimum, which becomes the linearisation point; where the system turns out not to be positive
  // definite, nothing changes. The result's poses are in the order of Graph().Poses(). The kernel and the loops are
  // this solver's, whatever `options` says, the log unless it has its own; kGnc starts from the loops that are in, and
  // graduates all of them besides if any is out, the lower cost of both winning. Where a chordal relaxation of the
  // graph costs less than the estimate, it starts from there (IncrementalOptions::restart).
  BatchResult<Pose> Finish(const BatchOptions& options = {});
  // From these values and no others, by pose index.
  BatchResult<Pose> FinishFrom(const std::vector<Pose>& T_world_body, const BatchOptions& options = {});

  // How often the map left a wrong minimum for a lower one (IncrementalOptions::restart), Finish included.
  int Restarts() const { return static_cast<int>(watch_.restarts); }

  // Poses and living factors; the pose values in it are the initial ones.
  const PoseGraph<Pose>& Graph() const { return graph_; }
  // Throws std::invalid_argument if the pose is unknown.
  Pose Estimate(PoseId id) const { return EstimateAt(graph_.IndexOf(id)); }
  Pose EstimateAt(int index) const;
  std::vector<Pose> Estimates() const;  // by pose index

  // At the estimate, O(factors): of all factors, whatever their weights; and with the kernel.
  double Chi2() const;
  double RobustChi2() const;
  // With which a factor takes part now: 1 without a kernel and for what is no loop. Throws std::invalid_argument if the
  // factor is unknown.
  double WeightOf(FactorId id) const;
  double LogDeterminant() const { return factor_.LogDeterminant(); }  // ln det H at the linearisation point
  // The factor (variable = pose index) at LinearizationPoints().
  const BlockCholesky<B>& Factor() const { return factor_; }
  const std::vector<Pose>& LinearizationPoints() const { return linearization_points_; }
  const PhaseSeconds& Seconds() const { return seconds_; }
  // What the anchor on the first pose holds; and what the absolute measurements so far leave undetermined, in words
  // (gauge.h): "" if they determine everything, or if there are none.
  const Gauge<Pose>& CurrentGauge() const { return gauge_; }
  std::string DescribeUndetermined() const;

  // A loaded solver continues bit for bit as the saved one would have, options included: every later estimate, factor
  // and report but for times, and what times decide (budget_seconds). Covariances made on the saved one are to be made
  // anew. state_file.h describes the file. Both throw FileError; a file that cannot be written stays as it was.
  void Save(const std::string& path) const;
  static IncrementalSolver Load(const std::string& path, LogSink log = {});
  void SetLog(LogSink log) { options_.log = std::move(log); }

 private:
  using Clock = std::chrono::steady_clock;
  using PointOf = std::function<const Pose&(int)>;
  using Replacements = std::vector<std::pair<int, LinearFactor<B>>>;
  struct Plan;
  struct Loop;
  using Loops = std::vector<Loop>;
  struct GateValues {
    double log_determinant = 0;
    int variables = 0;
  };
  // incremental_plan.cpp: what an update brings.
  void Validate(const GraphUpdate<Pose>& update) const;
  void PlanNewPoses(const GraphUpdate<Pose>& update, Plan& plan) const;
  // incremental_frame.cpp: the gauge, and the motion of the whole map when it changes.
  using Placed = std::vector<std::pair<terse::Factor<Pose>, Pose>>;  // absolute measurements, where their poses are
  void PlanFrame(const GraphUpdate<Pose>& update, Plan& plan) const;
  Placed AbsoluteAfter(const GraphUpdate<Pose>& update, const Plan& plan) const;
  void PlanMotion(const GraphUpdate<Pose>& update, const Pose& T_new_old, Plan& plan) const;
  void CommitFrame(const Plan& plan);
  // incremental_plan.cpp
  void PlanFactors(const GraphUpdate<Pose>& update, Plan& plan) const;
  void PlanAnchor(const GraphUpdate<Pose>& update, Plan& plan) const;
  void BindSlot(int slot, FactorId id, const Matrix<B, B>& W);
  void ReleaseSlot(FactorId id);
  AbsoluteFactors AbsoluteFactorsAfter(const GraphUpdate<Pose>& update) const;
  void Commit(const GraphUpdate<Pose>& update, const Plan& plan, StepReport& report,
              const std::vector<int>& added_slots);
  // incremental_solver.cpp
  void AddToFactor(const GraphUpdate<Pose>& update, Plan& plan, StepReport& report);
  [[noreturn]] void ThrowSingularUpdate(const GraphUpdate<Pose>& update, const Plan& plan, int failed_variable) const;
  typename BlockCholesky<B>::UpdateReport UpdateFactor(typename BlockCholesky<B>::Changes changes, StepReport& report);
  double TimedChi2(StepReport& report) const;
  void LogStep(const GraphUpdate<Pose>& update, const StepReport& report, bool was_deferred) const;
  // incremental_gate.cpp
  GateValues ValuesForGate() const;
  void ChangeCosts(const LinearFactor<B>& factor, int sign);
  void RecountCosts();
  double LinearMinimum() const { return cost_at_points_ - factor_.NewtonDecrement(); }
  double RemainingDecrease() const;
  double DegreesOfFreedom() const;  // at least one
  // What changes of chi2 are measured by: chi2 itself. The floor is for measurements that fit to rounding.
  double CostUnit() const { return std::max(LinearMinimum(), 1e-6 * DegreesOfFreedom()); }
  bool ClosesLoop(const GraphUpdate<Pose>& update) const;
  void DecideGate(const GraphUpdate<Pose>& update, const Plan& plan, const GateValues& before, StepReport& report);
  void PlaceNewPoses(int new_poses, StepReport& report);
  // incremental_offsets.cpp: Carry::kOffset, and relinearisation for both.
  bool IsOutgrown(int variable) const;
  double PossibleError(int variable) const;
  bool IsRelinearizationDue() const {
    return !moved_.empty() && updates_ - looked_at_ >= options_.relinearize_interval;
  }
  const Pose& RememberedEstimate(int index);
  Vector<Pose::kDof> WhitenedResidualAt(int slot);
  double LinearizationError(int slot);
  double ErrorAfter(int slot, const std::map<int, Pose>& points);
  void UpdateLinearizationErrors();
  void ForgetErrors();
  void SetLinearizationError(int slot, double error);
  // What is far below the tolerance is counted but not looked for.
  bool IsSuspicious(double error) const { return error > 1e-5 * options_.relinearize_tolerance * CostUnit(); }
  std::map<int, Pose> PosesToRelinearize(double times, std::optional<Clock::time_point> deadline, StepReport& report);
  double AffordableFlops(Clock::time_point deadline) const;
  double PathFlops(int variable, const std::unordered_set<int>& fronts) const;
  void TakePath(int variable, std::unordered_set<int>& fronts) const;
  LinearFactor<Pose::kDof> LinearizeSlot(int slot, const PointOf& point) const;
  Replacements LinearizeAround(const std::map<int, Pose>& points) const;
  bool Relinearize(const std::map<int, Pose>& points, Replacements replaced, StepReport& report);
  bool RelinearizeWorst(double times, std::optional<Clock::time_point> deadline, StepReport& report);
  void OptimizeOffsets(Clock::time_point start, StepReport& report);
  void BackSubstitute(std::optional<Clock::time_point> deadline, StepReport& report);
  // incremental_robust.cpp
  bool IsRobust() const { return options_.robust.kernel != RobustKernel::kNone; }
  void FindLoops(const GraphUpdate<Pose>& update, Plan& plan) const;
  Loop LoopOf(FactorId id) const;
  double LoopChi2(FactorId id) const;
  Vector<Pose::kDof> LinearResidual(int slot) const;
  double WeightOnArrival(Loop& loop) const;
  bool ChangeLoops(const Loops& in, const Loops& out, StepReport& report);
  void LogLoops(const Loops& loops, const char* what) const;
  void Park(FactorId id, double chi2);
  void Unpark(FactorId id);
  void AdmitNewLoops(Plan& plan, StepReport& report);
  bool AdmitLoops(const Loops& loops, StepReport& report);
  void AddContestants(Loops& contest) const;
  bool JudgeLoops(Loops& loops, StepReport& report);
  std::vector<int> TouchedLoops();
  bool ReviewMembers(StepReport& report);
  bool ReviewWeights(StepReport& report);
  void SetWeight(int slot, double weight);
  bool RetryParked(StepReport& report);
  void ReviewLoops(Clock::time_point start, StepReport& report);
  // incremental_restart.cpp: wrong minima.
  bool MayRestart() const { return options_.restart && options_.carry == Carry::kOffset && !IsRobust(); }
  void WatchStep(double minimum_before, double minimum_after, StepReport& report);
  bool SeemsTrapped() const;
  void RestartIfLower(StepReport& report);
  std::optional<std::vector<Pose>> RelaxedValues() const;
  void TookRestart();
  std::optional<BatchResult<Pose>> LowerMinimum(double cost, bool suspected, BatchOptions options) const;
  bool MoveTo(const std::vector<Pose>& T_world_body);
  BatchResult<Pose> SolveRobustBatch(const std::vector<Pose>& T_world_body, BatchOptions options) const;
  void TakeWeights(const std::vector<double>& weights);
  // incremental_points.cpp: Carry::kPoint.
  using Steps = std::map<int, Vector<B>>;  // by variable
  Steps SolveSteps(const std::vector<int>* scope, StepReport& report);
  bool ExceedsStepTolerance(const Vector<B>& d) const;
  bool MoveBy(Steps& steps, StepReport& report);
  std::vector<int> NextScope(const Steps& moved, bool neighbours) const;
  void MovePoints(int new_poses, Clock::time_point start, StepReport& report);
  // incremental_state.cpp: as state_file.h says.
  friend struct internal::StateAccess;
  template <class Archive>
  void Serialize(Archive& archive);
  std::string FindStateDefect() const;

  IncrementalOptions options_;
  PoseGraph<Pose> graph_;
  std::vector<Pose> linearization_points_;
  BlockCholesky<B> factor_;
  std::vector<int> slot_of_factor_;       // by factor id; -1 when removed
  std::vector<FactorId> factor_of_slot_;  // -1: an anchor, or a free slot
  std::vector<Matrix<B, B>> W_of_slot_;   // square roots of the factors' information
  int anchor_slot_ = -1;
  Gauge<Pose> gauge_;
  int gauge_found_at_ = 0;  // how many absolute measurements there were
  AbsoluteFactors absolute_;
  std::vector<int> moved_;           // poses that turned since their factors' errors were looked at
  std::vector<double> possible_of_;  // by pose index: PossibleError, 0 if not in moved_
  std::vector<Vector<B>> seen_;      // by pose index: d when its factors' errors were looked at
  double possible_error_ = 0;        // of moved_
  std::vector<Pose> remembered_;     // estimates, by pose index
  std::vector<long> remembered_in_;  // the look that they are from
  long look_ = 0;
  std::vector<double> error_of_slot_;  // |r(estimate) - (r + A d)|^2 when last looked at
  double error_sum_ = 0;
  std::vector<int> suspects_;                 // slots with an error worth looking at
  std::vector<char> is_suspect_, is_listed_;  // by slot
  long updates_ = 0, looked_at_ = 0;          // steps; the one that last looked for errors
  // Of the linearised system: chi2 at the linearisation points, and at the present d.
  double cost_at_points_ = 0, linear_cost_ = 0;
  long measured_scalars_ = 0;
  double eta_ = 0;  // 1/2 ln |H| when the previous step's factors had been added
  int eta_variables_ = 0;
  double seconds_per_flop_ = 1e-9;  // of relinearisation: measured, by the flops that were predicted
  bool deferred_ = false;           // work is left from earlier steps
  PhaseSeconds seconds_;
  // What tells a wrong minimum.
  struct Watch {
    double explained = 0;   // sum of the innovations at arrival: what chi2 comes to if the residuals were linear
    double corrected = 0;   // sum of the changes that relinearisation made to the linearised minimum, without sign
    double cost_tried = 0;  // when a restart was last tried
    long poses_tried = 0;
    long restarts = 0;
  } watch_;
  // Robust estimation; empty without a kernel.
  struct Parked {
    FactorId id;
    double chi2;  // when it was judged
  };
  std::vector<Parked> parked_;          // kGnc: loops that are out of the factor, ascending
  std::vector<char> is_loop_;           // by slot
  std::vector<double> weight_of_slot_;  // of a loop; W_of_slot_ contains its root
  std::vector<double> judged_chi2_;     // kGnc, by slot: of a loop, when it was judged
  std::vector<int> touched_;            // poses that moved since their loops were looked at
  double width_ = 0;                    // from the options
};

}  // namespace terse
