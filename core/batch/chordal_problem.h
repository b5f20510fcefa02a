#pragma once
// The chordal relaxation of a pose graph: its two linear problems, for whatever solves them, and the rigid alignment to
// position priors.
//
// `Measurements` says what a graph holds, by pose index:
//   Poses()                    number of poses
//   Priors()                   vector of PriorAt: pose priors, FIXed poses among them
//   HasPositions()             whether there are position priors
//   ForEachRelative(fn)        fn(RelativePoseFactor, from, to)
//   ForEachPosition(fn)        fn(PositionPriorFactor, pose)
// `Problem` is a linear least-squares problem with D unknowns per pose, for several right sides:
//   Pin(pose, X)               these unknowns have a known value
//   Add(i, A_i, R)             |A_i X_i + R|^2
//   Add(i, A_i, j, A_j, R)     |A_i X_i + A_j X_j + R|^2
//   Solve()                    X by pose; throws if the system is singular or not finite

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "batch/chordal_descent.h"
#include "terse/core/decompositions.h"
#include "terse/core/definite.h"
#include "terse/core/residual.h"

namespace terse::internal {

template <int D>
using Block = Eigen::Matrix<double, D, D>;
template <int D>
using Point = Eigen::Matrix<double, D, 1>;
// One column per right side.
template <int D>
using Columns = Eigen::Matrix<double, D, Eigen::Dynamic, 0, D, D>;

template <class Pose>
struct PriorAt {
  PosePriorFactor<Pose> prior;
  int pose;
};

inline void Assign(SE2& T, const Block<2>& R, const Eigen::Vector2d& t) { T = SE2(t, std::atan2(R(1, 0), R(0, 0))); }
inline void Assign(SE3& T, const Block<3>& R, const Eigen::Vector3d& t) { T = SE3(SO3::FromMatrix(R), t); }

// The weight kappa of |R_j - R_i R_ij|^2, Frobenius. With R_j = R_i R_ij Exp(phi) it is 2 |phi|^2 to first order, so an
// isotropic factor of variance s^2 per axis has kappa = 1 / (2 s^2). s^2 is the mean variance of phi, translation
// marginalised: the isotropic Gaussian closest in Kullback-Leibler divergence (the weight of SE-Sync). The weight
// matrix tr(Omega) / 2 I - Omega, exact to first order, was no better: chi2 1715 against 1679 on sphere2500,
// 3.15e6 against 3.12e6 on sphere_bignoise, 1.4193 against 1.4205 on parking-garage.
template <int N>
double ChordalWeight(const Matrix<N, N>& information) {
  constexpr int kAngles = N == 6 ? 3 : 1;
  const Block<N> Sigma = InverseOfDefinite<N>(information);
  return kAngles / (2 * Sigma.template bottomRightCorner<kAngles, kAngles>().trace());
}

// The unknown of a pose is X = R'; the problem is the same for each of its columns, which are the rows of R. In 2D the
// second column is the first one turned, as everything in the problem commutes with turns.
template <class Pose, class Measurements, class Problem>
void SolveRotations(const Measurements& measurements, int first, const Pose& T_world_first, Problem problem,
                    std::vector<Pose>& values) {
  constexpr int D = Pose::kDim, Unknown = D == 2 ? 1 : D;
  const auto known = [](const Pose& T) -> Columns<D> { return RotationOf(T).transpose().template leftCols<Unknown>(); };
  const auto& priors = measurements.Priors();
  if (priors.empty()) problem.Pin(first, known(T_world_first));
  // A single prior can be met exactly, however weak it is.
  if (priors.size() == 1) problem.Pin(priors[0].pose, known(priors[0].prior.T_world_body));
  measurements.ForEachRelative([&](const RelativePoseFactor<Pose>& f, int from, int to) {
    const double root = std::sqrt(ChordalWeight<Pose::kDof>(f.information));
    problem.Add(from, -root * RotationOf(f.T_from_to).transpose(), to, root * Block<D>::Identity(),
                Columns<D>::Zero(D, Unknown));
  });
  for (const auto& [prior, pose] : priors) {
    if (priors.size() == 1) break;
    const double root = std::sqrt(ChordalWeight<Pose::kDof>(prior.information));
    problem.Add(pose, root * Block<D>::Identity(), -root * known(prior.T_world_body));
  }
  const std::vector<Columns<D>> X = problem.Solve();
  for (std::size_t k = 0; k < values.size(); ++k) {
    Block<D> R;
    R.template topRows<Unknown>() = X[k].transpose();
    if (D == 2) R.row(1) << -R(0, 1), R(0, 0);
    Assign(values[k], ClosestRotation<D>(R), Point<D>::Zero());
  }
}

// With the rotations as they are, every residual is linear in the translations; so this is the minimum of chi2.
// The relative residual depends on t_to - t_from only, a position prior's with its lever arm turned.
template <class Pose, class Measurements, class Problem>
void SolveTranslations(const Measurements& measurements, bool use_positions, int first, const Pose& T_world_first,
                       Problem problem, std::vector<Pose>& values) {
  constexpr int D = Pose::kDim;
  for (Pose& value : values) Assign(value, RotationOf(value), Point<D>::Zero());
  const bool any_position = use_positions && measurements.HasPositions();
  const auto& priors = measurements.Priors();
  if (priors.empty() && !any_position) problem.Pin(first, T_world_first.Translation());
  // Its rotation is met, so its translation is the optimum too; a weak prior as the only anchor costs digits.
  if (priors.size() == 1 && !any_position) problem.Pin(priors[0].pose, priors[0].prior.T_world_body.Translation());
  const auto value = [&](int pose) -> const Pose& { return values[static_cast<std::size_t>(pose)]; };
  // J is with respect to the translation in the body frame, t = R rho. The rows that translations enter: with the
  // Cholesky factor of J' Omega J for a square root, and what is left of the residual there.
  const auto add = [&](const auto& J_residual, const Block<D>& R, const auto& residual, const auto& information,
                       const auto& place) {
    const auto A = (J_residual.template leftCols<D>() * R.transpose()).eval();
    const Block<D> H = A.transpose() * information * A;
    const Point<D> g = A.transpose() * information * residual;
    const Eigen::LLT<Block<D>> llt(H);
    // Not a number makes Solve fail, which all processes of a distributed run do together.
    const double ok = llt.info() == Eigen::Success ? 1 : std::numeric_limits<double>::quiet_NaN();
    place(Block<D>(ok * Block<D>(llt.matrixU())), Point<D>(ok * llt.matrixL().solve(g)));
  };
  measurements.ForEachRelative([&](const RelativePoseFactor<Pose>& f, int i, int j) {
    const auto linear = EvaluateRelative(f.T_from_to, value(i), value(j));
    add(linear.J_residual_to, RotationOf(value(j)), linear.residual, f.information,
        [&](const Block<D>& U, const Point<D>& r) { problem.Add(i, -U, j, U, r); });
  });
  if (any_position) {
    measurements.ForEachPosition([&](const PositionPriorFactor<Pose>& f, int i) {
      const auto linear = EvaluatePosition(f, value(i));
      add(linear.J_residual_pose, RotationOf(value(i)), linear.residual, f.information,
          [&](const Block<D>& U, const Point<D>& r) { problem.Add(i, U, r); });
    });
  }
  for (const auto& [prior, pose] : priors) {
    const int i = pose;
    const auto linear = EvaluatePrior(prior.T_world_body, value(i));
    add(linear.J_residual_pose, RotationOf(value(i)), linear.residual, prior.information,
        [&](const Block<D>& U, const Point<D>& r) { problem.Add(i, U, r); });
  }
  const std::vector<Columns<D>> t = problem.Solve();
  for (std::size_t k = 0; k < values.size(); ++k) Assign(values[k], RotationOf(values[k]), Point<D>(t[k].col(0)));
}

// Positions before a rigid motion, and where it is to bring them.
template <int D>
struct PositionPairs {
  std::size_t number = 0;
  Point<D> mean_old = Point<D>::Zero(), mean_new = Point<D>::Zero();
  Block<D> C = Block<D>::Zero();  // sum of centred new times old'
  double spread_old = 0, spread_new = 0;
  SingularValues<D> svd{Block<D>(Block<D>::Zero())};  // of C

  double Spread() const { return std::sqrt(spread_old * spread_new); }
  // The turn is determined if D - 1 singular values differ from zero.
  bool DetermineTurn() const { return number > 0 && svd.values[D - 2] > 1e-9 * Spread(); }
  template <class Pose>
  Pose MotionWith(const Block<D>& R) const {
    Pose T_new_old;
    Assign(T_new_old, R, mean_new - R * mean_old);
    return T_new_old;
  }
};

template <class Pose, class Measurements>
PositionPairs<Pose::kDim> PairPositions(const Measurements& measurements, const std::vector<Pose>& T_old_body) {
  constexpr int D = Pose::kDim;
  std::vector<std::pair<Point<D>, Point<D>>> positions;  // old, new
  PositionPairs<D> out;
  measurements.ForEachPosition([&](const PositionPriorFactor<Pose>& f, int pose) {
    positions.emplace_back(T_old_body[static_cast<std::size_t>(pose)] * f.p_body, f.p_world);
    out.mean_old += positions.back().first;
    out.mean_new += positions.back().second;
  });
  out.number = positions.size();
  if (out.number == 0) return out;
  out.mean_old /= static_cast<double>(out.number);
  out.mean_new /= static_cast<double>(out.number);
  for (const auto& [p_old, p_new] : positions) {
    out.C += (p_new - out.mean_new) * (p_old - out.mean_old).transpose();
    out.spread_old += (p_old - out.mean_old).squaredNorm();
    out.spread_new += (p_new - out.mean_new).squaredNorm();
  }
  out.svd = SingularValues<D>(out.C);
  return out;
}

// The rotation by the least angle that takes one unit vector to another; half a turn about any axis across them where
// they are opposite.
inline Block<3> LeastTurn(const Point<3>& from, const Point<3>& to) {
  Point<3> axis = from.cross(to);
  axis -= axis.dot(from) * from;  // rounding, which counts where they are nearly opposite
  const double sine = axis.norm(), angle = std::atan2(sine, from.dot(to));
  return SO3::Exp(sine > 1e-12 ? Point<3>(angle / sine * axis) : Point<3>(angle * from.unitOrthogonal())).Rotation();
}

// The motion that lays the values over the position priors; where several do so equally well (one position, or all on a
// straight line in 3D) the one that turns least.
template <class Pose, class Measurements>
Pose ClosestToPositionPriors(const Measurements& measurements, const std::vector<Pose>& T_old_body) {
  constexpr int D = Pose::kDim;
  const PositionPairs<D> pairs = PairPositions(measurements, T_old_body);
  Block<D> R = Block<D>::Identity();
  if (pairs.DetermineTurn()) {
    R = pairs.svd.ClosestOrthogonal();
  } else if constexpr (D == 3) {
    if (pairs.svd.values[0] > 1e-9 * pairs.Spread()) {
      const Point<3> along_old = pairs.svd.V.col(0), along_new = pairs.svd.U.col(0);
      R = LeastTurn(along_old, along_new);
    }
  }
  return pairs.template MotionWith<Pose>(R);
}

// `new_problem(columns)`: an empty Problem with so many right sides.
template <class Pose, class Measurements, class NewProblem>
std::vector<Pose> ChordalStart(const Measurements& measurements, int first, const Pose& T_world_first,
                               const NewProblem& new_problem) {
  std::vector<Pose> values(measurements.Poses());
  SolveRotations(measurements, first, T_world_first, new_problem(Pose::kDim == 2 ? 1 : 3), values);
  if (measurements.Priors().empty() && measurements.HasPositions()) {
    // The shape first: it turns the rotations into the frame of the positions.
    SolveTranslations(measurements, false, first, T_world_first, new_problem(1), values);
    const Pose T_new_old = ClosestToPositionPriors(measurements, values);
    for (Pose& value : values) value = T_new_old * value;
  }
  SolveTranslations(measurements, true, first, T_world_first, new_problem(1), values);
  return values;
}

}  // namespace terse::internal
