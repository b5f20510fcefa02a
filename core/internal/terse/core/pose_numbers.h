#pragma once
// A pose as the numbers that files hold of it.

#include <array>

#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse::internal {

// x y theta, in metres and radians.
inline std::array<double, 3> NumbersOf(const SE2& T) { return {T.Translation().x(), T.Translation().y(), T.Theta()}; }

// x y z qx qy qz qw, the quaternion of length 1.
inline std::array<double, 7> NumbersOf(const SE3& T) {
  const Vector<3>& p = T.Translation();
  const Quaternion& q = T.Rotation().Unit();
  return {p.x(), p.y(), p.z(), q.x(), q.y(), q.z(), q.w()};
}

}  // namespace terse::internal
