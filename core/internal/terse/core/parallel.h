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

#if defined(__SANITIZE_THREAD__)
#define TERSE_THREAD_SANITIZER
#elif defined(__has_feature)
#if __has_feature(thread_sanitizer)
#define TERSE_THREAD_SANITIZER
#endif
#endif
#ifdef TERSE_THREAD_SANITIZER
extern "C" void __tsan_acquire(void* address);
extern "C" void __tsan_release(void* address);
#endif

namespace terse::internal {

// What ThreadSanitizer cannot see, as it does not look into oneTBB: all that comes before a parallel region happens
// before its bodies, and these before what follows it; nothing else. Between two bodies it finds races as ever.
class ForkJoin {
 public:
#ifdef TERSE_THREAD_SANITIZER
  void Fork() { __tsan_release(&fork_); }
  void Begin() { __tsan_acquire(&fork_); }
  void End() { __tsan_release(&join_); }
  void Join() { __tsan_acquire(&join_); }

 private:
  char fork_ = 0, join_ = 0;
#else
  void Fork() {}
  void Begin() {}
  void End() {}
  void Join() {}
#endif
};

// Runs body() with room for so many threads; ForEachChunk and ForEachBottomUp inside it share them. No more than the
// process may have, by default one per processor: oneTBB would complain on standard error.
template <class Body>
void WithThreads(int threads, const Body& body) {
  const auto allowed = tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism);
  ForkJoin order;
  order.Fork();
  tbb::task_arena(static_cast<int>(std::min(static_cast<std::size_t>(threads), allowed))).execute([&] {
    order.Begin();
    body();
    order.End();
  });
  order.Join();
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
  ForkJoin order;
  order.Fork();
  tbb::this_task_arena::isolate([&] {
    tbb::parallel_for(
        tbb::blocked_range<std::size_t>(0, chunks, 1),
        [&](const tbb::blocked_range<std::size_t>& range) {
          order.Begin();
          for (std::size_t k = range.begin(); k < range.end(); ++k) chunk(k);
          order.End();
        },
        tbb::simple_partitioner());
  });
  order.Join();
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
  ForkJoin order;
  order.Fork();
  tbb::task_group group;
  for (const int leaf : leaves) {
    group.run([&, leaf] {
      order.Begin();
      // The last child takes its parent on.
      for (int k = leaf; k >= 0;) {
        body(k);
        k = parents[static_cast<std::size_t>(k)];
        if (k >= 0 && missing[static_cast<std::size_t>(k)].fetch_sub(1, std::memory_order_acq_rel) > 1) break;
      }
      order.End();
    });
  }
  group.wait();
  order.Join();
}

}  // namespace terse::internal
