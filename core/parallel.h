#pragma once
// Work spread over threads (oneTBB) so that the results do not depend on their number: whoever calls these writes each
// result from one body only, and cuts the work where the number of threads has no say.

#include <tbb/blocked_range.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>
#include <tbb/task_group.h>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <vector>

namespace terse::internal {

// Runs body() with room for so many threads; ForEachChunk and ForEachBottomUp inside it share them. No more than the
// process may have, by default one per processor: oneTBB would complain on standard error.
template <class Body>
void WithThreads(int threads, const Body& body) {
  const auto allowed = tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism);
  tbb::task_arena(static_cast<int>(std::min(static_cast<std::size_t>(threads), allowed))).execute(body);
}

// Inside WithThreads: the calling thread's number, below that of the threads.
inline std::size_t ThreadIndex() { return static_cast<std::size_t>(tbb::this_task_arena::current_thread_index()); }

// body(begin, end) on [0, n) in chunks of `size`. While it waits, a thread takes on nothing but chunks of the same
// loop.
template <class Body>
void ForEachChunk(bool parallel, std::size_t n, std::size_t size, const Body& body) {
  const auto chunk = [&](std::size_t k) { body(k * size, std::min(n, (k + 1) * size)); };
  const std::size_t chunks = (n + size - 1) / size;
  if (!parallel || chunks < 2) {
    for (std::size_t k = 0; k < chunks; ++k) chunk(k);
    return;
  }
  tbb::this_task_arena::isolate([&] {
    tbb::parallel_for(
        tbb::blocked_range<std::size_t>(0, chunks, 1),
        [&](const tbb::blocked_range<std::size_t>& range) {
          for (std::size_t k = range.begin(); k < range.end(); ++k) chunk(k);
        },
        tbb::simple_partitioner());
  });
}

// The same with threads of its own.
template <class Body>
void SpreadChunks(int threads, std::size_t n, std::size_t size, const Body& body) {
  if (threads < 2 || n <= size) return ForEachChunk(false, n, size, body);
  WithThreads(threads, [&] { ForEachChunk(true, n, size, body); });
}

// body(k) for all nodes of a forest, each after all its children; parents[k] > k, or -1 for a root.
template <class Body>
void ForEachBottomUp(const std::vector<int>& parents, const Body& body) {
  std::vector<std::atomic<int>> missing(parents.size());
  for (auto& count : missing) count.store(0, std::memory_order_relaxed);
  for (const int parent : parents) {
    if (parent >= 0) missing[static_cast<std::size_t>(parent)].fetch_add(1, std::memory_order_relaxed);
  }
  std::vector<int> leaves;
  for (std::size_t k = 0; k < parents.size(); ++k) {
    if (missing[k].load(std::memory_order_relaxed) == 0) leaves.push_back(static_cast<int>(k));
  }
  tbb::task_group group;
  for (const int leaf : leaves) {
    group.run([&, leaf] {
      // The last child takes its parent on.
      for (int k = leaf; k >= 0;) {
        body(k);
        k = parents[static_cast<std::size_t>(k)];
        if (k >= 0 && missing[static_cast<std::size_t>(k)].fetch_sub(1, std::memory_order_acq_rel) > 1) break;
      }
    });
  }
  group.wait();
}

}  // namespace terse::internal
