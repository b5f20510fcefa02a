// A compact map exported as a value, restored and continued.

#include "terse/compact/compact_map.h"

#include <gtest/gtest.h>

#include "terse/core/error.h"
#include "testing_compact.h"

namespace terse {
namespace {

using testing::Random;

// A graph, the run over it and its options.
template <class Pose>
struct Course {
  explicit Course(std::uint64_t seed, Strategy strategy = Strategy::kFpfl, bool priors = false, int poses = 60)
      : rng(seed) {
    testing::RandomGraphOptions scene_options;
    scene_options.poses = poses;
    scene_options.noise = 0.05;
    scene_options.id_stride = 3;
    scene_options.priors = priors;
    graph = testing::MakeRandomGraph<Pose>(rng, scene_options).graph;
    if (priors) graph.SetFixed(graph.Poses()[static_cast<std::size_t>(poses / 3)].id, true);
    replay.emplace(graph);
    options = testing::OptionsFor(*replay, strategy);
    options.thresholds.min_loop_gain = 0.3;
    options.thresholds.min_pose_gain = 2.5;
  }
  Decision Add(CompactPoseSlam<Pose>& slam, std::size_t k) const { return slam.AddPose(replay->Inputs()[k]); }
  CompactPoseSlam<Pose> Run(std::size_t end) const {
    CompactPoseSlam<Pose> slam(options);
    for (std::size_t k = 0; k < end; ++k) Add(slam, k);
    return slam;
  }
  Random rng;
  PoseGraph<Pose> graph;
  std::optional<GraphReplay<Pose>> replay;
  CompactOptions<Pose> options;
};

template <class Pose>
class CompactMapTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactMapTest, Groups);

void ExpectSame(const Decision& a, const Decision& b) {
  EXPECT_EQ(a.verdict, b.verdict);
  ASSERT_EQ(a.candidates.size(), b.candidates.size());
  for (std::size_t k = 0; k < a.candidates.size(); ++k) {
    const Candidate &c = a.candidates[k], &d = b.candidates[k];
    EXPECT_EQ(c.id, d.id);
    EXPECT_EQ(c.accepted, d.accepted);
    EXPECT_EQ(c.factor.has_value(), d.factor.has_value()) << "restored factors are numbered anew";
    EXPECT_NEAR(c.gain, d.gain, 1e-7 * (1 + std::abs(c.gain)));
    if (c.innovation) {
      EXPECT_NEAR(*c.innovation, d.innovation.value_or(-1), 1e-6 * (1 + *c.innovation));
    }
  }
}

template <class Pose>
void ExpectSamePoses(const CompactPoseSlam<Pose>& a, const CompactPoseSlam<Pose>& b, double tolerance,
                     double tolerance_when_seen = 0) {
  for (const Recovery recovery : {Recovery::kV0, Recovery::kV1, Recovery::kV2}) {
    const auto of_a = a.Trajectory(recovery), of_b = b.Trajectory(recovery);
    ASSERT_EQ(of_a.size(), of_b.size());
    for (std::size_t k = 0; k < of_a.size(); ++k) {
      EXPECT_EQ(of_a[k].id, of_b[k].id);
      EXPECT_EQ(of_a[k].kept, of_b[k].kept);
      const double most = recovery == Recovery::kV0 ? std::max(tolerance, tolerance_when_seen) : tolerance;
      EXPECT_LT(testing::Distance(of_a[k].T_world_body, of_b[k].T_world_body), most) << "pose " << k;
    }
  }
}

// Where the run that goes on stood at its optimum too, the two are the same but for rounding. One
// Finish ends at a step worth 1e-11 of chi2, which is short of that.
TYPED_TEST(CompactMapTest, ContinuesAsTheRunItCameFrom) {
  using Pose = TypeParam;
  for (const Strategy strategy : {Strategy::kFpfl, Strategy::kApfl, Strategy::kApal}) {
    for (const bool priors : {false, true}) {
      SCOPED_TRACE(std::string(Name(strategy)) + (priors ? ", priors" : ""));
      const Course<Pose> course(priors ? 2 : 1, strategy, priors);
      CompactPoseSlam<Pose> running = course.Run(30);
      for (int k = 0; k < 8; ++k) running.Finish();
      auto restored = CompactPoseSlam<Pose>::Restore(running.Export(), course.options);
      EXPECT_EQ(restored.PosesSeen(), 30);
      EXPECT_EQ(restored.LinksKept(), running.LinksKept());
      ExpectSamePoses(running, restored, 1e-9);
      for (std::size_t k = 30; k < 60; ++k) {
        SCOPED_TRACE("pose " + std::to_string(k));
        // What is deferred, and when it is made up for, depends on how long a run has been.
        for (int again = 0; again < 4; ++again) {
          running.Finish();
          restored.Finish();
        }
        ExpectSame(course.Add(running, k), course.Add(restored, k));
        if (::testing::Test::HasFailure()) return;
      }
      for (int again = 0; again < 4; ++again) {
        running.Finish();
        restored.Finish();
      }
      // A step ends within the solver's tolerances.
      ExpectSamePoses(running, restored, 1e-7, 1e-6);
      const auto a = running.Finish(), b = restored.Finish();
      EXPECT_NEAR(a.chi2, b.chi2, 1e-9 * a.chi2);
    }
  }
}

// A run that never stopped has other linearisation points meanwhile, so gains differ a little; what it keeps does not.
TYPED_TEST(CompactMapTest, KeepsWhatTheUninterruptedRunKeeps) {
  using Pose = TypeParam;
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE(seed);
    const Course<Pose> course(seed, Strategy::kFpfl, seed % 2 == 0);
    CompactPoseSlam<Pose> whole = course.Run(60);
    const CompactPoseSlam<Pose> half = course.Run(35);
    auto restored = CompactPoseSlam<Pose>::Restore(half.Export(), course.options);
    for (std::size_t k = 35; k < 60; ++k) course.Add(restored, k);
    EXPECT_EQ(restored.LinksKept(), whole.LinksKept());
    const double chi2 = whole.Finish().chi2;
    EXPECT_NEAR(restored.Finish().chi2, chi2, 1e-8 * chi2);
    for (std::size_t k = 0; k < 60; ++k) {
      const PoseId id = course.replay->Inputs()[k].id;
      EXPECT_EQ(whole.KeptBase(id), restored.KeptBase(id));
      EXPECT_LT(testing::Distance(whole.Estimate(id), restored.Estimate(id)), 1e-6);
    }
  }
}

TYPED_TEST(CompactMapTest, HoldsTheMapAndWhereItsEdgesComeFrom) {
  using Pose = TypeParam;
  const Course<Pose> course(3, Strategy::kFpfl, true);
  CompactPoseSlam<Pose> slam = course.Run(60);
  slam.Finish();
  const CompactMap<Pose> map = slam.Export();
  EXPECT_EQ(FindDefect(map), "");
  const auto trajectory = slam.Trajectory();
  ASSERT_EQ(map.poses.size(), trajectory.size());
  std::map<std::int64_t, RelativePoseFactor<Pose>> odometry;
  for (const auto& input : course.replay->Inputs()) {
    if (input.odometry) odometry[input.id.value] = *input.odometry;
  }
  for (std::size_t k = 0; k < map.poses.size(); ++k) {
    EXPECT_EQ(map.poses[k].id, trajectory[k].id);
    EXPECT_EQ(map.poses[k].T_world_body.Log(), trajectory[k].T_world_body.Log());
    EXPECT_EQ(map.poses[k].base, slam.KeptBase(trajectory[k].id));
  }
  const auto& graph = slam.Solver().Graph();
  EXPECT_EQ(map.edges.size() + map.priors.size(), graph.Factors().size());
  int loops = 0, composed = 0;
  for (const auto& edge : map.edges) {
    ASSERT_NE(graph.FindFactor(edge.factor), nullptr);
    EXPECT_EQ(std::get<RelativePoseFactor<Pose>>(graph.FindFactor(edge.factor)->factor).T_from_to.Log(),
              edge.measured.T_from_to.Log());
    EXPECT_TRUE(edge.added_at == edge.measured.from || edge.added_at == edge.measured.to);
    EXPECT_EQ(edge.gain.has_value(), edge.is_loop);
    loops += edge.is_loop;
    if (edge.composed_of.empty()) continue;
    ++composed;
    EXPECT_FALSE(edge.is_loop);
    EXPECT_EQ(edge.composed_of.front(), edge.measured.from);
    EXPECT_EQ(edge.composed_of.back(), edge.measured.to);
    Pose T;
    for (std::size_t k = 1; k < edge.composed_of.size(); ++k) {
      const PoseId before = edge.composed_of[k - 1], id = edge.composed_of[k];
      T = T * SeenFrom(before, odometry.at(id.value)).T_a_b;
      if (k + 1 < edge.composed_of.size()) {
        EXPECT_NE(slam.KeptBase(id), id) << "only the ends are kept";
      }
    }
    EXPECT_LT(testing::Distance(T, edge.measured.T_from_to), 1e-9);
  }
  EXPECT_EQ(loops, slam.LinksKept());
  EXPECT_GT(composed, 0);
  EXPECT_EQ(map.fixed.size(), 1u);
  EXPECT_GT(map.priors.size(), 0u);
}

// Links that came late or went, and those that were refused.
TEST(CompactMapLinksTest, LateRemovedAndRefusedOnes) {
  const testing::SlippingCircle course;
  for (std::size_t saved_at = 21; saved_at < 23; ++saved_at) {
    SCOPED_TRACE(saved_at);
    CompactPoseSlam<SE2> running(course.options);
    for (std::size_t k = 0; k < saved_at; ++k) running.AddPose(course.inputs[k], course.registration);
    running.Finish();
    if (running.LinksKept() == 0) {
      EXPECT_FALSE(running.Export().refused.empty());
    }
    auto restored = CompactPoseSlam<SE2>::Restore(running.Export(), course.options);
    int supported = 0;
    for (std::size_t k = saved_at; k < course.inputs.size(); ++k) {
      const Decision decision = running.AddPose(course.inputs[k], course.registration);
      ExpectSame(decision, restored.AddPose(course.inputs[k], course.registration));
      for (const Candidate& c : decision.candidates) supported += c.supported;
    }
    EXPECT_GT(supported, 0) << "what was refused before supports what comes after";
    const auto edges = running.Export().edges;
    const auto found = std::find_if(edges.rbegin(), edges.rend(), [](const auto& edge) { return edge.is_loop; });
    ASSERT_NE(found, edges.rend());
    const auto link = *found;
    running.RemoveLink(link.factor);
    RelativePoseFactor<SE2> late{PoseId{3}, PoseId{23},
                                 running.Estimate(PoseId{3}).Inverse() * running.Estimate(PoseId{23}),
                                 link.measured.information};
    const LinkDecision decision = running.AddLink(late);
    ASSERT_TRUE(decision.accepted);
    const auto map = running.Export();
    EXPECT_EQ(map.edges.back().factor, *decision.factor);
    EXPECT_EQ(map.edges.back().added_at, PoseId{29}) << "the last pose seen, though no end of it";
    EXPECT_EQ(*map.edges.back().gain, decision.gain);
    // The gap that the removed one left is closed.
    const auto again = CompactPoseSlam<SE2>::Restore(map, course.options).Export();
    ASSERT_EQ(again.edges.size(), map.edges.size());
    for (std::size_t k = 0; k < again.edges.size(); ++k) {
      EXPECT_EQ(again.edges[k].factor.value, static_cast<std::int64_t>(k));
      EXPECT_EQ(again.edges[k].measured.from, map.edges[k].measured.from);
      EXPECT_EQ(again.edges[k].is_loop, map.edges[k].is_loop);
    }
  }
}

TYPED_TEST(CompactMapTest, NothingAndOnePose) {
  using Pose = TypeParam;
  const CompactOptions<Pose> options;
  auto empty = CompactPoseSlam<Pose>::Restore(CompactPoseSlam<Pose>(options).Export(), options);
  EXPECT_EQ(empty.PosesSeen(), 0);
  CompactInput<Pose> first;
  first.id = PoseId{7};
  empty.AddPose(first, nullptr);
  const auto one = CompactPoseSlam<Pose>::Restore(empty.Export(), options);
  EXPECT_EQ(one.PosesSeen(), 1);
  EXPECT_TRUE(one.HasSeen(PoseId{7}));
}

TYPED_TEST(CompactMapTest, ContradictionsAreNamed) {
  using Pose = TypeParam;
  using Map = CompactMap<Pose>;
  const Course<Pose> course(2, Strategy::kFpfl, true);
  const Map good = course.Run(60).Export();
  std::size_t dropped = 1, loop = 0;
  while (good.poses[dropped].kept || !good.poses[dropped].next_kept) ++dropped;
  while (loop == 0 || !good.edges[loop].is_loop) ++loop;
  const auto expect = [&](const std::string& where, const std::function<void(Map&)>& spoil) {
    Map map = good;
    spoil(map);
    EXPECT_EQ(FindDefect(map).rfind(where + ": ", 0), 0u) << where << " but: " << FindDefect(map);
    EXPECT_THROW(CompactPoseSlam<Pose>::Restore(map, course.options), std::invalid_argument) << where;
  };
  const std::string at = "poses[" + std::to_string(dropped) + "].", of = "edges[" + std::to_string(loop) + "].";
  const double nan = std::numeric_limits<double>::quiet_NaN();
  expect(at + "id", [&](Map& m) { m.poses[dropped].id = m.poses[0].id; });
  expect(at + "base", [&](Map& m) { m.poses[dropped].base = m.poses[dropped].id; });
  expect(at + "previous", [&](Map& m) { m.poses[dropped].previous = PoseId{-99}; });
  expect(at + "previous", [&](Map& m) { m.poses[dropped].previous.reset(); });
  expect(at + "covariance", [&](Map& m) { m.poses[dropped].T_base_pose.covariance(0, 0) = nan; });
  expect(at + "covariance", [&](Map& m) { m.poses[dropped].T_base_pose.covariance(0, 1) += 1; });
  expect(at + "next_kept", [&](Map& m) { m.poses[dropped].next_kept = m.poses[dropped].id; });
  expect("poses[0].kept", [&](Map& m) { m.poses[0].kept = false; });
  expect("poses[0].previous", [&](Map& m) { m.poses[0].previous = m.poses[1].id; });
  expect(of + "from", [&](Map& m) { m.edges[loop].measured.from = m.poses[dropped].id; });
  expect(of + "to", [&](Map& m) { m.edges[loop].measured.to = PoseId{-99}; });
  expect(of + "added_at", [&](Map& m) { m.edges[loop].added_at = PoseId{-99}; });
  expect(of + "measurement", [&](Map& m) { m.edges[loop].measured.information(0, 0) = -1; });
  expect(of + "factor", [&](Map& m) { m.edges[loop].factor = m.edges[0].factor; });
  expect("priors[0].pose", [&](Map& m) {
    m.priors[0].measured = PosePriorFactor<Pose>{PoseId{-99}, Pose(), Pose::Jacobian::Identity()};
  });
  expect("fixed[1].pose", [&](Map& m) { m.fixed.push_back(m.fixed[0]); });
  expect("refused[0].seen", [&](Map& m) { m.refused.insert(m.refused.begin(), {m.poses[0].id, PoseId{-99}, {}}); });
  // A kept pose that nothing holds is found by the solver.
  Map loose = good;
  loose.edges.clear();
  loose.priors.clear();
  EXPECT_THROW(CompactPoseSlam<Pose>::Restore(loose, course.options), NumericalError);
}

// The new part of a graph, whether the rest is there again or not.
TYPED_TEST(CompactMapTest, AReplayOfWhatIsNew) {
  using Pose = TypeParam;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    SCOPED_TRACE(seed);
    const Course<Pose> course(seed, Strategy::kFpfl, true);
    const auto& inputs = course.replay->Inputs();
    std::vector<PoseId> seen;
    for (std::size_t k = 0; k < 40; ++k) seen.push_back(inputs[k].id);
    const auto is_seen = [&](PoseId id) { return std::find(seen.begin(), seen.end(), id) != seen.end(); };
    PoseGraph<Pose> part;
    for (const auto& node : course.graph.Factors()) {
      const FactorPoses ends = PosesOf(node.factor);
      if (is_seen(ends.first) && (ends.count == 1 || is_seen(ends.second))) continue;
      for (const PoseId id : {ends.first, ends.count == 2 ? ends.second : ends.first}) {
        if (part.HasPose(id)) continue;
        const auto& known = course.graph.Poses()[static_cast<std::size_t>(course.graph.IndexOf(id))];
        part.AddPose(id, known.T_world_body);
        part.SetFixed(id, known.fixed);
      }
      part.AddFactor(node.factor);
    }
    const PoseGraph<Pose>* const graphs[] = {&course.graph, &part};
    for (const PoseGraph<Pose>* graph : graphs) {
      GraphReplay<Pose> rest(*graph, seen);
      ASSERT_EQ(rest.Inputs().size(), 20u);
      const auto registration = rest.AsRegistration();
      for (std::size_t k = 0; k < 20; ++k) {
        const auto &a = rest.Inputs()[k], &b = inputs[40 + k];
        EXPECT_EQ(a.id, b.id);
        EXPECT_EQ(a.fixed, b.fixed);
        EXPECT_EQ(a.priors.size(), b.priors.size());
        ASSERT_TRUE(a.odometry.has_value());
        EXPECT_EQ(a.odometry->from, b.odometry->from);
        EXPECT_EQ(a.odometry->to, b.odometry->to);
        EXPECT_EQ(*a.linkable, *b.linkable);
        for (const PoseId id : *a.linkable) EXPECT_TRUE(registration(id, a.id).has_value());
      }
    }
  }
  const Course<Pose> course(1);
  std::vector<PoseId> all, none = {PoseId{-5}};
  for (const auto& input : course.replay->Inputs()) all.push_back(input.id);
  EXPECT_TRUE(GraphReplay<Pose>(course.graph, all).Inputs().empty());
  EXPECT_THROW((GraphReplay<Pose>(course.graph, none)), std::invalid_argument) << "nothing joins them";
}

}  // namespace
}  // namespace terse
