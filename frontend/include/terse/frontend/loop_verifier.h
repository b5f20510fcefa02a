#pragma once
// Do two stereo keyframes show the same place, and what is the motion between them?
//
//  1. mutual nearest descriptors that pass a ratio test;
//  2. three-point RANSAC, then Gauss-Newton (stereo_motion.h) on what agrees;
//  3. guided refinement: every point of the candidate is projected into both current images and its patch aligned there
//     to sub-pixel, at the scale that its depth asks for; the motion is estimated again from these;
//  4. the outcome is taken only with enough inliers, with a fair share of the points that should be seen confirmed,
//     spread over the image, and a covariance below bounds. Whether it agrees with the map is tested there
//     (innovation.h).
//
// The candidates' features (keyframe_features.h) are stored here, those of the current frame are extracted when they
// are first needed. Images are held of the current frame only, so memory grows with the stored keyframes alone.
//
// Deterministic. Not thread-safe.

#include <map>
#include <memory>
#include <optional>
#include <vector>

#include "terse/core/pose_graph.h"
#include "terse/frontend/keyframe_features.h"
#include "terse/frontend/stereo_frame.h"
#include "terse/frontend/stereo_motion.h"

namespace terse {

struct LoopVerifierOptions {
  FeatureOptions features;
  int max_distance = 70;         // bits of 256 in which matching descriptors differ, at most
  double ratio = 0.85;           // of the next best's distance that the best's must be below
  int min_matches = 15;          // fewer: not tried further
  int min_inliers = 40;          // after the refinement
  double min_confirmed = 0.2;    // inliers among the points of the candidate that should be in view
  double min_coverage = 0.15;    // of 8 x 4 image cells, those with inliers
  double max_sigma_rho = 0.15;   // metres, the largest standard deviation of the translation
  double max_sigma_phi = 0.01;   // radians, of the rotation
  int most_aligned = 450;        // points in the refinement
  double min_correlation = 0.8;  // of an aligned patch
  double disparity_offset = 0;   // what has to be added to all u_R, pixels
  double disparity_sigma = 0.2;  // its standard deviation: by so much the calibration may be off
  InitialMotionOptions initial;
  StereoMotionOptions motion;
  // Of loops that are verified; what decides on that is Schur's in any case. Where Monte Carlo gives none the other
  // stands.
  MotionCovariance covariance = MotionCovariance::kSchur;
  MonteCarloOptions monte_carlo;

  LoopVerifierOptions();
};

enum class LoopOutcome { kVerified, kFewMatches, kNoMotion, kFewInliers, kFewConfirmed, kPoorCoverage, kUncertain };
const char* Name(LoopOutcome outcome);

struct LoopVerification {
  LoopOutcome outcome = LoopOutcome::kFewMatches;
  // Of the last stage that was reached; the covariance (right perturbation, metres and radians) after the refinement.
  SE3 T_candidate_current;
  Matrix<6, 6> covariance = Matrix<6, 6>::Zero();
  int matches = 0;            // mutual
  int agreeing = 0;           // with the first motion
  int inliers = 0;            // after the refinement
  double confirmed = 0;       // share of the points that should be in view
  double coverage = 0;        // share of the image cells
  double residual_scale = 0;  // pixels
  bool Verified() const { return outcome == LoopOutcome::kVerified; }
};

class LoopVerifier {
 public:
  // Throws std::invalid_argument if an option makes no sense.
  explicit LoopVerifier(const StereoCamera& camera, const LoopVerifierOptions& options = {});
  ~LoopVerifier();
  LoopVerifier(LoopVerifier&&) noexcept;
  LoopVerifier& operator=(LoopVerifier&&) noexcept;

  // As odometry estimates it (StereoOdometry::DisparityOffset), for all frames, stored ones too. Pixels.
  void SetDisparityOffset(double offset, double sigma);
  // The frame that candidates are compared with from now on. Throws std::invalid_argument if an image has the wrong
  // type or size; nothing is changed then.
  void SetCurrent(const StereoFrame& frame);
  // Stores the features of the current frame. Throws std::invalid_argument if there is no current frame, or the id is
  // stored already.
  void Keep(PoseId id);
  void Forget(PoseId id) { kept_.erase(id); }
  bool Has(PoseId id) const { return kept_.count(id) != 0; }
  std::size_t Kept() const { return kept_.size(); }
  std::size_t Bytes() const;  // of all stored features

  // Throws std::invalid_argument if there is no current frame or the candidate is not stored.
  LoopVerification Verify(PoseId candidate);

  // Of the current frame, extracted now if they have not been.
  const KeyframeFeatures& CurrentFeatures();

 private:
  struct Current;

  StereoCamera camera_;
  LoopVerifierOptions options_;
  std::unique_ptr<Current> current_;
  std::map<PoseId, std::shared_ptr<const KeyframeFeatures>> kept_;
};

}  // namespace terse
