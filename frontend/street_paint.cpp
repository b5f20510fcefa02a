#include "street_paint.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <string>

#include "street_random.h"

namespace terse {
namespace {

cv::Point Texel(const StreetCanvas& canvas, double x, double y) {
  return {static_cast<int>(std::lround(x * canvas.texels_per_metre)),
          static_cast<int>(std::lround(y * canvas.texels_per_metre))};
}

int Thickness(const StreetCanvas& canvas, double metres) {
  return std::max(1, static_cast<int>(std::lround(metres * canvas.texels_per_metre)));
}

void PaintWindow(StreetCanvas& canvas, StreetRandom& random, double x, double y, double width, double height) {
  const double frame = random.Uniform(0.05, 0.12);
  canvas.Fill(x - frame, y - frame, width + 2 * frame, height + 2 * frame, random.Uniform(120, 220));
  canvas.Fill(x, y, width, height, random.Uniform(20, 70));
  if (random.Chance(0.5)) {  // a curtain or a blind
    canvas.Fill(x, y, width * random.Uniform(0.2, 1), height * random.Uniform(0.2, 0.8), random.Uniform(80, 210));
  }
  if (random.Chance(0.7)) canvas.Fill(x + width * random.Uniform(0.3, 0.6), y, 0.06, height, random.Uniform(120, 220));
  if (random.Chance(0.4)) canvas.Fill(x - 0.15, y + height + frame, width + 0.3, 0.1, random.Uniform(40, 230));
}

void PaintShopSign(StreetCanvas& canvas, StreetRandom& random, double x, double y, double width) {
  const double height = random.Uniform(0.4, 0.8), ground = random.Uniform(20, 230);
  canvas.Fill(x, y, width, height, ground);
  std::string text;
  for (int k = 0; k < static_cast<int>(width / height * 1.5); ++k) text += static_cast<char>(random.Integer('A', 'Z'));
  cv::putText(canvas.grey, text, Texel(canvas, x + 0.1, y + 0.8 * height), cv::FONT_HERSHEY_SIMPLEX,
              height * canvas.texels_per_metre / 36, cv::Scalar(ground > 120 ? 30 : 225), Thickness(canvas, 0.06));
}

// Posters, pipes and cables, stains.
void PaintClutter(StreetCanvas& canvas, StreetRandom& random, int count) {
  for (int k = 0; k < count; ++k) {
    const double x = random.Uniform(0, canvas.width), y = canvas.height - random.Uniform(0, 4.5);
    switch (random.Integer(0, 3)) {
      case 0: canvas.Fill(x, y, random.Uniform(0.2, 0.8), random.Uniform(0.2, 0.9), random.Uniform(20, 240)); break;
      case 1: canvas.Fill(x, 0, random.Uniform(0.05, 0.12), canvas.height, random.Uniform(40, 200)); break;
      case 2:
        cv::circle(canvas.grey, Texel(canvas, x, y), Thickness(canvas, random.Uniform(0.05, 0.4)),
                   cv::Scalar(random.Uniform(20, 240)), random.Chance(0.5) ? cv::FILLED : Thickness(canvas, 0.06));
        break;
      default:
        cv::line(canvas.grey, Texel(canvas, x, y),
                 Texel(canvas, x + random.Uniform(-1.5, 1.5), y + random.Uniform(-1.5, 1.5)),
                 cv::Scalar(random.Uniform(20, 240)), Thickness(canvas, random.Uniform(0.03, 0.08)));
    }
  }
}

// Columns of lines every `spacing` metres, the joints of bricks, boards or stones.
void PaintJoints(StreetCanvas& canvas, StreetRandom& random, double spacing, double grey) {
  for (double y = random.Uniform(0, spacing); y < canvas.height; y += spacing) {
    canvas.Fill(0, y, canvas.width, 0.03, grey);
  }
}

double SmoothBand(double x, double low, double high, double blur) {
  return std::clamp((x - low) / blur + 0.5, 0.0, 1.0) * std::clamp((high - x) / blur + 0.5, 0.0, 1.0);
}

// Things on the road that are where they are by chance: one per cell of `cell` metres along the road at most.
struct RoadCell {
  StreetRandom random;
  double s0;
};
RoadCell CellAt(std::uint64_t seed, double s, double cell) {
  const double index = std::floor(s / cell);
  return {StreetRandom(HashMix(seed, static_cast<std::int64_t>(index))), index * cell};
}

// Repaired rectangles, manholes and dark tracks. `left`: from the middle of the road.
double RoadGrey(std::uint64_t seed, double s, double left) {
  double grey = 88;
  RoadCell patch = CellAt(HashMix(seed, 1), s, 5.0);
  if (patch.random.Chance(0.75)) {
    const double from = patch.s0 + patch.random.Uniform(0, 2.5), to = from + patch.random.Uniform(0.5, 2.5);
    const double right = patch.random.Uniform(-5, 4), width = patch.random.Uniform(0.4, 2.5);
    const double change = patch.random.Uniform(-35, 30);
    if (s > from && s < to && left > right && left < right + width) grey += change;
  }
  RoadCell manhole = CellAt(HashMix(seed, 2), s, 8.0);
  const double ds = s - manhole.s0 - manhole.random.Uniform(0.5, 7.5);
  const double dl = left - manhole.random.Uniform(-3, 3), ring = std::hypot(ds, dl);
  if (ring < 0.34) grey = ring > 0.28 ? 35 : 70 + 40 * std::sin(40 * ds) * std::sin(40 * dl);
  for (int k = 3; k < 6; ++k) {  // cracks across or along
    RoadCell crack = CellAt(HashMix(seed, k), s, 4.0);
    const double slope = crack.random.Uniform(-1.5, 1.5), at = crack.random.Uniform(0.5, 3.5);
    const double middle = crack.random.Uniform(-5, 5), reach = crack.random.Uniform(0.5, 2.0);
    const double off = s - crack.s0 - at - slope * (left - middle) - 0.15 * std::sin(5 * left);
    if (std::abs(off) < 0.035 * std::hypot(1, slope) && std::abs(left - middle) < reach) grey -= 40;
  }
  return grey;
}

double GroundGrey(std::uint64_t seed, double s, double left, double blank, double blur) {
  const double aside = std::abs(left);
  if (aside > kSidewalkEdge + 0.6) return 95;  // grass
  double grey;
  if (aside < kCurb) {
    grey = 88 + (1 - blank) * (RoadGrey(seed, s, left) - 88);
    const double dash = SmoothBand(s - 7.5 * std::floor(s / 7.5), 1, 4, blur);
    grey += (1 - blank) * 120 * dash * SmoothBand(aside, -0.07, 0.07, blur);
    grey += (1 - 0.8 * blank) * 90 * SmoothBand(aside, kLaneEdge - 0.06, kLaneEdge + 0.06, blur);
  } else {
    const double cell_s = std::floor(s / 0.8), cell_l = std::floor(left / 0.6);
    StreetRandom slab(HashMix(seed, 7, static_cast<std::int64_t>(cell_s), static_cast<std::int64_t>(cell_l)));
    grey = 125 + (1 - blank) * slab.Uniform(-22, 22);
    if (s - 0.8 * cell_s < 0.03 || left - 0.6 * cell_l < 0.03) grey -= (1 - blank) * 35;
  }
  return grey + 55 * SmoothBand(aside, kCurb - 0.08, kCurb + 0.08, blur);
}

}  // namespace

void PaintFacade(StreetCanvas& canvas, std::uint64_t seed) {
  StreetRandom random(seed);
  canvas.grey.setTo(random.Uniform(60, 190));
  canvas.AddOctaves(seed, random.Uniform(2, 5), random.Uniform(12, 24), random.Uniform(0.7, 0.95));
  if (random.Chance(0.5)) PaintJoints(canvas, random, random.Uniform(0.25, 0.6), random.Uniform(50, 170));
  const double floor = random.Uniform(2.7, 3.4), spacing = random.Uniform(1.7, 3.2);
  const double width = spacing * random.Uniform(0.4, 0.65), height = random.Uniform(1.2, 1.9);
  const bool shop = random.Chance(0.4);
  for (double top = canvas.height - floor + 0.7; top > 0.3; top -= floor) {
    const bool ground = top > canvas.height - floor;
    for (double x = spacing * random.Uniform(0.15, 0.4); x + width < canvas.width - 0.2; x += spacing) {
      if (ground && random.Chance(0.2)) {
        canvas.Fill(x, top - 0.1, random.Uniform(0.9, 1.3), 4, random.Uniform(30, 180));  // a door
        canvas.Fill(x + 0.2, top + 0.1, 0.5, random.Uniform(0.4, 1.2), random.Uniform(30, 200));
      } else if (random.Chance(0.9)) {
        const double shift = ground ? random.Uniform(-0.2, 0.2) : 0;
        PaintWindow(canvas, random, x, top + shift, width, height);
      }
    }
    if (ground && shop) {
      PaintShopSign(canvas, random, random.Uniform(0.2, 1.0), top - 0.75, canvas.width * random.Uniform(0.4, 0.8));
    }
  }
  PaintClutter(canvas, random, static_cast<int>(canvas.width * 1.2));
  canvas.Fill(0, canvas.height - random.Uniform(0.2, 0.6), canvas.width, 1, random.Uniform(50, 120));
  canvas.AddOctaves(HashMix(seed, 1), 0.4, 8, 0.9);
}

void PaintBlankWall(StreetCanvas& canvas, std::uint64_t seed) {
  StreetRandom random(seed);
  canvas.grey.setTo(random.Uniform(120, 180));
  canvas.AddOctaves(seed, 4, 5, 0.6);
}

// A side if it is long, else the front or the back.
void PaintCar(StreetCanvas& canvas, std::uint64_t seed) {
  StreetRandom random(seed);
  canvas.grey.setTo(random.Uniform(25, 220));
  canvas.AddNoise(seed, 1.0, 15);
  const double width = canvas.width, height = canvas.height, line = random.Uniform(30, 200);
  if (width > 2.5) {
    for (const double x : {0.2, 0.78}) {
      const cv::Point hub = Texel(canvas, x * width, height - 0.15);
      cv::circle(canvas.grey, hub, Thickness(canvas, 0.34), cv::Scalar(20), cv::FILLED);
      cv::circle(canvas.grey, hub, Thickness(canvas, 0.2), cv::Scalar(random.Uniform(90, 200)), cv::FILLED);
    }
    for (const double x : {0.35, 0.6}) canvas.Fill(x * width, 0, 0.03, height, line);
    for (const double x : {0.38, 0.63}) canvas.Fill(x * width, 0.25 * height, 0.2, 0.05, line);
  } else if (height < 1.3) {
    canvas.Fill(width / 2 - 0.26, 0.55 * height, 0.52, 0.11, 225);
    canvas.Fill(0, height - 0.25, width, 0.25, random.Uniform(25, 60));
  }
  canvas.Fill(0, 0.2 * height, 0.3, 0.14, 235);
  canvas.Fill(width - 0.3, 0.2 * height, 0.3, 0.14, random.Uniform(90, 235));
}

void PaintCarWindows(StreetCanvas& canvas, std::uint64_t seed) {
  StreetRandom random(seed);
  canvas.grey.setTo(random.Uniform(60, 200));
  for (double x = 0.1; x < canvas.width - 0.3; x += 0.95) canvas.Fill(x, 0.08, 0.85, canvas.height, 35);
  canvas.AddOctaves(seed, 0.8, 18, 0.7);
}

void PaintLeaves(StreetCanvas& canvas, std::uint64_t seed) {
  StreetRandom random(seed);
  canvas.grey.setTo(random.Uniform(60, 95));
  canvas.AddOctaves(seed, 1.2, 24, 0.95);
}

void PaintPost(StreetCanvas& canvas, std::uint64_t seed) {
  StreetRandom random(seed);
  canvas.grey.setTo(random.Uniform(40, 160));
  canvas.AddOctaves(seed, 0.8, 20, 0.8);
  for (int k = 0; k < 4; ++k) {
    canvas.Fill(0, canvas.height - random.Uniform(0, 3), 9, random.Uniform(0.05, 0.5), random.Uniform(20, 230));
  }
}

void PaintSign(StreetCanvas& canvas, std::uint64_t seed) {
  StreetRandom random(seed);
  const double ground = random.Uniform(40, 220);
  canvas.grey.setTo(ground);
  canvas.Fill(0.05, 0.05, canvas.width - 0.1, canvas.height - 0.1, random.Chance(0.5) ? 230 : 30);
  PaintClutter(canvas, random, 6);
}

void PaintSky(StreetCanvas& canvas, std::uint64_t seed) {
  canvas.grey.setTo(215);
  canvas.AddOctaves(seed, 400, 14, 0.7);
}

void PaintGround(StreetCanvas& canvas, std::uint64_t seed, const StreetPath& path, double x0, double y0,
                 const std::function<double(double)>& blank) {
  // Where the texels lie along the road changes smoothly: computed on a coarse grid.
  constexpr double kGrid = 0.5;
  const int columns = static_cast<int>(canvas.width / kGrid) + 3, rows = static_cast<int>(canvas.height / kGrid) + 3;
  cv::Mat2d stations(rows, columns);
  const double middle_s = path.Nearest(x0 + canvas.width / 2, y0 + canvas.height / 2).s;
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const StreetPath::Station at = path.Nearest(x0 + kGrid * column, y0 + kGrid * row);
      // One lap more or less, so that the grid is continuous where the lap closes.
      const double lap = path.Length() * std::round((middle_s - at.s) / path.Length());
      stations(row, column) = {at.s + lap, at.left - kRoadMiddle};
    }
  }
  cv::Mat1f wear(canvas.grey.size());
  for (int y = 0; y < canvas.grey.rows; ++y) {
    const double gy = (y + 0.5) / canvas.texels_per_metre / kGrid;
    const int row = std::min(static_cast<int>(gy), rows - 2);
    for (int x = 0; x < canvas.grey.cols; ++x) {
      const double gx = (x + 0.5) / canvas.texels_per_metre / kGrid;
      const int column = std::min(static_cast<int>(gx), columns - 2);
      const double wx = gx - column, wy = gy - row;
      const cv::Vec2d at = (1 - wy) * ((1 - wx) * stations(row, column) + wx * stations(row, column + 1)) +
                           wy * ((1 - wx) * stations(row + 1, column) + wx * stations(row + 1, column + 1));
      const double s = at[0] - path.Length() * std::floor(at[0] / path.Length()), worn = 1 - blank(s);
      canvas.grey(y, x) = static_cast<float>(GroundGrey(seed, s, at[1], 1 - worn, 1 / canvas.texels_per_metre));
      wear(y, x) = static_cast<float>(0.2 + 0.8 * worn);
    }
  }
  StreetCanvas noise{cv::Mat1f(canvas.grey.size(), 0.0f), canvas.texels_per_metre, canvas.width, canvas.height};
  noise.AddOctaves(HashMix(seed, 8), 4, 12, 0.9, x0, y0);
  canvas.grey += wear.mul(noise.grey);
}

}  // namespace terse
