#pragma once
// Where the points of a stereo frame are in the next one.

#include <vector>

#include "stereo_tracker.h"
#include "terse/frontend/stereo_odometry.h"

namespace terse {

// Points of frame a, seen in frame b: uvu[k] = (u_L, v_L, u_R) where ok[k].
struct TrackMeasurement {
  std::vector<Vector<3>> uvu;
  std::vector<char> ok;
};

// (u_L, v, u_R) in b of points given by their image coordinates in a. A point behind b stays where it is.
std::vector<Vector<3>> PredictPoints(const StereoCamera& camera, const std::vector<Vector<3>>& points,
                                     const SE3& T_a_b);

// The motion among `candidates` under which the images agree best (index). Empty candidates are not allowed.
size_t ChooseMotion(const StereoCamera& camera, const StereoPyramid& a, const StereoPyramid& b,
                    const std::vector<Vector<3>>& points, const std::vector<SE3>& candidates);

// Tracks points from a to b: left to left, left to right, and back right to right (circle) and left to left.
TrackMeasurement MeasureTracks(const StereoCamera& camera, const StereoPyramid& a, const StereoPyramid& b,
                               const std::vector<Vector<3>>& points, const SE3& T_a_b, int levels,
                               const StereoOdometryOptions& options, OdometryTimes& times);

// Points of one frame from pixels of its left image; those whose disparity is not found are left out.
std::vector<Vector<3>> MeasureDisparities(const StereoCamera& camera, const StereoPyramid& images,
                                          const std::vector<cv::Point2f>& corners,
                                          const StereoOdometryOptions& options);

}  // namespace terse
