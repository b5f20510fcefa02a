#pragma once
// The normal equations of a linearised pose graph, H d = b with H = A'A and b = -A'r, kept block by block: the linear
// factors by slot, what each adds to H and b, and which slots are on a variable. B scalars per variable.
//
// A slot is where a linear factor lives from when it is added to when it is removed; then another may take it.
// Variables are numbered from 0 in the order in which they came. BlockCholesky holds one and changes it; what a
// change costs grows with the touched factors, whatever their variables' degree. Const functions may run
// concurrently. Instantiated for B = 3 and 6.

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "terse/core/linear_factor.h"

namespace terse {

namespace internal {
struct StateAccess;
}

template <int B>
class BlockSystem {
 public:
  using Replaced = std::vector<std::pair<int, LinearFactor<B>>>;  // by slot
  struct Changes {
    int new_variables = 0;               // numbered on from Variables()
    std::vector<LinearFactor<B>> added;  // may name the new variables
    Replaced replaced;                   // on the same variables
    std::vector<int> removed;            // slots
  };
  // What a linear factor adds to H and b.
  struct Normal {
    Matrix<B, B> H_first, H_second, H_cross;  // H_cross: second's rows, first's columns
    Vector<B> b_first, b_second;
  };
  static Normal NormalOf(const LinearFactor<B>& factor);
  static void SetNormal(const LinearFactor<B>& factor, Normal& normal);  // the same
  // A slot that changed, and what it held before: first is -1 if nothing.
  struct SlotChange {
    int slot;
    LinearFactor<B> before;
  };

  int Variables() const { return static_cast<int>(slots_of_.size()); }
  // Slots so far, free ones among them.
  int Slots() const { return static_cast<int>(factors_.size()); }
  // The variable `first` is -1 in a free slot.
  const LinearFactor<B>& LinearFactorAt(int slot) const { return factors_[static_cast<std::size_t>(slot)]; }
  // Not after DropNormals.
  const Normal& NormalAt(int slot) const { return normals_[static_cast<std::size_t>(slot)]; }
  // For those who take each once: half of the memory of a slot.
  void DropNormals();
  bool HasNormals() const { return has_normals_; }
  // Slots of the living factors on a variable, ascending.
  const std::vector<int>& SlotsOf(int variable) const { return slots_of_[static_cast<std::size_t>(variable)]; }
  const Vector<B>& DiagonalOf(int variable) const { return diagonal_[static_cast<std::size_t>(variable)]; }
  // diag(H), B scalars per variable.
  std::vector<double> Diagonal() const;
  // b, minus half the gradient of chi2 at the linearisation point; B scalars per variable.
  std::vector<double> Gradient() const;

  // Throws std::invalid_argument for changes that contradict each other or the graph.
  void Check(const Changes& changes) const;
  // What Apply did, so that it can be taken back.
  struct Undo;
  // Leaves `undo` able to take back what was done so far, whatever throws. Of the changes, what is replaced comes
  // apart: `undo` takes it over.
  void Apply(const Changes& changes, Replaced replaced, Undo& undo);
  void Revert(Undo& undo);
  // The slots of what was removed are free from now on, and the changes are remembered as those since that version.
  void Commit(const Undo& undo, std::uint64_t version_before) noexcept;
  // New linear factors for slots 0, 1, ..., on the same variables. Throws std::invalid_argument for others.
  void SetLinearFactors(const std::vector<LinearFactor<B>>& factors, int threads);
  // The same for all slots without a copy: `factors` holds the old ones afterwards.
  void ExchangeLinearFactors(std::vector<LinearFactor<B>>& factors, int threads);

  // What changed from one version to the present one, a slot once. Only so much is remembered as can be of use for
  // downdating covariances: absent if it was more, or longer ago.
  std::optional<std::vector<SlotChange>> ChangesSince(std::uint64_t version, std::uint64_t present) const;
  void ForgetChanges() { history_.clear(); }

  // A variable that has had more factors than this is a hub: its diagonal is kept by blocks of kSlotBlock slots, so
  // that no change has to look at all of them.
  static constexpr std::size_t kHub = 1024;
  static constexpr int kSlotBlock = 1024;

 private:
  void RequireSameVariables(const std::vector<LinearFactor<B>>& factors) const;
  void RenewNormals(std::size_t slots, int threads);
  void SetSlot(int slot, const LinearFactor<B>& factor);
  void ExchangeSlot(int slot, LinearFactor<B>& factor);
  void Attach(int slot);
  bool AttachTo(int variable, int slot);
  void AttachNew(int slot, Undo& undo);
  void Detach(int slot);
  Vector<B> DiagonalPart(int variable, int slot) const;
  void RecountDiagonal(int variable);
  void SumDiagonal(int variable);
  void RecountDiagonals(std::vector<std::pair<int, int>>& changed);
  // As state_file.h says; derived members are for Rebuild, which needs to know how many variables there are.
  friend struct internal::StateAccess;
  template <int>
  friend class BlockCholesky;
  template <class Archive>
  void Serialize(Archive& archive);
  void Rebuild(std::size_t variables);
  // What is wrong with stored factors, on so many variables, as text; empty if nothing is.
  std::string FindDefect(std::size_t variables) const;

  std::vector<LinearFactor<B>> factors_;  // by slot
  std::vector<Normal> normals_;           // by slot
  bool has_normals_ = true;
  std::vector<int> free_slots_;
  std::vector<std::vector<int>> slots_of_;            // by variable
  std::vector<Vector<B>> diagonal_;                   // of H, by variable
  std::map<int, std::map<int, Vector<B>>> hub_sums_;  // by hub and block of slots
  struct Step {
    std::uint64_t version_before;
    std::vector<SlotChange> changes;
  };
  std::deque<Step> history_;  // the last steps
};

extern template class BlockSystem<3>;
extern template class BlockSystem<6>;

}  // namespace terse
