#include "frame_quality.h"

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>

namespace terse {

FrameQuality MeasureQuality(const cv::Mat& image) {
  constexpr int kStride = 4;  // rows, so that it costs next to nothing
  std::int64_t sum = 0, squares = 0, differences = 0, count = 0;
  for (int v = 0; v < image.rows; v += kStride) {
    const uchar* row = image.ptr<uchar>(v);
    int row_sum = 0, row_squares = 0, row_differences = 0;
    for (int u = 1; u < image.cols; ++u) {
      row_sum += row[u];
      row_squares += row[u] * row[u];
      row_differences += std::abs(row[u] - row[u - 1]);
    }
    sum += row_sum;
    squares += row_squares;
    differences += row_differences;
    count += image.cols - 1;
  }
  FrameQuality quality;
  const double n = static_cast<double>(count);
  quality.mean = static_cast<double>(sum) / n;
  quality.contrast = std::sqrt(std::max(0.0, static_cast<double>(squares) / n - quality.mean * quality.mean));
  quality.sharpness = static_cast<double>(differences) / n / std::max(1.0, quality.contrast);
  return quality;
}

bool SameImage(const cv::Mat& a, const cv::Mat& b) {
  if (a.size() != b.size() || a.empty()) return false;
  for (int v = 0; v < a.rows; ++v) {
    if (std::memcmp(a.ptr<uchar>(v), b.ptr<uchar>(v), static_cast<size_t>(a.cols)) != 0) return false;
  }
  return true;
}

}  // namespace terse
