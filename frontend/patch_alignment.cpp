#include "patch_alignment.h"

#include <cmath>

namespace terse {
namespace {

constexpr int kIterations = 10;
constexpr double kSettled = 0.01;  // pixels of the patch
// Least sum of squared gradients, (grey levels per pixel)^2: below, noise of a few grey levels decides.
constexpr double kLeastTexture = 1500;

// Samples a square of kSide x kSide points, `spacing` pixels apart, bilinearly. Returns the sum.
template <int kSide, std::size_t kCount>
float Sample(const cv::Mat& image, double left, double top, double spacing, std::array<float, kCount>& sampled) {
  static_assert(kCount == static_cast<std::size_t>(kSide) * kSide);
  float sum = 0;
  std::size_t k = 0;
  for (int row = 0; row < kSide; ++row) {
    const double v = top + row * spacing;
    const int v0 = static_cast<int>(v);
    const auto fv = static_cast<float>(v - v0);
    const std::uint8_t *upper = image.ptr(v0), *lower = image.ptr(v0 + 1);
    for (int column = 0; column < kSide; ++column, ++k) {
      const double u = left + column * spacing;
      const int u0 = static_cast<int>(u);
      const auto fu = static_cast<float>(u - u0);
      const float a = static_cast<float>(upper[u0]) + fu * static_cast<float>(upper[u0 + 1] - upper[u0]);
      const float b = static_cast<float>(lower[u0]) + fu * static_cast<float>(lower[u0 + 1] - lower[u0]);
      sampled[k] = a + fv * (b - a);
      sum += sampled[k];
    }
  }
  return sum;
}

}  // namespace

AlignmentTemplate::AlignmentTemplate(const Patch& patch) {
  const auto at = [&](int x, int y) { return static_cast<float>(patch[static_cast<std::size_t>(y * kPatchSize + x)]); };
  double sum = 0;
  std::size_t k = 0;
  for (int y = 1; y <= kInner; ++y) {
    for (int x = 1; x <= kInner; ++x, ++k) {
      value_[k] = at(x, y);
      gx_[k] = (at(x + 1, y) - at(x - 1, y)) / 2;
      gy_[k] = (at(x, y + 1) - at(x, y - 1)) / 2;
      sum += value_[k];
    }
  }
  double squares = 0, mean_x = 0, mean_y = 0;
  for (k = 0; k < kCount; ++k) {
    value_[k] -= static_cast<float>(sum / kCount);
    squares += value_[k] * value_[k];
    mean_x += gx_[k] / kCount;
    mean_y += gy_[k] / kCount;
  }
  norm_ = std::sqrt(squares);
  for (k = 0; k < kCount; ++k) {
    // Brightness is free: only what differs from the mean gradient tells of a shift.
    gx_[k] -= static_cast<float>(mean_x);
    gy_[k] -= static_cast<float>(mean_y);
    H_xx_ += gx_[k] * gx_[k];
    H_xy_ += gx_[k] * gy_[k];
    H_yy_ += gy_[k] * gy_[k];
  }
}

std::optional<AlignmentTemplate::Place> AlignmentTemplate::Find(const cv::Mat& image, double x, double y,
                                                                double spacing, bool along_row, double reach) const {
  const double determinant = H_xx_ * H_yy_ - H_xy_ * H_xy_, trace = H_xx_ + H_yy_;
  // The smaller eigenvalue; the sign of (l1 - k)(l2 - k) alone would let through where both are below.
  const bool flat = trace < 2 * kLeastTexture || determinant < kLeastTexture * (trace - kLeastTexture);
  if (along_row ? H_xx_ < kLeastTexture : flat) return std::nullopt;
  const double start_x = x, start_y = y, half = kInner / 2 * spacing;
  std::array<float, kCount> sampled;
  Place place;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    const double left = x - half, top = y - half;
    if (!(left >= 0 && top >= 0 && x + half < image.cols - 1 && y + half < image.rows - 1)) return std::nullopt;
    const float mean = Sample<kInner>(image, left, top, spacing, sampled) / kCount;
    float squares = 0, product = 0;
    for (std::size_t k = 0; k < kCount; ++k) {
      sampled[k] -= mean;
      squares += sampled[k] * sampled[k];
      product += sampled[k] * value_[k];
    }
    if (!(squares > 0) || !(norm_ > 0)) return std::nullopt;
    place = {x, y, product / (std::sqrt(squares) * norm_)};
    const auto contrast = static_cast<float>(norm_ / std::sqrt(squares));
    float b_x = 0, b_y = 0;
    for (std::size_t k = 0; k < kCount; ++k) {
      const float residual = contrast * sampled[k] - value_[k];
      b_x += gx_[k] * residual;
      b_y += gy_[k] * residual;
    }
    double step_x = b_x / H_xx_, step_y = 0;
    if (!along_row) {
      step_x = (H_yy_ * b_x - H_xy_ * b_y) / determinant;
      step_y = (H_xx_ * b_y - H_xy_ * b_x) / determinant;
    }
    x -= step_x * spacing;
    y -= step_y * spacing;
    if (!(std::hypot(x - start_x, y - start_y) <= reach)) return std::nullopt;
    if (std::abs(step_x) + std::abs(step_y) < kSettled) {
      place.x = x;
      place.y = y;
      return place;
    }
  }
  return std::nullopt;
}

}  // namespace terse
