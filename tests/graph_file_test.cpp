// Formats, conventions and round trips of graph files. What must be refused: graph_file_error_test.cpp.

#include "terse/core/graph_file.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <clocale>
#include <cmath>
#include <cstring>
#include <fstream>
#include <locale>
#include <random>
#include <thread>

#include "shared_data.h"
#include "testing_files.h"

namespace terse {
namespace {

GraphFile ReadText(const std::string& content, const ReadOptions& options = {}) {
  const TestFile file("read.graph", content);
  return ReadGraph(file.Path(), options);
}

template <class Pose>
PoseGraph<Pose> ReadAs(const std::string& content, GraphFormat format = GraphFormat::kG2o,
                       const ReadOptions& options = {}) {
  GraphFile file = ReadText(content, options);
  EXPECT_EQ(file.format, format) << Name(file.format);
  return std::get<PoseGraph<Pose>>(file.graph);
}

template <class Kind, class Pose>
const Kind& FactorAt(const PoseGraph<Pose>& graph, std::size_t i) {
  return std::get<Kind>(graph.Factors().at(i).factor);
}

std::string Entries(int n, double diagonal = 1) {  // an upper triangle with distinct entries
  std::ostringstream out;
  for (int row = 0, k = 1; row < n; ++row) {
    for (int column = row; column < n; ++column, ++k) out << ' ' << (row == column ? diagonal * (n + k) : 0.01 * k);
  }
  return out.str();
}

Matrix<6, 6> SpatialEntries() {
  Matrix<6, 6> out;
  for (int row = 0, k = 1; row < 6; ++row) {
    for (int column = row; column < 6; ++column, ++k)
      out(row, column) = out(column, row) = row == column ? 6 + k : 0.01 * k;
  }
  return out;
}

// Equal to the last bit; == alone would take -0 for 0.
::testing::AssertionResult SameBits(const double* a, const double* b, int n) {
  for (int i = 0; i < n; ++i) {
    if (std::memcmp(a + i, b + i, sizeof(double)) != 0) {
      return ::testing::AssertionFailure() << "entry " << i << ": " << std::hexfloat << a[i] << " and " << b[i];
    }
  }
  return ::testing::AssertionSuccess();
}
template <int R, int C>
::testing::AssertionResult SameBits(const Matrix<R, C>& a, const Matrix<R, C>& b) {
  return SameBits(a.data(), b.data(), R * C);
}
::testing::AssertionResult SameBits(const SE2& a, const SE2& b) {
  const double x[] = {a.Translation()[0], a.Translation()[1], a.Theta()};
  const double y[] = {b.Translation()[0], b.Translation()[1], b.Theta()};
  return SameBits(x, y, 3);
}
::testing::AssertionResult SameBits(const SE3& a, const SE3& b) {
  const auto same = SameBits(a.Translation().data(), b.Translation().data(), 3);
  return same ? SameBits(a.Rotation().Unit().coeffs().data(), b.Rotation().Unit().coeffs().data(), 4) : same;
}

TEST(GraphFileTest, G2oPlanar) {
  const auto graph = ReadAs<SE2>(
      "VERTEX_SE2 5 1 2 0.5\n"
      "FIX 5 -3\n"
      "EDGE_PRIOR_SE2_XY 9 10 20 4 1 3\n"
      "EDGE_SE2 5 -3 0.1 0.2 0.3 7 0.02 0.03 10 0.05 12\n"
      "EDGE_PRIOR_SE2 5 1 2 3 7 0.02 0.03 10 0.05 12\n"
      "EDGE_SE2 9 -3 1 0 0 1 0 0 1 0 1\n");
  ASSERT_EQ(graph.Poses().size(), 3u);
  EXPECT_EQ(graph.Poses()[0].id.value, 5);
  EXPECT_EQ(graph.Poses()[1].id.value, -3) << "first mention in an edge";
  EXPECT_EQ(graph.Poses()[2].id.value, 9);
  EXPECT_TRUE(SameBits(*graph.Poses()[0].T_world_body, SE2(1, 2, 0.5)));
  EXPECT_FALSE(graph.Poses()[1].T_world_body.has_value());
  EXPECT_TRUE(graph.Poses()[0].fixed && graph.Poses()[1].fixed && !graph.Poses()[2].fixed);

  ASSERT_EQ(graph.Factors().size(), 4u);
  const auto& position = FactorAt<PositionPriorFactor<SE2>>(graph, 0);
  EXPECT_EQ(position.pose.value, 9);
  EXPECT_EQ(position.p_world, Vector<2>(10, 20));
  EXPECT_EQ(position.information, (Matrix<2, 2>() << 4, 1, 1, 3).finished());
  const auto& edge = FactorAt<RelativePoseFactor<SE2>>(graph, 1);
  EXPECT_EQ(edge.from.value, 5);
  EXPECT_EQ(edge.to.value, -3);
  EXPECT_TRUE(SameBits(edge.T_from_to, SE2(0.1, 0.2, 0.3)));
  const Matrix<3, 3> wanted = (Matrix<3, 3>() << 7, 0.02, 0.03, 0.02, 10, 0.05, 0.03, 0.05, 12).finished();
  EXPECT_EQ(edge.information, wanted);
  EXPECT_EQ(FactorAt<PosePriorFactor<SE2>>(graph, 2).information, wanted);
}

TEST(GraphFileTest, G2oSpatialConvertsTheRotationEntries) {
  const std::string text =
      "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n"
      "VERTEX_SE3:QUAT 0 1 2 3 0 0 0 1\n"
      "EDGE_SE3:QUAT 0 1 4 5 6 0.5 0.5 0.5 0.5" +
      Entries(6) +
      "\n"
      "EDGE_SE3_PRIOR 1 0 4 5 6 0.5 -0.5 0.5 0.5" +
      Entries(6) +
      "\n"
      "EDGE_PRIOR_SE3_XYZ 1 7 8 9 4 0.1 0.2 5 0.3 6\n";
  const Matrix<6, 6> entries = SpatialEntries();
  Vector<6> scale;
  scale << 1, 1, 1, 0.5, 0.5, 0.5;
  for (const RotationInformation meaning : {RotationInformation::kQuaternion, RotationInformation::kRadians}) {
    ReadOptions options;
    options.rotation_information = meaning;
    const auto graph = ReadAs<SE3>(text, GraphFormat::kG2o, options);
    Matrix<6, 6> wanted = entries;
    if (meaning == RotationInformation::kQuaternion) wanted = scale.asDiagonal() * entries * scale.asDiagonal();
    const auto& edge = FactorAt<RelativePoseFactor<SE3>>(graph, 0);
    EXPECT_EQ(edge.information, wanted);
    EXPECT_EQ(edge.T_from_to.Translation(), Vector<3>(4, 5, 6));
    EXPECT_EQ(edge.T_from_to.Rotation().Unit().coeffs(), Quaternion(0.5, 0.5, 0.5, 0.5).coeffs());
    const auto& prior = FactorAt<PosePriorFactor<SE3>>(graph, 1);
    EXPECT_EQ(prior.information, wanted);
    EXPECT_EQ(prior.T_world_body.Rotation().Unit().y(), -0.5);
    const auto& position = FactorAt<PositionPriorFactor<SE3>>(graph, 2);
    EXPECT_EQ(position.p_world, Vector<3>(7, 8, 9));
    EXPECT_EQ(position.information(2, 1), 0.3);
    EXPECT_EQ(position.information(2, 2), 6);
  }
}

TEST(GraphFileTest, RotationInformationConvertsThereAndBackExactly) {
  std::mt19937 random(11);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 100; ++trial) {
    Matrix<6, 6> information;
    for (int i = 0; i < 36; ++i) information.data()[i] = normal(random);
    for (const RotationInformation meaning : {RotationInformation::kQuaternion, RotationInformation::kRadians}) {
      EXPECT_TRUE(SameBits(InformationFromFile(InformationToFile(information, meaning), meaning), information));
    }
  }
}

TEST(GraphFileTest, QuaternionInformationIsThatOfItsVectorPart) {
  // Independent of the conversion: the cost of a small rotation, once by the quaternion and once by the tangent.
  const Matrix<6, 6> file_information = SpatialEntries();
  Vector<6> d;
  d << 1e-4, -2e-4, 3e-4, 2e-4, 1e-4, -3e-4;
  const SE3 error = SE3::Exp(d);
  Vector<6> e;
  e << error.Translation(), error.Rotation().Unit().vec();
  const double wanted = e.dot(file_information * e);
  const double found = d.dot(InformationFromFile(file_information, RotationInformation::kQuaternion) * d);
  EXPECT_NEAR(found, wanted, 1e-3 * wanted) << "the two differ in second order of 4e-4 only";
}

TEST(GraphFileTest, ToroPlanarHasItsOwnOrderOfEntries) {
  const auto graph = ReadAs<SE2>(
      "VERTEX2 0 1 2 3\nVERTEX2 1 0 0 0\nEDGE2 1 0 0.1 0.2 0.3 11 12 22 33 1.3 2.3\nEQUIV 0 1\n", GraphFormat::kToro);
  const auto& edge = FactorAt<RelativePoseFactor<SE2>>(graph, 0);
  EXPECT_EQ(edge.from.value, 1) << "backward edges stay as they are";
  EXPECT_EQ(edge.information, (Matrix<3, 3>() << 11, 12, 1.3, 12, 22, 2.3, 1.3, 2.3, 33).finished());
}

TEST(GraphFileTest, ToroSpatialAnglesAreRollPitchYawInRadians) {
  const auto graph =
      ReadAs<SE3>("VERTEX3 0 1 2 3 0.1 0.2 0.3\nEDGE3 0 1 1 2 3 -0.4 0.5 -0.6" + Entries(6) + "\n", GraphFormat::kToro);
  const auto rotation = [](double roll, double pitch, double yaw) {
    Matrix<3, 3> X, Y, Z;
    X << 1, 0, 0, 0, cos(roll), -sin(roll), 0, sin(roll), cos(roll);
    Y << cos(pitch), 0, sin(pitch), 0, 1, 0, -sin(pitch), 0, cos(pitch);
    Z << cos(yaw), -sin(yaw), 0, sin(yaw), cos(yaw), 0, 0, 0, 1;
    return Matrix<3, 3>(Z * Y * X);
  };
  const auto& edge = FactorAt<RelativePoseFactor<SE3>>(graph, 0);
  EXPECT_LT((edge.T_from_to.Rotation().Rotation() - rotation(-0.4, 0.5, -0.6)).norm(), 1e-15);
  EXPECT_LT((graph.Poses()[0].T_world_body->Rotation().Rotation() - rotation(0.1, 0.2, 0.3)).norm(), 1e-15);
  EXPECT_EQ(edge.information, SpatialEntries()) << "no quaternion scaling";
}

TEST(GraphFileTest, IsamInformationIsASquareRoot) {
  const auto planar =
      ReadAs<SE2>("ODOMETRY 0 1 1 0 0.1 2 0.1 0.2 3 0.3 4\nEDGE2 2 1 1 0 0 1 0 0 1 0 1\n", GraphFormat::kIsam);
  const Matrix<3, 3> R = (Matrix<3, 3>() << 2, 0.1, 0.2, 0, 3, 0.3, 0, 0, 4).finished();
  const Matrix<3, 3> found = FactorAt<RelativePoseFactor<SE2>>(planar, 0).information;
  EXPECT_LT((found - R.transpose() * R).norm(), 1e-14);
  EXPECT_EQ(found, found.transpose());
  EXPECT_EQ(planar.Poses().size(), 3u);

  const auto spatial =
      ReadAs<SE3>("EDGE3 0 1 1 2 3 0.1 0.2 0.3" + Entries(6) + "\nEDGE3 1 2 0 0 0 0 0 0\n", GraphFormat::kIsam);
  const Matrix<6, 6> R3 = SpatialEntries().triangularView<Eigen::Upper>();
  EXPECT_LT((FactorAt<RelativePoseFactor<SE3>>(spatial, 0).information - R3.transpose() * R3).norm(), 1e-12);
  EXPECT_EQ(FactorAt<RelativePoseFactor<SE3>>(spatial, 1).information, (Matrix<6, 6>::Identity()));
}

TEST(GraphFileTest, EdgesAloneAreReadTheWayThatFits) {
  EXPECT_EQ(ReadText("EDGE2 0 1 1 0 0 50 0 0 50 0 100\n").format, GraphFormat::kIsam) << "I22 = 0 in TORO's order";
  EXPECT_EQ(ReadText("EDGE2 0 1 1 0 0 50 0 50 100 0 0\n").format, GraphFormat::kToro) << "R33 = 0 in iSAM's order";
  EXPECT_EQ(ReadText("EDGE2 0 1 1 0 0 50 1 50 100 1 1\n").format, GraphFormat::kIsam) << "both fit";
  EXPECT_EQ(ReadText("EDGE3 0 1 0 0 0 0 0 0" + Entries(6) + "\n").format, GraphFormat::kIsam) << "both fit";
}

TEST(GraphFileTest, LayoutOfTheTextDoesNotMatter) {
  const std::string plain =
      "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 100000 0.5\nEDGE_SE2 0 1 1 0 0.5 1 0 0 1 0 1\nEDGE_SE2 0 1 1 0 0.5 1 0 0 1 0 "
      "1\n";
  const std::string odd =
      "\xEF\xBB\xBF# comment\r\n\r\n   \t\r\n//another\r\n#VERTEX_SE2 0 0 0 0\r\n"
      "  VERTEX_SE2\t0  0 0 +0\r\nVERTEX_SE2 +1 +1. 1e5 .5   \r\n"
      "EDGE_SE2 0 1 1.0 0 5E-1 1 0 0 1 0 1\r\nSOMETHING else\r\nEDGE_SE2 0 1 1 0 0.5 1 0 0 1 0 1";
  const auto a = ReadAs<SE2>(plain);
  const auto b = ReadAs<SE2>(odd);
  ASSERT_EQ(b.Poses().size(), 2u);
  ASSERT_EQ(b.Factors().size(), 2u) << "duplicates are kept";
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(a.Poses()[i].id, b.Poses()[i].id);
    EXPECT_TRUE(SameBits(*a.Poses()[i].T_world_body, *b.Poses()[i].T_world_body));
    EXPECT_TRUE(
        SameBits(FactorAt<RelativePoseFactor<SE2>>(a, i).T_from_to, FactorAt<RelativePoseFactor<SE2>>(b, i).T_from_to));
  }
}

TEST(GraphFileTest, VerticesMayFollowTheEdges) {
  const auto graph = ReadAs<SE2>("EDGE_SE2 3 2 1 0 0 1 0 0 1 0 1\nVERTEX_SE2 2 0 0 0\nVERTEX_SE2 3 1 1 1\n");
  EXPECT_EQ(graph.Poses()[0].id.value, 2);
  EXPECT_EQ(graph.Poses()[1].id.value, 3);
  EXPECT_TRUE(graph.Poses()[1].T_world_body.has_value());
}

TEST(GraphFileTest, ASinglePoseNeedsNoEdge) {
  EXPECT_EQ(ReadAs<SE3>("VERTEX_SE3:QUAT 4 0 0 0 0 0 0 1\n").Poses().size(), 1u);
}

TEST(GraphFileTest, UnknownTagsAreCounted) {
  const GraphFile file = ReadText(
      "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\nPARAMS_CAMERA x\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nVERTEX_XY 5 1 1\nVERTEX_XY 6 "
      "1 1\n");
  const std::map<std::string, long> wanted = {{"PARAMS_SE3OFFSET", 1}, {"PARAMS_CAMERA", 1}, {"VERTEX_XY", 2}};
  EXPECT_EQ(file.skipped_tags, wanted);
}

TEST(GraphFileTest, SensorOffsetsInSpaceAreNotSkipped) {
  const GraphFile file =
      ReadText("PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\nPARAMS_CAMERA x\nVERTEX_SE3:QUAT 4 0 0 0 0 0 0 1\n");
  EXPECT_EQ(file.skipped_tags, (std::map<std::string, long>{{"PARAMS_CAMERA", 1}}));
}

// The lines as hdl_graph_slam prints them: two blanks before the information.
TEST(GraphFileTest, PositionPriorsOfHdlGraphSlam) {
  const std::string vertex = "VERTEX_SE3:QUAT 4 0 0 0 0 0 0 1\n", rest = " 4 7 8 9  4 0.1 0.2 5 0.3 6\n";
  const auto theirs = ReadAs<SE3>(vertex + "EDGE_SE3_PRIORXYZ" + rest);
  const auto ours = ReadAs<SE3>(vertex + "EDGE_PRIOR_SE3_XYZ" + rest);
  const auto& prior = FactorAt<PositionPriorFactor<SE3>>(theirs, 0);
  EXPECT_EQ(prior.pose.value, 4);
  EXPECT_EQ(prior.p_world, Vector<3>(7, 8, 9));
  EXPECT_EQ(prior.information, (Matrix<3, 3>() << 4, 0.1, 0.2, 0.1, 5, 0.3, 0.2, 0.3, 6).finished());
  EXPECT_EQ(prior.information, FactorAt<PositionPriorFactor<SE3>>(ours, 0).information);
}

TEST(GraphFileTest, FixOfASkippedVertexIsCounted) {
  const GraphFile file = ReadText(
      "VERTEX_XY 5 1 1\nVERTEX_XY 6 1 1\nVERTEX_XY\nVERTEX_LINE x\nFIX 0 5 6\nFIX 5\n"
      "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
  const std::map<std::string, long> wanted = {{"VERTEX_XY", 3}, {"VERTEX_LINE", 1}, {"FIX", 3}};
  EXPECT_EQ(file.skipped_tags, wanted);
  const auto& graph = std::get<PoseGraph<SE2>>(file.graph);
  ASSERT_EQ(graph.Poses().size(), 2u);
  EXPECT_TRUE(graph.Poses()[0].fixed && !graph.Poses()[1].fixed);
}

TEST(GraphFileTest, GraphsInPiecesForThoseWhoWantThePoses) {
  ReadOptions options;
  options.expect_connected = false;
  const GraphFile file = ReadText("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n", options);
  EXPECT_EQ(std::get<PoseGraph<SE2>>(file.graph).Poses().size(), 2u);
}

// Which can be read once only, and here needs to be looked at three times.
TEST(GraphFileTest, APipeIsReadAsAFileIs) {
  const std::string text =
      "FIX 7\nEDGE_SE3_PRIOR 7 2 0 0 0 0 0 0 1" + Entries(6) + "\nEDGE_SE3:QUAT 9 7 1 0 0 0 0 0 1" + Entries(6) +
      "\nEDGE_SE3:QUAT 7 8 1 0 0 0 0 0 1" + Entries(6) +
      "\nVERTEX_SE3:QUAT 8 1 2 3 0 0 0 1\nPARAMS_SE3OFFSET 2 1 0 0 0 0 0 1\nVERTEX_SE3:QUAT 7 0 0 0 0 0 0 1\n";
  const auto wanted = ReadAs<SE3>(text);
  std::vector<std::int64_t> ids;
  for (const auto& node : wanted.Poses()) ids.push_back(node.id.value);
  EXPECT_EQ(ids, (std::vector<std::int64_t>{8, 7, 9})) << "vertices, then what edges name";
  const TestFile pipe("pipe"), from_file("file.g2o"), from_pipe("pipe.g2o");
  ASSERT_EQ(mkfifo(pipe.Path().c_str(), 0600), 0);
  std::thread writer([&] { std::ofstream(pipe.Path()) << text; });
  const auto read = ReadPoseGraph<SE3>(pipe.Path());
  writer.join();
  WriteG2o(wanted, from_file.Path());
  WriteG2o(read, from_pipe.Path());
  EXPECT_EQ(from_pipe.Content(), from_file.Content());
}

TEST(GraphFileTest, QuaternionsAreNormalisedOnceOnly) {
  const auto rounded = ReadAs<SE3>("VERTEX_SE3:QUAT 0 0 0 0 0.1826 0.3651 0.5477 0.7303\n");
  EXPECT_NEAR(rounded.Poses()[0].T_world_body->Rotation().Unit().norm(), 1, 1e-15);
  EXPECT_NEAR(rounded.Poses()[0].T_world_body->Rotation().Unit().x(), 0.1826, 1e-4);
}

TEST(GraphFileTest, RepairClampsAndCounts) {
  const std::string text =
      "EDGE_SE2 0 1 1 0 0 4 0 0 -1 0 2\nEDGE_SE2 0 1 1 0 0 0 0 0 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n";
  ReadOptions options;
  options.repair_information = true;
  const GraphFile file = ReadText(text, options);
  EXPECT_EQ(file.repaired_informations, 2);
  const auto& graph = std::get<PoseGraph<SE2>>(file.graph);
  Matrix<3, 3> wanted = Vector<3>(4, 4e-9, 2).asDiagonal();
  EXPECT_LT((FactorAt<RelativePoseFactor<SE2>>(graph, 0).information - wanted).norm(), 1e-14);
  EXPECT_GT(FactorAt<RelativePoseFactor<SE2>>(graph, 1).information(0, 0), 0);
  EXPECT_EQ(FactorAt<RelativePoseFactor<SE2>>(graph, 2).information, (Matrix<3, 3>::Identity()));
}

class DecimalComma : public std::numpunct<char> {
  char do_decimal_point() const override { return ','; }
  char do_thousands_sep() const override { return '.'; }
  std::string do_grouping() const override { return "\3"; }
};

TEST(GraphFileTest, ADecimalCommaLocaleChangesNothing) {
  const std::locale before = std::locale::global(std::locale(std::locale::classic(), new DecimalComma));
  std::setlocale(LC_ALL, "de_DE.UTF-8");  // where the system has it
  std::ostringstream bites;
  bites << 1234.5;
  const auto graph =
      ReadAs<SE2>("VERTEX_SE2 12345 1.5 0.25 0.125\nVERTEX_SE2 1 0 0 0\nEDGE_SE2 1 12345 1.5 0 0 1234.5 0 0 1 0 1\n");
  const TestFile file("locale.g2o");
  WriteG2o(graph, file.Path());
  const std::string written = file.Content();
  std::string message;
  try {
    ReadText("EDGE_SE2 1 12345 1.5 0 0 -1234.5 0 0 1 0 1\n");
  } catch (const FileError& error) {
    message = error.what();
  }
  std::setlocale(LC_ALL, "C");
  std::locale::global(before);
  EXPECT_EQ(bites.str(), "1.234,5") << "the test would not notice anything";
  EXPECT_EQ(graph.Poses()[0].T_world_body->Translation(), Vector<2>(1.5, 0.25));
  EXPECT_EQ(written,
            "VERTEX_SE2 12345 1.5 0.25 0.125\nVERTEX_SE2 1 0 0 0\nEDGE_SE2 1 12345 1.5 0 0 1234.5 0 0 1 0 1\n");
  EXPECT_NE(message.find("-1234.5"), std::string::npos) << message;
}

template <class Pose>
class RoundTripTest : public ::testing::Test {
 protected:
  double Draw() { return normal_(random_) * std::pow(10, normal_(random_)); }
  Pose DrawPose() {
    typename Pose::Tangent d;
    for (int i = 0; i < Pose::kDof; ++i) d[i] = Draw();
    return Pose::Exp(d);
  }
  template <int N>
  Matrix<N, N> DrawInformation() {
    Matrix<N, N> A;
    for (int i = 0; i < A.size(); ++i) A.data()[i] = normal_(random_);
    const Matrix<N, N> information = std::exp(Draw() / 10) * (A * A.transpose() + 0.1 * Matrix<N, N>::Identity());
    return 0.5 * (information + information.transpose());
  }
  RelativePoseFactor<Pose> DrawEdge(PoseId from, PoseId to) {
    return {from, to, DrawPose(), DrawInformation<Pose::kDof>()};
  }
  // Poses with values first, in the order in which a file keeps them.
  PoseGraph<Pose> DrawGraph(bool only_edges) {
    PoseGraph<Pose> graph;
    const int n = 3 + static_cast<int>(random_() % 20);
    const auto id = [](int i) { return PoseId{i % 2 == 0 ? -i * 1000003LL : (1LL << 62) + i}; };
    for (int i = 0; i < n; ++i) {
      graph.AddPose(id(i), i < n - 2 || only_edges ? std::optional<Pose>(DrawPose()) : std::nullopt);
      if (i > 0) graph.AddFactor(DrawEdge(id(i - 1), id(i)));
      if (!only_edges && random_() % 4 == 0) graph.SetFixed(id(i), true);
      if (i > 0 && random_() % 2 == 0) {
        graph.AddFactor(DrawEdge(id(i), id(static_cast<int>(random_() % static_cast<unsigned>(i)))));
      }
      if (!only_edges && random_() % 3 == 0) {
        graph.AddFactor(PosePriorFactor<Pose>{id(i), DrawPose(), DrawInformation<Pose::kDof>()});
      }
      if (!only_edges && random_() % 3 == 0) {
        PositionPriorFactor<Pose> prior{id(i), DrawPose().Translation(), DrawInformation<Pose::kDim>()};
        if (random_() % 2 == 0) prior.p_body = DrawPose().Translation();
        graph.AddFactor(prior);
      }
    }
    return graph;
  }
  std::mt19937 random_{21};
  std::normal_distribution<double> normal_;
};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(RoundTripTest, Groups);

template <class Pose>
void ExpectSameGraph(const PoseGraph<Pose>& a, const PoseGraph<Pose>& b) {
  ASSERT_EQ(a.Poses().size(), b.Poses().size());
  for (std::size_t i = 0; i < a.Poses().size(); ++i) {
    EXPECT_EQ(a.Poses()[i].id, b.Poses()[i].id);
    EXPECT_EQ(a.Poses()[i].fixed, b.Poses()[i].fixed);
    ASSERT_EQ(a.Poses()[i].T_world_body.has_value(), b.Poses()[i].T_world_body.has_value());
    if (!a.Poses()[i].T_world_body) continue;
    EXPECT_TRUE(SameBits(*a.Poses()[i].T_world_body, *b.Poses()[i].T_world_body));
  }
  ASSERT_EQ(a.Factors().size(), b.Factors().size());
  for (std::size_t i = 0; i < a.Factors().size(); ++i) {
    ASSERT_EQ(a.Factors()[i].factor.index(), b.Factors()[i].factor.index()) << "kinds keep their order";
    const FactorPoses x = PosesOf(a.Factors()[i].factor), y = PosesOf(b.Factors()[i].factor);
    EXPECT_EQ(x.first, y.first);
    EXPECT_EQ(x.second, y.second);
    if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&a.Factors()[i].factor)) {
      EXPECT_TRUE(SameBits(f->T_from_to, FactorAt<RelativePoseFactor<Pose>>(b, i).T_from_to));
      EXPECT_TRUE(SameBits(f->information, FactorAt<RelativePoseFactor<Pose>>(b, i).information));
    } else if (const auto* p = std::get_if<PosePriorFactor<Pose>>(&a.Factors()[i].factor)) {
      EXPECT_TRUE(SameBits(p->T_world_body, FactorAt<PosePriorFactor<Pose>>(b, i).T_world_body));
      EXPECT_TRUE(SameBits(p->information, FactorAt<PosePriorFactor<Pose>>(b, i).information));
    } else {
      const auto& q = FactorAt<PositionPriorFactor<Pose>>(a, i);
      EXPECT_TRUE(SameBits(q.p_world, FactorAt<PositionPriorFactor<Pose>>(b, i).p_world));
      EXPECT_TRUE(SameBits(q.p_body, FactorAt<PositionPriorFactor<Pose>>(b, i).p_body));
      EXPECT_TRUE(SameBits(q.information, FactorAt<PositionPriorFactor<Pose>>(b, i).information));
    }
  }
}

TYPED_TEST(RoundTripTest, G2oKeepsEveryBit) {
  for (int trial = 0; trial < 50; ++trial) {
    SCOPED_TRACE("trial " + std::to_string(trial));
    const PoseGraph<TypeParam> graph = this->DrawGraph(false);
    for (const RotationInformation meaning : {RotationInformation::kQuaternion, RotationInformation::kRadians}) {
      const TestFile file("round.g2o"), again("again.g2o");
      WriteG2o(graph, file.Path(), meaning);
      ReadOptions options;
      options.rotation_information = meaning;
      const GraphFile read = ReadGraph(file.Path(), options);
      ExpectSameGraph(graph, std::get<PoseGraph<TypeParam>>(read.graph));
      WriteG2o(std::get<PoseGraph<TypeParam>>(read.graph), again.Path(), meaning);
      EXPECT_EQ(file.Content(), again.Content());
    }
  }
}

TYPED_TEST(RoundTripTest, ToroKeepsEveryBitButRotationsInSpace) {
  using Pose = TypeParam;
  for (int trial = 0; trial < 50; ++trial) {
    SCOPED_TRACE("trial " + std::to_string(trial));
    const PoseGraph<Pose> graph = this->DrawGraph(true);
    const TestFile file("round.graph");
    WriteToro(graph, file.Path());
    const GraphFile read = ReadGraph(file.Path());
    EXPECT_EQ(read.format, GraphFormat::kToro);
    const auto& back = std::get<PoseGraph<Pose>>(read.graph);
    if constexpr (Pose::kDim == 2) {
      ExpectSameGraph(graph, back);
    } else {
      ASSERT_EQ(back.Factors().size(), graph.Factors().size());
      for (std::size_t i = 0; i < graph.Factors().size(); ++i) {
        const auto& a = FactorAt<RelativePoseFactor<Pose>>(graph, i);
        const auto& b = FactorAt<RelativePoseFactor<Pose>>(back, i);
        EXPECT_TRUE(SameBits(a.information, b.information));
        EXPECT_TRUE(SameBits(a.T_from_to.Translation().data(), b.T_from_to.Translation().data(), 3));
        EXPECT_LT((a.T_from_to.Rotation().Rotation() - b.T_from_to.Rotation().Rotation()).norm(), 1e-14);
      }
    }
  }
}

TEST(GraphFileTest, ToroAnglesHoldAtAPitchOf90Degrees) {
  std::mt19937 random(22);
  std::uniform_real_distribution<double> angle(-3, 3);
  for (const double off : {0.0, 1e-16, 1e-12, 1e-8, 1e-4}) {
    for (const double sign : {-1.0, 1.0}) {
      const SO3 R = SO3::Exp(Vector<3>(0, 0, angle(random))) * SO3::Exp(Vector<3>(0, sign * (M_PI / 2 - off), 0)) *
                    SO3::Exp(Vector<3>(angle(random), 0, 0));
      PoseGraph<SE3> graph;
      graph.AddPose({0}, SE3(R, Vector<3>::Zero()));
      const TestFile file("gimbal.graph");
      WriteToro(graph, file.Path());
      const GraphFile read = ReadGraph(file.Path());
      const auto& back = *std::get<PoseGraph<SE3>>(read.graph).Poses()[0].T_world_body;
      EXPECT_LT((back.Rotation().Rotation() - R.Rotation()).norm(), 1e-12) << "off " << off << " sign " << sign;
    }
  }
}

TEST(GraphFileTest, ToroRefusesWhatItCannotHold) {
  const TestFile file("refused.graph");
  PoseGraph<SE2> graph;
  graph.AddPose({3}, SE2());
  graph.SetFixed({3}, true);
  EXPECT_THROW(WriteToro(graph, file.Path()), FileError);
  graph.SetFixed({3}, false);
  graph.AddFactor(PosePriorFactor<SE2>{{3}, SE2(), Matrix<3, 3>::Identity()});
  EXPECT_THROW(WriteToro(graph, file.Path()), FileError);
  EXPECT_EQ(file.Content(), "") << "nothing is written";
  EXPECT_THROW(WriteG2o(graph, file.Path() + ".missing/x.g2o"), FileError);
}

// Information of 1e308 per square radian is four times as much in g2o's unit.
TEST(GraphFileTest, NothingIsWrittenThatCannotBeReadAgain) {
  PoseGraph<SE3> graph;
  graph.AddPose({0});
  graph.AddPose({1});
  graph.AddFactor(RelativePoseFactor<SE3>{{0}, {1}, SE3(), 1e308 * Matrix<6, 6>::Identity()});
  const TestFile file("large.g2o", "as it was");
  EXPECT_THROW(WriteG2o(graph, file.Path()), NumericalError);
  std::string line;
  std::getline(std::ifstream(file.Path()), line);
  EXPECT_EQ(line, "as it was");
  ReadOptions radians;
  radians.rotation_information = RotationInformation::kRadians;
  WriteG2o(graph, file.Path(), RotationInformation::kRadians);
  EXPECT_EQ(ReadPoseGraph<SE3>(file.Path(), radians).Factors().size(), 1u);
}

TEST(GraphFileTest, PublicGraphsHaveTheirKnownSizes) {
  TERSE_NEEDS(folder, "graphs");
  struct Known {
    GraphFormat format;
    std::size_t poses, factors;
  };
  const GraphFormat g2o = GraphFormat::kG2o, toro = GraphFormat::kToro;
  const std::map<std::string, Known> known = {
      {"sphere2500.g2o", {g2o, 2500, 4949}},
      {"parking-garage.g2o", {g2o, 1661, 6275}},
      {"torus3D.g2o", {g2o, 5000, 9048}},
      {"smallGrid3D.g2o", {g2o, 125, 297}},
      {"tinyGrid3D.g2o", {g2o, 9, 11}},
      {"sphere_bignoise_vertex3.g2o", {g2o, 2200, 8647}},
      {"kitti00_all_loops.g2o", {g2o, 4541, 28021}},
      {"manhattan.g2o", {g2o, 3500, 5453}},
      {"city10000.g2o", {g2o, 10000, 20687}},
      {"intel.g2o", {g2o, 1728, 2512}},
      {"input_M3500_g2o.g2o", {g2o, 3500, 5453}},
      {"w10000_hogman.graph", {toro, 10000, 64311}},
      {"w100.graph", {toro, 100, 300}},
      {"manhattanOlson3500_isam.txt", {GraphFormat::kIsam, 3500, 5598}},
      {"MIT.g2o", {g2o, 808, 827}},
      {"MIT-P.g2o", {g2o, 808, 827 + 16}},
      {"FR079.g2o", {g2o, 989, 1217}},
      {"CSAIL.g2o", {g2o, 1045, 1172}},
      {"Intel.g2o", {g2o, 1228, 1483}},
      {"FRH.g2o", {g2o, 1316, 2820}},
      {"MITb_g2o.g2o", {g2o, 808, 827}},
      {"INTEL_g2o.g2o", {g2o, 1228, 1483}},
      {"FR079_P_toro.graph", {toro, 989, 1217}},
      {"CSAIL_P_toro.graph", {toro, 1045, 1172}},
      {"FRH_P_toro.graph", {toro, 1316, 2820}},
  };
  std::size_t checked = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file()) continue;
    SCOPED_TRACE(entry.path().string());
    const GraphFile file = ReadGraph(entry.path().string());
    const auto it = known.find(entry.path().filename().string());
    if (it == known.end()) continue;
    ++checked;
    EXPECT_EQ(file.format, it->second.format);
    std::visit(
        [&](const auto& graph) {
          EXPECT_EQ(graph.Poses().size(), it->second.poses);
          EXPECT_EQ(graph.Factors().size(), it->second.factors);
        },
        file.graph);
    const std::map<std::string, long> equiv = {{"EQUIV", 40}};
    EXPECT_EQ(file.skipped_tags, it->first == "w100.graph" ? equiv : (std::map<std::string, long>()));
  }
  EXPECT_EQ(checked, known.size());
}

}  // namespace
}  // namespace terse
