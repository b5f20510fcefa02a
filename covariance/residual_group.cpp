#include "residual_group.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

namespace terse::internal {

using std::size_t;

namespace {
constexpr double kCut = 4;  // expected squares, beyond which a residual counts no more
}  // namespace

void ResidualGroup::Add(double square, std::vector<double> draws, double weight) {
  double mean = 0;
  for (const double d : draws) mean += d / static_cast<double>(draws.size());
  mean = std::max(mean, std::numeric_limits<double>::min());
  for (double& d : draws) d /= mean;
  squares.push_back(square / mean);
  expected.push_back(mean);
  weights.push_back(weight);
  drawn.push_back(std::move(draws));
}

void ResidualGroup::Append(ResidualGroup&& other) {
  const auto append = [](auto& to, auto& from) {
    to.insert(to.end(), std::make_move_iterator(from.begin()), std::make_move_iterator(from.end()));
  };
  append(squares, other.squares);
  append(expected, other.expected);
  append(weights, other.weights);
  append(drawn, other.drawn);
}

double ResidualGroup::Redundancy() const {
  double sum = 0;
  for (size_t k = 0; k < expected.size(); ++k) sum += scalars * weights[k] * expected[k];
  return sum;
}

std::pair<double, double> ResidualGroup::VarianceFactor(bool cut) const {
  const double limit = cut ? kCut : std::numeric_limits<double>::infinity();
  const auto sum = [&](const auto& square_of) {
    double total = 0;
    for (size_t k = 0; k < expected.size(); ++k) total += weights[k] * expected[k] * std::min(square_of(k), limit);
    return total;
  };
  const size_t draws = drawn.empty() ? 0 : drawn.front().size();
  double mean = 0, square = 0;
  for (size_t d = 0; d < draws; ++d) {
    const double one = sum([&](size_t k) { return drawn[k][d]; });
    mean += one / static_cast<double>(draws);
    square += one * one / static_cast<double>(draws);
  }
  if (!(mean > 0)) return {1, std::numeric_limits<double>::infinity()};
  const double error = std::sqrt(std::max(0.0, square / (mean * mean) - 1));
  double low = -80, high = 80;  // of the logarithm
  for (int i = 0; i < 60; ++i) {
    const double middle = (low + high) / 2, factor = std::exp(-middle);
    (sum([&](size_t k) { return squares[k] * factor; }) > mean ? low : high) = middle;
  }
  return {std::exp((low + high) / 2), error};
}

double Median(std::vector<double> values) {
  if (values.empty()) return 1;
  const auto middle = values.begin() + static_cast<long>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return std::max(*middle, std::numeric_limits<double>::min());
}

}  // namespace terse::internal
