#include "stereo_tracker.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <opencv2/core/utility.hpp>
#include <opencv2/video/tracking.hpp>

namespace terse {
namespace {

constexpr int kCoarseLevel = 2;
constexpr float kCoarseScale = 1 << kCoarseLevel;

bool Inside(const cv::Mat& image, int x, int y, int half) {
  return x >= half && y >= half && x < image.cols - half && y < image.rows - half;
}

// Sum of absolute differences of two patches of the same size around whole pixels.
int PatchSad(const cv::Mat& a, int ax, int ay, const cv::Mat& b, int bx, int by, int half_x, int half_y) {
  int sum = 0;
  for (int v = -half_y; v <= half_y; ++v) {
    const uchar* p = a.ptr<uchar>(ay + v) + ax - half_x;
    const uchar* q = b.ptr<uchar>(by + v) + bx - half_x;
    for (int u = 0; u <= 2 * half_x; ++u) sum += std::abs(p[u] - q[u]);
  }
  return sum;
}

int PatchSum(const cv::Mat& image, int x, int y, int half) {
  int sum = 0;
  for (int v = -half; v <= half; ++v) {
    const uchar* p = image.ptr<uchar>(y + v) + x - half;
    for (int u = 0; u <= 2 * half; ++u) sum += p[u];
  }
  return sum;
}

float CoarseDisparity(const cv::Mat& left, const cv::Mat& right, const cv::Point2f& point, int max_disparity) {
  constexpr int kHalfX = 4, kHalfY = 2;
  const int x = cvRound(point.x / kCoarseScale), y = cvRound(point.y / kCoarseScale);
  if (!Inside(left, x, y, kHalfX)) return -1;
  const int last = std::min(max_disparity, x - kHalfX);
  std::vector<int> sad(static_cast<size_t>(last + 1));
  for (int d = 0; d <= last; ++d) {
    sad[static_cast<size_t>(d)] = PatchSad(left, x, y, right, x - d, y, kHalfX, kHalfY);
  }
  const int best = static_cast<int>(std::min_element(sad.begin(), sad.end()) - sad.begin());
  const int best_sad = sad[static_cast<size_t>(best)];
  for (int d = 0; d <= last; ++d) {
    if (std::abs(d - best) > 1 && sad[static_cast<size_t>(d)] * 9 < best_sad * 10) return -1;  // ambiguous
  }
  // The left corner was rounded to a coarse pixel, and so was its match: the difference is what counts.
  return static_cast<float>(best) * kCoarseScale;
}

}  // namespace

StereoPyramid BuildPyramids(const StereoFrame& frame) {
  StereoPyramid pyramids;
  cv::parallel_for_(cv::Range(0, 2), [&](const cv::Range& range) {
    for (int k = range.start; k < range.end; ++k) {
      cv::buildOpticalFlowPyramid(k == 0 ? frame.left : frame.right, k == 0 ? pyramids.left : pyramids.right,
                                  cv::Size(kFlowWindow, kFlowWindow), kFlowLevels - 1, true, cv::BORDER_REFLECT_101,
                                  cv::BORDER_CONSTANT, false);
    }
  });
  return pyramids;
}

const cv::Mat& Level(const FlowPyramid& pyramid, int level) {
  return pyramid[std::min(static_cast<size_t>(2 * level), pyramid.size() - 2)];
}

void Flow(const FlowPyramid& from, const FlowPyramid& to, const std::vector<cv::Point2f>& from_points,
          std::vector<cv::Point2f>& to_points, std::vector<char>& ok, int levels) {
  ok.assign(from_points.size(), 0);
  if (from_points.empty()) return;
  std::vector<uchar> status;
  const cv::TermCriteria criteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 20, 0.01);
  cv::calcOpticalFlowPyrLK(from, to, from_points, to_points, status, cv::noArray(), cv::Size(kFlowWindow, kFlowWindow),
                           levels - 1, criteria, cv::OPTFLOW_USE_INITIAL_FLOW, 1e-4);
  const cv::Mat& image = to.front();
  for (size_t k = 0; k < status.size(); ++k) {
    const cv::Point2f& p = to_points[k];
    ok[k] = status[k] && p.x >= 0 && p.y >= 0 && p.x <= static_cast<float>(image.cols - 1) &&
            p.y <= static_cast<float>(image.rows - 1);
  }
}

void CheckBackwards(const FlowPyramid& from, const FlowPyramid& to, const std::vector<cv::Point2f>& from_points,
                    const std::vector<cv::Point2f>& to_points, std::vector<char>& ok, double tolerance) {
  std::vector<cv::Point2f> back = from_points;
  std::vector<char> back_ok;
  Flow(to, from, to_points, back, back_ok, 1);
  for (size_t k = 0; k < ok.size(); ++k) {
    ok[k] = ok[k] && back_ok[k] && std::hypot(back[k].x - from_points[k].x, back[k].y - from_points[k].y) <= tolerance;
  }
}

std::vector<float> CoarseDisparities(const StereoPyramid& images, const std::vector<cv::Point2f>& points,
                                     double max_disparity) {
  std::vector<float> disparities(points.size());
  const cv::Mat &left = Level(images.left, kCoarseLevel), &right = Level(images.right, kCoarseLevel);
  const int coarse_max = static_cast<int>(max_disparity / kCoarseScale);
  cv::parallel_for_(cv::Range(0, static_cast<int>(points.size())), [&](const cv::Range& range) {
    for (int k = range.start; k < range.end; ++k) {
      disparities[static_cast<size_t>(k)] = CoarseDisparity(left, right, points[static_cast<size_t>(k)], coarse_max);
    }
  });
  return disparities;
}

double PatchDifference(const FlowPyramid& from_image, const FlowPyramid& to_image, const std::vector<cv::Point2f>& from,
                       const std::vector<cv::Point2f>& to) {
  constexpr int kHalf = 2, kPixels = (2 * kHalf + 1) * (2 * kHalf + 1);
  constexpr double kMax = 30;  // grey levels
  const cv::Mat &a = Level(from_image, kCoarseLevel), &b = Level(to_image, kCoarseLevel);
  double sum = 0;
  for (size_t k = 0; k < from.size(); ++k) {
    const int ax = cvRound(from[k].x / kCoarseScale), ay = cvRound(from[k].y / kCoarseScale);
    const float x = std::clamp(to[k].x, -1e4f, 1e4f), y = std::clamp(to[k].y, -1e4f, 1e4f);
    const int bx = cvRound(x / kCoarseScale), by = cvRound(y / kCoarseScale);
    if (!Inside(a, ax, ay, kHalf) || !Inside(b, bx, by, kHalf)) {
      sum += kMax;
      continue;
    }
    const int shift = (PatchSum(a, ax, ay, kHalf) - PatchSum(b, bx, by, kHalf)) / kPixels;
    int difference = 0;
    for (int v = -kHalf; v <= kHalf; ++v) {
      const uchar* p = a.ptr<uchar>(ay + v) + ax - kHalf;
      const uchar* q = b.ptr<uchar>(by + v) + bx - kHalf;
      for (int u = 0; u <= 2 * kHalf; ++u) difference += std::abs(p[u] - q[u] - shift);
    }
    sum += std::min(kMax, static_cast<double>(difference) / kPixels);
  }
  return from.empty() ? 0 : sum / static_cast<double>(from.size());
}

}  // namespace terse
