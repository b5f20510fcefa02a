#pragma once
// The motion of a stereo camera between two frames from points that both see, and its covariance.
//
// Model: a point x in the image coordinates (u_L, v, u_R) of frame a is measured there as x + noise, and in frame b as
// the projection of T_a_b^-1 x + noise. The motion is estimated jointly with the points, each of which is eliminated by
// its own 3x3 Schur complement: holding the points where frame a alone sees them is noisier, biased along the view axis
// and overconfident. Image coordinates as the parameters of a point keep far points well-conditioned: one at infinity
// has disparity 0 and still constrains the rotation.
//
// Covariances are of d = [rho; phi] in T_a_b Exp(d), metres and radians: in the frame of camera b.
// All functions are thread-safe and deterministic.

#include <cstdint>
#include <optional>
#include <vector>

#include "terse/frontend/stereo_camera.h"
#include "terse/lie/se3.h"

namespace terse {

// One point as two stereo frames see it: (u_L, v_L, u_R), pixels.
struct StereoMatch {
  Vector<3> a, b;
};

struct StereoMotionOptions {
  double huber = 1;          // pixels: a residual (of one match, 6 numbers) counts linearly from here on
  double outlier = 3;        // pixels: a match with a larger residual after convergence is left out
  double min_disparity = 1;  // pixels: a match with less in either frame is not used
  int min_inliers = 12;      // fewer: no result
  int max_iterations = 20;
  // Covariance = factor * scale^2 * (Schur complement)^-1 + floor. The residuals' own scale is too optimistic: errors
  // of tracks are correlated with the texture, the disparity and each other. The factor, on variances, was found on
  // rendered sequences with exact ground truth.
  double covariance_factor = 4.5;
  double min_residual_scale = 0.1;  // pixels
  double sigma_rho_floor = 1e-3;    // metres, standard deviation
  double sigma_phi_floor = 2e-5;    // radians
};

struct StereoMotion {
  SE3 T_a_b;
  Matrix<6, 6> covariance;
  Vector<6> J_motion_offset;  // how the motion changes (d of T_a_b Exp(d)) with a pixel added to all u_R
  std::vector<char> inlier;   // one per match
  int inliers = 0;            // how many of them
  double residual_scale = 0;  // pixels, estimated standard deviation of one image coordinate
};

// Gauss-Newton from `initial`. Nothing if there are too few inliers, or if they do not determine the motion.
std::optional<StereoMotion> EstimateStereoMotion(const StereoCamera& camera, const std::vector<StereoMatch>& matches,
                                                 const StereoMotionOptions& options, const SE3& initial);

struct InitialMotionOptions {
  double threshold = 2;  // pixels, in the left image of b
  double confidence = 0.999;
  int max_iterations = 200;
  double min_disparity = 1;  // pixels, in a
  int min_inliers = 12;      // fewer: no result
};

// A motion to start from, and the matches that agree with it.
struct InitialMotionResult {
  SE3 T_a_b;
  std::vector<char> inlier;  // one per match
  int inliers = 0;
};

// Three-point RANSAC of the points of a, triangulated, against the left image of b. Needs no prediction.
std::optional<InitialMotionResult> InitialMotion(const StereoCamera& camera, const std::vector<StereoMatch>& matches,
                                                 const InitialMotionOptions& options = {});

// The covariance as S (section 5) takes it: the motion is estimated again and again from the matches with independent
// noise of sigma pixels added to every image coordinate. No factor and no floor. The matches should be inliers. Nothing
// if fewer than 8 samples give a motion. Costs `samples` times EstimateStereoMotion.
std::optional<Matrix<6, 6>> MonteCarloCovariance(const StereoCamera& camera, const std::vector<StereoMatch>& matches,
                                                 const SE3& T_a_b, double sigma, int samples, std::uint64_t seed,
                                                 const StereoMotionOptions& options = {});

// Where the covariance of a measured motion comes from. kSchur: StereoMotion::covariance. kMonteCarlo: the paper's.
enum class MotionCovariance { kSchur, kMonteCarlo };

struct MonteCarloOptions {
  double sigma = 1;   // pixels
  int samples = 100;  // a standard deviation is then known to 7 %
};

// The same of the inliers of a motion, by plain least squares: with noise of a pixel the bounds that tell outliers
// would cut it off. Throws std::invalid_argument unless sigma is positive and there are 8 samples at least.
std::optional<Matrix<6, 6>> MonteCarloCovariance(const StereoCamera& camera, const std::vector<StereoMatch>& matches,
                                                 const StereoMotion& motion, const MonteCarloOptions& options,
                                                 std::uint64_t seed);

}  // namespace terse
