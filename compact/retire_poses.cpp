#include "terse/compact/retire_poses.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>

#include "map_graph.h"
#include "retired_chains.h"
#include "terse/compact/information.h"
#include "terse/compact/pose_removal.h"
#include "terse/core/at.h"
#include "terse/core/pose_values.h"
#include "terse/covariance/marginals.h"

namespace terse {
namespace {

using internal::At;
using internal::ValuesOf;
using std::size_t;

template <class Pose>
PoseGraph<Pose> GraphOf(const CompactMap<Pose>& map, const std::vector<FactorId>& left_out) {
  PoseGraph<Pose> graph = internal::KeptPoses(map);
  for (const auto& edge : map.edges) {
    if (!std::binary_search(left_out.begin(), left_out.end(), edge.factor)) graph.AddFactor(edge.measured);
  }
  for (const auto& prior : map.priors) graph.AddFactor(prior.measured);
  return graph;
}

// Of those that retired in favour of a pose the farthest from it stand for all: they are the first not to be known
// well.
constexpr std::size_t kMostGround = 8;

template <class Pose>
class Retirement {
 public:
  Retirement(const CompactMap<Pose>& map, const CompactOptions<Pose>& options, const RetireOptions& retire)
      : options_(options),
        retire_(retire),
        map_(map),
        graph_(GraphOf(map, retire.left_out)),
        marginals_(graph_, ValuesOf(graph_)),
        chains_(map_.poses, options.composition) {
    next_factor_ = retire.first_factor.value;
    next_part_ = retire.first_part.value;
    for (const auto& edge : map.edges) AddEdge(edge);
    for (const auto& prior : map.priors) {
      next_factor_ = std::max(next_factor_, prior.factor.value + 1);
      stays_.insert(PosesOf(prior.measured).first);
    }
    for (const auto& fixed : map.fixed) stays_.insert(fixed.pose);
    for (const FactorId factor : retire.left_out) {
      stays_.insert(edges_.at(factor).measured.from);
      stays_.insert(edges_.at(factor).measured.to);
    }
    stays_.insert(map.poses.front().id);
    stays_.insert(map.poses.back().base);
  }

  Retired<Pose> Run() {
    for (const auto& node : graph_.Poses()) LookAt(node.id);
    for (int kept = static_cast<int>(graph_.Poses().size()); kept > retire_.least_kept && !order_.empty(); --kept) {
      const PoseId pose = order_.begin()->second;
      const Plan plan = plans_.at(pose);
      Retire(plan);
      for (const PoseId neighbour : plan.neighbours) LookAt(neighbour);
    }
    map_.edges.clear();
    for (auto& [factor, edge] : edges_) map_.edges.push_back(std::move(edge));
    return {std::move(map_), std::move(retired_)};
  }

 private:
  using Edge = typename CompactMap<Pose>::Edge;
  using Part = typename CompactMap<Pose>::Part;
  using Jacobian = typename Pose::Jacobian;

  struct Plan {
    PoseId pose, before;          // the odometry comes from
    PoseId heir;                  // of its ground
    std::optional<PoseId> after;  // it leads on to
    FactorId odometry, odometry_after;
    std::vector<PoseId> neighbours;
    internal::Tree<Pose> tree;
    bool is_odometry_alone = false;
  };

  static PoseId OtherEnd(PoseId pose, const Edge& edge) {
    return edge.measured.from == pose ? edge.measured.to : edge.measured.from;
  }
  const Pose& Estimate(PoseId id) const { return *graph_.Poses()[At(graph_.IndexOf(id))].T_world_body; }

  void AddEdge(Edge edge) {
    next_factor_ = std::max(next_factor_, edge.factor.value + 1);
    for (const Part& part : edge.parts) {
      next_factor_ = std::max(next_factor_, part.id.value + 1);
      next_part_ = std::min(next_part_, part.id.value - 1);
    }
    for (const PoseId end : {edge.measured.from, edge.measured.to}) factors_at_[end].insert(edge.factor);
    edges_.emplace(edge.factor, std::move(edge));
  }
  Edge TakeEdge(FactorId factor) {
    Edge edge = std::move(edges_.at(factor));
    edges_.erase(factor);
    for (const PoseId end : {edge.measured.from, edge.measured.to}) factors_at_[end].erase(factor);
    return edge;
  }

  void Forget(PoseId pose) {
    const auto it = plans_.find(pose);
    if (it == plans_.end()) return;
    order_.erase({it->second.tree.loss, pose});
    plans_.erase(it);
  }
  void LookAt(PoseId pose) {
    Forget(pose);
    if (auto plan = MakePlan(pose)) {
      order_.emplace(plan->tree.loss, pose);
      plans_.emplace(pose, std::move(*plan));
    }
  }

  bool HasFewNeighbours(PoseId pose) const;
  std::optional<Plan> MakePlan(PoseId pose) const;
  bool FindOdometry(Plan& plan) const;
  bool KnowsWell(PoseId kept, PoseId pose) const;
  std::optional<PoseId> FindHeir(const Plan& plan) const;
  void LeaveGround(PoseId pose, PoseId heir);
  UncertainPose<Pose> OdometryTo(PoseId kept, FactorId factor) const;
  UncertainPose<Pose> Between(PoseId a, PoseId b) const;
  void Retire(const Plan& plan);
  Edge MakeEdge(const Plan& plan, const internal::TreeFactor<Pose>& factor, const std::map<PoseId, long>& measurements);
  void FuseWithOther(Edge& edge, PoseId through);
  void MoveRefused(const Plan& plan, const UncertainPose<Pose>& T_before_pose);

  const CompactOptions<Pose>& options_;
  const RetireOptions& retire_;
  CompactMap<Pose> map_;
  const PoseGraph<Pose> graph_;
  const Marginals<Pose> marginals_;  // of the map as it came
  internal::RetiredChains<Pose> chains_;
  std::map<FactorId, Edge> edges_;
  std::map<PoseId, std::set<FactorId>> factors_at_;
  std::map<PoseId, std::vector<PoseId>> ground_of_;  // the farthest of those that retired in favour of this one
  std::set<PoseId> stays_;
  std::map<PoseId, Plan> plans_;
  std::set<std::pair<double, PoseId>> order_;
  std::int64_t next_factor_ = 0, next_part_ = -2;
  std::vector<RetiredPose> retired_;
};

// Of its odometry there is one edge to the kept pose that its chain starts from, and at most one that leads on.
template <class Pose>
bool Retirement<Pose>::FindOdometry(Plan& plan) const {
  const auto before = chains_.KeptBefore(plan.pose);
  if (!before) return false;
  plan.before = *before;
  plan.is_odometry_alone = true;
  bool is_found = false;
  for (const FactorId factor : factors_at_.at(plan.pose)) {
    const Edge& edge = edges_.at(factor);
    const PoseId other = OtherEnd(plan.pose, edge);
    plan.is_odometry_alone = plan.is_odometry_alone && !edge.is_loop && edge.parts.size() < 2;
    if (edge.is_loop) continue;
    if (chains_.IsOlder(other, plan.pose)) {
      if (is_found || other != plan.before) return false;
      is_found = true;
      plan.odometry = factor;
    } else {
      if (plan.after || chains_.KeptBefore(other) != plan.pose) return false;
      plan.after = other;
      plan.odometry_after = factor;
    }
  }
  return is_found;
}

// The test of FPFL (pose_step.h).
template <class Pose>
bool Retirement<Pose>::KnowsWell(PoseId kept, PoseId pose) const {
  const Thresholds<Pose>& thresholds = options_.thresholds;
  const UncertainPose<Pose> known = Between(kept, pose);
  const auto displacement = ComputeDisplacement<Pose>(known, options_.distance);
  return RangeProbabilities<Pose>(displacement, thresholds.range).minCoeff() > thresholds.probability &&
         InformationGain<Pose::kDof>(known.covariance, thresholds.link_covariance) <= thresholds.min_pose_gain;
}

// Of the neighbours one that the pose leaves its ground to: one that knows it well, and those too that retired in its
// favour.
template <class Pose>
std::optional<PoseId> Retirement<Pose>::FindHeir(const Plan& plan) const {
  const auto ground = ground_of_.find(plan.pose);
  const auto knows_all = [&](PoseId neighbour) {
    if (!KnowsWell(neighbour, plan.pose)) return false;
    return ground == ground_of_.end() || std::all_of(ground->second.begin(), ground->second.end(),
                                                     [&](PoseId retired) { return KnowsWell(neighbour, retired); });
  };
  const auto heir = std::find_if(plan.neighbours.begin(), plan.neighbours.end(), knows_all);
  return heir != plan.neighbours.end() ? std::optional<PoseId>(*heir) : std::nullopt;
}

template <class Pose>
void Retirement<Pose>::LeaveGround(PoseId pose, PoseId heir) {
  std::vector<PoseId>& ground = ground_of_[heir];
  ground.push_back(pose);
  const auto own = ground_of_.find(pose);
  if (own != ground_of_.end()) {
    ground.insert(ground.end(), own->second.begin(), own->second.end());
    ground_of_.erase(own);
  }
  if (ground.size() <= kMostGround) return;
  const auto distance = [&](PoseId id) { return (Estimate(id).Translation() - Estimate(heir).Translation()).norm(); };
  std::sort(ground.begin(), ground.end(),
            [&](PoseId a, PoseId b) { return std::pair(-distance(a), a) < std::pair(-distance(b), b); });
  ground.resize(kMostGround);
}

// Asked of every neighbour of a pose that retires, so not at the price of a hub's degree.
template <class Pose>
bool Retirement<Pose>::HasFewNeighbours(PoseId pose) const {
  std::set<PoseId> neighbours;
  for (const FactorId factor : factors_at_.at(pose)) {
    neighbours.insert(OtherEnd(pose, edges_.at(factor)));
    if (static_cast<int>(neighbours.size()) > retire_.most_neighbours) return false;
  }
  return true;
}

// Absent if the pose may not retire.
template <class Pose>
std::optional<typename Retirement<Pose>::Plan> Retirement<Pose>::MakePlan(PoseId pose) const {
  Plan plan;
  plan.pose = pose;
  if (stays_.count(pose) != 0 || factors_at_.count(pose) == 0 || !HasFewNeighbours(pose)) return std::nullopt;
  if (!FindOdometry(plan)) return std::nullopt;
  if (retire_.only_odometry && !plan.is_odometry_alone) return std::nullopt;
  std::vector<internal::Arm<Pose>> arms;
  const Pose T_pose_world = Estimate(pose).Inverse();
  for (const FactorId factor : factors_at_.at(pose)) {
    const Edge& edge = edges_.at(factor);
    const PoseId other = OtherEnd(pose, edge);
    auto at = std::find(plan.neighbours.begin(), plan.neighbours.end(), other) - plan.neighbours.begin();
    if (At(static_cast<int>(at)) == plan.neighbours.size()) {
      plan.neighbours.push_back(other);
      arms.emplace_back(T_pose_world * Estimate(other));
    }
    arms[At(static_cast<int>(at))].Add(pose, edge.measured);
  }
  const std::optional<PoseId> heir = FindHeir(plan);
  if (!heir) return std::nullopt;
  plan.heir = *heir;
  std::optional<std::pair<int, int>> must;
  if (plan.after) {
    const auto place = [&](PoseId id) {
      return static_cast<int>(std::find(plan.neighbours.begin(), plan.neighbours.end(), id) - plan.neighbours.begin());
    };
    must = {place(plan.before), place(*plan.after)};
  }
  auto tree = internal::RecoverTree(arms, must);
  if (!tree || !(tree->loss <= retire_.most_loss)) return std::nullopt;
  plan.tree = std::move(*tree);
  return plan;
}

// From the kept pose before it. What fused with the odometry is no part of the chain.
template <class Pose>
UncertainPose<Pose> Retirement<Pose>::OdometryTo(PoseId kept, FactorId factor) const {
  if (const auto chain = chains_.ChainTo(kept)) return *chain;
  const Edge& edge = edges_.at(factor);
  const PoseId before = OtherEnd(kept, edge);
  if (edge.parts.empty()) return SeenFrom(before, edge.measured);
  const UncertainPose<Pose>& part = edge.parts.front().T_from_to;
  return before < kept ? part : Invert(part);
}

template <class Pose>
UncertainPose<Pose> Retirement<Pose>::Between(PoseId a, PoseId b) const {
  return {Estimate(a).Inverse() * Estimate(b), marginals_.Relative(a, b)};
}

template <class Pose>
void Retirement<Pose>::Retire(const Plan& plan) {
  const bool alone = plan.is_odometry_alone;
  const UncertainPose<Pose> T_before_pose =
      alone ? OdometryTo(plan.pose, plan.odometry) : Between(plan.before, plan.pose);
  std::optional<typename internal::RetiredChains<Pose>::Next> next;
  if (plan.after) {
    next = {*plan.after, alone ? OdometryTo(*plan.after, plan.odometry_after) : Between(plan.pose, *plan.after)};
  }
  RetiredPose retired{plan.pose, plan.tree.loss, static_cast<int>(plan.neighbours.size()), 0,
                      static_cast<int>(plan.tree.factors.size())};
  std::map<PoseId, long> measurements;  // that joined the pose to its neighbours
  const std::set<FactorId> factors = factors_at_.at(plan.pose);
  for (const FactorId factor : factors) {
    const Edge edge = TakeEdge(factor);
    long& count = measurements[OtherEnd(plan.pose, edge)];
    for (const Part& part : edge.parts) count += part.measurements;
    if (edge.parts.empty()) ++count;
    ++retired.factors_removed;
  }
  factors_at_.erase(plan.pose);
  LeaveGround(plan.pose, plan.heir);
  for (const auto& factor : plan.tree.factors) {
    Edge edge = MakeEdge(plan, factor, measurements);
    FuseWithOther(edge, plan.pose);
    AddEdge(std::move(edge));
  }
  chains_.Drop(plan.pose, plan.before, T_before_pose, next, !alone);
  MoveRefused(plan, T_before_pose);
  Forget(plan.pose);
  retired_.push_back(retired);
}

template <class Pose>
typename Retirement<Pose>::Edge Retirement<Pose>::MakeEdge(const Plan& plan, const internal::TreeFactor<Pose>& factor,
                                                           const std::map<PoseId, long>& measurements) {
  const PoseId i = plan.neighbours[At(factor.i)], j = plan.neighbours[At(factor.j)];
  Edge edge;
  edge.factor = {next_factor_++};
  edge.measured = {i, j, factor.T_i_j, factor.information};
  const auto joins = [&](PoseId a, PoseId b) { return (i == a && j == b) || (i == b && j == a); };
  edge.is_loop = !plan.after || !joins(plan.before, *plan.after);
  edge.added_at = chains_.NewerOf(i, j);
  if (!edge.is_loop) {
    edge.composed_of = {plan.before, plan.pose, *plan.after};
    return edge;
  }
  edge.added_at = chains_.NewerOf(edge.added_at, plan.pose);
  edge.composed_of = {i, plan.pose, j};
  Part part;
  part.id = {next_part_--};
  part.added_at = plan.pose;
  part.links = {std::min(i, j), std::max(i, j)};
  part.T_from_to = SeenFrom(part.links.front(), edge.measured);
  part.measurements = measurements.at(i) + measurements.at(j);
  edge.parts = {part};
  return edge;
}

// With what joins the two ends already: the sum of both about the estimate, each of them a part.
template <class Pose>
void Retirement<Pose>::FuseWithOther(Edge& edge, PoseId through) {
  const PoseId a = edge.measured.from, b = edge.measured.to;
  // Looked for at the one of fewer factors.
  const auto& [few, other_end] = factors_at_[a].size() <= factors_at_[b].size() ? std::pair<PoseId, PoseId>(a, b)
                                                                                : std::pair<PoseId, PoseId>(b, a);
  const auto joins = [few = few, other_end = other_end, this](FactorId factor) {
    return OtherEnd(few, edges_.at(factor)) == other_end;
  };
  const auto& factors = factors_at_[few];
  const auto found = std::find_if(factors.begin(), factors.end(), joins);
  if (found == factors.end()) return;
  Edge other = TakeEdge(*found);
  const PoseId first = std::min(a, b), second = std::max(a, b);
  internal::Arm<Pose> sum(Estimate(first).Inverse() * Estimate(second));
  sum.Add(first, edge.measured);
  sum.Add(first, other.measured);
  const auto as_part = [&](const Edge& whole) {
    Part part;
    part.id = whole.factor;
    part.added_at = whole.added_at;
    part.gain = whole.gain.value_or(0);
    part.T_from_to = SeenFrom(first, whole.measured);
    return part;
  };
  for (Edge* each : {&edge, &other}) {
    if (each->parts.empty()) each->parts = {as_part(*each)};
  }
  // Odometry comes first, of what is as old what was there before.
  Edge& head = edge.is_loop ? other : edge;
  Edge& tail = edge.is_loop ? edge : other;
  for (Part& part : tail.parts) {
    if (part.id.value >= 0) part.id = {next_part_--};  // of an edge, none but the first has its id
    head.parts.push_back(std::move(part));
  }
  if (head.is_loop) head.composed_of.clear();
  head.measured = sum.AsFactor(first, second);
  head.factor = {next_factor_++};
  if (head.is_loop) head.added_at = chains_.NewerOf(head.added_at, through);
  edge = std::move(head);
}

// Links that the innovation test refused are the base's now; the poses near one where a registration failed are tried
// again.
template <class Pose>
void Retirement<Pose>::MoveRefused(const Plan& plan, const UncertainPose<Pose>& T_before_pose) {
  for (auto& refused : map_.refused) {
    if (refused.candidate != plan.pose) continue;
    refused.candidate = plan.before;
    refused.T_candidate_seen = Compose(T_before_pose, refused.T_candidate_seen, options_.composition);
  }
  auto& failed = map_.failed;
  failed.erase(std::remove_if(failed.begin(), failed.end(), [&](const auto& f) { return f.candidate == plan.pose; }),
               failed.end());
}

}  // namespace

template <class Pose>
Retired<Pose> RetirePoses(const CompactMap<Pose>& map, const CompactOptions<Pose>& options,
                          const RetireOptions& retire) {
  if (!(retire.most_loss >= 0)) throw std::invalid_argument("the loss of a pose that retires must be 0 nats or more");
  if (retire.most_neighbours < 1) throw std::invalid_argument("a pose that retires has 1 neighbour or more");
  const std::string defect = FindDefect(map);
  if (!defect.empty()) throw std::invalid_argument(defect);
  if (map.poses.empty()) return {map, {}};
  return Retirement<Pose>(map, options, retire).Run();
}

template Retired<SE2> RetirePoses(const CompactMap<SE2>&, const CompactOptions<SE2>&, const RetireOptions&);
template Retired<SE3> RetirePoses(const CompactMap<SE3>&, const CompactOptions<SE3>&, const RetireOptions&);

}  // namespace terse
