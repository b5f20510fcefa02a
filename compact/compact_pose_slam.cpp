#include "terse/compact/compact_pose_slam.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "compact_pose_slam_parts.h"
#include "fused_edges.h"
#include "terse/compact/information.h"
#include "terse/compact/innovation.h"
#include "terse/core/at.h"
#include "terse/core/chi_square.h"
#include "terse/core/error.h"
#include "terse/core/log_message.h"

namespace terse {
namespace {

using internal::At;
using std::size_t;

// A link that is supported finds its support among the last refused ones: they come from poses close behind each other,
// of which each may have had several. Failures are remembered for the steps in which their neighbours come up.
constexpr size_t kMostRefused = 64, kMostFailed = 256;

template <class Item>
void KeepNewest(size_t count, std::vector<Item>& items) {
  if (items.size() > count) items.erase(items.begin(), items.end() - static_cast<long>(count));
}

template <class Pose>
void CheckThresholds(const Thresholds<Pose>& thresholds) {
  const auto& [range, probability, min_loop_gain, min_pose_gain, link_covariance] = thresholds;
  if (!(range.array() > 0).all() || !range.allFinite()) {
    throw std::invalid_argument("compact options: the sensor range must be positive and finite");
  }
  if (!(probability >= 0 && probability < 1))
    throw std::invalid_argument("compact options: the probability must be in [0, 1)");
  if (!(min_loop_gain >= 0) || !(min_pose_gain >= 0))
    throw std::invalid_argument("compact options: gains must not be negative");
  // Cholesky reads one triangle and lets NaN pass.
  const bool symmetric = (link_covariance - link_covariance.transpose()).norm() <= 1e-9 * link_covariance.norm();
  if (!symmetric || link_covariance.llt().info() != Eigen::Success) {
    throw std::invalid_argument("compact options: the link covariance is not positive definite");
  }
}

template <class Pose>
void CheckOptions(const CompactOptions<Pose>& o) {
  const std::string defect = FindDefect(o.budget, o.strategy);
  if (!defect.empty()) throw std::invalid_argument("compact options: " + defect);
  CheckThresholds(o.thresholds);
  if (o.innovation_quantile && !(*o.innovation_quantile > 0 && *o.innovation_quantile < 1))
    throw std::invalid_argument("compact options: the innovation quantile must be in (0, 1)");
  if (!(o.plausible_quantile > 0 && o.plausible_quantile < 1))
    throw std::invalid_argument("compact options: the quantile of plausible displacements must be in (0, 1)");
  if (o.max_registrations < 1)
    throw std::invalid_argument("compact options: at least one registration per pose is needed");
  if (!(o.failed_neighbourhood >= 0))
    throw std::invalid_argument("compact options: the neighbourhood of failed registrations must not be negative");
  if (o.most_recorded < 0) throw std::invalid_argument("compact options: no less than 0 candidates can be recorded");
  if (o.consensus < 2) throw std::invalid_argument("compact options: a consensus takes at least two links");
  if (!(o.distance.view_axis.norm() > 0) || !o.distance.view_axis.allFinite()) {
    throw std::invalid_argument("compact options: the view axis is zero or not finite");
  }
}

template <class Pose>
IncrementalOptions SolverOptions(const CompactOptions<Pose>& options) {
  IncrementalOptions out = options.solver;
  if (!out.log) out.log = options.log;
  return out;
}

}  // namespace

template <class Pose>
RelativePoseFactor<Pose> Measurement(PoseId from, PoseId to, const UncertainPose<Pose>& T_from_to,
                                     CompositionOrder order) {
  const typename Pose::Jacobian covariance =
      order == CompositionOrder::kFirst ? T_from_to.covariance : RetractCovariance(T_from_to);
  const typename Pose::Jacobian information = covariance.llt().solve(Pose::Jacobian::Identity());
  return {from, to, T_from_to.T_a_b, (information + information.transpose()) / 2};
}

template <class Pose>
CompactPoseSlam<Pose>::CompactPoseSlam(const CompactOptions<Pose>& options)
    : solver_(std::make_unique<IncrementalSolver<Pose>>(SolverOptions(options))),
      marginals_(std::make_unique<IncrementalMarginals<Pose>>(*solver_)),
      gains_(std::make_unique<GainControl<Pose>>()),
      fused_(std::make_unique<FusedEdges<Pose>>()),
      reach_(std::make_unique<PoseIndex<Pose>>()) {
  TakeOptions(options);
}

template <class Pose>
void CompactPoseSlam<Pose>::TakeOptions(const CompactOptions<Pose>& options) {
  CheckOptions(options);
  options_ = options;
  gains_->Start(options);
  most_distance_ = ChiSquareQuantile(options.plausible_quantile, Displacement<Pose>::kSize);
  most_innovation_ = options.innovation_quantile ? ChiSquareQuantile(*options.innovation_quantile, Pose::kDof)
                                                 : std::numeric_limits<double>::infinity();
  searches_ = options.strategy == Strategy::kApfl || options.strategy == Strategy::kFpfl ||
              options.strategy == Strategy::kBounded;
}

template <class Pose>
CompactPoseSlam<Pose>::~CompactPoseSlam() = default;
template <class Pose>
CompactPoseSlam<Pose>::CompactPoseSlam(CompactPoseSlam&&) noexcept = default;
template <class Pose>
CompactPoseSlam<Pose>& CompactPoseSlam<Pose>::operator=(CompactPoseSlam&&) noexcept = default;

template <class Pose>
const typename CompactPoseSlam<Pose>::Seen& CompactPoseSlam<Pose>::Find(PoseId id) const {
  const auto it = index_.find(id.value);
  if (it == index_.end()) throw std::invalid_argument("pose " + std::to_string(id.value) + " was never added");
  return history_[At(it->second)];
}

template <class Pose>
void CompactPoseSlam<Pose>::CheckPose(const CompactInput<Pose>& input) const {
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
  if (input.loops) {
    for (const RelativePoseFactor<Pose>& loop : *input.loops) {
      const std::string defect = FindDefect<Pose>(loop);
      if (!defect.empty()) throw std::invalid_argument(defect);
      if (loop.from != input.id && loop.to != input.id)
        throw std::invalid_argument("a loop of " + name + " does not touch it");
      Find(loop.from == input.id ? loop.to : loop.from);
    }
  }
  if (!input.odometry) return;
  const std::string defect = FindDefect<Pose>(*input.odometry);
  if (!defect.empty()) throw std::invalid_argument(defect);
  if (input.odometry->from != input.id && input.odometry->to != input.id)
    throw std::invalid_argument("the odometry does not touch " + name);
}

template <class Pose>
typename CompactPoseSlam<Pose>::Current CompactPoseSlam<Pose>::Start(const CompactInput<Pose>& input) const {
  CheckPose(input);
  Current current;
  current.input = &input;
  if (history_.empty()) {
    current.base = input.id;
    current.T_world_body = input.T_world_body.value_or(Pose());
    return current;
  }
  const RelativePoseFactor<Pose>& edge = *input.odometry;
  const Seen& previous = Find(edge.from == input.id ? edge.to : edge.from);
  current.previous = current.parent = index_.at(previous.id.value);
  const UncertainPose<Pose> odometry = SeenFrom(previous.id, edge);
  current.base = previous.base;
  current.concatenated = !previous.kept;
  current.T_base_current = previous.kept ? odometry : Compose(previous.T_base_pose, odometry, options_.composition);
  current.chain = current.T_base_current;
  current.T_world_body = solver_->Estimate(current.base) * current.T_base_current.T_a_b;
  if (!IsFinite(current.T_world_body) || !current.chain.covariance.allFinite()) {
    throw NumericalError("the odometry of pose " + std::to_string(input.id.value) + " leads beyond all numbers");
  }
  return current;
}

template <class Pose>
void CompactPoseSlam<Pose>::SetLog(LogSink log) {
  solver_->SetLog(log);
  options_.log = std::move(log);
}

template <class Pose>
void CompactPoseSlam<Pose>::LogVerdict(const Decision& decision) const {
  if (!options_.log) return;
  const bool by_gain = decision.verdict == PoseVerdict::kInformative || decision.verdict == PoseVerdict::kRedundant;
  const LogLevel level =
      decision.Kept() && decision.verdict != PoseVerdict::kAllKept ? LogLevel::kInfo : LogLevel::kDebug;
  const std::string name = "pose " + std::to_string(decision.id.value) + (decision.Kept() ? " kept, " : " dropped, ");
  if (by_gain && decision.pose_gain) {
    internal::Log(options_.log, level, name, Name(decision.verdict), ": gain ", *decision.pose_gain,
                  " nats (threshold ", gains_->MinPoseGain(), "), ", decision.candidates.size(), " candidates");
  } else {
    internal::Log(options_.log, level, name, Name(decision.verdict), ": ", decision.candidates.size(), " candidates, ",
                  decision.registrations_tried, " tried, ", decision.links_accepted, " links, ", decision.links_refused,
                  " refused");
  }
}

template <class Pose>
void CompactPoseSlam<Pose>::Judge(const Current& current, Decision& decision) const {
  if (history_.empty()) {
    decision.verdict = PoseVerdict::kFirst;
  } else if (decision.links_accepted > 0) {
    decision.verdict = PoseVerdict::kLoopClosed;
  } else if (!current.input->priors.empty() || current.input->fixed) {
    decision.verdict = PoseVerdict::kPrior;
  } else if (options_.strategy == Strategy::kGiven) {
    decision.verdict = current.input->keep ? PoseVerdict::kGiven : PoseVerdict::kRedundant;
  } else if (current.is_anchored) {
    decision.verdict = PoseVerdict::kAnchored;
  } else if (options_.strategy != Strategy::kFpfl && options_.strategy != Strategy::kBounded) {
    decision.verdict = PoseVerdict::kAllKept;
  } else if (!decision.pose_gain) {
    decision.verdict = PoseVerdict::kNothingInRange;
  } else {
    decision.verdict =
        *decision.pose_gain > gains_->MinPoseGain() ? PoseVerdict::kInformative : PoseVerdict::kRedundant;
  }
}

// Puts the pose into the solver if it is not there yet, with its odometry and priors, and adds the links. Their ids.
template <class Pose>
std::vector<FactorId> CompactPoseSlam<Pose>::Keep(Current& current, std::vector<Factor<Pose>> links,
                                                  const Revival* revival) {
  const CompactInput<Pose>& input = *current.input;
  GraphUpdate<Pose> update;
  if (revival != nullptr) AddRevival(*revival, update);
  const size_t revived = update.factors.size();
  if (!current.in_solver) {
    const Pose start = input.fixed ? input.T_world_body.value_or(current.T_world_body) : current.T_world_body;
    update.poses.push_back({input.id, start, input.fixed});
    if (input.odometry && !current.concatenated) {
      update.factors.push_back(*input.odometry);
    } else if (input.odometry) {
      update.factors.push_back(Measurement(current.base, input.id, current.T_base_current, options_.composition));
    }
    update.factors.insert(update.factors.end(), input.priors.begin(), input.priors.end());
  }
  const size_t others = update.factors.size();
  update.factors.insert(update.factors.end(), links.begin(), links.end());
  if (update.poses.empty() && update.factors.empty()) return {};
  const StepReport report = solver_->Update(update);
  Accumulate(report, current.update);
  UpdateCovariances();
  if (revival != nullptr) Revive(*revival, report.factor_ids);
  if (!current.in_solver && input.odometry) {
    current.odometry = report.factor_ids[revived];
    RememberEdge(update.factors[revived], current.odometry, true);
  }
  std::vector<FactorId> ids(report.factor_ids.begin() + static_cast<long>(others), report.factor_ids.end());
  for (size_t k = 0; k < ids.size(); ++k) {
    links_.push_back({ids[k], input.id, std::nullopt});
    RememberEdge(links[k], ids[k], false);
  }
  current.in_solver = true;
  current.concatenated = false;
  current.T_world_body = solver_->Estimate(input.id);
  current.base = input.id;
  current.T_base_current = {};
  return ids;
}

// Of the poses of a chain up to `last`, in history_: they hang between their base and `next` from now on.
template <class Pose>
void CompactPoseSlam<Pose>::EndChain(int last, PoseId next, const UncertainPose<Pose>& T_base_next, int ended_by) {
  for (int k = last; k >= 0 && !history_[At(k)].kept; k = history_[At(k)].parent) {
    Seen& dropped = history_[At(k)];
    if (dropped.next_kept) break;
    dropped.next_kept = next;
    dropped.T_base_next = T_base_next;
    dropped.ended_by = ended_by;
  }
}

// Which stretch a dropped pose at this place belongs to.
template <class Pose>
int CompactPoseSlam<Pose>::StretchBehind(int parent, bool anchored, int at) const {
  return anchored || history_[At(parent)].kept ? at : history_[At(parent)].stretch;
}

template <class Pose>
void CompactPoseSlam<Pose>::Remember(const Current& current) {
  Seen seen;
  seen.id = seen.base = current.input->id;
  seen.previous = current.previous;
  seen.parent = current.parent;
  seen.kept = current.in_solver;
  seen.odometry = current.odometry;
  seen.T_world_body_when_seen = current.T_world_body;
  if (!seen.kept) {
    seen.base = current.base;
    seen.T_base_pose = current.T_base_current;
  }
  const int at = static_cast<int>(history_.size());
  seen.anchored = current.is_anchored;
  if (seen.kept) EndChain(current.parent, seen.id, current.chain, -1);
  if (seen.anchored) EndChain(current.previous, seen.base, current.T_ended_base, at);
  if (seen.parent >= 0) ++history_[At(seen.parent)].successors;
  if (!seen.kept) seen.stretch = StretchBehind(seen.parent, seen.anchored, at);
  index_[seen.id.value] = at;
  history_.push_back(seen);
}

template <class Pose>
Decision CompactPoseSlam<Pose>::AddPose(PoseId id, const std::optional<RelativePoseFactor<Pose>>& odometry,
                                        const Registration<Pose>& registration) {
  CompactInput<Pose> input;
  input.id = id;
  input.odometry = odometry;
  return AddPose(input, registration);
}

template <class Pose>
Decision CompactPoseSlam<Pose>::AddPose(const CompactInput<Pose>& input, const Registration<Pose>& registration) {
  Current current = Start(input);
  TakeOffers(current);
  const bool counts_loops = options_.budget.error && !history_.empty();
  SeenLoops<Pose> seen{input.id, current.base, current.T_base_current, {}, {}, {}};
  if (counts_loops && input.loops) {
    for (const RelativePoseFactor<Pose>& loop : *input.loops) {
      const PoseId other = loop.from == input.id ? loop.to : loop.from;
      seen.measured.push_back({KeptBase(other), SeenFrom(KeptBase(other), CarryEndToKept(other, loop))});
    }
  }
  const Registration<Pose> watched = counts_loops ? Watched(registration, seen) : nullptr;
  const Registration<Pose>& register_loop = counts_loops ? watched : registration;
  Decision decision;
  decision.id = input.id;
  try {
    if (history_.empty()) {
      Keep(current, {});
    } else if (options_.strategy == Strategy::kApfl || options_.strategy == Strategy::kFpfl) {
      Search(current, decision, register_loop);
    } else if (options_.strategy == Strategy::kBounded) {
      Bound(current, decision, register_loop);
    } else if (options_.strategy == Strategy::kApal || input.keep) {
      LinkAll(current, decision, register_loop);
    }
    Judge(current, decision);
    if (decision.Kept()) Keep(current, {});
    decision.update = std::move(current.update);
  } catch (...) {
    if (current.in_solver) {
      Remember(current);
    } else {
      const auto is_new = [&](const auto& link) { return link.seen == input.id; };
      refused_.erase(std::remove_if(refused_.begin(), refused_.end(), is_new), refused_.end());
      failed_.erase(std::remove_if(failed_.begin(), failed_.end(), is_new), failed_.end());
    }
    throw;
  }
  Remember(current);
  const int loops = input.loops ? static_cast<int>(input.loops->size()) : decision.registrations_tried;
  const typename GainControl<Pose>::Kept kept{static_cast<int>(solver_->Graph().Poses().size()), LinksKept(), loops,
                                              decision.links_accepted + static_cast<int>(decision.edges.size()),
                                              decision.Kept()};
  if (counts_loops && decision.links_refused == 0) {
    seen.in_range = std::move(current.in_range);
    gains_->FollowError(options_, seen, kept, *solver_, [this](FactorId id) { return FindLink(id) != links_.end(); });
  }
  gains_->Follow(options_, kept, current.T_world_body);
  KeepNewest(kMostRefused, refused_);
  KeepNewest(kMostFailed, failed_);
  LogVerdict(decision);
  return decision;
}

// An end that is nullptr stays.
template <class Pose>
RelativePoseFactor<Pose> CompactPoseSlam<Pose>::Carry(const RelativePoseFactor<Pose>& link, const Seen* from,
                                                      const Seen* to) const {
  const std::string defect = FindDefect<Pose>(link);
  if (!defect.empty()) throw std::invalid_argument(defect);
  if (from != nullptr && from->kept) from = nullptr;
  if (to != nullptr && to->kept) to = nullptr;
  if (from == nullptr && to == nullptr) return link;
  UncertainPose<Pose> measured = SeenFrom(link.from, link);
  if (from != nullptr) measured = Compose(from->T_base_pose, measured, options_.composition);
  if (to != nullptr) measured = Compose(measured, Invert(to->T_base_pose), options_.composition);
  return Measurement(from != nullptr ? from->base : link.from, to != nullptr ? to->base : link.to, measured,
                     options_.composition);
}

template <class Pose>
RelativePoseFactor<Pose> CompactPoseSlam<Pose>::CarryToKept(const RelativePoseFactor<Pose>& link) const {
  return Carry(link, &Find(link.from), &Find(link.to));
}

template <class Pose>
RelativePoseFactor<Pose> CompactPoseSlam<Pose>::CarryEndToKept(PoseId end, const RelativePoseFactor<Pose>& link) const {
  if (end != link.from && end != link.to) {
    throw std::invalid_argument("the link does not touch pose " + std::to_string(end.value));
  }
  const Seen& seen = Find(end);
  return Carry(link, end == link.from ? &seen : nullptr, end == link.to ? &seen : nullptr);
}

template <class Pose>
FactorId CompactPoseSlam<Pose>::AddPrior(const Factor<Pose>& prior) {
  const FactorPoses ends = PosesOf(prior);
  if (ends.count != 1) throw std::invalid_argument("a link is no prior");
  const std::string defect = FindDefect(prior);
  if (!defect.empty()) throw std::invalid_argument(defect);
  const Seen& seen = Find(ends.first);
  Factor<Pose> at_kept = prior;
  if (!seen.kept) {
    if (const auto* measured = std::get_if<PosePriorFactor<Pose>>(&prior)) {
      // A link from the origin of the world.
      const Seen* origin = nullptr;
      const RelativePoseFactor<Pose> link{{}, {1}, measured->T_world_body, measured->information};
      const RelativePoseFactor<Pose> carried = Carry(link, origin, &seen);
      at_kept = PosePriorFactor<Pose>{seen.base, carried.T_from_to, carried.information};
    } else {
      const bool is_turned = solver_->CurrentGauge().free_turns == 0;
      at_kept = CarryPosition(std::get<PositionPriorFactor<Pose>>(prior), seen.base, seen.T_base_pose,
                              solver_->Estimate(seen.base), is_turned);
    }
  }
  GraphUpdate<Pose> update;
  update.factors.push_back(at_kept);
  const FactorId id = solver_->Update(update).factor_ids.front();
  UpdateCovariances();
  return id;
}

template <class Pose>
LinkDecision CompactPoseSlam<Pose>::AddLink(const RelativePoseFactor<Pose>& link) {
  const RelativePoseFactor<Pose> carried = CarryToKept(link);
  if (carried.from == carried.to) {
    throw std::invalid_argument("poses " + std::to_string(link.from.value) + " and " + std::to_string(link.to.value) +
                                " hang on the same kept pose");
  }
  Candidate record;
  record.id = carried.from;
  LinkDecision decision;
  decision.from = carried.from;
  decision.to = carried.to;
  const UncertainPose<Pose> known = Between(carried.from, carried.to), measured = SeenFrom(carried.from, carried);
  record.measured_gain = InformationGain<Pose::kDof>(known.covariance, measured.covariance);
  decision.accepted = PassesTests(nullptr, known, measured, record);
  LogLink(carried.from, carried.to, record, decision.accepted);
  decision.gain = *record.measured_gain;
  decision.innovation = record.innovation;
  decision.outlier = record.outlier;
  if (decision.accepted && options_.strategy == Strategy::kBounded) {
    std::vector<NewEdge> edges(1);
    edges[0].a = carried.from;
    edges[0].b = carried.to;
    edges[0].T_a_b = measured;
    edges[0].gain = decision.gain;
    std::optional<StepReport> report;
    Decision unused;
    AddEdges(history_.back().id, edges, unused, report);
    decision.factor = edges[0].id;
  } else if (decision.accepted) {
    GraphUpdate<Pose> update;
    update.factors.push_back(carried);
    decision.factor = solver_->Update(update).factor_ids.front();
    UpdateCovariances();
    links_.push_back({*decision.factor, history_.back().id, decision.gain});
  }
  return decision;
}

template <class Pose>
BatchResult<Pose> CompactPoseSlam<Pose>::Finish() {
  BatchResult<Pose> result = solver_->Finish();
  UpdateCovariances();
  return result;
}

template RelativePoseFactor<SE2> Measurement<SE2>(PoseId, PoseId, const UncertainPose<SE2>&, CompositionOrder);
template RelativePoseFactor<SE3> Measurement<SE3>(PoseId, PoseId, const UncertainPose<SE3>&, CompositionOrder);
template class CompactPoseSlam<SE2>;
template class CompactPoseSlam<SE3>;

}  // namespace terse
