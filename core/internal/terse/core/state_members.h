#pragma once
// How state_file.h stores the types of this library: for the .cpp of a class that holds some of them.

#include "terse/core/incremental_solver.h"
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

template <class Archive>
void Serialize(Archive& archive, PhaseSeconds& seconds) {
  auto& [order, linearise, factor, solve] = seconds;
  archive(order, linearise, factor, solve);
}

template <class Archive>
void Serialize(Archive& archive, RobustOptions& options) {
  auto& [kernel, width, gnc_step] = options;
  archive(kernel, width, gnc_step);
}

template <class Archive>
void Serialize(Archive& archive, IncrementalOptions& options) {
  auto& [carry, gate, gate_threshold, decrease_scale, relinearize_tolerance, relinearize_metres, relinearize_radians,
         relinearize_interval, propagation_tolerance, max_iterations, step_metres, step_radians, partial,
         partial_neighbours, guard, budget_seconds, anchor_information, robust, reweigh_tolerance, restart, threads,
         report_cost, on_point_work, log] = options;  // the last two are not stored
  bool was_an_option = false;                         // of files of before
  archive(carry, gate, gate_threshold, decrease_scale, relinearize_tolerance, relinearize_metres, relinearize_radians,
          relinearize_interval, propagation_tolerance, max_iterations, step_metres, step_radians, partial,
          partial_neighbours, guard, budget_seconds, anchor_information, robust, reweigh_tolerance, restart, threads,
          report_cost, was_an_option);
  if constexpr (Archive::kReads) {
    const std::string defect = FindDefect(options);
    if (!defect.empty()) archive.Fail(defect);
  }
}

// Those of the classes are compiled in the library.
#define TERSE_EXTERN_STATE(Archive, Pose)                             \
  extern template void PoseGraph<Pose>::Serialize<Archive>(Archive&); \
  extern template void IncrementalSolver<Pose>::Serialize<Archive>(Archive&);
TERSE_EXTERN_STATE(StateWriter, SE2)
TERSE_EXTERN_STATE(StateReader, SE2)
TERSE_EXTERN_STATE(StateWriter, SE3)
TERSE_EXTERN_STATE(StateReader, SE3)
#undef TERSE_EXTERN_STATE

}  // namespace terse
