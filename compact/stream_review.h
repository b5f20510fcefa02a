#pragma once
// The beginning of a stream as it was measured, and what it looks like from later on.
//
// When twice as many loops are there as at the last look (before there are eight of them, twice as many poses, where
// thresholds are to be chosen), all that was measured so far is looked at again: what its
// residuals say of the information (CalibrateInformation), which thresholds fit it (SelectThresholds), and, as a
// file's are, which loops are wrong (LoopJury). If that is something else than what the map was
// made with, or loops came late, to poses that it had decided on, the same measurements go through a new one, loops
// with the later of their poses. All this in a thread of its own, while the stream goes on with the map that it has. It
// takes the other one over a fixed number of poses later, whether it had to wait for it or not, so that a run can be
// repeated.

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
  // A look on the way.
  struct OnTheWay {
    std::size_t events = 0;                       // that it is about
    long over_at = 0;                             // poses; 0: there is none
    bool is_last = false;                         // all that is to be held is there
    bool is_early = false;                        // for thresholds alone: loops are too few to tell more
    bool is_in_doubt = false;                     // its loops, by the map as it was
    std::vector<RecoveredPose<Pose>> trajectory;  // of that map then
  };
  // What it takes.
  struct Beginning {
    CompactOptions<Pose> settings;  // in use, as scale
    ReviewOptions options;
    InformationScale scale;
    std::vector<StreamEvent<Pose>> events;
    OnTheWay look;
  };
  struct Looked {
    InformationCalibration information;
    InformationScale scale;  // to use from now on, as thresholds
    Thresholds<Pose> thresholds;
    std::vector<StreamEvent<Pose>> events;  // with what is left out
    std::optional<RemadeMap<Pose>> remade;  // if that is another one
    std::string failure;                    // why thresholds could not be chosen, if so
  };
  static Looked LookAt(Beginning beginning);
  long Loops() const { return edges_ - std::max(0L, poses_ - 1); }
  bool IsInDoubt() const;
  bool IsEnough() const;
  bool IsDue(bool is_last, bool is_enough) const;
  void Begin();
  std::optional<Found> End(const LogSink& log);

  CompactOptions<Pose> settings_;
  ReviewOptions options_;
  InformationScale scale_;
  bool records_ = false;
  std::vector<StreamEvent<Pose>> events_;
  std::optional<PoseId> newest_, before_;     // poses in order of arrival
  long poses_ = 0, edges_ = 0;                // of the events
  long refused_ = 0;                          // loops, by the map
  long looked_at_ = 0, poses_looked_at_ = 0;  // loops, but for early looks; poses
  OnTheWay look_;
  std::future<Looked> looked_;
};

}  // namespace terse::internal
