#include "tables/outlier_run_log.h"

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tables/outlier_table_text.h"
#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/core/read_file.h"
#include "terse/core/words.h"

namespace terse {
namespace {

using Json = nlohmann::ordered_json;

std::optional<OutlierKind> KindOf(const Json& json) {
  if (json.is_null()) return std::nullopt;
  for (const auto& [word, kind] : Words<OutlierKind>::kAll) {
    if (json == word) return kind;
  }
  throw std::invalid_argument("no kind " + json.dump());
}

OutlierRun RunOf(const Json& json) {
  OutlierRun run;
  run.kind = KindOf(json.at("kind"));
  run.percent = json.at("percent");
  run.seed = json.at("seed").is_null() ? 0 : json.at("seed").get<std::uint64_t>();
  run.method = json.at("method");
  run.seconds = json.at("seconds");
  if (!json.at("failure").is_null()) {
    run.failure = json.at("failure");
    return run;
  }
  run.loops = {json.at("true_loops"), json.at("wrong_loops"), json.at("true_kept"), json.at("wrong_kept")};
  run.ate = json.at("ate_m").is_null() ? std::numeric_limits<double>::infinity() : json.at("ate_m").get<double>();
  const Json& steps = json.at("step_ms");
  if (!steps.is_null()) run.steps = StepTimes{steps.at("median"), steps.at("p99"), steps.at("worst")};
  return run;
}

OutlierRunKey MakeKey(const std::string& graph, int poses, int loops, const OutlierRun& run) {
  return {graph, poses, loops, run.kind ? static_cast<int>(*run.kind) : -1, run.percent, run.seed, run.method};
}

}  // namespace

OutlierRunKey KeyOf(const OutlierGraph& graph, const OutlierRun& run) {
  return MakeKey(graph.is.name, graph.poses, graph.loops, run);
}

OutlierRunLog::OutlierRunLog(const std::string& path) : path_(path) {
  std::string text = std::filesystem::exists(path) ? ReadAll(path) : "";
  text.erase(text.find_last_of('\n') + 1);  // npos + 1 is 0
  std::istringstream lines(text);
  long number = 0;
  for (std::string line; std::getline(lines, line);) {
    ++number;
    try {
      const Json json = Json::parse(line);
      const OutlierRun run = RunOf(json);
      known_[MakeKey(json.at("graph"), json.at("poses"), json.at("loops"), run)] = run;
    } catch (const std::exception&) {
      throw FileError(path, number, "expected a run of terse table outliers");
    }
  }
  AtomicFile whole(path);
  whole.Stream() << text;
  whole.Commit();
  file_.open(path, std::ios::app | std::ios::binary);
  if (!file_) throw FileError(path, 0, std::strerror(errno));
}

const OutlierRun* OutlierRunLog::Find(const OutlierRunKey& key) const {
  const auto found = known_.find(key);
  return found == known_.end() ? nullptr : &found->second;
}

void OutlierRunLog::Add(const OutlierGraph& graph, const OutlierRun& run) {
  Json json;
  json["graph"] = graph.is.name;
  json["poses"] = graph.poses;
  json["loops"] = graph.loops;
  json.update(OutlierRunJson(run));
  file_ << json.dump() + '\n' << std::flush;
  if (!file_) throw FileError(path_, 0, std::strerror(errno));
}

}  // namespace terse
