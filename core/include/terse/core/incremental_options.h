#pragma once
// How much an incremental step re-optimises. What it reports is in step_report.h.
//
// A step adds its factors to the Cholesky factor, asks the gate whether the map is optimised at all, and then carries
// the Gauss-Newton step in one of two ways. All published variants are settings of these options (PolicyOptions).
// Sources: Arablouei 2026, "Efficient Incremental SLAM via Information-Guided and Selective Optimization" (gates,
// partial optimisation); Kaess et al. 2012 (estimate = linearisation point + d).

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "terse/core/log.h"
#include "terse/core/pose_graph.h"
#include "terse/core/robust.h"

namespace terse {

// kOffset: estimate = linearisation point + d. Back-substitution reports every step in the estimate; poses whose d
//   outgrew the linearisation are relinearised when the interval comes round.
// kPoint: the estimate is the linearisation point. While any step exceeds the step tolerance, the poses move and are
//   relinearised: all of them, or, if partial, those above it while the rest of the step is dropped (Arablouei 2026
//   Eqs. 17-18). With the gate closed only the new poses take part, by their share of the full Gauss-Newton step.
enum class Carry { kOffset, kPoint };

// What has to exceed the gate's threshold for the map to be optimised in a step; kAlways and kNever have none, and the
// value 0. Saved states hold the numbers of these enums: new values come last.
enum class Gate {
  kNewtonDecrement,    // predicted decrease of chi2 that the estimate does not have yet; see DecreaseScale
  kMutualInformation,  // gain of the new factors about what was known, 1/2 ln |I + A Sigma A'|, nats
  kLogDeterminant,     // eta_t - N_t / N_{t-1} eta_{t-1}, eta = 1/2 ln |H|, N scalars: the published code of Arablouei
                       // 2026, not its Eq. 6
  kLoopClosure,        // a new relative factor between known poses that came in more than the threshold poses apart
  kAlways,
  kNever,
};

// The unit of the threshold of Gate::kNewtonDecrement.
enum class DecreaseScale {
  kAbsolute,  // of chi2 itself
  kChi2,      // relative to the linearised chi2 at its minimum
  kDof,       // relative to the scalars measured beyond those estimated (at least one)
};

// The work of a step of Carry::kPoint, for those who count it by a model of their own. Poses by their indices.
struct PointWork {
  enum class Kind {
    kEntered,       // before the first iteration: the poses from `first` on came with this step
    kSolved,        // back-substitution
    kRelinearised,  // linear factors linearised and refactored anew
  };
  Kind kind = Kind::kEntered;
  int first = 0;
  const std::vector<int>* poses = nullptr;  // solved for or relinearised; all if null
};

struct IncrementalOptions {
  Carry carry = Carry::kOffset;
  Gate gate = Gate::kNewtonDecrement;
  double gate_threshold = 1e-5;
  DecreaseScale decrease_scale = DecreaseScale::kChi2;

  // kOffset: factors are relinearised, those with the largest error first, when their linearisation errors
  // |r(estimate) - (r + A d)|^2 (whitened) add up to more than this share of chi2, until they add up to half of it.
  // Without a robust kernel, where chi2 is far below the degrees of freedom, their share is tolerated, up to 0.0003,
  // which moves no pose by more than 0.02 standard deviations, and 30 shares of chi2; and errors of poses that can
  // hardly matter are not looked for.
  double relinearize_tolerance = 1e-6;
  // Only poses whose d exceeds either are looked at.
  double relinearize_metres = 0;
  double relinearize_radians = 0;
  // Relinearisation is considered at every n-th step, or at once where the errors may be 100 times that share and 10
  // times what is tolerated: the steps between touch far less, and the estimate, which includes d, hardly notices.
  int relinearize_interval = 10;
  // Back-substitution leaves a subtree alone where no pose above it moved by so much that this, all else held, would
  // change chi2 by more than this share of it. 0 is exact.
  double propagation_tolerance = 1e-7;

  // Gauss-Newton iterations in a step (tau_GN of Arablouei 2026, 10 there). kOffset: more than one only after a far
  // loop.
  int max_iterations = 2;
  // kPoint: the step tolerance (tau_d of Arablouei 2026).
  double step_metres = 1e-3;
  double step_radians = 1e-3;
  // kPoint: only the poses that the last iteration moved, and their neighbours, take part in the next; else all do.
  // Without neighbours as in the code published with Arablouei 2026: then a pose that has settled stays until the next
  // step.
  bool partial = false;
  bool partial_neighbours = true;
  // kPoint: a step that raises chi2 is replaced by the full Gauss-Newton step, then shortened until it does not.
  bool guard = true;

  // Seconds a step may take; 0: no limit. kOffset: relinearisation that does not fit is made ready in pieces by later
  // steps and moves at once, after ten steps at the latest; back-substitution leaves subtrees to the next step, those
  // that moved least, but every tenth goes to the end; a map so small that no step can come near the budget does not
  // look at the clock, and does the same every time. kPoint: iterations end. Adding the factors is never deferred. An
  // update without factors works off what is left.
  double budget_seconds = 0;

  // Information of the proximal anchor on every tangent direction of the first pose, whatever priors there are.
  // Absent: as gauge.h describes.
  std::optional<double> anchor_information;

  // The kernel for loops that may be wrong. Its weights are brought up to date where that changes a factor's cost by
  // more than this share of chi2.
  RobustOptions robust;
  double reweigh_tolerance = 1e-4;

  // A step after which the map seems to sit in a wrong minimum, and Finish, try a chordal relaxation of the graph and
  // go on from there if it costs less (core/incremental/minimum_watch.h). kOffset, without a robust kernel, and in a
  // step only where that should fit into the budget. With kGnc where loops that were believed go together, of what is
  // left, and whatever the budget: such a map is lost.
  bool restart = true;

  // At most, and only where a step's work is large; the result is the same to the last bit for any number.
  int threads = 1;

  // kOffset: fill in StepReport::actual_decrease (evaluates all factors twice, outside the time that is reported).
  bool report_cost = false;
  // Is told of a step's work as it goes on. Its time is not the step's; it is not stored with a solver.
  std::function<void(const PointWork&)> on_point_work;

  LogSink log;  // log.h
};

// A threshold to start from: 1e-5 of chi2, 0.1 nat, 1 (no value suits all graphs), 4 poses.
double DefaultThreshold(Gate gate);

// What is wrong with the options, or "".
std::string FindDefect(const IncrementalOptions& options);

// The variants of Arablouei 2026 as published: no guard, unit anchor; gate threshold and step tolerance are per data
// set.
enum class Policy { kDefault, kGn1, kGni, kGniLcg, kGniIgg, kGniSpo, kGniSpoLcg, kGniSpoIgg };
IncrementalOptions PolicyOptions(Policy policy);

}  // namespace terse
