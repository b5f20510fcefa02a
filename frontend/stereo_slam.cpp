#include "terse/frontend/stereo_slam.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "lap_timer.h"
#include "terse/compact/contradicted_loops.h"
#include "terse/core/definite.h"
#include "terse/core/log_message.h"

namespace terse {
namespace {

RelativePoseFactor<SE3> Link(PoseId from, PoseId to, const SE3& T_from_to, const Matrix<6, 6>& covariance) {
  const Matrix<6, 6> information = InverseOfDefinite<6>(covariance);
  return {from, to, T_from_to, (information + information.transpose()) / 2};
}

CompactOptions<SE3> MapOptions(const StereoSlamOptions& options, bool by_appearance) {
  CompactOptions<SE3> out = options.compact;
  if (out.strategy == Strategy::kGiven) {
    throw std::invalid_argument("stereo options: a random selection needs a graph that is known beforehand");
  }
  if (by_appearance) out.strategy = Strategy::kApal;
  if (!out.log) out.log = options.log;
  return out;
}

StereoOdometryOptions OdometryOptions(const StereoSlamOptions& options) {
  StereoOdometryOptions out = options.odometry;
  if (!out.log) out.log = options.log;
  return out;
}

}  // namespace

CompactOptions<SE3> StereoCompactOptions(Strategy strategy) {
  CompactOptions<SE3> out;
  out.strategy = strategy;
  out.thresholds.range = {3, 3, 8, 0.7};
  out.thresholds.min_loop_gain = strategy == Strategy::kBounded ? 4 : 8;
  out.thresholds.min_pose_gain = 8;
  Vector<6> sigma;
  sigma << 0.02, 0.02, 0.03, 0.001, 0.001, 0.001;
  out.thresholds.link_covariance = sigma.cwiseProduct(sigma).asDiagonal();
  return out;
}

StereoSlam::StereoSlam(const StereoCamera& camera, const StereoSlamOptions& options,
                       std::optional<AppearanceSearch> appearance)
    : options_(options),
      odometry_(camera, OdometryOptions(options)),
      verifier_(camera, options.verifier),
      map_(MapOptions(options, appearance.has_value())),
      appearance_(std::move(appearance)) {
  if (options.most_verifications < 0 || options.most_per_place < 1 || !(options.odometry_length_part >= 0) ||
      !(options.odometry_angle_part >= 0)) {
    throw std::invalid_argument("stereo options: a number is out of its domain");
  }
}
StereoSlam::~StereoSlam() = default;
StereoSlam::StereoSlam(StereoSlam&&) noexcept = default;
StereoSlam& StereoSlam::operator=(StereoSlam&&) noexcept = default;

CompactInput<SE3> StereoSlam::MakeInput(const StereoFrame& frame, const OdometryStep& step) const {
  CompactInput<SE3> input;
  input.id = PoseId{frame.index};
  if (!previous_) return input;
  const SE3& T = step.T_previous_current;
  Matrix<6, 6> covariance = step.covariance;
  covariance.diagonal().head<3>().array() += std::pow(options_.odometry_length_part * T.Translation().norm(), 2);
  covariance.diagonal().tail<3>().array() += std::pow(options_.odometry_angle_part * T.Angle(), 2);
  UncertainPose<SE3> T_previous_current = {step.T_previous_current, covariance};
  if (pending_) T_previous_current = Compose(*pending_, T_previous_current);
  input.odometry = Link(*previous_, input.id, T_previous_current.T_a_b, T_previous_current.covariance);
  return input;
}

std::optional<RelativePoseFactor<SE3>> StereoSlam::Register(PoseId candidate, PoseId current, StereoSlamStep& step) {
  if (!verifier_.Has(candidate)) return std::nullopt;
  if (map_.Options().strategy != Strategy::kApal) {
    int deep = 0;
    for (const LoopAttempt& a : step.attempts) deep += a.verification.outcome != LoopOutcome::kFewMatches;
    if (deep >= options_.most_verifications) return std::nullopt;
  }
  LapTimer timer;
  verifier_.CurrentFeatures();
  step.times.features += timer.Lap();
  LoopAttempt attempt{candidate, current, verifier_.Verify(candidate), 0};
  attempt.milliseconds = timer.Lap();
  step.times.verification += attempt.milliseconds;
  const LoopVerification& v = attempt.verification;
  step.attempts.push_back(attempt);
  // Few matches say no more than that the place looks different.
  const LogLevel level = v.outcome == LoopOutcome::kFewMatches ? LogLevel::kDebug : LogLevel::kInfo;
  internal::Log(options_.log, level, "loop ", candidate.value, " - ", current.value, " ",
                v.Verified() ? "" : "refused: ", Name(v.outcome), "; ", v.matches, " matches, ", v.agreeing, " agree, ",
                v.inliers, " inliers, ", 100 * v.confirmed, " % of the points confirmed");
  if (!v.Verified()) return std::nullopt;
  return Link(candidate, current, v.T_candidate_current, v.covariance);
}

void StereoSlam::StoreFeatures(PoseId id) {
  verifier_.Keep(id);
  // With kApal a candidate without features would be a link that is missing.
  if (map_.Options().strategy != Strategy::kApal) {
    std::vector<std::size_t> near;
    const SE3 T_current_world = map_.Estimate(id).Inverse();
    for (std::size_t k = 0; k < stored_.size(); ++k) {
      const SE3 T = T_current_world * map_.Estimate(stored_[k]);
      if (T.Translation().norm() < options_.place_radius && T.Angle() < options_.place_angle) near.push_back(k);
    }
    if (near.size() >= static_cast<std::size_t>(options_.most_per_place)) {
      verifier_.Forget(stored_[near.front()]);
      stored_.erase(stored_.begin() + static_cast<long>(near.front()));
    }
  }
  stored_.push_back(id);
}

void StereoSlam::DropFeatures(const std::vector<RetiredPose>& retired) {
  for (const RetiredPose& pose : retired) {
    verifier_.Forget(pose.id);
    stored_.erase(std::remove(stored_.begin(), stored_.end(), pose.id), stored_.end());
  }
}

void StereoSlam::NoteOdometry(PoseId id, const std::optional<RelativePoseFactor<SE3>>& measured) {
  const SE3 before = odometry_poses_.empty() ? SE3() : odometry_poses_.back().T_first_frame;
  odometry_poses_.push_back({id, measured ? before * measured->T_from_to : before});
  if (map_.PosesForgotten() == forgotten_) return;
  forgotten_ = map_.PosesForgotten();
  const auto is_forgotten = [&](const OdometryPose& pose) { return !map_.HasSeen(pose.id); };
  odometry_poses_.erase(std::remove_if(odometry_poses_.begin(), odometry_poses_.end(), is_forgotten),
                        odometry_poses_.end());
}

void StereoSlam::NoteMeasured(const StereoSlamStep& step, const std::optional<RelativePoseFactor<SE3>>& odometry) {
  if (!MayLookBack()) return;
  measured_.AddPose(step.id);
  if (odometry) measured_.AddFactor(*odometry);
  for (const LoopAttempt& a : step.attempts) {
    const LoopVerification& v = a.verification;
    if (v.Verified()) measured_.AddFactor(Link(a.candidate, a.current, v.T_candidate_current, v.covariance));
  }
}

bool StereoSlam::MayLookBack() const {
  return map_.Options().solver.robust.kernel == RobustKernel::kGnc && !map_.Options().most_dropped;
}

LookedBack StereoSlam::LookBack(const std::vector<Decision>& decisions, const AfterStep<SE3>& after_step) {
  LookedBack out;
  if (!MayLookBack() || measured_.Poses().size() != static_cast<std::size_t>(map_.PosesSeen())) return out;
  const std::vector<FactorId> loops = LoopFactors(measured_);
  if (loops.empty()) return out;
  long refused = 0;
  for (const Decision& decision : decisions) refused += decision.links_refused;
  for (const FactorId id : LoopFactors(map_.Solver().Graph())) refused += map_.Solver().WeightOf(id) == 0;
  BatchOptions batch;
  batch.log = options_.log;
  LoopJury<SE3> jury(measured_, {}, map_.Options().solver.robust, batch);
  jury.on_judging = [&](const std::string& why) {
    out.why = why;
    internal::Log(options_.log, LogLevel::kInfo, why, ": all are judged together");
  };
  if (!jury.JudgeBy(map_, decisions, static_cast<long>(loops.size()), refused)) return out;
  CompactPoseSlam<SE3> again(map_.Options());
  out.decisions = AddPoses<SE3>(again, GraphReplay<SE3>(jury.Remaining()), [&](const Decision& decision, double s) {
    if (after_step) after_step(again, decision, s);
    return true;
  });
  map_ = std::move(again);
  for (const FactorId id : jury.LeftOut()) {
    const auto& loop = std::get<RelativePoseFactor<SE3>>(measured_.FindFactor(id)->factor);
    out.wrong.emplace_back(loop.from, loop.to);
  }
  const auto has_gone = [&](PoseId id) {
    if (map_.KeptBase(id) == id) return false;
    verifier_.Forget(id);
    return true;
  };
  stored_.erase(std::remove_if(stored_.begin(), stored_.end(), has_gone), stored_.end());
  return out;
}

std::vector<SE3> StereoSlam::OdometryTrajectory() const {
  std::vector<SE3> out;
  out.reserve(odometry_poses_.size());
  for (const OdometryPose& pose : odometry_poses_) out.push_back(pose.T_first_frame);
  return out;
}

std::vector<RetiredPose> StereoSlam::Retire() {
  std::vector<RetiredPose> retired = map_.Retire();
  DropFeatures(retired);
  return retired;
}

StereoSlamStep StereoSlam::AddFrame(const StereoFrame& frame) {
  StereoSlamStep step;
  step.id = PoseId{frame.index};
  if (map_.HasSeen(step.id)) throw std::invalid_argument("frame " + std::to_string(frame.index) + " was added already");
  verifier_.SetCurrent(frame);
  LapTimer timer;
  step.odometry = odometry_.Track(frame);
  step.times.odometry = timer.Lap();
  if (options_.odometry.estimate_disparity_offset) {
    verifier_.SetDisparityOffset(odometry_.DisparityOffset(), odometry_.DisparityOffsetSigma());
  }
  CompactInput<SE3> input = MakeInput(frame, step.odometry);
  // Odometry has gone on; should the map refuse the frame, the next one's link spans both.
  if (input.odometry) pending_ = SeenFrom(*previous_, *input.odometry);
  if (appearance_) {
    const KeyframeFeatures& features = verifier_.CurrentFeatures();
    step.times.features = timer.Lap();
    input.linkable.emplace();
    for (const AppearanceSearch::Match& match : appearance_->Query(features)) input.linkable->push_back(match.id);
    appearance_->Add(step.id, features);
    step.times.search = timer.Lap();
  }
  step.decision =
      map_.AddPose(input, [&](PoseId candidate, PoseId current) { return Register(candidate, current, step); });
  const double others = appearance_ ? 0 : step.times.features;
  step.times.map = timer.Lap() - others - step.times.verification;
  DropFeatures(step.decision.retired);
  if (step.decision.Kept()) {
    StoreFeatures(step.id);
    step.times.features += timer.Lap();
  }
  previous_ = step.id;
  pending_.reset();
  NoteOdometry(step.id, input.odometry);
  NoteMeasured(step, input.odometry);
  return step;
}

}  // namespace terse
