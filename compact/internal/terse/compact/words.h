#pragma once
// The words of the enumerations of compact pose SLAM, as those of core (terse/core/words.h).

#include "terse/compact/compact_pose_slam.h"
#include "terse/compact/sparsify_options.h"
#include "terse/core/words.h"

namespace terse {

// "rfpfl": as few poses and links as fpfl keeps, drawn at random, is what the command gives Strategy::kGiven.
TERSE_WORDS(Strategy, "strategy", {"apal", Strategy::kApal}, {"apfl", Strategy::kApfl}, {"fpfl", Strategy::kFpfl},
            {"rfpfl", Strategy::kGiven}, {"bounded", Strategy::kBounded});
TERSE_WORDS(Record, "record", {"none", Record::kNone}, {"decisions", Record::kDecisions},
            {"candidates", Record::kCandidates});
TERSE_WORDS(AngleMeasure, "angle", {"view", AngleMeasure::kViewDirection}, {"rotation", AngleMeasure::kRotation});
TERSE_WORDS(CompositionOrder, "composition", {"first", CompositionOrder::kFirst},
            {"fourth", CompositionOrder::kFourth});
TERSE_WORDS(SparsifyCriterion, "criterion", {"position", SparsifyCriterion::kPosition},
            {"information", SparsifyCriterion::kInformation}, {"connectivity", SparsifyCriterion::kConnectivity},
            {"random", SparsifyCriterion::kRandom});
TERSE_WORDS(FixedEdges, "fixed", {"odometry", FixedEdges::kOdometry}, {"tree", FixedEdges::kTree},
            {"none", FixedEdges::kNone});
TERSE_WORDS(RecoveredFactors, "recovered", {"tree", RecoveredFactors::kTree}, {"subgraph", RecoveredFactors::kSubgraph},
            {"dense", RecoveredFactors::kDense});
TERSE_WORDS(Recovery, "recovery", {"v0", Recovery::kV0}, {"v1", Recovery::kV1}, {"v2", Recovery::kV2});

}  // namespace terse
