#pragma once
// Laps of a closed course with many loops between them, for tests of Strategy::kBounded; and where each of a map's
// measurements comes from, worked out anew from the measurements of the poses themselves.

#include <algorithm>
#include <map>
#include <set>
#include <stdexcept>
#include <utility>
#include <vector>

#include "simulation.h"
#include "terse/compact/compact_map.h"
#include "testing_compact.h"
#include "testing_files.h"
#include "testing_state.h"

namespace terse::testing {

struct LapsOptions {
  int laps = 4, per_lap = 30;
  double loops = 0.5;                    // the share of those in reach that is measured
  double noise = 1;                      // 0: exact measurements, with the same covariances
  double metres = 0.03, radians = 0.01;  // of a measurement
};

// An ellipse of about a metre per pose, which in space rises and banks; no two laps lead through the same poses. Ids
// are 0, 1, ...; no two edges join the same poses. Loops lead to poses of an earlier lap within 1.5 m.
template <class Pose>
RandomGraph<Pose> MakeLaps(std::uint64_t seed, const LapsOptions& options = {}) {
  constexpr int B = Pose::kDof;
  Random rng(seed);
  RandomGraph<Pose> out;
  const double radius = options.per_lap / (2 * M_PI);
  const auto measure = [&](int i, int j) {
    Vector<B> scale = Vector<B>::Constant(1 / options.radians);
    scale.template head<Pose::kDim>().setConstant(1 / options.metres);
    const Matrix<B, B> A = scale.asDiagonal() * RandomInformation<B>(rng, 0.5) * scale.asDiagonal();
    const Matrix<B, B> information = (A + A.transpose()) / 2;
    const Eigen::Matrix<double, B, B> L = CholeskyFactor(information);
    const Vector<B> n = L.transpose().template triangularView<Eigen::Upper>().solve(
        Eigen::Matrix<double, B, 1>(options.noise * NormalVector<B>(rng)));
    const Pose T = out.truth[static_cast<std::size_t>(i)].Inverse() * out.truth[static_cast<std::size_t>(j)];
    out.graph.AddFactor(RelativePoseFactor<Pose>{PoseId{i}, PoseId{j}, Measured(T, n), information});
  };
  for (int k = 0; k < options.laps * options.per_lap; ++k) {
    const double u = 2 * M_PI * k / options.per_lap;
    typename Pose::Tangent jitter = 0.05 * NormalVector<B>(rng);
    Pose T;
    if constexpr (B == 3) {
      T = SE2(1.2 * radius * std::sin(u), -0.8 * radius * std::cos(u),
              std::atan2(0.8 * std::sin(u), 1.2 * std::cos(u)));
    } else {
      Vector<6> d = Vector<6>::Zero(), bank = Vector<6>::Zero();
      d.template head<3>() << 1.2 * radius * std::sin(u), -0.8 * radius * std::cos(u), 0.3 * std::sin(2 * u);
      bank << 0, 0, 0, 0.2 * std::sin(u), 0.1 * std::cos(u), 0;
      Vector<6> turn = Vector<6>::Zero();
      turn[5] = std::atan2(0.8 * std::sin(u), 1.2 * std::cos(u));
      T = SE3::Exp(d) * SE3::Exp(turn) * SE3::Exp(bank);
    }
    out.truth.push_back(k == 0 ? T : T * Pose().Retract(jitter));
    out.graph.AddPose(PoseId{k}, out.truth.back());
    if (k > 0) measure(k - 1, k);
    for (int i = 0; i <= k - options.per_lap / 2; ++i) {
      const Pose T_i_k = out.truth[static_cast<std::size_t>(i)].Inverse() * out.truth.back();
      if (T_i_k.Translation().norm() > 1.5 || Uniform(rng, 0, 1) > options.loops) continue;
      rng() % 2 == 0 ? measure(i, k) : measure(k, i);
    }
  }
  return out;
}

// 0.5 and 0.9 nats per degree of freedom, as SelectThresholds has at least.
template <class Pose>
CompactOptions<Pose> BoundedOptions(const GraphReplay<Pose>& replay) {
  CompactOptions<Pose> options = OptionsFor(replay, Strategy::kBounded);
  options.thresholds.min_loop_gain = 0.5 * Pose::kDof;
  options.thresholds.min_pose_gain = 0.9 * Pose::kDof;
  return options;
}

// A run over laps, with what it decided.
template <class Pose>
struct Laps {
  explicit Laps(std::uint64_t seed, const LapsOptions& laps = {}, Strategy strategy = Strategy::kBounded)
      : scene(MakeLaps<Pose>(seed, laps)), replay(scene.graph), options(BoundedOptions<Pose>(replay)) {
    options.strategy = strategy;
    options.record = Record::kDecisions;
  }
  CompactPoseSlam<Pose> Run() {
    CompactPoseSlam<Pose> slam(options);
    for (const auto& input : replay.Inputs()) decisions.push_back(slam.AddPose(input));
    return slam;
  }
  RandomGraph<Pose> scene;
  GraphReplay<Pose> replay;
  CompactOptions<Pose> options;
  std::vector<Decision> decisions;
};

template <class Pose>
CompactPoseSlam<Pose> Copy(const CompactPoseSlam<Pose>& slam) {
  const TestFile file("copy.state");
  slam.Save(file.Path());
  return CompactPoseSlam<Pose>::Load(file.Path());
}

// All that can be seen of a map, to the last bit.
template <class Pose>
std::string Picture(const CompactPoseSlam<Pose>& slam) {
  std::string out = Bits(slam.LinksKept()) + Bits(slam.Solver().Chi2()) + Bits(slam.Solver().LogDeterminant());
  const CompactMap<Pose> map = slam.Export();
  for (const auto& p : map.poses) {
    out += Bits(p.id) + Bits(p.kept) + Bits(p.T_world_body) + Bits(p.base) + Bits(p.T_base_pose.T_a_b);
    out += Bits(p.next_kept) + Bits(p.anchored_to) + Bits(p.ended_by) + Bits(p.carried);
  }
  for (const auto& e : map.edges) {
    out += Bits(e.factor) + Bits(e.measured.T_from_to) + Bits(e.is_loop) + Bits(e.added_at) + Bits(e.gain);
    for (const auto& part : e.parts) out += Bits(part.id) + Bits(part.T_from_to.T_a_b) + Bits(part.measurements);
  }
  return out + Bits(map.refused.size()) + Bits(map.failed.size());
}

// A map beside the graph that it was made from, which joins no two poses twice.
template <class Pose>
class Provenance {
 public:
  using Seen = typename CompactMap<Pose>::SeenPose;
  using Part = typename CompactMap<Pose>::Part;
  using Pair = std::pair<PoseId, PoseId>;  // the smaller id first

  Provenance(const PoseGraph<Pose>& graph, CompactMap<Pose> map) : map_(std::move(map)) {
    for (const auto& node : graph.Factors()) {
      const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
      if (edge != nullptr && !raw_.emplace(Ordered(edge->from, edge->to), *edge).second)
        throw std::logic_error("two edges join the same poses");
    }
    for (const Seen& seen : map_.poses) seen_[seen.id] = &seen;
  }
  static Pair Ordered(PoseId a, PoseId b) { return b < a ? Pair(b, a) : Pair(a, b); }
  const CompactMap<Pose>& Map() const { return map_; }
  const Seen& Find(PoseId id) const { return *seen_.at(id); }
  // The pose that the chain of this one comes from.
  PoseId Parent(PoseId id) const {
    const Seen& seen = Find(id);
    return seen.anchored_to ? *seen.anchored_to : *seen.previous;
  }
  const RelativePoseFactor<Pose>& Raw(PoseId a, PoseId b) const { return raw_.at(Ordered(a, b)); }

  // The poses from `id` back to the first of these that its chain leads through, both included. Poses that came back
  // since then are no end of it.
  std::vector<PoseId> Back(PoseId id, const std::set<PoseId>& ends) const {
    std::vector<PoseId> out = {id};
    while (ends.count(out.back()) == 0) out.push_back(Parent(out.back()));
    return out;
  }
  // What is measured from the first pose to the last, along all of them.
  UncertainPose<Pose> Along(const std::vector<PoseId>& path) const {
    UncertainPose<Pose> out;
    for (std::size_t k = 1; k < path.size(); ++k) {
      out = Compose(out, SeenFrom(path[k - 1], Raw(path[k - 1], path[k])));
    }
    return out;
  }
  // The poses between which a part of an edge was measured, from the smaller id of its ends to the larger.
  std::vector<PoseId> PathOf(const Part& part, const Pair& pair) const {
    const std::set<PoseId> ends = {pair.first, pair.second};
    std::vector<PoseId> there, back;
    if (part.links.size() == 2) {
      there = Back(part.links[0], ends);
      back = Back(part.links[1], ends);
    } else if (part.links.size() == 1) {
      there = Back(*Find(part.added_at).previous, ends);
      back = Back(part.links[0], ends);
    } else {
      throw std::logic_error("a part that no link composed");
    }
    std::reverse(there.begin(), there.end());
    there.push_back(part.added_at);
    there.insert(there.end(), back.begin(), back.end());
    if (there.front() != pair.first) std::reverse(there.begin(), there.end());
    return there;
  }

 private:
  CompactMap<Pose> map_;
  std::map<PoseId, const Seen*> seen_;
  std::map<Pair, RelativePoseFactor<Pose>> raw_;
};

}  // namespace terse::testing
