#include "retiring.h"

#include <algorithm>

#include "map_exchange.h"
#include "terse/core/error.h"
#include "terse/core/log_message.h"

namespace terse::internal {
namespace {

// Of the poses there were when poses last retired, and besides.
constexpr double kGrowth = 0.1;
constexpr int kLeastGrowth = 50;

// Poses that a budget asks for are not given up.
template <class Pose>
int LeastKept(const CompactParts<Pose>& parts) {
  const CompactBudget& budget = parts.options.budget;
  if (!budget.keep_poses && !budget.poses_per_area) return 0;
  return parts.map.Poses() - parts.gains.PosesTooMany(budget);
}

// Loops that the kernel leaves out keep their chance as long as they are among the last ones.
constexpr std::size_t kMostLeftOut = 100;

// Ascending.
template <class Pose>
std::vector<FactorId> LeftOut(const IncrementalSolver<Pose>& solver) {
  std::vector<FactorId> out;
  for (const auto& node : solver.Graph().Factors()) {
    if (solver.WeightOf(node.id) == 0) out.push_back(node.id);
  }
  std::sort(out.begin(), out.end());
  return out;
}

// Those before the last ones leave the map, and the list.
template <class Pose>
void DropOldest(std::vector<FactorId>& left_out, CompactMap<Pose>& map) {
  if (left_out.size() <= kMostLeftOut) return;
  const auto kept = left_out.end() - static_cast<long>(kMostLeftOut);
  const auto goes = [&](const auto& edge) { return std::binary_search(left_out.begin(), kept, edge.factor); };
  map.edges.erase(std::remove_if(map.edges.begin(), map.edges.end(), goes), map.edges.end());
  left_out.erase(left_out.begin(), kept);
}

template <class Pose>
std::vector<RetiredPose> RetireDown(double most_loss, int least_kept, CompactParts<Pose>& parts) {
  RetireOptions retire;
  retire.most_loss = most_loss;
  retire.least_kept = least_kept;
  const RobustKernel kernel = parts.options.solver.robust.kernel;
  retire.only_odometry = kernel != RobustKernel::kNone && kernel != RobustKernel::kGnc;
  retire.first_factor = parts.map.Solver().Graph().NextFactorId();
  retire.first_part = parts.links.NextPartId();
  Retired<Pose> retired;
  if (least_kept < parts.map.Poses()) {
    CompactMap<Pose> map = ExportMap(parts, Recovery::kV1);
    if (kernel == RobustKernel::kGnc) {
      retire.left_out = LeftOut(parts.map.Solver());
      DropOldest(retire.left_out, map);
    }
    retired = RetirePoses(map, parts.options, retire);
    if (!retired.poses.empty()) ReplaceMap(retired.map, parts);
  }
  parts.poses_after_retiring = parts.map.Poses();
  if (retired.poses.empty()) return {};
  Log(parts.options.log, LogLevel::kInfo, retired.poses.size(), " poses retired, ", parts.poses_after_retiring,
      " are kept");
  return std::move(retired.poses);
}

}  // namespace

template <class Pose>
std::vector<RetiredPose> Retire(double most_loss, CompactParts<Pose>& parts) {
  return RetireDown(most_loss, 0, parts);
}

template <class Pose>
std::vector<RetiredPose> RetireByShare(CompactParts<Pose>& parts) {
  const CompactOptions<Pose>& options = parts.options;
  const bool may =
      options.strategy == Strategy::kBounded && options.retire_share > 0 && !options.budget.error &&
      (options.solver.robust.kernel == RobustKernel::kNone || options.solver.robust.kernel == RobustKernel::kGnc);
  if (!may) return {};
  try {
    return RetireDown(options.retire_share * parts.gains.MinLoopGain(), LeastKept(parts), parts);
  } catch (const NumericalError& error) {
    parts.poses_after_retiring = parts.map.Poses();  // not again at every step
    Log(options.log, LogLevel::kInfo, "no poses retired: ", error.what());
    return {};
  }
}

template <class Pose>
std::vector<RetiredPose> RetireIfDue(CompactParts<Pose>& parts) {
  if (parts.map.Poses() <= (1 + kGrowth) * parts.poses_after_retiring + kLeastGrowth) return {};
  return RetireByShare(parts);
}

#define TERSE_INSTANTIATE(Pose)                                          \
  template std::vector<RetiredPose> Retire(double, CompactParts<Pose>&); \
  template std::vector<RetiredPose> RetireByShare(CompactParts<Pose>&);  \
  template std::vector<RetiredPose> RetireIfDue(CompactParts<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
