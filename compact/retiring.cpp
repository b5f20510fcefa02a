#include "retiring.h"

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

template <class Pose>
std::vector<RetiredPose> RetireDown(double most_loss, int least_kept, CompactParts<Pose>& parts) {
  RetireOptions retire;
  retire.most_loss = most_loss;
  retire.least_kept = least_kept;
  retire.only_odometry = parts.options.solver.robust.kernel != RobustKernel::kNone;
  retire.first_factor = parts.map.Solver().Graph().NextFactorId();
  retire.first_part = parts.links.NextPartId();
  Retired<Pose> retired = RetirePoses(ExportMap(parts, Recovery::kV1), parts.options, retire);
  if (!retired.poses.empty()) ReplaceMap(retired.map, parts);
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
  const bool may = options.strategy == Strategy::kBounded && options.retire_share > 0 && !options.budget.error &&
                   options.solver.robust.kernel == RobustKernel::kNone;
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
