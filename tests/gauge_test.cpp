// What absolute measurements determine of how a map lies, and the motion that takes a map to them.

#include "terse/core/gauge.h"

#include <gtest/gtest.h>

#include "terse/core/batch_solver.h"
#include "terse/core/frame_alignment.h"
#include "testing.h"

namespace terse {
namespace {

template <class Pose>
class GaugeTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(GaugeTest, Groups);

// Poses 0 to 9 on a bent line, two metres apart.
template <class Pose>
struct Chain {
  Chain() {
    typename Pose::Tangent step = Pose::Tangent::Zero();
    step[0] = 2;
    step[Pose::kDof - 1] = 0.2;
    if (Pose::kDim == 3) step[Pose::kDim] = 0.15;
    typename Pose::Jacobian information = 1e4 * Pose::Jacobian::Identity();
    for (int k = 0; k < 10; ++k) {
      truth.push_back(k == 0 ? Pose() : truth.back() * Pose().Retract(step));
      graph.AddPose(PoseId{k}, truth.back());
      if (k > 0) graph.AddFactor(RelativePoseFactor<Pose>{PoseId{k - 1}, PoseId{k}, Pose().Retract(step), information});
    }
  }
  PositionPriorFactor<Pose> Fix(int k, double information = 1) const {
    return {PoseId{k}, truth[std::size_t(k)].Translation(), information * Matrix<Pose::kDim, Pose::kDim>::Identity()};
  }
  Gauge<Pose> Found() const { return FindGauge(graph, truth); }
  PoseGraph<Pose> graph;
  std::vector<Pose> truth;
};

TYPED_TEST(GaugeTest, TheAnchorHoldsWhatIsNotDetermined) {
  using Pose = TypeParam;
  constexpr int D = Pose::kDim, R = Pose::kDof - D;
  const auto expect = [](const Chain<Pose>& chain, int shifts, int turns, const char* what) {
    const Gauge<Pose> gauge = chain.Found();
    EXPECT_EQ(gauge.free_shifts, shifts) << what;
    EXPECT_EQ(gauge.free_turns, turns) << what;
    EXPECT_EQ(DescribeUndetermined(gauge, chain.truth[0]).empty(), shifts + turns == 0) << what;
    // Nothing is singular, and nothing is pulled: from a start that is turned the measurements are met.
    std::vector<Pose> start;
    typename Pose::Tangent turn = Pose::Tangent::Zero();
    turn[Pose::kDof - 1] = 0.05;
    for (const Pose& T : chain.truth) start.push_back(Pose().Retract(turn) * T);
    EXPECT_LT(SolveBatch(chain.graph, start).chi2, 1e-3) << what;
  };
  Chain<Pose> chain;
  expect(chain, D, R, "nothing");
  chain.graph.AddFactor(chain.Fix(3));
  expect(chain, 0, R, "a position");
  EXPECT_NE(DescribeUndetermined(chain.graph, chain.truth).find("heading"), std::string::npos);
  chain.graph.AddFactor(chain.Fix(3, 50));
  expect(chain, 0, R, "the same again");
  Chain<Pose> two = chain;
  two.graph.AddFactor(chain.Fix(7));
  expect(two, 0, R - D + 1 > 0 ? R - 2 : 0, "two positions");
  two.graph.AddFactor(chain.Fix(0));
  expect(two, 0, 0, "three positions");

  Chain<Pose> poor;
  poor.graph.AddFactor(poor.Fix(3, 1e-9));
  expect(poor, D, R, "a position to 30 km");
  poor.graph.AddFactor(poor.Fix(7, 1e-4));
  poor.graph.AddFactor(poor.Fix(0, 1e-4));
  expect(poor, 0, R, "positions to 100 m, 14 m apart");

  Chain<Pose> prior;
  prior.graph.AddFactor(PosePriorFactor<Pose>{PoseId{5}, prior.truth[5], Pose::Jacobian::Identity() * 4});
  expect(prior, 0, 0, "a pose prior");
  Chain<Pose> turned;
  typename Pose::Jacobian weak = Pose::Jacobian::Identity();
  weak.template bottomRightCorner<R, R>() *= 1e-3;
  turned.graph.AddFactor(PosePriorFactor<Pose>{PoseId{5}, turned.truth[5], weak});
  expect(turned, 0, R, "a pose prior that knows no heading");
  Chain<Pose> fixed;
  fixed.graph.SetFixed(PoseId{5}, true);
  expect(fixed, 0, 0, "FIX");

  // A lever arm of 10 m is as good as another pose.
  Chain<Pose> lever;
  lever.graph.AddFactor(lever.Fix(3));
  auto antenna = lever.Fix(3);
  antenna.p_body[0] = 10;
  antenna.p_world = lever.truth[3] * antenna.p_body;
  lever.graph.AddFactor(antenna);
  expect(lever, 0, R == 1 ? 0 : 1, "two antennas");
}

TEST(GaugeWordsTest, NameTheFreeAxis) {
  Chain<SE3> chain;
  chain.graph = PoseGraph<SE3>();
  for (int k = 0; k < 2; ++k) chain.graph.AddPose(PoseId{k}, chain.truth[0] * SE3(SO3(), Vector<3>(0, 0, 5.0 * k)));
  std::vector<SE3> values = {*chain.graph.Poses()[0].T_world_body, *chain.graph.Poses()[1].T_world_body};
  for (int k = 0; k < 2; ++k) {
    chain.graph.AddFactor(
        PositionPriorFactor<SE3>{PoseId{k}, values[std::size_t(k)].Translation(), Matrix<3, 3>::Identity()});
  }
  EXPECT_EQ(DescribeUndetermined(chain.graph, values).find("heading, the turn about the axis ("), 0u)
      << DescribeUndetermined(chain.graph, values);
  EXPECT_EQ(DescribeUndetermined(PoseGraph<SE3>(), {}), "");
}

// Relative covariances are the same whatever holds the map: here against a full anchor on another pose.
TYPED_TEST(GaugeTest, RelativeCovariancesDoNotDependOnIt) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  Chain<Pose> chain;
  const auto relative = [&](const Eigen::MatrixXd& H) {
    const Eigen::MatrixXd Sigma = testing::Inverse(H);
    Eigen::Matrix<double, B, Eigen::Dynamic> J = Eigen::Matrix<double, B, Eigen::Dynamic>::Zero(B, H.cols());
    J.template middleCols<B>(2 * B) = -(chain.truth[8].Inverse() * chain.truth[2]).Adjoint();
    J.template middleCols<B>(8 * B).setIdentity();
    return Eigen::MatrixXd(J * Sigma * J.transpose());
  };
  const Eigen::MatrixXd expected = relative(testing::MakeDenseSystem(chain.graph, chain.truth).H);
  chain.graph.AddFactor(chain.Fix(3, 1e8));
  const Eigen::MatrixXd with_one = relative(testing::MakeDenseSystem(chain.graph, chain.truth).H);
  EXPECT_LT((with_one - expected).norm(), 1e-6 * expected.norm());
}

TYPED_TEST(GaugeTest, AlignmentFindsTheMotion) {
  using Pose = TypeParam;
  testing::Random rng(5);
  const Chain<Pose> chain;
  for (int trial = 0; trial < 50; ++trial) {
    const Pose T_new_old = testing::RandomMotion<Pose>(rng, 100, 3);
    std::vector<std::pair<Factor<Pose>, Pose>> measured;
    const auto add = [&](const Factor<Pose>& factor, int k) {
      measured.emplace_back(factor, T_new_old.Inverse() * chain.truth[std::size_t(k)]);
    };
    for (const int k : {0, 4, 9}) {
      auto fix = chain.Fix(k, 100);
      fix.information = 100 * testing::RandomInformation<Pose::kDim>(rng, 1);
      add(fix, k);
    }
    const auto found = internal::AlignToAbsolute(measured);
    ASSERT_TRUE(found) << trial;
    EXPECT_LT(found->Local(T_new_old).norm(), 1e-6) << trial;
    // One pose prior is enough, however it is turned.
    measured.clear();
    add(PosePriorFactor<Pose>{PoseId{4}, chain.truth[4], testing::RandomInformation<Pose::kDof>(rng, 10)}, 4);
    const auto onto = internal::AlignToAbsolute(measured);
    ASSERT_TRUE(onto) << trial;
    EXPECT_LT(onto->Local(T_new_old).norm(), 1e-6) << trial;
  }
  // One position turns nothing; none moves nothing.
  std::vector<std::pair<Factor<Pose>, Pose>> one = {{chain.Fix(5), Pose()}};
  const auto moved = internal::AlignToAbsolute(one);
  ASSERT_TRUE(moved);
  EXPECT_LT(moved->Angle(), 1e-12);
  EXPECT_LT((moved->Translation() - chain.truth[5].Translation()).norm(), 1e-6);
  EXPECT_FALSE(internal::AlignToAbsolute<Pose>({}));
  one.front().second = chain.truth[5];
  EXPECT_FALSE(internal::AlignToAbsolute(one)) << "it lies there already";
}

}  // namespace
}  // namespace terse
