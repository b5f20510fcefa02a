// A stream of measurements against the same graph replayed, and what only a stream has: late links, late priors,
// loops to dropped poses.

#include "terse/compact/measurement_stream.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <variant>

#include "terse/core/arrival.h"
#include "terse/core/error.h"
#include "terse/core/measurement_line.h"
#include "testing_bounded.h"
#include "testing_compact.h"
#include "testing_files.h"
#include "testing_state.h"

namespace terse {
namespace {

using namespace testing;

template <class Pose>
std::vector<Factor<Pose>> InOrderOfArrival(const PoseGraph<Pose>& graph) {
  std::vector<Factor<Pose>> out;
  for (const ArrivalStep& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
    for (const int k : step.factors) out.push_back(graph.Factors()[static_cast<std::size_t>(k)].factor);
  }
  return out;
}

template <class Pose>
struct StreamRun {
  explicit StreamRun(const CompactOptions<Pose>& options) : slam(options), stream(slam) {}
  void Take(const std::vector<StreamOutcome>& outcomes) {
    for (const StreamOutcome& outcome : outcomes) {
      if (const auto* d = std::get_if<Decision>(&outcome)) decisions.push_back(*d);
      if (const auto* l = std::get_if<LateLink>(&outcome)) links.push_back(*l);
      if (const auto* p = std::get_if<LatePrior>(&outcome)) priors.push_back(*p);
    }
  }
  void Add(const Factor<Pose>& factor) { Take(stream.Add(factor)); }
  void AddAll(const PoseGraph<Pose>& graph) {
    stream.SetValue(graph.Poses()[0].id, *graph.Poses()[0].T_world_body);
    for (const auto& factor : InOrderOfArrival(graph)) Add(factor);
    Take(stream.Flush());
  }
  void AddAsTheyStand(const PoseGraph<Pose>& graph) {
    stream.SetValue(graph.Poses()[0].id, *graph.Poses()[0].T_world_body);
    for (const auto& node : graph.Factors()) Add(node.factor);
    Take(stream.Flush());
  }
  CompactPoseSlam<Pose> slam;
  MeasurementStream<Pose> stream;
  std::vector<Decision> decisions;
  std::vector<LateLink> links;
  std::vector<LatePrior> priors;
};

void ExpectEqual(const Decision& a, const Decision& b) {
  EXPECT_EQ(a.id, b.id);
  EXPECT_EQ(a.verdict, b.verdict) << a.id.value;
  EXPECT_EQ(Bits(a.pose_gain), Bits(b.pose_gain)) << a.id.value;
  EXPECT_EQ(a.links_accepted, b.links_accepted) << a.id.value;
  ASSERT_EQ(a.candidates.size(), b.candidates.size()) << a.id.value;
  for (std::size_t k = 0; k < a.candidates.size(); ++k) {
    EXPECT_EQ(a.candidates[k].id, b.candidates[k].id);
    EXPECT_EQ(Bits(a.candidates[k].gain), Bits(b.candidates[k].gain));
    EXPECT_EQ(Bits(a.candidates[k].measured_gain), Bits(b.candidates[k].measured_gain));
    EXPECT_EQ(a.candidates[k].factor, b.candidates[k].factor);
  }
}

template <class Pose>
void ExpectSameTrajectory(const CompactPoseSlam<Pose>& a, const CompactPoseSlam<Pose>& b) {
  const auto left = a.Trajectory(), right = b.Trajectory();
  ASSERT_EQ(left.size(), right.size());
  for (std::size_t k = 0; k < left.size(); ++k) {
    EXPECT_EQ(left[k].id, right[k].id);
    EXPECT_EQ(left[k].kept, right[k].kept);
    EXPECT_EQ(left[k].T_world_body.Log(), right[k].T_world_body.Log()) << left[k].id.value;
  }
}

// Without dropped poses the two see the same loops.
template <class Pose>
void ExpectSameAsReplay(const PoseGraph<Pose>& graph, Strategy strategy) {
  GraphReplay<Pose> replay(graph);
  CompactOptions<Pose> options = OptionsFor(replay, strategy);
  options.thresholds.min_pose_gain = 0;
  const ReplayedRun<Pose> replayed = RunReplay(replay, options);
  StreamRun<Pose> streamed(options);
  streamed.AddAsTheyStand(graph);
  ASSERT_EQ(streamed.decisions.size(), replayed.decisions.size());
  for (std::size_t k = 0; k < replayed.decisions.size(); ++k) {
    ExpectEqual(streamed.decisions[k], replayed.decisions[k]);
  }
  EXPECT_GT(streamed.slam.LinksKept(), 0);
  EXPECT_TRUE(streamed.links.empty());
  ExpectSameTrajectory(streamed.slam, *replayed.slam);
}

TEST(MeasurementStream, DecidesAsTheReplayOfTheGraph) {
  for (const Strategy strategy : {Strategy::kApal, Strategy::kApfl, Strategy::kFpfl}) {
    ExpectSameAsReplay(MakeScene<SE2>(Scene::kManhattan, 120).graph, strategy);
    ExpectSameAsReplay(MakeScene<SE3>(Scene::kSphere, 120).graph, strategy);
  }
}

// Exporters write edges by their first pose: a loop to the pose before the last stands in front of the odometry.
template <class Pose>
PoseGraph<Pose> ShuffledWithinPoses(const PoseGraph<Pose>& graph) {
  std::mt19937_64 random(9);
  PoseGraph<Pose> shuffled;
  for (const auto& pose : graph.Poses()) shuffled.AddPose(pose.id, pose.T_world_body);
  std::size_t moved = 0;
  for (ArrivalStep& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
    const int odometry = step.factors.empty() ? -1 : step.factors.front();
    std::shuffle(step.factors.begin(), step.factors.end(), random);
    moved += !step.factors.empty() && step.factors.front() != odometry;
    for (const int k : step.factors) shuffled.AddFactor(graph.Factors()[static_cast<std::size_t>(k)].factor);
  }
  EXPECT_GT(moved, 10u);
  return shuffled;
}

TEST(MeasurementStream, OdometryIsWhatLeadsToTheLatestPose) {
  for (const Strategy strategy : {Strategy::kApfl, Strategy::kFpfl}) {
    ExpectSameAsReplay(ShuffledWithinPoses(MakeScene<SE2>(Scene::kManhattan, 120).graph), strategy);
    ExpectSameAsReplay(ShuffledWithinPoses(MakeScene<SE3>(Scene::kSphere, 120).graph), strategy);
  }
}

template <class Pose>
CompactOptions<Pose> DroppingOptions(const PoseGraph<Pose>& graph) {
  CompactOptions<Pose> options = OptionsFor(GraphReplay<Pose>(graph), Strategy::kFpfl);
  options.thresholds.min_loop_gain = 0.5;
  options.thresholds.min_pose_gain = 4;
  return options;
}

// A wandering robot with exact measurements and few loops, to any pose: rough ones, and ones far better than odometry.
template <class Pose>
PoseGraph<Pose> Wander(std::vector<Pose>& truth) {
  Random rng(7);
  PoseGraph<Pose> graph;
  for (int k = 0; k < 150; ++k) {
    truth.push_back(k == 0 ? Pose() : truth.back() * RandomMotion<Pose>(rng, 0.5, 0.2));
    graph.AddPose(PoseId{k}, k == 0 ? std::optional<Pose>(Pose()) : std::nullopt);
    const auto measure = [&](int from, double information) {
      graph.AddFactor(RelativePoseFactor<Pose>{PoseId{from}, PoseId{k},
                                               truth[static_cast<std::size_t>(from)].Inverse() * truth.back(),
                                               information * Pose::Jacobian::Identity()});
    };
    if (k > 0) measure(k - 1, 200);
    if (k > 20 && k % 6 == 0) measure(static_cast<int>(rng() % static_cast<unsigned>(k - 10)), k % 12 == 0 ? 5 : 1e5);
  }
  return graph;
}

// With exact measurements every link that is carried wrongly would bend the map or be refused.
template <class Pose>
void ExpectLoopsToDroppedPoses() {
  std::vector<Pose> truth;
  const auto graph = Wander<Pose>(truth);
  CompactOptions<Pose> options;
  options.strategy = Strategy::kFpfl;
  options.thresholds.range.setConstant(4);
  options.thresholds.min_loop_gain = 0.3;
  options.thresholds.min_pose_gain = 2 * Pose::kDof;
  StreamRun<Pose> streamed(options);
  streamed.AddAll(graph);
  // Only what is measured between two kept poses, as it was before loops were carried.
  GraphReplay<Pose> replay(graph);
  CompactPoseSlam<Pose> exact(options);
  for (CompactInput<Pose> input : replay.Inputs()) {
    const auto hangs = [&](const RelativePoseFactor<Pose>& loop) {
      const PoseId other = loop.from == input.id ? loop.to : loop.from;
      return exact.KeptBase(other) != other;
    };
    input.loops->erase(std::remove_if(input.loops->begin(), input.loops->end(), hangs), input.loops->end());
    exact.AddPose(input);
  }
  int revived = 0, carried = 0;
  for (const Decision& d : streamed.decisions) {
    revived += static_cast<int>(d.revived.size());
    for (const Candidate& c : d.candidates) carried += c.accepted && c.carried_from;
  }
  const int dropped = streamed.slam.PosesSeen() - static_cast<int>(streamed.slam.Solver().Graph().Poses().size());
  EXPECT_GT(dropped, 10);
  EXPECT_GT(revived, 3);
  EXPECT_GT(carried, 1);
  EXPECT_GT(streamed.slam.LinksKept(), exact.LinksKept());
  for (const Decision& d : streamed.decisions) EXPECT_EQ(d.links_refused, 0) << d.id.value;
  for (const auto& pose : streamed.slam.Trajectory()) {
    EXPECT_LT(Distance(pose.T_world_body, truth[static_cast<std::size_t>(pose.id.value)]), 1e-6) << pose.id.value;
  }
}

TEST(MeasurementStream, OffersLoopsToDroppedPosesAtTheKeptOnes) {
  ExpectLoopsToDroppedPoses<SE2>();
  ExpectLoopsToDroppedPoses<SE3>();
}

RelativePoseFactor<SE2> Edge(std::int64_t from, std::int64_t to, const SE2& T_from_to, double information = 400) {
  return {{from}, {to}, T_from_to, information * Matrix<3, 3>::Identity()};
}
SE2 Ahead(double metres) { return SE2(Vector<2>(metres, 0), 0); }
PosePriorFactor<SE2> Prior(std::int64_t id, const SE2& T_world_body) {
  return {{id}, T_world_body, 400 * Matrix<3, 3>::Identity()};
}

CompactOptions<SE2> LineOptions(Strategy strategy = Strategy::kFpfl) {
  CompactOptions<SE2> options;
  options.strategy = strategy;
  options.thresholds.range = {3, 3, 1};
  options.thresholds.min_loop_gain = 0.1;
  options.thresholds.min_pose_gain = 1.5;
  options.thresholds.link_covariance = 0.0025 * Matrix<3, 3>::Identity();
  return options;
}

// Poses 0, 1, 2, ... half a metre apart; every second one or so is dropped.
StreamRun<SE2> Line(int poses, Strategy strategy = Strategy::kFpfl) {
  StreamRun<SE2> run(LineOptions(strategy));
  for (int k = 1; k < poses; ++k) run.Add(Edge(k - 1, k, Ahead(0.5)));
  return run;
}

TEST(MeasurementStream, ClosesAPoseWhenTheNextOneOpens) {
  StreamRun<SE2> run(LineOptions());
  EXPECT_TRUE(run.stream.Flush().empty());
  run.Add(Edge(7, 3, Ahead(1)));
  ASSERT_EQ(run.decisions.size(), 1u);
  EXPECT_EQ(run.decisions[0].id, PoseId{7});
  EXPECT_EQ(run.decisions[0].verdict, PoseVerdict::kFirst);
  EXPECT_EQ(run.stream.Open(), PoseId{3});
  run.Add(Edge(9, 3, Ahead(1)));  // backwards
  ASSERT_EQ(run.decisions.size(), 2u);
  EXPECT_EQ(run.stream.Open(), PoseId{9});
  run.Take(run.stream.Flush());
  EXPECT_EQ(run.decisions.size(), 3u);
  EXPECT_FALSE(run.stream.Open());
  EXPECT_LT(Distance(run.slam.Estimate({9}), SE2()), 1e-9);
  run.Add(Edge(3, 4, Ahead(1)));  // goes on from an older pose
  run.Take(run.stream.Flush());
  EXPECT_LT(Distance(run.slam.Estimate({4}), Ahead(2)), 1e-9);
}

TEST(MeasurementStream, SeveralLoopsOnOneKeptPoseAreTriedOneAfterTheOther) {
  StreamRun<SE2> run(LineOptions(Strategy::kApfl));
  for (int k = 1; k < 8; ++k) run.Add(Edge(k - 1, k, Ahead(0.5), 40));
  run.Add(Edge(2, 7, SE2(Vector<2>(90, 0), 1)));  // wrong
  run.Add(Edge(7, 2, Ahead(-2.5)));
  run.Take(run.stream.Flush());
  EXPECT_EQ(run.decisions.back().links_refused, 1);
  EXPECT_EQ(run.decisions.back().links_accepted, 1);
  EXPECT_TRUE(run.links.empty());
  EXPECT_EQ(run.slam.LinksKept(), 1);
}

TEST(MeasurementStream, LateLinksAndTheirRemoval) {
  StreamRun<SE2> run = Line(12);
  run.Take(run.stream.Flush());
  PoseId first{0}, last{11};
  while (run.slam.KeptBase(first) == first) ++first.value;
  while (run.slam.KeptBase(last) == last) --last.value;
  run.Add(Edge(run.slam.KeptBase(first).value, first.value, Ahead(0.5)));
  ASSERT_EQ(run.links.size(), 1u);
  EXPECT_FALSE(run.links[0].decision.accepted);  // both ends hang on one pose
  run.links.clear();
  const double length = 0.5 * static_cast<double>(last.value - first.value);
  const SE2 before = run.slam.Estimate(last);
  run.Add(Edge(first.value, last.value, Ahead(length + 0.05), 4000));
  ASSERT_EQ(run.links.size(), 1u);
  const LateLink link = run.links[0];
  EXPECT_EQ(link.from, first);
  EXPECT_EQ(link.decision.from, run.slam.KeptBase(first));
  ASSERT_TRUE(link.decision.accepted);
  EXPECT_GT(Distance(run.slam.Estimate(last), before), 0.01);
  run.slam.RemoveLink(*link.decision.factor);
  EXPECT_LT(Distance(run.slam.Estimate(last), before), 1e-6);
  EXPECT_EQ(run.slam.LinksKept(), 0);
}

TEST(MeasurementStream, PriorsAndFixedPoses) {
  const SE2 shift(Vector<2>(10, -3), 0.4);
  StreamRun<SE2> run(LineOptions());
  run.Add(Prior(0, shift));  // opens the first pose
  EXPECT_EQ(run.stream.Open(), PoseId{0});
  run.Add(Edge(0, 1, Ahead(0.5)));
  run.Add(Prior(1, shift * Ahead(0.5)));
  run.stream.SetValue({2}, shift * Ahead(1));
  run.stream.Fix({{2}});
  run.Add(Edge(1, 2, Ahead(0.5)));
  run.Add(Edge(2, 3, Ahead(0.5)));
  run.Take(run.stream.Flush());
  ASSERT_EQ(run.decisions.size(), 4u);
  EXPECT_EQ(run.decisions[1].verdict, PoseVerdict::kPrior);
  EXPECT_EQ(run.decisions[2].verdict, PoseVerdict::kPrior);
  EXPECT_LT(Distance(run.slam.Estimate({3}), shift * Ahead(1.5)), 1e-6);
}

// The only absolute measurement, on a kept or a dropped pose: the whole map goes there.
TEST(MeasurementStream, LatePriors) {
  const SE2 shift(Vector<2>(10, -3), 0.4);
  for (const bool on_dropped : {false, true}) {
    StreamRun<SE2> run = Line(8);
    run.Take(run.stream.Flush());
    PoseId id{1};
    while ((run.slam.KeptBase(id) != id) != on_dropped) ++id.value;
    run.Add(Prior(id.value, shift * Ahead(0.5 * static_cast<double>(id.value))));
    ASSERT_EQ(run.priors.size(), 1u);
    EXPECT_EQ(run.priors[0].kept, run.slam.KeptBase(id));
    run.slam.Finish();
    for (int k = 0; k < 8; ++k) EXPECT_LT(Distance(run.slam.Estimate({k}), shift * Ahead(0.5 * k)), 1e-5) << k;
    if (on_dropped) {
      const SE2 T_world_body = shift * Ahead(0.5 * static_cast<double>(id.value));
      run.Add(PositionPriorFactor<SE2>{id, T_world_body.Translation(), Matrix<2, 2>::Identity()});
      ASSERT_EQ(run.priors.size(), 2u);
      EXPECT_EQ(run.priors[1].kept, run.slam.KeptBase(id));
    }
    run.Add(Edge(7, 8, Ahead(0.5)));  // the search goes on
    run.Take(run.stream.Flush());
    EXPECT_LT(Distance(run.slam.Estimate({8}), shift * Ahead(4)), 1e-5);
  }
}

TEST(MeasurementStream, ErrorsLeaveItAsItWas) {
  const auto graph = MakeScene<SE2>(Scene::kManhattan, 60).graph;
  const CompactOptions<SE2> options = DroppingOptions(graph);
  StreamRun<SE2> plain(options), disturbed(options);
  plain.AddAll(graph);
  const PoseId first = graph.Poses()[0].id;
  disturbed.stream.SetValue(first, *graph.Poses()[0].T_world_body);
  for (const auto& factor : InOrderOfArrival(graph)) {
    disturbed.Add(factor);
    const auto refuse = [&](const Factor<SE2>& bad) { EXPECT_THROW(disturbed.Add(bad), std::invalid_argument); };
    const std::int64_t open = disturbed.stream.Open()->value;
    refuse(Edge(100000, 100001, Ahead(1)));
    refuse(Edge(open, open, Ahead(1)));
    refuse(Edge(open, 100000, Ahead(NAN)));
    refuse(Edge(open, 100000, Ahead(1), -1));
    refuse(Prior(100000, SE2()));
    refuse(Prior(open, Ahead(INFINITY)));
    EXPECT_THROW(disturbed.stream.Fix({first}), std::invalid_argument);
    EXPECT_THROW(disturbed.stream.Fix({{100002}, {open}}), std::invalid_argument);
    EXPECT_THROW(disturbed.stream.SetValue(first, SE2()), std::invalid_argument);
    EXPECT_THROW(disturbed.stream.SetValue({open}, Ahead(NAN)), std::invalid_argument);
    EXPECT_EQ(disturbed.stream.Open()->value, open);
  }
  disturbed.Take(disturbed.stream.Flush());
  ASSERT_EQ(plain.decisions.size(), disturbed.decisions.size());
  for (std::size_t k = 0; k < plain.decisions.size(); ++k) ExpectEqual(plain.decisions[k], disturbed.decisions[k]);
  ExpectSameTrajectory(plain.slam, disturbed.slam);
}

TEST(MeasurementStream, RefusesRandomDraws) {
  CompactPoseSlam<SE2> slam(LineOptions(Strategy::kGiven));
  EXPECT_THROW(MeasurementStream<SE2>{slam}, std::invalid_argument);
}

// What a robot's program may send, numbers beyond all reason included.
template <class Pose>
class ExtremeStream {
 public:
  using Input = std::variant<Factor<Pose>, VertexLine<Pose>, FixLine, FactorId, char>;  // char: 'f'lush or 'd'iscard

  explicit ExtremeStream(unsigned seed) : random_(seed) {}
  Input Next() {
    const int kind = Pick(100);
    if (kind < 55) return Edge(last_, ++newest_);
    if (kind < 75) return Edge(Known(), Pick(4) == 0 ? Known() : last_);
    if (kind < 80) return Edge(Known(), Known());
    if (kind < 84) return PosePriorFactor<Pose>{{Known()}, Motion(), Information<Pose::kDof>()};
    if (kind < 88) return PositionPriorFactor<Pose>{{Known()}, Motion().Translation(), Information<Pose::kDim>()};
    if (kind < 91) return VertexLine<Pose>{{newest_ + 1}, Motion()};
    if (kind < 92) return FixLine{{{newest_ + Pick(2)}}};
    if (kind < 95) return FactorId{Pick(40)};
    return kind < 98 ? 'f' : 'd';
  }
  // The newest pose that the stream knows: odometry goes on from there.
  void Tell(std::int64_t last) { last_ = last; }

 private:
  int Pick(int count) { return static_cast<int>(random_() % static_cast<unsigned>(count)); }
  std::int64_t Known() { return Pick(static_cast<int>(newest_) + 2); }
  double Extreme() {
    constexpr double kNumbers[] = {0, 1e-308, 1e-160, 1e-20, 1e9, 1e20, 1e80, 1e155, 1e300, 1.7e308};
    return (Pick(2) == 0 ? 1 : -1) * kNumbers[Pick(10)];
  }
  Pose Motion() {
    Vector<Pose::kDof> v;
    for (int i = 0; i < Pose::kDof; ++i) v[i] = Pick(40) == 0 ? Extreme() : 0.1 * Pick(10) - 0.3;
    return Pose::Exp(v);
  }
  template <int N>
  Matrix<N, N> Information() {
    Vector<N> diagonal;
    for (int i = 0; i < N; ++i) diagonal[i] = Pick(60) == 0 ? Extreme() : 100;
    return diagonal.asDiagonal();
  }
  RelativePoseFactor<Pose> Edge(std::int64_t from, std::int64_t to) {
    return {{from}, {to}, Motion(), Information<Pose::kDof>()};
  }
  std::mt19937 random_;
  std::int64_t newest_ = 0, last_ = 0;
};

// As terse online does: what throws was answered with an error. Whether the line was taken.
template <class Pose>
bool Take(StreamRun<Pose>& run, const typename ExtremeStream<Pose>::Input& input) {
  try {
    if (const auto* factor = std::get_if<Factor<Pose>>(&input)) {
      run.Add(*factor);
    } else if (const auto* vertex = std::get_if<VertexLine<Pose>>(&input)) {
      run.stream.SetValue(vertex->id, vertex->T_world_body);
    } else if (const auto* fix = std::get_if<FixLine>(&input)) {
      run.stream.Fix(fix->poses);
    } else if (const auto* id = std::get_if<FactorId>(&input)) {
      run.slam.RemoveLink(*id);
    } else if (std::get<char>(input) == 'f') {
      run.Take(run.stream.Flush());
    } else {
      run.stream.Discard();
    }
    return true;
  } catch (const NumericalError&) {
  } catch (const std::invalid_argument&) {
  }
  return false;
}

// What can be seen of a run.
template <class Pose>
std::string Picture(const StreamRun<Pose>& run) {
  std::string out = run.stream.Open() ? Bits(*run.stream.Open()) : "";
  for (const auto& pose : run.slam.Trajectory()) out += Bits(pose.id) + Bits(pose.kept) + Bits(pose.T_world_body);
  for (const Pose& point : run.slam.Solver().LinearizationPoints()) out += Bits(point);
  for (const auto& node : run.slam.Solver().Graph().Factors()) out += Bits(node.id);
  return out + Bits(run.slam.LinksKept());
}

template <class Pose>
void ExpectErrorsChangeNothing(Strategy strategy, RobustKernel kernel, unsigned seed) {
  SCOPED_TRACE("seed " + std::to_string(seed) + ", strategy " + Name(strategy));
  CompactOptions<Pose> options;
  options.strategy = strategy;
  options.thresholds.range.setConstant(3);
  options.solver.robust.kernel = kernel;
  StreamRun<Pose> live(options), replayed(options);
  ExtremeStream<Pose> stream(seed);
  int failed = 0;
  for (int k = 0; k < 120; ++k) {
    const auto input = stream.Next();
    const std::string before = Picture(live);
    if (Take(live, input)) {
      ASSERT_TRUE(Take(replayed, input)) << "line " << k;
    } else {
      ++failed;
      ASSERT_EQ(Picture(live), before) << "line " << k;
    }
    ASSERT_EQ(Picture(live), Picture(replayed)) << "line " << k;
    ASSERT_EQ(live.decisions.size(), replayed.decisions.size());
    if (live.stream.Open()) stream.Tell(live.stream.Open()->value);
  }
  for (std::size_t k = 0; k < live.decisions.size(); ++k) ExpectEqual(live.decisions[k], replayed.decisions[k]);
  EXPECT_GT(failed, 0);
}

TEST(MeasurementStream, ErrorsChangeNothingOnExtremeStreams) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    for (const Strategy strategy : {Strategy::kFpfl, Strategy::kApfl, Strategy::kApal}) {
      ExpectErrorsChangeNothing<SE2>(strategy, RobustKernel::kNone, seed);
    }
    ExpectErrorsChangeNothing<SE3>(Strategy::kFpfl, RobustKernel::kNone, seed);
    ExpectErrorsChangeNothing<SE2>(Strategy::kFpfl, RobustKernel::kDcs, seed);
  }
}

TEST(MeasurementStream, APoseThatCannotBeClosedStaysOpen) {
  StreamRun<SE2> run = Line(4);
  EXPECT_EQ(run.stream.Open(), PoseId{3});
  run.Add(Edge(3, 4, Ahead(1e300)));
  const int seen = run.slam.PosesSeen();
  for (int k = 0; k < 2; ++k) {
    EXPECT_THROW(run.Add(Edge(4, 5, Ahead(1e300))), NumericalError);
    EXPECT_THROW(run.stream.Flush(), NumericalError);
    EXPECT_EQ(run.stream.Open(), PoseId{4});
    EXPECT_EQ(run.slam.PosesSeen(), seen);
  }
  run.stream.Discard();
  EXPECT_FALSE(run.stream.Open());
  run.Add(Edge(3, 4, Ahead(0.5)));
  run.Take(run.stream.Flush());
  EXPECT_LT(Distance(run.slam.Estimate({4}), Ahead(2)), 1e-9);
}

// Saved anywhere, in the middle of a pose too, and loaded into another run, it goes on to the last bit.
template <class Pose>
void ExpectSavedAnywhere() {
  const RandomGraph<Pose> scene = MakeLaps<Pose>(5);
  GraphReplay<Pose> replay(scene.graph);
  const auto options = OptionsFor(replay, Strategy::kFpfl);
  const auto factors = InOrderOfArrival(scene.graph);
  StreamRun<Pose> whole(options);
  whole.AddAll(scene.graph);
  for (std::size_t cut = 3; cut < factors.size(); cut += 7) {
    StreamRun<Pose> run(options);
    run.stream.SetValue(scene.graph.Poses()[0].id, *scene.graph.Poses()[0].T_world_body);
    for (std::size_t k = 0; k < cut; ++k) run.Add(factors[k]);
    const PoseId later{1 << 20};  // its value is known before it comes
    run.stream.SetValue(later, Pose());
    const TestFile file("stream.state");
    run.stream.Save(file.Path());
    StreamRun<Pose> other{CompactOptions<Pose>()};
    other.stream = MeasurementStream<Pose>::Load(file.Path(), other.slam);
    EXPECT_EQ(other.stream.Open(), run.stream.Open());
    for (std::size_t k = cut; k < factors.size(); ++k) other.Add(factors[k]);
    other.Take(other.stream.Flush());
    EXPECT_EQ(Bits(other.slam.Solver().LogDeterminant()), Bits(whole.slam.Solver().LogDeterminant())) << cut;
    for (const auto& node : whole.slam.Solver().Graph().Poses()) {
      ASSERT_EQ(Bits(other.slam.Estimate(node.id)), Bits(whole.slam.Estimate(node.id))) << cut;
    }
    const std::string before = Bits(run.slam.Solver().LogDeterminant());
    run.slam.Save(file.Path());
    EXPECT_THROW(MeasurementStream<Pose>::Load(file.Path(), run.slam), FileError);
    EXPECT_EQ(Bits(run.slam.Solver().LogDeterminant()), before);
  }
}

TEST(MeasurementStream, IsSavedAnywhere) {
  ExpectSavedAnywhere<SE2>();
  ExpectSavedAnywhere<SE3>();
}

}  // namespace
}  // namespace terse
