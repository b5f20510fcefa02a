#include "terse/core/robust.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "terse/core/arrival.h"
#include "terse/core/chi_square.h"
#include "terse/core/disjoint_sets.h"

namespace terse {
namespace {

double Square(double x) { return x * x; }

}  // namespace

std::string FindDefect(const RobustOptions& options) {
  if (!std::isfinite(options.width) || options.width < 0) return "the robust width must not be negative";
  if (!std::isfinite(options.gnc_step) || options.gnc_step <= 1) return "the step of mu must be above 1";
  if (!(options.quantile > 0 && options.quantile < 1)) return "the quantile of the width must be between 0 and 1";
  return "";
}

double DefaultRobustWidth(RobustKernel kernel, int dimension) { return WidthOf({kernel}, dimension); }

double WidthOf(const RobustOptions& options, int dimension) {
  if (options.width > 0) return options.width;
  const double k = ChiSquareQuantile(options.quantile, dimension);
  return std::sqrt(options.kernel == RobustKernel::kTukey ? 3 * k : k);
}

double RobustCost(RobustKernel kernel, double chi2, double width) {
  const double s = chi2, k = width * width;
  switch (kernel) {
    case RobustKernel::kNone: return s;
    case RobustKernel::kHuber: return s <= k ? s : 2 * width * std::sqrt(s) - k;
    case RobustKernel::kCauchy: return k * std::log1p(s / k);
    case RobustKernel::kTukey: return s >= k ? k / 3 : k / 3 * (1 - std::pow(1 - s / k, 3));
    case RobustKernel::kDcs: return s <= k ? s : k * (3 * s - k) / (s + k);
    case RobustKernel::kGnc: return std::min(s, k);
  }
  return s;
}

double RobustWeight(RobustKernel kernel, double chi2, double width) {
  const double s = chi2, k = width * width;
  switch (kernel) {
    case RobustKernel::kNone: return 1;
    case RobustKernel::kHuber: return s <= k ? 1 : width / std::sqrt(s);
    case RobustKernel::kCauchy: return 1 / (1 + s / k);
    case RobustKernel::kTukey: return s >= k ? 0 : Square(1 - s / k);
    case RobustKernel::kDcs: return s <= k ? 1 : Square(2 * k / (k + s));
    case RobustKernel::kGnc: return s <= k ? 1 : 0;
  }
  return 1;
}

double GncCost(double chi2, double width, double mu) {
  const double s = chi2, k = width * width;
  if (std::isinf(mu)) return std::min(s, k);
  if (s <= k * (mu / (mu + 1))) return s;
  if (s >= k * ((mu + 1) / mu)) return k;
  return 2 * width * std::sqrt(s * mu * (mu + 1)) - mu * (k + s);
}

double GncWeight(double chi2, double width, double mu) {
  const double s = chi2, k = width * width;
  if (std::isinf(mu)) return s <= k ? 1 : 0;
  if (s <= k * (mu / (mu + 1))) return 1;
  if (s >= k * ((mu + 1) / mu)) return 0;
  return std::clamp(width * std::sqrt(mu * (mu + 1) / s) - mu, 0.0, 1.0);
}

double GncStart(double largest_chi2, double width) {
  const double k = width * width;
  return largest_chi2 <= k ? std::numeric_limits<double>::infinity() : k / (2 * largest_chi2 - k);
}

template <class Pose>
std::vector<FactorId> LoopFactors(const PoseGraph<Pose>& graph) {
  internal::DisjointSets joined(graph.Poses().size());
  std::vector<FactorId> loops;
  for (const ArrivalStep& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
    for (const int f : step.factors) {
      const auto& node = graph.Factors()[static_cast<std::size_t>(f)];
      const FactorPoses ends = PosesOf(node.factor);
      if (ends.count < 2) continue;
      const auto index = [&](PoseId id) { return static_cast<std::size_t>(graph.IndexOf(id)); };
      if (!joined.Join(index(ends.first), index(ends.second))) loops.push_back(node.id);
    }
  }
  std::sort(loops.begin(), loops.end());
  return loops;
}

template <class Pose>
std::vector<FactorId> SlippedOdometry(const PoseGraph<Pose>& graph, const std::vector<double>& weights) {
  std::vector<FactorId> slipped;
  const std::vector<FactorId> loops = LoopFactors(graph);
  auto weight = weights.begin();
  for (const auto& node : graph.Factors()) {
    if (weight == weights.end()) break;
    if (*weight++ == 0 && !std::binary_search(loops.begin(), loops.end(), node.id)) slipped.push_back(node.id);
  }
  return slipped;
}

template <class Pose>
PoseGraph<Pose> WithWeights(const PoseGraph<Pose>& graph, const std::vector<double>& weights) {
  PoseGraph<Pose> out = graph;
  if (weights.empty()) return out;
  if (weights.size() != graph.Factors().size()) throw std::invalid_argument("one weight per factor is needed");
  auto weight = weights.begin();
  for (const auto& node : graph.Factors()) {
    if (*weight != 1) {
      const auto* relative = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
      if (relative == nullptr) throw std::invalid_argument("priors have no weights");
      RelativePoseFactor<Pose> loop = *relative;
      loop.information *= *weight;
      out.RemoveFactor(node.id);
      if (FindDefect<Pose>(loop).empty()) out.AddFactor(loop);  // not if the weight is zero
    }
    ++weight;
  }
  return out;
}

template <class Pose>
PoseGraph<Pose> WithoutFactors(PoseGraph<Pose> graph, const std::vector<FactorId>& ids) {
  for (const FactorId id : ids) graph.RemoveFactor(id);
  return graph;
}

#define TERSE_INSTANTIATE(Pose)                                                                             \
  template std::vector<FactorId> LoopFactors<Pose>(const PoseGraph<Pose>&);                                 \
  template std::vector<FactorId> SlippedOdometry<Pose>(const PoseGraph<Pose>&, const std::vector<double>&); \
  template PoseGraph<Pose> WithWeights<Pose>(const PoseGraph<Pose>&, const std::vector<double>&);           \
  template PoseGraph<Pose> WithoutFactors<Pose>(PoseGraph<Pose>, const std::vector<FactorId>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
