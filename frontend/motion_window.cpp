#include "terse/frontend/motion_window.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "stereo_reprojection.h"

namespace terse {
namespace {

double Weight(double residual, double huber) { return residual <= huber ? 1 : huber / residual; }
double Cost(double residual, double huber) {
  return residual <= huber ? residual * residual : huber * (2 * residual - huber);
}

// One point with the poses it involves; the first is its anchor.
struct PointBlocks {
  Matrix<3, 3> H_xx_inverse;
  Vector<3> g_x;
  std::vector<int> poses;
  std::vector<Matrix<3, 6>> H_xp;
};

class WindowAdjuster {
 public:
  WindowAdjuster(const StereoCamera& camera, const std::vector<WindowPoint>& points, const WindowOptions& options,
                 const std::vector<SE3>& T_world_camera)
      : camera_(camera), options_(options), frames_(static_cast<int>(T_world_camera.size())), poses_(T_world_camera) {
    for (const WindowPoint& point : points) {
      if (point.observations.size() < 2) continue;
      points_.push_back(&point);
      x_.push_back(point.observations.front().uvu);
    }
    blocks_.resize(points_.size());
  }

  WindowOffset Offset() const { return offset_; }

  std::vector<SE3> Run() {
    const int size = 6 * (frames_ - options_.fixed);
    if (size <= 0 || points_.empty()) return poses_;
    double cost = TotalCost(poses_, x_);
    for (int iteration = 0; iteration < options_.iterations; ++iteration) {
      MatrixX S = MatrixX::Zero(size, size);
      VectorX g = VectorX::Zero(size);
      offset_column_ = VectorX::Zero(size);
      offset_information_ = offset_gradient_ = 0;
      Assemble(S, g);
      const Eigen::LLT<MatrixX> llt(S);
      if (llt.info() != Eigen::Success) break;
      SolveOffset(llt, g);
      const VectorX d = llt.solve(g);
      if (!d.allFinite()) break;
      std::vector<SE3> poses = poses_;
      std::vector<Vector<3>> x = x_;
      Apply(d, poses, x);
      const double next = TotalCost(poses, x);
      if (!(next <= cost)) break;
      poses_ = std::move(poses);
      x_ = std::move(x);
      const bool converged = cost - next < 1e-4 * cost;
      cost = next;
      if (converged) break;
    }
    return poses_;
  }

 private:
  // T_a_b of all pairs of frames, a < b.
  std::vector<SE3> RelativePoses(const std::vector<SE3>& poses) const {
    std::vector<SE3> relative(static_cast<size_t>(frames_ * frames_));
    for (int a = 0; a < frames_; ++a) {
      const SE3 T_a_world = poses[static_cast<size_t>(a)].Inverse();
      for (int b = a + 1; b < frames_; ++b) relative[Pair(a, b)] = T_a_world * poses[static_cast<size_t>(b)];
    }
    return relative;
  }
  size_t Pair(int a, int b) const { return static_cast<size_t>(a * frames_ + b); }

  std::vector<StereoReprojection> Reprojections(const std::vector<SE3>& relative) const {
    std::vector<StereoReprojection> reprojections;
    for (const SE3& T_a_b : relative) reprojections.emplace_back(camera_, T_a_b);
    return reprojections;
  }

  double TotalCost(const std::vector<SE3>& poses, const std::vector<Vector<3>>& x) const {
    const auto reprojections = Reprojections(RelativePoses(poses));
    double cost = 0;
    for (size_t k = 0; k < points_.size(); ++k) {
      const auto& observations = points_[k]->observations;
      const int anchor = observations.front().frame;
      cost += Cost((observations.front().uvu - x[k]).norm(), options_.huber);
      for (size_t o = 1; o < observations.size(); ++o) {
        Vector<3> uvu;
        const bool in_front = reprojections[Pair(anchor, observations[o].frame)].Project(x[k], uvu);
        cost += Cost(in_front ? (observations[o].uvu - uvu).norm() : kBehind, options_.huber);
      }
    }
    return cost;
  }

  void Assemble(MatrixX& S, VectorX& g) {
    const std::vector<SE3> relative = RelativePoses(poses_);
    const auto reprojections = Reprojections(relative);
    std::vector<Matrix<6, 6>> J_anchor;  // d T_a_b's perturbation / d T_world_a's
    for (const SE3& T_a_b : relative) J_anchor.push_back(-T_a_b.Inverse().Adjoint());
    for (size_t k = 0; k < points_.size(); ++k) AssemblePoint(k, reprojections, J_anchor, S, g);
  }

  void AssemblePoint(size_t k, const std::vector<StereoReprojection>& reprojections,
                     const std::vector<Matrix<6, 6>>& J_anchor, MatrixX& S, VectorX& g) {
    const auto& observations = points_[k]->observations;
    const int anchor = observations.front().frame;
    PointBlocks& blocks = blocks_[k];
    blocks.poses.assign(1, anchor);
    blocks.H_xp.assign(1, Matrix<3, 6>::Zero());
    const Vector<3> r_anchor = observations.front().uvu - x_[k];
    const double w_anchor = Weight(r_anchor.norm(), options_.huber);
    Matrix<3, 3> H_xx = w_anchor * Matrix<3, 3>::Identity();
    blocks.g_x = w_anchor * r_anchor;
    Vector<3> H_xo(0, 0, -w_anchor);  // offset: u_R's residual grows with it
    offset_information_ += w_anchor;
    offset_gradient_ -= w_anchor * r_anchor.z();
    for (size_t o = 1; o < observations.size(); ++o) {
      const int frame = observations[o].frame;
      const auto seen = reprojections[Pair(anchor, frame)].Linearise(x_[k]);
      if (!seen.in_front) continue;
      const Vector<3> r = observations[o].uvu - seen.uvu;
      const double w = Weight(r.norm(), options_.huber);
      const Matrix<3, 6> J_a = seen.J_uvu_motion * J_anchor[Pair(anchor, frame)];
      const Matrix<3, 3> weighted_point = w * seen.J_uvu_point.transpose();
      H_xx.noalias() += weighted_point * seen.J_uvu_point;
      blocks.g_x.noalias() += weighted_point * r;
      blocks.poses.push_back(frame);
      blocks.H_xp.push_back(weighted_point * seen.J_uvu_motion);
      blocks.H_xp[0].noalias() += weighted_point * J_a;
      AddMotion(anchor, frame, J_a, seen.J_uvu_motion, w, r, S, g);
      H_xo -= weighted_point.col(2);
      AddOffset(anchor, frame, J_a, seen.J_uvu_motion, w, r.z());
    }
    blocks.H_xx_inverse = H_xx.inverse();
    Eliminate(blocks, H_xo, S, g);
  }

  int PoseRow(int frame) const { return 6 * (frame - options_.fixed); }  // negative: held

  void AddMotion(int a, int b, const Matrix<3, 6>& J_a, const Matrix<3, 6>& J_b, double w, const Vector<3>& r,
                 MatrixX& S, VectorX& g) const {
    const int oa = PoseRow(a), ob = PoseRow(b);
    if (ob < 0) return;
    S.block<6, 6>(ob, ob).noalias() += w * J_b.transpose() * J_b;
    g.segment<6>(ob).noalias() += w * J_b.transpose() * r;
    if (oa < 0) return;
    S.block<6, 6>(oa, oa).noalias() += w * J_a.transpose() * J_a;
    S.block<6, 6>(ob, oa).noalias() += w * J_b.transpose() * J_a;  // lower triangle: a < b
    g.segment<6>(oa).noalias() += w * J_a.transpose() * r;
  }

  void AddOffset(int a, int b, const Matrix<3, 6>& J_a, const Matrix<3, 6>& J_b, double w, double r_u_right) {
    if (PoseRow(a) >= 0) offset_column_.segment<6>(PoseRow(a)) -= w * J_a.row(2).transpose();
    if (PoseRow(b) >= 0) offset_column_.segment<6>(PoseRow(b)) -= w * J_b.row(2).transpose();
    offset_information_ += w;
    offset_gradient_ -= w * r_u_right;
  }

  template <class Factor>
  void SolveOffset(const Factor& llt, const VectorX& g) {
    const VectorX solved = llt.solve(offset_column_);
    offset_.information = std::max(0.0, offset_information_ - offset_column_.dot(solved));
    offset_.step = offset_.information > 0 ? (offset_gradient_ - solved.dot(g)) / offset_.information : 0;
  }

  void Eliminate(const PointBlocks& blocks, const Vector<3>& H_xo, MatrixX& S, VectorX& g) {
    const Vector<3> solved_o = blocks.H_xx_inverse * H_xo;
    offset_information_ -= H_xo.dot(solved_o);
    offset_gradient_ -= solved_o.dot(blocks.g_x);
    for (size_t i = 0; i < blocks.poses.size(); ++i) {
      const int oi = PoseRow(blocks.poses[i]);
      if (oi < 0) continue;
      const Matrix<6, 3> solved = blocks.H_xp[i].transpose() * blocks.H_xx_inverse;
      g.segment<6>(oi).noalias() -= solved * blocks.g_x;
      offset_column_.segment<6>(oi).noalias() -= solved * H_xo;
      for (size_t j = 0; j <= i; ++j) {
        const int oj = PoseRow(blocks.poses[j]);
        if (oj >= 0) S.block<6, 6>(oi, oj).noalias() -= solved * blocks.H_xp[j];
      }
    }
  }

  void Apply(const VectorX& d, std::vector<SE3>& poses, std::vector<Vector<3>>& x) const {
    for (int frame = options_.fixed; frame < frames_; ++frame) {
      SE3& pose = poses[static_cast<size_t>(frame)];
      pose = pose.Retract(d.segment<6>(PoseRow(frame)));
      pose.Normalize();
    }
    for (size_t k = 0; k < points_.size(); ++k) {
      Vector<3> rhs = blocks_[k].g_x;
      for (size_t i = 0; i < blocks_[k].poses.size(); ++i) {
        const int offset = PoseRow(blocks_[k].poses[i]);
        if (offset >= 0) rhs -= blocks_[k].H_xp[i] * d.segment<6>(offset);
      }
      x[k] += blocks_[k].H_xx_inverse * rhs;
    }
  }

  static constexpr double kBehind = 100;  // pixels: residual of a point behind a camera

  StereoCamera camera_;
  WindowOptions options_;
  int frames_;
  std::vector<SE3> poses_;
  std::vector<const WindowPoint*> points_;
  std::vector<Vector<3>> x_;
  std::vector<PointBlocks> blocks_;
  VectorX offset_column_;
  double offset_information_ = 0, offset_gradient_ = 0;
  WindowOffset offset_;
};

}  // namespace

WindowOffset AdjustWindow(const StereoCamera& camera, const std::vector<WindowPoint>& points,
                          const WindowOptions& options, std::vector<SE3>& T_world_camera) {
  WindowAdjuster adjuster(camera, points, options, T_world_camera);
  T_world_camera = adjuster.Run();
  return adjuster.Offset();
}

}  // namespace terse
