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

// The image in squares.
class Grid {
 public:
  Grid(cv::Size size, double side)
      : side_(side),
        columns_(static_cast<int>(size.width / side) + 1),
        counts_(static_cast<size_t>(columns_ * (static_cast<int>(size.height / side) + 1)), 0) {}
  int& Count(const cv::Point2f& p) {
    return counts_[static_cast<size_t>(static_cast<int>(p.y / side_) * columns_ + static_cast<int>(p.x / side_))];
  }

 private:
  double side_;
  int columns_;
  std::vector<int> counts_;
};

struct Candidate {
  float strength;
  cv::Point2f point;
  int rank;  // in its cell, after the tracks that are there

  auto StrongestFirst() const { return std::make_tuple(-strength, point.y, point.x); }
  auto EvenlyFirst() const { return std::make_tuple(rank, -strength, point.y, point.x); }
};

std::vector<Candidate> FindCandidates(const cv::Mat& image, const cv::Mat& derivatives, Grid& buckets,
                                      const CornerOptions& options) {
  std::vector<cv::KeyPoint> keypoints;
  cv::FAST(image, keypoints, options.fast_threshold, true);
  const int border = std::max(options.border, kHalfWindow + 1);
  std::vector<Candidate> candidates;
  for (const cv::KeyPoint& keypoint : keypoints) {
    const int x = static_cast<int>(keypoint.pt.x), y = static_cast<int>(keypoint.pt.y);
    if (x < border || y < border || x >= image.cols - border || y >= image.rows - border) continue;
    if (buckets.Count(keypoint.pt) > 0) continue;
    const float strength = Strength(derivatives, x, y);
    if (strength >= options.min_strength) candidates.push_back({strength, keypoint.pt, 0});
  }
  return candidates;
}

}  // namespace

std::vector<cv::Point2f> BucketedCorners(const cv::Mat& image, const cv::Mat& derivatives,
                                         const std::vector<cv::Point2f>& occupied, const CornerOptions& options) {
  // Buckets keep corners apart. Cells, a dozen corners each, get equal shares: otherwise one textured side of a street
  // takes them all, and roll and sideways motion are badly determined.
  const double area_of_one = static_cast<double>(image.size().area()) / std::max(1, options.wanted);
  Grid buckets(image.size(), std::max(6.0, std::sqrt(area_of_one / 2)));
  Grid cells(image.size(), std::max(24.0, std::sqrt(area_of_one * 12)));
  const cv::Rect inside(0, 0, image.cols, image.rows);
  for (const cv::Point2f& p : occupied) {
    if (!inside.contains(cv::Point(p))) continue;
    ++buckets.Count(p);
    ++cells.Count(p);
  }
  std::vector<Candidate> candidates = FindCandidates(image, derivatives, buckets, options);
  std::sort(candidates.begin(), candidates.end(),
            [](const Candidate& a, const Candidate& b) { return a.StrongestFirst() < b.StrongestFirst(); });
  std::vector<Candidate> apart;
  for (Candidate& candidate : candidates) {
    if (buckets.Count(candidate.point)++ > 0) continue;
    candidate.rank = cells.Count(candidate.point)++;
    apart.push_back(candidate);
  }
  std::sort(apart.begin(), apart.end(),
            [](const Candidate& a, const Candidate& b) { return a.EvenlyFirst() < b.EvenlyFirst(); });
  std::vector<cv::Point2f> corners;
  for (const Candidate& candidate : apart) {
    if (static_cast<int>(corners.size() + occupied.size()) >= options.wanted) break;
    corners.push_back(candidate.point);
  }
  return corners;
}

}  // namespace terse
