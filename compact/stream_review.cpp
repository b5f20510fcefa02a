#include "stream_review.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "terse/compact/compact_graph.h"
#include "terse/compact/contradicted_loops.h"
#include "terse/compact/state_members.h"
#include "terse/core/error.h"
#include "terse/core/log_message.h"

namespace terse::internal {
namespace {

constexpr long kFirstLoops = 8, kFirstPoses = 32;
// A look is over after so many more poses, or a share of those that there are.
constexpr long kLeastPosesOfLook = 20, kShareOfLook = 8;
// Of the samples that EstimateOptions asks for: wrong loops that come later are for the map alone to tell.
constexpr long kMostPosesOf = 5, kMostLoopsOf = 10;
// Scales and thresholds that differ by less are not worth another map; logarithm.
constexpr double kSameScale = 0.15;

bool AreNear(double a, double b) { return a == b || std::abs(std::log(a / b)) < kSameScale; }

bool AreSame(const KindScale& a, const KindScale& b) {
  return AreNear(a.translation, b.translation) && AreNear(a.rotation, b.rotation);
}
bool AreSame(const InformationScale& a, const InformationScale& b) {
  return AreSame(a.odometry, b.odometry) && AreSame(a.loops, b.loops);
}

template <class Pose>
bool AreSame(const Thresholds<Pose>& a, const Thresholds<Pose>& b) {
  for (Eigen::Index k = 0; k < a.range.size(); ++k) {
    if (!AreNear(a.range[k], b.range[k])) return false;
  }
  for (Eigen::Index k = 0; k < Pose::kDof; ++k) {
    if (!AreNear(std::sqrt(a.link_covariance(k, k)), std::sqrt(b.link_covariance(k, k)))) return false;
  }
  return AreNear(a.min_loop_gain, b.min_loop_gain) && AreNear(a.min_pose_gain, b.min_pose_gain);
}

// Loops and priors that came late stand where they would have come in time: behind what opened the later of their
// poses. First of the edges of a pose stands its odometry, that to the latest pose. True if any came late.
template <class Pose>
bool PutInTime(std::vector<StreamEvent<Pose>>& events) {
  std::unordered_map<std::int64_t, std::size_t> opened_at;
  std::unordered_map<std::size_t, std::pair<std::size_t, std::size_t>> odometry;  // by place: of which pose, event
  std::vector<std::size_t> place(events.size()), order(events.size());
  std::size_t newest = 0;
  bool has_late = false;
  for (std::size_t k = 0; k < events.size(); ++k) {
    place[k] = order[k] = k;
    if (!events[k].factor) continue;
    const FactorPoses ends = PosesOf(*events[k].factor);
    const std::size_t first = opened_at.try_emplace(ends.first.value, k).first->second;
    const std::size_t second = ends.count == 2 ? opened_at.try_emplace(ends.second.value, k).first->second : first;
    place[k] = std::max(first, second);
    if (place[k] == k) newest = k;
    has_late = has_late || place[k] < newest;
    if (ends.count < 2) continue;
    const auto [latest, is_first] = odometry.try_emplace(place[k], std::min(first, second), k);
    if (!is_first && std::min(first, second) > latest->second.first) latest->second = {std::min(first, second), k};
  }
  const auto comes_before = [&](std::size_t a, std::size_t b) {
    if (place[a] != place[b]) return place[a] < place[b];
    const auto of_pose = odometry.find(place[a]);
    return of_pose != odometry.end() && a == of_pose->second.second && b != a;
  };
  std::stable_sort(order.begin(), order.end(), comes_before);
  std::vector<StreamEvent<Pose>> sorted;
  sorted.reserve(events.size());
  for (const std::size_t k : order) sorted.push_back(std::move(events[k]));
  events = std::move(sorted);
  return has_late;
}

// Edges and priors, poses in the order in which these name them. Factors are numbered from 0.
template <class Pose>
struct MeasuredGraph {
  explicit MeasuredGraph(const std::vector<StreamEvent<Pose>>& events) {
    std::unordered_map<std::int64_t, Pose> values;
    std::unordered_set<std::int64_t> fixed, known;
    for (const auto& event : events) {
      if (event.T_world_body) {
        values[event.ids.front().value] = *event.T_world_body;
      } else {
        for (const PoseId id : event.ids) fixed.insert(id.value);
      }
    }
    for (std::size_t k = 0; k < events.size(); ++k) {
      if (!events[k].factor) continue;
      const FactorPoses ends = PosesOf(*events[k].factor);
      const std::size_t had = known.size();
      for (const PoseId id : {ends.first, ends.second}) {
        if ((ends.count < 2 && id != ends.first) || !known.insert(id.value).second) continue;
        graph.AddPose(id);
        const auto value = values.find(id.value);
        const bool is_first = known.size() == 1, is_fixed = fixed.count(id.value) != 0;
        if (!is_first && (!is_fixed || value == values.end())) continue;  // a value is of no effect
        graph.SetPose(id, value == values.end() ? Pose() : value->second);
        graph.SetFixed(id, is_fixed);
      }
      graph.AddFactor(*events[k].factor);
      event_of.push_back(k);
      opens.push_back(known.size() > had);
    }
  }
  PoseGraph<Pose> graph;
  std::vector<std::size_t> event_of;  // by factor
  std::vector<char> opens;            // a pose; likewise
};

// Of the measured graph, ascending.
template <class Pose>
std::vector<FactorId> LeftOut(const MeasuredGraph<Pose>& measured, const std::vector<StreamEvent<Pose>>& events) {
  std::vector<FactorId> out;
  for (std::size_t k = 0; k < measured.event_of.size(); ++k) {
    if (events[measured.event_of[k]].is_left_out) out.push_back({static_cast<std::int64_t>(k)});
  }
  return out;
}
// What opens a pose is not left out.
template <class Pose>
void MarkLeftOut(const std::vector<FactorId>& loops, const MeasuredGraph<Pose>& measured,
                 std::vector<StreamEvent<Pose>>& events) {
  for (const std::size_t k : measured.event_of) events[k].is_left_out = false;
  for (const FactorId id : loops) {
    const auto k = static_cast<std::size_t>(id.value);
    events[measured.event_of[k]].is_left_out = measured.opens[k] == 0;
  }
}

// By pose index, of poses that are not in the trajectory yet by their odometry. Empty if others are not in it either.
template <class Pose>
std::vector<Pose> ValuesFor(const MeasuredGraph<Pose>& measured, const std::vector<RecoveredPose<Pose>>& trajectory) {
  std::unordered_map<std::int64_t, Pose> values;
  for (const auto& pose : trajectory) values[pose.id.value] = pose.T_world_body;
  for (std::size_t k = 0; k < measured.opens.size(); ++k) {
    const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&measured.graph.Factors()[k].factor);
    if (!measured.opens[k] || edge == nullptr) continue;
    const auto from = values.find(edge->from.value), to = values.find(edge->to.value);
    if (from != values.end() && to != values.end()) continue;
    if (from == values.end() && to == values.end()) return {};
    if (from != values.end()) {
      values[edge->to.value] = Pose(from->second * edge->T_from_to);
    } else {
      values[edge->from.value] = Pose(to->second * edge->T_from_to.Inverse());
    }
  }
  std::vector<Pose> out;
  for (const auto& node : measured.graph.Poses()) out.push_back(values.at(node.id.value));
  return out;
}

// Those that are to be chosen.
template <class Pose>
Thresholds<Pose> ChooseThresholds(const PoseGraph<Pose>& graph, CompactOptions<Pose> settings,
                                  const ThresholdChoice& chosen) {
  Thresholds<Pose> out = settings.thresholds;
  if (!chosen.Any()) return out;
  SampleThresholds(graph, settings);
  const Thresholds<Pose>& found = settings.thresholds;
  if (chosen.range) out.range = found.range;
  if (chosen.min_loop_gain) out.min_loop_gain = found.min_loop_gain;
  if (chosen.min_pose_gain) out.min_pose_gain = found.min_pose_gain;
  if (chosen.link_covariance) out.link_covariance = found.link_covariance;
  return out;
}

long CountRefused(const std::vector<StreamOutcome>& outcomes) {
  long refused = 0;
  for (const StreamOutcome& outcome : outcomes) {
    if (const auto* decision = std::get_if<Decision>(&outcome)) refused += decision->links_refused;
    if (const auto* link = std::get_if<LateLink>(&outcome)) refused += link->decision.outlier;
  }
  return refused;
}

// As the strategy's tests are with information that was scaled, unless the user said otherwise.
template <class Pose>
CompactOptions<Pose> ForScale(CompactOptions<Pose> settings, const InformationScale& scale) {
  if (scale.IsOne() || settings.innovation_quantile != kInnovationQuantile) return settings;
  settings.innovation_quantile = kInnovationQuantileOfScaled;
  settings.solver.robust = MapRobust(settings.solver.robust, settings);
  return settings;
}

template <class Pose>
bool IsEdge(const StreamEvent<Pose>& event) {
  return event.factor && std::holds_alternative<RelativePoseFactor<Pose>>(*event.factor);
}

// Without what names the pose. True if there is something left.
template <class Pose>
bool TakeOut(PoseId id, StreamEvent<Pose>& event) {
  if (event.factor) {
    const FactorPoses ends = PosesOf(*event.factor);
    return ends.first != id && ends.second != id;
  }
  const bool had_any = !event.ids.empty();
  event.ids.erase(std::remove(event.ids.begin(), event.ids.end(), id), event.ids.end());
  return !had_any || !event.ids.empty();
}

}  // namespace

template <class Pose>
RemadeMap<Pose>::RemadeMap(const CompactOptions<Pose>& settings, const InformationScale& scale)
    : slam(std::make_unique<CompactPoseSlam<Pose>>(ForScale(settings, scale))), stream(*slam, scale) {}

template <class Pose>
bool RemadeMap<Pose>::Knows(const StreamEvent<Pose>& event) const {
  if (!event.factor) return false;
  const auto is_known = [&](PoseId id) { return stream.Open() == id || slam->HasSeen(id) || slam->HasForgotten(id); };
  const FactorPoses ends = PosesOf(*event.factor);
  return is_known(ends.first) && is_known(ends.second);
}

template <class Pose>
void RemadeMap<Pose>::TakeUpTo(const std::vector<StreamEvent<Pose>>& events) {
  const auto take = [&](const StreamEvent<Pose>& event) -> std::vector<StreamOutcome> {
    if (event.factor) return stream.Add(*event.factor);
    if (event.T_world_body)
      return stream.SetValue(event.ids.front(), *event.T_world_body), std::vector<StreamOutcome>();
    if (!event.ids.empty()) return stream.Fix(event.ids), std::vector<StreamOutcome>();
    return stream.Flush();
  };
  for (; taken_ < events.size(); ++taken_) {
    if (events[taken_].is_left_out) continue;
    try {
      const std::vector<StreamOutcome> outcomes = take(events[taken_]);
      refused += CountRefused(outcomes);
      for (const StreamOutcome& outcome : outcomes) {
        if (const auto* decision = std::get_if<Decision>(&outcome)) decisions.push_back(*decision);
      }
    } catch (const std::invalid_argument&) {
      if (!Knows(events[taken_])) throw;
    }
  }
}

template <class Pose>
StreamReview<Pose>::StreamReview(const CompactOptions<Pose>& settings, const ReviewOptions& options)
    : settings_(settings), options_(options), records_(true) {
  settings_.log = settings_.solver.log = nullptr;  // whoever listens may not expect another thread
}

template <class Pose>
Factor<Pose> StreamReview<Pose>::Scaled(const Factor<Pose>& factor, bool opens) const {
  const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&factor);
  if (edge == nullptr || scale_.IsOne()) return factor;
  const auto has = [&](std::optional<PoseId> id) { return edge->from == id || edge->to == id; };
  const bool is_odometry = !newest_ || (has(newest_) && (opens || has(before_)));
  return ScaleInformation(*edge, is_odometry ? scale_.odometry : scale_.loops);
}

template <class Pose>
void StreamReview<Pose>::Note(StreamEvent<Pose> event, std::optional<PoseId> opened,
                              const std::vector<StreamOutcome>& outcomes) {
  if (opened && !newest_ && event.factor) {
    const FactorPoses ends = PosesOf(*event.factor);
    newest_ = ends.first == *opened ? ends.second : ends.first;  // of a prior it is itself
    poses_ += newest_ != opened;
  }
  if (opened) {
    if (newest_ != opened) before_ = newest_;
    newest_ = opened;
    ++poses_;
  }
  if (!records_) return;
  edges_ += IsEdge(event);
  refused_ += CountRefused(outcomes);
  events_.push_back(std::move(event));
}

template <class Pose>
void StreamReview<Pose>::NoteDiscarded(PoseId open) {
  newest_ = before_;
  before_.reset();
  --poses_;
  const std::size_t had = events_.size();
  events_.erase(std::remove_if(events_.begin(), events_.end(), [&](auto& event) { return !TakeOut(open, event); }),
                events_.end());
  edges_ = std::count_if(events_.begin(), events_.end(), IsEdge<Pose>);
  if (events_.size() == had || look_.over_at == 0) return;
  // The look on the way may have seen it: another one.
  look_ = {};
  looked_at_ /= 2;
  poses_looked_at_ /= 2;
}

template <class Pose>
void StreamReview<Pose>::Stop() {
  records_ = false;
  look_ = {};
  events_ = {};
}

template <class Pose>
bool StreamReview<Pose>::IsInDoubt() const {
  const long left_out = std::count_if(events_.begin(), events_.end(), [](const auto& e) { return e.is_left_out; });
  return left_out > 0 || AreLoopsInDoubt(refused_, Loops());
}

template <class Pose>
bool StreamReview<Pose>::IsEnough() const {
  const EstimateOptions& sample = options_.estimate;
  return poses_ >= kMostPosesOf * sample.sample_poses || Loops() >= kMostLoopsOf * sample.sample_loops;
}

template <class Pose>
auto StreamReview<Pose>::LookAt(Beginning beginning) -> Looked {
  bool is_other = PutInTime(beginning.events);
  const MeasuredGraph<Pose> measured(beginning.events);
  OnTheWay& look = beginning.look;
  Looked out{{}, beginning.scale, beginning.settings.thresholds, std::move(beginning.events), std::nullopt, ""};
  CompactOptions<Pose>& settings = beginning.settings;
  InformationCalibration information;
  if (beginning.options.information && !look.is_early) {
    out.information = information = CalibrateInformation(measured.graph, beginning.options.estimate);
  }
  // What cannot be told leaves the scale that was found from less.
  const bool is_told = information.verdict != InformationVerdict::kUndetermined;
  if (!is_told || AreSame(information.scale, beginning.scale)) information.scale = beginning.scale;
  RobustOptions robust = settings.solver.robust;
  if (look.is_early) robust.kernel = RobustKernel::kNone;  // nothing is judged
  LoopJury<Pose> jury(measured.graph, information, robust);
  const auto choose = [&] {
    try {
      const Thresholds<Pose> found =
          ChooseThresholds(jury.Remaining(), ForScale(settings, jury.Scale()), beginning.options.chosen);
      if (AreSame(found, out.thresholds)) return false;
      out.thresholds = settings.thresholds = found;
      return true;
    } catch (const std::exception& error) {  // all else can do without
      out.failure = error.what();
      return false;
    }
  };
  long loops = 0;  // that the map hears of
  const auto make_again = [&] {
    out.scale = jury.Scale();
    MarkLeftOut(jury.LeftOut(), measured, out.events);
    out.remade.emplace(settings, out.scale);
    out.remade->TakeUpTo(out.events);
    look.trajectory = out.remade->slam->Trajectory();
    loops = static_cast<long>(LoopFactors(measured.graph).size() - jury.LeftOut().size());
  };
  const std::vector<FactorId> left_out_before = LeftOut(measured, out.events);
  if (jury.JudgeAtFirst()) {
    is_other = is_other || jury.LeftOut() != left_out_before;
    look.is_in_doubt = false;
  } else {
    jury.LeaveOut(left_out_before);
  }
  is_other = is_other || !AreSame(jury.Scale(), beginning.scale);
  std::vector<FactorId> strained;
  if (choose() || is_other) {
    make_again();
    look.is_in_doubt = look.is_in_doubt || AreLoopsInDoubt(out.remade->refused, loops);
    strained = StrainedLoops(out.remade->decisions, loops, measured.graph);
  }
  if ((look.is_in_doubt || !strained.empty()) && jury.JudgeNextTo(ValuesFor(measured, look.trajectory), strained)) {
    choose();
    make_again();
  }
  return out;
}

template <class Pose>
void StreamReview<Pose>::Begin() {
  Beginning beginning{settings_, options_, scale_, {}, look_};
  beginning.events.assign(events_.begin(), events_.begin() + static_cast<std::ptrdiff_t>(look_.events));
  looked_ = std::async([beginning = std::move(beginning)]() mutable { return LookAt(std::move(beginning)); });
}

// A map that cannot be made is none.
template <class Pose>
auto StreamReview<Pose>::End(const LogSink& log) -> std::optional<Found> {
  look_ = {};
  const auto warn = [&](const std::string& why) {
    if (!why.empty()) Log(log, LogLevel::kWarning, "a look at what was measured so far: ", why);
  };
  try {
    Looked looked = looked_.get();
    warn(looked.failure);
    if (!looked.remade) return std::nullopt;
    std::vector<StreamEvent<Pose>> events = std::move(looked.events);
    const auto seen = static_cast<std::ptrdiff_t>(events.size());
    events.insert(events.end(), events_.begin() + seen, events_.end());
    looked.remade->TakeUpTo(events);
    events_ = std::move(events);
    scale_ = looked.scale;
    settings_.thresholds = looked.thresholds;
    refused_ = looked.remade->refused;
    const auto left_out = std::count_if(events_.begin(), events_.end(), [](const auto& e) { return e.is_left_out; });
    return Found{{std::move(looked.information), scale_, static_cast<int>(left_out), {}}, std::move(*looked.remade)};
  } catch (const std::exception& error) {
    warn(error.what());
  }
  return std::nullopt;
}

template <class Pose>
bool StreamReview<Pose>::IsDue(bool is_last, bool is_enough) const {
  if (is_last || is_enough) {
    return Loops() > looked_at_ || (options_.chosen.Any() && poses_ > poses_looked_at_);
  }
  const bool is_early = Loops() < kFirstLoops && options_.chosen.Any();
  return Loops() >= std::max(kFirstLoops, 2 * looked_at_) ||
         (is_early && poses_ >= std::max(kFirstPoses, 2 * poses_looked_at_));
}

template <class Pose>
auto StreamReview<Pose>::Look(const CompactPoseSlam<Pose>& slam, bool is_last) -> std::optional<Found> {
  std::optional<Found> found;
  if (!records_) return found;
  if (look_.over_at > 0 && (is_last || poses_ >= look_.over_at)) {
    const bool was_last = look_.is_last;
    found = End(slam.Options().log);
    if (was_last) Stop();
  }
  if (!records_ || look_.over_at > 0) return found;
  const bool is_enough = IsEnough();
  if (IsDue(is_last, is_enough)) {
    look_.events = events_.size();
    look_.over_at = poses_ + std::max(kLeastPosesOfLook, poses_ / kShareOfLook);
    look_.is_last = is_enough;
    look_.is_early = Loops() < kFirstLoops && !is_last && !is_enough;
    look_.is_in_doubt = IsInDoubt();
    if (look_.is_in_doubt) look_.trajectory = (found ? *found->remade.slam : slam).Trajectory();
    if (!look_.is_early) looked_at_ = Loops();
    poses_looked_at_ = poses_;
    Begin();
  } else if (is_enough) {
    Stop();
  }
  if (!is_last || look_.over_at == 0) return found;
  std::optional<Found> last = End(slam.Options().log);
  return last ? std::move(last) : std::move(found);
}

template <class Pose>
template <class Archive>
void StreamReview<Pose>::Serialize(Archive& archive) {
  auto& [sample_poses, sample_loops, draws, max_iterations, tolerance, seed] = options_.estimate;
  auto& [range, min_loop_gain, min_pose_gain, link_covariance] = options_.chosen;
  archive(options_.information, range, min_loop_gain, min_pose_gain, link_covariance, sample_poses, sample_loops, draws,
          max_iterations, tolerance, seed);
  archive(scale_.odometry.translation, scale_.odometry.rotation, scale_.loops.translation, scale_.loops.rotation);
  archive(records_, newest_, before_, poses_, edges_, refused_, looked_at_, poses_looked_at_);
  archive(settings_.innovation_quantile, settings_.solver.robust.quantile);
  auto& [events, over_at, is_last, is_early, is_in_doubt, trajectory] = look_;
  archive(events, over_at, is_last, is_early, is_in_doubt);
  archive.Each(trajectory, [&](RecoveredPose<Pose>& pose) { archive(pose.id, pose.kept, pose.T_world_body); });
  archive.Each(events_, [&](StreamEvent<Pose>& event) {
    auto& [factor, T_world_body, ids, is_left_out] = event;
    archive(factor, T_world_body, ids, is_left_out);
  });
}

template <class Pose>
std::string StreamReview<Pose>::FindStateDefect() const {
  const auto is_positive = [](const KindScale& scale) {
    return scale.translation > 0 && scale.rotation > 0 && std::isfinite(scale.translation + scale.rotation);
  };
  if (!is_positive(scale_.odometry) || !is_positive(scale_.loops)) return "a scale that is not positive";
  for (const auto& event : events_) {
    if (event.factor && !FindDefect(*event.factor).empty()) return "a measurement: " + FindDefect(*event.factor);
    if (event.T_world_body && (event.ids.size() != 1 || !IsFinite(*event.T_world_body))) return "a value of no pose";
  }
  const long edges = std::count_if(events_.begin(), events_.end(), IsEdge<Pose>);
  if (edges != edges_ || poses_ < 0) return "another number of measurements than is stated";
  for (const auto& pose : look_.trajectory) {
    if (!IsFinite(pose.T_world_body)) return "a trajectory that is not finite";
  }
  return look_.over_at > 0 && look_.events > events_.size() ? "a look at more than there is" : "";
}

template <class Pose>
void StreamReview<Pose>::Resume(const CompactPoseSlam<Pose>& slam) {
  CompactOptions<Pose> settings = slam.Options();
  // As they were given; a map of scaled information has others.
  settings.innovation_quantile = settings_.innovation_quantile;
  settings.solver.robust.quantile = settings_.solver.robust.quantile;
  settings_ = std::move(settings);
  settings_.log = settings_.solver.log = nullptr;
  if (look_.over_at > 0) Begin();
}

#define TERSE_INSTANTIATE(Pose)                                           \
  template struct RemadeMap<Pose>;                                        \
  template class StreamReview<Pose>;                                      \
  template void StreamReview<Pose>::Serialize<StateWriter>(StateWriter&); \
  template void StreamReview<Pose>::Serialize<StateReader>(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
