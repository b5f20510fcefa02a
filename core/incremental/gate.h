#pragma once
// What the new factors are worth, and whether the map is optimised for them (Arablouei 2026; the values are in
// docs/algorithms.md).

#include "incremental/steps.h"
#include "incremental/update_plan.h"

namespace terse::internal {

template <class Pose>
class UpdateGate {
 public:
  static constexpr int B = Pose::kDof;
  // Of the block system before an update.
  struct Before {
    double log_determinant = 0;
    int variables = 0;
  };
  static Before Look(const LinearizedGraph<Pose>& map) {
    return {map.Cholesky().LogDeterminant(), map.Cholesky().Variables()};
  }
  // What is news to the gate: an update that has been added to the map.
  struct News {
    const GraphUpdate<Pose>& update;
    const UpdatePlan<Pose>& plan;  // with the linear factors that came
    Before before;
    bool is_deferred = false;  // earlier steps left work over
  };
  // Fills in the report's gain, predicted decrease, gate value and verdict; once per update, whose number is
  // step.map.Updates(). Whatever the value, kNewtonDecrement opens for work that earlier steps left over and for
  // relinearisation that is due, kMutualInformation and kLogDeterminant for such work and for a changed anchor, the
  // others for nothing else.
  void Decide(const News& news, StepContext<Pose>& step);

  template <class Archive>
  void Serialize(Archive& archive);
  std::string FindStateDefect() const { return eta_variables_ < 0 ? "it has miscounted" : ""; }

 private:
  double eta_ = 0;  // 1/2 ln |H| when the previous step's factors had been added
  int eta_variables_ = 0;
};

}  // namespace terse::internal
