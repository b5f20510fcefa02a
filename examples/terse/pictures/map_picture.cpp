#include "pictures/map_picture.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <locale>
#include <numeric>
#include <sstream>

#include "pictures/svg_chart.h"

namespace terse {
namespace {

using std::size_t;

constexpr double kWidth = 900, kMargin = 24, kGap = 44, kHead = 62, kFoot = 64, kMostHeight = 640;
constexpr double kPadding = 8;  // of a drawing within its panel
constexpr const char *kTruth = "#8b949e", *kEstimate = "#2f81f7", *kText = "#768390", *kUnmeasured = "#a371f7";
constexpr double kDegrees = 180 / 3.14159265358979323846;
constexpr int kEllipses = 24;
constexpr double kChi95 = 2.4477;  // root of the 95 % quantile of chi2 with two degrees of freedom

// Light to dark enough for white and black paper: green, yellow, orange, red.
constexpr std::array<std::array<double, 3>, 5> kGainColours{
    {{46, 160, 110}, {122, 178, 60}, {214, 168, 30}, {229, 112, 32}, {200, 48, 62}}};

std::string GainColour(double share) {
  const double at = std::clamp(share, 0.0, 1.0) * (kGainColours.size() - 1);
  const size_t low = std::min(static_cast<size_t>(at), kGainColours.size() - 2);
  const double part = at - static_cast<double>(low);
  std::array<int, 3> rgb{};
  for (size_t k = 0; k < 3; ++k) {
    rgb[k] = static_cast<int>(std::lround((1 - part) * kGainColours[low][k] + part * kGainColours[low + 1][k]));
  }
  char text[16];
  std::snprintf(text, sizeof text, "#%02x%02x%02x", rgb[0], rgb[1], rgb[2]);
  return text;
}

using Point = std::array<double, 2>;

// From the world to the paper.
class View {
 public:
  explicit View(const std::vector<RunFolder>& runs) : panels_(static_cast<double>(runs.size())) {
    Include(runs.front().T_world_body);
    // The plane itself in 2D; without z where that decides nothing.
    int least = 2;
    for (int k = 1; k >= 0 && runs.front().dimension == 3; --k) {
      if (Width(k) < Width(least)) least = k;
    }
    axes_ = {least == 0 ? 1 : 0, least == 2 ? 1 : 2};
    for (const RunFolder& run : runs) {
      Include(run.T_world_body);
      if (run.T_world_body_true) Include(*run.T_world_body_true);
    }
    width_ = (kWidth - 2 * kMargin - (panels_ - 1) * kGap) / panels_;
    // A metre where all poses are in one place.
    const double least_extent = std::max(Extent(0), Extent(1)) > 1e-6 ? 1e-9 : 1;
    const double across = std::max(Extent(0), least_extent), up = std::max(Extent(1), least_extent);
    scale_ = std::min((width_ - 2 * kPadding) / across, kMostHeight / up);
    height_ = std::max(scale_ * up + 2 * kPadding, 60.0);
  }

  double PanelWidth() const { return width_; }
  double DrawingHeight() const { return height_; }
  double Left(size_t panel) const { return kMargin + static_cast<double>(panel) * (width_ + kGap); }
  double Scale() const { return scale_; }  // pixels per metre
  const std::array<int, 2>& Axes() const { return axes_; }
  Point Project(const SE3& T, size_t panel) const {
    const auto middle = [&](int k) { return (low_[Axis(k)] + high_[Axis(k)]) / 2; };
    const Vector<3>& t = T.Translation();
    return {Left(panel) + width_ / 2 + scale_ * (t[axes_[0]] - middle(0)),
            kHead + height_ / 2 - scale_ * (t[axes_[1]] - middle(1))};
  }

 private:
  double Width(int axis) const { return high_[static_cast<size_t>(axis)] - low_[static_cast<size_t>(axis)]; }
  size_t Axis(int k) const { return static_cast<size_t>(axes_[static_cast<size_t>(k)]); }
  double Extent(int k) const { return high_[Axis(k)] - low_[Axis(k)]; }
  void Include(const std::vector<SE3>& poses) {
    for (const SE3& T : poses) {
      for (size_t k = 0; k < 3; ++k) {
        low_[k] = std::min(low_[k], T.Translation()[static_cast<int>(k)]);
        high_[k] = std::max(high_[k], T.Translation()[static_cast<int>(k)]);
      }
    }
  }

  std::array<double, 3> low_{HUGE_VAL, HUGE_VAL, HUGE_VAL}, high_{-HUGE_VAL, -HUGE_VAL, -HUGE_VAL};
  std::array<int, 2> axes_{0, 1};
  double panels_, width_ = 0, height_ = 0, scale_ = 1;
};

// The gains between which colours change: those of all runs but for the rarest.
struct GainRange {
  double low = 0, high = 0;
  bool known = false;
  explicit GainRange(const std::vector<RunFolder>& runs) {
    std::vector<double> gains;
    for (const RunFolder& run : runs) {
      for (const RunLink& link : run.links) {
        if (link.gain && std::isfinite(*link.gain)) gains.push_back(*link.gain);
      }
    }
    if (gains.empty()) return;
    std::sort(gains.begin(), gains.end());
    known = true;
    low = gains.front();
    high = gains[std::min(gains.size() - 1, gains.size() * 98 / 100)];
  }
  double Share(double gain) const { return high > low ? (gain - low) / (high - low) : 0.5; }
};

class MapPicture {
 public:
  MapPicture(const std::vector<RunFolder>& runs, const std::string& gain_unit)
      : runs_(runs), gain_unit_(gain_unit), view_(runs), gains_(runs) {
    out_.imbue(std::locale::classic());
    out_.setf(std::ios::fixed);
    out_.precision(1);
  }

  std::string Draw() {
    const double height = kHead + view_.DrawingHeight() + kFoot;
    out_ << "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 " << kWidth << ' ' << height << "\" width=\""
         << kWidth << "\" height=\"" << height
         << "\" font-family=\"system-ui,-apple-system,Segoe UI,Helvetica,Arial,sans-serif\" font-size=\"13\" fill=\""
         << kText << "\">\n<title>" << EscapeXml(Title()) << "</title>\n";
    for (size_t k = 0; k < runs_.size(); ++k) {
      Head(runs_[k], k);
      Curves(runs_[k], k);
      Links(runs_[k], k);
      Ellipses(runs_[k], k);
      Poses(runs_[k], k);
    }
    Legend(height - 18);
    ScaleBar(height - 44);
    GainLegend(height - 44);
    out_ << "</svg>\n";
    return out_.str();
  }

 private:
  std::string Title() const {
    std::string out;
    for (const RunFolder& run : runs_) out += (out.empty() ? "Map of " : " and ") + run.name;
    return out;
  }

  void Text(double x, double y, const std::string& text, const char* more = "") {
    out_ << "<text x=\"" << x << "\" y=\"" << y << "\"" << more << '>' << EscapeXml(text) << "</text>\n";
  }

  void Head(const RunFolder& run, size_t panel) {
    const long kept = std::count(run.kept.begin(), run.kept.end(), 1);
    char text[160];
    std::snprintf(text, sizeof text, "%ld of %zu poses, %zu links", kept, run.ids.size(), run.links.size());
    const double left = view_.Left(panel);
    Text(left, 24, run.name, " font-size=\"15\" font-weight=\"600\"");
    Text(left, 44, text);
    if (!run.ate_m) return;
    std::snprintf(text, sizeof text, "ATE %.3g m", *run.ate_m);
    Text(left + view_.PanelWidth(), 44, text, " text-anchor=\"end\"");
  }

  // A line for each robot.
  void Curve(const std::vector<SE3>& poses, const std::vector<size_t>& starts, size_t panel, const char* colour,
             double width) {
    auto next = starts.begin();
    for (size_t k = 0; k < poses.size(); ++k) {
      const bool is_start = next != starts.end() && *next == k;
      if (is_start) ++next;
      if (is_start && k > 0) out_ << "\"/>\n";
      if (is_start || k == 0) {
        out_ << "<polyline fill=\"none\" stroke-linejoin=\"round\" stroke=\"" << colour << "\" stroke-width=\"" << width
             << "\" points=\"";
      }
      const Point p = view_.Project(poses[k], panel);
      out_ << p[0] << ',' << p[1] << ' ';
    }
    if (!poses.empty()) out_ << "\"/>\n";
  }
  void Curves(const RunFolder& run, size_t panel) {
    if (run.T_world_body_true) Curve(*run.T_world_body_true, run.starts, panel, kTruth, 1);
    Curve(run.T_world_body, run.starts, panel, kEstimate, 1.2);
  }

  // Bent a little: most loops join places that lie on the trajectory and would hide behind it.
  void Links(const RunFolder& run, size_t panel) {
    std::vector<size_t> order(run.links.size());  // the most informative ones on top
    std::iota(order.begin(), order.end(), size_t{0});
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
      return run.links[a].gain.value_or(-1) < run.links[b].gain.value_or(-1);
    });
    const double opacity = run.links.size() < 50 ? 1 : run.links.size() < 5000 ? 0.6 : 0.3;
    out_ << "<g fill=\"none\" stroke-width=\"" << (run.links.size() < 500 ? 1.3 : 0.8) << "\" opacity=\"" << opacity
         << "\">\n";
    for (const size_t k : order) {
      const RunLink& link = run.links[k];
      const Point a = At(run, link.from, panel), b = At(run, link.to, panel);
      const double length = std::hypot(b[0] - a[0], b[1] - a[1]);
      const double bend = length > 0 ? std::min(0.5, 9 / length) : 0;
      out_ << "<path d=\"M" << a[0] << ',' << a[1] << 'Q' << (a[0] + b[0]) / 2 + bend * (a[1] - b[1]) << ','
           << (a[1] + b[1]) / 2 + bend * (b[0] - a[0]) << ' ' << b[0] << ',' << b[1] << "\" stroke=\""
           << (link.gain ? GainColour(gains_.Share(*link.gain)) : std::string(kUnmeasured)) << "\"/>\n";
    }
    out_ << "</g>\n";
  }

  // Far uncertainty stays off the other run, the head and the legend.
  void BeginClipped(size_t panel) {
    const double left = view_.Left(panel) - kPadding, width = view_.PanelWidth() + 2 * kPadding;
    out_ << "<clipPath id=\"panel-" << panel << "\"><rect x=\"" << left << "\" y=\"" << kHead - kPadding
         << "\" width=\"" << width << "\" height=\"" << view_.DrawingHeight() + 2 * kPadding
         << "\"/></clipPath>\n<g clip-path=\"url(#panel-" << panel << ")\">\n";
  }

  void Ellipses(const RunFolder& run, size_t panel) {
    BeginClipped(panel);
    const size_t stride = std::max<size_t>(1, run.covariances.size() / kEllipses);
    for (size_t k = 0; k < run.covariances.size(); k += stride) {
      const RunCovariance& c = run.covariances[k];
      const int i = view_.Axes()[0], j = view_.Axes()[1];
      const double xx = c.position(i, i), xy = c.position(i, j), yy = c.position(j, j);
      const double mean = (xx + yy) / 2, off = std::hypot((xx - yy) / 2, xy);
      const double pixels = kChi95 * view_.Scale();
      const double major = pixels * std::sqrt(mean + off), minor = pixels * std::sqrt(std::max(0.0, mean - off));
      if (!(major > 1.5) || !std::isfinite(major)) continue;  // no more than a dot
      const Point p = At(run, c.pose, panel);
      has_ellipses_ = true;
      out_ << "<ellipse rx=\"" << major << "\" ry=\"" << std::max(minor, 0.3) << "\" transform=\"translate(" << p[0]
           << ',' << p[1] << ") rotate(" << -kDegrees / 2 * std::atan2(2 * xy, xx - yy) << ")\" fill=\"" << kEstimate
           << "\" fill-opacity=\"0.14\" stroke=\"" << kEstimate << "\" stroke-width=\"0.8\"/>\n";
    }
    out_ << "</g>\n";
  }

  void Poses(const RunFolder& run, size_t panel) {
    const long kept = std::count(run.kept.begin(), run.kept.end(), 1);
    const double radius = kept > 1000 ? 1 : kept > 60 ? 1.8 : 3.2;
    out_ << "<g fill=\"" << kEstimate << "\">\n";
    for (size_t k = 0; k < run.kept.size(); ++k) {
      if (run.kept[k] == 0) continue;
      const Point p = At(run, static_cast<int>(k), panel);
      out_ << "<circle cx=\"" << p[0] << "\" cy=\"" << p[1] << "\" r=\"" << radius << "\"/>\n";
    }
    out_ << "</g>\n";
  }

  void Legend(double y) {
    double x = kMargin;
    const auto entry = [&](const std::string& symbol, const std::string& text) {
      out_ << "<g transform=\"translate(" << x << ',' << y << ")\">" << symbol << "</g>\n";
      Text(x + 22, y, text);
      x += 44 + 6.6 * static_cast<double>(text.size());
    };
    const auto line = [](const char* colour) {
      return std::string("<path d=\"M0,-4h16\" stroke-width=\"1.6\" stroke=\"") + colour + "\"/>";
    };
    entry(line(kEstimate), "estimate");
    entry(std::string("<circle cx=\"8\" cy=\"-4\" r=\"3.2\" fill=\"") + kEstimate + "\"/>", "kept pose");
    const bool truth = std::any_of(runs_.begin(), runs_.end(), [](const auto& r) { return bool{r.T_world_body_true}; });
    if (truth) entry(line(kTruth), "ground truth");
    const bool unmeasured = std::any_of(runs_.begin(), runs_.end(), [](const RunFolder& run) {
      return std::any_of(run.links.begin(), run.links.end(), [](const RunLink& link) { return !link.gain; });
    });
    if (unmeasured) entry(line(kUnmeasured), "loop, gain not measured");
    if (has_ellipses_) {
      entry(std::string("<ellipse cx=\"8\" cy=\"-4\" rx=\"8\" ry=\"4.5\" fill-opacity=\"0.14\" fill=\"") + kEstimate +
                "\" stroke=\"" + kEstimate + "\" stroke-width=\"0.8\"/>",
            "95 %");
    }
  }

  void GainLegend(double y) {
    if (!gains_.known) return;
    constexpr int kParts = 24;
    constexpr double kPart = 4.5;
    char low[32], high[48];
    std::snprintf(low, sizeof low, "%.3g", gains_.low);
    std::snprintf(high, sizeof high, "%.3g %s", gains_.high, gain_unit_.c_str());
    if (!(gains_.high > gains_.low)) {
      Text(kWidth - kMargin, y, std::string("gain of the loops ") + high, " text-anchor=\"end\"");
      return;
    }
    const double right = kWidth - kMargin - 6.6 * static_cast<double>(std::string(high).size()) - 6;
    for (int k = 0; k < kParts; ++k) {
      out_ << "<rect x=\"" << right - kPart * (kParts - k) << "\" y=\"" << y - 9 << "\" width=\"" << kPart + 0.3
           << "\" height=\"9\" fill=\"" << GainColour(k / (kParts - 1.0)) << "\"/>\n";
    }
    Text(right - kPart * kParts - 6, y, std::string("gain of a loop ") + low, " text-anchor=\"end\"");
    Text(right + 6, y, high);
  }

  // A round number of metres, about a sixth of the first panel.
  void ScaleBar(double y) {
    const double rough = view_.PanelWidth() / 6 / view_.Scale(), power = std::pow(10, std::floor(std::log10(rough)));
    double metres = power;
    for (const double nice : {2.0, 5.0, 10.0}) {
      if (nice * power <= 1.4 * rough) metres = nice * power;
    }
    const double length = metres * view_.Scale(), x = kMargin;
    out_ << "<path d=\"M" << x << ',' << y - 7 << "v6h" << length << "v-6\" fill=\"none\" stroke=\"" << kText
         << "\"/>\n";
    char text[32];
    std::snprintf(text, sizeof text, "%g m", metres);
    Text(x + length + 8, y, text);
  }

  Point At(const RunFolder& run, int pose, size_t panel) const {
    return view_.Project(run.T_world_body[static_cast<size_t>(pose)], panel);
  }

  const std::vector<RunFolder>& runs_;
  const std::string& gain_unit_;
  View view_;
  GainRange gains_;
  bool has_ellipses_ = false;
  std::ostringstream out_;
};

}  // namespace

std::string DrawMaps(const std::vector<RunFolder>& runs, const std::string& gain_unit) {
  return MapPicture(runs, gain_unit).Draw();
}

}  // namespace terse
