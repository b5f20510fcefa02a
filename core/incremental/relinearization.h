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

  // Whether relinearising everything, as often as a step may, should take less than so many seconds on the slowest
  // machine: then a step need not look at the clock, and does the same every time.
  static bool IsQuick(const Map& map, double seconds, int rounds);

  // Follows the map: its poses and slots after every update, a slot before it is released, and when all points move and
  // every pose is its own linearisation point.
  void Resize(const Map& map);
  void Release(int slot) { error_sum_ -= std::exchange(slots_[static_cast<std::size_t>(slot)].error, 0.0); }
  void ForgetErrors(Map& map);

  // Measurements that came in since this was called last: their poses may be far from their linearisation points. That
  // opens no gate that is shut.
  void NoteNew(bool gate_open, Map& map, const IncrementalOptions& options);
  // Poses that moved by back-substitution.
  void NoteMoved(const std::vector<int>& moved, const Map& map, const IncrementalOptions& options);
  // What back-substitutions took of late at most, about; how many in a row did not come to an end.
  void NoteSolved(double seconds, bool is_done) {
    solve_seconds_ = std::max(seconds, kForget * solve_seconds_);
    unfinished_solves_ = is_done ? 0 : unfinished_solves_ + 1;
  }
  double SolveSeconds() const { return solve_seconds_; }
  int UnfinishedSolves() const { return unfinished_solves_; }
  bool IsDue(const Map& map, const IncrementalOptions& options) const {
    return !moved_.empty() && map.Updates() - looked_at_ >= options.relinearize_interval;
  }
  // Poses, at most, that are to be looked at or are made ready.
  int Unseen() const { return static_cast<int>(moved_.size() + prepared_.points.size()); }
  // Errors of many times what is tolerated do not wait for the interval.
  bool IsUrgent(const Map& map, const IncrementalOptions& options) const;

  // Moves the linearisation points of the poses with the worst factors to their estimates, if the errors add up to more
  // than is tolerated (urgently: than many times that). A wrong or far link can throw an estimate to where the
  // linearisation means nothing; there the points go only part of the way. True if any moved. What does not fit before
  // the deadline is made ready in pieces by this and later calls, and moves all at once when it is: of poses that moved
  // together, some at new points and some at old ones would make the linearised system mean nothing.
  bool MoveWorst(bool urgently, Deadline deadline, Map& map, const IncrementalOptions& options, StepReport& report);
  // After whatever else a step did.
  void EndStep(Map& map);
  // Moves linearisation points; their d becomes zero. If the Cholesky factor does not take it, nothing changes.
  bool MovePoints(const PointMap<Pose>& points, typename Map::Replacements replaced, Map& map,
                  const IncrementalOptions& options, StepReport& report);

  template <class Archive>
  void Serialize(Archive& archive);
  // Times are stored apart: the same run has the same bytes before them.
  template <class Archive>
  void SerializeTimes(Archive& archive);
  std::string FindStateDefect(const Map& map) const;
  void NoteLoaded(const Map& map) { prepared_.version = map.Cholesky().Version(); }

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
  double ErrorAfter(int slot, const PointMap<Pose>& points, const Map& map);
  bool UpdateErrors(Deadline deadline, const Map& map, const IncrementalOptions& options);
  void SetError(int slot, double error, double suspicious);
  void SortSuspects(double suspicious);
  PointMap<Pose> ChoosePoses(double more_than, const Map& map, const IncrementalOptions& options);
  bool MoveAtOnce(PointMap<Pose> points, Map& map, const IncrementalOptions& options, StepReport& report);
  // In pieces.
  bool Fits(const PointMap<Pose>& points, Clock::time_point deadline, const Map& map) const;
  void Prepare(PointMap<Pose> points, Map& map);
  void PrepareAgain(Map& map);
  void QueueChanged(Map& map);
  bool LinearizePrepared(Clock::time_point deadline, Map& map, const IncrementalOptions& options);
  bool MovePrepared(Clock::time_point deadline, Map& map, const IncrementalOptions& options, StepReport& report);

  std::vector<OfPose> poses_;  // by index
  std::vector<OfSlot> slots_;
  std::vector<int> moved_;     // poses that turned since their factors' errors were looked at
  double possible_error_ = 0;  // of moved_
  std::vector<int> suspects_;  // slots with an error worth looking at
  double error_sum_ = 0;
  long look_ = 0;       // counts the looks at the errors
  long looked_at_ = 0;  // the update of the last one
  static constexpr double kForget = 0.98;
  double solve_seconds_ = 0;
  int unfinished_solves_ = 0;
  double seconds_per_flop_ = 1e-9;  // of relinearisation: measured, by the flops that were predicted

  // Points that are made ready.
  struct Prepared {
    PointMap<Pose> points;
    std::vector<int> queue;       // slots to be linearised
    double before = 0, cost = 0;  // of those that were
    double share = 1;             // of the way to the estimates that the points go
    bool is_checked = false;      // that this is not too far
    long since = 0;               // the update
    std::uint64_t version = 0;    // up to which changes are known
  };
  Prepared prepared_;
};

}  // namespace terse::internal
