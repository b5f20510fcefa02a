#include "terse/frontend/stereo_odometry.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "feature_tracks.h"
#include "frame_quality.h"
#include "lap_timer.h"
#include "terse/core/log_message.h"
#include "track_measurement.h"

namespace terse {
namespace {

constexpr int kMaxGap = 3;        // frames in a row that may be lost before tracking starts afresh
constexpr int kMaxRepeats = 2;    // equal images in a row while moving; more: the camera is frozen
constexpr double kMoving = 0.2;   // metres per frame: no vehicle stops or doubles this within one
constexpr double kBlurred = 0.6;  // of the usual sharpness

SE3 Power(const SE3& T, double exponent) { return SE3::Exp(exponent * T.Log()); }

}  // namespace

class StereoOdometry::State {
 public:
  State(const StereoCamera& camera, const StereoOdometryOptions& options)
      : camera_(camera), options_(options), window_(camera, options) {}

  OdometryStep Track(const StereoFrame& frame);
  const StereoOdometryOptions& Options() const { return options_; }
  const OffsetEstimate& Offset() const { return window_.Offset(); }
  std::vector<Vector<3>> TrackedPoints() const { return started_ ? window_.Points() : std::vector<Vector<3>>(); }

 private:
  struct Motion {
    StereoMotion motion;  // from the reference frame
    std::vector<StereoMatch> matches;
    std::vector<Vector<3>> points;  // as measured, of the window's points
    std::vector<char> inlier;
  };

  void CheckFrame(const StereoFrame& frame) const;
  OdometryStep TrackFrame(const StereoPyramid& images, OdometryStep step);
  OdometryStep Repeated(OdometryStep step) const;
  OdometryStep Lost(OdometryStep step, const StereoPyramid& images, const std::string& reason, bool restart);
  std::vector<SE3> Candidates() const;
  double Speed() const { return velocity_ ? velocity_->Translation().norm() : 0; }
  std::optional<Motion> MeasureMotion(const StereoPyramid& images, const SE3& predicted, int levels,
                                      OdometryStep& step) const;
  bool Plausible(const SE3& T_reference_current) const;
  Matrix<6, 6> CovarianceOf(const Motion& motion, OdometryTimes& times);
  Matrix<6, 6> LostCovariance() const;

  StereoCamera camera_;
  StereoOdometryOptions options_;
  bool started_ = false;
  cv::Mat previous_left_;
  StereoPyramid reference_;  // of the last frame that was tracked, the window's newest
  TrackWindow window_;
  SE3 T_world_previous_;         // the composition of all motions that were returned
  std::optional<SE3> velocity_;  // motion in one frame
  int gap_ = 0;                  // frames lost since the reference
  int repeats_ = 0;              // equal images in a row
  std::uint64_t measured_ = 0;   // motions whose covariance was taken: seeds of Monte Carlo
  FrameQuality usual_;           // running mean over tracked frames
};

OdometryStep StereoOdometry::State::Track(const StereoFrame& frame) {
  CheckFrame(frame);
  OdometryStep step;
  // A frame that shows nothing is like the next: a covered camera is not one that stands still.
  const bool tracking = started_ && gap_ == 0 && static_cast<int>(window_.Points().size()) >= options_.min_inliers;
  const bool repeated = started_ && SameImage(frame.left, previous_left_);
  repeats_ = repeated ? repeats_ + 1 : 0;
  const bool frozen = repeats_ > kMaxRepeats && Speed() > kMoving;
  if (tracking && repeated && !frozen) return Repeated(std::move(step));
  LapTimer timer;
  const StereoPyramid images = BuildPyramids(frame);
  step.times.pyramids = timer.Lap();
  if (frozen) return Lost(std::move(step), images, "frozen image", false);
  const FrameQuality quality = MeasureQuality(frame.left), right_quality = MeasureQuality(frame.right);
  previous_left_ = images.left.front();  // a copy
  if (!started_) {
    window_.Start(SE3(), images);
    reference_ = images;
    usual_ = quality;
    started_ = true;
    step.keyframe = true;
    step.times.corners = timer.Lap();
    return step;
  }
  if (quality.Dark()) return Lost(std::move(step), images, "dark", false);
  if (quality.Blank() || right_quality.Blank()) return Lost(std::move(step), images, "blank", false);
  const bool blurred = quality.sharpness < kBlurred * usual_.sharpness;
  step = TrackFrame(images, std::move(step));
  if (step.status == TrackingStatus::kLost) {
    const std::string reason = blurred ? "blurred" : step.reason;
    return Lost(std::move(step), images, reason, !blurred);
  }
  if (blurred) step.reason = "blurred";
  usual_.sharpness += 0.1 * (quality.sharpness - usual_.sharpness);
  return step;
}

void StereoOdometry::State::CheckFrame(const StereoFrame& frame) const {
  const cv::Size size(camera_.width, camera_.height);
  for (const cv::Mat* image : {&frame.left, &frame.right}) {
    if (image->type() != CV_8UC1) throw std::invalid_argument("stereo odometry needs 8-bit grey images");
    if (image->size() != size) throw std::invalid_argument("an image is not as large as the stereo camera says");
  }
}

OdometryStep StereoOdometry::State::Repeated(OdometryStep step) const {
  step.status = TrackingStatus::kTracked;
  step.reason = "repeated frame";
  step.tracked = step.inliers = static_cast<int>(window_.Points().size());
  step.residual_scale = options_.motion.min_residual_scale;
  step.covariance.diagonal().head<3>().setConstant(std::pow(2 * options_.motion.sigma_rho_floor, 2));
  step.covariance.diagonal().tail<3>().setConstant(std::pow(2 * options_.motion.sigma_phi_floor, 2));
  return step;
}

// Constant velocity, standing still, and a frame or two dropped; without a velocity, forwards at several speeds.
std::vector<SE3> StereoOdometry::State::Candidates() const {
  std::vector<SE3> candidates;
  if (velocity_) {
    for (const double frames : {1.0, 2.0, 3.0}) candidates.push_back(Power(*velocity_, frames + gap_));
  }
  candidates.emplace_back();
  if (!velocity_) {
    for (const double metres : {0.3, 0.6, 1.0, 1.5, 2.2, 3.0, 4.0}) candidates.push_back(SE3(SO3(), {0, 0, metres}));
  }
  return candidates;
}

std::optional<StereoOdometry::State::Motion> StereoOdometry::State::MeasureMotion(const StereoPyramid& images,
                                                                                  const SE3& predicted, int levels,
                                                                                  OdometryStep& step) const {
  const std::vector<Vector<3>> points = window_.Points();
  TrackMeasurement measured =
      MeasureTracks(camera_, reference_, images, points, predicted, levels, options_, step.times);
  LapTimer timer;
  std::vector<StereoMatch> matches;
  std::vector<size_t> index;
  for (size_t k = 0; k < points.size(); ++k) {
    if (!measured.ok[k]) continue;
    matches.push_back({window_.Offset().Corrected(points[k]), window_.Offset().Corrected(measured.uvu[k])});
    index.push_back(k);
  }
  step.tracked = static_cast<int>(matches.size());
  std::optional<Motion> result;
  const auto initial = InitialMotion(camera_, matches);
  if (initial) {
    StereoMotionOptions options = options_.motion;
    options.min_inliers = std::max(options.min_inliers, options_.min_inliers);
    auto motion = EstimateStereoMotion(camera_, matches, options, initial->T_a_b);
    if (motion) {
      result = Motion{*motion, matches, measured.uvu, std::vector<char>(points.size(), 0)};
      for (size_t i = 0; i < index.size(); ++i) result->inlier[index[i]] = motion->inlier[i];
    }
  }
  step.times.motion += timer.Lap();
  return result;
}

// Whether a camera that moved as before can have moved so.
bool StereoOdometry::State::Plausible(const SE3& T_reference_current) const {
  const double frames = gap_ + 1;
  if (T_reference_current.Angle() > options_.max_angle * frames) return false;
  const SE3 predicted = Power(velocity_.value_or(SE3()), frames);
  const double difference = (T_reference_current.Translation() - predicted.Translation()).norm();
  const double speed = velocity_ ? velocity_->Translation().norm() : 4;  // metres per frame: any car's
  return difference <= options_.max_acceleration * frames + 2 * speed;   // two frames dropped
}

Matrix<6, 6> StereoOdometry::State::CovarianceOf(const Motion& motion, OdometryTimes& times) {
  Matrix<6, 6> covariance = motion.motion.covariance;
  if (options_.covariance == MotionCovariance::kMonteCarlo) {
    LapTimer timer;
    const auto sampled =
        MonteCarloCovariance(camera_, motion.matches, motion.motion, options_.monte_carlo, ++measured_);
    if (sampled) covariance = *sampled;
    times.motion += timer.Lap();
  }
  const Vector<6>& J_motion_offset = motion.motion.J_motion_offset;
  return covariance + window_.Offset().Variance() * J_motion_offset * J_motion_offset.transpose();
}

Matrix<6, 6> StereoOdometry::State::LostCovariance() const {
  const SE3 motion = velocity_.value_or(SE3());
  const double rho = std::max(options_.lost_sigma_rho, options_.lost_sigma_part * motion.Translation().norm());
  const double phi = std::max(options_.lost_sigma_phi, options_.lost_sigma_part * motion.Angle());
  Vector<6> sigma;
  sigma << rho, rho, rho, phi, phi, phi;
  return sigma.cwiseAbs2().asDiagonal();
}

OdometryStep StereoOdometry::State::TrackFrame(const StereoPyramid& images, OdometryStep step) {
  LapTimer timer;
  const std::vector<SE3> candidates = Candidates();
  const size_t chosen = ChooseMotion(camera_, reference_, images, window_.Points(), candidates);
  step.times.tracking += timer.Lap();
  auto motion = MeasureMotion(images, candidates[chosen], kFlowLevels, step);
  // From a poor start many tracks are lost: with the motion known they are found.
  const int points = static_cast<int>(window_.Points().size());
  if (motion && motion->motion.inliers < points / 3) {
    auto again = MeasureMotion(images, motion->motion.T_a_b, 2, step);
    if (again && again->motion.inliers > motion->motion.inliers) motion = std::move(again);
  }
  step.status = TrackingStatus::kLost;
  if (!motion) {
    step.reason = step.tracked < options_.min_inliers ? "few points" : "no consistent motion";
    return step;
  }
  step.inliers = motion->motion.inliers;
  step.residual_scale = motion->motion.residual_scale;
  if (!Plausible(motion->motion.T_a_b) || step.inliers < step.tracked / 4) {
    step.reason = "motion jump";
    return step;
  }
  const SE3 T_world_current = window_.Newest().T_world_camera * motion->motion.T_a_b;
  window_.Advance(T_world_current, images, motion->points, motion->inlier, step.times);
  reference_ = images;
  step.status = TrackingStatus::kTracked;
  step.keyframe = window_.Newest().keyframe;
  step.T_previous_current = T_world_previous_.Inverse() * window_.Newest().T_world_camera;
  T_world_previous_ = window_.Newest().T_world_camera;
  double frames = gap_ + 1;
  const double stretched = motion->motion.T_a_b.Translation().norm() / (frames * std::max(Speed(), 1e-9));
  if (Speed() > kMoving && stretched > 1.6) {
    step.reason = "frames dropped before";
    frames *= std::round(stretched);
  }
  velocity_ = Power(motion->motion.T_a_b, 1.0 / frames);
  step.covariance = CovarianceOf(*motion, step.times);
  if (gap_ > 0) {
    // The motion since the reference is known, that since the previous frame is not: that one was lost.
    step.covariance = step.covariance + LostCovariance();
    step.reason = "recovered";
  }
  gap_ = 0;
  return step;
}

OdometryStep StereoOdometry::State::Lost(OdometryStep step, const StereoPyramid& images, const std::string& reason,
                                         bool restart) {
  step.status = TrackingStatus::kLost;
  step.reason = reason;
  step.keyframe = false;
  step.T_previous_current = velocity_.value_or(SE3());
  step.covariance = LostCovariance();
  T_world_previous_ = T_world_previous_ * step.T_previous_current;
  ++gap_;
  if (restart || gap_ > kMaxGap) {
    LapTimer timer;
    window_.Start(T_world_previous_, images);
    reference_ = images;
    gap_ = 0;
    step.keyframe = true;
    step.times.corners += timer.Lap();
  }
  return step;
}

StereoOdometry::StereoOdometry(const StereoCamera& camera, const StereoOdometryOptions& options) {
  if (!(camera.fx > 0 && camera.fy > 0 && camera.baseline > 0)) {
    throw std::invalid_argument("a stereo camera needs positive focal lengths and baseline");
  }
  if (camera.width < 64 || camera.height < 64) throw std::invalid_argument("a stereo camera's images are too small");
  if (options.corners < options.min_inliers || options.min_inliers < 4) {
    throw std::invalid_argument("stereo odometry needs at least 4 inliers, and as many corners as inliers");
  }
  const bool valid = options.forward_backward > 0 && options.circle > 0 && options.min_disparity > 0 &&
                     options.max_disparity > 0 && options.max_disparity <= 1 && options.disparity_offset_sigma > 0 &&
                     options.max_angle > 0 && options.max_acceleration > 0 && options.motion.huber > 0 &&
                     options.monte_carlo.sigma > 0 && options.monte_carlo.samples >= 8;
  if (!valid) throw std::invalid_argument("stereo odometry options: a number is out of its domain");
  state_ = std::make_unique<State>(camera, options);
}
StereoOdometry::~StereoOdometry() = default;
StereoOdometry::StereoOdometry(StereoOdometry&&) noexcept = default;
StereoOdometry& StereoOdometry::operator=(StereoOdometry&&) noexcept = default;

OdometryStep StereoOdometry::Track(const StereoFrame& frame) {
  OdometryStep step = state_->Track(frame);
  const LogSink& log = state_->Options().log;
  if (step.status == TrackingStatus::kLost) {
    internal::Log(log, LogLevel::kWarning, "frame ", frame.index, " lost: ", step.reason, "; ", step.tracked,
                  " tracks, ", step.inliers, " agree; constant velocity instead");
  } else {
    internal::Log(log, step.reason.empty() ? LogLevel::kDebug : LogLevel::kInfo, "frame ", frame.index, " ",
                  ToString(step.status), step.keyframe ? ", keyframe" : "", ": ", step.tracked, " tracks, ",
                  step.inliers, " agree to ", step.residual_scale, " px", step.reason.empty() ? "" : "; ", step.reason);
  }
  return step;
}
double StereoOdometry::DisparityOffset() const { return state_->Offset().Offset(); }
double StereoOdometry::DisparityOffsetSigma() const { return std::sqrt(state_->Offset().Variance()); }
std::vector<Vector<3>> StereoOdometry::TrackedPoints() const { return state_->TrackedPoints(); }

std::string ToString(TrackingStatus status) {
  return status == TrackingStatus::kFirst ? "first" : status == TrackingStatus::kTracked ? "tracked" : "lost";
}

}  // namespace terse
