// Lines of g2o one at a time, against the same lines as a file.

#include "terse/core/measurement_line.h"

#include <gtest/gtest.h>

#include <sstream>

#include "testing.h"
#include "testing_files.h"

namespace terse {
namespace {

using namespace testing;

template <class Pose>
void ExpectSameAsFile() {
  Random rng(3);
  RandomGraphOptions options;
  options.priors = true;
  auto graph = MakeRandomGraph<Pose>(rng, options).graph;
  graph.SetFixed(graph.Poses()[4].id, true);
  const TestFile file(std::to_string(Pose::kDim) + "d_lines.g2o");
  WriteG2o(graph, file.Path());
  const auto read = std::get<PoseGraph<Pose>>(ReadGraph(file.Path()).graph);
  MeasurementLineReader<Pose> reader("robot");
  std::istringstream lines(file.Content());
  std::size_t vertices = 0, factors = 0, fixed = 0;
  long number = 0;
  for (std::string text; std::getline(lines, text);) {
    const MeasurementLine<Pose> line = reader.Read(text, ++number);
    if (const auto* vertex = std::get_if<VertexLine<Pose>>(&line)) {
      EXPECT_EQ(DimensionOfLine(text), Pose::kDim);
      EXPECT_EQ(vertex->id, read.Poses()[vertices].id);
      EXPECT_EQ(vertex->T_world_body.Log(), read.Poses()[vertices++].T_world_body->Log());
    } else if (const auto* fix = std::get_if<FixLine>(&line)) {
      EXPECT_EQ(DimensionOfLine(text), 0);
      EXPECT_EQ(fix->poses, std::vector<PoseId>{graph.Poses()[4].id});
      ++fixed;
    } else if (const auto* factor = std::get_if<Factor<Pose>>(&line)) {
      const Factor<Pose>& expected = read.Factors()[factors++].factor;
      ASSERT_EQ(factor->index(), expected.index());
      EXPECT_EQ(PosesOf(*factor).first, PosesOf(expected).first);
      EXPECT_EQ(std::visit([](const auto& f) { return f.information.norm(); }, *factor),
                std::visit([](const auto& f) { return f.information.norm(); }, expected));
    }
  }
  EXPECT_EQ(vertices, read.Poses().size());
  EXPECT_EQ(factors, read.Factors().size());
  EXPECT_EQ(fixed, 1u);
}

TEST(MeasurementLine, ReadsTheLinesOfAFile) {
  ExpectSameAsFile<SE2>();
  ExpectSameAsFile<SE3>();
}

template <class Pose>
void ExpectError(MeasurementLineReader<Pose>& reader, const std::string& text, const std::string& cause) {
  try {
    reader.Read(text, 17);
    ADD_FAILURE() << text;
  } catch (const FileError& error) {
    EXPECT_EQ(std::string(error.what()).rfind("robot:17: ", 0), 0u) << error.what();
    EXPECT_NE(error.cause().find(cause), std::string::npos) << error.what();
  }
}

TEST(MeasurementLine, SaysWhatIsWrong) {
  MeasurementLineReader<SE2> reader("robot");
  ExpectError(reader, "", "expected a tag of the g2o format");
  ExpectError(reader, "EDGE2 0 1 1 0 0 1 0 1 1 0 0", "EDGE2");
  ExpectError(reader, "EDGE_SE3:QUAT 0 1", "in a run in 2D");
  ExpectError(reader, "EDGE_SE2 0 1 1 0 0 1 0 0 1 0", "takes 11 fields");
  ExpectError(reader, "EDGE_SE2 0 1 1 0 x 1 0 0 1 0 1", "field 6 (theta)");
  ExpectError(reader, "EDGE_SE2 0 0 1 0 0 1 0 0 1 0 1", "joins a pose to itself");
  ExpectError(reader, "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 -1", "--repair-information clamps it");
  ExpectError(reader, "FIX", "at least 1");
  ExpectError(reader, std::string("FIX 1\0 2", 8), "zero byte");
  EXPECT_EQ(DimensionOfLine("  "), 0);
  EXPECT_EQ(DimensionOfLine("EDGE2 0 1"), 0);
  ReadOptions repair;
  repair.repair_information = true;
  const auto line = MeasurementLineReader<SE2>("robot", repair).Read("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 -1\r", 1);
  EXPECT_EQ(FindDefect(std::get<Factor<SE2>>(line)), "");
}

TEST(MeasurementLine, RemembersSensorOffsets) {
  MeasurementLineReader<SE3> reader("robot");
  const std::string prior = "EDGE_SE3_PRIOR 4 7 0 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";
  reader.Read(prior, 1);
  reader.Read("PARAMS_SE3OFFSET 7 0 0 0 0 0 0 1", 2);
  reader.Read(prior, 3);
  reader.Read("PARAMS_SE3OFFSET 7 0 0 1 0 0 0 1", 4);
  ExpectError(reader, prior, "PARAMS_SE3OFFSET 7 is not the identity");
}

}  // namespace
}  // namespace terse
