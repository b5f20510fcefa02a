#include "run/compact_stats.h"

#include <cstdio>

#include "terse/compact/compact_json.h"
#include "terse/core/require_optimum.h"

namespace terse {

std::optional<Evaluation> EvaluateRun(const RunTrajectories& trajectories, int dimension) {
  if (!trajectories.truth || trajectories.estimate.stamps.size() < 2) return std::nullopt;
  EvaluateOptions how;
  how.alignment = dimension == 2 ? Alignment::kSE2 : Alignment::kSE3;
  how.all_pairs = false;
  return Evaluate(trajectories.estimate.T_world_body, trajectories.truth->T_world_body, how);
}

template <class Pose>
std::optional<ComposedCounts> CountComposed(const CompactPoseSlam<Pose>& slam) {
  if (slam.Options().strategy != Strategy::kBounded) return std::nullopt;
  return CountComposed(slam.Export());
}

nlohmann::ordered_json LoopsJudgedJson(std::size_t loops, const std::vector<std::string>& reasons,
                                       const std::vector<std::pair<PoseId, PoseId>>& wrong, double seconds) {
  nlohmann::ordered_json links = nlohmann::ordered_json::array();
  for (const auto& [from, to] : wrong) links.push_back({{"from", from.value}, {"to", to.value}});
  return {{"loops", loops}, {"reasons", reasons}, {"left_out", wrong.size()}, {"seconds", seconds}, {"links", links}};
}

void AddTo(nlohmann::ordered_json& stats, const std::optional<ComposedCounts>& counts) {
  if (!counts) return;
  stats["poses_anchored"] = counts->anchored;
  stats["edges_composed"] = counts->edges;
  stats["measurements_composed"] = counts->measurements;
  stats["edges_fused"] = counts->fused;
}

std::string Describe(const std::optional<ComposedCounts>& counts) {
  if (!counts) return "";
  const auto of = [](long count, const char* one, const char* many) {
    return std::to_string(count) + ' ' + (count == 1 ? one : many);
  };
  return of(counts->anchored, "pose was", "poses were") + " found again at kept poses (anchored); " +
         of(counts->edges, "edge holds ", "edges hold ") + of(counts->measurements, "measurement", "measurements") +
         " composed of links, " + of(counts->fused, "edge is", "edges are") + " fused of several\n";
}

void RetiredCounts::Add(const std::vector<RetiredPose>& retired) {
  poses += static_cast<long>(retired.size());
  for (const RetiredPose& pose : retired) loss += pose.loss;
}

std::optional<RetiredCounts> ToTell(const RetiredCounts& counts, Strategy strategy) {
  const bool may = strategy == Strategy::kBounded || counts.poses > 0;
  return may ? std::optional<RetiredCounts>(counts) : std::nullopt;
}

template <class Pose>
std::optional<RetiredCounts> CountRetired(const CompactRun<Pose>& run) {
  RetiredCounts counts;
  for (const Decision& decision : run.decisions) counts.Add(decision.retired);
  counts.Add(run.retired);
  return ToTell(counts, run.slam.Options().strategy);
}

template <class Pose>
void RetireFrom(CompactRun<Pose>& run, double most_loss) {
  const std::vector<RetiredPose> retired = run.slam.Retire(most_loss);
  run.retired.insert(run.retired.end(), retired.begin(), retired.end());
  run.result = run.slam.Finish();
  RequireOptimum(run.result);
}

void AddTo(nlohmann::ordered_json& stats, const std::optional<RetiredCounts>& counts) {
  if (!counts) return;
  stats["poses_retired"] = counts->poses;
  stats["retired_loss_nats"] = counts->loss;
}

std::string Describe(const std::optional<RetiredCounts>& counts) {
  if (!counts) return "";
  char line[120];
  std::snprintf(line, sizeof(line), "%ld %s retired; their removal lost %.3g nats\n", counts->poses,
                counts->poses == 1 ? "pose" : "poses", counts->loss);
  return line;
}

template <class Pose>
Stats MakeStats(const PoseGraph<Pose>& graph, const CompactRun<Pose>& run, const std::optional<Evaluation>& errors) {
  Stats stats;
  const PoseGraph<Pose> map = MapGraph(run.slam, run.result.T_world_body);
  const EdgeCounts kept = CountEdges(map);
  stats.poses = static_cast<std::size_t>(run.slam.PosesSeen());
  stats.counts = CountEdges(graph);
  stats.step_seconds = run.step_seconds;
  const bool leaves_out = run.slam.Options().solver.robust.kernel == RobustKernel::kGnc;
  stats.chi2 = leaves_out ? Chi2(map) : run.result.chi2;
  stats.normalized_chi2 = kept.scalars > 0 ? stats.chi2 / static_cast<double>(kept.scalars) : 0;
  stats.log_determinant = run.result.log_determinant;
  stats.iterations = run.result.iterations;
  stats.converged = run.result.Converged();
  stats.termination = Name(run.result.termination);
  stats.phases = run.slam.Solver().Seconds();
  stats.more["strategy"] = Name(run.slam.Options().strategy);
  stats.more["poses_kept"] = run.PosesKept();
  stats.more["links_kept"] = run.LinksKept();
  stats.more["links_offered"] = run.links_offered;
  stats.more["registrations_tried"] = run.registrations_tried;
  stats.more["links_refused"] = run.links_refused;
  AddTo(stats.more, CountComposed(run.slam));
  AddTo(stats.more, CountRetired(run));
  stats.more["restarts"] = run.slam.Solver().Restarts();
  nlohmann::ordered_json thresholds = ThresholdsToJson(run.slam.Options().thresholds);
  thresholds.erase("link_covariance");
  stats.more["thresholds"] = std::move(thresholds);
  if (errors) {
    stats.more["errors"] = {{"ate_m", errors->ate.translation_m},
                            {"ate_deg", errors->ate.rotation_deg},
                            {"rpe_m", errors->rpe.translation_m},
                            {"rpe_deg", errors->rpe.rotation_deg}};
  }
  return stats;
}

template std::optional<ComposedCounts> CountComposed(const CompactPoseSlam<SE2>&);
template std::optional<ComposedCounts> CountComposed(const CompactPoseSlam<SE3>&);
template std::optional<RetiredCounts> CountRetired(const CompactRun<SE2>&);
template std::optional<RetiredCounts> CountRetired(const CompactRun<SE3>&);
template void RetireFrom(CompactRun<SE2>&, double);
template void RetireFrom(CompactRun<SE3>&, double);
template Stats MakeStats<SE2>(const PoseGraph<SE2>&, const CompactRun<SE2>&, const std::optional<Evaluation>&);
template Stats MakeStats<SE3>(const PoseGraph<SE3>&, const CompactRun<SE3>&, const std::optional<Evaluation>&);

}  // namespace terse
