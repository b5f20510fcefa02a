// Graphs packed for sending (WritePacked): what is kept, how well, how small, and what is refused.

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <limits>

#include "terse/core/batch_solver.h"
#include "terse/core/generate.h"
#include "terse/core/graph_file.h"
#include "terse/core/limits.h"
#include "terse/core/packed_columns.h"
#include "terse/core/state_file.h"
#include "testing.h"
#include "testing_files.h"
#include "testing_scene.h"

namespace terse {
namespace {

using internal::Column;
using internal::Deflate;
using internal::Inflate;
using testing::Random;

constexpr std::int64_t kLeast = std::numeric_limits<std::int64_t>::min();
constexpr std::int64_t kMost = std::numeric_limits<std::int64_t>::max();

template <class Pose>
PoseGraph<Pose> ThereAndBack(const PoseGraph<Pose>& graph, const PackedPrecision& precision = {}) {
  const TestFile file("there.packed");
  WritePacked(graph, file.Path(), precision);
  GraphFile read = ReadGraph(file.Path());
  EXPECT_EQ(read.format, GraphFormat::kPacked);
  return std::get<PoseGraph<Pose>>(read.graph);
}

// The largest relative error of the information in any direction.
template <int N>
double InformationError(const Matrix<N, N>& written, const Matrix<N, N>& read) {
  const Eigen::MatrixXd a = read, b = written;
  const auto ratios = Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd>(a, b).eigenvalues();
  return (ratios.array() - 1).abs().maxCoeff();
}

// Half a step in every coordinate, along the axes of the residual.
template <class Pose>
void ExpectWithinHalfAStep(const Pose& written, const Pose& read, const typename Pose::Jacobian& information,
                           const PackedPrecision& precision) {
  constexpr int D = Pose::kDim, N = Pose::kDof;
  const Vector<N> sigmas = information.diagonal().cwiseSqrt().cwiseInverse();
  const Vector<D> shift = (read.Inverse() * written).Translation();
  for (int i = 0; i < D; ++i)
    EXPECT_LE(std::abs(shift[i]), 0.5 * precision.translation * sigmas[i] * (1 + 1e-9) + 1e-12);
  // Half a step in each of a rotation's coordinates, which are as long as the turn or longer.
  const double step = precision.rotation * sigmas.template tail<N - D>().minCoeff();
  const double turn = (read.Inverse() * written).Log().template tail<N - D>().norm();
  EXPECT_LE(turn, 0.5 * std::sqrt(N - D) * step * (1 + 1e-9) + 1e-12) << "for the axis that is known best";
}

template <class Pose>
void ExpectAlike(const PoseGraph<Pose>& written, const PoseGraph<Pose>& read, const PackedPrecision& precision) {
  ASSERT_EQ(read.Poses().size(), written.Poses().size());
  for (std::size_t k = 0; k < written.Poses().size(); ++k) {
    EXPECT_EQ(read.Poses()[k].id, written.Poses()[k].id);
    EXPECT_EQ(read.Poses()[k].fixed, written.Poses()[k].fixed);
  }
  ASSERT_EQ(read.Factors().size(), written.Factors().size());
  for (std::size_t k = 0; k < written.Factors().size(); ++k) {
    const auto &a = written.Factors()[k].factor, &b = read.Factors()[k].factor;
    ASSERT_EQ(a.index(), b.index()) << "the order of factors is kept";
    EXPECT_EQ(PosesOf(a).first, PosesOf(b).first);
    EXPECT_EQ(PosesOf(a).second, PosesOf(b).second);
    std::visit(
        [&](const auto& f) {
          using Kind = std::decay_t<decltype(f)>;
          const auto& g = std::get<Kind>(b);
          EXPECT_LT(InformationError<decltype(f.information)::RowsAtCompileTime>(f.information, g.information), 0.01);
          if constexpr (std::is_same_v<Kind, RelativePoseFactor<Pose>>) {
            ExpectWithinHalfAStep(f.T_from_to, g.T_from_to, g.information, precision);
          } else if constexpr (std::is_same_v<Kind, PosePriorFactor<Pose>>) {
            ExpectWithinHalfAStep(f.T_world_body, g.T_world_body, g.information, precision);
          } else {
            EXPECT_EQ(f.p_body, g.p_body);
            for (int i = 0; i < Pose::kDim; ++i) {
              const double step = precision.translation / std::sqrt(g.information(i, i));
              EXPECT_LE(std::abs(f.p_world[i] - g.p_world[i]), 0.5 * step * (1 + 1e-9) + 1e-12);
            }
          }
        },
        a);
  }
}

template <class Pose>
class PackedGraphTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(PackedGraphTest, Groups);

TYPED_TEST(PackedGraphTest, KeepsMeasurementsToAStepAndTheRestAsItIs) {
  using Pose = TypeParam;
  Random rng(31);
  for (const PackedPrecision& precision : {PackedPrecision(), PackedPrecision{0.5, 1e-4}, PackedPrecision{1, 1}}) {
    for (int trial = 0; trial < 10; ++trial) {
      testing::RandomGraphOptions options;
      options.priors = true;
      options.id_stride = 1 + trial;
      PoseGraph<Pose> graph = testing::MakeRandomGraph<Pose>(rng, options).graph;
      typename Pose::Position world = 1e6 * testing::NormalVector<Pose::kDim>(rng),
                              lever = testing::NormalVector<Pose::kDim>(rng);
      graph.AddFactor(
          PositionPriorFactor<Pose>{graph.Poses()[3].id, world, testing::RandomInformation<Pose::kDim>(rng), lever});
      for (const std::size_t k : {std::size_t{0}, std::size_t{7}}) graph.SetFixed(graph.Poses()[k].id, true);
      const PoseGraph<Pose> read = ThereAndBack(graph, precision);
      ExpectAlike(graph, read, precision);
      EXPECT_FALSE(read.Poses()[1].T_world_body) << "poses that are not fixed have no values";
      EXPECT_LT((read.Poses()[7].T_world_body->Inverse() * *graph.Poses()[7].T_world_body).Log().norm(), 1e-12);
    }
  }
}

TYPED_TEST(PackedGraphTest, TheOptimumStaysWithinAFractionOfItsStandardDeviations) {
  using Pose = TypeParam;
  Random rng(32);
  testing::RandomGraphOptions options;
  options.poses = 60;
  const PoseGraph<Pose> graph = testing::MakeRandomGraph<Pose>(rng, options).graph;
  PoseGraph<Pose> read = ThereAndBack(graph);
  for (const auto& pose : graph.Poses()) read.SetPose(pose.id, *pose.T_world_body);
  const BatchResult<Pose> before = SolveBatch(graph), after = SolveBatch(read);
  // Both with the first pose where it is: what is left is the shape.
  Eigen::VectorXd shift(Pose::kDof * static_cast<int>(graph.Poses().size()));
  for (std::size_t k = 0; k < graph.Poses().size(); ++k) {
    const Pose a = before.T_world_body[0].Inverse() * before.T_world_body[k];
    const Pose b = after.T_world_body[0].Inverse() * after.T_world_body[k];
    shift.segment<Pose::kDof>(Pose::kDof * static_cast<int>(k)) = a.Local(b);
  }
  const testing::DenseSystem system = testing::MakeDenseSystem(graph, before.T_world_body);
  const double squared = shift.dot(system.H * shift) / static_cast<double>(shift.size());
  EXPECT_GT(squared, 0);
  EXPECT_LT(std::sqrt(squared), 0.1) << "in standard deviations, a coordinate";
}

TYPED_TEST(PackedGraphTest, IdsAndOrderMayBeAnything) {
  using Pose = TypeParam;
  constexpr int N = Pose::kDof;
  Random rng(33);
  PoseGraph<Pose> graph;
  const std::vector<std::int64_t> ids = {kMost, kLeast, 0, -1, kMost - 1, 17};
  for (const std::int64_t id : ids) graph.AddPose({id});
  graph.SetFixed({17}, true);
  for (std::size_t k = 1; k < ids.size(); ++k) {
    const Matrix<N, N> information = testing::RandomInformation<N>(rng);
    for (int twice = 0; twice < 2; ++twice) {  // the same matrix again, the later pose first
      graph.AddFactor(
          RelativePoseFactor<Pose>{{ids[k]}, {ids[k - 1]}, testing::RandomMotion<Pose>(rng, 1, 3), information});
      graph.AddFactor(
          RelativePoseFactor<Pose>{{ids[0]}, {ids[k]}, testing::RandomMotion<Pose>(rng, 1, 3), information});
    }
  }
  const PoseGraph<Pose> read = ThereAndBack(graph);
  ExpectAlike(graph, read, PackedPrecision());
  EXPECT_TRUE(read.Poses().back().fixed);
  EXPECT_FALSE(read.Poses().back().T_world_body);
  PoseGraph<Pose> alone;
  alone.AddPose({5});
  EXPECT_EQ(ThereAndBack(alone).Poses().size(), 1u);
}

// A coarse step of one axis is no error of another: robots that turn know yaw better than roll and pitch.
TEST(PackedGraphFileTest, AxesOfLargeTurnsAreNotMixed) {
  Random rng(36);
  PoseGraph<SE3> graph;
  graph.AddPose({0});
  const Vector<6> information = (Vector<6>() << 1, 100, 1e4, 1, 1e2, 1e4).finished();
  for (int k = 1; k < 200; ++k) {
    graph.AddPose({k});
    graph.AddFactor(
        RelativePoseFactor<SE3>{{k - 1}, {k}, testing::RandomMotion<SE3>(rng, 1, 3), information.asDiagonal()});
  }
  const PoseGraph<SE3> read = ThereAndBack(graph);
  double worst = 0;
  for (std::size_t k = 0; k < graph.Factors().size(); ++k) {
    const auto& a = std::get<RelativePoseFactor<SE3>>(graph.Factors()[k].factor);
    const auto& b = std::get<RelativePoseFactor<SE3>>(read.Factors()[k].factor);
    const Vector<6> off = (b.T_from_to.Inverse() * a.T_from_to).Log();
    worst = std::max(worst, off.cwiseProduct(information.cwiseSqrt()).cwiseAbs().maxCoeff());
  }
  EXPECT_LT(worst, 0.5 / 32 * std::sqrt(3) * 1.1) << "standard deviations of any axis";
}

TYPED_TEST(PackedGraphTest, InformationOfAnySizeAndCorrelation) {
  using Pose = TypeParam;
  constexpr int N = Pose::kDof;
  Random rng(34);
  PoseGraph<Pose> graph;
  graph.AddPose({0});
  for (int k = 1; k < 40; ++k) {
    graph.AddPose({k});
    const Matrix<N, N> Q = testing::RandomInformation<N>(rng);
    // Eigenvalues over k / 4 decades, along axes that are nobody's.
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen{Eigen::MatrixXd(Q)};
    Eigen::VectorXd values(N);
    for (int i = 0; i < N; ++i) values[i] = std::pow(10, k / 4.0 * i / (N - 1));
    const Eigen::MatrixXd made = eigen.eigenvectors() * values.asDiagonal() * eigen.eigenvectors().transpose();
    const Matrix<N, N> information = 0.5 * (made + made.transpose());
    graph.AddFactor(RelativePoseFactor<Pose>{{k - 1}, {k}, testing::RandomMotion<Pose>(rng, 1, 1), information});
  }
  ExpectAlike(graph, ThereAndBack(graph), PackedPrecision());
}

TEST(PackedGraphFileTest, AWorldTakesATwentiethOfItsText) {
  const PoseGraph<SE2> graph = testing::MakeScene<SE2>(Scene::kManhattan, 2000, 1).graph;
  const TestFile text("world.g2o"), packed("world.packed");
  WriteG2o(graph, text.Path());
  WritePacked(graph, packed.Path());
  EXPECT_LT(20 * packed.Content().size(), text.Content().size()) << packed.Content().size() << " bytes";
}

TEST(PackedGraphFileTest, WhatCannotBeKeptIsRefusedAndTheFileStays) {
  PoseGraph<SE2> graph;
  graph.AddPose({3});
  graph.AddPose({4});
  graph.AddFactor(RelativePoseFactor<SE2>{{3}, {4}, SE2(Vector<2>(1, 0), 0), 1e40 * Matrix<3, 3>::Identity()});
  const TestFile file("kept.packed", "as it was");
  try {
    WritePacked(graph, file.Path());
    ADD_FAILURE() << "packed";
  } catch (const NumericalError& error) {
    EXPECT_NE(std::string(error.what()).find("3 and pose 4 cannot be packed"), std::string::npos) << error.what();
  }
  for (const double bad : {0.0, -1.0, 1.5, std::nan("")}) {
    EXPECT_THROW(WritePacked(graph, file.Path(), {bad, 0.1}), std::invalid_argument);
    EXPECT_THROW(WritePacked(graph, file.Path(), {0.1, bad}), std::invalid_argument);
  }
  EXPECT_EQ(file.Content(), "as it was");
}

TEST(PackedGraphFileTest, PiecesAreRefusedAsInOtherFormats) {
  PoseGraph<SE2> graph;
  graph.AddPose({1});
  graph.AddPose({2});
  const TestFile file("pieces.packed");
  WritePacked(graph, file.Path());
  EXPECT_THROW(ReadGraph(file.Path()), FileError);
  ReadOptions options;
  options.expect_connected = false;
  EXPECT_EQ(std::get<PoseGraph<SE2>>(ReadGraph(file.Path(), options).graph).Poses().size(), 2u);
}

TEST(PackedGraphFileTest, DamageIsFound) {
  const TestFile file("whole.packed");
  WritePacked(testing::MakeScene<SE2>(Scene::kManhattan, 30, 1).graph, file.Path());
  const std::string whole = file.Content();
  for (std::size_t k = 0; k < whole.size(); ++k) {
    std::string damaged = whole;
    damaged[k] = static_cast<char>(damaged[k] ^ 0x20);
    const TestFile other("damaged.packed", damaged);
    EXPECT_THROW(ReadGraph(other.Path()), FileError) << k;
    const TestFile cut("cut.packed", whole.substr(0, k));
    EXPECT_THROW(ReadGraph(cut.Path()), FileError) << k;
  }
}

// What a file holds, by names of its columns, with a checksum that fits.
struct Columns {
  int dimension = 2;
  double translation = 0.1, rotation = 0.1;
  Column ids = {1, 1}, pose_kinds = {0, 0}, values, kinds = {0}, last = {1}, back = {1}, which = {0},
         scales = {1, 2, 3}, couplings = {0, 0, 0}, levers;
  std::vector<Column> measured = {{10}, {0}, {0}};
};

std::string Refusal(const Columns& c, const std::string& kinds = "") {
  StateWriter writer("packed graph");
  writer(c.dimension, c.translation, c.rotation);
  for (const Column* column :
       {&c.ids, &c.pose_kinds, &c.values, &c.kinds, &c.last, &c.back, &c.which, &c.scales, &c.couplings, &c.levers}) {
    writer(column == &c.kinds && !kinds.empty() ? kinds : Deflate(*column));
  }
  std::vector<std::string> measured;
  for (const Column& column : c.measured) measured.push_back(Deflate(column));
  writer(measured);
  const TestFile file("made.packed", std::move(writer).Bytes());
  try {
    ReadGraph(file.Path());
  } catch (const FileError& error) {
    return error.what();
  }
  return "";
}

TEST(PackedGraphFileTest, ColumnsThatMakeNoGraphAreRefused) {
  EXPECT_EQ(Refusal({}), "") << "the others differ from this one";
  const auto refused = [](const char* cause, auto change) {
    Columns columns;
    change(columns);
    const std::string text = Refusal(columns);
    EXPECT_NE(text.find(cause), std::string::npos) << cause << " in " << text;
  };
  refused("5 dimensions", [](Columns& c) { c.dimension = 5; });
  refused("precision", [](Columns& c) { c.rotation = 0; });
  refused("columns", [](Columns& c) { c.measured.pop_back(); });
  refused("too short", [](Columns& c) { c.pose_kinds = {0}; });
  refused("too long", [](Columns& c) { c.back = {1, 1}; });
  refused("too long", [](Columns& c) { c.measured[2] = {0, 0}; });
  refused("in the graph already", [](Columns& c) { c.ids = {1, 0}; });
  refused("kind of factor", [](Columns& c) { c.kinds = {3}; });
  refused("kind of factor", [](Columns& c) { c.kinds = {-1}; });
  for (const std::int64_t bad : {std::int64_t{-1}, std::int64_t{2}, kLeast, kMost}) {
    refused("a pose that there is not", [&](Columns& c) { c.last = {bad}; });
    if (bad != -1) refused("a pose that there is not", [&](Columns& c) { c.back = {bad}; });
    refused("information matrix that there is not", [&](Columns& c) { c.which = {bad}; });
  }
  refused("joins a pose to itself", [](Columns& c) { c.back = {0}; });
  for (const std::int64_t bad : {kLeast, kMost, std::int64_t{-300000}, std::int64_t{1} << 40}) {
    refused("packed graph makes no sense", [&](Columns& c) { c.scales = {bad, 0, 0}; });
  }
  refused("packed graph makes no sense", [](Columns& c) { c.pose_kinds = {2, 0}, c.values = {-1, -1, -1}; });
  for (const std::int64_t bad : {kLeast, std::int64_t{-1}, std::int64_t{3}}) {
    refused("kind of pose", [&](Columns& c) { c.pose_kinds = {bad, 0}; });
  }
}

// Some kilobytes that stand for more factors than there is memory for.
TEST(PackedGraphFileTest, MoreThanTheMemoryHoldsIsRefusedBeforeItIsTaken) {
  const std::uint64_t count = UsableMemory() / 1024;
  std::string kinds;
  for (int k = 0; k < 8; ++k) kinds += static_cast<char>(count >> (8 * k) & 0xff);
  kinds += '\1';
  kinds.append(static_cast<std::size_t>(count / 1000), '\0');
  EXPECT_EQ(internal::InflatedCount(kinds), count);
  const std::string text = Refusal({}, kinds);
  EXPECT_NE(text.find("larger than this machine's memory allows"), std::string::npos) << text;
  kinds[5] = 1;  // 2^40 more
  EXPECT_EQ(internal::InflatedCount(kinds), 0u);
}

TEST(PackedColumnTest, GoesThereAndBack) {
  Random rng(35);
  for (const std::size_t size : {std::size_t{0}, std::size_t{1}, std::size_t{2}, std::size_t{1000}}) {
    for (const std::int64_t range : {std::int64_t{0}, std::int64_t{1}, std::int64_t{300}, kMost}) {
      Column column(size);
      for (auto& x : column) x = range == 0 ? 0 : static_cast<std::int64_t>(rng()) % range;
      EXPECT_EQ(Inflate(Deflate(column)), column);
    }
  }
  EXPECT_EQ(Inflate(Deflate({kLeast, kMost, -1, 0})), (Column{kLeast, kMost, -1, 0}));
  EXPECT_LT(Deflate(Column(1000000, 0)).size(), 1100u);
}

TEST(PackedColumnTest, PromisesAreNotBelieved) {
  std::string bytes = Deflate(Column(100, 7));
  for (const std::size_t k : {std::size_t{0}, std::size_t{3}, std::size_t{7}, std::size_t{8}}) {
    std::string other = bytes;
    other[k] = static_cast<char>(other[k] + 1);  // more elements, or more bytes of each
    EXPECT_THROW(Inflate(other), std::invalid_argument) << k;
  }
  EXPECT_THROW(Inflate(bytes.substr(0, 8)), std::invalid_argument);
  EXPECT_THROW(Inflate(""), std::invalid_argument);
}

}  // namespace
}  // namespace terse
