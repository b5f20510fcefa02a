#include "terse/compact/graph_replay.h"
#include "terse/core/at.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>
#include <stdexcept>
#include <unordered_map>
#include <unordered_set>

namespace terse {
namespace {

using internal::At;
using std::size_t;

// A sensor reaches a little beyond the longest of its links, and sees things from the side too.
constexpr double kMargin = 1.5, kLeastAngle = 1.0;
// Loops that are rarer than one at so many poses hardly tell how far the sensor reaches; one that follows what it sees
// from pose to pose reaches over several.
constexpr std::size_t kFewLinks = 100;
constexpr double kStepsInRange = 5;
// Nor does it tell nearer things apart, which is what is left of a robot that stands still.
constexpr double kDeviationsInRange = 5;

// The largest but one in a hundred: links that are absurd say nothing of the sensor.
double MostButFew(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto nth = values.end() - 1 - static_cast<long>(values.size() / 100);
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

std::pair<std::int64_t, std::int64_t> Pair(PoseId a, PoseId b) { return std::minmax(a.value, b.value); }

constexpr int kNever = std::numeric_limits<int>::min();  // a rank

// New poses alone, numbered by ascending id from 1, and all that were seen before as pose 0, which comes first. So the
// order of arrival is that of poses which join a map.
template <class Pose>
struct NewPart {
  PoseGraph<Pose> graph;
  std::vector<int> poses, factors;  // of the whole graph, by index in this one; -1 for pose 0
};

template <class Pose>
void SetPose(Factor<Pose>& prior, PoseId id) {
  if (auto* pose = std::get_if<PosePriorFactor<Pose>>(&prior)) pose->pose = id;
  if (auto* position = std::get_if<PositionPriorFactor<Pose>>(&prior)) position->pose = id;
}

template <class Pose>
NewPart<Pose> MakeNewPart(const PoseGraph<Pose>& graph, const std::unordered_set<std::int64_t>& seen) {
  NewPart<Pose> part;
  std::vector<int> order;
  for (size_t k = 0; k < graph.Poses().size(); ++k) {
    if (seen.count(graph.Poses()[k].id.value) == 0) order.push_back(static_cast<int>(k));
  }
  std::sort(order.begin(), order.end(),
            [&](int a, int b) { return graph.Poses()[At(a)].id < graph.Poses()[At(b)].id; });
  std::unordered_map<std::int64_t, PoseId> number;
  part.graph.AddPose(PoseId{0});
  part.poses.push_back(-1);
  for (const int p : order) {
    const PoseId id{static_cast<std::int64_t>(part.poses.size())};
    number[graph.Poses()[At(p)].id.value] = id;
    part.graph.AddPose(id);
    part.poses.push_back(p);
  }
  const auto numbered = [&](PoseId id) {
    const auto it = number.find(id.value);
    return it == number.end() ? PoseId{0} : it->second;
  };
  int at = -1;
  for (const auto& node : graph.Factors()) {
    ++at;
    Factor<Pose> factor = node.factor;
    const FactorPoses ends = PosesOf(factor);
    const PoseId first = numbered(ends.first), second = ends.count == 2 ? numbered(ends.second) : first;
    if (first == PoseId{0} && second == PoseId{0}) continue;
    if (auto* edge = std::get_if<RelativePoseFactor<Pose>>(&factor)) {
      edge->from = first;
      edge->to = second;
    }
    SetPose(factor, first);
    part.graph.AddFactor(factor);
    part.factors.push_back(at);
  }
  return part;
}

}  // namespace

template <class Pose>
GraphReplay<Pose>::GraphReplay(const PoseGraph<Pose>& graph) {
  if (graph.Poses().empty()) throw std::invalid_argument("the graph is empty");
  Build(graph, ArrivalSteps(graph, ArrivalUnit::kPose), std::vector<int>(graph.Poses().size(), kNever));
}

template <class Pose>
GraphReplay<Pose>::GraphReplay(const PoseGraph<Pose>& graph, const std::vector<PoseId>& seen) {
  std::unordered_set<std::int64_t> ids;
  std::vector<int> rank(graph.Poses().size(), kNever);
  for (size_t k = 0; k < seen.size(); ++k) {
    ids.insert(seen[k].value);
    if (graph.HasPose(seen[k])) rank[At(graph.IndexOf(seen[k]))] = static_cast<int>(k) - static_cast<int>(seen.size());
  }
  const NewPart<Pose> part = MakeNewPart(graph, ids);
  std::vector<ArrivalStep> steps = ArrivalSteps(part.graph, ArrivalUnit::kPose);
  for (ArrivalStep& step : steps) {
    for (int& p : step.poses) p = part.poses[At(p)];
    for (int& k : step.factors) k = part.factors[At(k)];
    step.poses.erase(std::remove(step.poses.begin(), step.poses.end(), -1), step.poses.end());
  }
  Build(graph, steps, std::move(rank));
}

template <class Pose>
void GraphReplay<Pose>::Build(const PoseGraph<Pose>& graph, const std::vector<ArrivalStep>& steps,
                              std::vector<int> rank) {
  const auto latest = [&](const Factor<Pose>& factor) {
    const FactorPoses ends = PosesOf(factor);
    return std::max(rank[At(graph.IndexOf(ends.first))], rank[At(graph.IndexOf(ends.second))]);
  };
  for (const ArrivalStep& step : steps) {
    for (const int p : step.poses) {
      const auto& node = graph.Poses()[At(p)];
      rank[At(p)] = static_cast<int>(inputs_.size());
      CompactInput<Pose> input;
      input.id = node.id;
      input.T_world_body = node.T_world_body;
      input.fixed = node.fixed && node.T_world_body.has_value();
      input.linkable.emplace();
      input.loops.emplace();
      inputs_.push_back(std::move(input));
    }
  }
  // Each factor belongs to the later of its poses.
  std::vector<std::vector<const RelativePoseFactor<Pose>*>> edges(inputs_.size());
  for (const ArrivalStep& step : steps) {
    for (const int k : step.factors) {
      const Factor<Pose>& factor = graph.Factors()[At(k)].factor;
      const size_t owner = At(latest(factor));
      if (const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&factor)) {
        edges[owner].push_back(edge);
      } else {
        inputs_[owner].priors.push_back(factor);
      }
    }
  }
  for (size_t k = 0; k < inputs_.size(); ++k) {
    const auto earlier = [&](const RelativePoseFactor<Pose>* edge) {
      return std::min(rank[At(graph.IndexOf(edge->from))], rank[At(graph.IndexOf(edge->to))]);
    };
    const auto odometry = std::max_element(edges[k].begin(), edges[k].end(),
                                           [&](const auto* a, const auto* b) { return earlier(a) < earlier(b); });
    if (odometry == edges[k].end()) continue;  // the first pose
    CompactInput<Pose>& input = inputs_[k];
    input.odometry = **odometry;
    input.linkable->reserve(edges[k].size() - 1);
    input.loops->reserve(edges[k].size() - 1);
    for (const auto* edge : edges[k]) {
      if (edge == *odometry) continue;
      links_.push_back({static_cast<int>(k), static_cast<int>(input.loops->size())});
      input.linkable->push_back(edge->from == input.id ? edge->to : edge->from);
      input.loops->push_back(*edge);
    }
  }
}

template <class Pose>
const RelativePoseFactor<Pose>& GraphReplay<Pose>::Link(int k) const {
  if (!all_links_.empty()) return all_links_[At(k)];
  const Place& place = links_[At(k)];
  return (*inputs_[At(place.input)].loops)[At(place.loop)];
}

template <class Pose>
void GraphReplay<Pose>::Choose(const std::vector<int>& poses, const std::vector<int>& links) {
  if (all_links_.empty()) {
    std::vector<RelativePoseFactor<Pose>> all;
    all.reserve(links_.size());
    for (int k = 0; k < LinksOffered(); ++k) all.push_back(Link(k));
    all_links_ = std::move(all);
  }
  for (auto& input : inputs_) {
    input.keep = false;
    input.linkable.emplace();
    input.loops.emplace();
  }
  for (const int k : poses) inputs_[At(k)].keep = true;
  for (const int k : links) {
    CompactInput<Pose>& input = inputs_[At(links_[At(k)].input)];
    const RelativePoseFactor<Pose>& link = Link(k);
    input.linkable->push_back(link.from == input.id ? link.to : link.from);
    input.loops->push_back(link);
  }
}

template <class Pose>
Registration<Pose> GraphReplay<Pose>::AsRegistration() {
  if (waiting_.empty()) {
    for (int k = LinksOffered() - 1; k >= 0; --k) waiting_[Pair(Link(k).from, Link(k).to)].push_back(k);
  }
  return [this](PoseId candidate, PoseId current) -> std::optional<RelativePoseFactor<Pose>> {
    const auto it = waiting_.find(Pair(candidate, current));
    if (it == waiting_.end() || it->second.empty()) return std::nullopt;
    const RelativePoseFactor<Pose>& link = Link(it->second.back());
    it->second.pop_back();
    return link;
  };
}

template <class Pose>
Vector<Displacement<Pose>::kSize> GraphReplay<Pose>::LinkRange(const DistanceOptions& options) const {
  const auto all = [this](const auto& visit) {
    for (int k = 0; k < LinksOffered(); ++k) visit(Link(k));
  };
  return RangeOf(all, links_.empty(), options);
}

template <class Pose>
Vector<Displacement<Pose>::kSize> GraphReplay<Pose>::LinkRange(const std::vector<RelativePoseFactor<Pose>>& links,
                                                               const DistanceOptions& options) const {
  const auto all = [&](const auto& visit) { std::for_each(links.begin(), links.end(), visit); };
  return RangeOf(all, links.empty(), options);
}

template <class Pose>
template <class Links>
Vector<Displacement<Pose>::kSize> GraphReplay<Pose>::RangeOf(const Links& links, bool none,
                                                             const DistanceOptions& options) const {
  std::vector<double> lengths, angles;
  const auto include = [&](const RelativePoseFactor<Pose>& edge) {
    const auto displacement = ComputeDisplacement<Pose>({edge.T_from_to}, options).mean;
    lengths.push_back(displacement.template head<Pose::kDim>().norm());
    angles.push_back(std::abs(displacement[Pose::kDim]));
  };
  links(include);
  for (const auto& input : inputs_) {
    if (none && input.odometry) include(*input.odometry);
  }
  double reach = kMargin * MostButFew(std::move(lengths));
  if (links_.size() * kFewLinks < inputs_.size()) {
    double path = 0, steps = 0;
    for (const auto& input : inputs_) {
      if (!input.odometry) continue;
      path += input.odometry->T_from_to.Translation().norm();
      ++steps;
    }
    if (steps > 0) {
      const double variance = LinkCovariance().diagonal().template head<Pose::kDim>().maxCoeff();
      reach = std::max({reach, kStepsInRange * path / steps, kDeviationsInRange * std::sqrt(variance)});
    }
  }
  Vector<Displacement<Pose>::kSize> range;
  range.setConstant(std::max(reach, 1e-3));
  range[Pose::kDim] = std::max(kLeastAngle, MostButFew(std::move(angles)));
  return range;
}

template <class Pose>
typename Pose::Jacobian GraphReplay<Pose>::LinkCovariance() const {
  typename Pose::Jacobian sum = Pose::Jacobian::Zero();
  double count = 0;
  const auto include = [&](const RelativePoseFactor<Pose>& edge) {
    sum += SeenFrom(edge.from, edge).covariance;
    ++count;
  };
  for (int k = 0; k < LinksOffered(); ++k) include(Link(k));
  for (const auto& input : inputs_) {
    if (links_.empty() && input.odometry) include(*input.odometry);
  }
  if (count == 0) return Pose::Jacobian::Identity();
  return sum / count;
}

template class GraphReplay<SE2>;
template class GraphReplay<SE3>;

}  // namespace terse
