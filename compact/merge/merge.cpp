#include "terse/compact/merge.h"

#include <algorithm>
#include <stdexcept>

#include "carry.h"
#include "map_graph.h"
#include "merge/joint_graph.h"
#include "merge/joint_ids.h"
#include "pose_history.h"
#include "terse/compact/compact_pose_slam.h"
#include "terse/compact/thresholds.h"
#include "terse/core/at.h"
#include "terse/core/chi_square.h"
#include "terse/core/gauge.h"
#include "terse/core/residual.h"

namespace terse {
namespace {

using internal::At;
using internal::CarriedLink;
using internal::JointGraph;
using internal::MapPlacement;
using internal::OptimalMap;
using std::size_t;

template <class Pose>
void Check(const std::vector<MapToMerge<Pose>>& maps, const MergeOptions<Pose>& options) {
  if (maps.size() < 2) throw std::invalid_argument("merging takes two maps or more");
  for (const double q : {options.pair_quantile, options.link_quantile}) {
    if (!(q > 0 && q < 1)) throw std::invalid_argument("the quantiles of links must be between 0 and 1");
  }
  if (options.most_compared < 2) throw std::invalid_argument("two links are compared at least");
  if (!(options.retire_share >= 0)) throw std::invalid_argument("retire_share must be 0 or more");
  if (options.threads < 1) throw std::invalid_argument("threads must be 1 or more");
  for (const auto& given : maps) {
    const std::string defect = FindDefect(given.map);
    if (!defect.empty()) throw std::invalid_argument("the map " + given.name + ": " + defect);
    if (given.map.poses.empty()) throw std::invalid_argument("the map " + given.name + " has no poses");
  }
}

template <class Pose>
class Merging {
 public:
  Merging(const std::vector<MapToMerge<Pose>>& maps, const std::vector<MapLink<Pose>>& links,
          const MergeOptions<Pose>& options)
      : given_(maps), links_(links), options_(options) {}

  Merged<Pose> Run() {
    const double limit = ChiSquareQuantile(options_.link_quantile, Pose::kDof);
    const std::vector<OptimalMap<Pose>> maps = OptimalMaps(limit);
    const std::vector<CarriedLink<Pose>> links = CarryLinks(maps);
    const MapPlacement<Pose> placement =
        internal::PlaceMaps(maps, links, options_.pair_quantile, options_.most_compared);
    JointGraph<Pose> joint(maps, links, placement, limit, options_.threads);
    BatchResult<Pose> result = joint.Decide();
    out_.graph = joint.Graph();
    out_.chi2_before = result.chi2;
    out_.poses_before = static_cast<int>(out_.graph.Poses().size());
    const Marginals<Pose> marginals(out_.graph, std::move(result));
    DescribeMaps(maps, placement, joint, marginals);
    DescribeLinks(links, placement, joint, marginals);
    MakeMap(WithForgotten(joint.Map(), placement));
    for (size_t k = 0; k < maps.size(); ++k) {
      for (const auto& pose : maps[k].map.poses) out_.maps[k].kept += out_.graph.HasPose(pose.id) ? 1 : 0;
    }
    return std::move(out_);
  }

 private:
  std::vector<OptimalMap<Pose>> OptimalMaps(double limit);
  std::vector<CarriedLink<Pose>> CarryLinks(const std::vector<OptimalMap<Pose>>& maps);
  void DescribeMaps(const std::vector<OptimalMap<Pose>>& maps, const MapPlacement<Pose>& placement,
                    const JointGraph<Pose>& joint, const Marginals<Pose>& marginals);
  void DescribeLinks(const std::vector<CarriedLink<Pose>>& links, const MapPlacement<Pose>& placement,
                     const JointGraph<Pose>& joint, const Marginals<Pose>& marginals);
  CompactMap<Pose> WithForgotten(CompactMap<Pose> joint, const MapPlacement<Pose>& placement) const;
  void MakeMap(const CompactMap<Pose>& joint);

  const std::vector<MapToMerge<Pose>>& given_;
  const std::vector<MapLink<Pose>>& links_;
  const MergeOptions<Pose>& options_;
  Merged<Pose> out_;
};

template <class Pose>
std::vector<OptimalMap<Pose>> Merging<Pose>::OptimalMaps(double limit) {
  std::vector<const CompactMap<Pose>*> given;
  std::vector<std::optional<std::int64_t>> given_offsets;
  for (const auto& map : given_) {
    given.push_back(&map.map);
    given_offsets.push_back(map.id_offset);
  }
  const std::vector<std::int64_t> offsets = internal::OffsetsOfIds(given, given_offsets);
  std::vector<OptimalMap<Pose>> maps;
  for (size_t k = 0; k < given_.size(); ++k) {
    PlacedMap<Pose> placed;
    placed.name = given_[k].name;
    placed.id_offset = offsets[k];
    placed.poses = static_cast<int>(given_[k].map.poses.size());
    maps.push_back(
        internal::ToOptimum(internal::WithOffset(given_[k].map, offsets[k]), placed.name, limit, options_.threads));
    placed.loops_out = maps.back().loops_out;
    out_.maps.push_back(std::move(placed));
  }
  return maps;
}

template <class Pose>
std::vector<CarriedLink<Pose>> Merging<Pose>::CarryLinks(const std::vector<OptimalMap<Pose>>& maps) {
  std::vector<internal::PoseHistory<Pose>> histories(maps.size());
  for (size_t k = 0; k < maps.size(); ++k) histories[k].Restore(maps[k].map.poses, 0);
  std::vector<CarriedLink<Pose>> carried;
  for (const MapLink<Pose>& link : links_) {
    const std::string which = "link " + std::to_string(carried.size()) + ": ";
    for (const int map : {link.from_map, link.to_map}) {
      if (map < 0 || map >= static_cast<int>(maps.size()))
        throw std::invalid_argument(which + "there is no map " + std::to_string(map));
    }
    if (link.from_map == link.to_map) throw std::invalid_argument(which + "it joins a map to itself");
    CarriedLink<Pose> joint{link.from_map, link.to_map, link.measured};
    joint.measured.from.value += out_.maps[At(link.from_map)].id_offset;
    joint.measured.to.value += out_.maps[At(link.to_map)].id_offset;
    const std::pair<int, PoseId> ends[] = {{link.from_map, joint.measured.from}, {link.to_map, joint.measured.to}};
    for (const auto& [map, id] : ends) {
      if (histories[At(map)].Has(id)) continue;
      throw std::invalid_argument(which + "the map " + given_[At(map)].name + " has no pose " +
                                  std::to_string(id.value - out_.maps[At(map)].id_offset));
    }
    const std::string defect = FindDefect(Factor<Pose>(joint.measured));
    if (!defect.empty()) throw std::invalid_argument(which + defect);
    for (const auto& [map, id] : ends)
      joint.measured = internal::CarryEndToKept(id, joint.measured, histories[At(map)], CompositionOrder::kFirst);
    carried.push_back(joint);
  }
  return carried;
}

template <class Pose>
void Merging<Pose>::DescribeMaps(const std::vector<OptimalMap<Pose>>& maps, const MapPlacement<Pose>& placement,
                                 const JointGraph<Pose>& joint, const Marginals<Pose>& marginals) {
  const bool is_absolute = CountAbsoluteFactors(out_.graph).Count() > 0;
  const PoseId origin = maps[placement.reference].graph.Poses().front().id;
  for (size_t k = 0; k < maps.size(); ++k) {
    PlacedMap<Pose>& placed = out_.maps[k];
    placed.placement = placement.by[k];
    if (!placement.IsJoined(k)) continue;
    const auto& first = maps[k].graph.Poses().front();
    placed.T_joint_map = joint.ValueOf(first.id) * first.T_world_body->Inverse();
    if (is_absolute) {
      placed.covariance = marginals.Marginal(first.id);
    } else if (k != placement.reference) {
      placed.covariance = marginals.Relative(origin, first.id);
    }
  }
}

template <class Pose>
void Merging<Pose>::DescribeLinks(const std::vector<CarriedLink<Pose>>& links, const MapPlacement<Pose>& placement,
                                  const JointGraph<Pose>& joint, const Marginals<Pose>& marginals) {
  for (size_t l = 0; l < links.size(); ++l) {
    const RelativePoseFactor<Pose>& measured = links[l].measured;
    MergedLink<Pose> out;
    out.link = links_[l];
    out.from = measured.from;
    out.to = measured.to;
    out.agreeing = placement.agreeing[l];
    if (joint.IsIn(l)) {
      out.verdict = MapLinkVerdict::kAccepted;
      out.innovation = FactorChi2(Factor<Pose>(measured), joint.ValueOf(measured.from), joint.ValueOf(measured.to));
    } else if (joint.AreJoined(l)) {
      out.verdict = MapLinkVerdict::kInconsistent;
      out.innovation = joint.InnovationOf(l, marginals);
    }
    out_.links.push_back(out);
  }
}

// Poses that maps have forgotten are known to be so where ids ascend (CompactMap::forgotten).
template <class Pose>
CompactMap<Pose> Merging<Pose>::WithForgotten(CompactMap<Pose> joint, const MapPlacement<Pose>& placement) const {
  const auto descends = [](const auto& a, const auto& b) { return !(a.id < b.id); };
  if (std::adjacent_find(joint.poses.begin(), joint.poses.end(), descends) != joint.poses.end()) return joint;
  for (size_t k = 0; k < given_.size(); ++k) joint.forgotten += placement.IsJoined(k) ? given_[k].map.forgotten : 0;
  return joint;
}

// Compacted again, dropped poses recovered in the joint map.
template <class Pose>
void Merging<Pose>::MakeMap(const CompactMap<Pose>& joint) {
  CompactOptions<Pose> options;
  options.retire_share = options_.retire_share;
  const bool is_connected = ConnectedComponents(out_.graph).size() == 1;
  if (options_.thresholds) {
    options.thresholds = *options_.thresholds;
  } else if (is_connected) {
    options.thresholds = SelectThresholds(out_.graph).thresholds;
  }
  out_.thresholds = options.thresholds;
  auto slam = CompactPoseSlam<Pose>::Restore(joint, options);
  if (options_.retire_share > 0 && (options_.thresholds || is_connected))
    out_.retired = slam.Retire(options_.retire_share * options.thresholds.min_loop_gain);
  const BatchResult<Pose> result = slam.Finish();
  out_.map = slam.Export();
  out_.graph = internal::GraphOfMap(out_.map).WithPoses(result.T_world_body);
  out_.chi2 = result.chi2;
}

}  // namespace

const char* Name(MapLinkVerdict verdict) {
  switch (verdict) {
    case MapLinkVerdict::kAccepted: return "accepted";
    case MapLinkVerdict::kInconsistent: return "inconsistent";
    case MapLinkVerdict::kMapsApart: return "maps_apart";
  }
  return "unknown";
}

const char* Name(Placement placement) {
  switch (placement) {
    case Placement::kReference: return "reference";
    case Placement::kLinks: return "links";
    case Placement::kUnconfirmed: return "unconfirmed";
    case Placement::kDatum: return "datum";
    case Placement::kApart: return "apart";
  }
  return "unknown";
}

template <class Pose>
Merged<Pose> Merge(const std::vector<MapToMerge<Pose>>& maps, const std::vector<MapLink<Pose>>& links,
                   const MergeOptions<Pose>& options) {
  Check(maps, options);
  return Merging<Pose>(maps, links, options).Run();
}

#define TERSE_INSTANTIATE(Pose)                                                                        \
  template Merged<Pose> Merge(const std::vector<MapToMerge<Pose>>&, const std::vector<MapLink<Pose>>&, \
                              const MergeOptions<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
