// What an update brings: checked, given initial values, linearised.

#include "incremental/update_plan.h"

#include <algorithm>
#include <limits>
#include <set>
#include <stdexcept>

#include "terse/core/at.h"
#include "terse/core/disjoint_sets.h"
#include "terse/core/pose_name.h"

namespace terse::internal {
namespace {

using std::size_t;

template <class Pose>
void Validate(const GraphUpdate<Pose>& update, const PoseGraph<Pose>& graph) {
  std::set<PoseId> fresh;
  for (const auto& pose : update.poses) {
    if (graph.HasPose(pose.id) || !fresh.insert(pose.id).second) {
      throw std::invalid_argument(Name(pose.id) + " is in the graph already");
    }
  }
  for (const auto& factor : update.factors) {
    const FactorPoses ends = PosesOf(factor);
    for (const PoseId id : {ends.first, ends.second}) {
      if (!graph.HasPose(id) && fresh.count(id) == 0) {
        throw std::invalid_argument(Name(id) + " is not in the graph");
      }
    }
    const std::string defect = FindDefect(factor);
    if (!defect.empty()) throw std::invalid_argument(defect);
  }
  if (!update.factor_ids.empty()) {
    if (update.factor_ids.size() != update.factors.size()) throw std::invalid_argument("not one id per factor");
    FactorId least = graph.NextFactorId();
    for (const FactorId id : update.factor_ids) {
      if (id < least) throw std::invalid_argument("the id " + std::to_string(id.value) + " of a factor is taken");
      if (id.value == std::numeric_limits<std::int64_t>::max())
        throw std::invalid_argument("no id follows that of a factor");
      least = {id.value + 1};
    }
  }
  std::set<FactorId> removed;
  for (const auto& pose : update.poses) {
    const bool finite = !pose.T_world_body || IsFinite(*pose.T_world_body);
    if (!finite) throw std::invalid_argument(Name(pose.id) + " has a value that is not finite");
    if (pose.fixed && !pose.T_world_body) {
      throw std::invalid_argument(Name(pose.id) + " is fixed but has no value");
    }
  }
  for (const FactorId id : update.removed) {
    if (graph.FindFactor(id) == nullptr || !removed.insert(id).second) {
      throw std::invalid_argument("factor " + std::to_string(id.value) + " is not in the graph");
    }
  }
}

// Values for the new poses: their own, or composed along the first factor that leads to a pose with one.
template <class Pose>
void PlanNewPoses(const GraphUpdate<Pose>& update, const LinearizedGraph<Pose>& map, UpdatePlan<Pose>& plan) {
  std::vector<std::optional<Pose>> value(update.poses.size());
  const int old = static_cast<int>(map.Graph().Poses().size());
  for (size_t k = 0; k < update.poses.size(); ++k) {
    plan.new_index[update.poses[k].id] = old + static_cast<int>(k);
    value[k] = update.poses[k].T_world_body;
  }
  const auto known = [&](PoseId id) -> std::optional<Pose> {
    const int index = plan.IndexOf(id, map.Graph());
    return index < old ? std::optional<Pose>(map.EstimateAt(index)) : value[At(index - old)];
  };
  const auto offer = [&](PoseId id, const Pose& T_world_body) {
    auto& slot = value[At(plan.new_index.at(id) - old)];
    if (!slot) slot = T_world_body;
  };
  for (const auto& factor : update.factors) {
    if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor)) {
      if (plan.new_index.count(f->pose) != 0) offer(f->pose, f->T_world_body);
    }
  }
  const auto has_value = [](const std::optional<Pose>& v) { return v.has_value(); };
  if (old == 0 && !value.empty() && std::none_of(value.begin(), value.end(), has_value)) value[0] = Pose();
  // Breadth first over the update's edges, from what is known.
  std::vector<std::vector<const RelativePoseFactor<Pose>*>> edges(value.size());
  std::vector<const RelativePoseFactor<Pose>*> ready;
  for (const auto& factor : update.factors) {
    const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor);
    if (f == nullptr) continue;
    for (const PoseId id : {f->from, f->to}) {
      const auto it = plan.new_index.find(id);
      if (it != plan.new_index.end()) edges[At(it->second - old)].push_back(f);
    }
    if (known(f->from).has_value() != known(f->to).has_value()) ready.push_back(f);
  }
  for (size_t k = 0; k < ready.size(); ++k) {
    const RelativePoseFactor<Pose>& f = *ready[k];
    const std::optional<Pose> from = known(f.from), to = known(f.to);
    if (from && to) continue;
    const PoseId reached = from ? f.to : f.from;
    offer(reached, from ? *from * f.T_from_to : *to * f.T_from_to.Inverse());
    const auto& onward = edges[At(plan.new_index.at(reached) - old)];
    ready.insert(ready.end(), onward.begin(), onward.end());
  }
  for (size_t k = 0; k < value.size(); ++k) {
    if (!value[k]) {
      throw std::invalid_argument(Name(update.poses[k].id) + " has no value and no factor to a pose that has one");
    }
    plan.new_values.push_back(*value[k]);
  }
}

// A loop joins poses that are joined already, by the graph or the factors before it.
template <class Pose>
void FindLoops(const GraphUpdate<Pose>& update, const PoseGraph<Pose>& graph, UpdatePlan<Pose>& plan) {
  const int old = static_cast<int>(graph.Poses().size());
  DisjointSets joined(update.poses.size() + 1);  // the last: what is there
  const auto set = [&](PoseId id) {
    const int index = plan.IndexOf(id, graph);
    return index < old ? update.poses.size() : At(index - old);
  };
  plan.is_loop.assign(update.factors.size(), 0);
  std::vector<char> is_odometry(update.factors.size(), 0);
  for (const size_t k : update.odometry) {
    const FactorPoses ends = PosesOf(update.factors[k]);
    is_odometry[k] = 1;
    if (ends.count == 2) joined.Join(set(ends.first), set(ends.second));
  }
  for (size_t k = 0; k < update.factors.size(); ++k) {
    const FactorPoses ends = PosesOf(update.factors[k]);
    if (is_odometry[k] == 0 && ends.count == 2)
      plan.is_loop[k] = joined.Join(set(ends.first), set(ends.second)) ? 0 : 1;
  }
}

// Loops that agree with the estimate as it is come in with the update, the others are to be judged.
template <class Pose>
void ScreenLoops(const GraphUpdate<Pose>& update, const LinearizedGraph<Pose>& map, RobustKernel kernel, double width,
                 UpdatePlan<Pose>& plan) {
  const int old = static_cast<int>(map.Graph().Poses().size());
  const auto estimate = [&](PoseId id) {
    const int v = plan.IndexOf(id, map.Graph());
    if (v >= old) return plan.new_values[At(v - old)];
    return plan.moved_points.empty() ? map.EstimateAt(v) : plan.moved_points[At(v)];
  };
  plan.waits = plan.is_loop;
  for (size_t k = 0; k < update.factors.size(); ++k) {
    if (!plan.IsLoop(k)) continue;
    const FactorPoses ends = PosesOf(update.factors[k]);
    const Vector<Pose::kDof> r = SquareRootInformation(update.factors[k]) *
                                 Residual(update.factors[k], estimate(ends.first), estimate(ends.second));
    if (RobustWeight(kernel, r.squaredNorm(), width) == 1) plan.waits[k] = 0;
  }
}

// New factors, linearised where their poses are.
template <class Pose>
void PlanFactors(const GraphUpdate<Pose>& update, const LinearizedGraph<Pose>& map, UpdatePlan<Pose>& plan) {
  const int old = static_cast<int>(map.Graph().Poses().size());
  const std::vector<Pose>& points = plan.moved_points.empty() ? map.Points() : plan.moved_points;
  const auto point = [&](int v) -> const Pose& { return v < old ? points[At(v)] : plan.new_values[At(v - old)]; };
  for (size_t k = 0; k < update.factors.size(); ++k) {
    const Factor<Pose>& factor = update.factors[k];
    const FactorPoses ends = PosesOf(factor);
    const int first = plan.IndexOf(ends.first, map.Graph()), second = plan.IndexOf(ends.second, map.Graph());
    plan.W.push_back(SquareRootInformation(factor));
    plan.only_relative = plan.only_relative && ends.count == 2;
    if (plan.Waits(k)) continue;
    plan.changes.added.push_back(Linearize(factor, plan.W.back(), first, second, point(first), point(second)));
  }
  for (size_t k = 0; k < update.poses.size(); ++k) {
    if (!update.poses[k].fixed) continue;
    const int index = old + static_cast<int>(k);
    const Pose& T = plan.new_values[k];
    plan.changes.added.push_back(Linearize<Pose>(FixedPosePrior<Pose>(update.poses[k].id, T), index, index, T, T));
  }
  for (const FactorId id : update.removed) {
    if (map.SlotOf(id) >= 0) plan.changes.removed.push_back(map.SlotOf(id));
  }
  plan.changes.new_variables = static_cast<int>(update.poses.size());
}

// Behind the others: PlanFrame has found the gauge.
template <class Pose>
void PlanAnchor(const GraphUpdate<Pose>& update, const LinearizedGraph<Pose>& map, UpdatePlan<Pose>& plan) {
  if (map.AnchorSlot() < 0) {
    plan.adds_anchor = !map.Graph().Poses().empty() || !update.poses.empty();
    if (plan.adds_anchor) plan.changes.added.push_back(Anchor(plan.frame.gauge));
  } else if (plan.frame.gauge.root != map.Frame().gauge.root) {
    plan.changes.replaced.emplace_back(map.AnchorSlot(), Anchor(plan.frame.gauge));
  }
}

}  // namespace

template <class Pose>
UpdatePlan<Pose> PlanUpdate(const GraphUpdate<Pose>& update, const LinearizedGraph<Pose>& map,
                            const IncrementalOptions& options, double width) {
  Validate(update, map.Graph());
  UpdatePlan<Pose> plan;
  PlanNewPoses(update, map, plan);
  PlanFrame(update, map, options, plan);
  if (options.robust.kernel != RobustKernel::kNone) {
    FindLoops(update, map.Graph(), plan);
    ScreenLoops(update, map, options.robust.kernel, width, plan);
  }
  PlanFactors(update, map, plan);
  PlanAnchor(update, map, plan);
  return plan;
}

#define TERSE_INSTANTIATE(Pose)                                                                \
  template UpdatePlan<Pose> PlanUpdate(const GraphUpdate<Pose>&, const LinearizedGraph<Pose>&, \
                                       const IncrementalOptions&, double);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
