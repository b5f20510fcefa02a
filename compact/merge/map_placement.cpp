#include "merge/map_placement.h"

#include <algorithm>
#include <limits>
#include <map>
#include <optional>
#include <utility>

#include "terse/compact/link_consistency.h"
#include "terse/core/at.h"
#include "terse/core/disjoint_sets.h"
#include "terse/core/error.h"
#include "terse/core/frame_alignment.h"

namespace terse::internal {
namespace {

using std::size_t;

// Of the rotation of one link, against points that are metres apart.
constexpr double kRotationPreference = 1;

// Two maps that may be put together.
struct Bond {
  int a = 0, b = 0;
  Placement by = Placement::kLinks;
  std::vector<int> members;  // links
  int strength = 0;
  double limit_share = 1;
};

template <class Pose>
const Pose& ValueOf(const PoseGraph<Pose>& graph, PoseId id) {
  return *graph.Poses()[At(graph.IndexOf(id))].T_world_body;
}

template <class Pose>
class Placing {
 public:
  Placing(const std::vector<OptimalMap<Pose>>& maps, const std::vector<CarriedLink<Pose>>& links)
      : maps_(maps), links_(links) {
    out_.by.assign(maps.size(), Placement::kApart);
    out_.T_joint_map.resize(maps.size());
    out_.agreeing.assign(links.size(), -1);
  }

  MapPlacement<Pose> Run(double pair_quantile, int most_compared) {
    std::vector<Bond> bonds = BondsOfLinks(pair_quantile, most_compared);
    AddBondsOfDatum(bonds);
    Place(std::move(bonds));
    if (out_.members.empty()) out_.limit_share = 1;
    return std::move(out_);
  }

 private:
  std::vector<Bond> BondsOfLinks(double pair_quantile, int most_compared);
  void AddBondsOfDatum(std::vector<Bond>& bonds) const;
  void Place(std::vector<Bond> bonds);
  void ChooseReference(const std::vector<size_t>& group_of);
  Pose FrameOf(const Bond& bond) const;
  void Hold(const Bond& bond);

  const std::vector<OptimalMap<Pose>>& maps_;
  const std::vector<CarriedLink<Pose>>& links_;
  MapPlacement<Pose> out_;
};

template <class Pose>
std::vector<Bond> Placing<Pose>::BondsOfLinks(double pair_quantile, int most_compared) {
  std::map<std::pair<int, int>, std::vector<int>> between;
  for (size_t l = 0; l < links_.size(); ++l)
    between[std::minmax(links_[l].from_map, links_[l].to_map)].push_back(static_cast<int>(l));
  const auto knowledge = [&](int map) {
    return MapKnowledge<Pose>{maps_[At(map)].marginals.get(), &maps_[At(map)].graph};
  };
  std::vector<Bond> bonds;
  for (const auto& [pair, links] : between) {
    std::vector<InterMapLink<Pose>> from_a;
    for (const int l : links) {
      const auto& measured = links_[At(l)].measured;
      const PoseId in_a = links_[At(l)].from_map == pair.first ? measured.from : measured.to;
      from_a.push_back({in_a, in_a == measured.from ? measured.to : measured.from, SeenFrom(in_a, measured)});
    }
    const AgreeingLinks found =
        FindAgreeing(from_a, knowledge(pair.first), knowledge(pair.second), pair_quantile, most_compared);
    for (size_t k = 0; k < links.size(); ++k) out_.agreeing[At(links[k])] = found.agreeing[k];
    const bool is_single = links.size() == 1;
    const int strength = static_cast<int>(found.members.size());
    if (!is_single && (strength < 2 || found.rival >= strength)) continue;
    Bond bond{pair.first, pair.second, is_single ? Placement::kUnconfirmed : Placement::kLinks,
              {},         strength,    found.limit_share};
    for (const int m : found.members) bond.members.push_back(links[At(m)]);
    bonds.push_back(std::move(bond));
  }
  return bonds;
}

// Maps in the world need no links, and those between them are judged by it.
template <class Pose>
void Placing<Pose>::AddBondsOfDatum(std::vector<Bond>& bonds) const {
  int first = -1;
  for (int k = 0; k < static_cast<int>(maps_.size()); ++k) {
    if (maps_[At(k)].absolute != Absolute::kDatum) continue;
    if (first >= 0) bonds.push_back({first, k, Placement::kDatum, {}, std::numeric_limits<int>::max(), 1});
    if (first < 0) first = k;
  }
}

// T_a_b of the frames of two maps.
template <class Pose>
Pose Placing<Pose>::FrameOf(const Bond& bond) const {
  if (bond.by == Placement::kDatum) return Pose();
  WeightedPoints<Pose> points;
  std::optional<Pose> of_first;
  for (const int l : bond.members) {
    const auto& measured = links_[At(l)].measured;
    const bool is_forward = links_[At(l)].from_map == bond.a;
    const Pose T_a_i = ValueOf(maps_[At(bond.a)].graph, is_forward ? measured.from : measured.to);
    const Pose T_b_j = ValueOf(maps_[At(bond.b)].graph, is_forward ? measured.to : measured.from);
    const Pose T_a_j = T_a_i * (is_forward ? measured.T_from_to : measured.T_from_to.Inverse());
    if (!of_first) of_first = T_a_j * T_b_j.Inverse();
    points.old_frame.push_back(T_b_j.Translation());
    points.new_frame.push_back(T_a_j.Translation());
    points.weights.push_back(1);
  }
  return FitPoints(points, 0, points.weights.size(), *of_first, kRotationPreference);
}

template <class Pose>
void Placing<Pose>::ChooseReference(const std::vector<size_t>& group_of) {
  std::map<size_t, int> sizes;
  for (const size_t g : group_of) ++sizes[g];
  size_t chosen = group_of[0];
  for (const size_t g : group_of) {
    if (sizes[g] > sizes[chosen]) chosen = g;
  }
  if (sizes[chosen] < 2) {
    throw NumericalError(links_.empty() ? "nothing holds the maps together: no links, and no two maps have absolute "
                                          "measurements that determine where they are"
                                        : "nothing holds the maps together: of the " + std::to_string(links_.size()) +
                                              " links between them no two agree on how two maps lie, or as many "
                                              "others contradict them");
  }
  std::optional<size_t> datum, first;
  for (size_t k = 0; k < maps_.size(); ++k) {
    if (group_of[k] != chosen) continue;
    if (!first) first = k;
    if (!datum && maps_[k].absolute == Absolute::kDatum) datum = k;
  }
  out_.has_datum = datum.has_value();
  out_.reference = datum.value_or(*first);
  out_.by[out_.reference] = out_.has_datum ? Placement::kDatum : Placement::kReference;
}

template <class Pose>
void Placing<Pose>::Hold(const Bond& bond) {
  if (bond.members.empty()) return;
  out_.limit_share = std::max(out_.limit_share, bond.limit_share);
  out_.members.insert(out_.members.end(), bond.members.begin(), bond.members.end());
  const int holds = *std::max_element(bond.members.begin(), bond.members.end(),
                                      [&](int x, int y) { return out_.agreeing[At(x)] < out_.agreeing[At(y)]; });
  out_.holding.push_back(At(holds));
}

template <class Pose>
void Placing<Pose>::Place(std::vector<Bond> bonds) {
  const auto rank = [](const Bond& bond) {
    return std::make_pair(bond.by == Placement::kUnconfirmed ? 1 : 0, -bond.strength);
  };
  std::stable_sort(bonds.begin(), bonds.end(), [&](const Bond& x, const Bond& y) { return rank(x) < rank(y); });
  DisjointSets sets(maps_.size());
  std::vector<std::vector<const Bond*>> tree(maps_.size());
  for (const Bond& bond : bonds) {
    if (!sets.Join(At(bond.a), At(bond.b))) continue;
    tree[At(bond.a)].push_back(&bond);
    tree[At(bond.b)].push_back(&bond);
  }
  std::vector<size_t> group_of;
  for (size_t k = 0; k < maps_.size(); ++k) group_of.push_back(sets.Root(k));
  ChooseReference(group_of);
  std::vector<size_t> reached = {out_.reference};
  for (size_t next = 0; next < reached.size(); ++next) {
    for (const Bond* bond : tree[reached[next]]) {
      const bool is_forward = At(bond->a) == reached[next];
      const size_t other = At(is_forward ? bond->b : bond->a);
      if (out_.IsJoined(other)) continue;
      const Pose T_a_b = FrameOf(*bond);
      out_.T_joint_map[other] = out_.T_joint_map[reached[next]] * (is_forward ? T_a_b : T_a_b.Inverse());
      out_.by[other] = bond->by;
      Hold(*bond);
      reached.push_back(other);
    }
  }
}

}  // namespace

template <class Pose>
MapPlacement<Pose> PlaceMaps(const std::vector<OptimalMap<Pose>>& maps, const std::vector<CarriedLink<Pose>>& links,
                             double pair_quantile, int most_compared) {
  return Placing<Pose>(maps, links).Run(pair_quantile, most_compared);
}

template MapPlacement<SE2> PlaceMaps(const std::vector<OptimalMap<SE2>>&, const std::vector<CarriedLink<SE2>>&, double,
                                     int);
template MapPlacement<SE3> PlaceMaps(const std::vector<OptimalMap<SE3>>&, const std::vector<CarriedLink<SE3>>&, double,
                                     int);

}  // namespace terse::internal
