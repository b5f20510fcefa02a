// Slips of the odometry: what LoopJudge makes of slip_search.h.

#include <algorithm>
#include <iterator>
#include <set>
#include <vector>

#include "incremental/loop_judge.h"
#include "terse/core/definite.h"
#include "terse/core/log_message.h"

namespace terse::internal {
namespace {

using std::size_t;

// Odometry that leads so close to a loop's end may be what the loop contradicts; and by how much more innovation than
// chi2 it may have if other loops hold what it holds.
constexpr int kReachOfSlip = 2;
constexpr double kMostLocalLeverage = 100;
// What a loop's innovation is without odometry that it rightly contradicts, in limits, at most.
constexpr double kNearOthers = 4;
// By so many loops it has to be the cheaper explanation: two wrong ones at the end of a trajectory can be one as well.
constexpr double kLeastGainOfSlip = 1.25;
// Loops, and odometry, that are looked at together.
constexpr size_t kMostLoops = 12, kMostOdometry = 10;

}  // namespace

template <class Pose>
void LoopJudge<Pose>::LogSlip(FactorId odometry, const StepContext<Pose>& step) const {
  const FactorPoses ends = PosesOf(step.map.Graph().FindFactor(odometry)->factor);
  Log(step.options.log, LogLevel::kWarning, "step ", step.map.Updates(), ": odometry ", ends.first.value, " - ",
      ends.second.value, " is left out, loops contradict it in the same way");
}

template <class Pose>
std::vector<FactorId> LoopJudge<Pose>::LoopsIn(const Map& map) const {
  std::vector<FactorId> in;
  for (size_t slot = 0; slot < slots_.size(); ++slot) {
    if (slots_[slot].is_loop) in.push_back(map.IdAt(static_cast<int>(slot)));
  }
  std::sort(in.begin(), in.end());
  return in;
}

// kGnc: loops that say together that an odometry edge is wrong come in for it, and the map moves to where it then is.
template <class Pose>
bool LoopJudge<Pose>::AdmitSlip(FactorId newcomer, StepContext<Pose>& step) {
  LinearizedGraph<Pose>& map = step.map;
  KnownLoops loops{newcomer, {}, [&] { return LoopsIn(map); }};
  const auto [first, last] = ParkedAround(newcomer);
  for (size_t k = first; k < last; ++k) loops.out.push_back(parked_[k].id);
  const std::optional<Slip<Pose>> slip = FindSlip(loops, Width(), map);
  return slip && TakeSlip(*slip, step);
}

template <class Pose>
bool LoopJudge<Pose>::TakeSlip(const Slip<Pose>& slip, StepContext<Pose>& step) {
  Loops in, out;
  if (slip.odometry) out.emplace_back(*slip.odometry, step.map);
  for (const FactorId id : slip.comes) in.emplace_back(id, step.map);
  for (const FactorId id : slip.goes) out.emplace_back(id, step.map);
  if (!Exchange(in, out, step)) return false;
  MoveMap(slip.T_world_body, step);
  if (slip.odometry) LogSlip(*slip.odometry, step);
  return true;
}

// kGnc: the same where the poses on both sides are held by other loops: those that contradict the odometry there are
// few, and what they have in common is a pose that lies wrong.
template <class Pose>
bool LoopJudge<Pose>::AdmitLocalSlip(Loop newcomer, StepContext<Pose>& step) {
  const Map& map = step.map;
  std::set<int> starts;  // of odometry at one of its ends
  for (const int v : {newcomer.linear.first, newcomer.linear.second}) starts.insert({v - 1, v});
  std::vector<Loop> others;
  const auto [first, last] = ParkedAround(newcomer.id);
  for (size_t k = first; k < last; ++k) {
    if (parked_[k].id == newcomer.id) continue;
    const FactorPoses ends = PosesOf(map.Graph().FindFactor(parked_[k].id)->factor);
    const auto touches = [&](PoseId id) {
      const int v = map.Graph().IndexOf(id);
      return starts.lower_bound(v - kReachOfSlip) != starts.upper_bound(v + kReachOfSlip);
    };
    if (touches(ends.first) || touches(ends.second)) others.emplace_back(parked_[k].id, map);
  }
  double at_stake = PriceOf(newcomer.id);
  for (const Loop& other : others) at_stake += PriceOf(other.id);
  if (at_stake <= kSlipPrice * limit_) return false;
  if (others.size() > kMostLoops) others.erase(others.begin(), others.end() - static_cast<long>(kMostLoops));
  const auto is_loop = [&](int slot) { return At(slot).is_loop != 0; };
  if (newcomer.z.IsEmpty()) newcomer.z = SolveForward(map.Cholesky().Tree(), newcomer.linear);
  Loops candidates;  // odometry that may be at fault, then the newcomer and the others
  for (const int v : starts) {
    const int slot = OdometrySlot(v, is_loop, map);
    if (slot < 0) continue;
    Loops both = {Loop(map.IdAt(slot), map), newcomer};
    // Without the odometry the newcomer is near what others say, or else it contradicts them as well.
    Contest<B> pair = ContestOf(both, map);
    if (pair.Leverage(0) <= kMostLocalLeverage && pair.Flip(0) && pair.Innovation(1) > kNearOthers * limit_) continue;
    if (PlacesAcross(v, LoopsIn(map), map) >= kLeastPlaces) candidates.push_back(std::move(both[0]));
  }
  if (candidates.empty()) return false;
  const size_t suspects = candidates.size();
  candidates.push_back(std::move(newcomer));
  std::move(others.begin(), others.end(), std::back_inserter(candidates));
  const Contest<B> together = ContestOf(candidates, map);
  std::vector<size_t> members = {0};  // of a contest: a suspect, and all that are none
  for (size_t k = suspects; k < candidates.size(); ++k) members.push_back(k);
  double lowest = -kLeastGainOfSlip * limit_;
  Slip<Pose> slip;
  for (size_t suspect = 0; suspect < suspects; ++suspect) {
    members[0] = suspect;
    Contest<B> without = together.Among(members);
    without.SetPrice(0, kSlipPrice * limit_);
    if (without.Leverage(0) > kMostLocalLeverage) without.Flip(1);  // what hangs on nothing else hangs on the loop
    if (without.Leverage(0) > kMostLocalLeverage || !without.Flip(0)) continue;
    without.Descend(1, members.size());
    if (without.Cost() >= lowest) continue;
    std::vector<FactorId> comes;
    for (size_t k = 1; k < members.size(); ++k) {
      if (without.In()[k] != 0) comes.push_back(candidates[members[k]].id);
    }
    if (CountPlaces(comes, map) < 2) continue;
    lowest = without.Cost();
    slip.comes = comes;
    slip.odometry = candidates[suspect].id;
  }
  return slip.odometry && TakeIfVerified(slip, step);
}

template <class Pose>
bool LoopJudge<Pose>::TakeIfVerified(Slip<Pose> suspected, StepContext<Pose>& step) {
  const Map& map = step.map;
  suspected.T_world_body = map.Estimates();
  const KnownLoops loops{FactorId(), {}, [&] { return LoopsIn(map); }};
  const std::optional<Slip<Pose>> slip = VerifySlip(suspected, loops, Width(), map);
  return slip && TakeSlip(*slip, step);
}

// kGnc: of the odometry that loops from several places contradict so much that it costs less to leave it out, the worst
// edge goes. As long as loops on both sides hold what it holds.
template <class Pose>
bool LoopJudge<Pose>::ReviewOdometry(const std::vector<int>& slots, StepContext<Pose>& step) {
  const Map& map = step.map;
  std::vector<std::pair<double, int>> doubtful;
  for (const int slot : slots) {
    const LinearFactor<B>& f = map.Cholesky().LinearFactorAt(slot);
    if (f.second < 0 || std::abs(f.first - f.second) != 1 || map.IdAt(slot).value < 0) continue;
    const double chi2 = map.LinearResidual(slot).squaredNorm();
    if (chi2 > limit_ && chi2 > kNews * At(slot).judged_chi2) doubtful.emplace_back(-chi2, slot);
  }
  if (doubtful.empty()) return false;
  std::sort(doubtful.begin(), doubtful.end());
  if (doubtful.size() > kMostOdometry) doubtful.resize(kMostOdometry);
  double worst = kSlipPrice * limit_;
  int worst_slot = -1;
  for (const auto& entry : doubtful) {
    Loop odometry(map.IdAt(entry.second), map);
    odometry.z = SolveForward(map.Cholesky().Tree(), odometry.linear);
    const Matrix<B, B> S = Matrix<B, B>::Identity() - Gram<B>(odometry.z, odometry.z);
    const double innovation = MahalanobisSquared<B>(S, map.LinearResidual(entry.second));
    if (innovation <= worst || !std::isfinite(innovation)) continue;
    if (PlacesAcross(std::min(odometry.linear.first, odometry.linear.second), LoopsIn(map), map) < kLeastPlaces) {
      continue;
    }
    worst = innovation;
    worst_slot = entry.second;
  }
  if (worst_slot < 0) return false;
  // Once, not at every step from now on: it takes batch solves.
  At(worst_slot).judged_chi2 = map.LinearResidual(worst_slot).squaredNorm();
  Slip<Pose> slip;
  slip.odometry = map.IdAt(worst_slot);
  return TakeIfVerified(slip, step);
}

// kGnc: all of it.
template <class Pose>
bool LoopJudge<Pose>::ReviewAllOdometry(StepContext<Pose>& step) {
  std::vector<int> slots;
  for (size_t slot = 0; slot < slots_.size(); ++slot) {
    if (!slots_[slot].is_loop) slots.push_back(static_cast<int>(slot));
  }
  if (!ReviewOdometry(slots, step)) return false;
  BackSubstitute(std::nullopt, step);
  return true;
}

#define TERSE_INSTANTIATE(Pose)                                                               \
  template void LoopJudge<Pose>::LogSlip(FactorId, const StepContext<Pose>&) const;           \
  template std::vector<FactorId> LoopJudge<Pose>::LoopsIn(const Map&) const;                  \
  template bool LoopJudge<Pose>::AdmitSlip(FactorId, StepContext<Pose>&);                     \
  template bool LoopJudge<Pose>::TakeSlip(const Slip<Pose>&, StepContext<Pose>&);             \
  template bool LoopJudge<Pose>::TakeIfVerified(Slip<Pose>, StepContext<Pose>&);              \
  template bool LoopJudge<Pose>::AdmitLocalSlip(JudgedLoop<Pose>, StepContext<Pose>&);        \
  template bool LoopJudge<Pose>::ReviewOdometry(const std::vector<int>&, StepContext<Pose>&); \
  template bool LoopJudge<Pose>::ReviewAllOdometry(StepContext<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
