#include "fused_edges.h"

#include <Eigen/Cholesky>
#include <algorithm>

#include "terse/compact/state_members.h"
#include "terse/core/at.h"

namespace terse {
namespace {

using std::size_t;

// Of an edge so many measurements are remembered one by one.
constexpr size_t kMostParts = 32;

template <class Pose>
UncertainPose<Pose> Fused(const UncertainPose<Pose>& a, const UncertainPose<Pose>& b) {
  using Jacobian = typename Pose::Jacobian;
  const Jacobian S = a.covariance + b.covariance;
  const Jacobian K = S.llt().solve(a.covariance).transpose();
  UncertainPose<Pose> out;
  out.T_a_b = a.T_a_b * Pose::Exp(K * (a.T_a_b.Inverse() * b.T_a_b).Log());
  const Jacobian covariance = K * b.covariance;  // a (a + b)^-1 b, symmetric but for rounding
  out.covariance = (covariance + covariance.transpose()) / 2;
  return out;
}

}  // namespace

template <class Pose>
const typename FusedEdges<Pose>::Edge* FusedEdges<Pose>::Find(const Ends& ends) const {
  const auto it = edges_.find(ends);
  return it != edges_.end() ? &it->second : nullptr;
}

template <class Pose>
void FusedEdges<Pose>::Forget(const Ends& ends, FactorId factor) {
  const auto it = edges_.find(ends);
  if (it != edges_.end() && it->second.factor == factor) edges_.erase(it);
}

template <class Pose>
typename std::map<typename FusedEdges<Pose>::Ends, typename FusedEdges<Pose>::Edge>::const_iterator
FusedEdges<Pose>::FindPart(FactorId part) const {
  return std::find_if(edges_.begin(), edges_.end(), [&](const auto& entry) {
    const auto& parts = entry.second.parts;
    return std::any_of(parts.begin(), parts.end(), [&](const Part& p) { return p.id == part; });
  });
}

template <class Pose>
void FusedEdges<Pose>::Append(Part part, std::vector<Part>& parts) {
  parts.push_back(std::move(part));
  if (parts.size() <= kMostParts) return;
  // The first is what the edge was before others fused with it: odometry, for one, stays by itself.
  Part& sum = parts[1];
  const Part& next = parts[2];
  sum.T_from_to = Fused(sum.T_from_to, next.T_from_to);
  sum.measurements += next.measurements;
  sum.gain += next.gain;
  sum.id = FactorId();
  sum.added_at = next.added_at;
  sum.links.clear();
  parts.erase(parts.begin() + 2);
}

template <class Pose>
UncertainPose<Pose> FusedEdges<Pose>::Sum(const std::vector<Part>& parts) {
  UncertainPose<Pose> sum = parts.front().T_from_to;
  for (size_t k = 1; k < parts.size(); ++k) sum = Fused(sum, parts[k].T_from_to);
  return sum;
}

template <class Pose>
template <class Archive>
void FusedEdges<Pose>::Serialize(Archive& archive) {
  auto& [edges, next_part] = *this;
  archive(next_part);
  std::vector<std::pair<Ends, Edge>> list(edges.begin(), edges.end());
  archive.Each(list, [&](std::pair<Ends, Edge>& entry) {
    auto& [factor, is_odometry, parts] = entry.second;
    archive(entry.first.first, entry.first.second, factor, is_odometry);
    archive.Each(parts, [&](Part& part) {
      auto& [id, added_at, gain, links, T_from_to, measurements] = part;
      archive(id, added_at, gain, links, T_from_to, measurements);
    });
  });
  if constexpr (Archive::kReads) edges = {list.begin(), list.end()};
}

template class FusedEdges<SE2>;
template class FusedEdges<SE3>;
template void FusedEdges<SE2>::Serialize(StateWriter&);
template void FusedEdges<SE2>::Serialize(StateReader&);
template void FusedEdges<SE3>::Serialize(StateWriter&);
template void FusedEdges<SE3>::Serialize(StateReader&);

}  // namespace terse
