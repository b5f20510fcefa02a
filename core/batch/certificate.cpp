#include "terse/core/certificate.h"

#include <Spectra/SymEigsShiftSolver.h>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "batch/chordal_descent.h"
#include "terse/core/at.h"
#include "terse/core/error.h"
#include "terse/core/gauge.h"

namespace terse {
namespace {

using internal::At;
using internal::ChordalTerm;
using Sparse = Eigen::SparseMatrix<double>;
using Triplets = std::vector<Eigen::Triplet<double>>;

// Of the mean of the diagonal.
constexpr double kFirstShift = 1e-11, kLastShift = 1e3;
// An eigenvalue below zero by no more than this share of the largest entry of the diagonal is rounding.
constexpr double kRoundingOfEigenvalues = 1e-12;
constexpr double kNothing = 1e-6;  // cost of a measured scalar
constexpr int kKrylov = 30, kMostRestarts = 1000;
constexpr double kEigenTolerance = 1e-6;

// Unknowns: the position of every pose but the first, which fixes where all lie, and D for its rotation.
int PositionAt(int dimension, int pose) { return pose * (dimension + 1) - 1; }
int RotationAt(int dimension, int pose) { return pose * (dimension + 1); }

// M - Diag(Lambda), as it is at a critical point, and sum tr Lambda.
template <class Pose>
struct CertificateMatrix {
  Sparse S;  // lower triangle
  double trace = 0;
};

template <class Pose>
CertificateMatrix<Pose> MakeMatrix(const std::vector<ChordalTerm<Pose>>& terms, const std::vector<Pose>& T) {
  constexpr int D = Pose::kDim;
  const int poses = static_cast<int>(T.size());
  CertificateMatrix<Pose> out;
  Triplets triplets;
  const auto add = [&](int row, int column, double value) {
    if (row < 0 || column < 0) return;
    triplets.emplace_back(std::max(row, column), std::min(row, column), value);
  };
  std::vector<Matrix<D, D>> diagonal(T.size(), Matrix<D, D>::Zero()), product(T.size(), Matrix<D, D>::Zero());
  for (const auto& term : terms) {
    const Pose &T_i = T[At(term.from)], &T_j = T[At(term.to)];
    const Matrix<D, D> R_i = internal::RotationOf(T_i), R_j = internal::RotationOf(T_j);
    const Vector<D> p = T_j.Translation() - T_i.Translation();
    const Matrix<D, D> I = Matrix<D, D>::Identity();
    diagonal[At(term.from)] += term.kappa * I + term.tau * term.t * term.t.transpose();
    diagonal[At(term.to)] += term.kappa * I;
    // Rows of the product of the estimate [p; R] with M that belong to a rotation.
    product[At(term.from)] +=
        term.kappa * (R_i - R_j * term.R.transpose()) + term.tau * (R_i * term.t - p) * term.t.transpose();
    product[At(term.to)] += term.kappa * (R_j - R_i * term.R);
    // The same as the traces of the multipliers below, without the difference of large numbers.
    out.trace += term.kappa * (R_j - R_i * term.R).squaredNorm() - term.tau * term.t.dot(R_i.transpose() * p - term.t);
    const int p_i = PositionAt(D, term.from), p_j = PositionAt(D, term.to);
    const int r_i = RotationAt(D, term.from), r_j = RotationAt(D, term.to);
    add(p_i, p_i, term.tau);
    add(p_j, p_j, term.tau);
    if (p_i >= 0 && p_j >= 0) add(p_i, p_j, -term.tau);
    for (int k = 0; k < D; ++k) {
      add(p_i, r_i + k, term.tau * term.t[k]);
      add(p_j, r_i + k, -term.tau * term.t[k]);
      for (int l = 0; l < D; ++l) add(r_i + k, r_j + l, -term.kappa * term.R(k, l));
    }
  }
  for (int v = 0; v < poses; ++v) {
    const Matrix<D, D> lambda = internal::RotationOf(T[At(v)]).transpose() * product[At(v)];
    const Matrix<D, D> block = diagonal[At(v)] - (lambda + lambda.transpose()) / 2;
    for (int k = 0; k < D; ++k) {
      for (int l = 0; l <= k; ++l) add(RotationAt(D, v) + k, RotationAt(D, v) + l, block(k, l));
    }
  }
  const int size = poses * (D + 1) - 1;
  out.S.resize(size, size);
  out.S.setFromTriplets(triplets.begin(), triplets.end());
  return out;
}

// The inverse of S + shift on the rotations, positions eliminated. Not a template of D: it takes long to compile.
class ShiftedInverse {
 public:
  using Scalar = double;
  ShiftedInverse(int dimension, const Sparse& S)
      : dimension_(dimension), S_(S), poses_((static_cast<int>(S.rows()) + 1) / (dimension + 1)) {
    solver_.analyzePattern(S_);
  }
  // False if that is not positive definite.
  bool Factor(double shift) {
    Sparse shifted = S_;
    for (int v = 0; v < poses_; ++v) {
      for (int k = 0; k < dimension_; ++k) shifted.coeffRef(At(v, k), At(v, k)) += shift;
    }
    solver_.factorize(shifted);
    return solver_.info() == Eigen::Success;
  }
  // Names that Spectra asks for.
  // NOLINTBEGIN(readability-identifier-naming)
  Eigen::Index rows() const { return poses_ * dimension_; }
  Eigen::Index cols() const { return rows(); }
  void set_shift(double) {}
  void perform_op(const double* x, double* y) const {
    Eigen::VectorXd b = Eigen::VectorXd::Zero(S_.rows());
    for (int v = 0; v < poses_; ++v) {
      for (int k = 0; k < dimension_; ++k) b[At(v, k)] = x[v * dimension_ + k];
    }
    const Eigen::VectorXd solution = solver_.solve(b);
    for (int v = 0; v < poses_; ++v) {
      for (int k = 0; k < dimension_; ++k) y[v * dimension_ + k] = solution[At(v, k)];
    }
  }
  // NOLINTEND(readability-identifier-naming)

 private:
  int At(int pose, int k) const { return RotationAt(dimension_, pose) + k; }

  const int dimension_;
  const Sparse& S_;
  const int poses_;
  Eigen::SimplicialLLT<Sparse, Eigen::Lower> solver_;
};

double SmallestEigenvalue(int dimension, const Sparse& S) {
  ShiftedInverse inverse(dimension, S);
  const double scale = S.diagonal().mean();
  double shift = kFirstShift * scale;
  while (!inverse.Factor(shift)) {
    shift *= 10;
    if (shift > kLastShift * scale) throw NumericalError("the certificate's matrix is not finite");
  }
  const Eigen::Index krylov = std::min<Eigen::Index>(kKrylov, inverse.rows());
  Spectra::SymEigsShiftSolver<ShiftedInverse> eigen(inverse, 1, krylov, -shift);
  eigen.init();
  eigen.compute(Spectra::SortRule::LargestMagn, kMostRestarts, kEigenTolerance);
  if (eigen.info() != Spectra::CompInfo::Successful)
    throw NumericalError("the smallest eigenvalue of the certificate's matrix was not found");
  return eigen.eigenvalues()[0];
}

}  // namespace

template <class Pose>
Certificate Certify(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body,
                    const CertifyOptions& options) {
  if (T_world_body.size() != graph.Poses().size() || T_world_body.empty())
    throw std::invalid_argument("a certificate takes one value per pose, and a pose");
  if (ConnectedComponents(graph).size() > 1)
    throw std::invalid_argument("the graph is in pieces: a certificate is for one that relative measurements connect");
  Certificate out;
  out.has_absolute = CountAbsoluteFactors(graph).Count() > 0;
  const auto terms = internal::ChordalTerms(graph);
  std::vector<Pose> critical = T_world_body;
  out.iterations = internal::DescendChordally(terms, options.max_iterations, options.threads, critical);
  out.cost = internal::ChordalCost(terms, critical);
  for (std::size_t v = 0; v < critical.size(); ++v) {
    const typename Pose::Tangent moved = (T_world_body[v].Inverse() * critical[v]).Log();
    out.largest_turn_rad = std::max(out.largest_turn_rad, moved.template tail<Pose::kDof - Pose::kDim>().norm());
    out.largest_shift_m =
        std::max(out.largest_shift_m, (critical[v].Translation() - T_world_body[v].Translation()).norm());
  }
  const auto [S, trace] = MakeMatrix(terms, critical);
  if (terms.empty()) {  // a single pose
    out.is_global = true;
    return out;
  }
  out.smallest_eigenvalue = SmallestEigenvalue(Pose::kDim, S);
  const double rotations = static_cast<double>(Pose::kDim) * static_cast<double>(critical.size());
  const double below =
      out.smallest_eigenvalue < -kRoundingOfEigenvalues * S.diagonal().maxCoeff() ? out.smallest_eigenvalue : 0;
  out.bound = trace + rotations * below;
  // Measurements without noise cost nothing but rounding.
  const double unit = std::max(out.cost, kNothing * Pose::kDof * static_cast<double>(terms.size()));
  out.gap = std::max(0.0, (out.cost - out.bound) / unit);
  out.is_global = out.gap <= options.most_gap;
  return out;
}

template Certificate Certify(const PoseGraph<SE2>&, const std::vector<SE2>&, const CertifyOptions&);
template Certificate Certify(const PoseGraph<SE3>&, const std::vector<SE3>&, const CertifyOptions&);

}  // namespace terse
