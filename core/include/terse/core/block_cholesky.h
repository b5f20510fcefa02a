#pragma once
// Multifrontal block Cholesky factor H = L L' of a linearised pose graph (block_system.h), kept up to date as the
// graph changes.
//
// It minimises sum |A_i d + r_i|^2 over d, with B scalars per variable. One structure serves batch and incremental
// use: a tree of fronts. A front owns pivot variables P and couples them to separator variables S, all of them pivots
// of its ancestors. It stores the panel [L_PP; L_SP; y_P'] and the update matrix of S (lower triangle, the last row is
// the right-hand side) that it hands to its parent. Every linear factor is assembled at the front of its earliest
// variable.
//
// Update() changes the graph: affected are the fronts that hold a touched variable and all their ancestors; their
// variables are ordered again (the newest last) and refactored, children that are not affected hand up their stored
// update matrix. With everything affected this is batch factorisation (Ila et al. 2017 section 3; Kaess et al. 2012
// for the tree).
//
// Cost of Update: symbolic and numeric work on the affected fronts only. Not thread-safe for writing; const
// functions may run concurrently. Instantiated for B = 3 and 6.

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "terse/core/block_system.h"

namespace terse {

// How changes came into the Cholesky factor.
enum class CholeskyPath {
  kNone,        // nothing was added or removed
  kAppended,    // new variables hang below what is there, which did not change
  kRankUpdate,  // rank-k update along the paths to the root
  kRefactored,  // the paths were ordered and factored again
};

struct CholeskyReport {
  bool ok = false;
  int failed_variable = -1;      // where the matrix was found not to be positive definite
  std::vector<int> added_slots;  // one per added factor
  CholeskyPath path = CholeskyPath::kNone;
  int fronts_updated = 0;         // by rank-k update
  int fronts = 0, variables = 0;  // refactored
  double flops = 0;               // sum of squared column counts
  double seconds_order = 0;       // of the symbolic part
};

// How far an update is that is made ready in pieces.
struct PreparationProgress {
  int failed_variable = -1;  // where the matrix was found not to be positive definite
  int fronts_left = 0;       // that did not change in this step
  double seconds_left = 0;   // predicted, those that changed among them
};

namespace internal {
// A number that no other object has, nor the same object after it was assigned to or moved from.
class Identity {
 public:
  Identity() : value_(Next()) {}
  Identity(const Identity&) : value_(Next()) {}
  Identity(Identity&& other) noexcept : value_(Next()) { other.value_ = Next(); }
  Identity& operator=(Identity&& other) noexcept {
    value_ = Next();
    other.value_ = Next();
    return *this;
  }
  Identity& operator=(const Identity&) {
    value_ = Next();
    return *this;
  }
  std::uint64_t Value() const { return value_; }

 private:
  static std::uint64_t Next();
  std::uint64_t value_;
};

template <int B>
class FrontTree;
template <int B>
struct UpdateContext;
}  // namespace internal

template <int B>
class BlockCholesky {
 public:
  using Clock = std::chrono::steady_clock;
  using Changes = typename BlockSystem<B>::Changes;
  using SlotChange = typename BlockSystem<B>::SlotChange;
  using UpdateReport = CholeskyReport;

  BlockCholesky();
  ~BlockCholesky();
  BlockCholesky(const BlockCholesky& other);
  BlockCholesky(BlockCholesky&& other);  // leaves an empty one
  BlockCholesky& operator=(const BlockCholesky& other);
  BlockCholesky& operator=(BlockCholesky&& other);

  // The cheapest way to bring the paths up to date, by flops; the others are for tests and benchmarks.
  enum class Method { kCheapest, kRefactor, kRankUpdateWherePossible };
  void SetMethod(Method method) { method_ = method; }

  // If the changed matrix is not positive definite (to rounding), or a right-hand side is not finite, nothing is
  // changed and ok is false. Throws std::invalid_argument for changes that contradict each other or the graph.
  [[nodiscard]] UpdateReport Update(const Changes& changes);
  // The same without a copy of what is replaced, which is gone afterwards, ok or not.
  [[nodiscard]] UpdateReport Update(Changes&& changes);

  // An update that only replaces linear factors can be made ready in pieces, while others go on and the old factor
  // stays in use. Prepare adds to what is prepared; a slot that another update changes is not any more. Advance goes on
  // until the deadline, one front at least, and leaves those out that changed since EndPreparedStep, because they may
  // well change again. UpdatePrepared is Update with PreparedChanges, whatever fronts are left;
  // nothing is prepared after it.
  void Prepare(const std::vector<std::pair<int, LinearFactor<B>>>& replaced);
  PreparationProgress Advance(Clock::time_point deadline);
  void EndPreparedStep();
  void ForgetPrepared();
  Changes PreparedChanges();
  [[nodiscard]] UpdateReport UpdatePrepared(Changes&& changes);

  // Up to so many threads (1 at first) share large work; results are the same to the last bit for any number. Throws
  // std::invalid_argument for less than one.
  void SetThreads(int threads);
  // The first Update, if it brings so many variables, eliminates them in this order, first to last, instead of looking
  // for one (elimination_order.h). Throws std::invalid_argument if the numbers are not those of variables, each once.
  void SetOrder(std::vector<int> order);
  // A fresh order of everything that takes more flops is rarely looked for: it would be a step of its own. 0: no limit,
  // as at first. Not stored.
  void LimitReordering(double flops);
  // For those who factor all at once, in a batch: update matrices go as soon as they have been assembled, and the next
  // ones take their memory while it is in the caches. An Update later on factors everything again; nothing can be made
  // ready in pieces, and System() has no NormalAt. L goes to a file without a name, in $TMPDIR or else /var/tmp, if it
  // takes more than so many bytes: Update throws FileError if the folder has no room. 0: if it takes more than half of
  // the memory that is free when it is made, and 64 MiB; what has no room there stays in memory as long as that has.
  // A copy of the factor is in memory.
  void DropUpdateMatrices(std::uint64_t most_bytes_of_L = 0);
  // Told the share of the work of a factorisation that is done, after every front: from any of its threads, from one at
  // a time. Neither copied with the factor nor stored.
  void SetProgress(std::function<void(double share)> progress);

  // New values for the linear factors of slots 0, 1, ... on the present structure: numeric work only. damping (B *
  // Variables() scalars or empty) is added to the diagonal. If false, L is unusable until a Refactor succeeds.
  void SetLinearFactors(const std::vector<LinearFactor<B>>& factors);
  // The same for all slots without a copy: `factors` holds the old ones afterwards.
  void ExchangeLinearFactors(std::vector<LinearFactor<B>>& factors);
  [[nodiscard]] bool Refactor(const std::vector<double>& damping = {});

  // Back-substitution L' d = y from the roots. A subtree is skipped where no front changed and no separator
  // moved enough: a variable whose move, all else held, would change the linearised chi2 by no more than `threshold`
  // keeps its old value. 0 is exact. Returns the variables whose d changed. When the deadline has passed, the subtrees
  // not yet visited wait for the next Solve; where most moved above comes first.
  std::vector<int> Solve(double threshold = 0, std::optional<Clock::time_point> deadline = std::nullopt);
  struct SolveReport {
    double flops = 0;  // twice the entries visited
    int deferred = 0;  // subtrees that wait
  };
  const SolveReport& LastSolve() const { return last_solve_; }
  // d, B scalars per variable, as of the last Solve.
  const std::vector<double>& Solution() const { return solution_; }
  // Sets d of one variable, until a Solve visits it.
  void SetSolution(int variable, const Vector<B>& d);
  // Sets d of one variable to zero: its linearisation point took the step over.
  void ClearSolution(int variable) { SetSolution(variable, Vector<B>::Zero()); }

  // H and b, and what is asked of them most.
  const BlockSystem<B>& System() const { return system_; }
  int Variables() const { return system_.Variables(); }
  int Slots() const { return system_.Slots(); }
  const LinearFactor<B>& LinearFactorAt(int slot) const { return system_.LinearFactorAt(slot); }
  const std::vector<int>& SlotsOf(int variable) const { return system_.SlotsOf(variable); }

  double LogDeterminant() const;      // ln det H
  double NewtonDecrement() const;     // |y|^2 = b' H^-1 b: the predicted decrease of chi2
  std::int64_t Nonzeros() const;      // scalars of the lower triangle of L
  std::uint64_t BytesInFile() const;  // of L (DropUpdateMatrices)

  // Stays as it is until another one is assigned to this one.
  std::uint64_t Identity() const { return identity_.Value(); }
  // A larger number after every Update that changed something and every Refactor; no two have the same unless one was
  // copied.
  std::uint64_t Version() const { return version_; }
  // What changed since an earlier version (BlockSystem::ChangesSince).
  std::optional<std::vector<SlotChange>> ChangesSince(std::uint64_t version) const {
    return system_.ChangesSince(version, version_);
  }
  // The fronts, for covariances.
  const internal::FrontTree<B>& Tree() const;

 private:
  struct Parts;
  void Swap(BlockCholesky& other) noexcept;
  void Resize(int variables);
  int UpdateTree(const typename BlockSystem<B>::Undo& undo, UpdateReport& report);
  int UpdateTreePrepared(const typename BlockSystem<B>::Undo& undo, UpdateReport& report);
  int RefactorRegion(internal::UpdateContext<B>& update);
  UpdateReport BringIn(const Changes& changes, typename BlockSystem<B>::Replaced replaced, bool is_prepared);
  // As state_file.h says.
  friend struct internal::StateAccess;
  template <class Archive>
  void Serialize(Archive& archive);

  BlockSystem<B> system_;
  std::unique_ptr<Parts> parts_;  // the tree of fronts and the ways to change it; never null
  std::vector<double> solution_;
  SolveReport last_solve_;
  Method method_ = Method::kCheapest;
  internal::Identity identity_;
  std::uint64_t version_ = 0, next_version_ = 0;  // the second: of the update at hand
};

extern template class BlockCholesky<3>;
extern template class BlockCholesky<6>;

}  // namespace terse
