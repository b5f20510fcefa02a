#pragma once
// Where a batch optimisation starts.
//
// The frame of the result. A fixed pose with a value (the one of lowest id) decides: everything is moved rigidly
// so that it has exactly that value. Otherwise the first pose (lowest id) has its file value, or else that of its
// pose prior, or else the identity. Position priors outrank a first pose's value: kCompose and kTree then lay the
// result over them by least squares, as one rigid body as far as they determine its motion, or stretch by stretch,
// whichever leaves the lower chi2; what was composed stays if that does. kChordal prefers priors to the first pose's
// value, see there.

#include <cstdint>
#include <functional>
#include <vector>

#include "terse/core/error.h"
#include "terse/core/log.h"
#include "terse/core/pose_graph.h"

namespace terse {

enum class InitialValues {
  // Each pose from an arrived neighbour by its first connecting factor, in online order (arrival.h).
  kCompose,
  // As the file says.
  kFile,
  // Along a breadth-first spanning tree of the relative factors from the first pose: fewest factors to each pose.
  kTree,
  // Rotations, then translations, each by one linear least-squares problem (chordal relaxation: Martinec and Pajdla,
  // CVPR 2007; Carlone et al., ICRA 2015). Good where the noise is large. Pose priors enter both problems. Without
  // any, position priors align the frame if they can; they enter the second problem in any case.
  kChordal,
  // The best of the others, taken a few steps further (ChooseStart, start_values.h).
  kAuto,
};
const char* Name(InitialValues method);  // compose, file, tree, chordal, auto

// Of kChordal and kAuto, which factorise.
struct StartOptions {
  int threads = 1;                                    // at most; the result is the same for any number
  LogSink log;                                        // log.h
  std::function<void(double share)> factor_progress;  // as in BatchOptions
  std::vector<int> order;                             // as in BatchOptions
  std::uint64_t most_factor_bytes = 0;                // as in BatchOptions
};

// Pose values in the order of graph.Poses(). O(V + E) and, for kChordal, sparse factorisations (kAuto: more). Throws
// std::invalid_argument if the graph is not connected (not for kFile) or, for kFile, names the first pose
// without a value; NumericalError if kChordal's systems are singular to rounding.
template <class Pose>
std::vector<Pose> ComputeInitialValues(const PoseGraph<Pose>& graph, InitialValues method,
                                       const StartOptions& options = {});

}  // namespace terse
