#include <algorithm>
#include <chrono>
#include <limits>
#include <stdexcept>

#include "bench_runs.h"
#include "ceres_covariance.h"
#include "terse/core/batch_solver.h"
#include "terse/covariance/marginals.h"

namespace terse::bench {
namespace {

constexpr int kRepeats = 10;

}  // namespace

template <class Pose>
nlohmann::json RunCovarianceBatch(const PoseGraph<Pose>& graph, InitialValues start, int ceres_limit) {
  using Clock = std::chrono::steady_clock;
  const auto since = [](Clock::time_point begin) {
    return std::chrono::duration<double>(Clock::now() - begin).count();
  };
  auto optimum = SolveBatch(graph, ComputeInitialValues(graph, start));
  const Marginals<Pose> marginals(graph, optimum.T_world_body, optimum.cholesky);
  std::vector<typename Pose::Jacobian> blocks = marginals.AllMarginals();
  double factor_seconds = std::numeric_limits<double>::infinity(), blocks_seconds = factor_seconds;
  for (int k = 0; k < kRepeats; ++k) {
    const auto begin = Clock::now();
    if (!optimum.cholesky.Refactor()) throw std::runtime_error("not positive definite at the optimum");
    factor_seconds = std::min(factor_seconds, since(begin));
    const auto middle = Clock::now();
    blocks = marginals.AllMarginals();
    blocks_seconds = std::min(blocks_seconds, since(middle));
  }
  nlohmann::json json = {{"factor_seconds", factor_seconds}, {"seconds", blocks_seconds}, {"ceres_limit", ceres_limit}};
  if (const auto ceres = CeresCovariance(graph, optimum.T_world_body, blocks, ceres_limit)) {
    json["ceres"] = {{"seconds", ceres->seconds}, {"difference", ceres->difference}};
  }
  return json;
}

template nlohmann::json RunCovarianceBatch<SE2>(const PoseGraph<SE2>&, InitialValues, int);
template nlohmann::json RunCovarianceBatch<SE3>(const PoseGraph<SE3>&, InitialValues, int);

}  // namespace terse::bench
