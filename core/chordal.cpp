#include "chordal.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <Eigen/SVD>
#include <Eigen/SparseCholesky>

#include "terse/core/error.h"
#include "terse/core/residual.h"

namespace terse::internal {
namespace {

template <int D>
using Block = Eigen::Matrix<double, D, D>;
using Dense = Eigen::MatrixXd;

Block<2> RotationOf(const SE2& T) { return T.Rotation(); }
Block<3> RotationOf(const SE3& T) { return T.Rotation().Rotation(); }
void Assign(SE2& T, const Block<2>& R, const Eigen::Vector2d& t) { T = SE2(t, std::atan2(R(1, 0), R(0, 0))); }
void Assign(SE3& T, const Block<3>& R, const Eigen::Vector3d& t) { T = SE3(SO3::FromMatrix(R), t); }

// The rotation closest to M in the Frobenius norm.
template <int D>
Block<D> ProjectToRotation(const Block<D>& M) {
  const Eigen::JacobiSVD<Block<D>> svd(M, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Block<D> U = svd.matrixU();
  if ((U * svd.matrixV().transpose()).determinant() < 0) U.col(D - 1) *= -1;
  return U * svd.matrixV().transpose();
}

// Normal equations H X = B in D x D blocks, X with `columns` columns. One pose can be pinned at a known value.
template <int D>
class BlockEquations {
 public:
  BlockEquations(std::size_t poses, int columns) : B_(Dense::Zero(Eigen::Index(D * poses), columns)) {}

  void Pin(int pose, const Dense& value) {
    pinned_ = pose;
    pinned_value_ = value;
  }
  void AddDiagonal(int i, const Block<D>& H) { Add(i, i, H); }
  // H_ji, and H_ij = H_ji'.
  void AddOffDiagonal(int j, int i, const Block<D>& H_ji) {
    if (i == pinned_) {
      AddRight(j, -H_ji * pinned_value_);
    } else if (j == pinned_) {
      AddRight(i, -H_ji.transpose() * pinned_value_);
    } else if (j > i) {
      Add(j, i, H_ji);
    } else {
      Add(i, j, H_ji.transpose());
    }
  }
  template <class Derived>
  void AddRight(int i, const Eigen::MatrixBase<Derived>& b) {
    B_.middleRows<D>(D * i) += b;
  }

  Dense Solve() {
    if (pinned_ >= 0) {
      // Its unknowns stay in the system, cut off from the others, so that indices need no translation.
      for (int k = 0; k < D; ++k) triplets_.emplace_back(D * pinned_ + k, D * pinned_ + k, 1.0);
      B_.middleRows<D>(D * pinned_) = pinned_value_;
    }
    Eigen::SparseMatrix<double> H(B_.rows(), B_.rows());
    H.setFromTriplets(triplets_.begin(), triplets_.end());
    triplets_ = {};
    const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>, Eigen::Lower, Eigen::AMDOrdering<int>> ldlt(H);
    if (ldlt.info() != Eigen::Success || ldlt.vectorD().minCoeff() <= 0) {
      throw NumericalError("chordal initial values: the linear system is singular");
    }
    return ldlt.solve(B_);
  }

 private:
  void Add(int row, int column, const Block<D>& H) {
    if (row == pinned_) return;
    for (int c = 0; c < D; ++c) {
      for (int r = row == column ? c : 0; r < D; ++r) {
        if (H(r, c) != 0) triplets_.emplace_back(D * row + r, D * column + c, H(r, c));
      }
    }
  }

  Dense B_;
  std::vector<Eigen::Triplet<double>> triplets_;  // lower triangle
  int pinned_ = -1;
  Dense pinned_value_;
};

// The weight kappa of |R_j - R_i R_ij|^2, Frobenius. With R_j = R_i R_ij Exp(phi) it is 2 |phi|^2 to first order, so an
// isotropic factor of variance s^2 per axis has kappa = 1 / (2 s^2). s^2 is the mean variance of phi, translation
// marginalised: the isotropic Gaussian closest in Kullback-Leibler divergence (the weight of SE-Sync). The weight
// matrix tr(Omega) / 2 I - Omega, exact to first order, was no better: chi2 1715 against 1679 on sphere2500,
// 3.15e6 against 3.12e6 on sphere_bignoise, 1.4193 against 1.4205 on parking-garage.
template <int N>
double ChordalWeight(const Matrix<N, N>& information) {
  constexpr int kAngles = N == 6 ? 3 : 1;
  const Block<N> Sigma = Block<N>(information).llt().solve(Block<N>::Identity());
  return kAngles / (2 * Sigma.template bottomRightCorner<kAngles, kAngles>().trace());
}

template <class Pose>
std::vector<const PosePriorFactor<Pose>*> PosePriors(const PoseGraph<Pose>& graph) {
  std::vector<const PosePriorFactor<Pose>*> priors;
  for (const auto& node : graph.Factors()) {
    if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&node.factor)) priors.push_back(f);
  }
  return priors;
}

// The unknown of a pose is X = R', a D x D block: each row of R is then a column of right-hand sides of its own.
template <class Pose>
void SolveRotations(const PoseGraph<Pose>& graph, int first, const Pose& T_world_first, std::vector<Pose>& values) {
  constexpr int D = Pose::kDim;
  BlockEquations<D> equations(values.size(), D);
  const auto priors = PosePriors(graph);
  if (priors.empty()) equations.Pin(first, RotationOf(T_world_first).transpose());
  // A single prior can be met exactly, however weak it is.
  if (priors.size() == 1) {
    equations.Pin(graph.IndexOf(priors[0]->pose), RotationOf(priors[0]->T_world_body).transpose());
  }
  for (const auto& node : graph.Factors()) {
    if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&node.factor)) {
      const int i = graph.IndexOf(f->from), j = graph.IndexOf(f->to);
      const double kappa = ChordalWeight<Pose::kDof>(f->information);
      equations.AddDiagonal(j, kappa * Block<D>::Identity());
      equations.AddDiagonal(i, kappa * Block<D>::Identity());
      equations.AddOffDiagonal(j, i, -kappa * RotationOf(f->T_from_to).transpose());
    } else if (const auto* p = std::get_if<PosePriorFactor<Pose>>(&node.factor); p != nullptr && priors.size() > 1) {
      const double kappa = ChordalWeight<Pose::kDof>(p->information);
      equations.AddDiagonal(graph.IndexOf(p->pose), kappa * Block<D>::Identity());
      equations.AddRight(graph.IndexOf(p->pose), kappa * RotationOf(p->T_world_body).transpose());
    }
  }
  const Dense X = equations.Solve();
  for (std::size_t k = 0; k < values.size(); ++k) {
    const Block<D> R = X.middleRows<D>(Eigen::Index(D * k)).transpose();
    Assign(values[k], ProjectToRotation<D>(R), Eigen::Matrix<double, D, 1>::Zero());
  }
}

// With the rotations as they are, every residual is linear in the translations; so this is the minimum of chi2.
// The relative residual depends on t_to - t_from only, a position prior's with its lever arm turned.
template <class Pose>
void SolveTranslations(const PoseGraph<Pose>& graph, bool use_position_priors, int first, const Pose& T_world_first,
                       std::vector<Pose>& values) {
  constexpr int D = Pose::kDim;
  for (Pose& value : values) Assign(value, RotationOf(value), Eigen::Matrix<double, D, 1>::Zero());
  BlockEquations<D> equations(values.size(), 1);
  std::size_t priors = 0;
  const PosePriorFactor<Pose>* pose_prior = nullptr;
  for (const auto& node : graph.Factors()) {
    if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&node.factor)) pose_prior = f, ++priors;
    priors += use_position_priors && std::holds_alternative<PositionPriorFactor<Pose>>(node.factor);
  }
  if (priors == 0) equations.Pin(first, T_world_first.Translation());
  // Its rotation is met, so its translation is the optimum too; a weak prior as the only anchor costs digits.
  if (priors == 1 && pose_prior != nullptr) {
    equations.Pin(graph.IndexOf(pose_prior->pose), pose_prior->T_world_body.Translation());
  }
  const auto value = [&](int pose) -> const Pose& { return values[static_cast<std::size_t>(pose)]; };
  // J is with respect to the translation in the body frame; t = R rho.
  const auto add_prior = [&](int i, const auto& linear, const auto& information) {
    const auto A = (linear.J_residual_pose.template leftCols<D>() * RotationOf(value(i)).transpose()).eval();
    equations.AddDiagonal(i, A.transpose() * information * A);
    equations.AddRight(i, -A.transpose() * information * linear.residual);
  };
  for (const auto& node : graph.Factors()) {
    if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&node.factor)) {
      const int i = graph.IndexOf(f->from), j = graph.IndexOf(f->to);
      const auto linear = EvaluateRelative(f->T_from_to, value(i), value(j));
      const auto A = (linear.J_residual_to.template leftCols<D>() * RotationOf(value(j)).transpose()).eval();
      const Block<D> W = A.transpose() * f->information * A;
      const Eigen::Matrix<double, D, 1> g = A.transpose() * f->information * linear.residual;
      equations.AddDiagonal(i, W);
      equations.AddDiagonal(j, W);
      equations.AddOffDiagonal(j, i, -W);
      equations.AddRight(j, -g);
      equations.AddRight(i, g);
    } else if (const auto* p = std::get_if<PosePriorFactor<Pose>>(&node.factor)) {
      const int i = graph.IndexOf(p->pose);
      add_prior(i, EvaluatePrior(p->T_world_body, value(i)), p->information);
    } else if (use_position_priors) {
      const auto& q = std::get<PositionPriorFactor<Pose>>(node.factor);
      const int i = graph.IndexOf(q.pose);
      add_prior(i, EvaluatePosition(q, value(i)), q.information);
    }
  }
  const Dense t = equations.Solve();
  for (std::size_t k = 0; k < values.size(); ++k) {
    Assign(values[k], RotationOf(values[k]), t.middleRows<D>(Eigen::Index(D * k)));
  }
}

}  // namespace

template <class Pose>
std::vector<Pose> ChordalValues(const PoseGraph<Pose>& graph, int first, const Pose& T_world_first) {
  std::vector<Pose> values(graph.Poses().size());
  SolveRotations(graph, first, T_world_first, values);
  if (PosePriors(graph).empty()) {
    const bool any_position = std::any_of(graph.Factors().begin(), graph.Factors().end(), [](const auto& node) {
      return std::holds_alternative<PositionPriorFactor<Pose>>(node.factor);
    });
    if (any_position) {
      // The shape first: it turns the rotations into the frame of the positions.
      SolveTranslations(graph, false, first, T_world_first, values);
      if (const auto T_new_old = AlignToPositionPriors(graph, values)) {
        for (Pose& value : values) value = *T_new_old * value;
      }
    }
  }
  SolveTranslations(graph, true, first, T_world_first, values);
  return values;
}

template <class Pose>
std::optional<Pose> AlignToPositionPriors(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_old_body) {
  constexpr int D = Pose::kDim;
  using Point = Eigen::Matrix<double, D, 1>;
  std::vector<std::pair<Point, Point>> pairs;  // old, new
  Point mean_old = Point::Zero(), mean_new = Point::Zero();
  for (const auto& node : graph.Factors()) {
    const auto* f = std::get_if<PositionPriorFactor<Pose>>(&node.factor);
    if (f == nullptr) continue;
    pairs.emplace_back(T_old_body[static_cast<std::size_t>(graph.IndexOf(f->pose))] * f->p_body, f->p_world);
    mean_old += pairs.back().first;
    mean_new += pairs.back().second;
  }
  if (pairs.empty()) return std::nullopt;
  mean_old /= static_cast<double>(pairs.size());
  mean_new /= static_cast<double>(pairs.size());
  Block<D> C = Block<D>::Zero();
  double spread_old = 0, spread_new = 0;
  for (const auto& [p_old, p_new] : pairs) {
    C += (p_new - mean_new) * (p_old - mean_old).transpose();
    spread_old += (p_old - mean_old).squaredNorm();
    spread_new += (p_new - mean_new).squaredNorm();
  }
  // The rotation is determined if D - 1 singular values differ from zero.
  const auto singular_values = Eigen::JacobiSVD<Block<D>>(C).singularValues();
  if (!(singular_values[D - 2] > 1e-9 * std::sqrt(spread_old * spread_new))) return std::nullopt;
  const Block<D> R = ProjectToRotation<D>(C);
  Pose T_new_old;
  Assign(T_new_old, R, mean_new - R * mean_old);
  return T_new_old;
}

#define TERSE_INSTANTIATE(Pose)                                                             \
  template std::vector<Pose> ChordalValues<Pose>(const PoseGraph<Pose>&, int, const Pose&); \
  template std::optional<Pose> AlignToPositionPriors<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
