#include "tables/compact_figures.h"

#include <cmath>

#include "pictures/svg_chart.h"
#include "terse/core/atomic_file.h"
#include "terse/core/number_text.h"

namespace terse {
namespace {

// Comma-separated values, a row at a time.
class Csv {
 public:
  explicit Csv(const std::string& path, const std::string& header) : file_(path) { file_.Stream() << header << '\n'; }
  void Row(const std::vector<std::string>& names, const std::vector<double>& numbers) {
    std::string line;
    for (const std::string& name : names) line += name + ',';
    for (const double number : numbers) line += Shortest(number) + ',';
    line.back() = '\n';
    file_.Stream() << line;
  }
  void Commit() { file_.Commit(); }

 private:
  AtomicFile file_;
};

constexpr const char *kAll = "APAL: all poses, all links", *kFew = "FPFL: few poses, few links",
                     *kMarginalised = "APAL, dropped poses marginalised";

template <class Point, class Value>
ChartLine Line(const std::string& name, const std::vector<Point>& points, const Value& value) {
  ChartLine line{name, {}, {}};
  for (const Point& point : points) {
    line.x.push_back(point.step);
    line.y.push_back(value(point));
  }
  return line;
}

void WriteNorms(const CompactTableRow& row, const std::string& stem) {
  Csv csv(stem + ".csv", "step,strategy,newest_position_m2,newest_rotation_rad2,kept_position_m2,kept_rotation_rad2");
  const std::pair<const char*, CovarianceNorms NormPoint::*> systems[] = {
      {"apal", &NormPoint::apal}, {"marginalised", &NormPoint::marginalised}, {"fpfl", &NormPoint::fpfl}};
  for (const NormPoint& point : row.norms) {
    for (const auto& [name, system] : systems) {
      const CovarianceNorms& n = point.*system;
      csv.Row({std::to_string(point.step), name},
              {n.newest_position, n.newest_rotation, n.kept_position, n.kept_rotation});
    }
  }
  csv.Commit();
  const auto panel = [&](const char* title, const char* y_label, double CovarianceNorms::*value) {
    ChartPanel out{title, "poses seen", y_label, {}};
    const std::pair<const char*, CovarianceNorms NormPoint::*> lines[] = {
        {kAll, &NormPoint::apal}, {kFew, &NormPoint::fpfl}, {kMarginalised, &NormPoint::marginalised}};
    for (const auto& [name, system] : lines) {
      const auto of = system;
      out.lines.push_back(Line(name, row.norms, [&](const NormPoint& p) { return p.*of.*value; }));
    }
    return out;
  };
  WriteText(DrawCharts("Covariances, " + row.graph,
                       {panel("Newest pose: position", "sum of variances, m²", &CovarianceNorms::newest_position),
                        panel("Newest pose: rotation", "sum of variances, rad²", &CovarianceNorms::newest_rotation),
                        panel("Kept poses: position", "sum of variances, m²", &CovarianceNorms::kept_position),
                        panel("Kept poses: rotation", "sum of variances, rad²", &CovarianceNorms::kept_rotation)}),
            stem + ".svg");
}

void WriteGrowth(const CompactTableRow& row, const std::string& stem) {
  Csv csv(stem + ".csv", "strategy,step,poses,links,seconds,hessian_nonzeros,factor_nonzeros");
  for (const auto& [name, result] : {std::pair{"apal", &row.apal}, std::pair{"fpfl", &row.fpfl}}) {
    for (const GrowthPoint& p : result->growth) {
      csv.Row({name}, {static_cast<double>(p.step), static_cast<double>(p.poses), static_cast<double>(p.links),
                       p.seconds, static_cast<double>(p.hessian_nonzeros), static_cast<double>(p.factor_nonzeros)});
    }
  }
  csv.Commit();
  const auto panel = [&](const char* title, std::int64_t GrowthPoint::*value) {
    const auto thousands = [value](const GrowthPoint& p) { return 1e-3 * static_cast<double>(p.*value); };
    return ChartPanel{title,
                      "poses seen",
                      "scalars, thousands",
                      {Line(kAll, row.apal.growth, thousands), Line(kFew, row.fpfl.growth, thousands)}};
  };
  WriteText(DrawCharts("Nonzeros, " + row.graph, {panel("H, lower triangle", &GrowthPoint::hessian_nonzeros),
                                                  panel("Cholesky factor L", &GrowthPoint::factor_nonzeros)}),
            stem + ".svg");
}

// The last point of every lap. Laps are equally long.
std::vector<GrowthPoint> AtLaps(const std::vector<GrowthPoint>& growth, int poses, int laps) {
  std::vector<GrowthPoint> out;
  std::size_t k = 0;
  for (int lap = 1; lap <= laps; ++lap) {
    const double end = static_cast<double>(poses) * lap / laps;
    while (k + 1 < growth.size() && growth[k].step < end) ++k;
    if (growth.empty()) continue;
    out.push_back(growth[k]);
    out.back().step = lap;
  }
  return out;
}

void WriteLaps(const CompactTableRow& row, int laps, const std::string& stem) {
  const auto all = AtLaps(row.apal.growth, row.poses, laps), few = AtLaps(row.fpfl.growth, row.poses, laps);
  Csv csv(stem + ".csv", "strategy,laps,poses,links,seconds");
  for (const auto& [name, points] : {std::pair{"apal", &all}, std::pair{"fpfl", &few}}) {
    for (const GrowthPoint& p : *points) {
      csv.Row({name},
              {static_cast<double>(p.step), static_cast<double>(p.poses), static_cast<double>(p.links), p.seconds});
    }
  }
  csv.Commit();
  const auto panel = [&](const char* title, const char* y_label, const auto& value) {
    ChartPanel out{title, "laps", y_label, {Line(kAll, all, value), Line(kFew, few, value)}};
    for (ChartLine& line : out.lines) line.marked = true;
    return out;
  };
  const auto seconds = [](const GrowthPoint& p) { return p.seconds; };
  ChartPanel logarithmic = panel("Cumulative time, logarithmic", "seconds", seconds);
  logarithmic.log_y = true;
  WriteText(DrawCharts("Growth over the laps, " + row.graph,
                       {panel("Poses kept", "poses", [](const GrowthPoint& p) { return p.poses; }),
                        panel("Links kept", "links", [](const GrowthPoint& p) { return p.links; }),
                        panel("Cumulative time", "seconds", seconds), logarithmic}),
            stem + ".svg");
}

}  // namespace

std::vector<std::string> WriteFigures(const CompactTableRow& row, int laps, const std::string& folder) {
  std::vector<std::string> names;
  const auto write = [&](const char* what, const auto& writer) {
    const std::string stem = row.graph + '_' + what;
    writer(folder + '/' + stem);
    names.push_back(stem + ".csv");
    names.push_back(stem + ".svg");
  };
  if (!row.norms.empty()) write("norms", [&](const std::string& stem) { WriteNorms(row, stem); });
  if (laps > 0) write("laps", [&](const std::string& stem) { WriteLaps(row, laps, stem); });
  write("growth", [&](const std::string& stem) { WriteGrowth(row, stem); });
  return names;
}

}  // namespace terse
