#pragma once
// A KITTI odometry sequence: a folder with calib.txt, times.txt and a folder of PNG images for each camera, image_0 and
// image_1 (grey) or, where these are missing, image_2 and image_3 (colour, read as grey). The images of a pair have the
// same name; their order is that of the names.

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "terse/frontend/kitti_calibration.h"
#include "terse/frontend/stereo_frame.h"

namespace terse {

class KittiFrames;

// Only the names are in memory. Const methods may be called from several threads.
class KittiSequence {
 public:
  // Reads calib.txt, times.txt and the first left image, and compares the names of the images. Throws FileError with
  // the file that is missing or wrong.
  explicit KittiSequence(const std::string& directory);

  int Size() const { return static_cast<int>(times_.size()); }
  const std::string& Directory() const { return directory_; }
  const StereoCamera& Camera() const { return calibration_.camera; }
  KittiPair Pair() const { return pair_; }
  // From the camera of the frames to the one of the ground truth; the identity for grey images.
  const SE3& T_camera0_left() const { return calibration_.T_camera0_left; }
  // Without times.txt the times are nominal, 10 frames a second.
  bool HasTimes() const { return has_times_; }
  double Time(int index) const;  // seconds
  // "left" or "right" image of a frame, for messages.
  std::string LeftPath(int index) const;
  std::string RightPath(int index) const;

  // Throws FileError: an image that is no readable PNG or not as large as the first one. std::invalid_argument: no
  // such frame.
  StereoFrame Read(int index) const;

  // The frames begin, begin + 1 ... end - 1, or those of `indices` in their order, read ahead on a second thread.
  // std::invalid_argument: no such frame.
  KittiFrames Frames(int begin, int end) const;
  KittiFrames Frames(std::vector<int> indices) const;

 private:
  void CheckIndex(int index) const;
  cv::Mat ReadImage(const std::string& path) const;

  std::string directory_;
  KittiPair pair_ = KittiPair::kGrey;
  KittiCalibration calibration_;
  std::vector<std::string> names_;  // of the image files
  std::vector<double> times_;
  bool has_times_ = false;
};

// Frames that are read ahead, a few at most. Needs no KittiSequence to stay alive. One thread calls Next().
class KittiFrames {
 public:
  KittiFrames(KittiSequence sequence, std::vector<int> indices);
  ~KittiFrames();
  KittiFrames(KittiFrames&&) noexcept;
  KittiFrames& operator=(KittiFrames&&) noexcept;

  // The next frame, or nothing after the last. Throws what KittiSequence::Read throws for this frame; the call after
  // that goes on with the frame behind it.
  std::optional<StereoFrame> Next();

 private:
  class Reader;
  std::unique_ptr<Reader> reader_;
};

}  // namespace terse
