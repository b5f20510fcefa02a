#include "tables/outlier_table_text.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "tables/text_table.h"
#include "terse/compact/compact_json.h"
#include "terse/core/words.h"

namespace terse {
namespace {

using Json = nlohmann::ordered_json;

std::string KindCell(const std::optional<OutlierKind>& kind) { return kind ? WordOf(*kind) : "clean"; }

std::string ShareCell(int part, int whole) { return whole == 0 ? "-" : FixedCell(Percent(part, whole), 0); }

std::string SigmasInWords(const KindScale& scale) {
  return Cell(scale.translation) + " in translation, " + Cell(scale.rotation) + " in rotation";
}

std::string Heading(const OutlierGraph& graph) {
  std::string text = graph.is.name + ": ";
  if (graph.dimension == 0) return text + "left out, " + graph.failure;
  text += std::to_string(graph.dimension) + "D, " + std::to_string(graph.poses) + " poses, " +
          std::to_string(graph.loops) + " loops";
  if (!graph.failure.empty()) return text + "; left out, " + graph.failure;
  text += "; reference: " + std::string(Name(graph.reference));
  if (graph.reference == ReferenceKind::kOptimum) text += ", expected error " + Cell(graph.sigma) + " m";
  if (!graph.scale.IsOne()) {
    text += "; standard deviations scaled by " + SigmasInWords(graph.scale.odometry) + " (odometry), " +
            SigmasInWords(graph.scale.loops) + " (loops)";
  }
  return text;
}

Json OrNull(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }
Json ToJson(const std::optional<OutlierKind>& kind) { return kind ? Json(WordOf(*kind)) : Json(nullptr); }
Json ToJson(const std::optional<StepTimes>& steps) {
  if (!steps) return nullptr;
  return {{"median", steps->median_ms}, {"p99", steps->p99_ms}, {"worst", steps->worst_ms}};
}

Json ToJson(const OutlierRow& row) {
  Json json;
  json["kind"] = ToJson(row.kind);
  json["percent"] = row.percent;
  json["method"] = row.method;
  json["runs"] = row.runs;
  json["failed"] = row.failed;
  json["successes"] = row.successes;
  json["precision"] = OrNull(row.precision);
  json["recall"] = OrNull(row.recall);
  json["ate_m"] = {{"median", OrNull(row.median_ate)}, {"worst", OrNull(row.worst_ate)}};
  json["ratio"] = {{"median", OrNull(row.median_ratio)}, {"worst", OrNull(row.worst_ratio)}};
  json["step_ms"] = ToJson(row.steps);
  json["seconds"] = row.seconds;
  return json;
}

Json ToJson(const OutlierGraph& graph) {
  Json json;
  json["graph"] = graph.is.name;
  json["path"] = graph.is.path;
  json["failure"] = graph.failure.empty() ? Json(nullptr) : Json(graph.failure);
  json["dimension"] = graph.dimension == 0 ? Json(nullptr) : Json(graph.dimension);
  json["poses"] = graph.poses;
  json["loops"] = graph.loops;
  json["reference"] = Name(graph.reference);
  json["reference_error_m"] = graph.sigma;
  json["sigma_scale"] = graph.scale.IsOne() ? Json(nullptr) : Json(terse::ToJson(graph.scale));
  json["rows"] = Json::array();
  for (const OutlierRow& row : graph.rows) json["rows"].push_back(ToJson(row));
  json["runs"] = Json::array();
  for (const OutlierRun& run : graph.runs) json["runs"].push_back(OutlierRunJson(run));
  return json;
}

Json ToJson(const OutlierSummary& summary) {
  Json json;
  json["dimension"] = summary.dimension;
  json["kind"] = ToJson(summary.kind);
  json["method"] = summary.method;
  json["up_to_50_percent"] = {{"runs", summary.runs_to_half}, {"successes", summary.successes_to_half}};
  json["at_90_percent"] = {{"runs", summary.runs_at_90}, {"successes", summary.successes_at_90}};
  json["ratios"] = Json::array();
  for (const auto& ratio : summary.ratios) {
    json["ratios"].push_back(
        {{"percent", ratio.percent}, {"median", OrNull(ratio.median)}, {"worst", OrNull(ratio.worst)}});
  }
  return json;
}

}  // namespace

std::string OutlierGraphText(const OutlierGraph& graph) {
  if (!graph.failure.empty()) return Heading(graph) + '\n';
  TextTable table({"wrong loops", "method", "%", "success %", "failed", "precision", "recall", "ATE m", "worst m",
                   "ratio", "worst", "step ms", "p99 ms", "worst ms", "time s"},
                  2);
  for (const OutlierRow& row : graph.rows) {
    const auto step = [&](double StepTimes::*part) { return row.steps ? Cell((*row.steps).*part) : "-"; };
    table.AddRow({KindCell(row.kind), row.method, Cell(row.percent, 4), ShareCell(row.successes, row.runs),
                  std::to_string(row.failed), FixedCell(row.precision, 3), FixedCell(row.recall, 3),
                  Cell(row.median_ate, 4), Cell(row.worst_ate, 4), FixedCell(row.median_ratio, 2),
                  FixedCell(row.worst_ratio, 2), step(&StepTimes::median_ms), step(&StepTimes::p99_ms),
                  step(&StepTimes::worst_ms), Cell(row.seconds)});
  }
  std::string failures;
  for (const OutlierRow& row : graph.rows) {
    if (row.failed == 0) continue;
    failures += "\n- failed: " + std::to_string(row.failed) + " of " + std::to_string(row.runs) + ", " + row.method +
                ", " + KindCell(row.kind) + (row.kind ? ", " + Cell(row.percent, 4) + " %" : "") + ": " + row.failure;
  }
  return Heading(graph) + "\n\n" + table.Text() + (failures.empty() ? "" : failures + "\n");
}

std::string OutlierSummaryText(const std::vector<OutlierGraph>& graphs) {
  const std::vector<OutlierSummary> all = SummariseAll(graphs);
  if (all.empty()) return "";
  std::set<double> percents;
  for (const OutlierSummary& summary : all) {
    for (const auto& ratio : summary.ratios) percents.insert(ratio.percent);
  }
  std::vector<std::string> header = {"dimension", "wrong loops", "method"};
  TextTable success({"dimension", "wrong loops", "method", "success % up to 50 %", "runs", "at 90 %", "runs"}, 3);
  for (const double percent : percents) header.push_back(Cell(percent, 4) + " %");
  TextTable ratios(header, 3);
  for (const OutlierSummary& s : all) {
    const std::vector<std::string> names = {std::to_string(s.dimension) + "D", KindCell(s.kind), s.method};
    success.AddRow({names[0], names[1], names[2], ShareCell(s.successes_to_half, s.runs_to_half),
                    std::to_string(s.runs_to_half), ShareCell(s.successes_at_90, s.runs_at_90),
                    std::to_string(s.runs_at_90)});
    std::vector<std::string> cells = names;
    for (const double percent : percents) {
      const auto at = std::find_if(s.ratios.begin(), s.ratios.end(),
                                   [&](const OutlierSummary::Ratio& ratio) { return ratio.percent == percent; });
      cells.push_back(at == s.ratios.end() ? "-" : FixedCell(at->median, 2) + " (" + FixedCell(at->worst, 2) + ")");
    }
    ratios.AddRow(cells);
  }
  return "Success over all graphs\n\n" + success.Text() +
         "\nError over that of the clean run, median and (worst), over all graphs\n\n" + ratios.Text();
}

std::string OutlierTableText(const std::vector<OutlierGraph>& graphs) {
  std::string out = OutlierSummaryText(graphs);
  for (const OutlierGraph& graph : graphs) out += (out.empty() ? "" : "\n") + OutlierGraphText(graph);
  return out;
}

Json OutlierRunJson(const OutlierRun& run) {
  Json json;
  json["kind"] = ToJson(run.kind);
  json["percent"] = run.percent;
  json["seed"] = run.kind ? Json(run.seed) : Json(nullptr);
  json["method"] = run.method;
  json["failure"] = run.failure.empty() ? Json(nullptr) : Json(run.failure);
  json["seconds"] = run.seconds;
  if (!run.failure.empty()) return json;
  json["success"] = run.success;
  json["true_loops"] = run.loops.true_loops;
  json["true_kept"] = run.loops.true_kept;
  json["wrong_loops"] = run.loops.wrong_loops;
  json["wrong_kept"] = run.loops.wrong_kept;
  json["precision"] = run.precision;
  json["recall"] = run.recall;
  json["ate_m"] = OrNull(run.ate);
  json["error_m"] = OrNull(run.error);
  json["ratio"] = run.ratio ? OrNull(*run.ratio) : Json(nullptr);
  json["step_ms"] = ToJson(run.steps);
  return json;
}

Json OutlierTableJson(const std::vector<OutlierGraph>& graphs, const OutlierTableOptions& options) {
  Json json;
  json["percents"] = options.percents;
  json["kinds"] = Json::array();
  for (const OutlierKind kind : options.kinds) json["kinds"].push_back(WordOf(kind));
  json["methods"] = options.methods;
  json["seeds"] = options.seeds;
  json["first_seed"] = options.first_seed;
  json["graphs"] = Json::array();
  for (const OutlierGraph& graph : graphs) json["graphs"].push_back(ToJson(graph));
  json["summary"] = Json::array();
  for (const OutlierSummary& summary : SummariseAll(graphs)) json["summary"].push_back(ToJson(summary));
  return json;
}

}  // namespace terse
