#include "terse/compact/sparsify.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "dropped_poses.h"
#include "terse/compact/link_choice.h"
#include "terse/compact/marginal_divergence.h"
#include "terse/core/at.h"
#include "terse/core/batch_solver.h"
#include "terse/core/error.h"
#include "terse/core/parallel.h"

namespace terse {
namespace {

using internal::At;

class Stopwatch {
 public:
  double Lap() {
    const auto now = std::chrono::steady_clock::now();
    return std::chrono::duration<double>(now - std::exchange(since_, now)).count();
  }

 private:
  std::chrono::steady_clock::time_point since_ = std::chrono::steady_clock::now();
};

void CheckBudget(const std::optional<SparsifyBudget>& budget, const char* what) {
  if (!budget) return;
  const bool is_good = std::isfinite(budget->value) && budget->value >= 0 && (!budget->is_share || budget->value <= 1);
  if (!is_good)
    throw std::invalid_argument(std::string("the budget of ") + what + " is a share from 0 to 1 or a number");
}

template <class Pose>
void Check(const PoseGraph<Pose>& graph, const SparsifyOptions& options) {
  if (graph.Poses().empty()) throw std::invalid_argument("the graph is empty");
  CheckBudget(options.links, "links");
  CheckBudget(options.poses, "poses");
  if (options.threads < 1) throw std::invalid_argument("threads must be 1 or more");
  if (!options.budget_error) return;
  if (!(*options.budget_error >= 1)) throw std::invalid_argument("budget_error must be 1 or more");
  if (options.links) throw std::invalid_argument("links and budget_error exclude each other");
  if (options.criterion != SparsifyCriterion::kPosition)
    throw std::invalid_argument("budget_error is for the criterion of positions");
}

// Each connected part for itself, its own first pose where it is.
template <class Pose>
BatchResult<Pose> ToOptimum(const PoseGraph<Pose>& graph, const std::vector<Pose>* start, int threads) {
  BatchOptions options;
  options.threads = threads;
  const auto solve = [&](const PoseGraph<Pose>& part, const std::vector<Pose>* from) {
    auto result = from != nullptr ? SolveBatch(part, *from, options) : SolveBatch(part, options);
    const bool has_optimum =
        result.termination != Termination::kNotPositiveDefinite && result.termination != Termination::kDiverged;
    if (!has_optimum) throw NumericalError("the graph has no optimum: " + result.message);
    return result;
  };
  const auto parts = internal::SplitIntoParts(graph);
  if (parts.size() == 1) return solve(graph, start);
  BatchResult<Pose> all;
  all.T_world_body.resize(graph.Poses().size());
  for (const auto& part : parts) {
    std::vector<Pose> from;
    for (const auto& node : part.Poses()) {
      if (start != nullptr) from.push_back((*start)[At(graph.IndexOf(node.id))]);
    }
    const auto result = solve(part, start != nullptr ? &from : nullptr);
    for (std::size_t v = 0; v < part.Poses().size(); ++v)
      all.T_world_body[At(graph.IndexOf(part.Poses()[v].id))] = result.T_world_body[v];
    all.chi2 += result.chi2;
  }
  return all;
}

template <class Pose>
class Sparsification {
 public:
  Sparsification(const PoseGraph<Pose>& graph, const SparsifyOptions& options) : graph_(graph), options_(options) {}

  Sparsified<Pose> Run() {
    Stopwatch watch;
    Tell("optimum", 0);
    FindOptimum();
    out_.seconds.optimum = watch.Lap();
    PoseGraph<Pose> linked = KeepLinks();
    out_.seconds.links = watch.Lap();
    const auto optimum = ToOptimum<Pose>(linked, &out_.T_world_body_whole, options_.threads);
    linked.SetPoses(optimum.T_world_body);
    out_.T_world_body = optimum.T_world_body;
    out_.chi2 = optimum.chi2;
    out_.seconds.optimum += watch.Lap();
    DropPoses(linked);
    out_.seconds.poses = watch.Lap();
    return std::move(out_);
  }

 private:
  void Tell(const char* task, double share) const {
    if (options_.progress && !options_.progress(task, share)) throw StoppedError();
  }
  // Its factor is as large as any and not kept.
  void FindOptimum() {
    auto whole = ToOptimum<Pose>(graph_, nullptr, options_.threads);
    out_.T_world_body_whole = std::move(whole.T_world_body);
    out_.chi2_whole = whole.chi2;
  }
  internal::LinkChoice Choose(const internal::LinkSystem<Pose>& system);
  PoseGraph<Pose> KeepLinks();
  void DropPoses(const PoseGraph<Pose>& linked);

  const PoseGraph<Pose>& graph_;
  const SparsifyOptions& options_;
  Sparsified<Pose> out_;
  std::vector<FactorId> holding_;
};

template <class Pose>
internal::LinkChoice Sparsification<Pose>::Choose(const internal::LinkSystem<Pose>& system) {
  out_.links_at_least = static_cast<int>(std::count(system.in_tree.begin(), system.in_tree.end(), 1));
  const int links = static_cast<int>(system.links.size()) - out_.links_at_least;
  const auto whole = internal::TotalsOf(system, std::vector<char>(system.links.size(), 1));
  const auto error = [&](double total) { return std::sqrt(total / system.poses); };
  out_.expected_error_whole = error(whole.position);
  internal::ChoiceOptions choice;
  choice.links = options_.links ? options_.links->Of(links) : links;
  if (options_.budget_error) choice.most_total = whole.position * *options_.budget_error * *options_.budget_error;
  choice.criterion = options_.criterion;
  choice.seed = options_.seed;
  choice.parallel = options_.threads > 1;
  choice.progress = [this](double share) { return !options_.progress || options_.progress("links", share); };
  internal::LinkChoice chosen;
  if (choice.links == links && !choice.most_total) {
    chosen.kept.assign(system.links.size(), 1);
    chosen.worth.assign(system.links.size(), 0.0);
  } else if (choice.parallel) {
    internal::WithThreads(options_.threads, [&] { chosen = internal::ChooseLinks(system, choice); });
  } else {
    chosen = internal::ChooseLinks(system, choice);
  }
  const bool has_all = std::count(chosen.kept.begin(), chosen.kept.end(), 0) == 0;
  const auto kept = has_all ? whole : internal::TotalsOf(system, chosen.kept);
  out_.log_det_lost = whole.log_determinant - kept.log_determinant;
  out_.expected_error = error(kept.position);
  if (options_.criterion != SparsifyCriterion::kPosition)
    chosen.course = {{0, internal::TotalsOf(system, system.in_tree).position}, {choice.links, kept.position}};
  for (const auto& step : chosen.course) out_.course.push_back({step.links, error(step.total)});
  return chosen;
}

template <class Pose>
PoseGraph<Pose> Sparsification<Pose>::KeepLinks() {
  const auto system = internal::MakeLinkSystem(graph_, out_.T_world_body_whole, options_.fixed);
  holding_ = system.holding;
  const internal::LinkChoice chosen = Choose(system);
  out_.exchanges = chosen.exchanges;
  for (std::size_t k = 0; k < system.links.size(); ++k) {
    const auto ends = PosesOf(graph_.FindFactor(system.ids[k])->factor);
    out_.links.push_back({system.ids[k], ends.first, ends.second, chosen.kept[k] != 0, chosen.worth[k]});
  }
  PoseGraph<Pose> linked;
  for (const auto& node : graph_.Poses()) {
    linked.AddPose(node.id, out_.T_world_body_whole[At(graph_.IndexOf(node.id))]);
    if (node.fixed) linked.SetFixed(node.id, true);
  }
  auto link = out_.links.begin();
  for (const auto& node : graph_.Factors()) {
    if (link != out_.links.end() && link->id == node.id && !(link++)->kept) continue;
    Factor<Pose> factor = node.factor;
    auto* measured = std::get_if<RelativePoseFactor<Pose>>(&factor);
    if (options_.recentre && measured != nullptr) {
      measured->T_from_to = out_.T_world_body_whole[At(graph_.IndexOf(measured->from))].Inverse() *
                            out_.T_world_body_whole[At(graph_.IndexOf(measured->to))];
    }
    linked.AddFactor(factor, node.id);
  }
  return linked;
}

template <class Pose>
void Sparsification<Pose>::DropPoses(const PoseGraph<Pose>& linked) {
  const int poses = static_cast<int>(linked.Poses().size());
  internal::EliminationOptions elimination;
  elimination.recovered = options_.recovered;
  elimination.conservative = options_.conservative;
  elimination.least_kept = options_.poses ? options_.poses->Of(poses) : poses;
  elimination.progress = [&](int eliminated) {
    const double share = eliminated / std::max(1.0, static_cast<double>(poses - elimination.least_kept));
    return !options_.progress || options_.progress("poses", share);
  };
  internal::Elimination<Pose> eliminated;
  if (elimination.least_kept < poses) {
    eliminated = internal::EliminatePoses(linked, elimination);
  } else {
    eliminated.graph = linked;
  }
  if (eliminated.stopped) throw StoppedError();
  for (const auto& pose : eliminated.eliminated)
    out_.dropped.push_back({pose.pose, pose.loss, static_cast<int>(pose.neighbours.size())});
  out_.loss = eliminated.loss;
  out_.map = internal::MapOf(linked, eliminated, holding_, out_.T_world_body_whole);
  out_.graph = std::move(eliminated.graph);
  if (out_.dropped.empty()) return;
  out_.chi2 = Chi2(out_.graph);
  out_.divergence = internal::DivergenceFromMarginal(linked, out_.T_world_body, out_.graph);
}

}  // namespace

int SparsifyBudget::Of(int total) const {
  const double number = is_share ? value * total : value;
  return static_cast<int>(std::lround(std::min(number, static_cast<double>(total))));
}

template <class Pose>
Sparsified<Pose> Sparsify(const PoseGraph<Pose>& graph, const SparsifyOptions& options) {
  Check(graph, options);
  try {
    return Sparsification<Pose>(graph, options).Run();
  } catch (const internal::ChoiceStopped&) {
    throw StoppedError();
  }
}

template Sparsified<SE2> Sparsify(const PoseGraph<SE2>&, const SparsifyOptions&);
template Sparsified<SE3> Sparsify(const PoseGraph<SE3>&, const SparsifyOptions&);

}  // namespace terse
