#include "terse/compact/judged_solve.h"

#include <algorithm>
#include <iterator>
#include <stdexcept>
#include <utility>
#include <vector>

#include "loops_of_run.h"
#include "terse/compact/contradicted_loops.h"
#include "terse/core/error.h"
#include "terse/core/residual.h"

namespace terse {
namespace {

// Loops that a compact map did not see, and those that it refused.
template <class Pose>
std::vector<FactorId> LeftOutOf(const CompactRun<Pose>& run, const PoseGraph<Pose>& graph) {
  const std::vector<FactorId> refused =
      LoopsOf(run.decisions, graph, [](const Candidate& link) { return link.outlier && !link.accepted; });
  std::vector<FactorId> out;
  std::set_union(refused.begin(), refused.end(), run.loops_left_out.begin(), run.loops_left_out.end(),
                 std::back_inserter(out));
  return out;
}

// As of the graph with those that were left out.
template <class Pose>
BatchResult<Pose> OfTheWhole(const PoseGraph<Pose>& graph, const std::vector<FactorId>& left_out,
                             BatchResult<Pose> without) {
  BatchResult<Pose> out = std::move(without);
  std::vector<double> weights;
  std::size_t k = 0;
  for (const auto& node : graph.Factors()) {
    const bool is_out = std::binary_search(left_out.begin(), left_out.end(), node.id);
    weights.push_back(is_out ? 0 : out.weights[k++]);
    if (!is_out) continue;
    const FactorPoses ends = PosesOf(node.factor);
    const auto value = [&](PoseId id) { return out.T_world_body[static_cast<std::size_t>(graph.IndexOf(id))]; };
    out.chi2 += FactorChi2(node.factor, value(ends.first), value(ends.second));
    out.robust_cost += out.robust_width * out.robust_width;
  }
  out.weights = std::move(weights);
  return out;
}

}  // namespace

template <class Pose>
BatchResult<Pose> JudgedAgain(const PoseGraph<Pose>& graph, BatchResult<Pose> result, const BatchOptions& options,
                              const std::function<void(const std::string& why)>& on_judging) {
  if (options.robust.kernel != RobustKernel::kGnc || result.cholesky.Variables() == 0 ||
      result.termination == Termination::kStopped) {
    return result;
  }
  const std::vector<FactorId> loops = LoopFactors(graph);
  std::vector<FactorId> believed;
  std::size_t k = 0;
  for (const auto& node : graph.Factors()) {
    if (result.weights[k++] >= 0.5 && std::binary_search(loops.begin(), loops.end(), node.id)) {
      believed.push_back(node.id);
    }
  }
  const long rejected = static_cast<long>(loops.size() - believed.size());
  if (!AreLoopsInDoubt(rejected, static_cast<long>(loops.size()))) return result;
  try {
    const InformationCalibration information = CalibrateInformation(graph);
    if (information.scale.IsOne() && information.without_caution.IsOne()) return result;
    if (on_judging) {
      on_judging(std::to_string(rejected) + " of " + std::to_string(loops.size()) + " loops contradict the map");
    }
    const CompactOptions<Pose> compact = OptionsFor<Pose>({RobustKernel::kGnc}, information);
    LoopJury<Pose> jury(graph, information, compact.solver.robust, options);
    const std::vector<FactorId> left_out = LeftOutOf(CompactGraph(jury, compact), graph);
    const bool are_believed = std::any_of(left_out.begin(), left_out.end(), [&](FactorId id) {
      return std::binary_search(believed.begin(), believed.end(), id);
    });
    if (!are_believed) return result;
    BatchResult<Pose> again = SolveBatch(WithoutFactors(graph, left_out), options);
    const bool is_solved = again.cholesky.Variables() > 0 && again.termination != Termination::kStopped;
    if (!is_solved || jury.CostOf(again.T_world_body) >= jury.CostOf(result.T_world_body)) return result;
    return OfTheWhole(graph, left_out, std::move(again));
  } catch (const NumericalError&) {  // what no compact map can be made of is not judged by one
    return result;
  } catch (const std::invalid_argument&) {
    return result;
  }
}

#define TERSE_INSTANTIATE(Pose)                                                                                \
  template BatchResult<Pose> JudgedAgain<Pose>(const PoseGraph<Pose>&, BatchResult<Pose>, const BatchOptions&, \
                                               const std::function<void(const std::string&)>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
