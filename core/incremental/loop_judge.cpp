#include "incremental/loop_judge.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "terse/core/front_paths.h"
#include "terse/core/graph_members.h"
#include "terse/core/log_message.h"
#include "terse/core/loop_contest.h"
#include "terse/core/option_members.h"
#include "terse/core/residual.h"

namespace terse::internal {
namespace {

using std::size_t;

// Loops that are judged at once, and of those that come back in a step.
constexpr size_t kMostJudged = 10, kMostRetried = 10;
// Scalars that a graduation may have: every stage of it solves for all.
constexpr size_t kMostGraduated = 60;
constexpr int kMostRounds = 3;
// Of a loop that has not been judged.
constexpr double kUnknownLeverage = 4;
// The estimate is at the minimum if its cost is above it by no more than this share of the limit.
constexpr double kAtMinimum = 1e-3;

}  // namespace

template <class Pose>
LoopJudge<Pose>::LoopJudge(const RobustOptions& options) : options_(options) {
  if (!IsActive()) return;
  const double width = WidthOf(options, B);
  limit_ = stated_limit_ = outer_limit_ = reviewed_limit_ = width * width;
}

template <class Pose>
void LoopJudge<Pose>::Resize(const Map& map) {
  const auto slots = static_cast<size_t>(map.Slots());
  if (IsActive() && slots_.size() < slots) slots_.resize(slots);
}

template <class Pose>
void LoopJudge<Pose>::Release(int slot) {
  if (!IsActive()) return;
  At(slot).is_loop = 0;
  At(slot).weight = 1;
  At(slot).judged_chi2 = 0;
}

template <class Pose>
void LoopJudge<Pose>::Enter(int slot, double weight) {
  At(slot).is_loop = 1;
  At(slot).weight = weight;
  At(slot).judged_chi2 = 0;
  At(slot).leverage = kUnknownLeverage;
}

// In comes with its weight, out goes. False, and nothing changes, if the Cholesky factor does not take it.
template <class Pose>
bool LoopJudge<Pose>::Exchange(const Loops& in, const Loops& out, StepContext<Pose>& step) {
  std::vector<LinearFactor<B>> comes;
  for (const Loop& loop : in) {
    LinearFactor<B> f = loop.LinearizeAtPoints(step.map);
    const double root = std::sqrt(loop.weight);
    f.A_first *= root;
    f.A_second *= root;
    f.residual *= root;
    comes.push_back(f);
  }
  std::vector<int> goes;
  for (const Loop& loop : out) goes.push_back(loop.slot);
  const auto done = step.map.Exchange(comes, goes, step.report);
  if (!done.ok) return false;
  step.report.path = std::max(step.report.path, done.path);
  LogLoops(in, "in, weight ", step);
  LogLoops(out, "out, weight was ", step);
  has_evicted_ = has_evicted_ || !out.empty();
  for (const Loop& loop : out) {
    step.relinearization.Release(loop.slot);
    if (At(loop.slot).is_loop) {
      ++evicted_;
    } else {
      slips_.insert(std::upper_bound(slips_.begin(), slips_.end(), loop.id), loop.id);
      const FactorPoses ends = PosesOf(step.map.Graph().FindFactor(loop.id)->factor);
      cycles_.Break(ends.first < ends.second ? ends.second : ends.first);
    }
    Release(loop.slot);
    step.map.Release(loop.id);
    Park(loop.id, std::numeric_limits<double>::infinity());  // to be heard once more where the others then are
  }
  for (size_t k = 0; k < in.size(); ++k) {
    const int slot = done.added_slots[k];
    step.map.Bind(slot, in[k].id, std::sqrt(in[k].weight) * in[k].W);
    Resize(step.map);
    if (!IsSlip(in[k].id)) Enter(slot, in[k].weight);
    Unpark(in[k].id);
  }
  step.relinearization.Resize(step.map);
  return true;
}

template <class Pose>
void LoopJudge<Pose>::LogLoops(const Loops& loops, const char* what, const StepContext<Pose>& step) const {
  if (!step.options.log) return;
  for (const Loop& loop : loops) {
    const FactorPoses ends = PosesOf(step.map.Graph().FindFactor(loop.id)->factor);
    const int slot = loop.slot;
    const double weight = slot >= 0 ? slots_[static_cast<size_t>(slot)].weight : loop.weight;
    Log(step.options.log, weight < 1 || slot >= 0 ? LogLevel::kInfo : LogLevel::kDebug, "step ", step.map.Updates(),
        ": loop ", ends.first.value, " - ", ends.second.value, " is ", what, weight, ", chi2 ",
        loop.residual.squaredNorm(), " (width^2 ", limit_, ")");
  }
}

template <class Pose>
void LoopJudge<Pose>::LogScreened(FactorId id, const StepContext<Pose>& step) const {
  Loop loop(id, step.map);
  loop.slot = -1;  // as it came
  LogLoops({loop}, "in, weight ", step);
}

template <class Pose>
void LoopJudge<Pose>::Park(FactorId id, double chi2) {
  const auto it =
      std::lower_bound(parked_.begin(), parked_.end(), id, [](const Parked& p, FactorId x) { return p.id < x; });
  if (it != parked_.end() && it->id == id) {
    it->chi2 = chi2;
  } else {
    parked_.insert(it, {id, chi2});
  }
}

template <class Pose>
double LoopJudge<Pose>::PriceOf(FactorId id) const {
  return (IsSlip(id) ? kSlipPrice : 1) * limit_;
}

template <class Pose>
void LoopJudge<Pose>::Unpark(FactorId id) {
  const auto it =
      std::lower_bound(parked_.begin(), parked_.end(), id, [](const Parked& p, FactorId x) { return p.id < x; });
  if (it != parked_.end() && it->id == id) parked_.erase(it);
  slips_.erase(std::remove(slips_.begin(), slips_.end(), id), slips_.end());
}

template <class Pose>
void LoopJudge<Pose>::LearnFrom(const LoopJudge& earlier) {
  if (!Adapts()) return;
  scale_ = earlier.scale_;
  cycles_ = earlier.cycles_;
  outer_limit_ = earlier.outer_limit_;
  SetLimit();
}

template <class Pose>
void LoopJudge<Pose>::LimitWidth(double width) {
  if (!Adapts()) return;
  outer_limit_ = std::min(width * width, stated_limit_);
  SetLimit();
}

// The limit is that of what was learned so far.
template <class Pose>
void LoopJudge<Pose>::NoteInnovation(double innovation, int count) {
  if (!Adapts() || !(innovation <= stated_limit_)) return;
  scale_.Add(innovation, count);
  SetLimit();
}

template <class Pose>
void LoopJudge<Pose>::Admit(UpdatePlan<Pose>& plan, double increase, StepContext<Pose>& step) {
  Loops loops, refused;  // these by odometry, although they agree with the map
  int screened = 0;
  NoteCycles(plan, step);
  for (size_t k = 0; k < plan.is_loop.size(); ++k) {
    if (!plan.IsLoop(k)) continue;
    const FactorId id = step.report.factor_ids[k];
    if (!plan.Waits(k)) {
      Enter(step.map.SlotOf(id), 1);
      if (IsRefusedByOdometry(id, step.map)) refused.emplace_back(id, step.map);
      ++screened;
      if (step.options.log) LogScreened(id, step);
      continue;
    }
    Park(id, std::numeric_limits<double>::infinity());
    loops.emplace_back(id, step.map);
    loops.back().is_new = true;
  }
  if (screened > 0 && plan.BringsLoopsOnly()) NoteInnovation(std::max(increase, 0.0) / screened, screened);
  if (!refused.empty()) Exchange({}, refused, step);
  if (loops.empty()) return;
  if (Chooses()) {
    AdmitLoops(loops, step);
  } else {
    AdmitWeighted(loops, step);
  }
  for (const Loop& loop : loops) {
    const int slot = step.map.SlotOf(loop.id);
    if (slot >= 0) plan.changes.added.push_back(step.map.Cholesky().LinearFactorAt(slot));
  }
}

// A contest compares residuals at the minimum: anywhere else it seems to pay that loops go which only lead there.
template <class Pose>
bool LoopJudge<Pose>::ComeToMinimum(StepContext<Pose>& step) const {
  const double above = step.map.RemainingDecrease();
  if (step.options.carry == Carry::kPoint || above <= kAtMinimum * limit_) return false;
  BackSubstitute(std::nullopt, step);
  step.settled += above - step.map.RemainingDecrease();
  return true;
}

// kGnc: those that agree with the estimate at once, the others by a contest.
template <class Pose>
bool LoopJudge<Pose>::AdmitLoops(Loops loops, StepContext<Pose>& step) {
  if (!loops.empty() && ComeToMinimum(step)) {
    for (Loop& loop : loops) {
      const bool is_new = loop.is_new;
      loop = Loop(loop.id, step.map);
      loop.is_new = is_new;
    }
  }
  bool changed = false;
  for (size_t first = 0; first < loops.size(); first += kMostJudged) {
    Loops block;
    for (size_t k = first; k < std::min(loops.size(), first + kMostJudged); ++k) {
      if (step.map.SlotOf(loops[k].id) < 0) block.push_back(loops[k]);  // else an earlier block's contest brought it in
    }
    const auto is_refused = [&](const Loop& loop) { return IsRefusedByOdometry(loop.id, step.map); };
    const auto first_refused = std::stable_partition(block.begin(), block.end(), std::not_fn(is_refused));
    const auto heard = static_cast<size_t>(first_refused - block.begin());
    Loops believable(block.begin(), first_refused);
    const bool admitted = !believable.empty() && Judge(believable, Camps(), step);
    std::copy(believable.begin(), believable.end(), block.begin());
    changed = changed || admitted;
    // The residuals that a contest compares are those of the minimum: others wait until that is found.
    if (changed) continue;
    for (size_t k = 0; k < block.size() && !changed; ++k) {
      Loops contest = {block[k]};
      const Camps camps = k < heard ? AddContestants(contest, step.map) : Camps();
      Park(block[k].id, step.map.Chi2Of(block[k].id));  // not the residual here, which is of another chart
      if (contest.size() > 1) changed = Judge(contest, camps, step);
      if (step.options.carry == Carry::kPoint) continue;
      changed = changed || AdmitSlip(block[k].id, step) || AdmitLocalSlip(contest[0], step);
    }
  }
  return changed;
}

template <class Pose>
std::pair<size_t, size_t> LoopJudge<Pose>::ParkedAround(FactorId id) const {
  const auto place = static_cast<size_t>(
      std::lower_bound(parked_.begin(), parked_.end(), id, [](const Parked& p, FactorId x) { return p.id < x; }) -
      parked_.begin());
  return {place - std::min(place, kNeighbours / 2), std::min(parked_.size(), place + kNeighbours / 2)};
}

template <class Pose>
auto LoopJudge<Pose>::ContestOf(Loops& loops, const Map& map) const -> Contest<B> {
  Eigen::VectorXd r(static_cast<Eigen::Index>(loops.size()) * B);
  std::vector<char> in;
  std::vector<const PathColumns<B>*> columns;
  for (Loop& loop : loops) {
    if (loop.z.IsEmpty()) loop.z = SolveForward(map.Cholesky().Tree(), loop.linear);
    r.segment<B>(static_cast<Eigen::Index>(in.size()) * B) =
        loop.slot >= 0 ? map.LinearResidual(loop.slot) : loop.residual;
    in.push_back(loop.slot >= 0);
    columns.push_back(&loop.z);
  }
  Contest<B> contest(std::move(r), JointGram<B>(columns), std::move(in), Width());
  for (size_t i = 0; i < loops.size(); ++i) contest.SetPrice(i, PriceOf(loops[i].id));
  return contest;
}

// kGnc: which of these are in, if any. True if that changed.
template <class Pose>
bool LoopJudge<Pose>::Judge(Loops& loops, const Camps& camps, StepContext<Pose>& step) {
  const Contest<B> start = ContestOf(loops, step.map);
  for (size_t i = 0; i < loops.size(); ++i) {
    if (std::exchange(loops[i].is_new, false)) NoteInnovation(start.Innovation(i), 1);
  }
  Contest<B> best = start;
  best.Descend();
  const auto offer = [&](Contest<B>& other) {
    other.Descend();
    if (other.Cost() < best.Cost() - 1e-6 * limit_) best = std::move(other);
  };
  if (camps.first_against > 0) {
    // The newcomer in and who agrees with it; then those that oppose them go, by groups and one by one.
    Contest<B> other = start;
    if (other.In()[0] != 0 || other.Flip(0)) {
      other.Descend(1, camps.first_against);
      other.DescendByGroups(camps.groups);
      other.Descend();
      offer(other);
    }
  }
  if (loops.size() > 1 && loops.size() * static_cast<size_t>(B) <= kMostGraduated) {
    Contest<B> other = start;
    if (other.Graduate(options_.gnc_step)) offer(other);
  }
  Loops comes, goes;
  for (size_t i = 0; i < loops.size(); ++i) {
    const bool was_in = loops[i].slot >= 0, is_in = best.In()[i] != 0;
    if (is_in && !was_in) comes.push_back(loops[i]);
    if (!is_in && was_in) goes.push_back(loops[i]);
    if (!is_in && !was_in && step.options.log) {
      const FactorPoses ends = PosesOf(step.map.Graph().FindFactor(loops[i].id)->factor);
      Log(step.options.log, LogLevel::kDebug, "step ", step.map.Updates(), ": loop ", ends.first.value, " - ",
          ends.second.value, " stays out, innovation ", best.Innovation(i), " (at most ", PriceOf(loops[i].id), ")");
    }
    if (is_in && was_in) {
      At(loops[i].slot).judged_chi2 = loops[i].residual.squaredNorm();
      At(loops[i].slot).leverage = best.Leverage(i);
    }
  }
  return (!comes.empty() || !goes.empty()) && Exchange(comes, goes, step);
}

// The slots on poses that moved since they were looked at.
template <class Pose>
typename LoopJudge<Pose>::Touched LoopJudge<Pose>::TakeTouched(Map& map) {
  Touched touched;
  for (const int v : map.TakeTouched()) {
    for (const int slot : map.Cholesky().SlotsOf(v)) {
      if (std::exchange(At(slot).is_listed, 1) != 0) continue;
      if (At(slot).is_loop) {
        touched.loops.push_back(slot);
      } else {
        touched.odometry.push_back(slot);
      }
    }
  }
  for (const auto* slots : {&touched.loops, &touched.odometry}) {
    for (const int slot : *slots) At(slot).is_listed = 0;
  }
  return touched;
}

// Loops that came in when the width was twice what it is may not be in now.
template <class Pose>
void LoopJudge<Pose>::DoubtAllIfNarrower() {
  reviewed_limit_ = std::max(reviewed_limit_, limit_);
  if (limit_ * kNews * kNews > reviewed_limit_) return;
  reviewed_limit_ = limit_;
  doubts_all_ = true;
  for (OfSlot& slot : slots_) {
    slot.judged_chi2 = 0;
    slot.leverage = kUnknownLeverage;
  }
}

// kGnc: loops that are in although the estimate contradicts them.
template <class Pose>
bool LoopJudge<Pose>::ReviewMembers(StepContext<Pose>& step) {
  std::vector<std::pair<double, int>> doubtful;
  Touched touched = TakeTouched(step.map);
  DoubtAllIfNarrower();
  if (doubts_all_) {
    touched.loops.clear();
    for (size_t slot = 0; slot < slots_.size(); ++slot) {
      if (slots_[slot].is_loop) touched.loops.push_back(static_cast<int>(slot));
    }
  }
  for (const int slot : touched.loops) {
    const double chi2 = step.map.LinearResidual(slot).squaredNorm(), innovation = chi2 * At(slot).leverage;
    if (innovation > limit_ && chi2 > kNews * At(slot).judged_chi2) doubtful.emplace_back(-innovation, slot);
  }
  doubts_all_ = doubts_all_ && doubtful.size() > kMostJudged;
  if (doubtful.empty()) return step.options.carry == Carry::kOffset && ReviewOdometry(touched.odometry, step);
  ComeToMinimum(step);
  std::sort(doubtful.begin(), doubtful.end());
  if (doubtful.size() > kMostJudged) doubtful.resize(kMostJudged);
  Loops loops;
  for (const auto& entry : doubtful) loops.emplace_back(step.map.IdAt(entry.second), step.map);
  return Judge(loops, Camps(), step);
}

// Loops that are out and that the estimate has come closer to, the closest first; those from `first` on.
template <class Pose>
bool LoopJudge<Pose>::RetryParked(size_t first, size_t last, StepContext<Pose>& step) {
  std::vector<std::pair<double, FactorId>> close;
  for (size_t k = first; k < last; ++k) {
    const double chi2 = step.map.Chi2Of(parked_[k].id);
    if (chi2 <= limit_ || chi2 * kNews < parked_[k].chi2) close.emplace_back(chi2, parked_[k].id);
  }
  std::sort(close.begin(), close.end());
  if (close.size() > kMostRetried) close.resize(kMostRetried);
  Loops again;
  for (const auto& [chi2, id] : close) {
    Park(id, chi2);
    again.emplace_back(id, step.map);
  }
  return Chooses() ? AdmitLoops(again, step) : AdmitWeighted(again, step);
}

template <class Pose>
void LoopJudge<Pose>::Review(StepContext<Pose>& step) {
  if (!IsActive()) return;
  bool retry = !parked_.empty() && step.map.Updates() % step.options.relinearize_interval == 0;
  for (int round = 0; round < kMostRounds; ++round) {
    if (step.IsOverBudget()) return;
    bool changed = DropIfRefused(step) || (Chooses() ? ReviewMembers(step) : ReviewWeights(step));
    // Those that had to go are heard at once from where the others then are.
    if (!changed && (std::exchange(has_evicted_, false) || std::exchange(retry, false))) {
      const size_t first = next_parked_ < parked_.size() ? next_parked_ : 0;
      next_parked_ = std::min(parked_.size(), first + kMostLooked);
      changed = RetryParked(first, next_parked_, step);
    }
    if (!changed || step.options.carry == Carry::kPoint || !step.report.gate_open) return;
    BackSubstitute(std::nullopt, step);
  }
}

template <class Pose>
template <class Archive>
void LoopJudge<Pose>::Serialize(Archive& archive) {
  auto& [options, stated_limit, limit, outer_limit, reviewed_limit, doubts_all, scale, cycles, reviewed_cycle_limit,
         slots, parked, next_parked, has_evicted, evicted, slips] = *this;
  archive(options, stated_limit, limit, outer_limit, reviewed_limit, doubts_all, scale, cycles, reviewed_cycle_limit,
          next_parked, has_evicted, slips);
  archive.Each(slots, [&](OfSlot& slot) {
    auto& [is_loop, is_listed, weight, judged_chi2, leverage] = slot;
    archive(is_loop, is_listed, weight, judged_chi2, leverage);
  });
  archive.Each(parked, [&](Parked& loop) {
    auto& [id, chi2] = loop;
    archive(id, chi2);
  });
}

template <class Pose>
std::string LoopJudge<Pose>::FindStateDefect(const Map& map) const {
  if (slots_.size() != (IsActive() ? static_cast<size_t>(map.Slots()) : 0)) {
    return "lists by slot have different sizes";
  }
  size_t next = 0;
  for (const auto& node : map.Graph().Factors()) {
    if (map.SlotOf(node.id) >= 0) continue;
    if (next == parked_.size() || parked_[next].id != node.id) return "a measurement without a slot";
    ++next;
  }
  return next == parked_.size() ? "" : "a loop is out of the map that is not in the graph";
}

#define TERSE_INSTANTIATE(Pose)                                        \
  template class LoopJudge<Pose>;                                      \
  template void LoopJudge<Pose>::Serialize<StateWriter>(StateWriter&); \
  template void LoopJudge<Pose>::Serialize<StateReader>(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
