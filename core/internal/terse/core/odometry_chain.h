#pragma once
// Odometry composed with its covariance, and what it closes: loops that lead from one place to the same other place
// make a short cycle with the odometry between their ends. How far that is from closed tells how good measurements are,
// and whether they agree, whatever other loops say and however far odometry drifts.

#include <cstddef>
#include <optional>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::internal {

// A relative factor from an earlier pose to a later one; poses are numbered in order of arrival.
template <class Pose>
struct ForwardEdge {
  std::size_t number = 0;  // the caller's
  int first = -1, last = -1;
  Pose T_first_last;
  typename Pose::Jacobian covariance;  // tangent at the later pose
};

template <class Pose>
ForwardEdge<Pose> Forward(std::size_t number, int from, int to, const RelativePoseFactor<Pose>& factor);

// Of the edges between poses that arrive one after the other, composed in stretches without a gap; of two between the
// same poses the first. Covariances of a chain, seen from its start, add up.
template <class Pose>
class OdometryChain {
 public:
  using Covariance = typename Pose::Jacobian;
  OdometryChain(const std::vector<ForwardEdge<Pose>>& edges, std::size_t poses);

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

// What lacks, to close the cycle, at the later end of its second loop; exponential coordinates.
template <class Pose>
struct CycleError {
  typename Pose::Tangent error;
  typename Pose::Jacobian covariance;

  double Squared() const;  // over the variance
};

// Nothing if odometry does not join their ends.
template <class Pose>
std::optional<CycleError<Pose>> CycleOf(const ForwardEdge<Pose>& first, const ForwardEdge<Pose>& second,
                                        const OdometryChain<Pose>& odometry);

// Of the odometry between the ends of one loop with it.
template <class Pose>
std::optional<CycleError<Pose>> CycleOf(const ForwardEdge<Pose>& loop, const OdometryChain<Pose>& odometry);

}  // namespace terse::internal
