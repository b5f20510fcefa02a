// What of the graph and the solver is stored, and whether what was stored can be one.

#include <algorithm>
#include <limits>

#include "terse/core/log_message.h"
#include "terse/core/state_members.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

template <class... List>
bool HaveSize(size_t size, const List&... lists) {
  return ((lists.size() == size) && ...);
}

bool AreBelow(const std::vector<int>& numbers, size_t n, int least = 0) {
  return std::all_of(numbers.begin(), numbers.end(), [&](int i) { return i >= least && (i < 0 || At(i) < n); });
}

}  // namespace

// Gaps do not show: the living are stored.
template <class Pose>
template <class Archive>
void FactorList<Pose>::Serialize(Archive& archive) {
  std::vector<Node> living;
  if constexpr (!Archive::kReads) living.assign(begin(), end());
  archive(living);
  if constexpr (Archive::kReads) {
    *this = FactorList();
    for (const Node& node : living) {
      if (node.id.value < 0 || (!empty() && !(back().id < node.id))) archive.Fail("factor ids that do not ascend");
      Append(node.id, node.factor);
    }
  }
}

template <class Pose>
template <class Archive>
void PoseGraph<Pose>::Serialize(Archive& archive) {
  auto& [poses, index, factors, next_factor_id] = *this;
  archive.Each(poses, [&](PoseNode& node) {
    auto& [id, T_world_body, fixed] = node;
    archive(id, T_world_body, fixed);
  });
  archive(factors, next_factor_id);
  if constexpr (Archive::kReads) {
    index.clear();
    for (const PoseNode& node : poses) {
      if (!index.emplace(node.id.value, static_cast<int>(index.size())).second) archive.Fail("a pose comes twice");
    }
    for (const FactorNode& node : factors) {
      const FactorPoses ends = PosesOf(node.factor);
      if (!HasPose(ends.first) || !HasPose(ends.second)) archive.Fail("a factor on a pose that there is not");
      if (node.id.value >= next_factor_id) archive.Fail("a factor with an id that was not given out");
    }
  }
}

template <class Pose>
template <class Archive>
void IncrementalSolver<Pose>::Serialize(Archive& archive) {
  auto& [options, graph, linearization_points, factor, slot_of_factor, factor_of_slot, W_of_slot, anchor_slot, gauge,
         gauge_found_at, absolute, moved, possible_of, seen, possible_error, remembered, remembered_in, look,
         error_of_slot, error_sum, suspects, is_suspect, is_listed, updates, looked_at, cost_at_points, linear_cost,
         measured_scalars, eta, eta_variables, seconds_per_flop, deferred, seconds, watch, parked, is_loop,
         weight_of_slot, judged_chi2, touched, width] = *this;
  archive(options, graph, linearization_points, factor, slot_of_factor, factor_of_slot, W_of_slot, anchor_slot, gauge,
          gauge_found_at, absolute, moved, possible_of, seen, possible_error, remembered, remembered_in, look,
          error_of_slot, error_sum, suspects, is_suspect, is_listed, updates, looked_at, cost_at_points, linear_cost,
          measured_scalars, eta, eta_variables, deferred, is_loop, weight_of_slot, judged_chi2, touched, width);
  archive.Each(parked, [&](Parked& loop) {
    auto& [id, chi2] = loop;
    archive(id, chi2);
  });
  auto& [explained, corrected, cost_tried, poses_tried, restarts] = watch;
  archive(explained, corrected, cost_tried, poses_tried, restarts);
  archive(seconds_per_flop, seconds);  // times last: the same run has the same bytes before them
  if constexpr (Archive::kReads) {
    const std::string defect = FindStateDefect();
    if (!defect.empty()) archive.Fail(defect);
  }
}

// Graph and factor fit together, and every list its index.
template <class Pose>
std::string IncrementalSolver<Pose>::FindStateDefect() const {
  const size_t poses = graph_.Poses().size(), slots = factor_of_slot_.size();
  if (!HaveSize(poses, linearization_points_, possible_of_, seen_, remembered_, remembered_in_) ||
      At(factor_.Variables()) != poses || !AreBelow(moved_, poses) || !AreBelow(touched_, poses)) {
    return "lists by pose have different sizes";
  }
  // The factor may have free slots that no step has ever used: those of a step that failed.
  if (!HaveSize(slots, W_of_slot_, error_of_slot_, is_suspect_, is_listed_) ||
      !HaveSize(IsRobust() ? slots : 0, is_loop_, weight_of_slot_, judged_chi2_) || At(factor_.Slots()) < slots ||
      !AreBelow(suspects_, slots) || !AreBelow(slot_of_factor_, slots, -1)) {
    return "lists by slot have different sizes";
  }
  if (static_cast<size_t>(graph_.NextFactorId().value) != slot_of_factor_.size()) return "factors without a slot";
  size_t bound = 0, next_parked = 0;
  long scalars = 0;
  for (const auto& node : graph_.Factors()) {
    const int slot = slot_of_factor_[static_cast<size_t>(node.id.value)];
    if (slot < 0 && next_parked < parked_.size() && parked_[next_parked].id == node.id) {
      ++next_parked;
      continue;
    }
    if (slot < 0 || factor_of_slot_[At(slot)] != node.id) return "a measurement without a slot";
    const FactorPoses ends = PosesOf(node.factor);
    const int second = ends.count == 2 ? graph_.IndexOf(ends.second) : -1;
    const LinearFactor<B>& f = factor_.FactorAt(slot);
    if (f.first != graph_.IndexOf(ends.first) || f.second != second) return "a measurement in a slot of other poses";
    ++bound;
    scalars += Dimension(node.factor);
  }
  if (next_parked != parked_.size()) return "a loop is out of the map that is not in the graph";
  for (int slot = 0; slot < factor_.Slots(); ++slot) {
    const LinearFactor<B>& f = factor_.FactorAt(slot);
    const bool is_bound = At(slot) < slots && factor_of_slot_[At(slot)].value >= 0;
    if (is_bound && bound-- == 0) return "a slot without a measurement";
    if (is_bound || f.first < 0) continue;
    if (At(slot) >= slots || f.second >= 0) return "a slot without a measurement";
    const auto& node = graph_.Poses()[At(f.first)];
    if (slot != anchor_slot_ && !(node.fixed && node.T_world_body)) return "a pose is held that is not fixed";
  }
  if (anchor_slot_ < -1 || anchor_slot_ >= factor_.Slots() || (anchor_slot_ < 0) != (poses == 0) ||
      (anchor_slot_ >= 0 && factor_.FactorAt(anchor_slot_).first != 0)) {
    return "the map is not anchored";
  }
  const AbsoluteFactors absolute = CountAbsoluteFactors(graph_);
  const auto is_count = [](long number) { return number >= 0 && number < std::numeric_limits<long>::max() / 2; };
  if (scalars != measured_scalars_ || absolute.pose_priors != absolute_.pose_priors ||
      absolute.position_priors != absolute_.position_priors || !is_count(updates_) || !is_count(looked_at_) ||
      !is_count(look_) || eta_variables_ < 0) {
    return "it has miscounted";
  }
  return "";
}

template <class Pose>
void IncrementalSolver<Pose>::Save(const std::string& path) const {
  SaveState(path, StateKind<Pose>("incremental solver"), *this);
}

template <class Pose>
IncrementalSolver<Pose> IncrementalSolver<Pose>::Load(const std::string& path, LogSink log) {
  IncrementalSolver solver = LoadState<IncrementalSolver>(path, StateKind<Pose>("incremental solver"));
  solver.SetLog(std::move(log));
  internal::Log(solver.options_.log, LogLevel::kInfo, "restored from ", path, ": ", solver.graph_.Poses().size(),
                " poses, ", solver.graph_.Factors().size(), " factors after ", solver.updates_, " steps");
  return solver;
}

#define TERSE_INSTANTIATE(Pose)                                          \
  template void PoseGraph<Pose>::Serialize(StateWriter&);                \
  template void PoseGraph<Pose>::Serialize(StateReader&);                \
  template void IncrementalSolver<Pose>::Serialize(StateWriter&);        \
  template void IncrementalSolver<Pose>::Serialize(StateReader&);        \
  template void IncrementalSolver<Pose>::Save(const std::string&) const; \
  template IncrementalSolver<Pose> IncrementalSolver<Pose>::Load(const std::string&, LogSink);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
