#include "run/run_statistics.h"

#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <numeric>
#include <set>
#include <stdexcept>

#include "commands/commands.h"
#include "terse/core/atomic_file.h"
#include "terse/core/linear_factor.h"
#include "terse/core/number_text.h"

namespace terse {
namespace {

// The smallest element that at least `share` of all do not exceed.
double Percentile(std::vector<double> values, double share) {
  if (values.empty()) return 0;
  const double last = std::ceil(share * static_cast<double>(values.size())) - 1;
  const auto nth = values.begin() + static_cast<long>(std::max(0.0, last));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

double PeakRssMegabytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

bool EndsWith(const std::string& text, const std::string& ending) {
  return text.size() >= ending.size() && text.compare(text.size() - ending.size(), ending.size(), ending) == 0;
}

}  // namespace

void RequireWritable(const std::string& path) {
  namespace fs = std::filesystem;
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  // Merely opening a pipe would already be seen at its other end.
  if (path.empty() || (fs::exists(status) && !fs::is_regular_file(status) && !fs::is_directory(status))) return;
  AtomicFile file(path);  // removed again
}

double SecondsNow() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

template <class Pose>
EdgeCounts CountEdges(const PoseGraph<Pose>& graph) {
  std::vector<PoseId> ids;
  for (const auto& node : graph.Poses()) ids.push_back(node.id);
  std::sort(ids.begin(), ids.end());
  const auto rank = [&](PoseId id) { return std::lower_bound(ids.begin(), ids.end(), id) - ids.begin(); };
  EdgeCounts counts;
  std::set<std::pair<long, long>> joined;
  for (const auto& node : graph.Factors()) {
    counts.scalars += Dimension(node.factor);
    const FactorPoses ends = PosesOf(node.factor);
    if (ends.count < 2) continue;
    const auto [low, high] = std::minmax({rank(ends.first), rank(ends.second)});
    ++counts.edges;
    if (high - low > 1) ++counts.loop_edges;
    if (!joined.insert({low, high}).second) ++counts.duplicates;
  }
  return counts;
}

nlohmann::ordered_json ToJson(const Stats& stats) {
  nlohmann::ordered_json json;
  json["poses"] = stats.poses;
  json["edges"] = stats.counts.edges;
  json["loop_edges"] = stats.counts.loop_edges;
  json["chi2"] = stats.chi2;
  json["normalized_chi2"] = stats.normalized_chi2;
  json["iterations"] = stats.iterations;
  json["converged"] = stats.converged;
  json["termination"] = stats.termination;
  json["log_determinant"] = stats.log_determinant;
  json["steps"] = stats.step_seconds.size();
  if (!stats.more.is_null()) json.update(stats.more);
  json["seconds"] = {{"total", stats.seconds_total},          {"read", stats.seconds_read},
                     {"order", stats.phases.order},           {"linearise", stats.phases.linearise},
                     {"factor", stats.phases.factor},         {"solve", stats.phases.solve},
                     {"covariance", stats.seconds_covariance}};
  const auto& steps = stats.step_seconds;
  json["step_seconds"] = {{"median", Percentile(steps, 0.5)},
                          {"p95", Percentile(steps, 0.95)},
                          {"p99", Percentile(steps, 0.99)},
                          {"max", Percentile(steps, 1)}};
  json["peak_rss_mb"] = PeakRssMegabytes();
  json["threads"] = stats.threads;
  json["version"] = TERSE_VERSION;
  return json;
}

void WriteJson(const nlohmann::ordered_json& json, const std::string& path) {
  AtomicFile file(path);
  file.Stream() << json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) << '\n';
  file.Commit();
}

namespace {

const char* Name(FactorPath path) {
  switch (path) {
    case FactorPath::kNone: return "none";
    case FactorPath::kAppended: return "appended";
    case FactorPath::kRankUpdate: return "rank_update";
    case FactorPath::kRefactored: return "refactored";
  }
  return "";
}

}  // namespace

void WriteStepsHeader(std::ostream& out) {
  out << "step,poses,factors,factor_ids,path,fronts_updated,fronts_refactored,variables_refactored,gate_open,gate_"
         "value,"
         "iterations,variables_relinearised,variables_moved,predicted_decrease,actual_decrease,gain_nats,"
         "deferred_relinearisations,deferred_fronts,flops,solve_flops,paper_update_flops,paper_solve_flops,seconds\n";
}

void WriteStepsRow(const ReplayStep& step, std::size_t poses, std::size_t factors, std::ostream& out) {
  const StepReport& r = step.report;
  out << step.index + 1 << ',' << poses << ',' << factors << ',';
  for (std::size_t k = 0; k < r.factor_ids.size(); ++k) out << (k > 0 ? " " : "") << r.factor_ids[k].value;
  out << ',' << Name(r.path) << ',' << r.fronts_updated << ',' << r.fronts_refactored << ',' << r.variables_refactored
      << ',' << (r.gate_open ? 1 : 0) << ',' << Shortest(r.gate_value) << ',' << r.iterations << ','
      << r.variables_relinearised << ',' << r.variables_moved << ',' << Shortest(r.predicted_decrease) << ','
      << Shortest(r.actual_decrease) << ',' << Shortest(r.gain_nats) << ',' << r.deferred_relinearisations << ','
      << r.deferred_fronts << ',' << Shortest(r.flops) << ',' << Shortest(r.solve_flops) << ','
      << Shortest(r.paper_update_flops) << ',' << Shortest(r.paper_solve_flops) << ',' << Shortest(r.seconds) << '\n';
}

void RequireStampId(PoseId id) {
  constexpr std::int64_t kMost = std::int64_t{1} << 53;
  if (id.value >= -kMost && id.value <= kMost) return;  // -2^63 has no absolute value
  throw std::invalid_argument("pose " + std::to_string(id.value) +
                              ": ids beyond 2^53 do not fit into the stamps of a trajectory");
}

template <class Pose>
Trajectory MakeTrajectory(const std::vector<PoseId>& ids, const std::vector<Pose>& T_world_body) {
  std::vector<std::size_t> order(ids.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return ids[a] < ids[b]; });
  Trajectory trajectory;
  for (const std::size_t k : order) {
    RequireStampId(ids[k]);
    trajectory.stamps.push_back(static_cast<double>(ids[k].value));
    if constexpr (Pose::kDim == 2) {
      trajectory.T_world_body.push_back(Lift(T_world_body[k]));
    } else {
      trajectory.T_world_body.push_back(T_world_body[k]);
    }
  }
  return trajectory;
}

void WriteTrajectory(const Trajectory& trajectory, const std::string& path) {
  const bool kitti = EndsWith(path, ".kitti") || EndsWith(path, ".txt");
  kitti ? WriteKitti(trajectory, path) : WriteTum(trajectory, path);
}

std::string FindTrajectoryPathDefect(const std::string& path) {
  const std::string extension = std::filesystem::path(path).extension().string();
  for (const char* known : {"", ".tum", ".kitti", ".txt"}) {
    if (extension == known) return "";
  }
  return path + ": the extension must be .tum, .kitti or .txt (KITTI)";
}

#define TERSE_INSTANTIATE(Pose)                                 \
  template EdgeCounts CountEdges<Pose>(const PoseGraph<Pose>&); \
  template Trajectory MakeTrajectory<Pose>(const std::vector<PoseId>&, const std::vector<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
