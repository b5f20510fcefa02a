#include "terse/distributed/ranks.h"

#include <cstdint>
#include <new>
#include <vector>

#include "terse/core/error.h"
#include "terse/core/line_stream.h"

namespace terse {
namespace {

enum Verdict : int { kInput = 0, kNumerical = 1 };

}  // namespace

int RankOf(MPI_Comm ranks) {
  int rank = 0;
  MPI_Comm_rank(ranks, &rank);
  return rank;
}

int RankCount(MPI_Comm ranks) {
  int count = 1;
  MPI_Comm_size(ranks, &count);
  return count;
}

void OnEveryRank(MPI_Comm ranks, const std::function<void()>& work) {
  const int rank = RankOf(ranks), count = RankCount(ranks);
  std::string cause;
  int verdict[2] = {count, kInput};  // the rank that failed, and how
  const auto fail = [&](Verdict kind, const char* what) {
    cause = what;
    verdict[0] = rank;
    verdict[1] = kind;
  };
  try {
    work();
  } catch (const NumericalError& error) {
    fail(kNumerical, error.what());
  } catch (const std::bad_alloc&) {
    fail(kInput, "out of memory");
  } catch (const std::exception& error) {
    fail(kInput, error.what());
  }
  int first = count;
  MPI_Allreduce(&verdict[0], &first, 1, MPI_INT, MPI_MIN, ranks);
  if (first == count) return;
  MPI_Bcast(&verdict[1], 1, MPI_INT, first, ranks);
  auto length = static_cast<int>(cause.size());
  MPI_Bcast(&length, 1, MPI_INT, first, ranks);
  cause.resize(static_cast<std::size_t>(length));
  MPI_Bcast(cause.data(), length, MPI_CHAR, first, ranks);
  if (count > 1) cause = "rank " + std::to_string(first) + ": " + cause;
  throw RankError(verdict[1] == kNumerical ? RankError::Kind::kNumerical : RankError::Kind::kInput, cause);
}

void RequireSameFile(MPI_Comm ranks, const std::string& path) {
  FileFingerprint own;
  OnEveryRank(ranks, [&] { own = FingerprintOf(path); });
  const std::uint64_t mine[2] = {own.bytes, own.crc32};
  std::vector<std::uint64_t> all(2 * static_cast<std::size_t>(RankCount(ranks)));
  MPI_Allgather(mine, 2, MPI_UINT64_T, all.data(), 2, MPI_UINT64_T, ranks);
  for (std::size_t r = 1; 2 * r < all.size(); ++r) {
    if (all[2 * r] == all[0] && all[2 * r + 1] == all[1]) continue;
    std::string cause = path;
    cause.append(": ranks 0 and ").append(std::to_string(r)).append(" read different files under this path, of ");
    cause.append(std::to_string(all[0])).append(" and ").append(std::to_string(all[2 * r]));
    cause.append(" bytes; expected the same file on every machine");
    throw RankError(RankError::Kind::kInput, cause);
  }
}

}  // namespace terse
