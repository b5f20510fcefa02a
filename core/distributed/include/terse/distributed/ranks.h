#pragma once
// The processes ("ranks") of a distributed run, and how they agree on errors: what one of them finds wrong, all throw.

#include <functional>
#include <stdexcept>
#include <string>

#include <mpi.h>

namespace terse {

// What every rank throws when one failed; what() starts with the rank, unless it is the only one.
class RankError : public std::runtime_error {
 public:
  enum class Kind { kInput, kNumerical };
  RankError(Kind kind, const std::string& message) : std::runtime_error(message), kind_(kind) {}
  Kind Cause() const { return kind_; }

 private:
  Kind kind_;
};

int RankOf(MPI_Comm ranks);
int RankCount(MPI_Comm ranks);

// Runs `work`, which must not communicate, on every rank. If it throws on one, all throw RankError with the cause of
// the lowest such rank: kNumerical for NumericalError. Collective.
void OnEveryRank(MPI_Comm ranks, const std::function<void()>& work);

// Throws RankError on all ranks unless all see the same file under this path; FileError's causes too. Collective.
void RequireSameFile(MPI_Comm ranks, const std::string& path);

}  // namespace terse
