#pragma once
// The trigonometric quotients of Exp, Log and the Jacobians, without cancellation at small angles.
//
// Quotient(k, theta) is sum_i (-theta^2)^i / (2 i + k)!, that is sin(t)/t (k = 1), (1 - cos t)/t^2 (2),
// (t - sin t)/t^3 (3), (t^2/2 + cos t - 1)/t^4 (4), (sin t - t + t^3/6)/t^5 (5).

#include <cmath>

namespace terse::internal {

// Below it the series of nine terms is exact to rounding; above it the closed forms lose at most 1e-13.
inline constexpr double kSeriesAngle = 1.0;

inline double Quotient(int k, double theta) {
  const double t2 = theta * theta;
  if (std::abs(theta) < kSeriesAngle) {
    double factorial = 1;
    for (int i = 2; i <= k; ++i) factorial *= i;
    double term = 1 / factorial, sum = 0;
    for (int i = 0; i < 10; ++i) {
      sum += term;
      term *= -t2 / ((2 * i + k + 1) * (2 * i + k + 2));
    }
    return sum;
  }
  switch (k) {
    case 1: return std::sin(theta) / theta;
    case 2: return (1 - std::cos(theta)) / t2;
    case 3: return (theta - std::sin(theta)) / (t2 * theta);
    case 4: return (t2 / 2 + std::cos(theta) - 1) / (t2 * t2);
    default: return (std::sin(theta) - theta + t2 * theta / 6) / (t2 * t2 * theta);
  }
}

// (1 - (t/2) cot(t/2)) / t^2, the coefficient of the inverse Jacobian; finite up to 2 pi.
inline double CotangentQuotient(double theta) {
  const double t2 = theta * theta;
  if (std::abs(theta) < 0.2) {
    return 1.0 / 12 + t2 * (1.0 / 720 + t2 * (1.0 / 30240 + t2 * (1.0 / 1209600 + t2 / 47900160)));
  }
  const double half = theta / 2;
  return (1 - half * std::cos(half) / std::sin(half)) / t2;
}

}  // namespace terse::internal
