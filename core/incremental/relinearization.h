#pragma once
// Which poses are relinearised: those whose measurements are worst described by the linearised system. Of each
// measurement the error of its linearisation, |r(estimate) - (r + A d)|^2 (whitened), is kept and brought up to date
// where poses moved enough to matter; the errors' sum is compared with what the options tolerate.

#include <optional>
#include <unordered_set>

#include "incremental/linearized_graph.h"

namespace terse::internal {

template <class Pose>
class Relinearization {
 public:
  static constexpr int B = Pose::kDof;
  using Map = LinearizedGraph<Pose>;
  using Clock = std::chrono::steady_clock;
  using Deadline = std::optional<Clock::time_point>;

  // Follows the map: its poses and slots after every update, a slot before it is released, and when all points move and
  // every pose is its own linearisation point.
  void Resize(const Map& map);
  void Release(int slot) { error_sum_ -= std::exchange(slots_[static_cast<std::size_t>(slot)].error, 0.0); }
  void ForgetErrors();

  // Poses that moved by back-substitution.
  void NoteMoved(const std::vector<int>& moved, const Map& map, const IncrementalOptions& options);
  bool IsDue(const Map& map, const IncrementalOptions& options) const {
    return !moved_.empty() && map.Updates() - looked_at_ >= options.relinearize_interval;
  }
  // Errors of many times what is tolerated do not wait for the interval.
  bool IsUrgent(const Map& map, const IncrementalOptions& options) const;

  // Moves the linearisation points of the poses with the worst factors to their estimates, if the errors add up to
  // `times` what is tolerated; once (or urgently) so far as the deadline allows. A wrong or far link can throw an
  // estimate to where the linearisation means nothing; there the points go only part of the way. True if any moved.
  bool MoveWorst(bool urgently, Deadline deadline, Map& map, const IncrementalOptions& options, StepReport& report);
  // Moves linearisation points; their d becomes zero. If the Cholesky factor does not take it, nothing changes.
  bool MovePoints(const std::map<int, Pose>& points, const typename Map::Replacements& replaced, Map& map,
                  const IncrementalOptions& options, StepReport& report);

  template <class Archive>
  void Serialize(Archive& archive);
  // Times are stored apart: the same run has the same bytes before them.
  template <class Archive>
  void SerializeTimes(Archive& archive);
  std::string FindStateDefect(const Map& map) const;

 private:
  struct OfPose {
    double possible = 0;                 // PossibleError, 0 if it is not in moved_
    Vector<B> seen = Vector<B>::Zero();  // d when its factors' errors were looked at
    Pose remembered;                     // its estimate
    long remembered_in = 0;              // the look that it is from
  };
  struct OfSlot {
    double error = 0;  // when last looked at
    char is_suspect = 0, is_listed = 0;
  };
  OfPose& At(int index) { return poses_[static_cast<std::size_t>(index)]; }
  OfSlot& SlotAt(int slot) { return slots_[static_cast<std::size_t>(slot)]; }
  double PossibleError(int variable, const Map& map) const;
  const Pose& RememberedEstimate(int index, const Map& map);
  Vector<Pose::kDof> WhitenedResidualAt(int slot, const Map& map);
  double LinearizationError(int slot, const Map& map);
  double ErrorAfter(int slot, const std::map<int, Pose>& points, const Map& map);
  void UpdateErrors(const Map& map, const IncrementalOptions& options);
  void SetError(int slot, double error, double suspicious);
  void SortSuspects(double suspicious);
  std::map<int, Pose> ChoosePoses(double times, Deadline deadline, const Map& map, const IncrementalOptions& options,
                                  StepReport& report);
  double AffordableFlops(Clock::time_point deadline) const;

  std::vector<OfPose> poses_;  // by index
  std::vector<OfSlot> slots_;
  std::vector<int> moved_;     // poses that turned since their factors' errors were looked at
  double possible_error_ = 0;  // of moved_
  std::vector<int> suspects_;  // slots with an error worth looking at
  double error_sum_ = 0;
  long look_ = 0;                   // counts the looks at the errors
  long looked_at_ = 0;              // the update of the last one
  double seconds_per_flop_ = 1e-9;  // of relinearisation: measured, by the flops that were predicted
};

}  // namespace terse::internal
