#pragma once
// How much terrain a trajectory has been in.

#include <array>
#include <cstddef>
#include <set>
#include <vector>

#include "terse/lie/se3.h"

namespace terse {

// The cubes of side `cell_m` that were entered, in a grid with one of them centred at `origin`. Memory grows with the
// terrain, not with time. Levels of a building, a cube apart or more, count one by one.
class EnteredCells {
 public:
  EnteredCells() = default;
  EnteredCells(const Vector<3>& origin, double cell_m) : origin_(origin), cell_m_(cell_m) {}

  // Metres; finite. Whether the cell had not been entered before.
  bool Enter(const Vector<3>& position);
  std::size_t Count() const { return entered_.size(); }
  double AreaM2() const { return static_cast<double>(Count()) * cell_m_ * cell_m_; }

  template <class Archive>
  void Serialize(Archive& archive);  // core/state_file.h

 private:
  using Cell = std::array<double, 3>;  // whole numbers, as large as positions get
  Vector<3> origin_ = Vector<3>::Zero();
  double cell_m_ = 1;
  std::set<Cell> entered_;
};

// By each pose, square metres: the number of cubes of side `cell_m` entered so far, times the area of one of their
// sides. The cubes' grid is centred in the trajectory's box, so that terrain flatter than a cube is in one layer of
// them. Empty unless cell_m > 0 and all is finite.
std::vector<double> ExploredArea(const std::vector<SE3>& T_world_body, double cell_m);

}  // namespace terse
