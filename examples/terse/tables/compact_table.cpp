#include "tables/compact_table.h"

#include <algorithm>

#include "pictures/run_report.h"
#include "run/compact_run.h"
#include "run/compact_stats.h"
#include "run/progress.h"
#include "run/run_statistics.h"
#include "terse/compact/json_file.h"
#include "terse/compact/random_choice.h"
#include "terse/compact/run_steps.h"
#include "terse/compact/run_writer.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/writable.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse {
namespace {

template <class Pose>
class TableRun {
 public:
  TableRun(const NamedGraph<Pose>& named, const CompactTableOptions& options)
      : named_(named), options_(options), is_giant_(named.graph.Poses().size() > options.most_poses) {
    settings_.strategy = Strategy::kFpfl;  // the paper's, whose thresholds all but bounded have
  }

  CompactTableRow Run() {
    const GraphReplay<Pose> replay(named_.graph);
    row_.graph = named_.is.name;
    row_.paper = named_.is.paper;
    row_.poses = static_cast<int>(named_.graph.Poses().size());
    row_.links = replay.LinksOffered();
    reference_ = named_.reference;
    row_.reference = reference_.kind;
    if (reference_.kind == ReferenceKind::kOptimum || is_giant_) SolveAll();
    FindTruth();
    ChooseThresholds();
    RunFpfl();
    is_giant_ ? TakeOptimumAsApal() : RunApal();
    if (options_.apfl) row_.apfl = RunStrategy(Strategy::kApfl).first;
    row_.rfpfl = RunRandom(row_.fpfl);
    row_.bounded = RunStrategy(Strategy::kBounded).first;
    row_.random = RunRandom(row_.bounded);
    if (options_.norms) {
      row_.norms = ComputeNorms(named_.graph, settings_, row_.graph + " norms", options_.quiet);
    }
    return std::move(row_);
  }

 private:
  using Trajectory = std::vector<RecoveredPose<Pose>>;

  void SolveAll() {
    Progress progress(row_.graph + " optimum", 0, options_.quiet);
    progress.Update(0);
    optimum_ = BatchOptimum(named_.graph).T_world_body;
    if (reference_.kind == ReferenceKind::kOptimum) reference_.T_world_body = optimum_;
  }

  TrajectoryErrors Errors(const Trajectory& trajectory) const {
    return ComputeErrors(named_.graph, reference_, trajectory, options_.most_poses);
  }

  // For the folders, where it is known.
  void FindTruth() {
    if (options_.folder.empty() || named_.reference.kind == ReferenceKind::kOptimum) return;
    truth_.emplace();
    for (std::size_t k = 0; k < reference_.T_world_body.size(); ++k) {
      (*truth_)[named_.graph.Poses()[k].id.value] = InSpace(reference_.T_world_body[k]);
    }
  }

  void ChooseThresholds() {
    CompactOptions<Pose> bounded = settings_;
    bounded.strategy = Strategy::kBounded;
    SampleWithProgress(named_.graph, options_.sample, row_.graph + " sample", options_.quiet, bounded);
    bounded_thresholds_ = bounded.thresholds;
    const double between = SecondsNow();
    SampleWithProgress(named_.graph, options_.sample, row_.graph + " sample", options_.quiet, settings_);
    const auto& [range, probability, min_loop_gain, min_pose_gain, link_covariance] = settings_.thresholds;
    row_.thresholds = {
        {range.data(), range.data() + range.size()}, probability, min_loop_gain, min_pose_gain, SecondsNow() - between};
  }

  // With the covariances of every step, or (APFL, FPFL, random) those that it asks for itself.
  std::pair<StrategyResult, CompactRun<Pose>> RunStrategy(Strategy strategy, const StrategyResult* size = nullptr,
                                                          std::uint64_t seed = 0) {
    GraphReplay<Pose> replay(named_.graph);
    if (size != nullptr) DrawAtRandom(replay, size->poses, std::min(size->links, row_.links), seed);
    CompactOptions<Pose> settings = settings_;
    settings.strategy = strategy;
    if (strategy == Strategy::kBounded) settings.thresholds = bounded_thresholds_;
    StrategyResult result;
    std::unique_ptr<IncrementalMarginals<Pose>> marginals;
    StepRecorder<Pose> recorder(row_.poses, truth_ ? &*truth_ : nullptr);
    double solving = 0, covariances = 0;
    const auto after_step = [&](const CompactPoseSlam<Pose>& slam, const Decision& decision, double seconds) {
      solving += seconds;
      if (strategy == Strategy::kApal) {
        if (!marginals) marginals = std::make_unique<IncrementalMarginals<Pose>>(slam.Solver());
        const double before = SecondsNow();
        marginals->Update();
        covariances += SecondsNow() - before;
      }
      recorder.Add(slam, decision, seconds);
      const CompactStep& now = recorder.Steps().back();
      if (!now.hessian_nonzeros) return;
      result.growth.push_back({static_cast<int>(recorder.Steps().size()), now.poses, now.links, solving + covariances,
                               *now.hessian_nonzeros, *now.factor_nonzeros});
    };
    CompactRun<Pose> run = RunWithProgress<Pose>(CompactPoseSlam<Pose>(settings), replay,
                                                 row_.graph + ' ' + Name(strategy), options_.quiet, after_step);
    result.poses = run.PosesKept();
    result.links = run.LinksKept();
    result.registrations = run.registrations_tried;
    result.seconds_solving = solving;
    if (strategy == Strategy::kApal) result.seconds_covariances = covariances;
    result.errors = Errors(run.slam.Trajectory());
    const bool is_first = size == nullptr || (size == &row_.fpfl && seed == options_.seed);
    if (is_first && !options_.folder.empty()) WriteFolder(run, recorder.Steps());
    return {std::move(result), std::move(run)};
  }

  void WriteFolder(const CompactRun<Pose>& run, const std::vector<CompactStep>& steps) const {
    const std::string folder = options_.folder + '/' + row_.graph + '/' + Name(run.slam.Options().strategy);
    RequireFolder(folder, "decisions.csv");
    const RunTrajectories trajectories = MakeRunTrajectories(run.slam, Recovery::kV2, truth_ ? &*truth_ : nullptr);
    Stats stats = MakeStats(named_.graph, run, EvaluateRun(trajectories, Pose::kDim));
    RunResults<Pose> results{run.slam, run.result, run.decisions, steps, trajectories};
    results.retired_at_end = run.retired;
    stats.seconds_covariance = WriteRun(results, folder);
    stats.seconds_total = run.Seconds() + stats.seconds_covariance;
    WriteJson(ToJson(stats), folder + "/stats.json");
    WriteReport({folder}, folder + "/report.html");
  }

  void RunFpfl() {
    auto [result, run] = RunStrategy(Strategy::kFpfl);
    row_.fpfl = std::move(result);
    row_.recovery["v0"] = Errors(run.slam.Trajectory(Recovery::kV0));
    row_.recovery["v1"] = Errors(run.slam.Trajectory(Recovery::kV1));
    row_.recovery["v2"] = *row_.fpfl.errors;
  }

  void RunApal() { row_.apal = RunStrategy(Strategy::kApal).first; }

  void TakeOptimumAsApal() {
    row_.apal.poses = row_.poses;
    row_.apal.links = row_.links;
    if (reference_.kind == ReferenceKind::kOptimum) return;
    Trajectory all;
    for (std::size_t k = 0; k < optimum_.size(); ++k) {
      all.push_back({named_.graph.Poses()[k].id, true, optimum_[k]});
    }
    row_.apal.errors = Errors(all);
  }

  // Maps of that size, drawn at random; the mean of the errors.
  std::optional<StrategyResult> RunRandom(const StrategyResult& size) {
    if (options_.random_runs < 1) return std::nullopt;
    StrategyResult last;
    TrajectoryErrors mean;
    const double share = 1.0 / options_.random_runs;
    for (int k = 0; k < options_.random_runs; ++k) {
      const std::uint64_t seed = options_.seed + static_cast<std::uint64_t>(k);
      StrategyResult result = RunStrategy(Strategy::kGiven, &size, seed).first;
      for (PoseError TrajectoryErrors::*kind :
           {&TrajectoryErrors::ate, &TrajectoryErrors::rpe, &TrajectoryErrors::rpe_all}) {
        (mean.*kind).translation_m += share * ((*result.errors).*kind).translation_m;
        (mean.*kind).rotation_deg += share * ((*result.errors).*kind).rotation_deg;
      }
      mean.stride = result.errors->stride;
      last = std::move(result);
    }
    last.errors = mean;
    last.growth.clear();
    return last;
  }

  const NamedGraph<Pose>& named_;
  const CompactTableOptions& options_;
  bool is_giant_;
  Reference<Pose> reference_;
  std::vector<Pose> optimum_;
  std::optional<TruePoses> truth_;
  CompactOptions<Pose> settings_;
  Thresholds<Pose> bounded_thresholds_;
  CompactTableRow row_;
};

}  // namespace

std::optional<double> StrategyResult::Seconds() const {
  if (!seconds_solving) return std::nullopt;
  return *seconds_solving + seconds_covariances.value_or(0);
}

std::optional<double> CompactTableRow::AteRatio(const StrategyResult& of) const {
  if (reference == ReferenceKind::kOptimum || !of.errors || !apal.errors) return std::nullopt;
  return of.errors->ate.translation_m / apal.errors->ate.translation_m;
}

std::optional<double> CompactTableRow::TimeRatio() const {
  if (!apal.Seconds() || !fpfl.Seconds()) return std::nullopt;
  return *apal.Seconds() / *fpfl.Seconds();
}

template <class Pose>
CompactTableRow RunCompactTable(const NamedGraph<Pose>& named, const CompactTableOptions& options) {
  return TableRun<Pose>(named, options).Run();
}

template CompactTableRow RunCompactTable<SE2>(const NamedGraph<SE2>&, const CompactTableOptions&);
template CompactTableRow RunCompactTable<SE3>(const NamedGraph<SE3>&, const CompactTableOptions&);

}  // namespace terse
