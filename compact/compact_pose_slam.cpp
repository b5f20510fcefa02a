#include "terse/compact/compact_pose_slam.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "terse/compact/information.h"
#include "terse/covariance/covariance_blocks.h"
#include "terse/covariance/marginals.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

constexpr size_t kFewPoses = 12;

template <class Pose>
double TranslationSpread(const typename Pose::Jacobian& covariance) {
  return std::sqrt(std::max(0.0, covariance.diagonal().template head<Pose::kDim>().sum()));
}

template <class Pose>
double RotationSpread(const typename Pose::Jacobian& covariance) {
  return std::sqrt(std::max(0.0, covariance.diagonal().template tail<Pose::kDof - Pose::kDim>().sum()));
}

template <class Pose>
void CheckOptions(const CompactOptions<Pose>& o) {
  if (!(o.range.array() > 0).all() || !o.range.allFinite()) {
    throw std::invalid_argument("compact options: the sensor range must be positive and finite");
  }
  if (!(o.probability >= 0 && o.probability < 1))
    throw std::invalid_argument("compact options: the probability must be in [0, 1)");
  if (!(o.min_loop_gain >= 0) || !(o.min_pose_gain >= 0))
    throw std::invalid_argument("compact options: gains must not be negative");
  // Cholesky reads one triangle and lets NaN pass.
  const bool symmetric = (o.link_covariance - o.link_covariance.transpose()).norm() <= 1e-9 * o.link_covariance.norm();
  if (!symmetric || o.link_covariance.llt().info() != Eigen::Success) {
    throw std::invalid_argument("compact options: the link covariance is not positive definite");
  }
  if (!(o.view_axis.norm() > 0) || !o.view_axis.allFinite()) {
    throw std::invalid_argument("compact options: the view axis is zero or not finite");
  }
}

}  // namespace

const char* Name(Strategy strategy) {
  switch (strategy) {
    case Strategy::kApal: return "apal";
    case Strategy::kApfl: return "apfl";
    case Strategy::kFpfl: return "fpfl";
  }
  return "unknown";
}

const char* Name(PoseVerdict verdict) {
  switch (verdict) {
    case PoseVerdict::kFirst: return "first";
    case PoseVerdict::kAllKept: return "all_kept";
    case PoseVerdict::kLoopClosed: return "loop_closed";
    case PoseVerdict::kPrior: return "prior";
    case PoseVerdict::kNothingInRange: return "nothing_in_range";
    case PoseVerdict::kInformative: return "informative";
    case PoseVerdict::kRedundant: return "redundant";
  }
  return "unknown";
}

template <class Pose>
struct CompactPoseSlam<Pose>::Evaluated {
  int pose = -1;  // solver index
  UncertainPose<Pose> T_pose_current;
  Candidate record;
};

template <class Pose>
struct CompactPoseSlam<Pose>::Current {
  const CompactInput<Pose>* input = nullptr;
  int previous = -1;  // in history_
  PoseId base;        // the kept pose its chain hangs on; itself once it is in the solver
  UncertainPose<Pose> T_base_current;
  UncertainPose<Pose> chain;  // T_base_current as it came in, when base was still another pose
  UncertainPose<Pose> odometry;
  Pose T_world_body;
  std::vector<Bound> bounds;
  bool in_solver = false;
  bool concatenated = false;  // poses were dropped between base and this one
};

template <class Pose>
CompactPoseSlam<Pose>::CompactPoseSlam(const CompactOptions<Pose>& options)
    : options_(options),
      deviations_(DeviationsBeyondRange(options.probability)),
      solver_(std::make_unique<IncrementalSolver<Pose>>(options.solver)),
      inverse_(std::make_unique<SelectedInverse<Pose::kDof>>(solver_->Factor())) {
  CheckOptions(options);
}

template <class Pose>
const typename CompactPoseSlam<Pose>::Seen& CompactPoseSlam<Pose>::Find(PoseId id) const {
  const auto it = index_.find(id.value);
  if (it == index_.end()) throw std::invalid_argument("pose " + std::to_string(id.value) + " was never added");
  return history_[At(it->second)];
}

template <class Pose>
typename CompactPoseSlam<Pose>::Current CompactPoseSlam<Pose>::Start(const CompactInput<Pose>& input) const {
  const std::string name = "pose " + std::to_string(input.id.value);
  if (index_.count(input.id.value) != 0) throw std::invalid_argument(name + " was added already");
  if (input.odometry.has_value() == history_.empty()) {
    throw std::invalid_argument(name + (history_.empty() ? " is the first and has odometry" : " has no odometry"));
  }
  if (input.T_world_body && !std::isfinite(input.T_world_body->Log().sum())) {
    throw std::invalid_argument(name + " has a value that is not finite");
  }
  if (input.fixed && !input.T_world_body && !history_.empty())
    throw std::invalid_argument(name + " is fixed but has no value");
  for (const Factor<Pose>& prior : input.priors) {
    const FactorPoses ends = PosesOf(prior);
    if (ends.count != 1 || ends.first != input.id)
      throw std::invalid_argument("a prior of " + name + " is no prior on it");
    const std::string defect = FindDefect<Pose>(prior);
    if (!defect.empty()) throw std::invalid_argument(defect);
  }
  Current current;
  current.input = &input;
  if (history_.empty()) {
    current.base = input.id;
    current.T_world_body = input.T_world_body.value_or(Pose());
    return current;
  }
  const std::string defect = FindDefect<Pose>(*input.odometry);
  if (!defect.empty()) throw std::invalid_argument(defect);
  const RelativePoseFactor<Pose>& edge = *input.odometry;
  if (edge.from != input.id && edge.to != input.id) throw std::invalid_argument("the odometry does not touch " + name);
  const Seen& previous = Find(edge.from == input.id ? edge.to : edge.from);
  current.previous = index_.at(previous.id.value);
  current.odometry = SeenFrom(previous.id, edge);
  current.base = previous.base;
  current.concatenated = !previous.kept;
  current.T_base_current = previous.kept ? current.odometry : Compose(previous.T_base_pose, current.odometry);
  current.chain = current.T_base_current;
  current.T_world_body = solver_->Estimate(current.base) * current.T_base_current.T_a_b;
  current.bounds = PropagateBounds(current);
  return current;
}

// Minkowski's inequality for root mean squares: an error of the older pose's rotation acts over the new step's length.
// The new step's own error is independent of what was known before, so that squares add.
// Holds while the map only gains information; relinearisation moves it in the second order.
template <class Pose>
std::vector<typename CompactPoseSlam<Pose>::Bound> CompactPoseSlam<Pose>::PropagateBounds(
    const Current& current) const {
  const double unbounded = std::numeric_limits<double>::infinity();
  if (current.previous + 1 != static_cast<int>(history_.size())) {
    return std::vector<Bound>(bounds_.size(), Bound{unbounded, unbounded});
  }
  const double length = current.odometry.T_a_b.Translation().norm();
  const double metres = TranslationSpread<Pose>(current.odometry.covariance);
  const double radians = RotationSpread<Pose>(current.odometry.covariance);
  std::vector<Bound> out(bounds_);
  for (Bound& bound : out) {
    bound.metres = std::hypot(bound.metres + bound.radians * length, metres);
    bound.radians = std::hypot(bound.radians, radians);
  }
  return out;
}

// Kept poses that the distance test could accept, given the bounds.
template <class Pose>
std::vector<int> CompactPoseSlam<Pose>::Prefilter(const Current& current) const {
  std::vector<int> out;
  const auto& range = options_.range;
  const double reach = range.template head<Pose::kDim>().norm();
  const double root = std::sqrt(static_cast<double>(Pose::kDim));
  for (int i = 0; i < static_cast<int>(current.bounds.size()); ++i) {
    const Bound& bound = current.bounds[At(i)];
    // A bound may be infinite.
    const double slack = deviations_ > 0 ? deviations_ * bound.metres : 0;
    const Pose T_world_i = solver_->EstimateAt(i);
    if ((T_world_i.Translation() - current.T_world_body.Translation()).norm() > reach + root * slack) continue;
    const auto mean = DisplacementMean<Pose>(T_world_i.Inverse() * current.T_world_body, options_.view_axis);
    const bool near =
        (mean.template head<Pose::kDim>().cwiseAbs().array() <= range.template head<Pose::kDim>().array() + slack)
            .all();
    if (!near) continue;
    const double angle = AngleProbabilityBound(mean[Pose::kDim], bound.radians, range[Pose::kDim]);
    if (angle > options_.probability) out.push_back(i);
  }
  return out;
}

// T_pose_current for each of the given kept poses (S, Eqs. 16-17).
template <class Pose>
std::vector<UncertainPose<Pose>> CompactPoseSlam<Pose>::Displacements(const Current& current,
                                                                      const std::vector<int>& poses) const {
  constexpr int B = Pose::kDof;
  using Jacobian = typename Pose::Jacobian;
  std::vector<UncertainPose<Pose>> out;
  if (poses.empty()) return out;
  const int base = solver_->Graph().IndexOf(current.base);
  const Jacobian F = current.T_base_current.T_a_b.Inverse().Adjoint();
  // Few blocks are cheapest by solves along their paths, many by the recursion, which keeps what it has computed.
  std::vector<int> columns = {base};
  const bool few = poses.size() <= kFewPoses;
  if (few) columns.insert(columns.end(), poses.begin(), poses.end());
  std::vector<int> rows(poses);
  rows.push_back(base);
  const MatrixX blocks = CovarianceBlocks(solver_->Factor(), rows, columns);
  const auto block = [&](size_t row, size_t column) -> Jacobian {
    return blocks.template block<B, B>(static_cast<Eigen::Index>(row) * B, static_cast<Eigen::Index>(column) * B);
  };
  const Jacobian Sigma_nn = F * block(poses.size(), 0) * F.transpose() + current.T_base_current.covariance;
  for (size_t k = 0; k < poses.size(); ++k) {
    if (poses[k] == base) {
      out.push_back(current.T_base_current);
      continue;
    }
    const Jacobian Sigma_in = block(k, 0) * F.transpose();
    const Jacobian Sigma_ii = few ? block(k, k + 1) : inverse_->Diagonal(poses[k]);
    const Pose T_pose_current = solver_->EstimateAt(poses[k]).Inverse() * current.T_world_body;
    out.push_back({T_pose_current, RelativeCovariance<Pose>(T_pose_current, Sigma_ii, Sigma_in, Sigma_nn)});
  }
  return out;
}

// The distance test and the gain of the given kept poses; those in range come back. Tightens the bounds of all.
template <class Pose>
std::vector<typename CompactPoseSlam<Pose>::Evaluated> CompactPoseSlam<Pose>::Evaluate(
    Current& current, const std::vector<int>& poses) const {
  std::vector<Evaluated> out;
  const std::vector<UncertainPose<Pose>> displacements = Displacements(current, poses);
  for (size_t k = 0; k < poses.size(); ++k) {
    Evaluated e;
    e.pose = poses[k];
    e.T_pose_current = displacements[k];
    e.record.id = solver_->Graph().Poses()[At(e.pose)].id;
    if (At(e.pose) < current.bounds.size()) {
      current.bounds[At(e.pose)] = {TranslationSpread<Pose>(e.T_pose_current.covariance),
                                    RotationSpread<Pose>(e.T_pose_current.covariance)};
    }
    const auto displacement = ComputeDisplacement<Pose>(e.T_pose_current, options_.view_axis);
    e.record.probability = RangeProbabilities<Pose>(displacement, options_.range).minCoeff();
    if (e.record.probability <= options_.probability) continue;
    e.record.gain = InformationGain<Pose::kDof>(e.T_pose_current.covariance, options_.link_covariance);
    out.push_back(e);
  }
  return out;
}

template <class Pose>
std::vector<UncertainPose<Pose>> CompactPoseSlam<Pose>::Predict(const CompactInput<Pose>& input,
                                                                const std::vector<PoseId>& from) const {
  if (history_.empty()) throw std::invalid_argument("nothing is known before the first pose");
  std::vector<int> poses;
  for (const PoseId id : from) poses.push_back(solver_->Graph().IndexOf(id));
  return Displacements(Start(input), poses);
}

template <class Pose>
std::optional<RelativePoseFactor<Pose>> CompactPoseSlam<Pose>::Register(const Registration<Pose>& registration,
                                                                        PoseId candidate, PoseId current) const {
  std::optional<RelativePoseFactor<Pose>> link = registration ? registration(candidate, current) : std::nullopt;
  if (!link) return link;
  const bool joins =
      (link->from == candidate && link->to == current) || (link->from == current && link->to == candidate);
  if (!joins) throw std::invalid_argument("the registration returned a link between other poses than asked for");
  const std::string defect = FindDefect<Pose>(*link);
  if (!defect.empty()) throw std::invalid_argument(defect);
  return link;
}

// Algorithm 1, lines 6-17: best first, the rest evaluated again after every accepted link.
template <class Pose>
void CompactPoseSlam<Pose>::CloseLoops(Current& current, std::vector<Evaluated>& candidates, Decision& decision,
                                       const Registration<Pose>& registration) {
  // Odometry measures this displacement already.
  const std::optional<PoseId> linked = current.concatenated ? std::nullopt : std::optional<PoseId>(current.base);
  std::vector<Candidate> settled;
  while (true) {
    auto best = candidates.end();
    for (auto it = candidates.begin(); it != candidates.end(); ++it) {
      if (it->record.tried || it->record.gain <= options_.min_loop_gain || it->record.id == linked) continue;
      if (best == candidates.end() || it->record.gain > best->record.gain) best = it;
    }
    if (best == candidates.end()) break;
    best->record.tried = true;
    ++decision.registrations_tried;
    const auto link = Register(registration, best->record.id, current.input->id);
    if (!link) continue;
    const UncertainPose<Pose> measured = SeenFrom(best->record.id, *link);
    best->record.measured_gain = InformationGain<Pose::kDof>(best->T_pose_current.covariance, measured.covariance);
    if (*best->record.measured_gain <= options_.min_loop_gain) continue;
    best->record.accepted = true;
    ++decision.links_accepted;
    Keep(current, {*link});
    std::vector<int> rest;
    for (const Evaluated& e : candidates) {
      if (e.record.tried) {
        settled.push_back(e.record);
      } else {
        rest.push_back(e.pose);
      }
    }
    candidates = Evaluate(current, rest);
  }
  for (const Evaluated& e : candidates) settled.push_back(e.record);
  decision.candidates = std::move(settled);
}

template <class Pose>
void CompactPoseSlam<Pose>::LinkAll(Current& current, Decision& decision, const Registration<Pose>& registration) {
  std::vector<PoseId> offered;
  if (current.input->linkable) {
    offered = *current.input->linkable;
  } else {
    for (const Evaluated& e : Evaluate(current, Prefilter(current))) {
      if (current.concatenated || e.record.id != current.base) offered.push_back(e.record.id);
    }
  }
  std::vector<Factor<Pose>> links;
  for (const PoseId id : offered) {
    Candidate candidate;
    candidate.id = id;
    candidate.tried = true;
    ++decision.registrations_tried;
    if (const auto link = Register(registration, id, current.input->id)) {
      candidate.accepted = true;
      ++decision.links_accepted;
      links.emplace_back(*link);
    }
    decision.candidates.push_back(candidate);
  }
  Keep(current, std::move(links));
}

template <class Pose>
void CompactPoseSlam<Pose>::Judge(const Current& current, Decision& decision) const {
  if (history_.empty()) {
    decision.verdict = PoseVerdict::kFirst;
  } else if (decision.links_accepted > 0) {
    decision.verdict = PoseVerdict::kLoopClosed;
  } else if (!current.input->priors.empty() || current.input->fixed) {
    decision.verdict = PoseVerdict::kPrior;
  } else if (options_.strategy != Strategy::kFpfl) {
    decision.verdict = PoseVerdict::kAllKept;
  } else if (!decision.pose_gain) {
    decision.verdict = PoseVerdict::kNothingInRange;
  } else {
    decision.verdict =
        *decision.pose_gain > options_.min_pose_gain ? PoseVerdict::kInformative : PoseVerdict::kRedundant;
  }
}

// Puts the pose into the solver if it is not there yet, with its odometry and priors, and adds the links.
template <class Pose>
void CompactPoseSlam<Pose>::Keep(Current& current, std::vector<Factor<Pose>> links) {
  const CompactInput<Pose>& input = *current.input;
  GraphUpdate<Pose> update;
  const int new_links = static_cast<int>(links.size());
  if (!current.in_solver) {
    const Pose start = input.fixed ? input.T_world_body.value_or(current.T_world_body) : current.T_world_body;
    update.poses.push_back({input.id, start, input.fixed});
    if (input.odometry && !current.concatenated) {
      update.factors.push_back(*input.odometry);
    } else if (input.odometry) {
      const auto& chain = current.T_base_current;
      const typename Pose::Jacobian information = chain.covariance.llt().solve(Pose::Jacobian::Identity());
      update.factors.push_back(
          RelativePoseFactor<Pose>{current.base, input.id, chain.T_a_b, (information + information.transpose()) / 2});
    }
    update.factors.insert(update.factors.end(), input.priors.begin(), input.priors.end());
  }
  update.factors.insert(update.factors.end(), links.begin(), links.end());
  if (update.poses.empty() && update.factors.empty()) return;
  solver_->Update(update);
  links_kept_ += new_links;
  if (!current.in_solver) {
    // The first absolute measurements release the anchor (gauge.h), and what it told of the map is lost.
    const bool absolute = input.fixed || !input.priors.empty();
    if (absolute && absolute_poses_++ < Pose::kDim) {
      constexpr double kUnbounded = std::numeric_limits<double>::infinity();
      std::fill(current.bounds.begin(), current.bounds.end(), Bound{kUnbounded, kUnbounded});
    }
    current.bounds.push_back({});
  }
  current.in_solver = true;
  current.concatenated = false;
  current.T_world_body = solver_->Estimate(input.id);
  current.base = input.id;
  current.T_base_current = {};
}

template <class Pose>
void CompactPoseSlam<Pose>::Remember(const Current& current) {
  Seen seen;
  seen.id = seen.base = current.input->id;
  seen.previous = current.previous;
  seen.kept = current.in_solver;
  seen.T_world_body_when_seen = current.T_world_body;
  if (!seen.kept) {
    seen.base = current.base;
    seen.T_base_pose = current.T_base_current;
  }
  for (int k = seen.kept ? current.previous : -1; k >= 0 && !history_[At(k)].kept; k = history_[At(k)].previous) {
    Seen& dropped = history_[At(k)];
    if (dropped.next_kept) break;
    dropped.next_kept = seen.id;
    dropped.T_base_next = current.chain;
  }
  index_[seen.id.value] = static_cast<int>(history_.size());
  history_.push_back(seen);
  bounds_ = current.bounds;
}

template <class Pose>
Decision CompactPoseSlam<Pose>::AddPose(const CompactInput<Pose>& input, const Registration<Pose>& registration) {
  Current current = Start(input);
  Decision decision;
  decision.id = input.id;
  try {
    if (history_.empty()) {
      Keep(current, {});
    } else if (options_.strategy == Strategy::kApal) {
      LinkAll(current, decision, registration);
    } else {
      std::vector<Evaluated> candidates = Evaluate(current, Prefilter(current));
      for (const Evaluated& e : candidates) {
        decision.pose_gain = std::min(decision.pose_gain.value_or(e.record.gain), e.record.gain);
      }
      CloseLoops(current, candidates, decision, registration);
    }
    Judge(current, decision);
    if (decision.Kept()) Keep(current, {});
  } catch (...) {
    if (current.in_solver) Remember(current);
    throw;
  }
  Remember(current);
  return decision;
}

template <class Pose>
Pose CompactPoseSlam<Pose>::Estimate(PoseId id) const {
  const Seen& seen = Find(id);
  return seen.kept ? solver_->Estimate(id) : solver_->Estimate(seen.base) * seen.T_base_pose.T_a_b;
}

template <class Pose>
std::vector<RecoveredPose<Pose>> CompactPoseSlam<Pose>::Trajectory(Recovery recovery) const {
  std::vector<RecoveredPose<Pose>> out;
  for (const Seen& seen : history_) {
    Pose T = Estimate(seen.id);
    if (!seen.kept && recovery == Recovery::kV0) T = seen.T_world_body_when_seen;
    if (!seen.kept && recovery == Recovery::kV2 && seen.next_kept) {
      // The misfit at the next kept pose, e in Exp(e) T_base_next, is shared in proportion to the covariance
      // gathered so far: the most likely chain between two poses held where they are.
      const Pose T_base = solver_->Estimate(seen.base);
      const Pose T_base_next = T_base.Inverse() * solver_->Estimate(*seen.next_kept);
      const typename Pose::Tangent e = (T_base_next * seen.T_base_next.T_a_b.Inverse()).Log();
      const auto left = [](const UncertainPose<Pose>& chain) -> typename Pose::Jacobian {
        const typename Pose::Jacobian A = chain.T_a_b.Adjoint();
        return A * chain.covariance * A.transpose();
      };
      const typename Pose::Tangent share = left(seen.T_base_pose) * left(seen.T_base_next).llt().solve(e);
      T = T_base * Pose::Exp(share) * seen.T_base_pose.T_a_b;
    }
    out.push_back({seen.id, seen.kept, T});
  }
  return out;
}

template class CompactPoseSlam<SE2>;
template class CompactPoseSlam<SE3>;

}  // namespace terse
