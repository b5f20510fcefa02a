#pragma once
// Wrong minima, and the way out of them.
//
// Were the residuals linear, each update would raise the least chi2 by its innovation, r' (Omega^-1 + J Sigma J')^-1 r,
// and nothing else would change it. So chi2 would be the sum of the innovations, whatever the scale of the information.
// What relinearisation does to the linearised minimum measures how far the residuals are from that. A map that went
// into a wrong minimum has been through large corrections, and its cost lies far above the innovations or was corrected
// by many times itself. Then, at first seldom, a chordal relaxation of the graph as it is shows whether there is
// anything lower.

#include "incremental/linearized_graph.h"

namespace terse::internal {

template <class Pose>
class MinimumWatch {
 public:
  using Map = LinearizedGraph<Pose>;

  // The linearised minimum without an update's factors, with them, and now that the step is done.
  void NoteStep(double before, double after, const Map& map, const IncrementalOptions& options);
  void NoteCorrection(double change) { corrected_ += change; }
  // Whether a restart should be tried at this cost of the estimate, of its minimum when it has settled.
  bool SeemsTrapped(const Map& map) const;
  void NoteTried(const Map& map);
  // For Finish, which has time.
  bool IsSuspected(const Map& map) const;
  // The minimum next to the chordal relaxation of `graph`, which is the map's or has the factors of it that are
  // believed, if it is clearly below `cost`. Unless `suspected` the relaxation itself must be.
  std::optional<BatchResult<Pose>> LowerMinimum(double cost, bool suspected, const PoseGraph<Pose>& graph,
                                                const Map& map, BatchOptions options) const;
  void NoteRestart(const Map& map);
  long Restarts() const { return restarts_; }
  void CountRestarts(long more) { restarts_ += more; }
  double Explained() const { return explained_; }

  template <class Archive>
  void Serialize(Archive& archive);

 private:
  double explained_ = 0;   // sum of the innovations at arrival: what chi2 comes to if the residuals were linear
  double corrected_ = 0;   // sum of the changes that relinearisation made to the linearised minimum, without sign
  double cost_tried_ = 0;  // when a restart was last tried
  long poses_tried_ = 0;
  long restarts_ = 0;
};

// The estimate's chi2 above the linearised minimum by more than this factor: it has not settled.
inline constexpr double kSettled = 1.5;

}  // namespace terse::internal
