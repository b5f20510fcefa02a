#pragma once
// What short cycles (odometry_chain.h) say of the scale of the measurements.

#include <optional>
#include <vector>

#include "terse/core/odometry_chain.h"
#include "terse/covariance/information_probe.h"

namespace terse::internal {

// All terms, numbered as they are.
template <class Pose>
std::vector<ForwardEdge<Pose>> ForwardEdges(const std::vector<ProbeTerm<Pose>>& terms);
// Those asked for, in order of arrival.
template <class Pose>
std::vector<ForwardEdge<Pose>> ForwardEdges(const std::vector<ProbeTerm<Pose>>& terms,
                                            const std::vector<char>& is_asked_for);

// Of each loop with the last one before it whose ends are close to its own; none if there is no such loop.
template <class Pose>
std::vector<std::optional<CycleError<Pose>>> ShortCycles(const std::vector<ForwardEdge<Pose>>& loops,
                                                         const OdometryChain<Pose>& odometry);

// Factors on standard deviations, one for odometry and loops, with which half of the short cycles are closed. Wrong
// loops that stand alone are in none, those in groups agree with each other: more than half may be wrong. None where
// there are few cycles.
template <class Pose>
std::optional<KindScale> ScaleOfShortCycles(const std::vector<std::optional<CycleError<Pose>>>& cycles);

}  // namespace terse::internal
