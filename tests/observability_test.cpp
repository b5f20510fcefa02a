// What a singular graph is said to leave free, against the null space of the dense H; and what is nearly singular.

#include "terse/core/observability.h"

#include <gtest/gtest.h>

#include "terse/core/batch_solver.h"
#include "terse/core/incremental_solver.h"
#include "terse/covariance/marginals.h"
#include "testing.h"

namespace terse {
namespace {

using testing::Random;

template <class Pose>
class ObservabilityTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(ObservabilityTest, Groups);

template <class Pose>
constexpr int kTurns = Pose::kDof - Pose::kDim;

template <class Pose>
struct Built {
  PoseGraph<Pose> graph;
  std::vector<Pose> values;
};

// A random graph, its ids from `first_id` on, added to what is there.
template <class Pose>
void AddRandomComponent(Random& rng, std::int64_t first_id, int poses, Built<Pose>& built) {
  const auto random = testing::MakeRandomGraph<Pose>(rng, {poses, 0.5, 0.02});
  const Pose T_world_start = testing::RandomMotion<Pose>(rng, 30, 1);
  const auto id = [&](PoseId old) { return PoseId{old.value - 100 + first_id}; };
  for (const auto& node : random.graph.Poses()) {
    built.graph.AddPose(id(node.id));
    built.values.push_back(T_world_start * random.truth[static_cast<std::size_t>(random.graph.IndexOf(node.id))]);
  }
  for (const auto& node : random.graph.Factors()) {
    auto f = std::get<RelativePoseFactor<Pose>>(node.factor);
    f.from = id(f.from);
    f.to = id(f.to);
    built.graph.AddFactor(f);
  }
}

// An edge that fits, with information about nothing but what is asked for.
template <class Pose>
RelativePoseFactor<Pose> Edge(const Built<Pose>& built, std::int64_t from, std::int64_t to, double translation,
                              double rotation) {
  const auto at = [&](std::int64_t id) { return built.values[static_cast<std::size_t>(built.graph.IndexOf({id}))]; };
  RelativePoseFactor<Pose> f{PoseId{from}, PoseId{to}, at(from).Inverse() * at(to), Pose::Jacobian::Zero()};
  f.information.diagonal().template head<Pose::kDim>().setConstant(translation);
  f.information.diagonal().template tail<kTurns<Pose>>().setConstant(rotation);
  return f;
}

template <class Pose>
PositionPriorFactor<Pose> PositionPrior(const Built<Pose>& built, std::int64_t id) {
  PositionPriorFactor<Pose> f;
  f.pose = PoseId{id};
  f.p_world = built.values[static_cast<std::size_t>(built.graph.IndexOf({id}))].Translation();
  f.information = 100 * Matrix<Pose::kDim, Pose::kDim>::Identity();
  return f;
}

template <class Pose>
std::vector<FreeMotion> FreeMotionsOf(const Built<Pose>& built, std::string* message = nullptr) {
  try {
    CholeskyAt(built.graph, built.values);
  } catch (const UnobservableError& error) {
    if (message != nullptr) *message = error.what();
    const auto result = SolveBatch(built.graph, built.values);
    EXPECT_EQ(result.termination, Termination::kNotPositiveDefinite);
    EXPECT_EQ(result.message, error.what());
    EXPECT_EQ(result.free_motions.size(), error.motions().size());
    EXPECT_EQ(result.cholesky.Variables(), 0);
    return error.motions();
  }
  ADD_FAILURE() << "the graph is not singular";
  return {};
}

// As many free directions as the dense H, scaled to a unit diagonal, has zero eigenvalues.
template <class Pose>
void ExpectNullity(const Built<Pose>& built, const std::vector<FreeMotion>& motions) {
  const auto dense = testing::MakeDenseSystem(built.graph, built.values);
  const Eigen::VectorXd scale =
      (dense.H.diagonal().array() > 0).select(dense.H.diagonal().cwiseSqrt().cwiseInverse(), 1);
  const auto nullity =
      (testing::Eigenvalues(scale.asDiagonal() * dense.H * scale.asDiagonal()).array() < 1e-13).count();
  Eigen::Index found = 0;
  for (const auto& motion : motions) {
    found += motion.directions.cols();
    EXPECT_LT((motion.directions.transpose() * motion.directions)
                  .
                  operator-(MatrixX::Identity(motion.directions.cols(), motion.directions.cols()))
                  .norm(),
              1e-12);
  }
  EXPECT_EQ(found, nullity);
}

TYPED_TEST(ObservabilityTest, ComponentWithoutPriorFloats) {
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random rng(seed);
    Built<TypeParam> built;
    AddRandomComponent(rng, 100, 12, built);
    AddRandomComponent(rng, 3, 7, built);  // the first pose's component has the anchor, this one nothing
    std::string message;
    const auto motions = FreeMotionsOf(built, &message);
    ASSERT_EQ(motions.size(), 1U) << message;
    EXPECT_EQ(motions[0].freedom, Freedom::kFloating);
    EXPECT_EQ(motions[0].poses, 7U);
    EXPECT_EQ(motions[0].pose, PoseId{3});
    EXPECT_EQ(motions[0].ids, (std::vector<PoseId>{{3}, {4}, {5}, {6}, {7}}));
    EXPECT_NE(message.find("7 poses (poses 3, 4, 5, 6, 7, ...)"), std::string::npos) << message;
    ExpectNullity(built, motions);
    // A prior in the second component takes the anchor from the first, which then floats.
    built.graph.AddFactor(PosePriorFactor<TypeParam>{PoseId{5}, built.values[14], 9 * TypeParam::Jacobian::Identity()});
    const auto other = FreeMotionsOf(built, &message);
    ASSERT_EQ(other.size(), 1U) << message;
    EXPECT_EQ(other[0].freedom, Freedom::kFloating);
    EXPECT_EQ(other[0].pose, PoseId{100});
    EXPECT_EQ(other[0].poses, 12U);
    ExpectNullity(built, other);
  }
}

TYPED_TEST(ObservabilityTest, PositionPriorsLeaveTurns) {
  constexpr int B = TypeParam::kDof, D = TypeParam::kDim;
  Random rng(7);
  Built<TypeParam> built;
  AddRandomComponent(rng, 100, 10, built);
  built.graph.AddFactor(PosePriorFactor<TypeParam>{PoseId{100}, built.values[0], TypeParam::Jacobian::Identity()});
  AddRandomComponent(rng, 200, 8, built);
  built.graph.AddFactor(PositionPrior(built, 204));
  std::string message;
  auto motions = FreeMotionsOf(built, &message);
  ASSERT_EQ(motions.size(), 1U) << message;
  EXPECT_EQ(motions[0].freedom, Freedom::kLooselyHeld);
  EXPECT_EQ(motions[0].pose, PoseId{204});
  EXPECT_EQ(motions[0].poses, 8U);
  ASSERT_EQ(motions[0].directions.cols(), kTurns<TypeParam>);
  // About the measured point: nothing but rotations there, and these along the axes.
  EXPECT_LT(motions[0].directions.topRows(D).norm(), 1e-9);
  EXPECT_NE(message.find(D == 2 ? "pose 204: rotation" : "rotation about z"), std::string::npos) << message;
  ExpectNullity(built, motions);
  // A second point leaves the turn about the line between them, which a plane does not have.
  built.graph.AddFactor(PositionPrior(built, 206));
  if (D == 2) {
    EXPECT_NO_THROW(CholeskyAt(built.graph, built.values));
    return;
  }
  motions = FreeMotionsOf(built, &message);
  ASSERT_EQ(motions.size(), 1U) << message;
  EXPECT_EQ(motions[0].freedom, Freedom::kLooselyHeld);
  ASSERT_EQ(motions[0].directions.cols(), 1);
  const VectorX line = built.values[14].Inverse().Adjoint().template topLeftCorner<D, D>() *
                       (built.values[16].Translation() - built.values[14].Translation()).normalized();
  EXPECT_NEAR(std::abs(line.dot(motions[0].directions.col(0).tail(B - D))), 1, 1e-9) << message;
  ExpectNullity(built, motions);
}

// The information must be positive definite, but 1e-30 beside 100 is nothing.
TYPED_TEST(ObservabilityTest, DirectionsThatNoFactorMeasures) {
  constexpr int D = TypeParam::kDim;
  Random rng(13);
  Built<TypeParam> built;
  AddRandomComponent(rng, 100, 10, built);
  // 110 - 111 - 112: no edge knows of rotations, so 110 and 111 turn in place, what hangs on them swings along, and 112
  // turns alone. So do, in space, the others about their own edge.
  for (std::int64_t id = 110; id < 113; ++id) {
    built.graph.AddPose({id});
    built.values.push_back(built.values.back() * testing::RandomMotion<TypeParam>(rng, 2, 0.5));
    built.graph.AddFactor(Edge(built, id - 1, id, 100, 1e-30));
  }
  std::string message;
  const auto motions = FreeMotionsOf(built, &message);
  Eigen::Index directions = 0;
  for (const auto& motion : motions) {
    EXPECT_EQ(motion.freedom, Freedom::kUnmeasured);
    EXPECT_GE(motion.pose.value, 110) << message;
    EXPECT_LT(motion.directions.topRows(D).norm(), 1e-9) << message;  // a turn in place
    directions += motion.directions.cols();
  }
  EXPECT_EQ(directions, 3 * kTurns<TypeParam>) << message;
  EXPECT_NE(message.find("no factor measures of pose 112: rotation"), std::string::npos) << message;
}

// A measured turn about the vertical axis only, as an odometer with a compass has: 3D alone.
TEST(Observability, NamesTheAxes) {
  Random rng(17);
  Built<SE3> built;
  AddRandomComponent(rng, 0, 6, built);
  built.graph.AddPose({6});
  built.values.push_back(built.values.back() * testing::RandomMotion<SE3>(rng, 2, 0.5));
  auto edge = Edge(built, 5, 6, 100, 1e-40);
  edge.information(5, 5) = 100;
  built.graph.AddFactor(edge);
  // What hangs on pose 6 makes the rounding that a turn of it drowns in.
  built.graph.AddPose({7});
  built.values.push_back(built.values.back() * testing::RandomMotion<SE3>(rng, 2, 0.5));
  built.graph.AddFactor(Edge(built, 6, 7, 100, 100));
  std::string message;
  const auto motions = FreeMotionsOf(built, &message);
  ASSERT_EQ(motions.size(), 1U) << message;
  EXPECT_EQ(motions[0].pose, PoseId{6});
  EXPECT_EQ(motions[0].ids, (std::vector<PoseId>{{6}, {7}}));
  EXPECT_NE(message.find("pose 6: rotation about x, rotation about y (it takes along"), std::string::npos) << message;
  ExpectNullity(built, motions);
}

TYPED_TEST(ObservabilityTest, AFailedUpdateSaysWhatWouldBeFree) {
  Random rng(19);
  Built<TypeParam> built;
  AddRandomComponent(rng, 100, 10, built);
  IncrementalSolver<TypeParam> solver;
  GraphUpdate<TypeParam> all;
  for (const auto& node : built.graph.Poses()) all.poses.push_back({node.id});
  for (const auto& node : built.graph.Factors()) all.factors.push_back(node.factor);
  const auto ids = solver.Update(all).factor_ids;
  const double log_determinant = solver.LogDeterminant();
  // Two new poses that know only each other, and all links of pose 100 gone.
  GraphUpdate<TypeParam> bad;
  bad.poses = {{PoseId{7}, TypeParam()}, {PoseId{8}, std::nullopt}};
  bad.factors.push_back(
      RelativePoseFactor<TypeParam>{PoseId{7}, PoseId{8}, TypeParam(), TypeParam::Jacobian::Identity()});
  for (const auto& node : solver.Graph().Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    if (ends.first == PoseId{100} || ends.second == PoseId{100}) bad.removed.push_back(node.id);
  }
  try {
    solver.Update(bad);
    FAIL() << "the update was made";
  } catch (const UnobservableError& error) {
    ASSERT_EQ(error.motions().size(), 2U) << error.what();
    EXPECT_EQ(error.motions()[0].pose, PoseId{7}) << error.what();
    EXPECT_EQ(error.motions()[0].poses, 2U);
    EXPECT_EQ(error.motions()[1].pose, PoseId{101});
    EXPECT_EQ(error.motions()[1].poses, 9U);
    for (const auto& motion : error.motions()) {
      EXPECT_EQ(motion.freedom, Freedom::kFloating);
      EXPECT_EQ(motion.directions.cols(), TypeParam::kDof);
    }
  }
  EXPECT_EQ(solver.LogDeterminant(), log_determinant);
  EXPECT_EQ(solver.Graph().Poses().size(), 10U);
  EXPECT_EQ(solver.Graph().Factors().size(), ids.size());
  EXPECT_TRUE(solver.Finish().Converged());
}

// There is either an error that names what is free, or every covariance is finite and positive definite. True if the
// graph has covariances.
template <class Pose>
bool HasSoundCovariances(const Built<Pose>& built, PoseId a, PoseId b) {
  try {
    const Marginals<Pose> marginals(built.graph, built.values);
    std::vector<PoseId> ids;
    for (const auto& node : built.graph.Poses()) ids.push_back(node.id);
    for (const auto& Sigma : marginals.AllMarginals()) {
      EXPECT_TRUE(Sigma.allFinite()) << Sigma;
      EXPECT_GT(Sigma.diagonal().minCoeff(), 0) << Sigma;
    }
    EXPECT_TRUE(marginals.Joint(ids).allFinite());
    const auto relative = marginals.Relative(a, b);
    EXPECT_TRUE(relative.allFinite()) << relative;
    EXPECT_GE(relative.diagonal().minCoeff(), 0) << relative;
    return true;
  } catch (const UnobservableError& error) {
    EXPECT_FALSE(error.motions().empty());
    for (const auto& motion : error.motions()) {
      EXPECT_TRUE(motion.directions.allFinite());
      EXPECT_EQ(motion.directions.rows(), Pose::kDof);
    }
    return false;
  }
}

// From well measured to not at all.
TYPED_TEST(ObservabilityTest, NearlySingularIsNeverNaN) {
  int chains = 0, bridges = 0, priors = 0, ends = 0, count = 0;
  for (int decades = 0; decades <= 300; decades += decades < 40 ? 1 : 20) {
    SCOPED_TRACE("information 1e-" + std::to_string(decades));
    const double weak = std::pow(10.0, -decades);
    ++count;
    Random rng(23);
    Built<TypeParam> built;
    AddRandomComponent(rng, 100, 8, built);
    // A chain that hardly knows of rotations.
    Built<TypeParam> chain = built;
    for (std::int64_t id = 108; id < 112; ++id) {
      chain.graph.AddPose({id});
      chain.values.push_back(chain.values.back() * testing::RandomMotion<TypeParam>(rng, 2, 0.5));
      chain.graph.AddFactor(Edge(chain, id - 1, id, 1, weak));
    }
    chains += HasSoundCovariances(chain, {108}, {111});
    // Two components that hardly hang together.
    Built<TypeParam> bridge = built;
    AddRandomComponent(rng, 200, 8, bridge);
    bridge.graph.AddFactor(Edge(bridge, 103, 204, weak, weak));
    bridges += HasSoundCovariances(bridge, {103}, {204});
    // A map that is hardly held.
    Built<TypeParam> prior = built;
    prior.graph.AddFactor(
        PosePriorFactor<TypeParam>{PoseId{104}, built.values[4], weak * TypeParam::Jacobian::Identity()});
    priors += HasSoundCovariances(prior, {101}, {107});
    // A last pose of which hardly anything is known: nothing else depends on it.
    Built<TypeParam> end = built;
    end.graph.AddPose({108});
    end.values.push_back(built.values.back() * testing::RandomMotion<TypeParam>(rng, 2, 0.5));
    end.graph.AddFactor(Edge(end, 107, 108, weak, weak));
    ends += HasSoundCovariances(end, {107}, {108});
  }
  for (const int sound : {chains, bridges}) {
    EXPECT_GT(sound, 10);
    EXPECT_LT(sound, count - 10);
  }
  EXPECT_EQ(priors, count) << "what a prior hardly holds the anchor does";
  EXPECT_GT(ends, 10);
}

// More than the search looks for, in a graph of thousands of poses.
TYPED_TEST(ObservabilityTest, ManyFreeDirectionsInALargeGraph) {
  Random rng(29);
  Built<TypeParam> built;
  AddRandomComponent(rng, 0, 800, built);
  for (std::int64_t k = 0; k < 40; ++k) {
    built.graph.AddPose({5000 + 2 * k});
    built.graph.AddPose({5001 + 2 * k});
    const TypeParam at = built.values[static_cast<std::size_t>(20 * k)];
    built.values.push_back(at * testing::RandomMotion<TypeParam>(rng, 2, 0.5));
    built.values.push_back(at * testing::RandomMotion<TypeParam>(rng, 2, 0.5));
    built.graph.AddFactor(Edge(built, 20 * k, 5000 + 2 * k, 100, 1e-60));
    built.graph.AddFactor(Edge(built, 5000 + 2 * k, 5001 + 2 * k, 100, 100));
  }
  std::string message;
  const auto motions = FreeMotionsOf(built, &message);
  EXPECT_GE(motions.size(), 8U) << message;
  for (const auto& motion : motions) {
    EXPECT_EQ(motion.freedom, Freedom::kUnmeasured);
    EXPECT_EQ(motion.poses, 2U) << Describe(motion);
    EXPECT_EQ(motion.pose.value % 2, 0) << Describe(motion);
    EXPECT_EQ(motion.directions.cols(), kTurns<TypeParam>) << Describe(motion);
  }
  EXPECT_NE(message.find("there may be more"), std::string::npos) << message;
}

TYPED_TEST(ObservabilityTest, WhatIsNotFiniteIsNoFreeMotion) {
  Random rng(31);
  Built<TypeParam> built;
  AddRandomComponent(rng, 100, 5, built);
  auto edge = Edge(built, 100, 104, 1, 1);
  edge.information *= 1e307;
  edge.information(0, 0) = 1e307;
  built.values[4] = built.values[4] * testing::RandomMotion<TypeParam>(rng, 1e5, 0);
  built.graph.AddFactor(edge);
  try {
    CholeskyAt(built.graph, built.values);
    FAIL() << "the graph is finite";
  } catch (const UnobservableError& error) {
    FAIL() << error.what();
  } catch (const NumericalError& error) {
    EXPECT_NE(std::string(error.what()).find("not finite"), std::string::npos) << error.what();
  }
}

TEST(Observability, DescribesDirections) {
  const auto describe = [](std::vector<double> d) {
    return DescribeDirection(Eigen::Map<const Eigen::VectorXd>(d.data(), static_cast<Eigen::Index>(d.size())));
  };
  EXPECT_EQ(describe({0, 1, 0}), "translation y");
  EXPECT_EQ(describe({0, 0, 1}), "rotation");
  EXPECT_EQ(describe({0.6, 0.8, 0}), "translation along (0.6, 0.8)");
  EXPECT_EQ(describe({0.6, 0, 0.8}), "translation (0.6, 0) with rotation (0.8)");
  EXPECT_EQ(describe({0, 0, -1, 0, 0, 0}), "translation z");
  EXPECT_EQ(describe({0, 0, 0, 0, 1, 0}), "rotation about y");
  EXPECT_EQ(describe({0, 0, 0, 0.6, 0, 0.8}), "rotation about (0.6, 0, 0.8)");
}

}  // namespace
}  // namespace terse
