#pragma once
// The links of a pose: loops that came with it, or registrations of what the search found (Algorithm 1, lines 6-17).

#include <optional>
#include <vector>

#include "compact_parts.h"

namespace terse::internal {

// The links of one pose under way. A null registration registers nothing, and nor does one where loops came with the
// pose.
template <class Pose>
class LoopClosing {
 public:
  // All outlive it.
  LoopClosing(CurrentPose<Pose>& current, Decision& decision, const Registration<Pose>& registration,
              CompactParts<Pose>& parts)
      : current_(current), decision_(decision), registration_(registration), parts_(parts) {}

  // Strategy::kApfl and kFpfl: which poses may be linked, and what the least informative of the links that are surely
  // possible would tell: from that it is judged whether the pose says anything new. Then CloseLoops.
  void Search();
  // Best first, the rest evaluated again after every accepted link.
  void CloseLoops(std::vector<Evaluated<Pose>> candidates);
  // kApal and kGiven: all links, in one update.
  void LinkAll();

 private:
  using Link = RelativePoseFactor<Pose>;
  bool Registers() const { return registration_ != nullptr && !current_.input->loops; }
  // A loop that was registered for the pose already (bounded_step.h) has been counted.
  bool IsRegistered(const Ask& ask) const { return ask.offer >= 0 && !current_.input->loops; }
  Evaluated<Pose>* Next();
  bool Try(Evaluated<Pose>& candidate);
  void EvaluateAgain();
  bool Accept(Evaluated<Pose>& candidate, const Link& link);
  bool AcceptOnChain(const Offer<Pose>& offer, Candidate& record);
  bool IsCostlyToCarry(const Offer<Pose>& offer, const UncertainPose<Pose>& known) const;
  void NoteAccepted(Candidate& record, std::optional<PoseId> revived);
  Candidate& Take(PoseId id, const std::optional<Link>& link, std::vector<Factor<Pose>>& links);

  CurrentPose<Pose>& current_;
  Decision& decision_;
  const Registration<Pose>& registration_;
  CompactParts<Pose>& parts_;
  // Of CloseLoops: the candidates as evaluated last, and the records of those that are not evaluated again.
  std::vector<Evaluated<Pose>> open_;
  std::vector<Candidate> settled_;
  std::vector<typename LinkTests<Pose>::Failed> failed_;  // registrations near the pose
  std::optional<PoseId>
      linked_;  // the pose came with odometry from this one, which measures their displacement already
};

// Whether a link agrees with the map (LinkTests::IsBelieved), and its measured gain is enough for it to be added.
template <class Pose>
bool PassesTests(const CurrentPose<Pose>* current, const UncertainPose<Pose>& known,
                 const UncertainPose<Pose>& measured, Candidate& record, CompactParts<Pose>& parts);

// Whether a measurement between kept poses takes its share of the position error (CompactOptions::min_variance_drop);
// and a loop of the pose at hand, together with the chain that the pose hangs on.
template <class Pose>
bool LowersVariance(PoseId a, PoseId b, const UncertainPose<Pose>& T_a_b, CompactParts<Pose>& parts);
template <class Pose>
bool LowersVariance(const CurrentPose<Pose>& current, PoseId kept, const UncertainPose<Pose>& T_kept_current,
                    CompactParts<Pose>& parts);
// Asks for a link. Throws std::invalid_argument for one between other poses or a defective one.
template <class Pose>
std::optional<RelativePoseFactor<Pose>> Register(const Registration<Pose>& registration, PoseId candidate,
                                                 PoseId current);
// Says what became of a link: `passed` if it is good.
template <class Pose>
void LogLink(PoseId a, PoseId b, const Candidate& record, bool good, const CompactParts<Pose>& parts,
             const char* passed = "added");
// A candidate that is surely possible: the pose tells no more than a link to it would. Where the sensor is asked it
// might have been linked.
template <class Pose>
void NotePoseGain(const Candidate& candidate, bool registers, const CompactOptions<Pose>& options,
                  CurrentPose<Pose>& current, Decision& decision);
// The record of a decision stays small however many poses were in range: what was tried, and the best of the others.
template <class Pose>
void RecordCandidates(std::vector<Candidate> settled, const CompactOptions<Pose>& options, Decision& decision);

}  // namespace terse::internal
