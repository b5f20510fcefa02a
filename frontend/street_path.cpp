#include "street_path.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace terse {
namespace {

constexpr double kCorner = M_PI / 2;
constexpr double kLongSide = 0.3;  // of what the corners leave of a lap; the short sides get 0.2 each

}  // namespace

double StreetPath::CornerLength(double curvature, double ramp) { return kCorner / curvature + ramp; }

StreetPath::StreetPath(double length, double curvature, double ramp) : length_(length) {
  const double corner = CornerLength(curvature, ramp), straight = length - 4 * corner;
  if (straight < 0) throw std::invalid_argument("StreetPath: the corners are longer than the lap");
  const double sides[2] = {kLongSide * straight, straight / 2 - kLongSide * straight};
  const auto curvature_at = [&](double s) {
    for (int k = 0; k < 4; ++k) {
      const double in_corner = s - sides[k % 2];
      if (in_corner < 0) return 0.0;
      if (in_corner < corner) return curvature * std::min({1.0, in_corner / ramp, (corner - in_corner) / ramp});
      s = in_corner - corner;
    }
    return 0.0;
  };
  const int steps = static_cast<int>(std::ceil(length / 0.05));
  step_ = length / steps;
  StreetPoint p;
  points_.push_back(p);
  for (int k = 0; k < steps; ++k) {
    const double turn = curvature_at((k + 0.5) * step_) * step_;
    p.x += step_ * std::cos(p.heading + turn / 2);
    p.y += step_ * std::sin(p.heading + turn / 2);
    p.heading += turn;
    points_.push_back(p);
  }
  // The last millimetres that the steps leave open.
  for (int k = 0; k <= steps; ++k) {
    StreetPoint& q = points_[static_cast<std::size_t>(k)];
    const double share = static_cast<double>(k) / steps;
    q.x -= share * p.x;
    q.y -= share * p.y;
    q.heading += share * (4 * kCorner - p.heading);
  }
}

StreetPoint StreetPath::At(double s) const {
  const double steps = (s - length_ * std::floor(s / length_)) / step_;
  const std::size_t k = std::min(static_cast<std::size_t>(steps), points_.size() - 2);
  const double w = steps - static_cast<double>(k);
  const StreetPoint &a = points_[k], &b = points_[k + 1];
  return {a.x + w * (b.x - a.x), a.y + w * (b.y - a.y), a.heading + w * (b.heading - a.heading)};
}

StreetPath::Station StreetPath::Nearest(double x, double y) const {
  const auto square = [&](std::size_t k) {
    const double dx = points_[k].x - x, dy = points_[k].y - y;
    return dx * dx + dy * dy;
  };
  constexpr std::size_t kStride = 16;
  std::size_t nearest = 0;
  double best = std::numeric_limits<double>::infinity();
  for (std::size_t k = 0; k + 1 < points_.size(); k += kStride) {
    if (square(k) < best) best = square(nearest = k);
  }
  const std::size_t coarse = nearest;
  for (std::size_t k = coarse - std::min(coarse, kStride); k + 1 < points_.size() && k < coarse + kStride; ++k) {
    if (square(k) < best) best = square(nearest = k);
  }
  const StreetPoint& p = points_[nearest];
  const double ahead = std::cos(p.heading) * (x - p.x) + std::sin(p.heading) * (y - p.y);
  const double left = std::cos(p.heading) * (y - p.y) - std::sin(p.heading) * (x - p.x);
  return {step_ * static_cast<double>(nearest) + ahead, left};
}

}  // namespace terse
