#include "tables/sparsify_table_text.h"

#include "tables/text_table.h"
#include "terse/compact/words.h"

namespace terse {
namespace {

using Json = nlohmann::ordered_json;

std::string LinksText(const SparsifyTableGraph& graph) {
  TextTable table({"criterion", "%", "links", "ATE m", "rotation deg", "log det lost", "expected m", "time s"}, 1);
  for (const SparsifyLinksRow& row : graph.link_rows) {
    table.AddRow({WordOf(row.criterion), Cell(row.percent, 4), std::to_string(row.links), Cell(row.ate),
                  Cell(row.rotation), Cell(row.log_det_lost, 4), Cell(row.expected_error, 4),
                  FixedCell(row.seconds, 2)});
  }
  return table.Text();
}

std::string PosesText(const SparsifyTableGraph& graph) {
  TextTable table({"recovered", "sparsity", "poses", "divergence nats", "per dropped pose", "time s"}, 1);
  for (const SparsifyPosesRow& row : graph.pose_rows) {
    const int dropped = graph.poses - row.poses;
    table.AddRow({WordOf(row.recovered), std::to_string(row.sparsity), std::to_string(row.poses),
                  Cell(row.divergence, 3), dropped > 0 ? Cell(row.divergence / dropped, 3) : "-",
                  FixedCell(row.seconds, 2)});
  }
  return table.Text();
}

Json ToJson(const SparsifyTableGraph& graph) {
  Json json;
  json["graph"] = graph.is.name;
  json["path"] = graph.is.path;
  json["failure"] = graph.failure.empty() ? Json(nullptr) : Json(graph.failure);
  json["dimension"] = graph.dimension == 0 ? Json(nullptr) : Json(graph.dimension);
  json["poses"] = graph.poses;
  json["links"] = graph.links;
  json["expected_error_m"] = graph.expected_error;
  json["link_rows"] = Json::array();
  for (const SparsifyLinksRow& row : graph.link_rows) {
    json["link_rows"].push_back({{"percent", row.percent},
                                 {"criterion", WordOf(row.criterion)},
                                 {"links", row.links},
                                 {"ate_m", row.ate},
                                 {"rotation_deg", row.rotation},
                                 {"log_det_lost_nats", row.log_det_lost},
                                 {"expected_error_m", row.expected_error},
                                 {"seconds", row.seconds}});
  }
  json["pose_rows"] = Json::array();
  for (const SparsifyPosesRow& row : graph.pose_rows) {
    json["pose_rows"].push_back({{"sparsity", row.sparsity},
                                 {"recovered", WordOf(row.recovered)},
                                 {"poses", row.poses},
                                 {"divergence_nats", row.divergence},
                                 {"seconds", row.seconds}});
  }
  return json;
}

}  // namespace

std::string SparsifyGraphText(const SparsifyTableGraph& graph) {
  std::string text = graph.is.name + ": ";
  if (graph.dimension > 0) {
    text += std::to_string(graph.dimension) + "D, " + std::to_string(graph.poses) + " poses, " +
            std::to_string(graph.links) + " links, expected error " + Cell(graph.expected_error, 4) + " m";
  }
  if (!graph.failure.empty()) text += (graph.dimension > 0 ? "; " : "") + std::string("left out, ") + graph.failure;
  text += '\n';
  if (!graph.link_rows.empty()) text += '\n' + LinksText(graph);
  if (!graph.pose_rows.empty()) text += '\n' + PosesText(graph);
  return text;
}

std::string SparsifySummaryText(const std::vector<SparsifyTableGraph>& graphs) {
  const SparsifySummary summary = Summarise(graphs);
  if (summary.cells == 0) return "";
  const std::string cells = std::to_string(summary.cells);
  return "By position ATE is at most the best of connectivity and random in " + std::to_string(summary.position_best) +
         " of " + cells + " cells, and " + FixedCell(summary.position_ratio, 2) +
         " times that on average (geometric); by information the log-determinant lost is the least in " +
         std::to_string(summary.information_best) + " of " + cells + ".\n";
}

std::string SparsifyTableText(const std::vector<SparsifyTableGraph>& graphs) {
  std::string out = SparsifySummaryText(graphs);
  for (const SparsifyTableGraph& graph : graphs) out += (out.empty() ? "" : "\n") + SparsifyGraphText(graph);
  return out;
}

Json SparsifyTableJson(const std::vector<SparsifyTableGraph>& graphs, const SparsifyTableOptions& options) {
  Json json;
  json["percents"] = options.percents;
  json["draws"] = options.draws;
  json["sparsities"] = options.sparsities;
  json["graphs"] = Json::array();
  for (const SparsifyTableGraph& graph : graphs) json["graphs"].push_back(ToJson(graph));
  const SparsifySummary summary = Summarise(graphs);
  json["summary"] = {{"cells", summary.cells},
                     {"position_best", summary.position_best},
                     {"position_ratio", summary.cells > 0 ? Json(summary.position_ratio) : Json(nullptr)},
                     {"information_best", summary.information_best}};
  return json;
}

}  // namespace terse
