#include "commands/sweep_frontier.h"

#include <algorithm>
#include <iostream>

#include "pictures/svg_chart.h"
#include "run/standard_output.h"
#include "tables/text_table.h"
#include "terse/core/atomic_file.h"
#include "terse/core/number_text.h"

namespace terse {
namespace {

std::string ErrorLabel(const Frontier& frontier) {
  return frontier.reference == ReferenceKind::kFile ? "ATE to the ground truth, m" : "ATE to the full optimum, m";
}

ChartPanel Panel(const Frontier& frontier, const std::string& title, const std::string& x_label,
                 int FrontierPoint::*size, int whole) {
  ChartPanel panel{title, x_label, ErrorLabel(frontier), {}, true, true};
  double least = 100, most = 0;
  for (const FrontierCurve& curve : frontier.curves) {
    ChartLine line{curve.name, {}, {}, true, true, curve.is_random};
    for (const FrontierPoint& point : curve.points) {
      // A map of everything is its own optimum: what is left is rounding, far below on the axis.
      const bool is_all = point.poses == frontier.poses && point.links == frontier.links;
      if (is_all && frontier.reference == ReferenceKind::kOptimum) continue;
      const double percent = Percent(point.*size, whole);
      line.x.push_back(percent);
      line.y.push_back(point.ate.translation_m);
      if (percent > 0) least = std::min(least, percent);
      most = std::max(most, percent);
    }
    panel.lines.push_back(std::move(line));
  }
  if (frontier.ate_of_all_m && least < most) {
    const double ate = *frontier.ate_of_all_m;
    panel.lines.push_back({"all poses and links", {least, most}, {ate, ate}, false, true, true});
  }
  return panel;
}

}  // namespace

void PrintFrontier(const Frontier& frontier) {
  TextTable table({"map", "gains x", "poses", "poses %", "links", "links %", "time s", "ATE m", "ATE deg"}, 1);
  for (const FrontierCurve& curve : frontier.curves) {
    for (const FrontierPoint& point : curve.points) {
      table.AddRow({curve.name, Cell(point.scale), std::to_string(point.poses),
                    FixedCell(Percent(point.poses, frontier.poses), 1), std::to_string(point.links),
                    FixedCell(Percent(point.links, frontier.links), 1), Cell(point.seconds),
                    Cell(point.ate.translation_m, 4), Cell(point.ate.rotation_deg, 4)});
    }
  }
  std::cout << "Maps of " << frontier.poses << " poses, " << frontier.links << " links; ATE against "
            << (frontier.reference == ReferenceKind::kFile ? "the ground truth" : "the optimum of the full graph");
  if (frontier.ate_of_all_m) std::cout << ", with all poses and links " << Cell(*frontier.ate_of_all_m, 4) << " m";
  std::cout << '\n' << table.Text();
  FlushOutput();
}

void WriteFrontierCsv(const Frontier& frontier, const std::string& path) {
  AtomicFile file(path);
  std::ostream& out = file.Stream();
  out << "map,scale,min_loop_gain,min_pose_gain,poses,poses_percent,links,links_percent,registrations,seconds,ate_m,"
         "ate_deg,least_ate_m,most_ate_m\n";
  for (const FrontierCurve& curve : frontier.curves) {
    for (const FrontierPoint& point : curve.points) {
      std::string name = curve.name;
      name.erase(std::remove(name.begin(), name.end(), ','), name.end());
      out << name;
      for (const double value :
           {point.scale, point.min_loop_gain, point.min_pose_gain, static_cast<double>(point.poses),
            Percent(point.poses, frontier.poses), static_cast<double>(point.links),
            Percent(point.links, frontier.links), static_cast<double>(point.registrations), point.seconds,
            point.ate.translation_m, point.ate.rotation_deg, point.least_ate_m, point.most_ate_m}) {
        out << ',' << Shortest(value);
      }
      out << '\n';
    }
  }
  file.Commit();
}

void WriteFrontierChart(const Frontier& frontier, const std::string& name, const std::string& path) {
  WriteText(DrawCharts("Size against error of compact maps: " + name,
                       {Panel(frontier, "Poses", "poses kept, % of all poses", &FrontierPoint::poses, frontier.poses),
                        Panel(frontier, "Links", "links kept, % of all links", &FrontierPoint::links, frontier.links)}),
            path);
}

}  // namespace terse
