// The terse command as a whole, and info, convert, evaluate and generate.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <sstream>
#include <string>
#include <vector>

#include "testing_command.h"

namespace {

namespace fs = std::filesystem;

using terse::testing::Outcome;

class Command : public terse::testing::CommandTest {};

constexpr char kSquare[] =
    "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 1.5\nVERTEX_SE2 2 1 1 3\n"
    "EDGE_SE2 0 1 1 0 1.5 100 0 0 100 0 400\nEDGE_SE2 1 2 1 0 1.5 100 0 0 100 0 400\n"
    "EDGE_SE2 0 2 1 1 3.1 100 0 0 100 0 400\n";

TEST_F(Command, HelpAndVersion) {
  const Outcome help = Run("--help");
  EXPECT_EQ(help.exit_code, 0);
  for (const char* name : {"info", "solve", "compact", "online", "convert", "evaluate", "generate"}) {
    EXPECT_NE(help.out.find(name), std::string::npos);
    const Outcome own = Run(std::string(name) + " --help");
    EXPECT_EQ(own.exit_code, 0);
    EXPECT_NE(own.out.find("Example: "), std::string::npos) << own.out;  // help_test.cpp runs it
  }
  EXPECT_EQ(Run("--version").out, "terse " TERSE_VERSION "\n");
}

// A copy of the command finds no terse-stereo beside it.
TEST_F(Command, WithoutTheStereoProgramAllElseWorks) {
  fs::copy_file(TERSE_COMMAND, Path("terse"));
  Write("square.g2o", kSquare);
  const auto run = [&](const std::string& arguments) {
    return std::system(("cd '" + folder_.string() + "' && ./terse " + arguments + " > .out 2> .err").c_str());
  };
  EXPECT_EQ(run("info square.g2o"), 0) << Read(".err");
  EXPECT_EQ(run("kitti --help"), 0) << Read(".err");
  for (const char* arguments : {"kitti street --output map", "generate stereo --output street"}) {
    const int status = run(arguments);
    EXPECT_EQ(WIFEXITED(status) ? WEXITSTATUS(status) : -1, 1) << arguments;
    EXPECT_EQ(Read(".err").rfind("terse: error: the stereo front end, ", 0), 0u) << Read(".err");
    EXPECT_NE(Read(".err").find("/terse/terse-stereo: No such file or directory; "), std::string::npos) << Read(".err");
  }
}

TEST_F(Command, UsageErrorsExitWith2) {
  ExpectFailure("", 2, "subcommand is required");
  ExpectFailure("inof x", 2, "unknown subcommand inof; did you mean info?");
  ExpectFailure("info", 2, "FILE is required");
  ExpectFailure("info a.g2o --jsn", 2, "unknown option --jsn; did you mean --json?");
  ExpectFailure("generate torus --pose 4", 2, "unknown option --pose; did you mean --poses?");
  ExpectFailure("generate torus --outptu=x.g2o", 2, "did you mean --output?");
  ExpectFailure("generate donut", 2, "donut");
  ExpectFailure("generate torus --poses 1", 2, "--poses");
  ExpectFailure("generate torus --poses many", 2, "many");
  ExpectFailure("generate torus --seed -1", 2, "-1 is not a whole number");
  ExpectFailure("generate torus --seed 18446744073709551616", 2, "--seed");
  ExpectFailure("evaluate a b --align sim3", 2, "sim3");
  ExpectFailure("info a --rotation-information degrees", 2, "degrees");
  ExpectFailure("convert a b c", 2, "unexpected argument c");
}

TEST_F(Command, InfoCounts) {
  Write("square.g2o", kSquare);
  const auto json = Json("info square.g2o --json");
  EXPECT_EQ(json["format"], "g2o");
  EXPECT_EQ(json["dimension"], 2);
  EXPECT_EQ(json["poses"], 3);
  EXPECT_EQ(json["edges"], 3);
  EXPECT_EQ(json["loop_edges"], 1);
  EXPECT_EQ(json["priors"], 0);
  EXPECT_EQ(json["components"], 1);
  EXPECT_EQ(json["initial_values"], true);
  EXPECT_EQ(json["file_bytes"], sizeof(kSquare) - 1);
  // By hand: edge 0-1 fits; 1-2 is off by (sin 1.5 - 1, cos 1.5) in x, y; 0-2 by -0.1 rad.
  const double expected = 100 * (2 - 2 * std::sin(1.5)) + 400 * 0.01;
  EXPECT_NEAR(json["chi2"].get<double>(), expected, 1e-9 * expected);
  const Outcome table = Run("info square.g2o");
  EXPECT_EQ(table.exit_code, 0);
  EXPECT_NE(table.out.find("loop edges              1\n"), std::string::npos) << table.out;
}

TEST_F(Command, InfoWithoutValuesHasNoChi2) {
  Write("edges.g2o", "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nMYTAG 3\n");
  const auto json = Json("info edges.g2o --json");
  EXPECT_EQ(json["initial_values"], false);
  EXPECT_TRUE(json["chi2"].is_null());
  EXPECT_EQ(json["duplicates"], 1);
  EXPECT_EQ(json["skipped_tags"]["MYTAG"], 1);
}

TEST_F(Command, BadInputExitsWith1AndNamesTheLine) {
  Write("bad.g2o", "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 zero 0\n");
  Write("indefinite.g2o", "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n");
  Write("empty.g2o", "");
  ExpectFailure("info missing.g2o", 1, "missing.g2o: ");
  ExpectFailure("info bad.g2o", 1, "bad.g2o:2: ");
  ExpectFailure("info indefinite.g2o", 1, "indefinite.g2o:3: ");
  ExpectFailure("info .", 1, ".: ");
  ExpectFailure("info empty.g2o", 1, "empty.g2o: ");
  ExpectFailure("evaluate missing.tum bad.g2o", 1, "missing.tum: ");
  EXPECT_EQ(Json("info indefinite.g2o --repair-information --json")["repaired_informations"], 1);
}

TEST_F(Command, RotationInformationChangesChi2) {
  const std::string pose = " 0 0 0 0 0 0 1\n";
  Write("turn.g2o", "VERTEX_SE3:QUAT 0" + pose + "VERTEX_SE3:QUAT 1" + pose +
                        "EDGE_SE3:QUAT 0 1 0 0 0 0.6 0 0 0.8 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n");
  const double quaternion = Json("info turn.g2o --json")["chi2"];
  const double radians = Json("info turn.g2o --rotation-information radians --json")["chi2"];
  EXPECT_NEAR(radians, std::pow(2 * std::asin(0.6), 2), 1e-12);
  EXPECT_NEAR(quaternion, radians / 4, 1e-12);
}

TEST_F(Command, ConvertGoesThereAndBack) {
  Write("square.g2o", kSquare);
  EXPECT_EQ(Run("convert square.g2o square.graph").exit_code, 0);
  EXPECT_EQ(Run("convert square.graph back.g2o").exit_code, 0);
  EXPECT_EQ(Json("info square.graph --json")["format"], "TORO");
  EXPECT_EQ(Json("info square.g2o --json")["chi2"], Json("info back.g2o --json")["chi2"]);
  EXPECT_EQ(Run("convert square.g2o square.tum").exit_code, 0);
  EXPECT_EQ(Run("convert square.g2o a.kitti").exit_code, 0);
  EXPECT_EQ(Run("convert square.tum b.txt").exit_code, 0);
  EXPECT_EQ(Read("square.tum").substr(0, 18), "0 0 0 0 0 0 0 1\n1 ");
  const std::string kitti = Read("a.kitti");
  EXPECT_EQ(std::count(kitti.begin(), kitti.end(), '\n'), 3);
}

TEST_F(Command, PackedGraphsAreReadWhereverGraphsAre) {
  Succeed("generate manhattan --poses 400 --output town.g2o --quiet");
  Succeed("convert town.g2o town.packed");
  EXPECT_EQ(Json("info town.packed --json")["format"], "packed");
  Succeed("convert town.packed back.g2o");
  for (const char* of : {"g2o", "packed"}) {
    Succeed(std::string("solve town.") + of + " --trajectory " + of + ".tum --quiet");
    Succeed(std::string("compact town.") + of + " --quiet --output " + of);
  }
  EXPECT_LT(Json("evaluate packed.tum g2o.tum --json")["ate"]["translation_m"], 1e-3)
      << "of some centimetres that it is off";
  Succeed("convert town.g2o coarse.packed --precision 0.5");
  EXPECT_LT(Read("coarse.packed").size(), Read("town.packed").size());
  ExpectFailure("convert town.g2o x.packed --precision 0", 2, "--precision");
  ExpectFailure("convert town.g2o x.g2o --precision 0.1", 1, "--precision is for a .packed graph, OUT is x.g2o");
  ExpectFailure("convert town.packed x.tum", 1, "pose 0 has no value");
  Write("damaged.packed", Read("town.packed").substr(0, 500));
  ExpectFailure("solve damaged.packed", 1, "damaged.packed: the file is truncated");
}

TEST_F(Command, VerticesAloneAreATrajectory) {
  Write("vertices.g2o", "VERTEX_SE2 1 1 0 0\nVERTEX_SE2 0 0 0 0\nVERTEX_SE2 2 2 0.5 0\nVERTEX_XY 7 0 0\nFIX 0 7\n");
  EXPECT_EQ(Run("convert vertices.g2o vertices.tum").exit_code, 0);
  EXPECT_EQ(Read("vertices.tum").substr(0, 18), "0 0 0 0 0 0 0 1\n1 ");
  EXPECT_EQ(Json("evaluate vertices.g2o vertices.tum --json")["poses"], 3);
  EXPECT_LT(Json("evaluate vertices.tum vertices.g2o --json")["ate"]["translation_m"], 1e-12);
  ExpectFailure("convert vertices.g2o again.g2o", 1, "3 poses but no edges");
  ExpectFailure("solve vertices.g2o", 1, "3 poses but no edges");
}

TEST_F(Command, FixOfALandmarkIsSkippedWithACount) {
  Write("landmarks.g2o", std::string(kSquare) + "VERTEX_XY 70 1 1\nVERTEX_XY 71 1 1\nFIX 70\n");
  EXPECT_EQ(Json("info landmarks.g2o --json")["skipped_tags"]["FIX"], 1);
  const Outcome solved = Succeed("solve landmarks.g2o");
  EXPECT_NE(solved.err.find("not known here were skipped: FIX of such vertices 1, VERTEX_XY 2"), std::string::npos)
      << solved.err;
}

TEST_F(Command, EvaluateHintsAtOtherFrames) {
  Succeed("generate sphere --poses 100 --output s.g2o --ground-truth s.tum");
  EXPECT_EQ(Succeed("evaluate s.g2o s.tum").err, "");
  std::istringstream lines(Read("s.tum"));
  std::ostringstream feet;
  feet.precision(17);
  for (std::string line; std::getline(lines, line);) {
    std::istringstream numbers(line);
    for (int k = 0; k < 8; ++k) {
      double value = 0;
      numbers >> value;
      feet << (k > 0 ? " " : "") << (k >= 1 && k <= 3 ? value / 0.3048 : value);
    }
    feet << '\n';
  }
  Write("feet.tum", feet.str());
  const Outcome outcome = Succeed("evaluate feet.tum s.tum --json");
  EXPECT_NE(
      outcome.err.find("terse: hint: these look like data of different frames: lengths of the reference are 0.305"),
      std::string::npos)
      << outcome.err;
  EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << "one line";
  EXPECT_EQ(nlohmann::json::parse(outcome.out)["poses"], 100);
}

TEST_F(Command, ConvertRefusesAndLeavesNothing) {
  Write("square.g2o", kSquare);
  Write("edges.g2o", "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
  Write("path.tum", "0 0 0 0 0 0 0 1\n");
  ExpectFailure("convert square.g2o square.xyz", 1, "extension");
  ExpectFailure("convert square.g2o nowhere/square.tum", 1, "nowhere");
  ExpectFailure("convert edges.g2o edges.tum", 1, "pose 0 has no value");
  ExpectFailure("convert path.tum path.g2o", 1, "no edges");
  EXPECT_EQ(FileCount(), 3);
}

TEST_F(Command, EvaluateOfATrajectoryWithItselfIsZero) {
  ASSERT_EQ(Run("generate sphere --poses 400 --output s.g2o --ground-truth s.tum").exit_code, 0);
  const auto same = Json("evaluate s.tum s.tum --kitti --json");
  EXPECT_EQ(same["poses"], 400);
  // 50 m, about 1e-14 relative, and the square root of it in the angle of a trace.
  for (const char* key : {"ate", "rpe", "rpe_all"}) {
    EXPECT_NEAR(same[key]["translation_m"].get<double>(), 0, 1e-9) << key;
    EXPECT_NEAR(same[key]["rotation_deg"].get<double>(), 0, 1e-5) << key;
  }
  EXPECT_GT(same["kitti"]["segments"], 0);
  for (const char* align : {"se3", "se2", "none"}) {
    const auto noisy = Json("evaluate s.g2o s.tum --json --align " + std::string(align));
    EXPECT_GT(noisy["ate"]["translation_m"], 0.1);
    EXPECT_GT(noisy["rpe_all"]["rotation_deg"], 0.1);
    EXPECT_FALSE(noisy.contains("kitti"));
  }
  const Outcome table = Run("evaluate s.g2o s.tum --kitti");
  EXPECT_EQ(table.exit_code, 0);
  for (const char* word : {"400 matched", "ATE", "RPE", "KITTI"}) {
    EXPECT_NE(table.out.find(word), std::string::npos) << table.out;
  }
}

TEST_F(Command, KittiErrorOfAShortPathIsNull) {
  ASSERT_EQ(Run("generate ellipse --output e.g2o --ground-truth e.tum").exit_code, 0);
  const auto json = Json("evaluate e.g2o e.tum --kitti --json");
  EXPECT_TRUE(json["kitti"]["t_rel_percent"].is_null());
  EXPECT_NE(Run("evaluate e.g2o e.tum --kitti").out.find("shorter than 100 m"), std::string::npos);
}

TEST_F(Command, GenerateMakesReadableGraphs) {
  for (const std::string scene : {"ellipse", "ellipse-n", "sphere", "torus", "manhattan", "garage"}) {
    const std::string arguments = "generate " + scene + (scene == "ellipse" ? "" : " --poses 300");
    const Outcome outcome = Run(arguments + " --output g.g2o --ground-truth g.tum");
    ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
    EXPECT_EQ(outcome.out + outcome.err, "") << "no progress where standard error is no terminal";
    const auto json = Json("info g.g2o --json");
    EXPECT_EQ(json["poses"], scene == "ellipse" ? 170 : 300);
    EXPECT_EQ(json["dimension"], scene == "manhattan" ? 2 : 3);
    EXPECT_EQ(json["components"], 1);
    EXPECT_EQ(json["initial_values"], true);
    EXPECT_GT(json["loop_edges"], 0) << scene;
    EXPECT_EQ(Json("evaluate g.g2o g.tum --json")["poses"], json["poses"]);
    EXPECT_EQ(Run(arguments).out, Read("g.g2o")) << "standard output is the default, same seed same bytes";
    EXPECT_NE(Run(arguments + " --seed 2").out, Read("g.g2o"));
  }
}

TEST_F(Command, GenerateStaysInAnArea) {
  Succeed("generate manhattan --area 6x4 --poses 500 --output g.g2o --ground-truth g.tum");
  EXPECT_EQ(Json("info g.g2o --json")["poses"], 500);
  std::istringstream truth(Read("g.tum"));
  for (std::string line; std::getline(truth, line);) {
    std::istringstream words(line);
    double id, x, y;
    words >> id >> x >> y;
    EXPECT_TRUE(std::abs(x) <= 3 && std::abs(y) <= 2) << line;
  }
  for (const std::string area : {"6", "6x", "x4", "0x4", "6x-4", "6x4x2", "6.5x4", "axb", "6 x4"}) {
    ExpectFailure("generate manhattan --area '" + area + "'", 2, "'" + area + "' is no area");
  }
  ExpectFailure("generate sphere --area 6x4", 1, "only the scene manhattan has an area");
  ExpectFailure("generate --from g.g2o --outliers 10 --area 6x4", 2, "excludes");
}

std::vector<std::string> Lines(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

// The lines of `with` that are not those of `clean`, which come in the same order.
std::vector<std::string> Added(const std::string& clean, const std::string& with) {
  std::vector<std::string> added;
  const auto all = Lines(clean);
  std::size_t next = 0;
  for (const std::string& line : Lines(with)) {
    if (next < all.size() && line == all[next]) {
      ++next;
    } else {
      added.push_back(line);
    }
  }
  EXPECT_EQ(next, all.size());
  return added;
}

TEST_F(Command, GenerateAddsWrongLoops) {
  Succeed("generate manhattan --poses 600 --seed 5 --output clean.g2o --ground-truth clean.tum");
  const double loops = Json("info clean.g2o --json")["loop_edges"];
  Succeed(
      "generate manhattan --poses 600 --seed 5 --output a.g2o --ground-truth a.tum --outliers 30 --outliers-list "
      "a.csv");
  Succeed("generate --from clean.g2o --seed 5 --output b.g2o --outliers 30 --outliers-list b.csv");
  EXPECT_EQ(Read("a.tum"), Read("clean.tum"));
  for (const std::string name : {"a", "b"}) {
    const auto list = Lines(Read(name + ".csv"));
    ASSERT_FALSE(list.empty());
    EXPECT_EQ(list[0], "from,to");
    EXPECT_EQ(static_cast<double>(list.size()) - 1, std::round(0.3 * loops));
    // A file's vertices come first.
    if (name == "b") Succeed("generate --from clean.g2o --outliers 0 --output same.g2o");
    const auto added = Added(Read(name == "b" ? "same.g2o" : "clean.g2o"), Read(name + ".g2o"));
    ASSERT_EQ(added.size(), list.size() - 1);
    for (std::size_t k = 0; k < added.size(); ++k) {
      std::string pair = added[k].substr(added[k].find(' ') + 1);
      std::istringstream fields(pair);
      std::string from, to;
      fields >> from >> to;
      EXPECT_EQ(from + "," + to, list[k + 1]);
    }
  }
  EXPECT_EQ(Succeed("generate --from clean.g2o --seed 5 --outliers 30").out, Read("b.g2o"));
  EXPECT_NE(Succeed("generate --from clean.g2o --seed 6 --outliers 30").out, Read("b.g2o"));
}

TEST_F(Command, GenerateAddsWrongLoopsOfAKind) {
  Succeed("generate manhattan --poses 600 --seed 5 --outliers 30 --outlier-kind local --outliers-list local.csv");
  const auto list = Lines(Read("local.csv"));
  ASSERT_GT(list.size(), 20u);
  for (std::size_t k = 1; k < list.size(); ++k) {
    const std::size_t comma = list[k].find(',');
    const long apart = std::labs(std::stol(list[k]) - std::stol(list[k].substr(comma + 1)));
    EXPECT_TRUE(apart >= 20 && apart <= 50) << list[k];
  }
  const std::string plain = Succeed("generate manhattan --poses 600 --seed 5 --outliers 30").out;
  EXPECT_EQ(Succeed("generate manhattan --poses 600 --seed 5 --outliers 30 --outlier-kind random").out, plain);
  EXPECT_NE(Succeed("generate manhattan --poses 600 --seed 5 --outliers 30 --outlier-kind grouped").out, plain);
  ExpectFailure("generate sphere --outlier-kind aliased", 2, "--outliers");
  ExpectFailure("generate sphere --outliers 10 --outlier-kind evil", 2, "evil");
}

TEST_F(Command, WrongLoopsThatCannotBeMade) {
  Write("square.g2o", kSquare);
  ExpectFailure("generate", 2, "SCENE or --from FILE is required");
  ExpectFailure("generate sphere --outliers -1", 2, "-1");
  ExpectFailure("generate sphere --outliers nan", 1, "negative");
  ExpectFailure("generate sphere --outliers many", 2, "many");
  ExpectFailure("generate sphere --outliers-list x.csv", 2, "--outliers");
  ExpectFailure("generate --from square.g2o", 2, "--outliers");
  ExpectFailure("generate sphere --from square.g2o --outliers 10", 2, "excludes");
  ExpectFailure("generate --from square.g2o --outliers 10 --poses 5", 2, "excludes");
  ExpectFailure("generate --from absent.g2o --outliers 10", 1, "absent.g2o: ");
  ExpectFailure("generate --from square.g2o --outliers 100 --output x.g2o", 1, "square.g2o: 1 wrong loops asked for");
  ExpectFailure("generate sphere --poses 2 --outliers 10 --output x.g2o --outliers-list x.csv", 1, "no loops");
  EXPECT_EQ(FileCount(), 1);
}

TEST_F(Command, VerticesAreDeadReckoned) {
  // Fewer poses than the least gap of a link: odometry only, which the vertices fit. Rounding to nine decimals
  // leaves residuals of 1e-9, weighted with at most 2500.
  ASSERT_EQ(Run("generate manhattan --poses 10 --output g.g2o").exit_code, 0);
  EXPECT_LT(Json("info g.g2o --json")["chi2"], 1e-12);
}

TEST_F(Command, AFullDiskIsAnError) {
  ASSERT_TRUE(fs::exists("/dev/full"));
  const std::string line = "'" TERSE_COMMAND "' generate ellipse > /dev/full 2> '" + (folder_ / "e").string() + "'";
  const int status = std::system(line.c_str());
  EXPECT_EQ(WEXITSTATUS(status), 1);
  EXPECT_NE(Read("e").find("cannot write"), std::string::npos);
}

// Interrupted while it writes, the command leaves neither a half-written file nor a temporary.
TEST_F(Command, AnInterruptLeavesNoFile) {
  for (const int signal : {SIGINT, SIGTERM}) {
    // Once it writes; it cannot be done soon, with so many poses.
    Interrupt({"generate", "manhattan", "--poses", "10000000", "--output", "g.g2o"}, signal,
              [&] { return FileCount() > 0; });
    EXPECT_EQ(FileCount(), 0);
  }
}

}  // namespace
