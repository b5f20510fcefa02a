#pragma once
// The normal equations H d = b in blocks of B scalars over the ranks, by PETSc. Rows are owned in unbroken ranges, and
// each rank adds to its own only.

#include <petscksp.h>

#include <utility>
#include <vector>

namespace terse::internal {

// What PETSc reported is thrown as std::runtime_error.
void Check(PetscErrorCode code);

// A PETSc object that is destroyed with its owner.
template <class Handle, PetscErrorCode (*Destroy)(Handle*)>
class Owned {
 public:
  Owned() = default;
  ~Owned() { Destroy(&handle_); }
  Owned(const Owned&) = delete;
  Owned& operator=(const Owned&) = delete;
  operator Handle() const { return handle_; }  // NOLINT(google-explicit-constructor): for PETSc's functions
  Handle* Out() { return &handle_; }

 private:
  Handle handle_ = nullptr;
};

class PetscSystem {
 public:
  // Block rows [begin, end) are this rank's. `pairs`: for every off-diagonal block in them its row and column, in any
  // order, repeated or not. Collective.
  PetscSystem(MPI_Comm ranks, int block, int begin, int end, std::vector<std::pair<int, int>> pairs);

  void SetZero();
  // Adds to an own block row; `values` is row by row.
  void AddBlock(int row, int column, const double* values);
  void AddRight(int row, const double* values);
  // The right side of all own rows, in place of what is there.
  void SetRight(const std::vector<double>& values);
  void FinishAssembly();  // collective
  // Whether a preconditioner takes the place of the factor.
  bool IsIterative() const { return is_iterative_; }
  // For multigrid: motions that the matrix hardly resists, B values per own block row each. Collective.
  void SetNearNullSpace(const std::vector<std::vector<double>>& motions);
  // Factorises, or makes what preconditions. Throws RankError if that fails. Collective, as what follows.
  void Factor();
  // The solution for the assembled right side, on every rank whole.
  std::vector<double> Solve();
  // b' d of the last Solve.
  double Decrement() const { return decrement_; }
  // Column `scalar` of the inverse, its part for the block of `scalar`, on every rank.
  std::vector<double> InverseColumn(PetscInt scalar);

 private:
  void SolveLinear();
  // Makes room in MUMPS for what it had too little for; false if that was not the cause.
  bool MakeRoom();

  MPI_Comm ranks_;
  PetscInt block_, begin_, end_;
  Owned<Mat, MatDestroy> matrix_;
  Owned<Vec, VecDestroy> right_, solution_, everywhere_;
  Owned<VecScatter, VecScatterDestroy> to_all_;
  Owned<KSP, KSPDestroy> solver_;
  bool is_iterative_ = false;
  double decrement_ = 0;
};

}  // namespace terse::internal
