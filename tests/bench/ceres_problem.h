#pragma once
// A pose graph as a Ceres problem: the same cost with the same exact Jacobians, whitening worked out beforehand.

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <array>
#include <utility>
#include <variant>
#include <vector>

#include "terse/core/pose_graph.h"
#include "terse/core/residual.h"

namespace terse::bench {

// Parameters of a pose: as many as it takes to store it without loss.
template <class Pose>
struct Parameters;

template <>
struct Parameters<SE2> {
  static constexpr int kSize = 3;
  static SE2 Read(const double* x) { return SE2(x[0], x[1], x[2]); }
  static void Write(const SE2& T, double* x) {
    x[0] = T.Translation().x();
    x[1] = T.Translation().y();
    x[2] = T.Theta();
  }
};

template <>
struct Parameters<SE3> {
  static constexpr int kSize = 7;
  static SE3 Read(const double* x) { return SE3(SO3(Quaternion(x[6], x[3], x[4], x[5])), Vector<3>(x[0], x[1], x[2])); }
  static void Write(const SE3& T, double* x) {
    Eigen::Map<Vector<3>>{x} = T.Translation();
    Eigen::Map<Vector<4>>{x + 3} = T.Rotation().Unit().coeffs();
  }
};

// T <- T.Retract(d). Ceres multiplies a cost's Jacobian with PlusJacobian and uses neither alone: with [I; 0] here, a
// cost states its Jacobian with respect to d in the first columns, exactly.
template <class Pose>
class PoseManifold final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return Parameters<Pose>::kSize; }
  int TangentSize() const override { return Pose::kDof; }
  bool Plus(const double* x, const double* d, double* out) const override {
    Pose T = Parameters<Pose>::Read(x).Retract(Eigen::Map<const Vector<Pose::kDof>>(d));
    T.Normalize();
    Parameters<Pose>::Write(T, out);
    return true;
  }
  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, Parameters<Pose>::kSize, Pose::kDof, Eigen::RowMajor>>(jacobian).setIdentity();
    return true;
  }
  bool Minus(const double* y, const double* x, double* d) const override {
    Eigen::Map<Vector<Pose::kDof>>{d} = Parameters<Pose>::Read(x).Local(Parameters<Pose>::Read(y));
    return true;
  }
  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, Pose::kDof, Parameters<Pose>::kSize, Eigen::RowMajor>>(jacobian).setIdentity();
    return true;
  }
};

template <class Pose>
class RelativeCost final
    : public ceres::SizedCostFunction<Pose::kDof, Parameters<Pose>::kSize, Parameters<Pose>::kSize> {
 public:
  explicit RelativeCost(const RelativePoseFactor<Pose>& factor)
      : T_from_to_(factor.T_from_to), W_(Square(factor.information).llt().matrixU()) {}

  bool Evaluate(double const* const* x, double* residual, double** jacobians) const override {
    const Pose from = Parameters<Pose>::Read(x[0]), to = Parameters<Pose>::Read(x[1]);
    Eigen::Map<Vector<B>> r(residual);
    if (jacobians == nullptr) {
      r = W_ * (from * T_from_to_).Local(to);
      return true;
    }
    const auto e = EvaluateRelative(T_from_to_, from, to);
    r = W_ * e.residual;
    if (jacobians[0] != nullptr) Write(e.J_residual_from, jacobians[0]);
    if (jacobians[1] != nullptr) Write(e.J_residual_to, jacobians[1]);
    return true;
  }

 private:
  static constexpr int B = Pose::kDof;
  using Square = Eigen::Matrix<double, B, B>;
  void Write(const Matrix<B, B>& J, double* out) const {
    Eigen::Map<Eigen::Matrix<double, B, Parameters<Pose>::kSize, Eigen::RowMajor>> ambient(out);
    if constexpr (Parameters<Pose>::kSize > B) ambient.setZero();
    ambient.template leftCols<B>().noalias() = W_ * J;
  }
  Pose T_from_to_;
  Square W_;
};

// Relative factors only. The gauge is left to the user.
template <class Pose>
class CeresProblem {
 public:
  CeresProblem(const PoseGraph<Pose>& graph, const std::vector<Pose>& values) : x_(values.size()) {
    for (std::size_t v = 0; v < values.size(); ++v) {
      Parameters<Pose>::Write(values[v], x_[v].data());
      problem_.AddParameterBlock(x_[v].data(), Parameters<Pose>::kSize, &manifold_);
    }
    const auto at = [&](PoseId id) { return x_[static_cast<std::size_t>(graph.IndexOf(id))].data(); };
    for (const auto& node : graph.Factors()) {
      const auto& factor = std::get<RelativePoseFactor<Pose>>(node.factor);
      problem_.AddResidualBlock(new RelativeCost<Pose>(factor), nullptr, at(factor.from), at(factor.to));
    }
  }
  ceres::Problem& Problem() { return problem_; }
  double* Parameter(std::size_t pose) { return x_[pose].data(); }
  std::size_t Poses() const { return x_.size(); }

 private:
  static ceres::Problem::Options Borrowing() {
    ceres::Problem::Options options;
    options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    return options;
  }
  std::vector<std::array<double, Parameters<Pose>::kSize>> x_;
  PoseManifold<Pose> manifold_;
  ceres::Problem problem_{Borrowing()};
};

}  // namespace terse::bench
