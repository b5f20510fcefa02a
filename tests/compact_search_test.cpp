// The search of Algorithm 1 against an exhaustive one: every kept pose, covariances of the graph with the new pose in
// it.

#include <gtest/gtest.h>

#include <deque>

#include "terse/compact/information.h"
#include "terse/compact/pose_index.h"
#include "terse/core/chi_square.h"
#include "terse/covariance/marginals.h"
#include "testing_compact.h"

namespace terse {
namespace {

using testing::Random;

struct Expected {
  double probability = 0, gain = 0, worth = 0;
  double distance = 0;  // squared, of the range
};

// All poses of the solver's graph but `current` itself, seen from it. `current` hangs on `base` by a chain, or is it.
template <class Pose>
std::map<std::int64_t, Expected> Search(const PoseGraph<Pose>& graph, const std::vector<Pose>& points,
                                        const std::vector<Pose>& estimates, PoseId current, PoseId base,
                                        const UncertainPose<Pose>& T_base_current,
                                        const CompactOptions<Pose>& options) {
  std::map<std::int64_t, Expected> out;
  const Marginals<Pose> marginals(graph, points);
  const auto estimate = [&](PoseId id) { return estimates[static_cast<std::size_t>(graph.IndexOf(id))]; };
  for (const auto& node : graph.Poses()) {
    if (node.id == current) continue;
    UncertainPose<Pose> seen;
    if (node.id != base) {
      // Covariances belong together at the linearisation points.
      const auto point = [&](PoseId id) { return points[static_cast<std::size_t>(graph.IndexOf(id))]; };
      const Pose T_point = point(node.id).Inverse() * point(base);
      seen.T_a_b = estimate(node.id).Inverse() * estimate(base);
      seen.covariance =
          MoveCovariance<Pose>(RelativeCovariance<Pose>(T_point, marginals.Marginal(node.id),
                                                        marginals.Cross(node.id, base), marginals.Marginal(base)),
                               T_point, seen.T_a_b);
    }
    seen = Compose(seen, T_base_current);
    const auto displacement = ComputeDisplacement<Pose>(seen, options.distance);
    const auto within = RangeProbabilities<Pose>(displacement, options.thresholds.range);
    const double gain = InformationGain<Pose::kDof>(seen.covariance, options.thresholds.link_covariance);
    out[node.id.value] = {within.minCoeff(), gain, gain * within.prod(),
                          DistanceToRange<Pose>(displacement, options.thresholds.range)};
  }
  return out;
}

// The anchor's 1e8 takes eight digits of the covariances of poses near it, the two ways sum in different orders. With
// priors the two anchors may hold other directions, which shows where linearisation points disagree a little.
constexpr double kRelativeWithoutPriors = 1e-6, kRelativeWithPriors = 1e-4;

// Follows a run: the chain of the newest pose, from the decisions.
template <class Pose>
class Follower {
 public:
  Follower(GraphReplay<Pose>& replay, CompactOptions<Pose> options)
      : options_(AllRecorded(options)), slam_(options_), registration_(replay.AsRegistration()) {
    for (CompactInput<Pose> input : replay.Inputs()) {
      if (::testing::Test::HasFatalFailure()) return;
      if (!input.priors.empty()) relative_ = kRelativeWithPriors;
      input.loops.reset();
      Step(input);
    }
  }
  int compared = 0, dropped = 0, links = 0, steps = 0;
  long kept_at_steps = 0, visited_at_steps = 0;

 private:
  struct Chain {
    PoseId base;
    UncertainPose<Pose> T_base_pose;
  };
  static CompactOptions<Pose> AllRecorded(CompactOptions<Pose> options) {
    options.most_recorded = 1 << 20;
    options.max_registrations = 1 << 20;
    return options;
  }

  void Step(const CompactInput<Pose>& input) {
    SCOPED_TRACE("pose " + std::to_string(input.id.value));
    if (!input.odometry) {
      slam_.AddPose(input, registration_);
      chains_[input.id.value] = {input.id, {}};
      return;
    }
    const PoseId previous = input.odometry->from == input.id ? input.odometry->to : input.odometry->from;
    Chain chain = chains_.at(previous.value);
    const bool direct = chain.base == previous;
    chain.T_base_pose = Compose(chain.T_base_pose, SeenFrom(previous, *input.odometry));
    auto graph = slam_.Solver().Graph();
    auto points = slam_.Solver().LinearizationPoints(), estimates = slam_.Solver().Estimates();
    const auto base = static_cast<std::size_t>(graph.IndexOf(chain.base));
    const Pose& T_base_pose = chain.T_base_pose.T_a_b;
    graph.AddPose(input.id);
    graph.AddFactor(RelativePoseFactor<Pose>{chain.base, input.id, T_base_pose, Information(chain.T_base_pose)});
    points.push_back(points[base] * T_base_pose);
    estimates.push_back(estimates[base] * T_base_pose);
    estimates_before_.clear();
    for (std::size_t i = 0; i + 1 < estimates.size(); ++i) estimates_before_[graph.Poses()[i].id.value] = estimates[i];
    seen_before_.clear();
    for (const auto& pose : slam_.Trajectory(Recovery::kV1)) seen_before_[pose.id.value] = pose.T_world_body;
    const auto before = Search(graph, points, estimates, input.id, chain.base, chain.T_base_pose, options_);

    std::optional<PoseId> first_tried;
    std::vector<std::pair<PoseId, PoseId>> failed_now;
    const auto decision = slam_.AddPose(input, [&](PoseId candidate, PoseId current) {
      if (!first_tried) first_tried = candidate;
      auto link = registration_(candidate, current);
      if (!link) failed_now.push_back({candidate, current});
      return link;
    });
    kept_at_steps += static_cast<long>(before.size());
    ++steps;
    CheckPrefilter(before, graph, points, estimates, chain);
    links += decision.links_accepted;
    dropped += decision.Kept() ? 0 : 1;
    CheckBefore(before, decision, first_tried, direct ? std::optional<PoseId>(previous) : std::nullopt,
                estimates.back());
    for (const auto& pair : failed_now) failed_.push_back(pair);
    while (failed_.size() > 256) failed_.pop_front();
    if (decision.links_accepted > 0) CheckAfter(input.id, before, decision);
    chains_[input.id.value] = decision.Kept() ? Chain{input.id, {}} : chain;
  }

  // The bound that the search leaves poses out by, with the covariances of the exhaustive one: no candidate is outside.
  void CheckPrefilter(const std::map<std::int64_t, Expected>& before, const PoseGraph<Pose>& graph,
                      const std::vector<Pose>& points, const std::vector<Pose>& estimates, const Chain& chain) {
    const Marginals<Pose> marginals(graph, points);
    std::vector<typename PoseIndex<Pose>::Item> items;
    for (std::size_t i = 0; i + 1 < estimates.size(); ++i) {
      const PoseId id = graph.Poses()[i].id;
      const Spread spread = id == chain.base ? Spread() : Spread::Of<Pose>(marginals.Relative(id, chain.base));
      items.push_back({estimates[i].Translation(), spread});
    }
    PoseIndex<Pose> index;
    index.Build(std::move(items));
    const double length = chain.T_base_pose.T_a_b.Translation().norm();
    const Spread own = Spread::Of<Pose>(chain.T_base_pose.covariance);
    const double deviations =
        std::max(DeviationsBeyondRange(options_.thresholds.probability), std::sqrt(MostDistance()));
    const auto reach = [&](const Spread& spread) {
      return options_.thresholds.range.template head<Pose::kDim>().norm() +
             std::sqrt(1.0 * Pose::kDim) * deviations * spread.Behind(length, own).metres;
    };
    std::set<std::int64_t> visited;
    index.VisitNear(estimates.back().Translation(), reach,
                    [&](int i) { visited.insert(graph.Poses()[static_cast<std::size_t>(i)].id.value); });
    for (const auto& [id, e] : before) {
      if (!IsCandidate(e)) continue;
      ASSERT_EQ(visited.count(id), 1u) << "candidate " << id;
    }
    visited_at_steps += static_cast<long>(visited.size());
  }

  bool InRange(const Expected& e) const { return e.probability > options_.thresholds.probability; }
  bool IsCandidate(const Expected& e) const { return InRange(e) || e.distance <= MostDistance(); }
  double MostDistance() const { return ChiSquareQuantile(options_.plausible_quantile, Displacement<Pose>::kSize); }
  bool Close(const Expected& e) const {
    return std::abs(e.probability - options_.thresholds.probability) < relative_ ||
           std::abs(e.distance - MostDistance()) < 1e-4 * MostDistance();
  }
  // A registration failed lately within a quarter of the range of both ends.
  bool FailedNear(PoseId candidate, const Pose& T_world_current) const {
    const auto are_near = [&](const Pose& a, const Pose& b) {
      const auto apart = DisplacementMean<Pose>(a.Inverse() * b, options_.distance);
      return (apart.cwiseAbs().array() <= options_.failed_neighbourhood * options_.thresholds.range.array()).all();
    };
    return std::any_of(failed_.begin(), failed_.end(), [&](const auto& f) {
      return are_near(estimates_before_.at(f.first.value), estimates_before_.at(candidate.value)) &&
             are_near(seen_before_.at(f.second.value), T_world_current);
    });
  }

  void CheckBefore(const std::map<std::int64_t, Expected>& before, const Decision& decision,
                   std::optional<PoseId> first_tried, std::optional<PoseId> linked, const Pose& T_world_current) {
    double least = 1e300, most = -1;
    for (const auto& [id, e] : before) {
      if (!IsCandidate(e)) continue;
      if (InRange(e)) least = std::min(least, e.gain);
      if (linked && id == linked->value) continue;
      if (e.gain > options_.thresholds.min_loop_gain && !FailedNear(PoseId{id}, T_world_current))
        most = std::max(most, e.worth);
    }
    ASSERT_EQ(decision.pose_gain.has_value(), least < 1e300);
    if (decision.pose_gain) {
      ASSERT_NEAR(*decision.pose_gain, least, relative_ * (1 + least));
    }
    if (first_tried) {
      ASSERT_NEAR(before.at(first_tried->value).worth, most, relative_ * (1 + most)) << "the best is tried first";
    } else {
      ASSERT_EQ(most, -1);
    }
    if (decision.links_accepted == 0) Compare(before, decision.candidates, {});
  }

  // What was left after the last accepted link, in the graph as it is now.
  void CheckAfter(PoseId current, const std::map<std::int64_t, Expected>& before, const Decision& decision) {
    const auto& solver = slam_.Solver();
    auto after = Search(solver.Graph(), solver.LinearizationPoints(), solver.Estimates(), current, current,
                        UncertainPose<Pose>(), options_);
    for (const auto& [id, e] : before) {
      if (!IsCandidate(e)) after.erase(id);
    }
    std::vector<Candidate> rest;
    std::set<std::int64_t> tried;
    for (const Candidate& c : decision.candidates) {
      // Those tried, in vain or not, keep the numbers they were tried with.
      if (c.tried) {
        ASSERT_TRUE(IsCandidate(before.at(c.id.value)) || Close(before.at(c.id.value)));
        tried.insert(c.id.value);
      } else {
        rest.push_back(c);
      }
    }
    // With a second link, a candidate that the first had moved out of range may be in range again: it is not looked
    // for.
    if (decision.links_accepted > 1) {
      std::set<std::int64_t> found;
      for (const Candidate& c : rest) found.insert(c.id.value);
      for (auto it = after.begin(); it != after.end();) it = found.count(it->first) == 0 ? after.erase(it) : ++it;
    }
    Compare(after, rest, tried);
  }

  void Compare(const std::map<std::int64_t, Expected>& expected, const std::vector<Candidate>& candidates,
               const std::set<std::int64_t>& without) {
    std::map<std::int64_t, Candidate> found;
    for (const Candidate& c : candidates) ASSERT_TRUE(found.emplace(c.id.value, c).second) << "twice";
    for (const auto& [id, e] : expected) {
      if (without.count(id) != 0 || Close(e)) continue;
      ASSERT_EQ(found.count(id), IsCandidate(e) ? 1u : 0u) << "candidate " << id << " of probability " << e.probability;
      if (!IsCandidate(e)) continue;
      ASSERT_NEAR(found[id].probability, e.probability, relative_ * e.probability);
      ASSERT_NEAR(found[id].gain, e.gain, relative_ * (1 + e.gain));
      ++compared;
    }
  }

  static typename Pose::Jacobian Information(const UncertainPose<Pose>& chain) {
    const typename Pose::Jacobian information = testing::Inverse(chain.covariance);
    return (information + information.transpose()) / 2;
  }

  CompactOptions<Pose> options_;
  double relative_ = kRelativeWithoutPriors;
  CompactPoseSlam<Pose> slam_;
  Registration<Pose> registration_;
  std::map<std::int64_t, Chain> chains_;
  std::deque<std::pair<PoseId, PoseId>> failed_;                 // registrations: candidate, pose at hand
  std::map<std::int64_t, Pose> estimates_before_, seen_before_;  // of kept poses; of all
};

template <class Pose>
class CompactSearchTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactSearchTest, Groups);

TYPED_TEST(CompactSearchTest, FindsWhatAnExhaustiveSearchFindsOnRandomGraphs) {
  int compared = 0, links = 0, dropped = 0;
  for (std::uint64_t seed = 1; seed <= 12; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random rng(seed);
    testing::RandomGraphOptions graph;
    graph.poses = 45;
    graph.loops_per_pose = 0.3;
    graph.id_stride = 3;
    graph.priors = seed % 4 == 0;
    GraphReplay<TypeParam> replay(testing::MakeRandomGraph<TypeParam>(rng, graph).graph);
    auto options = testing::OptionsFor(replay, Strategy::kFpfl);
    options.thresholds.range *= seed % 3 == 0 ? 0.2 : 0.5;
    options.thresholds.range[TypeParam::kDim] = seed % 2 == 0 ? 3.1 : 1;
    options.thresholds.probability = seed % 5 == 0 ? 0.6 : seed % 5 == 1 ? 0.001 : 0.1;
    options.thresholds.min_loop_gain = 0.1;
    options.thresholds.min_pose_gain = 1.5;
    const Follower<TypeParam> run(replay, options);
    compared += run.compared;
    links += run.links;
    dropped += run.dropped;
    if (::testing::Test::HasFatalFailure()) return;
  }
  EXPECT_GT(compared, 1000);
  EXPECT_GT(links, 30);
  EXPECT_GT(dropped, 20);
}

template <class Pose>
void ExpectExhaustiveOn(const PoseGraph<Pose>& graph, double share_of_range, double min_loop_gain, double min_pose_gain,
                        double most_visited = 1) {
  GraphReplay<Pose> replay(graph);
  auto options = testing::OptionsFor(replay, Strategy::kFpfl);
  options.thresholds.range *= share_of_range;
  options.thresholds.min_loop_gain = min_loop_gain;
  options.thresholds.min_pose_gain = min_pose_gain;
  options.failed_neighbourhood = 0.05;  // a file links few of the poses that are close
  const Follower<Pose> run(replay, options);
  EXPECT_GT(run.compared, 150);
  EXPECT_GT(run.links, 3);
  EXPECT_GT(run.dropped, 5);
  EXPECT_EQ(run.steps + 1, static_cast<int>(graph.Poses().size())) << "on every step";
  EXPECT_LT(run.compared, run.kept_at_steps) << "some poses were out of range";
  EXPECT_LE(run.compared, run.visited_at_steps);
  EXPECT_LE(static_cast<double>(run.visited_at_steps), most_visited * static_cast<double>(run.kept_at_steps))
      << "and some of them were not even looked at";
}

TEST(CompactSearchScenes, FindsWhatAnExhaustiveSearchFinds) {
  ExpectExhaustiveOn(testing::MakeScene<SE3>(Scene::kEllipse, 0, 1).graph, 1, 1, 3);
  ExpectExhaustiveOn(testing::MakeScene<SE2>(Scene::kManhattan, 200, 1).graph, 1.5, 1, 2, 0.95);
  ExpectExhaustiveOn(testing::MakeScene<SE2>(Scene::kManhattan, 300, 3).graph, 0.6, 1, 2, 0.75);
  ExpectExhaustiveOn(testing::MakeScene<SE3>(Scene::kGarage, 150, 1).graph, 8, 1, 8);
}

// Priors take over from the anchor that held the frame, and what the anchor told is lost: bounds must not outlive it.
TEST(CompactSearchScenes, FindsWhatAnExhaustiveSearchFindsWithPositionPriors) {
  for (const std::uint64_t seed : testing::Seeds(1, 10)) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random rng(seed);
    PoseGraph<SE3> graph;
    SE3 truth;
    for (int k = 0; k < 40; ++k) {
      const SE3 step = testing::RandomMotion<SE3>(rng, 1, 0.3);
      graph.AddPose(PoseId{k});
      if (k > 0) {
        truth = truth * step;
        graph.AddFactor(
            RelativePoseFactor<SE3>{PoseId{k - 1}, PoseId{k}, step, testing::RandomInformation<6>(rng, 100)});
      }
      if (k % 12 == 8)
        graph.AddFactor(PositionPriorFactor<SE3>{PoseId{k}, truth.Translation(), 1e6 * Matrix<3, 3>::Identity()});
    }
    GraphReplay<SE3> replay(graph);
    auto options = testing::OptionsFor(replay, Strategy::kFpfl);
    options.thresholds.range = Vector<4>(2, 2, 2, 1);
    options.thresholds.min_pose_gain = 1;
    const Follower<SE3> run(replay, options);
    EXPECT_GT(run.compared, 20);
  }
}

// Odometry need not come from the pose before: an older one, kept or dropped, starts a branch.
TYPED_TEST(CompactSearchTest, FindsWhatAnExhaustiveSearchFindsOnATree) {
  for (const double probability : {0.1, 0.6}) {
    Random rng(31);
    PoseGraph<TypeParam> graph;
    std::vector<TypeParam> truth;
    for (int k = 0; k < 60; ++k) {
      const int from = k % 6 == 0 && k > 0 ? static_cast<int>(rng() % static_cast<unsigned>(k)) : k - 1;
      truth.push_back(k == 0 ? TypeParam()
                             : truth[static_cast<std::size_t>(from)] * testing::RandomMotion<TypeParam>(rng, 0.5, 0.3));
      graph.AddPose(PoseId{k});
      if (k == 0) continue;
      graph.AddFactor(RelativePoseFactor<TypeParam>{PoseId{from}, PoseId{k},
                                                    truth[static_cast<std::size_t>(from)].Inverse() * truth.back(),
                                                    testing::RandomInformation<TypeParam::kDof>(rng, 300)});
    }
    GraphReplay<TypeParam> replay(graph);
    auto options = testing::OptionsFor(replay, Strategy::kFpfl);
    options.thresholds.range.setConstant(1.5);
    options.thresholds.probability = probability;
    options.thresholds.min_pose_gain = 2;
    const Follower<TypeParam> run(replay, options);
    EXPECT_GT(run.compared, 100);
    EXPECT_GT(run.dropped, 3);
  }
}

}  // namespace
}  // namespace terse
