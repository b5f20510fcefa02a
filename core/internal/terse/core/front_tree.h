#pragma once
// L as a tree of fronts, with y, log-determinant and the ways over it. Front ids are not contiguous: those of fronts
// that went are given again. The only one that knows how fronts hang together.

#include <string>
#include <utility>

#include "terse/core/block_cholesky.h"
#include "terse/core/buffer_pool.h"
#include "terse/core/front.h"

namespace terse::internal {

template <int B>
class FrontTree {
 public:
  const Front<B>& operator[](int front) const { return fronts_[At(front)]; }
  Front<B>& operator[](int front) { return fronts_[At(front)]; }
  int Variables() const { return static_cast<int>(front_of_.size()); }
  // Ids are below this.
  int Size() const { return static_cast<int>(fronts_.size()); }
  int FrontOf(int variable) const { return front_of_[At(variable)]; }
  const std::vector<int>& Roots() const { return roots_; }
  double LogDeterminant() const { return static_cast<double>(log_det_); }
  double SquaredY() const { return static_cast<double>(y2_); }
  std::int64_t Nonzeros() const;

  // From a front towards the root: visit(front) says whether to go on.
  template <class Visit>
  void Climb(int front, const Visit& visit) const {
    while (front >= 0 && visit(front)) front = (*this)[front].parent;
  }
  // All fronts, level by level from the roots.
  std::vector<int> TopDown() const;
  // All fronts, parents before children, one subtree after the other: visit(id, front).
  template <class Visit>
  void ForEach(const Visit& visit) const {
    std::vector<int> stack(roots_);
    while (!stack.empty()) {
      const int id = stack.back();
      stack.pop_back();
      const Front<B>& front = (*this)[id];
      visit(id, front);
      stack.insert(stack.end(), front.children.begin(), front.children.end());
    }
  }

  // New variables have no front yet; those beyond go.
  void Resize(int variables) { front_of_.resize(At(variables), -1); }
  // Fronts of one new variable each below what is there; parents[k] is a front, or -1 - j for leaves[j]. Where it
  // throws, nothing has changed.
  void Append(std::vector<Front<B>>& leaves, const std::vector<int>& parents, std::uint64_t version);
  // New fronts, children before parents, take the place of `gone` ones, which is_gone (by front) marks. Parents are
  // indices into `pending`, and so are children -1 - k; children that are not negative are fronts that stay. Where it
  // throws, nothing has changed. Buffers go to the pool.
  void Replace(const std::vector<int>& gone, const std::vector<char>& is_gone, std::vector<Front<B>>& pending,
               std::uint64_t version, BufferPool& pool);
  // So that Exchange does not allocate.
  void MakeRoom(int front, const Front<B>& changed);
  // A front after a rank-k update: its variables, panel, sums, new slots and correction come out of `changed`, its old
  // panel goes to the pool.
  void Exchange(int front, Front<B>&& changed, std::uint64_t version, BufferPool& pool) noexcept;
  // A front and one of the same shape exchange their numbers.
  void ExchangeNumbers(int front, Front<B>& other, std::uint64_t version) noexcept;
  // These variables are pivots of the front.
  void SetFrontOf(int first, int end, int front) noexcept;
  // All numbers are new; `order` is TopDown().
  void NoteRefactored(const std::vector<int>& order, std::uint64_t version);

  // Fresh fronts below one that may not be, parents before children: where the next Solve has to begin besides.
  std::vector<int> TakeWaiting() { return std::exchange(waiting_, {}); }
  void Wait(int front) { waiting_.push_back(front); }
  int Waiting() const { return static_cast<int>(waiting_.size()); }

  // As state_file.h says, in two parts: what hangs together how, and the fronts. FindDefect says what is wrong with
  // what was stored, empty if nothing is.
  template <class Archive>
  void SerializeShape(Archive& archive);
  template <class Archive>
  void SerializeFronts(Archive& archive, std::uint64_t version);
  std::string FindDefect() const;
  // Whether every living linear factor is in one front, which has its variables.
  std::string FindSlotDefect(const BlockSystem<B>& system) const;

 private:
  template <class Archive>
  void SerializeFront(Archive& archive, Front<B>& front, std::uint64_t version) const;

  std::vector<Front<B>> fronts_;
  std::vector<int> free_fronts_;
  std::vector<int> front_of_;  // by variable
  std::vector<int> roots_;
  std::vector<int> waiting_;
  // Sums over all fronts. They go up and down with every change: extended precision keeps them true.
  long double log_det_ = 0, y2_ = 0;
};

extern template class FrontTree<3>;
extern template class FrontTree<6>;

}  // namespace terse::internal
