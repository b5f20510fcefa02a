#pragma once
// Where in an image is a patch? To sub-pixel, from a start nearby.

#include <optional>

#include "terse/frontend/keyframe_features.h"

namespace terse {

// A patch made ready: grey values less their mean, and their gradients.
class AlignmentTemplate {
 public:
  explicit AlignmentTemplate(const Patch& patch);

  struct Place {
    double x = 0, y = 0;     // pixels of the image
    double correlation = 0;  // normalised, 1: equal up to brightness and contrast
  };
  // Gauss-Newton (inverse compositional, brightness and contrast free) from (x, y), with `spacing` pixels of the image
  // per pixel of the patch. `along_row`: y stays. Nothing if it leaves the image, moves by more than `reach` pixels, or
  // has no texture to go by.
  std::optional<Place> Find(const cv::Mat& image, double x, double y, double spacing, bool along_row,
                            double reach) const;

 private:
  static constexpr int kInner = kPatchSize - 2;  // where there are gradients
  static constexpr int kCount = kInner * kInner;
  std::array<float, kCount> value_, gx_, gy_;
  double norm_ = 0;  // of value_
  double H_xx_ = 0, H_xy_ = 0, H_yy_ = 0;
};

}  // namespace terse
