#pragma once
// Stereo visual odometry: the motion of the camera from frame to frame, with a covariance.
//
// Bucketed corners are tracked by pyramidal Lucas-Kanade from frame to frame and from left to right, each track
// starting where the predicted motion puts its point, and kept only if it comes back to where it started around the
// circle left - left - right - right. Three-point RANSAC and Gauss-Newton on the stereo residuals (stereo_motion.h)
// give the motion since the previous frame and its covariance; a bundle adjustment over the last few keyframes refines
// it.
//
// No frame is ever skipped: where the images do not determine the motion the status is kLost, the reason says why,
// and the motion is that of constant velocity with an inflated covariance. The first frame after it that can be tracked
// from the last good one is; else tracking starts afresh.
//
// Deterministic, whatever the number of threads. Not thread-safe: one call at a time for each object.

#include <memory>
#include <string>
#include <vector>

#include "terse/core/log.h"
#include "terse/frontend/stereo_frame.h"
#include "terse/frontend/stereo_motion.h"

namespace terse {

struct StereoOdometryOptions {
  int corners = 700;              // tracks wanted in a frame
  int window = 5;                 // keyframes adjusted together; 0 or 1: motion from two frames only
  int min_inliers = 30;           // fewer: lost
  double forward_backward = 0.5;  // pixels that a track may miss its start by, there and back
  double circle = 0.4;            // pixels that a track may miss by around the four images
  double max_disparity = 0.2;     // of the image width
  double min_disparity = 1;       // pixels
  double max_angle = 0.5;         // radians from one frame to the next; more: lost
  double max_acceleration = 3;    // metres that a motion may differ from the predicted one; more: lost
  // Estimate a common offset of all disparities from the sequence: a tenth of a pixel, as calibrations leave it, is
  // half a per cent of scale. Its uncertainty goes into the covariances.
  bool estimate_disparity_offset = true;
  double disparity_offset_sigma = 0.3;  // pixels, before the first frame
  StereoMotionOptions motion;
  // Monte Carlo costs `samples` estimates of the motion per frame; where it gives none the other stands.
  MotionCovariance covariance = MotionCovariance::kSchur;
  MonteCarloOptions monte_carlo;
  // Standard deviations of a lost edge: a part of the motion, and at least so much.
  double lost_sigma_part = 0.5, lost_sigma_rho = 0.5, lost_sigma_phi = 0.05;  // 1, metres, radians
  LogSink log;                                                                // log.h
};

enum class TrackingStatus { kFirst, kTracked, kLost };
std::string ToString(TrackingStatus status);

// Milliseconds of wall time.
struct OdometryTimes {
  double pyramids = 0, corners = 0, tracking = 0, stereo = 0, motion = 0, window = 0;
  double Total() const { return pyramids + corners + tracking + stereo + motion + window; }
};

struct OdometryStep {
  TrackingStatus status = TrackingStatus::kFirst;
  bool keyframe = false;
  SE3 T_previous_current;                          // identity for the first frame
  Matrix<6, 6> covariance = Matrix<6, 6>::Zero();  // right perturbation of T_previous_current
  int tracked = 0, inliers = 0;                    // tracks that passed all checks; that agree with the motion
  double residual_scale = 0;                       // pixels
  std::string reason;                              // why lost, or what was odd: "dark", "repeated frame", ...
  OdometryTimes times;
};

class StereoOdometry {
 public:
  // Throws std::invalid_argument if the camera or an option makes no sense.
  explicit StereoOdometry(const StereoCamera& camera, const StereoOdometryOptions& options = {});
  ~StereoOdometry();
  StereoOdometry(StereoOdometry&&) noexcept;
  StereoOdometry& operator=(StereoOdometry&&) noexcept;

  // The next frame. Throws std::invalid_argument if an image has the wrong type or size; the state is then unchanged.
  OdometryStep Track(const StereoFrame& frame);

  // What has to be added to u_R, as estimated so far, and its standard deviation: pixels.
  double DisparityOffset() const;
  double DisparityOffsetSigma() const;

  // The points that the last frame tracks, and what it measures of them: (u_L, v_L, u_R), pixels.
  std::vector<Vector<3>> TrackedPoints() const;

 private:
  class State;
  std::unique_ptr<State> state_;
};

}  // namespace terse
