#pragma once
// The one checker of analytic Jacobians: against central differences, both matrices printed when they differ.

#include <gtest/gtest.h>

#include <Eigen/Core>

namespace terse::testing {

// d f / d e at e = 0 for f: R^N -> R^M. The error is about step^2 |f'''| / 6 + 1e-16 |f| / step, so a step of
// 1e-5 leaves 1e-11 where f and its derivatives are of order one.
template <int N, class Function>
auto CentralDifferences(const Function& f, double step) {
  using Argument = Eigen::Matrix<double, N, 1>;
  using Value = decltype(f(Argument()));
  Eigen::Matrix<double, Value::RowsAtCompileTime, N> J;
  for (int i = 0; i < N; ++i) {
    const Argument e = step * Argument::Unit(i);
    J.col(i) = (f(e) - f(Argument(-e))) / (2 * step);
  }
  return J;
}

// Passes if every entry of J is within `tolerance` (absolute) of the central differences of f.
template <class Jacobian, class Function>
::testing::AssertionResult JacobianMatches(const Jacobian& J, const Function& f, double tolerance, double step = 1e-5) {
  const auto numeric = CentralDifferences<Jacobian::ColsAtCompileTime>(f, step);
  const double error = (J - numeric).cwiseAbs().maxCoeff();
  if (error <= tolerance) return ::testing::AssertionSuccess();  // false for NaN
  return ::testing::AssertionFailure() << "differs by " << error << " > " << tolerance << "\nanalytic:\n"
                                       << J << "\ncentral differences:\n"
                                       << numeric;
}

}  // namespace terse::testing
