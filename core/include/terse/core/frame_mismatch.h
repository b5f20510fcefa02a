#pragma once
// Whether two trajectories look like data of different frames: an error of a conversion, not of an estimate.
//
// Positions: rigid fits against fits with a scale, or to the mirror image, by the singular values of the positions'
// correlation (Umeyama, 1991). Orientations: the mean rotation between the bodies, over all poses. What is found
// explains most of the error, and is far from what drift does; with fewer than 10 poses, or where the positions lie on
// a line, nothing is said.

#include <optional>
#include <string>
#include <vector>

#include "terse/core/evaluate.h"

namespace terse {

struct FrameMismatch {
  std::optional<double> scale;     // lengths of the reference over those of the estimate
  bool mirrored = false;           // left-handed against right-handed axes
  std::optional<SO3> R_world;      // reference <- estimate, where the alignment asked for does not allow it
  std::optional<SO3> R_body;       // estimate's body <- reference's body, the same at all poses
  double ate_m = 0, fitted_m = 0;  // root mean square of the positions, as aligned and with the above
};

// Index by index, as Evaluate takes them.
std::optional<FrameMismatch> FindFrameMismatch(const std::vector<SE3>& T_world_estimate,
                                               const std::vector<SE3>& T_world_reference, Alignment alignment);

// One line for people.
std::string Describe(const FrameMismatch& mismatch);

}  // namespace terse
