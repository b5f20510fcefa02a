#include "outlier_maps.h"

#include <algorithm>

#include "bench_report.h"
#include "terse/core/initial_values.h"
#include "terse/core/replay.h"

namespace terse::bench {

using std::size_t;

template <class Pose>
MapResult MapRuns<Pose>::Batch(const Contaminated<Pose>& with, RobustKernel kernel) const {
  BatchOptions options;
  options.threads = threads_;
  options.max_iterations = 50;  // good starts take ten
  options.robust = Robust(kernel);
  const auto result = SolveBatch(with.graph, ComputeInitialValues(with.graph, InitialValues::kCompose), options);
  MapResult out;
  if (result.termination == Termination::kNotPositiveDefinite) out.failure = result.message;
  const auto weight = [&](size_t k, FactorId) { return result.weights.empty() ? 1 : result.weights[k]; };
  Take(CountLoops(with.graph, with.wrong, weight), out);
  out.ate = Ate(AsTrajectory(with.graph, result.T_world_body));
  return out;
}

template <class Pose>
std::pair<MapResult, MapResult> MapRuns<Pose>::Incremental(const Contaminated<Pose>& with) const {
  IncrementalOptions options;
  options.threads = threads_;
  options.robust = Robust(RobustKernel::kGnc);
  IncrementalSolver<Pose> solver(options);
  Replay(with.graph, {}, solver);
  std::pair<MapResult, MapResult> out;
  out.first = Present(solver, with);
  BatchOptions finish;
  finish.threads = threads_;
  solver.Finish(finish);
  out.second = Present(solver, with);
  return out;
}

template <class Pose>
MapResult MapRuns<Pose>::Compact(const Contaminated<Pose>& with, const Thresholds<Pose>& thresholds, bool test,
                                 int consensus, bool gnc) const {
  MapResult out;
  CompactOptions<Pose> settings;
  settings.strategy = Strategy::kFpfl;
  settings.thresholds = thresholds;
  settings.innovation_quantile = test ? std::optional<double>(kInnovationQuantile) : std::nullopt;
  settings.consensus = consensus;
  if (gnc) settings.solver.robust = Robust(RobustKernel::kGnc);
  GraphReplay<Pose> replay(with.graph);
  CompactPoseSlam<Pose> slam(settings);
  std::vector<FactorId> wrong;
  try {
    for (const auto& input : replay.Inputs()) {
      const Decision decision = slam.AddPose(input);
      for (const Candidate& c : decision.candidates) {
        if (!c.accepted || with.wrong.count(PairOf(c.carried_from.value_or(c.id), decision.id)) == 0) continue;
        wrong.push_back(*c.factor);
        out.by_consensus += c.supported ? 1 : 0;
      }
    }
    slam.Finish();
    out.links = slam.LinksKept() - static_cast<int>(wrong.size());
    out.wrong = static_cast<int>(
        std::count_if(wrong.begin(), wrong.end(), [&](FactorId id) { return slam.Solver().WeightOf(id) >= 0.5; }));
    out.poses = static_cast<int>(slam.Solver().Graph().Poses().size());
    out.ate = Ate(slam.Trajectory());
  } catch (const std::runtime_error& error) {
    out.failure = error.what();
  }
  return out;
}

template <class Pose>
MapResult MapRuns<Pose>::Present(const IncrementalSolver<Pose>& solver, const Contaminated<Pose>& with) const {
  MapResult out;
  const auto weight = [&](size_t, FactorId id) { return solver.WeightOf(id); };
  Take(CountLoops(solver.Graph(), with.wrong, weight), out);
  out.ate = Ate(AsTrajectory(solver.Graph(), solver.Estimates()));
  return out;
}

std::string MapHeader(const std::vector<double>& percents) {
  std::string header = "| graph | method |", rule = "|---|---|";
  for (const double percent : percents) {
    const std::string name = percent == 0 ? "clean" : Format("%g %%", percent);
    header += " " + name + ": ATE, m |" + (percent == 0 ? "" : " ratio | wrong kept |") + " true kept |";
    rule += percent == 0 ? "---:|---:|" : "---:|---:|---:|---:|";
  }
  return header + "\n" + rule + "\n";
}

std::string MapRow(const std::string& graph, const MethodRow& row) {
  std::string out = "| " + graph + " | " + row.name + " |";
  const double clean = row.results[0].ate;
  for (size_t k = 0; k < row.results.size(); ++k) {
    const MapResult& r = row.results[k];
    if (!r.failure.empty()) {
      out += k == 0 ? " failed | |" : " failed | | | |";
      continue;
    }
    out += " " + Format("%.4g", r.ate) + " |";
    if (k > 0)
      out += " " + (clean > 1e-6 ? Format("%.3g", r.ate / clean) : "") + " | " + std::to_string(r.wrong) +
             (r.by_consensus == 0 ? "" : " (" + std::to_string(r.by_consensus) + " by consensus)") + " |";
    out += " " + std::to_string(r.links) + (r.poses < 0 ? "" : " (" + std::to_string(r.poses) + " poses)") + " |";
  }
  return out + "\n";
}

template class MapRuns<SE2>;
template class MapRuns<SE3>;

}  // namespace terse::bench
