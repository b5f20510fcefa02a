#include "terse/frontend/keyframe_features.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "patch_alignment.h"

namespace terse {
namespace {

using std::size_t;

constexpr int kCell = 48;              // pixels of a level: corners are spread over cells
constexpr int kDescriptorRadius = 15;  // pixels of a level
constexpr int kWindowX = 16, kWindowY = 11;
constexpr double kRepeated = 0.9;  // of the next best disparity's difference: as good elsewhere, so not to be told
constexpr double kLeastCorrelation = 0.8;

struct Corner {
  int x, y;  // pixels of the level
  float response;
};

bool Stronger(const Corner& a, const Corner& b) {
  if (a.response != b.response) return a.response > b.response;
  return a.y != b.y ? a.y < b.y : a.x < b.x;
}

// The strongest of every cell, as many from each as are needed for `quota` in all.
std::vector<Corner> SpreadCorners(const cv::Mat& image, int threshold, int quota) {
  std::vector<cv::KeyPoint> found;
  cv::FAST(image, found, 2 * threshold, true);
  if (static_cast<int>(found.size()) < 2 * quota) cv::FAST(image, found, threshold, true);
  const int columns = (image.cols + kCell - 1) / kCell, rows = (image.rows + kCell - 1) / kCell;
  std::vector<std::vector<Corner>> cells(static_cast<size_t>(columns * rows));
  constexpr int kBorder = kDescriptorRadius + 1;
  for (const cv::KeyPoint& k : found) {
    const int x = cvRound(k.pt.x), y = cvRound(k.pt.y);
    if (x < kBorder || y < kBorder || x >= image.cols - kBorder || y >= image.rows - kBorder) continue;
    cells[static_cast<size_t>(y / kCell * columns + x / kCell)].push_back({x, y, k.response});
  }
  for (auto& cell : cells) std::sort(cell.begin(), cell.end(), Stronger);
  std::vector<Corner> out, round;
  for (size_t rank = 0; static_cast<int>(out.size()) < quota; ++rank) {
    round.clear();
    for (const auto& cell : cells) {
      if (rank < cell.size()) round.push_back(cell[rank]);
    }
    if (round.empty()) break;
    std::sort(round.begin(), round.end(), Stronger);
    for (const Corner& corner : round) {
      if (static_cast<int>(out.size()) < quota) out.push_back(corner);
    }
  }
  return out;
}

// Pairs of places to compare, normally distributed about the corner (Calonder et al., ECCV 2010).
struct Pattern {
  std::array<std::array<std::int8_t, 4>, 256> pairs;
  Pattern() {
    std::mt19937 engine(12345);
    // The sum of uniforms, not std::normal_distribution: the same numbers with every standard library.
    const auto draw = [&] {
      int value = 0;
      do {
        double sum = 0;
        for (int k = 0; k < 12; ++k) sum += static_cast<double>(engine()) / 4294967296.0;
        value = static_cast<int>(std::lround((sum - 6) * 6.5));
      } while (std::abs(value) > kDescriptorRadius);
      return static_cast<std::int8_t>(value);
    };
    for (auto& pair : pairs) {
      do {
        for (auto& coordinate : pair) coordinate = draw();
      } while (pair[0] == pair[2] && pair[1] == pair[3]);
    }
  }
};

BinaryDescriptor Describe(const cv::Mat& smoothed, const Corner& corner) {
  static const Pattern pattern;
  BinaryDescriptor out{};
  const auto grey = [&](int dx, int dy) { return smoothed.ptr(corner.y + dy)[corner.x + dx]; };
  for (size_t k = 0; k < pattern.pairs.size(); ++k) {
    const auto& p = pattern.pairs[k];
    const std::uint64_t bit = grey(p[0], p[1]) < grey(p[2], p[3]) ? 1 : 0;
    out[k / 64] |= bit << (k % 64);
  }
  return out;
}

Patch CutPatch(const cv::Mat& image, const Corner& corner) {
  Patch out;
  constexpr int kHalf = kPatchSize / 2;
  auto next = out.begin();
  for (int y = corner.y - kHalf; y <= corner.y + kHalf; ++y) {
    next = std::copy_n(image.ptr(y) + corner.x - kHalf, kPatchSize, next);
  }
  return out;
}

int Difference(const cv::Mat& a, int xa, const cv::Mat& b, int xb, int y) {
  int sum = 0;
  for (int row = y - kWindowY / 2; row <= y + kWindowY / 2; ++row) {
    const std::uint8_t *pa = a.ptr(row) + xa - kWindowX / 2, *pb = b.ptr(row) + xb - kWindowX / 2;
    for (int k = 0; k < kWindowX; ++k) sum += std::abs(pa[k] - pb[k]);
  }
  return sum;
}

bool WindowFits(const cv::Mat& image, int x) { return x >= kWindowX / 2 && x + kWindowX / 2 <= image.cols; }

// The place in `b`, on the same row and from x + least to x + most, whose window looks most like that in `a`; -1 if
// another place looks about as much.
int SearchRow(const cv::Mat& a, const cv::Mat& b, int x, int y, int least, int most) {
  std::vector<int> differences;
  const int first = std::max(x + least, kWindowX / 2), last = std::min(x + most, b.cols - kWindowX / 2);
  for (int other = first; other <= last; ++other) differences.push_back(Difference(a, x, b, other, y));
  if (differences.empty()) return -1;
  const auto best = std::min_element(differences.begin(), differences.end());
  for (auto it = differences.begin(); it != differences.end(); ++it) {
    if (std::abs(it - best) > 3 && *it * kRepeated <= *best) return -1;
  }
  return first + static_cast<int>(best - differences.begin());
}

// u_R of the corner at full resolution; negative if it is not found.
double MatchRight(const ImagePyramid& left, const ImagePyramid& right, size_t level, const Corner& corner,
                  const AlignmentTemplate& patch, const FeatureOptions& options) {
  const double scale_x = left.scale_x[level], scale_y = left.scale_y[level];
  const cv::Mat &full = left.levels[0], &other = right.levels[0];
  const double u = (corner.x + 0.5) * scale_x - 0.5, v = (corner.y + 0.5) * scale_y - 0.5;
  const int x = cvRound(u), y = cvRound(v);
  if (!WindowFits(full, x) || y < kWindowY / 2 || y + kWindowY / 2 >= full.rows) return -1;
  const int most = cvRound(options.max_disparity * full.cols);
  const int x_right = SearchRow(full, other, x, y, -most, 0);
  if (x_right < 0 || std::abs(SearchRow(other, full, x_right, y, 0, most) - x) > 1) return -1;
  const double start = (u - (x - x_right) + 0.5) / scale_x - 0.5;
  const auto place = patch.Find(right.levels[level], start, corner.y, 1, true, 2);
  if (!place || place->correlation < kLeastCorrelation) return -1;
  const double u_right = (place->x + 0.5) * scale_x - 0.5;
  return u - u_right >= options.min_disparity ? u_right : -1;
}

}  // namespace

ImagePyramid::ImagePyramid(const cv::Mat& image, int count, double scale) {
  double s = 1;
  for (int level = 0; level < count; ++level, s *= scale) {
    cv::Mat resized = image;
    const cv::Size size(cvRound(image.cols / s), cvRound(image.rows / s));
    // From the level before: interpolation is smoothing enough for small steps, INTER_AREA ten times as slow.
    if (level > 0) cv::resize(levels.back(), resized, size, 0, 0, cv::INTER_LINEAR);
    scale_x.push_back(static_cast<double>(image.cols) / resized.cols);
    scale_y.push_back(static_cast<double>(image.rows) / resized.rows);
    levels.push_back(resized);
  }
}

size_t KeyframeFeatures::Bytes() const {
  return points.capacity() * sizeof(Point) + descriptors.capacity() * sizeof(BinaryDescriptor) +
         patches.capacity() * sizeof(Patch);
}

KeyframeFeatures ExtractFeatures(const ImagePyramid& left, const ImagePyramid& right, const FeatureOptions& options) {
  KeyframeFeatures out;
  double shares = 0;
  for (const double scale : left.scale_x) shares += 1 / scale;
  for (size_t level = 0; level < left.levels.size(); ++level) {
    const cv::Mat& image = left.levels[level];
    const double share = 1 / left.scale_x[level] / shares;
    cv::Mat smoothed;
    cv::GaussianBlur(image, smoothed, {7, 7}, 2);
    for (const Corner& corner : SpreadCorners(image, options.fast_threshold, cvRound(options.most * share))) {
      const Patch patch = CutPatch(image, corner);
      const double u_right = MatchRight(left, right, level, corner, AlignmentTemplate(patch), options);
      if (u_right < 0) continue;
      KeyframeFeatures::Point point;
      point.u = static_cast<float>((corner.x + 0.5) * left.scale_x[level] - 0.5);
      point.v = static_cast<float>((corner.y + 0.5) * left.scale_y[level] - 0.5);
      point.u_right = static_cast<float>(u_right);
      point.level = static_cast<std::uint8_t>(level);
      out.points.push_back(point);
      out.descriptors.push_back(Describe(smoothed, corner));
      out.patches.push_back(patch);
    }
  }
  out.points.shrink_to_fit();
  out.descriptors.shrink_to_fit();
  out.patches.shrink_to_fit();
  return out;
}

}  // namespace terse
