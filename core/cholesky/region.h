#pragma once
// The touched part of the tree of fronts, ordered and factored again.

#include <optional>
#include <utility>
#include <vector>

#include "cholesky/elimination.h"
#include "cholesky/preparation.h"
#include "cholesky/update_context.h"

namespace terse::internal {

template <int B>
class Region {
 public:
  // Takes the fronts of the touched variables and all their ancestors.
  void TakeAffected(const UpdateContext<B>& update);
  // But those that are ready, with all that are affected below them; returns these.
  std::vector<int> TakeAffectedBut(const UpdateContext<B>& update, const Preparation<B>& prepared);
  // Takes all fronts if a fresh order of everything would make the paths far shorter; returns whether it did. Looked at
  // when the work since the last look is a multiple of what looking costs.
  bool TakeAllIfDrifted(const UpdateContext<B>& update);
  void TakeAll(const FrontTree<B>& tree);
  // What an update that succeeded took, for that.
  void NoteWork(double flops) { watch_.work += flops; }
  const std::vector<int>& Fronts() const { return fronts_; }
  // Orders and factors what was taken and the new variables again. Returns the variable at which the matrix turns out
  // not to be positive definite, or -1; until then the tree stays as it was.
  int Refactor(UpdateContext<B>& update);
  // The same in the present order, for an update that only replaces linear factors.
  int RefactorAsOrdered(UpdateContext<B>& update);
  // Whether what was taken has grown so much since it was ordered that this is to be done again, or is done already.
  bool IsOutOfOrder(const FrontTree<B>& tree) const;
  // Nothing is taken any more.
  void Clear() noexcept;
  // What an update that failed did not change.
  struct DriftWatch {
    double work = 0, next_look = 0;  // flops since the last look, and when the next one is due
  };
  const DriftWatch& Watch() const { return watch_; }
  void SetWatch(const DriftWatch& watch) { watch_ = watch; }
  // For the first factorisation, if it is of so many variables, all of them.
  void SetFirstOrder(std::vector<int> order) { first_order_ = std::move(order); }
  // From now on, looks that take more flops are rare; 0: no limit.
  void LimitLooks(double flops) { most_flops_ = flops; }

  template <class Archive>
  void Serialize(Archive& archive);
  // What is wrong with what was stored, empty if nothing is.
  std::string FindStateDefect() const;

 private:
  // What hangs together: a linear factor's variables, or the separator of a subtree that stays.
  struct Couplings {
    Cliques cliques;                // in indices of `variables_`
    std::vector<int> slot, orphan;  // a clique's origin; the other is -1
    std::vector<char> order_last;   // by variable
    std::vector<SymbolicFront> fronts;
  };
  template <class Visit>
  void ForEachSlot(const UpdateContext<B>& update, const Visit& visit) const;
  Couplings Collect(const UpdateContext<B>& update);
  void OrderNewestLast(const UpdateContext<B>& update, Couplings& couplings) const;
  Couplings Order(const UpdateContext<B>& update);
  std::vector<Front<B>> MakeFronts(const Couplings& couplings) const;

  std::vector<int> fronts_;           // taken
  std::vector<int> variables_;        // their pivots and the new variables
  std::vector<char> is_taken_;        // by front
  std::vector<int> local_;            // by variable: index in variables_, else -1
  std::optional<Couplings> ordered_;  // what was taken, if it is ordered already
  DriftWatch watch_;
  double most_flops_ = 0;
  std::vector<int> first_order_;
};

extern template class Region<3>;
extern template class Region<6>;

}  // namespace terse::internal
