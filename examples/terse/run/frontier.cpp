#include "run/frontier.h"

#include <algorithm>
#include <cmath>

#include "run/compact_run.h"
#include "run/progress.h"
#include "terse/compact/random_choice.h"
#include "terse/compact/thresholds_file.h"

namespace terse {
namespace {

template <class Pose>
class FrontierRun {
 public:
  FrontierRun(const PoseGraph<Pose>& graph, const FrontierOptions& options) : graph_(graph), options_(options) {}

  Frontier Run() {
    out_.poses = static_cast<int>(graph_.Poses().size());
    out_.links = GraphReplay<Pose>(graph_).LinksOffered();
    FindReference();
    for (const Strategy strategy : {Strategy::kFpfl, Strategy::kBounded}) {
      FrontierCurve informed{Name(strategy), false, {}},
          random{std::string("random, size of ") + Name(strategy), true, {}};
      const CompactOptions<Pose> settings = Settings(strategy);
      for (int k = 0; k < options_.steps; ++k) {
        informed.points.push_back(RunAt(settings, ScaleAt(k)));
        if (options_.random_runs > 0) random.points.push_back(RunRandom(settings, informed.points.back()));
      }
      out_.curves.push_back(std::move(informed));
      if (options_.random_runs > 0) out_.curves.push_back(std::move(random));
    }
    return std::move(out_);
  }

 private:
  void FindReference() {
    Progress progress("optimum", 0, options_.quiet);
    progress.Update(0);
    const std::vector<Pose> optimum = BatchOptimum(graph_).T_world_body;
    reference_.T_world_body = optimum;
    if (options_.ground_truth.empty()) return;
    reference_ = {ReferenceKind::kFile, ReadTruth(graph_, options_.ground_truth)};
    out_.reference = ReferenceKind::kFile;
    std::vector<RecoveredPose<Pose>> all;
    for (std::size_t k = 0; k < optimum.size(); ++k) all.push_back({graph_.Poses()[k].id, true, optimum[k]});
    out_.ate_of_all_m = ComputeErrors(graph_, reference_, all).ate.translation_m;
  }

  CompactOptions<Pose> Settings(Strategy strategy) const {
    CompactOptions<Pose> settings;
    settings.strategy = strategy;
    settings.log = options_.log;
    if (options_.thresholds.empty()) {
      SampleWithProgress(graph_, options_.sample, std::string("sample ") + Name(strategy), options_.quiet, settings);
    } else {
      settings.thresholds = ReadThresholds<Pose>(options_.thresholds);
    }
    return settings;
  }

  double ScaleAt(int k) const {
    const double share = options_.steps > 1 ? static_cast<double>(k) / (options_.steps - 1) : 0;
    return options_.from * std::pow(options_.to / options_.from, share);
  }

  FrontierPoint PointOf(const CompactRun<Pose>& run) const {
    FrontierPoint point;
    point.poses = run.PosesKept();
    point.links = run.LinksKept();
    point.registrations = run.registrations_tried;
    point.seconds = run.Seconds();
    point.ate = ComputeErrors(graph_, reference_, run.slam.Trajectory()).ate;
    point.least_ate_m = point.most_ate_m = point.ate.translation_m;
    return point;
  }

  FrontierPoint RunAt(CompactOptions<Pose> settings, double scale) const {
    settings.thresholds.min_loop_gain *= scale;
    settings.thresholds.min_pose_gain *= scale;
    const GraphReplay<Pose> replay(graph_);
    const std::string label = std::string(Name(settings.strategy)) + " x " + std::to_string(scale);
    FrontierPoint point = PointOf(RunWithProgress(CompactPoseSlam<Pose>(settings), replay, label, options_.quiet));
    point.scale = scale;
    point.min_loop_gain = settings.thresholds.min_loop_gain;
    point.min_pose_gain = settings.thresholds.min_pose_gain;
    return point;
  }

  FrontierPoint RunRandom(CompactOptions<Pose> settings, const FrontierPoint& size) const {
    settings.strategy = Strategy::kGiven;
    FrontierPoint mean = size;
    mean.poses = mean.links = mean.registrations = 0;
    mean.seconds = mean.most_ate_m = 0;
    mean.ate = {};
    long poses = 0, links = 0, registrations = 0;
    for (int k = 0; k < options_.random_runs; ++k) {
      GraphReplay<Pose> replay(graph_);
      DrawAtRandom(replay, size.poses, std::min(size.links, out_.links), options_.seed + static_cast<std::uint64_t>(k));
      const FrontierPoint point =
          PointOf(RunWithProgress(CompactPoseSlam<Pose>(settings), replay, "random", options_.quiet));
      poses += point.poses;
      links += point.links;
      registrations += point.registrations;
      mean.seconds += point.seconds / options_.random_runs;
      mean.ate.translation_m += point.ate.translation_m / options_.random_runs;
      mean.ate.rotation_deg += point.ate.rotation_deg / options_.random_runs;
      mean.least_ate_m = k == 0 ? point.ate.translation_m : std::min(mean.least_ate_m, point.ate.translation_m);
      mean.most_ate_m = std::max(mean.most_ate_m, point.ate.translation_m);
    }
    const auto rounded = [&](long sum) {
      return static_cast<int>(std::lround(static_cast<double>(sum) / options_.random_runs));
    };
    mean.poses = rounded(poses);
    mean.links = rounded(links);
    mean.registrations = rounded(registrations);
    return mean;
  }

  const PoseGraph<Pose>& graph_;
  const FrontierOptions& options_;
  Reference<Pose> reference_;
  Frontier out_;
};

}  // namespace

template <class Pose>
Frontier RunFrontier(const PoseGraph<Pose>& graph, const FrontierOptions& options) {
  return FrontierRun<Pose>(graph, options).Run();
}

template Frontier RunFrontier<SE2>(const PoseGraph<SE2>&, const FrontierOptions&);
template Frontier RunFrontier<SE3>(const PoseGraph<SE3>&, const FrontierOptions&);

}  // namespace terse
