#include "run/merge_output.h"

#include <algorithm>
#include <filesystem>

#include "terse/compact/map_file.h"
#include "terse/compact/thresholds_file.h"
#include "terse/core/atomic_file.h"
#include "terse/core/graph_file.h"
#include "terse/core/number_text.h"
#include "terse/core/pose_numbers.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/trajectory.h"

namespace terse {
namespace {

// Links that a map takes part in.
struct LinkCounts {
  long given = 0, accepted = 0;
};
template <class Pose>
LinkCounts CountLinks(const Merged<Pose>& merged, int map) {
  LinkCounts counts;
  for (const auto& link : merged.links) {
    if (link.link.from_map != map && link.link.to_map != map) continue;
    ++counts.given;
    counts.accepted += link.verdict == MapLinkVerdict::kAccepted;
  }
  return counts;
}

}  // namespace

template <class Pose>
nlohmann::ordered_json MergeStats(const Merged<Pose>& merged) {
  nlohmann::ordered_json out;
  long poses = 0;
  for (const auto& map : merged.maps) poses += map.placement == Placement::kApart ? 0 : map.poses;
  const auto of = [&](MapLinkVerdict verdict) {
    return std::count_if(merged.links.begin(), merged.links.end(), [&](const auto& l) { return l.verdict == verdict; });
  };
  out["poses"] = poses;
  out["poses_kept_before"] = merged.poses_before;
  out["poses_kept"] = merged.graph.Poses().size();
  out["factors_kept"] = merged.graph.Factors().size();
  out["links"] = merged.links.size();
  out["links_accepted"] = of(MapLinkVerdict::kAccepted);
  out["links_inconsistent"] = of(MapLinkVerdict::kInconsistent);
  out["links_of_maps_apart"] = of(MapLinkVerdict::kMapsApart);
  out["chi2_before_retiring"] = merged.chi2_before;
  out["chi2"] = merged.chi2;
  double lost = 0;
  for (const auto& pose : merged.retired) lost += pose.loss;
  out["retired"] = merged.retired.size();
  out["retired_loss_nats"] = lost;
  for (std::size_t k = 0; k < merged.maps.size(); ++k) {
    const PlacedMap<Pose>& map = merged.maps[k];
    const LinkCounts links = CountLinks(merged, static_cast<int>(k));
    nlohmann::ordered_json of_map;
    of_map["name"] = map.name;
    of_map["placement"] = Name(map.placement);
    of_map["id_offset"] = map.id_offset;
    of_map["poses"] = map.poses;
    of_map["poses_kept"] = map.kept;
    of_map["loops_left_out"] = map.loops_out;
    of_map["links"] = links.given;
    of_map["links_accepted"] = links.accepted;
    if (map.placement != Placement::kApart) {
      of_map["T_joint_map"] = internal::NumbersOf(map.T_joint_map);
      const Vector<Pose::kDof> deviations = map.covariance.diagonal().cwiseSqrt();
      const std::vector<double> sigma(deviations.data(), deviations.data() + Pose::kDof);
      of_map["sigma_of_first_pose"] = sigma;
    }
    out["maps"].push_back(of_map);
  }
  return out;
}

template <class Pose>
void WriteMerged(const Merged<Pose>& merged, RotationInformation rotation, const InformationScale& scale,
                 const std::string& folder) {
  std::filesystem::remove(folder + "/stats.json");  // it must not stand for what is half written
  WriteG2o(merged.graph, folder + "/compact.g2o", rotation);
  WriteCompactMap(merged.map, Strategy::kBounded, folder + "/graph.json", scale);
  WriteThresholds(merged.thresholds, folder + "/thresholds.json");
  std::vector<PoseId> ids;
  std::vector<Pose> values;
  for (const auto& pose : merged.map.poses) {
    ids.push_back(pose.id);
    values.push_back(pose.T_world_body);
  }
  WriteTum(MakeTrajectory(ids, values), folder + "/trajectory.tum");
  AtomicFile file(folder + "/links.csv");
  file.Stream() << "from_map,from,to_map,to,verdict,agreeing,innovation,joint_from,joint_to\n";
  for (const auto& link : merged.links) {
    file.Stream() << link.link.from_map + 1 << ',' << link.link.measured.from.value << ',' << link.link.to_map + 1
                  << ',' << link.link.measured.to.value << ',' << Name(link.verdict) << ',';
    if (link.agreeing >= 0) file.Stream() << link.agreeing;
    file.Stream() << ',';
    if (link.verdict != MapLinkVerdict::kMapsApart) file.Stream() << Shortest(link.innovation);
    file.Stream() << ',' << link.from.value << ',' << link.to.value << '\n';
  }
  file.Commit();
}

const std::vector<std::string>& MergeFiles() {
  static const std::vector<std::string> files = {"compact.g2o", "graph.json",  "thresholds.json", "trajectory.tum",
                                                 "links.csv",   "report.html", "stats.json"};
  return files;
}

#define TERSE_INSTANTIATE(Pose)                                    \
  template nlohmann::ordered_json MergeStats(const Merged<Pose>&); \
  template void WriteMerged(const Merged<Pose>&, RotationInformation, const InformationScale&, const std::string&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
