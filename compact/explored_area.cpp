#include "terse/compact/explored_area.h"

#include <cmath>

namespace terse {

bool EnteredCells::Enter(const Vector<3>& position) {
  const Vector<3> at = (position - origin_) / cell_m_;
  return entered_.insert({std::round(at.x()), std::round(at.y()), std::round(at.z())}).second;
}

std::vector<double> ExploredArea(const std::vector<SE3>& T_world_body, double cell_m) {
  if (!(cell_m > 0) || !std::isfinite(cell_m) || T_world_body.empty()) return {};
  Vector<3> low = T_world_body.front().Translation(), high = low;
  for (const SE3& T : T_world_body) {
    if (!T.Translation().allFinite()) return {};
    low = low.cwiseMin(T.Translation());
    high = high.cwiseMax(T.Translation());
  }
  EnteredCells cells((low + high) / 2, cell_m);
  std::vector<double> area;
  area.reserve(T_world_body.size());
  for (const SE3& T : T_world_body) {
    cells.Enter(T.Translation());
    area.push_back(cells.AreaM2());
  }
  return area;
}

}  // namespace terse
