#include "terse/core/position_start.h"

#include <algorithm>
#include <optional>

#include "batch/chordal.h"
#include "terse/core/decompositions.h"
#include "terse/core/frame_alignment.h"
#include "terse/core/gauge.h"
#include "terse/core/residual.h"

namespace terse::internal {
namespace {

using std::size_t;

// A stretch tells how it is turned to 0.05 rad, so that Gauss-Newton does the rest; it has three priors at least, one
// of which may be off.
constexpr double kStretchInformation = 400;
constexpr size_t kLeastPriors = 3;
// How much a stretch sticks to the turn of the one before, 1 / rad^2: decides what the priors leave open.
constexpr double kPreference = 1;
constexpr double kGrowth = 1.25;  // of a stretch that is too short, a prior at least

template <class Pose>
double CostOf(const PoseGraph<Pose>& graph, const std::vector<Pose>& values) {
  const auto value = [&](PoseId id) -> const Pose& { return values[static_cast<size_t>(graph.IndexOf(id))]; };
  double cost = 0;
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    cost += FactorChi2(node.factor, value(ends.first), value(ends.second));
  }
  for (const auto& node : graph.Poses()) {
    if (!node.fixed || !node.T_world_body) continue;
    cost += FactorChi2<Pose>(FixedPosePrior<Pose>(node.id, *node.T_world_body), value(node.id), value(node.id));
  }
  return cost;
}

template <class Pose>
std::vector<std::pair<Factor<Pose>, Pose>> AbsoluteOf(const PoseGraph<Pose>& graph, const std::vector<Pose>& values) {
  std::vector<std::pair<Factor<Pose>, Pose>> out;
  const auto add = [&](PoseId id, const Factor<Pose>& factor) {
    out.emplace_back(factor, values[static_cast<size_t>(graph.IndexOf(id))]);
  };
  for (const auto& node : graph.Poses()) {
    if (node.fixed && node.T_world_body) add(node.id, FixedPosePrior<Pose>(node.id, *node.T_world_body));
  }
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    if (ends.count == 1) add(ends.first, node.factor);
  }
  return out;
}

// The position priors in order of arrival, and sums over them from which the spread of any stretch follows.
template <class Pose>
class Stretches {
 public:
  Stretches(const PoseGraph<Pose>& graph, const std::vector<int>& order, const std::vector<Pose>& values) {
    std::vector<size_t> rank(order.size());
    for (size_t k = 0; k < order.size(); ++k) rank[static_cast<size_t>(order[k])] = k;
    std::vector<std::pair<size_t, const PositionPriorFactor<Pose>*>> priors;
    for (const auto& node : graph.Factors()) {
      const auto* f = std::get_if<PositionPriorFactor<Pose>>(&node.factor);
      if (f != nullptr) priors.emplace_back(rank[static_cast<size_t>(graph.IndexOf(f->pose))], f);
    }
    std::stable_sort(priors.begin(), priors.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    sums_.emplace_back();
    for (const auto& [at, f] : priors) {
      ranks_.push_back(at);
      points_.old_frame.push_back(values[static_cast<size_t>(order[at])] * f->p_body);
      points_.new_frame.push_back(f->p_world);
      points_.weights.push_back(f->information.trace() / Pose::kDim);
      const Point p = points_.old_frame.back() - points_.old_frame.front();
      const double w = points_.weights.back();
      Sum sum = sums_.back();
      sum.weight += w;
      sum.first += w * p;
      sum.second += w * p * p.transpose();
      sums_.push_back(sum);
    }
  }

  size_t Count() const { return ranks_.size(); }
  size_t RankOf(size_t prior) const { return ranks_[prior]; }

  // T_new_old of the stretch around each prior; empty if even all priors together do not tell how they are turned.
  std::vector<Pose> Corrections() const {
    std::vector<Pose> out;
    const size_t n = Count();
    if (n < kLeastPriors || InformationOf(0, n) < kStretchInformation) return out;
    Pose previous = FitPoints(points_, 0, n, Pose(), kPreference);
    for (size_t k = 0; k < n; ++k) {
      size_t half = 1;
      const auto first = [&] { return k > half ? k - half : 0; };
      const auto last = [&] { return std::min(n, k + half + 1); };
      while (last() - first() < n &&
             (last() - first() < kLeastPriors || InformationOf(first(), last()) < kStretchInformation)) {
        half = std::max(half + 1, static_cast<size_t>(kGrowth * static_cast<double>(half)));
      }
      previous = FitPoints(points_, first(), last(), previous, kPreference);
      out.push_back(previous);
    }
    return out;
  }

 private:
  using Point = Eigen::Matrix<double, Pose::kDim, 1>;
  using Block = Eigen::Matrix<double, Pose::kDim, Pose::kDim>;
  struct Sum {
    double weight = 0;
    Point first = Point::Zero();
    Block second = Block::Zero();
  };

  // About turns across the stretch's longest direction, 1 / rad^2, from where the priors were composed to be: noise
  // spreads the measured points even where nothing moves.
  double InformationOf(size_t first, size_t last) const {
    const double weight = sums_[last].weight - sums_[first].weight;
    if (!(weight > 0)) return 0;
    const Point mean = (sums_[last].first - sums_[first].first) / weight;
    const Block spread = sums_[last].second - sums_[first].second - weight * mean * mean.transpose();
    return SymmetricEigenvalues<Pose::kDim>(spread)[Pose::kDim - 1];
  }

  std::vector<size_t> ranks_;
  WeightedPoints<Pose> points_;
  std::vector<Sum> sums_;  // over the priors before
};

template <class Pose>
std::optional<std::vector<Pose>> Piecewise(const PoseGraph<Pose>& graph, const std::vector<int>& order,
                                           const std::vector<Pose>& values) {
  const Stretches<Pose> stretches(graph, order, values);
  const std::vector<Pose> corrections = stretches.Corrections();
  if (corrections.empty()) return std::nullopt;
  std::vector<Pose> out = values;
  size_t next = 0;  // the first prior behind the pose
  for (size_t k = 0; k < order.size(); ++k) {
    while (next < corrections.size() && stretches.RankOf(next) <= k) ++next;
    Pose& T = out[static_cast<size_t>(order[k])];
    const Pose T_before = corrections[next > 0 ? next - 1 : 0] * T;
    const Pose T_behind = corrections[std::min(next, corrections.size() - 1)] * T;
    double share = 0;
    if (next > 0 && next < corrections.size()) {
      const double from = static_cast<double>(stretches.RankOf(next - 1));
      share = (static_cast<double>(k) - from) / (static_cast<double>(stretches.RankOf(next)) - from);
    }
    T = T_before.Retract(share * T_before.Local(T_behind));
    T.Normalize();
  }
  // What a fixed pose is off by is its own: the stretches are where they belong.
  for (size_t k = 0; k < out.size(); ++k) {
    const auto& node = graph.Poses()[k];
    if (node.fixed && node.T_world_body) out[k] = *node.T_world_body;
  }
  return out;
}

}  // namespace

template <class Pose>
PositionStart MoveToPositionPriors(const PoseGraph<Pose>& graph, const std::vector<int>& order,
                                   std::vector<Pose>& T_world_body) {
  if (CountAbsoluteFactors(graph).position_priors == 0) return PositionStart::kAsComposed;
  PositionStart best = PositionStart::kAsComposed;
  double least = CostOf(graph, T_world_body);
  std::vector<Pose> chosen;
  const auto consider = [&](PositionStart what, std::vector<Pose> values) {
    const double cost = CostOf(graph, values);
    if (!(cost < least)) return;
    least = cost;
    best = what;
    chosen = std::move(values);
  };
  // The first leaves alone what the priors hardly know, the second meets exact ones, however weak they claim to be.
  for (const auto& T_new_old :
       {AlignToAbsolute(AbsoluteOf(graph, T_world_body)), AlignToPositionPriors(graph, T_world_body)}) {
    if (!T_new_old) continue;
    std::vector<Pose> rigid = T_world_body;
    for (Pose& T : rigid) T = *T_new_old * T;
    consider(PositionStart::kRigid, std::move(rigid));
  }
  if (auto piecewise = Piecewise(graph, order, T_world_body)) {
    consider(PositionStart::kPiecewise, std::move(*piecewise));
  }
  if (best != PositionStart::kAsComposed) T_world_body = std::move(chosen);
  return best;
}

template PositionStart MoveToPositionPriors<SE2>(const PoseGraph<SE2>&, const std::vector<int>&, std::vector<SE2>&);
template PositionStart MoveToPositionPriors<SE3>(const PoseGraph<SE3>&, const std::vector<int>&, std::vector<SE3>&);

}  // namespace terse::internal
