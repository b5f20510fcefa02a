// Budgets as users of the command see them: --poses-per-area and --error.

#include <gtest/gtest.h>

#include "testing_command.h"

namespace terse {
namespace {

class BudgetCommand : public testing::CommandTest {
 protected:
  void SetUp() override {
    CommandTest::SetUp();
    Succeed("generate manhattan --poses 600 --seed 5 --output in.g2o");
  }
  int Kept(const std::string& options, const std::string& folder) const {
    Succeed("compact in.g2o --strategy bounded --output " + folder + " " + options);
    return JsonFile(folder + "/stats.json")["poses_kept"].get<int>();
  }
};

TEST_F(BudgetCommand, MoreIsKeptWhereMoreIsAskedFor) {
  EXPECT_GT(Kept("--poses-per-area 4", "dense"), 1.5 * Kept("--poses-per-area 1.5", "sparse"));
  EXPECT_GT(Kept("--error 1.05", "good"), Kept("--error 4", "bad"));
  EXPECT_GT(Kept("--poses-per-area 3 --keep-links 2%", "both"), 0);
}

TEST_F(BudgetCommand, OnlineTakesThemAndItsJournalKnowsThem) {
  const std::string run =
      "online --dimension 2 --strategy bounded --range 3 3 3.2 --min-loop-gain 1 --min-pose-gain 2 ";
  const std::string stream = " < in.g2o";
  Succeed(run + "--poses-per-area 2 --journal run.journal" + stream);
  ExpectFailure(run + "--poses-per-area 3 --journal run.journal" + stream, 1, "poses_per_area");
  Succeed(run + "--error 1.5 --journal error.journal" + stream);
  ExpectFailure(run + "--error 1.2 --journal error.journal" + stream, 1, "error");
}

TEST_F(BudgetCommand, SaysWhatContradictsItself) {
  const std::string run = "compact in.g2o --output out ";
  ExpectFailure(run + "--poses-per-area 2 --keep-poses 10%", 2, "--poses-per-area");
  ExpectFailure(run + "--error 1.2 --keep-links 10%", 2, "--error");
  ExpectFailure(run + "--error 1.2 --poses-per-area 2", 2, "--error");
  ExpectFailure(run + "--error 1", 2, "above 1");
  ExpectFailure(run + "--error nan", 2, "above 1");
  ExpectFailure(run + "--poses-per-area 0", 2, "--poses-per-area");
  ExpectFailure(run + "--strategy apal --error 1.2", 1, "keeps all poses");
}

}  // namespace
}  // namespace terse
