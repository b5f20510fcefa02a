#pragma once
// The baseline factorisation: the same H = A'A in CHOLMOD, with its own choice of ordering and of simplicial or
// supernodal factorisation.

#include <cholmod.h>

#include <utility>
#include <vector>

#include "terse/core/block_cholesky.h"
#include "terse/core/gauge.h"
#include "terse/core/linear_factor.h"
#include "terse/core/pose_graph.h"

namespace terse::bench {

template <class Pose>
class CholmodMatrix {
 public:
  static constexpr int B = Pose::kDof;

  CholmodMatrix(const PoseGraph<Pose>& graph, const std::vector<Pose>& values)
      : CholmodMatrix(FactorsOf(graph, values), values.size()) {}
  // Of the same linear factors as another factor.
  explicit CholmodMatrix(const BlockCholesky<B>& other)
      : CholmodMatrix(FactorsOf(other), static_cast<std::size_t>(other.Variables())) {}
  ~CholmodMatrix() {
    cholmod_free_factor(&factor_, &common_);
    cholmod_free_sparse(&matrix_, &common_);
    cholmod_free_dense(&rhs_, &common_);
    cholmod_finish(&common_);
  }
  CholmodMatrix(const CholmodMatrix&) = delete;
  CholmodMatrix& operator=(const CholmodMatrix&) = delete;

  void Analyze() {
    cholmod_free_factor(&factor_, &common_);
    factor_ = cholmod_analyze(matrix_, &common_);
  }
  void Factorize() { cholmod_factorize(matrix_, factor_, &common_); }
  // The block columns of H^-1 of some variables, side by side, after so many rounds of iterative refinement. Residuals
  // are taken of A'A in extended precision, so that what H lost when it was summed up comes back, too.
  MatrixX InverseColumns(const std::vector<int>& variables, int refinements) {
    MatrixX unit =
        MatrixX::Zero(static_cast<Eigen::Index>(rhs_->nrow), B * static_cast<Eigen::Index>(variables.size()));
    for (std::size_t k = 0; k < variables.size(); ++k) {
      unit.block<B, B>(B * variables[k], B * static_cast<Eigen::Index>(k)).setIdentity();
    }
    MatrixX inverse = Solve(unit);
    for (int k = 0; k < refinements; ++k) inverse += Solve(Residual(unit, inverse));
    return inverse;
  }
  // The largest scalar of H^-1 b.
  double Solve() {
    cholmod_dense* x = cholmod_solve(CHOLMOD_A, factor_, rhs_, &common_);
    const double largest = cholmod_norm_dense(x, 0, &common_);
    cholmod_free_dense(&x, &common_);
    return largest;
  }

 private:
  using LinearFactors = std::vector<LinearFactor<B>>;

  CholmodMatrix(LinearFactors factors, std::size_t variables) : factors_(std::move(factors)) {
    cholmod_start(&common_);
    const std::size_t n = B * variables;
    rhs_ = cholmod_zeros(n, 1, CHOLMOD_REAL, &common_);
    cholmod_triplet* triplets = cholmod_allocate_triplet(n, n, factors_.size() * 3 * B * B, -1, CHOLMOD_REAL, &common_);
    for (const auto& f : factors_) AddFactor(f, *triplets);
    matrix_ = cholmod_triplet_to_sparse(triplets, 0, &common_);
    cholmod_free_triplet(&triplets, &common_);
  }
  static LinearFactors FactorsOf(const PoseGraph<Pose>& graph, const std::vector<Pose>& values) {
    LinearFactors factors;
    for (const auto& node : graph.Factors()) {
      const FactorPoses ends = PosesOf(node.factor);
      const int i = graph.IndexOf(ends.first), j = graph.IndexOf(ends.second);
      factors.push_back(
          Linearize(node.factor, i, j, values[static_cast<std::size_t>(i)], values[static_cast<std::size_t>(j)]));
    }
    factors.push_back(Anchor(FindGauge(graph, values)));
    return factors;
  }
  static LinearFactors FactorsOf(const BlockCholesky<B>& other) {
    LinearFactors factors;
    for (int v = 0; v < other.Variables(); ++v) {
      for (const int slot : other.SlotsOf(v)) {
        if (other.LinearFactorAt(slot).first == v) factors.push_back(other.LinearFactorAt(slot));
      }
    }
    return factors;
  }
  MatrixX Solve(MatrixX rhs) {
    cholmod_dense b{};
    b.nrow = b.d = static_cast<std::size_t>(rhs.rows());
    b.ncol = static_cast<std::size_t>(rhs.cols());
    b.nzmax = static_cast<std::size_t>(rhs.size());
    b.x = rhs.data();
    b.xtype = CHOLMOD_REAL;
    b.dtype = CHOLMOD_DOUBLE;
    cholmod_dense* x = cholmod_solve(CHOLMOD_A, factor_, &b, &common_);
    MatrixX solution = Eigen::Map<const MatrixX>(static_cast<const double*>(x->x), rhs.rows(), rhs.cols());
    cholmod_free_dense(&x, &common_);
    return solution;
  }
  // rhs - A'A x.
  MatrixX Residual(const MatrixX& rhs, const MatrixX& x) const {
    using Long = Eigen::Matrix<long double, Eigen::Dynamic, Eigen::Dynamic>;
    const auto rows = [](auto& of, int variable) { return of.middleRows(B * variable, B); };
    Long residual = rhs.cast<long double>();
    for (const auto& f : factors_) {
      const Long A = f.A_first.template cast<long double>(), C = f.A_second.template cast<long double>();
      Long Ax = A * rows(x, f.first).template cast<long double>();
      if (f.second >= 0) Ax += C * rows(x, f.second).template cast<long double>();
      rows(residual, f.first) -= A.transpose() * Ax;
      if (f.second >= 0) rows(residual, f.second) -= C.transpose() * Ax;
    }
    return residual.cast<double>();
  }
  static void Add(cholmod_triplet& triplets, int i, int j, const Matrix<B, B>& H) {
    for (int c = 0; c < B; ++c) {
      for (int r = 0; r < B; ++r) {
        const int row = B * i + r, column = B * j + c;
        if (row < column) continue;
        static_cast<int*>(triplets.i)[triplets.nnz] = row;
        static_cast<int*>(triplets.j)[triplets.nnz] = column;
        static_cast<double*>(triplets.x)[triplets.nnz++] = H(r, c);
      }
    }
  }
  void AddFactor(const LinearFactor<B>& f, cholmod_triplet& triplets) {
    double* b = static_cast<double*>(rhs_->x);
    const auto add_rhs = [&](int i, const Matrix<B, B>& A) {
      Eigen::Map<Vector<B>>(b + static_cast<std::ptrdiff_t>(B) * i) -= A.transpose() * f.residual;
    };
    Add(triplets, f.first, f.first, f.A_first.transpose() * f.A_first);
    add_rhs(f.first, f.A_first);
    if (f.second < 0) return;
    Add(triplets, f.second, f.second, f.A_second.transpose() * f.A_second);
    add_rhs(f.second, f.A_second);
    const bool forward = f.first > f.second;
    const Matrix<B, B> across =
        forward ? Matrix<B, B>(f.A_first.transpose() * f.A_second) : Matrix<B, B>(f.A_second.transpose() * f.A_first);
    Add(triplets, forward ? f.first : f.second, forward ? f.second : f.first, across);
  }

  LinearFactors factors_;
  cholmod_common common_{};
  cholmod_sparse* matrix_ = nullptr;
  cholmod_dense* rhs_ = nullptr;
  cholmod_factor* factor_ = nullptr;
};

}  // namespace terse::bench
