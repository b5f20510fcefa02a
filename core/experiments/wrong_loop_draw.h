#pragma once
// One wrong loop after another, of the kinds of outliers.h.

#include <array>
#include <cstddef>
#include <map>
#include <optional>
#include <unordered_map>
#include <vector>

#include "terse/core/outliers.h"
#include "terse/core/random.h"

namespace terse::internal {

// Below n, evenly.
std::size_t Below(Random& random, std::size_t n);

template <class Pose>
class WrongLoopDraw {
 public:
  using Edge = RelativePoseFactor<Pose>;

  // `sample`: true loops, not empty if any is drawn. `poses`: of the whole data.
  WrongLoopDraw(std::vector<Edge> sample, OutlierKind kind, std::size_t poses, const Random& random);

  // When the later poses of `count` wrong loops arrive, as places in that order, ascending.
  struct Due {
    std::size_t place;
    long group;  // kGrouped: of those that agree with each other
  };
  std::vector<Due> Schedule(double count);

  // A wrong loop from `id`, the next pose, to an earlier one that is none of `linked` (ascending); absent if no draw
  // gave one.
  std::optional<Edge> Draw(PoseId id, const Pose& T_world_id, const std::vector<PoseId>& linked, long group);
  void Add(PoseId id, const Pose& T_world_body);
  std::size_t Poses() const { return poses_.size(); }

 private:
  // What takes the place where the robot is for another one: `T_seen_true`, in the world. Loops of one agree.
  struct Mistake {
    Pose T_seen_true;
    std::size_t other;  // the place of the pose that was linked last
    Matrix<Pose::kDof, Pose::kDof> information;
    int used = 0, missed = 0;
  };
  struct Newcomer {
    PoseId id;
    const Pose& T_world_body;
    const std::vector<PoseId>& linked;
  };
  using Cell = std::array<long, 3>;
  struct HashCell {
    std::size_t operator()(const Cell& cell) const;
  };

  bool MayJoin(const Newcomer& pose, std::size_t other) const;
  std::optional<Edge> Join(const Newcomer& pose, std::size_t other, const Edge& like, const Pose& T_from_to);
  std::optional<Edge> DrawAnew(const Newcomer& pose, Mistake* mistake);
  std::optional<Edge> Repeat(const Newcomer& pose, std::size_t other, Mistake& mistake);
  std::optional<Edge> DrawGrouped(const Newcomer& pose, long group);
  std::optional<Edge> DrawAliased(const Newcomer& pose);
  bool IsLast() const;
  Cell CellAt(const Pose& T_world_body) const;

  std::vector<Edge> sample_;
  OutlierKind kind_;
  std::size_t all_poses_;
  Random random_;
  std::vector<std::pair<PoseId, Pose>> poses_;
  std::map<long, Mistake> groups_;  // kGrouped
  // kAliased: those that are not used up, oldest first; and the earlier poses by where they are.
  std::vector<Mistake> aliases_;
  std::size_t aliased_at_ = 0;  // the place of the newest wrong loop
  double reach_m_ = 0, reach_rad_ = 0;
  std::unordered_map<Cell, std::vector<std::size_t>, HashCell> cells_;
};

extern template class WrongLoopDraw<SE2>;
extern template class WrongLoopDraw<SE3>;

}  // namespace terse::internal
