#include "kept_map.h"

#include "terse/compact/state_members.h"
#include "terse/core/require_optimum.h"

namespace terse::internal {

template <class Pose>
UncertainPose<Pose> KeptMap<Pose>::Between(PoseId a, PoseId b) const {
  if (a == b) return {};
  return {solver_.Estimate(a).Inverse() * solver_.Estimate(b), marginals_->Relative(a, b)};
}

template <class Pose>
void KeptMap<Pose>::UpdateCovariances() {
  if (keeps_covariances_) marginals_->Update();
}

template <class Pose>
StepReport KeptMap<Pose>::Update(const GraphUpdate<Pose>& update) {
  StepReport report = solver_.Update(update);
  UpdateCovariances();
  return report;
}

template <class Pose>
BatchResult<Pose> KeptMap<Pose>::Finish() {
  BatchOptions options;
  options.graduate = false;  // which of all loops are wrong is asked before a map is made (contradicted_loops.h)
  BatchResult<Pose> result = solver_.Finish(options);
  UpdateCovariances();
  return result;
}

template <class Pose>
StepReport KeptMap<Pose>::Restore(const GraphUpdate<Pose>& update, const std::vector<Pose>& T_world_body) {
  IncrementalSolver<Pose> fresh(solver_.Options());
  StepReport report = fresh.Update(update);
  // Not from the solver's estimates: with its gate closed it has placed all poses one after the other, as new ones.
  RequireOptimum(fresh.FinishFrom(T_world_body));
  fresh.CountOnFrom(solver_);
  solver_ = std::move(fresh);
  marginals_.emplace(solver_);
  UpdateCovariances();
  return report;
}

template <class Pose>
template <class Archive>
void KeptMap<Pose>::Serialize(Archive& archive) {
  auto& [solver, marginals, keeps_covariances] = *this;
  archive(solver, *marginals, keeps_covariances);
}

#define TERSE_INSTANTIATE(Pose)                         \
  template class KeptMap<Pose>;                         \
  template void KeptMap<Pose>::Serialize(StateWriter&); \
  template void KeptMap<Pose>::Serialize(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
