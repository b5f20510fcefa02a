#include "terse/core/open_loops.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

#include "incremental/judged_loop.h"
#include "terse/core/at.h"
#include "terse/core/definite.h"
#include "terse/core/log_message.h"
#include "terse/core/loop_contest.h"
#include "terse/core/require_optimum.h"

namespace terse::internal {
namespace {

// That are heard at once, the most likely ones, and how often.
constexpr std::size_t MostOpen(int B) { return B == 3 ? 100 : 50; }
constexpr int kMostRounds = 3;

// A loop that is out, at an optimum.
template <class Pose>
struct LoopOut {
  static constexpr int B = Pose::kDof;
  FactorId id;
  Vector<B> residual;
  PathColumns<B> z;  // its covariance is their Gram matrix

  LoopOut(FactorId loop_id, const RelativePoseFactor<Pose>& loop, const PoseGraph<Pose>& graph,
          const BatchResult<Pose>& solved)
      : id(loop_id) {
    LinearFactor<B> linear;
    linear.first = graph.IndexOf(loop.from);
    linear.second = graph.IndexOf(loop.to);
    const Pose& T_world_from = solved.T_world_body[At(linear.first)];
    const Pose& T_world_to = solved.T_world_body[At(linear.second)];
    CompareExponentially(loop, SquareRootInformation(Factor<Pose>(loop)), T_world_from, T_world_to,
                         T_world_to.Inverse() * T_world_from, linear);
    residual = linear.residual;
    z = SolveForward(solved.cholesky.Tree(), linear);
  }
  double Innovation() const {
    const Matrix<B, B> S = Matrix<B, B>::Identity() + Gram<B>(z, z);
    return MahalanobisSquared<B>(S, residual);
  }
};

template <class Pose>
double SquaredByFar(const BatchResult<Pose>& solved) {
  return kByFar * solved.robust_width * solved.robust_width;
}

// Of the robust factors those that are out, but not by far, the most likely ones. Their columns are made twice, so that
// those of all are never held.
template <class Pose>
std::vector<LoopOut<Pose>> OpenLoops(const PoseGraph<Pose>& graph, const BatchResult<Pose>& solved,
                                     const std::vector<FactorId>& robust) {
  std::vector<std::pair<double, FactorId>> open;
  std::size_t k = 0;
  for (const auto& node : graph.Factors()) {
    const double weight = solved.weights[k++];
    const auto* loop = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (weight > 0 || loop == nullptr || !std::binary_search(robust.begin(), robust.end(), node.id)) continue;
    const double innovation = InnovationOf(*loop, graph, solved);
    if (innovation <= SquaredByFar(solved)) open.emplace_back(innovation, node.id);
  }
  std::sort(open.begin(), open.end());
  if (open.size() > MostOpen(Pose::kDof)) open.resize(MostOpen(Pose::kDof));
  std::vector<LoopOut<Pose>> likely;
  likely.reserve(open.size());
  for (const auto& [innovation, id] : open) {
    likely.emplace_back(id, std::get<RelativePoseFactor<Pose>>(graph.FindFactor(id)->factor), graph, solved);
  }
  return likely;
}

// Without those that the others and the map contradict by far together, ascending.
template <class Pose>
std::vector<FactorId> Compatible(const std::vector<LoopOut<Pose>>& open, const BatchResult<Pose>& solved) {
  constexpr int B = Pose::kDof;
  Eigen::VectorXd residual(static_cast<Eigen::Index>(open.size()) * B);
  std::vector<const PathColumns<B>*> columns;
  for (const auto& loop : open) {
    residual.segment<B>(static_cast<Eigen::Index>(columns.size()) * B) = loop.residual;
    columns.push_back(&loop.z);
  }
  Contest<B> contest(std::move(residual), JointGram<B>(columns), std::vector<char>(open.size(), 0),
                     std::sqrt(SquaredByFar(solved)));
  for (std::size_t i = 0; i < open.size(); ++i) contest.Flip(i);
  contest.Descend();
  std::vector<FactorId> in;
  for (std::size_t i = 0; i < open.size(); ++i) {
    if (contest.In()[i] != 0) in.push_back(open[i].id);
  }
  std::sort(in.begin(), in.end());
  return in;
}

// The optimum next to that with all of these in.
template <class Pose>
BatchResult<Pose> SolveWith(const std::vector<FactorId>& in, const PoseGraph<Pose>& graph,
                            const std::vector<Pose>& T_world_body, const BatchOptions& options) {
  BatchOptions certain = options;
  certain.robust_factors->clear();
  std::set_difference(options.robust_factors->begin(), options.robust_factors->end(), in.begin(), in.end(),
                      std::back_inserter(*certain.robust_factors));
  BatchResult<Pose> with = SolveBatch(graph, T_world_body, certain);
  return HasFactor(with) ? SolveBatch(graph, with.T_world_body, options) : std::move(with);
}

}  // namespace

template <class Pose>
double InnovationOf(const RelativePoseFactor<Pose>& loop, const PoseGraph<Pose>& graph,
                    const BatchResult<Pose>& solved) {
  return LoopOut<Pose>(FactorId(), loop, graph, solved).Innovation();
}

template <class Pose>
double TruncatedCost(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body,
                     const std::vector<FactorId>& robust, double width) {
  double cost = 0;
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    const auto value = [&](PoseId id) { return T_world_body[At(graph.IndexOf(id))]; };
    const double chi2 = FactorChi2(node.factor, value(ends.first), value(ends.second));
    cost += std::binary_search(robust.begin(), robust.end(), node.id) ? std::min(chi2, width * width) : chi2;
  }
  return cost;
}

template <class Pose>
BatchResult<Pose> SolveWithOpenLoops(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body,
                                     const BatchOptions& options, const IsBetter<Pose>& is_better) {
  BatchResult<Pose> solved = SolveBatch(graph, T_world_body, options);
  for (int round = 0; round < kMostRounds && HasFactor(solved); ++round) {
    const std::vector<LoopOut<Pose>> open = OpenLoops(graph, solved, *options.robust_factors);
    if (open.empty()) break;
    const std::vector<FactorId> in = Compatible(open, solved);
    if (in.empty()) break;
    BatchResult<Pose> with = SolveWith(in, graph, solved.T_world_body, options);
    const bool come_in = HasFactor(with) && is_better(with, solved);
    Log(options.log, LogLevel::kInfo, "batch: ", open.size(), " loops left out though the map knows little of them, ",
        in.size(), " agree, and ", come_in ? "come in" : "stay out");
    if (!come_in) break;
    solved = std::move(with);
  }
  return solved;
}

#define TERSE_INSTANTIATE(Pose)                                                                                       \
  template double InnovationOf<Pose>(const RelativePoseFactor<Pose>&, const PoseGraph<Pose>&,                         \
                                     const BatchResult<Pose>&);                                                       \
  template double TruncatedCost<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&, const std::vector<FactorId>&, \
                                      double);                                                                        \
  template BatchResult<Pose> SolveWithOpenLoops<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&,               \
                                                      const BatchOptions&, const IsBetter<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
