#pragma once
// Covariances at every step of an incremental run: solve --covariances all-steps.

#include <map>
#include <nlohmann/json.hpp>
#include <string>

#include "terse/core/atomic_file.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse {

// Comma-separated values, a row per step: docs/outputs.md. The solver must outlive the object.
template <class Pose>
class StepCovariances {
 public:
  // Throws FileError.
  StepCovariances(const IncrementalSolver<Pose>& solver, const CovarianceConvention& convention,
                  const std::string& path);
  // After every step of the solver; `step` counts from 1.
  void Add(int step);
  void Commit() { file_.Commit(); }
  double Seconds() const { return seconds_; }
  // How often each path was taken.
  nlohmann::ordered_json PathCounts() const;

 private:
  const IncrementalSolver<Pose>* solver_;
  CovarianceConvention convention_;
  IncrementalMarginals<Pose> marginals_;
  AtomicFile file_;
  std::map<CovariancePath, long> counts_;
  double seconds_ = 0;
};

}  // namespace terse
