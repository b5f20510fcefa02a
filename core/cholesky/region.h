#pragma once
// The touched part of the tree of fronts, ordered and factored again.

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
  // Takes all fronts if a fresh ordering of everything would have far fewer entries, which is looked at when the graph
  // has doubled; returns whether it did.
  bool TakeAllIfDrifted(const UpdateContext<B>& update);
  const std::vector<int>& Fronts() const { return fronts_; }
  // Orders and factors what was taken and the new variables again. Returns the variable at which the matrix turns out
  // not to be positive definite, or -1; until then the tree stays as it was.
  int Refactor(UpdateContext<B>& update);
  // The same in the present order, for an update that only replaces linear factors.
  int RefactorAsOrdered(UpdateContext<B>& update);
  // Whether what was taken has grown so much since it was ordered that this is to be done again.
  bool HasGrown(const FrontTree<B>& tree) const;
  // Nothing is taken any more.
  void Clear() noexcept;

  template <class Archive>
  void Serialize(Archive& archive);
  // What is wrong with what was stored for a tree of so many variables, empty if nothing is.
  std::string FindStateDefect(int variables) const;

 private:
  // What hangs together: a linear factor's variables, or the separator of a subtree that stays.
  struct Couplings {
    Cliques cliques;                // in indices of `variables_`
    std::vector<int> slot, orphan;  // a clique's origin; the other is -1
    std::vector<char> order_last;   // by variable
  };
  void TakeAll(const FrontTree<B>& tree);
  template <class Visit>
  void ForEachSlot(const UpdateContext<B>& update, bool with_added, const Visit& visit) const;
  Couplings Collect(const UpdateContext<B>& update, bool with_added);
  void OrderNewestLast(const UpdateContext<B>& update, Couplings& couplings) const;
  std::vector<Front<B>> MakeFronts(const Couplings& couplings) const;

  std::vector<int> fronts_;     // taken
  std::vector<int> variables_;  // their pivots and the new variables
  std::vector<char> is_taken_;  // by front
  std::vector<int> local_;      // by variable: index in variables_, else -1
  int drift_looked_at_ = 0;     // at so many variables
};

extern template class Region<3>;
extern template class Region<6>;

}  // namespace terse::internal
