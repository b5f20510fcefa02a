// Loops and trees spread over threads: every part is done once, a node after its children. Under ThreadSanitizer also
// that what a region reads and writes needs no lock of its own.

#include "terse/core/parallel.h"

#include <gtest/gtest.h>

#include <numeric>

namespace terse::internal {
namespace {

const tbb::global_control kAllowed(tbb::global_control::max_allowed_parallelism, 4);

TEST(Parallel, EveryChunkOnceAgainAndAgain) {
  std::vector<long> values(10000, 0);
  for (int round = 1; round <= 50; ++round) {
    const long added = round;  // written by this thread, read by all
    SpreadChunks(4, values.size(), 64, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) values[k] += added;
    });
    const long expected = round * (round + 1) / 2;
    for (const long value : values) ASSERT_EQ(value, expected);
  }
}

TEST(Parallel, ANodeAfterItsChildren) {
  for (const int fan : {1, 2, 5, 2000}) {
    const int n = 2000;
    std::vector<int> parents(n, -1);
    for (int k = 0; k + 1 < n; ++k) parents[static_cast<std::size_t>(k)] = std::min(n - 1, k + 1 + (k * 7) % fan);
    std::vector<std::vector<int>> children(n);
    for (int k = 0; k < n; ++k) {
      if (parents[static_cast<std::size_t>(k)] >= 0)
        children[static_cast<std::size_t>(parents[static_cast<std::size_t>(k)])].push_back(k);
    }
    std::vector<long> sizes(n, 0);
    WithThreads(4, [&] {
      ForEachBottomUp(parents, [&](int k) {
        long size = 1;
        for (const int child : children[static_cast<std::size_t>(k)]) size += sizes[static_cast<std::size_t>(child)];
        sizes[static_cast<std::size_t>(k)] = size;
        // A loop inside a node, as large fronts have them.
        std::vector<int> part(300, 0);
        ForEachChunk(true, part.size(), 50, [&](std::size_t begin, std::size_t end) {
          for (std::size_t i = begin; i < end; ++i) part[i] = k;
        });
        ASSERT_EQ(std::accumulate(part.begin(), part.end(), 0L), 300L * k);
      });
    });
    long all = 0;
    for (int k = 0; k < n; ++k) {
      if (parents[static_cast<std::size_t>(k)] < 0) all += sizes[static_cast<std::size_t>(k)];
    }
    EXPECT_EQ(all, n);
  }
}

}  // namespace
}  // namespace terse::internal
