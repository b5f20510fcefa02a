#pragma once
// Residuals of one kind of measurements beside what draws of noise through the same factor lead to expect.

#include <utility>
#include <vector>

namespace terse::internal {

// Squares of a group's residuals over those that the draws lead to expect.
struct ResidualGroup {
  std::vector<double> squares, expected, weights;  // by edge; expected: per scalar
  std::vector<std::vector<double>> drawn;          // by edge, by draw
  int scalars = 1;                                 // of an edge

  void Add(double square, std::vector<double> draws, double weight);
  void Append(ResidualGroup&& other);
  double Redundancy() const;
  // The factor on variances with which the residuals, cut, add up to what the draws do; and the standard error of its
  // logarithm. Without cut: the plain ratio.
  std::pair<double, double> VarianceFactor(bool cut) const;
};

// Above zero; 1 of none.
double Median(std::vector<double> values);

}  // namespace terse::internal
