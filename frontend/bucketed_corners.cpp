#include "bucketed_corners.h"

#include <algorithm>
#include <cmath>
#include <opencv2/features2d.hpp>
#include <tuple>

namespace terse {
namespace {

constexpr int kHalfWindow = 3;
constexpr float kScharrGain = 32;  // Scharr's kernel gives 32 times the derivative

// The smaller eigenvalue of the structure tensor, mean over the window.
float Strength(const cv::Mat& derivatives, int x, int y) {
  int xx = 0, xy = 0, yy = 0;
  for (int v = y - kHalfWindow; v <= y + kHalfWindow; ++v) {
    const short* row = derivatives.ptr<short>(v) + 2 * (x - kHalfWindow);
    for (int u = 0; u < 2 * kHalfWindow + 1; ++u) {
      const int dx = row[2 * u] >> 3, dy = row[2 * u + 1] >> 3;
      xx += dx * dx;
      xy += dx * dy;
      yy += dy * dy;
    }
  }
  constexpr float kScale = (8 / kScharrGain) * (8 / kScharrGain) / ((2 * kHalfWindow + 1) * (2 * kHalfWindow + 1));
  const float a = static_cast<float>(xx), b = static_cast<float>(xy), c = static_cast<float>(yy);
  return 0.5f * kScale * (a + c - std::sqrt((a - c) * (a - c) + 4 * b * b));
}

// Square buckets, so many that one corner in each makes the number wanted.
class Buckets {
 public:
  Buckets(cv::Size size, int wanted)
      : side_(std::max(8.0, std::sqrt(static_cast<double>(size.area()) / std::max(1, wanted)))),
        columns_(static_cast<int>(size.width / side_) + 1),
        taken_(static_cast<size_t>(columns_ * (static_cast<int>(size.height / side_) + 1)), 0) {}

  int At(float x, float y) const { return static_cast<int>(y / side_) * columns_ + static_cast<int>(x / side_); }
  bool Taken(int bucket) const { return taken_[static_cast<size_t>(bucket)] != 0; }
  void Take(int bucket) { taken_[static_cast<size_t>(bucket)] = 1; }

 private:
  double side_;
  int columns_;
  std::vector<char> taken_;
};

struct Candidate {
  float strength;
  cv::Point2f point;
  bool operator<(const Candidate& other) const {
    return std::tie(other.strength, point.y, point.x) < std::tie(strength, other.point.y, other.point.x);
  }
};

}  // namespace

std::vector<cv::Point2f> BucketedCorners(const cv::Mat& image, const cv::Mat& derivatives,
                                         const std::vector<cv::Point2f>& occupied, const CornerOptions& options) {
  // Half the corners wanted as buckets with up to two each would cluster; a third more buckets than corners makes up
  // for those that hold none.
  Buckets buckets(image.size(), options.wanted * 3 / 2);
  const cv::Rect inside(0, 0, image.cols, image.rows);
  for (const cv::Point2f& p : occupied) {
    if (inside.contains(cv::Point(p))) buckets.Take(buckets.At(p.x, p.y));
  }
  std::vector<cv::KeyPoint> keypoints;
  cv::FAST(image, keypoints, options.fast_threshold, true);
  const int border = std::max(options.border, kHalfWindow + 1);
  std::vector<Candidate> candidates;
  for (const cv::KeyPoint& keypoint : keypoints) {
    const int x = static_cast<int>(keypoint.pt.x), y = static_cast<int>(keypoint.pt.y);
    if (x < border || y < border || x >= image.cols - border || y >= image.rows - border) continue;
    if (buckets.Taken(buckets.At(keypoint.pt.x, keypoint.pt.y))) continue;
    const float strength = Strength(derivatives, x, y);
    if (strength >= options.min_strength) candidates.push_back({strength, keypoint.pt});
  }
  std::sort(candidates.begin(), candidates.end());
  std::vector<cv::Point2f> corners;
  const int room = options.wanted - static_cast<int>(occupied.size());
  for (const Candidate& candidate : candidates) {
    if (static_cast<int>(corners.size()) >= room) break;
    const int bucket = buckets.At(candidate.point.x, candidate.point.y);
    if (buckets.Taken(bucket)) continue;
    buckets.Take(bucket);
    corners.push_back(candidate.point);
  }
  return corners;
}

}  // namespace terse
