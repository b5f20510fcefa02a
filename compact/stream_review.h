#pragma once
// The beginning of a stream as it was measured, and what it looks like from later on.
//
// When twice as many loops are there as at the last look, all that was measured so far is looked at again: what its
// residuals say of the information (CalibrateInformation), which thresholds fit it (SelectThresholds), and, where the
// map refuses many loops, which of them are wrong (ContradictedLoops). If that is something else than what the map was
// made with, the same measurements go through a new one. All this in a thread of its own, while the stream goes on with
// the map that it has. It takes the other one over a fixed number of poses later, whether it had to wait for it or not,
// so that a run can be repeated.

#include <algorithm>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "terse/compact/measurement_stream.h"

namespace terse::internal {

// One call of a stream: a measurement, the value of a pose, poses that are fixed, or, with nothing, Flush.
template <class Pose>
struct StreamEvent {
  std::optional<Factor<Pose>> factor;
  std::optional<Pose> T_world_body;
  std::vector<PoseId> ids;   // of the value; of what is fixed
  bool is_left_out = false;  // a loop that is wrong
};

// Another map of the same measurements.
template <class Pose>
struct RemadeMap {
  RemadeMap(const CompactOptions<Pose>& settings, const InformationScale& scale);
  // Those that it has not taken, but for loops left out, and links that it cannot have, to a pose that it has
  // forgotten. Throws what the stream throws for others.
  void TakeUpTo(const std::vector<StreamEvent<Pose>>& events);

  std::unique_ptr<CompactPoseSlam<Pose>> slam;
  MeasurementStream<Pose> stream;  // of it
  std::vector<Decision> decisions;
  long refused = 0;  // loops

 private:
  bool Knows(const StreamEvent<Pose>& event) const;
  std::size_t taken_ = 0;
};

template <class Pose>
class StreamReview {
 public:
  StreamReview() = default;
  explicit StreamReview(const InformationScale& scale) : scale_(scale) {}
  // That looks.
  StreamReview(const CompactOptions<Pose>& settings, const ReviewOptions& options);

  const InformationScale& Scale() const { return scale_; }
  // `opens`: a pose that no measurement named before.
  Factor<Pose> Scaled(const Factor<Pose>& factor, bool opens) const;

  // What the stream has taken, as it was measured, the pose that it opened, and what came of it.
  void Note(StreamEvent<Pose> event, std::optional<PoseId> opened = std::nullopt,
            const std::vector<StreamOutcome>& outcomes = {});
  void NoteDiscarded(PoseId open);
  // No look any more; the scale stays.
  void Stop();

  // Begins a look if there is reason for one. Returns the map that was made anew if its time has come, with all events
  // in it, and uses its scale from here on. `slam`: the map as it is. `is_last`: looks at everything measured, and
  // waits.
  struct Found {
    Review review;  // but for its decisions
    RemadeMap<Pose> remade;
  };
  std::optional<Found> Look(const CompactPoseSlam<Pose>& slam, bool is_last);

  template <class Archive>
  void Serialize(Archive& archive);
  // After it was read: why it makes no sense, or ""; and on it goes.
  std::string FindStateDefect() const;
  void Resume(const CompactPoseSlam<Pose>& slam);

 private:
  // The beginning that a look is about.
  struct Beginning {
    CompactOptions<Pose> settings;  // in use, as scale
    ReviewOptions options;
    InformationScale scale;
    std::vector<StreamEvent<Pose>> events;
    bool is_in_doubt = false;                     // its loops, by the map as it is
    std::vector<RecoveredPose<Pose>> trajectory;  // of that map
  };
  struct Looked {
    InformationCalibration information;
    InformationScale scale;  // to use from now on, as thresholds
    Thresholds<Pose> thresholds;
    std::vector<StreamEvent<Pose>> events;  // with what is left out
    std::optional<RemadeMap<Pose>> remade;  // if that is another one
  };
  static Looked LookAt(Beginning beginning);
  // Whether it is the first chance to choose thresholds, and the last.
  bool HasNoThresholds() const { return options_.chosen.Any() && looked_at_ == 0; }
  long Loops() const { return edges_ - std::max(0L, poses_ - 1); }
  bool IsInDoubt() const;
  bool IsEnough() const;
  void Begin(std::size_t events, const CompactPoseSlam<Pose>& slam);
  std::optional<Found> End();

  CompactOptions<Pose> settings_;
  ReviewOptions options_;
  InformationScale scale_;
  bool records_ = false;
  std::vector<StreamEvent<Pose>> events_;
  std::optional<PoseId> newest_, before_;  // poses in order of arrival
  long poses_ = 0, edges_ = 0;             // of the events
  long refused_ = 0;                       // loops, by the map
  long looked_at_ = 0;                     // loops
  bool is_last_look_ = false;              // for all that is to be held is there
  // A look on the way: events that it is about, and with how many poses it is over; 0: there is none.
  std::size_t events_of_look_ = 0;
  long over_at_ = 0;
  std::future<Looked> look_;
};

}  // namespace terse::internal
