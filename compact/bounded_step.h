#pragma once
// A map bounded by area (Strategy::kBounded): what a link says where the map is already.
//
// Two things. Where the robot is: the chain starts anew at the linked kept pose, with the link's covariance, and the
// pose is not kept. And what the map is like: from the pose's base along its chain and back along the link is a
// measurement between two kept poses, of which the map learns
//   1/2 ln |I + Sigma_d (Sigma_chain + Sigma_link)^-1|,
// Sigma_d what it knows of their displacement. It fuses with the edge that joins the two already, or becomes an edge if
// it tells enough. Every measurement is used once: the link that starts the next chain is none of those composed, and a
// stretch of a chain carries one loop of another pose at most, none if it is odometry between kept poses. This is the
// reduced pose graph of Johannsson et al. (ICRA 2013) with information as the judge. Where a link tells the map so much
// that a pose is worth it, as on the first return to old terrain, the pose is kept and linked as by Strategy::kFpfl.

#include <vector>

#include "composed_edges.h"

namespace terse::internal {

// The links of one pose under way. A null registration registers nothing, and nor does one where loops came with the
// pose.
template <class Pose>
class BoundedStep {
 public:
  using Jacobian = typename Pose::Jacobian;

  // All outlive it.
  BoundedStep(CurrentPose<Pose>& current, Decision& decision, const Registration<Pose>& registration,
              CompactParts<Pose>& parts)
      : current_(current), decision_(decision), registration_(registration), parts_(parts) {}

  // Links the pose, or starts its chain anew, or leaves it as it came.
  void Run();

 private:
  using Failed = typename LinkTests<Pose>::Failed;
  // A loop of the pose that agrees with the map.
  struct Sighting {
    int offer = -1;           // in CurrentPose::offers
    double log_det = 0;       // of what it leaves open of where the robot is
    double map_gain = 0;      // what it tells of the map, with the chain, nats
    bool is_doubted = false;  // the map contradicts it, but others say the same
  };

  bool Registers() const { return registration_ != nullptr && !current_.input->loops; }
  const Offer<Pose>& OfferOf(const Sighting& s) const { return current_.offers[static_cast<std::size_t>(s.offer)]; }
  bool IsOnOdometry(const Offer<Pose>& offer) const;
  double MapGain(const UncertainPose<Pose>& known, const Jacobian& Sigma_link) const;
  bool TellsEnough(PoseId kept, double map_gain) const;
  void ThinOffers();
  void Search();
  void Sight(int offer);
  void RegisterSightings();
  Evaluated<Pose>* NextToRegister(const std::vector<Failed>& failed);
  bool TellsMap() const;
  void PutSecondToUse(std::vector<Sighting>& sightings) const;
  void Anchor();
  void Use(int offer, bool Candidate::*as);
  std::vector<NewEdge<Pose>> ComposeEdges(std::vector<Sighting> sightings) const;
  std::optional<NewEdge<Pose>> ComposeWithChain(std::vector<Sighting>& sightings) const;
  std::optional<NewEdge<Pose>> ComposePair(std::vector<Sighting>& sightings) const;

  CurrentPose<Pose>& current_;
  Decision& decision_;
  const Registration<Pose>& registration_;
  CompactParts<Pose>& parts_;
  std::vector<Evaluated<Pose>> candidates_;  // of every sighting its own is among them
  std::vector<Sighting> sightings_;
};

}  // namespace terse::internal
