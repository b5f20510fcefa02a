// The plot behind docs/consistency.md: mean NEES of simulated runs over the noise, beside its 95 % band.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <locale>
#include <sstream>

#include "bench_report.h"
#include "simulation.h"
#include "tables/document.h"
#include "terse/core/batch_solver.h"
#include "terse/covariance/marginals.h"

namespace terse::bench {
namespace {

using testing::NeesInterval;

// Means over the runs, per degree of freedom: 1 is consistent.
struct Point {
  double noise = 0;    // times the tests' ordinary noise
  double radians = 0;  // median standard deviation of an edge's rotation about an axis
  double newest = 0, all = 0;
  int lost = 0;  // runs that did not end in an optimum
};

struct Sweep {
  std::string name;
  int dof = 0, dof_of_all = 0;
  std::vector<Point> points;
};

template <class Pose>
double MedianRotation(const PoseGraph<Pose>& graph) {
  std::vector<double> deviations;
  for (const auto& node : graph.Factors()) {
    const auto* f = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (f == nullptr) continue;
    const Eigen::MatrixXd Sigma = Eigen::MatrixXd(f->information).inverse();
    for (int k = Pose::kDim; k < Pose::kDof; ++k) deviations.push_back(std::sqrt(Sigma(k, k)));
  }
  std::nth_element(deviations.begin(), deviations.begin() + static_cast<long>(deviations.size() / 2), deviations.end());
  return deviations[deviations.size() / 2];
}

template <class Pose>
Sweep Run(const std::string& name, const std::vector<double>& noises, int runs) {
  constexpr int B = Pose::kDof;
  Sweep sweep{name, B, 0, {}};
  for (const double noise : noises) {
    std::fprintf(stderr, "%s, noise %g ...\n", name.c_str(), noise);
    Point point;
    point.noise = noise;
    for (int seed = 1; seed <= runs; ++seed) {
      testing::SimulationOptions options;
      options.noise = noise;
      const auto run = testing::Simulate<Pose>(static_cast<std::uint64_t>(seed), options);
      const auto result = SolveBatch(run.graph, run.initial);
      if (seed == 1) point.radians = MedianRotation(run.graph);
      if (!result.Converged()) ++point.lost;
      const Marginals<Pose> marginals(run.graph, result.T_world_body);
      std::vector<PoseId> ids;
      Eigen::VectorXd e(B * (static_cast<Eigen::Index>(run.truth.size()) - 1));
      for (std::size_t k = 1; k < run.truth.size(); ++k) {
        ids.push_back(run.graph.Poses()[k].id);
        e.segment<B>(B * (static_cast<Eigen::Index>(k) - 1)) = result.T_world_body[k].Local(run.truth[k]);
      }
      sweep.dof_of_all = static_cast<int>(e.size());
      point.newest += testing::Nees(e.tail<B>(), marginals.Marginal(ids.back())) / (runs * B);
      point.all += testing::Nees(e, marginals.Joint(ids)) / (runs * static_cast<double>(e.size()));
    }
    sweep.points.push_back(point);
  }
  return sweep;
}

std::string Interval(int runs, int dof) {
  const auto bounds = NeesInterval(runs, dof);
  return "[" + Format("%.3f", bounds.low / dof) + ", " + Format("%.3f", bounds.high / dof) + "]";
}

std::string Table(const std::vector<Sweep>& sweeps, int runs) {
  std::string header = "| noise |", rule = "|---:|";
  for (const auto& sweep : sweeps) {
    header += " " + sweep.name + ": mrad | newest pose | all poses |";
    rule += "---:|---:|---:|";
  }
  std::string out = header + "\n" + rule + "\n";
  for (std::size_t k = 0; k < sweeps.front().points.size(); ++k) {
    out += "| " + Format("%.3g", sweeps.front().points[k].noise) + " |";
    for (const auto& sweep : sweeps) {
      const Point& p = sweep.points[k];
      out += " " + Format("%.3g", 1e3 * p.radians) + " | " + Format("%.3f", p.newest) + " | " + Format("%.3f", p.all) +
             (p.lost > 0 ? " (" + std::to_string(p.lost) + " runs without optimum)" : "") + " |";
    }
    out += "\n";
  }
  out += "| *95 % interval* |";
  for (const auto& sweep : sweeps)
    out += " | " + Interval(runs, sweep.dof) + " | " + Interval(runs, sweep.dof_of_all) + " |";
  return out + "\n";
}

// One panel per sweep, both axes logarithmic.
class Picture {
 public:
  Picture(const std::vector<Sweep>& sweeps, int runs) : sweeps_(sweeps), runs_(runs) {
    out_.imbue(std::locale::classic());
  }

  std::string Draw() {
    out_ << "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 900 400\" width=\"900\" height=\"400\" "
            "font-family=\"system-ui,-apple-system,Segoe UI,Helvetica,Arial,sans-serif\" font-size=\"13\" "
            "fill=\"#768390\">\n<title>Mean NEES per degree of freedom over the noise, with its 95 % band</title>\n";
    for (std::size_t k = 0; k < sweeps_.size(); ++k) Panel(sweeps_[k], 70 + 430 * static_cast<double>(k));
    Legend();
    out_ << "</svg>\n";
    return out_.str();
  }

 private:
  static constexpr double kTop = 50, kHeight = 240, kWidth = 380, kLow = 0.85, kHigh = 1.5;
  static constexpr const char *kNewest = "#e8710a", *kAll = "#2f81f7";

  static double X(const Sweep& sweep, double radians) {
    const double first = sweep.points.front().radians, last = sweep.points.back().radians;
    return kWidth * (0.03 + 0.94 * std::log(radians / first) / std::log(last / first));
  }
  static double Y(double nees) { return kTop + kHeight * (1 - std::log(nees / kLow) / std::log(kHigh / kLow)); }
  void Text(double x, double y, const std::string& text, const char* anchor, const char* more = "") {
    out_ << "<text x=\"" << x << "\" y=\"" << y << "\" text-anchor=\"" << anchor << "\"" << more << ">" << text
         << "</text>\n";
  }
  void Line(double x1, double y1, double x2, double y2, const char* style) {
    out_ << "<path d=\"M" << x1 << "," << y1 << "L" << x2 << "," << y2 << "\" fill=\"none\" " << style << "/>\n";
  }
  void Band(double left, int dof, const char* colour) {
    const auto bounds = NeesInterval(runs_, dof);
    const double y = Y(bounds.high / dof);
    out_ << "<rect x=\"" << left << "\" y=\"" << y << "\" width=\"" << kWidth << "\" height=\""
         << Y(bounds.low / dof) - y << "\" fill=\"" << colour << "\" fill-opacity=\"0.25\"/>\n";
  }
  // What leaves the panel is cut off at its upper edge.
  void Curve(double left, const Sweep& sweep, double Point::*value, const char* colour) {
    out_ << "<polyline clip-path=\"url(#panel" << left << ")\" fill=\"none\" stroke-width=\"2\" stroke=\"" << colour
         << "\" points=\"";
    for (const Point& p : sweep.points) out_ << left + X(sweep, p.radians) << "," << Y(p.*value) << " ";
    out_ << "\"/>\n";
    for (const Point& p : sweep.points) {
      if (p.*value > kHigh) continue;
      out_ << "<circle cx=\"" << left + X(sweep, p.radians) << "\" cy=\"" << Y(p.*value) << "\" r=\"3\" fill=\""
           << colour << "\"/>\n";
    }
  }
  void Panel(const Sweep& sweep, double left) {
    const double bottom = kTop + kHeight;
    out_ << "<clipPath id=\"panel" << left << "\"><rect x=\"" << left << "\" y=\"" << kTop << "\" width=\"" << kWidth
         << "\" height=\"" << kHeight << "\"/></clipPath>\n";
    Text(left, kTop - 14, sweep.name, "start", " font-size=\"15\" font-weight=\"600\"");
    Band(left, sweep.dof, kNewest);
    Band(left, sweep.dof_of_all, kAll);
    const char* thin = "stroke=\"#8b949e\" stroke-opacity=\"0.35\"";
    for (const double y : {0.9, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5}) {
      Line(left, Y(y), left + kWidth, Y(y), y == 1 ? "stroke=\"#8b949e\"" : thin);
      Text(left - 8, Y(y) + 4, Format("%g", y), "end");
    }
    for (const double mrad : {1, 3, 10, 30, 100, 300, 1000}) {
      const double x = X(sweep, 1e-3 * mrad);
      if (x < 0 || x > kWidth) continue;
      Line(left + x, bottom, left + x, bottom + 5, "stroke=\"#8b949e\"");
      Text(left + x, bottom + 20, Format("%g", mrad), "middle");
    }
    Line(left, bottom, left + kWidth, bottom, "stroke=\"#8b949e\"");
    Text(left + kWidth / 2, bottom + 42, "standard deviation of an edge's rotation, mrad", "middle");
    Curve(left, sweep, &Point::newest, kNewest);
    Curve(left, sweep, &Point::all, kAll);
  }
  void Legend() {
    const double y = kTop + kHeight + 78;
    const std::pair<const char*, std::string> entries[] = {{kNewest, "newest pose"}, {kAll, "all poses jointly"}};
    double x = 70;
    for (const auto& [colour, text] : entries) {
      out_ << "<path d=\"M" << x << "," << y - 4 << "h24\" stroke-width=\"2\" stroke=\"" << colour << "\"/>\n";
      out_ << "<circle cx=\"" << x + 12 << "\" cy=\"" << y - 4 << "\" r=\"3\" fill=\"" << colour << "\"/>\n";
      Text(x + 32, y, text, "start");
      out_ << "<rect x=\"" << x + 170 << "\" y=\"" << y - 11 << "\" width=\"24\" height=\"14\" fill=\"" << colour
           << "\" fill-opacity=\"0.25\"/>\n";
      Text(x + 202, y, "its 95 % interval", "start");
      x += 430;
    }
    out_ << "<text transform=\"translate(22," << kTop + kHeight / 2
         << ") rotate(-90)\" text-anchor=\"middle\">mean NEES per degree of freedom</text>\n";
  }

  const std::vector<Sweep>& sweeps_;
  int runs_;
  std::ostringstream out_;
};

}  // namespace

int Main(int argc, char** argv) {
  int runs = 200;
  std::vector<double> noises;
  std::string svg, update;
  for (double noise = 0.5; noise < 40; noise *= std::sqrt(2.0)) noises.push_back(noise);
  CLI::App app("Mean NEES of simulated runs over the noise", "consistency");
  app.add_option("--runs", runs, "Runs per point")->check(CLI::PositiveNumber);
  app.add_option("--noise", noises, "Multiples of the ordinary noise, ascending")->delimiter(',');
  app.add_option("--svg", svg, "Write the plot here");
  app.add_option("--update", update, "Put the table into this document");
  CLI11_PARSE(app, argc, argv);
  const std::vector<Sweep> sweeps = {Run<SE2>("2D", noises, runs), Run<SE3>("3D", noises, runs)};
  const std::string table = Table(sweeps, runs);
  std::cout << table;
  if (!svg.empty()) std::ofstream(svg) << Picture(sweeps, runs).Draw();
  if (!update.empty()) UpdateDocument(update, table, "bench");
  return 0;
}

}  // namespace terse::bench
