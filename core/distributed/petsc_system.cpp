#include "distributed/petsc_system.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "terse/distributed/distributed_solver.h"
#include "terse/distributed/ranks.h"

namespace terse {
namespace {

std::string first_message;  // of the error that PETSc is unwinding from

PetscErrorCode KeepMessage(MPI_Comm, int, const char*, const char*, PetscErrorCode code, PetscErrorType type,
                           const char* message, void*) {
  if (type == PETSC_ERROR_INITIAL && message != nullptr) first_message = message;
  return code;
}

[[noreturn]] void FailNumerically(const std::string& cause) { throw RankError(RankError::Kind::kNumerical, cause); }

bool HasOption(const char* name) {
  PetscBool found = PETSC_FALSE;
  internal::Check(PetscOptionsHasName(nullptr, nullptr, name, &found));
  return found == PETSC_TRUE;
}

// Scalars of a pose differ by orders of magnitude: what smooths them by the scalar makes multigrid indefinite.
void SetMultigridDefaults() {
  constexpr char kSmoother[] = "-mg_levels_pc_type";
  PetscBool is_multigrid = PETSC_FALSE;
  char type[32] = "";
  internal::Check(PetscOptionsGetString(nullptr, nullptr, "-pc_type", type, sizeof type, nullptr));
  internal::Check(PetscStrcmp(type, PCGAMG, &is_multigrid));
  if (is_multigrid == PETSC_TRUE && !HasOption(kSmoother)) {
    internal::Check(PetscOptionsSetValue(nullptr, kSmoother, "pbjacobi"));
  }
}

}  // namespace

PetscSession::PetscSession(const std::vector<std::string>& options) {
  std::vector<std::string> words{"terse"};
  words.insert(words.end(), options.begin(), options.end());
  std::vector<char*> argv;
  argv.reserve(words.size() + 1);
  for (std::string& word : words) argv.push_back(word.data());
  int argc = static_cast<int>(argv.size());
  argv.push_back(nullptr);
  char** argv_data = argv.data();
  if (PetscInitialize(&argc, &argv_data, nullptr, nullptr) != 0) throw std::runtime_error("PETSc does not start");
  internal::Check(PetscPushErrorHandler(KeepMessage, nullptr));
  internal::Check(PetscPopSignalHandler());  // a crash is the program's, which mpirun reports
}

PetscSession::~PetscSession() {
  PetscOptionsSetValue(nullptr, "-options_left", "no");  // UnusedOptions says it in time
  PetscFinalize();
}

std::vector<std::string> PetscSession::UnusedOptions() const {
  PetscInt count = 0;
  char **names = nullptr, **values = nullptr;
  internal::Check(PetscOptionsLeftGet(nullptr, &count, &names, &values));
  std::vector<std::string> out;
  out.reserve(static_cast<std::size_t>(count));
  for (PetscInt k = 0; k < count; ++k) out.push_back(std::string("-") + names[k]);
  internal::Check(PetscOptionsLeftRestore(nullptr, &count, &names, &values));
  return out;
}

namespace internal {

void Check(PetscErrorCode code) {
  if (code == 0) return;
  const char* general = nullptr;
  PetscErrorMessage(code, &general, nullptr);
  std::string cause = first_message.empty() && general != nullptr ? general : first_message;
  first_message.clear();
  throw std::runtime_error("PETSc: " + cause);
}

PetscSystem::PetscSystem(MPI_Comm ranks, int block, int begin, int end, std::vector<std::pair<int, int>> pairs)
    : ranks_(ranks), block_(block), begin_(begin), end_(end) {
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  // Blocks per own row: in the columns of this rank and in others', and in the upper triangle alone.
  const auto rows = static_cast<std::size_t>(end - begin);
  std::vector<PetscInt> own(rows, 1), others(rows, 0), own_upper(rows, 1), others_upper(rows, 0);
  for (const auto& [row, column] : pairs) {
    const auto r = static_cast<std::size_t>(row - begin);
    const bool is_own = begin <= column && column<end, is_upper = column> row;
    ++(is_own ? own : others)[r];
    if (is_upper) ++(is_own ? own_upper : others_upper)[r];
  }
  // A factor needs the upper triangle alone; most preconditioners need both.
  is_iterative_ = HasOption("-pc_type");
  const PetscInt local = (end_ - begin_) * block_;
  Check(MatCreate(ranks_, matrix_.Out()));
  Check(MatSetSizes(matrix_, local, local, PETSC_DETERMINE, PETSC_DETERMINE));
  Check(MatSetBlockSize(matrix_, block_));
  Check(MatSetType(matrix_, is_iterative_ ? MATAIJ : MATSBAIJ));
  Check(MatSetFromOptions(matrix_));
  Check(MatXAIJSetPreallocation(matrix_, block_, own.data(), others.data(), own_upper.data(), others_upper.data()));
  Check(MatSetOption(matrix_, MAT_SPD, PETSC_TRUE));
  Check(MatSetOption(matrix_, MAT_NO_OFF_PROC_ENTRIES, PETSC_TRUE));
  Check(MatSetOption(matrix_, MAT_NEW_NONZERO_ALLOCATION_ERR, PETSC_TRUE));
  PetscBool is_sbaij = PETSC_FALSE;
  Check(PetscObjectTypeCompareAny(reinterpret_cast<PetscObject>(static_cast<Mat>(matrix_)), &is_sbaij, MATSEQSBAIJ,
                                  MATMPISBAIJ, ""));
  if (is_sbaij == PETSC_TRUE) Check(MatSetOption(matrix_, MAT_IGNORE_LOWER_TRIANGULAR, PETSC_TRUE));

  Check(MatCreateVecs(matrix_, solution_.Out(), right_.Out()));
  Check(VecScatterCreateToAll(solution_, to_all_.Out(), everywhere_.Out()));

  Check(KSPCreate(ranks_, solver_.Out()));
  Check(KSPSetOperators(solver_, matrix_, matrix_));
  PC conditioner = nullptr;
  Check(KSPGetPC(solver_, &conditioner));
  if (is_iterative_) {
    Check(KSPSetType(solver_, KSPCG));
    Check(KSPSetTolerances(solver_, 1e-8, PETSC_DEFAULT, PETSC_DEFAULT, PETSC_DEFAULT));
    SetMultigridDefaults();
  } else {
    Check(KSPSetType(solver_, KSPPREONLY));
    Check(PCSetType(conditioner, PCCHOLESKY));
    Check(PCFactorSetMatSolverType(conditioner, MATSOLVERMUMPS));
  }
  Check(KSPSetFromOptions(solver_));
}

void PetscSystem::SetZero() {
  Check(MatZeroEntries(matrix_));
  Check(VecSet(right_, 0));
}

void PetscSystem::AddBlock(int row, int column, const double* values) {
  const PetscInt r = row, c = column;
  Check(MatSetValuesBlocked(matrix_, 1, &r, 1, &c, values, ADD_VALUES));
}

void PetscSystem::AddRight(int row, const double* values) {
  double* own = nullptr;
  Check(VecGetArray(right_, &own));
  double* block = own + (row - begin_) * block_;
  for (PetscInt k = 0; k < block_; ++k) block[k] += values[k];
  Check(VecRestoreArray(right_, &own));
}

void PetscSystem::SetRight(const std::vector<double>& values) {
  double* own = nullptr;
  Check(VecGetArray(right_, &own));
  std::copy(values.begin(), values.end(), own);
  Check(VecRestoreArray(right_, &own));
}

void PetscSystem::FinishAssembly() {
  Check(MatAssemblyBegin(matrix_, MAT_FINAL_ASSEMBLY));
  Check(MatAssemblyEnd(matrix_, MAT_FINAL_ASSEMBLY));
  Check(KSPSetOperators(solver_, matrix_, matrix_));
}

void PetscSystem::SetNearNullSpace(const std::vector<std::vector<double>>& motions) {
  std::vector<Owned<Vec, VecDestroy>> owned(motions.size());
  std::vector<Vec> vectors;
  for (std::size_t k = 0; k < motions.size(); ++k) {
    Check(VecDuplicate(solution_, owned[k].Out()));
    double* values = nullptr;
    Check(VecGetArray(owned[k], &values));
    std::copy(motions[k].begin(), motions[k].end(), values);
    Check(VecRestoreArray(owned[k], &values));
    for (const Vec before : vectors) {  // orthonormal, as PETSc wants them
      double share = 0;
      Check(VecDot(owned[k], before, &share));
      Check(VecAXPY(owned[k], -share, before));
    }
    Check(VecNormalize(owned[k], nullptr));
    vectors.push_back(owned[k]);
  }
  Owned<MatNullSpace, MatNullSpaceDestroy> space;
  Check(MatNullSpaceCreate(ranks_, PETSC_FALSE, static_cast<PetscInt>(vectors.size()), vectors.data(), space.Out()));
  Check(MatSetNearNullSpace(matrix_, space));
}

void PetscSystem::Factor() {
  PC conditioner = nullptr;
  Check(KSPGetPC(solver_, &conditioner));
  while (true) {
    Check(KSPSetUp(solver_));
    PCFailedReason reason = PC_NOERROR;
    Check(PCSetUp(conditioner));
    Check(PCGetFailedReason(conditioner, &reason));
    auto worst = static_cast<int>(reason);
    MPI_Allreduce(MPI_IN_PLACE, &worst, 1, MPI_INT, MPI_MAX, ranks_);
    if (worst == static_cast<int>(PC_NOERROR)) return;
    if (!MakeRoom()) break;
  }
  Mat factor = nullptr;
  PetscInt code = 0;
  if (PCFactorGetMatrix(conditioner, &factor) == 0) MatMumpsGetInfog(factor, 1, &code);
  const std::string detail = code != 0 ? " (MUMPS reports INFOG(1) = " + std::to_string(code) + ")" : "";
  const bool is_memory = code == -9 || code == -13 || code == -19 || code == -20;
  FailNumerically((is_memory ? "out of memory in the factorisation" : "the system is not positive definite") + detail);
}

bool PetscSystem::MakeRoom() {
  PC conditioner = nullptr;
  Check(KSPGetPC(solver_, &conditioner));
  MatSolverType type = nullptr;
  Check(PCFactorGetMatSolverType(conditioner, &type));
  if (type == nullptr || std::string(type) != MATSOLVERMUMPS) return false;
  Mat factor = nullptr;
  Check(PCFactorGetMatrix(conditioner, &factor));
  PetscInt code = 0, room = 0;
  Check(MatMumpsGetInfog(factor, 1, &code));
  Check(MatMumpsGetIcntl(factor, 14, &room));  // per cent beyond the estimate
  constexpr PetscInt kMostRoom = 400;
  if (code != -9 || room >= kMostRoom) return false;
  Check(MatMumpsSetIcntl(factor, 14, std::max<PetscInt>(2 * room, 40)));
  FinishAssembly();  // counts as a change, without which the factor would not be made again
  return true;
}

void PetscSystem::SolveLinear() {
  Check(KSPSolve(solver_, right_, solution_));
  KSPConvergedReason reason = KSP_CONVERGED_ITERATING;
  Check(KSPGetConvergedReason(solver_, &reason));
  if (reason < 0) {
    FailNumerically("the linear solver fails: " + std::string(KSPConvergedReasons[reason]) +
                    "; PETSc's options set its limits, as -ksp_max_it");
  }
}

std::vector<double> PetscSystem::Solve() {
  SolveLinear();
  Check(VecDot(right_, solution_, &decrement_));
  if (!std::isfinite(decrement_)) FailNumerically("the system is singular to rounding");
  Check(VecScatterBegin(to_all_, solution_, everywhere_, INSERT_VALUES, SCATTER_FORWARD));
  Check(VecScatterEnd(to_all_, solution_, everywhere_, INSERT_VALUES, SCATTER_FORWARD));
  const double* values = nullptr;
  PetscInt size = 0;
  Check(VecGetSize(everywhere_, &size));
  Check(VecGetArrayRead(everywhere_, &values));
  std::vector<double> out(values, values + size);
  Check(VecRestoreArrayRead(everywhere_, &values));
  return out;
}

std::vector<double> PetscSystem::InverseColumn(PetscInt scalar) {
  const PetscInt row = scalar / block_;
  const bool is_own = begin_ <= row && row < end_;
  Check(VecSet(right_, 0));
  if (is_own) Check(VecSetValue(right_, scalar, 1, INSERT_VALUES));
  Check(VecAssemblyBegin(right_));
  Check(VecAssemblyEnd(right_));
  SolveLinear();
  std::vector<double> out(static_cast<std::size_t>(block_), 0.0);
  if (is_own) {
    const double* values = nullptr;
    Check(VecGetArrayRead(solution_, &values));
    std::copy_n(values + (row - begin_) * block_, block_, out.begin());
    Check(VecRestoreArrayRead(solution_, &values));
  }
  MPI_Allreduce(MPI_IN_PLACE, out.data(), static_cast<int>(block_), MPI_DOUBLE, MPI_SUM, ranks_);
  return out;
}

}  // namespace internal
}  // namespace terse
