// Loops that may be wrong.
//
// Given everything else, the residual of a loop (whitened, n = that without the loop) and its covariance P = J Sigma J'
// say what any weight w would make of it: r(w) = (I + w P)^-1 n; the linearised cost would grow by n' (I + P)^-1 n, its
// innovation. Both come from one forward substitution along the paths of its poses, without touching the factor.
//
// kGnc minimises truncated least squares over which loops are in. A new loop, or one that the estimate contradicts, is
// judged together with those that oppose or support it: graduated non-convexity on their joint n and P, then single
// flips while these lower the cost. A loop that is out is no part of the factor.

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "cholesky/path_solve.h"
#include "incremental/incremental_plan.h"
#include "incremental/loop_contest.h"
#include "support/disjoint_sets.h"
#include "terse/core/log_message.h"
#include "terse/core/residual.h"

namespace terse {
namespace {

using internal::Contest;
using internal::Gram;
using internal::SolveBackward;
using internal::SolveForward;
using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }
constexpr size_t At(FactorId id) { return static_cast<size_t>(id.value); }

// Loops that are judged together; those that come back are judged so many in a step.
constexpr size_t kMostContested = 10, kMostRetried = 4;
constexpr int kMostRounds = 3;
// A loop is judged again when its chi2 has changed by this factor.
constexpr double kNews = 2;

}  // namespace

template <class Pose>
struct IncrementalSolver<Pose>::Loop {
  FactorId id;
  int slot = -1;           // -1: out of the factor
  Matrix<B, B> W;          // without weight, as the next two
  LinearFactor<B> linear;  // at the linearisation points
  Vector<B> residual;      // at the estimate
  double weight = 1;       // that it is to have
  internal::Columns<B> z;
};

// A loop joins poses that are joined already, by the graph or the factors before it.
template <class Pose>
void IncrementalSolver<Pose>::FindLoops(const GraphUpdate<Pose>& update, Plan& plan) const {
  const int old = static_cast<int>(graph_.Poses().size());
  internal::DisjointSets joined(update.poses.size() + 1);  // the last: what is there
  const auto set = [&](PoseId id) {
    const int index = plan.IndexOf(id, graph_);
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

template <class Pose>
typename IncrementalSolver<Pose>::Loop IncrementalSolver<Pose>::LoopOf(FactorId id) const {
  Loop loop;
  loop.id = id;
  loop.slot = slot_of_factor_[At(id)];
  const auto& factor = graph_.FindFactor(id)->factor;
  const FactorPoses ends = PosesOf(factor);
  const int a = graph_.IndexOf(ends.first), b = graph_.IndexOf(ends.second);
  loop.W = SquareRootInformation(factor);
  loop.linear = Linearize(factor, loop.W, a, b, linearization_points_[At(a)], linearization_points_[At(b)]);
  loop.residual = loop.W * Residual(factor, EstimateAt(a), EstimateAt(b));
  return loop;
}

template <class Pose>
double IncrementalSolver<Pose>::LoopChi2(FactorId id) const {
  const auto& factor = graph_.FindFactor(id)->factor;
  const FactorPoses ends = PosesOf(factor);
  return FactorChi2(factor, EstimateAt(graph_.IndexOf(ends.first)), EstimateAt(graph_.IndexOf(ends.second)));
}

// The weight that agrees with the residual that it leads to, found from that of the innovation.
template <class Pose>
double IncrementalSolver<Pose>::WeightOnArrival(Loop& loop) const {
  const RobustKernel kernel = options_.robust.kernel;
  double weight = RobustWeight(kernel, loop.residual.squaredNorm(), width_);
  if (weight == 1) return weight;
  loop.z = SolveForward(factor_, loop.linear);
  const Matrix<B, B> P = Gram<B>(loop.z, loop.z), I = Matrix<B, B>::Identity();
  weight = RobustWeight(kernel, loop.residual.dot((I + P).llt().solve(loop.residual)), width_);
  for (int k = 0; k < 20; ++k) {
    const Vector<B> r = (I + weight * P).llt().solve(loop.residual);
    weight = RobustWeight(kernel, r.squaredNorm(), width_);
  }
  return weight;
}

// In comes with its weight, out goes. False, and nothing changes, if the factor does not take it.
template <class Pose>
bool IncrementalSolver<Pose>::ChangeLoops(const Loops& in, const Loops& out, StepReport& report) {
  typename BlockCholesky<B>::Changes changes;
  for (const Loop& loop : in) {
    LinearFactor<B> f = loop.linear;
    const double root = std::sqrt(loop.weight);
    f.A_first *= root;
    f.A_second *= root;
    f.residual *= root;
    changes.added.push_back(f);
  }
  std::vector<LinearFactor<B>> gone;
  for (const Loop& loop : out) {
    changes.removed.push_back(loop.slot);
    gone.push_back(factor_.FactorAt(loop.slot));
  }
  const auto factored = UpdateFactor(changes, report);
  if (!factored.ok) return false;
  report.path = std::max(report.path, factored.path);
  LogLoops(in, "in, weight ");
  LogLoops(out, "out, weight was ");
  for (const auto& f : gone) ChangeCosts(f, -1);
  for (const auto& f : changes.added) ChangeCosts(f, 1);
  for (const Loop& loop : out) {
    ReleaseSlot(loop.id);
    Park(loop.id, loop.residual.squaredNorm());
  }
  for (size_t k = 0; k < in.size(); ++k) {
    const int slot = factored.added_slots[k];
    BindSlot(slot, in[k].id, std::sqrt(in[k].weight) * in[k].W);
    is_loop_[At(slot)] = 1;
    weight_of_slot_[At(slot)] = in[k].weight;
    judged_chi2_[At(slot)] = 0;
    Unpark(in[k].id);
  }
  return true;
}

template <class Pose>
void IncrementalSolver<Pose>::LogLoops(const Loops& loops, const char* what) const {
  if (!options_.log) return;
  for (const Loop& loop : loops) {
    const FactorPoses ends = PosesOf(graph_.FindFactor(loop.id)->factor);
    const int slot = loop.slot;
    const double weight = slot >= 0 ? weight_of_slot_[At(slot)] : loop.weight;
    internal::Log(options_.log, weight < 1 || slot >= 0 ? LogLevel::kInfo : LogLevel::kDebug, "step ", updates_,
                  ": loop ", ends.first.value, " - ", ends.second.value, " is ", what, weight, ", chi2 ",
                  loop.residual.squaredNorm(), " (width^2 ", width_ * width_, ")");
  }
}

template <class Pose>
void IncrementalSolver<Pose>::Park(FactorId id, double chi2) {
  const auto it =
      std::lower_bound(parked_.begin(), parked_.end(), id, [](const Parked& p, FactorId x) { return p.id < x; });
  if (it != parked_.end() && it->id == id) {
    it->chi2 = chi2;
  } else {
    parked_.insert(it, {id, chi2});
  }
}

template <class Pose>
void IncrementalSolver<Pose>::Unpark(FactorId id) {
  const auto it =
      std::lower_bound(parked_.begin(), parked_.end(), id, [](const Parked& p, FactorId x) { return p.id < x; });
  if (it != parked_.end() && it->id == id) parked_.erase(it);
}

template <class Pose>
void IncrementalSolver<Pose>::AdmitNewLoops(Plan& plan, StepReport& report) {
  Loops loops;
  for (size_t k = 0; k < plan.is_loop.size(); ++k) {
    if (!plan.IsLoop(k)) continue;
    Park(report.factor_ids[k], std::numeric_limits<double>::infinity());
    loops.push_back(LoopOf(report.factor_ids[k]));
  }
  if (loops.empty()) return;
  if (options_.robust.kernel == RobustKernel::kGnc) {
    AdmitLoops(loops, report);
  } else {
    for (Loop& loop : loops) loop.weight = WeightOnArrival(loop);
    ChangeLoops(loops, {}, report);
  }
  for (const Loop& loop : loops) {  // the gate counts what they bring
    const int slot = slot_of_factor_[At(loop.id)];
    if (slot >= 0) plan.changes.added.push_back(factor_.FactorAt(slot));
  }
}

// kGnc: those that agree with the estimate at once, the others by a contest.
template <class Pose>
bool IncrementalSolver<Pose>::AdmitLoops(const Loops& loops, StepReport& report) {
  bool changed = false;
  for (size_t first = 0; first < loops.size(); first += kMostContested) {
    Loops block(loops.begin() + static_cast<long>(first),
                loops.begin() + static_cast<long>(std::min(loops.size(), first + kMostContested)));
    const bool fits = std::all_of(block.begin(), block.end(),
                                  [&](const Loop& l) { return l.residual.squaredNorm() <= width_ * width_; });
    if (fits) {
      changed = ChangeLoops(block, {}, report) || changed;
      continue;
    }
    const bool admitted = JudgeLoops(block, report);
    changed = changed || admitted;
    // The residuals that a contest compares are those of the minimum: others wait until that is found.
    if (admitted || block.size() > 1) continue;
    Loops contest = block;
    AddContestants(contest);
    Park(block[0].id, block[0].residual.squaredNorm());
    if (contest.size() > 1 && JudgeLoops(contest, report)) changed = true;
  }
  return changed;
}

// Whom it would move most if the loop were in, and who would be served. What is in may give way by little and still
// oppose: its conflict can be with the odometry between.
template <class Pose>
void IncrementalSolver<Pose>::AddContestants(Loops& contest) const {
  const Loop& loop = contest[0];
  const Matrix<B, B> S = Matrix<B, B>::Identity() + Gram<B>(loop.z, loop.z);
  const std::vector<double> x = SolveBackward<B>(factor_, loop.z, S.llt().solve(loop.residual));
  const auto moved = [&](const LinearFactor<B>& f) -> Vector<B> {
    return f.A_first * Eigen::Map<const Vector<B>>(x.data() + At(f.first) * B) +
           f.A_second * Eigen::Map<const Vector<B>>(x.data() + At(f.second) * B);
  };
  std::vector<std::pair<double, FactorId>> against, along;
  for (const Parked& parked : parked_) {
    if (parked.id == loop.id) continue;
    const Loop other = LoopOf(parked.id);
    const double now = other.residual.squaredNorm(), after = (other.residual - moved(other.linear)).squaredNorm();
    if (after * kNews < now) along.emplace_back(after, parked.id);
  }
  if (along.empty()) return;  // one against another: who was first stays
  for (int slot = 0; slot < static_cast<int>(is_loop_.size()); ++slot) {
    if (!is_loop_[At(slot)]) continue;
    against.emplace_back(-moved(factor_.FactorAt(slot)).squaredNorm(), factor_of_slot_[At(slot)]);
  }
  for (auto* side : {&against, &along}) {
    const auto kept = side->begin() + static_cast<long>(std::min(side->size(), kMostContested / 2));
    std::partial_sort(side->begin(), kept, side->end());
    side->erase(kept, side->end());
  }
  for (const auto* side : {&against, &along}) {
    for (const auto& entry : *side) contest.push_back(LoopOf(entry.second));
  }
}

// At the present d.
template <class Pose>
Vector<Pose::kDof> IncrementalSolver<Pose>::LinearResidual(int slot) const {
  const LinearFactor<B>& f = factor_.FactorAt(slot);
  const std::vector<double>& d = factor_.Solution();
  return f.residual + f.A_first * Eigen::Map<const Vector<B>>(d.data() + At(f.first) * B) +
         f.A_second * Eigen::Map<const Vector<B>>(d.data() + At(f.second) * B);
}

// kGnc: which of these are in. True if that changed.
template <class Pose>
bool IncrementalSolver<Pose>::JudgeLoops(Loops& loops, StepReport& report) {
  const auto n = static_cast<Eigen::Index>(loops.size());
  Eigen::VectorXd r(n * B), in(n * B);
  Eigen::MatrixXd P(n * B, n * B);
  std::vector<char> chosen(loops.size());
  for (Eigen::Index i = 0; i < n; ++i) {
    Loop& loop = loops[static_cast<size_t>(i)];
    if (loop.z.empty()) loop.z = SolveForward(factor_, loop.linear);
    chosen[static_cast<size_t>(i)] = loop.slot >= 0;
    in.segment<B>(i * B).setConstant(loop.slot >= 0 ? 1 : 0);
    r.segment<B>(i * B) = loop.slot >= 0 ? LinearResidual(loop.slot) : loop.residual;
    for (Eigen::Index j = 0; j <= i; ++j) {
      P.block<B, B>(i * B, j * B) = Gram<B>(loop.z, loops[static_cast<size_t>(j)].z);
      if (j < i) P.block<B, B>(j * B, i * B) = P.block<B, B>(i * B, j * B).transpose();
    }
  }
  if (in.maxCoeff() > 0) {  // leave out what is in
    Eigen::MatrixXd M = -P * in.asDiagonal();
    M.diagonal().array() += 1;
    const Eigen::PartialPivLU<Eigen::MatrixXd> lu(M);
    r = lu.solve(r).eval();
    P = lu.solve(P).eval();
    P = ((P + P.transpose()) / 2).eval();
  }
  const Contest contest(std::move(r), std::move(P), B, width_);
  std::vector<char> graduated = contest.Graduate(options_.robust.gnc_step);
  const double cost = contest.Descend(chosen);
  if (contest.Descend(graduated) < cost - 1e-9 * width_ * width_) chosen = graduated;
  Loops comes, goes;
  for (size_t i = 0; i < loops.size(); ++i) {
    if (chosen[i] && loops[i].slot < 0) comes.push_back(loops[i]);
    if (!chosen[i] && loops[i].slot >= 0) goes.push_back(loops[i]);
    if (chosen[i] && loops[i].slot >= 0) judged_chi2_[At(loops[i].slot)] = loops[i].residual.squaredNorm();
  }
  return (!comes.empty() || !goes.empty()) && ChangeLoops(comes, goes, report);
}

// The slots of the loops on poses that moved since they were looked at.
template <class Pose>
std::vector<int> IncrementalSolver<Pose>::TouchedLoops() {
  std::vector<int> slots;
  for (const int v : touched_) {
    for (const int slot : factor_.SlotsOf(v)) {
      if (is_loop_[At(slot)] && std::exchange(is_listed_[At(slot)], 1) == 0) slots.push_back(slot);
    }
  }
  touched_.clear();
  for (const int slot : slots) is_listed_[At(slot)] = 0;
  return slots;
}

// kGnc: loops that are in although the estimate contradicts them.
template <class Pose>
bool IncrementalSolver<Pose>::ReviewMembers(StepReport& report) {
  std::vector<std::pair<double, int>> doubtful;
  for (const int slot : TouchedLoops()) {
    const double chi2 = LinearResidual(slot).squaredNorm();
    if (chi2 > std::max(width_ * width_, kNews * judged_chi2_[At(slot)])) doubtful.emplace_back(-chi2, slot);
  }
  if (doubtful.empty()) return false;
  std::sort(doubtful.begin(), doubtful.end());
  if (doubtful.size() > kMostContested) doubtful.resize(kMostContested);
  Loops loops;
  for (const auto& entry : doubtful) loops.push_back(LoopOf(factor_of_slot_[At(entry.second)]));
  return JudgeLoops(loops, report);
}

template <class Pose>
bool IncrementalSolver<Pose>::ReviewWeights(StepReport& report) {
  Replacements replaced;
  const auto point = [&](int v) -> const Pose& { return linearization_points_[At(v)]; };
  const double tolerated = options_.reweigh_tolerance * CostUnit();
  for (const int slot : TouchedLoops()) {
    const FactorId id = factor_of_slot_[At(slot)];
    const double chi2 = LoopChi2(id), weight = RobustWeight(options_.robust.kernel, chi2, width_);
    if (std::abs(weight - weight_of_slot_[At(slot)]) * chi2 <= tolerated) continue;
    SetWeight(slot, weight);
    replaced.emplace_back(slot, LinearizeSlot(slot, point));
  }
  return !replaced.empty() && Relinearize({}, std::move(replaced), report);
}

template <class Pose>
void IncrementalSolver<Pose>::SetWeight(int slot, double weight) {
  weight_of_slot_[At(slot)] = weight;
  W_of_slot_[At(slot)] =
      std::sqrt(weight) * SquareRootInformation(graph_.FindFactor(factor_of_slot_[At(slot)])->factor);
}

// kGnc: loops that are out and that the estimate has come closer to, the closest first.
template <class Pose>
bool IncrementalSolver<Pose>::RetryParked(StepReport& report) {
  std::vector<std::pair<double, FactorId>> close;
  for (const Parked& parked : parked_) {
    const double chi2 = LoopChi2(parked.id);
    if (chi2 <= width_ * width_ || chi2 * kNews < parked.chi2) close.emplace_back(chi2, parked.id);
  }
  std::sort(close.begin(), close.end());
  if (close.size() > kMostRetried) close.resize(kMostRetried);
  for (const auto& [chi2, id] : close) {
    Park(id, chi2);
    if (AdmitLoops({LoopOf(id)}, report)) return true;
  }
  return false;
}

template <class Pose>
void IncrementalSolver<Pose>::ReviewLoops(Clock::time_point start, StepReport& report) {
  const bool gnc = options_.robust.kernel == RobustKernel::kGnc;
  bool retry = gnc && !parked_.empty() && updates_ % options_.relinearize_interval == 0;
  for (int round = 0; round < kMostRounds; ++round) {
    const double seconds = std::chrono::duration<double>(Clock::now() - start).count();
    if (options_.budget_seconds > 0 && seconds > options_.budget_seconds) return;
    bool changed = gnc ? ReviewMembers(report) : ReviewWeights(report);
    if (!changed && std::exchange(retry, false)) changed = RetryParked(report);
    if (!changed || options_.carry == Carry::kPoint || !report.gate_open) return;
    BackSubstitute(std::nullopt, report);
  }
}

template <class Pose>
double IncrementalSolver<Pose>::RobustChi2() const {
  if (!IsRobust()) return Chi2();
  double sum = Chi2();
  const auto replace = [&](FactorId id) {
    const double chi2 = LoopChi2(id);
    sum += RobustCost(options_.robust.kernel, chi2, width_) - chi2;
  };
  for (const Parked& parked : parked_) replace(parked.id);
  for (size_t slot = 0; slot < is_loop_.size(); ++slot) {
    if (is_loop_[slot]) replace(factor_of_slot_[slot]);
  }
  return sum;
}

template <class Pose>
double IncrementalSolver<Pose>::WeightOf(FactorId id) const {
  if (graph_.FindFactor(id) == nullptr) {
    throw std::invalid_argument("factor " + std::to_string(id.value) + " is not in the graph");
  }
  if (!IsRobust()) return 1;
  const int slot = slot_of_factor_[At(id)];
  if (slot < 0) return 0;
  return is_loop_[At(slot)] ? weight_of_slot_[At(slot)] : 1;
}

template <class Pose>
BatchResult<Pose> IncrementalSolver<Pose>::SolveRobustBatch(const std::vector<Pose>& T_world_body,
                                                            BatchOptions options) const {
  options.robust = options_.robust;
  options.robust_factors.emplace();
  for (const Parked& parked : parked_) options.robust_factors->push_back(parked.id);
  for (size_t slot = 0; slot < is_loop_.size(); ++slot) {
    if (is_loop_[slot]) options.robust_factors->push_back(factor_of_slot_[slot]);
  }
  options.graduate = false;
  BatchResult<Pose> result = SolveBatch(graph_, T_world_body, options);
  if (options.robust.kernel != RobustKernel::kGnc || parked_.empty()) return result;
  options.graduate = true;
  BatchResult<Pose> graduated = SolveBatch(graph_, T_world_body, options);
  return graduated.robust_cost < result.robust_cost * (1 - 1e-9) ? graduated : result;
}

// By position in the graph's factors. Linear factors keep their points.
template <class Pose>
void IncrementalSolver<Pose>::TakeWeights(const std::vector<double>& weights) {
  Loops in, out;
  size_t k = 0;
  for (const auto& node : graph_.Factors()) {
    const double weight = weights[k++];
    const int slot = slot_of_factor_[At(node.id)];
    if (slot >= 0 && !is_loop_[At(slot)]) continue;
    if (options_.robust.kernel != RobustKernel::kGnc && slot >= 0) {
      SetWeight(slot, weight);
      continue;
    }
    if (weight > 0 && slot < 0) in.push_back(LoopOf(node.id));
    if (weight == 0 && slot >= 0) out.push_back(LoopOf(node.id));
  }
  StepReport report;
  if (!in.empty() || !out.empty()) ChangeLoops(in, out, report);
}

#define TERSE_INSTANTIATE(Pose)                                                                                       \
  template void IncrementalSolver<Pose>::FindLoops(const GraphUpdate<Pose>&, Plan&) const;                            \
  template void IncrementalSolver<Pose>::Unpark(FactorId);                                                            \
  template void IncrementalSolver<Pose>::AdmitNewLoops(Plan&, StepReport&);                                           \
  template void IncrementalSolver<Pose>::ReviewLoops(Clock::time_point, StepReport&);                                 \
  template double IncrementalSolver<Pose>::RobustChi2() const;                                                        \
  template double IncrementalSolver<Pose>::WeightOf(FactorId) const;                                                  \
  template BatchResult<Pose> IncrementalSolver<Pose>::SolveRobustBatch(const std::vector<Pose>&, BatchOptions) const; \
  template void IncrementalSolver<Pose>::TakeWeights(const std::vector<double>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
