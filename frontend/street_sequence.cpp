#include "terse/frontend/street_sequence.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "street_paint.h"
#include "street_random.h"
#include "street_renderer.h"

namespace terse {
namespace {

constexpr double kMostTurn = 2.25 * M_PI / 180;   // radians per frame, of the path alone
constexpr double kRampFrames = 5;                 // over which a corner tightens
constexpr double kRate = 10;                      // frames per second
constexpr double kFocalLength = 707.0912 / 1226;  // KITTI's, per pixel of width
constexpr double kBaseline = 0.5371657;           // metres
constexpr double kHeight = 1.65;                  // of the camera over the road, metres

StereoCamera MakeCamera(const StreetOptions& options) {
  const double f = kFocalLength * options.width;
  return {f, f, 0.491 * options.width, 0.495 * options.height, kBaseline, options.width, options.height};
}

void Check(const StreetOptions& options) {
  const auto require = [](bool condition, const std::string& what) {
    if (!condition) throw std::invalid_argument(what);
  };
  require(options.frames >= 1 && options.laps >= 1, "there must be at least one frame and one lap");
  require(options.width >= 16 && options.height >= 16, "an image has at least 16x16 pixels");
  require(options.metres_per_frame > 0 && options.metres_per_frame <= 5,
          "the speed must be above 0 and at most 5 metres per frame");
  require(options.noise >= 0 && options.noise <= 50, "the noise must be 0 to 50 grey levels");
  require(options.contrast >= 0 && options.contrast <= 1, "the contrast must be 0 to 1");
  require(options.exposure >= 0 && options.exposure < 1, "the exposure must vary by less than 1");
  require(std::abs(options.disparity_offset) <= 5, "the disparity offset must be at most 5 pixels");
  const long least = static_cast<long>(StreetSequence::LeastFramesPerLap(options.metres_per_frame)) * options.laps;
  require(options.frames >= least, std::to_string(options.laps) + " laps need at least " + std::to_string(least) +
                                       " frames, as the camera turns by at most 2.5 degrees per frame");
}

StreetPath MakePath(const StreetOptions& options) {
  const double v = options.metres_per_frame;
  return StreetPath(options.frames * v / options.laps, kMostTurn / v, kRampFrames * v);
}

// How the car strays from the path, all of it slow enough to add little to the turn.
double Stray(double frame, double frames_per_lap) {
  return 0.3 * std::sin(2 * M_PI * frame / (1.37 * frames_per_lap) + 1) +
         0.12 * std::sin(2 * M_PI * frame / (0.57 * frames_per_lap));
}

// World: x and y on the road, z up. Camera: x right, y down, z ahead.
SE3 CameraOnStreet(const StreetPath& path, const StreetOptions& options, double frame) {
  const double frames_per_lap = static_cast<double>(options.frames) / options.laps;
  const auto position = [&](double k) {
    const double steady = k + 0.4 * std::sin(2 * M_PI * k / (0.73 * frames_per_lap));
    const StreetPoint p = path.At(steady * options.metres_per_frame);
    const double left = Stray(k, frames_per_lap);
    return Vector<2>(p.x - left * std::sin(p.heading), p.y + left * std::cos(p.heading));
  };
  const Vector<2> p = position(frame), ahead = position(frame + 0.05) - position(frame - 0.05);
  const double heading = std::atan2(ahead.y(), ahead.x());
  const double height = kHeight + 0.012 * std::sin(0.37 * frame) + 0.006 * std::sin(1.3 * frame);
  Matrix<3, 3> R;
  R << std::sin(heading), 0, std::cos(heading),  //
      -std::cos(heading), 0, std::sin(heading),  //
      0, -1, 0;
  const Vector<3> shake = {0.0035 * std::sin(0.41 * frame + 1) + 0.001 * std::sin(1.7 * frame),
                           0.001 * std::sin(0.23 * frame), 0.003 * std::sin(0.29 * frame + 2)};
  return SE3(SO3(Quaternion(R)) * SO3::Exp(shake), {p.x(), p.y(), height});
}

// Grey values of many normal deviates, drawn from at random.
class NoiseTable {
 public:
  explicit NoiseTable(double sigma) : values_(1 << 16) {
    StreetRandom random(7);
    for (std::size_t k = 0; k < values_.size(); k += 2) {
      const double r = sigma * std::sqrt(-2 * std::log(1 - random.Uniform(0, 1))), angle = random.Uniform(0, 2 * M_PI);
      values_[k] = static_cast<float>(r * std::cos(angle));
      values_[k + 1] = static_cast<float>(r * std::sin(angle));
    }
  }
  // Sixteen bits of a draw choose one value.
  cv::Mat1b Expose(const cv::Mat1f& clean, float gain, std::uint64_t seed) const {
    StreetRandom random(seed);
    cv::Mat1b out(clean.size());
    for (int row = 0; row < clean.rows; ++row) {
      const float* in = clean[row];
      unsigned char* to = out[row];
      std::uint64_t bits = 0;
      for (int column = 0; column < clean.cols; ++column, bits >>= 16) {
        if (column % 4 == 0) bits = random.Bits();
        const float grey = gain * in[column] + values_[bits & 0xffff] + 0.5f;
        to[column] = static_cast<unsigned char>(std::min(std::max(grey, 0.0f), 255.0f));
      }
    }
    return out;
  }

 private:
  std::vector<float> values_;
};

}  // namespace

struct StreetSequence::Data {
  StreetOptions options;
  StereoCamera camera;
  StreetPath path;
  StreetScene scene;
  NoiseTable noise;
  SE3 T_first_street;  // from the street's frame to that of the first camera

  explicit Data(const StreetOptions& given)
      : options(given),
        camera(MakeCamera(given)),
        path(MakePath(given)),
        scene(path,
              {given.contrast, std::min(60.0, camera.fx / 12), given.featureless_stretches, given.seed, given.twins}),
        noise(given.noise),
        T_first_street(CameraOnStreet(path, given, 0).Inverse()) {}

  void CheckFrame(int frame) const {
    if (frame >= 0 && frame < options.frames) return;
    throw std::invalid_argument("the sequence has no frame " + std::to_string(frame));
  }
  StreetView View(bool right) const {
    return {camera.fx, camera.fy,    camera.cx - (right ? options.disparity_offset : 0),
            camera.cy, camera.width, camera.height};
  }
  SE3 T_street_camera(int frame, bool right) const {
    const SE3 T_street_left = CameraOnStreet(path, options, frame);
    return right ? T_street_left * SE3(SO3(), {camera.baseline, 0, 0}) : T_street_left;
  }
  cv::Mat1f Clean(int frame, bool right) const {
    return RenderStreet(scene, View(right), T_street_camera(frame, right));
  }
  cv::Mat1b Exposed(int frame, bool right) const {
    const double gain = 1 + options.exposure * std::sin(0.061 * frame) * std::cos(0.017 * frame + 0.5);
    const double own = right ? 1.02 : 1;  // no two cameras are the same
    return noise.Expose(Clean(frame, right), static_cast<float>(gain * own), HashMix(options.seed, frame, right));
  }
};

StreetSequence::StreetSequence(const StreetOptions& options) {
  Check(options);
  data_ = std::make_unique<Data>(options);
}
StreetSequence::~StreetSequence() = default;
StreetSequence::StreetSequence(StreetSequence&&) noexcept = default;
StreetSequence& StreetSequence::operator=(StreetSequence&&) noexcept = default;

int StreetSequence::LeastFramesPerLap(double metres_per_frame) {
  const double v = metres_per_frame;
  return static_cast<int>(std::ceil(4 * StreetPath::CornerLength(kMostTurn / v, kRampFrames * v) / v));
}

const StreetOptions& StreetSequence::Options() const { return data_->options; }
const StereoCamera& StreetSequence::Camera() const { return data_->camera; }

double StreetSequence::Time(int frame) const {
  data_->CheckFrame(frame);
  return frame / kRate;
}

SE3 StreetSequence::T_world_camera(int frame) const {
  data_->CheckFrame(frame);
  return data_->T_first_street * data_->T_street_camera(frame, false);
}

StereoFrame StreetSequence::Render(int frame) const {
  return {frame, Time(frame), data_->Exposed(frame, false), data_->Exposed(frame, true)};
}

StereoFrame StreetSequence::RenderClean(int frame) const {
  return {frame, Time(frame), data_->Clean(frame, false), data_->Clean(frame, true)};
}

cv::Mat StreetSequence::RenderDepth(int frame) const {
  data_->CheckFrame(frame);
  return RenderStreetDepth(data_->scene, data_->View(false), data_->T_street_camera(frame, false));
}

}  // namespace terse
