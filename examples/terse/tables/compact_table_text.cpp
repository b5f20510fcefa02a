#include "tables/compact_table_text.h"

#include <cmath>

#include "tables/text_table.h"

namespace terse {
namespace {

using Json = nlohmann::ordered_json;

std::string WithPaper(std::optional<double> ours, std::optional<double> paper, int decimals = 1) {
  return FixedCell(ours, decimals) + (paper ? " (" + Cell(paper, 4) + ")" : "");
}

std::vector<std::string> ErrorCells(const std::optional<TrajectoryErrors>& errors) {
  std::vector<std::string> cells;
  for (PoseError TrajectoryErrors::*kind :
       {&TrajectoryErrors::ate, &TrajectoryErrors::rpe, &TrajectoryErrors::rpe_all}) {
    for (double PoseError::*part : {&PoseError::translation_m, &PoseError::rotation_deg}) {
      cells.push_back(errors ? Cell((*errors).*kind.*part, 4) : "-");
    }
  }
  return cells;
}

void AddCells(std::vector<std::string>& cells, const std::vector<std::string>& more) {
  cells.insert(cells.end(), more.begin(), more.end());
}

const std::vector<std::string> kErrorNames = {"ATE m", "ATE deg", "RPE m", "RPE deg", "RPE all m", "RPE all deg"};

std::string RecoveryText(const std::vector<CompactTableRow>& rows) {
  std::vector<std::string> header = {"graph", "recovery"};
  AddCells(header, kErrorNames);
  TextTable table(header, 2);
  for (const CompactTableRow& row : rows) {
    for (const auto& [name, errors] : row.recovery) {
      std::vector<std::string> cells = {row.graph, name};
      AddCells(cells, ErrorCells(errors));
      table.AddRow(cells);
    }
  }
  return table.Text();
}

std::string ThresholdsText(const std::vector<CompactTableRow>& rows) {
  TextTable table({"graph", "range v m, rad", "s", "g_loop nats", "g_pose nats", "links %", "poses %", "time s"}, 2);
  for (const CompactTableRow& row : rows) {
    const ChosenThresholds& chosen = row.thresholds;
    std::string range;
    for (const double v : chosen.range) range += (range.empty() ? "" : " ") + Cell(v);
    table.AddRow({row.graph, range, Cell(chosen.probability), FixedCell(chosen.min_loop_gain, 2),
                  FixedCell(chosen.min_pose_gain, 2),
                  WithPaper(Percent(row.fpfl.links, row.links), row.paper.links_percent),
                  WithPaper(Percent(row.fpfl.poses, row.poses), row.paper.poses_percent), Cell(chosen.seconds)});
  }
  return table.Text();
}

std::string TimesText(const std::vector<CompactTableRow>& rows) {
  TextTable table({"graph", "poses", "links", "solving s", "covariances s", "APAL s", "APFL s", "FPFL s", "APAL / FPFL",
                   "links %", "poses %", "registrations"});
  for (const CompactTableRow& row : rows) {
    table.AddRow({row.graph, std::to_string(row.poses), std::to_string(row.links), Cell(row.apal.seconds_solving),
                  Cell(row.apal.seconds_covariances), Cell(row.apal.Seconds()),
                  row.apfl ? Cell(row.apfl->Seconds()) : "-", Cell(row.fpfl.Seconds()),
                  WithPaper(row.TimeRatio(), row.paper.time_ratio), FixedCell(Percent(row.fpfl.links, row.links), 1),
                  FixedCell(Percent(row.fpfl.poses, row.poses), 1), std::to_string(row.fpfl.registrations)});
  }
  return table.Text();
}

std::string ErrorsText(const std::vector<CompactTableRow>& rows) {
  std::vector<std::string> header = {"graph", "reference", "strategy"};
  AddCells(header, kErrorNames);
  header.push_back("ATE / APAL");
  TextTable table(header, 3);
  for (const CompactTableRow& row : rows) {
    const auto add = [&](const char* name, const StrategyResult& result, bool is_ours) {
      std::vector<std::string> cells = {row.graph, Name(row.reference), name};
      AddCells(cells, ErrorCells(result.errors));
      cells.push_back(WithPaper(row.AteRatio(result), is_ours ? row.paper.ate_ratio : std::nullopt, 2));
      table.AddRow(cells);
    };
    add("APAL", row.apal, false);
    if (row.apfl) add("APFL", *row.apfl, false);
    add("FPFL", row.fpfl, true);
    if (row.rfpfl) add("RFPFL", *row.rfpfl, false);
  }
  return table.Text();
}

std::string BoundedText(const std::vector<CompactTableRow>& rows) {
  TextTable table({"graph", "poses %", "links %", "FPFL poses %", "FPFL links %", "ATE m", "FPFL ATE m", "random ATE m",
                   "random / bounded", "ATE / APAL", "time s", "APAL / bounded"});
  for (const CompactTableRow& row : rows) {
    const auto ate = [](const StrategyResult& result) {
      return result.errors ? std::optional<double>(result.errors->ate.translation_m) : std::nullopt;
    };
    const auto over = [](std::optional<double> a, std::optional<double> b) {
      return a && b ? std::optional<double>(*a / *b) : std::nullopt;
    };
    const std::optional<double> random = row.random ? ate(*row.random) : std::nullopt;
    table.AddRow({row.graph, FixedCell(Percent(row.bounded.poses, row.poses), 1),
                  FixedCell(Percent(row.bounded.links, row.links), 1), FixedCell(Percent(row.fpfl.poses, row.poses), 1),
                  FixedCell(Percent(row.fpfl.links, row.links), 1), Cell(ate(row.bounded), 4), Cell(ate(row.fpfl), 4),
                  Cell(random, 4), FixedCell(over(random, ate(row.bounded)), 1),
                  FixedCell(row.AteRatio(row.bounded), 2), Cell(row.bounded.Seconds()),
                  FixedCell(over(row.apal.Seconds(), row.bounded.Seconds()), 0)});
  }
  return table.Text();
}

Json OrNull(std::optional<double> value) { return value && std::isfinite(*value) ? Json(*value) : Json(nullptr); }

Json ToJson(const PoseError& error) {
  return {{"translation_m", error.translation_m}, {"rotation_deg", error.rotation_deg}};
}

Json ToJson(const std::optional<TrajectoryErrors>& errors) {
  if (!errors) return nullptr;
  return {{"ate", ToJson(errors->ate)},
          {"rpe", ToJson(errors->rpe)},
          {"rpe_all", ToJson(errors->rpe_all)},
          {"stride", errors->stride}};
}

Json ToJson(const CompactTableRow& row, const StrategyResult& result) {
  Json json;
  json["poses_kept"] = result.poses;
  json["poses_percent"] = Percent(result.poses, row.poses);
  json["links_kept"] = result.links;
  json["links_percent"] = Percent(result.links, row.links);
  json["registrations_tried"] = result.registrations;
  json["seconds"] = {{"solving", OrNull(result.seconds_solving)},
                     {"covariances", OrNull(result.seconds_covariances)},
                     {"total", OrNull(result.Seconds())}};
  json["errors"] = ToJson(result.errors);
  json["ate_ratio"] = OrNull(row.AteRatio(result));
  return json;
}

}  // namespace

std::string CompactTablesText(const std::vector<CompactTableRow>& rows) {
  std::string out = "Table 1: dropped poses recovered by v0, v1, v2 (FPFL)\n\n" + RecoveryText(rows) +
                    "\nTable 2: thresholds chosen from the sample, and what FPFL keeps (the paper's in brackets)\n\n" +
                    ThresholdsText(rows) + "\nTable 3: times; APAL: solving and the covariances of every step\n\n" +
                    TimesText(rows) + "\nTable 4: errors; RFPFL: mean of random runs\n\n" + ErrorsText(rows) +
                    "\nTable 5: a map bounded by area; random: mean of maps of its size\n\n" + BoundedText(rows);
  for (const CompactTableRow& row : rows) {
    const int stride = row.fpfl.errors ? row.fpfl.errors->stride : 1;
    if (stride > 1) {
      out += "\n" + row.graph + ": ATE and RPE of all pairs are of one pose in " + std::to_string(stride) +
             "; APAL is the batch optimum.\n";
    }
  }
  return out;
}

Json ToJson(const CompactTableRow& row) {
  Json json;
  json["graph"] = row.graph;
  json["poses"] = row.poses;
  json["links"] = row.links;
  json["reference"] = Name(row.reference);
  json["thresholds"] = {{"range", row.thresholds.range},
                        {"probability", row.thresholds.probability},
                        {"min_loop_gain", row.thresholds.min_loop_gain},
                        {"min_pose_gain", row.thresholds.min_pose_gain},
                        {"seconds", row.thresholds.seconds}};
  for (const auto& [name, errors] : row.recovery) json["recovery"][name] = ToJson(std::optional(errors));
  json["apal"] = ToJson(row, row.apal);
  json["apfl"] = row.apfl ? ToJson(row, *row.apfl) : Json(nullptr);
  json["fpfl"] = ToJson(row, row.fpfl);
  json["rfpfl"] = row.rfpfl ? ToJson(row, *row.rfpfl) : Json(nullptr);
  json["bounded"] = ToJson(row, row.bounded);
  json["random"] = row.random ? ToJson(row, *row.random) : Json(nullptr);
  json["time_ratio"] = OrNull(row.TimeRatio());
  json["paper"] = {{"poses_percent", OrNull(row.paper.poses_percent)},
                   {"links_percent", OrNull(row.paper.links_percent)},
                   {"ate_ratio", OrNull(row.paper.ate_ratio)},
                   {"time_ratio", OrNull(row.paper.time_ratio)}};
  return json;
}

}  // namespace terse
