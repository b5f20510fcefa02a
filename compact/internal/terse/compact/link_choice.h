#pragma once
// Which links to keep: greedily by what they are worth in the presence of those chosen before, the first ones exactly,
// later ones by samples in rounds (link_worth.h), then by exchanges.

#include "terse/compact/link_system.h"
#include "terse/compact/link_worth.h"

namespace terse::internal {

// After so many links the sum of squared position errors, or the log-determinant of the information.
struct ChoiceStep {
  int links;
  double total;
};

struct LinkChoice {
  std::vector<char> kept;     // by link
  std::vector<double> worth;  // by link: at its choice; of one that is not kept as last looked at
  // Ascending; first nothing but what is fixed, last the choice. Empty without a criterion that is a sum over links.
  std::vector<ChoiceStep> course;
  int exchanges = 0;  // that changed it for the better
};

struct ChoiceOptions {
  int links = 0;                     // beyond those of LinkSystem::in_tree that hold poses
  std::optional<double> most_total;  // instead: until the total is at most this (position)
  SparsifyCriterion criterion = SparsifyCriterion::kPosition;
  std::uint64_t seed = 1;
  bool parallel = false;
  std::function<bool(double share)> progress;  // false: give up
};

// The choice gave up.
struct ChoiceStopped {};

template <class Pose>
LinkChoice ChooseLinks(const LinkSystem<Pose>& system, const ChoiceOptions& options);

// What the information of these links says, exactly.
struct ChoiceTotals {
  double position;  // the expected sum of squared errors, square metres
  double log_determinant;
};
template <class Pose>
ChoiceTotals TotalsOf(const LinkSystem<Pose>& system, const std::vector<char>& kept);

}  // namespace terse::internal
