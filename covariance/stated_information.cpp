#include <algorithm>
#include <cmath>

#include "information_kinds.h"
#include "terse/core/definite.h"
#include "terse/covariance/information_scale.h"

namespace terse {
namespace {

constexpr double kEqual = 0.03;         // of the norm: matrices that were turned and rounded are equal
constexpr double kPlausibleStep = 0.5;  // standard deviation of an odometry edge, of its length
constexpr double kPlausibleTurn = 0.5;  // radians

double Percentile(std::vector<double>& values, double share) {
  if (values.empty()) return 0;
  const auto at = static_cast<long>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + at, values.end());
  return values[static_cast<std::size_t>(at)];
}

SigmaSpread SpreadOf(std::vector<double> sigmas) {
  return {Percentile(sigmas, 0.1), Percentile(sigmas, 0.5), Percentile(sigmas, 0.9)};
}

// Blocks apart: metres and radians have different sizes.
template <class Pose>
bool AreEqual(const typename Pose::Jacobian& a, const typename Pose::Jacobian& b) {
  constexpr int kTurn = Pose::kDof - Pose::kDim;
  const auto close = [](const auto& x, const auto& y) { return (x - y).norm() <= kEqual * y.norm(); };
  return close(a.template topLeftCorner<Pose::kDim, Pose::kDim>(),
               b.template topLeftCorner<Pose::kDim, Pose::kDim>()) &&
         close(a.template bottomRightCorner<kTurn, kTurn>(), b.template bottomRightCorner<kTurn, kTurn>()) &&
         (a - b).norm() <= kEqual * b.norm();
}

// Ones as read; in 3D also a quarter for rotation, what ones for the quaternion's vector part are in radians.
template <class Pose>
bool IsIdentity(const typename Pose::Jacobian& information) {
  typename Pose::Jacobian ones = Pose::Jacobian::Identity();
  if (AreEqual<Pose>(information, ones)) return true;
  ones.diagonal().template tail<Pose::kDof - Pose::kDim>().setConstant(0.25);
  return Pose::kDim == 3 && AreEqual<Pose>(information, ones);
}

template <class Pose>
struct Collected {
  std::vector<double> translation_m, rotation_rad, lengths_m;
  std::optional<typename Pose::Jacobian> first;
  bool is_constant = true;

  void Add(const RelativePoseFactor<Pose>& f) {
    constexpr int kDim = Pose::kDim, kTurn = Pose::kDof - kDim;
    const typename Pose::Jacobian covariance = InverseOfDefinite<Pose::kDof>(f.information);
    translation_m.push_back(std::sqrt(covariance.template topLeftCorner<kDim, kDim>().trace() / kDim));
    rotation_rad.push_back(std::sqrt(covariance.template bottomRightCorner<kTurn, kTurn>().trace() / kTurn));
    lengths_m.push_back(f.T_from_to.Translation().norm());
    if (!first) first = f.information;
    is_constant = is_constant && AreEqual<Pose>(f.information, *first);
  }
  StatedKind Stated() const {
    StatedKind out;
    out.edges = static_cast<long>(translation_m.size());
    out.translation_m = SpreadOf(translation_m);
    out.rotation_rad = SpreadOf(rotation_rad);
    out.is_constant = first && is_constant;
    out.is_identity = out.is_constant && IsIdentity<Pose>(*first);
    return out;
  }
};

}  // namespace

bool StatedInformation::IsImplausible() const {
  const StatedKind& chain = odometry.edges > 0 ? odometry : loops;
  return chain.edges > 0 &&
         (chain.translation_m.median > kPlausibleStep * median_step_m || chain.rotation_rad.median > kPlausibleTurn);
}

bool StatedInformation::IsPlaceholder() const {
  const StatedKind& chain = odometry.edges > 0 ? odometry : loops;
  if (chain.edges == 0) return false;
  if (chain.is_identity && (loops.edges == 0 || loops.is_identity)) return true;
  if (!chain.is_constant || (loops.edges > 0 && !loops.is_constant)) return false;
  return IsImplausible();
}

bool InformationScale::IsOne() const {
  return odometry.translation == 1 && odometry.rotation == 1 && loops.translation == 1 && loops.rotation == 1;
}

template <class Pose>
StatedInformation DescribeInformation(const PoseGraph<Pose>& graph) {
  Collected<Pose> odometry, loops;
  const internal::EdgeKinds kinds(graph);
  for (const auto& node : graph.Factors()) {
    const auto* f = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (f != nullptr) (kinds.IsLoop(f->from, f->to) ? loops : odometry).Add(*f);
  }
  StatedInformation out{odometry.Stated(), loops.Stated(), false, 0};
  out.same = out.odometry.is_constant && out.loops.is_constant && AreEqual<Pose>(*odometry.first, *loops.first);
  out.median_step_m = Percentile(odometry.lengths_m.empty() ? loops.lengths_m : odometry.lengths_m, 0.5);
  return out;
}

template <class Pose>
RelativePoseFactor<Pose> ScaleInformation(const RelativePoseFactor<Pose>& factor, const KindScale& scale) {
  RelativePoseFactor<Pose> out = factor;
  out.information = internal::Scaled<Pose>(factor.information, scale);
  return out;
}

template <class Pose>
PoseGraph<Pose> ScaleInformation(const PoseGraph<Pose>& graph, const InformationScale& scale) {
  const internal::EdgeKinds kinds(graph);
  PoseGraph<Pose> out;
  for (const auto& node : graph.Poses()) {
    out.AddPose(node.id, node.T_world_body);
    if (node.fixed) out.SetFixed(node.id, true);
  }
  for (const auto& node : graph.Factors()) {
    Factor<Pose> factor = node.factor;
    if (auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor)) {
      *f = ScaleInformation(*f, kinds.IsLoop(f->from, f->to) ? scale.loops : scale.odometry);
    }
    out.AddFactor(factor);
  }
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                                                          \
  template RelativePoseFactor<Pose> ScaleInformation(const RelativePoseFactor<Pose>&, const KindScale&); \
  template StatedInformation DescribeInformation<Pose>(const PoseGraph<Pose>&);                          \
  template PoseGraph<Pose> ScaleInformation<Pose>(const PoseGraph<Pose>&, const InformationScale&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
