#pragma once
// A pose and its covariance as geometry_msgs/PoseWithCovariance holds them: docs/howto/ros2.md.
//
// Templates over the message, so that the library needs no ROS. The message's covariance is 6x6, row by row, in the
// order x y z, rotation about X, Y, Z: position and rotation along the axes of the frame in the message's header,
// square metres and square radians. That is CovarianceFrame::kWorldAxes, translation first.

#include <terse/compact/compact_pose_slam.h>

#include <Eigen/LU>
#include <cstddef>

namespace terse {

inline constexpr CovarianceConvention kRosConvention{CovarianceFrame::kWorldAxes, TangentOrder::kTranslationFirst};

// `covariance` is in kRosConvention.
template <class PoseWithCovariance>
void FillPose(const SE3& T, const Matrix<6, 6>& covariance, PoseWithCovariance& to) {
  const Quaternion& q = T.Rotation().Unit();
  to.pose.position.x = T.Translation().x();
  to.pose.position.y = T.Translation().y();
  to.pose.position.z = T.Translation().z();
  to.pose.orientation.x = q.x();
  to.pose.orientation.y = q.y();
  to.pose.orientation.z = q.z();
  to.pose.orientation.w = q.w();
  for (int r = 0; r < 6; ++r) {
    for (int c = 0; c < 6; ++c) to.covariance[static_cast<std::size_t>(6 * r + c)] = covariance(r, c);
  }
}

// A pose in the plane: z, roll and pitch are zero and exact.
template <class PoseWithCovariance>
void FillPose(const SE2& T, const Matrix<3, 3>& covariance, PoseWithCovariance& to) {
  const SO3 about_z = SO3::Exp({0, 0, T.Theta()});
  Matrix<6, 6> in_space = Matrix<6, 6>::Zero();
  constexpr int kAt[] = {0, 1, 5};
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) in_space(kAt[r], kAt[c]) = covariance(r, c);
  }
  FillPose(SE3(about_z, {T.Translation().x(), T.Translation().y(), 0}), in_space, to);
}

// Any pose that the map has seen, kept or dropped, as it is known now. Throws std::invalid_argument if it is unknown.
template <class Pose, class PoseWithCovariance>
void FillPose(const CompactPoseSlam<Pose>& slam, PoseId id, PoseWithCovariance& to) {
  FillPose(slam.Estimate(id, Recovery::kV2), slam.Covariance(id, kRosConvention), to);
}

// The other way: a pose that a message gives is a measurement of the map's pose `id`. Its covariance must be positive
// definite: FindDefect tells.
template <class PoseWithCovariance>
PosePriorFactor<SE3> PriorFrom(const PoseWithCovariance& from, PoseId id) {
  const auto& p = from.pose.position;
  const auto& q = from.pose.orientation;
  const SE3 T(SO3(Quaternion(q.w, q.x, q.y, q.z)), {p.x, p.y, p.z});
  Matrix<6, 6> covariance;
  for (int r = 0; r < 6; ++r) {
    for (int c = 0; c < 6; ++c) covariance(r, c) = from.covariance[static_cast<std::size_t>(6 * r + c)];
  }
  const Matrix<6, 6> native = ConvertCovariance<SE3>(covariance, T, kRosConvention, {});
  const Matrix<6, 6> information = native.inverse();
  return {id, T, (information + information.transpose()) / 2};
}

}  // namespace terse
