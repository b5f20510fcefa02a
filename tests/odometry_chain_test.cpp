// Odometry composed with its covariance, by hand; cycles of true loops and of one that is off.

#include "terse/core/odometry_chain.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <vector>

#include "testing.h"

namespace terse {
namespace {

using internal::Forward;
using internal::ForwardEdge;

template <class Pose>
class OdometryChain : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(OdometryChain, Groups);

TYPED_TEST(OdometryChain, HasItsCovariances) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  testing::Random random(3);
  std::vector<ForwardEdge<Pose>> edges;
  Pose way;
  Matrix<B, B> covariance = Matrix<B, B>::Zero();
  for (int k = 1; k < 12; ++k) {
    const Pose T = testing::RandomMotion<Pose>(random, 2, 0.5);
    const auto information = testing::RandomInformation<B>(random);
    const bool turns = k % 3 == 0;
    const RelativePoseFactor<Pose> step{{}, {}, turns ? T.Inverse() : T, information};
    edges.push_back(Forward(0, turns ? k : k - 1, turns ? k - 1 : k, step));
    Matrix<B, B> of_step = information.inverse();
    if (turns) of_step = T.Inverse().Adjoint() * of_step * T.Inverse().Adjoint().transpose();
    if (k <= 4) continue;
    way = way * T;
    covariance = (T.Inverse().Adjoint() * covariance * T.Inverse().Adjoint().transpose() + of_step).eval();
  }
  const internal::OdometryChain<Pose> chain(edges, 12);
  EXPECT_TRUE(chain.IsWhole());
  EXPECT_LT(chain.Way(4, 11).Local(way).norm(), 1e-12);
  EXPECT_LT((chain.CovarianceOf(4, 11) - covariance).norm(), 1e-10 * covariance.norm());
  const Matrix<B, B> Ad = way.Adjoint();
  EXPECT_LT((chain.CovarianceOf(11, 4) - Ad * covariance * Ad.transpose()).norm(),
            1e-9 * covariance.norm() * Ad.squaredNorm());
  edges.erase(edges.begin() + 5);
  const internal::OdometryChain<Pose> gap(edges, 12);
  EXPECT_FALSE(gap.IsWhole());
  EXPECT_TRUE(gap.Joins(0, 5) && gap.Joins(6, 11));
  EXPECT_FALSE(gap.Joins(5, 6));
}

// Loops between the same two places, whichever way they were measured.
TYPED_TEST(OdometryChain, CyclesAreClosedByTrueLoops) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  testing::Random random(5);
  const Matrix<B, B> information = testing::RandomInformation<B>(random);
  std::vector<Pose> truth = {Pose()};
  std::vector<ForwardEdge<Pose>> edges;
  for (int k = 1; k < 30; ++k) {
    truth.push_back(truth.back() * testing::RandomMotion<Pose>(random, 2, 0.5));
    const Pose T = truth[static_cast<std::size_t>(k - 1)].Inverse() * truth.back();
    if (k != 15) edges.push_back(Forward(0, k - 1, k, RelativePoseFactor<Pose>{{}, {}, T, information}));
  }
  const internal::OdometryChain<Pose> odometry(edges, truth.size());
  const auto loop = [&](int from, int to, const Pose& off) {
    const Pose T = truth[static_cast<std::size_t>(from)].Inverse() * truth[static_cast<std::size_t>(to)] * off;
    return Forward(0, from, to, RelativePoseFactor<Pose>{{}, {}, T, information});
  };
  const auto a = loop(3, 20, Pose()), b = loop(24, 1, Pose());
  ASSERT_TRUE(CycleOf(a, b, odometry));
  EXPECT_LT(CycleOf(a, b, odometry)->error.norm(), 1e-12);
  const typename Pose::Tangent off = Pose::Tangent::Constant(0.01);
  const auto cycle = CycleOf(a, loop(1, 24, Pose::Exp(off)), odometry);
  ASSERT_TRUE(cycle);
  EXPECT_LT((cycle->error + off).norm(), 1e-10);
  EXPECT_NEAR(cycle->Squared(), off.dot(cycle->covariance.inverse() * off), 1e-9);
  EXPECT_FALSE(CycleOf(a, loop(1, 14, Pose()), odometry)) << "no odometry from pose 14 to pose 15";
}

}  // namespace
}  // namespace terse
