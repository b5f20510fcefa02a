// The folder that a compact run leaves behind, read back file by file, and a run that continues from it.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <map>
#include <set>

#include "terse/compact/explored_area.h"
#include "terse/compact/run_folder.h"
#include "terse/core/error.h"
#include "terse/core/evaluate.h"
#include "terse/core/graph_file.h"
#include "terse/core/trajectory.h"
#include "testing_command.h"

namespace terse {
namespace {

using nlohmann::json;
using testing::CsvRows;
using testing::Outcome;

// A reader of what numpy.load reads: stored zip entries, .npy format 1.0, little-endian.
struct NpyArray {
  std::vector<std::size_t> shape;
  std::string type, data;
};
std::size_t Number(const std::string& bytes, std::size_t at, int count) {
  std::size_t out = 0;
  for (int k = count - 1; k >= 0; --k)
    out = out << 8 | static_cast<unsigned char>(bytes.at(at + static_cast<std::size_t>(k)));
  return out;
}
std::uint32_t Crc(const std::string& bytes) {
  std::uint32_t crc = ~0u;
  for (const char c : bytes) {
    crc ^= static_cast<unsigned char>(c);
    for (int k = 0; k < 8; ++k) crc = (crc >> 1) ^ ((crc & 1u) != 0 ? 0xEDB88320u : 0u);
  }
  return ~crc;
}
NpyArray ParseNpy(const std::string& npy) {
  EXPECT_EQ(npy.substr(0, 8), std::string("\x93NUMPY\x01\x00", 8));
  const std::size_t length = Number(npy, 8, 2);
  EXPECT_EQ((10 + length) % 64, 0u);
  const std::string header = npy.substr(10, length);
  EXPECT_EQ(header.back(), '\n');
  EXPECT_NE(header.find("'fortran_order': False"), std::string::npos);
  NpyArray out;
  const std::size_t type = header.find("'descr': '") + 10;
  out.type = header.substr(type, 3);
  std::istringstream shape(header.substr(header.find('(') + 1));
  for (std::size_t n = 0; shape >> n; shape.ignore(2)) out.shape.push_back(n);
  out.data = npy.substr(10 + length);
  return out;
}
std::map<std::string, NpyArray> ParseNpz(const std::string& zip) {
  std::map<std::string, NpyArray> out;
  const std::size_t end = zip.size() - 22;
  EXPECT_EQ(zip.substr(end, 4), "PK\x05\x06");
  std::size_t entry = Number(zip, end + 16, 4);
  EXPECT_EQ(entry + Number(zip, end + 12, 4), end);
  for (std::size_t k = 0; k < Number(zip, end + 10, 2); ++k) {
    EXPECT_EQ(zip.substr(entry, 4), "PK\x01\x02");
    const std::size_t at = Number(zip, entry + 42, 4), size = Number(zip, at + 18, 4), name = Number(zip, at + 26, 2);
    EXPECT_EQ(zip.substr(at, 4), "PK\x03\x04");
    EXPECT_EQ(zip.substr(entry + 6, 26), zip.substr(at + 4, 26)) << "directory and local header agree";
    EXPECT_EQ(Number(zip, at + 8, 2), 0u) << "stored";
    const std::string content = zip.substr(at + 30 + name, size);
    EXPECT_EQ(Crc(content), Number(zip, at + 14, 4));
    out[zip.substr(at + 30, name)] = ParseNpy(content);
    entry += 46 + name;
  }
  EXPECT_EQ(entry, end);
  return out;
}

template <class Number>
std::vector<Number> As(const NpyArray& array) {
  std::vector<Number> out(array.data.size() / sizeof(Number));
  std::memcpy(out.data(), array.data.data(), out.size() * sizeof(Number));
  return out;
}

template <class Pose>
Pose PoseOf(const json& v) {
  if constexpr (Pose::kDim == 2) {
    return SE2(v[0], v[1], v[2]);
  } else {
    return SE3(SO3(Quaternion(v[6], v[3], v[4], v[5])), Vector<3>(v[0], v[1], v[2]));
  }
}
SE3 Space(const SE2& T) { return Lift(T); }
SE3 Space(const SE3& T) { return T; }

class RunFolder : public testing::CommandTest {
 protected:
  // in.g2o, in.tum.
  void MakeScene(int dimension, int seed = 1) const {
    Succeed(std::string("generate ") + (dimension == 2 ? "manhattan --poses 200" : "ellipse-n --poses 170 --laps 2") +
            " --seed " + std::to_string(seed) + " --output in.g2o --ground-truth in.tum");
  }
  template <class Pose>
  PoseGraph<Pose> ReadAs(const std::string& name) const {
    return std::get<PoseGraph<Pose>>(ReadGraph(Path(name)).graph);
  }
  std::vector<json> Lines(const std::string& name) const {
    std::vector<json> out;
    std::istringstream text(Read(name));
    for (std::string line; std::getline(text, line);) out.push_back(json::parse(line));
    return out;
  }
  // Of in.g2o: the poses below `end`; or those from there on with the edges that they take part in.
  template <class Pose>
  void WritePart(std::int64_t end, bool first, const std::string& name) const {
    const auto graph = ReadAs<Pose>("in.g2o");
    PoseGraph<Pose> part;
    for (const auto& node : graph.Factors()) {
      const FactorPoses ends = PosesOf(node.factor);
      if ((std::max(ends.first, ends.second).value < end) != first) continue;
      for (const PoseId id : {ends.first, ends.second}) {
        if (!part.HasPose(id))
          part.AddPose(id, graph.Poses()[static_cast<std::size_t>(graph.IndexOf(id))].T_world_body);
      }
      part.AddFactor(node.factor);
    }
    WriteG2o(part, Path(name));
  }
  void ExpectDecisionsAgree(const std::string& folder) const;
  void ExpectStepsAgree(const std::string& folder, bool has_truth) const;
  void ExpectRetirementsAgree(const std::string& folder, long earlier = 0) const;
  void ExpectArraysAgree(const std::string& folder, std::size_t dof) const;
  template <class Pose>
  void ExpectPosesAgree(const json& graph, const PoseGraph<Pose>& compact, const std::string& folder) const;
  template <class Pose>
  void ExpectEdgesAgree(const json& graph, const PoseGraph<Pose>& compact, const std::string& folder) const;
  template <class Pose>
  void ExpectGraphAgrees(const std::string& folder) const;
};

void RunFolder::ExpectDecisionsAgree(const std::string& folder) const {
  const auto rows = CsvRows(Read(folder + "/decisions.csv"));
  const auto lines = Lines(folder + "/decisions.jsonl");
  ASSERT_EQ(rows.size(), lines.size());
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const auto& row = rows[k];
    const json& line = lines[k];
    EXPECT_EQ(std::to_string(line["pose"].get<long>()), row[0]);
    EXPECT_EQ(line["kept"], row[1] == "1");
    EXPECT_EQ(line["verdict"], row[2]);
    EXPECT_EQ(line["pose_gain_nats"].is_null(), row[3].empty());
    if (!row[3].empty()) {
      EXPECT_EQ(line["pose_gain_nats"], std::stod(row[3]));
    }
    EXPECT_EQ(line["registrations_tried"], std::stol(row[4]));
    EXPECT_EQ(line["links_accepted"], std::stol(row[5]));
    EXPECT_EQ(line["links_refused"], std::stol(row[12]));
    std::istringstream ids(row[6]), probabilities(row[7]), gains(row[8]), measured(row[9]), accepted(row[10]),
        innovations(row[11]), factors(row[13]);
    const auto same = [](const json& value, std::istringstream& list) {
      std::string text;
      list >> text;
      if (text == "-") {
        EXPECT_TRUE(value.is_null());
      } else if (value.is_boolean()) {
        EXPECT_EQ(value, text == "1");
      } else {
        // Probabilities may be subnormal, which std::stod takes for an error.
        EXPECT_EQ(value.get<double>(), std::strtod(text.c_str(), nullptr));
      }
    };
    for (const json& c : line["candidates"]) {
      same(c["id"], ids);
      same(c["probability"], probabilities);
      same(c["gain_nats"], gains);
      same(c["measured_gain_nats"], measured);
      same(c["accepted"], accepted);
      same(c["innovation"], innovations);
      same(c["factor"], factors);
    }
    EXPECT_TRUE((ids >> std::ws).eof()) << "no candidate is missing";
  }
}

void RunFolder::ExpectStepsAgree(const std::string& folder, bool has_truth) const {
  const auto rows = CsvRows(Read(folder + "/steps.csv"));
  const auto decisions = Lines(folder + "/decisions.jsonl");
  const auto stats = JsonFile(folder + "/stats.json");
  ASSERT_EQ(rows.size(), decisions.size());
  int poses = 0, links = 0;
  long sampled = 0, errors = 0;
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const auto& row = rows[k];
    const json& decision = decisions[k];
    ASSERT_EQ(row.size(), 10u);
    poses += decision["kept"] ? 1 : 0;
    double gain = -1;
    for (const json& c : decision["candidates"]) {
      links += c["accepted"] ? 1 : 0;
      if (c["accepted"] && !c["measured_gain_nats"].is_null()) gain = std::max<double>(gain, c["measured_gain_nats"]);
    }
    EXPECT_EQ(row[0], std::to_string(decision["pose"].get<long>()));
    EXPECT_EQ(row[1], std::to_string(poses));
    EXPECT_EQ(row[2], std::to_string(links));
    EXPECT_EQ(row[3].empty(), gain < 0);
    if (gain >= 0) {
      EXPECT_EQ(std::stod(row[3]), gain);
    }
    EXPECT_EQ(row[4].empty(), !decision["kept"]);
    EXPECT_EQ(row[5].empty(), !decision["kept"]);
    if (!row[4].empty()) {
      EXPECT_TRUE(row[4] == "0" || row[4] == "1");
    }
    EXPECT_GE(std::stod(row[6]), 0);
    EXPECT_EQ(row[7].empty(), row[8].empty());
    sampled += !row[7].empty();
    errors += !row[9].empty();
    if (row[7].empty()) continue;
    EXPECT_LE(std::stol(row[7]), std::stol(row[8])) << "the factor fills in";
  }
  EXPECT_EQ(poses, stats["poses_kept"]);
  EXPECT_EQ(links, stats["links_kept"]);
  EXPECT_FALSE(rows.back()[7].empty());
  EXPECT_LE(sampled, 600);
  EXPECT_EQ(!rows.back()[9].empty(), has_truth && rows.size() > 1);
  if (!has_truth) {
    EXPECT_EQ(errors, 0);
  }
}

void RunFolder::ExpectArraysAgree(const std::string& folder, std::size_t dof) const {
  const auto rows = CsvRows(Read(folder + "/covariances.csv"));
  const auto arrays = ParseNpz(Read(folder + "/covariances.npz"));
  ASSERT_EQ(arrays.size(), 2u);
  const NpyArray &ids = arrays.at("ids.npy"), &covariances = arrays.at("covariances.npy");
  EXPECT_EQ(ids.type, "<i8");
  EXPECT_EQ(covariances.type, "<f8");
  EXPECT_EQ(ids.shape, (std::vector<std::size_t>{rows.size()}));
  EXPECT_EQ(covariances.shape, (std::vector<std::size_t>{rows.size(), dof, dof}));
  const auto numbers = As<std::int64_t>(ids);
  const auto entries = As<double>(covariances);
  ASSERT_EQ(entries.size(), rows.size() * dof * dof);
  for (std::size_t k = 0; k < rows.size(); ++k) {
    EXPECT_EQ(std::to_string(numbers[k]), rows[k][0]);
    for (std::size_t e = 0; e < dof * dof; ++e) EXPECT_EQ(entries[k * dof * dof + e], std::stod(rows[k][1 + e]));
  }
}

template <class Pose>
void RunFolder::ExpectPosesAgree(const json& graph, const PoseGraph<Pose>& compact, const std::string& folder) const {
  const Trajectory trajectory = ReadTrajectory(Path(folder + "/trajectory.tum"));
  const auto rows = CsvRows(Read(folder + "/decisions.csv"));
  ASSERT_EQ(graph["poses"].size(), trajectory.stamps.size());
  std::map<std::int64_t, SE3> listed;
  for (std::size_t k = 0; k < trajectory.stamps.size(); ++k) {
    listed[static_cast<std::int64_t>(trajectory.stamps[k])] = trajectory.T_world_body[k];
  }
  std::set<std::int64_t> before;
  for (std::size_t k = 0; k < graph["poses"].size(); ++k) {
    const json& pose = graph["poses"][k];
    const std::int64_t id = pose["id"];
    EXPECT_EQ(std::to_string(id), rows[k][0]) << "in order of arrival";
    EXPECT_EQ(pose["kept"], compact.HasPose({id}));
    const Pose T = PoseOf<Pose>(pose["T_world_body"]);
    EXPECT_LT(listed.at(id).Local(Space(T)).norm(), 1e-12);
    if (pose["kept"]) {
      const auto& node = compact.Poses()[static_cast<std::size_t>(compact.IndexOf({id}))];
      EXPECT_LT(T.Local(*node.T_world_body).norm(), 1e-9);
    } else {
      EXPECT_TRUE(compact.HasPose({pose["base"]}));
      EXPECT_EQ(pose["covariance"].size(), static_cast<std::size_t>(Pose::kDof * (Pose::kDof + 1) / 2));
      EXPECT_EQ(pose.contains("T_base_next"), !pose["next_kept"].is_null());
    }
    if (k > 0) {
      EXPECT_EQ(before.count(pose["previous"]), 1u) << "came before";
    }
    before.insert(id);
  }
}

template <class Pose>
void RunFolder::ExpectEdgesAgree(const json& graph, const PoseGraph<Pose>& compact, const std::string& folder) const {
  std::map<std::int64_t, json> poses;
  for (const json& pose : graph["poses"]) poses[pose["id"]] = pose;
  ASSERT_EQ(graph["edges"].size(), compact.Factors().size());
  std::size_t k = 0;
  long loops = 0;
  for (const auto& node : compact.Factors()) {
    const json& edge = graph["edges"][k++];
    const auto& expected = std::get<RelativePoseFactor<Pose>>(node.factor);
    EXPECT_EQ(edge["factor"], node.id.value);
    EXPECT_EQ(edge["from"], expected.from.value);
    EXPECT_EQ(edge["to"], expected.to.value);
    EXPECT_LT(PoseOf<Pose>(edge["measurement"]).Local(expected.T_from_to).norm(), 1e-9);
    std::size_t entry = 0;
    for (int r = 0; r < Pose::kDof; ++r) {
      for (int c = r; c < Pose::kDof; ++c) {
        EXPECT_NEAR(edge["information"][entry++].template get<double>(), expected.information(r, c),
                    1e-9 * expected.information.norm());
      }
    }
    loops += edge["kind"] == "loop";
    if (!edge.contains("composed_of")) continue;
    EXPECT_EQ(edge["kind"], "odometry");
    const json& chain = edge["composed_of"];
    ASSERT_GT(chain.size(), 2u);
    for (std::size_t j = 1; j < chain.size(); ++j) {
      EXPECT_EQ(poses.at(chain[j])["previous"], chain[j - 1]);
      EXPECT_EQ(poses.at(chain[j])["kept"], j + 1 == chain.size());
    }
  }
  EXPECT_EQ(loops, JsonFile(folder + "/stats.json")["links_kept"].get<long>());
}

template <class Pose>
void RunFolder::ExpectGraphAgrees(const std::string& folder) const {
  const json graph = JsonFile(folder + "/graph.json");
  EXPECT_EQ(graph["format"], "terse-compact-graph-1");
  EXPECT_EQ(graph["dimension"], Pose::kDim);
  const auto compact = ReadAs<Pose>(folder + "/compact.g2o");
  ExpectPosesAgree<Pose>(graph, compact, folder);
  ExpectEdgesAgree<Pose>(graph, compact, folder);
}

TEST_F(RunFolder, FilesAgreeWithEachOther) {
  const auto check = [&](auto pose) {
    using Pose = decltype(pose);
    MakeScene(Pose::kDim);
    for (const std::string strategy : {"apal", "fpfl", "rfpfl"}) {
      SCOPED_TRACE(std::to_string(Pose::kDim) + "D " + strategy);
      Succeed("compact in.g2o --strategy " + strategy + " --ground-truth in.tum --quiet --output out");
      ExpectDecisionsAgree("out");
      ExpectStepsAgree("out", true);
      ExpectArraysAgree("out", Pose::kDof);
      ExpectGraphAgrees<Pose>("out");
      // What evo does with the two trajectories.
      std::istringstream text(Read("out/trajectory.tum"));
      for (std::string line; std::getline(text, line);) EXPECT_EQ(std::count(line.begin(), line.end(), ' '), 7) << line;
      const Trajectory estimate = ReadTrajectory(Path("out/trajectory.tum"));
      const Trajectory truth = ReadTrajectory(Path("out/ground_truth.tum"));
      EXPECT_EQ(truth.stamps, estimate.stamps);
      EvaluateOptions how;
      how.alignment = Pose::kDim == 2 ? Alignment::kSE2 : Alignment::kSE3;
      const Evaluation expected = Evaluate(estimate.T_world_body, truth.T_world_body, how);
      const json errors = JsonFile("out/stats.json")["errors"];
      EXPECT_NEAR(errors["ate_m"], expected.ate.translation_m, 1e-9);
      EXPECT_NEAR(errors["ate_deg"], expected.ate.rotation_deg, 1e-6);
      EXPECT_NEAR(errors["rpe_m"], expected.rpe.translation_m, 1e-9);
      EXPECT_NEAR(errors["rpe_deg"], expected.rpe.rotation_deg, 1e-6);
      const double last = std::stod(CsvRows(Read("out/steps.csv")).back()[9]);
      EXPECT_NEAR(last, expected.ate.translation_m, 0.5 * expected.ate.translation_m)
          << "before the closing iterations";
      std::filesystem::remove_all(folder_ / "out");
      Succeed("compact in.g2o --strategy " + strategy + " --quiet --output out");
      EXPECT_FALSE(Exists("out/ground_truth.tum"));
      EXPECT_FALSE(JsonFile("out/stats.json").contains("errors"));
      ExpectStepsAgree("out", false);
    }
  };
  check(SE2());
  check(SE3());
}

TEST_F(RunFolder, CompactGraphsAreGraphs) {
  MakeScene(3);
  Succeed("compact in.g2o --strategy fpfl --quiet --output out");
  const auto stats = JsonFile("out/stats.json");
  EXPECT_EQ(Json("info out/compact.g2o --json")["poses"], stats["poses_kept"]);
  Succeed("solve out/compact.g2o --stats solved.json");
  EXPECT_NEAR(JsonFile("solved.json")["chi2"].get<double>(), stats["chi2"].get<double>(),
              1e-8 * stats["chi2"].get<double>());
  Succeed("compact out/compact.g2o --strategy fpfl --quiet --output again");
  ExpectGraphAgrees<SE3>("again");
  Succeed("evaluate out/trajectory.tum in.tum");
}

TEST_F(RunFolder, PriorsFixedPosesAndOnePose) {
  Write("one.g2o", "VERTEX_SE2 4 1 2 0.5\n");
  Write("one.tum", "4 1 2 0 0 0 0 1\n");
  Succeed("compact one.g2o --strategy fpfl --ground-truth one.tum --quiet --output one");
  ExpectDecisionsAgree("one");
  ExpectStepsAgree("one", true);
  ExpectArraysAgree("one", 3);
  ExpectGraphAgrees<SE2>("one");
  Succeed("compact one.g2o --continue one --quiet --output same");
  EXPECT_EQ(Read("same/graph.json"), Read("one/graph.json"));
  Write("empty.g2o", "");
  ExpectFailure("compact empty.g2o --strategy fpfl --output empty", 1, "empty.g2o");
  EXPECT_FALSE(Exists("empty"));
  Write("held.g2o",
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 2 0 0.1\nFIX 2\nEDGE_SE2 0 1 1 0 0 9 0 0 9 0 9\n"
        "EDGE_SE2 1 2 1.1 0 0 9 0 0 9 0 9\nEDGE_PRIOR_SE2 0 0.1 0 0 4 1 0 4 0 4\nEDGE_PRIOR_SE2_XY 1 1 0.1 4 1 4\n");
  Succeed("compact held.g2o --strategy fpfl --quiet --output held");
  const json graph = JsonFile("held/graph.json");
  EXPECT_EQ(graph["fixed"], json::parse(R"([{"pose":2,"T_world_body":[2.0,0.0,0.1]}])"));
  ASSERT_EQ(graph["priors"].size(), 2u);
  EXPECT_EQ(graph["priors"][0]["kind"], "pose");
  EXPECT_EQ(graph["priors"][0]["information"], json({4.0, 1.0, 0.0, 4.0, 0.0, 4.0}));
  EXPECT_EQ(graph["priors"][1]["kind"], "position");
  EXPECT_EQ(graph["priors"][1]["measurement"], json({1.0, 0.1}));
  Succeed("compact held.g2o --continue held --quiet --output again");
  const auto a = ReadAs<SE2>("held/compact.g2o"), b = ReadAs<SE2>("again/compact.g2o");
  for (std::size_t k = 0; k < 3; ++k)
    EXPECT_LT(a.Poses()[k].T_world_body->Local(*b.Poses()[k].T_world_body).norm(), 1e-7);
  EXPECT_EQ(JsonFile("again/graph.json")["priors"], graph["priors"]);
}

// Half of a graph, continued with the whole or with the rest alone, is the whole graph's run.
TEST_F(RunFolder, ContinuesWithMore) {
  const auto check = [&](auto pose) {
    using Pose = decltype(pose);
    SCOPED_TRACE(Pose::kDim);
    MakeScene(Pose::kDim);
    const auto count = static_cast<std::int64_t>(ReadAs<Pose>("in.g2o").Poses().size());
    Succeed("compact in.g2o --strategy fpfl --ground-truth in.tum --quiet --output whole");
    WritePart<Pose>(count / 2, true, "half.g2o");
    WritePart<Pose>(count / 2, false, "rest.g2o");
    Succeed("compact half.g2o --strategy fpfl --thresholds whole/thresholds.json --quiet --output half");
    const auto whole = JsonFile("whole/stats.json");
    for (const std::string more : {"in.g2o", "rest.g2o"}) {
      SCOPED_TRACE(more);
      const auto outcome = Succeed("compact " + more + " --continue half --ground-truth in.tum --output more");
      EXPECT_NE(outcome.out.find("fpfl kept"), std::string::npos) << outcome.out;
      const auto stats = JsonFile("more/stats.json");
      for (const char* key : {"poses", "poses_kept", "links_kept", "strategy", "thresholds"}) {
        EXPECT_EQ(stats[key], whole[key]) << key;
      }
      EXPECT_NEAR(stats["chi2"].get<double>(), whole["chi2"].get<double>(), 1e-6 * whole["chi2"].get<double>());
      EXPECT_NEAR(stats["errors"]["ate_m"].get<double>(), whole["errors"]["ate_m"].get<double>(), 1e-4);
      EXPECT_EQ(stats["continued"]["poses"], count / 2);
      EXPECT_EQ(stats["steps"], count - count / 2);
      const auto ids = [&](const std::string& folder) {
        std::vector<std::int64_t> out;
        const auto graph = ReadAs<Pose>(folder + "/compact.g2o");
        for (const auto& node : graph.Poses()) out.push_back(node.id.value);
        return out;
      };
      EXPECT_EQ(ids("more"), ids("whole"));
      // The rows of the first half come first.
      EXPECT_EQ(Read("more/decisions.jsonl").rfind(Read("half/decisions.jsonl"), 0), 0u);
      ExpectDecisionsAgree("more");
      ExpectStepsAgree("more", true);
      ExpectGraphAgrees<Pose>("more");
      std::filesystem::remove_all(folder_ / "more");
    }
    // In place, and where only the two files that it needs are left.
    for (const char* name : {"decisions.csv", "decisions.jsonl", "steps.csv", "compact.g2o"}) {
      std::filesystem::remove(folder_ / "half" / name);
    }
    Succeed("compact rest.g2o --continue half --output half --quiet");
    EXPECT_EQ(JsonFile("half/stats.json")["poses_kept"], whole["poses_kept"]);
    EXPECT_EQ(Lines("half/decisions.jsonl").size(), static_cast<std::size_t>(count - count / 2));
  };
  check(SE2());
  check(SE3());
}

// A map whose odometry alone leads far away starts where it was.
TEST_F(RunFolder, GoesOnFromTheEstimates) {
  Succeed("generate sphere --poses 600 --seed 2 --output in.g2o");
  Succeed("compact in.g2o --strategy fpfl --quiet --output old");
  Succeed("compact in.g2o --continue old --quiet --output new");
  const auto before = JsonFile("old/stats.json"), after = JsonFile("new/stats.json");
  EXPECT_NEAR(after["chi2"].get<double>(), before["chi2"].get<double>(), 1e-9 * before["chi2"].get<double>());
  EXPECT_LE(after["iterations"], 2);
}

TEST_F(RunFolder, BadGraphsAreNamedAndLeaveNothing) {
  MakeScene(2);
  Succeed("compact in.g2o --strategy fpfl --quiet --output old");
  const std::string text = Read("old/graph.json");
  const json good = json::parse(text);
  const auto expect = [&](const std::string& content, const std::string& cause) {
    Write("old/graph.json", content);
    const Outcome outcome = Run("compact in.g2o --continue old --output new");
    EXPECT_EQ(outcome.exit_code, 1) << cause;
    EXPECT_EQ(outcome.err.rfind("terse: error: old/graph.json:", 0), 0u) << outcome.err;
    EXPECT_NE(outcome.err.find(cause), std::string::npos) << cause << '\n' << outcome.err;
    EXPECT_FALSE(Exists("new")) << cause;
  };
  const auto spoiled = [&](const std::string& pointer, const json& value) {
    json changed = good;
    changed[json::json_pointer(pointer)] = value;
    return changed.dump();
  };
  for (const double share : {0.0, 0.01, 0.5, 0.999}) {
    expect(text.substr(0, static_cast<std::size_t>(share * static_cast<double>(text.size()))), "ends too early");
  }
  expect("{]", "graph.json:1: not valid JSON");
  expect("[1]", "expected a compact map as a JSON object");
  expect("{\"format\":\"other\"}", "format: \"other\", expected \"terse-compact-graph-1\"");
  expect("{}", "format: missing");
  expect(spoiled("/dimension", 4), "dimension: 4, expected 2 or 3");
  expect(spoiled("/dimension", 3), "poses[0].T_world_body: ");
  expect(spoiled("/strategy", "most"), "strategy: \"most\", expected \"apal\" or");
  expect(spoiled("/poses", 1), "poses: 1, expected a list");
  expect(spoiled("/poses/3/id", "x"), "poses[3].id: \"x\", expected a whole number");
  expect(spoiled("/poses/3/id", 0), "poses[3].id: pose 0 is there twice");
  expect(spoiled("/poses/3/T_world_body/1", nullptr), "poses[3].T_world_body[1]: null, expected a number");
  expect(spoiled("/poses/3/T_world_body", {1, 2}), "poses[3].T_world_body: [1,2], expected a list of 3 numbers");
  expect(spoiled("/poses/3/previous", 99999), "poses[3].previous: pose 99999 is none of the poses before");
  expect(spoiled("/edges/0/to", 99999), "edges[0].to: pose 99999 is none of the poses");
  expect(spoiled("/edges/0/kind", "chain"), "edges[0].kind: \"chain\", expected \"odometry\" or \"loop\"");
  expect(spoiled("/edges/1/factor", good["edges"][0]["factor"]), "edges[1].factor: ");
  expect(spoiled("/edges/1/information/0", -1), "edges[1].measurement: ");
  json missing = good;
  missing["edges"][2].erase("measurement");
  expect(missing.dump(), "edges[2].measurement: missing, expected [x, y, theta]");
  std::string large = text;
  large.replace(large.find("\"T_world_body\":[") + 16, 1, "1e999,");
  expect(large, "too large");
  Write("old/graph.json", text);
  std::filesystem::rename(folder_ / "old/thresholds.json", folder_ / "elsewhere.json");
  ExpectFailure("compact in.g2o --continue old --output new --quiet", 1,
                "old/thresholds.json: the file does not exist");
  Succeed("compact in.g2o --continue old --thresholds elsewhere.json --output new --quiet");
  ExpectFailure("compact in.g2o --continue nowhere --output other", 1, "nowhere/graph.json: the file does not exist");
  ExpectFailure("compact in.g2o --continue old --strategy rfpfl --output other", 2, "--continue");
  Succeed("generate ellipse --output space.g2o");
  ExpectFailure("compact space.g2o --continue new --output other", 1, "3D, but the map to continue");
  Write("apart.g2o", "EDGE_SE2 5000 5001 1 0 0 1 0 0 1 0 1\n");
  ExpectFailure("compact apart.g2o --continue new --output other", 1, "apart.g2o");
  Write("short.tum", "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n");
  ExpectFailure("compact in.g2o --strategy fpfl --ground-truth short.tum --output other", 1, "short.tum: no pose 2");
  EXPECT_EQ(CsvRows(Read("new/steps.csv")).size(), good["poses"].size());
}

// The figures of stats.json, counted in graph.json, and in the words of the summary; and what a reader makes of them.
TEST_F(RunFolder, OfABoundedMap) {
  Succeed("generate ellipse-n --laps 4 --output in.g2o");
  const std::string summary =
      Succeed("compact in.g2o --strategy bounded --retire-share 0 --robust none --output out").out;
  const json graph = JsonFile("out/graph.json"), stats = JsonFile("out/stats.json");
  long anchored = 0, edges = 0, measurements = 0, fused = 0;
  for (const json& pose : graph["poses"]) anchored += pose.contains("anchored_to");
  std::map<std::pair<long, long>, int> sizes;
  for (const json& edge : graph["edges"]) {
    long composed = 0, all = 0;
    for (const json& part : edge.value("parts", json::array())) {
      all += part["measurements"].get<long>();
      if (part["id"].get<long>() < 0) composed += part["measurements"].get<long>();
    }
    edges += composed > 0, measurements += composed, fused += all > 1;
    if (all > 0) sizes[{edge["from"], edge["to"]}] = static_cast<int>(all);
  }
  EXPECT_GT(anchored, 200);
  EXPECT_GT(measurements, edges);
  EXPECT_GT(fused, 5);
  EXPECT_EQ(stats["poses_anchored"], anchored);
  EXPECT_EQ(stats["edges_composed"], edges);
  EXPECT_EQ(stats["measurements_composed"], measurements);
  EXPECT_EQ(stats["edges_fused"], fused);
  EXPECT_NE(summary.find(std::to_string(anchored) + " poses were found again at kept poses (anchored); " +
                         std::to_string(edges) + " edges hold " + std::to_string(measurements) +
                         " measurements composed of links, " + std::to_string(fused) + " edges are fused of several"),
            std::string::npos)
      << summary;
  const terse::RunFolder run = ReadRunFolder((folder_ / "out").string());
  std::size_t found = 0;
  const auto check = [&](const auto& edge) {
    const auto size =
        sizes.find({run.ids[static_cast<std::size_t>(edge.from)], run.ids[static_cast<std::size_t>(edge.to)]});
    EXPECT_EQ(edge.measurements, size != sizes.end() ? size->second : 1);
    found += size != sizes.end();
  };
  for (const RunLink& link : run.links) check(link);
  for (const RunChain& edge : run.chain) check(edge);
  EXPECT_EQ(found, sizes.size());
  long anchors = 0, made = 0;
  for (std::size_t k = 0; k < run.decisions.size(); ++k) {
    const RunDecision& decision = run.decisions[k];
    EXPECT_EQ(decision.anchored_to.has_value(), decision.verdict == "anchored");
    EXPECT_TRUE(!decision.anchored_to || run.kept[static_cast<std::size_t>(*decision.anchored_to)]) << k;
    for (const RunCandidate& c : decision.candidates) anchors += c.anchors;
    made += static_cast<long>(decision.edges.size());
  }
  EXPECT_EQ(anchors, anchored);
  EXPECT_EQ(made, measurements) << "nothing was taken out again";
  EXPECT_EQ(run.range_m, stats["thresholds"]["range"][0].get<double>());
  EXPECT_EQ(stats["poses_retired"], 0);
  EXPECT_EQ(Read("out/decisions.jsonl").find("retired"), std::string::npos);
}

// What is in the map after every step, told by the decisions, is what steps.csv counts; at the end it is graph.json.
// `earlier`: how many retired in the run that this one continues.
void RunFolder::ExpectRetirementsAgree(const std::string& folder, long earlier) const {
  const terse::RunFolder run = ReadRunFolder(Path(folder));
  const auto lines = Lines(folder + "/decisions.jsonl");
  const json stats = JsonFile(folder + "/stats.json"), graph = JsonFile(folder + "/graph.json");
  ASSERT_EQ(lines.size(), run.decisions.size());
  std::set<int> there;
  std::set<std::int64_t> gone;
  long retired = 0;
  for (std::size_t k = 0; k < lines.size(); ++k) {
    const RunDecision& decision = run.decisions[k];
    if (lines[k]["kept"]) there.insert(static_cast<int>(k));
    for (const int pose : decision.revived) EXPECT_TRUE(there.insert(pose).second) << pose << " was not in the map";
    EXPECT_TRUE(!decision.anchored_to || there.count(*decision.anchored_to) == 1) << "at that step it was in the map";
    const json in_step = lines[k].value("retired", json::array());
    const json at_end = lines[k].value("retired_at_end", json::array());
    ASSERT_EQ(decision.retired.size(), in_step.size() + at_end.size());
    for (std::size_t r = 0; r < decision.retired.size(); ++r) {
      if (r == in_step.size()) {
        EXPECT_EQ(run.steps.at("poses")[k], there.size()) << "the end comes after the step";
      }
      const int pose = decision.retired[r];
      const std::int64_t id = run.ids[static_cast<std::size_t>(pose)];
      EXPECT_EQ(id, r < in_step.size() ? in_step[r] : at_end[r - in_step.size()]);
      EXPECT_EQ(there.erase(pose), 1u) << pose << " was in the map";
      gone.insert(id);
      ++retired;
    }
    if (at_end.empty()) {
      EXPECT_EQ(run.steps.at("poses")[k], there.size()) << k;
    }
  }
  for (std::size_t k = 0; k < run.kept.size(); ++k) EXPECT_EQ(run.kept[k], there.count(static_cast<int>(k))) << k;
  EXPECT_EQ(stats["poses_kept"], there.size());
  EXPECT_EQ(stats["poses_retired"], retired - earlier);
  // What retired poses leave says which.
  long left = 0;
  for (const json& edge : graph["edges"]) {
    for (const json& part : edge.value("parts", json::array())) {
      left += part["id"].get<long>() < 0 && gone.count(part["added_at"]) == 1;
    }
  }
  EXPECT_EQ(left > 0, !gone.empty());
}

TEST_F(RunFolder, OfAMapThatPosesRetireFrom) {
  for (const std::string scene : {"ellipse-n --laps 2", "manhattan --poses 600"}) {
    SCOPED_TRACE(scene);
    Succeed("generate " + scene + " --output in.g2o");
    const std::string summary = Succeed("compact in.g2o --strategy bounded --output out").out;
    const json stats = JsonFile("out/stats.json");
    EXPECT_GT(stats["poses_retired"], 0);
    EXPECT_NE(summary.find(stats["poses_retired"].dump() + " poses retired"), std::string::npos) << summary;
    ExpectRetirementsAgree("out");
    Succeed("compact in.g2o --strategy bounded --retire-share 0 --output none --quiet");
    ExpectRetirementsAgree("none");
    EXPECT_LT(stats["poses_kept"], JsonFile("none/stats.json")["poses_kept"]);
    // Afterwards more of them; the record of the run stays as it was up to its end.
    Succeed("compact in.g2o --strategy bounded --retire 3 --output more --quiet");
    ExpectRetirementsAgree("more");
    EXPECT_GT(JsonFile("more/stats.json")["poses_retired"], stats["poses_retired"]);
    EXPECT_GE(JsonFile("more/stats.json")["retired_loss_nats"], stats["retired_loss_nats"]);
    auto before = Lines("out/decisions.jsonl"), after = Lines("more/decisions.jsonl");
    EXPECT_GT(after.back()["retired_at_end"].size(), before.back()["retired_at_end"].size());
    for (auto* lines : {&before, &after}) lines->back().erase("retired_at_end");
    EXPECT_EQ(before, after);
    // Of a run without poses of its own the earlier one's last line tells, besides what that one retired.
    Succeed("compact in.g2o --continue out --retire 3 --output later --quiet");
    const auto later = Lines("later/decisions.jsonl");
    ASSERT_EQ(later.size(), before.size());
    ExpectRetirementsAgree("later", stats["poses_retired"].get<long>());
    EXPECT_GT(later.back()["retired_at_end"].size(), Lines("out/decisions.jsonl").back()["retired_at_end"].size());
  }
  const std::size_t in_steps = Read("out/decisions.jsonl").find("\"retired\":[");
  EXPECT_NE(in_steps, std::string::npos) << "not only at the end";
}

// A run continued has the retirements of both, and counts its own.
TEST_F(RunFolder, OfAContinuedRunThatPosesRetireFrom) {
  Succeed("generate manhattan --poses 600 --output in.g2o");
  WritePart<SE2>(400, true, "first.g2o");
  Succeed("compact first.g2o --strategy bounded --output first --quiet");
  EXPECT_NE(Read("first/decisions.jsonl").find("retired_at_end"), std::string::npos);
  Succeed("compact in.g2o --continue first --output both --quiet");
  const auto first = Lines("first/decisions.jsonl"), both = Lines("both/decisions.jsonl");
  ASSERT_GT(both.size(), first.size());
  EXPECT_TRUE(std::equal(first.begin(), first.end(), both.begin()));
  const terse::RunFolder run = ReadRunFolder(Path("both"));
  std::size_t retired = 0, own = 0;
  for (std::size_t k = 0; k < both.size(); ++k) {
    retired += run.decisions[k].retired.size();
    if (k >= first.size()) own += run.decisions[k].retired.size();
  }
  EXPECT_GT(own, 0u);
  EXPECT_GT(retired, own);
  EXPECT_EQ(JsonFile("both/stats.json")["poses_retired"], own);
  std::string text = Read("both/decisions.jsonl");
  text.insert(text.find("\"retired\":[") + 11, "123456,");
  Write("both/decisions.jsonl", text);
  try {
    ReadRunFolder(Path("both"));
    ADD_FAILURE() << "no such pose";
  } catch (const FileError& error) {
    EXPECT_NE(std::string(error.what()).find("decisions.jsonl: names pose 123456"), std::string::npos) << error.what();
  }
}

SE3 At(double x, double y, double z) { return SE3(SO3(), Vector<3>(x, y, z)); }

TEST(ExploredArea, CountsTheCellsEntered) {
  // The box is 8 x 4 x 0 m, its middle (4, 2): cells of 2 m are centred at even coordinates there.
  const std::vector<SE3> path{At(0, 0, 0), At(0.9, 0.9, 0), At(2, 0, 0), At(8, 4, 0), At(8, 3.2, 0), At(0.1, 0, 0)};
  EXPECT_EQ(ExploredArea(path, 2), (std::vector<double>{4, 4, 8, 12, 12, 12}));
  EXPECT_EQ(ExploredArea(path, 100), std::vector<double>(path.size(), 10000.0));
  // Hills below half a cell do not count, levels of a building do.
  EXPECT_EQ(ExploredArea({At(0, 0, 0.9), At(0, 0, -0.9)}, 2), (std::vector<double>{4, 4}));
  EXPECT_EQ(ExploredArea({At(0, 0, 0), At(0, 0, 6)}, 2), (std::vector<double>{4, 8}));
  EXPECT_TRUE(ExploredArea({}, 2).empty());
  for (const double cell : {0.0, -1.0, static_cast<double>(NAN), static_cast<double>(INFINITY)}) {
    EXPECT_TRUE(ExploredArea(path, cell).empty());
  }
  EXPECT_TRUE(ExploredArea({At(NAN, 0, 0)}, 2).empty());
}

// Every key and column is in the documentation.
TEST_F(RunFolder, IsDocumented) {
  MakeScene(3);
  Succeed("compact in.g2o --strategy fpfl --ground-truth in.tum --quiet --output out");
  Succeed("compact in.g2o --continue out --ground-truth in.tum --quiet --output out");
  const std::string docs = testing::Slurp(TERSE_SOURCE_DIR "/docs/outputs.md");
  std::set<std::string> names;
  const auto keys = [&](const json& object) {
    for (const auto& item : object.items()) names.insert(item.key());
  };
  const json graph = JsonFile("out/graph.json"), stats = JsonFile("out/stats.json");
  keys(graph);
  keys(stats);
  keys(stats["errors"]);
  keys(stats["continued"]);
  for (const char* list : {"poses", "edges", "priors", "fixed", "refused"}) {
    for (const json& item : graph[list]) keys(item);
  }
  Succeed("generate ellipse-n --laps 2 --output bounded.g2o");
  Succeed("compact bounded.g2o --strategy bounded --quiet --output bounded");
  keys(JsonFile("bounded/stats.json"));
  const json bounded = JsonFile("bounded/graph.json");
  for (const json& pose : bounded["poses"]) keys(pose);
  for (const json& edge : bounded["edges"]) {
    keys(edge);
    const json parts = edge.value("parts", json::array());
    for (const json& part : parts) keys(part);
  }
  MakeScene(2);
  Succeed("compact in.g2o --strategy bounded --quiet --output retiring");
  for (const std::string folder : {"out", "bounded", "retiring"}) {
    for (const json& line : Lines(folder + "/decisions.jsonl")) {
      keys(line);
      for (const json& candidate : line["candidates"]) keys(candidate);
      for (const json& edge : line.value("edges", json::array())) keys(edge);
    }
  }
  EXPECT_EQ(names.count("parts") + names.count("anchored_to") + names.count("anchors"), 3u);
  EXPECT_EQ(names.count("retired") + names.count("retired_at_end"), 2u);
  for (const auto& entry : std::filesystem::directory_iterator(folder_ / "out")) names.insert(entry.path().filename());
  std::istringstream header(Read("out/steps.csv").substr(0, Read("out/steps.csv").find('\n')));
  for (std::string column; std::getline(header, column, ',');) names.insert(column);
  EXPECT_GT(names.size(), 60u);
  for (const std::string& name : names) EXPECT_NE(docs.find(name), std::string::npos) << name;
}

// The table's runs, in folders of their own.
TEST_F(RunFolder, OfATable) {
  const auto table = Json("table compact . --graphs ellipse --random-runs 2 --apfl --json --quiet --output figures");
  for (const std::string strategy : {"apal", "apfl", "fpfl", "rfpfl"}) {
    const std::string folder = "figures/ellipse/" + strategy;
    SCOPED_TRACE(folder);
    ASSERT_TRUE(Exists(folder + "/stats.json"));
    ExpectDecisionsAgree(folder);
    ExpectStepsAgree(folder, true);
    ExpectArraysAgree(folder, 6);
    ExpectGraphAgrees<SE3>(folder);
    const auto stats = JsonFile(folder + "/stats.json");
    const auto& row = table["graphs"][0][strategy];
    EXPECT_EQ(stats["strategy"], strategy);
    EXPECT_EQ(stats["poses_kept"], row["poses_kept"]);
    if (strategy == "rfpfl") continue;  // the mean of two
    EXPECT_NEAR(stats["errors"]["ate_m"].get<double>(), row["errors"]["ate"]["translation_m"].get<double>(), 1e-9);
  }
}

}  // namespace
}  // namespace terse
