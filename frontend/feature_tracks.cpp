#include "feature_tracks.h"

#include <algorithm>

#include "lap_timer.h"
#include "track_measurement.h"

namespace terse {

void TrackWindow::Start(const SE3& T_world_camera, const StereoPyramid& images) {
  frames_.assign(1, {next_id_++, T_world_camera, true});
  tracks_.clear();
  AddCorners(images);
}

void TrackWindow::Advance(const SE3& T_world_camera, const StereoPyramid& images,
                          const std::vector<Vector<3>>& measured, const std::vector<char>& keep, OdometryTimes& times) {
  LapTimer timer;
  // Only keyframes stay in the window behind the newest frame, which is there to be tracked from.
  if (!frames_.back().keyframe) DropFrame(frames_.size() - 1);
  if (frames_.size() >= static_cast<size_t>(std::max(2, options_.window))) DropFrame(0);
  frames_.push_back({next_id_++, T_world_camera, false});
  std::vector<FeatureTrack> kept;
  for (size_t k = 0; k < tracks_.size(); ++k) {
    if (!keep[k]) continue;
    kept.push_back(std::move(tracks_[k]));
    kept.back().past.observations.push_back({frames_.back().id, measured[k]});
  }
  tracks_ = std::move(kept);
  frames_.back().keyframe = BecomesKeyframe();
  if (options_.window >= 2) Adjust();
  times.window += timer.Lap();
  if (frames_.back().keyframe) AddCorners(images);
  times.corners += timer.Lap();
}

std::vector<Vector<3>> TrackWindow::Points() const {
  std::vector<Vector<3>> points;
  for (const FeatureTrack& track : tracks_) points.push_back(track.Now());
  return points;
}

// When the tracks have moved enough to add information, or become few.
bool TrackWindow::BecomesKeyframe() const {
  constexpr double kMinFlow = 4;  // pixels, median
  if (static_cast<int>(tracks_.size()) < options_.corners / 2) return true;
  const int last = frames_[frames_.size() - 2].id;
  std::vector<double> flow;
  for (const FeatureTrack& track : tracks_) {
    const auto& observations = track.past.observations;
    if (observations.size() < 2 || observations[observations.size() - 2].frame != last) continue;
    flow.push_back((observations.back().uvu - observations[observations.size() - 2].uvu).head<2>().norm());
  }
  if (flow.empty()) return true;
  std::nth_element(flow.begin(), flow.begin() + static_cast<long>(flow.size() / 2), flow.end());
  return flow[flow.size() / 2] >= kMinFlow;
}

void TrackWindow::DropFrame(size_t index) {
  const int id = frames_[index].id;
  for (FeatureTrack& track : tracks_) {
    auto& observations = track.past.observations;
    if (index == 0) {
      while (observations.front().frame <= id && observations.size() > 1) observations.erase(observations.begin());
    } else if (observations.size() > 1 && observations.back().frame == id) {
      observations.pop_back();
    }
  }
  frames_.erase(frames_.begin() + static_cast<long>(index));
}

void TrackWindow::Adjust() {
  std::vector<SE3> poses;
  for (const Frame& frame : frames_) poses.push_back(frame.T_world_camera);
  std::vector<WindowPoint> points;
  for (const FeatureTrack& track : tracks_) {
    WindowPoint point;
    size_t frame = 0;
    for (const auto& observation : track.past.observations) {
      while (frame < frames_.size() && frames_[frame].id < observation.frame) ++frame;
      if (frame < frames_.size() && frames_[frame].id == observation.frame) {
        point.observations.push_back({static_cast<int>(frame), offset_.Corrected(observation.uvu)});
      }
    }
    if (point.observations.size() >= 2) points.push_back(std::move(point));
  }
  WindowOptions options;
  // Older poses have been given out, as motions. To move them would move the newest against the one before: measured on
  // rendered frames, twice the error from frame to frame and NEES / 6 of 4 in place of 1.
  constexpr int kAdjusted = 2;
  options.fixed = std::max(1, static_cast<int>(frames_.size()) - kAdjusted);
  const WindowOffset offset = AdjustWindow(camera_, points, options, poses);
  // Between keyframes, as in a car that stands, the window is the same again and tells nothing new.
  if (options_.estimate_disparity_offset && frames_.back().keyframe) {
    offset_.Update(offset, static_cast<int>(poses.size()));
  }
  for (size_t k = 0; k < frames_.size(); ++k) frames_[k].T_world_camera = poses[k];
}

void OffsetEstimate::Update(const WindowOffset& window, int frames) {
  // Noise of tracks in pixels, squared; the errors of a track are alike in all frames; and every observation is in as
  // many windows as there are frames.
  constexpr double kNoise = 0.25 * 0.25, kCorrelation = 3;
  const double information = window.information / (kNoise * kCorrelation * frames);
  information_ += information;
  if (information_ > 0) offset_ += information / information_ * window.step;
}

void TrackWindow::AddCorners(const StereoPyramid& images) {
  std::vector<cv::Point2f> occupied;
  for (const FeatureTrack& track : tracks_) {
    occupied.emplace_back(static_cast<float>(track.Now().x()), static_cast<float>(track.Now().y()));
  }
  CornerOptions options;
  // Some will have no disparity.
  const int missing = options_.corners - static_cast<int>(tracks_.size());
  if (missing <= 0) return;
  options.wanted = options_.corners + missing / 2;
  const std::vector<cv::Point2f> corners = BucketedCorners(images.left[0], images.left[1], occupied, options);
  for (const Vector<3>& point : MeasureDisparities(camera_, images, corners, options_)) {
    if (static_cast<int>(tracks_.size()) >= options_.corners) break;
    tracks_.push_back({{{{frames_.back().id, point}}}});
  }
}

}  // namespace terse
