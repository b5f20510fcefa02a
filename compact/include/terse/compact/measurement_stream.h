#pragma once
// Compact pose SLAM fed with single measurements in the order in which a robot makes them.
//
// An edge that names one new pose opens this pose: the edge is its odometry. Until it is closed it gathers its loops,
// the edges to earlier poses, and its priors. The next edge that opens a pose closes it, or Flush(): it is then added
// with its loops (CompactInput::loops).
//
// An edge between two closed poses is a late link (AddLink), a prior on a closed pose a late prior (AddPrior). A late
// link between poses that hang on one kept pose says nothing about the map: it is not accepted.
//
// The first pose is that of the first prior, or the `from` of the first edge.
//
// Throws std::invalid_argument for what contradicts the measurements before it, NumericalError where the solver fails,
// and is then as before: a pose at hand that cannot be closed stays at hand until Discard() gives it up. Not
// thread-safe.

#include <map>
#include <optional>
#include <set>
#include <string>
#include <variant>
#include <vector>

#include "terse/compact/compact_pose_slam.h"

namespace terse {

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

template <class Pose>
class MeasurementStream {
 public:
  // `slam` outlives the stream, and only the stream adds poses to it. Throws std::invalid_argument for
  // Strategy::kGiven, which must know the poses beforehand.
  explicit MeasurementStream(CompactPoseSlam<Pose>& slam);

  std::vector<StreamOutcome> Add(const Factor<Pose>& factor);
  // Closes the pose at hand, if there is one.
  std::vector<StreamOutcome> Flush();
  // Gives up the pose at hand, if there is one, with all that was measured at it.
  void Discard() { open_.reset(); }

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
  LateLink LinkLate(const RelativePoseFactor<Pose>& edge);
  std::vector<StreamOutcome> AddPrior(const Factor<Pose>& prior);
  CompactInput<Pose> Prepare(PoseId id, const std::optional<RelativePoseFactor<Pose>>& odometry) const;
  void OpenNext(CompactInput<Pose> pose);
  void Forget(PoseId id);
  std::vector<StreamOutcome> Close();
  bool IsOpen(PoseId id) const { return open_ && open_->id == id; }
  bool IsKnown(PoseId id) const { return IsOpen(id) || slam_->HasSeen(id) || slam_->HasForgotten(id); }
  bool IsEmpty() const { return !open_ && slam_->PosesSeen() == 0; }

  CompactPoseSlam<Pose>* slam_;
  // All that a snapshot of the stream would have to hold besides `slam`.
  std::optional<CompactInput<Pose>> open_;
  std::map<PoseId, Pose> values_;  // of poses to come
  std::set<PoseId> fixed_;         // likewise
};

extern template class MeasurementStream<SE2>;
extern template class MeasurementStream<SE3>;

}  // namespace terse
