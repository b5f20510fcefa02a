#include "gain_control.h"

#include <algorithm>
#include <cmath>

#include "terse/compact/state_members.h"

namespace terse {
namespace {

constexpr double kWindow = 100, kSteepness = 2, kLeastExcess = -1, kMostExcess = 3, kMostByPoses = 0.7;
// Of what poses_per_area asks for, and at least so many poses: what moves a threshold by one step.
constexpr double kDensityWindow = 0.1, kLeastDensityWindow = 2;
// Of the logarithm, what adds up while the loops seen become e times as many; and the most that counts of it, and of
// the sum. Loops that were left out do not come again, and what they would have told shows late, so thresholds start
// low and rise slowly.
constexpr double kErrorRise = 0.7, kErrorFall = 4, kMostErrorDown = 2, kMostErrorUp = 1;
// Of min_loop_gain: an edge costs less than a pose. (Over 23 graphs 0.1 to 1 make maps as good; the more it is, the
// sooner laps stop bringing new edges. Below a half they go on for tens of laps.)
constexpr double kEdgeGain = 0.7;

// The excess after more was kept of more that there was; and x of gain_control.h.
double Followed(double excess, double share, double kept, int offered) {
  return std::max(excess + kept - share * offered, -kWindow * share);
}

double Exponent(std::optional<double> share, double excess) {
  return share ? kSteepness * std::min(excess / (kWindow * *share), kMostExcess) : 0;
}

template <class Pose>
Vector<3> PositionInSpace(const Pose& T_world_body) {
  Vector<3> p = Vector<3>::Zero();
  p.head<Pose::kDim>() = T_world_body.Translation();
  return p;
}

}  // namespace

template <class Pose>
void GainControl<Pose>::Start(const CompactOptions<Pose>& options) {
  *this = GainControl();
  if (options.budget.error) error_sum_ = error_exponent_ = -kMostErrorDown;
  const double factor = std::exp(error_exponent_);
  min_loop_gain_ = options.thresholds.min_loop_gain * factor;
  min_pose_gain_ = options.thresholds.min_pose_gain * factor;
  min_edge_gain_ = kEdgeGain * min_loop_gain_;
}

template <class Pose>
void GainControl<Pose>::Resume(const CompactOptions<Pose>& options, int poses_kept, int links_kept,
                               const std::vector<Pose>& T_world_body) {
  poses_kept_ = poses_kept;
  links_kept_ = links_kept;
  if (!options.budget.poses_per_area) return;
  for (const Pose& T : T_world_body) Enter(options, T);
}

template <class Pose>
void GainControl<Pose>::Enter(const CompactOptions<Pose>& options, const Pose& T_world_body) {
  const Vector<3> position = PositionInSpace(T_world_body);
  if (cells_.Count() == 0) cells_ = EnteredCells(position, AreaCell(options.thresholds));
  cells_.Enter(position);
}

template <class Pose>
double GainControl<Pose>::DensityExponent(double poses_per_area, int poses) const {
  const double wanted = WantedPoses(poses_per_area);
  const double window = std::max(kDensityWindow * wanted, kLeastDensityWindow);
  return kSteepness * std::clamp((poses - wanted) / window, kLeastExcess, kMostExcess);
}

template <class Pose>
int GainControl<Pose>::PosesTooMany(const CompactBudget& budget) const {
  double excess = 0;
  if (budget.keep_poses) excess = excess_poses_;
  if (budget.poses_per_area) excess = poses_kept_ - WantedPoses(*budget.poses_per_area);
  return excess > 0 ? static_cast<int>(std::min(excess, 1.0 * std::max(poses_kept_, 0))) : 0;
}

template <class Pose>
void GainControl<Pose>::FollowError(const CompactOptions<Pose>& options, const SeenLoops<Pose>& seen, const Kept& kept,
                                    const IncrementalSolver<Pose>& solver,
                                    const std::function<bool(FactorId)>& is_link) {
  growth_.See(seen, kept.is_kept, kept.loops_used, options.thresholds.link_covariance, solver);
  if (!growth_.IsDue()) return;
  const double passed = growth_.Passed();
  const std::optional<double> growth = growth_.Growth(solver, is_link);
  if (!growth) return;
  // Never quite 1, and below it only as estimates differ from where the map was linearised.
  const double found = std::max(*growth - 1, 1e-3 * (*options.budget.error - 1));
  const double off = std::clamp(std::log((*options.budget.error - 1) / found), -kMostErrorDown, kMostErrorUp);
  error_sum_ += (off > 0 ? kErrorRise : kErrorFall) * off * passed;
  error_sum_ = std::clamp(error_sum_, -kMostErrorDown, kMostErrorUp);
  error_exponent_ = std::min(off, 0.0) + error_sum_;
}

template <class Pose>
void GainControl<Pose>::Follow(const CompactOptions<Pose>& options, const Kept& kept, const Pose& T_world_body) {
  if (options.strategy != Strategy::kFpfl && options.strategy != Strategy::kBounded) return;
  const auto& [keep_poses, keep_links, poses_per_area, error] = options.budget;
  // In floating point: a damaged state holds any number.
  const double new_poses = 1.0 * kept.poses - poses_kept_, new_links = 1.0 * kept.links - links_kept_;
  poses_kept_ = kept.poses;
  links_kept_ = kept.links;
  if (keep_poses) excess_poses_ = Followed(excess_poses_, *keep_poses, new_poses, 1);
  if (keep_links) excess_links_ = Followed(excess_links_, *keep_links, new_links, kept.new_loops);
  if (poses_per_area) Enter(options, T_world_body);
  const double of_poses =
      poses_per_area ? DensityExponent(*poses_per_area, kept.poses) : Exponent(keep_poses, excess_poses_);
  const double of_links = Exponent(keep_links, excess_links_);
  const bool both = (keep_poses || poses_per_area) && keep_links;
  const auto& thresholds = options.thresholds;
  min_pose_gain_ = thresholds.min_pose_gain * std::exp(of_poses + error_exponent_);
  // A map that closes no loops is lost, and then everything is new to it: the budget of poses is not kept that way.
  const double by_poses = std::min(of_poses, kMostByPoses);
  const double of_loops = both ? std::max(by_poses, of_links) : by_poses + of_links;
  min_loop_gain_ = thresholds.min_loop_gain * std::exp(of_loops + error_exponent_);
  min_edge_gain_ = kEdgeGain * thresholds.min_loop_gain * std::exp(of_links + error_exponent_);
}

template <class Pose>
template <class Archive>
void GainControl<Pose>::Serialize(Archive& archive) {
  auto& [min_loop_gain, min_pose_gain, min_edge_gain, excess_poses, excess_links, poses_kept, links_kept, cells, growth,
         error_sum, error_exponent] = *this;
  archive(min_loop_gain, min_pose_gain, min_edge_gain, excess_poses, excess_links, poses_kept, links_kept, cells,
          growth, error_sum, error_exponent);
}

#define TERSE_INSTANTIATE(Pose)                             \
  template class GainControl<Pose>;                         \
  template void GainControl<Pose>::Serialize(StateWriter&); \
  template void GainControl<Pose>::Serialize(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
