#include "terse/frontend/stereo_camera.h"

namespace terse {

Vector<3> StereoCamera::Project(const Vector<3>& p) const {
  const double u = fx * p.x() / p.z() + cx;
  return {u, fy * p.y() / p.z() + cy, u - fx * baseline / p.z()};
}

Matrix<3, 3> StereoCamera::ProjectionJacobian(const Vector<3>& p) const {
  const double zz = p.z() * p.z();
  Matrix<3, 3> J;
  J << fx / p.z(), 0, -fx * p.x() / zz,  //
      0, fy / p.z(), -fy * p.y() / zz,   //
      fx / p.z(), 0, -fx * (p.x() - baseline) / zz;
  return J;
}

Vector<3> StereoCamera::Triangulate(const Vector<3>& uvu) const {
  const double z = fx * baseline / (uvu.x() - uvu.z());
  return {(uvu.x() - cx) * z / fx, (uvu.y() - cy) * z / fy, z};
}

}  // namespace terse
