#include "compact_parts.h"

#include <cmath>
#include <stdexcept>

#include "terse/compact/state_members.h"
#include "terse/core/definite.h"

namespace terse::internal {
namespace {

void Require(bool is_met, const char* what) {
  if (!is_met) throw std::invalid_argument(std::string("compact options: ") + what);
}

template <class Pose>
void CheckThresholds(const Thresholds<Pose>& thresholds) {
  const auto& [range, probability, min_loop_gain, min_pose_gain, link_covariance] = thresholds;
  Require((range.array() > 0).all() && range.allFinite(), "the sensor range must be positive and finite");
  Require(probability >= 0 && probability < 1, "the probability must be in [0, 1)");
  Require(min_loop_gain >= 0 && min_pose_gain >= 0, "gains must not be negative");
  // Cholesky reads one triangle and lets NaN pass.
  const bool symmetric = (link_covariance - link_covariance.transpose()).norm() <= 1e-9 * link_covariance.norm();
  Require(symmetric && IsDefinite<Pose::kDof>(link_covariance), "the link covariance is not positive definite");
}

template <class Pose>
void CheckOptions(const CompactOptions<Pose>& o) {
  const std::string defect = FindDefect(o.budget, o.strategy);
  Require(defect.empty(), defect.c_str());
  CheckThresholds(o.thresholds);
  Require(!o.innovation_quantile || (*o.innovation_quantile > 0 && *o.innovation_quantile < 1),
          "the innovation quantile must be in (0, 1)");
  Require(o.plausible_quantile > 0 && o.plausible_quantile < 1,
          "the quantile of plausible displacements must be in (0, 1)");
  Require(o.max_registrations >= 1, "at least one registration per pose is needed");
  Require(o.failed_neighbourhood >= 0, "the neighbourhood of failed registrations must not be negative");
  Require(!o.most_dropped || *o.most_dropped >= 1, "at least one dropped pose has to be remembered");
  Require(o.most_recorded >= 0, "no less than 0 candidates can be recorded");
  Require(o.min_variance_drop >= 0 && o.min_variance_drop < 1, "the share of the variance must be in [0, 1)");
  Require(o.retire_share >= 0 && std::isfinite(o.retire_share),
          "the share of a retiring pose's loss must be 0 or more");
  Require(o.consensus >= 2, "a consensus takes at least two links");
  Require(o.distance.view_axis.norm() > 0 && o.distance.view_axis.allFinite(), "the view axis is zero or not finite");
}

template <class Pose>
IncrementalOptions SolverOptions(const CompactOptions<Pose>& options) {
  IncrementalOptions out = options.solver;
  if (!out.log) out.log = options.log;
  return out;
}

}  // namespace

template <class Pose>
CompactParts<Pose>::CompactParts(const CompactOptions<Pose>& with) : map(SolverOptions(with)) {
  TakeOptions(with);
}

template <class Pose>
void CompactParts<Pose>::TakeOptions(const CompactOptions<Pose>& with) {
  CheckOptions(with);
  options = with;
  gains.Start(options);
  links.TakeOptions(options);
  search.TakeOptions();
  tests.TakeOptions();
  const Strategy strategy = options.strategy;
  map.KeepCovariances(strategy == Strategy::kApfl || strategy == Strategy::kFpfl || strategy == Strategy::kBounded);
}

// All but what the next step works out again to the same bits.
template <class Pose>
template <class Archive>
void CompactParts<Pose>::Serialize(Archive& archive) {
  archive(options);
  if constexpr (Archive::kReads) TakeOptions(options);
  archive(map, gains, links, history, poses_after_retiring);
  links.SerializeEdges(archive);
  archive(tests);
  if constexpr (Archive::kReads) {
    const PoseGraph<Pose>& graph = map.Solver().Graph();
    for (const std::string& defect :
         {history.FindStateDefect(graph), tests.FindStateDefect(), links.FindStateDefect(graph, history)}) {
      if (!defect.empty()) archive.Fail(defect);
    }
  }
}

#define TERSE_INSTANTIATE(Pose)                              \
  template struct CompactParts<Pose>;                        \
  template void CompactParts<Pose>::Serialize(StateWriter&); \
  template void CompactParts<Pose>::Serialize(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
