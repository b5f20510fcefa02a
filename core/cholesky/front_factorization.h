#pragma once
// The numbers of fronts: assembly from the block system and from the children's update matrices, and partial
// factorisation.

#include <cstdint>
#include <functional>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "terse/core/front_tree.h"

namespace terse::internal {

template <int B>
class FrontFactorization {
 public:
  using Normals = std::unordered_map<int, typename BlockSystem<B>::Normal>;  // by slot

  void SetThreads(int threads) { threads_ = threads; }
  int Threads() const { return threads_; }
  void Resize(int variables) { scratch_.row_of.resize(At(variables), -1); }

  // Assembles and factors one front, which has its buffers; its children that are not in the tree are in `pending`
  // (FrontTree::Replace). damping: B scalars per variable, added to the diagonal, or empty. `instead`: what some slots
  // add instead of what the system says. Returns the variable at which the matrix was found not to be positive
  // definite, or -1.
  int Factor(Front<B>& front, const std::vector<Front<B>>& pending, const BlockSystem<B>& system,
             const FrontTree<B>& tree, const std::vector<double>& damping = {}, const Normals* instead = nullptr) {
    return FactorFront(front, {system, tree, pending, damping, instead}, scratch_, false);
  }
  // Factors fronts, children before parents; parents[k] > k is the index of that of fronts[k], or -1. Gives them
  // buffers and counts the flops. Returns the variable at which the matrix was found not to be positive definite,
  // whatever the number of threads the first in this order, or -1.
  int FactorAll(const std::vector<Front<B>*>& fronts, const std::vector<int>& parents,
                const std::vector<Front<B>>& pending, const BlockSystem<B>& system, const FrontTree<B>& tree,
                const std::vector<double>& damping, double& flops);
  // Makes a front that Factor can take out of one of the tree, in the same order. place(child): where a child is in
  // `pending`, or -1 if the tree's stays.
  template <class Place>
  void CopyShape(int id, const Place& place, FrontTree<B>& tree, Front<B>& front) {
    const Front<B>& now = tree[id];
    front.pivots = now.pivots;
    front.separators = now.separators;
    front.slots = now.slots;
    front.children.clear();
    for (const int child : now.children) {
      if (place(child) < 0) WorkInCorrections(tree[child]);
      front.children.push_back(place(child) < 0 ? child : -1 - place(child));
    }
  }
  // Works what rank-k updates left into the update matrix.
  void WorkInCorrections(Front<B>& front);
  // Sums up what the pivots add to log-determinant and |y|^2; returns the first variable from a column on that nothing
  // measures, or -1.
  static int SumPivots(Front<B>& front, int first_column, const BlockSystem<B>& system);

  // FactorAll of a whole tree then gives each update matrix away as soon as the parent has taken it, and stores panels
  // in a file if they take more than so many bytes in all (BlockCholesky::DropUpdateMatrices).
  void DropUpdates(std::uint64_t most_bytes) {
    drops_updates_ = true;
    most_bytes_ = most_bytes;
  }
  bool HasDropped() const { return has_dropped_; }
  // FactorAll tells the share of its work that is done: from any of its threads, from one at a time.
  void SetProgress(std::function<void(double share)> progress) { progress_ = std::move(progress); }

  BufferPool& Pool() { return pool_; }
  // Scratch, by variable: its first row in the front at hand.
  std::vector<int>& RowOf() { return scratch_.row_of; }

  template <class Archive>
  void Serialize(Archive& archive);
  // What is wrong with what was stored, empty if nothing is.
  std::string FindStateDefect() const { return threads_ < 1 ? "a factor without a thread" : ""; }

 private:
  struct Sources {
    const BlockSystem<B>& system;
    const FrontTree<B>& tree;
    const std::vector<Front<B>>& pending;
    const std::vector<double>& damping;
    const Normals* instead = nullptr;
  };
  struct Scratch {
    std::vector<int> row_of;                               // by variable
    std::vector<int> at, run_end;                          // by separator of a child
    ShortLivedBuffers updates;                             // where none is kept
    std::vector<typename BlockSystem<B>::Normal> normals;  // of the front's slots, where the system has none
  };
  // May run for several fronts at once, if parallel also with threads of its own inside one. scratch: of the calling
  // thread, which takes no other front while it waits for those (ForEachChunk).
  static int FactorFront(Front<B>& front, const Sources& from, Scratch& scratch, bool parallel);
  // In a file for panels that have no room yet, in this order, or nowhere if memory has room for all.
  void PlacePanels(const std::vector<Front<B>*>& fronts, const std::vector<int>& order) const;
  enum class Part { kPanel, kUpdate };
  static void Assemble(Part part, Front<B>& front, const Sources& from, Scratch& scratch);
  static void AssembleChild(Part part, Front<B>& front, const Front<B>& child, Scratch& scratch);

  Scratch scratch_;
  std::vector<Scratch> thread_scratch_;
  BufferPool pool_;
  int threads_ = 1;
  bool drops_updates_ = false, has_dropped_ = false;
  std::uint64_t most_bytes_ = 0;
  std::function<void(double share)> progress_;
};

extern template class FrontFactorization<3>;
extern template class FrontFactorization<6>;

}  // namespace terse::internal
