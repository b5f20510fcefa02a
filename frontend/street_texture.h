#pragma once
// A painted surface: grey values on a grid of texels, halved again and again for what is far away.

#include <cstdint>
#include <functional>
#include <mutex>
#include <opencv2/core/mat.hpp>
#include <vector>

namespace terse {

// What a painter paints on: grey values 0 to 255, and texels per metre.
struct StreetCanvas {
  cv::Mat1f grey;
  double texels_per_metre = 1;
  double width = 0, height = 0;  // metres; the grid may reach a little further

  // Adds smooth random values of about +-amplitude with this wavelength (metres). x0, y0: where the canvas lies in a
  // larger pattern; canvases of one seed fit together.
  void AddNoise(std::uint64_t seed, double wavelength, double amplitude, double x0 = 0, double y0 = 0);
  // Octaves from `longest` down to two texels, the amplitude times `fall` at each halving.
  void AddOctaves(std::uint64_t seed, double longest, double amplitude, double fall, double x0 = 0, double y0 = 0);
  // Metres from the top left corner.
  void Fill(double x, double y, double width, double height, double grey_value);
};

// Painted when it is first seen. Get() may be called from several threads.
class StreetTexture {
 public:
  using Painter = std::function<void(StreetCanvas&)>;
  // Metres. `contrast` scales the grey values about the middle.
  StreetTexture(double width, double height, double texels_per_metre, double contrast, Painter painter);
  double TexelsPerMetre() const { return texels_per_metre_; }

  struct Level {
    const unsigned char* grey = nullptr;
    int width = 0, height = 0;  // texels
  };
  const std::vector<Level>& Get() const;

 private:
  void Paint() const;

  double width_, height_, texels_per_metre_, contrast_;
  Painter painter_;
  mutable std::once_flag painted_;
  mutable std::vector<cv::Mat1b> images_;
  mutable std::vector<Level> levels_;
};

}  // namespace terse
