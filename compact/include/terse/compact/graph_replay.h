#pragma once
// A stored graph as the source of a compact run: its poses in order of arrival, with their edges as loops that are
// measured already.

#include <cstdint>
#include <map>

#include "terse/compact/compact_pose_slam.h"
#include "terse/core/arrival.h"

namespace terse {

template <class Pose>
class GraphReplay {
 public:
  // Throws std::invalid_argument if the graph is empty or not connected.
  explicit GraphReplay(const PoseGraph<Pose>& graph);
  // What the graph adds to a run that has seen poses before, given in their order of arrival: those poses, their priors
  // and the edges among them are left out, whether the graph holds them again or only names some. Throws
  // std::invalid_argument if no edges join the new poses to those seen.
  GraphReplay(const PoseGraph<Pose>& graph, const std::vector<PoseId>& seen);

  // In order of arrival. Odometry is the edge to the latest earlier pose; the other edges are links.
  const std::vector<CompactInput<Pose>>& Inputs() const { return inputs_; }
  // The edges beside the odometry, in the order in which they come; k from 0 to before LinksOffered().
  const RelativePoseFactor<Pose>& Link(int k) const;
  int LinksOffered() const { return static_cast<int>(links_.size()); }
  // For Strategy::kGiven: these poses, by their place in the order of arrival, and these links, as Link() counts them.
  void Choose(const std::vector<int>& poses, const std::vector<int>& links);

  // The file as a sensor, for inputs without their `loops`: the edge between the two, each edge once: a second call
  // gives the next of several, then none. So one replay serves one such run. Refers to this object.
  Registration<Pose> AsRegistration();

  // A sensor range that covers the links (the odometry, if there are no links): 1.5 times the longest one's length in
  // each direction, the largest angle but at least one radian. Of every hundred links the longest does not count, nor
  // does the one of the largest angle: it may be absurd. Where there are fewer links than one per hundred poses the
  // range is at least five mean steps of the odometry: the links happen to be short; and five standard deviations of a
  // link's position.
  Vector<Displacement<Pose>::kSize> LinkRange(const DistanceOptions& options = {}) const;
  // The same, but it covers these links in place of all.
  Vector<Displacement<Pose>::kSize> LinkRange(const std::vector<RelativePoseFactor<Pose>>& links,
                                              const DistanceOptions& options = {}) const;
  // Mean covariance of the links (of the odometry, if there are none).
  typename Pose::Jacobian LinkCovariance() const;

 private:
  // Arrivals: poses and factors of `graph` in their order. Ranks of poses seen before are below 0.
  void Build(const PoseGraph<Pose>& graph, const std::vector<ArrivalStep>& steps, std::vector<int> rank);
  // `links` is a function of a visitor, which it calls with each link that is to be covered.
  template <class Links>
  Vector<Displacement<Pose>::kSize> RangeOf(const Links& links, bool none, const DistanceOptions& options) const;

  // There may be hundreds of links for a pose: each is stored once.
  struct Place {
    int input, loop;
  };
  std::vector<CompactInput<Pose>> inputs_;
  std::vector<Place> links_;                         // where they stand as an input's loops
  std::vector<RelativePoseFactor<Pose>> all_links_;  // once Choose has taken some from the inputs
  // {smaller id, larger id} -> links, last first; since AsRegistration was called.
  std::map<std::pair<std::int64_t, std::int64_t>, std::vector<int>> waiting_;
};

extern template class GraphReplay<SE2>;
extern template class GraphReplay<SE3>;

}  // namespace terse
