#include "pictures/run_report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <unordered_map>

#include "pictures/report_page.h"
#include "pictures/svg_chart.h"
#include "terse/compact/decision.h"

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
Json Short(const nlohmann::json& value) { return value.is_number() ? Short(value.get<double>()) : Json(nullptr); }

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
    for (int k = 0; k <= static_cast<int>(PoseVerdict::kDrawn); ++k) out.push_back(Name(static_cast<PoseVerdict>(k)));
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
  for (const auto& decision : run.decisions) {
    const auto& verdict = decision.at("verdict");  // null before the decisions that are known
    const auto at =
        std::find(Verdicts().begin(), Verdicts().end(), verdict.is_string() ? verdict.get<std::string>() : "");
    out["verdict"].push_back(at != Verdicts().end() ? Json(at - Verdicts().begin()) : Json(nullptr));
  }
  out.update(Positions(run.T_world_body));
  return out;
}

Json Links(const RunFolder& run) {
  Json out = {{"from", Json::array()},
              {"to", Json::array()},
              {"step", Json::array()},
              {"gain", Json::array()},
              {"innovation", Json::array()}};
  for (const RunLink& link : run.links) {
    out["from"].push_back(link.from);
    out["to"].push_back(link.to);
    out["step"].push_back(link.step);
    out["gain"].push_back(Short(link.gain));
    out["innovation"].push_back(Short(link.innovation));
  }
  return out;
}

Json Chain(const RunFolder& run) {
  Json out = {{"from", Json::array()}, {"to", Json::array()}, {"composed", Json::array()}};
  for (const RunChain& edge : run.chain) {
    out["from"].push_back(edge.from);
    out["to"].push_back(edge.to);
    out["composed"].push_back(edge.dropped);
  }
  return out;
}

Json Decisions(const RunFolder& run) {
  std::unordered_map<std::int64_t, std::size_t> index;
  for (std::size_t k = 0; k < run.ids.size(); ++k) index[run.ids[k]] = k;
  Json out = {{"pose_gain", Json::array()},
              {"registrations", Json::array()},
              {"accepted", Json::array()},
              {"refused", Json::array()},
              {"candidates", Json::array()}};
  for (const auto& decision : run.decisions) {
    out["pose_gain"].push_back(Short(decision.at("pose_gain_nats")));
    out["registrations"].push_back(decision.at("registrations_tried").get<std::int64_t>());
    out["accepted"].push_back(decision.at("links_accepted").get<std::int64_t>());
    out["refused"].push_back(decision.at("links_refused").get<std::int64_t>());
    Json candidates = Json::array();
    for (const auto& c : decision.at("candidates")) {
      // Absent in folders of earlier versions.
      const auto flag = [&c](const char* key) {
        const auto found = c.find(key);
        return found != c.end() && found->is_boolean() ? Json(found->get<bool>() ? 1 : 0) : Json();
      };
      candidates.push_back({index.at(c.at("id").get<std::int64_t>()), Short(c.at("probability")),
                            Short(c.at("gain_nats")), Short(c.at("measured_gain_nats")),
                            c.at("accepted").get<bool>() ? 1 : 0, Short(c.at("innovation")), flag("tried"),
                            flag("measured")});
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
  // That of compact runs, which the command offers no choice of.
  out["gate"] = "newton_decrement";
  out["gate_unit"] = "share of chi2";
  out["thresholds"] = run.thresholds;
  out["thresholds"].erase("link_covariance");
  out["stats"] = run.stats;
  return out;
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
  std::string page = ReportPage();
  const std::string data = ReportToJson(runs).dump(-1, ' ', false, Json::error_handler_t::replace);
  std::string safe;  // no "</script>" in it
  safe.reserve(data.size());
  for (const char c : data) {
    if (c == '<') {
      safe += "\\u003c";
    } else {
      safe += c;
    }
  }
  const std::size_t at = page.find(kPlace);
  if (at == std::string::npos) throw std::logic_error("the report's page has no place for its data");
  WriteText(page.replace(at, kPlace.size(), safe), path);
}

void WriteReport(const std::vector<std::string>& folders, const std::string& path) {
  WriteReport(ReadRunFolders(folders), path);
}

}  // namespace terse
