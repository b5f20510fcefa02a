#include "incremental/slip_search.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "terse/core/at.h"
#include "terse/core/definite.h"
#include "terse/core/front_paths.h"
#include "terse/core/residual.h"
#include "terse/core/robust.h"

namespace terse::internal {
namespace {

using std::size_t;

// Loops are from different places if they are farther from each other than this, in order of arrival, at an end.
constexpr int kReachOfPlace = 9;
// A loop may say the same as another if its chi2 falls by this factor, or below what a true one has; so many of them,
// the closest first, are compared by covariance.
constexpr double kMuchLess = 9;
constexpr size_t kMostWitnesses = 30;
// Until so many in a row do not: the closest come first.
constexpr size_t kMostInVain = 8;
constexpr double kTolerance = 1e-6;  // of costs that are compared
// A robot does not jump. Where loops have it move farther from one pose to the next, in steps as odometry has the
// longest, it is two places that look alike that they take for one, however many they are.
constexpr double kMostSteps = 10, kMostDeviations = 3;
// With wrong loops among those that are in, a solver creeps; what it is worth shows long before.
constexpr int kMostIterations = 20;

// From index `first` to a later one.
template <class Pose>
struct Span {
  FactorId id;
  int first, last;
  Pose T_first_last;
};

template <class Pose>
std::optional<Span<Pose>> SpanOf(FactorId id, const PoseGraph<Pose>& graph) {
  const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&graph.FindFactor(id)->factor);
  if (edge == nullptr) return std::nullopt;
  const int from = graph.IndexOf(edge->from), to = graph.IndexOf(edge->to);
  if (from < to) return Span<Pose>{id, from, to, edge->T_from_to};
  return Span<Pose>{id, to, from, edge->T_from_to.Inverse()};
}

// kLeastPlaces at most.
template <class Pose>
int CountPlaces(const std::vector<Span<Pose>>& spans) {
  std::vector<Span<Pose>> places;
  for (const auto& span : spans) {
    const bool is_new = std::none_of(places.begin(), places.end(), [&](const Span<Pose>& other) {
      return std::abs(span.first - other.first) <= kReachOfPlace && std::abs(span.last - other.last) <= kReachOfPlace;
    });
    if (is_new) places.push_back(span);
    if (places.size() == At(kLeastPlaces)) break;
  }
  return static_cast<int>(places.size());
}

template <class Pose>
class Search {
 public:
  static constexpr int B = Pose::kDof;
  using Covariance = Matrix<B, B>;
  Search(const KnownLoops& loops, double width, const LinearizedGraph<Pose>& map)
      : loops_(loops), k_(width * width), map_(map) {}

  std::optional<Slip<Pose>> Find() {
    const std::optional<Span<Pose>> newcomer = SpanOf(loops_.newcomer);
    if (!newcomer || newcomer->last - newcomer->first < 2) return std::nullopt;
    correction_ = map_.EstimateAt(newcomer->first) * newcomer->T_first_last * map_.EstimateAt(newcomer->last).Inverse();
    FindWitnesses(*newcomer);
    if (Places() < kLeastPlaces) return std::nullopt;
    const std::optional<Slip<Pose>> slip = Blame();
    return slip ? Verified(*slip) : std::nullopt;
  }

 private:
  std::optional<Span<Pose>> SpanOf(FactorId id) const { return internal::SpanOf(id, map_.Graph()); }
  double Chi2(FactorId id, const Pose& T_world_first, const Pose& T_world_last) const {
    const auto& factor = map_.Graph().FindFactor(id)->factor;
    const FactorPoses ends = PosesOf(factor);
    const bool is_forward = map_.Graph().IndexOf(ends.first) < map_.Graph().IndexOf(ends.second);
    return is_forward ? FactorChi2(factor, T_world_first, T_world_last)
                      : FactorChi2(factor, T_world_last, T_world_first);
  }
  double Chi2Corrected(const Span<Pose>& span) const {
    return Chi2(span.id, map_.EstimateAt(span.first), correction_ * map_.EstimateAt(span.last));
  }

  // Of a loop's measurement, tangent at its later pose.
  Covariance CovarianceOf(const Span<Pose>& span) const {
    const auto& edge = std::get<RelativePoseFactor<Pose>>(map_.Graph().FindFactor(span.id)->factor);
    Covariance covariance = InverseOfDefinite<B>(edge.information);
    if (map_.Graph().IndexOf(edge.from) == span.first) return covariance;
    const Covariance turn = edge.T_from_to.Adjoint();
    return turn * covariance * turn.transpose();
  }
  // Of the way from one pose to another as the map has it, tangent at the second.
  Covariance CovarianceOf(int from, int to) const {
    if (from == to) return Covariance::Zero();
    const Pose &T_from = map_.Points()[At(from)], &T_to = map_.Points()[At(to)];
    const RelativePoseFactor<Pose> way{{}, {}, T_from.Inverse() * T_to, Covariance::Identity()};
    const PathColumns<B> z =
        SolveForward(map_.Cholesky().Tree(), Linearize<Pose>(way, Covariance::Identity(), from, to, T_from, T_to));
    return Gram<B>(z, z);
  }

  // Whether the cycle closes that leads along one loop, to the end of another, back along that and to the first one's
  // start: the covariances of both loops and of the ways between their ends, none of which crosses the slip.
  bool Agree(const Span<Pose>& a, const Span<Pose>& b) const {
    const auto T = [&](int v) { return map_.EstimateAt(v); };
    const Pose start = T(b.first).Inverse() * T(a.first), end = T(a.last).Inverse() * T(b.last);
    const Pose T_first_last = start * a.T_first_last * end;
    const Covariance by_end = end.Inverse().Adjoint(), by_start = T_first_last.Inverse().Adjoint();
    const Covariance covariance = CovarianceOf(b) + CovarianceOf(a.last, b.last) +
                                  by_end * CovarianceOf(a) * by_end.transpose() +
                                  by_start * CovarianceOf(a.first, b.first) * by_start.transpose();
    const Vector<B> error = b.T_first_last.Local(T_first_last);
    return MahalanobisSquared<B>(covariance, error) <= k_;
  }

  // Loops that the correction explains, across a stretch that as many as possible have in common.
  void FindWitnesses(const Span<Pose>& newcomer) {
    std::vector<std::pair<double, Span<Pose>>> close;
    for (const FactorId id : loops_.out) {
      const std::optional<Span<Pose>> span = SpanOf(id);
      if (id == newcomer.id || !span || span->first >= newcomer.last || span->last <= newcomer.first) continue;
      const double after = Chi2Corrected(*span);
      if (after <= k_ || after * kMuchLess < map_.Chi2Of(id)) close.emplace_back(after, *span);
    }
    TakeWitnesses(newcomer, close);
    if (Places() < kLeastPlaces) return;
    std::sort(close.begin(), close.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    if (close.size() > kMostWitnesses) close.resize(kMostWitnesses);
    std::vector<std::pair<double, Span<Pose>>> agreeing;
    size_t in_vain = 0;
    for (auto it = close.begin(); it != close.end() && in_vain < kMostInVain; ++it) {
      const bool agrees = Agree(newcomer, it->second);
      in_vain = agrees ? 0 : in_vain + 1;
      if (agrees) agreeing.push_back(*it);
    }
    TakeWitnesses(newcomer, agreeing);
  }

  // The stretch, and those of these that cross it.
  void TakeWitnesses(const Span<Pose>& newcomer, const std::vector<std::pair<double, Span<Pose>>>& spans) {
    std::vector<std::pair<int, int>> events;  // a span ends before another begins at the same pose
    for (const auto& [chi2, span] : spans) {
      events.emplace_back(std::max(span.first, newcomer.first), 1);
      events.emplace_back(std::min(span.last, newcomer.last), -1);
    }
    std::sort(events.begin(), events.end());
    int open = 0, most = 0, at = newcomer.first;
    for (const auto& [pose, change] : events) {
      open += change;
      if (open > most) most = open, at = pose;
    }
    witnesses_ = {newcomer};
    first_ = newcomer.first;
    last_ = newcomer.last;
    for (const auto& [chi2, span] : spans) {
      if (span.first > at || span.last <= at) continue;
      witnesses_.push_back(span);
      first_ = std::max(first_, span.first);
      last_ = std::min(last_, span.last);
    }
  }

  int Places() const { return CountPlaces(witnesses_); }

  // As far as a robot can have gone from one pose to the next.
  double FarthestStep() const {
    if (farthest_) return *farthest_;
    const std::vector<FactorId> in = loops_.in();
    double longest = 0;
    for (const auto& node : map_.Graph().Factors()) {
      const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
      if (edge == nullptr || map_.SlotOf(node.id) < 0) continue;
      const int apart = std::abs(map_.Graph().IndexOf(edge->from) - map_.Graph().IndexOf(edge->to));
      if (apart == 1 && !std::binary_search(in.begin(), in.end(), node.id)) {
        longest = std::max(longest, edge->T_from_to.Translation().norm());
      }
    }
    farthest_ = longest > 0 ? kMostSteps * longest : std::numeric_limits<double>::infinity();
    return *farthest_;
  }
  // By how much the step from pose v that a loop across it says may be too long: the ways to its ends have drifted.
  double DriftAt(int v, const Pose& step, const Span<Pose>& across) const {
    const auto seen_from = [](const Pose& T, const Covariance& covariance) -> Covariance {
      return T.Adjoint() * covariance * T.Adjoint().transpose();
    };
    const Pose T_next_last = map_.EstimateAt(v + 1).Inverse() * map_.EstimateAt(across.last);
    const Covariance covariance = seen_from(step.Inverse(), CovarianceOf(across.first, v)) +
                                  seen_from(T_next_last, CovarianceOf(v + 1, across.last) + CovarianceOf(across));
    return kMostDeviations * std::sqrt(covariance.template topLeftCorner<Pose::kDim, Pose::kDim>().trace());
  }
  bool IsJump(int v, const Pose& step, const std::vector<FactorId>& loops) const {
    const double length = step.Translation().norm();
    if (length <= FarthestStep()) return false;
    const std::optional<Span<Pose>> across = loops.empty() ? std::nullopt : SpanOf(loops.front());
    const bool crosses = across && across->first <= v && v < across->last;
    return length > FarthestStep() + (crosses ? DriftAt(v, step, *across) : 0);
  }

  // The odometry edge that the fewest loops defend; of these the one that would have to be the least wrong. One across
  // which the robot seems to have jumped only if there is no other: drift may say so, or a group be at fault.
  std::optional<Slip<Pose>> Blame() const {
    const std::vector<FactorId> in = loops_.in();
    const auto is_in = [&](int slot) { return std::binary_search(in.begin(), in.end(), map_.IdAt(slot)); };
    std::vector<Span<Pose>> defending;
    std::vector<int> defenders(At(last_ - first_ + 1));
    for (const FactorId id : in) {
      const std::optional<Span<Pose>> span = SpanOf(id);
      if (!span || span->first >= last_ || span->last <= first_ || Chi2Corrected(*span) <= k_) continue;
      defending.push_back(*span);
      ++defenders[At(std::max(span->first, first_) - first_)];
      --defenders[At(std::min(span->last, last_) - first_)];
    }
    double least = std::numeric_limits<double>::infinity();
    int fewest = std::numeric_limits<int>::max(), at = -1, open = 0;
    bool is_jump = true;
    std::optional<FactorId> blamed;
    for (int v = first_; v < last_; ++v) {
      open += defenders[At(v - first_)];
      if (open > fewest && !is_jump) continue;
      const Pose step = map_.EstimateAt(v).Inverse() * correction_ * map_.EstimateAt(v + 1);
      const bool jumps = step.Translation().norm() > FarthestStep();
      const bool is_first = is_jump && !jumps;  // that it did not jump across
      if (jumps > is_jump || (open > fewest && !is_first)) continue;
      const int slot = OdometrySlot(v, is_in, map_);
      if (slot < 0) continue;
      const FactorId odometry = map_.IdAt(slot);
      const double wrong = Chi2(odometry, map_.EstimateAt(v), correction_ * map_.EstimateAt(v + 1));
      if (open == fewest && wrong >= least && !is_first) continue;
      fewest = open, least = wrong, at = v, blamed = odometry, is_jump = jumps;
    }
    if (!blamed || fewest + kSlipPrice >= static_cast<double>(witnesses_.size())) return std::nullopt;
    Slip<Pose> slip{*blamed, {}, {}, map_.Estimates()};
    for (const auto& span : witnesses_) slip.comes.push_back(span.id);
    for (const auto& span : defending) {
      if (span.first <= at && at < span.last) slip.goes.push_back(span.id);
    }
    for (size_t v = At(at) + 1; v < slip.T_world_body.size(); ++v) {
      slip.T_world_body[v] = correction_ * slip.T_world_body[v];
    }
    return slip;
  }

  double Chi2At(const Factor<Pose>& factor, const std::vector<Pose>& T_world_body) const {
    const FactorPoses ends = PosesOf(factor);
    const auto T = [&](PoseId id) -> const Pose& { return T_world_body[At(map_.Graph().IndexOf(id))]; };
    return FactorChi2(factor, T(ends.first), T(ends.second));
  }

  // Truncated least squares of the map with or without one odometry edge.
  double Cost(const std::vector<Pose>& T_world_body, FactorId without) const {
    const std::vector<FactorId> in = loops_.in();
    double sum = 0;
    for (const auto& node : map_.Graph().Factors()) {
      if (node.id == without) continue;
      const double chi2 = Chi2At(node.factor, T_world_body);
      const bool is_chosen = map_.SlotOf(node.id) < 0 || std::binary_search(in.begin(), in.end(), node.id);
      sum += is_chosen ? std::min(chi2, k_) : chi2;
    }
    return sum;
  }

  struct Optimum {
    double cost;
    std::vector<Pose> T_world_body;  // empty: there is none
  };
  // With what comes in, without what goes and without the slip.
  Optimum Solved(const Slip<Pose>& slip) const {
    const auto has = [](const std::vector<FactorId>& ids, FactorId id) {
      return std::find(ids.begin(), ids.end(), id) != ids.end();
    };
    std::vector<double> weights;
    for (const auto& node : map_.Graph().Factors()) {
      const bool was_in = map_.SlotOf(node.id) >= 0;
      const bool is_in = was_in ? node.id != slip.odometry && !has(slip.goes, node.id) : has(slip.comes, node.id);
      weights.push_back(is_in ? 1 : 0);
    }
    BatchOptions options;
    options.relative_tolerance = kTolerance;
    options.max_iterations = kMostIterations;
    const BatchResult<Pose> with = SolveBatch(WithWeights(map_.Graph(), weights), slip.T_world_body, options);
    if (with.termination == Termination::kNotPositiveDefinite) return {std::numeric_limits<double>::infinity(), {}};
    const double price = slip.odometry ? kSlipPrice * k_ : 0;
    return {Cost(with.T_world_body, slip.odometry.value_or(FactorId())) + price, with.T_world_body};
  }

  // Loops that are in and lead from where one does to where it does, which has the end closest to the slip on one side.
  std::vector<FactorId> GroupAt(int v, bool before, const std::vector<Span<Pose>>& in) const {
    const Span<Pose>* seed = nullptr;
    int closest = kReachOfGroup + 1;
    for (const auto& span : in) {
      for (const int end : {span.first, span.last}) {
        const int distance = before ? v - end : end - v - 1;
        if (distance >= 0 && distance < closest) closest = distance, seed = &span;
      }
    }
    std::vector<FactorId> group;
    for (const auto& span : in) {
      const bool is_near = seed != nullptr && std::abs(span.first - seed->first) <= kReachOfGroup &&
                           std::abs(span.last - seed->last) <= kReachOfGroup;
      if (is_near) group.push_back(span.id);
    }
    return group;
  }

 public:
  // A group of loops at one side is one mistake as well, and is blamed instead if that costs no more: as much as a slip
  // at most, however many they are. A jump is no slip.
  std::optional<Slip<Pose>> Verified(const Slip<Pose>& slip) const {
    const Optimum alone = Solved(slip);
    const double cost_now = Cost(map_.Estimates(), FactorId());
    if (!(alone.cost < cost_now)) return std::nullopt;
    const FactorPoses ends = PosesOf(map_.Graph().FindFactor(*slip.odometry)->factor);
    const int v = std::min(map_.Graph().IndexOf(ends.first), map_.Graph().IndexOf(ends.second));
    const bool jumps = IsJump(v, alone.T_world_body[At(v)].Inverse() * alone.T_world_body[At(v) + 1], slip.comes);
    std::vector<Span<Pose>> in;
    for (const FactorId id : loops_.in()) {
      const bool stays = std::find(slip.goes.begin(), slip.goes.end(), id) == slip.goes.end();
      if (const auto span = SpanOf(id); span && stays) in.push_back(*span);
    }
    double lowest = jumps ? cost_now : alone.cost;
    std::optional<Slip<Pose>> best;
    if (!jumps) {
      best = slip;
      best->T_world_body = alone.T_world_body;
    }
    for (const bool before : {true, false}) {
      const std::vector<FactorId> group = GroupAt(v, before, in);
      if (group.empty()) continue;
      Slip<Pose> other = slip;
      other.odometry.reset();
      other.goes.insert(other.goes.end(), group.begin(), group.end());
      other.T_world_body = alone.T_world_body;
      const Optimum without = Solved(other);
      if (without.T_world_body.empty()) continue;
      double counted = 0;
      for (const FactorId id : group) {
        counted += std::min(Chi2At(map_.Graph().FindFactor(id)->factor, without.T_world_body), k_);
      }
      const double cost = without.cost - std::max(0.0, counted - kSlipPrice * k_);
      if (best ? cost > lowest : cost >= lowest) continue;
      lowest = cost;
      best = other;
      best->T_world_body = without.T_world_body;
    }
    return best;
  }

 private:
  const KnownLoops& loops_;
  double k_;
  const LinearizedGraph<Pose>& map_;
  Pose correction_;                         // of what comes after the slip
  mutable std::optional<double> farthest_;  // that a robot goes in one step
  std::vector<Span<Pose>> witnesses_;
  int first_ = 0, last_ = 0;  // poses between which all of them say that it is
};

}  // namespace

template <class Pose>
std::optional<Slip<Pose>> FindSlip(const KnownLoops& loops, double width, const LinearizedGraph<Pose>& map) {
  return Search<Pose>(loops, width, map).Find();
}

template <class Pose>
std::optional<Slip<Pose>> VerifySlip(const Slip<Pose>& slip, const KnownLoops& loops, double width,
                                     const LinearizedGraph<Pose>& map) {
  return Search<Pose>(loops, width, map).Verified(slip);
}

template <class Pose>
int OdometrySlot(int v, const std::function<bool(int slot)>& is_loop, const LinearizedGraph<Pose>& map) {
  if (v < 0 || v + 1 >= map.Cholesky().Variables()) return -1;
  for (const int slot : map.Cholesky().SlotsOf(v)) {
    const auto& f = map.Cholesky().LinearFactorAt(slot);
    const bool is_step = std::min(f.first, f.second) == v && std::max(f.first, f.second) == v + 1;
    if (is_step && !is_loop(slot)) return slot;
  }
  return -1;
}

template <class Pose>
int CountPlaces(const std::vector<FactorId>& loops, const LinearizedGraph<Pose>& map) {
  std::vector<Span<Pose>> spans;
  for (const FactorId id : loops) {
    if (const auto span = SpanOf(id, map.Graph())) spans.push_back(*span);
  }
  return CountPlaces(spans);
}

template <class Pose>
int PlacesAcross(int v, const std::vector<FactorId>& loops, const LinearizedGraph<Pose>& map) {
  std::vector<Span<Pose>> across;
  for (const FactorId id : loops) {
    const std::optional<Span<Pose>> span = SpanOf(id, map.Graph());
    if (span && span->first <= v && v < span->last) across.push_back(*span);
  }
  return CountPlaces(across);
}

#define TERSE_INSTANTIATE(Pose)                                                                         \
  template int OdometrySlot(int, const std::function<bool(int)>&, const LinearizedGraph<Pose>&);        \
  template int CountPlaces(const std::vector<FactorId>&, const LinearizedGraph<Pose>&);                 \
  template int PlacesAcross(int, const std::vector<FactorId>&, const LinearizedGraph<Pose>&);           \
  template std::optional<Slip<Pose>> FindSlip(const KnownLoops&, double, const LinearizedGraph<Pose>&); \
  template std::optional<Slip<Pose>> VerifySlip(const Slip<Pose>&, const KnownLoops&, double,           \
                                                const LinearizedGraph<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
