// `terse-mpi solve` as mpirun starts it: the optimum of `terse solve` on one, two and four ranks, and what happens when
// a rank or a file is not as the others.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <regex>

#include "shared_data.h"
#include "terse/core/trajectory.h"
#include "testing_command.h"

namespace terse {
namespace {

class DistributedCommand : public testing::CommandTest {
 protected:
  void SetUp() override {
    CommandTest::SetUp();
    setenv("OMPI_ALLOW_RUN_AS_ROOT", "1", 1);
    setenv("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1", 1);
    // Ranks beyond the processors, as on a small machine.
    setenv("OMPI_MCA_rmaps_base_oversubscribe", "1", 1);
    setenv("OMPI_MCA_mpi_yield_when_idle", "1", 1);
  }

  testing::Outcome Shell(const std::string& line) const {
    const int status =
        std::system(("cd '" + folder_.string() + "' && { " + line + "; } > .out 2> .err < /dev/null").c_str());
    return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, Read(".out"), Read(".err")};
  }
  testing::Outcome Mpi(int ranks, const std::string& arguments) const {
    return Shell("timeout 300 mpirun -n " + std::to_string(ranks) + " '" TERSE_MPI "' solve " + arguments);
  }
  void MpiSucceeds(int ranks, const std::string& arguments) const {
    const testing::Outcome outcome = Mpi(ranks, arguments);
    EXPECT_EQ(outcome.exit_code, 0) << arguments << '\n' << outcome.out << outcome.err;
  }
  void ExpectMpiFailure(int ranks, const std::string& arguments, int exit_code, const std::string& cause) const {
    const testing::Outcome outcome = Mpi(ranks, arguments);
    EXPECT_EQ(outcome.exit_code, exit_code) << arguments << '\n' << outcome.err;
    EXPECT_NE(outcome.err.find("terse-mpi: error: " + cause), std::string::npos) << outcome.err;
  }

  static double CostOfChordalStart(const nlohmann::ordered_json& stats) {
    for (const auto& trial : stats["initial"].value("compared", nlohmann::ordered_json::array())) {
      if (trial["method"] == "chordal") return trial.value("cost_at_start", -1.0);
    }
    return -2;
  }

  // The same chi2 to 1e-9, and from the same start poses to a micrometre.
  void ExpectSameOptimum(int ranks, const std::string& file, const std::string& options = "",
                         const std::string& petsc = "") const {
    Succeed("solve " + file + " " + options + " --quiet --stats one.json --trajectory one.tum");
    MpiSucceeds(ranks, file + " " + options + " --quiet --stats many.json --trajectory many.tum " + petsc);
    const auto one = JsonFile("one.json"), many = JsonFile("many.json");
    const double chi2 = one["chi2"];
    EXPECT_NEAR(many["chi2"], chi2, 1e-9 * chi2 + 1e-12) << file << ", " << ranks << " ranks";
    EXPECT_TRUE(many["converged"]);
    EXPECT_EQ(many["poses"], one["poses"]);
    EXPECT_NEAR(many["normalized_chi2"], one["normalized_chi2"], 1e-9);
    EXPECT_EQ(many["ranks"].size(), static_cast<std::size_t>(ranks));
    double poses = 0;
    for (const auto& rank : many["ranks"]) poses += rank["poses"].get<double>();
    EXPECT_EQ(poses, many["poses"].get<double>());
    if (options.find("--initial") == std::string::npos) {
      // The relaxation that the ranks solve together is that of one machine.
      const double here = CostOfChordalStart(one), there = CostOfChordalStart(many);
      const double tolerance = petsc.empty() ? 1e-6 : 1e-3;
      EXPECT_NEAR(there, here, tolerance * here + 1e-12) << file << ", " << ranks << " ranks";
      return;
    }
    const Trajectory here = ReadTrajectory(Path("one.tum")), there = ReadTrajectory(Path("many.tum"));
    ASSERT_EQ(here.stamps, there.stamps);
    for (std::size_t k = 0; k < here.stamps.size(); ++k) {
      const double apart = here.T_world_body[k].Local(there.T_world_body[k]).norm();
      ASSERT_LT(apart, 1e-6) << file << ", " << ranks << " ranks, pose " << here.stamps[k];
    }
  }
};

TEST_F(DistributedCommand, FindsTheOptimumOfOneMachine) {
  Succeed("generate manhattan --poses 800 --seed 5 --output flat.g2o --quiet");
  Succeed("generate sphere --poses 300 --seed 6 --output round.g2o --quiet");
  for (const int ranks : {1, 2, 4}) {
    ExpectSameOptimum(ranks, "flat.g2o");
    ExpectSameOptimum(ranks, "round.g2o", "--rotation-information radians --initial chordal");
  }
  ExpectSameOptimum(2, "flat.g2o", "--initial compose");
  ExpectSameOptimum(3, "round.g2o");
}

TEST_F(DistributedCommand, TakesPetscsOwnSolvers) {
  Succeed("generate sphere --poses 200 --seed 6 --output round.g2o --quiet");
  ExpectSameOptimum(2, "round.g2o", "", "-pc_type gamg");
  ExpectSameOptimum(2, "round.g2o", "--initial file", "-mat_type aij -ksp_type cg");
  const testing::Outcome misspelt = Mpi(2, "round.g2o -pc_typo gamg");
  EXPECT_EQ(misspelt.exit_code, 0);
  EXPECT_NE(misspelt.err.find("PETSc did not use the option -pc_typo"), std::string::npos) << misspelt.err;
  ExpectMpiFailure(2, "round.g2o -pc_type nonsense", 1, "rank 0: PETSc: Unable to find requested PC type nonsense");
  ExpectMpiFailure(2, "round.g2o -pc_type jacobi -ksp_max_it 2", 3, "the linear solver fails: DIVERGED_ITS");
}

// The better one of the file's values and the chordal ones.
TEST_F(DistributedCommand, ChoosesItsStart) {
  Succeed("generate sphere --poses 200 --seed 6 --output drift.g2o --quiet");
  MpiSucceeds(2, "drift.g2o --quiet --output solved.g2o --stats drift.json");
  EXPECT_EQ(JsonFile("drift.json")["initial"]["method"], "chordal");
  MpiSucceeds(2, "solved.g2o --quiet --stats solved.json");
  const auto solved = JsonFile("solved.json");
  EXPECT_EQ(solved["initial"]["method"], "file");
  EXPECT_LE(solved["iterations"].get<int>(), 2);
  EXPECT_NEAR(solved["chi2"].get<double>(), JsonFile("drift.json")["chi2"].get<double>(), 1e-6);
}

// Priors anywhere, in any order, with and without a sensor's place, fixed poses, values missing; more ranks than poses.
TEST_F(DistributedCommand, KnowsAllThatAGraphHolds) {
  Write("gnss.g2o",
        "EDGE_SE3_PRIOR 2 7 2.1 0.1 0 0 0 0 1 9 0 0 0 0 0 9 0 0 0 0 9 0 0 0 9 0 0 9 0 9\n"
        "VERTEX_SE3:QUAT 5 0.2 0 0 0 0 0 1\nVERTEX_LANDMARK 77 1 2 3\n"
        "EDGE_SE3:QUAT 5 1 1 0 0 0 0 0.1 0.99498743710662 10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 40 0 0 40 0 40\n"
        "EDGE_SE3:QUAT 1 2 1 0.2 0 0 0.05 0 0.99874921777191 10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 40 0 0 40 0 40\n"
        "EDGE_SE3:QUAT 2 5 -1.7 0.4 0 0 0 -0.1 0.99498743710662 10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 40 0 0 40 0 40\n"
        "PARAMS_SE3OFFSET 7 0.1 0 0.2 0 0 0.1 0.99498743710662\n"
        "EDGE_PRIOR_SE3_XYZ 1 1.1 0.1 0.1 4 0 0 4 0 4\nFIX 5 77\n");
  // Positions alone, which the relaxation is laid over.
  Write("positions.g2o",
        "EDGE_SE3:QUAT 1 2 1 0.2 0 0 0.05 0 0.99874921777191 10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 40 0 0 40 0 40\n"
        "EDGE_SE3:QUAT 2 3 1 0.4 0 0 0 0.1 0.99498743710662 10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 40 0 0 40 0 40\n"
        "EDGE_SE3:QUAT 3 1 -1.9 0.4 0.1 0 0 -0.1 0.99498743710662 10 0 0 0 0 0 10 0 0 0 0 10 0 0 0 40 0 0 40 0 40\n"
        "EDGE_PRIOR_SE3_XYZ 1 11.1 0.1 0.1 4 0 0 4 0 4\nEDGE_PRIOR_SE3_XYZ 2 11.2 0.9 0.1 4 0 0 4 0 4\n"
        "EDGE_PRIOR_SE3_XYZ 3 10.7 1.8 0.3 4 0 0 4 0 4\n");
  for (const int ranks : {1, 2, 4}) {
    ExpectSameOptimum(ranks, "gnss.g2o");
    ExpectSameOptimum(ranks, "positions.g2o");
  }
  ExpectSameOptimum(2, "gnss.g2o", "--initial chordal");
  ExpectMpiFailure(2, "gnss.g2o --initial file", 1, "rank 0: gnss.g2o: pose 1 has no value");
}

TEST_F(DistributedCommand, WritesGraphAndCovariances) {
  Succeed("generate sphere --poses 120 --seed 2 --output round.g2o --quiet");
  Succeed("solve round.g2o --quiet --stats one.json");
  MpiSucceeds(3, "round.g2o --quiet --output solved.g2o --covariance-ids 0,60,119 --covariance-output many.csv");
  const auto info = Json("info solved.g2o --json");
  EXPECT_EQ(info["poses"], 120);
  const double chi2 = JsonFile("one.json")["chi2"];
  EXPECT_NEAR(info["chi2"].get<double>(), chi2, 1e-9 * chi2);
  Succeed("covariance round.g2o --solve --ids 0,60,119 --output one.csv --quiet");
  const auto one = testing::CsvRows(Read("one.csv")), many = testing::CsvRows(Read("many.csv"));
  ASSERT_EQ(many.size(), 3u);
  for (std::size_t row = 0; row < many.size(); ++row) {
    ASSERT_EQ(many[row].size(), 37u);
    EXPECT_EQ(many[row][0], one[row][0]);
    double scale = 0;
    for (std::size_t k = 1; k < 37; ++k) scale = std::max(scale, std::abs(std::stod(one[row][k])));
    for (std::size_t k = 1; k < 37; ++k) {
      EXPECT_NEAR(std::stod(many[row][k]), std::stod(one[row][k]), 1e-7 * scale) << row << ' ' << k;
    }
  }
}

TEST_F(DistributedCommand, WhatOneRankFindsWrongAllSay) {
  ExpectMpiFailure(2, "absent.g2o", 1, "rank 0: absent.g2o: the file does not exist");
  ExpectMpiFailure(2, "", 2, "FILE is required");
  Succeed("generate manhattan --poses 100 --seed 5 --output good.g2o --quiet");
  const std::string good = Read("good.g2o");
  // In the share of the second alone.
  const long lines = std::count(good.begin(), good.end(), '\n');
  Write("bad.g2o", good + "EDGE_SE2 98 99 1 0 0 -1 0 0 1 0 1\n");
  ExpectMpiFailure(2, "bad.g2o", 1, "rank 1: bad.g2o:" + std::to_string(lines + 1) + ": ");
  Write("parts.g2o", good + "EDGE_SE2 200 201 1 0 0 1 0 0 1 0 1\n");
  ExpectMpiFailure(2, "parts.g2o", 1, "rank 0: parts.g2o: the graph falls into 2 components; expected one");
  Write("toro.graph", "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 0 0 1 0 1 1 0 0\n");
  ExpectMpiFailure(2, "toro.graph", 1, "rank 0: toro.graph: no line is of the g2o format");
  ExpectMpiFailure(2, "good.g2o --covariance-ids 5,1000", 1,
                   "rank 0: good.g2o: --covariance-ids: there is no pose 1000");
  ExpectMpiFailure(2, "good.g2o --stats absent/stats.json", 1, "rank 0: absent/stats.json: ");
  // Two machines with different files under one path.
  std::filesystem::create_directory(folder_ / "there");
  Write("there/good.g2o", good + "# more\n");
  const std::string rank = "-n 1 '" TERSE_MPI "' solve good.g2o --output solved.g2o";
  const testing::Outcome outcome = Shell("timeout 60 mpirun " + rank + " : -wdir there " + rank);
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_NE(outcome.err.find("good.g2o: ranks 0 and 1 read different files under this path"), std::string::npos)
      << outcome.err;
  EXPECT_FALSE(Exists("there/solved.g2o"));
  EXPECT_FALSE(Exists("solved.g2o"));
}

TEST_F(DistributedCommand, HasTheOptionsThatItsPageNames) {
  const std::string help = Shell("'" TERSE_MPI "' solve --help").out;
  const std::string page = testing::Slurp(TERSE_SOURCE_DIR "/docs/howto/mpi.md");
  const std::regex option("`(--[a-z-]+)");
  long named = 0;
  for (std::sregex_iterator found(page.begin(), page.end(), option), end; found != end; ++found, ++named) {
    EXPECT_NE(help.find((*found)[1].str() + " "), std::string::npos) << (*found)[1];
  }
  EXPECT_GE(named, 2);
}

// One killed in the middle.
TEST_F(DistributedCommand, ARankThatDiesEndsAllOfThem) {
  Succeed("generate manhattan --poses 60000 --area 87x87 --seed 5 --output large.g2o --quiet");
  Write("killer.sh",
        "[ $OMPI_COMM_WORLD_RANK = 0 ] || { sleep 2; kill -9 $$; } &\n"
        "exec '" TERSE_MPI "' solve large.g2o --output solved.g2o --stats stats.json\n");
  const testing::Outcome outcome = Shell("timeout 120 mpirun -n 2 sh killer.sh");
  EXPECT_NE(outcome.exit_code, 0);
  EXPECT_NE(outcome.exit_code, 124) << "the other waits for ever";
  EXPECT_NE(outcome.err.find("told to stop: another rank died"), std::string::npos) << outcome.err;
  EXPECT_FALSE(Exists("solved.g2o"));
  EXPECT_FALSE(Exists("stats.json"));
  EXPECT_EQ(FileCount(), 2) << "nothing of a half-written file stays";
}

TEST_F(DistributedCommand, WorksOverANetwork) {
  Succeed("generate manhattan --poses 500 --seed 5 --output flat.g2o --quiet");
  Succeed("solve flat.g2o --quiet --stats one.json");
  const testing::Outcome outcome =
      Shell("timeout 120 '" TERSE_SOURCE_DIR "/tests/two_hosts.sh' '" TERSE_MPI "' solve flat.g2o --stats many.json");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.err;
  const double chi2 = JsonFile("one.json")["chi2"];
  EXPECT_NEAR(JsonFile("many.json")["chi2"], chi2, 1e-9 * chi2);
  const std::size_t sent = outcome.err.find("sent ");
  ASSERT_NE(sent, std::string::npos);
  EXPECT_GT(std::stol(outcome.err.substr(sent + 5)), 10000) << "the ranks did not talk over the network";
}

TEST_F(DistributedCommand, AgreesOnPublicGraphs) {
  TERSE_NEEDS(intel, "graphs/2d/intel.g2o");
  TERSE_NEEDS(garage, "graphs/3d/parking-garage.g2o");
  TERSE_NEEDS(mit, "graphs/igg_spo/MIT.g2o");
  for (const std::string& path : {intel, garage, mit}) ExpectSameOptimum(2, "'" + path + "'");
  for (const std::string& path : {intel, garage}) ExpectSameOptimum(2, "'" + path + "'", "--initial chordal");
}

}  // namespace
}  // namespace terse
