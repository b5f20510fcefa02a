#pragma once
// The one place that knows what the rotation part of a 3D information matrix in a file means.

#include "terse/lie/se3.h"

namespace terse {

// kQuaternion: of the quaternion's vector part, which is half the rotation vector (g2o's EDGE_SE3:QUAT).
// kRadians: of the rotation vector (GTSAM and Ceres read the same files so).
enum class RotationInformation { kQuaternion, kRadians };

// Omega_phi = S Omega_file S with S = diag(1 1 1 1/2 1/2 1/2) for kQuaternion; exact in both directions.
Matrix<6, 6> InformationFromFile(const Matrix<6, 6>& information_file, RotationInformation meaning);
Matrix<6, 6> InformationToFile(const Matrix<6, 6>& information, RotationInformation meaning);

}  // namespace terse
