#pragma once
// The links of the map beside its odometry, and, in a bounded map, what the edges between kept poses are made of. Plain
// bookkeeping: the factors themselves are the solver's.

#include <optional>
#include <string>
#include <vector>

#include "fused_edges.h"
#include "pose_history.h"
#include "terse/compact/compact_options.h"

namespace terse::internal {

template <class Pose>
class KeptLinks {
 public:
  using Ends = typename FusedEdges<Pose>::Ends;
  using Edge = typename FusedEdges<Pose>::Edge;
  struct Link {
    FactorId factor;
    PoseId added_at;             // the last pose seen then
    std::optional<double> gain;  // nats, measured
  };

  void TakeOptions(const CompactOptions<Pose>& options);

  int Size() const { return static_cast<int>(links_.size()); }
  const Link* Find(FactorId factor) const;  // nullptr if it is no link
  const FusedEdges<Pose>& Edges() const { return fused_; }

  // The newest factor is a link; is odometry between these.
  void AddLink(const Factor<Pose>& measured, const Link& link);
  void AddOdometry(PoseId from, PoseId to, FactorId factor);
  void SetGain(FactorId link, double gain);
  FactorId NewPartId() { return fused_.NewPartId(); }
  FactorId NextPartId() const { return fused_.NextPartId(); }
  // An edge whose parts have changed, with its factor as it was before and as it is from now on; `added_at` if it was
  // no link before.
  void SetEdge(const Ends& ends, Edge edge, FactorId factor, PoseId added_at);
  void ForgetEdge(const Ends& ends, FactorId factor) { fused_.Forget(ends, factor); }
  void Remove(FactorId link, const Ends& ends);

  // An edge in a map, in all but its factor, measurement, and, of odometry, when it came. And from there, in the order
  // of the new factors.
  void Export(typename CompactMap<Pose>::Edge& edge) const;
  void Restore(const typename CompactMap<Pose>::Edge& edge, FactorId factor);
  // Nothing is kept any more. Ids of parts go on.
  void Clear();

  // The links alone; the edges come apart.
  template <class Archive>
  void Serialize(Archive& archive);
  template <class Archive>
  void SerializeEdges(Archive& archive) {
    archive(fused_);
  }
  // Of what was read: what contradicts the kept graph or what was seen, else "".
  std::string FindStateDefect(const PoseGraph<Pose>& kept, const PoseHistory<Pose>& history) const;

 private:
  bool fuses_ = false;           // Strategy::kBounded: others may fuse with an edge
  bool fuses_odometry_ = false;  // not with what a kernel weighs, which odometry is not
  std::vector<Link> links_;      // ascending factors
  // What joins kept poses, so that others can fuse with it; unless fuses_ only edges that came in several parts.
  FusedEdges<Pose> fused_;
};

}  // namespace terse::internal
