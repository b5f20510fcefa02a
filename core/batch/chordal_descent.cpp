#include "batch/chordal_descent.h"

#include <Eigen/QR>
#include <cmath>
#include <limits>

#include "terse/core/at.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/definite.h"
#include "terse/core/error.h"
#include "terse/core/gauge.h"

namespace terse::internal {
namespace {

// Steps that are predicted to lower the cost by less than this share of it are below its rounding: they are taken as
// long as the prediction falls.
constexpr double kBelowRounding = 1e-14;
constexpr double kShortest = 1e-6;  // step

// The measured and the estimated relative pose, their difference weighted; D D + D scalars.
template <class Pose>
auto Difference(const ChordalTerm<Pose>& term, const Pose& T_from, const Pose& T_to) {
  constexpr int D = Pose::kDim;
  const Pose T = T_from.Inverse() * T_to;
  const Matrix<D, D> dR = std::sqrt(term.kappa) * (RotationOf(T) - term.R);
  Vector<D * D + D> out;
  for (int c = 0; c < D; ++c) out.template segment<D>(c * D) = dR.col(c);
  out.template tail<D>() = std::sqrt(term.tau) * (T.Translation() - term.t);
  return out;
}

// Generators of the rotations: d(R Exp(phi)) = R hat(e_k) d phi_k.
Matrix<2, 2> Generator(const SE2&, int) { return (Matrix<2, 2>() << 0, -1, 1, 0).finished(); }
Matrix<3, 3> Generator(const SE3&, int k) { return Hat(Vector<3>::Unit(k)); }

// All of a term depends on the relative pose, so that as many rows as a pose has dimensions say the same.
template <class Pose>
LinearFactor<Pose::kDof> LinearizeTerm(const ChordalTerm<Pose>& term, const Pose& T_from, const Pose& T_to) {
  constexpr int D = Pose::kDim, B = Pose::kDof, Rows = D * D + D;
  const Pose T = T_from.Inverse() * T_to;
  const Matrix<D, D> R = RotationOf(T);
  Matrix<Rows, B> J = Matrix<Rows, B>::Zero();  // by the perturbation of `to`, on the right
  J.template block<D, D>(D * D, 0) = std::sqrt(term.tau) * R;
  for (int k = 0; k < B - D; ++k) {
    const Matrix<D, D> turned = std::sqrt(term.kappa) * R * Generator(T, k);
    for (int c = 0; c < D; ++c) J.template block<D, 1>(c * D, D + k) = turned.col(c);
  }
  const Eigen::HouseholderQR<Matrix<Rows, B>> qr(J);
  const Matrix<Rows, B> Q = qr.householderQ() * Matrix<Rows, B>::Identity();
  LinearFactor<B> factor;
  factor.first = term.from;
  factor.second = term.to;
  factor.A_second = Q.transpose() * J;
  factor.A_first = -factor.A_second * T.Inverse().Adjoint();
  factor.residual = Q.transpose() * Difference(term, T_from, T_to);
  return factor;
}

}  // namespace

Matrix<2, 2> RotationOf(const SE2& T) { return T.Rotation(); }
Matrix<3, 3> RotationOf(const SE3& T) { return T.Rotation().Rotation(); }

template <class Pose>
std::vector<ChordalTerm<Pose>> ChordalTerms(const PoseGraph<Pose>& graph) {
  constexpr int D = Pose::kDim, Turns = Pose::kDof - Pose::kDim;
  std::vector<ChordalTerm<Pose>> terms;
  for (const auto& node : graph.Factors()) {
    const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (edge == nullptr) continue;
    const typename Pose::Jacobian covariance = InverseOfDefinite<Pose::kDof>(edge->information);
    ChordalTerm<Pose> term{graph.IndexOf(edge->from),
                           graph.IndexOf(edge->to),
                           RotationOf(edge->T_from_to),
                           edge->T_from_to.Translation(),
                           0,
                           0};
    // |R - I|^2 is twice the square of the angle.
    term.kappa = Turns / (2 * covariance.template bottomRightCorner<Turns, Turns>().trace());
    term.tau = D / covariance.template topLeftCorner<D, D>().trace();
    terms.push_back(term);
  }
  return terms;
}

template <class Pose>
double ChordalCost(const std::vector<ChordalTerm<Pose>>& terms, const std::vector<Pose>& T_world_body) {
  double cost = 0;
  for (const auto& term : terms)
    cost += Difference(term, T_world_body[At(term.from)], T_world_body[At(term.to)]).squaredNorm();
  return cost;
}

template <class Pose>
int DescendChordally(const std::vector<ChordalTerm<Pose>>& terms, int max_iterations, int threads,
                     std::vector<Pose>& T_world_body) {
  constexpr int B = Pose::kDof;
  const auto linearise = [&] {
    std::vector<LinearFactor<B>> factors = {Anchor<B>(0, Vector<B>::Constant(kAnchorInformation))};
    for (const auto& term : terms)
      factors.push_back(LinearizeTerm(term, T_world_body[At(term.from)], T_world_body[At(term.to)]));
    return factors;
  };
  BlockCholesky<B> cholesky;
  cholesky.SetThreads(threads);
  cholesky.DropUpdateMatrices();
  typename BlockCholesky<B>::Changes everything;
  everything.new_variables = static_cast<int>(T_world_body.size());
  everything.added = linearise();
  bool is_ready = cholesky.Update(everything).ok;
  double cost = ChordalCost(terms, T_world_body), least = std::numeric_limits<double>::infinity();
  int iteration = 0;
  while (iteration < max_iterations) {
    if (!is_ready) throw NumericalError("the chordal problem is singular at the estimate");
    ++iteration;
    cholesky.Solve();
    const double predicted = cholesky.NewtonDecrement();
    const bool is_rounding = predicted <= kBelowRounding * cost;
    if (is_rounding && !(predicted < least / 2)) break;
    least = is_rounding ? predicted : least;
    std::vector<Pose> trial(T_world_body.size());
    double share = 1, after = 0;
    for (;; share /= 2) {
      for (std::size_t v = 0; v < trial.size(); ++v) {
        const Eigen::Map<const Vector<B>> d(cholesky.Solution().data() + v * static_cast<std::size_t>(B));
        trial[v] = T_world_body[v] * Pose::Exp(share * d);
      }
      after = ChordalCost(terms, trial);
      if (is_rounding || after <= cost || share < kShortest) break;
    }
    if (!is_rounding && !(after < cost)) break;
    T_world_body = std::move(trial);
    cost = after;
    cholesky.SetLinearFactors(linearise());
    is_ready = cholesky.Refactor();
  }
  return iteration;
}

#define TERSE_INSTANTIATE(Pose)                                                                 \
  template std::vector<ChordalTerm<Pose>> ChordalTerms(const PoseGraph<Pose>&);                 \
  template double ChordalCost(const std::vector<ChordalTerm<Pose>>&, const std::vector<Pose>&); \
  template int DescendChordally(const std::vector<ChordalTerm<Pose>>&, int, int, std::vector<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
