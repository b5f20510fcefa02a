#include "terse/core/robust.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "support/disjoint_sets.h"
#include "terse/core/arrival.h"

namespace terse {
namespace {

constexpr double kPi = 3.14159265358979323846;

double Square(double x) { return x * x; }

// P(chi-square > x): the recursion of the incomplete gamma function in steps of two degrees of freedom.
double ChiSquareTail(double x, int dof) {
  const double h = x / 2;
  double tail = dof % 2 == 0 ? std::exp(-h) : std::erfc(std::sqrt(h));
  // h^a e^-h / Gamma(a + 1) for a = dof / 2 - 1, ...
  double term = dof % 2 == 0 ? std::exp(-h) : 2 * std::sqrt(h / kPi) * std::exp(-h);
  for (int d = dof % 2 == 0 ? 2 : 1; d < dof; d += 2) {
    if (d > 1) term *= h / (d / 2.0);
    tail += term;
  }
  return tail;
}

}  // namespace

std::string FindDefect(const RobustOptions& options) {
  if (!std::isfinite(options.width) || options.width < 0) return "the robust width must not be negative";
  if (!std::isfinite(options.gnc_step) || options.gnc_step <= 1) return "the step of mu must be above 1";
  return "";
}

double ChiSquareQuantile(double probability, int dof) {
  if (!(probability >= 0) || !(probability < 1) || dof < 1) {
    throw std::invalid_argument("a chi-square quantile needs a probability in [0, 1) and a degree of freedom");
  }
  double low = 0, high = dof;
  while (ChiSquareTail(high, dof) > 1 - probability) high *= 2;
  for (double middle = high / 2; low < middle && middle < high; middle = low + (high - low) / 2) {
    (ChiSquareTail(middle, dof) > 1 - probability ? low : high) = middle;
  }
  return high;
}

double DefaultRobustWidth(RobustKernel kernel, int dimension) {
  const double k = ChiSquareQuantile(0.99, dimension);
  return std::sqrt(kernel == RobustKernel::kTukey ? 3 * k : k);
}

double WidthOf(const RobustOptions& options, int dimension) {
  return options.width > 0 ? options.width : DefaultRobustWidth(options.kernel, dimension);
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

template std::vector<FactorId> LoopFactors<SE2>(const PoseGraph<SE2>&);
template std::vector<FactorId> LoopFactors<SE3>(const PoseGraph<SE3>&);

}  // namespace terse
