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
// Standard deviations, squared, and shares of chi2.
constexpr double kRest = 3e-4, kMostShares = 30;
// Linearisation errors of so many times the share of chi2, or what is tolerated at rest, do not wait for the interval.
constexpr double kUrgent = 100, kUrgentAtRest = 10;
// Shares of what is tolerated: from which on a pose's factors are looked at, and a neighbour joins those that are
// relinearised. Where loops are judged by their residuals, errors are looked for that would not matter otherwise.
constexpr double kWorthLooking = 0.1, kWorthLookingToJudge = 1e-2, kWorthJoining = 1e-2;

// What does not fit into the budget moves at the latest after so many steps, whatever it takes.
constexpr long kMostSteps = 10;
// Poses or slots between two looks at the clock.
constexpr size_t kPiece = 64;
// What linearising a measurement takes, and everything that comes with it.
constexpr double kSlotFlops = 2e3;
// What any machine does in a second.
constexpr double kSlowFlops = 1e8;
// How fast the measured speed follows.
constexpr double kFollow = 0.3;

template <class Pose>
void LogShare(double share, size_t points, const LinearizedGraph<Pose>& map, const IncrementalOptions& options) {
  Log(options.log, LogLevel::kInfo, "step ", map.Updates(), ": far steps, ", points, " linearisation points go only ",
      share, " of the way");
}

template <class Pose>
void WarnOfRefusal(size_t points, const LinearizedGraph<Pose>& map, const IncrementalOptions& options) {
  Log(options.log, LogLevel::kWarning, "step ", map.Updates(), ": not positive definite at ", points,
      " new linearisation points, the old ones stay");
}

bool JudgesLoops(const IncrementalOptions& options) { return options.robust.kernel != RobustKernel::kNone; }

// Errors that add up to E move no pose by more than sqrt(E) of its standard deviations: d' S^-1 d <= |A d|^2 <= E.
// Where chi2 is far below what the information promises, its share would never let the map rest: there the share of
// what was promised is tolerated, but no more than kRest, nor than so many shares of chi2, for the information may
// promise too little. Loops are not judged by a map at rest.
template <class Pose>
double Tolerated(const LinearizedGraph<Pose>& map, const IncrementalOptions& options) {
  const double share = options.relinearize_tolerance * map.CostUnit();
  if (JudgesLoops(options)) return share;
  const double promised = options.relinearize_tolerance * map.DegreesOfFreedom();
  return std::max(share, std::min({kRest, promised, kMostShares * share}));
}

template <class Pose>
double WorthLooking(const LinearizedGraph<Pose>& map, const IncrementalOptions& options) {
  return (JudgesLoops(options) ? kWorthLookingToJudge : kWorthLooking) * Tolerated(map, options);
}

template <class Pose>
double Urgent(const LinearizedGraph<Pose>& map, const IncrementalOptions& options) {
  return std::max(kUrgent * options.relinearize_tolerance * map.CostUnit(), kUrgentAtRest * Tolerated(map, options));
}

// What is far below the tolerance is counted but not looked for.
template <class Pose>
double Suspicious(const LinearizedGraph<Pose>& map, const IncrementalOptions& options) {
  return 1e-5 * Tolerated(map, options);
}

template <class Pose>
bool IsOutgrown(int variable, const LinearizedGraph<Pose>& map, const IncrementalOptions& options) {
  const auto d = map.OffsetOf(variable);
  return d.template head<Pose::kDim>().norm() > options.relinearize_metres ||
         d.template tail<Pose::kDof - Pose::kDim>().norm() > options.relinearize_radians;
}

}  // namespace

template <class Pose>
bool Relinearization<Pose>::IsQuick(const Map& map, double seconds, int rounds) {
  const double most = kSlowFlops * seconds / rounds;
  double flops = kSlotFlops * static_cast<double>(map.Cholesky().Slots());
  if (flops > most) return false;
  for (const int f : map.Cholesky().Tree().TopDown()) flops += map.Cholesky().Tree()[f].RefactorFlops();
  return flops <= most;
}

template <class Pose>
void Relinearization<Pose>::Resize(const Map& map) {
  poses_.resize(map.Points().size());
  if (slots_.size() < static_cast<size_t>(map.Slots())) slots_.resize(static_cast<size_t>(map.Slots()));
}

template <class Pose>
void Relinearization<Pose>::ForgetErrors(Map& map) {
  prepared_ = {};
  map.ForgetPrepared();
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
  const double worth = WorthLooking(map, options);
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
void Relinearization<Pose>::NoteNew(bool gate_open, Map& map, const IncrementalOptions& options) {
  const std::vector<int> slots = map.TakeBound();
  if (slots.empty() || options.carry != Carry::kOffset) return;
  Resize(map);
  ++look_;
  for (const int slot : slots) {
    const double error = LinearizationError(slot, map);
    SetError(slot, error, Suspicious(map, options));
    if (!gate_open || !(error > WorthLooking(map, options))) continue;
    const int v = map.Cholesky().LinearFactorAt(slot).first;
    if (At(v).possible == 0) moved_.push_back(v);
    At(v).possible += error;
    possible_error_ += error;
  }
}

template <class Pose>
bool Relinearization<Pose>::IsUrgent(const Map& map, const IncrementalOptions& options) const {
  return possible_error_ > Urgent(map, options);
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
  const LinearFactor<B>& f = map.Cholesky().LinearFactorAt(slot);
  if (f.first < 0 || map.IdAt(slot).value < 0) return 0;
  const auto is_at_point = [&](int v) { return v < 0 || map.OffsetOf(v).isZero(0); };
  if (is_at_point(f.first) && is_at_point(f.second)) return 0;
  return (WhitenedResidualAt(slot, map) - map.LinearResidual(slot)).squaredNorm();
}

// Of the factors on poses that moved; false if the deadline came before it had looked at all.
template <class Pose>
bool Relinearization<Pose>::UpdateErrors(Deadline deadline, const Map& map, const IncrementalOptions& options) {
  ++look_;
  std::vector<int> slots;
  while (!moved_.empty()) {
    const size_t piece = deadline ? std::min(kPiece, moved_.size()) : moved_.size();
    slots.clear();
    for (auto it = moved_.end() - static_cast<long>(piece); it != moved_.end(); ++it) {
      possible_error_ -= std::exchange(At(*it).possible, 0.0);
      At(*it).seen = map.OffsetOf(*it);
      for (const int slot : map.Cholesky().SlotsOf(*it)) {
        if (std::exchange(SlotAt(slot).is_listed, 1) == 0) slots.push_back(slot);
      }
    }
    moved_.resize(moved_.size() - piece);
    for (const int slot : slots) {
      SlotAt(slot).is_listed = 0;
      SetError(slot, LinearizationError(slot, map), Suspicious(map, options));
    }
    if (deadline && !moved_.empty() && Clock::now() > *deadline) return false;
  }
  possible_error_ = 0;
  return true;
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
PointMap<Pose> Relinearization<Pose>::ChoosePoses(double more_than, const Map& map, const IncrementalOptions& options) {
  const BlockCholesky<B>& cholesky = map.Cholesky();
  const double tolerated = Tolerated(map, options);
  PointMap<Pose> points;
  if (error_sum_ <= more_than) return points;
  SortSuspects(Suspicious(map, options));
  double left = error_sum_;
  std::vector<int> added;
  const auto add = [&](int v) {
    if (v < 0 || !IsOutgrown(v, map, options) || points.Has(v)) return;
    points.Add(v, RememberedEstimate(v, map));
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
      if (other < 0 || points.Has(other) || !IsOutgrown(other, map, options)) continue;
      if (ErrorAfter(slot, points, map) > kWorthJoining * tolerated) add(other);
    }
  }
  return points;
}

// The linearisation error of a factor when these poses are relinearised.
template <class Pose>
double Relinearization<Pose>::ErrorAfter(int slot, const PointMap<Pose>& points, const Map& map) {
  const auto point = [&](int v) -> const Pose& { return points.Find(v, map.Points()[static_cast<size_t>(v)]); };
  const LinearFactor<B> f = map.LinearizeSlot(slot, point);
  const auto offset = [&](int v) { return points.Has(v) ? nullptr : map.OffsetOf(v).data(); };
  const Vector<B> linear = LinearResidual(f, offset);
  return (WhitenedResidualAt(slot, map) - linear).squaredNorm();
}

template <class Pose>
bool Relinearization<Pose>::MovePoints(const PointMap<Pose>& points, typename Map::Replacements replaced, Map& map,
                                       const IncrementalOptions& options, StepReport& report) {
  std::vector<int> slots;
  for (const auto& change : replaced) slots.push_back(change.first);
  if (!map.Relinearize(points, std::move(replaced), report)) {
    WarnOfRefusal(points.size(), map, options);
    return false;
  }
  for (const auto& point : points) At(point.first).seen.setZero();
  ++look_;
  for (const int slot : slots) {
    map.CountCost(slot);
    SetError(slot, options.carry == Carry::kOffset ? LinearizationError(slot, map) : 0, Suspicious(map, options));
  }
  report.variables_relinearised += static_cast<int>(points.size());
  return true;
}

template <class Pose>
bool Relinearization<Pose>::MoveWorst(bool urgently, Deadline deadline, Map& map, const IncrementalOptions& options,
                                      StepReport& report) {
  if (!prepared_.points.empty()) {
    return MovePrepared(deadline.value_or(Clock::time_point::max()), map, options, report);
  }
  PointMap<Pose> points;
  {
    ScopedTimer timer(map.Seconds().linearise);
    if (!UpdateErrors(deadline, map, options)) {
      report.deferred_relinearisations = static_cast<int>(moved_.size());
      return false;
    }
    looked_at_ = map.Updates();
    points = ChoosePoses(urgently ? Urgent(map, options) : Tolerated(map, options), map, options);
  }
  if (points.empty()) return false;
  if (!deadline || Fits(points, *deadline, map)) return MoveAtOnce(std::move(points), map, options, report);
  Prepare(std::move(points), map);
  return MovePrepared(*deadline, map, options, report);
}

template <class Pose>
bool Relinearization<Pose>::MoveAtOnce(PointMap<Pose> points, Map& map, const IncrementalOptions& options,
                                       StepReport& report) {
  const auto start = Clock::now();
  typename Map::Replacements replaced;
  {
    ScopedTimer timer(map.Seconds().linearise);
    replaced = map.LinearizeAround(points);
    double before = static_cast<double>(B * replaced.size());
    for (const auto& change : replaced) before += map.Cholesky().LinearFactorAt(change.first).residual.squaredNorm();
    for (double share = 1; share >= kLeastShare; share /= 2) {
      if (SquaredResiduals(replaced) <= kClimb * before) {
        if (share < 1) LogShare(share, points.size(), map, options);
        break;
      }
      for (auto& [v, T] : points) T = map.Points()[static_cast<size_t>(v)].Retract(share / 2 * map.OffsetOf(v));
      replaced = map.LinearizeAround(points);
    }
  }
  const double flops = report.flops, slots = static_cast<double>(replaced.size());
  if (!MovePoints(points, std::move(replaced), map, options, report)) return false;
  const double done = report.flops - flops + kSlotFlops * slots;
  const double measured = std::chrono::duration<double>(Clock::now() - start).count() / done;
  seconds_per_flop_ += kFollow * (measured - seconds_per_flop_);
  return true;
}

template <class Pose>
bool Relinearization<Pose>::Fits(const PointMap<Pose>& points, Clock::time_point deadline, const Map& map) const {
  const double flops_left =
      std::chrono::duration<double>(deadline - Clock::now()).count() / std::max(seconds_per_flop_, 1e-12);
  const BlockCholesky<B>& cholesky = map.Cholesky();
  FrontPaths<B> paths(cholesky.Tree());
  double flops = 0;
  for (const auto& point : points) {
    paths.ForEachMissing(point.first, [&](const Front<B>& front) { flops += front.RefactorFlops(); });
    paths.Add(point.first);
    flops += kSlotFlops * static_cast<double>(cholesky.SlotsOf(point.first).size());
    if (flops > flops_left) return false;
  }
  return true;
}

template <class Pose>
void Relinearization<Pose>::Prepare(PointMap<Pose> points, Map& map) {
  prepared_ = {};
  prepared_.points = std::move(points);
  prepared_.since = map.Updates();
  PrepareAgain(map);
}

template <class Pose>
void Relinearization<Pose>::PrepareAgain(Map& map) {
  map.ForgetPrepared();
  prepared_.queue = map.SlotsOn(prepared_.points);
  prepared_.before = prepared_.cost = 0;
  prepared_.version = map.Cholesky().Version();
}

// Slots that came or changed since this was called last, on poses whose points are made ready.
template <class Pose>
void Relinearization<Pose>::QueueChanged(Map& map) {
  const BlockCholesky<B>& cholesky = map.Cholesky();
  const std::uint64_t before = std::exchange(prepared_.version, cholesky.Version());
  const auto changes = cholesky.ChangesSince(before);
  if (!changes) return PrepareAgain(map);  // too many
  for (const auto& change : *changes) {
    const LinearFactor<B>& f = cholesky.LinearFactorAt(change.slot);
    if (f.first >= 0 && (prepared_.points.Has(f.first) || prepared_.points.Has(f.second))) {
      prepared_.queue.push_back(change.slot);
    }
  }
}

template <class Pose>
void Relinearization<Pose>::EndStep(Map& map) {
  if (prepared_.points.empty()) return;
  QueueChanged(map);
  map.EndPreparedStep();
}

// True when the queue is empty. Points that would make their measurements cost far more go half as far, as at once.
template <class Pose>
bool Relinearization<Pose>::LinearizePrepared(Clock::time_point deadline, Map& map, const IncrementalOptions& options) {
  ScopedTimer timer(map.Seconds().linearise);
  auto& [points, queue, before, cost, share, is_checked, since, version] = prepared_;
  const auto point = [&, &points = points](int v) -> const Pose& {
    return points.Find(v, map.Points()[static_cast<size_t>(v)]);
  };
  typename Map::Replacements replaced;
  for (;;) {
    while (!queue.empty()) {
      replaced.clear();
      for (size_t k = 0; k < kPiece && !queue.empty(); ++k) {
        const int slot = queue.back();
        queue.pop_back();
        if (map.Cholesky().LinearFactorAt(slot).first < 0) continue;  // gone meanwhile
        replaced.emplace_back(slot, map.LinearizeSlot(slot, point));
        before += B + map.Cholesky().LinearFactorAt(slot).residual.squaredNorm();
        cost += replaced.back().second.residual.squaredNorm();
      }
      map.Prepare(replaced);
      if (!queue.empty() && Clock::now() > deadline) return false;
    }
    is_checked = is_checked || cost <= kClimb * before || share / 2 < kLeastShare;
    if (is_checked) return true;
    for (auto& [v, T] : points) {
      const Pose& from = map.Points()[static_cast<size_t>(v)];
      T = from.Retract(from.Local(T) / 2);
    }
    share /= 2;
    LogShare(share, points.size(), map, options);
    PrepareAgain(map);
  }
}

// Goes on with what is made ready; true if it moved.
template <class Pose>
bool Relinearization<Pose>::MovePrepared(Clock::time_point deadline, Map& map, const IncrementalOptions& options,
                                         StepReport& report) {
  const bool is_late = map.Updates() - prepared_.since >= kMostSteps;
  QueueChanged(map);
  PreparationProgress progress;
  bool is_ready = LinearizePrepared(is_late ? Clock::time_point::max() : deadline, map, options);
  if (is_ready && !is_late) {
    progress = map.Advance(deadline);
    const double left = std::chrono::duration<double>(deadline - Clock::now()).count();
    is_ready = progress.failed_variable >= 0 || (progress.fronts_left == 0 && progress.seconds_left <= left);
  }
  report.deferred_relinearisations = is_ready ? 0 : static_cast<int>(prepared_.points.size());
  if (!is_ready) return false;
  const PointMap<Pose> points = std::move(prepared_.points);
  prepared_ = {};
  std::vector<int> slots;
  if (progress.failed_variable >= 0 || !map.RelinearizePrepared(points, slots, report)) {
    WarnOfRefusal(points.size(), map, options);
    map.ForgetPrepared();
    return false;
  }
  for (const int slot : slots) {
    map.CountCost(slot);
    SetError(slot, 0, Suspicious(map, options));
  }
  std::vector<int> moved;
  for (const auto& point : points) {
    OfPose& pose = At(point.first);
    pose.seen.setZero();
    possible_error_ -= std::exchange(pose.possible, 0.0);
    moved.push_back(point.first);
  }
  moved_.erase(std::remove_if(moved_.begin(), moved_.end(), [&](int v) { return At(v).possible == 0; }), moved_.end());
  NoteMoved(moved, map, options);
  report.variables_relinearised += static_cast<int>(points.size());
  return true;
}

template <class Pose>
template <class Archive>
void Relinearization<Pose>::Serialize(Archive& archive) {
  auto& [poses, slots, moved, possible_error, suspects, error_sum, look, looked_at, solve_seconds, unfinished_solves,
         seconds_per_flop, prepared] = *this;
  archive.Each(poses, [&](OfPose& pose) {
    auto& [possible, seen, remembered, remembered_in] = pose;
    archive(possible, seen, remembered, remembered_in);
  });
  archive.Each(slots, [&](OfSlot& slot) {
    auto& [error, is_suspect, is_listed] = slot;
    archive(error, is_suspect, is_listed);
  });
  archive(moved, possible_error, suspects, error_sum, look, looked_at, unfinished_solves);
  auto& [points, queue, before, cost, share, is_checked, since, version] = prepared;
  std::vector<std::pair<int, Pose>> list(points.begin(), points.end());
  archive.Each(list, [&](std::pair<int, Pose>& entry) { archive(entry.first, entry.second); });
  if constexpr (Archive::kReads) {
    points = {};
    for (const auto& [v, T] : list) {
      if (v < 0 || static_cast<size_t>(v) >= poses.size() || points.Has(v)) {
        archive.Fail("a pose is made ready that there is not, or twice");
      }
      points.Add(v, T);
    }
  }
  archive(queue, before, cost, share, is_checked, since);
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
  const auto& [points, queue, before, cost, share, is_checked, since, version] = prepared_;
  if (!are_below(queue, slots_.size())) return "a slot is to be linearised that there is not";
  if (unfinished_solves_ < 0 || since < 0 || since > map.Updates() || !(share > 0 && share <= 1)) {
    return "it has miscounted";
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
