#include "terse/core/hanging_loops.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <map>
#include <utility>

#include "terse/core/at.h"
#include "terse/core/chi_square.h"
#include "terse/core/decompositions.h"
#include "terse/core/front_paths.h"
#include "terse/core/log_message.h"
#include "terse/core/loop_groups.h"
#include "terse/core/open_loops.h"
#include "terse/core/require_optimum.h"
#include "terse/core/residual.h"
#include "terse/core/robust.h"

namespace terse::internal {
namespace {

using std::size_t;

// More loops than that bear each other out better than any odometry could.
constexpr size_t kMostOfGroup = 10;
constexpr double kLostTurn = 0.5;  // radians
// Times what 99 of 100 true loops are within, as not all are alike.
constexpr double kReserve = 2;
constexpr double kErrorsOfScale = 3;
constexpr int kMostRounds = 3;

template <class Pose>
struct LoopIn {
  FactorId id;
  const Factor<Pose>* factor = nullptr;
  std::pair<int, int> places;  // of its ends in order of arrival
};

template <class Pose>
std::vector<LoopIn<Pose>> LoopsIn(const PoseGraph<Pose>& graph, const BatchResult<Pose>& solved,
                                  const std::vector<FactorId>& robust) {
  const std::vector<int> place = PlacesInArrival(graph);
  std::vector<LoopIn<Pose>> loops;
  size_t k = 0;
  for (const auto& node : graph.Factors()) {
    const bool is_in = solved.weights[k++] > 0 && std::binary_search(robust.begin(), robust.end(), node.id);
    if (!is_in || !std::holds_alternative<RelativePoseFactor<Pose>>(node.factor)) continue;
    const FactorPoses ends = PosesOf(node.factor);
    const auto places = std::minmax(place[At(graph.IndexOf(ends.first))], place[At(graph.IndexOf(ends.second))]);
    if (places.second - places.first > 1) loops.push_back({node.id, &node.factor, places});  // else it is odometry
  }
  return loops;
}

template <class Pose>
std::vector<std::vector<size_t>> GroupsOf(const std::vector<LoopIn<Pose>>& loops) {
  std::vector<std::pair<int, int>> places;
  places.reserve(loops.size());
  for (const LoopIn<Pose>& loop : loops) places.push_back(loop.places);
  return GroupLoops(places);
}

// What all else says of a group that is in.
template <class Pose>
struct WithoutGroup {
  double turn = 0;        // radians: standard deviation of what the loops measure, the largest
  double innovation = 0;  // squared, of all
};

template <class Pose>
WithoutGroup<Pose> LookWithout(const std::vector<size_t>& group, const std::vector<LoopIn<Pose>>& loops,
                               const PoseGraph<Pose>& graph, const BatchResult<Pose>& solved) {
  constexpr int B = Pose::kDof, kTurns = B - Pose::kDim;
  const auto rows = static_cast<Eigen::Index>(group.size()) * B;
  Eigen::VectorXd residual(rows);
  std::vector<PathColumns<B>> columns;
  std::vector<Matrix<B, B>> roots;
  columns.reserve(group.size());
  for (const size_t k : group) {
    const FactorPoses ends = PosesOf(*loops[k].factor);
    const int first = graph.IndexOf(ends.first), second = graph.IndexOf(ends.second);
    roots.push_back(SquareRootInformation(*loops[k].factor));
    const LinearFactor<B> linear = Linearize(*loops[k].factor, roots.back(), first, second,
                                             solved.T_world_body[At(first)], solved.T_world_body[At(second)]);
    residual.segment<B>(static_cast<Eigen::Index>(columns.size()) * B) = linear.residual;
    columns.push_back(SolveForward(solved.cholesky.Tree(), linear));
  }
  std::vector<const PathColumns<B>*> each;
  each.reserve(columns.size());
  for (const auto& z : columns) each.push_back(&z);
  const Eigen::MatrixXd known = JointGram<B>(each);
  const Eigen::LLT<Eigen::MatrixXd> by_others(Eigen::MatrixXd::Identity(rows, rows) - known);
  WithoutGroup<Pose> out;
  if (by_others.info() != Eigen::Success) return out;  // nothing else holds it, or it cannot be told
  out.innovation = residual.dot(by_others.solve(residual));
  const Eigen::MatrixXd covariance = by_others.solve(known);
  for (size_t k = 0; k < group.size(); ++k) {
    const auto row = static_cast<Eigen::Index>(k) * B;
    const Matrix<B, B> to_tangent = InverseOf<B>(roots[k]);
    const Matrix<B, B> of_loop = to_tangent * covariance.block<B, B>(row, row) * to_tangent.transpose();
    out.turn = std::max(out.turn, std::sqrt(of_loop.diagonal().template tail<kTurns>().maxCoeff()));
  }
  return out;
}

// Squared: what true loops are within.
template <class Pose>
double PriceOf(const BatchResult<Pose>& solved, size_t loops_in) {
  const double limit = solved.robust_width * solved.robust_width;
  const auto out = std::count(solved.weights.begin(), solved.weights.end(), 0.0);
  const double explained = solved.robust_cost - static_cast<double>(out) * limit;
  const double redundancy = Pose::kDof * static_cast<double>(loops_in);
  const double factor = explained / redundancy * (1 + kErrorsOfScale * std::sqrt(2 / redundancy));
  return std::min(limit, kReserve * factor * ChiSquareQuantile(RobustOptions().quantile, Pose::kDof));
}

struct Doubts {
  double price = 0;
  std::vector<FactorId> loops;  // ascending
};

template <class Pose>
Doubts FindDoubts(const PoseGraph<Pose>& graph, const BatchResult<Pose>& solved, const std::vector<FactorId>& robust) {
  Doubts out;
  const std::vector<LoopIn<Pose>> loops = LoopsIn(graph, solved, robust);
  if (loops.empty()) return out;
  out.price = PriceOf(solved, loops.size());
  for (const std::vector<size_t>& group : GroupsOf(loops)) {
    if (group.size() > kMostOfGroup) continue;
    const WithoutGroup<Pose> others = LookWithout(group, loops, graph, solved);
    if (others.turn < kLostTurn || others.innovation <= out.price * static_cast<double>(group.size())) continue;
    for (const size_t k : group) out.loops.push_back(loops[k].id);
  }
  std::sort(out.loops.begin(), out.loops.end());
  return out;
}

}  // namespace

template <class Pose>
std::optional<BatchResult<Pose>> WithoutHangingLoops(const PoseGraph<Pose>& graph, const BatchResult<Pose>& solved,
                                                     const BatchOptions& options) {
  const std::vector<FactorId>& robust = *options.robust_factors;
  BatchOptions plain = options, next_to = options;
  plain.robust = RobustOptions();
  plain.robust_factors.reset();
  next_to.graduate = false;
  next_to.robust.width = solved.robust_width;
  std::optional<BatchResult<Pose>> best;
  for (int round = 0; round < kMostRounds; ++round) {
    const BatchResult<Pose>& before = best ? *best : solved;
    if (!HasFactor(before)) break;
    const Doubts doubts = FindDoubts(graph, before, robust);
    if (doubts.loops.empty()) break;
    std::vector<FactorId> out = doubts.loops;
    size_t k = 0;
    for (const auto& node : graph.Factors()) {
      if (before.weights[k++] == 0) out.push_back(node.id);
    }
    std::sort(out.begin(), out.end());
    const BatchResult<Pose> without = SolveBatch(WithoutFactors(graph, out), plain);
    BatchResult<Pose> other = SolveBatch(graph, without.T_world_body, next_to);
    const double width = std::sqrt(doubts.price);
    const auto cost = [&](const BatchResult<Pose>& of) { return TruncatedCost(graph, of.T_world_body, robust, width); };
    const bool is_better = HasFactor(other) && cost(other) < cost(before);
    Log(options.log, LogLevel::kInfo, "batch: ", doubts.loops.size(), " loops hold parts of the map that odometry ",
        "would have elsewhere, and ", is_better ? "go" : "stay");
    if (!is_better) break;
    best = std::move(other);
  }
  return best;
}

#define TERSE_INSTANTIATE(Pose)                                                               \
  template std::optional<BatchResult<Pose>> WithoutHangingLoops<Pose>(const PoseGraph<Pose>&, \
                                                                      const BatchResult<Pose>&, const BatchOptions&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
