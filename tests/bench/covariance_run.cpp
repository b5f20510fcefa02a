#include <algorithm>
#include <chrono>
#include <map>
#include <string>

#include "bench_runs.h"
#include "covariance_oracle.h"
#include "terse/core/replay.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse::bench {
namespace {

using Clock = std::chrono::steady_clock;

template <class Work>
double Seconds(const Work& work) {
  const auto start = Clock::now();
  work();
  return std::chrono::duration<double>(Clock::now() - start).count();
}

// Brings the kept blocks up to date and looks at all of them and at the newest column.
template <class Pose>
class Keeper {
 public:
  Keeper(const IncrementalSolver<Pose>& solver, CovarianceOptions::Method method)
      : marginals_(solver, WithMethod(method)) {}

  void Step() {
    CovarianceReport report;
    seconds += Seconds([&] {
      report = marginals_.Update();
      checksum += marginals_.KeptMarginals().front()(0, 0) + marginals_.NewestColumn().front()(0, 0);
    });
    ++steps[Name(report.path)];
    refreshed += report.refreshed;
    drift = std::max(drift, report.drift);
    measured_drift = std::max(measured_drift, report.measured_drift);
  }
  const IncrementalMarginals<Pose>& Marginals() const { return marginals_; }

  double seconds = 0, checksum = 0, drift = 0, measured_drift = 0;
  int refreshed = 0;
  std::map<std::string, int> steps;  // by path

 private:
  static CovarianceOptions WithMethod(CovarianceOptions::Method method) {
    CovarianceOptions options;
    options.method = method;
    return options;
  }
  IncrementalMarginals<Pose> marginals_;
};

// The `count` poses nearest to the newest one, as estimated.
template <class Pose>
std::vector<PoseId> Nearest(const IncrementalSolver<Pose>& solver, int count) {
  const std::vector<Pose> estimates = solver.Estimates();
  std::vector<std::pair<double, std::size_t>> by_distance;
  for (std::size_t i = 0; i + 1 < estimates.size(); ++i) {
    by_distance.emplace_back((estimates[i].Translation() - estimates.back().Translation()).norm(), i);
  }
  const std::size_t many = std::min(by_distance.size(), static_cast<std::size_t>(count));
  std::partial_sort(by_distance.begin(), by_distance.begin() + static_cast<std::ptrdiff_t>(many), by_distance.end());
  std::vector<PoseId> ids;
  for (std::size_t k = 0; k < many; ++k) ids.push_back(solver.Graph().Poses()[by_distance[k].second].id);
  return ids;
}

}  // namespace

template <class Pose>
nlohmann::json RunCovarianceKept(const PoseGraph<Pose>& graph, int interval) {
  IncrementalSolver<Pose> solver;
  Keeper<Pose> kept(solver, CovarianceOptions::Method::kCheapest);
  Keeper<Pose> recursion(solver, CovarianceOptions::Method::kRecursion);
  double solve_seconds = 0;
  testing::InverseErrors errors;
  int samples = 0, steps = 0;
  Replay<Pose>(graph, {}, solver, [&](const ReplayStep& step) {
    solve_seconds += step.report.seconds;
    kept.Step();
    ++steps;
    if ((step.index + 1) % interval != 0 && step.index + 1 != step.steps) return true;
    recursion.Step();
    errors.Widen(testing::CompareWithCholmod(solver, kept.Marginals(), 20));
    ++samples;
    return true;
  });
  return {{"solve_seconds", solve_seconds},
          {"seconds", kept.seconds},
          {"recursion_seconds", recursion.seconds * steps / std::max(1, samples)},
          {"steps", kept.steps},
          {"refreshed", kept.refreshed},
          {"drift", kept.drift},
          {"measured_drift", kept.measured_drift},
          {"error", errors.kept},
          {"cholmod_error", errors.cholmod},
          {"interval", interval},
          {"checksum", kept.checksum + recursion.checksum}};
}

template <class Pose>
nlohmann::json RunCovarianceNewest(const PoseGraph<Pose>& graph, int candidates) {
  IncrementalSolver<Pose> solver;
  const IncrementalMarginals<Pose> marginals(solver);
  double solve_seconds = 0, total = 0, checksum = 0;
  std::vector<double> seconds;
  Replay<Pose>(graph, {}, solver, [&](const ReplayStep& step) {
    solve_seconds += step.report.seconds;
    std::vector<PoseId> ids = Nearest(solver, candidates);
    // The newest pose's own block comes with its column.
    ids.push_back(solver.Graph().Poses().back().id);
    seconds.push_back(Seconds([&] {
      for (const auto& block : marginals.Column(ids.back(), ids)) checksum += block(0, 0);
    }));
    total += seconds.back();
    return true;
  });
  std::sort(seconds.begin(), seconds.end());
  return {{"candidates", candidates},
          {"solve_seconds", solve_seconds},
          {"seconds", total},
          {"median_ms", 1e3 * seconds[seconds.size() / 2]},
          {"worst_ms", 1e3 * seconds.back()},
          {"checksum", checksum}};
}

template nlohmann::json RunCovarianceKept<SE2>(const PoseGraph<SE2>&, int);
template nlohmann::json RunCovarianceKept<SE3>(const PoseGraph<SE3>&, int);
template nlohmann::json RunCovarianceNewest<SE2>(const PoseGraph<SE2>&, int);
template nlohmann::json RunCovarianceNewest<SE3>(const PoseGraph<SE3>&, int);

}  // namespace terse::bench
