#pragma once
// A synthetic stereo sequence with exact ground truth: laps round a block of a street, as images and in KITTI's layout.
//
// What makes it as hard as real images: noise, an exposure that changes all the time, stretches where road and walls
// show next to nothing, and a calibration whose disparities are a little off. The camera turns by at most 2.5 degrees
// per frame. Every lap is driven a little differently, so that no two frames are the same.

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "terse/frontend/stereo_camera.h"
#include "terse/frontend/stereo_frame.h"
#include "terse/lie/se3.h"

namespace terse {

struct StreetOptions {
  int frames = 400, laps = 2;
  int width = 1226, height = 370;  // pixels
  std::uint64_t seed = 1;
  double metres_per_frame = 1;
  double noise = 5;               // standard deviation, grey levels
  double contrast = 0.5;          // of the textures, 0 to 1
  double disparity_offset = 0.1;  // pixels: what the images show minus what the calibration says
  double exposure = 0.25;         // the gain varies by this much about 1
  bool featureless_stretches = true;
  // The second half of a lap looks like the first, as rows of houses built to one plan do: what stands at two places
  // half a lap apart is the same.
  bool twins = false;
};

class StreetSequence {
 public:
  // std::invalid_argument: options out of range, or too few frames for the corners of a lap.
  explicit StreetSequence(const StreetOptions& options);
  ~StreetSequence();
  StreetSequence(StreetSequence&&) noexcept;
  StreetSequence& operator=(StreetSequence&&) noexcept;

  // The corners of a lap need as many.
  static int LeastFramesPerLap(double metres_per_frame);

  const StreetOptions& Options() const;
  // As calib.txt says.
  const StereoCamera& Camera() const;
  double Time(int frame) const;  // seconds
  // Of the left camera, from its first pose on.
  SE3 T_world_camera(int frame) const;

  // The same for the same options, whatever other frames are rendered before or at once. Thread-safe.
  StereoFrame Render(int frame) const;
  // Without noise and at constant exposure, grey values as 32-bit floats.
  StereoFrame RenderClean(int frame) const;
  // The z of what the centre of each pixel of the left image shows, metres, 32-bit float; 0 where it shows nothing.
  cv::Mat RenderDepth(int frame) const;

 private:
  struct Data;
  std::unique_ptr<Data> data_;
};

// image_0, image_1, calib.txt, times.txt and poses.txt (the ground truth) in `directory`, which is made if it is
// missing and otherwise must be empty of images. `progress` is called with the number of frames done, by one thread at
// a time. Throws FileError.
void WriteStreet(const StreetSequence& sequence, const std::string& directory, int threads,
                 const std::function<void(int)>& progress = {});

}  // namespace terse
