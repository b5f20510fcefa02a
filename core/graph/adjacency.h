#pragma once
// Who touches whom in a pose graph, by indices. Private to the library.

#include <algorithm>
#include <numeric>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::internal {

// The factors at each pose in the order of the graph. other == the pose itself: a prior.
struct Adjacency {
  struct Entry {
    int other, factor;
  };
  std::vector<std::size_t> begin;  // of each pose's entries; one more than there are poses
  std::vector<Entry> entries;

  struct Range {
    const Entry *first, *last;
    const Entry* begin() const { return first; }
    const Entry* end() const { return last; }
  };
  Range At(int pose) const {
    const auto p = static_cast<std::size_t>(pose);
    return {entries.data() + begin[p], entries.data() + begin[p + 1]};
  }
};

template <class Pose>
Adjacency BuildAdjacency(const PoseGraph<Pose>& graph) {
  const auto& factors = graph.Factors();
  std::vector<std::pair<int, int>> ends(factors.size());
  Adjacency out;
  out.begin.assign(graph.Poses().size() + 1, 0);
  for (std::size_t f = 0; f < factors.size(); ++f) {
    const FactorPoses poses = PosesOf(factors[f].factor);
    const int a = graph.IndexOf(poses.first), b = graph.IndexOf(poses.second);
    ends[f] = {a, b};
    ++out.begin[static_cast<std::size_t>(a) + 1];
    if (a != b) ++out.begin[static_cast<std::size_t>(b) + 1];
  }
  std::partial_sum(out.begin.begin(), out.begin.end(), out.begin.begin());
  out.entries.resize(out.begin.back());
  std::vector<std::size_t> next(out.begin.begin(), out.begin.end() - 1);
  for (std::size_t f = 0; f < ends.size(); ++f) {
    const auto [a, b] = ends[f];
    out.entries[next[static_cast<std::size_t>(a)]++] = {b, static_cast<int>(f)};
    if (a != b) out.entries[next[static_cast<std::size_t>(b)]++] = {a, static_cast<int>(f)};
  }
  return out;
}

// Pose indices by ascending id.
template <class Pose>
std::vector<int> PosesById(const PoseGraph<Pose>& graph) {
  const auto& poses = graph.Poses();
  std::vector<int> by_id(poses.size());
  std::iota(by_id.begin(), by_id.end(), 0);
  std::sort(by_id.begin(), by_id.end(), [&](int a, int b) {
    return poses[static_cast<std::size_t>(a)].id < poses[static_cast<std::size_t>(b)].id;
  });
  return by_id;
}

}  // namespace terse::internal
