#include "run/run_statistics.h"

#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <set>

#include "terse/core/linear_factor.h"
#include "terse/core/number_text.h"
#include "terse/core/replay.h"
#include "terse/core/words.h"

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

bool EndsWith(const std::string& text, const std::string& ending) {
  return text.size() >= ending.size() && text.compare(text.size() - ending.size(), ending.size(), ending) == 0;
}

}  // namespace

double PeakRssMegabytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
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

void WriteStepsHeader(std::ostream& out) {
  out << "step,poses,factors,factor_ids,path,fronts_updated,fronts_refactored,variables_refactored,gate_open,gate_"
         "value,"
         "iterations,variables_relinearised,variables_moved,predicted_decrease,actual_decrease,gain_nats,"
         "deferred_relinearisations,deferred_fronts,flops,solve_flops,paper_update_flops,paper_solve_flops,seconds\n";
}

void WriteStepsRow(const ReplayStep& step, std::size_t poses, std::size_t factors, const ModelFlops& model,
                   std::ostream& out) {
  const StepReport& r = step.report;
  out << step.index + 1 << ',' << poses << ',' << factors << ',';
  for (std::size_t k = 0; k < r.factor_ids.size(); ++k) out << (k > 0 ? " " : "") << r.factor_ids[k].value;
  out << ',' << WordOf(r.path) << ',' << r.fronts_updated << ',' << r.fronts_refactored << ',' << r.variables_refactored
      << ',' << (r.gate_open ? 1 : 0) << ',' << Shortest(r.gate_value) << ',' << r.iterations << ','
      << r.variables_relinearised << ',' << r.variables_moved << ',' << Shortest(r.predicted_decrease) << ','
      << Shortest(r.actual_decrease) << ',' << Shortest(r.gain_nats) << ',' << r.deferred_relinearisations << ','
      << r.deferred_fronts << ',' << Shortest(r.flops) << ',' << Shortest(r.solve_flops) << ','
      << Shortest(model.update) << ',' << Shortest(model.solve) << ',' << Shortest(r.seconds) << '\n';
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

template EdgeCounts CountEdges<SE2>(const PoseGraph<SE2>&);
template EdgeCounts CountEdges<SE3>(const PoseGraph<SE3>&);

}  // namespace terse
