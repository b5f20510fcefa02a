#include "terse/core/pose_graph.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <set>

#include "testing.h"

namespace terse {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

template <class Pose>
Pose RandomPose(std::mt19937& random) {
  std::normal_distribution<double> normal;
  typename Pose::Tangent d;
  for (int i = 0; i < Pose::kDof; ++i) d[i] = normal(random);
  return Pose::Exp(d);
}

template <class Pose>
typename Pose::Jacobian RandomInformation(std::mt19937& random) {
  std::normal_distribution<double> normal;
  typename Pose::Jacobian A;
  for (int i = 0; i < A.size(); ++i) A.data()[i] = normal(random);
  typename Pose::Jacobian information = A * A.transpose() + 0.1 * Pose::Jacobian::Identity();
  return 0.5 * (information + information.transpose()).eval();
}

template <class Pose>
RelativePoseFactor<Pose> Edge(std::int64_t from, std::int64_t to) {
  return {{from}, {to}, Pose(), Pose::Jacobian::Identity()};
}

template <class Pose>
class PoseGraphTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(PoseGraphTest, Groups);

TYPED_TEST(PoseGraphTest, AnyIdInAnyOrderKeepsItsIndex) {
  using Pose = TypeParam;
  PoseGraph<Pose> graph;
  const std::int64_t ids[] = {7, std::numeric_limits<std::int64_t>::max(), -3, std::numeric_limits<std::int64_t>::min(),
                              0};
  for (const std::int64_t id : ids) graph.AddPose({id});
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(graph.IndexOf({ids[i]}), i);
    EXPECT_EQ(graph.Poses()[static_cast<std::size_t>(i)].id, PoseId{ids[i]});
    EXPECT_FALSE(graph.Poses()[static_cast<std::size_t>(i)].T_world_body.has_value());
  }
  EXPECT_FALSE(graph.HasPose({1}));
  EXPECT_THROW(graph.IndexOf({1}), std::invalid_argument);
  EXPECT_THROW(graph.SetPose({1}, Pose()), std::invalid_argument);
  EXPECT_THROW(graph.SetFixed({1}, true), std::invalid_argument);
  EXPECT_THROW(graph.AddPose({7}), std::invalid_argument);
  EXPECT_EQ(graph.Poses().size(), 5u);
  graph.SetFixed({7}, true);
  EXPECT_TRUE(graph.Poses()[0].fixed);
}

TYPED_TEST(PoseGraphTest, InformationThatWasNeverSetIsNamed) {
  using Pose = TypeParam;
  PoseGraph<Pose> graph;
  graph.AddPose({1});
  graph.AddPose({2});
  RelativePoseFactor<Pose> edge;
  edge.from = {1};
  edge.to = {2};
  PosePriorFactor<Pose> prior;
  prior.pose = {1};
  PositionPriorFactor<Pose> position;
  position.pose = {1};
  for (const Factor<Pose>& factor : {Factor<Pose>(edge), Factor<Pose>(prior), Factor<Pose>(position)}) {
    EXPECT_NE(FindDefect(factor).find("the information is zero everywhere (unset?)"), std::string::npos)
        << FindDefect(factor);
    EXPECT_THROW(graph.AddFactor(factor), std::invalid_argument);
  }
  EXPECT_NE(FindDefect<Pose>(edge).find("edge 1 -> 2: "), std::string::npos);
  edge.information(0, 0) = 1;
  EXPECT_NE(FindDefect<Pose>(edge).find("not positive definite"), std::string::npos) << "is set, but wrong";
}

TYPED_TEST(PoseGraphTest, RemovedFactorsLeaveTheOthersAndTheirIds) {
  using Pose = TypeParam;
  std::mt19937 random(1);
  PoseGraph<Pose> graph;
  for (int i = 0; i < 10; ++i) graph.AddPose({i});
  std::set<std::int64_t> living;
  std::int64_t newest = -1;
  for (int step = 0; step < 400; ++step) {
    // Now more come than go, now more go.
    if (living.empty() || random() % 4 < (step / 50 % 2 == 0 ? 3U : 1U)) {
      const FactorId id = graph.AddFactor(
          Edge<Pose>(static_cast<std::int64_t>(random() % 5), 5 + static_cast<std::int64_t>(random() % 5)));
      EXPECT_GT(id.value, newest) << "an id was reused";
      newest = id.value;
      living.insert(id.value);
    } else {
      auto it = living.begin();
      std::advance(it, static_cast<long>(random() % living.size()));
      EXPECT_TRUE(graph.RemoveFactor({*it}));
      EXPECT_FALSE(graph.RemoveFactor({*it}));
      EXPECT_EQ(graph.FindFactor({*it}), nullptr);
      living.erase(it);
    }
    ASSERT_EQ(graph.Factors().size(), living.size());
    auto wanted = living.begin();
    std::size_t k = 0;
    for (const auto& node : graph.Factors()) {
      EXPECT_EQ(node.id.value, *wanted++);
      EXPECT_EQ(graph.FindFactor(node.id), &node);
      EXPECT_EQ(&graph.Factors()[k++], &node);
    }
    EXPECT_EQ(k, living.size());
    EXPECT_THROW(graph.Factors().at(k), std::out_of_range);
  }
  EXPECT_FALSE(graph.RemoveFactor({newest + 1}));
  EXPECT_FALSE(graph.RemoveFactor({-1}));
}

TYPED_TEST(PoseGraphTest, DefectsAreRefusedAndLeaveTheGraphAsItWas) {
  using Pose = TypeParam;
  PoseGraph<Pose> graph;
  graph.AddPose({0}, Pose());
  graph.AddPose({1}, Pose());
  const FactorId first = graph.AddFactor(Edge<Pose>(0, 1));

  std::vector<Factor<Pose>> bad;
  bad.push_back(Edge<Pose>(0, 0));
  bad.push_back(Edge<Pose>(0, 2));
  bad.push_back(Edge<Pose>(2, 0));
  RelativePoseFactor<Pose> edge = Edge<Pose>(0, 1);
  edge.information(0, 0) = 0;
  bad.push_back(edge);
  edge.information(0, 0) = -1;
  bad.push_back(edge);
  edge.information(0, 0) = kNaN;
  bad.push_back(edge);
  edge.information(0, 0) = std::numeric_limits<double>::infinity();
  bad.push_back(edge);
  edge = Edge<Pose>(0, 1);
  edge.information(0, 1) = 0.5;
  bad.push_back(edge);
  PosePriorFactor<Pose> prior{{2}, Pose(), Pose::Jacobian::Identity()};
  bad.push_back(prior);
  prior.pose = {0};
  prior.information *= -1;
  bad.push_back(prior);
  PositionPriorFactor<Pose> position{{0}, Pose::Position::Zero(), Matrix<Pose::kDim, Pose::kDim>::Identity()};
  position.p_world[1] = kNaN;
  bad.push_back(position);
  position.p_world.setZero();
  position.information.setOnes();  // positive semidefinite only
  bad.push_back(position);

  for (std::size_t i = 0; i < bad.size(); ++i) {
    EXPECT_THROW(graph.AddFactor(bad[i]), std::invalid_argument) << "factor " << i;
    EXPECT_EQ(graph.Factors().size(), 1u) << "factor " << i;
    EXPECT_EQ(graph.Poses().size(), 2u) << "factor " << i;
  }
  EXPECT_EQ(graph.AddFactor(Edge<Pose>(1, 0)).value, first.value + 1) << "a refused factor took an id";
}

TYPED_TEST(PoseGraphTest, FactorsTakeTheIdsThatTheyAreGiven) {
  using Pose = TypeParam;
  PoseGraph<Pose> graph;
  graph.AddPose({0}, Pose());
  graph.AddPose({1}, Pose());
  EXPECT_EQ(graph.AddFactor(Edge<Pose>(0, 1), {7}).value, 7);
  EXPECT_EQ(graph.AddFactor(Edge<Pose>(1, 0)).value, 8);
  for (const std::int64_t taken :
       {std::int64_t{-1}, std::int64_t{0}, std::int64_t{8}, std::numeric_limits<std::int64_t>::max()}) {
    EXPECT_THROW(graph.AddFactor(Edge<Pose>(0, 1), {taken}), std::invalid_argument) << taken;
  }
  EXPECT_EQ(graph.NextFactorId().value, 9);
  EXPECT_EQ(graph.Factors().size(), 2u);
  EXPECT_TRUE(graph.RemoveFactor({7}));
  EXPECT_THROW(graph.AddFactor(Edge<Pose>(0, 1), {7}), std::invalid_argument) << "ids are not used again";
}

TYPED_TEST(PoseGraphTest, ValuesThatAreNotFiniteAreRefused) {
  using Pose = TypeParam;
  PoseGraph<Pose> graph;
  typename Pose::Tangent d = Pose::Tangent::Zero();
  d[0] = kNaN;
  const Pose broken = Pose::Exp(d);
  EXPECT_THROW(graph.AddPose({0}, broken), std::invalid_argument);
  EXPECT_FALSE(graph.HasPose({0}));
  graph.AddPose({0}, Pose());
  EXPECT_THROW(graph.SetPose({0}, broken), std::invalid_argument);
  EXPECT_EQ(graph.Poses()[0].T_world_body->Translation()[0], 0);
}

TYPED_TEST(PoseGraphTest, ValuesOfAllPosesAreSetAllOrNone) {
  using Pose = TypeParam;
  testing::Random rng(5);
  const auto random = testing::MakeRandomGraph<Pose>(rng, {12, 0.7, 0.02});
  auto graph = random.graph.WithPoses(random.truth);
  ASSERT_EQ(graph.Factors().size(), random.graph.Factors().size());
  std::vector<Pose> values;
  for (std::size_t k = 0; k < graph.Poses().size(); ++k) {
    EXPECT_EQ(graph.Poses()[k].id, random.graph.Poses()[k].id);
    EXPECT_EQ(graph.Poses()[k].T_world_body->Translation(), random.truth[k].Translation());
    values.push_back(Pose());
  }
  EXPECT_NE(random.graph.Poses().back().T_world_body->Translation(), random.truth.back().Translation()) << "a copy";
  typename Pose::Tangent d = Pose::Tangent::Zero();
  d[0] = kNaN;
  values.back() = Pose::Exp(d);
  EXPECT_THROW(graph.SetPoses(values), std::invalid_argument);
  values.pop_back();
  EXPECT_THROW(graph.SetPoses(values), std::invalid_argument);
  EXPECT_THROW(graph.WithPoses(values), std::invalid_argument);
  for (std::size_t k = 0; k < graph.Poses().size(); ++k) {
    EXPECT_EQ(graph.Poses()[k].T_world_body->Translation(), random.truth[k].Translation()) << "nothing has changed";
  }
}

TYPED_TEST(PoseGraphTest, FindDefectNamesTheFactorAndTheEigenvalue) {
  using Pose = TypeParam;
  RelativePoseFactor<Pose> edge = Edge<Pose>(4, 9);
  EXPECT_EQ(FindDefect<Pose>(edge), "");
  edge.information(1, 1) = -2.5;
  const std::string defect = FindDefect<Pose>(edge);
  EXPECT_NE(defect.find("edge 4 -> 9"), std::string::npos) << defect;
  EXPECT_NE(defect.find("-2.5"), std::string::npos) << defect;
}

TYPED_TEST(PoseGraphTest, ComponentsEqualAFloodFill) {
  using Pose = TypeParam;
  std::mt19937 random(2);
  for (int trial = 0; trial < 50; ++trial) {
    const int n = 1 + static_cast<int>(random() % 30);
    PoseGraph<Pose> graph;
    for (int i = 0; i < n; ++i) graph.AddPose({100 - i});
    std::vector<std::vector<int>> neighbours(static_cast<std::size_t>(n));
    for (int k = 0; k < n / 2; ++k) {
      const int a = static_cast<int>(random() % static_cast<unsigned>(n));
      const int b = static_cast<int>(random() % static_cast<unsigned>(n));
      if (a == b) continue;
      graph.AddFactor(Edge<Pose>(100 - a, 100 - b));
      neighbours[static_cast<std::size_t>(a)].push_back(b);
      neighbours[static_cast<std::size_t>(b)].push_back(a);
    }
    std::set<std::set<int>> wanted;
    std::vector<bool> seen(static_cast<std::size_t>(n), false);
    for (int start = 0; start < n; ++start) {
      std::set<int> component;
      std::vector<int> stack{start};
      while (!stack.empty()) {
        const int i = stack.back();
        stack.pop_back();
        if (seen[static_cast<std::size_t>(i)]) continue;
        seen[static_cast<std::size_t>(i)] = true;
        component.insert(i);
        for (const int j : neighbours[static_cast<std::size_t>(i)]) stack.push_back(j);
      }
      if (!component.empty()) wanted.insert(component);
    }
    const auto components = ConnectedComponents(graph);
    std::set<std::set<int>> found;
    for (std::size_t i = 0; i < components.size(); ++i) {
      EXPECT_LE(components[i].size(), components[i > 0 ? i - 1 : 0].size());
      found.insert(std::set<int>(components[i].begin(), components[i].end()));
    }
    EXPECT_EQ(found, wanted) << "trial " << trial;
  }
}

TYPED_TEST(PoseGraphTest, Chi2AddsTheWeightedResiduals) {
  using Pose = TypeParam;
  std::mt19937 random(3);
  PoseGraph<Pose> graph;
  const Pose T_world_0 = RandomPose<Pose>(random), T_world_1 = RandomPose<Pose>(random);
  graph.AddPose({0}, T_world_0);
  graph.AddPose({1});
  const RelativePoseFactor<Pose> edge{{0}, {1}, RandomPose<Pose>(random), RandomInformation<Pose>(random)};
  const PosePriorFactor<Pose> prior{{1}, RandomPose<Pose>(random), RandomInformation<Pose>(random)};
  graph.AddFactor(edge);
  graph.AddFactor(prior);
  EXPECT_THROW(Chi2(graph), std::invalid_argument) << "pose 1 has no value";
  graph.SetPose({1}, T_world_1);
  const typename Pose::Tangent r = edge.T_from_to.Local(T_world_0.Inverse() * T_world_1);
  const typename Pose::Tangent p = prior.T_world_body.Local(T_world_1);
  const double wanted = r.dot(edge.information * r) + p.dot(prior.information * p);
  // The two compose in another order: rounding of some 1e-16, times the conditioning of a few operations.
  EXPECT_NEAR(Chi2(graph), wanted, 1e-12 * wanted);
}

}  // namespace
}  // namespace terse
