#include "ceres_batch.h"

#include <ceres/ceres.h>

#include <Eigen/Cholesky>
#include <array>
#include <chrono>

#include "terse/core/residual.h"

namespace terse::bench {
namespace {

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

class StopAtCost final : public ceres::IterationCallback {
 public:
  StopAtCost(double target_chi2, TimeToCost& result) : target_chi2_(target_chi2), result_(result) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    result_.iterations = summary.iteration;
    result_.chi2 = 2 * summary.cost;
    if (result_.chi2 > target_chi2_) return ceres::SOLVER_CONTINUE;
    result_.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
    return ceres::SOLVER_TERMINATE_SUCCESSFULLY;
  }

 private:
  double target_chi2_;
  TimeToCost& result_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

template <class Pose>
TimeToCost Solve(const PoseGraph<Pose>& graph, const std::vector<Pose>& start, double target_chi2,
                 double trust_region_radius) {
  std::vector<std::array<double, Parameters<Pose>::kSize>> x(start.size());
  PoseManifold<Pose> manifold;
  ceres::Problem::Options ownership;
  ownership.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(ownership);
  for (std::size_t v = 0; v < start.size(); ++v) {
    Parameters<Pose>::Write(start[v], x[v].data());
    problem.AddParameterBlock(x[v].data(), Parameters<Pose>::kSize, &manifold);
  }
  problem.SetParameterBlockConstant(x[0].data());
  const auto at = [&](PoseId id) { return x[static_cast<std::size_t>(graph.IndexOf(id))].data(); };
  for (const auto& node : graph.Factors()) {
    const auto& factor = std::get<RelativePoseFactor<Pose>>(node.factor);
    problem.AddResidualBlock(new RelativeCost<Pose>(factor), nullptr, at(factor.from), at(factor.to));
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  options.num_threads = 1;
  options.max_num_iterations = 200;
  options.initial_trust_region_radius = trust_region_radius;
  // The target decides when to stop.
  options.function_tolerance = options.gradient_tolerance = options.parameter_tolerance = 1e-16;
  options.logging_type = ceres::SILENT;
  TimeToCost result;
  StopAtCost stop(target_chi2, result);
  options.callbacks = {&stop};
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return result;
}

}  // namespace

template <class Pose>
TimeToCost CeresTimeToCost(const PoseGraph<Pose>& graph, const std::vector<Pose>& start, double target_chi2) {
  const TimeToCost cautious = Solve(graph, start, target_chi2, 1e4), bold = Solve(graph, start, target_chi2, 1e16);
  const bool bold_is_better = bold.seconds >= 0 && (cautious.seconds < 0 || bold.seconds < cautious.seconds);
  return bold_is_better ? bold : cautious;
}

template TimeToCost CeresTimeToCost<SE2>(const PoseGraph<SE2>&, const std::vector<SE2>&, double);
template TimeToCost CeresTimeToCost<SE3>(const PoseGraph<SE3>&, const std::vector<SE3>&, double);

}  // namespace terse::bench
