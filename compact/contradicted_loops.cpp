#include "terse/compact/contradicted_loops.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <string>
#include <utility>

#include "loops_of_run.h"
#include "terse/core/chi_square.h"
#include "terse/core/loop_groups.h"
#include "terse/core/open_loops.h"
#include "terse/core/residual.h"
#include "terse/core/robust.h"
#include "terse/core/supported_loops.h"

namespace terse {
namespace {

constexpr int kLeastRefused = 3;
constexpr std::size_t kLeastAlone = 50;
constexpr double kDoubtfulShare = 0.01;
constexpr double kChanceOfStrain = 0.05;
// An explanation of so many times as many loops, in so many times as many groups, is better at any cost.
constexpr double kManyMore = 1.05;
// With so few loops, one through a kernel so many times as wide is looked at too. It has to explain so many groups
// more, as a single one may be one mistake, and to cost less by such a share of what its loops count.
constexpr std::size_t kFewLoops = 500;
constexpr double kWider = 2, kLeastGroups = 1.5, kWorthOfWider = 0.25;
// A group goes where all costs less with it as a wrong one, by the chi2 of so many loops left out or of such a part of
// its own; those are looked at, the worst first, whose own chi2 is larger by that of one than it should be.
constexpr double kPriceOfGroup = 5, kPriceOfLoop = 0.75;
constexpr std::size_t kMostSuspects = 10;
constexpr int kMostGroupsOut = 10;
// Which loops contradict a trajectory does not take the last digits of it.
constexpr double kTolerance = 1e-6;
constexpr int kMostIterations = 50;
// Of the variance: nobody's measurements are better than this share of what they say.
constexpr double kLeastScale = 1e-6;

// A trajectory that may explain the loops.
template <class Pose>
struct Explanation {
  std::vector<Pose> T_world_body;
  double cost = 0;                     // truncated least squares: a loop no more than k
  double wide_cost = 0;                // by the wider kernel
  double open_cost = 0;                // by k as much wider, but no wider than the kernel
  std::vector<FactorId> contradicted;  // loops, by far
  double left_out = 0;                 // chi2 over which the kernel leaves a loop out
};

template <class Pose>
double Chi2Of(const Factor<Pose>& factor, const PoseGraph<Pose>& graph, const std::vector<Pose>& values) {
  const FactorPoses ends = PosesOf(factor);
  const auto value = [&](PoseId id) { return values[static_cast<std::size_t>(graph.IndexOf(id))]; };
  return FactorChi2(factor, value(ends.first), value(ends.second));
}

// What is asked of an explanation.
template <class Pose>
class Judge {
 public:
  // k, the chi2 that counts as much as any larger one, is what one true loop in a hundred exceeds. Where information is
  // too cautious that is less than it says: the median of what gnc explains tells, and with more room a group of wrong
  // loops would be worth the odometry that they bend.
  // Whether `strained` ones are explained does not count, only what they cost.
  Judge(const PoseGraph<Pose>& graph, const BatchResult<Pose>& by_gnc, const std::vector<FactorId>& strained)
      : graph_(graph), loops_(LoopFactors(graph)), left_out_(std::pow(by_gnc.robust_width, 2)) {
    std::set_difference(loops_.begin(), loops_.end(), strained.begin(), strained.end(), std::back_inserter(counted_));
    const std::vector<int> place = internal::PlacesInArrival(graph);
    std::vector<std::pair<int, int>> places;
    for (const FactorId id : loops_) {
      const FactorPoses ends = PosesOf(graph.FindFactor(id)->factor);
      const auto of = [&](PoseId pose) { return place[static_cast<std::size_t>(graph.IndexOf(pose))]; };
      places.push_back(std::minmax({of(ends.first), of(ends.second)}));
    }
    share_of_group_.resize(loops_.size());
    groups_ = internal::GroupLoops(places);
    for (const auto& group : groups_) {
      for (const std::size_t k : group) share_of_group_[k] = 1 / static_cast<double>(group.size());
    }
    std::vector<double> explained;
    for (const FactorId id : loops_) {
      const double chi2 = Chi2Of(graph.FindFactor(id)->factor, graph, by_gnc.T_world_body);
      if (chi2 <= left_out_) explained.push_back(chi2);
    }
    double scale = 1;
    if (!explained.empty()) {
      const auto middle = explained.begin() + static_cast<std::ptrdiff_t>(explained.size() / 2);
      std::nth_element(explained.begin(), middle, explained.end());
      scale = std::min(1.0, *middle / ChiSquareQuantile(0.5, Pose::kDof));
    }
    k_ = std::max(scale, kLeastScale) * ChiSquareQuantile(RobustOptions().quantile, Pose::kDof);
    mean_ = std::max(scale, kLeastScale) * Pose::kDof;
  }

  Explanation<Pose> Weigh(std::vector<Pose> T_world_body) const {
    Explanation<Pose> out{std::move(T_world_body), 0, 0, 0, {}, left_out_};
    for (const auto& node : graph_.Factors()) {
      const bool is_loop = std::binary_search(loops_.begin(), loops_.end(), node.id);
      const double chi2 = Chi2Of(node.factor, graph_, out.T_world_body);
      out.cost += is_loop ? std::min(chi2, k_) : chi2;
      out.open_cost += is_loop ? std::min({chi2, kWider * kWider * k_, left_out_}) : chi2;
      out.wide_cost += is_loop ? std::min(chi2, kWider * kWider * left_out_) : chi2;
      // Wrong loops, local ones too, are farther off in 999 of 1000 cases, true ones seldom: none to two in a hundred
      // on most graphs, three on manhattan.
      if (is_loop && chi2 > internal::kByFar * left_out_) out.contradicted.push_back(node.id);
    }
    std::sort(out.contradicted.begin(), out.contradicted.end());
    return out;
  }
  std::size_t Loops() const { return loops_.size(); }
  // Of loops, and of places that they join: wrong ones that agree with each other are many, but of one place.
  bool ExplainsManyMore(const Explanation<Pose>& a, const Explanation<Pose>& b) const {
    return static_cast<double>(Explained(a)) > kManyMore * static_cast<double>(Explained(b)) &&
           ExplainsMoreGroups(a, b);
  }
  // Cheaper, and of as many loops or more of their groups, or of many more: with little information on loops either
  // alone is misleading.
  bool IsBetter(const Explanation<Pose>& a, const Explanation<Pose>& b) const {
    const bool is_cheaper = a.cost < b.cost && (Explained(a) >= Explained(b) || ExplainsMoreGroups(a, b));
    return is_cheaper || ExplainsManyMore(a, b);
  }
  // With more loops in, of which the map knows little: true ones there may well be in the tail.
  bool IsBetterWithOpen(const Explanation<Pose>& a, const Explanation<Pose>& b) const {
    return a.open_cost < b.open_cost && Explained(a) >= Explained(b);
  }
  // Through the wider kernel.
  bool IsWorthMore(const Explanation<Pose>& wider, const Explanation<Pose>& than) const {
    const double more = static_cast<double>(Explained(wider)) - static_cast<double>(Explained(than));
    return ExplainsManyMore(wider, than) && ExplainedGroups(wider) > ExplainedGroups(than) + kLeastGroups &&
           than.wide_cost - wider.wide_cost > kWorthOfWider * more * kWider * kWider * left_out_;
  }
  // Of groups what is not contradicted nor taken out, where its chi2 is larger by that of a loop left out than as many
  // true ones have: the worst first.
  std::vector<std::vector<FactorId>> Suspects(const Explanation<Pose>& by,
                                              const std::vector<FactorId>& taken_out) const {
    std::vector<std::pair<double, std::vector<FactorId>>> found;
    for (const auto& group : groups_) {
      double chi2 = 0;
      std::vector<FactorId> in;
      for (const std::size_t k : group) {
        if (std::binary_search(by.contradicted.begin(), by.contradicted.end(), loops_[k])) continue;
        if (std::binary_search(taken_out.begin(), taken_out.end(), loops_[k])) continue;
        in.push_back(loops_[k]);
        chi2 += Chi2Of(graph_.FindFactor(loops_[k])->factor, graph_, by.T_world_body) - mean_;
      }
      if (chi2 >= left_out_) found.emplace_back(-chi2, std::move(in));
    }
    std::sort(found.begin(), found.end());
    if (found.size() > kMostSuspects) found.resize(kMostSuspects);
    std::vector<std::vector<FactorId>> out;
    out.reserve(found.size());
    for (auto& suspect : found) out.push_back(std::move(suspect.second));
    return out;
  }
  // By how much all costs less without a group of so many loops than they are worth; below zero: it stays.
  double Relief(const Explanation<Pose>& with, const Explanation<Pose>& without, std::size_t loops) const {
    return with.cost - without.cost - std::max(kPriceOfGroup, kPriceOfLoop * static_cast<double>(loops)) * left_out_;
  }
  std::size_t Explained(const Explanation<Pose>& by) const {
    return counted_.size() -
           static_cast<std::size_t>(std::count_if(by.contradicted.begin(), by.contradicted.end(), [&](FactorId id) {
             return std::binary_search(counted_.begin(), counted_.end(), id);
           }));
  }

 private:
  bool ExplainsMoreGroups(const Explanation<Pose>& a, const Explanation<Pose>& b) const {
    return ExplainedGroups(a) > kManyMore * ExplainedGroups(b);
  }
  // Of a group the share of its loops.
  double ExplainedGroups(const Explanation<Pose>& by) const {
    double sum = 0;
    for (std::size_t k = 0; k < loops_.size(); ++k) {
      const bool is_out = std::binary_search(by.contradicted.begin(), by.contradicted.end(), loops_[k]);
      if (!is_out && std::binary_search(counted_.begin(), counted_.end(), loops_[k])) sum += share_of_group_[k];
    }
    return sum;
  }

  const PoseGraph<Pose>& graph_;
  std::vector<FactorId> loops_, counted_;         // ascending
  std::vector<std::vector<std::size_t>> groups_;  // of indices into loops_
  std::vector<double> share_of_group_;            // of each loop
  double left_out_, k_ = 0, mean_ = 0;            // of the chi2 of a true loop
};

// Wrong loops of one group agree with each other, and together hold what they bend.
template <class Pose>
Explanation<Pose> WithoutDearGroups(Explanation<Pose> best, const Judge<Pose>& judge, const PoseGraph<Pose>& graph,
                                    const BatchOptions& next_to) {
  const auto solve_without = [&](const std::vector<FactorId>& without, const Explanation<Pose>& from) {
    BatchOptions options = next_to;
    options.robust_factors->clear();
    std::set_difference(next_to.robust_factors->begin(), next_to.robust_factors->end(), without.begin(), without.end(),
                        std::back_inserter(*options.robust_factors));
    return judge.Weigh(SolveBatch(WithoutFactors(graph, without), from.T_world_body, options).T_world_body);
  };
  std::vector<FactorId> out;
  for (int round = 0; round < kMostGroupsOut; ++round) {
    const std::vector<std::vector<FactorId>> suspects = judge.Suspects(best, out);
    if (suspects.empty()) break;
    if (round == 0) best = solve_without({}, best);  // to its end, so that this is no one's merit
    double most = 0;
    std::optional<Explanation<Pose>> found;
    std::vector<FactorId> out_of_found;
    for (const std::vector<FactorId>& group : suspects) {
      std::vector<FactorId> without;
      std::set_union(out.begin(), out.end(), group.begin(), group.end(), std::back_inserter(without));
      Explanation<Pose> other = solve_without(without, best);
      const double relief = judge.Relief(best, other, group.size());
      if (!(relief > most)) continue;
      most = relief;
      found = std::move(other);
      out_of_found = std::move(without);
    }
    if (!found) break;
    best = std::move(*found);
    out = std::move(out_of_found);
  }
  return best;
}

// ContradictedLoops, with the values that say so.
template <class Pose>
Explanation<Pose> BestExplanation(const PoseGraph<Pose>& graph, const std::vector<Pose>& first,
                                  const std::vector<FactorId>& strained, BatchOptions options) {
  // The map's width, where it is open, leaves room for what a map with few links does not know.
  options.robust.quantile = RobustOptions().quantile;
  options.relative_tolerance = std::max(options.relative_tolerance, kTolerance);
  options.max_iterations = std::min(options.max_iterations, kMostIterations);
  const std::vector<FactorId> unsupported = internal::UnsupportedLoops(graph);
  const BatchResult<Pose> solved = SolveBatch(WithoutFactors(graph, unsupported), options);
  const Judge<Pose> judge(graph, solved, strained);
  BatchOptions next_to = options;
  next_to.robust.width = solved.robust_width;
  next_to.robust_factors = LoopFactors(graph);
  next_to.graduate = false;
  const auto explain_next_to = [&](const std::vector<Pose>& T_world_body) {
    const auto is_better = [&](const BatchResult<Pose>& with, const BatchResult<Pose>& before) {
      return judge.IsBetterWithOpen(judge.Weigh(with.T_world_body), judge.Weigh(before.T_world_body));
    };
    return judge.Weigh(internal::SolveWithOpenLoops<Pose>(graph, T_world_body, next_to, is_better).T_world_body);
  };
  Explanation<Pose> best = explain_next_to(solved.T_world_body);
  const auto keep_if_better = [&](Explanation<Pose> other) {
    if (judge.IsBetter(other, best)) best = std::move(other);
  };

  if (!first.empty()) keep_if_better(explain_next_to(first));

  // Where true loops stand alone, most of what is explained had no support.
  std::vector<FactorId> explained_alone;
  std::set_difference(unsupported.begin(), unsupported.end(), best.contradicted.begin(), best.contradicted.end(),
                      std::back_inserter(explained_alone));
  const bool are_few = judge.Loops() <= kFewLoops, stand_alone = 2 * explained_alone.size() >= judge.Explained(best);
  if (are_few || stand_alone) {
    keep_if_better(judge.Weigh(SolveBatch(graph, options).T_world_body));
  }

  // A few true loops in the tail of the noise would be given up for the odometry that they bend.
  if (are_few) {
    BatchOptions wider = options;
    wider.robust.width = kWider * solved.robust_width;
    Explanation<Pose> other = judge.Weigh(SolveBatch(graph, wider).T_world_body);
    if (judge.IsWorthMore(other, best)) return other;  // at the optimum of another kernel
  }
  return WithoutDearGroups(std::move(best), judge, graph, next_to);
}

// Of all measurements, at these values.
template <class Pose>
long CountContradicted(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body, double left_out) {
  return std::count_if(graph.Factors().begin(), graph.Factors().end(), [&](const auto& node) {
    return Chi2Of(node.factor, graph, T_world_body) > internal::kByFar * left_out;
  });
}

// The ids that these factors have in a scaled graph.
template <class Pose>
std::vector<FactorId> IdsInScaled(const PoseGraph<Pose>& graph, const std::vector<FactorId>& ids) {
  std::vector<FactorId> out;
  std::int64_t place = 0;
  for (const auto& node : graph.Factors()) {
    if (std::binary_search(ids.begin(), ids.end(), node.id)) out.push_back({place});
    ++place;
  }
  return out;
}

// Of all poses, by their index in the graph.
template <class Pose>
std::vector<Pose> ValuesOf(const CompactPoseSlam<Pose>& slam, const PoseGraph<Pose>& graph) {
  std::vector<Pose> values(graph.Poses().size());
  for (const RecoveredPose<Pose>& pose : slam.Trajectory()) {
    values[static_cast<std::size_t>(graph.IndexOf(pose.id))] = pose.T_world_body;
  }
  return values;
}

}  // namespace

bool AreLoopsInDoubt(long refused, long offered) {
  return refused >= kLeastRefused && static_cast<double>(refused) > kDoubtfulShare * static_cast<double>(offered);
}

template <class Pose>
std::vector<FactorId> ContradictedLoops(const PoseGraph<Pose>& graph, const std::vector<Pose>& first,
                                        BatchOptions options) {
  return BestExplanation(graph, first, {}, std::move(options)).contradicted;
}

template <class Pose>
std::string WhyLoopsAreInDoubt(const PoseGraph<Pose>& graph) {
  const internal::LoopSupport support = internal::FindSupport(graph);
  if (!support.are_suspect || support.unsupported.size() < kLeastAlone) return "";
  if (!support.others_are_many) return "";  // then a first map is one explanation more, and costs little
  return std::to_string(support.unsupported.size()) + " of " + std::to_string(support.loops) +
         " loops have no other that bears them out";
}

template <class Pose>
std::vector<FactorId> StrainedLoops(const std::vector<Decision>& decisions, long offered,
                                    const PoseGraph<Pose>& graph) {
  if (offered == 0) return {};
  const double limit = ChiSquareQuantile(1 - kChanceOfStrain / static_cast<double>(offered), Pose::kDof);
  const std::vector<FactorId> believed = LoopsOf(
      decisions, graph, [&](const Candidate& link) { return link.accepted && link.innovation.value_or(0) > limit; });
  std::vector<FactorId> strained;
  if (believed.empty()) return strained;
  const std::vector<FactorId> alone = internal::UnsupportedLoops(graph);
  std::set_intersection(believed.begin(), believed.end(), alone.begin(), alone.end(), std::back_inserter(strained));
  return strained;
}

template <class Pose>
LoopJury<Pose>::LoopJury(const PoseGraph<Pose>& graph, const InformationCalibration& information,
                         const RobustOptions& robust, BatchOptions options)
    : graph_(graph),
      scale_(information.scale),
      without_caution_(information.without_caution),
      options_(std::move(options)) {
  options_.robust = robust;
  Leave();
}

template <class Pose>
bool LoopJury<Pose>::JudgeAtFirst() {
  if (options_.robust.kernel != RobustKernel::kGnc) return false;
  const std::string why = WhyLoopsAreInDoubt(Remaining());
  return !why.empty() && Judge(why, {});
}

template <class Pose>
bool LoopJury<Pose>::JudgeBy(const CompactRun<Pose>& run) {
  return JudgeBy(run.slam, run.decisions, run.links_offered, run.links_refused);
}

template <class Pose>
bool LoopJury<Pose>::JudgeBy(const CompactPoseSlam<Pose>& map, const std::vector<Decision>& decisions, long offered,
                             long refused) {
  if (options_.robust.kernel != RobustKernel::kGnc) return false;
  const std::string of_all = " of " + std::to_string(offered) + " loops ";
  if (AreLoopsInDoubt(refused, offered)) {
    return Judge(std::to_string(refused) + of_all + "contradict the map", ValuesOf(map, graph_));
  }
  const std::vector<FactorId> strained = StrainedLoops(decisions, offered, graph_);
  return !strained.empty() &&
         Judge(std::to_string(strained.size()) + of_all + "bent the map as hardly one of them should",
               ValuesOf(map, graph_), strained);
}

template <class Pose>
bool LoopJury<Pose>::JudgeNextTo(const std::vector<Pose>& T_world_body, const std::vector<FactorId>& strained) {
  return options_.robust.kernel == RobustKernel::kGnc && Judge("", T_world_body, strained);
}

template <class Pose>
void LoopJury<Pose>::LeaveOut(std::vector<FactorId> loops) {
  if (loops == left_out_) return;
  left_out_ = std::move(loops);
  if (!scale_.IsOne()) {
    const InformationScale again = CalibrateInformation(WithoutFactors(graph_, left_out_)).scale;
    if (!again.IsOne()) scale_ = again;
  }
  Leave();
}

template <class Pose>
double LoopJury<Pose>::CostOf(const std::vector<Pose>& T_world_body) const {
  const PoseGraph<Pose> as_shown = ScaleInformation(graph_, scale_.IsOne() ? without_caution_ : scale_);
  const double width = std::sqrt(ChiSquareQuantile(RobustOptions().quantile, Pose::kDof));
  return internal::TruncatedCost(as_shown, T_world_body, LoopFactors(as_shown), width);
}

template <class Pose>
bool LoopJury<Pose>::Judge(const std::string& why, const std::vector<Pose>& first,
                           const std::vector<FactorId>& strained) {
  if (on_judging && !why.empty()) on_judging(why);
  const bool is_whole = left_out_.empty();  // what remains
  std::optional<PoseGraph<Pose>> scaled;
  if (!is_whole && !scale_.IsOne()) scaled = ScaleInformation(graph_, scale_);
  bool has_other_ids = !scale_.IsOne();  // a scaled graph numbers its factors by their place
  const PoseGraph<Pose>& whole = is_whole ? Remaining() : scaled ? *scaled : graph_;
  Explanation<Pose> best =
      BestExplanation(whole, first, has_other_ids ? IdsInScaled(graph_, strained) : strained, options_);
  if (scale_.IsOne() && !without_caution_.IsOne()) {
    const PoseGraph<Pose> strict = ScaleInformation(graph_, without_caution_);
    Explanation<Pose> stricter = BestExplanation(strict, first, IdsInScaled(graph_, strained), options_);
    const auto contradicted = [&](const Explanation<Pose>& by) {
      return CountContradicted(strict, by.T_world_body, stricter.left_out);
    };
    has_other_ids = contradicted(stricter) <= contradicted(best);
    if (has_other_ids) best = std::move(stricter);
  }
  std::vector<FactorId> found = std::move(best.contradicted);
  if (has_other_ids) {
    for (FactorId& id : found) id = graph_.Factors()[static_cast<std::size_t>(id.value)].id;
    std::sort(found.begin(), found.end());
  }
  if (found == left_out_) return false;
  LeaveOut(std::move(found));
  return true;
}

template <class Pose>
void LoopJury<Pose>::Leave() {
  remaining_.reset();
  if (!left_out_.empty()) remaining_ = WithoutFactors(graph_, left_out_);
  if (!scale_.IsOne()) remaining_ = ScaleInformation(Remaining(), scale_);
}

template <class Pose>
CompactRun<Pose> CompactGraph(LoopJury<Pose>& jury, CompactOptions<Pose> options, const AfterStep<Pose>& after_step) {
  const auto run_once = [&] {
    SampleThresholds(jury.Remaining(), options);
    return CompactGraph(jury.Remaining(), options, after_step);
  };
  jury.JudgeAtFirst();
  CompactRun<Pose> run = run_once();
  if (jury.JudgeBy(run)) run = run_once();
  run.loops_left_out = jury.LeftOut();
  run.information_scale = jury.Scale();
  return run;
}

#define TERSE_INSTANTIATE(Pose)                                                                                   \
  template std::string WhyLoopsAreInDoubt<Pose>(const PoseGraph<Pose>&);                                          \
  template std::vector<FactorId> StrainedLoops<Pose>(const std::vector<Decision>&, long, const PoseGraph<Pose>&); \
  template std::vector<FactorId> ContradictedLoops<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&,        \
                                                         BatchOptions);                                           \
  template class LoopJury<Pose>;                                                                                  \
  template CompactRun<Pose> CompactGraph<Pose>(LoopJury<Pose>&, CompactOptions<Pose>, const AfterStep<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
