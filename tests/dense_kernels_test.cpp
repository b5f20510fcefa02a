// Every instruction set that this processor runs, against Eigen's dense Cholesky, at sizes around all tile edges.

#include "core/dense_kernels.h"

#include <gtest/gtest.h>

#include <limits>

#include "testing.h"

namespace terse {
namespace {

Eigen::MatrixXd RandomSpd(testing::Random& rng, int n) {
  Eigen::MatrixXd A(n, n);
  for (int i = 0; i < n * n; ++i) A.data()[i] = testing::Normal(rng);
  return A * A.transpose() + n * Eigen::MatrixXd::Identity(n, n);
}

TEST(DenseKernels, EqualDenseCholesky) {
  testing::Random rng(3);
  std::vector<std::pair<int, int>> sizes;  // pivots, separators
  for (int p = 1; p <= 26; ++p) {
    for (int s = 0; s <= 34; s += 1 + p % 3) sizes.emplace_back(p, s);
  }
  for (const auto& size : {std::pair{130, 7}, {128, 128}, {129, 63}, {300, 0}, {40, 301}}) sizes.push_back(size);
  for (const auto& kernels : internal::AvailableKernels()) {
    SCOPED_TRACE(kernels.name);
    for (const auto& [p, s] : sizes) {
      const int rows = p + s, n = s;
      const Eigen::MatrixXd H = RandomSpd(rng, rows);
      const Eigen::MatrixXd L = H.llt().matrixL();
      // The entries that are not meaningful must not be used: they start as NaN.
      const double nan = std::numeric_limits<double>::quiet_NaN();
      Eigen::MatrixXd panel = Eigen::MatrixXd::Constant(rows, p, nan), update = Eigen::MatrixXd::Constant(n, n, nan);
      for (int c = 0; c < p; ++c) panel.col(c).tail(rows - c) = H.col(c).tail(rows - c);
      for (int c = 0; c < n; ++c) update.col(c).tail(n - c) = H.col(p + c).tail(n - c);
      ASSERT_EQ(kernels.factor_panel(panel.data(), rows, rows, p), -1);
      kernels.subtract_product(update.data(), n, panel.data() + p, panel.data() + p, rows, n, n, p);
      // Condition below 10, up to 340 rows.
      double error = 0;
      for (int c = 0; c < p; ++c)
        error = std::max(error, (panel.col(c) - L.col(c)).tail(rows - c).cwiseAbs().maxCoeff());
      const Eigen::MatrixXd schur = L.bottomRightCorner(n, n) * L.bottomRightCorner(n, n).transpose();
      for (int c = 0; c < n; ++c)
        error = std::max(error, (update.col(c) - schur.col(c)).tail(n - c).cwiseAbs().maxCoeff());
      ASSERT_LT(error, 1e-10 * rows) << "pivots " << p << ", separators " << s;
    }
  }
}

TEST(DenseKernels, NameTheColumnThatIsNotPositive) {
  testing::Random rng(4);
  for (const auto& kernels : internal::AvailableKernels()) {
    for (const int bad : {0, 5, 8, 19}) {
      for (const double pivot :
           {-1.0, 0.0, std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
        Eigen::MatrixXd H = RandomSpd(rng, 20);
        H.row(bad).setZero();
        H.col(bad).setZero();
        H(bad, bad) = pivot;
        EXPECT_EQ(kernels.factor_panel(H.data(), 20, 20, 20), bad) << kernels.name << ", pivot " << pivot;
      }
    }
  }
}

}  // namespace
}  // namespace terse
