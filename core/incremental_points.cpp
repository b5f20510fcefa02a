// Carry::kPoint: the estimate is the linearisation point.

#include <map>

#include "incremental_plan.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

}  // namespace

template <class Pose>
void IncrementalSolver<Pose>::MovePoints(StepReport& report) {
  for (int k = 0; k < options_.max_iterations; ++k) {
    std::map<int, Pose> points;
    for (const int v : factor_.Solve()) {
      const Eigen::Map<const Vector<B>> d(factor_.Solution().data() + At(v) * B);
      if (d.template head<Pose::kDim>().norm() > options_.step_metres ||
          d.template tail<B - Pose::kDim>().norm() > options_.step_radians) {
        points.emplace(v, linearization_points_[At(v)].Retract(d));
      }
    }
    for (int v = 0; v < factor_.Variables(); ++v) {
      if (points.count(v) == 0) factor_.ClearSolution(v);
    }
    if (points.empty()) break;
    ++report.iterations;
    Relinearize(points, LinearizeAround(points), report);
  }
}

template void IncrementalSolver<SE2>::MovePoints(StepReport&);
template void IncrementalSolver<SE3>::MovePoints(StepReport&);

}  // namespace terse
