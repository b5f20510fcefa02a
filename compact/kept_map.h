#pragma once
// The kept poses with what was measured between them: the solver, and what is known of the poses.

#include <optional>
#include <vector>

#include "terse/compact/uncertain_pose.h"
#include "terse/core/incremental_solver.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse::internal {

template <class Pose>
class KeptMap {
 public:
  explicit KeptMap(const IncrementalOptions& options) : solver_(options) { marginals_.emplace(solver_); }
  KeptMap(const KeptMap&) = delete;
  KeptMap& operator=(const KeptMap&) = delete;

  const IncrementalSolver<Pose>& Solver() const { return solver_; }
  const IncrementalMarginals<Pose>& Marginals() const { return *marginals_; }
  int Poses() const { return static_cast<int>(solver_.Graph().Poses().size()); }
  // T_a_b between kept poses.
  UncertainPose<Pose> Between(PoseId a, PoseId b) const;

  // Whether the covariances are brought up to date with every change from now on (IncrementalMarginals::Update).
  void KeepCovariances(bool keep) { keeps_covariances_ = keep; }
  void UpdateCovariances();

  // Throw what the solver throws.
  StepReport Update(const GraphUpdate<Pose>& update);
  BatchResult<Pose> Finish();
  // What this update makes, brought to its optimum from these values, by index, in place of what there is. Throws
  // NumericalError, and changes nothing, if it has none.
  StepReport Restore(const GraphUpdate<Pose>& update, const std::vector<Pose>& T_world_body);

  void LimitRobustWidth(double width) { solver_.LimitRobustWidth(width); }
  void SetLog(LogSink log) { solver_.SetLog(std::move(log)); }
  template <class Archive>
  void Serialize(Archive& archive);

 private:
  IncrementalSolver<Pose> solver_;
  // Of solver_, where it is; as new as its last change if they are kept. Never absent.
  std::optional<IncrementalMarginals<Pose>> marginals_;
  bool keeps_covariances_ = false;
};

}  // namespace terse::internal
