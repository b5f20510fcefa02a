#pragma once
// What the edges between kept poses are made of, where several measurements became one factor. Plain bookkeeping: the
// factors themselves are the solver's.

#include <algorithm>
#include <cstdint>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "terse/compact/compact_map.h"

namespace terse {

template <class Pose>
class FusedEdges {
 public:
  using Part = typename CompactMap<Pose>::Part;
  using Ends = std::pair<PoseId, PoseId>;  // the smaller id first; parts measure T_first_second
  struct Edge {
    FactorId factor;  // as it is now: it comes anew with every part
    bool is_odometry = false;
    std::vector<Part> parts;  // oldest first; none: it is one measurement, the factor itself
  };

  static Ends Ordered(PoseId a, PoseId b) { return b < a ? Ends(b, a) : Ends(a, b); }
  // nullptr if nothing that others may fuse with joins the two.
  const Edge* Find(const Ends& ends) const;
  // Nothing if something joins the two already.
  void Remember(const Ends& ends, FactorId factor, bool is_odometry) {
    edges_.emplace(ends, Edge{factor, is_odometry, {}});
  }
  void Set(const Ends& ends, Edge edge) { edges_[ends] = std::move(edge); }
  void Forget(const Ends& ends, FactorId factor);
  const std::map<Ends, Edge>& All() const { return edges_; }
  // The edge that has this measurement for a part; end() if none has.
  typename std::map<Ends, Edge>::const_iterator FindPart(FactorId part) const;

  // For measurements that never were a factor of their own: below -1, which no factor's is.
  FactorId NewPartId() { return {next_part_--}; }
  FactorId NextPartId() const { return {next_part_}; }
  // Behind a part of another run, so that its id stays its own.
  void Reserve(FactorId part) { next_part_ = std::min(next_part_, part.value - 1); }

  // Adds the part. Beyond so many the two oldest that can be taken out no more become one.
  static void Append(Part part, std::vector<Part>& parts);
  // The one measurement that they make: the sum of their information, where it costs least. The values are close
  // together, as each was tested.
  static UncertainPose<Pose> Sum(const std::vector<Part>& parts);

  template <class Archive>
  void Serialize(Archive& archive);

 private:
  std::map<Ends, Edge> edges_;
  std::int64_t next_part_ = -2;
};

}  // namespace terse
