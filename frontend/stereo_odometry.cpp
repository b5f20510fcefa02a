#include "terse/frontend/stereo_odometry.h"

#include <stdexcept>

namespace terse {

class StereoOdometry::State {};

StereoOdometry::StereoOdometry(const StereoCamera&, const StereoOdometryOptions&) : state_(std::make_unique<State>()) {}
StereoOdometry::~StereoOdometry() = default;
StereoOdometry::StereoOdometry(StereoOdometry&&) noexcept = default;
StereoOdometry& StereoOdometry::operator=(StereoOdometry&&) noexcept = default;

OdometryStep StereoOdometry::Track(const StereoFrame&) { throw std::logic_error("not written yet"); }
std::vector<Vector<3>> StereoOdometry::TrackedPoints() const { return {}; }

std::string ToString(TrackingStatus status) {
  return status == TrackingStatus::kFirst ? "first" : status == TrackingStatus::kTracked ? "tracked" : "lost";
}

}  // namespace terse
