#pragma once
// Multifrontal block Cholesky factor H = L L' of a linearised pose graph, kept up to date as the graph changes.
//
// The factor minimises sum |A_i d + r_i|^2 over d, with B scalars per variable: H = A'A, b = -A'r. One structure
// serves batch and incremental use: a tree of fronts. A front owns pivot variables P and couples them to separator
// variables S, all of them pivots of its ancestors. It stores the panel [L_PP; L_SP; y_P'] and the update
// matrix of S (lower triangle, the last row is the right-hand side) that it hands to its parent. Every linear
// factor is assembled at the front of its earliest variable.
//
// Update() changes the graph: affected are the fronts that hold a touched variable and all their ancestors; their
// variables are ordered again (the newest last) and refactored, children that are not affected hand up their stored
// update matrix. With everything affected this is batch factorisation (Ila et al., IJRR 2017, section 3;
// Kaess et al., IJRR 2012, for the tree).
//
// Cost of Update: symbolic and numeric work on the affected fronts only. Not thread-safe for writing; const
// functions may run concurrently. Instantiated for B = 3 and 6.

#include <chrono>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "terse/core/buffer_pool.h"
#include "terse/core/linear_factor.h"

namespace terse {

// How changes came into the factor.
enum class FactorPath {
  kNone,        // nothing was added or removed
  kAppended,    // new variables hang below what is there, which did not change
  kRankUpdate,  // rank-k update along the paths to the root
  kRefactored,  // the paths were ordered and factored again
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
}  // namespace internal

template <int B>
class BlockCholesky {
 public:
  using Clock = std::chrono::steady_clock;

  // update += W W': a rank-k update that has not been worked into it yet. W has a row per scalar of the first
  // `separators` separators and one for the right-hand side.
  struct Correction {
    int separators = 0, columns = 0;
    std::vector<double> W;  // column-major
  };

  struct Front {
    int parent = -1;
    std::vector<int> pivots, separators;  // variables in elimination order
    std::vector<int> children;
    std::vector<int> slots;     // linear factors assembled here
    std::vector<double> panel;  // (p + s + 1) x p, column-major, p = B |P|, s = B |S|; may be longer
    // (u + 1) x (u + 1), column-major, lower triangle, u = B update_separators: the first of S; may be longer.
    std::vector<double> update;
    int update_separators = 0;
    std::vector<Correction> corrections;
    double log_det = 0;                         // sum of 2 ln L_kk
    double y2 = 0;                              // sum of |y|^2
    bool fresh = true;                          // changed since the last Solve
    std::uint64_t stamp = 0;                    // the version with which the panel last changed
    int ordered_rows = 0, ordered_columns = 0;  // when it was last ordered
    int Rows() const { return B * static_cast<int>(pivots.size() + separators.size()) + 1; }
    int Columns() const { return B * static_cast<int>(pivots.size()); }
  };

  struct Changes {
    int new_variables = 0;                                  // numbered on from Variables()
    std::vector<LinearFactor<B>> added;                     // may name the new variables
    std::vector<std::pair<int, LinearFactor<B>>> replaced;  // slot, same variables
    std::vector<int> removed;                               // slots
  };

  struct UpdateReport {
    bool ok = false;
    int failed_variable = -1;      // where the matrix was found not to be positive definite
    std::vector<int> added_slots;  // one per added factor
    FactorPath path = FactorPath::kNone;
    int fronts_updated = 0;         // by rank-k update
    int fronts = 0, variables = 0;  // refactored
    double flops = 0;               // sum of squared column counts
    double seconds_order = 0;       // of the symbolic part
  };

  // The cheapest way to bring the paths up to date, by flops; the others are for tests and benchmarks.
  enum class Method { kCheapest, kRefactor, kRankUpdateWherePossible };
  void SetMethod(Method method) { method_ = method; }

  // If the changed matrix is not positive definite (to rounding), or a right-hand side is not finite, nothing is
  // changed and ok is false. Throws std::invalid_argument for changes that contradict each other or the graph.
  [[nodiscard]] UpdateReport Update(const Changes& changes);

  // Up to so many threads (1 at first) share large work; results are the same to the last bit for any number. Throws
  // std::invalid_argument for less than one.
  void SetThreads(int threads);

  // New values for the factors of slots 0, 1, ... on the present structure: numeric work only. damping (B * Variables()
  // scalars or empty) is added to the diagonal. If false, the factor is unusable until a Refactor succeeds.
  void SetFactors(const std::vector<LinearFactor<B>>& factors);
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

  int Variables() const { return static_cast<int>(front_of_.size()); }
  double LogDeterminant() const { return static_cast<double>(log_det_); }  // ln det H
  double NewtonDecrement() const {
    return static_cast<double>(y2_);
  }  // |y|^2 = b' H^-1 b: the predicted decrease of chi2
  // b = -A'r at the linearisation point, minus half the gradient of chi2; B scalars per variable.
  std::vector<double> Gradient() const;
  // diag(H).
  std::vector<double> Diagonal() const;
  const Vector<B>& DiagonalOf(int variable) const { return diagonal_[static_cast<std::size_t>(variable)]; }
  // Slots so far, free ones among them.
  int Slots() const { return static_cast<int>(factors_.size()); }
  const LinearFactor<B>& FactorAt(int slot) const { return factors_[static_cast<std::size_t>(slot)]; }
  // Slots of the living factors on a variable, ascending.
  const std::vector<int>& SlotsOf(int variable) const { return slots_of_[static_cast<std::size_t>(variable)]; }

  // The tree, for covariances. Front ids are not contiguous.
  const Front& FrontAt(int front) const { return fronts_[static_cast<std::size_t>(front)]; }
  int FrontOf(int variable) const { return front_of_[static_cast<std::size_t>(variable)]; }
  const std::vector<int>& Roots() const { return roots_; }
  std::int64_t FactorNonzeros() const;
  // Stays as it is until another factor is assigned to this one.
  std::uint64_t Identity() const { return identity_.Value(); }
  // A larger number after every Update that changed something and every Refactor; two factors never have the same
  // unless one was copied.
  std::uint64_t Version() const { return version_; }
  // A slot that changed, and what it held before: first is -1 if nothing.
  struct SlotChange {
    int slot;
    LinearFactor<B> before;
  };
  // What changed since an earlier version, a slot once. Only so much is remembered as can be of use for downdating
  // covariances: absent if it was more, or longer ago.
  std::optional<std::vector<SlotChange>> ChangesSince(std::uint64_t version) const;

 private:
  // What a factor adds to H and b.
  struct Normal {
    Matrix<B, B> H_first, H_second, H_cross;  // H_cross: second's rows, first's columns
    Vector<B> b_first, b_second;
  };
  struct Undo;
  struct Region;
  struct RankPath;
  struct Changed;
  void CheckChanges(const Changes& changes) const;
  void SetSlot(int slot, const LinearFactor<B>& factor);
  void ApplyFactors(const Changes& changes, std::vector<int>& added_slots, Undo& undo);
  void RevertFactors(Undo& undo);
  void Attach(int slot);
  bool AttachTo(int variable, int slot);
  void AttachNew(int slot, Undo& undo);
  void Detach(int slot);
  void Remember(const Undo& undo) noexcept;
  Vector<B> DiagonalPart(int variable, int slot) const;
  void RecountDiagonal(int variable);
  void SumDiagonal(int variable);
  void RecountDiagonals(std::vector<std::pair<int, int>>& changed);
  // block_cholesky_region.cpp: the touched part of the tree and its new elimination.
  void AffectedFronts(const Undo& undo, std::vector<int>& affected);
  template <class Visit>
  void ForEachSlot(const Region& region, const Visit& visit) const;
  void CollectCliques(int old_variables, Region& region);
  bool HasDrifted(int old_variables, Region& all);
  void AllFronts(std::vector<int>& fronts);
  void Forget(const Region& region);
  std::vector<Front> MakeFronts(const Region& region) const;
  int FactorPending(std::vector<Front>& pending, UpdateReport& report);
  void Replace(const std::vector<int>& affected, std::vector<Front>& pending, std::vector<int>& id_of) noexcept;
  int RefactorRegion(int old_variables, const Undo& undo, Region& region, UpdateReport& report);
  // block_cholesky_rank.cpp: the ways without refactoring.
  bool PlanAppend(const Changes& changes, int old_variables, const std::vector<int>& added_slots) const;
  int Append(int old_variables, UpdateReport& report);
  bool PlanRankUpdate(const Changes& changes, int old_variables, const std::vector<int>& affected,
                      const std::vector<int>& added_slots, RankPath& path);
  bool IsCheaper(const RankPath& path);
  int ResumeRoot(Front& front, int first, const double* W, int columns);
  int RankUpdateFront(Changed& changed, const std::vector<const Front*>& below, int old_variables,
                      UpdateReport& report);
  int RankUpdate(const RankPath& path, int old_variables, UpdateReport& report);
  // block_cholesky_front.cpp: the numbers of one front.
  int FactorFront(Front& front, const std::vector<Front>& pending, const std::vector<double>& damping,
                  std::vector<int>& row_of, bool parallel);
  int FactorFronts(const std::vector<Front*>& fronts, const std::vector<int>& parents,
                   const std::vector<Front>& pending, const std::vector<double>& damping, double& flops);
  void AssembleFactor(Front& front, int slot, const std::vector<int>& row_of);
  void AssembleChild(Front& front, const Front& child, const std::vector<int>& row_of);
  void WorkInCorrections(Front& front);
  int SumPivots(Front& front, int first_column) const;
  std::vector<int> TopDown() const;
  // block_cholesky_state.cpp: as state_file.h says.
  friend struct internal::StateAccess;
  template <class Archive>
  void Serialize(Archive& archive);
  template <class Archive>
  void SerializeFront(Archive& archive, Front& front) const;
  void RebuildDerived();
  std::string FindTreeDefect() const;
  std::string FindSlotDefect() const;

  std::vector<LinearFactor<B>> factors_;  // by slot; first is -1 for a free slot
  std::vector<Normal> normals_;           // by slot
  std::vector<int> free_slots_;
  std::vector<std::vector<int>> slots_of_;  // by variable
  std::vector<Front> fronts_;
  std::vector<int> free_fronts_;
  std::vector<int> front_of_;  // by variable
  std::vector<int> roots_;
  std::vector<int> waiting_;  // fresh fronts below one that may not be, parents before children
  // Sums over all fronts. They go up and down with every change: extended precision keeps them true.
  long double log_det_ = 0, y2_ = 0;
  std::vector<double> solution_;
  SolveReport last_solve_;
  Method method_ = Method::kCheapest;
  int threads_ = 1;
  // Scratch that stays allocated, so that an update costs nothing for what it does not touch.
  std::vector<int> row_of_;                      // by variable: first row in the front at hand
  std::vector<std::vector<int>> thread_row_of_;  // the same, by thread
  std::vector<int> local_;                       // by variable: index in the region at hand, else -1
  std::vector<char> is_affected_;                // by front
  std::vector<Vector<B>> diagonal_;              // of H, by variable
  // A variable that has had more factors than kHub: its diagonal by blocks of kSlotBlock slots, so that no change has
  // to look at all of them.
  static constexpr std::size_t kHub = 1024;
  static constexpr int kSlotBlock = 1024;
  std::map<int, std::map<int, Vector<B>>> hubs_;
  std::vector<double> moved_;            // by variable: what its change in the Solve at hand is worth
  std::vector<int> position_;            // by front: in the path at hand
  std::vector<std::uint64_t> stamp_of_;  // by variable: the last front that it was seen in
  std::uint64_t stamp_ = 0;
  int drift_looked_at_ = 0;  // at so many variables
  double debt_ = 0;          // flops that rank-k updates took more since the last ordering because nothing was ordered
  internal::BufferPool pool_;
  internal::Identity identity_;
  std::uint64_t version_ = 0, next_version_ = 0;  // the second: of the update at hand
  struct Step {
    std::uint64_t version_before;
    std::vector<SlotChange> changes;
  };
  std::deque<Step> history_;  // the last steps, up to kMostRemembered changes
};

extern template class BlockCholesky<3>;
extern template class BlockCholesky<6>;

}  // namespace terse
