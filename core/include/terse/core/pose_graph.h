#pragma once
// The measurement graph: poses by user id, factors by stable id.
//
// Pose is SE2 or SE3. Poses keep their order of insertion: a pose's index in Poses() never changes.
// Every information matrix is full, in the tangent order of the pose ([rho; phi], metres and radians). One that was
// never set is zero, and refused by that name.
// A graph is a value; concurrent reads are safe.

#include <cstddef>
#include <cstdint>
#include <iterator>
#include <optional>
#include <string>
#include <unordered_map>
#include <variant>
#include <vector>

#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse {

namespace internal {
struct StateAccess;
}

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
  typename Pose::Jacobian information = Pose::Jacobian::Zero();
};

// Measures T_world_body. Residual Local(measured^-1 * T_world_body).
template <class Pose>
struct PosePriorFactor {
  PoseId pose;
  Pose T_world_body;
  typename Pose::Jacobian information = Pose::Jacobian::Zero();
};

// Measures where a point of the body is in the world, as GNSS does. Residual T_world_body * p_body - p_world, world
// frame; p_body is the lever arm, as of an antenna, and the body's origin unless it is given.
template <class Pose>
struct PositionPriorFactor {
  PoseId pose;
  typename Pose::Position p_world = Pose::Position::Zero();
  Matrix<Pose::kDim, Pose::kDim> information = Matrix<Pose::kDim, Pose::kDim>::Zero();
  typename Pose::Position p_body = Pose::Position::Zero();
};

template <class Pose>
using Factor = std::variant<RelativePoseFactor<Pose>, PosePriorFactor<Pose>, PositionPriorFactor<Pose>>;

template <class Pose>
struct FactorNode {
  FactorId id;
  Factor<Pose> factor;
};

// Factors in order of arrival, from which any can go. A removed one leaves a gap, which no access shows; the gaps are
// closed when they are more than the living. So Remove is O(log n) amortised, and references live until then only.
template <class Pose>
class FactorList {
 public:
  using Node = FactorNode<Pose>;
  class Iterator {
   public:
    using iterator_category = std::forward_iterator_tag;
    using value_type = Node;
    using difference_type = std::ptrdiff_t;
    using pointer = const Node*;
    using reference = const Node&;
    Iterator() = default;
    Iterator(const FactorList& list, std::size_t at) : list_(&list), at_(at) { SkipGaps(); }
    reference operator*() const { return list_->nodes_[at_]; }
    pointer operator->() const { return &list_->nodes_[at_]; }
    Iterator& operator++() {
      ++at_;
      SkipGaps();
      return *this;
    }
    Iterator operator++(int) {
      const Iterator before = *this;
      ++*this;
      return before;
    }
    friend bool operator==(const Iterator& a, const Iterator& b) { return a.at_ == b.at_; }
    friend bool operator!=(const Iterator& a, const Iterator& b) { return a.at_ != b.at_; }

   private:
    void SkipGaps() {
      while (at_ < list_->nodes_.size() && list_->is_gap_[at_]) ++at_;
    }
    const FactorList* list_ = nullptr;
    std::size_t at_ = 0;
  };

  std::size_t size() const { return nodes_.size() - gaps_; }
  bool empty() const { return size() == 0; }
  Iterator begin() const { return Iterator(*this, 0); }
  Iterator end() const { return Iterator(*this, nodes_.size()); }
  // The k-th living factor. O(1) while there are no gaps, else O(log n).
  const Node& operator[](std::size_t k) const { return nodes_[gaps_ == 0 ? k : PositionOf(k)]; }
  const Node& at(std::size_t k) const;  // throws std::out_of_range
  const Node& back() const { return (*this)[size() - 1]; }
  // O(log n); nullptr if it is not there.
  const Node* Find(FactorId id) const;

  // The id must be above all before.
  void Append(FactorId id, const Factor<Pose>& factor);
  bool Remove(FactorId id);

 private:
  friend struct internal::StateAccess;
  template <class Archive>
  void Serialize(Archive& archive);  // state_file.h, as in the classes below
  std::size_t PositionOf(std::size_t k) const;
  void CloseGaps();

  std::vector<Node> nodes_;  // ascending ids
  std::vector<bool> is_gap_;
  std::vector<int> gap_counts_;  // Fenwick tree over is_gap_
  std::size_t gaps_ = 0;
};

template <class Pose>
class PoseGraph {
 public:
  struct PoseNode {
    PoseId id;
    std::optional<Pose> T_world_body;  // absent when a file names the pose in edges only
    bool fixed = false;                // FIX in a file: anchored at its value
  };
  using FactorNode = terse::FactorNode<Pose>;

  // Throws std::invalid_argument if the id is taken or the value is not finite.
  void AddPose(PoseId id, const std::optional<Pose>& T_world_body = std::nullopt);
  // Throws std::invalid_argument if the pose is unknown.
  void SetPose(PoseId id, const Pose& T_world_body);
  // Gives every pose a value, by pose index, as solvers return them. Throws std::invalid_argument, leaving the graph as
  // it was, if there is not one finite value per pose.
  void SetPoses(const std::vector<Pose>& T_world_body);
  // A copy with these values.
  PoseGraph WithPoses(const std::vector<Pose>& T_world_body) const;
  void SetFixed(PoseId id, bool fixed);

  // Throws std::invalid_argument, leaving the graph as it was, if a pose is unknown, an edge joins a pose to
  // itself, a number is not finite, or the information is not symmetric positive definite.
  FactorId AddFactor(const Factor<Pose>& factor);
  // Gives it this id, and the next one those above. Throws besides if the id is below NextFactorId.
  FactorId AddFactor(const Factor<Pose>& factor, FactorId id);
  // False if there is no such factor (any more). O(log n) amortised.
  bool RemoveFactor(FactorId id);
  // The id that the next factor gets.
  FactorId NextFactorId() const { return {next_factor_id_}; }

  const std::vector<PoseNode>& Poses() const { return poses_; }
  // Living factors in order of arrival.
  const FactorList<Pose>& Factors() const { return factors_; }
  const FactorNode* FindFactor(FactorId id) const { return factors_.Find(id); }
  bool HasPose(PoseId id) const { return index_.count(id.value) != 0; }
  // Index into Poses(). Throws std::invalid_argument if the pose is unknown.
  int IndexOf(PoseId id) const;

 private:
  friend struct internal::StateAccess;
  template <class Archive>
  void Serialize(Archive& archive);

  std::vector<PoseNode> poses_;
  std::unordered_map<std::int64_t, int> index_;
  FactorList<Pose> factors_;
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

extern template class FactorList<SE2>;
extern template class FactorList<SE3>;
extern template class PoseGraph<SE2>;
extern template class PoseGraph<SE3>;

}  // namespace terse
