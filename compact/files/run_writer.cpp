#include "terse/compact/run_writer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>

#include "npz_file.h"
#include "terse/compact/compact_graph.h"
#include "terse/compact/compact_map.h"
#include "terse/compact/json_file.h"
#include "terse/compact/map_file.h"
#include "terse/compact/thresholds_file.h"
#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/core/graph_file.h"
#include "terse/core/number_text.h"
#include "terse/core/read_file.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/covariance/covariance_table.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse {
namespace {

constexpr const char* kRetiredAtEnd = "retired_at_end";

// The lines behind the first `skipped`, if there are so many.
std::string Rows(const std::string& path, std::size_t skipped, std::size_t rows) {
  if (!std::filesystem::exists(path)) return "";
  const std::string text = ReadAll(path);
  if (!text.empty() && text.back() != '\n') return "";  // the last one is cut short
  const auto lines = static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
  if (lines != skipped + rows) return "";
  std::size_t start = 0;
  for (std::size_t k = 0; k < skipped; ++k) start = text.find('\n', start) + 1;
  return text.substr(start);
}

std::string JsonNumber(const std::optional<double>& value) {
  return value && std::isfinite(*value) ? Shortest(*value) : "null";
}

const char* JsonFlag(bool value) { return value ? "true" : "false"; }

void WriteEdges(const std::vector<ComposedEdge>& edges, std::ostream& out) {
  const char* before = ",\"edges\":[";
  for (const ComposedEdge& edge : edges) {
    out << before << "{\"id\":" << edge.id.value << ",\"from\":" << edge.from.value << ",\"to\":" << edge.to.value
        << ",\"gain_nats\":" << JsonNumber(edge.gain) << ",\"fused\":" << JsonFlag(edge.fused) << '}';
    before = ",";
  }
  out << ']';
}

void WriteRetired(const char* key, const std::vector<RetiredPose>& retired, std::ostream& out) {
  if (retired.empty()) return;
  out << ",\"" << key << "\":[";
  for (std::size_t k = 0; k < retired.size(); ++k) out << (k > 0 ? "," : "") << retired[k].id.value;
  out << ']';
}

// Of a run that decided on no pose: what retired in it stands in the last line of the run that it continues.
std::string WithRetired(const std::string& lines, const std::vector<RetiredPose>& retired, const std::string& path) {
  if (lines.empty() || retired.empty()) return lines;
  const std::size_t before = lines.find_last_of('\n', lines.size() - 2);
  const std::size_t last = before == std::string::npos ? 0 : before + 1;
  auto decision = ParseJson<nlohmann::ordered_json>(lines.substr(last), path);
  for (const RetiredPose& pose : retired) decision[kRetiredAtEnd].push_back(pose.id.value);
  return lines.substr(0, last) + decision.dump() + '\n';
}

// A JSON object per line.
void WriteDecisionLines(const std::vector<Decision>& decisions, const std::vector<RetiredPose>& retired_at_end,
                        const std::string& earlier, const std::string& path) {
  AtomicFile file(path);
  std::ostream& out = file.Stream();
  out << (decisions.empty() ? WithRetired(earlier, retired_at_end, path) : earlier);
  for (const Decision& d : decisions) {
    out << "{\"pose\":" << d.id.value << ",\"kept\":" << JsonFlag(d.Kept()) << ",\"verdict\":\"" << Name(d.verdict)
        << "\",\"pose_gain_nats\":" << JsonNumber(d.pose_gain) << ",\"registrations_tried\":" << d.registrations_tried
        << ",\"links_accepted\":" << d.links_accepted << ",\"links_refused\":" << d.links_refused
        << ",\"candidates\":[";
    for (std::size_t k = 0; k < d.candidates.size(); ++k) {
      const Candidate& c = d.candidates[k];
      out << (k > 0 ? "," : "") << "{\"id\":" << c.id.value << ",\"probability\":" << JsonNumber(c.probability)
          << ",\"gain_nats\":" << JsonNumber(c.gain) << ",\"measured_gain_nats\":" << JsonNumber(c.measured_gain)
          << ",\"measured\":" << JsonFlag(c.measured) << ",\"tried\":" << JsonFlag(c.tried)
          << ",\"accepted\":" << JsonFlag(c.accepted) << ",\"innovation\":" << JsonNumber(c.innovation)
          << ",\"factor\":" << (c.factor ? std::to_string(c.factor->value) : "null");
      if (c.carried_from) out << ",\"carried_from\":" << c.carried_from->value;
      if (c.anchors) out << ",\"anchors\":true";
      if (c.composed) out << ",\"composed\":true";
      out << '}';
    }
    out << "],\"candidates_found\":" << d.candidates_found << ",\"revived\":[";
    for (std::size_t k = 0; k < d.revived.size(); ++k) out << (k > 0 ? "," : "") << d.revived[k].value;
    out << ']';
    WriteRetired("retired", d.retired, out);
    if (d.anchored_to) out << ",\"anchored_to\":" << d.anchored_to->value;
    if (!d.edges.empty()) WriteEdges(d.edges, out);
    if (&d == &decisions.back()) WriteRetired(kRetiredAtEnd, retired_at_end, out);
    out << "}\n";
  }
  file.Commit();
}

// As covariances.csv has them.
template <class Pose>
void WriteCovarianceArrays(const std::vector<PoseId>& ids, const std::vector<typename Pose::Jacobian>& covariances,
                           const std::string& path) {
  constexpr std::size_t kDof = Pose::kDof;
  std::vector<std::int64_t> numbers;
  numbers.reserve(ids.size());
  for (const PoseId id : ids) numbers.push_back(id.value);
  std::vector<double> entries;
  entries.reserve(covariances.size() * kDof * kDof);
  for (const auto& covariance : covariances) {
    for (int r = 0; r < Pose::kDof; ++r) {
      for (int c = 0; c < Pose::kDof; ++c) entries.push_back(covariance(r, c));
    }
  }
  WriteNpz({MakeNpzArray("ids", numbers), MakeNpzArray("covariances", {ids.size(), kDof, kDof}, entries)}, path);
}

// Which information the graph carries, for the first line of its file; "" if it is that of the input.
std::string InformationComment(const InformationScale& scale) {
  if (scale.IsOne()) return "";
  const auto kind = [](const KindScale& s) {
    return Shortest(s.translation) + " (translation) and " + Shortest(s.rotation) + " (rotation)";
  };
  return "information calibrated by terse: the input's standard deviations times " + kind(scale.odometry) +
         " of odometry, " + kind(scale.loops) + " of loops";
}

}  // namespace

RunRows ReadRunRows(const std::string& folder, std::size_t poses) {
  return {Rows(folder + "/decisions.csv", 1, poses), Rows(folder + "/decisions.jsonl", 0, poses),
          Rows(folder + "/steps.csv", 1, poses)};
}

void WriteDecisions(const std::vector<Decision>& decisions, const std::string& path, const std::string& earlier) {
  AtomicFile file(path);
  std::ostream& out = file.Stream();
  out << "pose,kept,verdict,pose_gain_nats,registrations_tried,links_accepted,"
         "candidates,probabilities,gains_nats,measured_gains_nats,accepted,innovations,links_refused,factors\n"
      << earlier;
  for (const Decision& d : decisions) {
    out << d.id.value << ',' << (d.Kept() ? 1 : 0) << ',' << Name(d.verdict) << ','
        << (d.pose_gain ? Shortest(*d.pose_gain) : "") << ',' << d.registrations_tried << ',' << d.links_accepted;
    const auto list = [&](auto&& text) {
      out << ',';
      for (std::size_t k = 0; k < d.candidates.size(); ++k) out << (k > 0 ? " " : "") << text(d.candidates[k]);
    };
    list([](const Candidate& c) { return std::to_string(c.id.value); });
    list([](const Candidate& c) { return Shortest(c.probability); });
    list([](const Candidate& c) { return Shortest(c.gain); });
    list([](const Candidate& c) { return c.measured_gain ? Shortest(*c.measured_gain) : std::string("-"); });
    list([](const Candidate& c) { return std::string(c.accepted ? "1" : "0"); });
    list([](const Candidate& c) { return c.innovation ? Shortest(*c.innovation) : std::string("-"); });
    out << ',' << d.links_refused;
    list([](const Candidate& c) { return c.factor ? std::to_string(c.factor->value) : std::string("-"); });
    out << '\n';
  }
  file.Commit();
}

template <class Pose>
void WriteMapAndTrajectory(const CompactPoseSlam<Pose>& slam, const BatchResult<Pose>& result, Recovery recovery,
                           RotationInformation rotation_information, const std::string& folder) {
  WriteG2o(MapGraph(slam, result.T_world_body), folder + "/compact.g2o", rotation_information);
  WriteTum(MakeRunTrajectories(slam, recovery, nullptr).estimate, folder + "/trajectory.tum");
}

template <class Pose>
RunTrajectories MakeRunTrajectories(const CompactPoseSlam<Pose>& slam, Recovery recovery, const TruePoses* truth) {
  std::vector<PoseId> ids;
  std::vector<Pose> estimates;
  std::vector<SE3> true_poses;
  for (const auto& pose : slam.Trajectory(recovery)) {
    ids.push_back(pose.id);
    estimates.push_back(pose.T_world_body);
    if (truth != nullptr) true_poses.push_back(truth->at(pose.id.value));
  }
  RunTrajectories out{MakeTrajectory(ids, estimates), std::nullopt};
  if (truth != nullptr) out.truth = MakeTrajectory(ids, true_poses);
  return out;
}

template <class Pose>
double WriteRun(const RunResults<Pose>& run, const std::string& folder) {
  // Of an earlier run into the same folder: stats.json, the last file of a run, must not stand for what is half
  // written, nor its true poses for those of this one.
  for (const char* name : {"/stats.json", "/ground_truth.tum"}) {
    std::error_code ignored;
    std::filesystem::remove(folder + name, ignored);
  }
  const CompactOptions<Pose>& options = run.slam.Options();
  WriteThresholds(options.thresholds, folder + "/thresholds.json");
  const PoseGraph<Pose> kept = MapGraph(run.slam, run.result.T_world_body);
  WriteG2o(kept, folder + "/compact.g2o", run.rotation_information, InformationComment(run.information_scale));
  WriteCompactMap(run.slam.Export(run.recovery), options.strategy, folder + "/graph.json", run.information_scale);
  WriteTum(run.trajectories.estimate, folder + "/trajectory.tum");
  if (run.trajectories.truth) WriteTum(*run.trajectories.truth, folder + "/ground_truth.tum");
  WriteDecisions(run.decisions, folder + "/decisions.csv", run.earlier.decisions_csv);
  WriteDecisionLines(run.decisions, run.retired_at_end, run.earlier.decisions_jsonl, folder + "/decisions.jsonl");
  WriteCompactSteps(run.steps, run.earlier.steps_csv, folder + "/steps.csv");
  std::vector<PoseId> ids;
  for (const auto& node : kept.Poses()) ids.push_back(node.id);
  using Clock = std::chrono::steady_clock;
  const Clock::time_point before = Clock::now();
  // Finish left the solver at the optimum, with the weights of its loops.
  const auto covariances = IncrementalMarginals<Pose>(run.slam.Solver()).AllMarginals();
  const double seconds = std::chrono::duration<double>(Clock::now() - before).count();
  WriteCovariances<Pose>(ids, covariances, folder + "/covariances.csv");
  WriteCovarianceArrays<Pose>(ids, covariances, folder + "/covariances.npz");
  return seconds;
}

#define TERSE_INSTANTIATE(Pose)                                                                                 \
  template void WriteMapAndTrajectory<Pose>(const CompactPoseSlam<Pose>&, const BatchResult<Pose>&, Recovery,   \
                                            RotationInformation, const std::string&);                           \
  template RunTrajectories MakeRunTrajectories<Pose>(const CompactPoseSlam<Pose>&, Recovery, const TruePoses*); \
  template double WriteRun<Pose>(const RunResults<Pose>&, const std::string&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
