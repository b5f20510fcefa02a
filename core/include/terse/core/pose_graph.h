#pragma once
// The measurement graph: poses by user id, factors by stable id.
//
// Pose is SE2 or SE3. Poses keep their order of insertion: a pose's index in Poses() never changes.
// Every information matrix is full, in the tangent order of the pose ([rho; phi], metres and radians).
// A graph is a value; concurrent reads are safe.

#include <cstdint>
#include <optional>
#include <string>
#include <unordered_map>
#include <variant>
#include <vector>

#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse {

// A user's name for a pose: any 64-bit number, in any order, with gaps.
struct PoseId {
  std::int64_t value = 0;
  friend bool operator==(PoseId a, PoseId b) { return a.value == b.value; }
  friend bool operator!=(PoseId a, PoseId b) { return a.value != b.value; }
  friend bool operator<(PoseId a, PoseId b) { return a.value < b.value; }
};

// Given out by the graph in order of arrival, never reused.
struct FactorId {
  std::int64_t value = -1;
  friend bool operator==(FactorId a, FactorId b) { return a.value == b.value; }
  friend bool operator!=(FactorId a, FactorId b) { return a.value != b.value; }
  friend bool operator<(FactorId a, FactorId b) { return a.value < b.value; }
};

// Measures T_from_to. Residual Local(T_from_to^-1 * T_world_from^-1 * T_world_to).
template <class Pose>
struct RelativePoseFactor {
  PoseId from, to;
  Pose T_from_to;
  typename Pose::Jacobian information;
};

// Measures T_world_body. Residual Local(measured^-1 * T_world_body).
template <class Pose>
struct PosePriorFactor {
  PoseId pose;
  Pose T_world_body;
  typename Pose::Jacobian information;
};

// Measures the position of the body in the world, as GNSS does. Residual translation - p_world, world frame.
template <class Pose>
struct PositionPriorFactor {
  PoseId pose;
  typename Pose::Position p_world;
  Matrix<Pose::kDim, Pose::kDim> information;
};

template <class Pose>
using Factor = std::variant<RelativePoseFactor<Pose>, PosePriorFactor<Pose>, PositionPriorFactor<Pose>>;

template <class Pose>
class PoseGraph {
 public:
  struct PoseNode {
    PoseId id;
    std::optional<Pose> T_world_body;  // absent when a file names the pose in edges only
    bool fixed = false;                // FIX in a file: anchored at its value
  };
  struct FactorNode {
    FactorId id;
    Factor<Pose> factor;
  };

  // Throws std::invalid_argument if the id is taken or the value is not finite.
  void AddPose(PoseId id, const std::optional<Pose>& T_world_body = std::nullopt);
  // Throws std::invalid_argument if the pose is unknown.
  void SetPose(PoseId id, const Pose& T_world_body);
  void SetFixed(PoseId id, bool fixed);

  // Throws std::invalid_argument, leaving the graph as it was, if a pose is unknown, an edge joins a pose to
  // itself, a number is not finite, or the information is not symmetric positive definite.
  FactorId AddFactor(const Factor<Pose>& factor);
  // False if there is no such factor (any more).
  bool RemoveFactor(FactorId id);

  const std::vector<PoseNode>& Poses() const { return poses_; }
  // Living factors in order of arrival.
  const std::vector<FactorNode>& Factors() const { return factors_; }
  const FactorNode* FindFactor(FactorId id) const;
  bool HasPose(PoseId id) const { return index_.count(id.value) != 0; }
  // Index into Poses(). Throws std::invalid_argument if the pose is unknown.
  int IndexOf(PoseId id) const;

 private:
  std::vector<PoseNode> poses_;
  std::unordered_map<std::int64_t, int> index_;
  std::vector<FactorNode> factors_;  // ascending ids
  std::int64_t next_factor_id_ = 0;
};

// The pose or poses a factor touches: {from, to}, or {pose}.
struct FactorPoses {
  PoseId first, second;
  int count = 1;
};
template <class Pose>
FactorPoses PosesOf(const Factor<Pose>& factor);

// The cause if a factor's numbers are unusable (see AddFactor), else empty.
template <class Pose>
std::string FindDefect(const Factor<Pose>& factor);

bool IsFinite(const SE2& T);
bool IsFinite(const SE3& T);

// chi2 = sum of r' Omega r over all factors at the graph's pose values (no 1/2).
// Throws std::invalid_argument if a pose has no value.
template <class Pose>
double Chi2(const PoseGraph<Pose>& graph);

// Connected components as lists of pose indices, largest first.
template <class Pose>
std::vector<std::vector<int>> ConnectedComponents(const PoseGraph<Pose>& graph);

extern template class PoseGraph<SE2>;
extern template class PoseGraph<SE3>;

}  // namespace terse
