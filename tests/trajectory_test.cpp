// Trajectory files: what is written reads back, what is wrong is refused with its line.

#include "terse/core/trajectory.h"

#include <gtest/gtest.h>

#include <clocale>
#include <locale>
#include <sstream>

#include "shared_data.h"
#include "terse/core/graph_file.h"
#include "testing_files.h"
#include "testing_poses.h"

namespace terse {
namespace {

using testing::PoseRandom;

Trajectory RandomTrajectory(int poses, unsigned seed) {
  PoseRandom random(seed);
  Trajectory out;
  double stamp = 1305031098.6659;
  for (int i = 0; i < poses; ++i) {
    out.stamps.push_back(stamp);
    out.T_world_body.push_back(testing::RandomPose<SE3>(random, 50));
    stamp += random.LogUniform(1e-4, 1);
  }
  return out;
}

// The message of the FileError that reading `content` throws; empty if it reads.
std::string ErrorOf(const std::string& content) {
  const TestFile file("trajectory_bad.txt", content);
  try {
    ReadTrajectory(file.Path());
  } catch (const FileError& error) {
    EXPECT_EQ(error.path(), file.Path());
    return std::to_string(error.line()) + ": " + error.cause();
  }
  return "";
}

const std::string kIdentityTum = " 0 0 0 0 0 0 1";
const std::string kIdentityKitti = "1 0 0 0 0 1 0 0 0 0 1 0";

TEST(TrajectoryTest, TumReadsBackToTheBit) {
  const Trajectory written = RandomTrajectory(500, 31);
  const TestFile file("trajectory_tum.txt");
  WriteTum(written, file.Path());
  const Trajectory read = ReadTrajectory(file.Path());
  EXPECT_EQ(read.format, TrajectoryFormat::kTum);
  EXPECT_EQ(read.stamps, written.stamps);
  ASSERT_EQ(read.T_world_body.size(), written.T_world_body.size());
  for (std::size_t i = 0; i < read.T_world_body.size(); ++i) {
    EXPECT_EQ(read.T_world_body[i].Translation(), written.T_world_body[i].Translation());
    EXPECT_EQ(read.T_world_body[i].Rotation().Unit().coeffs(), written.T_world_body[i].Rotation().Unit().coeffs());
  }
}

TEST(TrajectoryTest, KittiReadsBackToRounding) {
  const Trajectory written = RandomTrajectory(500, 32);
  const TestFile file("trajectory_kitti.txt");
  WriteKitti(written, file.Path());
  const Trajectory read = ReadTrajectory(file.Path());
  EXPECT_EQ(read.format, TrajectoryFormat::kKitti);
  ASSERT_EQ(read.T_world_body.size(), written.T_world_body.size());
  for (std::size_t i = 0; i < read.T_world_body.size(); ++i) {
    EXPECT_EQ(read.stamps[i], static_cast<double>(i));
    EXPECT_EQ(read.T_world_body[i].Translation(), written.T_world_body[i].Translation());
    // Quaternion to matrix, through the projection, and back: some ten operations.
    EXPECT_LT((read.T_world_body[i].Rotation().Inverse() * written.T_world_body[i].Rotation()).Log().norm(), 1e-14);
  }
}

TEST(TrajectoryTest, WritesNumbersTheShortWay) {
  Trajectory trajectory;
  trajectory.stamps = {0, 0.1};
  trajectory.T_world_body = {SE3(), SE3(SO3(), Vector<3>(1, -0.5, 1e-20))};
  const TestFile tum("trajectory_short.tum"), kitti("trajectory_short.kitti");
  WriteTum(trajectory, tum.Path());
  WriteKitti(trajectory, kitti.Path());
  EXPECT_EQ(tum.Content(), "0 0 0 0 0 0 0 1\n0.1 1 -0.5 1e-20 0 0 0 1\n");
  EXPECT_EQ(kitti.Content(), "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 -0.5 0 0 1 1e-20\n");
}

TEST(TrajectoryTest, ProjectsMatricesOfFewDigitsToTheNearestRotation) {
  PoseRandom random(33);
  for (int i = 0; i < 100; ++i) {
    const SO3 R = SO3::Exp(random.RotationVector(random.Angle()));
    const Matrix<3, 3> M = R.Rotation();
    std::ostringstream line;
    line.precision(7);
    for (int row = 0; row < 3; ++row) line << M(row, 0) << ' ' << M(row, 1) << ' ' << M(row, 2) << " 1 ";
    const TestFile file("trajectory_digits.txt", line.str());
    const SO3 read = ReadTrajectory(file.Path()).T_world_body.at(0).Rotation();
    EXPECT_NEAR(read.Unit().norm(), 1, 1e-15);
    // Each entry is off by at most 5e-8; the rotation vector averages several of them.
    EXPECT_LT((read.Inverse() * R).Log().norm(), 2e-7);
  }
}

// R P with P symmetric and positive definite is nearest to R: the polar decomposition.
TEST(TrajectoryTest, ProjectionIsThePolarFactor) {
  PoseRandom random(39);
  for (int i = 0; i < 100; ++i) {
    const SO3 R = SO3::Exp(random.RotationVector(random.Angle()));
    const Matrix<3, 3> S = random.Information<3>();
    const Matrix<3, 3> M = R.Rotation() * (Matrix<3, 3>::Identity() + 4e-4 / S.cwiseAbs().maxCoeff() * S);
    std::ostringstream line;
    line.precision(17);
    for (int row = 0; row < 3; ++row) line << M(row, 0) << ' ' << M(row, 1) << ' ' << M(row, 2) << " 0 ";
    const TestFile file("trajectory_polar.txt", line.str());
    const SO3 read = ReadTrajectory(file.Path()).T_world_body.at(0).Rotation();
    EXPECT_LT((read.Inverse() * R).Log().norm(), 1e-14);
  }
}

TEST(TrajectoryTest, AcceptsCommentsBlankLinesAndAnyLineEnd) {
  const TestFile file("trajectory_loose.txt",
                      "# stamp x y z qx qy qz qw\r\n\r\n  1 1 2 3 0 0 0 1 \r\n\n\t#end\n+2.5e0 4 5 6 0 0 1\t0");
  const Trajectory read = ReadTrajectory(file.Path());
  EXPECT_EQ(read.stamps, (std::vector<double>{1, 2.5}));
  EXPECT_EQ(read.T_world_body[1].Translation(), Vector<3>(4, 5, 6));
  EXPECT_EQ(read.T_world_body[1].Rotation().Unit().z(), 1);
}

TEST(TrajectoryTest, NormalisesQuaternionsOfFewDigits) {
  const TestFile file("trajectory_quaternion.txt", "1 0 0 0 0.7071 0 0 0.7071\n");
  const SO3 R = ReadTrajectory(file.Path()).T_world_body.at(0).Rotation();
  EXPECT_NEAR(R.Unit().norm(), 1, 1e-15);
  EXPECT_NEAR(R.Log().x(), testing::kPi / 2, 1e-15);
}

TEST(TrajectoryTest, RefusesWhatIsWrongAndNamesTheLine) {
  const std::string tum = "0" + kIdentityTum + "\n", kitti = kIdentityKitti + "\n";
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"", "0: the file is empty"},
      {"# only\n\n", "0: no poses"},
      {"1 2 3\n", "1: expected 8 numbers"},
      {"1 2 3 4 5 6 7 8 9\n", "1: expected 8 numbers"},
      {tum + "1 0 0 0 0 0 1\n", "2: a TUM line has 8 numbers, found 7"},
      {tum + "\n# c\n1 0 0 0 0 0 0 1 1\n", "4: a TUM line has 8 numbers, found 9"},
      {kitti + kitti + "1 0 0 0 0 1 0 0 0 0 1\n", "3: a KITTI line has 12 numbers, found 11"},
      {kitti + tum, "2: a KITTI line has 12 numbers, found 8"},
      {tum + "1 0 x 0 0 0 0 1\n", "2: field 3 (y)"},
      {tum + "1 0 0,5 0 0 0 0 1\n", "2: field 3 (y)"},
      {tum + "1 0 nan 0 0 0 0 1\n", "2: field 3 (y)"},
      {tum + "1 0 0 -inf 0 0 0 1\n", "2: field 4 (z)"},
      {tum + "1 0 0 1e999 0 0 0 1\n", "2: field 4 (z)"},
      {tum + "1 0 0 0x1 0 0 0 1\n", "2: field 4 (z)"},
      {tum + "1 0 0 0 0 0 0 0\n", "2: the quaternion has norm 0"},
      {tum + "1 0 0 0 0 0 0.5 1\n", "2: the quaternion has norm 1.118"},
      {tum + "1 0 0 0 1e200 0 0 1\n", "2: the quaternion has norm 1e+200"},
      {tum + tum, "2: stamp 0 is there already"},
      {tum + "-1" + kIdentityTum, "2: stamp -1 is before the last one, 0"},
      {"1 0 0 0 0 1 0 0 0 0 1.01 0\n", "1: the matrix is not a rotation"},
      {"1 0 0 0 0 1 0 0 0 0 -1 0\n", "1: the matrix is a reflection"},
      {"1e200 0 0 0 0 1 0 0 0 0 1 0\n", "1: the matrix is not a rotation"},
      {tum + std::string("1 0\0 0", 6), "2: a binary file"},
      {"\x7f"
       "ELF junk\n",
       "1: "},
  };
  for (const auto& [content, expected] : cases) {
    EXPECT_EQ(ErrorOf(content).substr(0, expected.size()), expected) << content;
  }
  // On the right side of the tolerances.
  EXPECT_EQ(ErrorOf("1 0 0 0 0 1 0 0 0 0 1.0004 0\n"), "");
  EXPECT_EQ(ErrorOf("1 0 0 0 0 0 0 1.009\n"), "");
}

TEST(TrajectoryTest, RefusesFoldersAndMissingFiles) {
  EXPECT_THROW(ReadTrajectory(::testing::TempDir()), FileError);
  EXPECT_THROW(ReadTrajectory(::testing::TempDir() + "no/such/file"), FileError);
  EXPECT_THROW(WriteTum(RandomTrajectory(2, 34), ::testing::TempDir() + "no/such/folder/file"), FileError);
  Trajectory uneven = RandomTrajectory(2, 35);
  uneven.stamps.pop_back();
  EXPECT_THROW(WriteTum(uneven, ::testing::TempDir() + "terse_uneven"), std::invalid_argument);
  EXPECT_THROW(WriteKitti(uneven, ::testing::TempDir() + "terse_uneven"), std::invalid_argument);
}

struct CommaForPoint : std::numpunct<char> {
  char do_decimal_point() const override { return ','; }
  char do_thousands_sep() const override { return '.'; }
  std::string do_grouping() const override { return "\3"; }
};

TEST(TrajectoryTest, DoesNotDependOnTheLocale) {
  const std::locale before = std::locale::global(std::locale(std::locale::classic(), new CommaForPoint));
  // The C locale too, where the machine has one with a comma.
  for (const char* name : {"de_DE.UTF-8", "fr_FR.UTF-8"}) {
    if (std::setlocale(LC_ALL, name) != nullptr) break;
  }
  const Trajectory written = RandomTrajectory(3, 36);
  const TestFile tum("trajectory_locale.tum"), kitti("trajectory_locale.kitti");
  WriteTum(written, tum.Path());
  WriteKitti(written, kitti.Path());
  const Trajectory tum_read = ReadTrajectory(tum.Path()), kitti_read = ReadTrajectory(kitti.Path());
  std::locale::global(before);
  std::setlocale(LC_ALL, "C");
  EXPECT_EQ(tum_read.stamps, written.stamps);
  EXPECT_EQ(kitti_read.T_world_body.back().Translation(), written.T_world_body.back().Translation());
  EXPECT_EQ(tum.Content().find(','), std::string::npos);
  EXPECT_EQ(kitti.Content().find(','), std::string::npos);
}

TEST(TrajectoryTest, LiftKeepsThePlane) {
  PoseRandom random(37);
  for (int i = 0; i < 1000; ++i) {
    const SE2 A = testing::RandomPose<SE2>(random, 3), B = testing::RandomPose<SE2>(random, 3);
    EXPECT_LT((Lift(A * B).Adjoint() - (Lift(A) * Lift(B)).Adjoint()).cwiseAbs().maxCoeff(), 1e-13);
    EXPECT_EQ(Lift(A).Translation().z(), 0);
    EXPECT_NEAR(Lift(A).Angle(), A.Angle(), 1e-15);
  }
}

TEST(TrajectoryTest, ReadsTheVerticesOfGraphsInOrderOfTheirIds) {
  const std::string edge_tail = " 1 0 0 1 0 0 1 0 1\n";
  const TestFile plane("trajectory_plane.g2o", "VERTEX_SE2 7 1 2 0.5\nVERTEX_SE2 -3 0 0 0\nEDGE_SE2 -3 7" + edge_tail +
                                                   "EDGE_SE2 7 9" + edge_tail);
  const Trajectory read = ReadTrajectory(plane.Path());
  EXPECT_EQ(read.format, TrajectoryFormat::kGraph);
  EXPECT_EQ(read.stamps, (std::vector<double>{-3, 7}));  // 9 has no value
  EXPECT_EQ(read.T_world_body[1].Translation(), Vector<3>(1, 2, 0));
  EXPECT_NEAR(read.T_world_body[1].Rotation().Log().z(), 0.5, 1e-15);

  const TestFile edges("trajectory_edges.g2o", "EDGE_SE2 0 1" + edge_tail);
  EXPECT_THROW(ReadTrajectory(edges.Path()), FileError);
  const TestFile huge("trajectory_huge.g2o",
                      "VERTEX_SE2 9007199254740992 0 0 0\nVERTEX_SE2 9007199254740993 0 0 0\n"
                      "EDGE_SE2 9007199254740992 9007199254740993" +
                          edge_tail);
  EXPECT_THROW(ReadTrajectory(huge.Path()), FileError);
}

TEST(TrajectoryTest, VerticesAloneAndGraphsInPiecesAreTrajectories) {
  const TestFile plane("trajectory_vertices.g2o", "VERTEX_SE2 7 1 2 0.5\nVERTEX_SE2 -3 0 0 0\nVERTEX_SE2 9 3 0 0\n");
  EXPECT_EQ(ReadTrajectory(plane.Path()).stamps, (std::vector<double>{-3, 7, 9}));
  const TestFile space("trajectory_vertices3.g2o",
                       "VERTEX_SE3:QUAT 2 1 2 3 0 0 0 1\nVERTEX_SE3:QUAT 1 4 5 6 0 0 0 1\nVERTEX_TRACKXYZ 5 0 0 0\n");
  const Trajectory read = ReadTrajectory(space.Path());
  EXPECT_EQ(read.stamps, (std::vector<double>{1, 2}));
  EXPECT_EQ(read.T_world_body[0].Translation(), Vector<3>(4, 5, 6));
  const TestFile toro("trajectory_vertices.graph", "VERTEX2 0 1 2 0.5\nVERTEX2 1 0 0 0\n");
  EXPECT_EQ(ReadTrajectory(toro.Path()).stamps.size(), 2u);
  const TestFile pieces("trajectory_pieces.g2o",
                        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 2 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
  EXPECT_EQ(ReadTrajectory(pieces.Path()).stamps.size(), 3u);
}

TEST(TrajectoryTest, GraphInSpaceKeepsItsPoses) {
  PoseRandom random(38);
  PoseGraph<SE3> graph;
  for (int i = 0; i < 20; ++i) graph.AddPose(PoseId{100 - 2 * i}, testing::RandomPose<SE3>(random, 5));
  for (int i = 0; i + 1 < 20; ++i) {
    graph.AddFactor(RelativePoseFactor<SE3>{PoseId{100 - 2 * i}, PoseId{98 - 2 * i},
                                            testing::RandomPose<SE3>(random, 1), random.Information<6>()});
  }
  const TestFile file("trajectory_space.g2o");
  WriteG2o(graph, file.Path());
  const Trajectory read = ReadTrajectory(file.Path());
  ASSERT_EQ(read.stamps.size(), 20u);
  for (std::size_t i = 0; i < 20; ++i) {
    const PoseId id{static_cast<std::int64_t>(read.stamps[i])};
    const SE3& expected = *graph.Poses()[static_cast<std::size_t>(graph.IndexOf(id))].T_world_body;
    EXPECT_EQ(read.T_world_body[i].Translation(), expected.Translation());
    EXPECT_EQ(read.T_world_body[i].Rotation().Unit().coeffs(), expected.Rotation().Unit().coeffs());
  }
}

TEST(TrajectoryTest, KittiAndTumFormsOfTheGroundTruthAgree) {
  TERSE_NEEDS(kitti, "kitti/poses/00.txt");
  TERSE_NEEDS(tum, "kitti/00_ground_truth.tum");
  const Trajectory a = ReadTrajectory(kitti), b = ReadTrajectory(tum);
  EXPECT_EQ(a.format, TrajectoryFormat::kKitti);
  EXPECT_EQ(b.format, TrajectoryFormat::kTum);
  ASSERT_EQ(a.stamps.size(), 4541u);
  EXPECT_EQ(a.stamps, b.stamps);
  for (std::size_t i = 0; i < a.stamps.size(); ++i) {
    EXPECT_LT((a.T_world_body[i].Translation() - b.T_world_body[i].Translation()).norm(), 1e-9);
    // Seven digits in the matrix; the quaternions were made from it without a projection.
    EXPECT_LT((a.T_world_body[i].Rotation().Inverse() * b.T_world_body[i].Rotation()).Log().norm(), 2e-6);
  }
}

}  // namespace
}  // namespace terse
