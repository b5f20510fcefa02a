#pragma once
// Incremental optimisation of a growing pose graph (Arablouei 2026 Algorithm 1, with the gates and policies of
// incremental_options.h). An update
//
//   1. is checked and planned: new poses get values, new factors are linearised, the gauge is found (gauge.h);
//   2. is added to the Cholesky factor, along the paths of the tree that it touches;
//   3. with a robust kernel (robust.h), its loops come in with the weight that their innovation deserves, or stay out;
//   4. passes the gate, or not: what the factors are worth decides whether the map is optimised;
//   5. if it passes, linearisation points move to the estimates where the linearised system describes the measurements
//      worst, and back-substitution brings the step to every pose that it moves; else only the new poses are placed;
//   6. loops that the estimate has come to contradict, or to agree with, are judged again, and a map that seems to sit
//      in a wrong minimum tries another start.
//
// Each of these is a part of its own in core/incremental (docs/architecture.md).
//
// When absolute measurements come to determine where the map is or how it is turned, the map as a whole is moved to
// where they say before its anchor lets go: all linearisation points together, so that no step has to turn it. What
// they have determined once stays theirs until one is removed.
//
// A new pose starts at the value given with it, else at that of its pose prior, else at T_estimate * T_from_to along
// its first factor to a known pose; the very first one may have none of these and starts at the identity. Update is
// atomic: if it throws, the solver is as before. Not thread-safe for writing; const functions may run concurrently.

#include <memory>
#include <string>
#include <vector>

#include "terse/core/batch_solver.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/gauge.h"
#include "terse/core/graph_update.h"
#include "terse/core/incremental_options.h"
#include "terse/core/pose_graph.h"
#include "terse/core/step_report.h"

namespace terse {

template <class Pose>
class IncrementalSolver {
 public:
  static constexpr int B = Pose::kDof;

  explicit IncrementalSolver(const IncrementalOptions& options = {});
  IncrementalSolver(const IncrementalSolver& other);
  IncrementalSolver(IncrementalSolver&& other) noexcept;
  IncrementalSolver& operator=(IncrementalSolver other) noexcept;
  ~IncrementalSolver();

  // Throws std::invalid_argument (unknown or duplicate ids, defective factors, a pose no factor reaches),
  // UnobservableError (the system would be singular; it says what would be free) or NumericalError (not finite).
  StepReport Update(const GraphUpdate<Pose>& update);

  // Iterates to the batch optimum, which becomes the linearisation point; where the system turns out not to be positive
  // definite, nothing changes. The result's poses are in the order of Graph().Poses(). The kernel and the loops are
  // this solver's, whatever `options` says, the log unless it has its own. kGnc starts from the loops that are in.
  // Where more than one in twenty is out, and many have no other that bears them out, all are told apart anew besides,
  // those first that others do, and the lower cost wins (BatchOptions::graduate; false: not so). Where a chordal
  // relaxation of the graph costs less than the estimate, it starts from there (IncrementalOptions::restart).
  BatchResult<Pose> Finish(const BatchOptions& options = {});
  // From these values and no others, by pose index.
  BatchResult<Pose> FinishFrom(const std::vector<Pose>& T_world_body, const BatchOptions& options = {});

  const IncrementalOptions& Options() const { return options_; }
  // How often the map left a wrong minimum for a lower one (IncrementalOptions::restart), Finish included.
  int Restarts() const;
  // From now on the width of kGnc, where RobustOptions leave it open, is at most this: for who tests loops before they
  // come, and knows better how well they agree. Loops that are in are judged again if it is much narrower than it was.
  void LimitRobustWidth(double width);
  // Adds the restarts and seconds of a solver that this one takes the place of, and what it learned of loops.
  void CountOnFrom(const IncrementalSolver& earlier);

  // Poses and living factors; the pose values in it are the initial ones.
  const PoseGraph<Pose>& Graph() const;
  // Throws std::invalid_argument if the pose is unknown.
  Pose Estimate(PoseId id) const { return EstimateAt(Graph().IndexOf(id)); }
  Pose EstimateAt(int index) const;
  std::vector<Pose> Estimates() const;  // by pose index

  // At the estimate, O(factors): of all factors, whatever their weights; and with the kernel.
  double Chi2() const;
  double RobustChi2() const;
  // With which a factor takes part now: 1 without a kernel and for what is no loop. Throws std::invalid_argument if the
  // factor is unknown.
  double WeightOf(FactorId id) const;
  double LogDeterminant() const { return Cholesky().LogDeterminant(); }  // ln det H at the linearisation point
  // The factor (variable = pose index) at LinearizationPoints().
  const BlockCholesky<Pose::kDof>& Cholesky() const;
  const std::vector<Pose>& LinearizationPoints() const;
  const PhaseSeconds& Seconds() const;
  // What the anchor on the first pose holds; and what the absolute measurements so far leave undetermined, in words
  // (gauge.h): "" if they determine everything, or if there are none.
  const Gauge<Pose>& CurrentGauge() const;
  std::string DescribeUndetermined() const;

  // A loaded solver continues bit for bit as the saved one would have, options included: every later estimate, factor
  // and report but for times, and what times decide (budget_seconds). Covariances made on the saved one are to be made
  // anew. state_file.h describes the file. Both throw FileError; a file that cannot be written stays as it was.
  void Save(const std::string& path) const;
  static IncrementalSolver Load(const std::string& path, LogSink log = {});
  void SetLog(LogSink log);

 private:
  // The linearised graph, relinearisation, gate, loop judge and watch over minima.
  struct Parts;
  friend struct internal::StateAccess;
  template <class Archive>
  void Serialize(Archive& archive);

  IncrementalOptions options_;
  std::unique_ptr<Parts> parts_;
};

}  // namespace terse
