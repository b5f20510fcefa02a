#pragma once
// Bringing the tree up to date without ordering and factoring it again: new leaves, and rank-k updates along the paths
// to the root.
//
// With augmented rows a = [A, -r], H = sum a'a and y ride along as the panel's last row. A front takes W, k columns
// over its variables and the right-hand side: [L, W] Q = [L~, W~], W~ zero on the pivots; its update matrix grows by
// W~_S W~_S', and W~_S goes on to the parent.

#include "cholesky/update_context.h"

namespace terse::internal {

// New variables that a single linear factor each joins to an older one: what is there does not change, because the
// factor can be met exactly.
template <int B>
bool CanAppend(const UpdateContext<B>& update);
// Returns the variable at which it failed, or -1; until then the tree stays as it was.
template <int B>
int Append(UpdateContext<B>& update);

template <int B>
class RankUpdate {
 public:
  // The fronts that a rank-k update goes through, children before parents, and where its linear factors join it:
  // (position in `fronts`, slot), ascending. Empty where there is none.
  struct Path {
    std::vector<int> fronts;
    std::vector<std::pair<int, int>> starts;
    double excess = 0;  // flops that it takes more because nothing is ordered
  };
  // Whether a rank-k update can take the changes in.
  bool Plan(const UpdateContext<B>& update, const std::vector<int>& affected, Path& path);
  // Whether that is cheaper than to order and factor the path again. Without ordering the path fills up. What that has
  // cost so far counts against the next update, so that it never costs more than an ordering would have.
  bool IsCheaper(const FrontTree<B>& tree, Path& path) const;
  // Returns the variable at which the matrix turns out not to be positive definite, or -1. Until then nothing changes.
  int Update(const Path& path, UpdateContext<B>& update);

  // Something was ordered again: nothing is held against the next update.
  void ForgetDebt() { debt_ = 0; }

  template <class Archive>
  void Serialize(Archive& archive);

 private:
  using Below = std::vector<const Front<B>*>;  // changed children
  int PlaceVariables(Front<B>& front, const Front<B>& old, const Below& below, UpdateContext<B>& update);
  int FillColumns(const Front<B>& front, const Below& below, UpdateContext<B>& update, FrontBuffer& W) const;
  static void WidenPanel(Front<B>& front, const Front<B>& old, BufferPool& pool);
  static int ResumeRoot(Front<B>& front, int first, const double* W, int columns, BufferPool& pool);
  int UpdateFront(const Front<B>& old, Front<B>& front, const Below& below, UpdateContext<B>& update);

  std::vector<int> position_;            // by front: in the path at hand
  std::vector<std::uint64_t> stamp_of_;  // by variable: the last front that it was seen in
  std::uint64_t stamp_ = 0;
  double debt_ = 0;  // flops that rank-k updates took more since the last ordering because nothing was ordered
};

extern template class RankUpdate<3>;
extern template class RankUpdate<6>;

}  // namespace terse::internal
