#include "terse/compact/compact_graph.h"

#include <chrono>
#include <numeric>
#include <stdexcept>

#include "terse/compact/contradicted_loops.h"
#include "terse/core/require_optimum.h"

namespace terse {

template <class Pose>
PoseGraph<Pose> CompactRun<Pose>::KeptGraph() const {
  return slam.Solver().Graph().WithPoses(result.T_world_body);
}

template <class Pose>
double CompactRun<Pose>::Seconds() const {
  return std::accumulate(step_seconds.begin(), step_seconds.end(), 0.0);
}

template <class Pose>
std::vector<Decision> AddPoses(CompactPoseSlam<Pose>& slam, const GraphReplay<Pose>& replay,
                               const StepWatch& after_step) {
  using Clock = std::chrono::steady_clock;
  std::vector<Decision> decisions;
  for (const auto& input : replay.Inputs()) {
    const Clock::time_point before = Clock::now();
    decisions.push_back(slam.AddPose(input));
    const double seconds = std::chrono::duration<double>(Clock::now() - before).count();
    if (after_step && !after_step(decisions.back(), seconds)) break;
  }
  return decisions;
}

template <class Pose>
CompactRun<Pose> RunCompact(CompactPoseSlam<Pose> slam, const GraphReplay<Pose>& replay,
                            const AfterStep<Pose>& after_step) {
  CompactRun<Pose> run{std::move(slam), {}, {}, replay.LinksOffered(), 0, 0, {}, {}, {}};
  run.decisions = AddPoses<Pose>(run.slam, replay, [&](const Decision& decision, double seconds) {
    run.step_seconds.push_back(seconds);
    run.links_refused += decision.links_refused;
    run.registrations_tried += decision.registrations_tried;
    if (after_step) after_step(run.slam, decision, seconds);
    return true;
  });
  run.retired = run.slam.Retire();
  run.result = run.slam.Finish();
  RequireOptimum(run.result);
  return run;
}

RobustKernel DefaultKernel(Strategy strategy) {
  return strategy == Strategy::kBounded ? RobustKernel::kGnc : RobustKernel::kNone;
}

template <class Pose>
RobustOptions MapRobust(RobustOptions given, const CompactOptions<Pose>& options) {
  if (given.kernel == RobustKernel::kGnc && given.width == 0 && options.innovation_quantile) {
    given.quantile = *options.innovation_quantile;
  }
  return given;
}

template <class Pose>
CompactOptions<Pose> OptionsFor(const RobustOptions& robust, const InformationCalibration& information,
                                CompactOptions<Pose> options) {
  if (!information.scale.IsOne()) options.innovation_quantile = kInnovationQuantileOfScaled;
  options.solver.robust = MapRobust(robust, options);
  return options;
}

template <class Pose>
PoseGraph<Pose> MapGraph(const CompactPoseSlam<Pose>& slam, const std::vector<Pose>& T_world_body) {
  PoseGraph<Pose> graph = slam.Solver().Graph().WithPoses(T_world_body);
  for (const auto& node : slam.Solver().Graph().Factors()) {
    if (slam.Solver().WeightOf(node.id) == 0) graph.RemoveFactor(node.id);
  }
  return graph;
}

template <class Pose>
CompactRun<Pose> CompactGraph(const PoseGraph<Pose>& graph, const CompactOptions<Pose>& options,
                              const AfterStep<Pose>& after_step) {
  if (options.strategy == Strategy::kGiven) {
    throw std::invalid_argument("rfpfl draws its poses from a replay beforehand: call RunCompact with it");
  }
  GraphReplay<Pose> replay(graph);
  return RunCompact(CompactPoseSlam<Pose>(options), replay, after_step);
}

template <class Pose>
CompactRun<Pose> CompactGraph(const PoseGraph<Pose>& graph, Strategy strategy, const AfterStep<Pose>& after_step) {
  CompactOptions<Pose> options;
  options.strategy = strategy;
  const InformationCalibration information = CalibrateInformation(graph);
  options = OptionsFor({DefaultKernel(strategy)}, information, std::move(options));
  LoopJury<Pose> jury(graph, information, options.solver.robust);
  return CompactGraph(jury, std::move(options), after_step);
}

template <class Pose>
SampledThresholds<Pose> SampleThresholds(const PoseGraph<Pose>& graph, CompactOptions<Pose>& options,
                                         SampleOptions sample) {
  sample.probability = options.thresholds.probability;
  sample.distance = options.distance;
  sample.strategy = options.strategy;
  sample.innovation_quantile = options.innovation_quantile;
  SampledThresholds<Pose> chosen = SelectThresholds(graph, sample);
  options.thresholds = chosen.thresholds;
  return chosen;
}

#define TERSE_INSTANTIATE(Pose)                                                                                        \
  template struct CompactRun<Pose>;                                                                                    \
  template std::vector<Decision> AddPoses<Pose>(CompactPoseSlam<Pose>&, const GraphReplay<Pose>&, const StepWatch&);   \
  template CompactRun<Pose> RunCompact<Pose>(CompactPoseSlam<Pose>, const GraphReplay<Pose>&, const AfterStep<Pose>&); \
  template RobustOptions MapRobust<Pose>(RobustOptions, const CompactOptions<Pose>&);                                  \
  template CompactOptions<Pose> OptionsFor<Pose>(const RobustOptions&, const InformationCalibration&,                  \
                                                 CompactOptions<Pose>);                                                \
  template PoseGraph<Pose> MapGraph<Pose>(const CompactPoseSlam<Pose>&, const std::vector<Pose>&);                     \
  template CompactRun<Pose> CompactGraph<Pose>(const PoseGraph<Pose>&, const CompactOptions<Pose>&,                    \
                                               const AfterStep<Pose>&);                                                \
  template CompactRun<Pose> CompactGraph<Pose>(const PoseGraph<Pose>&, Strategy, const AfterStep<Pose>&);              \
  template SampledThresholds<Pose> SampleThresholds<Pose>(const PoseGraph<Pose>&, CompactOptions<Pose>&, SampleOptions);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
