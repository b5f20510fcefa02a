#include "ceres_covariance.h"

#include <ceres/covariance.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <stdexcept>

#include "ceres_problem.h"
#include "terse/core/gauge.h"

namespace terse::bench {
namespace {

// The anchor of gauge.h at the value it was made for: residual zero.
template <class Pose>
class AnchorCost final : public ceres::SizedCostFunction<Pose::kDof, Parameters<Pose>::kSize> {
 public:
  explicit AnchorCost(const Gauge<Pose>& gauge) : root_(gauge.root) {}
  bool Evaluate(double const* const*, double* residual, double** jacobians) const override {
    Eigen::Map<Vector<Pose::kDof>>{residual}.setZero();
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    using Jacobian = Eigen::Matrix<double, Pose::kDof, Parameters<Pose>::kSize, Eigen::RowMajor>;
    Eigen::Map<Jacobian>{jacobians[0]} = root_ * Jacobian::Identity();
    return true;
  }

 private:
  typename Gauge<Pose>::Root root_;
};

template <class Pose>
std::optional<CeresCovarianceResult> Compute(const PoseGraph<Pose>& graph, const std::vector<Pose>& values,
                                             const std::vector<typename Pose::Jacobian>& ours) {
  CeresProblem<Pose> problem(graph, values);
  problem.Problem().AddResidualBlock(new AnchorCost<Pose>(FindGauge(graph, values)), nullptr, problem.Parameter(0));
  std::vector<std::pair<const double*, const double*>> blocks;
  for (std::size_t v = 0; v < values.size(); ++v) blocks.emplace_back(problem.Parameter(v), problem.Parameter(v));
  ceres::Covariance::Options options;
  options.algorithm_type = ceres::SPARSE_QR;
  options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  options.num_threads = 1;
  ceres::Covariance covariance(options);
  CeresCovarianceResult result;
  const auto start = std::chrono::steady_clock::now();
  if (!covariance.Compute(blocks, &problem.Problem())) return std::nullopt;
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  for (std::size_t v = 0; v < values.size(); ++v) {
    typename Pose::Jacobian block;  // symmetric: rows or columns first makes no difference
    covariance.GetCovarianceBlockInTangentSpace(blocks[v].first, blocks[v].second, block.data());
    result.difference = std::max(result.difference, (ours[v] - block).norm() / block.norm());
  }
  return result;
}

}  // namespace

template <class Pose>
std::optional<CeresCovarianceResult> CeresCovariance(const PoseGraph<Pose>& graph, const std::vector<Pose>& values,
                                                     const std::vector<typename Pose::Jacobian>& ours,
                                                     int limit_seconds) {
  int ends[2];
  if (pipe(ends) != 0) throw std::runtime_error("no pipe");
  const pid_t child = fork();
  if (child < 0) throw std::runtime_error("no process for Ceres");
  if (child == 0) {
    const auto limit = static_cast<rlim_t>(limit_seconds);
    const rlimit limits{limit, limit};
    setrlimit(RLIMIT_CPU, &limits);  // ends the process
    const auto result = Compute(graph, values, ours);
    const bool sent = result && write(ends[1], &*result, sizeof *result) == sizeof *result;
    _exit(sent ? 0 : 1);
  }
  close(ends[1]);
  CeresCovarianceResult result;
  const bool complete = read(ends[0], &result, sizeof result) == sizeof result;
  close(ends[0]);
  waitpid(child, nullptr, 0);
  return complete ? std::optional(result) : std::nullopt;
}

template std::optional<CeresCovarianceResult> CeresCovariance<SE2>(const PoseGraph<SE2>&, const std::vector<SE2>&,
                                                                   const std::vector<SE2::Jacobian>&, int);
template std::optional<CeresCovarianceResult> CeresCovariance<SE3>(const PoseGraph<SE3>&, const std::vector<SE3>&,
                                                                   const std::vector<SE3::Jacobian>&, int);

}  // namespace terse::bench
