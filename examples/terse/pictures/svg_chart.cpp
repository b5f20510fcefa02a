#include "pictures/svg_chart.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <locale>
#include <sstream>

#include "terse/core/atomic_file.h"

namespace terse {
namespace {

constexpr double kPanelWidth = 480, kPanelHeight = 330;                              // with its margins
constexpr double kLeft = 82, kRight = 22, kTop = 44, kBottom = 60, kChartHead = 46;  // margins, and the title's height
constexpr const char* kColours[] = {"#0b62c4", "#d1480b", "#1a7f37", "#8250df", "#9a6700", "#bf3989",
                                    "#0a7ea4", "#57606a", "#d4a72c", "#e56db1", "#6fae3f", "#3d2f8f"};

// Thousands apart, and no more digits than a tick needs.
std::string TickText(double value) {
  char text[32];
  const double size = std::abs(value);
  if (size >= 1e7 || (size > 0 && size < 1e-3)) {
    std::snprintf(text, sizeof text, "%.3g", value);
    return text;
  }
  std::snprintf(text, sizeof text, "%.10g", value);
  std::string out = text;
  if (size < 10000) return out;
  for (int at = static_cast<int>(std::min(out.find('.'), out.size())) - 3; at > (value < 0 ? 1 : 0); at -= 3) {
    out.insert(static_cast<std::size_t>(at), "\u2009");
  }
  return out;
}

// One direction of a panel: values to [0, 1], and its ticks.
class Axis {
 public:
  Axis(bool logarithmic, bool from_zero) : logarithmic_(logarithmic), from_zero_(from_zero) {}
  void Include(double value) {
    low_ = std::min(low_, value);
    high_ = std::max(high_, value);
    is_whole_ = is_whole_ && value == std::round(value);
  }
  // What is beyond has no place on an axis whose length is a number too.
  bool Takes(double value) const {
    return std::abs(value) <= kMostMagnitude && (!logarithmic_ || value >= 1 / kMostMagnitude);
  }

  void Close() {
    if (low_ > high_) low_ = logarithmic_ ? 1 : 0, high_ = logarithmic_ ? 10 : 1;
    // So close that steps between them would be lost in rounding: as equal.
    const double size = std::max(std::abs(low_), std::abs(high_));
    if (!(high_ - low_ > std::max(1e-12 * size, 1 / kMostMagnitude))) high_ = low_;
    logarithmic_ ? CloseLogarithmic() : CloseLinear();
  }
  double Share(double value) const {
    return logarithmic_ ? std::log(value / low_) / std::log(high_ / low_) : (value - low_) / (high_ - low_);
  }
  const std::vector<double>& Ticks() const { return ticks_; }

 private:
  static constexpr double kMostMagnitude = 1e300;
  double NiceStep() const {
    const double rough = (high_ - low_) / 5, power = std::pow(10, std::floor(std::log10(rough)));
    double step = 10 * power;
    for (const double nice : {5.0, 2.0, 1.0}) {
      if (nice * power >= 0.999 * rough) step = nice * power;
    }
    return step;
  }
  void TickEvery(double step) {
    for (long k = std::lround(std::ceil(low_ / step - 1e-9)); static_cast<double>(k) * step <= high_ + 1e-9 * step;
         ++k) {
      ticks_.push_back(static_cast<double>(k) * step);
    }
  }
  void CloseLinear() {
    if (from_zero_ && low_ > 0) low_ = 0;
    if (low_ == high_) high_ += std::max(1.0, std::abs(high_));
    const double step = is_whole_ ? std::max(NiceStep(), 1.0) : NiceStep();
    if (from_zero_) high_ = step * std::ceil(high_ / step - 1e-9);
    TickEvery(step);
  }
  // As on a linear axis within less than a decade; powers of two about one; 1, 2, 5 within few decades, decades alone
  // within many.
  void CloseLogarithmic() {
    if (from_zero_ || low_ == high_) low_ /= 1.1, high_ *= 1.1;
    if (high_ < 4 * low_) return TickEvery(NiceStep());
    if (low_ > 0.05 && high_ < 20 && high_ < 64.1 * low_) {
      for (double tick = 1.0 / 16; tick <= 1.001 * high_; tick *= 2) {
        if (tick >= 0.999 * low_) ticks_.push_back(tick);
      }
      return;
    }
    const double decades = std::log10(high_ / low_);
    const int stride = std::max(1, static_cast<int>(std::ceil(decades / 7)));
    for (int d = static_cast<int>(std::floor(std::log10(low_))); std::pow(10, d) <= high_; ++d) {
      if (d % stride != 0) continue;
      for (const double m : {1.0, 2.0, 5.0}) {
        const double tick = m * std::pow(10, d);
        if (m > 1 && decades > 3) continue;
        if (tick >= 0.999 * low_ && tick <= 1.001 * high_) ticks_.push_back(tick);
      }
    }
  }

  bool logarithmic_, from_zero_;
  bool is_whole_ = true;  // all values
  double low_ = HUGE_VAL, high_ = -HUGE_VAL;
  std::vector<double> ticks_;
};

class Chart {
 public:
  Chart(const std::string& title, const std::vector<ChartPanel>& panels, int columns)
      : title_(title), panels_(panels), columns_(std::max(1, std::min(columns, static_cast<int>(panels.size())))) {
    out_.imbue(std::locale::classic());
    out_.setf(std::ios::fixed);
    out_.precision(1);
    for (const ChartPanel& panel : panels) {
      for (const ChartLine& line : panel.lines) {
        if (!line.x.empty() && std::find(names_.begin(), names_.end(), line.name) == names_.end())
          names_.push_back(line.name);
      }
    }
  }

  std::string Draw() {
    const int rows = (static_cast<int>(panels_.size()) + columns_ - 1) / columns_;
    const double width = kPanelWidth * columns_, body = kChartHead + kPanelHeight * rows;
    const std::vector<std::pair<double, double>> legend = PlaceLegend(body + 14, width);
    const double height = legend.size() > 1 ? legend.back().second + 20 : body + 8;
    out_ << "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 " << width << ' ' << height << "\" width=\""
         << width << "\" height=\"" << height
         << "\" font-family=\"system-ui,-apple-system,Segoe UI,Helvetica,Arial,sans-serif\" font-size=\"13\" "
            "fill=\"#424a53\">\n<title>"
         << EscapeXml(title_) << "</title>\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n";
    Text(kLeft, 28, title_, "start", " font-size=\"17\" font-weight=\"600\" fill=\"#1f2328\"");
    for (std::size_t k = 0; k < panels_.size(); ++k) {
      const int at = static_cast<int>(k);
      Panel(panels_[k], kPanelWidth * (at % columns_) + kLeft, kChartHead + kPanelHeight * (at / columns_) + kTop);
    }
    if (names_.size() > 1) Legend(legend);
    out_ << "</svg>\n";
    return out_.str();
  }

 private:
  static constexpr double kWidth = kPanelWidth - kLeft - kRight, kHeight = kPanelHeight - kTop - kBottom;

  void Text(double x, double y, const std::string& text, const char* anchor, const char* more = "") {
    out_ << "<text x=\"" << x << "\" y=\"" << y << "\" text-anchor=\"" << anchor << "\"" << more << ">"
         << EscapeXml(text) << "</text>\n";
  }
  const char* ColourOf(const std::string& name) const {
    const auto at = static_cast<std::size_t>(std::find(names_.begin(), names_.end(), name) - names_.begin());
    return kColours[at % std::size(kColours)];
  }

  void Panel(const ChartPanel& panel, double left, double top) {
    Axis x(panel.log_x, false), y(panel.log_y, true);
    for (const ChartLine& line : panel.lines) {
      for (std::size_t k = 0; k < line.x.size(); ++k) {
        if (x.Takes(line.x[k]) && y.Takes(line.y[k])) x.Include(line.x[k]), y.Include(line.y[k]);
      }
    }
    x.Close();
    y.Close();
    const double bottom = top + kHeight;
    Text(left, top - 14, panel.title, "start", " font-weight=\"600\" fill=\"#1f2328\"");
    for (const double tick : y.Ticks()) {
      const double at = bottom - kHeight * y.Share(tick);
      out_ << "<path d=\"M" << left << ',' << at << 'h' << kWidth << "\" stroke=\"#d8dee4\"/>\n";
      Text(left - 8, at + 4, TickText(tick), "end");
    }
    for (const double tick : x.Ticks()) {
      const double at = left + kWidth * x.Share(tick);
      out_ << "<path d=\"M" << at << ',' << bottom << "v5\" stroke=\"#6e7781\"/>\n";
      Text(at, bottom + 20, TickText(tick), "middle");
    }
    out_ << "<path d=\"M" << left << ',' << top << 'V' << bottom << 'H' << left + kWidth
         << "\" fill=\"none\" stroke=\"#6e7781\"/>\n";
    Text(left + kWidth / 2, bottom + 42, panel.x_label, "middle");
    out_ << "<text transform=\"translate(" << left - 64 << ',' << top + kHeight / 2
         << ") rotate(-90)\" text-anchor=\"middle\">" << EscapeXml(panel.y_label) << "</text>\n";
    for (const ChartLine& line : panel.lines) {
      std::vector<std::pair<double, double>> points;
      for (std::size_t k = 0; k < line.x.size(); ++k) {
        if (!x.Takes(line.x[k]) || !y.Takes(line.y[k])) continue;
        points.emplace_back(left + kWidth * x.Share(line.x[k]), bottom - kHeight * y.Share(line.y[k]));
      }
      Curve(points, line);
    }
  }

  void Curve(const std::vector<std::pair<double, double>>& points, const ChartLine& line) {
    if (points.empty()) return;
    const char* colour = ColourOf(line.name);
    if (line.joined) {
      out_ << "<polyline fill=\"none\" stroke-width=\"1.8\" stroke-linejoin=\"round\" stroke=\"" << colour << '"'
           << (line.dashed ? " stroke-dasharray=\"6 4\"" : "") << " points=\"";
      for (const auto& [x, y] : points) out_ << x << ',' << y << ' ';
      out_ << "\"/>\n";
    }
    if (!line.marked) return;
    const double radius = points.size() > 200 ? 1.5 : 3;
    for (const auto& [x, y] : points) {
      out_ << "<circle cx=\"" << x << "\" cy=\"" << y << "\" r=\"" << radius << "\" fill=\"" << colour << "\"/>\n";
    }
  }

  // Where the entries begin, in as many rows as they need.
  std::vector<std::pair<double, double>> PlaceLegend(double y, double width) const {
    std::vector<std::pair<double, double>> out;
    double x = kLeft;
    for (const std::string& name : names_) {
      const double entry = 62 + 7.2 * static_cast<double>(name.size());
      if (x > kLeft && x + entry - 30 > width) x = kLeft, y += 22;
      out.emplace_back(x, y);
      x += entry;
    }
    return out;
  }
  void Legend(const std::vector<std::pair<double, double>>& places) {
    for (std::size_t k = 0; k < names_.size(); ++k) {
      const auto [x, y] = places[k];
      out_ << "<path d=\"M" << x << ',' << y - 4 << "h24\" stroke-width=\"2.5\" stroke=\"" << ColourOf(names_[k])
           << "\"/>\n";
      Text(x + 32, y, names_[k], "start");
    }
  }

  const std::string& title_;
  const std::vector<ChartPanel>& panels_;
  int columns_;
  std::vector<std::string> names_;
  std::ostringstream out_;
};

}  // namespace

std::string EscapeXml(const std::string& text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&': out += "&amp;"; break;
      case '<': out += "&lt;"; break;
      case '>': out += "&gt;"; break;
      case '"': out += "&quot;"; break;
      default: out += c;
    }
  }
  return out;
}

std::string DrawCharts(const std::string& title, const std::vector<ChartPanel>& panels, int columns) {
  return Chart(title, panels, columns).Draw();
}

void WriteText(const std::string& text, const std::string& path) {
  AtomicFile file(path);
  file.Stream() << text;
  file.Commit();
}

}  // namespace terse
