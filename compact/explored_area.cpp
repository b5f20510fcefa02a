#include "terse/compact/explored_area.h"

#include <cmath>

#include "terse/core/state_file.h"

namespace terse {

bool EnteredCells::Enter(const Vector<3>& position) {
  const Vector<3> at = (position - origin_) / cell_m_;
  return entered_.insert({std::round(at.x()), std::round(at.y()), std::round(at.z())}).second;
}

template <class Archive>
void EnteredCells::Serialize(Archive& archive) {
  auto& [origin, cell_m, entered] = *this;
  archive(origin, cell_m);
  std::vector<Vector<3>> list;
  list.reserve(entered.size());
  for (const Cell& cell : entered) list.emplace_back(cell[0], cell[1], cell[2]);
  archive(list);
  if constexpr (Archive::kReads) {
    entered.clear();
    for (const Vector<3>& cell : list) {
      if (!cell.allFinite() || cell.array().round().matrix() != cell ||
          !entered.insert({cell[0], cell[1], cell[2]}).second)
        archive.Fail("a cell that is none");
    }
    if (!origin.allFinite() || !(cell_m > 0)) archive.Fail("cells without a size");
  }
}

template void EnteredCells::Serialize(StateWriter&);
template void EnteredCells::Serialize(StateReader&);

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
