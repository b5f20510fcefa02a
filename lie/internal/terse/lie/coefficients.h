#pragma once
// The trigonometric quotients of Exp, Log and the Jacobians, without cancellation at small angles.
//
// Quotient(k, theta) is sum_i (-theta^2)^i / (2 i + k)!, that is sin(t)/t (k = 1), (1 - cos t)/t^2 (2),
// (t - sin t)/t^3 (3), (t^2/2 + cos t - 1)/t^4 (4), (sin t - t + t^3/6)/t^5 (5).

#include <cmath>

namespace terse::internal {

// Below it the series is exact to rounding; above it the closed forms lose at most 1e-13.
inline constexpr double kSeriesAngle = 1.0;
// Below it five of the ten terms are: what the others add is below 1e-17 of the sum.
inline constexpr double kShortSeriesAngle = 0.1;

// 1 / n!
inline constexpr double kInverseFactorial[] = {1.0,
                                               1.0,
                                               1.0 / 2,
                                               1.0 / 6,
                                               1.0 / 24,
                                               1.0 / 120,
                                               1.0 / 720,
                                               1.0 / 5040,
                                               1.0 / 40320,
                                               1.0 / 362880,
                                               1.0 / 3628800,
                                               1.0 / 39916800,
                                               1.0 / 479001600,
                                               1.0 / 6227020800,
                                               1.0 / 87178291200,
                                               1.0 / 1307674368000,
                                               1.0 / 20922789888000,
                                               1.0 / 355687428096000,
                                               1.0 / 6402373705728000,
                                               1.0 / 121645100408832000,
                                               1.0 / 2432902008176640000,
                                               1.0 / 2432902008176640000 / 21,
                                               1.0 / 2432902008176640000 / 462,
                                               1.0 / 2432902008176640000 / 10626};

inline double Quotient(int k, double theta) {
  const double t2 = theta * theta;
  if (t2 < kSeriesAngle * kSeriesAngle) {
    int i = t2 < kShortSeriesAngle * kShortSeriesAngle ? 4 : 9;
    double sum = kInverseFactorial[2 * i + k];
    while (i-- > 0) sum = kInverseFactorial[2 * i + k] - t2 * sum;
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
