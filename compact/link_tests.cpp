#include "link_tests.h"

#include <algorithm>
#include <limits>
#include <set>

#include "chains.h"
#include "pose_recovery.h"
#include "terse/compact/information.h"
#include "terse/compact/innovation.h"
#include "terse/compact/state_members.h"
#include "terse/core/chi_square.h"

namespace terse::internal {
namespace {

using std::size_t;

// A link that is supported finds its support among the last refused ones: they come from poses close behind each other,
// of which each may have had several. Failures are remembered for the steps in which their neighbours come up.
constexpr size_t kMostRefused = 64, kMostFailed = 256;
// Poses before the first link of a consensus whose links may speak against it, and by how much of its time they have to
// lead back.
constexpr std::int64_t kStretch = 20;
constexpr double kLeastAge = 0.25;
constexpr size_t kMostAgreed = 64;

template <class Item>
void KeepNewest(size_t count, std::vector<Item>& items) {
  if (items.size() > count) items.erase(items.begin(), items.end() - static_cast<long>(count));
}

}  // namespace

template <class Pose>
void LinkTests<Pose>::TakeOptions() {
  stated_innovation_ = options_.innovation_quantile ? ChiSquareQuantile(*options_.innovation_quantile, Pose::kDof)
                                                    : std::numeric_limits<double>::infinity();
  most_innovation_ = options_.innovation_quantile
                         ? std::min(scale_.Limit(stated_innovation_, Pose::kDof), cycles_.LimitInMap())
                         : stated_innovation_;
}

template <class Pose>
void LinkTests<Pose>::NoteOdometry(const CompactInput<Pose>& input) {
  if (!input.odometry) return;
  newest_before_ = cycles_.Newest();
  cycles_.Extend(*input.odometry);
}

template <class Pose>
bool LinkTests<Pose>::IsBelieved(const CurrentPose<Pose>* current, const UncertainPose<Pose>& known,
                                 const UncertainPose<Pose>& measured, Candidate& record) {
  if (options_.innovation_quantile) {
    record.innovation = InnovationDistance(known, measured);
    record.outlier = !(*record.innovation <= most_innovation_);
    if (current != nullptr) {
      const auto cycle = cycles_.Innovation(record.id, current->input->id, measured.T_a_b, measured.covariance);
      record.outlier = record.outlier || cycles_.Refuses(cycle);
      if (cycle) noted_cycles_.push_back(*cycle);
    }
    // What the stated covariances allow counts, also if it is refused (innovation_scale.h).
    if (current != nullptr && *record.innovation <= stated_innovation_) noted_.push_back(*record.innovation);
    if (current != nullptr && !record.outlier) noted_agreed_.push_back({record.id, current->input->id});
  }
  if (record.outlier && current != nullptr) {
    record.supported = IsSupported(*current, record.id, known, measured);
    if (!record.supported) refused_.push_back({record.id, current->input->id, measured});
    noted_break_ = noted_break_ || record.supported;
  }
  return !IsRefused(record);
}

// From a pose seen before to the one at hand, along its chain or through the map, whichever knows more.
template <class Pose>
UncertainPose<Pose> LinkTests<Pose>::FromSeen(PoseId id, const CurrentPose<Pose>& current) const {
  const auto& seen = history_.Find(id);
  if (!seen.kept && !seen.next_kept && seen.base == current.base) {
    // Both hang on one chain: what lies before the older one is no error between them.
    if (const auto behind = Behind(seen.T_base_pose, current.T_base_current)) return *behind;
  }
  UncertainPose<Pose> best = Compose(Invert(seen.T_base_pose), map_.Between(seen.base, current.base));
  if (!seen.kept && seen.next_kept) {
    if (const auto behind = Behind(seen.T_base_pose, seen.T_base_next)) {
      const UncertainPose<Pose> through_next = Compose(*behind, map_.Between(*seen.next_kept, current.base));
      if (through_next.covariance.determinant() < best.covariance.determinant()) best = through_next;
    }
  }
  return Compose(best, current.T_base_current);
}

// Whether enough refused links of other poses predict this one of the pose at hand.
template <class Pose>
bool LinkTests<Pose>::IsSupported(const CurrentPose<Pose>& current, PoseId candidate, const UncertainPose<Pose>& known,
                                  const UncertainPose<Pose>& measured) const {
  // A link to where the map has the pose: who cannot tell it from the one measured agrees with anything.
  const UncertainPose<Pose> expected{known.T_a_b, measured.covariance};
  std::set<PoseId> supporters;
  for (auto it = refused_.rbegin(); it != refused_.rend(); ++it) {
    if (it->seen == current.input->id || supporters.count(it->seen) != 0) continue;
    const UncertainPose<Pose> T_candidate_seen = Compose(map_.Between(candidate, it->candidate), it->T_candidate_seen);
    const UncertainPose<Pose> predicted = Compose(T_candidate_seen, FromSeen(it->seen, current));
    if (InnovationDistance(predicted, measured) > most_innovation_) continue;
    if (InnovationDistance(predicted, expected) <= most_innovation_) continue;
    supporters.insert(it->seen);
    if (static_cast<int>(supporters.size()) + 1 < options_.consensus) continue;
    return !IsOutvoted(candidate, current.input->id, *supporters.begin(), static_cast<long>(supporters.size()));
  }
  return false;
}

// Whether as many poses of the same stretch have links that agree with the map, over as long a time: then the map was
// right there, and those that agree with each other make one mistake.
template <class Pose>
bool LinkTests<Pose>::IsOutvoted(PoseId candidate, PoseId current, PoseId first_supporter, long supporters) const {
  const auto age = [](PoseId older, PoseId newer) { return static_cast<double>(newer.value - older.value); };
  const auto speaks = [&](const Agreed& link) {
    return link.seen.value >= first_supporter.value - kStretch &&
           age(link.candidate, link.seen) >= kLeastAge * age(candidate, current);
  };
  std::set<PoseId> seen;
  for (const Agreed& link : agreed_) {
    if (speaks(link)) seen.insert(link.seen);
  }
  return static_cast<long>(seen.size()) > supporters;
}

template <class Pose>
bool LinkTests<Pose>::AreNeighbours(const Pose& T_world_a, const Pose& T_world_b) const {
  const auto apart = DisplacementMean<Pose>(T_world_a.Inverse() * T_world_b, options_.distance);
  return (apart.cwiseAbs().array() <= options_.failed_neighbourhood * options_.thresholds.range.array()).all();
}

template <class Pose>
std::vector<typename LinkTests<Pose>::Failed> LinkTests<Pose>::FailedNear(const CurrentPose<Pose>& current) const {
  const PoseRecovery<Pose> recovery(history_, map_);
  std::vector<Failed> out;
  for (const Failed& failed : failed_) {
    const bool is_own = failed.seen == current.input->id;  // which is not remembered yet
    if (is_own || AreNeighbours(recovery.Estimate(failed.seen, Recovery::kV1), current.T_world_body))
      out.push_back(failed);
  }
  return out;
}

template <class Pose>
bool LinkTests<Pose>::IsNearFailed(const std::vector<Failed>& failed, PoseId candidate) const {
  return std::any_of(failed.begin(), failed.end(), [&](const Failed& f) {
    return f.candidate == candidate ||
           AreNeighbours(map_.Solver().Estimate(f.candidate), map_.Solver().Estimate(candidate));
  });
}

template <class Pose>
void LinkTests<Pose>::TakeIn() {
  for (const double innovation : noted_) scale_.Add(innovation);
  for (const double innovation : noted_cycles_) cycles_.Note(innovation, stated_innovation_);
  if (noted_break_) cycles_.Break(cycles_.Newest());
  // Links lead to kept poses.
  cycles_.Forget([&](PoseId id) { return map_.Solver().Graph().HasPose(id); });
  agreed_.insert(agreed_.end(), noted_agreed_.begin(), noted_agreed_.end());
  KeepNewest(kMostAgreed, agreed_);
  ClearNoted();
  TakeOptions();
  KeepNewest(kMostRefused, refused_);
  KeepNewest(kMostFailed, failed_);
  EraseIf([&](PoseId seen) { return history_.IsForgotten(seen); });
}

template <class Pose>
void LinkTests<Pose>::ClearNoted() {
  noted_.clear();
  noted_cycles_.clear();
  noted_agreed_.clear();
  noted_break_ = false;
}

template <class Pose>
void LinkTests<Pose>::ForgetNewest(PoseId newest) {
  if (cycles_.Newest() == newest) cycles_.Retract(newest_before_);
  ClearNoted();
  EraseIf([&](PoseId seen) { return seen == newest; });
}

template <class Pose>
template <class Test>
void LinkTests<Pose>::EraseIf(const Test& test) {
  const auto is_hit = [&](const auto& link) { return test(link.seen); };
  refused_.erase(std::remove_if(refused_.begin(), refused_.end(), is_hit), refused_.end());
  failed_.erase(std::remove_if(failed_.begin(), failed_.end(), is_hit), failed_.end());
}

template <class Pose>
void LinkTests<Pose>::Export(CompactMap<Pose>& map) const {
  map.refused = refused_;
  map.failed = failed_;
}

template <class Pose>
void LinkTests<Pose>::Restore(const CompactMap<Pose>& map) {
  refused_ = map.refused;
  failed_ = map.failed;
}

template <class Pose>
template <class Archive>
void LinkTests<Pose>::Serialize(Archive& archive) {
  auto& [options, map, history, stated_innovation, most_innovation, scale, cycles, newest_before, noted, noted_cycles,
         noted_break, noted_agreed, all_agreed, all_refused, all_failed] = *this;
  archive(scale, cycles);  // what is before it is of the whole, or follows; what is noted is empty between poses
  archive.Each(all_agreed, [&](Agreed& link) {
    auto& [candidate, seen] = link;
    archive(candidate, seen);
  });
  if constexpr (Archive::kReads) TakeOptions();
  archive.Each(all_refused, [&](Refused& link) {
    auto& [candidate, seen, T_candidate_seen] = link;
    archive(candidate, seen, T_candidate_seen);
  });
  archive.Each(all_failed, [&](Failed& registration) {
    auto& [candidate, seen] = registration;
    archive(candidate, seen);
  });
}

template <class Pose>
std::string LinkTests<Pose>::FindStateDefect() const {
  const auto is_unknown = [&](const auto& link) {
    return !map_.Solver().Graph().HasPose(link.candidate) || !history_.Has(link.seen);
  };
  if (std::any_of(refused_.begin(), refused_.end(), is_unknown)) return "a link of unknown poses";
  if (std::any_of(failed_.begin(), failed_.end(), is_unknown)) return "a registration of unknown poses";
  return "";
}

#define TERSE_INSTANTIATE(Pose)                           \
  template class LinkTests<Pose>;                         \
  template void LinkTests<Pose>::Serialize(StateWriter&); \
  template void LinkTests<Pose>::Serialize(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
