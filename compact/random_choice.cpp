#include "terse/compact/random_choice.h"

#include <algorithm>
#include <numeric>
#include <random>
#include <set>

#include "terse/core/at.h"

namespace terse {
namespace {

using internal::At;
using std::size_t;

// Leaves `count` elements, those before `from` among them, the others drawn (Fisher and Yates).
void Draw(std::vector<int>& list, size_t from, size_t count, std::mt19937_64& engine) {
  for (size_t k = from; k < std::min(count, list.size()); ++k) {
    std::swap(list[k], list[k + engine() % (list.size() - k)]);
  }
  list.resize(std::min(count, list.size()));
}

}  // namespace

template <class Pose>
void DrawAtRandom(GraphReplay<Pose>& replay, int poses, int links, std::uint64_t seed) {
  std::mt19937_64 engine(seed);
  std::vector<int> chosen(replay.Inputs().size()), between;
  std::iota(chosen.begin(), chosen.end(), 0);
  Draw(chosen, 1, At(std::max(poses, 1)), engine);
  std::set<std::int64_t> drawn;
  for (const int k : chosen) drawn.insert(replay.Inputs()[At(k)].id.value);
  for (int k = 0; k < replay.LinksOffered(); ++k) {
    const RelativePoseFactor<Pose>& link = replay.Link(k);
    if (drawn.count(link.from.value) != 0 && drawn.count(link.to.value) != 0) between.push_back(k);
  }
  Draw(between, 0, At(std::max(links, 0)), engine);
  std::sort(between.begin(), between.end());
  replay.Choose(chosen, between);
}

template void DrawAtRandom(GraphReplay<SE2>&, int, int, std::uint64_t);
template void DrawAtRandom(GraphReplay<SE3>&, int, int, std::uint64_t);

}  // namespace terse
