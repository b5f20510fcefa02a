#pragma once
// Private to the generator: what a scene is, the random numbers, and the search for links.

#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <unordered_map>
#include <vector>

#include "terse/core/generate.h"
#include "terse/core/random.h"

namespace terse::internal {

// Nine decimals. What the generator gives out is rounded so that the last bit of a sine, in which mathematical
// libraries differ, does not reach the file.
inline double Rounded(double value) { return std::round(value * 1e9) / 1e9; }
SE2 Rounded(const SE2& T);
SE3 Rounded(const SE3& T);

// Which earlier poses pose k is linked to, besides its predecessor.
struct LinkRule {
  std::vector<long> offsets;       // k - offset, where that exists
  double radius_m = 0;             // and, if positive, every pose closer than this
  double max_view_angle_rad = 10;  // whose view direction differs by less than this
  long min_gap = 2;                // at least so many poses before k
  long max_links = 0;              // so many; 0: all
  long oldest_links = 0;           // if there are more: so many oldest ones, and of the others the newest
};

template <class Pose>
struct ScenePlan {
  long poses = 0;
  std::function<Pose(long k)> T_world_body;                            // called once for each k, in order
  std::function<typename Pose::Tangent(const Pose& T_from_to)> sigma;  // standard deviations of a measurement
  LinkRule links;
};

// Throw std::invalid_argument for options the scene cannot follow.
ScenePlan<SE2> PlanManhattan(const GenerateOptions& options, Random& random);
ScenePlan<SE3> PlanEllipse(const GenerateOptions& options);
ScenePlan<SE3> PlanEllipseLaps(const GenerateOptions& options);
ScenePlan<SE3> PlanSphere(const GenerateOptions& options);
ScenePlan<SE3> PlanTorus(const GenerateOptions& options);
ScenePlan<SE3> PlanGarage(const GenerateOptions& options);

// The view direction: body z in space, body x in the plane.
Vector<2> ViewDirection(const SE2& T_world_body);
Vector<3> ViewDirection(const SE3& T_world_body);

// Earlier poses near a new one: a hash of cells. A cell holds its oldest and its newest poses, so many of each that no
// scene's own number of poses or ten laps exceed them: neither memory nor the time of a pose grow with how often the
// robot has been there.
template <class Pose>
class LinkFinder {
 public:
  struct Seen {
    long pose = 0;
    Pose T_world_body;
  };

  explicit LinkFinder(const LinkRule& rule) : rule_(rule) {}
  // Links of pose k, oldest first; then k is in the hash for those to come. Called once for each k, in order.
  std::vector<Seen> Next(long k, const Pose& T_world_body);

 private:
  static constexpr std::size_t kMostOldest = 160, kMostNewest = 160;
  using Index = std::array<long, 3>;
  struct IndexHash {
    std::size_t operator()(const Index& index) const;
  };
  struct Cell {
    std::vector<Seen> oldest, newest;  // `newest` is a ring once it is full
    std::size_t next = 0;              // its place for the pose to come
  };
  Index IndexOf(const Pose& pose) const;
  void CollectNear(const Seen& pose, std::vector<Seen>& found) const;
  void Remember(const Seen& pose);

  LinkRule rule_;
  std::unordered_map<Index, Cell, IndexHash> cells_;
  std::vector<Pose> all_;  // if there are offsets, which lead to any
};

}  // namespace terse::internal
