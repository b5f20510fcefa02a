#include "terse/core/chi_square.h"

#include <cmath>
#include <stdexcept>

namespace terse {
namespace {

constexpr double kPi = 3.14159265358979323846;

// P(chi-square > x): the recursion of the incomplete gamma function in steps of two degrees of freedom.
double ChiSquareTail(double x, int dof) {
  const double h = x / 2;
  double tail = dof % 2 == 0 ? std::exp(-h) : std::erfc(std::sqrt(h));
  // h^a e^-h / Gamma(a + 1) for a = dof / 2 - 1, ...
  double term = dof % 2 == 0 ? std::exp(-h) : 2 * std::sqrt(h / kPi) * std::exp(-h);
  for (int d = dof % 2 == 0 ? 2 : 1; d < dof; d += 2) {
    if (d > 1) term *= h / (d / 2.0);
    tail += term;
  }
  return tail;
}

}  // namespace

double ChiSquareQuantile(double probability, int dof) {
  if (!(probability >= 0) || !(probability < 1) || dof < 1) {
    throw std::invalid_argument("a chi-square quantile needs a probability in [0, 1) and a degree of freedom");
  }
  double low = 0, high = dof;
  while (ChiSquareTail(high, dof) > 1 - probability) high *= 2;
  for (double middle = high / 2; low < middle && middle < high; middle = low + (high - low) / 2) {
    (ChiSquareTail(middle, dof) > 1 - probability ? low : high) = middle;
  }
  return high;
}

}  // namespace terse
