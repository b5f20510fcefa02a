#include "terse/compact/merge.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>

#include "carry.h"
#include "merge/joint_ids.h"
#include "merge/optimal_map.h"
#include "pose_history.h"
#include "terse/compact/compact_pose_slam.h"
#include "terse/compact/innovation.h"
#include "terse/compact/link_consistency.h"
#include "terse/compact/thresholds.h"
#include "terse/core/at.h"
#include "terse/core/batch_solver.h"
#include "terse/core/chi_square.h"
#include "terse/core/disjoint_sets.h"
#include "terse/core/error.h"
#include "terse/core/frame_alignment.h"
#include "terse/core/gauge.h"
#include "terse/core/innovation_scale.h"
#include "terse/core/residual.h"
#include "terse/covariance/marginals.h"

namespace terse {
namespace {

using internal::Absolute;
using internal::At;
using std::size_t;

// Between the test of links and truncated least squares.
constexpr int kMostRounds = 10;
// A link that came in and was thrown out again so often stays out.
constexpr int kMostReturns = 2;
// Of the rotation of one link, against points that are metres apart.
constexpr double kRotationPreference = 1;

template <class Pose>
const Pose& ValueOf(const PoseGraph<Pose>& graph, PoseId id) {
  return *graph.Poses()[At(graph.IndexOf(id))].T_world_body;
}

template <class Pose>
bool IsAbsolute(const Factor<Pose>& factor) {
  return PosesOf(factor).count == 1;
}

template <class Pose>
class Merging {
 public:
  Merging(const std::vector<MapToMerge<Pose>>& maps, const std::vector<MapLink<Pose>>& links,
          const MergeOptions<Pose>& options)
      : given_(maps),
        links_(links),
        options_(options),
        stated_limit_(ChiSquareQuantile(options.link_quantile, Pose::kDof)) {}

  Merged<Pose> Run() {
    Prepare();
    CarryLinks();
    Compare();
    Place();
    Join();
    Decide();
    Describe();
    MakeMap();
    return std::move(out_);
  }

 private:
  struct Part : internal::OptimalMap<Pose> {  // with joint ids
    bool joined = false;
    Pose T_joint_map;
  };
  struct Link {
    RelativePoseFactor<Pose> measured;  // joint ids, kept poses
    bool in = false, holds = false;     // holds: the maps of a tree edge together, whatever the kernel says
    int returns = 0;
  };
  // Two maps that may be put together.
  struct Bond {
    int a = 0, b = 0;
    Placement by = Placement::kLinks;
    std::vector<int> members;  // links
    int strength = 0;
  };

  void Prepare();
  void CarryLinks();
  void Compare();
  void Place();
  Pose FrameOf(const Bond& bond) const;
  void ChooseGroup(const std::vector<int>& group_of);
  void Join();
  bool KeepsAbsolute(size_t k) const;
  PoseGraph<Pose> WithLinks() const;
  BatchResult<Pose> Solve(const PoseGraph<Pose>& graph, const BatchOptions& options);
  double InnovationOf(const Link& link, const Marginals<Pose>& marginals) const;
  bool LetIn(const PoseGraph<Pose>& graph, BatchResult<Pose> result);
  bool ThrowOut(bool graduate);
  void Decide();
  void Describe();
  void MakeMap();
  CompactMap<Pose> JointMap() const;

  const std::vector<MapToMerge<Pose>>& given_;
  const std::vector<MapLink<Pose>>& links_;
  const MergeOptions<Pose>& options_;
  const double stated_limit_;        // of squared innovations
  internal::InnovationScale scale_;  // of what links show
  double limit_ = stated_limit_;     // what that makes of it
  std::vector<Part> parts_;
  std::vector<Link> joint_links_;  // as links_
  std::vector<Bond> bonds_;
  std::vector<size_t> order_;  // of the joined maps: maps[0] last
  size_t reference_ = 0;
  bool has_datum_ = false;
  PoseGraph<Pose> base_;                                    // the joined maps without links
  std::vector<std::map<FactorId, FactorId>> joint_factor_;  // by map: ids in base_
  std::vector<Pose> values_;                                // of base_
  Merged<Pose> out_;
};

template <class Pose>
void Merging<Pose>::Prepare() {
  if (given_.size() < 2) throw std::invalid_argument("merging takes two maps or more");
  for (const double q : {options_.pair_quantile, options_.link_quantile}) {
    if (!(q > 0 && q < 1)) throw std::invalid_argument("the quantiles of links must be between 0 and 1");
  }
  if (options_.most_compared < 2) throw std::invalid_argument("two links are compared at least");
  if (!(options_.retire_share >= 0)) throw std::invalid_argument("retire_share must be 0 or more");
  if (options_.threads < 1) throw std::invalid_argument("threads must be 1 or more");
  std::vector<const CompactMap<Pose>*> maps;
  for (const auto& given : given_) {
    const std::string defect = FindDefect(given.map);
    if (!defect.empty()) throw std::invalid_argument("the map " + given.name + ": " + defect);
    if (given.map.poses.empty()) throw std::invalid_argument("the map " + given.name + " has no poses");
    maps.push_back(&given.map);
  }
  const std::vector<std::int64_t> offsets = internal::OffsetsOfIds(maps);
  parts_.resize(given_.size());
  for (size_t k = 0; k < given_.size(); ++k) {
    PlacedMap<Pose> placed;
    placed.name = given_[k].name;
    placed.id_offset = offsets[k];
    placed.poses = static_cast<int>(given_[k].map.poses.size());
    static_cast<internal::OptimalMap<Pose>&>(parts_[k]) = internal::ToOptimum(
        internal::WithOffset(given_[k].map, offsets[k]), placed.name, stated_limit_, options_.threads);
    placed.loops_out = parts_[k].loops_out;
    out_.maps.push_back(std::move(placed));
  }
}

template <class Pose>
void Merging<Pose>::CarryLinks() {
  std::vector<internal::PoseHistory<Pose>> histories(parts_.size());
  for (size_t k = 0; k < parts_.size(); ++k) histories[k].Restore(parts_[k].map.poses, 0);
  const int maps = static_cast<int>(parts_.size());
  for (size_t l = 0; l < links_.size(); ++l) {
    const MapLink<Pose>& link = links_[l];
    const std::string which = "link " + std::to_string(l) + ": ";
    for (const int map : {link.from_map, link.to_map}) {
      if (map < 0 || map >= maps) throw std::invalid_argument(which + "there is no map " + std::to_string(map));
    }
    if (link.from_map == link.to_map) throw std::invalid_argument(which + "it joins a map to itself");
    const size_t a = At(link.from_map), b = At(link.to_map);
    Link joint;
    joint.measured = link.measured;
    joint.measured.from.value += out_.maps[a].id_offset;
    joint.measured.to.value += out_.maps[b].id_offset;
    const auto expect = [&](size_t map, PoseId id, PoseId own) {
      if (!histories[map].Has(id)) {
        throw std::invalid_argument(which + "the map " + given_[map].name + " has no pose " +
                                    std::to_string(own.value));
      }
    };
    expect(a, joint.measured.from, link.measured.from);
    expect(b, joint.measured.to, link.measured.to);
    const std::string defect = FindDefect(Factor<Pose>(joint.measured));
    if (!defect.empty()) throw std::invalid_argument(which + defect);
    for (const auto& [map, end] : {std::pair(a, joint.measured.from), std::pair(b, joint.measured.to)}) {
      joint.measured = internal::CarryEndToKept(end, joint.measured, histories[map], CompositionOrder::kFirst);
    }
    MergedLink<Pose> merged;
    merged.link = link;
    merged.from = joint.measured.from;
    merged.to = joint.measured.to;
    out_.links.push_back(merged);
    joint_links_.push_back(joint);
  }
}

template <class Pose>
void Merging<Pose>::Compare() {
  std::map<std::pair<int, int>, std::vector<int>> between;
  for (size_t l = 0; l < links_.size(); ++l)
    between[std::minmax(links_[l].from_map, links_[l].to_map)].push_back(static_cast<int>(l));
  for (const auto& [pair, links] : between) {
    const auto [a, b] = pair;
    std::vector<internal::InterMapLink<Pose>> from_a;
    for (const int l : links) {
      const auto& measured = joint_links_[At(l)].measured;
      const PoseId in_a = links_[At(l)].from_map == a ? measured.from : measured.to;
      from_a.push_back({in_a, in_a == measured.from ? measured.to : measured.from, SeenFrom(in_a, measured)});
    }
    const internal::AgreeingLinks found = internal::FindAgreeing(
        from_a, internal::MapKnowledge<Pose>{parts_[At(a)].marginals.get(), &parts_[At(a)].graph},
        internal::MapKnowledge<Pose>{parts_[At(b)].marginals.get(), &parts_[At(b)].graph}, options_.pair_quantile,
        options_.most_compared);
    for (size_t k = 0; k < links.size(); ++k) out_.links[At(links[k])].agreeing = found.agreeing[k];
    for (const double d : found.typical) scale_.Add(d);
    const bool is_single = links.size() == 1;
    if (!is_single && (found.members.size() < 2 || found.rival >= static_cast<int>(found.members.size()))) continue;
    Bond bond;
    bond.a = a;
    bond.b = b;
    bond.by = is_single ? Placement::kUnconfirmed : Placement::kLinks;
    for (const int m : found.members) bond.members.push_back(links[At(m)]);
    bond.strength = static_cast<int>(bond.members.size());
    bonds_.push_back(std::move(bond));
  }
  // Maps in the world need no links, and those between them are judged by it.
  int first = -1;
  for (size_t k = 0; k < parts_.size(); ++k) {
    if (parts_[k].absolute != Absolute::kDatum) continue;
    Bond bond;
    bond.a = first;
    bond.b = static_cast<int>(k);
    bond.by = Placement::kDatum;
    bond.strength = std::numeric_limits<int>::max();
    if (first >= 0) bonds_.push_back(bond);
    if (first < 0) first = bond.b;
  }
}

// T_a_b of the frames of two maps.
template <class Pose>
Pose Merging<Pose>::FrameOf(const Bond& bond) const {
  if (bond.by == Placement::kDatum) return Pose();
  internal::WeightedPoints<Pose> points;
  std::optional<Pose> of_first;
  for (const int l : bond.members) {
    const auto& measured = joint_links_[At(l)].measured;
    const bool is_forward = links_[At(l)].from_map == bond.a;
    const Pose T_a_i = ValueOf(parts_[At(bond.a)].graph, is_forward ? measured.from : measured.to);
    const Pose T_b_j = ValueOf(parts_[At(bond.b)].graph, is_forward ? measured.to : measured.from);
    const Pose T_a_j = T_a_i * (is_forward ? measured.T_from_to : measured.T_from_to.Inverse());
    if (!of_first) of_first = T_a_j * T_b_j.Inverse();
    points.old_frame.push_back(T_b_j.Translation());
    points.new_frame.push_back(T_a_j.Translation());
    points.weights.push_back(1);
  }
  return internal::FitPoints(points, 0, points.weights.size(), *of_first, kRotationPreference);
}

// The largest group of maps that hold together; of those as large the one with maps[0], else with the earliest map.
template <class Pose>
void Merging<Pose>::ChooseGroup(const std::vector<int>& group_of) {
  std::map<int, int> sizes;
  for (const int g : group_of) ++sizes[g];
  int chosen = group_of[0];
  for (const int g : group_of) {
    if (sizes[g] > sizes[chosen]) chosen = g;
  }
  if (sizes[chosen] < 2) {
    throw NumericalError(links_.empty() ? "nothing holds the maps together: no links, and no two maps have absolute "
                                          "measurements that determine where they are"
                                        : "nothing holds the maps together: of the " + std::to_string(links_.size()) +
                                              " links between them no two agree on how two maps lie");
  }
  std::optional<size_t> datum, first;
  for (size_t k = 0; k < parts_.size(); ++k) {
    parts_[k].joined = group_of[k] == chosen;
    if (!parts_[k].joined) continue;
    if (!first) first = k;
    if (!datum && parts_[k].absolute == Absolute::kDatum) datum = k;
  }
  has_datum_ = datum.has_value();
  reference_ = datum.value_or(*first);
  for (size_t k = 1; k < parts_.size(); ++k) {
    if (parts_[k].joined) order_.push_back(k);
  }
  if (parts_[0].joined) order_.push_back(0);
}

// Along a spanning tree of the strongest bonds.
template <class Pose>
void Merging<Pose>::Place() {
  const auto rank = [](const Bond& bond) {
    return std::make_pair(bond.by == Placement::kUnconfirmed ? 1 : 0, -bond.strength);
  };
  std::stable_sort(bonds_.begin(), bonds_.end(), [&](const Bond& x, const Bond& y) { return rank(x) < rank(y); });
  internal::DisjointSets sets(parts_.size());
  std::vector<std::vector<const Bond*>> tree(parts_.size());
  for (const Bond& bond : bonds_) {
    if (!sets.Join(At(bond.a), At(bond.b))) continue;
    tree[At(bond.a)].push_back(&bond);
    tree[At(bond.b)].push_back(&bond);
  }
  std::vector<int> group_of;
  for (size_t k = 0; k < parts_.size(); ++k) group_of.push_back(static_cast<int>(sets.Root(k)));
  ChooseGroup(group_of);
  std::vector<size_t> reached = {reference_};
  std::vector<char> seen(parts_.size(), 0);
  seen[reference_] = 1;
  out_.maps[reference_].placement = has_datum_ ? Placement::kDatum : Placement::kReference;
  for (size_t next = 0; next < reached.size(); ++next) {
    for (const Bond* bond : tree[reached[next]]) {
      const bool is_forward = At(bond->a) == reached[next];
      const size_t other = At(is_forward ? bond->b : bond->a);
      if (std::exchange(seen[other], 1)) continue;
      const Pose T_a_b = FrameOf(*bond);
      parts_[other].T_joint_map = parts_[reached[next]].T_joint_map * (is_forward ? T_a_b : T_a_b.Inverse());
      out_.maps[other].placement = bond->by;
      reached.push_back(other);
      if (bond->members.empty()) continue;
      for (const int l : bond->members) joint_links_[At(l)].in = true;
      const int holds = *std::max_element(bond->members.begin(), bond->members.end(), [&](int x, int y) {
        return out_.links[At(x)].agreeing < out_.links[At(y)].agreeing;
      });
      joint_links_[At(holds)].holds = true;
    }
  }
}

// Of a map whose origin somebody chose the joint frame keeps that only if it is the reference.
template <class Pose>
bool Merging<Pose>::KeepsAbsolute(size_t k) const {
  return parts_[k].absolute != Absolute::kFrame || (k == reference_ && !has_datum_);
}

template <class Pose>
void Merging<Pose>::Join() {
  joint_factor_.resize(parts_.size());
  std::vector<std::pair<Factor<Pose>, Pose>> absolute;
  for (const size_t k : order_) {
    const Part& part = parts_[k];
    for (const auto& node : part.graph.Poses()) {
      values_.push_back(part.T_joint_map * *node.T_world_body);
      base_.AddPose(node.id, values_.back());
      if (node.fixed && KeepsAbsolute(k)) base_.SetFixed(node.id, true);
    }
    for (const auto& node : part.graph.Factors()) {
      if (IsAbsolute(node.factor) && !KeepsAbsolute(k)) continue;
      joint_factor_[k][node.id] = base_.AddFactor(node.factor);
      if (IsAbsolute(node.factor)) absolute.emplace_back(node.factor, ValueOf(base_, PosesOf(node.factor).first));
    }
  }
  if (absolute.empty()) return;
  const std::optional<Pose> T_world_joint = internal::AlignToAbsolute(absolute);
  if (!T_world_joint) return;
  for (size_t v = 0; v < values_.size(); ++v) {
    if (!base_.Poses()[v].fixed) values_[v] = *T_world_joint * values_[v];
  }
}

template <class Pose>
PoseGraph<Pose> Merging<Pose>::WithLinks() const {
  PoseGraph<Pose> graph = base_.WithPoses(values_);
  for (const Link& link : joint_links_) {
    if (link.in) graph.AddFactor(link.measured);
  }
  return graph;
}

template <class Pose>
BatchResult<Pose> Merging<Pose>::Solve(const PoseGraph<Pose>& graph, const BatchOptions& options) {
  BatchOptions with_threads = options;
  with_threads.threads = options_.threads;
  BatchResult<Pose> result = SolveBatch(graph, values_, with_threads);
  if (result.cholesky.Variables() == 0) throw NumericalError("the joint map has no optimum: " + result.message);
  values_ = result.T_world_body;
  return result;
}

template <class Pose>
double Merging<Pose>::InnovationOf(const Link& link, const Marginals<Pose>& marginals) const {
  const PoseId from = link.measured.from, to = link.measured.to;
  const auto value = [&](PoseId id) { return values_[At(base_.IndexOf(id))]; };
  const UncertainPose<Pose> predicted{value(from).Inverse() * value(to), marginals.Relative(from, to)};
  return InnovationDistance(predicted, SeenFrom(from, link.measured));
}

// Links that agree with the joint map come in. True if any did.
template <class Pose>
bool Merging<Pose>::LetIn(const PoseGraph<Pose>& graph, BatchResult<Pose> result) {
  const Marginals<Pose> marginals(graph, std::move(result));
  std::vector<size_t> outside;
  for (size_t l = 0; l < joint_links_.size(); ++l) {
    Link& link = joint_links_[l];
    if (link.in || !base_.HasPose(link.measured.from) || !base_.HasPose(link.measured.to)) continue;
    out_.links[l].innovation = InnovationOf(link, marginals);
    if (out_.links[l].innovation <= stated_limit_ && link.returns == 0) scale_.Add(out_.links[l].innovation);
    outside.push_back(l);
  }
  limit_ = scale_.Limit(stated_limit_, Pose::kDof);
  bool any = false;
  for (const size_t l : outside) {
    if (out_.links[l].innovation > limit_ || joint_links_[l].returns >= kMostReturns) continue;
    joint_links_[l].in = any = true;
  }
  return any;
}

// Truncated least squares over the links that are in. True if any went.
template <class Pose>
bool Merging<Pose>::ThrowOut(bool graduate) {
  const PoseGraph<Pose> graph = WithLinks();
  BatchOptions options;
  options.robust.kernel = RobustKernel::kGnc;
  options.robust.width = std::sqrt(limit_);
  options.graduate = graduate;
  options.robust_factors.emplace();
  std::vector<size_t> links;
  auto id = static_cast<std::int64_t>(base_.Factors().size());
  for (size_t l = 0; l < joint_links_.size(); ++l) {
    if (!joint_links_[l].in) continue;
    if (!joint_links_[l].holds) {
      options.robust_factors->push_back({id});
      links.push_back(l);
    }
    ++id;
  }
  if (links.empty()) return false;
  const BatchResult<Pose> result = Solve(graph, options);
  bool any = false;
  for (size_t k = 0; k < links.size(); ++k) {
    if (result.weights[At(static_cast<int>((*options.robust_factors)[k].value))] > 0) continue;
    joint_links_[links[k]].in = false;
    ++joint_links_[links[k]].returns;
    any = true;
  }
  return any;
}

template <class Pose>
void Merging<Pose>::Decide() {
  for (int round = 0; round < kMostRounds; ++round) {
    const PoseGraph<Pose> graph = WithLinks();
    BatchResult<Pose> result = Solve(graph, {});
    const bool came = LetIn(graph.WithPoses(values_), std::move(result));
    const bool went = ThrowOut(round == 0);
    if (!came && !went) break;
  }
  out_.graph = WithLinks();
  BatchResult<Pose> result = Solve(out_.graph, {});
  out_.chi2 = out_.chi2_before = result.chi2;
  if (CountAbsoluteFactors(out_.graph).Count() == 0) {  // the reference lies where it did
    const Part& part = parts_[reference_];
    const auto& first = part.graph.Poses().front();
    const Pose T = *first.T_world_body * values_[At(base_.IndexOf(first.id))].Inverse();
    for (Pose& value : values_) value = T * value;
  }
  out_.graph.SetPoses(values_);
}

template <class Pose>
void Merging<Pose>::Describe() {
  const Marginals<Pose> marginals(out_.graph, values_);
  const bool is_absolute = CountAbsoluteFactors(out_.graph).Count() > 0;
  const PoseId origin = parts_[reference_].graph.Poses().front().id;
  const auto value = [&](PoseId id) { return values_[At(base_.IndexOf(id))]; };
  for (size_t k = 0; k < parts_.size(); ++k) {
    PlacedMap<Pose>& placed = out_.maps[k];
    if (!parts_[k].joined) continue;
    const auto& first = parts_[k].graph.Poses().front();
    placed.T_joint_map = value(first.id) * first.T_world_body->Inverse();
    if (is_absolute) {
      placed.covariance = marginals.Marginal(first.id);
    } else if (k != reference_) {
      placed.covariance = marginals.Relative(origin, first.id);
    }
  }
  for (size_t l = 0; l < joint_links_.size(); ++l) {
    const Link& link = joint_links_[l];
    MergedLink<Pose>& out = out_.links[l];
    const PoseId from = link.measured.from, to = link.measured.to;
    if (!base_.HasPose(from) || !base_.HasPose(to)) continue;
    out.verdict = link.in ? MapLinkVerdict::kAccepted : MapLinkVerdict::kInconsistent;
    if (link.in) {
      out.innovation = FactorChi2(Factor<Pose>(link.measured), value(from), value(to));
    } else {
      out.innovation = InnovationOf(link, marginals);
    }
  }
}

// The maps one after the other, their measurements numbered as in the joint graph.
template <class Pose>
CompactMap<Pose> Merging<Pose>::JointMap() const {
  CompactMap<Pose> joint;
  std::int64_t lowest_part = -1;
  for (const size_t k : order_) {
    const CompactMap<Pose>& map = parts_[k].map;
    const Pose T = out_.maps[k].T_joint_map;
    for (auto pose : map.poses) {
      pose.T_world_body = pose.kept ? values_[At(base_.IndexOf(pose.id))] : T * pose.T_world_body;
      pose.T_world_body_when_seen = T * pose.T_world_body_when_seen;
      if (!pose.previous && !joint.poses.empty()) pose.previous = joint.poses.back().id;
      joint.poses.push_back(std::move(pose));
    }
    std::int64_t lowest = -1;
    for (auto edge : map.edges) {
      edge.factor = joint_factor_[k].at(edge.factor);
      for (auto& part : edge.parts) {
        if (part.id.value >= -1) continue;
        lowest = std::min(lowest, part.id.value);
        part.id.value += lowest_part + 1;
      }
      joint.edges.push_back(std::move(edge));
    }
    lowest_part += lowest + 1;
    for (const auto& prior : map.priors) {
      const auto id = joint_factor_[k].find(prior.factor);
      if (id != joint_factor_[k].end()) joint.priors.push_back({id->second, prior.measured});
    }
    if (KeepsAbsolute(k)) joint.fixed.insert(joint.fixed.end(), map.fixed.begin(), map.fixed.end());
    joint.refused.insert(joint.refused.end(), map.refused.begin(), map.refused.end());
    joint.failed.insert(joint.failed.end(), map.failed.begin(), map.failed.end());
  }
  auto id = static_cast<std::int64_t>(base_.Factors().size());
  for (size_t l = 0; l < joint_links_.size(); ++l) {
    const Link& link = joint_links_[l];
    if (!link.in) continue;
    typename CompactMap<Pose>::Edge edge;
    edge.factor = {id++};
    edge.measured = link.measured;
    edge.is_loop = true;
    const bool from_is_newer = base_.IndexOf(link.measured.from) > base_.IndexOf(link.measured.to);
    edge.added_at = from_is_newer ? link.measured.from : link.measured.to;
    joint.edges.push_back(std::move(edge));
  }
  std::sort(joint.edges.begin(), joint.edges.end(), [](const auto& a, const auto& b) { return a.factor < b.factor; });
  return joint;
}

// Compacted again, dropped poses recovered in the joint map.
template <class Pose>
void Merging<Pose>::MakeMap() {
  CompactOptions<Pose> options;
  options.retire_share = options_.retire_share;
  out_.poses_before = static_cast<int>(out_.graph.Poses().size());
  const bool is_connected = ConnectedComponents(out_.graph).size() == 1;
  const bool may_retire = options_.retire_share > 0 && (options_.thresholds || is_connected);
  if (options_.thresholds) {
    options.thresholds = *options_.thresholds;
  } else if (is_connected) {
    options.thresholds = SelectThresholds(out_.graph).thresholds;
  }
  out_.thresholds = options.thresholds;
  auto slam = CompactPoseSlam<Pose>::Restore(JointMap(), options);
  if (may_retire) out_.retired = slam.Retire(options_.retire_share * options.thresholds.min_loop_gain);
  const BatchResult<Pose> result = slam.Finish();
  out_.map = slam.Export();
  out_.graph = internal::GraphOfMap(out_.map).WithPoses(result.T_world_body);
  out_.chi2 = result.chi2;
  for (size_t k = 0; k < parts_.size(); ++k) {
    if (!parts_[k].joined) continue;
    for (const auto& pose : parts_[k].map.poses) out_.maps[k].kept += out_.graph.HasPose(pose.id) ? 1 : 0;
  }
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
  return Merging<Pose>(maps, links, options).Run();
}

#define TERSE_INSTANTIATE(Pose)                                                                        \
  template Merged<Pose> Merge(const std::vector<MapToMerge<Pose>>&, const std::vector<MapLink<Pose>>&, \
                              const MergeOptions<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
