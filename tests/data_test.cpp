// The generated inputs in data/ are what the command in data/README.md makes.

#include <gtest/gtest.h>

#include "testing_command.h"

namespace {

using DataTest = terse::testing::CommandTest;

TEST_F(DataTest, TheEllipseIsMadeByTheCommandInTheReadme) {
  const std::filesystem::path data = std::filesystem::path(TERSE_SOURCE_DIR) / "data";
  const std::string arguments = "generate ellipse --seed 1 --output ellipse.g2o --ground-truth ellipse.tum";
  EXPECT_NE(terse::testing::Slurp(data / "README.md").find("`terse " + arguments + "`"), std::string::npos);
  Succeed(arguments);
  for (const char* name : {"ellipse.g2o", "ellipse.tum"}) {
    EXPECT_TRUE(Read(name) == terse::testing::Slurp(data / name)) << name << " differs";  // too long to print
  }
}

}  // namespace
