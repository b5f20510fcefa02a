#pragma once
// Words and numbers for what repr() says.

#include <string>

#include "conversions.h"
#include "terse/core/number_text.h"

namespace terse::python {

// "1 pose", "2 poses".
template <class Count>
std::string Counted(Count count, const std::string& thing) {
  return std::to_string(count) + " " + thing + (count == 1 ? "" : "s");
}
inline std::string DimensionText(int dimension) { return std::to_string(dimension) + "D"; }

// "[1 0 0.157]".
template <class Numbers>
std::string NumbersText(const Numbers& numbers) {
  std::string text = "[";
  for (py::ssize_t k = 0; k < static_cast<py::ssize_t>(numbers.size()); ++k) {
    text += (k > 0 ? " " : "") + SixDigits(numbers.data()[k]);
  }
  return text + "]";
}
template <class Pose>
std::string PoseText(const Pose& T) {
  std::vector<double> row(kRow<Pose>);
  WritePose(T, row.data());
  return NumbersText(row);
}

// As options are made: terse.Name(first, option=value, ...) with those that differ from the other object's.
std::string OptionsText(const py::object& options, const py::object& standard, const std::string& first);

}  // namespace terse::python
