#include "terse/frontend/stereo_motion.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>

#include "stereo_reprojection.h"

namespace terse {
namespace {

// A match and the point that is estimated with it.
struct PointState {
  const StereoMatch* match = nullptr;
  Vector<3> x;        // (u_L, v, u_R) in a
  bool used = false;  // in this round
};

struct NormalEquations {
  Matrix<6, 6> S = Matrix<6, 6>::Zero();  // Schur complement, weighted
  Vector<6> g = Vector<6>::Zero();
  Vector<6> offset = Vector<6>::Zero();  // S times the motion's change with a pixel added to all u_R
  double cost = 0;                       // robust
  double weighted = 0;                   // sum of weight * residual^2
  double weights = 0;
};

double HuberWeight(double residual, double huber) { return residual <= huber ? 1 : huber / residual; }
double HuberCost(double residual, double huber) {
  return residual <= huber ? residual * residual : huber * (2 * residual - huber);
}

// The point's own part of a linearised match: H_xx x = g_x and what couples it to the motion.
struct PointSystem {
  bool valid = false;
  Eigen::LLT<Matrix<3, 3>> H_xx;
  Matrix<3, 6> H_xp;
  Vector<3> g_x;
  Vector<3> offset_x;  // how g_x and g_p change with a pixel added to both u_R
  Vector<6> offset_p;
  Matrix<6, 6> H_pp;
  Vector<6> g_p;
  double residual = 0;  // norm of the 6 residuals, pixels
};

PointSystem Linearise(const StereoReprojection& reprojection, const PointState& point) {
  PointSystem system;
  const auto b = reprojection.Linearise(point.x);
  system.valid = b.in_front;
  if (!system.valid) return system;
  const Vector<3> r_a = point.match->a - point.x, r_b = point.match->b - b.uvu;
  system.H_xx.compute(Matrix<3, 3>::Identity() + b.J_uvu_point.transpose() * b.J_uvu_point);
  system.H_xp.noalias() = b.J_uvu_point.transpose() * b.J_uvu_motion;
  system.H_pp.noalias() = b.J_uvu_motion.transpose() * b.J_uvu_motion;
  system.g_x.noalias() = r_a + b.J_uvu_point.transpose() * r_b;
  system.g_p.noalias() = b.J_uvu_motion.transpose() * r_b;
  system.offset_x = Vector<3>(0, 0, 1) + b.J_uvu_point.row(2).transpose();
  system.offset_p = b.J_uvu_motion.row(2).transpose();
  system.residual = std::sqrt(r_a.squaredNorm() + r_b.squaredNorm());
  return system;
}

double Residual(const StereoReprojection& reprojection, const PointState& point) {
  Vector<3> uvu;
  if (!reprojection.Project(point.x, uvu)) return INFINITY;
  return std::sqrt((point.match->a - point.x).squaredNorm() + (point.match->b - uvu).squaredNorm());
}

class MotionEstimator {
 public:
  MotionEstimator(const StereoCamera& camera, const std::vector<StereoMatch>& matches,
                  const StereoMotionOptions& options, const SE3& initial)
      : camera_(camera), options_(options), T_a_b_(initial) {
    points_.resize(matches.size());
    for (size_t k = 0; k < matches.size(); ++k) points_[k].match = &matches[k];
  }

  std::optional<StereoMotion> Run() {
    // The first round is robust against what a bad start takes for outliers, the second is without them.
    for (const double outlier : {10 * options_.outlier, options_.outlier}) {
      if (SelectPoints(outlier) < options_.min_inliers || !Minimise()) return std::nullopt;
    }
    if (SelectPoints(options_.outlier) < options_.min_inliers) return std::nullopt;
    return Result();
  }

 private:
  // The best point for the present motion, for each match; those with a residual below `outlier` are used.
  int SelectPoints(double outlier) {
    const StereoReprojection reprojection(camera_, T_a_b_);
    int used = 0;
    for (PointState& point : points_) {
      const StereoMatch& match = *point.match;
      point.used = std::min(match.a.x() - match.a.z(), match.b.x() - match.b.z()) >= options_.min_disparity;
      if (!point.used) continue;
      point.x = match.a;
      for (int iteration = 0; iteration < 3 && point.used; ++iteration) {
        const PointSystem system = Linearise(reprojection, point);
        point.used = system.valid;
        if (system.valid) point.x += system.H_xx.solve(system.g_x);
      }
      point.used = point.used && Residual(reprojection, point) < outlier;
      used += point.used;
    }
    return used;
  }

  NormalEquations Assemble(std::vector<PointSystem>& systems) const {
    const StereoReprojection reprojection(camera_, T_a_b_);
    NormalEquations normal;
    for (size_t k = 0; k < points_.size(); ++k) {
      if (!points_[k].used) continue;
      PointSystem& system = systems[k] = Linearise(reprojection, points_[k]);
      if (!system.valid) continue;
      const double weight = HuberWeight(system.residual, options_.huber);
      const Matrix<3, 6> solved = system.H_xx.solve(system.H_xp);
      normal.S.noalias() += weight * (system.H_pp - system.H_xp.transpose() * solved);
      normal.g.noalias() += weight * (system.g_p - solved.transpose() * system.g_x);
      normal.offset.noalias() += weight * (system.offset_p - solved.transpose() * system.offset_x);
      normal.cost += HuberCost(system.residual, options_.huber);
      normal.weighted += weight * system.residual * system.residual;
      normal.weights += weight;
    }
    return normal;
  }

  double Cost(const SE3& T_a_b, const std::vector<PointState>& points) const {
    const StereoReprojection reprojection(camera_, T_a_b);
    double cost = 0;
    for (const PointState& point : points) {
      if (point.used) cost += HuberCost(Residual(reprojection, point), options_.huber);
    }
    return cost;
  }

  // Gauss-Newton with damping where a step would raise the cost. False if the motion is not determined.
  bool Minimise() {
    std::vector<PointSystem> systems(points_.size());
    double damping = 0;
    for (int iteration = 0; iteration < options_.max_iterations; ++iteration) {
      const NormalEquations normal = Assemble(systems);
      bool lower = false;
      Vector<6> d;
      for (int attempt = 0; attempt < 6 && !lower; ++attempt) {
        Matrix<6, 6> damped = normal.S;
        damped.diagonal() *= 1 + damping;
        const Eigen::LLT<Matrix<6, 6>> llt(damped);
        if (llt.info() != Eigen::Success) return false;
        d = llt.solve(normal.g);
        if (!d.allFinite()) return false;
        lower = Step(d, systems, normal.cost);
        damping = lower ? damping * 0.1 : std::max(1e-4, damping * 10);
        if (damping < 1e-5) damping = 0;
      }
      if (!lower || (d.head<3>().norm() < 1e-6 && d.tail<3>().norm() < 1e-7)) break;
    }
    return true;
  }

  // Moves motion and points by d, unless that raises the cost.
  bool Step(const Vector<6>& d, const std::vector<PointSystem>& systems, double cost) {
    const SE3 T_a_b = T_a_b_.Retract(d);
    std::vector<PointState> points = points_;
    for (size_t k = 0; k < points.size(); ++k) {
      if (!points[k].used || !systems[k].valid) continue;
      points[k].x += systems[k].H_xx.solve(systems[k].g_x - systems[k].H_xp * d);
    }
    if (!(Cost(T_a_b, points) <= cost * (1 + 1e-12))) return false;
    T_a_b_ = T_a_b;
    T_a_b_.Normalize();
    points_ = std::move(points);
    return true;
  }

  std::optional<StereoMotion> Result() {
    std::vector<PointSystem> systems(points_.size());
    const NormalEquations normal = Assemble(systems);
    const Eigen::LLT<Matrix<6, 6>> llt(normal.S);
    if (llt.info() != Eigen::Success || llt.rcond() < 1e-12) return std::nullopt;
    StereoMotion result;
    result.T_a_b = T_a_b_;
    result.J_motion_offset = llt.solve(normal.offset);
    for (const PointState& point : points_) {
      result.inlier.push_back(point.used);
      result.inliers += point.used;
    }
    // Each match has 6 residuals and 3 unknowns of its own.
    const double freedom = std::max(1.0, 3 * normal.weights - 6);
    result.residual_scale = std::max(options_.min_residual_scale, std::sqrt(normal.weighted / freedom));
    result.covariance = options_.covariance_factor * result.residual_scale * result.residual_scale *
                        llt.solve(Matrix<6, 6>::Identity());
    result.covariance.diagonal().head<3>().array() += options_.sigma_rho_floor * options_.sigma_rho_floor;
    result.covariance.diagonal().tail<3>().array() += options_.sigma_phi_floor * options_.sigma_phi_floor;
    result.covariance = (0.5 * (result.covariance + result.covariance.transpose())).eval();
    return result;
  }

  StereoCamera camera_;
  StereoMotionOptions options_;
  SE3 T_a_b_;
  std::vector<PointState> points_;
};

}  // namespace

std::optional<StereoMotion> EstimateStereoMotion(const StereoCamera& camera, const std::vector<StereoMatch>& matches,
                                                 const StereoMotionOptions& options, const SE3& initial) {
  return MotionEstimator(camera, matches, options, initial).Run();
}

std::optional<Matrix<6, 6>> MonteCarloCovariance(const StereoCamera& camera, const std::vector<StereoMatch>& matches,
                                                 const SE3& T_a_b, double sigma, int samples, std::uint64_t seed,
                                                 const StereoMotionOptions& options) {
  std::mt19937_64 engine(seed);
  std::normal_distribution<double> normal(0, sigma);
  const SE3 T_b_a = T_a_b.Inverse();
  std::vector<Vector<6>> errors;
  Vector<6> mean = Vector<6>::Zero();
  for (int sample = 0; sample < samples; ++sample) {
    std::vector<StereoMatch> noisy = matches;
    for (StereoMatch& match : noisy) {
      for (int i = 0; i < 3; ++i) match.a[i] += normal(engine);
      for (int i = 0; i < 3; ++i) match.b[i] += normal(engine);
    }
    const auto motion = EstimateStereoMotion(camera, noisy, options, T_a_b);
    if (!motion) continue;
    errors.push_back((T_b_a * motion->T_a_b).Log());
    mean += errors.back();
  }
  if (errors.size() < 8) return std::nullopt;
  mean /= static_cast<double>(errors.size());
  Matrix<6, 6> covariance = Matrix<6, 6>::Zero();
  for (const Vector<6>& error : errors) covariance += (error - mean) * (error - mean).transpose();
  return covariance / static_cast<double>(errors.size() - 1);
}

std::optional<Matrix<6, 6>> MonteCarloCovariance(const StereoCamera& camera, const std::vector<StereoMatch>& matches,
                                                 const StereoMotion& motion, const MonteCarloOptions& options,
                                                 std::uint64_t seed) {
  if (!(options.sigma > 0) || options.samples < 8) {
    throw std::invalid_argument("Monte Carlo covariance: sigma must be positive, and samples 8 at least");
  }
  std::vector<StereoMatch> inliers;
  for (size_t k = 0; k < matches.size(); ++k) {
    if (motion.inlier[k] != 0) inliers.push_back(matches[k]);
  }
  constexpr double kNoBound = 1e9;
  StereoMotionOptions plain;
  plain.huber = plain.outlier = kNoBound;
  plain.min_disparity = 0.1;  // noise is not to choose among far points
  return MonteCarloCovariance(camera, inliers, motion.T_a_b, options.sigma, options.samples, seed, plain);
}

}  // namespace terse
