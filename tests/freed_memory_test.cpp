#include "terse/core/freed_memory.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cstring>
#include <memory>
#include <vector>

#include "slow_build.h"

namespace terse {
namespace {

long PageFaults() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_minflt;
}

// Of taking, filling and freeing 100 MB.
long FaultsOfUsingMuch() {
  constexpr std::size_t kPiece = 20u << 20;
  const long before = PageFaults();
  std::vector<std::unique_ptr<char[]>> pieces;
  for (int k = 0; k < 5; ++k) {
    pieces.emplace_back(new char[kPiece]);
    std::memset(pieces.back().get(), k, kPiece);
    EXPECT_EQ(pieces.back()[kPiece / 2], k);
  }
  return PageFaults() - before;
}

TEST(FreedMemory, IsThereForWhatComesNext) {
  for (int k = 0; k < 2; ++k) FaultsOfUsingMuch();
  const long as_before = FaultsOfUsingMuch();
  KeepFreedMemory();
  FaultsOfUsingMuch();
  if (kSlowBuild) return;  // sanitizers have a heap of their own
  EXPECT_GT(as_before, 0);
  EXPECT_LT(FaultsOfUsingMuch(), as_before / 2);  // none, but where the kernel moves pages
}

}  // namespace
}  // namespace terse
