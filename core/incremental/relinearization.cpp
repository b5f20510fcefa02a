#include "incremental/relinearization.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "support/stopwatch.h"
#include "terse/core/front_paths.h"
#include "terse/core/graph_members.h"
#include "terse/core/log_message.h"
#include "terse/core/residual.h"

namespace terse::internal {
namespace {

using std::size_t;

// Relinearised factors may cost this many times as much as before (curved valleys climb a little) before the
// points go only part of the way, at least this share of it.
constexpr double kClimb = 4, kLeastShare = 0.05;
// Linearisation errors of so many times what is tolerated do not wait for the interval.
constexpr double kUrgent = 100;
// Shares of what is tolerated: from which on a pose's factors are looked at, and a neighbour joins those that are
// relinearised.
constexpr double kWorthLooking = 1e-2, kWorthJoining = 1e-2;

template <class Pose>
double Tolerated(const LinearizedGraph<Pose>& map, const IncrementalOptions& options) {
  return options.relinearize_tolerance * map.CostUnit();
}

// What is far below the tolerance is counted but not looked for.
template <class Pose>
double Suspicious(const LinearizedGraph<Pose>& map, const IncrementalOptions& options) {
  return 1e-5 * options.relinearize_tolerance * map.CostUnit();
}

template <class Pose>
bool IsOutgrown(int variable, const LinearizedGraph<Pose>& map, const IncrementalOptions& options) {
  const auto d = map.OffsetOf(variable);
  return d.template head<Pose::kDim>().norm() > options.relinearize_metres ||
         d.template tail<Pose::kDof - Pose::kDim>().norm() > options.relinearize_radians;
}

// What refactoring the fronts from the variable to the root takes that are not in `taken` yet.
template <int B>
double PathFlops(const FrontPaths<B>& taken, int variable) {
  double flops = 0;
  taken.ForEachMissing(variable, [&](const Front<B>& front) { flops += front.RefactorFlops(); });
  return flops;
}

template <int B>
double SquaredResiduals(const std::vector<std::pair<int, LinearFactor<B>>>& replaced) {
  double sum = 0;
  for (const auto& change : replaced) sum += change.second.residual.squaredNorm();
  return sum;
}

}  // namespace

template <class Pose>
void Relinearization<Pose>::Resize(const Map& map) {
  poses_.resize(map.Points().size());
  if (slots_.size() < static_cast<size_t>(map.Slots())) slots_.resize(static_cast<size_t>(map.Slots()));
}

template <class Pose>
void Relinearization<Pose>::ForgetErrors() {
  for (OfPose& pose : poses_) {
    pose.seen.setZero();
    pose.possible = 0;
  }
  for (OfSlot& slot : slots_) {
    slot.error = 0;
    slot.is_suspect = 0;
  }
  moved_.clear();
  suspects_.clear();
  possible_error_ = error_sum_ = 0;
  ++look_;
}

// A scale for how much the errors of a pose's factors changed since they were looked at: they are products of its turn
// with whatever moves (residuals are linear in the translations alone).
template <class Pose>
double Relinearization<Pose>::PossibleError(int variable, const Map& map) const {
  constexpr int R = B - Pose::kDim;
  const auto d = map.OffsetOf(variable);
  return d.template tail<R>().squaredNorm() *
         (d - poses_[static_cast<size_t>(variable)].seen).cwiseAbs2().dot(map.Cholesky().System().DiagonalOf(variable));
}

template <class Pose>
void Relinearization<Pose>::NoteMoved(const std::vector<int>& moved, const Map& map,
                                      const IncrementalOptions& options) {
  const double worth = kWorthLooking * options.relinearize_tolerance * map.CostUnit();
  for (const int v : moved) {
    const double possible = PossibleError(v, map);
    double& known = At(v).possible;  // 0: not listed
    if (known == 0 && (!(possible > worth) || !IsOutgrown(v, map, options))) continue;
    if (known == 0) moved_.push_back(v);
    possible_error_ += possible - known;
    known = std::max(possible, std::numeric_limits<double>::min());
  }
}

template <class Pose>
bool Relinearization<Pose>::IsUrgent(const Map& map, const IncrementalOptions& options) const {
  return possible_error_ > kUrgent * options.relinearize_tolerance * map.CostUnit();
}

// EstimateAt for many factors on the same poses; from one look at the errors to the next.
template <class Pose>
const Pose& Relinearization<Pose>::RememberedEstimate(int index, const Map& map) {
  OfPose& pose = At(index);
  if (std::exchange(pose.remembered_in, look_) != look_) pose.remembered = map.EstimateAt(index);
  return pose.remembered;
}

template <class Pose>
Vector<Pose::kDof> Relinearization<Pose>::WhitenedResidualAt(int slot, const Map& map) {
  const LinearFactor<B>& f = map.Cholesky().LinearFactorAt(slot);
  const Pose& first = RememberedEstimate(f.first, map);
  return map.RootAt(slot) * Residual(map.Graph().FindFactor(map.IdAt(slot))->factor, first,
                                     f.second >= 0 ? RememberedEstimate(f.second, map) : first);
}

// How far the linearised factor is from the true one, in units of chi2.
template <class Pose>
double Relinearization<Pose>::LinearizationError(int slot, const Map& map) {
  if (map.Cholesky().LinearFactorAt(slot).first < 0 || map.IdAt(slot).value < 0) return 0;
  return (WhitenedResidualAt(slot, map) - map.LinearResidual(slot)).squaredNorm();
}

// Of the factors on poses that moved.
template <class Pose>
void Relinearization<Pose>::UpdateErrors(const Map& map, const IncrementalOptions& options) {
  ++look_;
  std::vector<int> slots;
  for (const int v : moved_) {
    At(v).possible = 0;
    At(v).seen = map.OffsetOf(v);
    for (const int slot : map.Cholesky().SlotsOf(v)) {
      if (std::exchange(SlotAt(slot).is_listed, 1) == 0) slots.push_back(slot);
    }
  }
  moved_.clear();
  possible_error_ = 0;
  for (const int slot : slots) {
    SlotAt(slot).is_listed = 0;
    SetError(slot, LinearizationError(slot, map), Suspicious(map, options));
  }
}

template <class Pose>
void Relinearization<Pose>::SetError(int slot, double error, double suspicious) {
  OfSlot& known = SlotAt(slot);
  if (error > suspicious && std::exchange(known.is_suspect, 1) == 0) suspects_.push_back(slot);
  error_sum_ += error - known.error;
  known.error = error;
}

// The worst first; those that are none any more are let go.
template <class Pose>
void Relinearization<Pose>::SortSuspects(double suspicious) {
  const auto is_clear = [&](int slot) { return !(SlotAt(slot).error > suspicious); };
  for (const int slot : suspects_) SlotAt(slot).is_suspect = is_clear(slot) ? 0 : 1;
  suspects_.erase(std::remove_if(suspects_.begin(), suspects_.end(), is_clear), suspects_.end());
  std::sort(suspects_.begin(), suspects_.end(),
            [&](int a, int b) { return std::make_pair(-SlotAt(a).error, a) < std::make_pair(-SlotAt(b).error, b); });
}

// The poses of the worst factors, so many that what is left is half of what is tolerated.
template <class Pose>
std::map<int, Pose> Relinearization<Pose>::ChoosePoses(double times, Deadline deadline, const Map& map,
                                                       const IncrementalOptions& options, StepReport& report) {
  UpdateErrors(map, options);
  looked_at_ = map.Updates();
  const BlockCholesky<B>& cholesky = map.Cholesky();
  const double tolerated = Tolerated(map, options);
  std::map<int, Pose> points;
  if (error_sum_ <= times * tolerated) return points;
  SortSuspects(Suspicious(map, options));
  double left = error_sum_;
  std::vector<int> added;
  FrontPaths<B> paths(cholesky.Tree());
  const double affordable = deadline ? AffordableFlops(*deadline) : std::numeric_limits<double>::infinity();
  double flops = 0;
  report.deferred_relinearisations = 0;
  const auto add = [&](int v) {
    if (v < 0 || !IsOutgrown(v, map, options) || points.count(v) != 0) return;
    if (deadline) {
      const double more = PathFlops(paths, v);
      // A step that brings nothing gets on whatever the budget: what never fits would wait for ever.
      // But not from an estimate that back-substitution has half done.
      const bool must = points.empty() && report.path == CholeskyPath::kNone && cholesky.LastSolve().deferred == 0;
      if (flops + more > affordable && !must) {
        ++report.deferred_relinearisations;
        return;
      }
      flops += more;
      paths.Add(v);
    }
    points.emplace(v, RememberedEstimate(v, map));
    added.push_back(v);
  };
  for (const int slot : suspects_) {
    if (tolerated > 0 && left <= tolerated / 2) break;
    left -= SlotAt(slot).error;
    add(cholesky.LinearFactorAt(slot).first);
    add(cholesky.LinearFactorAt(slot).second);
  }
  // Poses that moved together far and fast: a factor between one that is relinearised and one that is not would be
  // linearised where nobody is.
  for (size_t k = 0; k < added.size(); ++k) {
    for (const int slot : cholesky.SlotsOf(added[k])) {
      const LinearFactor<B>& f = cholesky.LinearFactorAt(slot);
      const int other = f.first == added[k] ? f.second : f.first;
      if (other < 0 || points.count(other) != 0 || !IsOutgrown(other, map, options)) continue;
      if (ErrorAfter(slot, points, map) > kWorthJoining * tolerated) add(other);
    }
  }
  return points;
}

template <class Pose>
double Relinearization<Pose>::AffordableFlops(Clock::time_point deadline) const {
  // Half of the time is for back-substitution and for what the prediction misses.
  return 0.5 * std::chrono::duration<double>(deadline - Clock::now()).count() / seconds_per_flop_;
}

// The linearisation error of a factor when these poses are relinearised.
template <class Pose>
double Relinearization<Pose>::ErrorAfter(int slot, const std::map<int, Pose>& points, const Map& map) {
  const auto point = [&](int v) -> const Pose& {
    const auto it = points.find(v);
    return it != points.end() ? it->second : map.Points()[static_cast<size_t>(v)];
  };
  const LinearFactor<B> f = map.LinearizeSlot(slot, point);
  const auto offset = [&](int v) { return points.count(v) == 0 ? map.OffsetOf(v).data() : nullptr; };
  const Vector<B> linear = LinearResidual(f, offset);
  return (WhitenedResidualAt(slot, map) - linear).squaredNorm();
}

template <class Pose>
bool Relinearization<Pose>::MovePoints(const std::map<int, Pose>& points, const typename Map::Replacements& replaced,
                                       Map& map, const IncrementalOptions& options, StepReport& report) {
  if (!map.Relinearize(points, replaced, report)) {
    Log(options.log, LogLevel::kWarning, "step ", map.Updates(), ": not positive definite at ", points.size(),
        " new linearisation points, the old ones stay");
    return false;
  }
  for (const auto& point : points) At(point.first).seen.setZero();
  ++look_;
  for (const auto& change : replaced) {
    map.CountCost(change.first);
    SetError(change.first, options.carry == Carry::kOffset ? LinearizationError(change.first, map) : 0,
             Suspicious(map, options));
  }
  report.variables_relinearised += static_cast<int>(points.size());
  return true;
}

template <class Pose>
bool Relinearization<Pose>::MoveWorst(bool urgently, Deadline deadline, Map& map, const IncrementalOptions& options,
                                      StepReport& report) {
  std::map<int, Pose> points;
  typename Map::Replacements replaced;
  {
    ScopedTimer timer(map.Seconds().linearise);
    points = ChoosePoses(urgently ? kUrgent : 1, deadline, map, options, report);
    if (points.empty()) return false;
    replaced = map.LinearizeAround(points);
    double before = static_cast<double>(B * replaced.size());
    for (const auto& change : replaced) before += map.Cholesky().LinearFactorAt(change.first).residual.squaredNorm();
    for (double share = 1; share >= kLeastShare; share /= 2) {
      if (SquaredResiduals(replaced) <= kClimb * before) {
        if (share < 1) {
          Log(options.log, LogLevel::kInfo, "step ", map.Updates(), ": far steps, ", points.size(),
              " linearisation points go only ", share, " of the way");
        }
        break;
      }
      for (auto& [v, T] : points) T = map.Points()[static_cast<size_t>(v)].Retract(share / 2 * map.OffsetOf(v));
      replaced = map.LinearizeAround(points);
    }
  }
  const auto start = Clock::now();
  double flops = 0;
  if (deadline) {
    FrontPaths<B> paths(map.Cholesky().Tree());
    for (const auto& point : points) {
      flops += PathFlops(paths, point.first);
      paths.Add(point.first);
    }
  }
  if (!MovePoints(points, replaced, map, options, report)) return false;
  if (deadline) {
    const double measured = std::chrono::duration<double>(Clock::now() - start).count() / std::max(flops, 1e3);
    seconds_per_flop_ += 0.3 * (measured - seconds_per_flop_);
  }
  return true;
}

template <class Pose>
template <class Archive>
void Relinearization<Pose>::Serialize(Archive& archive) {
  auto& [poses, slots, moved, possible_error, suspects, error_sum, look, looked_at, seconds_per_flop] = *this;
  archive.Each(poses, [&](OfPose& pose) {
    auto& [possible, seen, remembered, remembered_in] = pose;
    archive(possible, seen, remembered, remembered_in);
  });
  archive.Each(slots, [&](OfSlot& slot) {
    auto& [error, is_suspect, is_listed] = slot;
    archive(error, is_suspect, is_listed);
  });
  archive(moved, possible_error, suspects, error_sum, look, looked_at);
}

template <class Pose>
template <class Archive>
void Relinearization<Pose>::SerializeTimes(Archive& archive) {
  archive(seconds_per_flop_);
}

template <class Pose>
std::string Relinearization<Pose>::FindStateDefect(const Map& map) const {
  const auto are_below = [](const std::vector<int>& numbers, size_t n) {
    return std::all_of(numbers.begin(), numbers.end(), [&](int i) { return i >= 0 && static_cast<size_t>(i) < n; });
  };
  if (poses_.size() != map.Points().size() || !are_below(moved_, poses_.size())) {
    return "lists by pose have different sizes";
  }
  if (slots_.size() != static_cast<size_t>(map.Slots()) || !are_below(suspects_, slots_.size())) {
    return "lists by slot have different sizes";
  }
  for (int slot = 0; slot < map.Slots(); ++slot) {
    const bool is_measured = map.IdAt(slot).value >= 0;
    if (!is_measured && slots_[static_cast<size_t>(slot)].error != 0) return "an error of no measurement";
  }
  const auto is_count = [](long number) { return number >= 0 && number < std::numeric_limits<long>::max() / 2; };
  return is_count(look_) && is_count(looked_at_) ? "" : "it has miscounted";
}

#define TERSE_INSTANTIATE(Pose)                                                   \
  template class Relinearization<Pose>;                                           \
  template void Relinearization<Pose>::Serialize<StateWriter>(StateWriter&);      \
  template void Relinearization<Pose>::Serialize<StateReader>(StateReader&);      \
  template void Relinearization<Pose>::SerializeTimes<StateWriter>(StateWriter&); \
  template void Relinearization<Pose>::SerializeTimes<StateReader>(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
