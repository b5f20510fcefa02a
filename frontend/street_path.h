#pragma once
// A closed driving line of straights and clothoid corners, in the plane z = 0, turning left round a block.

#include <cstddef>
#include <vector>

namespace terse {

struct StreetPoint {
  double x = 0, y = 0;  // metres
  double heading = 0;   // radians from the x axis, counterclockwise, continuous over one lap
};

class StreetPath {
 public:
  // A lap of `length` metres round four corners with at most `curvature` (1/m), which grows and falls linearly over
  // `ramp` metres. std::invalid_argument: the corners alone are longer.
  StreetPath(double length, double curvature, double ramp);
  static double CornerLength(double curvature, double ramp);

  double Length() const { return length_; }
  // At the arc length s, which wraps round.
  StreetPoint At(double s) const;
  // The arc length nearest to a point, and how far left of the line it lies (negative: right), metres.
  struct Station {
    double s = 0, left = 0;
  };
  Station Nearest(double x, double y) const;

 private:
  double length_ = 0, step_ = 0;
  std::vector<StreetPoint> points_;  // every step_, the last one closes the lap
};

}  // namespace terse
