// Information that a stream states and its residuals contradict, and thresholds that nobody gave: found on the way, as
// if they had been known from the beginning.

#include <gtest/gtest.h>

#include <cmath>
#include <set>
#include <variant>

#include "slow_build.h"
#include "terse/compact/compact_graph.h"
#include "terse/compact/measurement_stream.h"
#include "terse/core/arrival.h"
#include "terse/core/error.h"
#include "terse/core/evaluate.h"
#include "terse/core/generate.h"
#include "terse/core/outliers.h"
#include "testing_files.h"
#include "testing_lone_loop.h"
#include "testing_state.h"

namespace terse {
namespace {

using namespace testing;
using std::size_t;

template <class Pose>
struct World {
  PoseGraph<Pose> graph;
  std::vector<Pose> truth;
};

template <class Pose>
World<Pose> MakeWorld(std::uint64_t seed) {
  World<Pose> world;
  GenerateOptions options;
  options.scene = Pose::kDim == 2 ? Scene::kManhattan : Scene::kTorus;
  options.poses = 500;
  options.seed = seed;
  GenerateSink<Pose> sink;
  sink.pose = [&](PoseId id, const Pose& T) {
    world.truth.push_back(T);
    world.graph.AddPose(id);
  };
  sink.edge = [&](const RelativePoseFactor<Pose>& edge) { world.graph.AddFactor(edge); };
  Generate(options, sink);
  return world;
}

template <class Pose>
PoseGraph<Pose> WithInformation(const PoseGraph<Pose>& graph, double of_unit, double of_stated) {
  PoseGraph<Pose> out;
  for (const auto& node : graph.Poses()) out.AddPose(node.id);
  for (const auto& node : graph.Factors()) {
    auto edge = std::get<RelativePoseFactor<Pose>>(node.factor);
    edge.information = of_unit * Pose::Jacobian::Identity() + of_stated * edge.information;
    out.AddFactor(edge);
  }
  return out;
}
template <class Pose>
PoseGraph<Pose> WithIdentity(const PoseGraph<Pose>& graph) {
  return WithInformation(graph, 1, 0);
}

template <class Pose>
std::vector<RelativePoseFactor<Pose>> InOrderOfArrival(const PoseGraph<Pose>& graph) {
  std::vector<RelativePoseFactor<Pose>> out;
  for (const ArrivalStep& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
    for (const int k : step.factors) {
      out.push_back(std::get<RelativePoseFactor<Pose>>(graph.Factors()[static_cast<size_t>(k)].factor));
    }
  }
  return out;
}

// As `terse online` has them.
template <class Pose>
CompactOptions<Pose> Settings() {
  CompactOptions<Pose> options;
  options.thresholds.range.setConstant(6);
  options.thresholds.range[Pose::kDim] = 3;
  options.solver.robust.kernel = RobustKernel::kGnc;
  options.solver.robust.quantile = kInnovationQuantile;
  return options;
}

template <class Pose>
struct Streamed {
  explicit Streamed(const CompactOptions<Pose>& options) : slam(options), stream(slam) {}
  void Take(const std::vector<StreamOutcome>& outcomes) {
    for (const StreamOutcome& outcome : outcomes) {
      if (const auto* decision = std::get_if<Decision>(&outcome)) decisions.push_back(*decision);
    }
  }
  void LookBack(bool at_end) {
    std::optional<Review> found = stream.TakeReview(at_end);
    if (!found) return;
    EXPECT_EQ(found->decisions.size(), decisions.size());
    decisions = std::move(found->decisions);
    left_out = found->loops_left_out;
    ++made_again;
  }
  void Add(const Factor<Pose>& factor) {
    Take(stream.Add(factor));
    LookBack(false);
  }
  void Finish() {
    Take(stream.Flush());
    LookBack(true);
  }
  void AddAll(const PoseGraph<Pose>& graph) {
    for (const auto& factor : InOrderOfArrival(graph)) Add(factor);
    Finish();
  }
  CompactPoseSlam<Pose> slam;
  MeasurementStream<Pose> stream;
  std::vector<Decision> decisions;
  int made_again = 0, left_out = 0;
};

template <class Pose>
Streamed<Pose> Calibrated(const PoseGraph<Pose>& graph, const ReviewOptions& options = {}) {
  Streamed<Pose> run(Settings<Pose>());
  run.stream.StartReviews(options);
  run.AddAll(graph);
  return run;
}

ReviewOptions AllChosen() {
  ReviewOptions options;
  options.chosen = {true, true, true, true};
  return options;
}

template <class Pose>
std::string Picture(const CompactPoseSlam<Pose>& slam) {
  std::string out;
  for (const auto& pose : slam.Trajectory()) out += Bits(pose.id) + Bits(pose.kept) + Bits(pose.T_world_body);
  for (const auto& node : slam.Solver().Graph().Factors()) out += Bits(node.id);
  return out;
}

double ErrorOf(const CompactPoseSlam<SE2>& slam, const std::vector<SE2>& truth) {
  const auto in_space = [](const SE2& T) {
    return SE3(SO3::Exp({0, 0, T.Theta()}), {T.Translation().x(), T.Translation().y(), 0});
  };
  std::vector<SE3> estimate, reference;
  for (const auto& pose : slam.Trajectory()) estimate.push_back(in_space(pose.T_world_body));
  for (const SE2& T : truth) reference.push_back(in_space(T));
  return AbsoluteError(estimate, reference);
}

// The oracle: the first of these measurements, scaled from the beginning.
template <class Pose>
Streamed<Pose> WithScale(const std::vector<RelativePoseFactor<Pose>>& factors, const InformationScale& scale,
                         const Thresholds<Pose>& thresholds = Settings<Pose>().thresholds) {
  CompactOptions<Pose> settings = Settings<Pose>();
  settings.thresholds = thresholds;
  if (!scale.IsOne()) settings.innovation_quantile = settings.solver.robust.quantile = kInnovationQuantileOfScaled;
  Streamed<Pose> run(settings);
  run.stream = MeasurementStream<Pose>(run.slam, scale);
  for (const auto& factor : factors) run.Take(run.stream.Add(factor));
  return run;
}

template <class Pose>
void ExpectAsIfTheScaleHadBeenKnown(std::uint64_t seed) {
  SCOPED_TRACE(seed);
  const PoseGraph<Pose> graph = WithIdentity(MakeWorld<Pose>(seed).graph);
  const Streamed<Pose> run = Calibrated(graph);
  EXPECT_GE(run.made_again, 1);
  EXPECT_FALSE(run.stream.Scale().IsOne());
  Streamed<Pose> other = WithScale(InOrderOfArrival(graph), run.stream.Scale());
  other.Finish();
  EXPECT_TRUE(Picture(run.slam) == Picture(other.slam));
  ASSERT_EQ(run.decisions.size(), other.decisions.size());
  for (size_t k = 0; k < other.decisions.size(); ++k) {
    EXPECT_EQ(run.decisions[k].id, other.decisions[k].id);
    EXPECT_EQ(run.decisions[k].verdict, other.decisions[k].verdict);
  }
  // What is odometry and what a loop is as where the whole graph is scaled.
  Streamed<Pose> of_scaled(other.slam.Options());
  of_scaled.AddAll(ScaleInformation(graph, run.stream.Scale()));
  EXPECT_TRUE(Picture(of_scaled.slam) == Picture(other.slam));
}

TEST(StreamReview, EndsAsIfTheScaleHadBeenKnown) {
  ExpectAsIfTheScaleHadBeenKnown<SE2>(71);
  ExpectAsIfTheScaleHadBeenKnown<SE2>(72);
  ExpectAsIfTheScaleHadBeenKnown<SE3>(73);
}

// At any time, whatever was found so far.
TEST(StreamReview, TheMapIsAlwaysThatOfItsScale) {
  const auto factors = InOrderOfArrival(WithIdentity(MakeWorld<SE2>(74).graph));
  Streamed<SE2> run(Settings<SE2>());
  run.stream.StartReviews();
  int compared = 0, made_again = 0;
  for (size_t n = 0; n < factors.size(); ++n) {
    run.Add(factors[n]);
    if (run.made_again == made_again && n % 150 != 0) continue;
    made_again = run.made_again;
    const std::vector<RelativePoseFactor<SE2>> so_far(factors.begin(), factors.begin() + static_cast<long>(n) + 1);
    const Streamed<SE2> other = WithScale(so_far, run.stream.Scale());
    ASSERT_TRUE(Picture(run.slam) == Picture(other.slam)) << "after " << n;
    EXPECT_EQ(run.stream.Open(), other.stream.Open());
    ++compared;
  }
  EXPECT_GE(made_again, 1);
  EXPECT_GE(compared, 5);
}

template <class Pose>
void ExpectRightInformationStays(std::uint64_t seed) {
  SCOPED_TRACE(seed);
  const PoseGraph<Pose> graph = MakeWorld<Pose>(seed).graph;
  Streamed<Pose> plain(Settings<Pose>());
  plain.AddAll(graph);
  const Streamed<Pose> run = Calibrated(graph);
  EXPECT_TRUE(run.stream.Scale().IsOne());
  EXPECT_EQ(run.made_again, 0);
  EXPECT_TRUE(Picture(run.slam) == Picture(plain.slam));
}

TEST(StreamReview, RightInformationStays) {
  for (const std::uint64_t seed : Seeds(81, 84)) ExpectRightInformationStays<SE2>(seed);
  ExpectRightInformationStays<SE3>(85);
}

// The first edge of each pose in time, the others so many edges later.
template <class Pose>
std::vector<RelativePoseFactor<Pose>> WithLateLoops(const std::vector<RelativePoseFactor<Pose>>& in_time,
                                                    size_t delay) {
  std::vector<RelativePoseFactor<Pose>> out, late;
  std::set<std::int64_t> known;
  const auto is_new = [&](PoseId id) { return known.insert(id.value).second; };
  for (size_t k = 0; k < in_time.size(); ++k) {
    const bool opens_from = is_new(in_time[k].from), opens_to = is_new(in_time[k].to);
    (opens_from || opens_to ? out : late).push_back(in_time[k]);
    if (late.size() >= delay) out.insert(out.end(), late.begin(), late.end()), late.clear();
  }
  out.insert(out.end(), late.begin(), late.end());
  return out;
}

// Loops that a place recognition finds some poses later, or when the drive is over: to poses that the map has dropped
// or kept without knowing of them.
TEST(StreamReview, LoopsThatComeLateAreHeardOfInTime) {
  const World<SE2> world = MakeWorld<SE2>(86);
  const auto in_time = InOrderOfArrival(world.graph);
  Streamed<SE2> oracle(Settings<SE2>());
  for (const auto& factor : in_time) oracle.Take(oracle.stream.Add(factor));
  oracle.Take(oracle.stream.Flush());
  for (const size_t delay : {size_t{30}, in_time.size()}) {
    SCOPED_TRACE(delay);
    Streamed<SE2> run(Settings<SE2>()), without(Settings<SE2>());
    run.stream.StartReviews();
    for (const auto& factor : WithLateLoops(in_time, delay)) {
      run.Add(factor);
      without.Take(without.stream.Add(factor));
    }
    run.Finish();
    without.Finish();
    EXPECT_GE(run.made_again, 1);
    EXPECT_TRUE(Picture(run.slam) == Picture(oracle.slam));
    ASSERT_EQ(run.decisions.size(), oracle.decisions.size());
    EXPECT_FALSE(Picture(without.slam) == Picture(oracle.slam)) << "nothing was late";
    if (delay < in_time.size()) continue;
    EXPECT_LT(ErrorOf(run.slam, world.truth), ErrorOf(without.slam, world.truth));
  }
}

// A wrong loop in front of its pose's odometry is left out all the same, and the map is that of any other order.
TEST(StreamReview, AWrongLoopMayStandBeforeTheOdometry) {
  const World<SE2> world = MakeWorld<SE2>(87);
  const PoseGraph<SE2> wrong = AddWrongLoops(world.graph, world.truth, 40, 5, OutlierKind::kRandom).graph;
  const auto odometry_first = InOrderOfArrival(wrong);
  auto odometry_last = odometry_first;  // of each pose
  const auto later = [](const RelativePoseFactor<SE2>& edge) { return std::max(edge.from.value, edge.to.value); };
  const auto span = [](const RelativePoseFactor<SE2>& edge) { return std::abs(edge.from.value - edge.to.value); };
  std::stable_sort(odometry_last.begin(), odometry_last.end(), [&](const auto& a, const auto& b) {
    return later(a) != later(b) ? later(a) < later(b) : span(a) > span(b);
  });
  Streamed<SE2> first(Settings<SE2>()), last(Settings<SE2>());
  for (auto* run : {&first, &last}) {
    run->stream.StartReviews();
    for (const auto& factor : run == &first ? odometry_first : odometry_last) run->Add(factor);
    run->Finish();
    EXPECT_GT(run->left_out, 50);
  }
  EXPECT_EQ(first.left_out, last.left_out);
  EXPECT_LT(ErrorOf(last.slam, world.truth), 1.1 * ErrorOf(first.slam, world.truth));
}

// Nothing but odometry contradicts a loop that is the first of a few, and not enough for a map to refuse it.
TEST(StreamReview, ALoneLoopIsDoubtedAsInAFile) {
  for (const std::uint64_t seed : Seeds(1, 3)) {
    auto [graph, wrong] = OutAndBackWithOneWrong(seed);
    Streamed<SE2> with = Calibrated(graph, AllChosen());
    EXPECT_EQ(with.left_out, 1) << seed;
    graph.RemoveFactor(wrong);
    EXPECT_EQ(Calibrated(graph, AllChosen()).left_out, 0) << seed;
  }
}

// Unit matrices, and a hundred times too certain: what such maps were like, and what they are.
TEST(StreamReview, InventedInformationDoesNotLoseTheMap) {
  const World<SE2> world = MakeWorld<SE2>(91);
  const PoseGraph<SE2> wrong = AddWrongLoops(world.graph, world.truth, 43, 91).graph;
  Streamed<SE2> right(Settings<SE2>());
  right.AddAll(world.graph);
  const double clean = ErrorOf(right.slam, world.truth);
  Streamed<SE2> plain(Settings<SE2>());
  plain.AddAll(WithInformation(wrong, 0, 1e4));
  EXPECT_GT(ErrorOf(plain.slam, world.truth), 3 * clean);
  for (const auto& graph : {wrong, WithIdentity(wrong), WithInformation(wrong, 0, 1e4)}) {
    EXPECT_LT(ErrorOf(Calibrated(graph).slam, world.truth), 1.5 * clean);
  }
}

// A sum, so that nothing that is no number is overlooked.
double ChangeOf(const Thresholds<SE2>& a, const Thresholds<SE2>& b) {
  const auto change = [](double x, double y) { return std::abs(std::log(x / y)); };
  double sum = change(a.min_loop_gain, b.min_loop_gain) + change(a.min_pose_gain, b.min_pose_gain);
  for (int k = 0; k < 3; ++k) {
    sum += change(a.range[k], b.range[k]) + change(a.link_covariance(k, k), b.link_covariance(k, k));
  }
  return sum;
}

// Those of the sample that a file would give, and the map that they give: with right information, with the unit matrix.
TEST(StreamReview, ThresholdsThatNobodyGaveAreChosen) {
  const PoseGraph<SE2> world = MakeWorld<SE2>(101).graph;
  for (const PoseGraph<SE2>& graph : {world, WithIdentity(world)}) {
    const Streamed<SE2> run = Calibrated(graph, AllChosen());
    EXPECT_GE(run.made_again, 1);
    CompactOptions<SE2> of_file = Settings<SE2>();
    of_file.innovation_quantile = run.slam.Options().innovation_quantile;
    SampleThresholds(ScaleInformation(graph, run.stream.Scale()), of_file);
    EXPECT_GT(ChangeOf(Settings<SE2>().thresholds, of_file.thresholds), 0.3);
    EXPECT_LT(ChangeOf(run.slam.Options().thresholds, of_file.thresholds), 0.2);
    Streamed<SE2> other = WithScale(InOrderOfArrival(graph), run.stream.Scale(), run.slam.Options().thresholds);
    other.Finish();
    EXPECT_TRUE(Picture(run.slam) == Picture(other.slam));
  }
}

TEST(StreamReview, GivenThresholdsStay) {
  const PoseGraph<SE2> graph = MakeWorld<SE2>(102).graph;
  const Thresholds<SE2> given = Settings<SE2>().thresholds,
                        all = Calibrated(graph, AllChosen()).slam.Options().thresholds;
  ReviewOptions options;
  options.chosen.min_pose_gain = true;
  const Thresholds<SE2> found = Calibrated(graph, options).slam.Options().thresholds;
  EXPECT_EQ(found.min_pose_gain, all.min_pose_gain);
  EXPECT_NE(found.min_pose_gain, given.min_pose_gain);
  EXPECT_EQ(found.min_loop_gain, given.min_loop_gain);
  EXPECT_EQ(found.range, given.range);
  EXPECT_EQ(found.link_covariance, given.link_covariance);
}

// Without a loop, with fewer than a look at all else waits for; and with positions, far from zero.
TEST(StreamReview, ThresholdsOfFewLoops) {
  const std::vector<RelativePoseFactor<SE2>> factors = InOrderOfArrival(MakeWorld<SE2>(103).graph);
  for (const int most_loops : {0, 3}) {
    for (const bool has_positions : {false, true}) {
      Streamed<SE2> run(Settings<SE2>());
      run.stream.StartReviews(AllChosen());
      PoseGraph<SE2> graph;
      const auto add = [&](const Factor<SE2>& factor) {
        run.Add(factor);
        graph.AddFactor(factor);
      };
      int loops = 0;
      for (size_t k = 0; k < factors.size(); ++k) {
        const bool opens = !graph.HasPose(factors[k].to);
        if (!opens && loops == most_loops) continue;
        loops += !opens;
        for (const PoseId id : {factors[k].from, factors[k].to}) {
          if (!graph.HasPose(id)) graph.AddPose(id);
        }
        add(factors[k]);
        const double along = static_cast<double>(k);
        if (has_positions && opens && k % 10 == 0) {
          add(PositionPriorFactor<SE2>{factors[k].to, {5e5 + along, 5e6}, 1e-2 * Matrix<2, 2>::Identity()});
        }
      }
      run.Finish();
      EXPECT_GE(run.made_again, 1);
      CompactOptions<SE2> of_file = Settings<SE2>();
      of_file.innovation_quantile = run.slam.Options().innovation_quantile;
      SampleThresholds(ScaleInformation(graph, run.stream.Scale()), of_file);
      EXPECT_LT(ChangeOf(run.slam.Options().thresholds, of_file.thresholds), 0.3);
    }
  }
}

// A look that a discarded pose calls off is made again.
TEST(StreamReview, ThresholdsOfAStreamWithDiscardedPoses) {
  const std::vector<RelativePoseFactor<SE2>> factors = InOrderOfArrival(MakeWorld<SE2>(104).graph);
  Streamed<SE2> run(Settings<SE2>());
  run.stream.StartReviews(AllChosen());
  for (size_t k = 0; k < 90; ++k) {
    run.Add(factors[k]);
    if (k < 30) continue;
    run.Take(run.stream.Flush());
    run.Add(RelativePoseFactor<SE2>{{0}, {1000000}, SE2({50, 3}, 1), Matrix<3, 3>::Identity()});
    run.stream.Discard();
  }
  run.Finish();
  EXPECT_GE(run.made_again, 1);
  EXPECT_GT(ChangeOf(run.slam.Options().thresholds, Settings<SE2>().thresholds), 0.3);
}

// Long before there are loops the range is that of the odometry, or of what it tells apart if the robot stands still.
TEST(StreamReview, ARobotWithoutLoopsKeepsFewPoses) {
  for (const double step : {0.0, 3.0}) {
    CompactOptions<SE2> options;
    Streamed<SE2> run(options);
    run.stream.StartReviews(AllChosen());
    for (int k = 0; k < 400; ++k) {
      run.Add(RelativePoseFactor<SE2>{{k}, {k + 1}, SE2({step, 0}, 0), 400 * Matrix<3, 3>::Identity()});
      if (k != 60) continue;
      EXPECT_GE(run.made_again, 1);
      EXPECT_NEAR(run.slam.Options().thresholds.range[0], std::max(5 * step, 5 * 0.05), 1e-9);
    }
    run.Finish();
    EXPECT_LT(run.slam.Solver().Graph().Poses().size(), 200u);
  }
}

template <class Pose>
void ExpectGoesOnFromAFile(const ReviewOptions& options) {
  const TestFile file("stream.state");
  const PoseGraph<Pose> graph = WithIdentity(MakeWorld<Pose>(95).graph);
  const std::string whole = Picture(Calibrated(graph, options).slam);
  const auto factors = InOrderOfArrival(graph);
  for (const size_t saved_at : {factors.size() / 20, factors.size() / 5, factors.size() / 3}) {
    Streamed<Pose> begun(Settings<Pose>());
    begun.stream.StartReviews(options);
    for (size_t k = 0; k < saved_at; ++k) begun.Add(factors[k]);
    begun.stream.Save(file.Path());
    Streamed<Pose> run(Settings<Pose>());
    run.stream = MeasurementStream<Pose>::Load(file.Path(), run.slam);
    run.decisions = begun.decisions;
    for (size_t k = saved_at; k < factors.size(); ++k) run.Add(factors[k]);
    run.Finish();
    EXPECT_TRUE(Picture(run.slam) == whole) << saved_at;
  }
}

// What the map refuses while a look is on the way comes too late for it, from a file too.
TEST(StreamReview, AFileHoldsWhatALookBeganWith) {
  const TestFile file("stream.state");
  std::vector<RelativePoseFactor<SE2>> measured;
  int loops = 0;
  size_t begun = 0;  // with how many the look has
  std::set<std::int64_t> known;
  for (const auto& factor : InOrderOfArrival(MakeWorld<SE2>(105).graph)) {
    measured.push_back(factor);
    const bool is_loop = !known.insert(factor.to.value).second;
    loops += is_loop;
    if (loops == 4 && is_loop) measured.back().T_from_to = SE2({40, 9}, 1) * factor.T_from_to;
    if (loops == 8 && begun == 0) begun = measured.size();
    const bool is_new = begun > 0 && !is_loop && measured.size() < begun + 20;
    if (is_new) {
      const double wrong = static_cast<double>(measured.size());
      measured.push_back({{1}, factor.to, SE2({50 + wrong, 3 * wrong}, 1), factor.information});
    }
    if (begun > 0 && measured.size() > begun + 60) break;
  }
  Streamed<SE2> straight(Settings<SE2>());
  straight.stream.StartReviews();
  for (size_t k = 0; k < measured.size(); ++k) {
    straight.Add(measured[k]);
    if (k == begun + 15) straight.stream.Save(file.Path());
  }
  Streamed<SE2> run(Settings<SE2>());
  run.stream = MeasurementStream<SE2>::Load(file.Path(), run.slam);
  run.decisions.resize(size_t(run.slam.PosesSeen()));
  for (size_t k = begun + 16; k < measured.size(); ++k) run.Add(measured[k]);
  EXPECT_TRUE(Picture(run.slam) == Picture(straight.slam));
  EXPECT_EQ(run.made_again, straight.made_again);
}

// A look on the way included.
TEST(StreamReview, GoesOnFromAFile) {
  ExpectGoesOnFromAFile<SE2>({});
  ExpectGoesOnFromAFile<SE2>(AllChosen());
  if (!kSlowBuild) ExpectGoesOnFromAFile<SE3>(AllChosen());
}

// Poses that were given up are in no map that is made later.
TEST(StreamReview, DiscardedPosesAreForgotten) {
  const PoseGraph<SE2> graph = WithIdentity(MakeWorld<SE2>(96).graph);
  Streamed<SE2> run(Settings<SE2>());
  run.stream.StartReviews();
  const auto factors = InOrderOfArrival(graph);
  const std::int64_t kNowhere = 1000000;
  for (size_t k = 0; k < factors.size(); ++k) {
    run.Add(factors[k]);
    const bool is_closed = k + 1 < factors.size() && !run.slam.HasSeen(factors[k + 1].to) &&
                           run.stream.Open() != factors[k + 1].to && k % 40 < 2;
    if (!is_closed) continue;
    const PoseId newest = *run.stream.Open();
    run.Take(run.stream.Flush());
    run.stream.SetValue({kNowhere}, SE2({1e3, 0}, 1));
    run.Add(RelativePoseFactor<SE2>{newest, {kNowhere}, SE2({50, 3}, 1), Matrix<3, 3>::Identity()});
    run.Add(RelativePoseFactor<SE2>{factors[0].from, {kNowhere}, SE2({-9, 3}, 1), Matrix<3, 3>::Identity()});
    run.stream.Discard();
  }
  run.Finish();
  EXPECT_GE(run.made_again, 1);
  EXPECT_FALSE(run.slam.HasSeen({kNowhere}));
  Streamed<SE2> other = WithScale(factors, run.stream.Scale());
  other.Finish();
  EXPECT_TRUE(Picture(run.slam) == Picture(other.slam));
}

TEST(StreamReview, StopsWhenItIsTold) {
  const PoseGraph<SE2> graph = WithIdentity(MakeWorld<SE2>(97).graph);
  const auto factors = InOrderOfArrival(graph);
  Streamed<SE2> run(Settings<SE2>());
  run.stream.StartReviews();
  size_t k = 0;
  while (run.made_again == 0) run.Add(factors[k++]);
  const InformationScale scale = run.stream.Scale();
  run.stream.EndReviews();
  while (k < factors.size()) run.Add(factors[k++]);
  run.Finish();
  EXPECT_EQ(run.made_again, 1);
  EXPECT_EQ(run.stream.Scale().loops.translation, scale.loops.translation);
  EXPECT_EQ(run.stream.Scale().odometry.rotation, scale.odometry.rotation);
  EXPECT_THROW(run.stream.StartReviews(), std::logic_error);
}

// With few poses asked for it looks at the beginning only, and holds no more.
TEST(StreamReview, LooksAtTheBeginningOnly) {
  const PoseGraph<SE2> graph = WithIdentity(MakeWorld<SE2>(98).graph);
  Streamed<SE2> run(Settings<SE2>());
  ReviewOptions options;
  options.estimate.sample_poses = 40;
  options.estimate.sample_loops = 20;
  run.stream.StartReviews(options);
  const auto factors = InOrderOfArrival(graph);
  for (size_t k = 0; k < factors.size(); ++k) run.Add(factors[k]);
  const InformationScale scale = run.stream.Scale();
  EXPECT_FALSE(scale.IsOne());
  run.Finish();
  EXPECT_EQ(run.stream.Scale().loops.translation, scale.loops.translation);
}

}  // namespace
}  // namespace terse
