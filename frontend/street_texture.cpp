#include "street_texture.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "street_random.h"

namespace terse {
namespace {

constexpr double kMiddleGrey = 105;

// Where the texels of a row or column lie between the nodes of the noise.
struct Lattice {
  std::vector<int> node;      // counted from first
  std::vector<float> weight;  // of the next node
  std::int64_t first = 0;
  int nodes = 0;

  Lattice(int texels, double texels_per_metre, double origin, double wavelength) {
    first = static_cast<std::int64_t>(std::floor(origin / wavelength));
    for (int k = 0; k < texels; ++k) {
      const double at = (origin + (k + 0.5) / texels_per_metre) / wavelength - static_cast<double>(first);
      const double w = at - std::floor(at);
      node.push_back(static_cast<int>(at));
      weight.push_back(static_cast<float>(w * w * (3 - 2 * w)));
    }
    nodes = node.back() + 2;
  }
};

}  // namespace

void StreetCanvas::AddNoise(std::uint64_t seed, double wavelength, double amplitude, double x0, double y0) {
  const Lattice columns(grey.cols, texels_per_metre, x0, wavelength), rows(grey.rows, texels_per_metre, y0, wavelength);
  const std::uint64_t octave = static_cast<std::uint64_t>(std::llround(1e6 * wavelength));
  const auto lattice_row = [&](int row) {
    std::vector<float> values;
    for (int k = 0; k < columns.nodes; ++k) {
      StreetRandom random(HashMix(seed, octave, columns.first + k, rows.first + row));
      values.push_back(static_cast<float>(random.Uniform(-amplitude, amplitude)));
    }
    return values;
  };
  std::vector<float> above, below, blended(static_cast<std::size_t>(columns.nodes));
  int row = -2;
  for (int y = 0; y < grey.rows; ++y) {
    const auto index = static_cast<std::size_t>(y);
    if (rows.node[index] != row) {
      above = rows.node[index] == row + 1 ? below : lattice_row(rows.node[index]);
      row = rows.node[index];
      below = lattice_row(row + 1);
    }
    for (std::size_t k = 0; k < blended.size(); ++k) blended[k] = above[k] + rows.weight[index] * (below[k] - above[k]);
    float* out = grey[y];
    for (std::size_t x = 0; x < columns.node.size(); ++x) {
      const float* at = &blended[static_cast<std::size_t>(columns.node[x])];
      out[x] += at[0] + columns.weight[x] * (at[1] - at[0]);
    }
  }
}

void StreetCanvas::AddOctaves(std::uint64_t seed, double longest, double amplitude, double fall, double x0, double y0) {
  for (double wavelength = longest; wavelength * texels_per_metre >= 2; wavelength /= 2, amplitude *= fall) {
    AddNoise(seed, wavelength, amplitude, x0, y0);
  }
}

void StreetCanvas::Fill(double x, double y, double width, double height, double grey_value) {
  const auto texel = [&](double metres) { return static_cast<int>(std::lround(metres * texels_per_metre)); };
  const cv::Rect area(texel(x), texel(y), texel(x + width) - texel(x), texel(y + height) - texel(y));
  const cv::Rect inside = area & cv::Rect(0, 0, grey.cols, grey.rows);
  if (inside.area() > 0) grey(inside).setTo(grey_value);
}

StreetTexture::StreetTexture(double width, double height, double texels_per_metre, double contrast, Painter painter)
    : width_(width),
      height_(height),
      texels_per_metre_(texels_per_metre),
      contrast_(contrast),
      painter_(std::move(painter)) {}

const std::vector<StreetTexture::Level>& StreetTexture::Get() const {
  std::call_once(painted_, [this] { Paint(); });
  return levels_;
}

void StreetTexture::Paint() const {
  // Rounded up to what can be halved exactly as often as makes sense.
  const double smaller = std::min(width_, height_) * texels_per_metre_;
  const int halvings = std::clamp(static_cast<int>(std::log2(smaller)) - 1, 0, 6);
  const auto texels = [&](double metres) {
    return std::max(2, static_cast<int>(std::ceil(std::ldexp(metres * texels_per_metre_, -halvings))) << halvings);
  };
  StreetCanvas canvas{cv::Mat1f(texels(height_), texels(width_), 0.0f), texels_per_metre_, width_, height_};
  painter_(canvas);
  cv::Mat1b image;
  canvas.grey.convertTo(image, CV_8U, contrast_, (1 - contrast_) * kMiddleGrey);
  images_.push_back(image);
  for (int k = 0; k < halvings; ++k) {
    cv::Mat1b half;
    cv::resize(image, half, {image.cols / 2, image.rows / 2}, 0, 0, cv::INTER_AREA);
    images_.push_back(image = half);
  }
  for (const cv::Mat1b& level : images_) levels_.push_back({level.data, level.cols, level.rows});
}

}  // namespace terse
