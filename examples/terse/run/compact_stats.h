#pragma once
// stats.json of a run over a stored graph: docs/outputs.md.

#include <optional>

#include "run/run_statistics.h"
#include "terse/compact/compact_graph.h"
#include "terse/compact/composed_counts.h"
#include "terse/compact/run_writer.h"
#include "terse/core/evaluate.h"

namespace terse {

// ATE and RPE from each pose to the next; absent without the truth of two poses at least.
std::optional<Evaluation> EvaluateRun(const RunTrajectories& trajectories, int dimension);

// Times but those of its steps are the caller's.
template <class Pose>
Stats MakeStats(const PoseGraph<Pose>& graph, const CompactRun<Pose>& run, const std::optional<Evaluation>& errors);

// loops_judged: of so many loops, why they were judged and which of them are wrong.
nlohmann::ordered_json LoopsJudgedJson(std::size_t loops, const std::vector<std::string>& reasons,
                                       const std::vector<std::pair<PoseId, PoseId>>& wrong, double seconds);

// What the strategy bounded made of links: keys of stats.json, and a line of words for the summary. Nothing for others.
template <class Pose>
std::optional<ComposedCounts> CountComposed(const CompactPoseSlam<Pose>& slam);
void AddTo(nlohmann::ordered_json& stats, const std::optional<ComposedCounts>& counts);
std::string Describe(const std::optional<ComposedCounts>& counts);

// What retired from the map (retire_poses.h): likewise.
struct RetiredCounts {
  long poses = 0;
  double loss = 0;  // nats, of all together
  void Add(const std::vector<RetiredPose>& retired);
};
// Nothing where no pose could.
std::optional<RetiredCounts> ToTell(const RetiredCounts& counts, Strategy strategy);
template <class Pose>
std::optional<RetiredCounts> CountRetired(const CompactRun<Pose>& run);
// Besides, at the end of a run, those that lose no more than this.
template <class Pose>
void RetireFrom(CompactRun<Pose>& run, double most_loss);
void AddTo(nlohmann::ordered_json& stats, const std::optional<RetiredCounts>& counts);
std::string Describe(const std::optional<RetiredCounts>& counts);

}  // namespace terse
