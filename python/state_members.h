#pragma once
// How pickles store what the library reports. A member that is forgotten does not compile.

#include "terse/compact/compact_graph.h"
#include "terse/compact/map_file.h"
#include "terse/compact/merge.h"
#include "terse/compact/state_members.h"
#include "terse/core/evaluate.h"
#include "terse/core/graph_file.h"
#include "terse/core/observability.h"
#include "terse/covariance/covariance_options.h"
#include "terse/covariance/information_scale.h"

namespace terse {

template <class Archive>
void Serialize(Archive& archive, StepReport& report) {
  auto& [factor_ids, path, fronts_updated, fronts_refactored, variables_refactored, gate_open, gate_value, iterations,
         variables_relinearised, variables_moved, predicted_decrease, actual_decrease, gain_nats, restarted,
         deferred_relinearisations, deferred_fronts, flops, solve_flops, seconds] = report;
  archive(factor_ids, path, fronts_updated, fronts_refactored, variables_refactored, gate_open, gate_value, iterations,
          variables_relinearised, variables_moved, predicted_decrease, actual_decrease, gain_nats, restarted,
          deferred_relinearisations, deferred_fronts, flops, solve_flops, seconds);
}

template <class Archive>
void Serialize(Archive& archive, Candidate& candidate) {
  auto& [id, probability, gain, measured, tried, measured_gain, innovation, outlier, supported, accepted, factor,
         carried_from, anchors, composed] = candidate;
  archive(id, probability, gain, measured, tried, measured_gain, innovation, outlier, supported, accepted, factor,
          carried_from, anchors, composed);
}

template <class Archive>
void Serialize(Archive& archive, ComposedEdge& edge) {
  auto& [id, from, to, gain, fused] = edge;
  archive(id, from, to, gain, fused);
}

template <class Archive>
void Serialize(Archive& archive, RetiredPose& pose) {
  auto& [id, loss, neighbours, factors_removed, factors_recovered] = pose;
  archive(id, loss, neighbours, factors_removed, factors_recovered);
}

template <class Archive>
void Serialize(Archive& archive, Decision& decision) {
  auto& [id, candidates, candidates_found, verdict, pose_gain, registrations_tried, links_accepted, links_refused,
         loops_forgotten, revived, retired, anchored_to, edges, update] = decision;
  archive(id, candidates, candidates_found, verdict, pose_gain, registrations_tried, links_accepted, links_refused,
          loops_forgotten, revived, retired, anchored_to, edges, update);
}

template <class Archive>
void Serialize(Archive& archive, LinkDecision& decision) {
  auto& [from, to, gain, innovation, outlier, accepted, factor] = decision;
  archive(from, to, gain, innovation, outlier, accepted, factor);
}

template <class Archive, class Pose>
void Serialize(Archive& archive, MapLink<Pose>& link) {
  auto& [from_map, to_map, measured] = link;
  archive(from_map, to_map, measured);
}

template <class Archive, class Pose>
void Serialize(Archive& archive, SampledThresholds<Pose>& sampled) {
  auto& [thresholds, loop_gain_90, pose_gain_90, sample_poses, sample_loops, sample_links] = sampled;
  auto& [range, probability, min_loop_gain, min_pose_gain, link_covariance] = thresholds;
  archive(range, probability, min_loop_gain, min_pose_gain, link_covariance, loop_gain_90, pose_gain_90, sample_poses,
          sample_loops, sample_links);
}

template <class Archive>
void Serialize(Archive& archive, CovarianceReport& report) {
  auto& [path, columns, flops, seconds, downdate_cost, recursion_cost, drift, measured_drift, refreshed] = report;
  archive(path, columns, flops, seconds, downdate_cost, recursion_cost, drift, measured_drift, refreshed);
}

template <class Archive>
void Serialize(Archive& archive, PoseError& error) {
  auto& [translation_m, rotation_deg] = error;
  archive(translation_m, rotation_deg);
}

template <class Archive>
void Serialize(Archive& archive, KittiError& error) {
  auto& [t_rel_percent, r_rel_deg_per_100m, segments] = error;
  archive(t_rel_percent, r_rel_deg_per_100m, segments);
}

template <class Archive>
void Serialize(Archive& archive, Evaluation& evaluation) {
  auto& [ate, rpe, rpe_all, poses, kitti] = evaluation;
  archive(ate, rpe, rpe_all, poses, kitti);
}

template <class Archive>
void Serialize(Archive& archive, Trajectory& trajectory) {
  auto& [format, stamps, T_world_body] = trajectory;
  archive(format, stamps, T_world_body);
  if constexpr (Archive::kReads) {
    if (stamps.size() != T_world_body.size()) archive.Fail("not as many stamps as poses");
  }
}

template <class Archive>
void Serialize(Archive& archive, GraphFile& file) {
  auto& [graph, format, skipped_tags, repaired_informations] = file;
  archive(graph, format, skipped_tags, repaired_informations);
}

template <class Archive>
void Serialize(Archive& archive, FreeMotion& motion) {
  auto& [freedom, poses, ids, pose, directions] = motion;
  auto rows = static_cast<std::int64_t>(directions.rows()), columns = static_cast<std::int64_t>(directions.cols());
  archive(freedom, poses, ids, pose, rows, columns);
  if constexpr (Archive::kReads) {
    if (rows < 0 || columns < 0 || rows > 6 || columns > 6) archive.Fail("directions of another size");
    directions.resize(rows, columns);
  }
  archive.Doubles(directions.data(), static_cast<std::size_t>(rows * columns));
}

template <class Archive>
void Serialize(Archive& archive, SigmaSpread& spread) {
  auto& [low, median, high] = spread;
  archive(low, median, high);
}
template <class Archive>
void Serialize(Archive& archive, StatedKind& kind) {
  auto& [edges, translation_m, rotation_rad, is_constant, is_identity] = kind;
  archive(edges, translation_m, rotation_rad, is_constant, is_identity);
}
template <class Archive>
void Serialize(Archive& archive, StatedInformation& stated) {
  auto& [odometry, loops, same, median_step_m] = stated;
  archive(odometry, loops, same, median_step_m);
}
template <class Archive>
void Serialize(Archive& archive, KindScale& scale) {
  auto& [translation, rotation] = scale;
  archive(translation, rotation);
}
template <class Archive>
void Serialize(Archive& archive, InformationScale& scale) {
  auto& [odometry, loops] = scale;
  archive(odometry, loops);
}
template <class Archive>
void Serialize(Archive& archive, ScaleEstimate& estimate) {
  auto& [sigma_factor, log_error, redundancy, determined, at_floor] = estimate;
  archive(sigma_factor, log_error, redundancy, determined, at_floor);
}
template <class Archive>
void Serialize(Archive& archive, KindEstimate& estimate) {
  auto& [translation, rotation] = estimate;
  archive(translation, rotation);
}
template <class Archive>
void Serialize(Archive& archive, InformationEstimate& estimate) {
  auto& [odometry, loops, poses, edges, loop_edges, has_copies, loops_left_out, agreeing_loops, iterations,
         normalized_chi2, failure] = estimate;
  archive(odometry, loops, poses, edges, loop_edges, has_copies, loops_left_out, agreeing_loops, iterations,
          normalized_chi2, failure);
}
template <class Archive>
void Serialize(Archive& archive, InformationCalibration& calibration) {
  auto& [stated, estimate, verdict, scale, without_caution, message] = calibration;
  archive(stated, estimate, verdict, scale, without_caution, message);
}

template <class Archive, class Pose>
void Serialize(Archive& archive, CompactMap<Pose>& map) {
  auto& [poses, forgotten, edges, priors, fixed, refused, failed] = map;
  archive(forgotten);
  archive.Each(poses, [&archive](auto& seen) {
    auto& [id, kept, T_world_body, T_world_body_when_seen, previous, base, T_base_pose, next_kept, T_base_next,
           anchored_to, ended_by, carried] = seen;
    archive(id, kept, T_world_body, T_world_body_when_seen, previous, base, T_base_pose, next_kept, T_base_next,
            anchored_to, ended_by, carried);
  });
  archive.Each(edges, [&archive](auto& edge) {
    auto& [factor, measured, is_loop, added_at, gain, composed_of, parts] = edge;
    archive(factor, measured, is_loop, added_at, gain, composed_of);
    archive.Each(parts, [&archive](auto& part) {
      auto& [id, part_added_at, part_gain, links, T_from_to, measurements] = part;
      archive(id, part_added_at, part_gain, links, T_from_to, measurements);
    });
  });
  archive.Each(priors, [&archive](auto& prior) {
    auto& [factor, measured] = prior;
    archive(factor, measured);
  });
  archive.Each(fixed, [&archive](auto& held) {
    auto& [pose, T_world_body] = held;
    archive(pose, T_world_body);
  });
  archive.Each(refused, [&archive](auto& link) {
    auto& [candidate, seen, T_candidate_seen] = link;
    archive(candidate, seen, T_candidate_seen);
  });
  archive.Each(failed, [&archive](auto& pair) {
    auto& [candidate, seen] = pair;
    archive(candidate, seen);
  });
  if constexpr (Archive::kReads) {
    const std::string defect = FindDefect(map);
    if (!defect.empty()) archive.Fail(defect);
  }
}
template <class Archive>
void Serialize(Archive& archive, CompactMapFile& file) {
  auto& [map, strategy, information_scale] = file;
  archive(map, strategy, information_scale);
}

// Without the Cholesky factor, which is made again when covariances are asked for.
template <class Archive, class Pose>
void Serialize(Archive& archive, BatchResult<Pose>& result) {
  auto& [termination, message, T_world_body, iterations, chi2, robust_cost, gradient_norm, log_determinant, seconds,
         factor, free_motions, robust_width, weights] = result;
  archive(termination, message, T_world_body, iterations, chi2, robust_cost, gradient_norm, log_determinant, seconds,
          free_motions, robust_width, weights);
}

}  // namespace terse
