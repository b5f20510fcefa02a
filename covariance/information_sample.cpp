#include "information_sample.h"

#include <cstdlib>

#include "terse/core/arrival.h"
#include "terse/core/at.h"
#include "terse/core/chi_square.h"
#include "terse/core/definite.h"
#include "terse/covariance/short_cycles.h"

namespace terse::internal {
namespace {

// Where loops are dense fewer poses tell enough.
constexpr long kMostLoopsOf = 10;

}  // namespace

template <class Pose>
InformationSample<Pose> TakeSample(const PoseGraph<Pose>& graph, const EstimateOptions& options) {
  InformationSample<Pose> sample;
  for (const ArrivalStep& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
    const auto poses = static_cast<long>(sample.graph.Poses().size());
    if (poses >= options.sample_poses && sample.loops >= options.sample_loops) break;
    if (sample.loops >= kMostLoopsOf * options.sample_loops) break;
    for (const int p : step.poses) {
      const auto& node = graph.Poses()[At(p)];
      sample.graph.AddPose(node.id, node.T_world_body);
    }
    for (const int f : step.factors) {
      const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&graph.Factors()[At(f)].factor);
      if (edge == nullptr) continue;
      const int from = sample.graph.IndexOf(edge->from), to = sample.graph.IndexOf(edge->to);
      sample.graph.AddFactor(*edge);
      sample.terms.push_back({from, to, *edge, 1});
      sample.is_loop.push_back(std::abs(from - to) > 1);
      sample.loops += sample.is_loop.back();
    }
  }
  return sample;
}

template <class Pose>
double ShareOfAgreeingLoops(const InformationSample<Pose>& sample) {
  using Jacobian = typename Pose::Jacobian;
  const OdometryChain<Pose> odometry(ForwardEdges(sample.terms), sample.graph.Poses().size());
  if (!odometry.IsWhole() || sample.loops == 0) return 0;
  const double most = ChiSquareQuantile(0.99, Pose::kDof);
  long agreeing = 0;
  for (const auto& loop : ForwardEdges(sample.terms, sample.is_loop)) {
    const Pose difference = loop.T_first_last.Inverse() * odometry.Way(loop.first, loop.last);
    const Jacobian Ad = difference.Inverse().Adjoint();
    const Jacobian sum = odometry.CovarianceOf(loop.first, loop.last) + Ad * loop.covariance * Ad.transpose();
    agreeing += MahalanobisSquared<Pose::kDof>(sum, difference.Log()) <= most;
  }
  return static_cast<double>(agreeing) / static_cast<double>(sample.loops);
}

template <class Pose>
double ShareOfAgreeingLoops(const PoseGraph<Pose>& graph, const EstimateOptions& options) {
  return ShareOfAgreeingLoops(TakeSample(graph, options));
}

#define TERSE_INSTANTIATE(Pose)                                                                      \
  template InformationSample<Pose> TakeSample<Pose>(const PoseGraph<Pose>&, const EstimateOptions&); \
  template double ShareOfAgreeingLoops<Pose>(const InformationSample<Pose>&);                        \
  template double ShareOfAgreeingLoops<Pose>(const PoseGraph<Pose>&, const EstimateOptions&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
