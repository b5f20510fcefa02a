// Every instruction set that this processor runs, against Eigen's dense Cholesky, at sizes around all tile edges.

#include "terse/core/dense_kernels.h"

#include <gtest/gtest.h>

#include <limits>
#include <tuple>

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
      const Eigen::MatrixXd L = testing::CholeskyFactor(H);
      // The entries that are not meaningful must not be used: they start as NaN.
      const double nan = std::numeric_limits<double>::quiet_NaN();
      Eigen::MatrixXd panel = Eigen::MatrixXd::Constant(rows, p, nan), update = Eigen::MatrixXd::Constant(n, n, nan);
      for (int c = 0; c < p; ++c) panel.col(c).tail(rows - c) = H.col(c).tail(rows - c);
      for (int c = 0; c < n; ++c) update.col(c).tail(n - c) = H.col(p + c).tail(n - c);
      ASSERT_EQ(kernels.factor_panel(panel.data(), rows, rows, p), -1);
      kernels.subtract_product(update.data(), n, panel.data() + p, panel.data() + p, rows, n, n, p);
      // Condition below 10, up to 340 rows.
      Eigen::MatrixXd square = Eigen::MatrixXd::Constant(n, n, nan);
      kernels.set_negative_square(square.data(), n, panel.data() + p, rows, n, n, p);
      double error = 0;
      for (int c = 0; c < n; ++c) {
        const Eigen::VectorXd whole = square.col(c) + H.bottomRightCorner(n, n).col(c) - update.col(c);
        error = std::max(error, whole.tail(n - c).cwiseAbs().maxCoeff());
      }
      for (int c = 0; c < p; ++c)
        error = std::max(error, (panel.col(c) - L.col(c)).tail(rows - c).cwiseAbs().maxCoeff());
      const Eigen::MatrixXd schur = L.bottomRightCorner(n, n) * L.bottomRightCorner(n, n).transpose();
      for (int c = 0; c < n; ++c)
        error = std::max(error, (update.col(c) - schur.col(c)).tail(n - c).cwiseAbs().maxCoeff());
      ASSERT_LT(error, 1e-10 * rows) << "pivots " << p << ", separators " << s;
    }
  }
}

// Blocks of a matrix with a last row, some of them neighbours in the target too, into a larger one: the lower triangle
// alone, which the upper, not a number, must not reach.
template <int B>
void ExpectExtendAdd(const internal::DenseKernels& kernels, testing::Random& rng) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (int blocks = 0; blocks <= 9; ++blocks) {
    std::vector<int> at, run_end(static_cast<std::size_t>(blocks), blocks);
    int next = 0;
    for (int k = 0; k < blocks; ++k) {
      next += rng() % 3 == 0 ? B + 2 : 0;
      at.push_back(next);
      next += B;
    }
    for (int k = blocks - 2; k >= 0; --k) {
      const auto i = static_cast<std::size_t>(k);
      run_end[i] = at[i + 1] == at[i] + B ? run_end[i + 1] : k + 1;
    }
    const int n = blocks * B + 1, rows = next + 3, rhs = next + 2;
    Eigen::MatrixXd from = Eigen::MatrixXd::NullaryExpr(n, n, [&] { return testing::Normal(rng); });
    for (int c = 1; c < n; ++c) from.col(c).head(c).setConstant(nan);
    const int first = blocks / 3, last = blocks - blocks / 4;
    Eigen::MatrixXd to = Eigen::MatrixXd::NullaryExpr(rows, rows, [&] { return testing::Normal(rng); }), expected = to;
    for (int j = first * B; j < last * B; ++j) {
      const auto target = [&](int k) { return at[static_cast<std::size_t>(k / B)] + k % B; };
      for (int i = j; i < blocks * B; ++i) expected(target(i), target(j)) += from(i, j);
      expected(rhs, target(j)) += from(n - 1, j);
    }
    kernels.extend_add(to.data(), rows, from.data(), n, at.data(), run_end.data(), first, last, blocks, rhs, B);
    EXPECT_EQ(to, expected) << kernels.name << ", blocks " << blocks;
  }
}
TEST(DenseKernels, ExtendAddPlacesBlocks) {
  testing::Random rng(9);
  for (const auto& kernels : internal::AvailableKernels()) {
    for (int k = 0; k < 20; ++k) {
      ExpectExtendAdd<3>(kernels, rng);
      ExpectExtendAdd<6>(kernels, rng);
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

// [L, W] Q = [L~, W~]: the pivots of H + W W', and what W~ leaves below is the change of the Schur complement. Leading
// dimensions exceed the rows, and what lies outside stays as it was.
TEST(DenseKernels, RankUpdateEqualsDenseCholesky) {
  testing::Random rng(5);
  std::vector<std::tuple<int, int, int>> sizes;  // pivots, of them new, rows below
  for (int p = 1; p <= 26; ++p) {
    for (int s = 0; s <= 34; s += 1 + p % 3) sizes.emplace_back(p, p % 4 == 0 ? p / 4 : 0, s);
  }
  for (const int fresh : {1, 3, 6, 12}) sizes.emplace_back(fresh, fresh, 5);
  sizes.emplace_back(130, 6, 67);
  int columns = 1;
  for (const auto& kernels : internal::AvailableKernels()) {
    SCOPED_TRACE(kernels.name);
    for (const auto& [p, fresh, s] : sizes) {
      const int rows = p + s, old = p - fresh, ld = rows + 3, ldw = rows + 5;
      columns = columns % 20 + 1;
      const int K = std::max(columns, fresh);  // new pivots need as many measurements
      // New pivots have no entries at all yet.
      Eigen::MatrixXd H = RandomSpd(rng, rows);
      H.middleRows(old, fresh).setZero();
      H.middleCols(old, fresh).setZero();
      Eigen::MatrixXd L = Eigen::MatrixXd::Zero(rows, p);
      const Eigen::MatrixXd top = testing::CholeskyFactor(H.topLeftCorner(old, old));
      L.topLeftCorner(old, old) = top;
      // Eigen's solve binds a reference to the first entry, which an empty matrix has not.
      if (s > 0 && old > 0)
        L.bottomLeftCorner(s, old) = top.triangularView<Eigen::Lower>().solve(H.topRightCorner(old, s)).transpose();
      const Eigen::MatrixXd W = Eigen::MatrixXd::NullaryExpr(rows, K, [&] { return testing::Normal(rng); });
      const Eigen::MatrixXd changed = H + W * W.transpose();
      const Eigen::MatrixXd expected = testing::CholeskyFactor(changed);
      const Eigen::MatrixXd grown = W.bottomRows(s) * W.bottomRows(s).transpose() +
                                    L.bottomRows(s) * L.bottomRows(s).transpose() -
                                    expected.bottomLeftCorner(s, p) * expected.bottomLeftCorner(s, p).transpose();

      Eigen::MatrixXd panel = Eigen::MatrixXd::Constant(ld, p, 77), w = Eigen::MatrixXd::Constant(ldw, K, 77);
      for (int c = 0; c < p; ++c) panel.col(c).segment(c, rows - c) = L.col(c).tail(rows - c);
      w.topRows(rows) = W;
      kernels.rank_update(panel.data(), ld, rows, p, w.data(), ldw, K);
      double error = 0;
      for (int c = 0; c < p; ++c) {
        error =
            std::max(error, (panel.col(c).segment(c, rows - c) - expected.col(c).tail(rows - c)).cwiseAbs().maxCoeff());
        ASSERT_TRUE((panel.col(c).tail(ld - rows).array() == 77).all());
        ASSERT_TRUE((panel.col(c).head(c).array() == 77).all());
      }
      const Eigen::MatrixXd left = w.middleRows(p, s);
      if (s > 0) error = std::max(error, (left * left.transpose() - grown).cwiseAbs().maxCoeff());
      ASSERT_TRUE((w.bottomRows(ldw - rows).array() == 77).all());
      // New pivots hang on few random measurements: their condition costs some digits.
      ASSERT_LT(error, (fresh > 0 ? 1e-8 : 1e-10) * rows)
          << "pivots " << p << ", new " << fresh << ", below " << s << ", columns " << K;
    }
  }
}

TEST(DenseKernels, ZeroUpdateOfZeroPivotLeavesIt) {
  for (const auto& kernels : internal::AvailableKernels()) {
    std::vector<double> panel(20, 0.0), w(20, 0.0);
    kernels.rank_update(panel.data(), 5, 5, 4, w.data(), 5, 4);
    EXPECT_EQ(panel, std::vector<double>(20, 0.0)) << kernels.name;
    EXPECT_EQ(w, std::vector<double>(20, 0.0)) << kernels.name;
  }
}

TEST(DenseKernels, BackSubstituteEqualsDense) {
  testing::Random rng(6);
  for (const auto& kernels : internal::AvailableKernels()) {
    SCOPED_TRACE(kernels.name);
    for (int p = 1; p <= 26; ++p) {
      for (const int s : {0, 1, 2, 3, 5, 8, 15, 16, 17, 31, 32, 33, 70}) {
        const int rows = p + s + 1;
        const Eigen::MatrixXd H = RandomSpd(rng, rows);
        const Eigen::MatrixXd L = testing::CholeskyFactor(H);
        Eigen::MatrixXd panel = Eigen::MatrixXd::Constant(rows, p, std::numeric_limits<double>::quiet_NaN());
        for (int c = 0; c < p; ++c) panel.col(c).tail(rows - c) = L.col(c).tail(rows - c);
        Eigen::VectorXd x = Eigen::VectorXd::NullaryExpr(p + s, [&] { return testing::Normal(rng); });
        const Eigen::VectorXd separators = x.tail(s);
        const Eigen::VectorXd y = x.head(p) - L.block(p, 0, s, p).transpose() * separators;
        const Eigen::VectorXd expected = L.topLeftCorner(p, p).transpose().triangularView<Eigen::Upper>().solve(y);
        kernels.back_substitute(panel.data(), rows, p, x.data());
        ASSERT_LT((x.head(p) - expected).cwiseAbs().maxCoeff(), 1e-12 * rows) << "pivots " << p << ", separators " << s;
        ASSERT_EQ(x.tail(s), separators);
      }
    }
  }
}

TEST(DenseKernels, SubtractsProductOfDifferentMatrices) {
  testing::Random rng(7);
  for (const auto& kernels : internal::AvailableKernels()) {
    SCOPED_TRACE(kernels.name);
    for (int n = 1; n <= 40; ++n) {
      for (const int depth : {1, 2, 3, 6, 17, 128, 129, 300}) {
        const int ld = n + n % 4;
        const auto random = [&](int columns) {
          return Eigen::MatrixXd(Eigen::MatrixXd::NullaryExpr(ld, columns, [&] { return testing::Normal(rng); }));
        };
        const Eigen::MatrixXd A = random(depth), B = random(depth);
        Eigen::MatrixXd C = random(n).topRows(n).eval();
        const Eigen::MatrixXd expected = C - A.topRows(n) * B.topRows(n).transpose();
        kernels.subtract_product(C.data(), n, A.data(), B.data(), ld, n, n, depth);
        for (int c = 0; c < n; ++c) {
          ASSERT_LT((C.col(c) - expected.col(c)).tail(n - c).cwiseAbs().maxCoeff(), 1e-12 * (depth + 10))
              << n << " rows, depth " << depth;
        }
      }
    }
  }
}

Eigen::MatrixXd RandomMatrix(testing::Random& rng, int rows, int columns) {
  return Eigen::MatrixXd::NullaryExpr(rows, columns, [&] { return testing::Normal(rng); });
}

// Right-hand sides side by side, as the kernels store them.
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

TEST(DenseKernels, RectangularProduct) {
  testing::Random rng(6);
  for (const auto& kernels : internal::AvailableKernels()) {
    SCOPED_TRACE(kernels.name);
    for (int rows = 1; rows <= 30; ++rows) {
      for (const int columns : {1, 3, 6, 8, 19, 33}) {
        for (const int depth : {1, 5, 24, 130}) {
          const Eigen::MatrixXd A = RandomMatrix(rng, rows + 2, depth), B = RandomMatrix(rng, columns + 1, depth);
          Eigen::MatrixXd C = RandomMatrix(rng, rows + 3, columns), expected = C;
          const Eigen::MatrixXd product = A.topRows(rows) * B.topRows(columns).transpose();
          expected.topRows(rows) += product;
          kernels.add_rectangle(C.data(), rows + 3, A.data(), rows + 2, B.data(), columns + 1, rows, columns, depth);
          ASSERT_LT((C - expected).cwiseAbs().maxCoeff(), 1e-12 * depth) << rows << ' ' << columns << ' ' << depth;
          ASSERT_EQ(C.bottomRows(3), expected.bottomRows(3));
          // What is set may have been anything.
          C.topRows(rows).setConstant(std::numeric_limits<double>::quiet_NaN());
          kernels.set_rectangle(C.data(), rows + 3, A.data(), rows + 2, B.data(), columns + 1, rows, columns, depth);
          ASSERT_LT((C.topRows(rows) - product).cwiseAbs().maxCoeff(), 1e-12 * depth)
              << rows << ' ' << columns << ' ' << depth;
          ASSERT_EQ(C.bottomRows(3), expected.bottomRows(3));
        }
      }
    }
  }
}

TEST(DenseKernels, SubstitutionWithManyRightHandSides) {
  testing::Random rng(7);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const auto& kernels : internal::AvailableKernels()) {
    SCOPED_TRACE(kernels.name);
    for (int p = 1; p <= 27; ++p) {
      for (const int s : {0, 1, 2, 7, 30}) {
        for (const int columns : {3, 6, 12, 17, 40}) {
          const int rows = p + s, ld = rows + 1, stride = internal::Stride(columns);
          const Eigen::MatrixXd L = testing::CholeskyFactor(RandomSpd(rng, rows));
          // The upper triangle and the row of the right-hand side are nobody's business.
          Eigen::MatrixXd panel = Eigen::MatrixXd::Constant(ld, p, nan);
          for (int c = 0; c < p; ++c) panel.col(c).segment(c, rows - c) = L.col(c).tail(rows - c);
          const auto L_PP = L.topLeftCorner(p, p).triangularView<Eigen::Lower>();
          const RowMajor x = RandomMatrix(rng, rows, stride);
          RowMajor forward = x, backward = x;
          kernels.substitute_forward(panel.data(), ld, rows, p, forward.data(), stride);
          RowMajor expected = x;
          expected.topRows(p) = L_PP.solve(Eigen::MatrixXd(x.topRows(p)));
          if (s > 0) expected.bottomRows(s) -= L.bottomLeftCorner(s, p) * expected.topRows(p);
          ASSERT_LT((forward - expected).cwiseAbs().maxCoeff(), 1e-11 * rows) << p << ' ' << s << ' ' << columns;
          kernels.substitute_backward(panel.data(), ld, rows, p, backward.data(), stride);
          expected = x;
          if (s > 0) expected.topRows(p) -= L.bottomLeftCorner(s, p).transpose() * x.bottomRows(s);
          expected.topRows(p) = L_PP.transpose().solve(Eigen::MatrixXd(expected.topRows(p)));
          ASSERT_LT((backward - expected).cwiseAbs().maxCoeff(), 1e-11 * rows) << p << ' ' << s << ' ' << columns;
        }
      }
    }
  }
}

TEST(DenseKernels, ProductsOfRowsAndCongruences) {
  testing::Random rng(8);
  for (const auto& kernels : internal::AvailableKernels()) {
    SCOPED_TRACE(kernels.name);
    for (const int depth : {1, 6, 12, 31}) {
      for (const int width : {4, 8, 12, 24, 40}) {
        for (const int rows : {1, 5, 6, 20}) {
          const RowMajor X = RandomMatrix(rng, rows, depth + 1), T = RandomMatrix(rng, depth, width + 2);
          RowMajor Y = RandomMatrix(rng, rows, width + 3), expected = Y;
          expected.leftCols(width) -= X.leftCols(depth) * T.leftCols(width);
          kernels.subtract_rows(Y.data(), width + 3, X.data(), depth + 1, T.data(), width + 2, rows, depth, width);
          ASSERT_LT((Y - expected).cwiseAbs().maxCoeff(), 1e-12 * depth);
          ASSERT_EQ(Y.rightCols(3), expected.rightCols(3));
        }
      }
      for (const int size : {3, 6}) {
        const int wide = internal::Stride(size);
        RowMajor Z = RandomMatrix(rng, 7 + depth, wide);
        const RowMajor T = RandomMatrix(rng, size, wide), transformed = Z.leftCols(size) * T;
        kernels.transform_rows(Z.data(), wide, T.data(), 7 + depth, size);
        ASSERT_LT((Z - transformed).cwiseAbs().maxCoeff(), 1e-13);
        const int count = 5, stride = internal::Stride(depth);
        RowMajor Y = RandomMatrix(rng, count * size, stride), M = RandomMatrix(rng, stride, stride);
        Y.rightCols(stride - depth).setZero();
        Eigen::MatrixXd S = RandomMatrix(rng, size, count * size), expected = S;
        for (int k = 0; k < count; ++k) {
          const Eigen::MatrixXd y = Y.block(k * size, 0, size, depth);
          const Eigen::MatrixXd product = y * M.topLeftCorner(depth, depth) * y.transpose();
          expected.middleCols(k * size, size) -= (product + product.transpose()) / 2;
        }
        kernels.subtract_congruences(S.data(), Y.data(), stride, M.data(), count, size, depth);
        ASSERT_LT((S - expected).cwiseAbs().maxCoeff(), 1e-12 * depth * depth);
      }
    }
  }
}

TEST(DenseKernels, NormalBlocksAreProducts) {
  std::mt19937_64 rng(11);
  for (const auto& kernels : internal::AvailableKernels()) {
    SCOPED_TRACE(kernels.name);
    for (const int size : {3, 6}) {
      const Eigen::MatrixXd A = RandomMatrix(rng, size, size), B = RandomMatrix(rng, size, size);
      const Eigen::VectorXd r = RandomMatrix(rng, size, 1);
      const Eigen::MatrixXd untouched = RandomMatrix(rng, size, size);
      Eigen::MatrixXd H_first = untouched, H_second = untouched, H_cross = untouched;
      Eigen::VectorXd b_first(size), b_second = r;
      const auto compute = [&](const double* b) {
        kernels.normal_blocks(A.data(), b, r.data(), size, H_first.data(), H_second.data(), H_cross.data(),
                              b_first.data(), b_second.data());
        EXPECT_LT((H_first - A.transpose() * A).norm(), 1e-14 * size * size);
        EXPECT_EQ(H_first, H_first.transpose());
        EXPECT_LT((b_first + A.transpose() * r).norm(), 1e-14 * size * size);
      };
      compute(nullptr);
      EXPECT_EQ(H_second, untouched);
      EXPECT_EQ(H_cross, untouched);
      EXPECT_EQ(b_second, r);
      compute(B.data());
      EXPECT_LT((H_second - B.transpose() * B).norm(), 1e-14 * size * size);
      EXPECT_LT((H_cross - B.transpose() * A).norm(), 1e-14 * size * size);
      EXPECT_LT((b_second + B.transpose() * r).norm(), 1e-14 * size * size);
    }
  }
}

}  // namespace
}  // namespace terse
