#pragma once
// The course of a step but for its links: a pose arrives, is judged, comes into the map or not, and is remembered.

#include <vector>

#include "compact_parts.h"

namespace terse::internal {

// Throws std::invalid_argument or NumericalError for what cannot be taken.
template <class Pose>
CurrentPose<Pose> Arrive(const CompactInput<Pose>& input, const CompactParts<Pose>& parts);

// Puts the pose into the map if it is not there yet, with its odometry and priors, and adds the links; a dropped pose
// comes back before. The ids of the links. Throws NumericalError, and changes nothing, if the map has no solution.
template <class Pose>
std::vector<FactorId> Keep(const std::vector<Factor<Pose>>& links, CurrentPose<Pose>& current,
                           CompactParts<Pose>& parts, const Revival<Pose>* revival = nullptr);
// All updates of a step as one report; what is left to do is that of the last one.
void Accumulate(const StepReport& update, std::optional<StepReport>& sum);

// Whether it is worth keeping, and why.
template <class Pose>
PoseVerdict Judge(const CurrentPose<Pose>& current, const Decision& decision, const CompactParts<Pose>& parts);
template <class Pose>
void Remember(const CurrentPose<Pose>& current, PoseHistory<Pose>& history);
// Of a pose that has arrived, for CompactBudget::error.
template <class Pose>
SeenLoops<Pose> LoopsOf(const CurrentPose<Pose>& current, const CompactParts<Pose>& parts);
// The thresholds follow the budget; `seen`: for the budget of the error, else nullptr.
template <class Pose>
void FollowBudget(const CurrentPose<Pose>& current, const Decision& decision, SeenLoops<Pose>* seen,
                  CompactParts<Pose>& parts);
template <class Pose>
void LogVerdict(const Decision& decision, const CompactParts<Pose>& parts);

}  // namespace terse::internal
