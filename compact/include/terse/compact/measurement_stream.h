#pragma once
// Compact pose SLAM fed with single measurements in the order in which a robot makes them.
//
// An edge that names one new pose opens this pose. Until it is closed it gathers further edges to earlier poses, and
// its priors. The edge to the latest of these poses is its odometry, the others are its loops. The next edge that opens
// a pose closes it, or Flush(): it is then added with its loops (CompactInput::loops).
//
// An edge between two closed poses is a late link (AddLink), a prior on a closed pose a late prior (AddPrior). A late
// link between poses that hang on one kept pose says nothing about the map: it is not accepted.
//
// The first pose is that of the first prior, or the `from` of the first edge.
//
// A map that grows hears of everything once, and cannot know at the beginning what its information is worth, nor which
// of its first loops are wrong. With StartReviews(), from eight loops on and each time that there are twice as many, a
// thread of its own looks at all that was measured so far, as CompactGraph does with a file: scales information that
// nobody estimated or that residuals contradict (information_scale.h), judges all loops together where the map refuses
// many (contradicted_loops.h), chooses the thresholds that it is asked to choose (thresholds.h; before there are eight
// loops each time that there are twice as many poses), and if something else comes out, or loops came late, makes the
// map again, with loops where they belong in time. TakeReview() takes it over.
//
// Throws std::invalid_argument for what contradicts the measurements before it, NumericalError where the solver fails,
// and is then as before: a pose at hand that cannot be closed stays at hand until Discard() gives it up. Not
// thread-safe.

#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <variant>
#include <vector>

#include "terse/compact/compact_pose_slam.h"
#include "terse/covariance/information_scale.h"

namespace terse {

namespace internal {
template <class Pose>
class StreamReview;
}

struct LateLink {
  PoseId from, to;  // as measured
  LinkDecision decision;
  bool forgotten = false;  // an end is (CompactOptions::most_dropped): it was not taken
};
struct LatePrior {
  PoseId pose;
  PoseId kept;  // the pose it was carried to
  FactorId factor;
};
using StreamOutcome = std::variant<Decision, LateLink, LatePrior>;

struct ReviewOptions {
  bool information = true;  // else it stays as it is stated
  // By SelectThresholds, from 32 poses on. Before, those of the map's options are in use.
  ThresholdChoice chosen;
  // Until there are five times the poses or ten times the loops of the samples asked for all measurements are held and
  // reviewed, and none later.
  EstimateOptions estimate;
};

// `slam` is another map of the same measurements, its options have the thresholds that were chosen.
struct Review {
  InformationCalibration information;
  InformationScale scale;           // in use
  int loops_left_out = 0;           // of those measured, which the map did not see
  std::vector<Decision> decisions;  // of all poses that were closed so far, which take the place of those before
};

template <class Pose>
class MeasurementStream {
 public:
  // `slam` outlives the stream, and only the stream adds poses to it. Throws std::invalid_argument for
  // Strategy::kGiven, which must know the poses beforehand.
  explicit MeasurementStream(CompactPoseSlam<Pose>& slam);
  // Relative measurements are scaled, as another run found that they have to be.
  MeasurementStream(CompactPoseSlam<Pose>& slam, const InformationScale& scale);
  ~MeasurementStream();
  MeasurementStream(MeasurementStream&&) noexcept;
  MeasurementStream& operator=(MeasurementStream&&) noexcept;

  // Before the first measurement; throws std::logic_error after it.
  void StartReviews(const ReviewOptions& options = {});
  // Between measurements, as often as one likes: the map that was made again, when its time has come, a number of poses
  // after the review began that depends on nothing else; what the thread has not done by then is waited for. Factors of
  // `slam` are numbered anew. `at_end`: all measurements are looked at, and waited for.
  std::optional<Review> TakeReview(bool at_end = false);
  // None any more; scales stay. To be called before others change `slam` (a link removed, poses retired), for a map
  // that is made again has what the stream was given and nothing else.
  void EndReviews();
  // In use, ones to begin with.
  const InformationScale& Scale() const;

  // `is_scaled`: its information is right as it is.
  std::vector<StreamOutcome> Add(const Factor<Pose>& factor, bool is_scaled = false);
  // Closes the pose at hand, if there is one.
  std::vector<StreamOutcome> Flush();
  // Gives up the pose at hand, if there is one, with all that was measured at it.
  void Discard();

  // Where the first pose and fixed ones are; of no effect for others. Before the pose is closed.
  void SetValue(PoseId id, const Pose& T_world_body);
  // Anchors poses at their values (the first one without a value at the identity). Before they are closed; the value of
  // one that is not the first must be known when it is opened.
  void Fix(const std::vector<PoseId>& ids);

  // The stream and its `slam` as one file, as CompactPoseSlam::Save; and back, into `slam`, which is replaced but for
  // its log, and outlives what is returned. Throw FileError; `slam` is then as before.
  void Save(const std::string& path) const;
  static MeasurementStream Load(const std::string& path, CompactPoseSlam<Pose>& slam);

  // The pose at hand.
  std::optional<PoseId> Open() const { return open_ ? std::optional<PoseId>(open_->id) : std::nullopt; }

 private:
  friend struct internal::StateAccess;
  template <class Archive>
  void Serialize(Archive& archive);
  std::vector<StreamOutcome> AddEdge(const RelativePoseFactor<Pose>& edge);
  void AddToOpen(const RelativePoseFactor<Pose>& edge);
  LateLink LinkLate(const RelativePoseFactor<Pose>& edge);
  std::vector<StreamOutcome> AddPrior(const Factor<Pose>& prior);
  CompactInput<Pose> Prepare(PoseId id, const std::optional<RelativePoseFactor<Pose>>& odometry) const;
  void OpenNext(CompactInput<Pose> pose);
  void Forget(PoseId id);
  std::vector<StreamOutcome> Close();
  bool IsOpen(PoseId id) const { return open_ && open_->id == id; }
  bool IsKnown(PoseId id) const { return IsOpen(id) || slam_->HasSeen(id) || slam_->HasForgotten(id); }
  bool Opens(const Factor<Pose>& factor) const;
  bool IsEmpty() const { return !open_ && slam_->PosesSeen() == 0; }

  CompactPoseSlam<Pose>* slam_;
  // All that a snapshot of the stream would have to hold besides `slam`.
  std::optional<CompactInput<Pose>> open_;
  std::map<PoseId, Pose> values_;  // of poses to come
  std::set<PoseId> fixed_;         // likewise
  std::unique_ptr<internal::StreamReview<Pose>> review_;
};

extern template class MeasurementStream<SE2>;
extern template class MeasurementStream<SE3>;

}  // namespace terse
