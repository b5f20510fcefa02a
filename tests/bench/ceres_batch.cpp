#include "ceres_batch.h"

#include <chrono>

#include "ceres_problem.h"

namespace terse::bench {
namespace {

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
  CeresProblem<Pose> problem(graph, start);
  problem.Problem().SetParameterBlockConstant(problem.Parameter(0));
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
  ceres::Solve(options, &problem.Problem(), &summary);
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
