// Thresholds chosen from a sample against graphs to which the links are really added, and the random baseline.

#include "terse/compact/thresholds.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "terse/compact/information.h"
#include "terse/compact/random_choice.h"
#include "terse/core/outliers.h"
#include "terse/covariance/marginals.h"
#include "testing_compact.h"

namespace terse {
namespace {

using testing::Random;

// What a sample of all poses and links tells, from a graph that the links are added to one after the other.
template <class Pose>
struct Recorded {
  std::vector<double> loop_gains, pose_gains;
};

template <class Pose>
class Recorder {
 public:
  explicit Recorder(const PoseGraph<Pose>& graph) : replay_(graph), Sigma_y_(replay_.LinkCovariance()), slam_(All()) {}

  Recorded<Pose> Record(const std::vector<long>& looked_at) {
    for (long k = 0; !looked_at.empty() && k <= looked_at.back(); ++k) {
      const auto& input = replay_.Inputs()[static_cast<std::size_t>(k)];
      if (k > 0 && std::binary_search(looked_at.begin(), looked_at.end(), k)) Look(input);
      slam_.AddPose(input);
    }
    return out_;
  }

 private:
  static CompactOptions<Pose> All() {
    CompactOptions<Pose> options;
    options.strategy = Strategy::kApal;
    return options;
  }
  UncertainPose<Pose> Seen(const PoseGraph<Pose>& graph, const std::vector<Pose>& points, PoseId from,
                           PoseId to) const {
    const auto at = [&](PoseId id) { return points[static_cast<std::size_t>(graph.IndexOf(id))]; };
    const Marginals<Pose> marginals(graph, points);
    return {at(from).Inverse() * at(to), marginals.Relative(from, to)};
  }
  double Gain(const UncertainPose<Pose>& T) const { return InformationGain<Pose::kDof>(T.covariance, Sigma_y_); }

  void Look(const CompactInput<Pose>& input) {
    const PoseId base = input.odometry->from == input.id ? input.odometry->to : input.odometry->from;
    const UncertainPose<Pose> T_base_n = SeenFrom(base, *input.odometry);
    auto graph = slam_.Solver().Graph();
    auto points = slam_.Solver().LinearizationPoints();
    points.push_back(points[static_cast<std::size_t>(graph.IndexOf(base))] * T_base_n.T_a_b);
    graph.AddPose(input.id);
    graph.AddFactor(*input.odometry);
    double least = Gain(T_base_n);
    std::vector<PoseId> left = *input.linkable;
    for (const PoseId loop : left) {
      const auto T = Seen(graph, points, loop, input.id);
      least = std::min(least, Gain(T));
    }
    out_.pose_gains.push_back(least);
    const typename Pose::Jacobian inverse = testing::Inverse(Sigma_y_),
                                  information = (inverse + inverse.transpose()) / 2;
    while (!left.empty()) {
      std::vector<double> gains;
      for (const PoseId loop : left) gains.push_back(Gain(Seen(graph, points, loop, input.id)));
      const auto best = std::max_element(gains.begin(), gains.end());
      const auto which = left.begin() + (best - gains.begin());
      out_.loop_gains.push_back(*best);
      const Pose T = Seen(graph, points, *which, input.id).T_a_b;
      graph.AddFactor(RelativePoseFactor<Pose>{*which, input.id, T, information});
      left.erase(which);
    }
  }

  GraphReplay<Pose> replay_;
  typename Pose::Jacobian Sigma_y_;
  CompactPoseSlam<Pose> slam_;
  Recorded<Pose> out_;
};

// 90 % are not above it.
double Percentile90(std::vector<double> values) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(std::lround(0.9 * static_cast<double>(values.size() - 1)))];
}

double Raise(double gain, double power) { return std::pow(gain + 1, power) - 1; }

// The formulas and bounds of the header.
template <class Pose>
void ExpectFormulas(const SampledThresholds<Pose>& t) {
  constexpr int kDof = Pose::kDof;
  const double loop = std::min(std::max(Raise(t.loop_gain_90, 1.36), 0.5 * kDof), 1.5 * kDof);
  EXPECT_NEAR(t.thresholds.min_loop_gain, loop, 1e-12 * loop);
  const double pose = std::max({Raise(t.pose_gain_90, 1.7), 0.9 * kDof, 0.9 * loop});
  EXPECT_NEAR(t.thresholds.min_pose_gain, pose, 1e-12 * pose);
}

template <class Pose>
void ExpectAsRecorded(const PoseGraph<Pose>& graph, double share, double tolerance) {
  SCOPED_TRACE("share " + std::to_string(share));
  SampleOptions options;
  options.strategy = Strategy::kFpfl;
  options.share = share;
  const auto chosen = SelectThresholds(graph, options);
  ASSERT_EQ(chosen.sample_poses, std::lround(share * static_cast<double>(graph.Poses().size())));
  const auto looked_at = SamplePositions(static_cast<long>(graph.Poses().size()), chosen.sample_poses);
  const auto recorded = Recorder<Pose>(graph).Record(looked_at);
  ASSERT_EQ(static_cast<std::size_t>(chosen.sample_loops), recorded.loop_gains.size()) << "none is left out";
  const double loop = Percentile90(recorded.loop_gains), pose = Percentile90(recorded.pose_gains);
  // Below 0.05 nat gains are not told apart.
  EXPECT_NEAR(chosen.loop_gain_90, loop, loop < 0.05 ? 0.05 : tolerance * loop);
  EXPECT_NEAR(chosen.pose_gain_90, pose, tolerance * pose + 1e-12);
  ExpectFormulas(chosen);
  const GraphReplay<Pose> replay(graph);
  EXPECT_TRUE(chosen.thresholds.link_covariance == replay.LinkCovariance());
  EXPECT_TRUE(chosen.thresholds.range == replay.LinkRange());
}

template <class Pose>
class ThresholdsTest : public ::testing::Test {
 public:
  static testing::RandomGraph<Pose> Scene(std::uint64_t seed, double noise = 0.02) {
    Random rng(seed);
    testing::RandomGraphOptions options;
    options.poses = 36;
    options.loops_per_pose = 0.9;
    options.noise = noise;
    options.id_stride = 2;
    return testing::MakeRandomGraph<Pose>(rng, options);
  }
};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(ThresholdsTest, Groups);

// The anchor's 1e8 takes eight digits of the covariances near it.
TYPED_TEST(ThresholdsTest, AreThoseOfLinksReallyAdded) {
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const auto graph = testing::WithoutNoise(this->Scene(seed));
    for (const double share : {0.1, 0.35, 0.6, 1.0}) ExpectAsRecorded(graph, share, 1e-5);
  }
}

// Estimates and linearisation points are not quite the same.
TYPED_TEST(ThresholdsTest, AreThoseOfLinksReallyAddedWithNoise) {
  ExpectAsRecorded(this->Scene(5, 0.05).graph, 0.8, 0.02);
}

TEST(ThresholdsScenes, AreThoseOfLinksReallyAdded) {
  ExpectAsRecorded(testing::WithoutNoise(testing::MakeScene<SE2>(Scene::kManhattan, 150)), 0.6, 1e-5);
  ExpectAsRecorded(testing::WithoutNoise(testing::MakeScene<SE3>(Scene::kSphere, 120)), 0.9, 1e-5);
}

// Wrong loops that the innovation test refuses leave no trace in the thresholds but in LinkRange, which tests nothing.
// Believed, they do.
template <class Pose>
void ExpectNoTraceOfWrongLoops(const testing::RandomGraph<Pose>& scene, double percent) {
  const PoseGraph<Pose> clean = testing::WithoutNoise(scene);
  const auto with = AddWrongLoops(clean, scene.truth, percent, 3);
  ASSERT_GT(with.wrong.size(), 5u);
  SampleOptions options;
  options.share = 1;
  const auto expected = SelectThresholds(clean, options), believed = SelectThresholds(with.graph, options);
  options.innovation_quantile = 0.9999;
  const auto same = SelectThresholds(clean, options), tested = SelectThresholds(with.graph, options);
  EXPECT_TRUE(same.thresholds.range == expected.thresholds.range) << "of true loops none is refused";
  EXPECT_EQ(same.loop_gain_90, expected.loop_gain_90);
  EXPECT_EQ(same.pose_gain_90, expected.pose_gain_90);
  EXPECT_NEAR(tested.loop_gain_90, expected.loop_gain_90, 1e-6 * expected.loop_gain_90);
  EXPECT_NEAR(tested.pose_gain_90, expected.pose_gain_90, 1e-6 * expected.pose_gain_90);
  EXPECT_GT(believed.loop_gain_90, 1.05 * expected.loop_gain_90);
}

TEST(ThresholdsScenes, WrongLoopsAreLeftOut) {
  ExpectNoTraceOfWrongLoops(testing::MakeScene<SE2>(Scene::kManhattan, 150), 10);
  ExpectNoTraceOfWrongLoops(testing::MakeScene<SE3>(Scene::kSphere, 120), 10);
}

// Of each part of the run one pose, the last parts too.
TEST(SamplePositionsTest, AreSpreadOverTheRun) {
  for (const long poses : {1L, 7L, 100L, 100003L}) {
    for (const long count : {0L, 1L, 5L, poses / 2, poses}) {
      if (count > poses) continue;
      const auto at = SamplePositions(poses, count);
      ASSERT_EQ(static_cast<long>(at.size()), count);
      for (long k = 0; k < count; ++k) {
        EXPECT_GE(at[static_cast<std::size_t>(k)], k * poses / count);
        EXPECT_LT(at[static_cast<std::size_t>(k)], (k + 1) * poses / count);
      }
      EXPECT_EQ(at, SamplePositions(poses, count)) << "the same ones every time";
    }
  }
}

// On lap after lap a pose has ever more links: what is looked at and what joins the map does not grow with them, and
// what is chosen is what a look at every pose would choose.
TEST(ThresholdsScenes, ManyLinksCostNoMore) {
  PoseGraph<SE3> graph;
  GenerateOptions generate;
  generate.scene = Scene::kEllipseN;
  generate.laps = 4;
  GenerateSink<SE3> sink;
  sink.pose = [&](PoseId id, const SE3& T) { graph.AddPose(id, T); };
  sink.edge = [&](const RelativePoseFactor<SE3>& edge) { graph.AddFactor(edge); };
  Generate(generate, sink);
  const auto poses = static_cast<long>(graph.Poses().size());
  ASSERT_GT(GraphReplay<SE3>(graph).LinksOffered(), 15 * poses) << "many";
  SampleOptions options;
  options.innovation_quantile = 0.9999;
  const auto chosen = SelectThresholds(graph, options);
  EXPECT_EQ(chosen.sample_poses, 200);
  EXPECT_LE(chosen.sample_loops, 12 * chosen.sample_poses);
  EXPECT_GT(chosen.sample_loops, 5 * chosen.sample_poses);
  EXPECT_LE(chosen.sample_links, 4 * poses);
  EXPECT_GT(chosen.sample_links, 2 * poses);
  options.share = 1;
  options.most_poses = poses;
  const auto all = SelectThresholds(graph, options);
  EXPECT_EQ(all.sample_poses, poses);
  EXPECT_NEAR(chosen.loop_gain_90, all.loop_gain_90, 0.1);
  EXPECT_NEAR(chosen.thresholds.min_loop_gain, all.thresholds.min_loop_gain, 0.05 * all.thresholds.min_loop_gain);
  EXPECT_NEAR(chosen.thresholds.range[0], all.thresholds.range[0], 0.05 * all.thresholds.range[0]);
}

// A far loop in the last tenth of a long run is seen: before, the sample ended at 60 % of it.
TEST(ThresholdsScenes, LateLoopsAreSeen) {
  PoseGraph<SE2> graph;
  const Matrix<3, 3> information = 1e4 * Matrix<3, 3>::Identity();
  constexpr int kPoses = 400, kTurn = 360;
  for (int k = 0; k < kPoses; ++k) graph.AddPose(PoseId{k});
  const SE2 step = SE2::Exp({1, 0, 2 * M_PI / kTurn});
  for (int k = 1; k < kPoses; ++k) {
    graph.AddFactor(RelativePoseFactor<SE2>{{k - 1}, {k}, step, information});
    if (k >= kTurn) graph.AddFactor(RelativePoseFactor<SE2>{{k - kTurn}, {k}, SE2(), information});
  }
  const auto chosen = SelectThresholds(graph);
  EXPECT_GT(chosen.sample_loops, 10);
  EXPECT_GT(chosen.loop_gain_90, 0.3);
}

// A single absurd link of hundreds says nothing of the sensor; drift does not widen the range.
TEST(ThresholdsScenes, RangeIsTheSensors) {
  const auto scene = testing::MakeScene<SE2>(Scene::kManhattan, 400);
  PoseGraph<SE2> graph = scene.graph;
  const auto plain = SelectThresholds(graph);
  ASSERT_GT(GraphReplay<SE2>(graph).LinksOffered(), 100);
  double longest = 0;
  const GraphReplay<SE2> replay(graph);
  for (const auto& input : replay.Inputs()) {
    for (const PoseId other : *input.linkable) {
      const auto at = [&](PoseId id) { return scene.truth[static_cast<std::size_t>(graph.IndexOf(id))]; };
      longest = std::max(longest, (at(other).Inverse() * at(input.id)).Translation().norm());
    }
  }
  EXPECT_LT(plain.thresholds.range[0], 1.7 * longest) << "1.5 times what is measured, with its noise";
  EXPECT_GT(plain.thresholds.range[0], 0.9 * longest);
  graph.AddFactor(RelativePoseFactor<SE2>{graph.Poses()[3].id, graph.Poses()[200].id, SE2::Exp({1000, 0, 0}),
                                          Matrix<3, 3>::Identity()});
  EXPECT_LT(SelectThresholds(graph).thresholds.range[0], 1.1 * plain.thresholds.range[0]);
}

// Odometry so good that gains are next to nothing, and so bad that they are large: both ends of the bounds.
TYPED_TEST(ThresholdsTest, AreBounded) {
  using Pose = TypeParam;
  for (const double scale : {1e-4, 1e4}) {
    const auto scene = this->Scene(6);
    GraphReplay<Pose> replay(scene.graph);
    PoseGraph<Pose> graph;
    for (const auto& node : scene.graph.Poses()) graph.AddPose(node.id, node.T_world_body);
    for (const auto& input : replay.Inputs()) {
      if (input.odometry) graph.AddFactor(*input.odometry);
      for (const PoseId other : *input.linkable) {
        auto link = *replay.AsRegistration()(other, input.id);
        link.information *= scale;
        graph.AddFactor(link);
      }
    }
    SampleOptions options;
    options.strategy = Strategy::kFpfl;
    const auto chosen = SelectThresholds(graph, options);
    ExpectFormulas(chosen);
    // What a bounded map asks of a link does not depend on the sample.
    const auto bounded = SelectThresholds(graph);
    EXPECT_EQ(bounded.thresholds.min_loop_gain, 0.425 * Pose::kDof);
    EXPECT_EQ(bounded.thresholds.min_pose_gain, chosen.thresholds.min_pose_gain);
    if (scale < 1) {
      EXPECT_EQ(chosen.thresholds.min_loop_gain, 0.5 * Pose::kDof);
      EXPECT_EQ(chosen.thresholds.min_pose_gain, 0.9 * Pose::kDof);
    } else {
      EXPECT_EQ(chosen.thresholds.min_loop_gain, 1.5 * Pose::kDof);
      EXPECT_GE(chosen.thresholds.min_pose_gain, 0.9 * 1.5 * Pose::kDof);
    }
  }
}

// The rarer loops are the less is asked of one: at none per pose next to nothing, at one for two poses all.
TYPED_TEST(ThresholdsTest, RareLoopsAreAskedForLess) {
  using Pose = TypeParam;
  const auto scene = this->Scene(8);
  const GraphReplay<Pose> replay(scene.graph);
  double last = 0;
  for (const int loops : {1, 2, 4, 8, 16}) {
    PoseGraph<Pose> graph;
    int left = loops, poses = 0;
    for (const auto& node : scene.graph.Poses()) graph.AddPose(node.id, node.T_world_body), ++poses;
    for (const auto& input : replay.Inputs()) {
      if (input.odometry) graph.AddFactor(*input.odometry);
      for (const auto& loop : *input.loops) {
        if (left-- > 0) graph.AddFactor(loop);
      }
    }
    const double share = std::min(1.0, 2.0 * loops / poses);
    const double most = (0.02 + 1.48 * std::pow(share, 1.5)) * Pose::kDof;
    SampleOptions options;
    EXPECT_NEAR(SelectThresholds(graph, options).thresholds.min_loop_gain, std::min(0.425 * Pose::kDof, most), 1e-12);
    options.strategy = Strategy::kFpfl;
    const double few = SelectThresholds(graph, options).thresholds.min_loop_gain;
    EXPECT_LE(few, most * (1 + 1e-12));
    EXPECT_GE(few, last);
    last = few;
  }
}

TYPED_TEST(ThresholdsTest, TheSampleIsWhatWasAskedFor) {
  const auto graph = this->Scene(7).graph;
  SampleOptions options;
  EXPECT_EQ(SelectThresholds(graph, options).sample_poses, 22);
  long last = 0;
  const long end = SamplePositions(36, 10).back() + 1;
  options.progress = [&](long done, long total) {
    EXPECT_EQ(done, ++last);
    EXPECT_EQ(total, end);
  };
  options.most_poses = 10;
  const auto capped = SelectThresholds(graph, options);
  EXPECT_EQ(capped.sample_poses, 10);
  EXPECT_EQ(last, end);
  options = {};
  options.share = 10 / 36.0;
  const auto same = SelectThresholds(graph, options);
  EXPECT_EQ(same.sample_poses, 10);
  EXPECT_EQ(same.thresholds.min_loop_gain, capped.thresholds.min_loop_gain);
  EXPECT_EQ(same.thresholds.min_pose_gain, capped.thresholds.min_pose_gain);
  EXPECT_TRUE(same.thresholds.range == capped.thresholds.range);
  // Nothing to learn from: what the links say remains.
  options.share = 1e-3;
  const auto none = SelectThresholds(graph, options);
  EXPECT_EQ(none.sample_poses, 0);
  EXPECT_EQ(none.thresholds.min_loop_gain, 0.425 * TypeParam::kDof);
  EXPECT_TRUE(none.thresholds.range == GraphReplay<TypeParam>(graph).LinkRange());
}

TYPED_TEST(ThresholdsTest, MisuseIsRefused) {
  const auto refuse = [](const PoseGraph<TypeParam>& graph, auto change) {
    SampleOptions options;
    change(options);
    EXPECT_THROW(SelectThresholds(graph, options), std::invalid_argument);
  };
  const auto graph = this->Scene(8).graph;
  refuse(graph, [](auto& o) { o.share = 0; });
  refuse(graph, [](auto& o) { o.share = 1.1; });
  refuse(graph, [](auto& o) { o.share = std::numeric_limits<double>::quiet_NaN(); });
  refuse(graph, [](auto& o) { o.probability = 1; });
  refuse(graph, [](auto& o) { o.probability = -1; });
  refuse(graph, [](auto& o) { o.most_poses = 0; });
  refuse(graph, [](auto& o) { o.innovation_quantile = 1; });
  refuse(graph, [](auto& o) { o.innovation_quantile = -0.1; });
  refuse(graph, [](auto& o) { o.innovation_quantile = std::numeric_limits<double>::quiet_NaN(); });
  PoseGraph<TypeParam> apart;
  refuse(apart, [](auto&) {});
  apart.AddPose(PoseId{1});
  apart.AddPose(PoseId{2});
  refuse(apart, [](auto&) {});
}

// The random baseline -----------------------------------------------------------------------------------------------

struct Drawn {
  std::set<std::int64_t> poses;
  std::vector<std::pair<std::int64_t, std::int64_t>> links;
  bool operator==(const Drawn& o) const { return poses == o.poses && links == o.links; }
};

template <class Pose>
Drawn Draw(GraphReplay<Pose>& replay, int poses, int links, std::uint64_t seed) {
  DrawAtRandom(replay, poses, links, seed);
  Drawn out;
  for (const auto& input : replay.Inputs()) {
    if (input.keep) out.poses.insert(input.id.value);
    for (const PoseId other : *input.linkable) out.links.emplace_back(other.value, input.id.value);
  }
  return out;
}

TYPED_TEST(ThresholdsTest, DrawsWhatWasAskedFor) {
  const auto graph = this->Scene(9).graph;
  GraphReplay<TypeParam> replay(graph);
  const GraphReplay<TypeParam> all(graph);
  const std::int64_t first = all.Inputs()[0].id.value;
  const auto between = [&](const std::set<std::int64_t>& poses) {
    int count = 0;
    for (const auto& input : all.Inputs()) {
      for (const PoseId other : *input.linkable) count += poses.count(other.value) * poses.count(input.id.value) != 0;
    }
    return count;
  };
  std::set<std::set<std::int64_t>> choices;
  for (const int poses : {-1, 0, 1, 2, 12, 36, 50}) {
    for (const int links : {-1, 0, 3, 1000}) {
      for (std::uint64_t seed = 1; seed <= 5; ++seed) {
        const auto drawn = Draw(replay, poses, links, seed);
        EXPECT_EQ(static_cast<int>(drawn.poses.size()), std::min(std::max(poses, 1), 36));
        EXPECT_EQ(drawn.poses.count(first), 1u);
        const int possible = between(drawn.poses);
        EXPECT_EQ(static_cast<int>(drawn.links.size()), std::min(std::max(links, 0), possible));
        for (const auto& [a, b] : drawn.links) EXPECT_TRUE(drawn.poses.count(a) == 1 && drawn.poses.count(b) == 1);
        EXPECT_TRUE(drawn == Draw(replay, poses, links, seed)) << "same seed, same choice, drawn again or anew";
        GraphReplay<TypeParam> other(graph);
        EXPECT_TRUE(drawn == Draw(other, poses, links, seed));
        if (poses == 12) choices.insert(drawn.poses);
      }
    }
  }
  EXPECT_EQ(choices.size(), 5u) << "another seed, another choice";
}

TYPED_TEST(ThresholdsTest, EveryPoseIsDrawnAsOftenAsAnother) {
  const auto graph = this->Scene(10).graph;
  GraphReplay<TypeParam> replay(graph);
  std::map<std::int64_t, int> times;
  constexpr int kSeeds = 700;
  for (std::uint64_t seed = 1; seed <= kSeeds; ++seed) {
    for (const std::int64_t pose : Draw(replay, 11, 0, seed).poses) ++times[pose];
  }
  ASSERT_EQ(times.size(), 36u);
  for (const auto& [pose, count] : times) {
    if (pose == replay.Inputs()[0].id.value) {
      EXPECT_EQ(count, kSeeds);
      continue;
    }
    const double expected = kSeeds * 10 / 35.0;
    EXPECT_NEAR(count, expected, 4 * std::sqrt(expected)) << pose;
  }
}

TYPED_TEST(ThresholdsTest, TheBaselineKeepsExactlyWhatWasDrawn) {
  const auto graph = this->Scene(11).graph;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    GraphReplay<TypeParam> replay(graph);
    const auto drawn = Draw(replay, 14, 4, seed);
    CompactOptions<TypeParam> options;
    options.strategy = Strategy::kGiven;
    auto run = testing::RunReplay(replay, options);
    const auto& kept = run.slam->Solver().Graph();
    EXPECT_EQ(kept.Poses().size(), drawn.poses.size());
    for (const auto& node : kept.Poses()) EXPECT_EQ(drawn.poses.count(node.id.value), 1u);
    std::vector<std::pair<std::int64_t, std::int64_t>> links;
    for (const Decision& d : run.decisions) {
      EXPECT_EQ(d.Kept(), drawn.poses.count(d.id.value) == 1);
      EXPECT_EQ(d.links_refused, 0);
      for (const Candidate& c : d.candidates) {
        EXPECT_TRUE(c.accepted && c.factor && !c.measured_gain && !c.innovation);
        links.emplace_back(c.id.value, d.id.value);
      }
    }
    EXPECT_EQ(links, drawn.links);
    EXPECT_EQ(run.slam->LinksKept(), static_cast<int>(links.size()));
    EXPECT_EQ(kept.Factors().size(), kept.Poses().size() - 1 + links.size());
    EXPECT_EQ(run.slam->Trajectory().size(), graph.Poses().size());
    EXPECT_TRUE(run.slam->Finish().Converged());
  }
}

}  // namespace
}  // namespace terse
