#include "carry.h"

#include <stdexcept>
#include <variant>

#include "chains.h"
#include "terse/core/decompositions.h"
#include "terse/core/definite.h"
#include "terse/core/residual.h"

namespace terse::internal {
namespace {

template <class Pose>
using Seen = typename PoseHistory<Pose>::Seen;

template <class Value>
void ThrowIfDefective(const Value& measured) {
  const std::string defect = FindDefect(measured);
  if (!defect.empty()) throw std::invalid_argument(defect);
}

// An end that is nullptr stays.
template <class Pose>
RelativePoseFactor<Pose> Carry(const RelativePoseFactor<Pose>& link, const Seen<Pose>* from, const Seen<Pose>* to,
                               CompositionOrder order) {
  ThrowIfDefective<Factor<Pose>>(link);
  if (from != nullptr && from->kept) from = nullptr;
  if (to != nullptr && to->kept) to = nullptr;
  if (from == nullptr && to == nullptr) return link;
  UncertainPose<Pose> measured = SeenFrom(link.from, link);
  if (from != nullptr) measured = Compose(from->T_base_pose, measured, order);
  if (to != nullptr) measured = Compose(measured, Invert(to->T_base_pose), order);
  return Measurement(from != nullptr ? from->base : link.from, to != nullptr ? to->base : link.to, measured, order);
}

// A position prior on a pose behind the end of a chain as one on the pose at its start, with the chain's translation as
// (more of) its lever arm and the chain's covariance added, turned into the world as the pose at its start is. If how
// that is turned is not known (`is_turned` false), its largest variance in every direction instead.
template <class Pose>
PositionPriorFactor<Pose> CarryPosition(const PositionPriorFactor<Pose>& prior, const Seen<Pose>& seen,
                                        const Pose& T_world_base, bool is_turned) {
  constexpr int D = Pose::kDim;
  using Block = Eigen::Matrix<double, D, D>;
  // Of the measured point in the base's frame: the Jacobian of T_base_pose Exp(d) p_body is that of the factor itself.
  PositionPriorFactor<Pose> in_base = prior;
  const Matrix<D, Pose::kDof> J = EvaluatePosition(in_base, seen.T_base_pose.T_a_b).J_residual_pose;
  const Block chain = J * seen.T_base_pose.covariance * J.transpose();
  Block added;
  if (is_turned) {
    const Block R = T_world_base.Adjoint().template topLeftCorner<D, D>();
    added = R * chain * R.transpose();
  } else {
    const double largest = SymmetricEigenvalues<D>(chain)[D - 1];
    added = largest * Block::Identity();
  }
  const Block measured = InverseOfDefinite<D>(prior.information);
  const Block information = InverseOfDefinite<D>(measured + added);
  PositionPriorFactor<Pose> out = prior;
  out.pose = seen.base;
  out.p_body = seen.T_base_pose.T_a_b * prior.p_body;
  out.information = (information + information.transpose()) / 2;
  return out;
}

}  // namespace

template <class Pose>
RelativePoseFactor<Pose> CarryToKept(const RelativePoseFactor<Pose>& link, const PoseHistory<Pose>& history,
                                     CompositionOrder order) {
  return Carry<Pose>(link, &history.Find(link.from), &history.Find(link.to), order);
}

template <class Pose>
RelativePoseFactor<Pose> CarryEndToKept(PoseId end, const RelativePoseFactor<Pose>& link,
                                        const PoseHistory<Pose>& history, CompositionOrder order) {
  if (end != link.from && end != link.to) {
    throw std::invalid_argument("the link does not touch pose " + std::to_string(end.value));
  }
  const auto& seen = history.Find(end);
  return Carry<Pose>(link, end == link.from ? &seen : nullptr, end == link.to ? &seen : nullptr, order);
}

template <class Pose>
Factor<Pose> CarryPriorToKept(const Factor<Pose>& prior, const PoseHistory<Pose>& history,
                              const IncrementalSolver<Pose>& solver, CompositionOrder order) {
  const FactorPoses ends = PosesOf(prior);
  if (ends.count != 1) throw std::invalid_argument("a link is no prior");
  ThrowIfDefective(prior);
  const auto& seen = history.Find(ends.first);
  if (seen.kept) return prior;
  if (const auto* measured = std::get_if<PosePriorFactor<Pose>>(&prior)) {
    // A link from the origin of the world.
    const RelativePoseFactor<Pose> link{{}, {1}, measured->T_world_body, measured->information};
    const RelativePoseFactor<Pose> carried = Carry<Pose>(link, nullptr, &seen, order);
    return PosePriorFactor<Pose>{seen.base, carried.T_from_to, carried.information};
  }
  const bool is_turned = solver.CurrentGauge().free_turns == 0;
  return CarryPosition<Pose>(std::get<PositionPriorFactor<Pose>>(prior), seen, solver.Estimate(seen.base), is_turned);
}

#define TERSE_INSTANTIATE(Pose)                                                                                       \
  template RelativePoseFactor<Pose> CarryToKept(const RelativePoseFactor<Pose>&, const PoseHistory<Pose>&,            \
                                                CompositionOrder);                                                    \
  template RelativePoseFactor<Pose> CarryEndToKept(PoseId, const RelativePoseFactor<Pose>&, const PoseHistory<Pose>&, \
                                                   CompositionOrder);                                                 \
  template Factor<Pose> CarryPriorToKept(const Factor<Pose>&, const PoseHistory<Pose>&,                               \
                                         const IncrementalSolver<Pose>&, CompositionOrder);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
