#include "pictures/run_report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string_view>
#include <unordered_map>

#include "pictures/compared_runs.h"
#include "pictures/report_page.h"
#include "pictures/svg_chart.h"
#include "terse/compact/decision.h"
#include "terse/compact/explored_area.h"
#include "terse/compact/json_file.h"
#include "terse/core/atomic_file.h"
#include "terse/core/words.h"

namespace terse {
namespace {

using Json = nlohmann::ordered_json;

// Not finite becomes null.
Json Short(double value) {
  if (!std::isfinite(value)) return nullptr;
  char text[40];
  std::snprintf(text, sizeof text, "%.7g", value);
  return std::strtod(text, nullptr);
}
Json Short(const std::optional<double>& value) { return value ? Short(*value) : Json(nullptr); }
Json Flag(const std::optional<bool>& value) { return value ? Json(*value ? 1 : 0) : Json(); }

Json Positions(const std::vector<SE3>& poses) {
  Json out;
  constexpr const char* kNames[] = {"x", "y", "z"};
  for (int k = 0; k < 3; ++k) {
    Json& values = out[kNames[k]] = Json::array();
    for (const SE3& T : poses) values.push_back(Short(T.Translation()[k]));
  }
  return out;
}

const std::vector<std::string>& Verdicts() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> out;
    for (int k = 0; k <= static_cast<int>(PoseVerdict::kAnchored); ++k)
      out.push_back(Name(static_cast<PoseVerdict>(k)));
    return out;
  }();
  return names;
}

Json Poses(const RunFolder& run) {
  Json out;
  out["id"] = run.ids;
  out["kept"] = Json::array();
  for (const char kept : run.kept) out["kept"].push_back(static_cast<int>(kept));
  out["verdict"] = Json::array();
  for (const RunDecision& decision : run.decisions) {
    const auto at = std::find(Verdicts().begin(), Verdicts().end(), decision.verdict.value_or(""));
    out["verdict"].push_back(at != Verdicts().end() ? Json(at - Verdicts().begin()) : Json(nullptr));
  }
  out.update(Positions(run.T_world_body));
  return out;
}

// How many measurements an edge is made of, and whether links of poses that are not kept are among them.
template <class Edge>
void AddParts(const Edge& edge, Json& out) {
  out["measurements"].push_back(edge.measurements);
  out["made_of_links"].push_back(edge.composed ? 1 : 0);
}

Json Links(const RunFolder& run) {
  Json out = {{"from", Json::array()},         {"to", Json::array()},         {"step", Json::array()},
              {"gain", Json::array()},         {"innovation", Json::array()}, {"measurements", Json::array()},
              {"made_of_links", Json::array()}};
  for (const RunLink& link : run.links) {
    out["from"].push_back(link.from);
    out["to"].push_back(link.to);
    out["step"].push_back(link.step);
    out["gain"].push_back(Short(link.gain));
    out["innovation"].push_back(Short(link.innovation));
    AddParts(link, out);
  }
  return out;
}

Json Chain(const RunFolder& run) {
  Json out = {{"from", Json::array()},
              {"to", Json::array()},
              {"composed", Json::array()},
              {"measurements", Json::array()},
              {"made_of_links", Json::array()}};
  for (const RunChain& edge : run.chain) {
    out["from"].push_back(edge.from);
    out["to"].push_back(edge.to);
    out["composed"].push_back(edge.dropped);
    AddParts(edge, out);
  }
  return out;
}

Json Decisions(const RunFolder& run) {
  Json out = {{"pose_gain", Json::array()},   {"registrations", Json::array()}, {"accepted", Json::array()},
              {"refused", Json::array()},     {"revived", Json::array()},       {"retired", Json::array()},
              {"anchored_to", Json::array()}, {"edges", Json::array()},         {"candidates", Json::array()}};
  for (const RunDecision& decision : run.decisions) {
    out["pose_gain"].push_back(Short(decision.pose_gain));
    out["registrations"].push_back(decision.registrations_tried);
    out["accepted"].push_back(decision.links_accepted);
    out["refused"].push_back(decision.links_refused);
    out["revived"].push_back(decision.revived);
    out["retired"].push_back(decision.retired);
    out["anchored_to"].push_back(decision.anchored_to ? Json(*decision.anchored_to) : Json());
    Json edges = Json::array();
    for (const RunComposedEdge& edge : decision.edges) {
      edges.push_back({edge.from, edge.to, Short(edge.gain), edge.fused ? 1 : 0});
    }
    out["edges"].push_back(std::move(edges));
    Json candidates = Json::array();
    for (const RunCandidate& c : decision.candidates) {
      candidates.push_back({c.pose, Short(c.probability), Short(c.gain), Short(c.measured_gain), c.accepted ? 1 : 0,
                            Short(c.innovation), Flag(c.tried), Flag(c.measured)});
      if (c.anchors || c.composed) candidates.back().push_back(c.anchors ? "anchors" : "composed");
    }
    out["candidates"].push_back(std::move(candidates));
  }
  return out;
}

Json Covariances(const RunFolder& run) {
  Json out = {{"pose", Json::array()}, {"position", Json::array()}};
  for (const RunCovariance& c : run.covariances) {
    const Matrix<3, 3>& S = c.position;
    out["pose"].push_back(c.pose);
    out["position"].push_back(
        {Short(S(0, 0)), Short(S(0, 1)), Short(S(0, 2)), Short(S(1, 1)), Short(S(1, 2)), Short(S(2, 2))});
  }
  return out;
}

// All columns but the pose's id.
Json Steps(const RunFolder& run) {
  static const std::unordered_map<std::string, std::string> kRenamed = {{"gain_nats", "gain"}};
  Json out;
  for (const auto& [column, values] : run.steps) {
    if (column == "pose") continue;
    const auto renamed = kRenamed.find(column);
    Json& list = out[renamed != kRenamed.end() ? renamed->second : column] = Json::array();
    for (const double value : values) list.push_back(Short(value));
  }
  return out;
}

// Explored by each pose, if the range of the sensor is known.
Json Area(const RunFolder& run) {
  Json out = {{"cell", Short(run.range_m)}, {"explored", Json::array()}};
  for (const double area : ExploredArea(run.T_world_body, run.range_m.value_or(0))) {
    out["explored"].push_back(Short(area));
  }
  return out;
}

Json ToJson(const RunFolder& run) {
  Json out;
  out["name"] = run.name;
  out["dimension"] = run.dimension;
  out["poses"] = Poses(run);
  out["verdicts"] = Verdicts();
  out["truth"] = run.T_world_body_true ? Positions(*run.T_world_body_true) : Json(nullptr);
  out["links"] = Links(run);
  out["chain"] = Chain(run);
  out["decisions"] = Decisions(run);
  out["covariances"] = Covariances(run);
  out["steps"] = Steps(run);
  out["area"] = Area(run);
  // That of compact runs, which the command offers no choice of.
  out["gate"] = WordOf(Gate::kNewtonDecrement);
  out["gate_unit"] = "share of chi2";
  out["thresholds"] = ParseJson<Json>(run.thresholds_json, run.path + "/thresholds.json");
  out["thresholds"].erase("link_covariance");
  out["stats"] = ParseJson<Json>(run.stats_json, run.path + "/stats.json");
  return out;
}

// As deep as the lists of a run's poses and decisions lie.
constexpr int kPieceDepth = 5;

void WriteWithoutTags(const Json& json, std::ostream& out) {
  const std::string text = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  for (std::size_t start = 0; start < text.size();) {
    const std::size_t end = std::min(text.find('<', start), text.size());
    out << std::string_view(text).substr(start, end - start);
    if (end < text.size()) out << "\\u003c";  // no "</script>" in it
    start = end + 1;
  }
}

// As dump() has it, which would need memory for the text of a whole run.
void WriteInPieces(const Json& json, int depth, std::ostream& out) {
  if (depth == 0 || !json.is_structured()) {
    WriteWithoutTags(json, out);
    return;
  }
  out << (json.is_object() ? '{' : '[');
  const char* before = "";
  for (const auto& item : json.items()) {
    out << before;
    before = ",";
    if (json.is_object()) {
      WriteWithoutTags(item.key(), out);
      out << ':';
    }
    WriteInPieces(item.value(), depth - 1, out);
  }
  out << (json.is_object() ? '}' : ']');
}

}  // namespace

Json ReportToJson(const std::vector<RunFolder>& runs) {
  Json out;
  out["format"] = "terse-report-1";
  out["version"] = TERSE_VERSION;
  out["runs"] = Json::array();
  for (const RunFolder& run : runs) out["runs"].push_back(ToJson(run));
  return out;
}

void WriteReport(const std::vector<RunFolder>& runs, const std::string& path) {
  static const std::string kPlace = "\"@TERSE_REPORT_DATA@\"";
  const Json data = ReportToJson(runs);
  const std::string page = ReportPage();
  const std::size_t at = page.find(kPlace);
  if (at == std::string::npos) throw std::logic_error("the report's page has no place for its data");
  AtomicFile file(path);
  file.Stream() << std::string_view(page).substr(0, at);
  WriteInPieces(data, kPieceDepth, file.Stream());
  file.Stream() << std::string_view(page).substr(at + kPlace.size());
  file.Commit();
}

void WriteReport(const std::vector<std::string>& folders, const std::string& path) {
  WriteReport(ReadRunFolders(folders), path);
}

}  // namespace terse
