#pragma once
// A point of one stereo frame as another sees it, with Jacobians; the point is given by its image coordinates.

#include "terse/frontend/stereo_camera.h"
#include "terse/lie/se3.h"

namespace terse {

// The motion T_a_b, prepared for many points.
class StereoReprojection {
 public:
  struct Result {
    bool in_front = false;      // of camera b; if not, the rest is not set
    Vector<3> uvu;              // (u_L, v, u_R) in b
    Matrix<3, 3> J_uvu_point;   // by x
    Matrix<3, 6> J_uvu_motion;  // by d in T_a_b Exp(d), d = [rho; phi]
  };

  StereoReprojection(const StereoCamera& camera, const SE3& T_a_b)
      : camera_(camera), R_b_a_(T_a_b.Rotation().Rotation().transpose()), t_a_b_(T_a_b.Translation()) {
    J_q_x_ << 1 / camera.fx, 0, 0, 0, 1 / camera.fy, 0, 0, 0, 0;
    J_inverse_depth_x_ << 1 / (camera.fx * camera.baseline), 0, -1 / (camera.fx * camera.baseline);
    J_q_x_ -= t_a_b_ * J_inverse_depth_x_;
    J_q_x_ = (R_b_a_ * J_q_x_).eval();
  }

  // x: (u_L, v, u_R) in a. All is done with q = p_b / z_a, which is well-defined for points at infinity.
  Vector<3> Point(const Vector<3>& x) const {
    const Vector<3> n((x.x() - camera_.cx) / camera_.fx, (x.y() - camera_.cy) / camera_.fy, 1);
    return R_b_a_ * (n - InverseDepth(x) * t_a_b_);
  }

  bool Project(const Vector<3>& x, Vector<3>& uvu) const {
    const Vector<3> q = Point(x);
    if (q.z() < kNearest) return false;
    uvu = Project(q, InverseDepth(x));
    return true;
  }

  Result Linearise(const Vector<3>& x) const {
    Result result;
    const Vector<3> q = Point(x);
    result.in_front = q.z() >= kNearest;
    if (!result.in_front) return result;
    const double inverse_depth = InverseDepth(x), scale = 1 / q.z(), fxb = camera_.fx * camera_.baseline;
    result.uvu = Project(q, inverse_depth);
    Matrix<3, 3> J_uvu_q;
    J_uvu_q << camera_.fx * scale, 0, -camera_.fx * q.x() * scale * scale,  //
        0, camera_.fy * scale, -camera_.fy * q.y() * scale * scale,         //
        camera_.fx * scale, 0, (fxb * inverse_depth - camera_.fx * q.x()) * scale * scale;
    result.J_uvu_point.noalias() = J_uvu_q * J_q_x_;
    result.J_uvu_point.row(2) -= fxb * scale * J_inverse_depth_x_;
    result.J_uvu_motion.leftCols<3>() = -inverse_depth * J_uvu_q;
    result.J_uvu_motion.rightCols<3>().noalias() = J_uvu_q * Hat(q);
    return result;
  }

 private:
  static constexpr double kNearest = 1e-2;  // of the depth in a

  double InverseDepth(const Vector<3>& x) const { return (x.x() - x.z()) / (camera_.fx * camera_.baseline); }

  Vector<3> Project(const Vector<3>& q, double inverse_depth) const {
    const double u = camera_.fx * q.x() / q.z() + camera_.cx;
    return {u, camera_.fy * q.y() / q.z() + camera_.cy, u - camera_.fx * camera_.baseline * inverse_depth / q.z()};
  }

  StereoCamera camera_;
  Matrix<3, 3> R_b_a_;
  Vector<3> t_a_b_;
  Matrix<3, 3> J_q_x_;
  Eigen::Matrix<double, 1, 3, Eigen::DontAlign | Eigen::RowMajor> J_inverse_depth_x_;
};

}  // namespace terse
