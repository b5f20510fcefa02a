#pragma once
// How state_file.h stores the options of the incremental solver.

#include "terse/core/incremental_options.h"
#include "terse/core/state_file.h"

namespace terse {

template <class Archive>
void Serialize(Archive& archive, RobustOptions& options) {
  auto& [kernel, width, gnc_step, quantile] = options;
  archive(kernel, width, gnc_step, quantile);
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

}  // namespace terse
