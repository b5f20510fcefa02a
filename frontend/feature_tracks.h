#pragma once
// The tracks of a stereo odometry: points of the reference frame with their past in the window.

#include <vector>

#include "bucketed_corners.h"
#include "stereo_tracker.h"
#include "terse/frontend/motion_window.h"
#include "terse/frontend/stereo_odometry.h"

namespace terse {

struct FeatureTrack {
  WindowPoint past;  // with frames as ids; the last is the reference frame's
  const Vector<3>& Now() const { return past.observations.back().uvu; }
};

// A common error of all disparities: what calibration leaves, a scale error of the motion. Constant, estimated from all
// windows so far.
class OffsetEstimate {
 public:
  explicit OffsetEstimate(double prior_sigma) : information_(1 / (prior_sigma * prior_sigma)) {}
  void Update(const WindowOffset& window, int frames);
  Vector<3> Corrected(const Vector<3>& uvu) const { return {uvu.x(), uvu.y(), uvu.z() + offset_}; }
  double Offset() const { return offset_; }  // pixels, added to u_R
  double Variance() const { return 1 / information_; }

 private:
  double offset_ = 0, information_;
};

// A few frames with their tracks; the last is the newest, which later frames are tracked from. Ids of frames increase.
class TrackWindow {
 public:
  struct Frame {
    int id;
    SE3 T_world_camera;
    bool keyframe;
  };

  TrackWindow(const StereoCamera& camera, const StereoOdometryOptions& options)
      : camera_(camera), options_(options), offset_(options.disparity_offset_sigma) {}

  // Forgets all and starts with one frame.
  void Start(const SE3& T_world_camera, const StereoPyramid& images);

  // The next frame, with what was measured of Points(): tracks without (keep[k] = 0) end. New corners are added if it
  // becomes a keyframe or few tracks are left. Poses of the window are adjusted.
  void Advance(const SE3& T_world_camera, const StereoPyramid& images, const std::vector<Vector<3>>& measured,
               const std::vector<char>& keep, OdometryTimes& times);

  std::vector<Vector<3>> Points() const;
  const OffsetEstimate& Offset() const { return offset_; }
  const Frame& Newest() const { return frames_.back(); }

 private:
  bool BecomesKeyframe() const;
  void DropFrame(size_t index);
  void Adjust();
  void AddCorners(const StereoPyramid& images);

  StereoCamera camera_;
  StereoOdometryOptions options_;
  std::vector<Frame> frames_;
  std::vector<FeatureTrack> tracks_;
  OffsetEstimate offset_;
  int next_id_ = 0;
};

}  // namespace terse
