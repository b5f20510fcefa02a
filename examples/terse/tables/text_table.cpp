#include "tables/text_table.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <stdexcept>

namespace terse {
namespace {

// Letters, not bytes: of UTF-8 every byte but the continuing ones begins one.
std::size_t Width(const std::string& text) {
  return static_cast<std::size_t>(std::count_if(text.begin(), text.end(), [](char c) { return (c & 0xC0) != 0x80; }));
}

std::string Format(const char* format, int digits, double value) {
  char text[64];
  std::snprintf(text, sizeof text, format, digits, value);
  return text;
}

}  // namespace

TextTable::TextTable(std::vector<std::string> header, std::size_t left) : rows_{std::move(header)}, left_(left) {}

void TextTable::AddRow(std::vector<std::string> cells) {
  if (cells.size() != rows_.front().size()) throw std::invalid_argument("a row of the wrong length");
  rows_.push_back(std::move(cells));
}

std::string TextTable::Text() const {
  std::vector<std::size_t> widths(rows_.front().size(), 3);
  for (const auto& row : rows_) {
    for (std::size_t k = 0; k < row.size(); ++k) widths[k] = std::max(widths[k], Width(row[k]));
  }
  std::string out;
  for (std::size_t r = 0; r < rows_.size(); ++r) {
    for (std::size_t k = 0; k < widths.size(); ++k) {
      const std::string space(widths[k] - Width(rows_[r][k]), ' ');
      out += "| " + (k < left_ ? rows_[r][k] + space : space + rows_[r][k]) + ' ';
    }
    out += "|\n";
    if (r > 0) continue;
    for (std::size_t k = 0; k < widths.size(); ++k)
      out += '|' + std::string(widths[k] + 1, '-') + (k < left_ ? '-' : ':');
    out += "|\n";
  }
  return out;
}

std::string Cell(std::optional<double> value, int digits) {
  if (!value || !std::isfinite(*value)) return "-";
  return Format("%.*g", digits, *value);
}

std::string FixedCell(std::optional<double> value, int decimals) {
  if (!value || !std::isfinite(*value)) return "-";
  return Format("%.*f", decimals, *value);
}

double Percent(double part, double whole) { return whole > 0 ? 100 * part / whole : 100; }

}  // namespace terse
