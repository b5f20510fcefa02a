#pragma once
// Compact runs of random structure whose kept and dropped poses are chosen, and the graph in which the dropped poses
// are poses like all others: an oracle for what is said about them.

#include <optional>
#include <vector>

#include "terse/compact/compact_pose_slam.h"
#include "testing.h"

namespace terse::testing {

struct ChainOptions {
  int poses = 45;
  double keep = 0.25;    // probability of a pose to be kept
  double branch = 0.25;  // that its odometry comes from one of the last eight poses, kept or dropped
  double link = 0.5;     // of a link, for each kept pose
  double prior = 0, fixed = 0;
  // Without it a chain that goes on from a dropped pose of one that has ended does not end itself: the next kept pose
  // starts from the kept one before.
  bool shared_odometry = false;
  double noise = 0;  // of measurements, in standard deviations
  double deviation = 0.01;
  CompositionOrder composition = CompositionOrder::kFirst;
};

template <class Pose>
class Chains {
 public:
  static constexpr int B = Pose::kDof;

  Chains(std::uint64_t seed, const ChainOptions& options) : options_(options), rng_(seed), slam_(SlamOptions()) {
    for (int k = 0; k < options.poses; ++k) AddPose(k);
  }

  CompactPoseSlam<Pose>& Slam() { return slam_; }
  int Size() const { return static_cast<int>(truth_.size()); }
  PoseId Id(int k) const { return PoseId{3 * k + 5}; }
  bool IsKept(int k) const { return kept_[At(k)]; }
  int Parent(int k) const { return parent_[At(k)]; }
  // The kept pose at which the chain of a dropped one ended first, its own or that of one it hangs on; -1 if none.
  int End(int k) const {
    while (!kept_[At(k)] && end_[At(k)] < 0) k = Parent(k);
    return end_[At(k)];
  }
  const Pose& Truth(int k) const { return truth_[At(k)]; }

  // With pose k at index k. A chain that ends after another has ended that led through some of its poses is a chain of
  // its own, as to the map: it has copies of these, behind the others.
  PoseGraph<Pose> Oracle() const {
    PoseGraph<Pose> graph = others_;
    for (int k = 1; k < Size(); ++k) {
      if (!kept_[At(k)] && end_[At(k)] < 0) graph.AddFactor(odometry_[At(k)]);
      if (!kept_[At(k)]) continue;
      PoseId id = Id(k);
      for (int c = k, p = Parent(k);; c = p, p = Parent(p)) {
        const bool copied = !kept_[At(p)] && end_[At(p)] != k;
        PoseId other = Id(p);
        if (copied) {
          other = PoseId{-1 - static_cast<std::int64_t>(graph.Poses().size())};
          graph.AddPose(other, truth_[At(p)]);
        }
        RelativePoseFactor<Pose> edge = odometry_[At(c)];
        (edge.from == Id(c) ? edge.from : edge.to) = id;
        (edge.from == Id(p) ? edge.from : edge.to) = other;
        graph.AddFactor(edge);
        id = other;
        if (kept_[At(p)]) break;
      }
    }
    return graph;
  }

 private:
  static std::size_t At(int k) { return static_cast<std::size_t>(k); }
  CompactOptions<Pose> SlamOptions() const {
    CompactOptions<Pose> options;
    options.strategy = Strategy::kGiven;  // keeps what it is told to
    options.composition = options_.composition;
    return options;
  }
  bool Happens(double probability) { return Uniform(rng_, 0, 1) < probability; }

  RelativePoseFactor<Pose> Measure(int i, int j) {
    if (rng_() % 2 == 0) std::swap(i, j);
    const typename Pose::Tangent n = options_.noise * options_.deviation * NormalVector<B>(rng_);
    return {Id(i), Id(j), truth_[At(i)].Inverse() * truth_[At(j)] * Pose().Retract(n).Inverse(),
            RandomInformation<B>(rng_, 1 / (options_.deviation * options_.deviation))};
  }

  void AddPose(int k) {
    bool keep = k == 0 || Happens(options_.keep), is_shared = false;
    int parent = k - 1;
    if (k > 1 && Happens(options_.branch)) parent -= static_cast<int>(rng_() % At(std::min(k, 8)));
    for (int p = parent; p >= 0 && !kept_[At(p)]; p = Parent(p)) is_shared = is_shared || end_[At(p)] >= 0;
    if (keep && is_shared && !options_.shared_odometry) {
      while (!kept_[At(parent)]) parent = Parent(parent);
    }
    parent_.push_back(parent);
    truth_.push_back(k == 0 ? RandomMotion<Pose>(rng_, 5, 1) : truth_[At(parent)] * RandomMotion<Pose>(rng_, 1, 0.3));
    kept_.push_back(keep);
    end_.push_back(-1);
    for (int p = parent; keep && p >= 0 && !kept_[At(p)] && end_[At(p)] < 0; p = Parent(p)) end_[At(p)] = k;

    CompactInput<Pose> input;
    input.id = Id(k);
    input.T_world_body = truth_.back();
    input.fixed = keep && Happens(options_.fixed);
    input.keep = keep;
    others_.AddPose(Id(k), truth_.back());
    others_.SetFixed(Id(k), input.fixed);
    odometry_.push_back(k == 0 ? RelativePoseFactor<Pose>() : Measure(parent, k));
    if (k > 0) input.odometry = odometry_.back();
    if (keep && Happens(options_.prior)) {
      input.priors.push_back(PosePriorFactor<Pose>{Id(k), truth_.back(), RandomInformation<B>(rng_, 1e3)});
      others_.AddFactor(input.priors.back());
    }
    input.linkable.emplace();
    std::optional<RelativePoseFactor<Pose>> link;
    if (keep && k > 0 && Happens(options_.link)) {
      int other = static_cast<int>(rng_() % At(k));
      while (!kept_[At(other)]) --other;
      link = Measure(other, k);
      others_.AddFactor(*link);
      input.linkable->push_back(Id(other));
    }
    slam_.AddPose(input, [&](PoseId, PoseId) { return link; });
  }

  ChainOptions options_;
  Random rng_;
  std::vector<Pose> truth_;
  std::vector<int> parent_, end_;
  std::vector<bool> kept_;
  std::vector<RelativePoseFactor<Pose>> odometry_;  // by its newer pose
  PoseGraph<Pose> others_;                          // all poses; links, priors
  CompactPoseSlam<Pose> slam_;
};

}  // namespace terse::testing
