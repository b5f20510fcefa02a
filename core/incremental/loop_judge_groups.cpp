// Loops that lead from one place to one other: what LoopJudge makes of groups.

#include <algorithm>
#include <array>
#include <cstdlib>
#include <map>
#include <set>
#include <vector>

#include "incremental/loop_judge.h"
#include "terse/core/definite.h"
#include "terse/core/front_paths.h"

namespace terse::internal {
namespace {

using std::size_t;

// Loops of each side of a contest, and of a group.
constexpr size_t MostOfASide(int B) { return B == 3 ? 40 : 24; }
constexpr size_t kMostOfGroup = 12;
template <int B>
bool AreNear(const LinearFactor<B>& a, const LinearFactor<B>& b) {
  return std::abs(a.first - b.first) <= kReachOfGroup && std::abs(a.second - b.second) <= kReachOfGroup;
}

}  // namespace

// Whom it would move most if the loop were in, and who would be served. What is in may give way by little and still
// oppose: its conflict can be with the odometry between.
template <class Pose>
typename LoopJudge<Pose>::Camps LoopJudge<Pose>::AddContestants(Loops& contest, const Map& map) const {
  using Ranked = std::vector<std::pair<double, FactorId>>;
  const Loop& loop = contest[0];
  const Matrix<B, B> S = Matrix<B, B>::Identity() + Gram<B>(loop.z, loop.z);
  const std::vector<double> x = SolveBackward<B>(map.Cholesky().Tree(), loop.z, SolveDefinite<B>(S, loop.residual));
  const auto moved = [&](const LinearFactor<B>& f) { return ResidualChange(f, x); };
  Ranked against, along;
  int mates = 0;  // of its group, or at one with it
  const auto look = [&](size_t first, size_t last) {
    for (size_t k = first; k < last; ++k) {
      if (parked_[k].id == loop.id) continue;
      const Loop other(parked_[k].id, map);
      const double now = other.residual.squaredNorm(), after = (other.residual - moved(other.linear)).squaredNorm();
      if (after * kNews >= now || IsRefusedByOdometry(other.id, map)) continue;
      along.emplace_back(after, other.id);
      if (AreNear(loop.linear, other.linear) || after <= limit_) ++mates;
    }
  };
  const auto [first_around, behind_around] = ParkedAround(loop.id);
  look(first_around, behind_around);
  // One against another: who was first stays. More are heard when they have become twice as many.
  if (mates == 0 || (mates & (mates - 1)) != 0) return {};
  along.clear();
  look(parked_.size() - std::min(parked_.size(), kMostLooked), parked_.size());
  for (int slot = 0; slot < static_cast<int>(slots_.size()); ++slot) {
    if (!slots_[static_cast<size_t>(slot)].is_loop) continue;
    against.emplace_back(-moved(map.Cholesky().LinearFactorAt(slot)).squaredNorm(), map.IdAt(slot));
  }
  const auto best = [](Ranked& side) { side.resize(std::min(side.size(), MostOfASide(B))); };
  std::sort(along.begin(), along.end());
  best(along);
  for (const auto& entry : along) contest.emplace_back(entry.second, map);
  Camps camps;
  camps.first_against = contest.size();
  const auto kept = against.begin() + static_cast<long>(std::min(against.size(), MostOfASide(B)));
  std::partial_sort(against.begin(), kept, against.end());
  std::set<int> taken;
  for (auto it = against.begin(); it != kept && taken.size() < MostOfASide(B); ++it) {
    const int seed = map.SlotOf(it->second);
    if (taken.count(seed) > 0) continue;
    std::vector<size_t> group;
    for (const int slot : GroupOf(seed, map)) {
      if (!taken.insert(slot).second) continue;
      group.push_back(contest.size());
      contest.emplace_back(map.IdAt(slot), map);
    }
    camps.groups.push_back(std::move(group));
  }
  return camps;
}

// The slots of loops that lead from where this one does to where it does, itself the first.
template <class Pose>
std::vector<int> LoopJudge<Pose>::GroupOf(int slot, const Map& map) const {
  const LinearFactor<B>& seed = map.Cholesky().LinearFactorAt(slot);
  std::vector<int> group = {slot};
  for (int v = std::max(0, seed.first - kReachOfGroup);
       v <= std::min(map.Cholesky().Variables() - 1, seed.first + kReachOfGroup); ++v) {
    for (const int other : map.Cholesky().SlotsOf(v)) {
      const LinearFactor<B>& f = map.Cholesky().LinearFactorAt(other);
      if (other == slot || !slots_[static_cast<size_t>(other)].is_loop || f.first != v || !AreNear(f, seed)) continue;
      group.push_back(other);
      if (group.size() == kMostOfGroup) return group;
    }
  }
  return group;
}

// One of a group speaks for it, the closest to the estimate; who is alone has been heard. Few are all heard.
template <class Pose>
bool LoopJudge<Pose>::JudgeParkedGroups(StepContext<Pose>& step) {
  struct Entry {
    double chi2;
    FactorId id;
    std::array<int, 2> ends;
    bool operator<(const Entry& other) const { return chi2 < other.chi2; }
  };
  std::vector<Entry> order;
  std::map<std::array<int, 2>, std::vector<std::array<int, 2>>> cells;  // a reach wide
  const auto cell = [](const std::array<int, 2>& ends) {
    return std::array<int, 2>{ends[0] / kReachOfGroup, ends[1] / kReachOfGroup};
  };
  const auto is_near = [](const std::array<int, 2>& a, const std::array<int, 2>& b) {
    return a != b && std::abs(a[0] - b[0]) <= kReachOfGroup && std::abs(a[1] - b[1]) <= kReachOfGroup;
  };
  const auto any_near = [&](const std::array<int, 2>& ends) {
    const std::array<int, 2> at = cell(ends);
    for (int i = -1; i <= 1; ++i) {
      for (int j = -1; j <= 1; ++j) {
        const auto it = cells.find({at[0] + i, at[1] + j});
        if (it == cells.end()) continue;
        for (const auto& other : it->second) {
          if (is_near(ends, other)) return true;
        }
      }
    }
    return false;
  };
  for (const Parked& parked : parked_) {
    const FactorPoses ends = PosesOf(step.map.Graph().FindFactor(parked.id)->factor);
    order.push_back({step.map.Chi2Of(parked.id),
                     parked.id,
                     {step.map.Graph().IndexOf(ends.first), step.map.Graph().IndexOf(ends.second)}});
    cells[cell(order.back().ends)].push_back(order.back().ends);
  }
  const bool hears_all = parked_.size() <= kNeighbours;
  const auto is_alone = [&](const Entry& e) { return !hears_all && !any_near(e.ends); };
  order.erase(std::remove_if(order.begin(), order.end(), is_alone), order.end());
  std::sort(order.begin(), order.end());
  cells.clear();  // from here on those that have been heard
  bool changed = false;
  for (const Entry& entry : order) {
    if (step.map.SlotOf(entry.id) >= 0 || (!hears_all && any_near(entry.ends))) continue;
    cells[cell(entry.ends)].push_back(entry.ends);
    if (!AdmitLoops({Loop(entry.id, step.map)}, step)) continue;
    changed = true;
    BackSubstitute(std::nullopt, step);
  }
  return changed;
}

#define TERSE_INSTANTIATE(Pose)                                                                       \
  template typename LoopJudge<Pose>::Camps LoopJudge<Pose>::AddContestants(Loops&, const Map&) const; \
  template std::vector<int> LoopJudge<Pose>::GroupOf(int, const Map&) const;                          \
  template bool LoopJudge<Pose>::JudgeParkedGroups(StepContext<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
