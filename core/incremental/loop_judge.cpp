#include "incremental/loop_judge.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "incremental/loop_contest.h"
#include "terse/core/front_paths.h"
#include "terse/core/graph_members.h"
#include "terse/core/log_message.h"
#include "terse/core/option_members.h"
#include "terse/core/residual.h"

namespace terse::internal {
namespace {

using std::size_t;

// Loops that are judged together; those that come back are judged so many in a step.
constexpr size_t kMostContested = 10, kMostRetried = 4;
constexpr int kMostRounds = 3;
// A loop is judged again when its chi2 has changed by this factor.
constexpr double kNews = 2;

}  // namespace

template <class Pose>
struct LoopJudge<Pose>::Loop {
  FactorId id;
  int slot;                // -1: out
  Matrix<B, B> W;          // without weight, as the next two
  LinearFactor<B> linear;  // at the linearisation points
  Vector<B> residual;      // at the estimate
  double weight = 1;       // that it is to have
  PathColumns<B> z;

  Loop(FactorId loop_id, const LinearizedGraph<Pose>& map) : id(loop_id), slot(map.SlotOf(loop_id)) {
    const auto& factor = map.Graph().FindFactor(id)->factor;
    const FactorPoses ends = PosesOf(factor);
    const int a = map.Graph().IndexOf(ends.first), b = map.Graph().IndexOf(ends.second);
    W = SquareRootInformation(factor);
    linear = Linearize(factor, W, a, b, map.Points()[static_cast<size_t>(a)], map.Points()[static_cast<size_t>(b)]);
    residual = W * Residual(factor, map.EstimateAt(a), map.EstimateAt(b));
  }
};

template <class Pose>
LoopJudge<Pose>::LoopJudge(const RobustOptions& options) : options_(options) {
  if (IsActive()) width_ = WidthOf(options, B);
}

template <class Pose>
void LoopJudge<Pose>::Resize(const Map& map) {
  const auto slots = static_cast<size_t>(map.Slots());
  if (IsActive() && slots_.size() < slots) slots_.resize(slots);
}

template <class Pose>
void LoopJudge<Pose>::Release(int slot) {
  if (!IsActive()) return;
  At(slot).is_loop = 0;
  At(slot).weight = 1;
}

// The weight that agrees with the residual that it leads to, found from that of the innovation.
template <class Pose>
double LoopJudge<Pose>::WeightOnArrival(Loop& loop, const Map& map) const {
  const RobustKernel kernel = options_.kernel;
  double weight = RobustWeight(kernel, loop.residual.squaredNorm(), width_);
  if (weight == 1) return weight;
  loop.z = SolveForward(map.Cholesky().Tree(), loop.linear);
  const Matrix<B, B> P = Gram<B>(loop.z, loop.z), I = Matrix<B, B>::Identity();
  weight = RobustWeight(kernel, loop.residual.dot((I + P).llt().solve(loop.residual)), width_);
  for (int k = 0; k < 20; ++k) {
    const Vector<B> r = (I + weight * P).llt().solve(loop.residual);
    weight = RobustWeight(kernel, r.squaredNorm(), width_);
  }
  return weight;
}

// In comes with its weight, out goes. False, and nothing changes, if the Cholesky factor does not take it.
template <class Pose>
bool LoopJudge<Pose>::Exchange(const Loops& in, const Loops& out, StepContext<Pose>& step) {
  std::vector<LinearFactor<B>> comes;
  for (const Loop& loop : in) {
    LinearFactor<B> f = loop.linear;
    const double root = std::sqrt(loop.weight);
    f.A_first *= root;
    f.A_second *= root;
    f.residual *= root;
    comes.push_back(f);
  }
  std::vector<int> goes;
  for (const Loop& loop : out) goes.push_back(loop.slot);
  const auto done = step.map.Exchange(comes, goes, step.report);
  if (!done.ok) return false;
  step.report.path = std::max(step.report.path, done.path);
  LogLoops(in, "in, weight ", step);
  LogLoops(out, "out, weight was ", step);
  for (const Loop& loop : out) {
    step.relinearization.Release(loop.slot);
    Release(loop.slot);
    step.map.Release(loop.id);
    Park(loop.id, loop.residual.squaredNorm());
  }
  for (size_t k = 0; k < in.size(); ++k) {
    const int slot = done.added_slots[k];
    step.map.Bind(slot, in[k].id, std::sqrt(in[k].weight) * in[k].W);
    Resize(step.map);
    At(slot).is_loop = 1;
    At(slot).weight = in[k].weight;
    At(slot).judged_chi2 = 0;
    Unpark(in[k].id);
  }
  step.relinearization.Resize(step.map);
  return true;
}

template <class Pose>
void LoopJudge<Pose>::LogLoops(const Loops& loops, const char* what, const StepContext<Pose>& step) const {
  if (!step.options.log) return;
  for (const Loop& loop : loops) {
    const FactorPoses ends = PosesOf(step.map.Graph().FindFactor(loop.id)->factor);
    const int slot = loop.slot;
    const double weight = slot >= 0 ? slots_[static_cast<size_t>(slot)].weight : loop.weight;
    Log(step.options.log, weight < 1 || slot >= 0 ? LogLevel::kInfo : LogLevel::kDebug, "step ", step.map.Updates(),
        ": loop ", ends.first.value, " - ", ends.second.value, " is ", what, weight, ", chi2 ",
        loop.residual.squaredNorm(), " (width^2 ", width_ * width_, ")");
  }
}

template <class Pose>
void LoopJudge<Pose>::Park(FactorId id, double chi2) {
  const auto it =
      std::lower_bound(parked_.begin(), parked_.end(), id, [](const Parked& p, FactorId x) { return p.id < x; });
  if (it != parked_.end() && it->id == id) {
    it->chi2 = chi2;
  } else {
    parked_.insert(it, {id, chi2});
  }
}

template <class Pose>
void LoopJudge<Pose>::Unpark(FactorId id) {
  const auto it =
      std::lower_bound(parked_.begin(), parked_.end(), id, [](const Parked& p, FactorId x) { return p.id < x; });
  if (it != parked_.end() && it->id == id) parked_.erase(it);
}

template <class Pose>
void LoopJudge<Pose>::Admit(UpdatePlan<Pose>& plan, StepContext<Pose>& step) {
  Loops loops;
  for (size_t k = 0; k < plan.is_loop.size(); ++k) {
    if (!plan.IsLoop(k)) continue;
    Park(step.report.factor_ids[k], std::numeric_limits<double>::infinity());
    loops.emplace_back(step.report.factor_ids[k], step.map);
  }
  if (loops.empty()) return;
  if (Chooses()) {
    AdmitLoops(loops, step);
  } else {
    for (Loop& loop : loops) loop.weight = WeightOnArrival(loop, step.map);
    Exchange(loops, {}, step);
  }
  for (const Loop& loop : loops) {
    const int slot = step.map.SlotOf(loop.id);
    if (slot >= 0) plan.changes.added.push_back(step.map.Cholesky().LinearFactorAt(slot));
  }
}

// kGnc: those that agree with the estimate at once, the others by a contest.
template <class Pose>
bool LoopJudge<Pose>::AdmitLoops(const Loops& loops, StepContext<Pose>& step) {
  bool changed = false;
  for (size_t first = 0; first < loops.size(); first += kMostContested) {
    Loops block(loops.begin() + static_cast<long>(first),
                loops.begin() + static_cast<long>(std::min(loops.size(), first + kMostContested)));
    const bool fits = std::all_of(block.begin(), block.end(),
                                  [&](const Loop& l) { return l.residual.squaredNorm() <= width_ * width_; });
    if (fits) {
      changed = Exchange(block, {}, step) || changed;
      continue;
    }
    const bool admitted = Judge(block, step);
    changed = changed || admitted;
    // The residuals that a contest compares are those of the minimum: others wait until that is found.
    if (admitted || block.size() > 1) continue;
    Loops contest = block;
    AddContestants(contest, step.map);
    Park(block[0].id, block[0].residual.squaredNorm());
    if (contest.size() > 1 && Judge(contest, step)) changed = true;
  }
  return changed;
}

// Whom it would move most if the loop were in, and who would be served. What is in may give way by little and still
// oppose: its conflict can be with the odometry between.
template <class Pose>
void LoopJudge<Pose>::AddContestants(Loops& contest, const Map& map) const {
  const Loop& loop = contest[0];
  const Matrix<B, B> S = Matrix<B, B>::Identity() + Gram<B>(loop.z, loop.z);
  const std::vector<double> x = SolveBackward<B>(map.Cholesky().Tree(), loop.z, S.llt().solve(loop.residual));
  const auto moved = [&](const LinearFactor<B>& f) { return ResidualChange(f, x); };
  std::vector<std::pair<double, FactorId>> against, along;
  for (const Parked& parked : parked_) {
    if (parked.id == loop.id) continue;
    const Loop other(parked.id, map);
    const double now = other.residual.squaredNorm(), after = (other.residual - moved(other.linear)).squaredNorm();
    if (after * kNews < now) along.emplace_back(after, parked.id);
  }
  if (along.empty()) return;  // one against another: who was first stays
  for (int slot = 0; slot < static_cast<int>(slots_.size()); ++slot) {
    if (!slots_[static_cast<size_t>(slot)].is_loop) continue;
    against.emplace_back(-moved(map.Cholesky().LinearFactorAt(slot)).squaredNorm(), map.IdAt(slot));
  }
  for (auto* side : {&against, &along}) {
    const auto kept = side->begin() + static_cast<long>(std::min(side->size(), kMostContested / 2));
    std::partial_sort(side->begin(), kept, side->end());
    side->erase(kept, side->end());
  }
  for (const auto* side : {&against, &along}) {
    for (const auto& entry : *side) contest.emplace_back(entry.second, map);
  }
}

// kGnc: which of these are in. True if that changed.
template <class Pose>
bool LoopJudge<Pose>::Judge(Loops& loops, StepContext<Pose>& step) {
  const auto n = static_cast<Eigen::Index>(loops.size());
  Eigen::VectorXd r(n * B), in(n * B);
  Eigen::MatrixXd P(n * B, n * B);
  std::vector<char> chosen(loops.size());
  for (Eigen::Index i = 0; i < n; ++i) {
    Loop& loop = loops[static_cast<size_t>(i)];
    if (loop.z.empty()) loop.z = SolveForward(step.map.Cholesky().Tree(), loop.linear);
    chosen[static_cast<size_t>(i)] = loop.slot >= 0;
    in.segment<B>(i * B).setConstant(loop.slot >= 0 ? 1 : 0);
    r.segment<B>(i * B) = loop.slot >= 0 ? step.map.LinearResidual(loop.slot) : loop.residual;
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
  std::vector<char> graduated = contest.Graduate(options_.gnc_step);
  const double cost = contest.Descend(chosen);
  if (contest.Descend(graduated) < cost - 1e-9 * width_ * width_) chosen = graduated;
  Loops comes, goes;
  for (size_t i = 0; i < loops.size(); ++i) {
    if (chosen[i] && loops[i].slot < 0) comes.push_back(loops[i]);
    if (!chosen[i] && loops[i].slot >= 0) goes.push_back(loops[i]);
    if (chosen[i] && loops[i].slot >= 0) At(loops[i].slot).judged_chi2 = loops[i].residual.squaredNorm();
  }
  return (!comes.empty() || !goes.empty()) && Exchange(comes, goes, step);
}

// The slots of the loops on poses that moved since they were looked at.
template <class Pose>
std::vector<int> LoopJudge<Pose>::TouchedLoops(Map& map) {
  std::vector<int> slots;
  for (const int v : map.TakeTouched()) {
    for (const int slot : map.Cholesky().SlotsOf(v)) {
      if (At(slot).is_loop && std::exchange(At(slot).is_listed, 1) == 0) slots.push_back(slot);
    }
  }
  for (const int slot : slots) At(slot).is_listed = 0;
  return slots;
}

// kGnc: loops that are in although the estimate contradicts them.
template <class Pose>
bool LoopJudge<Pose>::ReviewMembers(StepContext<Pose>& step) {
  std::vector<std::pair<double, int>> doubtful;
  for (const int slot : TouchedLoops(step.map)) {
    const double chi2 = step.map.LinearResidual(slot).squaredNorm();
    if (chi2 > std::max(width_ * width_, kNews * At(slot).judged_chi2)) doubtful.emplace_back(-chi2, slot);
  }
  if (doubtful.empty()) return false;
  std::sort(doubtful.begin(), doubtful.end());
  if (doubtful.size() > kMostContested) doubtful.resize(kMostContested);
  Loops loops;
  for (const auto& entry : doubtful) loops.emplace_back(step.map.IdAt(entry.second), step.map);
  return Judge(loops, step);
}

template <class Pose>
bool LoopJudge<Pose>::ReviewWeights(StepContext<Pose>& step) {
  Map& map = step.map;
  typename Map::Replacements replaced;
  const auto point = [&](int v) -> const Pose& { return map.Points()[static_cast<size_t>(v)]; };
  const double tolerated = step.options.reweigh_tolerance * map.CostUnit();
  for (const int slot : TouchedLoops(map)) {
    const double chi2 = map.Chi2Of(map.IdAt(slot)), weight = RobustWeight(options_.kernel, chi2, width_);
    if (std::abs(weight - At(slot).weight) * chi2 <= tolerated) continue;
    SetWeight(slot, weight, map);
    replaced.emplace_back(slot, map.LinearizeSlot(slot, point));
  }
  return !replaced.empty() && step.relinearization.MovePoints({}, replaced, map, step.options, step.report);
}

template <class Pose>
void LoopJudge<Pose>::SetWeight(int slot, double weight, Map& map) {
  At(slot).weight = weight;
  map.SetRoot(slot, std::sqrt(weight) * SquareRootInformation(map.Graph().FindFactor(map.IdAt(slot))->factor));
}

// kGnc: loops that are out and that the estimate has come closer to, the closest first.
template <class Pose>
bool LoopJudge<Pose>::RetryParked(StepContext<Pose>& step) {
  std::vector<std::pair<double, FactorId>> close;
  for (const Parked& parked : parked_) {
    const double chi2 = step.map.Chi2Of(parked.id);
    if (chi2 <= width_ * width_ || chi2 * kNews < parked.chi2) close.emplace_back(chi2, parked.id);
  }
  std::sort(close.begin(), close.end());
  if (close.size() > kMostRetried) close.resize(kMostRetried);
  for (const auto& [chi2, id] : close) {
    Park(id, chi2);
    if (AdmitLoops({Loop(id, step.map)}, step)) return true;
  }
  return false;
}

template <class Pose>
void LoopJudge<Pose>::Review(StepContext<Pose>& step) {
  if (!IsActive()) return;
  bool retry = Chooses() && !parked_.empty() && step.map.Updates() % step.options.relinearize_interval == 0;
  for (int round = 0; round < kMostRounds; ++round) {
    if (step.IsOverBudget()) return;
    bool changed = Chooses() ? ReviewMembers(step) : ReviewWeights(step);
    if (!changed && std::exchange(retry, false)) changed = RetryParked(step);
    if (!changed || step.options.carry == Carry::kPoint || !step.report.gate_open) return;
    BackSubstitute(std::nullopt, step);
  }
}

template <class Pose>
double LoopJudge<Pose>::RobustChi2(const Map& map) const {
  double sum = map.Chi2();
  const auto replace = [&](FactorId id) {
    const double chi2 = map.Chi2Of(id);
    sum += RobustCost(options_.kernel, chi2, width_) - chi2;
  };
  for (const Parked& parked : parked_) replace(parked.id);
  for (size_t slot = 0; slot < slots_.size(); ++slot) {
    if (slots_[slot].is_loop) replace(map.IdAt(static_cast<int>(slot)));
  }
  return sum;
}

template <class Pose>
double LoopJudge<Pose>::WeightOf(FactorId id, const Map& map) const {
  if (map.Graph().FindFactor(id) == nullptr) {
    throw std::invalid_argument("factor " + std::to_string(id.value) + " is not in the graph");
  }
  if (!IsActive()) return 1;
  const int slot = map.SlotOf(id);
  if (slot < 0) return 0;
  const OfSlot& known = slots_[static_cast<size_t>(slot)];
  return known.is_loop ? known.weight : 1;
}

template <class Pose>
BatchResult<Pose> LoopJudge<Pose>::SolveBatch(const Map& map, const std::vector<Pose>& T_world_body,
                                              BatchOptions options) const {
  if (!IsActive()) return terse::SolveBatch(map.Graph(), T_world_body, options);
  options.robust = options_;
  options.robust_factors.emplace();
  for (const Parked& parked : parked_) options.robust_factors->push_back(parked.id);
  for (size_t slot = 0; slot < slots_.size(); ++slot) {
    if (slots_[slot].is_loop) options.robust_factors->push_back(map.IdAt(static_cast<int>(slot)));
  }
  options.graduate = false;
  BatchResult<Pose> result = terse::SolveBatch(map.Graph(), T_world_body, options);
  if (!Chooses() || parked_.empty()) return result;
  options.graduate = true;
  BatchResult<Pose> graduated = terse::SolveBatch(map.Graph(), T_world_body, options);
  return graduated.robust_cost < result.robust_cost * (1 - 1e-9) ? graduated : result;
}

// Linear factors keep their points.
template <class Pose>
void LoopJudge<Pose>::TakeWeights(const std::vector<double>& weights, StepContext<Pose>& step) {
  if (!IsActive()) return;
  Loops in, out;
  size_t k = 0;
  for (const auto& node : step.map.Graph().Factors()) {
    const double weight = weights[k++];
    const int slot = step.map.SlotOf(node.id);
    if (slot >= 0 && !At(slot).is_loop) continue;
    if (!Chooses() && slot >= 0) {
      SetWeight(slot, weight, step.map);
      continue;
    }
    if (weight > 0 && slot < 0) in.emplace_back(node.id, step.map);
    if (weight == 0 && slot >= 0) out.emplace_back(node.id, step.map);
  }
  if (!in.empty() || !out.empty()) Exchange(in, out, step);
}

template <class Pose>
template <class Archive>
void LoopJudge<Pose>::Serialize(Archive& archive) {
  auto& [options, width, slots, parked] = *this;
  archive(options, width);
  archive.Each(slots, [&](OfSlot& slot) {
    auto& [is_loop, is_listed, weight, judged_chi2] = slot;
    archive(is_loop, is_listed, weight, judged_chi2);
  });
  archive.Each(parked, [&](Parked& loop) {
    auto& [id, chi2] = loop;
    archive(id, chi2);
  });
}

template <class Pose>
std::string LoopJudge<Pose>::FindStateDefect(const Map& map) const {
  if (slots_.size() != (IsActive() ? static_cast<size_t>(map.Slots()) : 0)) {
    return "lists by slot have different sizes";
  }
  size_t next = 0;
  for (const auto& node : map.Graph().Factors()) {
    if (map.SlotOf(node.id) >= 0) continue;
    if (next == parked_.size() || parked_[next].id != node.id) return "a measurement without a slot";
    ++next;
  }
  return next == parked_.size() ? "" : "a loop is out of the map that is not in the graph";
}

#define TERSE_INSTANTIATE(Pose)                                        \
  template class LoopJudge<Pose>;                                      \
  template void LoopJudge<Pose>::Serialize<StateWriter>(StateWriter&); \
  template void LoopJudge<Pose>::Serialize<StateReader>(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
