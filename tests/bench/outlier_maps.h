#pragma once
// What wrong loops do to the map.

#include <string>
#include <vector>

#include "tables/outlier_scene.h"
#include "terse/compact/thresholds.h"

namespace terse::bench {

struct MapResult {
  std::string failure;   // empty if there is a map
  double ate = 0;        // metres
  int wrong = 0;         // links kept
  int by_consensus = 0;  // of these, refused by the innovation test but for others that agree
  int links = -1;        // true ones among the loops
  int poses = -1;        // where not all are kept
};

template <class Pose>
class MapRuns {
 public:
  MapRuns(const OutlierScene<Pose>& scene, int threads) : scene_(scene), threads_(threads) {}

  MapResult Batch(const Contaminated<Pose>& with, RobustKernel kernel) const;
  // After the last step, and after Finish.
  std::pair<MapResult, MapResult> Incremental(const Contaminated<Pose>& with) const;
  MapResult Compact(const Contaminated<Pose>& with, const Thresholds<Pose>& thresholds, bool test, int consensus,
                    bool gnc) const;

 private:
  RobustOptions Robust(RobustKernel kernel) const { return {kernel, scene_.width}; }
  double Ate(const std::vector<RecoveredPose<Pose>>& poses) const {
    return ComputeAte(scene_.graph, scene_.reference, poses);
  }
  static void Take(const LoopCounts& loops, MapResult& out) {
    out.links = loops.true_kept;
    out.wrong = loops.wrong_kept;
  }
  MapResult Present(const IncrementalSolver<Pose>& solver, const Contaminated<Pose>& with) const;

  const OutlierScene<Pose>& scene_;
  int threads_;
};

struct MethodRow {
  std::string name;
  std::vector<MapResult> results;  // clean first
};

std::string MapHeader(const std::vector<double>& percents);
std::string MapRow(const std::string& graph, const MethodRow& row);

}  // namespace terse::bench
