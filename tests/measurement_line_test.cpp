// Lines of g2o one at a time, against the same lines as a file.

#include "terse/core/measurement_line.h"

#include <gtest/gtest.h>

#include <sstream>

#include "terse/core/residual.h"
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
  ExpectError(reader, prior, "sensor offset 7");
  const auto offset = reader.Read("PARAMS_SE3OFFSET 7 0 0 1 0 0 0 1", 2);
  EXPECT_EQ(std::get<SensorOffsetLine>(offset).T_body_sensor.Translation(), Vector<3>(0, 0, 1));
  const auto on_body = [&] {
    return std::get<PosePriorFactor<SE3>>(std::get<Factor<SE3>>(reader.Read(prior, 3))).T_world_body.Translation();
  };
  EXPECT_EQ(on_body(), Vector<3>(0, 0, -1));
  ExpectError(reader, "PARAMS_SE3OFFSET 7 0 0 0 0 0 0 1", "second PARAMS_SE3OFFSET 7");
  reader.Read("PARAMS_SE3OFFSET 7 0 0 1 0 0 0 1", 4);
  EXPECT_EQ(on_body(), Vector<3>(0, 0, -1)) << "as before";
}

TEST(MeasurementLine, ReadsPositionPriorsOfHdlGraphSlam) {
  MeasurementLineReader<SE3> reader("robot");
  const auto line = reader.Read("EDGE_SE3_PRIORXYZ 4 1 2 3  1 0 0 2 0 4", 1);
  const auto& prior = std::get<PositionPriorFactor<SE3>>(std::get<Factor<SE3>>(line));
  EXPECT_EQ(prior.p_world, Vector<3>(1, 2, 3));
  EXPECT_EQ(Vector<3>(prior.information.diagonal()), Vector<3>(1, 2, 4));
  EXPECT_EQ(DimensionOfLine("EDGE_SE3_PRIORXYZ 4"), 3);
}

// g2o's error, in its own terms: rotation matrices, the chart [t; vector part of the quaternion] of
// Z^-1 T_world_body T_body_sensor.
double CostInG2o(const SE3& Z, const SE3& T_body_sensor, const Matrix<6, 6>& information, const SE3& T_world_body) {
  const auto matrix = [](const SE3& T) {
    Eigen::Isometry3d out = Eigen::Isometry3d::Identity();
    out.linear() = T.Rotation().Rotation();
    out.translation() = T.Translation();
    return out;
  };
  const Eigen::Isometry3d delta = matrix(Z).inverse() * matrix(T_world_body) * matrix(T_body_sensor);
  Eigen::Quaterniond q(delta.linear());
  if (q.w() < 0) q.coeffs() *= -1;
  Vector<6> error;
  error << delta.translation(), q.vec();
  return error.dot(information * error);
}

// The costs agree to second order around the measurement: their relative difference vanishes with the deviation, like
// the part of third order does.
TEST(MeasurementLine, PriorOnASensorIsOneOnTheBody) {
  Random rng(11);
  for (int trial = 0; trial < 50; ++trial) {
    const SE3 Z = RandomMotion<SE3>(rng, 5, 1), T_body_sensor = RandomMotion<SE3>(rng, 2, 1);
    const Matrix<6, 6> information = RandomInformation<6>(rng);
    std::ostringstream offset, prior;
    offset.precision(17);
    prior.precision(17);
    const auto write = [](const SE3& T, std::ostream& out) {
      const Vector<3>& t = T.Translation();
      const Quaternion& q = T.Rotation().Unit();
      for (const double x : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()}) out << ' ' << x;
    };
    offset << "PARAMS_SE3OFFSET 7";
    write(T_body_sensor, offset);
    prior << "EDGE_SE3_PRIOR 4 7";
    write(Z, prior);
    for (int row = 0; row < 6; ++row) {
      for (int column = row; column < 6; ++column) prior << ' ' << information(row, column);
    }
    MeasurementLineReader<SE3> reader("robot");
    reader.Read(offset.str(), 1);
    const auto factor = std::get<Factor<SE3>>(reader.Read(prior.str(), 2));
    const SE3 best = Z * T_body_sensor.Inverse();
    EXPECT_LT(best.Local(std::get<PosePriorFactor<SE3>>(factor).T_world_body).norm(), 1e-12);
    const Vector<6> direction = NormalVector<6>(rng).normalized();
    const auto difference = [&](double length) {
      const SE3 T_world_body = best.Retract(length * direction);
      const double cost = CostInG2o(Z, T_body_sensor, information, T_world_body);
      return std::abs(FactorChi2<SE3>(factor, T_world_body, T_world_body) - cost) / cost;
    };
    EXPECT_LT(difference(1e-2), 0.1) << trial;
    EXPECT_LT(difference(1e-4), 1e-3) << trial;
    EXPECT_LT(difference(1e-5), 1e-4) << trial;
  }
}

}  // namespace
}  // namespace terse
