// The groups against their defining identities, central differences and power series in long double.

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <limits>
#include <vector>

#include "terse/lie/coefficients.h"
#include "terse/lie/se2.h"
#include "terse/lie/se3.h"
#include "testing_jacobian.h"
#include "testing_poses.h"

namespace terse {
namespace {

using testing::JacobianMatches;
using testing::kPi;
using testing::PoseRandom;

constexpr int kCases = 10000;

// One interface over the three groups: tangents, matrices and the generator matrices of their algebra.
struct RotationGroup {
  using T = SO3;
  static SO3::Tangent RandomTangent(PoseRandom& random) { return random.RotationVector(random.Angle()); }
  static Eigen::Matrix3d Wedge(const SO3::Tangent& d) { return Hat(d); }
  static Eigen::Matrix3d Small(const SO3::Tangent& d) { return Hat(d); }  // ad
  static Eigen::Matrix3d AsMatrix(const SO3& T) { return T.Rotation(); }
};

struct PlaneGroup {
  using T = SE2;
  static SE2::Tangent RandomTangent(PoseRandom& random) { return testing::RandomTangent<SE2>(random, 3); }
  static Eigen::Matrix3d Wedge(const SE2::Tangent& d) {
    Eigen::Matrix3d M;
    M << 0, -d[2], d[0], d[2], 0, d[1], 0, 0, 0;
    return M;
  }
  static Eigen::Matrix3d Small(const SE2::Tangent& d) {
    Eigen::Matrix3d M;
    M << 0, -d[2], d[1], d[2], 0, -d[0], 0, 0, 0;
    return M;
  }
  static Eigen::Matrix3d AsMatrix(const SE2& T) {
    Eigen::Matrix3d M = Eigen::Matrix3d::Identity();
    M.topLeftCorner<2, 2>() = T.Rotation();
    M.topRightCorner<2, 1>() = T.Translation();
    return M;
  }
};

struct SpaceGroup {
  using T = SE3;
  static SE3::Tangent RandomTangent(PoseRandom& random) { return testing::RandomTangent<SE3>(random, 3); }
  static Eigen::Matrix4d Wedge(const SE3::Tangent& d) {
    Eigen::Matrix4d M = Eigen::Matrix4d::Zero();
    M.topLeftCorner<3, 3>() = Hat(d.tail<3>());
    M.topRightCorner<3, 1>() = d.head<3>();
    return M;
  }
  static Eigen::Matrix<double, 6, 6> Small(const SE3::Tangent& d) {
    Eigen::Matrix<double, 6, 6> M;
    M << Hat(d.tail<3>()), Hat(d.head<3>()), Eigen::Matrix3d::Zero(), Hat(d.tail<3>());
    return M;
  }
  static Eigen::Matrix4d AsMatrix(const SE3& T) {
    Eigen::Matrix4d M = Eigen::Matrix4d::Identity();
    M.topLeftCorner<3, 3>() = T.Rotation().Rotation();
    M.topRightCorner<3, 1>() = T.Translation();
    return M;
  }
};

template <class Matrix>
double MaxDifference(const Matrix& a, const Matrix& b) {
  return (a - b).cwiseAbs().maxCoeff();
}

// sum_n A^n / (n + first)!, in long double: the exponential (first = 0), the left Jacobian of ad(d) (first = 1).
// Terms grow to pi^3 / 3! before they shrink, so about one digit of the eighteen is lost.
template <class M>
M PowerSeries(const M& A, int first) {
  using Long = Eigen::Matrix<long double, M::RowsAtCompileTime, M::ColsAtCompileTime>;
  const Long L = A.template cast<long double>();
  Long term = Long::Identity(), sum = Long::Zero();
  for (int n = 0; n < 45; ++n) {
    sum += term;
    term = (term * L / static_cast<long double>(n + 1 + first)).eval();
  }
  return sum.template cast<double>();
}

template <class Group>
class LieTest : public ::testing::Test {};
using Groups = ::testing::Types<RotationGroup, PlaneGroup, SpaceGroup>;
TYPED_TEST_SUITE(LieTest, Groups);

// Entries reach |rho| ~ 10 and every function is a handful of operations with condition number of order one,
// times the two digits that the closed forms may lose.
constexpr double kRounding = 2e-13;

TYPED_TEST(LieTest, ExpIsTheMatrixExponential) {
  PoseRandom random(1);
  for (int i = 0; i < kCases; ++i) {
    const auto d = TypeParam::RandomTangent(random);
    const auto expected = PowerSeries(TypeParam::Wedge(d), 0);
    ASSERT_LT(MaxDifference(TypeParam::AsMatrix(TypeParam::T::Exp(d)), expected), kRounding) << d.transpose();
  }
}

TYPED_TEST(LieTest, LogInvertsExp) {
  PoseRandom random(2);
  for (int i = 0; i < kCases; ++i) {
    const auto d = TypeParam::RandomTangent(random);
    const auto T = TypeParam::T::Exp(d);
    ASSERT_LT(MaxDifference(T.Log(), d), kRounding) << d.transpose();
    ASSERT_LT(MaxDifference(TypeParam::AsMatrix(TypeParam::T::Exp(T.Log())), TypeParam::AsMatrix(T)), kRounding);
  }
}

TYPED_TEST(LieTest, LogKeepsTheRelativeAccuracyOfSmallRotations) {
  PoseRandom random(3);
  for (int i = 0; i < kCases; ++i) {
    auto d = TypeParam::RandomTangent(random);
    d *= random.LogUniform(1e-290, 1e-3);
    // Squares of numbers below 1e-154 vanish; nothing may depend on them.
    ASSERT_LT(MaxDifference(TypeParam::T::Exp(d).Log(), d), 4e-15 * d.cwiseAbs().maxCoeff()) << d.transpose();
  }
}

TYPED_TEST(LieTest, CompositionAndInverseAreThoseOfMatrices) {
  PoseRandom random(4);
  for (int i = 0; i < kCases; ++i) {
    const auto A = TypeParam::T::Exp(TypeParam::RandomTangent(random));
    const auto B = TypeParam::T::Exp(TypeParam::RandomTangent(random));
    const auto MA = TypeParam::AsMatrix(A), MB = TypeParam::AsMatrix(B);
    using M = std::decay_t<decltype(MA)>;
    ASSERT_LT(MaxDifference(TypeParam::AsMatrix(A * B), M(MA * MB)), kRounding);
    ASSERT_LT(MaxDifference(TypeParam::AsMatrix(A.Inverse()), M(MA.inverse())), kRounding);
    ASSERT_LT(MaxDifference(TypeParam::AsMatrix(A * A.Inverse()), M(M::Identity())), kRounding);
  }
}

TYPED_TEST(LieTest, AdjointMovesATangentAcross) {
  PoseRandom random(5);
  for (int i = 0; i < kCases; ++i) {
    const auto T = TypeParam::T::Exp(TypeParam::RandomTangent(random));
    const auto d = TypeParam::RandomTangent(random);
    const auto left = T * TypeParam::T::Exp(d) * T.Inverse();
    const typename TypeParam::T::Tangent moved = T.Adjoint() * d;
    ASSERT_LT(MaxDifference(TypeParam::AsMatrix(left), TypeParam::AsMatrix(TypeParam::T::Exp(moved))), kRounding * 5)
        << d.transpose();
  }
}

TYPED_TEST(LieTest, LeftJacobianIsItsPowerSeries) {
  PoseRandom random(6);
  for (int i = 0; i < kCases; ++i) {
    const auto d = TypeParam::RandomTangent(random);
    using J = typename TypeParam::T::Jacobian;
    const J expected = PowerSeries(TypeParam::Small(d), 1);
    ASSERT_LT(MaxDifference(TypeParam::T::LeftJacobian(d), expected), kRounding) << d.transpose();
    // The inverse's entries reach (pi / 2)^2 |rho|.
    ASSERT_LT(MaxDifference(J(TypeParam::T::LeftJacobianInverse(d) * expected), J(J::Identity())), 5 * kRounding);
  }
}

TYPED_TEST(LieTest, RightJacobianMirrorsTheLeft) {
  PoseRandom random(7);
  for (int i = 0; i < kCases; ++i) {
    const auto d = TypeParam::RandomTangent(random);
    using J = typename TypeParam::T::Jacobian;
    ASSERT_EQ(TypeParam::T::RightJacobian(d), TypeParam::T::LeftJacobian(-d));
    ASSERT_EQ(TypeParam::T::RightJacobianInverse(d), TypeParam::T::LeftJacobianInverse(-d));
    // J_l = Ad(Exp(d)) J_r.
    const J moved = TypeParam::T::Exp(d).Adjoint() * TypeParam::T::RightJacobian(d);
    ASSERT_LT(MaxDifference(TypeParam::T::LeftJacobian(d), moved), 5 * kRounding) << d.transpose();
  }
}

TYPED_TEST(LieTest, JacobiansMatchCentralDifferences) {
  PoseRandom random(8);
  using T = typename TypeParam::T;
  using Tangent = typename T::Tangent;
  for (int i = 0; i < kCases; ++i) {
    const Tangent d = TypeParam::RandomTangent(random);
    const T at = T::Exp(d);
    const auto left = [&](const auto& e) -> Tangent { return (T::Exp(d + e) * at.Inverse()).Log(); };
    const auto right = [&](const auto& e) -> Tangent { return (at.Inverse() * T::Exp(d + e)).Log(); };
    // Steps of 1e-5 leave 1e-11 times the translation of up to about ten metres.
    ASSERT_TRUE(JacobianMatches(T::LeftJacobian(d), left, 1e-8)) << d.transpose();
    ASSERT_TRUE(JacobianMatches(T::RightJacobian(d), right, 1e-8)) << d.transpose();
  }
}

TYPED_TEST(LieTest, InverseJacobiansMatchCentralDifferences) {
  PoseRandom random(9);
  using T = typename TypeParam::T;
  using Tangent = typename T::Tangent;
  for (int i = 0; i < kCases; ++i) {
    const Tangent d = TypeParam::RandomTangent(random);
    const T at = T::Exp(d);
    // Log jumps where the angle passes pi; there the product with the Jacobian above is the check.
    if (d.template tail < T::kDof == 6 || std::is_same_v<T, SO3> ? 3 : 1 > ().norm() > kPi - 1e-4) continue;
    const auto left = [&](const auto& e) -> Tangent { return (T::Exp(e) * at).Log(); };
    const auto right = [&](const auto& e) -> Tangent { return (at * T::Exp(e)).Log(); };
    ASSERT_TRUE(JacobianMatches(T::LeftJacobianInverse(d), left, 1e-8)) << d.transpose();
    ASSERT_TRUE(JacobianMatches(T::RightJacobianInverse(d), right, 1e-8)) << d.transpose();
  }
}

TYPED_TEST(LieTest, IdentityIsExact) {
  using T = typename TypeParam::T;
  using J = typename T::Jacobian;
  const typename T::Tangent zero = T::Tangent::Zero();
  EXPECT_EQ(TypeParam::AsMatrix(T::Exp(zero)), TypeParam::AsMatrix(T()));
  EXPECT_EQ(T().Log(), zero);
  EXPECT_EQ(T().Adjoint(), J(J::Identity()));
  EXPECT_EQ(T::LeftJacobian(zero), J(J::Identity()));
  EXPECT_EQ(T::LeftJacobianInverse(zero), J(J::Identity()));
}

// Thresholds.

long double SeriesQuotient(int k, long double theta) {
  long double term = 1, sum = 0;
  for (int i = 2; i <= k; ++i) term /= i;
  for (int i = 0; i < 40; ++i) {
    sum += term;
    term *= -theta * theta / ((2 * i + k + 1) * (2 * i + k + 2));
  }
  return sum;
}

// (1 - (t/2) cot(t/2)) / t^2 without cancellation.
long double SeriesCotangent(long double theta) {
  return (SeriesQuotient(3, theta) / 2 - SeriesQuotient(4, theta)) / SeriesQuotient(2, theta);
}

std::vector<double> AnglesAround(double threshold) {
  std::vector<double> angles = {0, 5e-324, 1e-300, 1e-160, 1e-9, 1e-5, 1e-2, 0.5, 2, 3, kPi - 1e-9, kPi};
  for (double angle = threshold * 0.9; angle < threshold * 1.1; angle += threshold * 1e-3) angles.push_back(angle);
  angles.push_back(std::nextafter(threshold, 0));
  angles.push_back(threshold);
  angles.push_back(std::nextafter(threshold, 10));
  return angles;
}

TEST(CoefficientsTest, QuotientsMatchTheSeries) {
  for (int k = 1; k <= 5; ++k) {
    for (const double angle : AnglesAround(internal::kSeriesAngle)) {
      const double expected = static_cast<double>(SeriesQuotient(k, angle));
      // sin t - t + t^3/6 is 0.008 at one radian: the closed form loses two digits there. Q1 is zero at pi.
      const double tolerance = std::max(5e-14 * std::abs(expected), 1e-16);
      EXPECT_NEAR(internal::Quotient(k, angle), expected, tolerance) << k << " at " << angle;
      EXPECT_EQ(internal::Quotient(k, -angle), internal::Quotient(k, angle)) << k << " at " << angle;
    }
    const double below = internal::Quotient(k, std::nextafter(internal::kSeriesAngle, 0));
    EXPECT_NEAR(internal::Quotient(k, internal::kSeriesAngle), below, 1e-14) << k;
  }
}

TEST(CoefficientsTest, CotangentQuotientMatchesTheSeries) {
  for (const double angle : AnglesAround(0.2)) {
    const double expected = static_cast<double>(SeriesCotangent(angle));
    EXPECT_NEAR(internal::CotangentQuotient(angle), expected, 1e-14) << angle;
    EXPECT_EQ(internal::CotangentQuotient(-angle), internal::CotangentQuotient(angle)) << angle;
  }
  EXPECT_NEAR(internal::CotangentQuotient(0.2), internal::CotangentQuotient(std::nextafter(0.2, 0)), 1e-14);
}

TEST(SO3Test, LogAgreesOnBothSidesOfItsThreshold) {
  // Log switches where the quaternion's vector part is 1e-5 long, at an angle of about 2e-5.
  for (const double sine : AnglesAround(1e-5)) {
    if (sine > 1) continue;
    const double cosine = std::sqrt((1 - sine) * (1 + sine));
    const SO3 R(Quaternion(cosine, 0, sine, 0));
    const double expected =
        static_cast<double>(2 * std::atan2(static_cast<long double>(sine), static_cast<long double>(cosine)));
    EXPECT_NEAR(R.Log().y(), expected, 4e-16 * expected) << sine;
  }
}

TEST(SO3Test, NegatedQuaternionIsTheSameRotation) {
  PoseRandom random(10);
  for (int i = 0; i < kCases; ++i) {
    const SO3 R = SO3::Exp(random.RotationVector(random.Angle()));
    const SO3 negated(Quaternion(-R.Unit().coeffs()));
    ASSERT_EQ(R.Log(), negated.Log());
    ASSERT_LE(R.Log().norm(), kPi * (1 + 4e-16));
  }
}

TEST(SO3Test, HalfTurns) {
  for (int axis = 0; axis < 3; ++axis) {
    const Vector<3> e = Vector<3>::Unit(axis);
    for (const double gap : {0.0, 1e-15, 1e-12, 1e-9, 1e-6}) {
      EXPECT_LT((SO3::Exp((kPi - gap) * e).Log() - (kPi - gap) * e).norm(), 2e-15) << gap;
      // Past pi it comes back from the other side.
      if (gap == 0) continue;
      EXPECT_LT((SO3::Exp((kPi + gap) * e).Log() + (kPi - gap) * e).norm(), 2e-15) << gap;
    }
    Quaternion half_turn(0, 0, 0, 0);
    half_turn.vec() = e;
    EXPECT_NEAR(SO3(half_turn).Log()[axis], kPi, 1e-15);
    EXPECT_NEAR((SO3(half_turn) * e - e).norm(), 0, 1e-15);
  }
}

TEST(SO3Test, FromMatrixInvertsRotation) {
  PoseRandom random(11);
  for (int i = 0; i < kCases; ++i) {
    const SO3 R = SO3::Exp(random.RotationVector(random.Angle()));
    // The matrix holds w as a difference, or the vector part as one: accurate to rounding, not better.
    ASSERT_LT((R.Inverse() * SO3::FromMatrix(R.Rotation())).Log().norm(), 4e-15);
    const Vector<3> p = random.NormalVector<3>();
    ASSERT_LT((R * p - R.Rotation() * p).norm(), 4e-15 * p.norm());
  }
}

TEST(SO3Test, NormalizeIsIdempotentToTheBit) {
  PoseRandom random(12);
  for (int i = 0; i < 100 * kCases; ++i) {
    const double size = i % 2 == 0 ? random.LogUniform(1e-3, 1e3) : 1 + 1e-15 * random.Normal();
    Quaternion q(random.Normal(), random.Normal(), random.Normal(), random.Normal());
    q.coeffs() *= size / q.norm();
    const SO3 once(q);
    const SO3 twice(once.Unit());
    ASSERT_EQ(once.Unit().coeffs(), twice.Unit().coeffs());
    ASSERT_NEAR(once.Unit().norm(), 1, 2 * std::numeric_limits<double>::epsilon());
  }
}

TEST(SO3Test, NormalizeChangesOnlyWhatIsOff) {
  const double eps = std::numeric_limits<double>::epsilon();
  // |q|^2 - 1 is twice the excess of w: within the threshold the bits stay, beyond it the norm is restored.
  EXPECT_EQ(SO3(Quaternion(1 + eps, 0, 0, 0)).Unit().w(), 1 + eps);
  EXPECT_EQ(SO3(Quaternion(1 - eps, 0, 0, 0)).Unit().w(), 1 - eps);
  EXPECT_EQ(SO3(Quaternion(1 + 8 * eps, 0, 0, 0)).Unit().w(), 1);
  EXPECT_EQ(SO3(Quaternion(1 - 8 * eps, 0, 0, 0)).Unit().w(), 1);
}

TEST(SO3Test, LongProductsStayUnit) {
  PoseRandom random(13);
  SO3 R;
  const SO3 step = SO3::Exp(random.RotationVector(0.1));
  for (int i = 0; i < 1000000; ++i) R = R * step;
  EXPECT_NEAR(R.Unit().norm(), 1, 4 * std::numeric_limits<double>::epsilon());
}

TEST(SE2Test, WrapAngle) {
  EXPECT_EQ(WrapAngle(kPi), kPi);
  EXPECT_EQ(WrapAngle(-kPi), kPi);
  EXPECT_EQ(WrapAngle(std::nextafter(-kPi, 0)), std::nextafter(-kPi, 0));
  EXPECT_LT(WrapAngle(std::nextafter(kPi, 10)), 0);
  EXPECT_EQ(WrapAngle(5e-324), 5e-324);
  EXPECT_NEAR(WrapAngle(1 + 2 * kPi), 1, 1e-15);
  EXPECT_NEAR(WrapAngle(-1 - 20 * kPi), -1, 1e-14);
  EXPECT_TRUE(std::isnan(WrapAngle(std::numeric_limits<double>::infinity())));
  PoseRandom random(14);
  for (int i = 0; i < kCases; ++i) {
    const double angle = random.Sign() * random.LogUniform(1e-3, 1e6), wrapped = WrapAngle(angle);
    ASSERT_GT(wrapped, -kPi);
    ASSERT_LE(wrapped, kPi);
    ASSERT_EQ(WrapAngle(wrapped), wrapped);
    // The cosine of 1e6 rad is known to 1e-10 only through the rounding of 2 pi.
    ASSERT_NEAR(std::cos(wrapped), std::cos(angle), 1e-10);
  }
}

TEST(SE2Test, NormalizeIsIdempotentToTheBit) {
  PoseRandom random(15);
  for (int i = 0; i < kCases; ++i) {
    const SE2 T(random.Normal(), random.Normal(), 100 * random.Normal());
    SE2 normalized = T;
    normalized.Normalize();
    ASSERT_EQ(normalized.Theta(), T.Theta());
    ASSERT_EQ(normalized.Translation(), T.Translation());
  }
}

// The chart of the optimiser. SE3's is Exp and Log, SE2's is [x y theta].
template <class Pose>
class ChartTest : public ::testing::Test {};
using Poses = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(ChartTest, Poses);

TYPED_TEST(ChartTest, RetractAndLocalAreInverse) {
  PoseRandom random(16);
  for (int i = 0; i < kCases; ++i) {
    const auto T = testing::RandomPose<TypeParam>(random, 3);
    const auto d = testing::RandomTangent<TypeParam>(random, 3);
    if (std::abs(TypeParam::Exp(d).Angle()) > kPi - 1e-8) continue;  // rounding may move it past pi
    ASSERT_LT(MaxDifference(T.Local(T.Retract(d)), d), kRounding) << d.transpose();
    const auto other = testing::RandomPose<TypeParam>(random, 3);
    const auto back = T.Retract(T.Local(other));
    ASSERT_LT(MaxDifference(back.Adjoint(), other.Adjoint()), 5 * kRounding);
  }
}

TYPED_TEST(ChartTest, LocalJacobianMatchesCentralDifferences) {
  PoseRandom random(17);
  for (int i = 0; i < kCases; ++i) {
    const typename TypeParam::Tangent r = testing::RandomTangent<TypeParam>(random, 3);
    const TypeParam E = TypeParam().Retract(r);
    if (E.Angle() > kPi - 1e-4) continue;  // the chart jumps within the step
    const auto local = [&](const auto& e) -> typename TypeParam::Tangent { return TypeParam().Local(E.Retract(e)); };
    ASSERT_TRUE(JacobianMatches(TypeParam::LocalJacobian(r), local, 1e-8)) << r.transpose();
  }
}

TEST(SE2Test, ChartIsThatOfTheFiles) {
  const SE2 T = SE2(1, 2, 0.5).Retract(SE2::Tangent(0.3, -0.2, 0.1));
  EXPECT_NEAR(T.Translation().x(), 1 + std::cos(0.5) * 0.3 + std::sin(0.5) * 0.2, 1e-15);
  EXPECT_NEAR(T.Translation().y(), 2 + std::sin(0.5) * 0.3 - std::cos(0.5) * 0.2, 1e-15);
  EXPECT_NEAR(T.Theta(), 0.6, 1e-15);
}

TEST(SE2Test, HalfTurns) {
  for (const double theta : {kPi, kPi - 1e-9, -kPi + 1e-9, std::nextafter(kPi, 0)}) {
    const SE2::Tangent d(1, -2, theta);
    EXPECT_LT(MaxDifference(SE2::Exp(d).Log(), d), 4e-15) << theta;
    EXPECT_EQ(SE2(1, 2, theta).Angle(), std::abs(theta));
  }
}

TEST(SE3Test, HalfTurns) {
  for (const double theta : {kPi, kPi - 1e-9, std::nextafter(kPi, 0)}) {
    SE3::Tangent d;
    d << 1, -2, 3, theta * Vector<3>(2, -1, 2) / 3;
    EXPECT_LT(MaxDifference(SE3::Exp(d).Log(), d), 1e-14) << theta;
    EXPECT_NEAR(SE3::Exp(d).Angle(), theta, 1e-15);
  }
}

}  // namespace
}  // namespace terse
