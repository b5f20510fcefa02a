#pragma once
// The work model of Arablouei 2026 ("Efficient Incremental SLAM via Information-Guided and Selective Optimization") as
// its published code counts it, for comparison with its tables only. The code orders the scalars of the whole graph
// anew at every increment, with SYMAMD and a postorder of the elimination tree, and takes for kappa_i the entries in
// row i of L, where i is the scalar's number in the graph although L's rows are in elimination order. Costs: sum of
// kappa^2 over the variables refactored, twice the sum of kappa over those solved for; an edge between known variables
// is entered for nothing. O(entries of L) per increment.

#include <vector>

#include "terse/core/incremental_solver.h"

namespace terse::internal {

class PaperFlops {
 public:
  PaperFlops() = default;
  // At the present graph of the factor. Two numbers are coupled where a factor's products do not vanish, position and
  // rotation looked at separately: H then has the pattern that a sparse product of Jacobians gives.
  template <int B>
  explicit PaperFlops(const BlockCholesky<B>& factor);

  double Added(int first_new) const;  // entering variables from `first_new` on
  double Updated() const;             // all relinearised
  double Updated(const std::vector<int>& variables) const;
  double Solved() const;
  double Solved(const std::vector<int>& variables) const;

 private:
  std::vector<double> kappa_, kappa2_;  // by variable, summed over its scalars
};

// Counts the work of a solver's steps, whose options have its Sink(). Carry::kPoint.
template <class Pose>
class PaperFlopsMeter {
 public:
  struct Flops {
    double update = 0, solve = 0;
  };
  // Before the first update.
  void Watch(const IncrementalSolver<Pose>& solver) { solver_ = &solver; }
  std::function<void(const PointWork&)> Sink() {
    return [this](const PointWork& work) { Count(work); };
  }
  // Of the last step that optimised.
  const Flops& OfLastStep() const { return flops_; }

 private:
  void Count(const PointWork& work);

  const IncrementalSolver<Pose>* solver_ = nullptr;
  PaperFlops paper_;  // of the graph at the step's beginning
  Flops flops_;
};

}  // namespace terse::internal
