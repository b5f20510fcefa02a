#pragma once
// The factors between a pose and its neighbours, and what they say of the neighbours alone (retire_poses.h).
//
// Everything is linear about the present estimates: T_a_b = E_a_b Exp(d) with E the estimate, d normal.

#include <optional>
#include <utility>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::internal {

// All factors between p and one neighbour k as one: the d of T_p_k.
template <class Pose>
class Arm {
 public:
  using Jacobian = typename Pose::Jacobian;
  using Tangent = typename Pose::Tangent;

  explicit Arm(const Pose& E_p_k) : E_p_k_(E_p_k) {}
  // `p`: one of its two poses.
  void Add(PoseId p, const RelativePoseFactor<Pose>& factor);

  const Pose& Estimate() const { return E_p_k_; }
  const Jacobian& Information() const { return information_; }
  const Tangent& Vector() const { return vector_; }  // the information times the mean
  Jacobian Covariance() const;
  Tangent Mean() const;
  // As a factor between these, with the same minimum and curvature at the estimate.
  RelativePoseFactor<Pose> AsFactor(PoseId p, PoseId k) const;

 private:
  Pose E_p_k_;
  Jacobian information_ = Jacobian::Zero();
  Tangent vector_ = Tangent::Zero();
};

// The factor that says d ~ N(mean, information^-1) in T = E Exp(d); its ends are the caller's to name.
template <class Pose>
RelativePoseFactor<Pose> FactorOf(const Pose& E, const typename Pose::Tangent& mean,
                                  const typename Pose::Jacobian& information);

// Whether a factor of such a mean is as good as linear: it does not disagree with the estimate by more than its
// covariance can explain, nor by an angle that the chart would bend.
template <class Pose>
bool IsMild(const typename Pose::Tangent& mean, const typename Pose::Jacobian& information);

// From the i-th neighbour to the j-th.
template <class Pose>
struct TreeFactor {
  int i, j;
  Pose T_i_j;
  typename Pose::Jacobian information;
};

template <class Pose>
struct Tree {
  std::vector<TreeFactor<Pose>> factors;
  double loss = 0;   // nats
  double scale = 1;  // of all covariances
};

// The tree over the neighbours, `must` one of its edges. Absent where the factors disagree with the estimates by more
// than their covariances say, so that nothing is linear, or the numbers are beyond what the arithmetic can hold.
template <class Pose>
std::optional<Tree<Pose>> RecoverTree(const std::vector<Arm<Pose>>& arms, std::optional<std::pair<int, int>> must);

}  // namespace terse::internal
