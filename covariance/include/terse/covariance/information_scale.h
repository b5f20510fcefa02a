#pragma once
// Information that is no covariance: what a graph states, what its residuals say, and the factors between the two.
//
// Many exported graphs carry the unit matrix or one constant for every edge, which nobody estimated. Gains in nats, the
// plausible range of a sensor and tests of innovations mean nothing then. The residuals tell what the standard
// deviations should have been: translation and rotation of odometry and of loops, four variance components.
//
// At the optimum of a graph whose information is right, the squares of a group's whitened residuals sum to its
// redundancy: its scalars less its leverages (Foerstner, "Ein Verfahren zur Schaetzung von Varianz- und
// Kovarianzkomponenten", AVN 1979; Koch, Parameter Estimation and Hypothesis Testing, 1999, section 3.6). Odometry with
// few loops fits almost perfectly, so leverages matter. They come from draws: residuals of simulated noise through the
// same factor, (I - A H^-1 A') n, one substitution each. The scale of a group is what makes its residuals, with squares
// beyond four times the expected ones cut there, add up to what the draws give with the same cut. Loops that stand out
// of the other loops lose weight in the next solution. This is repeated, each time at the optimum under the last
// scales, until no scale moves.
//
// So many wrong loops that none stands out bend the map, and residuals with it. So the scale at which short cycles
// close is tried too (two loops between the same places and the odometry between their ends: wrong loops are in few of
// those, or agree with each other in groups), and the information as stated, also times powers of four, for a guess is
// often right but for one factor: truncated least squares tells wrong loops apart there, and scales are estimated from
// the others. The scales under which the measurements are most probable are
// the estimate: poses integrated out (Laplace's approximation: MacKay, "Bayesian interpolation", Neural Computation
// 4(3), 1992), a wrong loop anywhere in the range of what loops say, the others of a group of wrong ones as their
// cycles close.
//
// A loop is a relative factor between poses that do not arrive one right after the other (arrival.h). Priors and fixed
// poses are left out of the estimate and never scaled. Standard deviations are root mean squares over the axes, metres
// and radians, body frame at the factor's second pose.

#include <optional>
#include <string>

#include "terse/core/pose_graph.h"

namespace terse {

// Over the edges of a kind: 10th, 50th and 90th percentile.
struct SigmaSpread {
  double low = 0, median = 0, high = 0;
};

// What the information of a kind of edges states.
struct StatedKind {
  long edges = 0;
  SigmaSpread translation_m, rotation_rad;
  bool is_constant = false;  // the same matrix on all edges, to a few per cent
  bool is_identity = false;  // a constant, and ones: in radians, or in 3D for the vector part of the quaternion
};

struct StatedInformation {
  StatedKind odometry, loops;
  bool same = false;         // both kinds are constant, and the same
  double median_step_m = 0;  // length of the odometry edges (of the loops, if there is none)
  // An odometry edge (a loop, if there is none) is uncertain by more than half a step or half a radian, by the median.
  bool IsImplausible() const;
  // Nobody measured this: all identity, or constants that are implausible.
  bool IsPlaceholder() const;
};

// What the information itself says, without residuals. O(E log E). Throws std::invalid_argument if the graph is not
// connected.
template <class Pose>
StatedInformation DescribeInformation(const PoseGraph<Pose>& graph);

// Factors on standard deviations.
struct KindScale {
  double translation = 1, rotation = 1;
};
struct InformationScale {
  KindScale odometry, loops;
  bool IsOne() const;
};

// W -> S Omega S of every relative factor, S diagonal by block; all else as it was. Factors are numbered from 0.
template <class Pose>
PoseGraph<Pose> ScaleInformation(const PoseGraph<Pose>& graph, const InformationScale& scale);

// The same of one factor.
template <class Pose>
RelativePoseFactor<Pose> ScaleInformation(const RelativePoseFactor<Pose>& factor, const KindScale& scale);

// A scale out of residuals.
struct ScaleEstimate {
  double sigma_factor = 1;  // the residuals' standard deviation over the stated one
  double log_error = 0;     // standard error of its logarithm
  double redundancy = 0;    // scalars' worth of residuals
  bool determined = false;  // enough of them; otherwise the factor is that of the other kind, or 1
  bool at_floor = false;    // smaller than any sensor's: held at what is plausible
};
struct KindEstimate {
  ScaleEstimate translation, rotation;
};

struct EstimateOptions {
  // The sample is the beginning of the graph in order of arrival, until it has so many poses and loops.
  long sample_poses = 2000, sample_loops = 1000;
  int draws = 32;
  int max_iterations = 12;
  double tolerance = 0.02;  // of the logarithm of a scale
  std::uint64_t seed = 1;
};

struct InformationEstimate {
  KindEstimate odometry, loops;
  long poses = 0, edges = 0, loop_edges = 0;  // of the sample
  // Some measurements agree better than any sensor could: they are computed from one another, not measured. Odometry
  // and loops then share one factor for translation and one for rotation, to which all squares count in full, but for
  // loops that truncated least squares leaves out.
  bool has_copies = false;
  long loops_left_out = 0;  // contradicted by the others
  // Share of the loops that agree with the odometry between their ends as both are stated (99 % of right ones would).
  double agreeing_loops = 0;
  int iterations = 0;
  double normalized_chi2 = 0;  // of the sample at the optimum under the stated information, over its redundancy
  std::string failure;         // why there is no estimate, else empty
};

// Throws std::invalid_argument if the graph is empty or not connected.
template <class Pose>
InformationEstimate EstimateInformationScale(const PoseGraph<Pose>& graph, const EstimateOptions& options = {});

enum class InformationVerdict {
  kConsistent,    // within the band, or cautious where it was measured
  kContradicted,  // scaled
  kUndetermined,  // too few loops, or residuals that are rounding
};
const char* Name(InformationVerdict verdict);

struct InformationCalibration {
  StatedInformation stated;
  InformationEstimate estimate;
  InformationVerdict verdict = InformationVerdict::kUndetermined;
  InformationScale scale;  // ones unless contradicted
  // Where the information is consistent, but standard deviations of translation or of rotation are more than ten times
  // what residuals say, of odometry as of loops: three times those, and the stated ones at most, for odometry and loops
  // alike. For telling wrong loops from true ones, not for maps; ones otherwise.
  InformationScale without_caution;
  std::string message;  // a sentence for people
};

// Whether the residuals contradict the information so much that it is better scaled, beyond two standard errors: if
// standard deviations found are twice the stated ones in any group, or smaller: a third of placeholders'
// (StatedInformation), a twentieth of one constant for all edges, somebody's guess. Information that differs from edge
// to edge was computed by somebody: too much caution is left alone. Information is not called too certain where far
// more loops agree with it than would if it were (InformationEstimate::agreeing_loops): the others are wrong then. What
// residuals cannot tell, a tree's for example, stays as it is. The residuals are those of a beginning
// (EstimateOptions), and where a drive is back at known places late, all loops of that may be wrong ones. So where
// standard deviations come out three times smaller without the loops that no other bears out (Mangelson et al., ICRA
// 2018), and there is one of the others for every four poses, those count. Where odometry contradicts such loops far
// more than it contradicts the others, and those agree with the information as stated, these alone were asked:
// `estimate` is of the graph without them, and `message` says how many they are.
template <class Pose>
InformationCalibration CalibrateInformation(const PoseGraph<Pose>& graph, const EstimateOptions& options = {});

}  // namespace terse
