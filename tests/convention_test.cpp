// Conventions of covariances: each is what its perturbation says, and all lead to each other.

#include "terse/covariance/convention.h"

#include <gtest/gtest.h>

#include "terse/lie/so3.h"
#include "testing.h"

namespace terse {
namespace {

using testing::NormalVector;
using testing::Random;
using testing::RelativeError;

template <class Pose>
class ConventionTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(ConventionTest, Groups);

std::vector<CovarianceConvention> All() {
  std::vector<CovarianceConvention> all;
  for (const auto frame : {CovarianceFrame::kBody, CovarianceFrame::kWorld, CovarianceFrame::kWorldAxes}) {
    for (const auto order : {TangentOrder::kTranslationFirst, TangentOrder::kRotationFirst}) {
      all.push_back({frame, order});
    }
  }
  return all;
}

// How the body is turned from T to `moved`, about the world's axes.
Vector<1> Turn(const SE2& T, const SE2& moved) { return Vector<1>(WrapAngle(moved.Theta() - T.Theta())); }
Vector<3> Turn(const SE3& T, const SE3& moved) { return (moved.Rotation() * T.Rotation().Inverse()).Log(); }

// The error of `moved` beside T as the header defines it.
template <class Pose>
typename Pose::Tangent ErrorIn(const CovarianceConvention& convention, const Pose& T, const Pose& moved) {
  constexpr int kRotation = Pose::kDof - Pose::kDim;
  typename Pose::Tangent e;
  switch (convention.frame) {
    case CovarianceFrame::kBody: e = (T.Inverse() * moved).Log(); break;
    case CovarianceFrame::kWorld: e = (moved * T.Inverse()).Log(); break;
    case CovarianceFrame::kWorldAxes: e << moved.Translation() - T.Translation(), Turn(T, moved); break;
  }
  if (convention.order == TangentOrder::kTranslationFirst) return e;
  typename Pose::Tangent swapped;
  swapped << e.template tail<kRotation>(), e.template head<Pose::kDim>();
  return swapped;
}

// d ErrorIn(to) / d ErrorIn(body) at zero.
template <class Pose>
typename Pose::Jacobian Derivative(const CovarianceConvention& to, const Pose& T) {
  typename Pose::Jacobian J;
  for (int k = 0; k < Pose::kDof; ++k) {
    typename Pose::Tangent d = Pose::Tangent::Zero();
    d[k] = 1e-5;
    const typename Pose::Tangent back = -d;
    J.col(k) = (ErrorIn(to, T, T * Pose::Exp(d)) - ErrorIn(to, T, T * Pose::Exp(back))) / 2e-5;
  }
  return J;
}

TYPED_TEST(ConventionTest, EachIsTheCovarianceOfItsError) {
  using Pose = TypeParam;
  Random rng(1);
  for (int n = 0; n < 20; ++n) {
    const Pose T = testing::RandomMotion<Pose>(rng, 5, 1), T_b = testing::RandomMotion<Pose>(rng, 5, 1);
    const typename Pose::Jacobian Sigma = testing::RandomInformation<Pose::kDof>(rng),
                                  cross = testing::RandomInformation<Pose::kDof>(rng);
    for (const CovarianceConvention& to : All()) {
      const typename Pose::Jacobian J = Derivative(to, T);
      EXPECT_LT(RelativeError(ConvertCovariance<Pose>(Sigma, T, to), J * Sigma * J.transpose()), 1e-7);
      EXPECT_LT(
          RelativeError(ConvertCrossCovariance<Pose>(cross, T, T_b, to), J * cross * Derivative(to, T_b).transpose()),
          1e-7);
    }
  }
}

TYPED_TEST(ConventionTest, EachIsWhatSamplesShow) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof, kSamples = 40000;
  Random rng(2);
  const Pose T = testing::RandomMotion<Pose>(rng, 3, 1);
  // Small, so that first order is enough; d = L n with L L' = Sigma.
  const typename Pose::Jacobian L = 1e-3 * testing::CholeskyFactor(testing::RandomInformation<B>(rng));
  const typename Pose::Jacobian Sigma = L * L.transpose();
  const auto all = All();
  std::vector<typename Pose::Jacobian> sampled(all.size(), Pose::Jacobian::Zero());
  for (int n = 0; n < kSamples; ++n) {
    const typename Pose::Tangent d = L * NormalVector<B>(rng);
    const Pose moved = T * Pose::Exp(d);
    for (std::size_t k = 0; k < all.size(); ++k) {
      const typename Pose::Tangent e = ErrorIn(all[k], T, moved);
      sampled[k] += e * e.transpose() / kSamples;
    }
  }
  for (std::size_t k = 0; k < all.size(); ++k) {
    // The sampled covariance is off by about sqrt(dof / samples).
    EXPECT_LT(RelativeError(sampled[k], ConvertCovariance<Pose>(Sigma, T, all[k])), 0.04);
  }
}

TYPED_TEST(ConventionTest, AllLeadToAllAndBack) {
  using Pose = TypeParam;
  Random rng(3);
  for (int n = 0; n < 10; ++n) {
    const Pose T = testing::RandomMotion<Pose>(rng, 5, 1);
    const typename Pose::Jacobian Sigma = testing::RandomInformation<Pose::kDof>(rng);
    for (const CovarianceConvention& from : All()) {
      const auto given = ConvertCovariance<Pose>(Sigma, T, from);
      for (const CovarianceConvention& to : All()) {
        const auto converted = ConvertCovariance<Pose>(given, T, from, to);
        EXPECT_EQ(converted, converted.transpose());
        EXPECT_LT(RelativeError(converted, ConvertCovariance<Pose>(Sigma, T, to)), 1e-11);
        EXPECT_LT(RelativeError(ConvertCovariance<Pose>(converted, T, to, from), given), 1e-11);
      }
      EXPECT_EQ(ConvertCovariance<Pose>(given, T, from, from), given);
    }
  }
}

// R Sigma R' on every block; the position's block is the ellipse on a map, wherever the world's origin is.
TYPED_TEST(ConventionTest, WorldAxesTurnBothBlocksAndNothingElse) {
  using Pose = TypeParam;
  constexpr int D = Pose::kDim;
  Random rng(4);
  const Pose T = testing::RandomMotion<Pose>(rng, 5, 1);
  const typename Pose::Jacobian Sigma = testing::RandomInformation<Pose::kDof>(rng);
  const CovarianceConvention axes{CovarianceFrame::kWorldAxes, TangentOrder::kTranslationFirst};
  const auto converted = ConvertCovariance<Pose>(Sigma, T, axes);
  Matrix<D, D> R;
  for (int k = 0; k < D; ++k) {
    const typename Pose::Position unit = Pose::Position::Unit(k);
    R.col(k) = T * unit - T.Translation();
  }
  const Matrix<D, D> position = Sigma.template topLeftCorner<D, D>();
  EXPECT_LT(RelativeError(converted.template topLeftCorner<D, D>(), R * position * R.transpose()), 1e-13);
  EXPECT_NEAR(converted.trace(), Sigma.trace(), 1e-12 * Sigma.trace());
  const Pose shift = testing::RandomMotion<Pose>(rng, 1000, 0);
  EXPECT_LT(RelativeError(ConvertCovariance<Pose>(Sigma, shift * T, axes), converted), 1e-12);
  if (D == 2) {
    EXPECT_EQ(converted(2, 2), Sigma(2, 2));
  }
}

}  // namespace
}  // namespace terse
