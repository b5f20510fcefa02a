#include "experiments/wrong_loop_draw.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "experiments/generate_scene.h"
#include "terse/core/residual.h"

namespace terse::internal {
namespace {

using std::size_t;

constexpr int kDraws = 1000;                         // for a place beside one pose
constexpr size_t kLocalLeast = 20, kLocalMost = 50;  // poses apart
constexpr size_t kGroupLeast = 3, kGroupMost = 10;   // loops
constexpr size_t kGroupStride = 2;                   // poses on along the other visit, at most
constexpr double kGroupReach = 2;  // of the longest true loop: where two paths part the group ends, and another begins
constexpr int kAliasLoops = 20, kMostMissed = 10;     // of one mistake; at so many poses in turn it did not fit
constexpr size_t kAliasWait = 50, kMostAliases = 64;  // poses until another mistake is made; that are open
constexpr size_t kMostInCell = 256;                   // poses, the oldest
constexpr double kLastShare = 0.02;                   // of the poses, among which none waits any more

// With an error of the covariance `information`^-1.
template <class Pose>
Pose WithNoise(const Pose& T_from_to, const Matrix<Pose::kDof, Pose::kDof>& information, Random& random) {
  constexpr int N = Pose::kDof;
  Eigen::Matrix<double, N, 1> noise;
  for (int d = 0; d < N; ++d) noise[d] = random.Normal();
  const Eigen::Matrix<double, N, N> dense = information;
  dense.llt().matrixU().solveInPlace(noise);
  return Rounded(T_from_to.Retract(noise));
}

double Angle(const SE2& T) { return std::abs(T.Theta()); }
double Angle(const SE3& T) { return T.Rotation().Log().norm(); }

}  // namespace

size_t Below(Random& random, size_t n) {
  return std::min(n - 1, static_cast<size_t>(random.Uniform() * static_cast<double>(n)));
}

template <class Pose>
WrongLoopDraw<Pose>::WrongLoopDraw(std::vector<Edge> sample, OutlierKind kind, size_t poses, const Random& random)
    : sample_(std::move(sample)), kind_(kind), all_poses_(poses), random_(random) {
  for (const Edge& loop : sample_) {
    reach_m_ = std::max(reach_m_, loop.T_from_to.Translation().norm());
    reach_rad_ = std::max(reach_rad_, Angle(loop.T_from_to));
  }
}

template <class Pose>
std::vector<typename WrongLoopDraw<Pose>::Due> WrongLoopDraw<Pose>::Schedule(double count) {
  std::vector<Due> due;
  for (long group = 0; static_cast<double>(due.size()) < count; ++group) {
    // The later one of two different poses.
    const size_t a = Below(random_, all_poses_), b = Below(random_, all_poses_ - 1);
    const size_t first = std::max(a, b < a ? b : b + 1);
    const size_t loops =
        kind_ == OutlierKind::kGrouped ? kGroupLeast + Below(random_, kGroupMost - kGroupLeast + 1) : 1;
    for (size_t k = 0; k < loops && static_cast<double>(due.size()) < count; ++k)
      due.push_back({std::min(first + k, all_poses_ - 1), group});
  }
  std::stable_sort(due.begin(), due.end(), [](const Due& a, const Due& b) { return a.place < b.place; });
  return due;
}

template <class Pose>
std::optional<RelativePoseFactor<Pose>> WrongLoopDraw<Pose>::Draw(PoseId id, const Pose& T_world_id,
                                                                  const std::vector<PoseId>& linked, long group) {
  const Newcomer pose{id, T_world_id, linked};
  switch (kind_) {
    case OutlierKind::kGrouped: return DrawGrouped(pose, group);
    case OutlierKind::kAliased: return DrawAliased(pose);
    default: return DrawAnew(pose, nullptr);
  }
}

template <class Pose>
void WrongLoopDraw<Pose>::Add(PoseId id, const Pose& T_world_body) {
  if (kind_ == OutlierKind::kAliased && reach_m_ > 0) {
    auto& cell = cells_[CellAt(T_world_body)];
    if (cell.size() < kMostInCell) cell.push_back(poses_.size());
  }
  poses_.emplace_back(id, T_world_body);
}

// Closer than all its links, a wrong one would bring the pose in.
template <class Pose>
bool WrongLoopDraw<Pose>::MayJoin(const Newcomer& pose, size_t other) const {
  const PoseId id = poses_[other].first;
  return id < pose.linked.back() && !std::binary_search(pose.linked.begin(), pose.linked.end(), id);
}

// With the direction and information of a true loop, if that is wrong.
template <class Pose>
std::optional<RelativePoseFactor<Pose>> WrongLoopDraw<Pose>::Join(const Newcomer& pose, size_t other, const Edge& like,
                                                                  const Pose& T_from_to) {
  const auto& [id, T_world_other] = poses_[other];
  const bool forward = like.from < like.to;
  Edge wrong{forward ? id : pose.id, forward ? pose.id : id, WithNoise(T_from_to, like.information, random_),
             like.information};
  const double chi2 = forward ? FactorChi2<Pose>(wrong, T_world_other, pose.T_world_body)
                              : FactorChi2<Pose>(wrong, pose.T_world_body, T_world_other);
  if (chi2 < kWrongChi2PerDof * Pose::kDof) return std::nullopt;
  return wrong;
}

template <class Pose>
std::optional<RelativePoseFactor<Pose>> WrongLoopDraw<Pose>::DrawAnew(const Newcomer& pose, Mistake* mistake) {
  const size_t n = poses_.size();
  if (kind_ == OutlierKind::kLocal && n < kLocalLeast) return std::nullopt;
  for (int draw = 0; draw < kDraws; ++draw) {
    const size_t other = kind_ != OutlierKind::kLocal
                             ? Below(random_, n)
                             : n - kLocalLeast - Below(random_, std::min(n, kLocalMost) - kLocalLeast + 1);
    const Edge& like = sample_[Below(random_, sample_.size())];
    if (!MayJoin(pose, other)) continue;
    auto wrong = Join(pose, other, like, like.T_from_to);
    if (!wrong) continue;
    if (mistake != nullptr) {
      const bool forward = wrong->to == pose.id;
      const Pose T_other_pose = forward ? wrong->T_from_to : wrong->T_from_to.Inverse();
      *mistake = {poses_[other].second * T_other_pose * pose.T_world_body.Inverse(), other, like.information, 1, 0};
    }
    return wrong;
  }
  return std::nullopt;
}

// What the same mistake makes of another pair of poses.
template <class Pose>
std::optional<RelativePoseFactor<Pose>> WrongLoopDraw<Pose>::Repeat(const Newcomer& pose, size_t other,
                                                                    Mistake& mistake) {
  const Pose T_other_pose = poses_[other].second.Inverse() * mistake.T_seen_true * pose.T_world_body;
  const Edge like{PoseId{0}, PoseId{1}, T_other_pose, mistake.information};
  auto wrong = Join(pose, other, like, T_other_pose);
  if (wrong) {
    mistake.other = other;
    ++mistake.used;
  }
  return wrong;
}

// The next loop of the group leads from this pose to one close behind, or before, the last one that was linked:
// whichever is nearest where the robot seems to be.
template <class Pose>
std::optional<RelativePoseFactor<Pose>> WrongLoopDraw<Pose>::DrawGrouped(const Newcomer& pose, long group) {
  const auto found = groups_.find(group);
  if (found != groups_.end()) {
    Mistake& mistake = found->second;
    const Pose T_world_seen = mistake.T_seen_true * pose.T_world_body;
    std::optional<size_t> nearest;
    double least = 0;
    const size_t first = mistake.other - std::min(mistake.other, kGroupStride);
    for (size_t other = first; other <= std::min(mistake.other + kGroupStride, poses_.size() - 1); ++other) {
      if (other == mistake.other || !MayJoin(pose, other)) continue;
      const double apart = (poses_[other].second.Inverse() * T_world_seen).Translation().norm();
      if (nearest && apart >= least) continue;
      nearest = other;
      least = apart;
    }
    const bool is_far = least > kGroupReach * reach_m_;
    auto wrong = nearest && !is_far ? Repeat(pose, *nearest, mistake) : std::nullopt;
    if (wrong || (++mistake.missed < kMostMissed && !is_far && !IsLast())) return wrong;
  }
  Mistake mistake{Pose(), 0, Matrix<Pose::kDof, Pose::kDof>::Identity(), 0, 0};
  auto wrong = DrawAnew(pose, &mistake);
  if (wrong) groups_.insert_or_assign(group, mistake);
  return wrong;
}

template <class Pose>
std::optional<RelativePoseFactor<Pose>> WrongLoopDraw<Pose>::DrawAliased(const Newcomer& pose) {
  for (Mistake& mistake : aliases_) {
    const Pose T_world_seen = mistake.T_seen_true * pose.T_world_body;
    const Cell middle = CellAt(T_world_seen);
    std::vector<size_t> near;
    for (int k = 0; k < 27; ++k) {
      const auto cell = cells_.find({middle[0] + k % 3 - 1, middle[1] + k / 3 % 3 - 1, middle[2] + k / 9 - 1});
      if (cell == cells_.end()) continue;
      for (const size_t other : cell->second) {
        const Pose T_other_seen = poses_[other].second.Inverse() * T_world_seen;
        const bool is_near = T_other_seen.Translation().norm() <= reach_m_ && Angle(T_other_seen) <= reach_rad_;
        if (is_near && MayJoin(pose, other)) near.push_back(other);
      }
    }
    if (near.empty()) continue;
    auto wrong = Repeat(pose, near[Below(random_, near.size())], mistake);
    if (!wrong) continue;
    if (mistake.used >= kAliasLoops) aliases_.erase(aliases_.begin() + (&mistake - aliases_.data()));
    aliased_at_ = poses_.size();
    return wrong;
  }
  if (!aliases_.empty() && !IsLast() && poses_.size() < aliased_at_ + kAliasWait) return std::nullopt;
  Mistake mistake{Pose(), 0, Matrix<Pose::kDof, Pose::kDof>::Identity(), 0, 0};
  auto wrong = DrawAnew(pose, &mistake);
  if (!wrong) return wrong;
  if (aliases_.size() == kMostAliases) aliases_.erase(aliases_.begin());
  aliases_.push_back(mistake);
  aliased_at_ = poses_.size();
  return wrong;
}

template <class Pose>
bool WrongLoopDraw<Pose>::IsLast() const {
  return static_cast<double>(poses_.size()) > (1 - kLastShare) * static_cast<double>(all_poses_);
}

template <class Pose>
typename WrongLoopDraw<Pose>::Cell WrongLoopDraw<Pose>::CellAt(const Pose& T_world_body) const {
  Cell cell = {0, 0, 0};
  for (int d = 0; d < Pose::kDim; ++d)
    cell[static_cast<size_t>(d)] = static_cast<long>(std::floor(T_world_body.Translation()[d] / reach_m_));
  return cell;
}

template <class Pose>
size_t WrongLoopDraw<Pose>::HashCell::operator()(const Cell& cell) const {
  size_t hash = 0;
  for (const long c : cell) hash = hash * 1000003u + static_cast<size_t>(c);
  return hash;
}

template class WrongLoopDraw<SE2>;
template class WrongLoopDraw<SE3>;

}  // namespace terse::internal
