#pragma once
// A stored graph through compact pose SLAM: its poses in order of arrival, its edges as the registration
// (graph_replay.h), and then to the optimum of what was kept.
//
//     const CompactRun<SE3> run = CompactGraph(graph);
//     WriteG2o(run.KeptGraph(), "compact.g2o");

#include <functional>
#include <vector>

#include "terse/compact/thresholds.h"
#include "terse/covariance/information_scale.h"

namespace terse {

template <class Pose>
struct CompactRun {
  CompactPoseSlam<Pose> slam;
  std::vector<Decision> decisions;   // one per pose, in order of arrival
  std::vector<double> step_seconds;  // of AddPose
  int links_offered = 0;             // edges beside the odometry
  int registrations_tried = 0, links_refused = 0;
  std::vector<RetiredPose> retired;           // at the end, as CompactOptions::retire_share has it
  BatchResult<Pose> result;                   // of the kept graph
  InformationScale information_scale = {};    // of what the run saw, against the graph: CompactGraph with a strategy
  std::vector<FactorId> loops_left_out = {};  // before the run, which did not see them; likewise

  int PosesKept() const { return static_cast<int>(slam.Solver().Graph().Poses().size()); }
  int LinksKept() const { return slam.LinksKept(); }
  // Kept poses and links with the values of `result`.
  PoseGraph<Pose> KeptGraph() const;
  double Seconds() const;  // of all steps; the closing iterations are not counted
};

// Called after every step with the seconds it took; its own time is not counted.
template <class Pose>
using AfterStep = std::function<void(const CompactPoseSlam<Pose>&, const Decision&, double seconds)>;

// Told of every step and of the seconds it took, its own time not counted; false: no further one.
using StepWatch = std::function<bool(const Decision&, double seconds)>;

// Adds the poses of the replay to `slam`, which may have seen poses before, one after the other. Ends early where
// `after_step` returns false. Throws what AddPose throws; poses added before stay.
template <class Pose>
std::vector<Decision> AddPoses(CompactPoseSlam<Pose>& slam, const GraphReplay<Pose>& replay,
                               const StepWatch& after_step = nullptr);

// The same with all that a run is asked for, and to the optimum. Throws NumericalError if the kept map has
// no optimum, and what AddPose throws.
template <class Pose>
CompactRun<Pose> RunCompact(CompactPoseSlam<Pose> slam, const GraphReplay<Pose>& replay,
                            const AfterStep<Pose>& after_step = nullptr);

// What the commands take unless a kernel is asked for: kGnc for kBounded, none for the papers' own strategies.
RobustKernel DefaultKernel(Strategy strategy);

// Given, but for the width of kGnc if that is left open: it is the limit of the innovation test, so that a loop that
// joins the map for that test is not left out at once. Without the test DefaultRobustWidth.
template <class Pose>
RobustOptions MapRobust(RobustOptions given, const CompactOptions<Pose>& options);

// As the commands have them where information was calibrated: the kernel of MapRobust and, if it is scaled, the test's
// limit for that.
template <class Pose>
CompactOptions<Pose> OptionsFor(const RobustOptions& robust, const InformationCalibration& information,
                                CompactOptions<Pose> options = {});

// The kept map as a graph, at these values by pose index, without what a kernel leaves out.
template <class Pose>
PoseGraph<Pose> MapGraph(const CompactPoseSlam<Pose>& slam, const std::vector<Pose>& T_world_body);

// With the options as they are. Throws std::invalid_argument besides if the graph is empty or not connected, or for
// Strategy::kGiven, whose replay has to be told first (GraphReplay::Choose).
template <class Pose>
CompactRun<Pose> CompactGraph(const PoseGraph<Pose>& graph, const CompactOptions<Pose>& options,
                              const AfterStep<Pose>& after_step = nullptr);
// With thresholds from a sample of the graph (SampleThresholds), the strategy's kernel, all else as CompactOptions has
// it, and as the command does: information that nobody estimated and that the residuals contradict is scaled first
// (CalibrateInformation), of which CompactRun::information_scale tells. Where many loops stand alone and the strategy
// has kGnc, all are judged before there is a map; where the map refuses many they are judged by it, and it is made
// anew, so that `after_step` hears of every pose twice (LoopJury, contradicted_loops.h). With the options above nothing
// of this happens.
template <class Pose>
CompactRun<Pose> CompactGraph(const PoseGraph<Pose>& graph, Strategy strategy = Strategy::kBounded,
                              const AfterStep<Pose>& after_step = nullptr);

// Puts thresholds from a sample of the graph (SelectThresholds) into `options`. The sample's probability, distance and
// innovation quantile are those of `options`; its share and size are asked for in `sample`. Returns, too, what they
// were chosen by.
template <class Pose>
SampledThresholds<Pose> SampleThresholds(const PoseGraph<Pose>& graph, CompactOptions<Pose>& options,
                                         SampleOptions sample = {});

extern template struct CompactRun<SE2>;
extern template struct CompactRun<SE3>;

}  // namespace terse
