// `terse compact` as its users and the tools that call it see it.

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>
#include <sstream>

#include "terse/compact/graph_replay.h"
#include "terse/core/chi_square.h"
#include "terse/core/graph_file.h"
#include "terse/core/robust.h"
#include "terse/core/trajectory.h"
#include "terse/covariance/marginals.h"
#include "testing_command.h"

namespace terse {
namespace {

using testing::CsvRows;
using testing::Outcome;

class CompactCommand : public testing::CommandTest {
 protected:
  void MakeScene(const std::string& scene) const {
    Succeed("generate " + scene + (scene == "ellipse-n" ? " --poses 255 --laps 3" : " --poses 300") +
            " --output in.g2o");
  }
  std::vector<nlohmann::json> JsonLines(const std::string& name) const {
    std::vector<nlohmann::json> out;
    std::istringstream text(Read(name));
    for (std::string line; std::getline(text, line);) out.push_back(nlohmann::json::parse(line));
    return out;
  }
  template <class Pose>
  PoseGraph<Pose> ReadAs(const std::string& name, RotationInformation reading = {}) const {
    ReadOptions options;
    options.rotation_information = reading;
    return std::get<PoseGraph<Pose>>(ReadGraph(Path(name), options).graph);
  }
};

const std::vector<std::string> kResults = {"compact.g2o",     "covariances.csv", "covariances.npz", "decisions.csv",
                                           "decisions.jsonl", "graph.json",      "report.html",     "stats.json",
                                           "steps.csv",       "thresholds.json", "trajectory.tum"};

template <class Pose>
bool HasFactor(const PoseGraph<Pose>& graph, const Factor<Pose>& factor) {
  const auto& a = std::get<RelativePoseFactor<Pose>>(factor);
  for (const auto& node : graph.Factors()) {
    const auto& b = std::get<RelativePoseFactor<Pose>>(node.factor);
    // Written and read again: the last bits of what was concatenated or converted.
    if (a.from == b.from && a.to == b.to && a.T_from_to.Local(b.T_from_to).norm() < 1e-9 &&
        (a.information - b.information).norm() < 1e-9 * b.information.norm()) {
      return true;
    }
  }
  return false;
}

template <class Pose>
void ExpectStatsAgree(const nlohmann::json& stats, const PoseGraph<Pose>& compact, const PoseGraph<Pose>& input) {
  EXPECT_EQ(stats["poses"], input.Poses().size());
  EXPECT_EQ(stats["edges"], input.Factors().size());
  EXPECT_EQ(stats["poses_kept"], compact.Poses().size());
  EXPECT_EQ(stats["steps"], input.Poses().size());
  const double chi2 = stats["chi2"];
  EXPECT_NEAR(Chi2(compact), chi2, 1e-8 * chi2 + 1e-12);
  EXPECT_EQ(compact.Factors().size(), compact.Poses().size() - 1 + stats.at("links_kept").template get<std::size_t>())
      << "a link to the pose before, and the loops";
}

template <class Pose>
void ExpectTrajectoryAgrees(const Trajectory& trajectory, const PoseGraph<Pose>& compact,
                            const PoseGraph<Pose>& input) {
  ASSERT_EQ(trajectory.stamps.size(), input.Poses().size());
  std::map<double, SE3> T_world_body;
  for (std::size_t k = 0; k < trajectory.stamps.size(); ++k) {
    T_world_body[trajectory.stamps[k]] = trajectory.T_world_body[k];
  }
  for (const auto& node : input.Poses()) EXPECT_EQ(T_world_body.count(static_cast<double>(node.id.value)), 1u);
  for (const auto& node : compact.Poses()) {
    EXPECT_TRUE(input.HasPose(node.id));
    SE3 lifted;
    if constexpr (Pose::kDim == 2) {
      lifted = Lift(*node.T_world_body);
    } else {
      lifted = *node.T_world_body;
    }
    EXPECT_LT(lifted.Local(T_world_body.at(static_cast<double>(node.id.value))).norm(), 1e-9) << node.id.value;
  }
}

template <class Pose>
void ExpectDecisionsAgree(const std::vector<std::vector<std::string>>& decisions, const nlohmann::json& stats,
                          const PoseGraph<Pose>& compact, const PoseGraph<Pose>& input) {
  ASSERT_EQ(decisions.size(), input.Poses().size());
  long kept = 0, links = 0, tried = 0, refused = 0;
  for (const auto& row : decisions) {
    ASSERT_EQ(row.size(), 14u);
    EXPECT_EQ(compact.HasPose({std::stoll(row[0])}), row[1] == "1") << row[0];
    kept += std::stol(row[1]);
    tried += std::stol(row[4]);
    links += std::stol(row[5]);
    refused += std::stol(row[12]);
    EXPECT_EQ(std::count(row[10].begin(), row[10].end(), '1'), std::stol(row[5])) << row[0];
    // Accepted links name their factor, which RemoveLink takes.
    std::istringstream accepted(row[10]), factors(row[13]);
    std::string flag, factor;
    while (accepted >> flag && factors >> factor) EXPECT_EQ(flag == "1", factor != "-") << row[0];
  }
  EXPECT_EQ(stats["poses_kept"], kept);
  EXPECT_EQ(stats["links_kept"], links);
  EXPECT_EQ(stats["registrations_tried"], tried);
  EXPECT_EQ(stats["links_refused"], refused);
}

template <class Pose>
void ExpectCovariancesAgree(const std::vector<std::vector<std::string>>& rows, const PoseGraph<Pose>& compact) {
  std::vector<Pose> values;
  for (const auto& node : compact.Poses()) values.push_back(*node.T_world_body);
  const Marginals<Pose> marginals(compact, values);
  ASSERT_EQ(rows.size(), values.size());
  for (const auto& row : rows) {
    ASSERT_EQ(row.size(), 1u + Pose::kDof * Pose::kDof);
    const auto expected = marginals.Marginal({std::stoll(row[0])});
    typename Pose::Jacobian actual;
    for (int i = 0; i < Pose::kDof * Pose::kDof; ++i) {
      actual(i / Pose::kDof, i % Pose::kDof) = std::stod(row[1 + static_cast<std::size_t>(i)]);
    }
    EXPECT_LT((actual - expected).norm(), 1e-6 * expected.norm()) << row[0];
  }
}

// What all strategies owe: files that agree with each other and with the input.
template <class Pose>
void ExpectConsistent(const std::filesystem::path& folder, const PoseGraph<Pose>& input) {
  const auto read = [&](const char* name) { return testing::Slurp(folder / name); };
  const auto compact = std::get<PoseGraph<Pose>>(ReadGraph((folder / "compact.g2o").string()).graph);
  const auto stats = nlohmann::json::parse(read("stats.json"));
  ExpectStatsAgree(stats, compact, input);
  ExpectTrajectoryAgrees(ReadTrajectory((folder / "trajectory.tum").string()), compact, input);
  ExpectDecisionsAgree(CsvRows(read("decisions.csv")), stats, compact, input);
  ExpectCovariancesAgree(CsvRows(read("covariances.csv")), compact);
}

TEST_F(CompactCommand, FilesAgreeWithEachOther) {
  const auto check = [&](auto pose, const std::string& scene) {
    using Pose = decltype(pose);
    MakeScene(scene);
    const auto input = ReadAs<Pose>("in.g2o");
    for (const std::string strategy : {"apal", "apfl", "fpfl"}) {
      SCOPED_TRACE(scene + ' ' + strategy);
      const Outcome outcome = Succeed("compact in.g2o --strategy " + strategy + " --output " + strategy);
      EXPECT_EQ(outcome.err, "") << "no progress where standard error is no terminal";
      EXPECT_NE(outcome.out.find("results in " + strategy), std::string::npos) << outcome.out;
      std::vector<std::string> names;
      for (const auto& entry : std::filesystem::directory_iterator(folder_ / strategy)) {
        names.push_back(entry.path().filename().string());
      }
      std::sort(names.begin(), names.end());
      EXPECT_EQ(names, kResults);
      ExpectConsistent<Pose>(folder_ / strategy, input);
      const auto stats = JsonFile(strategy + "/stats.json");
      const GraphReplay<Pose> replay(input);
      EXPECT_EQ(stats["links_offered"], replay.LinksOffered());
      // What is kept as it was given: all links, and odometry between poses that are both kept.
      const auto compact = ReadAs<Pose>(strategy + "/compact.g2o");
      long same = 0;
      for (const auto& node : compact.Factors()) same += HasFactor(input, node.factor);
      EXPECT_GE(same, stats.at("links_kept").template get<long>());
      if (strategy != "fpfl") {
        EXPECT_EQ(same, static_cast<long>(compact.Factors().size()));
        EXPECT_EQ(stats["poses_kept"], stats["poses"]);
      }
      if (strategy == "apal") {
        EXPECT_EQ(stats["links_kept"], stats["links_offered"]);
      }
    }
    const auto kept = [&](const char* what, const std::string& s) {
      return JsonFile(s + "/stats.json")[what].template get<long>();
    };
    EXPECT_LT(kept("poses_kept", "fpfl"), kept("poses_kept", "apal")) << scene;
    EXPECT_LE(kept("links_kept", "apfl"), kept("links_kept", "apal")) << scene;
    std::filesystem::remove_all(folder_ / "fpfl");
  };
  check(SE2(), "manhattan");
  check(SE3(), "ellipse-n");
}

TEST_F(CompactCommand, AllPosesAllLinksIsThePlainProblem) {
  MakeScene("manhattan");
  Succeed("compact in.g2o --strategy apal --output all");
  Succeed("solve in.g2o --stats solved.json");
  const double chi2 = JsonFile("solved.json")["chi2"];
  EXPECT_NEAR(JsonFile("all/stats.json")["chi2"].get<double>(), chi2, 1e-8 * chi2);
  Succeed("solve all/compact.g2o --stats again.json");
  EXPECT_NEAR(JsonFile("again.json")["chi2"].get<double>(), chi2, 1e-8 * chi2) << "what is written can be solved again";
}

TEST_F(CompactCommand, StatisticsHaveTheAgreedKeys) {
  MakeScene("manhattan");
  Succeed("solve in.g2o --stats solved.json");
  Succeed("compact in.g2o --strategy fpfl --output few");
  const auto stats = JsonFile("few/stats.json");
  const auto solved = JsonFile("solved.json");
  for (const auto& item : solved.items()) {
    // A run sets off from what it knows after its last pose: there is no start to choose.
    EXPECT_EQ(stats.contains(item.key()), item.key() != "initial") << item.key();
  }
  for (const char* key : {"poses_kept", "links_kept", "links_offered", "registrations_tried", "links_refused"}) {
    EXPECT_TRUE(stats[key].is_number_integer()) << key;
  }
  EXPECT_EQ(stats["strategy"], "fpfl");
}

TEST_F(CompactCommand, ThresholdsAreObeyed) {
  MakeScene("manhattan");
  const std::string run = "compact in.g2o --strategy fpfl --output few ";
  Succeed(run + "--range 3 4 1.5 --min-pose-gain 2 --min-loop-gain 1.25 --probability 0.2");
  const auto given = JsonFile("few/stats.json");
  EXPECT_EQ(given["thresholds"], nlohmann::json({{"dimension", 2},
                                                 {"range", {3.0, 4.0, 1.5}},
                                                 {"probability", 0.2},
                                                 {"min_loop_gain", 1.25},
                                                 {"min_pose_gain", 2.0}}));
  EXPECT_FALSE(given.contains("sample")) << "nothing was left to choose";
  for (const auto& row : CsvRows(Read("few/decisions.csv"))) {
    if (row[2] == "redundant") {
      EXPECT_LE(std::stod(row[3]), 2.0) << row[0];
    }
    if (row[2] == "informative") {
      EXPECT_GT(std::stod(row[3]), 2.0) << row[0];
    }
    std::istringstream measured(row[9]), accepted(row[10]), innovations(row[11]);
    std::string gain, flag, innovation;
    while (measured >> gain && accepted >> flag && innovations >> innovation) {
      const bool outlier = innovation != "-" && std::stod(innovation) > ChiSquareQuantile(0.9999, 3);
      EXPECT_EQ(flag == "1", gain != "-" && std::stod(gain) > 1.25 && !outlier) << row[0];
    }
  }
  // A loop that came with the pose is there, however unlikely the map takes it to be; only the search asks for the
  // range.
  long searched = 0, unlikely = 0;
  for (const auto& decision : JsonLines("few/decisions.jsonl")) {
    for (const auto& candidate : decision["candidates"]) {
      const bool is_likely = candidate["probability"] > 0.2;
      searched += !candidate["measured"];
      unlikely += !is_likely;
      EXPECT_TRUE(is_likely || candidate["measured"]) << decision["pose"];
    }
  }
  EXPECT_GT(searched, 0);
  EXPECT_GT(unlikely, 0);
  // One is given, the others come from the sample and do not depend on it.
  Succeed(run + "--min-loop-gain 0");
  const auto links = JsonFile("few/stats.json");
  Succeed(run);
  const auto chosen = JsonFile("few/stats.json");
  EXPECT_EQ(links["thresholds"]["min_loop_gain"], 0);
  EXPECT_EQ(links["thresholds"]["min_pose_gain"], chosen["thresholds"]["min_pose_gain"]);
  EXPECT_EQ(links["thresholds"]["range"], chosen["thresholds"]["range"]);
  Succeed(run + "--min-pose-gain 1e9 --min-loop-gain 1e9");
  const auto fewest = JsonFile("few/stats.json");
  EXPECT_EQ(fewest["links_kept"], 0);
  EXPECT_LT(fewest["poses_kept"], chosen["poses_kept"]);
}

// The files that two runs agree in when they were the same to the bit; the statistics hold times.
const std::vector<std::string> kRepeatable = {"compact.g2o",     "covariances.csv", "covariances.npz",
                                              "decisions.csv",   "decisions.jsonl", "graph.json",
                                              "thresholds.json", "trajectory.tum"};

TEST_F(CompactCommand, ThresholdsAreChosenFromASample) {
  MakeScene("manhattan");
  const std::string run = "compact in.g2o --strategy fpfl --quiet --output ";
  Succeed(run + "plain");
  Succeed(run + "chosen --auto-thresholds");
  for (const std::string& name : kRepeatable) EXPECT_EQ(Read("plain/" + name), Read("chosen/" + name)) << name;
  const auto stats = JsonFile("chosen/stats.json");
  EXPECT_EQ(stats["sample"]["poses"], 180);
  for (const char* key : {"loop_gain_90", "pose_gain_90", "seconds"}) EXPECT_GE(stats["sample"][key], 0) << key;
  Succeed(run + "less --auto-thresholds --sample 0.2");
  EXPECT_EQ(JsonFile("less/stats.json")["sample"]["poses"], 60);
  EXPECT_NE(Read("less/thresholds.json"), Read("chosen/thresholds.json"));
  // What is given stays, though a sample is taken.
  Succeed(run + "mixed --auto-thresholds --min-pose-gain 0.5 --min-loop-gain 0.25 --range 9 8 1 --probability 0.3");
  const auto mixed = JsonFile("mixed/stats.json");
  EXPECT_EQ(mixed["sample"]["poses"], 180);
  EXPECT_EQ(mixed["thresholds"]["min_pose_gain"], 0.5);
  EXPECT_EQ(mixed["thresholds"]["min_loop_gain"], 0.25);
  EXPECT_EQ(mixed["thresholds"]["range"], nlohmann::json({9.0, 8.0, 1.0}));
  EXPECT_EQ(mixed["thresholds"]["probability"], 0.3);
  // All poses and links need none, but may be asked for some.
  Succeed("compact in.g2o --strategy apal --quiet --output all");
  EXPECT_FALSE(JsonFile("all/stats.json").contains("sample"));
  Succeed("compact in.g2o --strategy apal --quiet --output all --auto-thresholds");
  EXPECT_EQ(Read("all/thresholds.json"), Read("chosen/thresholds.json"));
}

TEST_F(CompactCommand, ThresholdsReadBackGiveTheSameRun) {
  for (const std::string scene : {"manhattan", "ellipse-n"}) {
    SCOPED_TRACE(scene);
    MakeScene(scene);
    Succeed("compact in.g2o --strategy fpfl --quiet --output a --sample 0.4");
    Succeed("compact in.g2o --strategy fpfl --quiet --output b --thresholds a/thresholds.json");
    for (const std::string& name : kRepeatable) EXPECT_EQ(Read("a/" + name), Read("b/" + name)) << name;
    const auto stats = JsonFile("b/stats.json");
    EXPECT_FALSE(stats.contains("sample"));
    EXPECT_EQ(stats["thresholds"], JsonFile("a/stats.json")["thresholds"]);
    EXPECT_TRUE(JsonFile("a/thresholds.json").contains("link_covariance"));
    // Options override the file.
    Succeed("compact in.g2o --strategy fpfl --quiet --output b --thresholds a/thresholds.json --min-pose-gain 1e9");
    auto expected = JsonFile("a/thresholds.json");
    expected["min_pose_gain"] = 1e9;
    EXPECT_EQ(JsonFile("b/thresholds.json"), expected);
    EXPECT_LT(JsonFile("b/stats.json")["poses_kept"], JsonFile("a/stats.json")["poses_kept"]);
  }
  // Of a run in space for one in the plane.
  Succeed("generate manhattan --poses 50 --output plane.g2o");
  ExpectFailure("compact plane.g2o --strategy fpfl --output c --thresholds a/thresholds.json", 1,
                "a/thresholds.json: thresholds for 3D, but the run is 2D");
  ExpectFailure("compact in.g2o --strategy fpfl --output c --thresholds none.json", 1,
                "none.json: the file does not exist");
  Write("broken.json", "{\"dimension\": 3}");
  ExpectFailure("compact in.g2o --strategy fpfl --output c --thresholds broken.json", 1, "broken.json: key \"");
}

TEST_F(CompactCommand, TheRandomBaselineHasTheSameCounts) {
  MakeScene("manhattan");
  Succeed("compact in.g2o --strategy fpfl --quiet --output few");
  const auto few = JsonFile("few/stats.json");
  std::set<std::string> choices;
  for (const std::string seed : {"1", "2", "3"}) {
    const std::string run = "compact in.g2o --strategy rfpfl --quiet --seed " + seed + " --output ";
    Succeed(run + "random");
    const auto stats = JsonFile("random/stats.json");
    EXPECT_EQ(stats["poses_kept"], few["poses_kept"]);
    EXPECT_EQ(stats["links_kept"], few["links_kept"]);
    EXPECT_EQ(stats["thresholds"], few["thresholds"]);
    ExpectConsistent<SE2>(folder_ / "random", ReadAs<SE2>("in.g2o"));
    for (const auto& row : CsvRows(Read("random/decisions.csv"))) {
      EXPECT_TRUE(row[2] == "first" || row[2] == "drawn" || row[2] == "loop_closed" || row[2] == "redundant") << row[2];
    }
    Succeed(run + "again");
    for (const std::string& name : kRepeatable) EXPECT_EQ(Read("again/" + name), Read("random/" + name)) << name;
    choices.insert(Read("random/compact.g2o"));
  }
  EXPECT_EQ(choices.size(), 3u);
}

TEST_F(CompactCommand, WrongLoopsAreRefused) {
  Succeed("generate manhattan --poses 300 --output clean.g2o --ground-truth truth.tum");
  Succeed("generate manhattan --poses 300 --output wrong.g2o --outliers 50 --outliers-list wrong.csv");
  const std::string run = "compact wrong.g2o --strategy apfl --range 500 500 4 --min-pose-gain 3 --quiet --output ";
  const auto error = [&](const std::string& folder) {
    return Json("evaluate " + folder + "/trajectory.tum truth.tum --json")["ate"]["translation_m"].get<double>();
  };
  const auto refused = [&](const std::string& folder) {
    return JsonFile(folder + "/stats.json")["links_refused"].get<long>();
  };
  Succeed(run + "tested --min-loop-gain 1");
  Succeed(run + "untested --min-loop-gain 1 --no-innovation-test");
  Succeed(run + "strict --min-loop-gain 1 --innovation-quantile 0.5");
  Succeed("compact clean.g2o --strategy apfl --range 500 500 4 --min-pose-gain 3 --min-loop-gain 1 --output clean");
  EXPECT_GT(refused("tested"), 10);
  EXPECT_GT(refused("strict"), refused("tested"));
  EXPECT_EQ(refused("untested"), 0);
  EXPECT_LT(error("tested"), 1.2 * error("clean"));
  EXPECT_GT(error("untested"), 3 * error("clean"));
  // A robust kernel leaves out what nothing has tested.
  for (const std::string kernel : {"gnc", "dcs"}) {
    Succeed(run + kernel + " --min-loop-gain 1 --no-innovation-test --robust " + kernel);
    EXPECT_EQ(refused(kernel), 0);
    EXPECT_LT(error(kernel), 0.5 * error("untested")) << kernel;
  }
}

// The unit matrix on all edges of a scene whose measurements are good to centimetres.
TEST_F(CompactCommand, InformationThatNobodyEstimatedIsScaled) {
  MakeScene("manhattan");
  PoseGraph<SE2> given = ReadAs<SE2>("in.g2o"), plain;
  for (const auto& node : given.Poses()) plain.AddPose(node.id);
  for (const auto& node : given.Factors()) {
    auto edge = std::get<RelativePoseFactor<SE2>>(node.factor);
    edge.information.setIdentity();
    plain.AddFactor(edge);
  }
  WriteG2o(plain, Path("plain.g2o"));
  const std::string run = "compact plain.g2o --output ";
  const Outcome outcome = Succeed(run + "scaled");
  EXPECT_NE(outcome.err.find("terse: note: plain.g2o: the information is the unit matrix"), std::string::npos);
  EXPECT_NE(outcome.err.find("(--calibrate-information off leaves it)"), std::string::npos) << outcome.err;
  EXPECT_EQ(Succeed(run + "scaled --calibrate-information auto --quiet").err, "");
  const auto found = JsonFile("scaled/stats.json")["information"];
  EXPECT_EQ(found["verdict"], "contradicted");
  EXPECT_TRUE(found["placeholder"]);
  const auto scale = found["sigma_scale"];
  for (const char* kind : {"odometry", "loops"}) {
    // generate's 0.03 m and 0.02 rad, beside 1 m and 1 rad.
    EXPECT_NEAR(scale[kind]["translation"].get<double>(), 0.03, 0.006) << kind;
    EXPECT_NEAR(scale[kind]["rotation"].get<double>(), 0.02, 0.004) << kind;
  }
  EXPECT_EQ(JsonFile("scaled/graph.json")["sigma_scale"], scale);
  EXPECT_EQ(
      Read("scaled/compact.g2o").rfind("# information calibrated by terse: the input's standard deviations times ", 0),
      0u);
  // What is kept has the scaled information.
  const auto kept = ReadAs<SE2>("scaled/compact.g2o");
  for (const auto& node : kept.Factors()) {
    const auto& edge = std::get<RelativePoseFactor<SE2>>(node.factor);
    EXPECT_GT(edge.information(0, 0), 50) << edge.from.value << ' ' << edge.to.value;
  }
  Succeed(run + "left --calibrate-information off --quiet");
  EXPECT_EQ(JsonFile("left/stats.json")["information"]["verdict"], "off");
  EXPECT_FALSE(JsonFile("left/graph.json").contains("sigma_scale"));
  EXPECT_NE(Read("left/compact.g2o").front(), '#');
  // A map goes on with its scales, whatever is asked for; one that was left goes on as it is.
  for (const std::string& folder : {std::string("scaled"), std::string("left")}) {
    Succeed("compact plain.g2o --continue " + folder + " --output more --quiet");
    const auto more = JsonFile("more/stats.json")["information"];
    EXPECT_EQ(more["verdict"], "continued");
    EXPECT_EQ(more["sigma_scale"], JsonFile(folder + "/stats.json")["information"]["sigma_scale"]);
    EXPECT_EQ(JsonFile("more/graph.json").contains("sigma_scale"), folder == "scaled");
  }
  // Information that agrees with the residuals is left as it is.
  Succeed("compact in.g2o --output agrees --quiet");
  EXPECT_EQ(JsonFile("agrees/stats.json")["information"]["verdict"], "consistent");
  ExpectFailure(run + "out --calibrate-information on", 2, "--calibrate-information");
}

TEST_F(CompactCommand, TheDefaultIsBounded) {
  MakeScene("ellipse-n");
  const Outcome unsaid = Succeed("compact in.g2o --output unsaid");
  EXPECT_EQ(unsaid.out.rfind("bounded kept ", 0), 0u) << unsaid.out;
  EXPECT_EQ(JsonFile("unsaid/stats.json")["strategy"], "bounded");
  EXPECT_EQ(JsonFile("unsaid/graph.json")["strategy"], "bounded");
  Succeed("compact in.g2o --strategy bounded --output said --quiet");
  Succeed("compact in.g2o --strategy fpfl --output few --quiet");
  for (const std::string file : {"graph.json", "thresholds.json", "trajectory.tum"}) {
    EXPECT_EQ(Read("unsaid/" + file), Read("said/" + file)) << file;
  }
  EXPECT_NE(Read("unsaid/graph.json"), Read("few/graph.json"));
  // A map goes on as it began.
  Succeed("compact in.g2o --continue few --output more --quiet");
  EXPECT_EQ(JsonFile("more/stats.json")["strategy"], "fpfl");
}

TEST_F(CompactCommand, RegistrationsAreBounded) {
  MakeScene("manhattan");
  const auto most = [&](const std::string& folder) {
    long out = 0;
    for (const auto& d : JsonLines(folder + "/decisions.jsonl")) out = std::max<long>(out, d["registrations_tried"]);
    return out;
  };
  const std::string run = "compact in.g2o --min-loop-gain 0.01 --range 9 9 1 --min-pose-gain 3 --quiet --output ";
  Succeed(run + "one --max-registrations 1");
  Succeed(run + "two --max-registrations 2");
  Succeed(run + "default");
  EXPECT_EQ(most("one"), 1);
  EXPECT_EQ(most("two"), 2);
  EXPECT_GE(most("default"), 2);
  EXPECT_LE(most("default"), 8);
  EXPECT_LE(JsonFile("one/stats.json")["links_kept"], JsonFile("default/stats.json")["links_kept"]);
  for (const std::string count : {"0", "-1", "x"})
    ExpectFailure(run + "out --max-registrations " + count, 2, "--max-registrations");
}

TEST_F(CompactCommand, WhatIsRecordedChangesNothingElse) {
  MakeScene("manhattan");
  for (const std::string strategy : {"fpfl", "bounded"}) {
    SCOPED_TRACE(strategy);
    std::map<std::string, long> untried, tried;
    for (const std::string record : {"none", "decisions", "candidates"}) {
      Succeed("compact in.g2o --quiet --strategy " + strategy + " --output " + record + " --record " + record);
      EXPECT_EQ(Read(record + "/compact.g2o"), Read("none/compact.g2o"));
      const auto lines = JsonLines(record + "/decisions.jsonl"), fewest = JsonLines("none/decisions.jsonl");
      ASSERT_EQ(lines.size(), fewest.size());
      for (std::size_t k = 0; k < lines.size(); ++k) {
        for (const char* key : {"kept", "verdict", "pose_gain_nats", "registrations_tried", "links_accepted",
                                "candidates_found", "revived"})
          EXPECT_EQ(lines[k][key], fewest[k][key]) << key;
        long others = 0;
        for (const auto& candidate : lines[k]["candidates"]) ++(candidate["tried"] ? tried[record] : others);
        EXPECT_LE(others, 16);
        untried[record] += others;
      }
    }
    EXPECT_EQ(untried["none"] + tried["none"] + untried["decisions"], 0);
    const long registrations = JsonFile("decisions/stats.json")["registrations_tried"];
    if (strategy == "fpfl") {
      EXPECT_EQ(tried["decisions"], registrations);
    } else {  // a link that says where the robot is was tried, too, and is no registration
      EXPECT_GT(tried["decisions"], registrations);
    }
    EXPECT_EQ(tried["candidates"], tried["decisions"]);
    EXPECT_GT(untried["candidates"], 0);
  }
  ExpectFailure("compact in.g2o --output out --record all", 2, "--record");
}

TEST_F(CompactCommand, LostLoopsAreToldWithTheCause) {
  Succeed("generate manhattan --poses 300 --output in.g2o --ground-truth in.tum");
  EXPECT_EQ(Succeed("compact in.g2o --output default").err, "");
  const std::string run = "compact in.g2o --strategy fpfl --ground-truth in.tum --output out ";
  const Outcome good = Succeed(run);
  EXPECT_EQ(good.err, "");
  const auto errors = JsonFile("out/stats.json")["errors"];
  char line[128];
  std::snprintf(line, sizeof(line), "ATE %.4g m, %.4g deg against in.tum\n", errors["ate_m"].get<double>(),
                errors["ate_deg"].get<double>());
  EXPECT_NE(good.out.find(line), std::string::npos) << good.out;
  EXPECT_EQ(Succeed("compact in.g2o --output out").out.find("ATE"), std::string::npos) << "no truth, no error";
  EXPECT_EQ(Succeed(run + "--min-loop-gain 1e9").err,
            "terse: warning: 0 of 393 loops are in the map; the others tell less than --min-loop-gain 1e+09 nats\n");
  const std::string distrusted = Succeed(run + "--min-loop-gain 1 --innovation-quantile 0.01").err;
  EXPECT_NE(distrusted.find(" disagree with it by more than the innovation test allows"), std::string::npos)
      << distrusted;
  EXPECT_EQ(Succeed(run + "--min-loop-gain 1e9 --quiet").err, "");
  EXPECT_EQ(Succeed("compact in.g2o --strategy apal --output out --min-loop-gain 1e9").err, "") << "takes all";
}

TEST_F(CompactCommand, PosesRetire) {
  MakeScene("manhattan");
  Succeed("compact in.g2o --strategy apal --output all");
  const auto before = JsonFile("all/stats.json");
  EXPECT_FALSE(before.contains("poses_retired"));
  const std::string range = " --range 10 10 3.2 --min-pose-gain 1000 --min-loop-gain 1";
  const Outcome outcome = Succeed("compact in.g2o --strategy apal --retire 2 --output few" + range);
  const auto stats = JsonFile("few/stats.json");
  const long retired = stats["poses_retired"].get<long>();
  EXPECT_GT(retired, 0);
  EXPECT_EQ(stats["poses_kept"].get<long>() + retired, before["poses_kept"].get<long>());
  EXPECT_GE(stats["retired_loss_nats"].get<double>(), 0);
  EXPECT_NE(outcome.out.find(std::to_string(retired) + " poses retired"), std::string::npos) << outcome.out;
  EXPECT_EQ(ReadAs<SE2>("few/compact.g2o").Poses().size(), stats["poses_kept"].get<std::size_t>());
  EXPECT_EQ(ReadTrajectory((folder_ / "few/trajectory.tum").string()).stamps.size(),
            before["poses"].get<std::size_t>());
  // All that is there has been seen: the map stays, and more may retire from it.
  Succeed("compact in.g2o --continue few --retire 50 --output fewer --quiet" + range);
  EXPECT_LE(JsonFile("fewer/stats.json")["poses_kept"].get<long>(), stats["poses_kept"].get<long>());
  ExpectFailure("compact in.g2o --retire -1 --output out", 2, "--retire");
}

// While the map grows, and as much as is asked for; what retired is a dropped pose like others.
TEST_F(CompactCommand, PosesRetireAsTheMapGrows) {
  Succeed("generate manhattan --poses 600 --output in.g2o");
  const auto lines = [&](const std::string& folder) {
    std::vector<nlohmann::json> out;
    std::istringstream text(Read(folder + "/decisions.jsonl"));
    for (std::string line; std::getline(text, line);) out.push_back(nlohmann::json::parse(line));
    return out;
  };
  const auto run = [&](const std::string& options, const std::string& folder) {
    Succeed("compact in.g2o --quiet --output " + folder + ' ' + options);
    std::set<long> retired;
    for (const auto& line : lines(folder)) {
      for (const char* key : {"retired", "retired_at_end"}) {
        for (const long id : line.value(key, nlohmann::json::array())) retired.insert(id);
      }
      for (const long id : line["revived"]) retired.erase(id);
    }
    long dropped = 0;
    const auto graph = JsonFile(folder + "/graph.json");
    for (const auto& pose : graph["poses"]) {
      dropped += !pose["kept"].get<bool>();
      if (retired.count(pose["id"]) == 0) continue;
      EXPECT_FALSE(pose["kept"]) << pose["id"];
      EXPECT_TRUE(pose.contains("base") && pose.contains("T_base_pose")) << pose["id"];
    }
    const auto stats = JsonFile(folder + "/stats.json");
    EXPECT_EQ(stats["poses_kept"].get<long>() + dropped, stats["poses"].get<long>());
    EXPECT_EQ(ReadTrajectory(Path(folder + "/trajectory.tum")).stamps.size(), stats["poses"].get<std::size_t>());
    return std::pair{stats, retired.size()};
  };
  const auto [unsaid, unsaid_retired] = run("", "unsaid");
  const auto [none, none_retired] = run("--retire-share 0", "none");
  const auto [many, many_retired] = run("--retire-share 2", "many");
  EXPECT_EQ(none["poses_retired"], 0);
  EXPECT_EQ(none["retired_loss_nats"], 0);
  EXPECT_EQ(none_retired, 0u);
  EXPECT_GT(unsaid_retired, 10u);
  EXPECT_GE(unsaid["poses_retired"], unsaid_retired);
  EXPECT_GT(many["poses_retired"], unsaid["poses_retired"]);
  EXPECT_GE(many["retired_loss_nats"], unsaid["retired_loss_nats"]);
  EXPECT_LT(unsaid["poses_kept"], none["poses_kept"]);
  run("--retire-share 0.3", "said");
  EXPECT_EQ(Read("said/graph.json"), Read("unsaid/graph.json")) << "the default";
  // No other strategy retires poses by itself.
  run("--strategy fpfl", "few");
  EXPECT_FALSE(JsonFile("few/stats.json").contains("poses_retired"));
  run("--strategy fpfl --retire-share 5", "same");
  EXPECT_EQ(Read("same/graph.json"), Read("few/graph.json"));
  for (const std::string bad : {"-0.1", "nan", "inf", "some"}) {
    ExpectFailure("compact in.g2o --output out --retire-share " + bad, 2, "--retire-share: " + bad);
  }
  EXPECT_FALSE(Exists("out"));
}

TEST_F(CompactCommand, OptionsThatContradictEachOther) {
  MakeScene("manhattan");
  Succeed("compact in.g2o --strategy fpfl --quiet --output a");
  const long files = FileCount();
  const std::string run = "compact in.g2o --strategy fpfl --output out ";
  ExpectFailure(run + "--thresholds a/thresholds.json --auto-thresholds", 2, "excludes");
  ExpectFailure(run + "--thresholds a/thresholds.json --sample 0.5", 2, "excludes");
  ExpectFailure(run + "--no-innovation-test --innovation-quantile 0.99", 2, "excludes");
  ExpectFailure(run + "--robust-width 3", 2, "--robust");
  ExpectFailure(run + "--robust dcs --robust-width 0", 2, "0 is not a positive number");
  ExpectFailure(run + "--robust welsch", 2, "welsch");
  ExpectFailure(run + "--sample 1.5", 2, "--sample");
  ExpectFailure(run + "--sample 0", 2, "--sample");
  ExpectFailure(run + "--innovation-quantile 1", 2, "--innovation-quantile");
  ExpectFailure(run + "--innovation-quantile 0", 2, "--innovation-quantile");
  for (const std::string option : {"innovation-quantile", "sample", "probability", "min-loop-gain", "min-pose-gain"}) {
    ExpectFailure(run + "--" + option + " nan", 2, "--" + option);
  }
  ExpectFailure(run + "--seed -1", 2, "-1 is not a whole number");
  ExpectFailure(run + "--composition third", 2, "third");
  ExpectFailure(run + "--angle roll", 2, "roll");
  EXPECT_EQ(FileCount(), files);
}

TEST_F(CompactCommand, RecoveryConcernsDroppedPosesOnly) {
  MakeScene("ellipse-n");
  std::set<std::string> trajectories;
  std::string graph;
  for (const std::string recovery : {"v0", "v1", "v2"}) {
    Succeed("compact in.g2o --strategy fpfl --output few --recover " + recovery);
    EXPECT_LT(JsonFile("few/stats.json")["poses_kept"], 255);
    trajectories.insert(Read("few/trajectory.tum"));
    if (!graph.empty()) {
      EXPECT_EQ(Read("few/compact.g2o"), graph) << "same run, bit by bit";
    }
    graph = Read("few/compact.g2o");
  }
  EXPECT_EQ(trajectories.size(), 3u);
  Succeed("compact in.g2o --strategy fpfl --output few");
  EXPECT_EQ(trajectories.count(Read("few/trajectory.tum")), 1u);
}

TEST_F(CompactCommand, ReadOptionsAndQuiet) {
  MakeScene("ellipse-n");
  const Outcome outcome = Succeed("compact in.g2o --strategy apal --rotation-information radians --output r --quiet");
  EXPECT_EQ(outcome.out + outcome.err, "");
  const double chi2 = JsonFile("r/stats.json")["chi2"];
  EXPECT_NEAR(Chi2(ReadAs<SE3>("r/compact.g2o", RotationInformation::kRadians)), chi2, 1e-8 * chi2)
      << "written as it was read";
  Write("bad.g2o", "EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n");
  ExpectFailure("compact bad.g2o --strategy apal --output bad", 1, "bad.g2o:1: ");
  EXPECT_FALSE(Exists("bad"));
  EXPECT_NE(Succeed("compact bad.g2o --strategy apal --output bad --repair-information").err.find("clamped"),
            std::string::npos);
}

TEST_F(CompactCommand, UsageErrorsExitWith2AndLeaveNothing) {
  Write("plane.g2o", "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
  Write("space.g2o", "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n");
  const std::string plane = "compact plane.g2o --output out --strategy ", space = "compact space.g2o --output out ";
  ExpectFailure("compact", 2, "required");
  ExpectFailure("compact plane.g2o --strategy apal", 2, "--output is required");
  ExpectFailure(plane + "few", 2, "few");
  ExpectFailure(plane + "fpfl --recover v3", 2, "v3");
  ExpectFailure(plane + "fpfl --range 1 2", 2, "--range");
  ExpectFailure(plane + "fpfl --range 1 2 3 4 5", 2, "At Most 4 required but received 5");
  ExpectFailure(plane + "fpfl --range 1 2 0", 2, "0 is not a positive number");
  ExpectFailure(plane + "fpfl --range 1 2 nan", 2, "nan is not a positive number");
  ExpectFailure(plane + "fpfl --range 1 2 3 4", 2, "4 numbers given, but a 2D graph takes X Y ANGLE");
  ExpectFailure(space + "--strategy fpfl --range 1 2 3", 2, "3 numbers given, but a 3D graph takes X Y Z ANGLE");
  ExpectFailure(plane + "fpfl --range 1 2 x", 2, "x is not a positive number");
  ExpectFailure(plane + "fpfl --probability 1", 2, "--probability");
  ExpectFailure(plane + "fpfl --probability -0.1", 2, "--probability");
  ExpectFailure(plane + "fpfl --min-pose-gain -1", 2, "--min-pose-gain");
  ExpectFailure(plane + "fpfl --min-loop-gain much", 2, "much");
  EXPECT_EQ(FileCount(), 2);
  // FILE may come last.
  Succeed("compact --output out --strategy fpfl --range 1 2 3 plane.g2o");
  Succeed("compact --output out --strategy fpfl --range 1 2 3 1 space.g2o");
}

TEST_F(CompactCommand, BadInputAndOutputExitWith1) {
  Write("in.g2o", "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
  Write("file", "");
  const std::string run = "compact in.g2o --strategy fpfl --output ";
  ExpectFailure("compact missing.g2o --strategy fpfl --output out", 1, "missing.g2o: the file does not exist");
  ExpectFailure("compact . --strategy fpfl --output out", 1, ".: ");
  EXPECT_FALSE(Exists("out"));
  ExpectFailure(run + "file", 1, "file: cannot make this folder: a file of this name is in the way");
  ExpectFailure(run + "file/out", 1, "file/out: cannot make this folder");
  if (std::filesystem::exists("/proc/self")) ExpectFailure(run + "/proc/out", 1, "/proc/out: cannot make this folder");
  if (geteuid() != 0) {  // root may write everywhere
    std::filesystem::create_directory(folder_ / "closed");
    std::filesystem::permissions(folder_ / "closed",
                                 std::filesystem::perms::owner_read | std::filesystem::perms::owner_exec);
    ExpectFailure(run + "closed", 1, "cannot write");
  }
  Succeed(run + "deep/er/out --quiet");
  EXPECT_TRUE(Exists("deep/er/out/stats.json"));
}

// Squares beyond the range of doubles.
TEST_F(CompactCommand, ANumericalFailureExitsWith3) {
  Write("in.g2o", "EDGE_SE2 0 1 1e200 0 0 1 0 0 1 0 1\nEDGE_SE2 0 1 -1e200 0 0 1 0 0 1 0 1\n");
  ExpectFailure("compact in.g2o --output out --strategy apal", 3, "in.g2o: ");
  EXPECT_TRUE(std::filesystem::is_empty(folder_ / "out"));
}

TEST_F(CompactCommand, AnInterruptLeavesNoFile) {
  Succeed("generate garage --poses 3000 --output in.g2o");
  for (const int signal : {SIGINT, SIGTERM}) {
    Interrupt(
        {"compact", "in.g2o", "--strategy", "apal", "--output", "out"}, signal,
        [&, after = testing::After(std::chrono::milliseconds(300))]() mutable { return Exists("out") && after(); });
    EXPECT_TRUE(std::filesystem::is_empty(folder_ / "out"));
  }
}

}  // namespace
}  // namespace terse
