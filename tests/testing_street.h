#pragma once
// A few frames of a rendered street, driven forth on the even frames and back on the odd ones: every revisit shows
// another image of the same place.

#include <vector>

#include "terse/frontend/street_sequence.h"

namespace terse::testing {

struct ThereAndBack {
  StereoCamera camera;
  std::vector<StereoFrame> frames;  // numbered in this order
  std::vector<SE3> T_world_camera;
};

// Of frames first ... first + length - 1, half as large as KITTI's.
inline ThereAndBack MakeThereAndBack(int first, int length) {
  StreetOptions options;
  options.width = 612;
  options.height = 184;
  const StreetSequence street(options);
  std::vector<int> order;
  for (int k = 0; k < length; k += 2) order.push_back(first + k);
  for (int k = (length - 1) / 2 * 2 - 1; k > 0; k -= 2) order.push_back(first + k);
  ThereAndBack out;
  out.camera = street.Camera();
  for (const int k : order) {
    StereoFrame frame = street.Render(k);
    frame.index = static_cast<int>(out.frames.size());
    frame.time = 0.1 * frame.index;
    out.frames.push_back(frame);
    out.T_world_camera.push_back(street.T_world_camera(k));
  }
  return out;
}

}  // namespace terse::testing
