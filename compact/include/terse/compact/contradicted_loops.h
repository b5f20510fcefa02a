#pragma once
// Loops of a finished graph that are judged before a map is made of it.
//
// A map that grows hears of a loop once, when it comes, and what it refuses is no evidence for anything later. Where
// many loops are wrong, an early one that nothing contradicts yet bends the map, and true ones are refused for it. A
// file has all its loops at once: where many have no other that bears them out, or a first map refuses many, all are
// judged by gnc (batch_solver.h), and those that it contradicts never come to the map that is made then.

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "terse/compact/compact_graph.h"
#include "terse/core/robust.h"
#include "terse/covariance/information_scale.h"

namespace terse {

// More than one link in a hundred, and not only one or two, was refused. Of maps of public graphs without wrong loops
// that refuse more than two none refuses over one in 160 (but sphere_bignoise's, which is lost); a tenth of wrong ones
// makes it one in fifteen, or, where most are never looked at, one in sixty with half of them wrong (parking-garage).
bool AreLoopsInDoubt(long refused, long offered);

// Before there is a map: fifty loops, and more than one in ten, have no other that bears them out (two that agree over
// the odometry between their ends), odometry alone contradicts them more than it contradicts the others or they are
// more than one in three, and there is one of the others for every four poses (on ais2klinik, where loops are rare, the
// explanation that a first map gives is needed: 2.7 m, 6.4 without). In words; "" if not so.
template <class Pose>
std::string WhyLoopsAreInDoubt(const PoseGraph<Pose>& graph);

// Loops that the best explanation of all of them contradicts by far, ascending: with more than ten times the chi2 at
// which the kernel leaves a loop out. What is nearer the map judges for itself; slips of the odometry are not among
// them. Explanations are, in this order: the optimum of all loops next to that by gnc of odometry and of the loops that
// others near them bear out, which leaves few wrong ones in and the factor sparse; the optimum next to `first`; and,
// where true loops stand alone or there are no more than 500, that of the whole by gnc. The first two let in loops that
// they leave out although they know little of what these measure (open_loops.h), if that contradicts no more and has
// less chi2, of a loop no more than four times what one true one in a hundred exceeds. A later one has to have less
// chi2 than the best before it, of a loop no more than one true one in a hundred exceeds, and to contradict no more
// loops or to explain one in twenty more of the groups that they are (loop_groups.h); or to explain both one loop and
// one group in twenty more. Of up to 500 loops, that of the whole by a kernel twice as wide is a last one, which has to
// do the latter, of one and a half groups at least, and to save a quarter of what these loops count as that kernel has
// it. Out of any other best one groups are taken that, counted as wrong, make its chi2 less by that of five loops left
// out, and of three quarters of their own. `first`: values by pose index, such as those of a first map, or
// none. `options.robust`: of the map's solver, with kGnc; its quantile is not looked at. Throws std::invalid_argument
// as SolveBatch does.
template <class Pose>
std::vector<FactorId> ContradictedLoops(const PoseGraph<Pose>& graph, const std::vector<Pose>& first,
                                        BatchOptions options);

// Loops that a map of the graph believes, by what it decided on so many, though no other bears them out and their
// innovation is one that hardly any of so many true ones has (one run in twenty has such a loop). Where loops are few
// no other contradicts a wrong one that odometry just allows; so these have to be worth what they cost, and that an
// explanation holds them is no merit of it.
template <class Pose>
std::vector<FactorId> StrainedLoops(const std::vector<Decision>& decisions, long offered, const PoseGraph<Pose>& graph);

// What of a graph a map is made of.
//
//     LoopJury<SE3> jury(graph, CalibrateInformation(graph), options.solver.robust);
//     jury.JudgeAtFirst();
//     auto run = CompactGraph(jury.Remaining(), options);
//     if (jury.JudgeBy(run)) run = CompactGraph(jury.Remaining(), options);
//
// or CompactGraph(jury, options), which does that.
template <class Pose>
class LoopJury {
 public:
  // `graph` is to outlive it, its information is stated. `information`: what CalibrateInformation finds of it, or
  // nothing. Its scale is found again of what remains when loops are left out: wrong ones spoil it. Where information
  // is far too cautious loops are judged with less of that too; what counts is the explanation that contradicts fewer
  // measurements by that, odometry among them.
  // `robust`: of the map's solver; without kGnc there is nothing to judge. `options`: of the solves.
  LoopJury(const PoseGraph<Pose>& graph, const InformationCalibration& information, const RobustOptions& robust,
           BatchOptions options = {});
  // Told why, before loops are judged.
  std::function<void(const std::string& why)> on_judging;

  // Before there is a map, if loops are in doubt. True if some are left out now.
  bool JudgeAtFirst();
  // By a map of what remains, if its loops are in doubt or some are strained. True if others are left out now, so that
  // it is to be made anew.
  bool JudgeBy(const CompactRun<Pose>& run);
  // The same: what it decided on so many loops, of which it refused so many.
  bool JudgeBy(const CompactPoseSlam<Pose>& map, const std::vector<Decision>& decisions, long offered, long refused);
  // The same without asking whether there is reason, by the values of a map (by pose index; none: by none).
  bool JudgeNextTo(const std::vector<Pose>& T_world_body, const std::vector<FactorId>& strained);
  // As if these had been found, ascending.
  void LeaveOut(std::vector<FactorId> loops);
  // Of such values by truncated least squares, with the information as residuals show it.
  double CostOf(const std::vector<Pose>& T_world_body) const;
  const std::vector<FactorId>& LeftOut() const { return left_out_; }  // of the graph, ascending
  // Scaled, without those that are left out. The graph itself where neither is so.
  const PoseGraph<Pose>& Remaining() const { return remaining_ ? *remaining_ : graph_; }
  const InformationScale& Scale() const { return scale_; }  // of what remains

 private:
  bool Judge(const std::string& why, const std::vector<Pose>& first, const std::vector<FactorId>& strained = {});
  void Leave();
  const PoseGraph<Pose>& graph_;
  InformationScale scale_;
  InformationScale without_caution_;  // for judging, where scale_ is one
  BatchOptions options_;
  std::vector<FactorId> left_out_;
  std::optional<PoseGraph<Pose>> remaining_;  // if it is not the graph
};

// With thresholds from a sample of what the jury leaves, before and, if it judges by it, after a first map:
// `after_step` hears of every pose twice then.
template <class Pose>
CompactRun<Pose> CompactGraph(LoopJury<Pose>& jury, CompactOptions<Pose> options,
                              const AfterStep<Pose>& after_step = nullptr);

}  // namespace terse
