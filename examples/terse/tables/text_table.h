#pragma once
// Tables of text: columns aligned for the eye, in the syntax of Markdown, so that documents can take them as they are.

#include <optional>
#include <string>
#include <vector>

namespace terse {

class TextTable {
 public:
  // The first `left` columns are aligned to the left.
  explicit TextTable(std::vector<std::string> header, std::size_t left = 1);
  // Throws std::invalid_argument if it has more or fewer cells than the header.
  void AddRow(std::vector<std::string> cells);
  std::string Text() const;

 private:
  std::vector<std::vector<std::string>> rows_;  // the header first
  std::size_t left_;
};

// So many significant digits, "-" if absent or not finite.
std::string Cell(std::optional<double> value, int digits = 3);
// So many decimals.
std::string FixedCell(std::optional<double> value, int decimals);

double Percent(double part, double whole);  // 100 of nothing

}  // namespace terse
