#include "terse/frontend/loop_verifier.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "descriptor_matching.h"
#include "patch_alignment.h"

namespace terse {
namespace {

using std::size_t;

constexpr int kCellColumns = 8, kCellRows = 4;
constexpr double kAlignReach = 6;                            // pixels of the level
constexpr double kLeastMagnified = 0.4, kMostMagnified = 3;  // between the two views: beyond, a patch looks different

// A view of the current frame's pyramids: the level to look for a patch in, and how far apart its pixels lie there.
struct View {
  size_t level;
  double spacing;
};

View ChooseLevel(const ImagePyramid& pyramid, double pixel) {
  View view{0, pixel};
  for (size_t k = 1; k < pyramid.levels.size(); ++k) {
    const double spacing = pixel / pyramid.scale_x[k];
    if (std::abs(std::log(spacing)) < std::abs(std::log(view.spacing))) view = {k, spacing};
  }
  return view;
}

// A spread sample, as the features come by level and strength: every so many.
std::vector<size_t> Sample(size_t count, int most) {
  const size_t wanted = std::min(count, static_cast<size_t>(most));
  std::vector<size_t> out;
  for (size_t k = 0; k < wanted; ++k) out.push_back(k * count / wanted);
  return out;
}

struct Refined {
  std::vector<StereoMatch> matches;
  int in_view = 0;  // points that should be seen
};

// Stage 3: the points of `candidate` found in the current images, given about where the camera is.
Refined AlignPoints(const StereoCamera& camera, const KeyframeFeatures& candidate, const ImagePyramid& left,
                    const ImagePyramid& right, const SE3& T_candidate_current, const LoopVerifierOptions& options) {
  const Vector<3> offset = {0, 0, options.disparity_offset};
  Refined out;
  const SE3 T_current_candidate = T_candidate_current.Inverse();
  for (const size_t k : Sample(candidate.Size(), options.most_aligned)) {
    const Vector<3> measured = candidate.Measured(k) + offset;
    const Vector<3> p = camera.Triangulate(measured), q = T_current_candidate * p;
    if (q.z() <= 0) continue;
    const Vector<3> expected = camera.Project(q);
    const double magnified = p.z() / q.z();
    if (magnified < kLeastMagnified || magnified > kMostMagnified) continue;
    const double margin = kPatchSize * magnified;
    const auto inside = [&](double u) { return u >= margin && u < camera.width - margin; };
    if (!inside(expected[0]) || !inside(expected[2]) || expected[1] < margin || expected[1] >= camera.height - margin) {
      continue;
    }
    ++out.in_view;
    const size_t level = candidate.points[k].level;
    const View view = ChooseLevel(left, left.scale_x[level] * magnified);
    const double sx = left.scale_x[view.level], sy = left.scale_y[view.level];
    const AlignmentTemplate patch(candidate.patches[k]);
    const auto in_left = patch.Find(left.levels[view.level], (expected[0] + 0.5) / sx - 0.5,
                                    (expected[1] + 0.5) / sy - 0.5, view.spacing, false, kAlignReach);
    if (!in_left || in_left->correlation < options.min_correlation) continue;
    const double u = (in_left->x + 0.5) * sx - 0.5, v = (in_left->y + 0.5) * sy - 0.5;
    const double start = (u - (expected[0] - expected[2]) - options.disparity_offset + 0.5) / sx - 0.5;
    const auto in_right = patch.Find(right.levels[view.level], start, in_left->y, view.spacing, true, kAlignReach);
    if (!in_right || in_right->correlation < options.min_correlation) continue;
    out.matches.push_back({measured, Vector<3>(u, v, (in_right->x + 0.5) * sx - 0.5) + offset});
  }
  return out;
}

// Of the inliers in b, the share of the image cells that have some.
double Coverage(const StereoCamera& camera, const std::vector<StereoMatch>& matches, const std::vector<char>& inlier) {
  std::vector<char> seen(kCellColumns * kCellRows, 0);
  for (size_t k = 0; k < matches.size(); ++k) {
    if (inlier[k] == 0) continue;
    const int column = std::clamp(static_cast<int>(matches[k].b[0] * kCellColumns / camera.width), 0, kCellColumns - 1);
    const int row = std::clamp(static_cast<int>(matches[k].b[1] * kCellRows / camera.height), 0, kCellRows - 1);
    seen[static_cast<size_t>(row * kCellColumns + column)] = 1;
  }
  return static_cast<double>(std::count(seen.begin(), seen.end(), 1)) / static_cast<double>(seen.size());
}

// Bounds the largest eigenvalue of a 3x3 covariance from above by its largest absolute row sum.
double LargestSigma(const Matrix<3, 3>& covariance) {
  return std::sqrt(covariance.cwiseAbs().rowwise().sum().maxCoeff());
}

}  // namespace

const char* Name(LoopOutcome outcome) {
  switch (outcome) {
    case LoopOutcome::kVerified: return "verified";
    case LoopOutcome::kFewMatches: return "few_matches";
    case LoopOutcome::kNoMotion: return "no_motion";
    case LoopOutcome::kFewInliers: return "few_inliers";
    case LoopOutcome::kFewConfirmed: return "few_confirmed";
    case LoopOutcome::kPoorCoverage: return "poor_coverage";
    case LoopOutcome::kUncertain: return "uncertain";
  }
  return "unknown";
}

struct LoopVerifier::Current {
  StereoFrame frame;
  std::optional<ImagePyramid> left, right;
  std::shared_ptr<const KeyframeFeatures> features;
};

LoopVerifier::LoopVerifier(const StereoCamera& camera, const LoopVerifierOptions& options)
    : camera_(camera), options_(options) {
  const FeatureOptions& f = options.features;
  if (f.levels < 1 || f.levels > 8 || !(f.level_scale > 1) || f.most < 0 || options.most_aligned < 0 ||
      !(options.disparity_sigma >= 0) || !(options.monte_carlo.sigma > 0) || options.monte_carlo.samples < 8) {
    throw std::invalid_argument("loop verifier options: a number is out of its domain");
  }
}

LoopVerifierOptions::LoopVerifierOptions() {
  // Patches are aligned as if they faced the camera: their errors are larger than the residuals say, and alike nearby.
  // Found on rendered sequences with exact ground truth.
  motion.covariance_factor = 8;
}
LoopVerifier::~LoopVerifier() = default;
LoopVerifier::LoopVerifier(LoopVerifier&&) noexcept = default;
LoopVerifier& LoopVerifier::operator=(LoopVerifier&&) noexcept = default;

void LoopVerifier::SetDisparityOffset(double offset, double sigma) {
  options_.disparity_offset = offset;
  options_.disparity_sigma = sigma;
}

void LoopVerifier::SetCurrent(const StereoFrame& frame) {
  const cv::Size size(camera_.width, camera_.height);
  if (frame.left.type() != CV_8UC1 || frame.right.type() != CV_8UC1 || frame.left.size() != size ||
      frame.right.size() != size) {
    throw std::invalid_argument("frame " + std::to_string(frame.index) +
                                ": the images are not 8-bit grey or not as large as the camera says");
  }
  auto current = std::make_unique<Current>();
  current->frame = frame;
  current_ = std::move(current);
}

const KeyframeFeatures& LoopVerifier::CurrentFeatures() {
  if (!current_) throw std::invalid_argument("there is no current frame");
  if (!current_->features) {
    const FeatureOptions& options = options_.features;
    current_->left.emplace(current_->frame.left, options.levels, options.level_scale);
    current_->right.emplace(current_->frame.right, options.levels, options.level_scale);
    current_->features =
        std::make_shared<const KeyframeFeatures>(ExtractFeatures(*current_->left, *current_->right, options));
  }
  return *current_->features;
}

void LoopVerifier::Keep(PoseId id) {
  if (Has(id)) throw std::invalid_argument("keyframe " + std::to_string(id.value) + " is stored already");
  CurrentFeatures();
  kept_[id] = current_->features;
}

size_t LoopVerifier::Bytes() const {
  size_t sum = 0;
  for (const auto& entry : kept_) sum += entry.second->Bytes();
  return sum;
}

LoopVerification LoopVerifier::Verify(PoseId id) {
  const KeyframeFeatures& current = CurrentFeatures();
  const auto it = kept_.find(id);
  if (it == kept_.end()) throw std::invalid_argument("keyframe " + std::to_string(id.value) + " is not stored");
  const KeyframeFeatures& candidate = *it->second;
  LoopVerification out;
  std::vector<StereoMatch> matches;
  const Vector<3> offset = {0, 0, options_.disparity_offset};
  for (const auto& [i, j] : MatchDescriptors(candidate, current, options_.max_distance, options_.ratio)) {
    matches.push_back(
        {candidate.Measured(static_cast<size_t>(i)) + offset, current.Measured(static_cast<size_t>(j)) + offset});
  }
  out.matches = static_cast<int>(matches.size());
  if (out.matches < options_.min_matches) return out;

  out.outcome = LoopOutcome::kNoMotion;
  const auto first = InitialMotion(camera_, matches, options_.initial);
  if (!first) return out;
  std::vector<StereoMatch> agreeing;
  for (size_t k = 0; k < matches.size(); ++k) {
    if (first->inlier[k] != 0) agreeing.push_back(matches[k]);
  }
  out.agreeing = first->inliers;
  out.T_candidate_current = first->T_a_b;
  if (const auto better = EstimateStereoMotion(camera_, agreeing, options_.motion, first->T_a_b)) {
    out.T_candidate_current = better->T_a_b;
  }

  const Refined refined =
      AlignPoints(camera_, candidate, *current_->left, *current_->right, out.T_candidate_current, options_);
  out.outcome = LoopOutcome::kFewInliers;
  const auto motion = EstimateStereoMotion(camera_, refined.matches, options_.motion, out.T_candidate_current);
  if (!motion) return out;
  out.T_candidate_current = motion->T_a_b;
  // The offset of all disparities is known so well only. Points tell nothing of it, and far ones make it grow with the
  // distance.
  const Vector<6> d = options_.disparity_sigma * motion->J_motion_offset;
  out.covariance = motion->covariance + d * d.transpose();
  out.residual_scale = motion->residual_scale;
  out.inliers = motion->inliers;
  out.confirmed = motion->inliers / std::max(1.0, static_cast<double>(refined.in_view));
  out.coverage = Coverage(camera_, refined.matches, motion->inlier);
  if (out.inliers < options_.min_inliers) return out;
  const bool certain = LargestSigma(out.covariance.topLeftCorner<3, 3>()) <= options_.max_sigma_rho &&
                       LargestSigma(out.covariance.bottomRightCorner<3, 3>()) <= options_.max_sigma_phi;
  out.outcome = out.confirmed < options_.min_confirmed ? LoopOutcome::kFewConfirmed
                : out.coverage < options_.min_coverage ? LoopOutcome::kPoorCoverage
                : !certain                             ? LoopOutcome::kUncertain
                                                       : LoopOutcome::kVerified;
  if (out.Verified() && options_.covariance == MotionCovariance::kMonteCarlo) {
    const auto seed = static_cast<std::uint64_t>(id.value);
    const auto sampled = MonteCarloCovariance(camera_, refined.matches, *motion, options_.monte_carlo, seed);
    if (sampled) out.covariance = *sampled + d * d.transpose();
  }
  return out;
}

}  // namespace terse
