#include "terse/compact/explored_area.h"

#include <array>
#include <cmath>
#include <set>

namespace terse {

std::vector<double> ExploredArea(const std::vector<SE3>& T_world_body, double cell_m) {
  if (!(cell_m > 0) || !std::isfinite(cell_m) || T_world_body.empty()) return {};
  Vector<3> low = T_world_body.front().Translation(), high = low;
  for (const SE3& T : T_world_body) {
    if (!T.Translation().allFinite()) return {};
    low = low.cwiseMin(T.Translation());
    high = high.cwiseMax(T.Translation());
  }
  const Vector<3> center = (low + high) / 2;
  std::set<std::array<double, 3>> entered;
  std::vector<double> area;
  area.reserve(T_world_body.size());
  for (const SE3& T : T_world_body) {
    const Vector<3> at = (T.Translation() - center) / cell_m;
    entered.insert({std::round(at.x()), std::round(at.y()), std::round(at.z())});
    area.push_back(static_cast<double>(entered.size()) * cell_m * cell_m);
  }
  return area;
}

}  // namespace terse
