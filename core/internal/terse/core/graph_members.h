#pragma once
// How state_file.h stores poses, measurements and their linearisations: for the .cpp of a class that holds some of
// them.

#include "terse/core/gauge.h"
#include "terse/core/state_file.h"

namespace terse {

template <class Archive>
void Serialize(Archive& archive, SE2& T) {
  auto p = T.Translation();  // NOLINT(performance-unnecessary-copy-initialization): reading writes to it.
  double theta = T.Theta();
  archive(p, theta);
  if constexpr (Archive::kReads) T = SE2(p, theta);
}

// Its constructor leaves a unit quaternion as it is.
template <class Archive>
void Serialize(Archive& archive, SE3& T) {
  auto p = T.Translation();  // NOLINT(performance-unnecessary-copy-initialization): reading writes to it.
  Vector<4> q = T.Rotation().Unit().coeffs();  // x y z w
  archive(p, q);
  if constexpr (Archive::kReads) T = SE3(SO3(Quaternion(q[3], q[0], q[1], q[2])), p);
}

template <class Archive>
void Serialize(Archive& archive, PoseId& id) {
  auto& [value] = id;
  archive(value);
}

template <class Archive>
void Serialize(Archive& archive, FactorId& id) {
  auto& [value] = id;
  archive(value);
}

template <class Archive, class Pose>
void Serialize(Archive& archive, RelativePoseFactor<Pose>& factor) {
  auto& [from, to, T_from_to, information] = factor;
  archive(from, to, T_from_to, information);
}

template <class Archive, class Pose>
void Serialize(Archive& archive, PosePriorFactor<Pose>& factor) {
  auto& [pose, T_world_body, information] = factor;
  archive(pose, T_world_body, information);
}

template <class Archive, class Pose>
void Serialize(Archive& archive, PositionPriorFactor<Pose>& factor) {
  auto& [pose, p_world, information, p_body] = factor;
  archive(pose, p_world, information, p_body);
}

template <class Archive, class Pose>
void Serialize(Archive& archive, FactorNode<Pose>& node) {
  auto& [id, factor] = node;
  archive(id, factor);
}

template <class Archive, int B>
void Serialize(Archive& archive, LinearFactor<B>& factor) {
  auto& [first, second, A_first, A_second, residual] = factor;
  archive(first, second, A_first, A_second, residual);
}

template <class Archive>
void Serialize(Archive& archive, AbsoluteFactors& count) {
  auto& [pose_priors, position_priors] = count;
  archive(pose_priors, position_priors);
}

template <class Archive, class Pose>
void Serialize(Archive& archive, Gauge<Pose>& gauge) {
  auto& [free_shifts, free_turns, root] = gauge;
  archive(free_shifts, free_turns, root);
}

// Those of the classes are compiled in the library.
#define TERSE_EXTERN_STATE(Archive, Pose) extern template void PoseGraph<Pose>::Serialize<Archive>(Archive&);
TERSE_EXTERN_STATE(StateWriter, SE2)
TERSE_EXTERN_STATE(StateReader, SE2)
TERSE_EXTERN_STATE(StateWriter, SE3)
TERSE_EXTERN_STATE(StateReader, SE3)
#undef TERSE_EXTERN_STATE

}  // namespace terse
