#include "run/sparsify_output.h"

#include <algorithm>
#include <filesystem>

#include "terse/compact/map_file.h"
#include "terse/compact/words.h"
#include "terse/core/atomic_file.h"
#include "terse/core/graph_file.h"
#include "terse/core/number_text.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/trajectory.h"

namespace terse {

template <class Pose>
nlohmann::ordered_json SparsifyStats(const PoseGraph<Pose>& graph, const Sparsified<Pose>& small,
                                     const SparsifyOptions& options) {
  const auto kept = std::count_if(small.links.begin(), small.links.end(), [](const auto& link) { return link.kept; });
  nlohmann::ordered_json out;
  out["poses"] = graph.Poses().size();
  out["poses_kept"] = small.graph.Poses().size();
  out["factors"] = graph.Factors().size();
  out["factors_kept"] = small.graph.Factors().size();
  out["links"] = static_cast<long>(small.links.size()) - small.links_at_least;
  out["links_kept"] = kept - small.links_at_least;
  out["criterion"] = WordOf(options.criterion);
  out["fixed"] = WordOf(options.fixed);
  out["recovered"] = WordOf(options.recovered);
  out["conservative"] = options.conservative;
  out["recentred"] = options.recentre;
  out["expected_error_whole_m"] = small.expected_error_whole;
  out["expected_error_m"] = small.expected_error;
  out["log_det_lost_nats"] = small.log_det_lost;
  out["poses_loss_nats"] = small.loss;
  out["divergence_nats"] = small.divergence;
  out["exchanges"] = small.exchanges;
  out["chi2_whole"] = small.chi2_whole;
  out["chi2"] = small.chi2;
  for (const auto& point : small.course)
    out["course"].push_back({{"links", point.links}, {"expected_error_m", point.expected_error}});
  out["seconds_optimum"] = small.seconds.optimum;
  out["seconds_links"] = small.seconds.links;
  out["seconds_poses"] = small.seconds.poses;
  return out;
}

template <class Pose>
void WriteSparsified(const PoseGraph<Pose>& graph, const Sparsified<Pose>& small, RotationInformation rotation,
                     const std::string& folder) {
  std::filesystem::remove(folder + "/stats.json");  // it must not stand for what is half written
  WriteG2o(small.graph, folder + "/compact.g2o", rotation);
  WriteCompactMap(small.map, Strategy::kBounded, folder + "/graph.json");
  std::vector<PoseId> ids;
  for (const auto& node : graph.Poses()) ids.push_back(node.id);
  WriteTum(MakeTrajectory(ids, small.T_world_body), folder + "/trajectory.tum");
  AtomicFile file(folder + "/links.csv");
  file.Stream() << "factor,from,to,kept,worth\n";
  for (const ConsideredLink& link : small.links) {
    file.Stream() << link.id.value << ',' << link.from.value << ',' << link.to.value << ',' << (link.kept ? 1 : 0)
                  << ',' << Shortest(link.worth) << '\n';
  }
  file.Commit();
}

const std::vector<std::string>& SparsifyFiles() {
  static const std::vector<std::string> files = {"compact.g2o", "graph.json",  "trajectory.tum",
                                                 "links.csv",   "report.html", "stats.json"};
  return files;
}

#define TERSE_INSTANTIATE(Pose)                                                                       \
  template nlohmann::ordered_json SparsifyStats(const PoseGraph<Pose>&, const Sparsified<Pose>&,      \
                                                const SparsifyOptions&);                              \
  template void WriteSparsified(const PoseGraph<Pose>&, const Sparsified<Pose>&, RotationInformation, \
                                const std::string&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
