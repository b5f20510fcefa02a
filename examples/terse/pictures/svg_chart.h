#pragma once
// Line charts as SVG: panels in rows, each with its axes; one legend for all.

#include <string>
#include <vector>

namespace terse {

struct ChartLine {
  std::string name;  // lines of the same name in several panels share colour and legend
  std::vector<double> x, y;
  bool marked = false;  // a dot at every point
  bool joined = true;   // by a line, which may be dashed
  bool dashed = false;
};

struct ChartPanel {
  std::string title, x_label, y_label;  // the labels with their units
  std::vector<ChartLine> lines;
  bool log_x = false, log_y = false;  // what is not positive is then left out
};

// `columns` panels in a row. What is not finite is left out. Lines without points draw nothing.
std::string DrawCharts(const std::string& title, const std::vector<ChartPanel>& panels, int columns = 2);

// For text and attributes.
std::string EscapeXml(const std::string& text);

// Written whole or not at all. Throws FileError.
void WriteText(const std::string& text, const std::string& path);

}  // namespace terse
