#include "terse/core/freed_memory.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
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
  EXPECT_LT(FaultsOfUsingMuch(), as_before / 10);  // none, but where the kernel moves pages
}

// kB of the heap for which the kernel has been asked for large pages.
long HeapInLargePages() {
  std::ifstream smaps("/proc/self/smaps");
  long kilobytes = 0, asked = 0;
  bool is_heap = false;
  for (std::string line; std::getline(smaps, line);) {
    if (line.find('-') < line.find(' ') && line.find(':') > line.find(' ')) {
      is_heap = line.find("[heap]") != std::string::npos;
    }
    if (is_heap && line.rfind("Size:", 0) == 0) kilobytes = std::stol(line.substr(5));
    if (is_heap && line.rfind("VmFlags:", 0) == 0 && line.find(" hg") != std::string::npos) asked += kilobytes;
  }
  return asked;
}

TEST(FreedMemory, TheHeapIsInLargePages) {
  if (kSlowBuild || !std::filesystem::exists("/sys/kernel/mm/transparent_hugepage")) return;
  KeepFreedMemory();
  EXPECT_GT(HeapInLargePages(), 180 << 10);
}

}  // namespace
}  // namespace terse
