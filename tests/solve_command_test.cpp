// `terse solve` as its users and the tools that call it see it.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "terse/core/arrival.h"
#include "terse/core/batch_solver.h"
#include "terse/core/graph_file.h"
#include "terse/core/pose_values.h"
#include "terse/core/robust.h"
#include "terse/core/trajectory.h"
#include "terse/covariance/marginals.h"
#include "testing_command.h"

namespace terse {
namespace {

using testing::CsvRows;
using testing::Outcome;

class SolveCommand : public testing::CommandTest {
 protected:
  void MakeScene(const std::string& scene) const {
    Succeed("generate " + scene + (scene == "ellipse" ? "" : " --poses 150") + " --output in.g2o");
  }
  template <class Pose>
  PoseGraph<Pose> ReadAs(const std::string& name, RotationInformation reading = {}) const {
    ReadOptions options;
    options.rotation_information = reading;
    return std::get<PoseGraph<Pose>>(ReadGraph(Path(name), options).graph);
  }
};

std::vector<std::string> Keys(const nlohmann::json& json) {
  std::vector<std::string> keys;
  for (const auto& item : json.items()) keys.push_back(item.key());
  return keys;  // the parser sorts them
}

TEST_F(SolveCommand, StatisticsHaveTheAgreedKeysAndTrueNumbers) {
  MakeScene("ellipse");
  const Outcome outcome = Succeed("solve in.g2o --output out.g2o --stats stats.json");
  const auto stats = JsonFile("stats.json");
  EXPECT_EQ(Keys(stats),
            (std::vector<std::string>{"chi2", "converged", "edges", "initial", "iterations", "log_determinant",
                                      "loop_edges", "normalized_chi2", "peak_rss_mb", "poses", "seconds",
                                      "step_seconds", "steps", "termination", "threads", "version"}));
  EXPECT_EQ(Keys(stats["seconds"]),
            (std::vector<std::string>{"covariance", "factor", "linearise", "order", "read", "solve", "total"}));
  EXPECT_EQ(Keys(stats["step_seconds"]), (std::vector<std::string>{"max", "median", "p95", "p99"}));
  const auto info = Json("info in.g2o --json");
  for (const char* key : {"poses", "edges", "loop_edges"}) EXPECT_EQ(stats[key], info[key]) << key;
  EXPECT_EQ(stats["converged"], true);
  EXPECT_EQ(stats["termination"], "converged");
  EXPECT_EQ(stats["steps"], 1);
  EXPECT_EQ(stats["threads"], 1);
  EXPECT_EQ(stats["version"], TERSE_VERSION);
  EXPECT_GT(stats["iterations"], 0);
  EXPECT_GT(stats["peak_rss_mb"], 0);
  EXPECT_GE(stats["seconds"]["total"], stats["seconds"]["read"]);
  const double chi2 = stats["chi2"], scalars = 6 * stats["edges"].get<double>();
  EXPECT_DOUBLE_EQ(stats["normalized_chi2"].get<double>(), chi2 / scalars);
  // The file holds shortest decimals that read back the same; only quaternions are normalised again.
  const auto solved = ReadAs<SE3>("out.g2o");
  EXPECT_NEAR(Chi2(solved), chi2, 1e-9 * chi2);
  EXPECT_LT(chi2, Json("info in.g2o --json")["chi2"]);
  EXPECT_NEAR(CholeskyAt(solved, internal::ValuesOf(solved)).LogDeterminant(), stats["log_determinant"].get<double>(),
              1e-6);
  EXPECT_NE(outcome.out.find("170 poses"), std::string::npos) << outcome.out;
  EXPECT_EQ(outcome.err, "") << "no progress where standard error is no terminal";
}

TEST_F(SolveCommand, EqualsTheLibrary) {
  MakeScene("manhattan");
  Succeed("solve in.g2o --output out.g2o --stats stats.json");
  const auto in = ReadAs<SE2>("in.g2o");
  const auto expected = SolveBatch(in);
  EXPECT_EQ(JsonFile("stats.json")["chi2"].get<double>(), expected.chi2) << "the same code, bit by bit";
  const auto out = ReadAs<SE2>("out.g2o");
  ASSERT_EQ(out.Factors().size(), in.Factors().size());
  for (std::size_t k = 0; k < out.Poses().size(); ++k) {
    EXPECT_EQ(out.Poses()[k].id, in.Poses()[k].id);
    EXPECT_LT(out.Poses()[k].T_world_body->Local(expected.T_world_body[k]).norm(), 1e-12);
  }
}

TEST_F(SolveCommand, StatsSayWhichStartWentOn) {
  MakeScene("manhattan");
  Succeed("solve in.g2o --stats stats.json");
  const auto initial = JsonFile("stats.json")["initial"];
  EXPECT_EQ(initial["chosen_by"], "auto");
  ASSERT_EQ(initial["compared"].size(), 4U);
  double lowest = 1e300, chosen = 0;
  for (const auto& trial : initial["compared"]) {
    if (trial.contains("unavailable")) continue;
    EXPECT_LE(trial["cost"].get<double>(), trial["cost_at_start"].get<double>());
    lowest = std::min(lowest, trial["cost"].get<double>());
    if (trial["method"] == initial["method"]) chosen = trial["cost"];
  }
  EXPECT_EQ(chosen, lowest);
  Succeed("solve in.g2o --initial tree --stats stats.json");
  EXPECT_EQ(JsonFile("stats.json")["initial"]["method"], "tree");
  EXPECT_EQ(JsonFile("stats.json")["initial"]["chosen_by"], "option");
  Succeed("solve in.g2o --robust dcs --stats stats.json");
  EXPECT_EQ(JsonFile("stats.json")["initial"]["method"], "compose");
  Succeed("solve in.g2o --mode incremental --initial auto --stats stats.json");
  EXPECT_EQ(JsonFile("stats.json")["restarts"], 0);
}

TEST_F(SolveCommand, EveryModeAndStartAgrees) {
  for (const std::string scene : {"ellipse", "manhattan"}) {
    MakeScene(scene);
    Succeed("solve in.g2o --stats batch.json");
    const double chi2 = JsonFile("batch.json")["chi2"], log_det = JsonFile("batch.json")["log_determinant"];
    for (const std::string options :
         {"--initial file", "--initial tree", "--initial chordal", "--mode incremental",
          "--mode incremental --every edge", "--mode incremental --initial file", "--every edge", "--threads 4"}) {
      Succeed("solve in.g2o --output out.g2o --stats stats.json " + options);
      const auto stats = JsonFile("stats.json");
      // Both stop when a step would gain less than 1e-11 of chi2.
      EXPECT_NEAR(stats["chi2"].get<double>(), chi2, 1e-8 * chi2) << scene << ' ' << options;
      EXPECT_NEAR(stats["log_determinant"].get<double>(), log_det, 1e-6 * std::abs(log_det)) << scene << ' ' << options;
      EXPECT_NEAR(Json("info out.g2o --json")["chi2"].get<double>(), chi2, 1e-8 * chi2) << scene << ' ' << options;
      EXPECT_EQ(stats["threads"], options == "--threads 4" ? 4 : 1);
    }
  }
}

TEST_F(SolveCommand, AStepIsAPoseOrAnEdge) {
  MakeScene("ellipse");
  const auto graph = ReadAs<SE3>("in.g2o");
  Succeed("solve in.g2o --mode incremental --stats pose.json");
  Succeed("solve in.g2o --mode incremental --every edge --stats edge.json");
  const auto pose = JsonFile("pose.json"), edge = JsonFile("edge.json");
  EXPECT_EQ(pose["steps"], ArrivalSteps(graph, ArrivalUnit::kPose).size());
  EXPECT_EQ(edge["steps"], ArrivalSteps(graph, ArrivalUnit::kEdge).size());
  EXPECT_EQ(edge["steps"], graph.Factors().size());
  for (const auto& stats : {pose, edge}) {
    EXPECT_GE(stats["chi2_before_finish"].get<double>(), stats["chi2"].get<double>() * (1 - 1e-9));
    const auto& seconds = stats["step_seconds"];
    EXPECT_LE(seconds["median"], seconds["p95"]);
    EXPECT_LE(seconds["p95"], seconds["p99"]);
    EXPECT_LE(seconds["p99"], seconds["max"]);
  }
}

template <class Pose>
void ExpectMarginals(const PoseGraph<Pose>& solved, const std::string& csv, const std::vector<PoseId>& ids) {
  const Marginals<Pose> marginals(solved, internal::ValuesOf(solved));
  const auto rows = CsvRows(csv);
  ASSERT_EQ(rows.size(), ids.size());
  for (std::size_t k = 0; k < ids.size(); ++k) {
    ASSERT_EQ(rows[k].size(), 1u + Pose::kDof * Pose::kDof);
    EXPECT_EQ(rows[k][0], std::to_string(ids[k].value));
    const auto expected = marginals.Marginal(ids[k]);
    typename Pose::Jacobian actual;
    for (int i = 0; i < Pose::kDof * Pose::kDof; ++i) {
      actual(i / Pose::kDof, i % Pose::kDof) = std::stod(rows[k][1 + static_cast<std::size_t>(i)]);
    }
    // The anchor (1e8) beside informations of 1..1000 costs digits, and values are those of the last iteration.
    EXPECT_LT((actual - expected).norm(), 1e-6 * expected.norm()) << ids[k].value;
  }
}

TEST_F(SolveCommand, CovariancesAreTheMarginals) {
  const auto check = [&](auto pose, const std::string& scene, const std::string& mode) {
    using Pose = decltype(pose);
    MakeScene(scene);
    Succeed("solve in.g2o --output out.g2o --covariances diagonal --covariance-output all.csv" + mode);
    const auto solved = ReadAs<Pose>("out.g2o");
    std::vector<PoseId> ids;
    for (const auto& node : solved.Poses()) ids.push_back(node.id);
    ExpectMarginals(solved, Read("all.csv"), ids);
    Succeed("solve in.g2o --covariances last --covariance-output last.csv" + mode);
    ExpectMarginals(solved, Read("last.csv"), {*std::max_element(ids.begin(), ids.end())});
  };
  for (const std::string mode : {"", " --mode incremental"}) {
    check(SE2(), "manhattan", mode);
    check(SE3(), "ellipse", mode);
  }
  EXPECT_EQ(Read("all.csv").substr(0, 13), "id,x_x,x_y,x_");
}

TEST_F(SolveCommand, CovariancesOnStandardOutputStandAlone) {
  MakeScene("ellipse");
  Succeed("solve in.g2o --covariance-output all.csv --quiet");
  const Outcome outcome = Succeed("solve in.g2o --covariances diagonal");
  EXPECT_EQ(outcome.out, Read("all.csv")) << "the summary must not follow the table";
  EXPECT_NE(outcome.err.find("converged"), std::string::npos) << outcome.err;
  EXPECT_EQ(Succeed("solve in.g2o --covariances diagonal --quiet").err, "");
  EXPECT_EQ(CsvRows(Succeed("solve in.g2o --covariances last --quiet").out).size(), 1u);
}

TEST_F(SolveCommand, TrajectoriesHaveAllPosesById) {
  // Vertices and edges against the order of ids.
  Write("in.g2o",
        "VERTEX_SE2 5 2 0 0\nVERTEX_SE2 1 0 0 0\nVERTEX_SE2 3 1 0 0\n"
        "EDGE_SE2 5 3 -1 0 0 1 0 0 1 0 1\nEDGE_SE2 3 1 -1 0 0 1 0 0 1 0 1\n");
  Succeed("solve in.g2o --trajectory t.tum");
  Succeed("solve in.g2o --trajectory t.kitti --mode incremental");
  Succeed("solve in.g2o --trajectory t.txt");
  EXPECT_EQ(Read("t.kitti"), Read("t.txt"));
  const Trajectory tum = ReadTrajectory(Path("t.tum")), kitti = ReadTrajectory(Path("t.kitti"));
  EXPECT_EQ(tum.format, TrajectoryFormat::kTum);
  EXPECT_EQ(kitti.format, TrajectoryFormat::kKitti);
  EXPECT_EQ(tum.stamps, (std::vector<double>{1, 3, 5}));
  ASSERT_EQ(kitti.T_world_body.size(), 3u);
  for (int k = 0; k < 3; ++k) {
    // The anchored first pose is pose 5 of the file at x = 2 or pose 1 at 0: the edges fit both.
    EXPECT_NEAR(tum.T_world_body[std::size_t(k)].Translation().x(), k, 1e-12);
    EXPECT_NEAR(kitti.T_world_body[std::size_t(k)].Translation().x(), k, 1e-12);
  }
  EXPECT_EQ(Succeed("solve in.g2o --trajectory /dev/stdout --quiet").out, Read("t.tum")) << "no ending: TUM";
}

TEST_F(SolveCommand, ReadOptions) {
  MakeScene("ellipse");
  Succeed("solve in.g2o --stats q.json");
  Succeed("solve in.g2o --rotation-information radians --output r.g2o --stats r.json");
  EXPECT_GT(JsonFile("r.json")["chi2"], JsonFile("q.json")["chi2"]) << "four times the weight on rotations";
  const double chi2 = JsonFile("r.json")["chi2"];
  EXPECT_NEAR(Chi2(ReadAs<SE3>("r.g2o", RotationInformation::kRadians)), chi2, 1e-9 * chi2) << "written as it was read";
  Write("bad.g2o", "EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n");
  ExpectFailure("solve bad.g2o", 1, "bad.g2o:1: ");
  const Outcome repaired = Succeed("solve bad.g2o --repair-information");
  EXPECT_NE(repaired.err.find("clamped"), std::string::npos);
  EXPECT_EQ(Succeed("solve bad.g2o --repair-information --quiet").err, "");
}

TEST_F(SolveCommand, QuietIsSilent) {
  MakeScene("ellipse");
  const Outcome outcome = Succeed("solve in.g2o --quiet --output out.g2o");
  EXPECT_EQ(outcome.out + outcome.err, "");
}

TEST_F(SolveCommand, UsageErrorsExitWith2) {
  MakeScene("ellipse");
  ExpectFailure("solve", 2, "FILE is required");
  ExpectFailure("solve in.g2o --mode online", 2, "online");
  ExpectFailure("solve in.g2o --initial zero", 2, "zero");
  ExpectFailure("solve in.g2o --every loop", 2, "loop");
  ExpectFailure("solve in.g2o --covariances full", 2, "full");
  ExpectFailure("solve in.g2o --threads 0", 2, "--threads");
  ExpectFailure("solve in.g2o --threads two", 2, "two");
  ExpectFailure("solve in.g2o --trajectory out.csv", 2, "extension must be .tum, .kitti");
  ExpectFailure("solve in.g2o --stat s.json", 2, "did you mean --stats?");
  for (const char* initial : {"chordal", "tree"}) {
    ExpectFailure("solve in.g2o --mode incremental --initial " + std::string(initial), 2, "compose or file");
  }
  EXPECT_EQ(FileCount(), 1);
}

TEST_F(SolveCommand, BadInputExitsWith1) {
  Write("edges.g2o", "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
  Write("empty.g2o", "");
  ExpectFailure("solve missing.g2o", 1, "missing.g2o: the file does not exist");
  ExpectFailure("solve .", 1, ".: ");
  ExpectFailure("solve empty.g2o", 1, "empty.g2o: ");
  ExpectFailure("solve edges.g2o --initial file", 1, "edges.g2o: pose 0 has no value");
  ExpectFailure("solve edges.g2o --initial file --mode incremental", 1, "edges.g2o: pose 0 has no value");
  Succeed("solve edges.g2o");
}

// Outputs are tried before the work: none is written if one cannot be.
TEST_F(SolveCommand, UnwritableOutputExitsWith1AndLeavesNothing) {
  MakeScene("ellipse");
  Write("file", "");
  for (const std::string option : {"--output", "--trajectory", "--covariance-output", "--stats"}) {
    const std::string others = (option == "--output" ? "--stats s.json " : "--output o.g2o ") + option;
    ExpectFailure("solve in.g2o " + others + " nowhere/x.tum", 1, "folder nowhere does not exist");
    ExpectFailure("solve in.g2o " + others + " file/x.tum", 1, "file is not a folder");
    ExpectFailure("solve in.g2o " + others + " /", 1, "folder");
  }
  EXPECT_EQ(FileCount(), 2);
}

TEST_F(SolveCommand, AFactorInAFileGivesTheSame) {
  // /tmp and /var/tmp may be in memory.
  setenv("TMPDIR", std::filesystem::path(TERSE_COMMAND).parent_path().c_str(), 1);
  Succeed("generate sphere --poses 400 --output in.g2o");
  Succeed("solve in.g2o --output memory.g2o --covariance-output memory.csv --stats memory.json");
  const Outcome outcome =
      Succeed("solve in.g2o --factor-memory 0.000001 --output file.g2o --covariance-output file.csv --stats file.json");
  EXPECT_EQ(Read("file.g2o"), Read("memory.g2o"));
  EXPECT_EQ(Read("file.csv"), Read("memory.csv"));
  EXPECT_NE(outcome.out.find("was in a file"), std::string::npos) << outcome.out;
  EXPECT_FALSE(JsonFile("memory.json").contains("factor_bytes_in_file"));
  EXPECT_GT(JsonFile("file.json")["factor_bytes_in_file"], 100000);
  const long before = FileCount();
  setenv("TMPDIR", "/no/such/folder", 1);
  ExpectFailure("solve in.g2o --factor-memory 0.000001 --output o.g2o", 1, "/no/such/folder: cannot store");
  EXPECT_EQ(FileCount(), before);
  setenv("TMPDIR", std::filesystem::path(TERSE_COMMAND).parent_path().c_str(), 1);
  ExpectFailure("solve in.g2o --factor-memory 0", 2, "not a number above 0");
  ExpectFailure("solve in.g2o --factor-memory nan", 2, "not a number above 0");
  for (const char* plenty : {"1e30", "1e300"}) {
    Succeed(std::string("solve in.g2o --stats plenty.json --factor-memory ") + plenty);
    EXPECT_FALSE(JsonFile("plenty.json").contains("factor_bytes_in_file"));
  }
  Succeed("solve in.g2o --mode incremental --stats incremental.json --factor-memory 1e-30");
  EXPECT_GT(JsonFile("incremental.json")["factor_bytes_in_file"], 100000);
  unsetenv("TMPDIR");
}

// Two positions at one place leave the rotation about it free: solved as the first pose lies, and said so.
TEST_F(SolveCommand, AFreeTurnIsSolvedAndSaidSo) {
  Write("in.g2o", "EDGE_SE2 0 1 0 0 0 1 0 0 1 0 1\nEDGE_PRIOR_SE2_XY 0 1 1 1 0 1\nEDGE_PRIOR_SE2_XY 1 1 1 1 0 1\n");
  const auto outcome = Succeed("solve in.g2o --covariance-output c.csv");
  EXPECT_NE(outcome.err.find("heading is not determined"), std::string::npos) << outcome.err;
  const auto rows = testing::CsvRows(Read("c.csv"));
  EXPECT_NEAR(std::stod(rows.at(1).back()), 1, 1e-6) << "of the edge between the two";
}

// Squares beyond the range of doubles.
TEST_F(SolveCommand, ANumericalFailureExitsWith3) {
  Write("in.g2o", "EDGE_SE2 0 1 1e200 0 0 1 0 0 1 0 1\nEDGE_SE2 0 1 -1e200 0 0 1 0 0 1 0 1\n");
  for (const std::string mode : {"batch", "incremental"}) {
    ExpectFailure("solve in.g2o --covariances diagonal --output out.g2o --stats s.json --mode " + mode, 3, "in.g2o: ");
  }
  EXPECT_EQ(FileCount(), 1);
}

TEST_F(SolveCommand, AnInterruptWhileItWorksLeavesNoFile) {
  Succeed("generate garage --poses 3000 --output in.g2o");
  for (const int signal : {SIGINT, SIGTERM}) {
    Interrupt({"solve", "in.g2o", "--mode", "incremental", "--output", "out.g2o", "--stats", "stats.json"}, signal,
              testing::After(std::chrono::milliseconds(300)));
    EXPECT_EQ(FileCount(), 1);
  }
}

TEST_F(SolveCommand, AnInterruptWhileItWritesLeavesNoHalfFile) {
  constexpr int kPoses = 100000;
  {
    std::ofstream file(folder_ / "in.g2o");
    for (int k = 1; k < kPoses; ++k) file << "EDGE_SE2 " << k - 1 << ' ' << k << " 1 0 0 1 0 0 1 0 1\n";
  }
  const auto temporary = [&] {
    std::error_code error;  // files come and go meanwhile
    for (const auto& entry : std::filesystem::directory_iterator(folder_)) {
      if (entry.path().string().find(".tmp-") != std::string::npos && entry.file_size(error) > 0 && !error) return true;
    }
    return Exists("out.g2o");
  };
  Interrupt({"solve", "in.g2o", "--output", "out.g2o", "--trajectory", "out.tum", "--stats", "stats.json"}, SIGINT,
            temporary);
  EXPECT_FALSE(Exists("stats.json"));
  EXPECT_EQ(FileCount(), 1 + Exists("out.g2o") + Exists("out.tum")) << "no temporary";
  // Whole if the signal came late.
  if (Exists("out.g2o")) {
    EXPECT_EQ(ReadAs<SE2>("out.g2o").Poses().size(), std::size_t(kPoses));
  }
  if (Exists("out.tum")) {
    EXPECT_EQ(ReadTrajectory(Path("out.tum")).stamps.size(), std::size_t(kPoses));
  }
}

TEST_F(SolveCommand, WritesARowPerStep) {
  MakeScene("manhattan");
  Succeed("solve in.g2o --mode incremental --every edge --steps steps.csv --stats stats.json");
  const auto stats = JsonFile("stats.json");
  const auto rows = CsvRows(Read("steps.csv"));
  ASSERT_EQ(rows.size(), stats["steps"].get<std::size_t>());
  EXPECT_EQ(rows.size(), stats["edges"].get<std::size_t>());
  const std::string header = Read("steps.csv").substr(0, Read("steps.csv").find('\n'));
  EXPECT_EQ(header.rfind("step,poses,factors,factor_ids,path,", 0), 0u) << header;
  for (std::size_t k = 0; k < rows.size(); ++k) {
    ASSERT_EQ(rows[k].size(), static_cast<std::size_t>(std::count(header.begin(), header.end(), ',') + 1));
    EXPECT_EQ(rows[k][0], std::to_string(k + 1));
    EXPECT_EQ(rows[k][2], std::to_string(k + 1));
    EXPECT_EQ(rows[k][3], std::to_string(k));
    EXPECT_GE(std::stod(rows[k].back()), 0);
  }
  EXPECT_EQ(rows.back()[1], std::to_string(stats["poses"].get<int>()));
}

TEST_F(SolveCommand, PoliciesAndGatesAllFinishAtTheOptimum) {
  MakeScene("manhattan");
  const double optimum = (Succeed("solve in.g2o --stats batch.json"), JsonFile("batch.json")["chi2"].get<double>());
  const auto run = [&](const std::string& options) {
    Succeed("solve in.g2o --mode incremental --steps steps.csv --stats stats.json " + options);
    EXPECT_NEAR(JsonFile("stats.json")["chi2"].get<double>(), optimum, 1e-6 * optimum) << options;
    int open = 0;
    for (const auto& row : CsvRows(Read("steps.csv"))) open += row[8] == "1" ? 1 : 0;
    return open;
  };
  const int steps = run("--policy gni --step-tolerance 1e-4 1e-5");
  for (const char* policy : {"default", "gn1", "gni-lcg", "gni-igg", "gni-spo", "gni-spo-lcg", "gni-spo-igg"}) {
    EXPECT_LE(run(std::string("--policy ") + policy), steps);
  }
  for (const char* gate : {"newton_decrement", "mutual_information", "log_determinant", "loop_closure"}) {
    EXPECT_LT(run(std::string("--policy gni-spo --gate-threshold 1e9 --gate ") + gate), steps) << gate;
    EXPECT_LE(run(std::string("--gate ") + gate), steps) << gate;
  }
  EXPECT_EQ(run("--policy gni-spo-igg --gate always"), steps);
  EXPECT_EQ(run("--policy gni --gate never"), 0);
  EXPECT_LE(run("--policy gni-spo --step-budget-ms 1000 --initial file --paper-flops"), steps);
  EXPECT_LE(run("--policy gni-spo --step-budget-ms 0 --initial file"), steps);
}

TEST_F(SolveCommand, RefusesStepOptionsThatMeanNothing) {
  MakeScene("manhattan");
  for (const char* option : {"--policy gni", "--gate always", "--gate-threshold 1", "--step-tolerance 1 1",
                             "--step-budget-ms 1", "--steps steps.csv", "--paper-flops"}) {
    ExpectFailure(std::string("solve in.g2o ") + option, 2, "needs --mode incremental");
  }
  const std::string incremental = "solve in.g2o --mode incremental ";
  ExpectFailure(incremental + "--policy gn2", 2, "gn2");
  ExpectFailure(incremental + "--gate open", 2, "open");
  ExpectFailure(incremental + "--gate-threshold nan", 2, "gate-threshold");
  ExpectFailure(incremental + "--step-tolerance 1", 2, "step-tolerance");
  ExpectFailure(incremental + "--step-tolerance 1 -1", 2, "step-tolerance");
  ExpectFailure(incremental + "--step-tolerance nan 1", 2, "step-tolerance");
  ExpectFailure(incremental + "--step-budget-ms -1", 2, "step-budget-ms");
  ExpectFailure(incremental + "--paper-flops", 2, "needs --steps");
  ExpectFailure(incremental + "--steps nowhere/steps.csv", 1, "nowhere");
  EXPECT_FALSE(Exists("steps.csv"));
}

// Wrong loops behind the true ones in the file.
TEST_F(SolveCommand, RobustKernelsLeaveWrongLoopsOut) {
  MakeScene("manhattan");
  Succeed("solve in.g2o --output clean.g2o --stats clean.json");
  const auto clean = ReadAs<SE2>("clean.g2o");
  auto graph = ReadAs<SE2>("in.g2o");
  const auto loops = LoopFactors(graph);
  const std::size_t first_wrong = graph.Factors().size();
  for (std::size_t k = 0; k < 10; ++k) {
    auto wrong = std::get<RelativePoseFactor<SE2>>(graph.FindFactor(loops[k])->factor);
    wrong.from = graph.Poses()[3 * k].id;
    wrong.to = graph.Poses()[140 - 7 * k].id;
    wrong.T_from_to = SE2(0.3, -0.2 * static_cast<double>(k), 0.1);
    graph.AddFactor(wrong);
  }
  WriteG2o(graph, Path("wrong.g2o"));
  for (const std::string mode : {"batch", "incremental", "incremental --every edge"}) {
    SCOPED_TRACE(mode);
    const auto outcome = Succeed("solve wrong.g2o --robust gnc --output out.g2o --stats stats.json --mode " + mode);
    const auto robust = JsonFile("stats.json")["robust"];
    EXPECT_EQ(robust["kernel"], "gnc");
    EXPECT_NEAR(robust["width"].get<double>(), 3.3682, 1e-4);
    EXPECT_EQ(robust["loops"], loops.size() + 10);
    EXPECT_EQ(robust["rejected"], robust["loops_rejected"].size());
    std::size_t found = 0;
    for (const auto& loop : robust["loops_rejected"]) {
      const auto& factor = graph.Factors()[loop["factor"].get<std::size_t>()].factor;
      EXPECT_EQ(PosesOf(factor).first.value, loop["from"].get<std::int64_t>());
      EXPECT_EQ(PosesOf(factor).second.value, loop["to"].get<std::int64_t>());
      EXPECT_EQ(loop["weight"], 0);
      found += loop["factor"] >= first_wrong ? 1 : 0;
    }
    EXPECT_EQ(found, 10u);
    EXPECT_LE(robust["rejected"], 10 + loops.size() / 20) << "of true loops one in a hundred, give or take";
    EXPECT_NE(outcome.out.find(" loops rejected"), std::string::npos) << outcome.out;
    const auto out = ReadAs<SE2>("out.g2o");
    for (std::size_t k = 0; k < out.Poses().size(); ++k) {
      EXPECT_LT(out.Poses()[k].T_world_body->Local(*clean.Poses()[k].T_world_body).norm(), 0.3);
    }
  }
  // The covariances are those without the wrong loops.
  Succeed("solve wrong.g2o --robust gnc --covariance-output batch.csv --quiet");
  Succeed("solve wrong.g2o --robust gnc --covariance-output steps.csv --quiet --mode incremental");
  const auto batch = CsvRows(Read("batch.csv")), steps = CsvRows(Read("steps.csv"));
  ASSERT_EQ(batch.size(), steps.size());
  for (std::size_t k = 0; k < batch.size(); ++k) {
    EXPECT_NEAR(std::stod(batch[k][1]), std::stod(steps[k][1]), 1e-6 * std::stod(batch[k][1]) + 1e-12);
  }
}

TEST_F(SolveCommand, RobustUsageIsChecked) {
  MakeScene("manhattan");
  for (const std::string kernel : {"huber", "cauchy", "tukey", "dcs"}) {
    Succeed("solve in.g2o --robust " + kernel + " --robust-width 4 --stats stats.json");
    EXPECT_EQ(JsonFile("stats.json")["robust"]["kernel"], kernel);
    EXPECT_EQ(JsonFile("stats.json")["robust"]["width"], 4);
  }
  Succeed("solve in.g2o --stats plain.json");
  Succeed("solve in.g2o --robust none --stats stats.json");
  EXPECT_FALSE(JsonFile("stats.json").contains("robust"));
  EXPECT_EQ(JsonFile("stats.json")["chi2"], JsonFile("plain.json")["chi2"]);
  ExpectFailure("solve in.g2o --robust welsch", 2, "--robust");
  ExpectFailure("solve in.g2o --robust gnc --robust-width 0", 2, "--robust-width");
  ExpectFailure("solve in.g2o --robust gnc --robust-width nan", 2, "--robust-width");
  ExpectFailure("solve in.g2o --robust-width 3", 2, "--robust");
}

}  // namespace
}  // namespace terse
