// Messages as docs/howto/ros2.md fills them.

#include "ros2_messages.h"

#include <gtest/gtest.h>

#include <array>

#include "testing.h"
#include "testing_chains.h"

namespace terse {
namespace {

// The fields of geometry_msgs/msg/PoseWithCovariance.
struct Message {
  struct {
    struct {
      double x = -1, y = -1, z = -1;
    } position;
    struct {
      double x = -1, y = -1, z = -1, w = -1;
    } orientation;
  } pose;
  std::array<double, 36> covariance{};
};

SE3 PoseOf(const Message& message) {
  const auto& p = message.pose.position;
  const auto& q = message.pose.orientation;
  return {SO3(Quaternion(q.w, q.x, q.y, q.z)), {p.x, p.y, p.z}};
}

// The small motion [u; w] of the message's pose: the origin by u, turned by w about the axes of the header's frame.
SE3 Moved(const SE3& T, const Vector<6>& e) {
  return {SO3::Exp(e.tail<3>()) * T.Rotation(), T.Translation() + e.head<3>()};
}

// The message's matrix is the covariance of what its text says, by the derivative of the library's own error.
TEST(Ros2Messages, TheMatrixIsThatOfTheMessagesErrors) {
  testing::Chains<SE3> chains(1, {});
  for (int k = 1; k < chains.Size(); ++k) {
    Message message;
    FillPose(chains.Slam(), chains.Id(k), message);
    const SE3 T = PoseOf(message);
    EXPECT_LT((T.Inverse() * chains.Truth(k)).Log().norm(), 1e-8);
    Matrix<6, 6> J, M;  // d of T Exp(d) by [u; w]
    for (int c = 0; c < 6; ++c) {
      const Vector<6> e = 1e-5 * Vector<6>::Unit(c), back = -e;
      J.col(c) = ((T.Inverse() * Moved(T, e)).Log() - (T.Inverse() * Moved(T, back)).Log()) / 2e-5;
      for (int r = 0; r < 6; ++r) M(r, c) = message.covariance[static_cast<std::size_t>(6 * r + c)];
    }
    EXPECT_LT(testing::RelativeError(J * M * J.transpose(), chains.Slam().Covariance(chains.Id(k))), 1e-7) << k;
  }
}

TEST(Ros2Messages, InThePlane) {
  testing::Chains<SE2> chains(2, {});
  for (int k = 1; k < chains.Size(); ++k) {
    Message message;
    FillPose(chains.Slam(), chains.Id(k), message);
    const SE2& T = chains.Truth(k);
    const SE3 expected(SO3::Exp({0, 0, T.Theta()}), {T.Translation().x(), T.Translation().y(), 0});
    EXPECT_LT((PoseOf(message).Inverse() * expected).Log().norm(), 1e-8);
    const Matrix<3, 3> body = chains.Slam().Covariance(chains.Id(k));
    const Matrix<2, 2> position = T.Rotation() * body.topLeftCorner<2, 2>() * T.Rotation().transpose();
    const Vector<2> with_yaw = T.Rotation() * body.topRightCorner<2, 1>();
    const auto& m = message.covariance;
    const double scale = 1e-9 * body.norm();
    EXPECT_NEAR(m[0], position(0, 0), scale);
    EXPECT_NEAR(m[1], position(0, 1), scale);
    EXPECT_NEAR(m[6], position(1, 0), scale);
    EXPECT_NEAR(m[7], position(1, 1), scale);
    EXPECT_NEAR(m[5], with_yaw.x(), scale);
    EXPECT_NEAR(m[11], with_yaw.y(), scale);
    EXPECT_NEAR(m[30], with_yaw.x(), scale);
    EXPECT_NEAR(m[35], body(2, 2), scale);
    for (const unsigned zero : {2U, 3U, 4U, 14U, 21U, 28U, 33U}) EXPECT_EQ(m[zero], 0);
  }
}

TEST(Ros2Messages, APriorFromAMessageIsWhatWasFilled) {
  testing::Random rng(3);
  const SE3 T = testing::RandomMotion<SE3>(rng, 5, 1);
  const Matrix<6, 6> information = testing::RandomInformation<6>(rng);
  Message message;
  FillPose(T, ConvertCovariance<SE3>(testing::Inverse(information), T, kRosConvention), message);
  const PosePriorFactor<SE3> prior = PriorFrom(message, PoseId{7});
  EXPECT_EQ(prior.pose, PoseId{7});
  EXPECT_LT((prior.T_world_body.Inverse() * T).Log().norm(), 1e-12);
  EXPECT_LT(testing::RelativeError(prior.information, information), 1e-9);
  EXPECT_TRUE(FindDefect<SE3>(prior).empty());
  message.covariance.fill(0);
  EXPECT_FALSE(FindDefect<SE3>(PriorFrom(message, PoseId{7})).empty());
}

}  // namespace
}  // namespace terse
