#include <Eigen/Cholesky>
#include <algorithm>
#include <chrono>
#include <cmath>

#include "bench_runs.h"
#include "cholmod_matrix.h"
#include "terse/core/arrival.h"
#include "terse/core/incremental_solver.h"
#include "terse/covariance/marginals.h"

namespace terse::bench {
namespace {

using Clock = std::chrono::steady_clock;
double SecondsSince(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

double Quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

template <class Pose>
GraphUpdate<Pose> UpdateOf(const PoseGraph<Pose>& graph, const ArrivalStep& step) {
  GraphUpdate<Pose> update;
  for (const int p : step.poses) update.poses.push_back({graph.Poses()[static_cast<std::size_t>(p)].id});
  for (const int f : step.factors) update.factors.push_back(graph.Factors()[static_cast<std::size_t>(f)].factor);
  return update;
}

// The largest error of a pose in standard deviations of its own, at the optimum.
template <class Pose>
double LargestError(const IncrementalSolver<Pose>& solver, BatchResult<Pose> optimum) {
  const std::vector<Pose> best = optimum.T_world_body, estimates = solver.Estimates();
  const auto covariances = Marginals<Pose>(solver.Graph(), std::move(optimum)).AllMarginals();
  double largest = 0;
  for (std::size_t i = 0; i < best.size(); ++i) {
    const typename Pose::Tangent d = best[i].Local(estimates[i]);
    largest = std::max(largest, d.dot(covariances[i].ldlt().solve(d)));
  }
  return std::sqrt(largest);
}

// What is looked at every so many steps.
template <class Pose>
struct Samples {
  double gap_sum = 0, worst_gap = 0, final_gap = 0, chi2 = 0, cholmod_seconds = 0, cholmod_last = 0;
  double error_sum = 0, worst_error = 0;
  nlohmann::json gaps = nlohmann::json::array();  // [poses, gap]

  void Gap(const IncrementalSolver<Pose>& solver) {
    BatchOptions options;
    options.relative_tolerance = 1e-9;
    auto optimum = SolveBatch(solver.Graph(), solver.Estimates(), options);
    chi2 = solver.Chi2();
    // Before the first loop the optimum is 0 but for rounding, and a ratio says nothing.
    if (optimum.chi2 < 1e-9 * static_cast<double>(solver.Graph().Poses().size())) return;
    final_gap = chi2 / optimum.chi2 - 1;
    worst_gap = std::max(worst_gap, final_gap);
    gap_sum += final_gap;
    gaps.push_back({solver.Graph().Poses().size(), final_gap});
    const double error = LargestError(solver, std::move(optimum));
    error_sum += error;
    worst_error = std::max(worst_error, error);
  }
  void Cholmod(const IncrementalSolver<Pose>& solver) {
    CholmodMatrix<Pose> matrix(solver.Graph(), solver.LinearizationPoints());
    const auto start = Clock::now();
    matrix.Analyze();
    matrix.Factorize();
    matrix.Solve();
    cholmod_last = SecondsSince(start);
    cholmod_seconds += cholmod_last;
  }
};

struct StepTimes {
  std::vector<double> seconds;
  double total = 0;
  void Add(double s) {
    seconds.push_back(s);
    total += s;
  }
  void Write(nlohmann::json& json) const {
    json["total_seconds"] = total;
    json["median_ms"] = 1e3 * Quantile(seconds, 0.5);
    json["p99_ms"] = 1e3 * Quantile(seconds, 0.99);
    json["worst_ms"] = 1e3 * Quantile(seconds, 1);
  }
};

}  // namespace

template <class Pose>
nlohmann::json RunIncremental(const PoseGraph<Pose>& graph, int interval) {
  const std::vector<ArrivalStep> steps = ArrivalSteps(graph, ArrivalUnit::kPose);
  IncrementalSolver<Pose> solver;
  StepTimes times;
  Samples<Pose> samples;
  double flops = 0, solve_flops = 0, sampled_steps = 0, estimate_seconds = 0, checksum = 0;
  for (std::size_t k = 0; k < steps.size(); ++k) {
    const GraphUpdate<Pose> update = UpdateOf(graph, steps[k]);
    const auto start = Clock::now();
    const StepReport report = solver.Update(update);
    const double update_seconds = SecondsSince(start);
    const std::vector<Pose> estimates = solver.Estimates();
    times.Add(SecondsSince(start));
    estimate_seconds += times.seconds.back() - update_seconds;
    checksum += estimates.back().Translation()[0];  // the estimate is really made
    flops += report.flops;
    solve_flops += report.solve_flops;
    if ((k + 1) % static_cast<std::size_t>(interval) != 0 && k + 1 != steps.size()) continue;
    samples.Gap(solver);
    samples.Cholmod(solver);
    ++sampled_steps;
  }
  const PhaseSeconds& phases = solver.Seconds();
  nlohmann::json json = {
      {"steps", steps.size()},
      {"chi2", samples.chi2},
      {"mean_gap", samples.gaps.empty() ? 0 : samples.gap_sum / static_cast<double>(samples.gaps.size())},
      {"worst_gap", samples.worst_gap},
      {"final_gap", samples.final_gap},
      {"mean_error", samples.gaps.empty() ? 0 : samples.error_sum / static_cast<double>(samples.gaps.size())},
      {"worst_error", samples.worst_error},
      {"gaps", samples.gaps},
      {"interval", interval},
      {"factor_flops", flops},
      {"solve_flops", solve_flops},
      {"gflops_per_second", phases.factor > 0 ? 1e-9 * flops / phases.factor : 0},
      {"checksum", checksum}};
  times.Write(json);
  const double parts = phases.order + phases.linearise + phases.factor + phases.solve;
  json["phases"] = {{"order", phases.order},        {"linearise", phases.linearise},
                    {"factor", phases.factor},      {"solve", phases.solve},
                    {"estimate", estimate_seconds}, {"rest", times.total - estimate_seconds - parts}};
  json["cholmod"] = {{"total_seconds", samples.cholmod_seconds / sampled_steps * static_cast<double>(steps.size())},
                     {"last_ms", 1e3 * samples.cholmod_last}};
  return json;
}

template nlohmann::json RunIncremental<SE2>(const PoseGraph<SE2>&, int);
template nlohmann::json RunIncremental<SE3>(const PoseGraph<SE3>&, int);

}  // namespace terse::bench
