#pragma once
// Loops that may be wrong.
//
// Given everything else, the residual of a loop (whitened, n = that without the loop) and its covariance P = J Sigma J'
// say what any weight w would make of it: r(w) = (I + w P)^-1 n; the linearised cost would grow by n' (I + P)^-1 n, its
// innovation. Both come from one forward substitution along the paths of its poses, without touching the Cholesky
// factor.
//
// kGnc minimises truncated least squares over which loops are in. A new loop, or one that the estimate contradicts, is
// judged together with those that oppose or support it: graduated non-convexity on their joint n and P, then single
// flips while these lower the cost. A loop that is out takes no part. The other kernels weigh every loop; one whose
// weight leaves it nothing to say is out as well, until the estimate comes closer to it.

#include <algorithm>
#include <cmath>
#include <utility>

#include "incremental/judged_loop.h"
#include "incremental/slip_search.h"
#include "incremental/steps.h"
#include "incremental/update_plan.h"
#include "terse/core/cycle_test.h"
#include "terse/core/innovation_scale.h"
#include "terse/core/loop_contest.h"

namespace terse::internal {

template <class Pose>
class LoopJudge {
 public:
  static constexpr int B = Pose::kDof;
  using Map = LinearizedGraph<Pose>;
  LoopJudge() = default;
  explicit LoopJudge(const RobustOptions& options);  // without a kernel it has nothing to do
  bool IsActive() const { return options_.kernel != RobustKernel::kNone; }
  // c as it is now: that of the options, or what loops so far made of it (innovation_scale.h).
  double Width() const { return std::sqrt(limit_); }
  // A width that the options leave open is at most this.
  void LimitWidth(double width);
  // What another judge has learned of the innovations of loops.
  void LearnFrom(const LoopJudge& earlier);

  // Follows the map: its slots after every update, a slot before it is released, a measurement that is removed.
  void Resize(const Map& map);
  void Release(int slot);
  void Unpark(FactorId id);

  // The loops among the factors of an update that has been made: each comes in with the weight that its innovation
  // deserves, or stays out. Those that are in join plan.changes.added, for the gate counts what they bring.
  // increase: by what the update raised the minimum.
  void Admit(UpdatePlan<Pose>& plan, double increase, StepContext<Pose>& step);
  // Loops on poses that moved, and now and then those that are out, are judged again, while anything changes.
  void Review(StepContext<Pose>& step);

  // kGnc: the groups of loops that are out, once more; all odometry, whether a part of it is wrong. True if that
  // changed anything.
  bool JudgeParkedGroups(StepContext<Pose>& step);
  bool ReviewAllOdometry(StepContext<Pose>& step);
  // kGnc: loops that are in although odometry alone contradicts them, by what is known of it now.
  bool DropRefused(StepContext<Pose>& step);

  // Loops that went since this was last asked.
  int TakeEvicted() { return std::exchange(evicted_, 0); }
  double RobustChi2(const Map& map) const;
  // By position in the graph's factors: 1 for what is in, 0 for what is out.
  std::vector<double> WeightsIn(const Map& map) const;
  double WeightOf(FactorId id, const Map& map) const;
  // The batch optimum from these values with this judge's kernel, kGnc from the loops that are in, or anew; then its
  // weights, by position in the graph's factors.
  BatchResult<Pose> SolveBatch(const Map& map, const std::vector<Pose>& T_world_body, BatchOptions options,
                               bool anew) const;
  void TakeWeights(const std::vector<double>& weights, StepContext<Pose>& step);

  template <class Archive>
  void Serialize(Archive& archive);
  std::string FindStateDefect(const Map& map) const;

 private:
  using Loop = JudgedLoop<Pose>;
  using Loops = std::vector<Loop>;
  // Of loops that are judged together: the newcomer, those that agree with it, those that oppose it.
  struct Camps {
    std::size_t first_against = 0;                 // 0: there are no camps
    std::vector<std::vector<std::size_t>> groups;  // of those that oppose it
  };
  // Loops that are out, looked at for a newcomer's sake: around it in order of arrival, then all; and in a step.
  static constexpr std::size_t kNeighbours = 200, kMostLooked = 2000;
  // A loop, or odometry, is judged again when its chi2 has changed by this factor.
  static constexpr double kNews = 2;
  struct OfSlot {
    char is_loop = 0, is_listed = 0;
    double weight = 1;       // of a loop; the slot's W contains its root
    double judged_chi2 = 0;  // kGnc: when it was judged
    double leverage = 0;     // kGnc: its innovation over its chi2, at most, when it was judged
  };
  struct Parked {
    FactorId id;
    double chi2;  // when it was judged
  };
  OfSlot& At(int slot) { return slots_[static_cast<std::size_t>(slot)]; }
  bool Adapts() const { return Chooses() && options_.width == 0; }
  void NoteInnovation(double innovation, int count);
  void NoteCycles(const UpdatePlan<Pose>& plan, const StepContext<Pose>& step);
  bool IsRefusedByOdometry(FactorId id, const Map& map) const;
  bool DropIfRefused(StepContext<Pose>& step);
  void SetLimit() { limit_ = std::min({outer_limit_, scale_.Limit(stated_limit_, B), cycles_.LimitInMap()}); }
  bool Chooses() const { return options_.kernel == RobustKernel::kGnc; }
  void Park(FactorId id, double chi2);
  bool IsSlip(FactorId id) const { return std::binary_search(slips_.begin(), slips_.end(), id); }
  double PriceOf(FactorId id) const;  // of being out
  void Enter(int slot, double weight);
  double WeightOnArrival(Loop& loop, double tolerated, const Map& map) const;
  bool AdmitWeighted(Loops loops, StepContext<Pose>& step);
  bool Exchange(const Loops& in, const Loops& out, StepContext<Pose>& step);
  void LogLoops(const Loops& loops, const char* what, const StepContext<Pose>& step) const;
  void LogScreened(FactorId id, const StepContext<Pose>& step) const;
  void LogSlip(FactorId odometry, const StepContext<Pose>& step) const;
  bool ComeToMinimum(StepContext<Pose>& step) const;  // true if the estimate changed
  bool AdmitLoops(Loops loops, StepContext<Pose>& step);
  bool TakeSlip(const Slip<Pose>& slip, StepContext<Pose>& step);
  bool TakeIfVerified(Slip<Pose> suspected, StepContext<Pose>& step);
  bool AdmitSlip(FactorId newcomer, StepContext<Pose>& step);
  bool AdmitLocalSlip(Loop newcomer, StepContext<Pose>& step);
  std::pair<std::size_t, std::size_t> ParkedAround(FactorId id) const;  // positions: the first, behind the last
  std::vector<int> GroupOf(int slot, const Map& map) const;
  Camps AddContestants(Loops& contest, const Map& map) const;
  Contest<B> ContestOf(Loops& loops, const Map& map) const;
  bool Judge(Loops& loops, const Camps& camps, StepContext<Pose>& step);
  struct Touched {
    std::vector<int> loops, odometry;  // slots
  };
  Touched TakeTouched(Map& map);
  std::vector<FactorId> LoopsIn(const Map& map) const;  // ascending
  bool ReviewOdometry(const std::vector<int>& slots, StepContext<Pose>& step);
  bool ReviewMembers(StepContext<Pose>& step);
  void DoubtAllIfNarrower();
  bool ReviewWeights(StepContext<Pose>& step);
  bool RetryParked(std::size_t first, std::size_t last, StepContext<Pose>& step);
  void SetWeight(int slot, double weight, Map& map);

  RobustOptions options_;
  double stated_limit_ = 0;          // the width of the options, squared
  double limit_ = 0;                 // the width as it is, squared
  double outer_limit_ = 0;           // from outside, squared
  double reviewed_limit_ = 0;        // what it was when all loops that are in were last in doubt
  bool doubts_all_ = false;          // they are to be looked at, not only those on poses that moved
  InnovationScale scale_;            // kGnc, with a width that the options leave open
  CycleTest<Pose> cycles_;           // the same
  double reviewed_cycle_limit_ = 0;  // when all that are in were last tested
  std::vector<OfSlot> slots_;        // empty without a kernel
  std::vector<Parked> parked_;       // loops that are out, ascending
  std::size_t next_parked_ = 0;      // of these, to be looked at
  bool has_evicted_ = false;         // since loops that are out were looked at
  int evicted_ = 0;                  // within a step
  std::vector<FactorId> slips_;      // kGnc: odometry among what is out, ascending
};

}  // namespace terse::internal
