#include "pictures/run_charts.h"

#include <algorithm>
#include <cmath>

#include "pictures/svg_chart.h"
#include "terse/compact/explored_area.h"

namespace terse {
namespace {

// Names of the lines: with one run what is drawn, with several whose it is.
std::string LineName(const std::vector<RunFolder>& runs, const RunFolder& run, const std::string& what) {
  if (what.empty()) return run.name;
  return runs.size() == 1 ? what : run.name + ", " + what;
}

ChartLine Threshold(const std::string& name, std::optional<double> threshold, const RunFolder& run) {
  const double value = threshold.value_or(NAN);
  ChartLine line{name, {1, static_cast<double>(run.ids.size())}, {value, value}};
  line.dashed = true;
  return line;
}

// A column of steps.csv where it has values; the step's number is its place.
ChartLine Column(const std::string& name, const RunFolder& run, const std::string& column) {
  const auto found = run.steps.find(column);
  if (found == run.steps.end()) return {name, {}, {}};
  ChartLine line{name, {}, {}};
  for (std::size_t k = 0; k < found->second.size(); ++k) {
    if (!std::isfinite(found->second[k])) continue;
    line.x.push_back(static_cast<double>(k + 1));
    line.y.push_back(found->second[k]);
  }
  return line;
}

// A map bounded by area goes to the right, one that grows with time upwards.
ChartLine PosesOverArea(const std::string& name, const RunFolder& run) {
  ChartLine line{name, {}, {}};
  const std::vector<double> area = ExploredArea(run.T_world_body, run.range_m.value_or(0));
  const auto poses = run.steps.find("poses");
  if (poses == run.steps.end()) return line;
  for (std::size_t k = 0; k < std::min(area.size(), poses->second.size()); ++k) {
    if (!std::isfinite(poses->second[k])) continue;
    line.x.push_back(area[k]);
    line.y.push_back(poses->second[k]);
  }
  return line;
}

ChartLine Dots(ChartLine line) {
  line.joined = false;
  line.marked = true;
  return line;
}

ChartLine Cumulative(ChartLine line) {
  double sum = 0;
  for (double& y : line.y) y = sum += y;
  return line;
}

std::string Names(const std::vector<RunFolder>& runs) {
  std::string out;
  for (const RunFolder& run : runs) out += (out.empty() ? "" : ", ") + run.name;
  return out;
}

}  // namespace

std::string DrawGains(const std::vector<RunFolder>& runs) {
  ChartPanel loops{"Loops: measured gain", "step", "gain [nats]", {}};
  ChartPanel poses{"Poses: least gain of a possible link", "step", "gain [nats]", {}};
  loops.log_y = poses.log_y = true;
  for (const RunFolder& run : runs) {
    ChartLine accepted{LineName(runs, run, "accepted"), {}, {}}, rejected{LineName(runs, run, "not accepted"), {}, {}};
    for (std::size_t k = 0; k < run.decisions.size(); ++k) {
      for (const RunCandidate& candidate : run.decisions[k].candidates) {
        if (!candidate.measured_gain) continue;
        ChartLine& line = candidate.accepted ? accepted : rejected;
        line.x.push_back(static_cast<double>(k + 1));
        line.y.push_back(*candidate.measured_gain);
      }
    }
    ChartLine kept{LineName(runs, run, "kept"), {}, {}}, dropped{LineName(runs, run, "dropped"), {}, {}};
    for (std::size_t k = 0; k < run.decisions.size(); ++k) {
      if (!run.decisions[k].pose_gain) continue;
      ChartLine& line = run.kept[k] != 0 ? kept : dropped;
      line.x.push_back(static_cast<double>(k + 1));
      line.y.push_back(*run.decisions[k].pose_gain);
    }
    for (ChartLine* line : {&accepted, &rejected}) loops.lines.push_back(Dots(*line));
    for (ChartLine* line : {&kept, &dropped}) poses.lines.push_back(Dots(*line));
    // A strategy that asks for no gains has no thresholds either.
    const std::string threshold = LineName(runs, run, "threshold");
    if (accepted.x.size() + rejected.x.size() > 0) {
      loops.lines.push_back(Threshold(threshold, run.min_loop_gain, run));
    }
    if (kept.x.size() + dropped.x.size() > 0) {
      poses.lines.push_back(Threshold(threshold, run.min_pose_gain, run));
    }
  }
  return DrawCharts("Information gains, " + Names(runs), {loops, poses});
}

std::string DrawTimings(const std::vector<RunFolder>& runs) {
  ChartPanel step{"Time of a step", "step", "seconds", {}}, total{"Time in all", "step", "seconds", {}};
  ChartPanel size{"Poses and loops of the map", "step", "number", {}};
  ChartPanel nonzeros{"Nonzeros of the factor", "step", "number", {}};
  ChartPanel area{"Kept poses as the area grows", "explored area [m\u00b2]", "poses", {}};
  ChartPanel gate{"Gate of the solver", "step", "share of chi2", {}}, ate{"ATE", "step", "metres", {}};
  step.log_y = gate.log_y = true;
  for (const RunFolder& run : runs) {
    const std::string name = LineName(runs, run, "");
    step.lines.push_back(Dots(Column(name, run, "seconds")));
    total.lines.push_back(Cumulative(Column(name, run, "seconds")));
    size.lines.push_back(Column(LineName(runs, run, "poses"), run, "poses"));
    size.lines.push_back(Column(LineName(runs, run, "loops"), run, "links"));
    area.lines.push_back(PosesOverArea(LineName(runs, run, ""), run));
    nonzeros.lines.push_back(Column(name, run, "factor_nonzeros"));
    gate.lines.push_back(Dots(Column(name, run, "gate_value")));
    ate.lines.push_back(Column(name, run, "ate_m"));
  }
  std::vector<ChartPanel> panels{step, total, size, area, nonzeros, gate};
  for (const ChartLine& line : ate.lines) {
    if (!line.x.empty()) {
      panels.push_back(ate);
      break;
    }
  }
  return DrawCharts("Cost and size, " + Names(runs), panels);
}

}  // namespace terse
