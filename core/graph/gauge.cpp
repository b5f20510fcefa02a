#include "terse/core/gauge.h"

#include <cmath>
#include <locale>
#include <sstream>

#include "terse/core/decompositions.h"

namespace terse {
namespace {

// Of the largest: what is below is rounding.
constexpr double kRounding = 1e-12;

// The projection on the eigenvectors whose eigenvalue is below `least`, and their number.
template <int N>
int ProjectOnFree(const Matrix<N, N>& information, double least, Matrix<N, N>& projection) {
  const SymmetricEigen<N> eigen = DecomposeSymmetric<N>(information);
  int free = 0;
  while (free < N && eigen.values[free] < least) ++free;
  const auto axes = eigen.vectors.leftCols(free);
  projection = axes * axes.transpose();
  return free;
}

// Without the directions that are zero to rounding.
template <int N>
Matrix<N, N> PseudoInverse(const Matrix<N, N>& information) {
  const SymmetricEigen<N> eigen = DecomposeSymmetric<N>(information);
  Vector<N> inverse = Vector<N>::Zero();
  for (int k = 0; k < N; ++k) {
    const double value = eigen.values[k];
    if (value > kRounding * eigen.values[N - 1]) inverse[k] = 1 / value;
  }
  return eigen.vectors * inverse.asDiagonal() * eigen.vectors.transpose();
}

template <class Pose>
void AddAbsolute(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body,
                 AbsoluteInformation<Pose>& information) {
  const auto value = [&](PoseId id) -> const Pose& {
    return T_world_body.at(static_cast<std::size_t>(graph.IndexOf(id)));
  };
  for (const auto& node : graph.Poses()) {
    if (node.fixed && node.T_world_body)
      information.Add(FixedPosePrior<Pose>(node.id, *node.T_world_body), value(node.id));
  }
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    if (ends.count == 1) information.Add(node.factor, value(ends.first));
  }
}

std::string Text(const Vector<3>& axis) {
  std::ostringstream out;
  out.imbue(std::locale::classic());
  out.precision(2);
  out << "(" << axis[0] << ", " << axis[1] << ", " << axis[2] << ")";
  return out.str();
}

// What the anchor holds of the turns of a spatial map, in words.
std::string DescribeTurns(const Gauge<SE3>& gauge, const SE3& T_world_first) {
  if (gauge.free_turns == 3) return "heading, roll and pitch are";
  const Matrix<3, 3> R = T_world_first.Adjoint().topLeftCorner<3, 3>();
  const Matrix<3, 3> held = R * gauge.root.bottomRightCorner<3, 3>() * R.transpose();
  const SymmetricEigen<3> eigen = DecomposeSymmetric<3>(held);
  if (gauge.free_turns == 2) return "the turns across the axis " + Text(eigen.vectors.col(0)) + " are";
  Vector<3> axis = eigen.vectors.col(2);
  if (axis[2] < 0) axis = -axis;
  const bool is_heading = axis[2] > 0.9;
  return (is_heading ? "heading, the turn about the axis " : "the turn about the axis ") + Text(axis) + ", is";
}

std::string DescribeTurns(const Gauge<SE2>&, const SE2&) { return "heading is"; }

}  // namespace

template <class Pose>
AbsoluteFactors CountAbsoluteFactors(const PoseGraph<Pose>& graph) {
  AbsoluteFactors count;
  for (const auto& node : graph.Poses()) {
    if (node.fixed && node.T_world_body) ++count.pose_priors;
  }
  for (const auto& node : graph.Factors()) {
    if (std::holds_alternative<PosePriorFactor<Pose>>(node.factor)) ++count.pose_priors;
    if (std::holds_alternative<PositionPriorFactor<Pose>>(node.factor)) ++count.position_priors;
  }
  return count;
}

template <class Pose>
void AbsoluteInformation<Pose>::Add(const Factor<Pose>& factor, const Pose& T_world_body) {
  if (std::holds_alternative<RelativePoseFactor<Pose>>(factor)) return;
  if (!any_) centre_ = T_world_body.Translation();
  any_ = true;
  // A pose prior's at zero residual: how far off the map is says nothing about what is measured.
  Matrix<B, B> A = SquareRootInformation(factor);
  if (std::holds_alternative<PositionPriorFactor<Pose>>(factor)) {
    A = Linearize(factor, A, 0, 0, T_world_body, T_world_body).A_first;
  } else {
    any_pose_prior_ = true;
  }
  Vector<B> shift = Vector<B>::Zero();
  shift.template head<Pose::kDim>() = -centre_;
  const Pose T_centre_body = Pose().Retract(shift) * T_world_body;
  const Matrix<B, B> J = A * T_centre_body.Inverse().Adjoint();
  information_ += J.transpose() * J;
}

template <class Pose>
Gauge<Pose> AbsoluteInformation<Pose>::FindGauge(const Pose& T_world_first) const {
  constexpr int D = Pose::kDim, R = B - D;
  Gauge<Pose> gauge;
  if (!any_) return gauge;
  const Matrix<D, D> shifts = information_.template topLeftCorner<D, D>();
  const Matrix<D, R> mixed = information_.template topRightCorner<D, R>();
  // About the turns alone: wherever the map is shifted to.
  const Matrix<R, R> turns =
      information_.template bottomRightCorner<R, R>() - mixed.transpose() * PseudoInverse<D>(shifts) * mixed;
  Matrix<D, D> held_shifts;
  Matrix<R, R> held_turns;
  gauge.free_shifts = ProjectOnFree<D>(shifts, kLeastPositionInformation, held_shifts);
  gauge.free_turns = ProjectOnFree<R>((turns + turns.transpose()) / 2, kLeastTurnInformation, held_turns);
  const Matrix<B, B> adjoint = T_world_first.Adjoint();
  const Matrix<D, D> R_shift = adjoint.template topLeftCorner<D, D>();
  const Matrix<R, R> R_turn = adjoint.template bottomRightCorner<R, R>();
  const double root = std::sqrt(kAnchorInformation), weak = any_pose_prior_ ? 0 : std::sqrt(kWeakAnchorInformation);
  gauge.root.setZero();
  gauge.root.template topLeftCorner<D, D>() = root * R_shift.transpose() * held_shifts * R_shift;
  const Matrix<R, R> P = R_turn.transpose() * held_turns * R_turn;
  gauge.root.template bottomRightCorner<R, R>() = root * P + weak * (Matrix<R, R>::Identity() - P);
  return gauge;
}

template <class Pose>
Gauge<Pose> FindGauge(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body) {
  AbsoluteInformation<Pose> information;
  AddAbsolute(graph, T_world_body, information);
  return information.FindGauge(T_world_body.empty() ? Pose() : T_world_body.front());
}

template <class Pose>
LinearFactor<Pose::kDof> Anchor(const Gauge<Pose>& gauge) {
  LinearFactor<Pose::kDof> out;
  out.first = 0;
  out.A_first = gauge.root;
  return out;
}

template <class Pose>
std::string DescribeUndetermined(const Gauge<Pose>& gauge, const Pose& T_world_first) {
  std::string what;
  if (gauge.free_turns > 0) {
    what = DescribeTurns(gauge, T_world_first) + " not determined by the priors yet";
  }
  if (gauge.free_shifts > 0) {
    what += (what.empty() ? "" : ", and ") + std::string("the position is not determined in ") +
            (gauge.free_shifts == Pose::kDim ? "any direction" : std::to_string(gauge.free_shifts) + " directions");
  }
  return what.empty() ? what : what + ": held at the first pose's, relative to which covariances are";
}

template <class Pose>
std::string DescribeUndetermined(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body) {
  if (CountAbsoluteFactors(graph).Count() == 0 || T_world_body.empty()) return "";
  return DescribeUndetermined(FindGauge(graph, T_world_body), T_world_body.front());
}

template <class Pose>
PosePriorFactor<Pose> FixedPosePrior(PoseId id, const Pose& T_world_body) {
  return {id, T_world_body, kAnchorInformation * Pose::Jacobian::Identity()};
}

#define TERSE_INSTANTIATE(Pose)                                                                      \
  template AbsoluteFactors CountAbsoluteFactors<Pose>(const PoseGraph<Pose>&);                       \
  template class AbsoluteInformation<Pose>;                                                          \
  template Gauge<Pose> FindGauge<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&);            \
  template LinearFactor<Pose::kDof> Anchor<Pose>(const Gauge<Pose>&);                                \
  template std::string DescribeUndetermined<Pose>(const Gauge<Pose>&, const Pose&);                  \
  template std::string DescribeUndetermined<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&); \
  template PosePriorFactor<Pose> FixedPosePrior<Pose>(PoseId, const Pose&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
