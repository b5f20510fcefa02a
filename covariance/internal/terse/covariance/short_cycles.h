#pragma once
// Loops that lead from one place to the same other place, and the odometry between their ends, close a short cycle:
// how far it is from closed tells how good measurements are, whatever other loops say and however far odometry drifts.

#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

#include "terse/covariance/information_probe.h"

namespace terse::internal {

// Of the relative factors between poses that arrive one after the other, composed in stretches without a gap.
// Covariances of a chain, seen from its start, add up.
template <class Pose>
class OdometryChain {
 public:
  using Covariance = typename Pose::Jacobian;
  OdometryChain(const std::vector<ProbeTerm<Pose>>& terms, std::size_t poses);

  bool IsWhole() const { return is_whole_; }
  bool Joins(int from, int to) const;
  // Between poses that are joined.
  Pose Way(int from, int to) const;
  // Of the way, tangent at its end.
  Covariance CovarianceOf(int from, int to) const;

 private:
  std::vector<Pose> T_;  // from the start of the first stretch, as if there were no gaps
  std::vector<Covariance> covariance_;
  std::vector<int> stretch_;
  bool is_whole_ = true;
};

// From an earlier pose to a later one.
template <class Pose>
struct LoopMeasurement {
  std::size_t term = 0;
  int first = -1, last = -1;
  Pose T_first_last;
  typename Pose::Jacobian covariance;  // tangent at the later pose
};

// What lacks, to close the cycle, at the later end of its second loop; exponential coordinates.
template <class Pose>
struct CycleError {
  typename Pose::Tangent error;
  typename Pose::Jacobian covariance;
};

// Those of the terms asked for, in order of arrival.
template <class Pose>
std::vector<LoopMeasurement<Pose>> LoopMeasurements(const std::vector<ProbeTerm<Pose>>& terms,
                                                    const std::vector<char>& is_asked_for);

// Of each loop with the last one before it whose ends are close to its own; none if there is no such loop.
template <class Pose>
std::vector<std::optional<CycleError<Pose>>> ShortCycles(const std::vector<LoopMeasurement<Pose>>& loops,
                                                         const OdometryChain<Pose>& odometry);

// Factors on standard deviations, one for odometry and loops, with which half of the short cycles are closed. Wrong
// loops that stand alone are in none, those in groups agree with each other: more than half may be wrong. None where
// there are few cycles.
template <class Pose>
std::optional<KindScale> ScaleOfShortCycles(const std::vector<std::optional<CycleError<Pose>>>& cycles);

}  // namespace terse::internal
