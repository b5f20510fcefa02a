#include "batch/chordal.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <utility>

#include "terse/core/block_cholesky.h"
#include "terse/core/error.h"
#include "terse/core/gauge.h"
#include "terse/core/residual.h"

namespace terse::internal {
namespace {

template <int D>
using Block = Eigen::Matrix<double, D, D>;
template <int D>
using Point = Eigen::Matrix<double, D, 1>;

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

// A linear least-squares problem with D unknowns per pose: sum |A_i x_i + A_j x_j + r|^2, on the block factor of three
// scalars per variable. In 2D the third one is held at zero.
template <int D>
class LeastSquares {
 public:
  explicit LeastSquares(std::size_t poses) : poses_(poses) {}

  // This pose has a known value; its unknowns stay in the system, cut off from the others, so that indices need no
  // translation.
  void Pin(int pose, const Point<D>& value) {
    pinned_ = pose;
    pinned_value_ = value;
  }
  void Add(int i, const Block<D>& A_i, const Point<D>& r) {
    if (i == pinned_) return;
    LinearFactor<3> f;
    f.first = i;
    f.A_first.template topLeftCorner<D, D>() = A_i;
    f.residual.template head<D>() = r;
    factors_.push_back(f);
  }
  void Add(int i, const Block<D>& A_i, int j, const Block<D>& A_j, const Point<D>& r) {
    if (i == pinned_) return Add(j, A_j, r + A_i * pinned_value_);
    if (j == pinned_) return Add(i, A_i, r + A_j * pinned_value_);
    Add(i, A_i, r);
    factors_.back().second = j;
    factors_.back().A_second.template topLeftCorner<D, D>() = A_j;
  }

  // With the structure of the last problem that was solved with this factor, if there was one.
  std::vector<Point<D>> Solve(BlockCholesky<3>& factor) {
    if (pinned_ >= 0) {
      const int pose = std::exchange(pinned_, -1);
      Add(pose, Block<D>::Identity(), -pinned_value_);
    }
    if (D < 3) HoldThird();
    bool ok = false;
    if (factor.Variables() == 0) {
      BlockCholesky<3>::Changes everything;
      everything.new_variables = static_cast<int>(poses_);
      everything.added = std::move(factors_);
      ok = factor.Update(everything).ok;
    } else {
      factor.SetLinearFactors(factors_);
      ok = factor.Refactor();
    }
    if (!ok) throw NumericalError("chordal initial values: the linear system is singular");
    factor.Solve();
    std::vector<Point<D>> x(poses_);
    for (std::size_t k = 0; k < poses_; ++k) x[k] = Eigen::Map<const Point<D>>(factor.Solution().data() + 3 * k);
    return x;
  }

 private:
  void HoldThird() {
    for (std::size_t k = 0; k < poses_; ++k) {
      LinearFactor<3> f;
      f.first = static_cast<int>(k);
      f.A_first(2, 2) = 1;
      factors_.push_back(f);
    }
  }

  std::size_t poses_;
  std::vector<LinearFactor<3>> factors_;
  int pinned_ = -1;
  Point<D> pinned_value_ = Point<D>::Zero();
};

BlockCholesky<3> EmptyFactor(const StartOptions& options) {
  BlockCholesky<3> factor;
  factor.SetThreads(options.threads);
  factor.DropUpdateMatrices();
  factor.SetProgress(options.factor_progress);
  return factor;
}

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

// A FIXed pose counts as one, as in the solvers.
template <class Pose>
std::vector<PosePriorFactor<Pose>> PosePriors(const PoseGraph<Pose>& graph) {
  std::vector<PosePriorFactor<Pose>> priors;
  for (const auto& node : graph.Factors()) {
    if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&node.factor)) priors.push_back(*f);
  }
  for (const auto& node : graph.Poses()) {
    if (node.fixed && node.T_world_body) priors.push_back(FixedPosePrior(node.id, *node.T_world_body));
  }
  return priors;
}

template <class Pose>
bool HasPositionPriors(const PoseGraph<Pose>& graph) {
  return std::any_of(graph.Factors().begin(), graph.Factors().end(),
                     [](const auto& node) { return std::holds_alternative<PositionPriorFactor<Pose>>(node.factor); });
}

// The unknown of a pose is X = R'; the problem is the same for each of its columns, which are the rows of R. In 2D the
// second column is the first one turned, as everything in the problem commutes with turns.
template <class Pose>
void SolveRotations(const PoseGraph<Pose>& graph, const std::vector<PosePriorFactor<Pose>>& priors, int first,
                    const Pose& T_world_first, const StartOptions& options, std::vector<Pose>& values) {
  constexpr int D = Pose::kDim;
  BlockCholesky<3> factor = EmptyFactor(options);
  std::vector<Block<D>> X(values.size());
  for (int column = 0; column < (D == 2 ? 1 : D); ++column) {
    LeastSquares<D> problem(values.size());
    const auto column_of = [&](const Pose& T) -> Point<D> { return RotationOf(T).row(column).transpose(); };
    if (priors.empty()) problem.Pin(first, column_of(T_world_first));
    // A single prior can be met exactly, however weak it is.
    if (priors.size() == 1) problem.Pin(graph.IndexOf(priors[0].pose), column_of(priors[0].T_world_body));
    for (const auto& node : graph.Factors()) {
      const auto* f = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
      if (f == nullptr) continue;
      const double root = std::sqrt(ChordalWeight<Pose::kDof>(f->information));
      problem.Add(graph.IndexOf(f->from), -root * RotationOf(f->T_from_to).transpose(), graph.IndexOf(f->to),
                  root * Block<D>::Identity(), Point<D>::Zero());
    }
    for (const auto& prior : priors) {
      if (priors.size() == 1) break;
      const double root = std::sqrt(ChordalWeight<Pose::kDof>(prior.information));
      problem.Add(graph.IndexOf(prior.pose), root * Block<D>::Identity(), -root * column_of(prior.T_world_body));
    }
    const std::vector<Point<D>> x = problem.Solve(factor);
    for (std::size_t k = 0; k < x.size(); ++k) {
      X[k].col(column) = x[k];
      if (D == 2) X[k].col(1) << -x[k][1], x[k][0];
    }
  }
  for (std::size_t k = 0; k < values.size(); ++k) {
    const Block<D> R = X[k].transpose();
    Assign(values[k], ProjectToRotation<D>(R), Point<D>::Zero());
  }
}

// With the rotations as they are, every residual is linear in the translations; so this is the minimum of chi2.
// The relative residual depends on t_to - t_from only, a position prior's with its lever arm turned.
template <class Pose>
void SolveTranslations(const PoseGraph<Pose>& graph, const std::vector<PosePriorFactor<Pose>>& priors,
                       bool use_position_priors, int first, const Pose& T_world_first, const StartOptions& options,
                       std::vector<Pose>& values) {
  constexpr int D = Pose::kDim;
  for (Pose& value : values) Assign(value, RotationOf(value), Point<D>::Zero());
  LeastSquares<D> problem(values.size());
  const bool any_position = use_position_priors && HasPositionPriors(graph);
  if (priors.empty() && !any_position) problem.Pin(first, T_world_first.Translation());
  // Its rotation is met, so its translation is the optimum too; a weak prior as the only anchor costs digits.
  if (priors.size() == 1 && !any_position) {
    problem.Pin(graph.IndexOf(priors[0].pose), priors[0].T_world_body.Translation());
  }
  const auto value = [&](int pose) -> const Pose& { return values[static_cast<std::size_t>(pose)]; };
  // J is with respect to the translation in the body frame, t = R rho. The rows that translations enter: with the
  // Cholesky factor of J' Omega J for a square root, and what is left of the residual there.
  const auto add = [&](const auto& J_residual, const Block<D>& R, const auto& residual, const auto& information,
                       const auto& place) {
    const auto A = (J_residual.template leftCols<D>() * R.transpose()).eval();
    const Block<D> H = A.transpose() * information * A;
    const Point<D> g = A.transpose() * information * residual;
    const Eigen::LLT<Block<D>> llt(H);
    if (llt.info() != Eigen::Success) throw NumericalError("chordal initial values: the linear system is singular");
    place(Block<D>(llt.matrixU()), Point<D>(llt.matrixL().solve(g)));
  };
  for (const auto& node : graph.Factors()) {
    if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&node.factor)) {
      const int i = graph.IndexOf(f->from), j = graph.IndexOf(f->to);
      const auto linear = EvaluateRelative(f->T_from_to, value(i), value(j));
      add(linear.J_residual_to, RotationOf(value(j)), linear.residual, f->information,
          [&](const Block<D>& U, const Point<D>& r) { problem.Add(i, -U, j, U, r); });
    } else if (const auto* q = std::get_if<PositionPriorFactor<Pose>>(&node.factor); q != nullptr && any_position) {
      const int i = graph.IndexOf(q->pose);
      const auto linear = EvaluatePosition(*q, value(i));
      add(linear.J_residual_pose, RotationOf(value(i)), linear.residual, q->information,
          [&](const Block<D>& U, const Point<D>& r) { problem.Add(i, U, r); });
    }
  }
  for (const auto& prior : priors) {
    const int i = graph.IndexOf(prior.pose);
    const auto linear = EvaluatePrior(prior.T_world_body, value(i));
    add(linear.J_residual_pose, RotationOf(value(i)), linear.residual, prior.information,
        [&](const Block<D>& U, const Point<D>& r) { problem.Add(i, U, r); });
  }
  BlockCholesky<3> factor = EmptyFactor(options);
  const std::vector<Point<D>> t = problem.Solve(factor);
  for (std::size_t k = 0; k < values.size(); ++k) Assign(values[k], RotationOf(values[k]), t[k]);
}

// Positions before a rigid motion, and where it is to bring them.
template <int D>
struct PositionPairs {
  std::size_t number = 0;
  Point<D> mean_old = Point<D>::Zero(), mean_new = Point<D>::Zero();
  Block<D> C = Block<D>::Zero();  // sum of centred new times old'
  double spread_old = 0, spread_new = 0;
  Eigen::JacobiSVD<Block<D>> svd;  // of C

  double Spread() const { return std::sqrt(spread_old * spread_new); }
  // The turn is determined if D - 1 singular values differ from zero.
  bool DetermineTurn() const { return number > 0 && svd.singularValues()[D - 2] > 1e-9 * Spread(); }
  template <class Pose>
  Pose MotionWith(const Block<D>& R) const {
    Pose T_new_old;
    Assign(T_new_old, R, mean_new - R * mean_old);
    return T_new_old;
  }
};

template <class Pose>
PositionPairs<Pose::kDim> PairPositions(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_old_body) {
  constexpr int D = Pose::kDim;
  std::vector<std::pair<Point<D>, Point<D>>> positions;  // old, new
  PositionPairs<D> out;
  for (const auto& node : graph.Factors()) {
    const auto* f = std::get_if<PositionPriorFactor<Pose>>(&node.factor);
    if (f == nullptr) continue;
    positions.emplace_back(T_old_body[static_cast<std::size_t>(graph.IndexOf(f->pose))] * f->p_body, f->p_world);
    out.mean_old += positions.back().first;
    out.mean_new += positions.back().second;
  }
  out.number = positions.size();
  if (out.number == 0) return out;
  out.mean_old /= static_cast<double>(out.number);
  out.mean_new /= static_cast<double>(out.number);
  for (const auto& [p_old, p_new] : positions) {
    out.C += (p_new - out.mean_new) * (p_old - out.mean_old).transpose();
    out.spread_old += (p_old - out.mean_old).squaredNorm();
    out.spread_new += (p_new - out.mean_new).squaredNorm();
  }
  out.svd.compute(out.C, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return out;
}

// The motion that lays the values over the position priors; where several do so equally well (one position, or all on a
// straight line in 3D) the one that turns least.
template <class Pose>
Pose ClosestToPositionPriors(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_old_body) {
  constexpr int D = Pose::kDim;
  const PositionPairs<D> pairs = PairPositions(graph, T_old_body);
  Block<D> R = Block<D>::Identity();
  if (pairs.DetermineTurn()) {
    R = ProjectToRotation<D>(pairs.C);
  } else if constexpr (D == 3) {
    if (pairs.svd.singularValues()[0] > 1e-9 * pairs.Spread()) {
      const Point<3> along_old = pairs.svd.matrixV().col(0), along_new = pairs.svd.matrixU().col(0);
      R = Eigen::Quaterniond::FromTwoVectors(along_old, along_new).toRotationMatrix();
    }
  }
  return pairs.template MotionWith<Pose>(R);
}

}  // namespace

template <class Pose>
std::vector<Pose> ChordalValues(const PoseGraph<Pose>& graph, int first, const Pose& T_world_first,
                                const StartOptions& options) {
  std::vector<Pose> values(graph.Poses().size());
  const auto priors = PosePriors(graph);
  SolveRotations(graph, priors, first, T_world_first, options, values);
  if (priors.empty() && HasPositionPriors(graph)) {
    // The shape first: it turns the rotations into the frame of the positions.
    SolveTranslations(graph, priors, false, first, T_world_first, options, values);
    const Pose T_new_old = ClosestToPositionPriors(graph, values);
    for (Pose& value : values) value = T_new_old * value;
  }
  SolveTranslations(graph, priors, true, first, T_world_first, options, values);
  return values;
}

template <class Pose>
std::optional<Pose> AlignToPositionPriors(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_old_body) {
  const PositionPairs<Pose::kDim> pairs = PairPositions(graph, T_old_body);
  if (!pairs.DetermineTurn()) return std::nullopt;
  return pairs.template MotionWith<Pose>(ProjectToRotation<Pose::kDim>(pairs.C));
}

#define TERSE_INSTANTIATE(Pose)                                                                                  \
  template std::vector<Pose> ChordalValues<Pose>(const PoseGraph<Pose>&, int, const Pose&, const StartOptions&); \
  template std::optional<Pose> AlignToPositionPriors<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
