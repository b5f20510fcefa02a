#pragma once
// Robust costs for loops that may be wrong.
//
// A robust factor costs rho(s) instead of s = r' Omega r; its derivative w(s) = rho'(s), in [0, 1], is the weight with
// which it is linearised (W scaled by sqrt(w)): iteratively reweighted least squares. c is the width, in units of the
// whitened residual's norm, k = c^2.
//
//   kHuber   rho = s up to k, then 2 c sqrt(s) - k              w = min(1, c / sqrt(s))
//            Huber, "Robust estimation of a location parameter", 1964.
//   kCauchy  rho = k ln(1 + s / k)                              w = 1 / (1 + s / k)
//   kTukey   rho = k/3 (1 - (1 - s/k)^3) up to k, then k/3      w = (1 - s/k)^2, 0 beyond
//            Beaton and Tukey, Technometrics 1974.
//   kDcs     rho = s up to k, then k (3 s - k) / (s + k)        w = min(1, 2 k / (k + s))^2
//            Agarwal et al., "Robust map optimization using dynamic covariance scaling", ICRA 2013, Eq. 15.
//   kGnc     rho = min(s, k), truncated least squares           w = 1 up to k, 0 beyond
//            reached by graduated non-convexity: Yang et al., RA-L 2020, Eqs. 8 and 14. Its surrogate for mu > 0 is
//            convex for mu -> 0 and rho for mu -> infinity (GncWeight, GncCost).
//
// Robust are the loops: relative factors other than the one that brings a pose in. Those, odometry as a rule, hold
// every pose, so that weights of zero leave nothing free. kGnc leaves one of them out, too, where loops from several
// places contradict it in the same way: they hold what came after. Priors and fixed poses are never robust.
//
// A width that is left open assumes that information is that of covariances. kGnc makes it narrower where loops agree
// with the others much better than that: c^2 is at most six times the quantile at the scale that the median of their
// innovations says (and at least a thousandth of it). So covariances that are too cautious let no wrong loops pass.
// Only where loops come one after the other, which includes SolveBatch with BatchOptions::graduate.

#include <string>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse {

enum class RobustKernel { kNone, kHuber, kCauchy, kTukey, kDcs, kGnc };

struct RobustOptions {
  RobustKernel kernel = RobustKernel::kNone;
  double width = 0;        // c; 0: left open, see quantile
  double gnc_step = 1.4;   // kGnc: mu grows by this factor from one stage to the next (Yang et al.: 1.4)
  double quantile = 0.99;  // a width that is left open: c^2 is this quantile of chi-square, for kTukey three times that
};

// What is wrong with the options, or "".
std::string FindDefect(const RobustOptions& options);

// c^2 is what a true factor of so many scalars exceeds once in a hundred times. Tukey's is three times that: its cost
// then ends where truncated least squares ends.
double DefaultRobustWidth(RobustKernel kernel, int dimension);
// options.width, or that of the quantile.
double WidthOf(const RobustOptions& options, int dimension);

// rho(s) and rho'(s), s = chi2 >= 0, width > 0. kNone: s and 1.
double RobustCost(RobustKernel kernel, double chi2, double width);
double RobustWeight(RobustKernel kernel, double chi2, double width);

// Of the surrogate of kGnc: between the thresholds k mu/(mu+1) and k (mu+1)/mu
// rho = 2 c sqrt(s mu (mu+1)) - mu (k + s), w = c sqrt(mu (mu+1) / s) - mu; s and 1 below, k and 0 above.
double GncCost(double chi2, double width, double mu);
double GncWeight(double chi2, double width, double mu);
// The mu to start from (Yang et al., Remark 5): k / (2 s_max - k); infinite if all are within the width.
double GncStart(double largest_chi2, double width);

// The factors that a robust kernel is for, as the graph would come in (arrival.h), ascending. Throws
// std::invalid_argument if the graph is not connected.
template <class Pose>
std::vector<FactorId> LoopFactors(const PoseGraph<Pose>& graph);

// Those without weight that are no loops, as kGnc leaves odometry out that loops contradict in the same way (a slip);
// `weights` by position in the graph's factors.
template <class Pose>
std::vector<FactorId> SlippedOdometry(const PoseGraph<Pose>& graph, const std::vector<double>& weights);

// A graph with weights, such as those of BatchResult, by position in its factors: the information of relative factors
// is multiplied by theirs, factors of weight zero are left out. Factors whose weight is not 1 get new ids. No weights:
// the graph as it is. Throws std::invalid_argument if there is not one weight per factor, or a prior's is not 1.
template <class Pose>
PoseGraph<Pose> WithWeights(const PoseGraph<Pose>& graph, const std::vector<double>& weights);

// A copy without these factors, the others under their ids.
template <class Pose>
PoseGraph<Pose> WithoutFactors(PoseGraph<Pose> graph, const std::vector<FactorId>& ids);

}  // namespace terse
