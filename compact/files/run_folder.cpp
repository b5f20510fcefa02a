#include "terse/compact/run_folder.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <limits>
#include <set>
#include <sstream>
#include <unordered_map>

#include "terse/compact/json_file.h"
#include "terse/core/error.h"
#include "terse/core/evaluate.h"
#include "terse/core/read_file.h"

namespace terse {
namespace {

using std::size_t;
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

// Throws FileError unless it is there: what lacks it is no folder of a run.
std::string Present(const std::string& path) {
  if (std::filesystem::exists(path)) return path;
  throw FileError(path, 0, "cannot read; expected a folder written by terse compact, kitti or table compact");
}

// What nlohmann finds wrong while `work` takes an object apart.
template <class Work>
void WithJsonErrors(const std::string& path, long line, const Work& work) {
  try {
    work();
  } catch (const nlohmann::json::exception& error) {
    throw FileError(path, line, std::string("not as terse writes it: ") + error.what());
  }
}

// The id that a number stands for, if it is one: not every double has a counterpart among the integers.
std::optional<std::int64_t> IdOf(double number) {
  if (!(std::abs(number) < 0x1p63) || number != std::floor(number)) return std::nullopt;
  return static_cast<std::int64_t>(number);
}

void RequireCount(const std::string& path, size_t count, size_t poses) {
  if (count == poses) return;
  throw FileError(path, 0,
                  std::to_string(count) + " rows, but graph.json beside it has " + std::to_string(poses) +
                      " poses; the files of one run belong together");
}

std::optional<double> Optional(const nlohmann::json& value) {
  return value.is_number() ? std::optional<double>(value.get<double>()) : std::nullopt;
}

std::optional<bool> Flag(const nlohmann::json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_boolean() ? std::optional<bool>(found->get<bool>()) : std::nullopt;
}

// The number behind a key, if there is one.
template <class Json>
std::optional<double> NumberAt(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_number() ? std::optional<double>(found->template get<double>())
                                                     : std::nullopt;
}

// The greatest of the lengths; the last number is an angle.
std::optional<double> RangeIn(const nlohmann::json& thresholds) {
  const auto range = thresholds.find("range");
  if (range == thresholds.end() || !range->is_array()) return std::nullopt;
  std::optional<double> out;
  for (size_t k = 0; k + 1 < range->size(); ++k) {
    if (const auto length = Optional(range->at(k))) out = std::max(out.value_or(*length), *length);
  }
  return out;
}

// Of graph.json: what FolderReader asks for, a small part of it.
const std::set<std::string>& KeysOfGraph() {
  static const std::set<std::string> keys = {"dimension", "poses", "id",          "kept",         "edges",
                                             "from",      "to",    "kind",        "factor",       "added_at",
                                             "gain_nats", "parts", "composed_of", "measurements", "forgotten"};
  return keys;
}

class FolderReader {
 public:
  FolderReader(RunFolder& run, const nlohmann::ordered_json& stats) : run_(run), stats_(stats) {}

  void ReadPoses(const nlohmann::json& graph) {
    const std::string path = run_.path + "/graph.json";
    const std::int64_t dimension = WholeNumber(graph.at("dimension"), path);
    if (dimension != 2 && dimension != 3) {
      throw FileError(path, 0, "dimension: " + std::to_string(dimension) + ", expected 2 or 3");
    }
    run_.dimension = static_cast<int>(dimension);
    forgets_ = graph.contains("forgotten");
    for (const auto& pose : graph.at("poses")) {
      const std::int64_t id = WholeNumber(pose.at("id"), path);
      if (!index_.emplace(id, static_cast<int>(run_.ids.size())).second) {
        throw FileError(path, 0, "pose " + std::to_string(id) + " is there twice");
      }
      run_.ids.push_back(id);
      run_.kept.push_back(pose.at("kept").get<bool>() ? 1 : 0);
    }
  }

  void ReadEdges(const nlohmann::json& graph) {
    const std::string path = run_.path + "/graph.json";
    for (const auto& edge : graph.at("edges")) {
      const auto index = [&](const char* key) { return IndexOf(edge.at(key), path); };
      const int from = index("from"), to = index("to");
      if (edge.at("kind") == "loop") {
        const auto innovation = innovations_.find(WholeNumber(edge.at("factor"), path));
        run_.links.push_back({from, to, StepOf(edge.at("added_at"), path), Optional(edge.at("gain_nats")),
                              innovation != innovations_.end() ? innovation->second : std::nullopt});
        ReadParts(edge, path, run_.links.back());
      } else {
        const auto composed = edge.find("composed_of");
        const int dropped = composed != edge.end() ? static_cast<int>(composed->size()) - 2 : 0;
        run_.chain.push_back({from, to, std::max(0, dropped)});
        ReadParts(edge, path, run_.chain.back());
      }
    }
  }

  // A kept pose has come in with odometry, but for the first of each robot.
  void FindStarts() {
    std::vector<char> follows(run_.ids.size(), 0);
    for (const RunChain& edge : run_.chain) follows[static_cast<std::size_t>(std::max(edge.from, edge.to))] = 1;
    for (std::size_t k = 1; k < follows.size(); ++k) {
      if (run_.kept[k] != 0 && follows[k] == 0) run_.starts.push_back(k);
    }
  }

  // By id where the stamps are ids, in whatever order; else (kitti: seconds) row by row.
  std::vector<SE3> ReadPosesFrom(const std::string& path) const {
    const Trajectory trajectory = ReadTrajectory(path);
    const size_t count = trajectory.stamps.size();
    RequireCount(path, count, run_.ids.size());
    std::vector<SE3> out(count);
    size_t ids = 0;
    for (size_t k = 0; k < count; ++k) {
      const auto id = IdOf(trajectory.stamps[k]);
      const auto found = id ? index_.find(*id) : index_.end();
      if (found == index_.end()) continue;
      out[static_cast<size_t>(found->second)] = trajectory.T_world_body[k];
      ++ids;
    }
    if (ids == count) return out;
    if (is_stereo_) return trajectory.T_world_body;
    throw FileError(path, 0, "its stamps are not the ids in graph.json; the files of one run belong together");
  }

  void ReadDecisions(const std::string& path) {
    std::istringstream lines(ReadText(Present(path)));
    long number = 0;
    std::vector<std::int64_t> poses;
    for (std::string line; std::getline(lines, line);) {
      WithJsonErrors(path, ++number, [&] {
        const auto decision = ParseJson<nlohmann::json>(line, path, number);
        poses.push_back(WholeNumber(decision.at("pose"), path, number));
        run_.decisions.push_back(MakeDecision(decision, path, number));
      });
    }
    const std::size_t before = PosesBefore(poses.size());
    RequireCount(path, before + poses.size(), run_.ids.size());
    for (std::size_t k = 0; k < poses.size(); ++k) RequirePose(path, static_cast<double>(poses[k]), before + k);
    run_.decisions.insert(run_.decisions.begin(), before, RunDecision());
  }

  // A missing pose has no covariance: those of a run by the random baseline with few poses, say.
  void ReadCovariances(const std::string& path) {
    const auto [names, rows] = ReadCsv(path);
    const size_t size = run_.dimension == 3 ? 6 : 3;
    for (size_t r = 0; r < rows.size(); ++r) {
      const std::vector<double>& row = rows[r];
      const auto id = IdOf(row[0]);
      const auto found = id ? index_.find(*id) : index_.end();
      if (row.size() != 1 + size * size || found == index_.end()) {
        throw FileError(path, static_cast<long>(r) + 2, "expected the id of a pose and its covariance");
      }
      Matrix<3, 3> body = Matrix<3, 3>::Zero();
      for (int i = 0; i < run_.dimension; ++i) {
        for (int j = 0; j < run_.dimension; ++j)
          body(i, j) = row[1 + static_cast<size_t>(i) * size + static_cast<size_t>(j)];
      }
      const Matrix<3, 3> R = run_.T_world_body[static_cast<size_t>(found->second)].Rotation().Rotation();
      run_.covariances.push_back({found->second, R * body * R.transpose()});
    }
  }

  void ReadSteps(const std::string& path) {
    const auto [names, rows] = ReadCsv(path);
    const std::size_t before = PosesBefore(rows.size());
    RequireCount(path, before + rows.size(), run_.ids.size());
    for (size_t column = 0; column < names.size(); ++column) {
      run_.steps[names[column]].assign(before, kNone);
      for (const std::vector<double>& row : rows) run_.steps[names[column]].push_back(row[column]);
    }
    const auto poses = run_.steps.find("pose");
    if (poses == run_.steps.end()) throw FileError(path, 0, "expected a column named pose");
    for (size_t k = before; k < poses->second.size(); ++k) RequirePose(path, poses->second[k], k);
  }

  // What stats.json says of the map, where it says it.
  void CheckStats(const std::string& path) const {
    const auto check = [&](const char* key, size_t count) {
      const auto found = stats_.find(key);
      if (found == stats_.end() || (found->is_number() && found->get<double>() == static_cast<double>(count))) return;
      throw FileError(path, 0,
                      std::string(key) + " is " + found->dump() + ", but graph.json beside it has " +
                          std::to_string(count) + "; the files of one run belong together");
    };
    check("poses_kept", static_cast<size_t>(std::count(run_.kept.begin(), run_.kept.end(), 1)));
    check("links_kept", run_.links.size());
  }

 private:
  // How many measurements an edge is made of.
  template <class Edge>
  static void ReadParts(const nlohmann::json& from, const std::string& path, Edge& to) {
    const auto parts = from.find("parts");
    if (parts == from.end()) return;
    to.measurements = 0;
    for (const auto& part : *parts) {
      to.measurements += static_cast<int>(WholeNumber(part.at("measurements"), path));
      to.composed = to.composed || WholeNumber(part.at("id"), path) < 0;
    }
  }

  // Behind a key, if it is there.
  void AddPoses(const nlohmann::json& from, const char* key, const std::string& path, std::vector<int>& to) const {
    const auto list = from.find(key);
    if (list == from.end()) return;
    for (const auto& id : *list) {
      if (const auto index = FindPose(id, path)) to.push_back(*index);
    }
  }

  RunDecision MakeDecision(const nlohmann::json& from, const std::string& path, long line) {
    RunDecision out;
    out.verdict = from.at("verdict").get<std::string>();
    out.registrations_tried = WholeNumber(from.at("registrations_tried"), path, line);
    out.links_accepted = WholeNumber(from.at("links_accepted"), path, line);
    out.links_refused = WholeNumber(from.at("links_refused"), path, line);
    out.pose_gain = Optional(from.at("pose_gain_nats"));
    for (const auto& candidate : from.at("candidates")) {
      const std::optional<int> pose = FindPose(candidate.at("id"), path);
      if (!pose) continue;
      RunCandidate& to = out.candidates.emplace_back();
      to.pose = *pose;
      to.accepted = candidate.at("accepted").get<bool>();
      to.probability = Optional(candidate.at("probability"));
      to.gain = Optional(candidate.at("gain_nats"));
      to.measured_gain = Optional(candidate.at("measured_gain_nats"));
      to.innovation = Optional(candidate.at("innovation"));
      to.tried = Flag(candidate, "tried");
      to.measured = Flag(candidate, "measured");
      to.anchors = Flag(candidate, "anchors").value_or(false);
      to.composed = Flag(candidate, "composed").value_or(false);
      if (!candidate.at("factor").is_null())
        innovations_[WholeNumber(candidate.at("factor"), path, line)] = to.innovation;
    }
    if (const auto at = from.find("anchored_to"); at != from.end()) out.anchored_to = FindPose(*at, path);
    if (const auto edges = from.find("edges"); edges != from.end()) {
      for (const auto& edge : *edges) {
        const std::optional<int> a = FindPose(edge.at("from"), path), b = FindPose(edge.at("to"), path);
        if (a && b) out.edges.push_back({*a, *b, Optional(edge.at("gain_nats")), edge.at("fused").get<bool>()});
      }
    }
    AddPoses(from, "revived", path, out.revived);
    AddPoses(from, "retired", path, out.retired);
    AddPoses(from, "retired_at_end", path, out.retired);
    return out;
  }

  void RequirePose(const std::string& path, double id, size_t k) const {
    if (id == static_cast<double>(run_.ids[k])) return;
    throw FileError(path, 0,
                    "row " + std::to_string(k + 1) +
                        " is of another pose than in graph.json; the files of one run "
                        "belong together");
  }

  // Of a run that continued one whose own decisions or steps were not there: the poses that these rows are not about.
  size_t PosesBefore(size_t rows) const {
    const auto continued = stats_.find("continued");
    if (rows >= run_.ids.size() || continued == stats_.end()) return 0;
    const auto poses = continued->find("poses");
    if (poses == continued->end() || !poses->is_number_unsigned()) return 0;
    return std::min(poses->get<size_t>(), run_.ids.size());
  }

  int IndexOf(const nlohmann::json& id, const std::string& path) const {
    const auto found = index_.find(WholeNumber(id, path));
    if (found != index_.end()) return found->second;
    throw FileError(path, 0, "names pose " + id.dump() + ", which is not among the poses of graph.json");
  }

  // Nothing for a pose that the run has forgotten.
  std::optional<int> FindPose(const nlohmann::json& id, const std::string& path) const {
    if (forgets_ && index_.count(WholeNumber(id, path)) == 0) return std::nullopt;
    return IndexOf(id, path);
  }

  // The step of a pose, or the next one that there is: where poses are forgotten ids ascend.
  int StepOf(const nlohmann::json& id, const std::string& path) const {
    if (const auto index = FindPose(id, path)) return *index;
    const auto next = std::lower_bound(run_.ids.begin(), run_.ids.end(), WholeNumber(id, path));
    if (next == run_.ids.end()) return IndexOf(id, path);
    return static_cast<int>(next - run_.ids.begin());
  }

  static std::pair<std::vector<std::string>, std::vector<std::vector<double>>> ReadCsv(const std::string& path) {
    std::istringstream lines(ReadText(Present(path)));
    std::vector<std::string> names;
    std::vector<std::vector<double>> rows;
    std::string line, cell;
    std::getline(lines, line);
    for (std::istringstream head(line); std::getline(head, cell, ',');) names.push_back(cell);
    while (std::getline(lines, line)) {
      std::vector<double>& row = rows.emplace_back();
      for (size_t start = 0; start <= line.size();) {
        const size_t end = std::min(line.find(',', start), line.size());
        double value = kNone;
        const char *first = line.data() + start, *last = line.data() + end;
        if (first != last && std::from_chars(first, last, value).ptr != last) {
          throw FileError(path, static_cast<long>(rows.size()) + 1,
                          "\"" + std::string(first, last) + "\" is no number");
        }
        row.push_back(value);
        start = end + 1;
      }
      if (row.size() == names.size()) continue;
      throw FileError(
          path, static_cast<long>(rows.size()) + 1,
          "expected " + std::to_string(names.size()) + " cells as in the header, found " + std::to_string(row.size()));
    }
    return {names, rows};
  }

  RunFolder& run_;
  const nlohmann::ordered_json& stats_;
  bool forgets_ = false;                              // dropped poses: others may name some that are not there
  const bool is_stereo_ = stats_.contains("frames");  // stamps are seconds then, and rows in order of arrival
  std::unordered_map<std::int64_t, int> index_;
  std::unordered_map<std::int64_t, std::optional<double>> innovations_;  // by factor
};

}  // namespace

RunFolder ReadRunFolder(const std::string& path) {
  if (!std::filesystem::is_directory(path)) {
    throw FileError(path, 0, "no such folder; expected one written by terse compact, kitti or table compact");
  }
  RunFolder run;
  run.path = path;
  run.name = std::filesystem::canonical(path).filename().string();
  const std::string graph_path = path + "/graph.json";
  const auto graph = ReadJsonObject(Present(graph_path), "a compact map", KeysOfGraph());
  const auto thresholds =
      ReadJsonObject<nlohmann::json>(Present(path + "/thresholds.json"), "thresholds", &run.thresholds_json);
  const auto stats = ReadJsonObject<nlohmann::ordered_json>(Present(path + "/stats.json"), "figures", &run.stats_json);
  run.min_loop_gain = NumberAt(thresholds, "min_loop_gain");
  run.min_pose_gain = NumberAt(thresholds, "min_pose_gain");
  run.range_m = RangeIn(thresholds);
  const auto errors = stats.find("errors");
  if (errors != stats.end()) run.ate_m = NumberAt(*errors, "ate_m");
  FolderReader reader(run, stats);
  WithJsonErrors(graph_path, 0, [&] { reader.ReadPoses(graph); });
  run.T_world_body = reader.ReadPosesFrom(path + "/trajectory.tum");
  reader.ReadDecisions(path + "/decisions.jsonl");
  WithJsonErrors(graph_path, 0, [&] { reader.ReadEdges(graph); });
  reader.FindStarts();
  reader.CheckStats(path + "/stats.json");
  reader.ReadSteps(path + "/steps.csv");
  reader.ReadCovariances(path + "/covariances.csv");
  // The file may be left from an earlier run into the same folder.
  if (errors != stats.end()) {
    std::vector<SE3> truth = reader.ReadPosesFrom(path + "/ground_truth.tum");
    const SE3 T_estimate_truth = Align(truth, run.T_world_body, run.dimension == 3 ? Alignment::kSE3 : Alignment::kSE2);
    for (SE3& T : truth) T = T_estimate_truth * T;
    run.T_world_body_true = std::move(truth);
  }
  return run;
}

}  // namespace terse
