#pragma once
// How an open gate's step is carried: the two strategies of IncrementalOptions::carry.

#include "incremental/relinearization.h"

namespace terse::internal {

// A step under way.
template <class Pose>
struct StepContext {
  const IncrementalOptions& options;
  LinearizedGraph<Pose>& map;
  Relinearization<Pose>& relinearization;
  StepReport& report;
  double settled = 0;  // decrease of the cost that judging loops took before the gate looks
  std::chrono::steady_clock::time_point start = std::chrono::steady_clock::now();

  double Seconds() const { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); }
  bool IsOverBudget() const { return options.budget_seconds > 0 && Seconds() > options.budget_seconds; }
};

// Carry::kOffset: relinearises what is due (or left, if the last step deferred work), back-substitutes, and again while
// the errors are urgent. True if work is deferred to later steps.
template <class Pose>
bool OptimizeOffsets(int new_poses, bool was_deferred, StepContext<Pose>& step);
// One back-substitution, of everything that it reaches or up to the deadline.
template <class Pose>
void BackSubstitute(std::optional<std::chrono::steady_clock::time_point> deadline, StepContext<Pose>& step);

// Carry::kPoint: moves the linearisation points while any step exceeds the step tolerance (Arablouei 2026 Eqs. 17-18);
// with the gate closed those of the new poses. True if work is deferred.
template <class Pose>
bool OptimizePoints(int new_poses, StepContext<Pose>& step);

// All linearisation points. False, and nothing changes, if the Cholesky factor does not take them.
template <class Pose>
bool MoveMap(const std::vector<Pose>& T_world_body, StepContext<Pose>& step);

}  // namespace terse::internal
