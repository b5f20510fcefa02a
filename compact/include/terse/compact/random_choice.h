#pragma once
// The baseline of compact runs: as many poses and links as another strategy keeps, but drawn at random.

#include <cstdint>

#include "terse/compact/graph_replay.h"

namespace terse {

// For Strategy::kGiven: chooses so many poses, the first one among them, and so many of the links between them, or all
// if there are not as many. Same seed, same choice.
template <class Pose>
void DrawAtRandom(GraphReplay<Pose>& replay, int poses, int links, std::uint64_t seed);

}  // namespace terse
