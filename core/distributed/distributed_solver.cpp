#include "terse/distributed/distributed_solver.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "distributed/petsc_system.h"
#include "support/stopwatch.h"
#include "terse/core/gauge.h"
#include "terse/core/linear_factor.h"
#include "terse/core/pose_numbers.h"
#include "terse/core/residual.h"

namespace terse {
namespace {

using internal::PetscSystem;
using internal::ScopedTimer;

// A start rests when a step is predicted to lower its cost by less than this share of it.
constexpr double kRest = 1e-2;

// One solver run on one rank.
template <class Pose>
class DistributedRun {
 public:
  static constexpr int B = Pose::kDof;

  DistributedRun(MPI_Comm ranks, const GraphShare<Pose>& share, const DistributedOptions& options)
      : ranks_(ranks),
        share_(share),
        options_(options),
        system_(ranks, B, share.begin, share.end, NeighboursOf(share)) {
    for (const auto& term : share.relative) W_.push_back(SquareRootInformation(term.factor));
  }

  DistributedResult<Pose> Execute(std::vector<std::vector<Pose>> starts) && {
    for (auto& values : starts) Enter(std::move(values));
    run_ = &runs_[Choose()];
    while (!run_->done && run_->trial.iterations < options_.max_iterations) TakeStep();
    result_.start = static_cast<int>(run_ - runs_.data());
    for (const Run& run : runs_) result_.trials.push_back(run.trial);
    result_.termination = run_->termination;
    result_.iterations = run_->trial.iterations;
    result_.chi2 = run_->chi2;
    result_.T_world_body = std::move(run_->values);
    if (!options_.covariances_of.empty()) SolveForCovariances();
    return std::move(result_);
  }

 private:
  using Block = Eigen::Matrix<double, B, B, Eigen::RowMajor>;  // as PETSc reads them

  // From one start.
  struct Run {
    StartTrial trial;
    std::vector<Pose> values;
    double chi2 = 0;  // the cost is trial.cost
    bool rests = false, done = false;
    Termination termination = Termination::kMaxIterations;
  };

  void Enter(std::vector<Pose> values) {
    Run run;
    double cost = 0;
    run.chi2 = Cost(values, cost);
    run.values = std::move(values);
    run.trial.cost_at_start = run.trial.cost = cost;
    if (!std::isfinite(cost)) run.trial.unavailable = "chi2 is not finite at the initial values";
    runs_.push_back(std::move(run));
  }

  // A start whose system cannot be solved is none; all ranks find that together.
  void TakeRound(Run& run, int steps) {
    run_ = &run;
    try {
      for (int k = 0; k < steps && !run.done && run.trial.iterations < options_.max_iterations; ++k) TakeStep();
    } catch (const RankError& error) {
      if (error.Cause() != RankError::Kind::kNumerical) throw;
      run.trial.unavailable = error.what();
    }
  }

  // The index of the start that goes on; as ChooseStart (start_values.h), in one round.
  std::size_t Choose() {
    constexpr int kRound = 3;
    constexpr double kNear = 10, kSame = 1e-9;
    std::vector<std::size_t> order;
    for (std::size_t k = 0; k < runs_.size(); ++k) {
      if (runs_[k].trial.unavailable.empty()) order.push_back(k);
    }
    if (order.empty()) throw RankError(RankError::Kind::kNumerical, "chi2 is not finite at the initial values");
    const auto is_lower = [&](std::size_t a, std::size_t b) { return runs_[a].trial.cost < runs_[b].trial.cost; };
    std::stable_sort(order.begin(), order.end(), is_lower);
    for (std::size_t k = 0; k < order.size() && order.size() > 1; ++k) {
      const StartTrial& first = runs_[order[0]].trial;
      // Where the first came to rest near where it set off, those above would have to fall further than it did.
      const bool is_first_settled = k > 0 && runs_[order[0]].rests && first.cost_at_start <= kNear * first.cost;
      if (is_first_settled && runs_[order[k]].trial.cost_at_start > kNear * first.cost) break;
      TakeRound(runs_[order[k]], kRound);
    }
    order.erase(
        std::remove_if(order.begin(), order.end(), [&](std::size_t k) { return !runs_[k].trial.unavailable.empty(); }),
        order.end());
    if (order.empty()) throw RankError(RankError::Kind::kNumerical, runs_.front().trial.unavailable);
    // Of those that are the same to rounding the one that set off lowest.
    const double lowest = runs_[*std::min_element(order.begin(), order.end(), is_lower)].trial.cost;
    const std::size_t chosen = *std::find_if(
        order.begin(), order.end(), [&](std::size_t k) { return runs_[k].trial.cost <= (1 + kSame) * lowest; });
    for (std::size_t k = 0; k < runs_.size(); ++k) {
      if (k != chosen) runs_[k].values = {};
    }
    return chosen;
  }

  const Pose& ValueOf(const std::vector<Pose>& values, int pose) const {
    return values[static_cast<std::size_t>(pose)];
  }

  double TermChi2(const ShareTerm<Pose>& term, const std::vector<Pose>& values) const {
    return FactorChi2(term.factor, ValueOf(values, term.first), ValueOf(values, term.second));
  }

  // chi2, and in `cost` what FIXed poses away from their values add to it. Every term counts where its first pose is.
  double Cost(const std::vector<Pose>& values, double& cost) {
    ScopedTimer timer(result_.seconds.linearise);
    double sums[2] = {0, 0};
    for (const auto* terms : {&share_.relative, &share_.absolute, &share_.fixed}) {
      for (const auto& term : *terms) {
        if (share_.Owns(term.first)) sums[terms == &share_.fixed] += TermChi2(term, values);
      }
    }
    MPI_Allreduce(MPI_IN_PLACE, sums, 2, MPI_DOUBLE, MPI_SUM, ranks_);
    cost = sums[0] + sums[1];
    return sums[0];
  }

  // Into own rows alone: a measurement with an end elsewhere is linearised there too.
  void Add(const LinearFactor<B>& f) {
    const auto row = [&](int row, const Matrix<B, B>& A_row, int other, const Matrix<B, B>& A_other) {
      if (!share_.Owns(row)) return;
      const Block diagonal = A_row.transpose() * A_row;
      system_.AddBlock(row, row, diagonal.data());
      const Vector<B> right = -A_row.transpose() * f.residual;
      system_.AddRight(row, right.data());
      if (other < 0) return;
      const Block side = A_row.transpose() * A_other;
      system_.AddBlock(row, other, side.data());
    };
    row(f.first, f.A_first, f.second, f.A_second);
    if (f.second >= 0) row(f.second, f.A_second, f.first, f.A_first);
  }

  void Assemble(const std::vector<Pose>& values) {
    ScopedTimer timer(result_.seconds.linearise);
    system_.SetZero();
    for (std::size_t k = 0; k < share_.relative.size(); ++k) {
      const auto& term = share_.relative[k];
      Add(Linearize(term.factor, W_[k], term.first, term.second, ValueOf(values, term.first),
                    ValueOf(values, term.second)));
    }
    // What the absolute measurements leave free the anchor holds: every rank finds the same.
    AbsoluteInformation<Pose> absolute;
    for (const auto* terms : {&share_.fixed, &share_.absolute}) {
      for (const auto& term : *terms) {
        const Pose& value = ValueOf(values, term.first);
        absolute.Add(term.factor, value);
        if (share_.Owns(term.first)) Add(Linearize(term.factor, term.first, -1, value, value));
      }
    }
    if (share_.Owns(0)) Add(Anchor(absolute.FindGauge(values.front())));
    system_.FinishAssembly();
    if (system_.IsIterative()) system_.SetNearNullSpace(RigidMotions(values));
  }

  // Of the map as a whole, in the tangent directions of own poses: Exp(xi) T = T Exp(Ad(T^-1) xi).
  std::vector<std::vector<double>> RigidMotions(const std::vector<Pose>& values) const {
    std::vector<std::vector<double>> motions(B);
    for (int pose = share_.begin; pose < share_.end; ++pose) {
      const Matrix<B, B> A = ValueOf(values, pose).Inverse().Adjoint();
      for (int k = 0; k < B; ++k) {
        for (int i = 0; i < B; ++i) motions[static_cast<std::size_t>(k)].push_back(A(i, k));
      }
    }
    return motions;
  }

  void Factorise(const std::vector<Pose>& values) {
    Assemble(values);
    ScopedTimer timer(result_.seconds.factor);
    system_.Factor();
  }

  void TakeStep() {
    Run& run = *run_;
    ++run.trial.iterations;
    Factorise(run.values);
    std::vector<double> d;
    {
      ScopedTimer timer(result_.seconds.solve);
      d = system_.Solve();
    }
    const double before = run.trial.cost, predicted = system_.Decrement();
    // chi2 has no unit: below the constant it is rounding.
    const double tolerance = options_.relative_tolerance * before + 1e-16;
    const bool is_small = predicted <= tolerance;
    run.rests = predicted <= kRest * before;
    run.termination = Termination::kStalled;
    run.done = true;
    // Along the step until chi2 has fallen by a part of what its slope promises (Armijo).
    constexpr double kPart = 1e-4;
    constexpr int kMostHalvings = 30;
    double scale = 1;
    for (int halving = 0; halving <= kMostHalvings; ++halving, scale /= 2) {
      std::vector<Pose> trial = Moved(run.values, d, scale);
      double cost = 0;
      const double chi2 = Cost(trial, cost);
      const double decrease = before - cost;
      // Near the optimum chi2 is rounding, and the step is better than it.
      const bool is_last = is_small && scale == 1 && decrease >= -tolerance;
      if (!std::isfinite(cost) || !(decrease >= kPart * scale * predicted || is_last)) continue;
      run.values = std::move(trial);
      run.chi2 = chi2;
      run.trial.cost = cost;
      run.done = is_small || (scale == 1 && decrease <= tolerance);
      run.termination = run.done ? Termination::kConverged : Termination::kMaxIterations;
      break;
    }
    if (options_.progress) options_.progress(++steps_, run.chi2);
  }

  static std::vector<Pose> Moved(std::vector<Pose> values, const std::vector<double>& d, double scale) {
    for (std::size_t v = 0; v < values.size(); ++v) {
      values[v] = values[v].Retract(scale * Eigen::Map<const Vector<B>>(d.data() + v * B));
    }
    return values;
  }

  void SolveForCovariances() {
    Factorise(result_.T_world_body);
    ScopedTimer timer(result_.seconds.solve);
    for (const int pose : options_.covariances_of) {
      Matrix<B, B> covariance;
      for (int k = 0; k < B; ++k) {
        const std::vector<double> column = system_.InverseColumn(static_cast<PetscInt>(pose) * B + k);
        covariance.col(k) = Eigen::Map<const Vector<B>>(column.data());
      }
      result_.covariances.push_back((covariance + covariance.transpose()) / 2);
    }
  }

  MPI_Comm ranks_;
  const GraphShare<Pose>& share_;
  const DistributedOptions& options_;
  PetscSystem system_;
  std::vector<Matrix<B, B>> W_;  // of the relative measurements
  std::vector<Run> runs_;
  Run* run_ = nullptr;  // whose steps are taken
  int steps_ = 0;
  DistributedResult<Pose> result_;
};

// All ranks, the first too, make their poses of numbers, so that they are the same to the last bit.
SE2 PoseOf(const std::array<double, 3>& n) { return SE2({n[0], n[1]}, n[2]); }
SE3 PoseOf(const std::array<double, 7>& n) { return SE3(SO3(Quaternion(n[6], n[3], n[4], n[5])), {n[0], n[1], n[2]}); }

}  // namespace

template <class Pose>
void BroadcastPoses(MPI_Comm ranks, std::vector<Pose>& T_world_body) {
  constexpr std::size_t kPosesAtOnce = std::size_t{1} << 24;  // MPI counts in int
  using PoseNumbers = decltype(internal::NumbersOf(Pose()));
  for (std::size_t begin = 0; begin < T_world_body.size(); begin += kPosesAtOnce) {
    const std::size_t end = std::min(T_world_body.size(), begin + kPosesAtOnce);
    std::vector<PoseNumbers> numbers;
    for (std::size_t k = begin; k < end; ++k) numbers.push_back(internal::NumbersOf(T_world_body[k]));
    MPI_Bcast(numbers.data(), static_cast<int>(numbers.size() * PoseNumbers().size()), MPI_DOUBLE, 0, ranks);
    for (std::size_t k = begin; k < end; ++k) T_world_body[k] = PoseOf(numbers[k - begin]);
  }
}

template <class Pose>
DistributedResult<Pose> SolveDistributed(MPI_Comm ranks, const GraphShare<Pose>& share,
                                         std::vector<std::vector<Pose>> starts, const DistributedOptions& options) {
  if (starts.empty()) throw std::invalid_argument("one start at least is needed");
  for (const auto& values : starts) {
    if (values.size() != share.ids.size()) throw std::invalid_argument("one initial value per pose is needed");
  }
  for (const int pose : options.covariances_of) {
    if (pose < 0 || static_cast<std::size_t>(pose) >= share.ids.size()) {
      throw std::invalid_argument("there is no pose " + std::to_string(pose));
    }
  }
  return DistributedRun<Pose>(ranks, share, options).Execute(std::move(starts));
}

#define TERSE_INSTANTIATE(Pose)                                                              \
  template void BroadcastPoses<Pose>(MPI_Comm, std::vector<Pose>&);                          \
  template DistributedResult<Pose> SolveDistributed<Pose>(MPI_Comm, const GraphShare<Pose>&, \
                                                          std::vector<std::vector<Pose>>, const DistributedOptions&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
