// Where dropped poses of a bounded map are and how well that is known, beside the dense inverse of the graph in which
// they are poses like all others.
//
// As to the map every chain is one of its own, with the link that ends it: what other chains share with it comes a
// second time. A chain and the kept poses at its ends are what the map knows of these, and how the chain lies between
// them given where they are: the chain's own measurements less what they tell of its ends.

#include <gtest/gtest.h>

#include <cstdio>

#include "terse/core/linear_factor.h"
#include "testing_bounded.h"

namespace terse {
namespace {

using testing::AddDense;
using testing::DenseSystem;
using testing::Laps;
using testing::LapsOptions;
using testing::Provenance;
using testing::RelativeError;

template <class Pose>
class CompactBoundedCovarianceTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactBoundedCovarianceTest, Groups);

template <class Pose>
class Oracle {
 public:
  static constexpr int B = Pose::kDof;
  using Jacobian = typename Pose::Jacobian;
  // A chain ends where a kept pose came in, or with a link of a pose.
  using End = std::pair<PoseId, std::optional<PoseId>>;

  // Values: of all poses seen.
  Oracle(const CompactPoseSlam<Pose>& slam, const Provenance<Pose>& provenance, std::vector<Pose> values)
      : provenance_(provenance), values_(std::move(values)) {
    for (const auto& pose : provenance.Map().poses) graph_.AddPose(pose.id);
    for (const auto& node : slam.Solver().Graph().Factors()) graph_.AddFactor(node.factor);
    for (const auto& pose : provenance.Map().poses) {
      if (pose.kept) continue;
      if (!pose.next_kept) {
        Add(pose.id, provenance.Parent(pose.id), pose.id, provenance.Parent(pose.id));
      } else if (ends_.insert({*pose.next_kept, pose.ended_by}).second) {
        AddChain(pose);
      }
    }
    DenseSystem less = testing::MakeDenseSystem(graph_, values_);
    for (const auto& known : known_) Subtract(known, less);
    Sigma_ = testing::Inverse(less.H);
  }

  Jacobian Marginal(PoseId id) const { return Block(Index(id), Index(id)); }
  Jacobian Relative(PoseId id_a, PoseId id_b) const {
    const int a = Index(id_a), b = Index(id_b);
    const Jacobian A = (At(b).Inverse() * At(a)).Adjoint();
    return A * Block(a, a) * A.transpose() + Block(b, b) - A * Block(a, b) - Block(b, a) * A.transpose();
  }
  // The chain that a dropped pose hangs on, its own or that of one before it that has ended.
  std::optional<End> EndOf(PoseId id) const {
    while (!provenance_.Find(id).kept && !provenance_.Find(id).next_kept) id = provenance_.Parent(id);
    const auto& pose = provenance_.Find(id);
    return pose.kept ? std::nullopt : std::optional<End>({*pose.next_kept, pose.ended_by});
  }
  int Ends() const { return static_cast<int>(ends_.size()); }

 private:
  int Index(PoseId id) const { return graph_.IndexOf(id); }
  const Pose& At(int k) const { return values_[static_cast<std::size_t>(k)]; }
  Jacobian Block(int a, int b) const { return Sigma_.block<B, B>(B * a, B * b); }

  // What was measured between two poses, between these in the graph.
  void Add(PoseId a, PoseId b, PoseId in_graph_a, PoseId in_graph_b) {
    RelativePoseFactor<Pose> edge = provenance_.Raw(a, b);
    const bool forwards = edge.from == a;
    edge.from = forwards ? in_graph_a : in_graph_b;
    edge.to = forwards ? in_graph_b : in_graph_a;
    graph_.AddFactor(edge);
  }
  PoseId CopyOf(PoseId id) {
    const PoseId copy{-1 - static_cast<std::int64_t>(values_.size())};
    graph_.AddPose(copy);
    values_.push_back(values_[static_cast<std::size_t>(Index(id))]);
    return copy;
  }
  // From `id`, which is `in_graph` there, back to the kept pose where its chain starts. Poses of this end are
  // themselves, others copies.
  void AddBack(PoseId id, PoseId in_graph, const std::optional<End>& end) {
    while (!provenance_.Find(id).kept || id == start_) {
      const PoseId parent = provenance_.Parent(id);
      const auto& seen = provenance_.Find(parent);
      const bool is_own = seen.kept || (end && seen.next_kept == end->first && seen.ended_by == end->second);
      const PoseId other = is_own ? parent : CopyOf(parent);
      Add(id, parent, in_graph, other);
      start_ = PoseId{-1};
      id = parent;
      in_graph = other;
    }
  }
  void AddChain(const typename CompactMap<Pose>::SeenPose& pose) {
    const PoseId next = *pose.next_kept;
    if (pose.base != next) known_.push_back({pose.base, next, pose.T_base_next});
    const End end{next, pose.ended_by};
    if (!pose.ended_by) {
      start_ = next;  // a kept one, of which the chain is what it came in with
      AddBack(next, next, end);
      return;
    }
    // The pose whose link ended the chain hangs on another one by now: here it is a copy between odometry and link.
    const PoseId by = *pose.ended_by, copy = CopyOf(by);
    const PoseId previous = *provenance_.Find(by).previous, linked = *provenance_.Find(by).anchored_to;
    const auto join = [&](PoseId other, const std::optional<End>& of) {
      const auto& seen = provenance_.Find(other);
      const bool is_own = seen.kept || (of && seen.next_kept == of->first && seen.ended_by == of->second);
      const PoseId in_graph = is_own ? other : CopyOf(other);
      Add(by, other, copy, in_graph);
      AddBack(other, in_graph, of);
    };
    join(previous, end);
    join(linked, std::nullopt);
  }
  struct Known {
    PoseId base, next;
    UncertainPose<Pose> T_base_next;
  };
  void Subtract(const Known& known, DenseSystem& system) const {
    const Eigen::MatrixXd own = testing::Inverse(known.T_base_next.covariance);
    const RelativePoseFactor<Pose> edge{known.base, known.next, known.T_base_next.T_a_b, (own + own.transpose()) / 2};
    DenseSystem of_edge{Eigen::MatrixXd::Zero(system.H.rows(), system.H.cols()),
                        Eigen::VectorXd::Zero(system.b.size())};
    const int a = Index(known.base), b = Index(known.next);
    AddDense(of_edge, Linearize<Pose>(edge, a, b, At(a), At(b)));
    system.H -= of_edge.H;
  }

  const Provenance<Pose>& provenance_;
  std::vector<Pose> values_;
  PoseGraph<Pose> graph_;
  std::set<End> ends_;
  std::vector<Known> known_;
  PoseId start_{-1};
  Eigen::MatrixXd Sigma_;
};

// Exact measurements: estimates are the true poses and first order is all there is.
TYPED_TEST(CompactBoundedCovarianceTest, EqualsTheGraphWithAllPoses) {
  using Pose = TypeParam;
  double worst = 0, worst_relative = 0;
  int dropped = 0, by_link = 0, behind = 0, carried = 0, pairs = 0;
  for (const std::uint64_t seed : {1U, 2U, 6U}) {  // a slow build's too: one has few loops that came along a chain
    SCOPED_TRACE(seed);
    LapsOptions options;
    options.noise = 0;
    options.laps = 3;
    options.per_lap = 20;
    Laps<Pose> laps(seed, options);
    const CompactPoseSlam<Pose> slam = laps.Run();
    const Provenance<Pose> provenance(laps.scene.graph, slam.Export());
    for (const Recovery recovery : {Recovery::kV1, Recovery::kV2}) {
      for (const auto& pose : slam.Trajectory(recovery)) {
        EXPECT_LT(testing::Distance(pose.T_world_body, laps.scene.truth[static_cast<std::size_t>(pose.id.value)]), 1e-7)
            << pose.id.value;
      }
    }
    const Oracle<Pose> oracle(slam, provenance, laps.scene.truth);
    for (const auto& pose : provenance.Map().poses) {
      if (pose.id == PoseId{0}) continue;
      const double error = RelativeError(slam.Covariance(pose.id), oracle.Marginal(pose.id));
      EXPECT_LT(error, 1e-6) << pose.id.value;
      worst = std::max(worst, error);
      dropped += !pose.kept;
      by_link += pose.ended_by.has_value();
      behind += !pose.kept && !pose.next_kept;
      carried += pose.anchored_to && !provenance.Find(*pose.anchored_to).kept;
      // Chains that share measurements, which the oracle has twice, aside.
      for (const auto& other : provenance.Map().poses) {
        if (!(other.id < pose.id)) continue;
        const bool both = !pose.kept && !other.kept;
        if (both && (oracle.EndOf(pose.id) != oracle.EndOf(other.id) || !oracle.EndOf(pose.id))) continue;
        const double relative =
            RelativeError(slam.RelativeCovariance(other.id, pose.id), oracle.Relative(other.id, pose.id));
        EXPECT_LT(relative, 1e-6) << other.id.value << ", " << pose.id.value;
        worst_relative = std::max(worst_relative, relative);
        pairs += both;
      }
    }
  }
  EXPECT_GT(dropped, 30);
  EXPECT_GT(by_link, 15);
  EXPECT_GT(carried, 1);
  EXPECT_GT(pairs, 20);
  std::printf(
      "marginal %.1e, relative %.1e; %d dropped, %d on chains that a link ended, %d behind the last, %d carried\n",
      worst, worst_relative, dropped, by_link, behind, carried);
}

}  // namespace
}  // namespace terse
