#include "incremental/loop_selection.h"

#include <algorithm>
#include <iterator>
#include <stdexcept>
#include <utility>

#include "terse/core/at.h"
#include "terse/core/disjoint_sets.h"
#include "terse/core/error.h"
#include "terse/core/log_message.h"
#include "terse/core/open_loops.h"
#include "terse/core/replay.h"
#include "terse/core/supported_loops.h"

namespace terse::internal {
namespace {

using std::size_t;

// Between two looks at whether the caller wants to go on.
constexpr int kStepsBetweenProgress = 100;
// What is out but not by far may as well be the tail of true ones, as long as it is no more than this share of what is
// in.
constexpr double kTail = 0.01;

template <class Pose>
class Selector {
 public:
  static constexpr int B = Pose::kDof;
  using Selection = LoopSelection<Pose>;
  Selector(const PoseGraph<Pose>& graph, const BatchOptions& options, bool& is_stopped)
      : graph_(graph), options_(options), is_stopped_(is_stopped), loops_(LoopFactors(graph)) {}

  std::optional<Selection> SelectBorneOut() {
    LoopSupport support = FindSupport(graph_);
    if (!support.are_suspect) return std::nullopt;
    alone_ = std::move(support.unsupported);
    std::optional<Selection> first = Replayed(WithoutFactors(graph_, alone_));
    if (!first) return std::nullopt;
    const std::optional<Verdict> judged = Judge(*first);
    if (!judged) return std::nullopt;
    const Verdict& verdict = *judged;
    Log(options_.log, LogLevel::kInfo, "batch: ", alone_.size(), " of ", loops_.size(), " loops have no support; the ",
        "others explain ", verdict.explained, ", contradict ", verdict.wrong.size(), " of those, leave ", verdict.open,
        " open");
    if (2 * verdict.explained_alone >= verdict.explained) return std::nullopt;
    if (static_cast<double>(verdict.open) <= kTail * static_cast<double>(verdict.explained)) return first;
    std::optional<Selection> second = Replayed(WithoutFactors(graph_, verdict.wrong));
    if (is_stopped_) return std::nullopt;
    if (!second) return first;
    const double width = std::min(first->width, second->width);  // costs of different ones are not comparable
    return CostOf(*second, width) < CostOf(*first, width) ? std::move(second) : std::move(first);
  }
  std::optional<Selection> Select() { return Replayed(graph_); }

 private:
  // Of the loops at a map.
  struct Verdict {
    size_t explained = 0, explained_alone = 0;
    size_t open = 0;              // out, but not by far
    std::vector<FactorId> wrong;  // of those without support, by far
  };

  std::optional<Selection> Replayed(const PoseGraph<Pose>& part) {
    IncrementalOptions incremental;
    incremental.robust = options_.robust;
    incremental.threads = options_.threads;
    incremental.log = options_.log;
    IncrementalSolver<Pose> solver(incremental);
    try {
      Replay<Pose>(part, ReplayOptions(), solver, [&](const ReplayStep& step) {
        const bool asks = options_.progress && (step.index + 1) % kStepsBetweenProgress == 0;
        is_stopped_ = asks && !options_.progress(0, solver.Chi2());
        return !is_stopped_;
      });
      if (is_stopped_) return std::nullopt;
      BatchOptions finish = options_;
      finish.robust_factors.reset();
      finish.graduate = false;  // or it would select in turn
      BatchResult<Pose> result = solver.Finish(finish);
      OrderAsIn(part, ArrivalUnit::kPose, solver.Graph(), result);
      Selection selection{std::move(result.T_world_body), {}, result.robust_width};
      const std::vector<FactorId> slips = SlippedOdometry(part, result.weights);
      std::set_union(loops_.begin(), loops_.end(), slips.begin(), slips.end(),
                     std::back_inserter(selection.robust_factors));
      return selection;
    } catch (const NumericalError& error) {
      Log(options_.log, LogLevel::kInfo, "batch: no replay, ", error.what());
    } catch (const std::invalid_argument& error) {
      Log(options_.log, LogLevel::kInfo, "batch: no replay, ", error.what());
    }
    return std::nullopt;
  }

  // All loops, next to a selection, which comes to the optimum of those that are believed there; nothing if there is
  // none.
  std::optional<Verdict> Judge(Selection& selection) const {
    BatchOptions next_to = options_;
    next_to.graduate = false;
    next_to.robust.width = selection.width;
    next_to.robust_factors = selection.robust_factors;
    const BatchResult<Pose> solved = SolveWithOpenLoops<Pose>(
        graph_, selection.T_world_body, next_to,
        [](const auto& with, const auto& before) { return with.robust_cost < before.robust_cost; });
    if (solved.cholesky.Variables() == 0) return std::nullopt;  // singular
    selection.T_world_body = solved.T_world_body;
    Verdict out;
    const double by_far = kByFar * selection.width * selection.width;
    size_t k = 0;
    for (const auto& node : graph_.Factors()) {
      const double weight = solved.weights[k++];
      if (!std::binary_search(loops_.begin(), loops_.end(), node.id)) continue;
      const bool is_alone = std::binary_search(alone_.begin(), alone_.end(), node.id);
      if (weight > 0) {
        ++out.explained;
        out.explained_alone += is_alone;
      } else if (InnovationOf(std::get<RelativePoseFactor<Pose>>(node.factor), graph_, solved) <= by_far) {
        ++out.open;
      } else if (is_alone) {
        out.wrong.push_back(node.id);
      }
    }
    std::sort(out.wrong.begin(), out.wrong.end());
    return out;
  }

  double CostOf(const Selection& selection, double width) const {
    return TruncatedCost(graph_, selection.T_world_body, selection.robust_factors, width);
  }

  const PoseGraph<Pose>& graph_;
  const BatchOptions& options_;
  bool& is_stopped_;
  std::vector<FactorId> loops_, alone_;  // ascending
};

}  // namespace

template <class Pose>
bool IsConnected(const PoseGraph<Pose>& graph) {
  DisjointSets sets(graph.Poses().size());
  size_t joins = 0;
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    joins += ends.count == 2 && sets.Join(At(graph.IndexOf(ends.first)), At(graph.IndexOf(ends.second)));
  }
  return joins + 1 >= graph.Poses().size();
}

template <class Pose>
std::optional<LoopSelection<Pose>> SelectByReplay(const PoseGraph<Pose>& graph, const BatchOptions& options,
                                                  bool& is_stopped) {
  return Selector<Pose>(graph, options, is_stopped).Select();
}

template <class Pose>
std::optional<LoopSelection<Pose>> SelectBorneOut(const PoseGraph<Pose>& graph, const BatchOptions& options,
                                                  bool& is_stopped) {
  return Selector<Pose>(graph, options, is_stopped).SelectBorneOut();
}

#define TERSE_INSTANTIATE(Pose)                                                                                 \
  template std::optional<LoopSelection<Pose>> SelectByReplay<Pose>(const PoseGraph<Pose>&, const BatchOptions&, \
                                                                   bool&);                                      \
  template std::optional<LoopSelection<Pose>> SelectBorneOut<Pose>(const PoseGraph<Pose>&, const BatchOptions&, \
                                                                   bool&);                                      \
  template bool IsConnected<Pose>(const PoseGraph<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
