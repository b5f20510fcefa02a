#pragma once
// What CompactPoseSlam is made of. Each part writes its own members alone; the steps (pose_step.h, loop_closing.h,
// bounded_step.h, composed_edges.h, revival.h) say which of them change when.

#include "candidate_search.h"
#include "gain_control.h"
#include "kept_links.h"
#include "kept_map.h"
#include "link_tests.h"
#include "pose_history.h"
#include "terse/compact/aligned_variance.h"

namespace terse::internal {

template <class Pose>
struct CompactParts {
  // Throws std::invalid_argument if an option is out of its domain.
  explicit CompactParts(const CompactOptions<Pose>& with);
  CompactParts(const CompactParts&) = delete;
  CompactParts& operator=(const CompactParts&) = delete;

  // Throws as the constructor does. The solver keeps the options that it was made with.
  void TakeOptions(const CompactOptions<Pose>& with);
  template <class Archive>
  void Serialize(Archive& archive);

  CompactOptions<Pose> options;
  KeptMap<Pose> map;
  GainControl<Pose> gains;  // the thresholds in force
  PoseHistory<Pose> history;
  KeptLinks<Pose> links;
  CandidateSearch<Pose> search{options, map};
  int poses_after_retiring = 0;  // that were kept when poses last retired (retiring.h)
  LinkTests<Pose> tests{options, map, history};
  AlignedVariance<Pose> variance{map.Solver(), map.Marginals()};
};

}  // namespace terse::internal
