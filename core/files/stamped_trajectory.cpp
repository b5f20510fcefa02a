#include "terse/core/stamped_trajectory.h"

#include <algorithm>
#include <numeric>
#include <stdexcept>

#include "terse/core/pose_name.h"

namespace terse {

void RequireStampId(PoseId id) {
  constexpr std::int64_t kMost = std::int64_t{1} << 53;
  if (id.value >= -kMost && id.value <= kMost) return;  // -2^63 has no absolute value
  throw std::invalid_argument(Name(id) + ": ids beyond 2^53 do not fit into the stamps of a trajectory");
}

template <class Pose>
Trajectory MakeTrajectory(const std::vector<PoseId>& ids, const std::vector<Pose>& T_world_body) {
  std::vector<std::size_t> order(ids.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return ids[a] < ids[b]; });
  Trajectory trajectory;
  for (const std::size_t k : order) {
    RequireStampId(ids[k]);
    trajectory.stamps.push_back(static_cast<double>(ids[k].value));
    trajectory.T_world_body.push_back(InSpace(T_world_body[k]));
  }
  return trajectory;
}

template Trajectory MakeTrajectory<SE2>(const std::vector<PoseId>&, const std::vector<SE2>&);
template Trajectory MakeTrajectory<SE3>(const std::vector<PoseId>&, const std::vector<SE3>&);

}  // namespace terse
