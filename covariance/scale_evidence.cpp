#include "terse/covariance/scale_evidence.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "terse/core/at.h"
#include "terse/core/definite.h"
#include "terse/core/residual.h"
#include "terse/covariance/short_cycles.h"

namespace terse::internal {
namespace {

const double kLogTwoPi = std::log(2 * 3.14159265358979323846);
// What loops say is not taken to range over less: metres and radians.
constexpr double kLeastRange = 1, kLeastTurn = 0.1;

template <class Pose>
double HalfLogDeterminant(const typename Pose::Jacobian& M) {
  return LowerCholesky<Pose::kDof>(M).diagonal().array().log().sum();
}

// Logarithm of the volume that holds what the loops say, as if it were evenly spread.
template <class Pose>
double LogRange(const std::vector<ForwardEdge<Pose>>& loops) {
  using Tangent = typename Pose::Tangent;
  Tangent sum = Tangent::Zero(), squares = Tangent::Zero();
  for (const auto& loop : loops) {
    Tangent x = loop.T_first_last.Log();
    x.template head<Pose::kDim>() = loop.T_first_last.Translation();
    sum += x;
    squares += x.cwiseAbs2();
  }
  const double n = std::max(1.0, static_cast<double>(loops.size()));
  const Tangent range = (12 * (squares / n - (sum / n).cwiseAbs2())).cwiseMax(0).cwiseSqrt();
  double log_range = 0;
  for (int i = 0; i < Pose::kDof; ++i)
    log_range += std::log(std::max(range[i], i < Pose::kDim ? kLeastRange : kLeastTurn));
  return log_range;
}

}  // namespace

template <class Pose>
double CostOfScales(const std::vector<ProbeTerm<Pose>>& terms, const std::vector<char>& is_loop,
                    const BatchResult<Pose>& solved) {
  const std::size_t poses = solved.T_world_body.size();
  std::vector<char> is_wrong(terms.size());
  double cost = solved.log_determinant / 2, normals = -static_cast<double>(poses);
  for (std::size_t k = 0; k < terms.size(); ++k) {
    const ProbeTerm<Pose>& t = terms[k];
    is_wrong[k] = solved.weights[k] < 0.5;
    if (is_wrong[k]) continue;
    cost += FactorChi2(Factor<Pose>(t.factor), solved.T_world_body[At(t.first)], solved.T_world_body[At(t.second)]) / 2;
    cost -= HalfLogDeterminant<Pose>(t.factor.information);
    ++normals;
  }
  const double log_range = LogRange(ForwardEdges(terms, is_loop));
  for (const auto& cycle :
       ShortCycles(ForwardEdges(terms, is_wrong), OdometryChain<Pose>(ForwardEdges(terms), poses))) {
    if (!cycle) {
      cost += log_range;
      continue;
    }
    const double of_group = MahalanobisSquared<Pose::kDof>(cycle->covariance, cycle->error) / 2 +
                            HalfLogDeterminant<Pose>(cycle->covariance) + Pose::kDof * kLogTwoPi / 2;
    cost += std::min(log_range, of_group);
  }
  return cost + normals * Pose::kDof * kLogTwoPi / 2;
}

template <class Pose>
double LeastCostOfScales(const std::vector<ProbeTerm<Pose>>& terms, const std::vector<char>& is_loop) {
  const double log_range = LogRange(ForwardEdges(terms, is_loop));
  double cost = -Pose::kDof * kLogTwoPi / 2;
  std::vector<int> steps_to(1);
  for (std::size_t k = 0; k < terms.size(); ++k) {
    const auto later = static_cast<std::size_t>(std::max(terms[k].first, terms[k].second));
    if (later >= steps_to.size()) steps_to.resize(later + 1);
    if (!is_loop[k]) {
      ++steps_to[later];
      continue;
    }
    cost += std::min(log_range, Pose::kDof * kLogTwoPi / 2 - HalfLogDeterminant<Pose>(terms[k].factor.information));
  }
  const bool is_chain = std::all_of(steps_to.begin() + 1, steps_to.end(), [](int steps) { return steps == 1; });
  return is_chain ? cost : -std::numeric_limits<double>::infinity();
}

template double CostOfScales(const std::vector<ProbeTerm<SE2>>&, const std::vector<char>&, const BatchResult<SE2>&);
template double CostOfScales(const std::vector<ProbeTerm<SE3>>&, const std::vector<char>&, const BatchResult<SE3>&);
template double LeastCostOfScales(const std::vector<ProbeTerm<SE2>>&, const std::vector<char>&);
template double LeastCostOfScales(const std::vector<ProbeTerm<SE3>>&, const std::vector<char>&);

}  // namespace terse::internal
