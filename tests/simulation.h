#pragma once
// Simulated runs with noise drawn from the covariance that the factors state, and what is expected of their errors.
//
// Normalised estimation error squared (NEES): e' Sigma^-1 e, e = Local(estimate, truth) in the body frame. If Sigma is
// the covariance of e, it is chi-square distributed with as many degrees of freedom as e has scalars, and so is the sum
// over independent runs (Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking and Navigation, 5.4.2).

#include "testing.h"

namespace terse::testing {

struct SimulationOptions {
  double noise = 1;          // times 1 cm and 5 mrad per edge, or some times that
  bool priors = false;       // noisy absolute measurements instead of an anchored first pose
  int poses = 41, lap = 20;  // two laps, loops between them
};

template <class Pose>
struct Simulation {
  PoseGraph<Pose> graph;      // ids 0, 1, ...; the first pose has its true value, the others none
  std::vector<Pose> truth;    // by pose index
  std::vector<Pose> initial;  // the odometry, composed
};

// Z with Local(Z^-1 T) = n exactly.
template <class Pose>
Pose Measured(const Pose& T, const typename Pose::Tangent& n) {
  return T * Pose().Retract(n).Inverse();
}

// A closed course of 20 poses, about 1 m apart, which in space rises, falls and banks: the same for all seeds. The
// informations are correlated; standard deviations are the ones asked for times 1.4 in the median, 3.2 at most.
template <class Pose>
Simulation<Pose> Simulate(std::uint64_t seed, const SimulationOptions& options = {});

double Nees(const Eigen::VectorXd& e, const Eigen::MatrixXd& Sigma);

// Of the standard normal distribution.
double NormalQuantile(double probability);

// After Wilson and Hilferty; good to 1e-4 of itself from 100 degrees of freedom on.
double ChiSquareQuantile(double dof, double probability);

struct Interval {
  double low, high;
  bool Contains(double x) const { return low < x && x < high; }
};

// Where the mean NEES over `runs` runs with `dof` scalars each lies with this probability.
Interval NeesInterval(int runs, int dof, double probability = 0.95);

}  // namespace terse::testing
