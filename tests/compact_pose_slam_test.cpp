// Algorithm 1: against batch optimisation where it keeps everything, and its rules where it does not.

#include "terse/compact/compact_pose_slam.h"

#include <gtest/gtest.h>

#include <cstring>
#include <limits>

#include "terse/core/batch_solver.h"
#include "terse/core/error.h"
#include "terse/core/initial_values.h"
#include "testing_compact.h"

namespace terse {
namespace {

using testing::Random;
using testing::RunReplay;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

template <class Pose>
class CompactPoseSlamTest : public ::testing::Test {
 public:
  static PoseGraph<Pose> RandomGraph(std::uint64_t seed, bool priors = false) {
    Random rng(seed);
    testing::RandomGraphOptions options;
    options.poses = 40;
    options.priors = priors;
    options.id_stride = 7;
    return testing::MakeRandomGraph<Pose>(rng, options).graph;
  }
};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactPoseSlamTest, Groups);

template <class Pose>
void ExpectAllKeptEqualsBatch(const PoseGraph<Pose>& graph) {
  auto run = RunReplay(graph, Strategy::kApal, 1, 3);
  const auto result = run.slam->Finish();
  const auto batch = SolveBatch(graph, ComputeInitialValues(graph, InitialValues::kCompose));
  ASSERT_TRUE(result.Converged() && batch.Converged());
  EXPECT_EQ(run.slam->Solver().Graph().Poses().size(), graph.Poses().size());
  EXPECT_EQ(run.slam->Solver().Graph().Factors().size(), graph.Factors().size());
  EXPECT_NEAR(result.chi2, batch.chi2, 1e-8 * batch.chi2);
}

TYPED_TEST(CompactPoseSlamTest, KeepingAllIsTheBatchProblem) {
  for (const std::uint64_t seed : testing::Seeds(1, 6)) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    ExpectAllKeptEqualsBatch(this->RandomGraph(seed, seed % 2 == 0));
  }
}

// The short way to add a pose is the long one with nothing else known of it.
TYPED_TEST(CompactPoseSlamTest, APoseItsOdometryAndARegistration) {
  const auto graph = this->RandomGraph(11);
  GraphReplay<TypeParam> replay(graph), again(graph);
  CompactOptions<TypeParam> options;
  options.strategy = Strategy::kFpfl;
  options.thresholds.range = replay.LinkRange();
  options.thresholds.min_loop_gain = 0.5;
  options.thresholds.min_pose_gain = 2;
  CompactPoseSlam<TypeParam> by_input(options), by_pose(options);
  const auto registration = replay.AsRegistration(), same_registration = again.AsRegistration();
  int links = 0;
  for (CompactInput<TypeParam> input : replay.Inputs()) {
    input.loops.reset();
    input.linkable.reset();
    input.T_world_body.reset();
    const Decision a = by_input.AddPose(input, registration);
    const Decision b = by_pose.AddPose(input.id, input.odometry, same_registration);
    EXPECT_EQ(a.verdict, b.verdict);
    EXPECT_EQ(a.pose_gain, b.pose_gain);
    EXPECT_EQ(a.links_accepted, b.links_accepted);
    EXPECT_EQ(a.anchored_to, b.anchored_to);
    links += a.links_accepted + (a.anchored_to ? 1 : 0);
  }
  EXPECT_GT(links, 0) << "the registration is asked, and what it says is of use";
  EXPECT_EQ(by_input.Finish().chi2, by_pose.Finish().chi2);
  EXPECT_THROW(by_pose.AddPose(PoseId{-1}, std::nullopt), std::invalid_argument) << "only the first has no odometry";
}

TEST(CompactScenes, KeepingAllIsTheBatchProblem) {
  ExpectAllKeptEqualsBatch(testing::MakeScene<SE3>(Scene::kEllipse, 0, 1).graph);
  ExpectAllKeptEqualsBatch(testing::MakeScene<SE3>(Scene::kGarage, 200, 1).graph);
  ExpectAllKeptEqualsBatch(testing::MakeScene<SE2>(Scene::kManhattan, 300, 1).graph);
}

TYPED_TEST(CompactPoseSlamTest, AFixedPoseIsHeldAtItsValue) {
  for (const int fixed : {0, 17}) {
    auto graph = this->RandomGraph(3);
    const auto& node = graph.Poses()[static_cast<std::size_t>(fixed)];
    graph.SetFixed(node.id, true);
    ExpectAllKeptEqualsBatch(graph);
    auto run = RunReplay(graph, Strategy::kFpfl, 1, 1e9);
    run.slam->Finish();
    // kAnchorInformation against some edges of information 1e2 that pull by 0.02.
    EXPECT_LT(testing::Distance(run.slam->Estimate(node.id), *node.T_world_body), 1e-4);
  }
}

template <class Pose>
void ExpectSameGraph(const PoseGraph<Pose>& a, const PoseGraph<Pose>& b) {
  ASSERT_EQ(a.Poses().size(), b.Poses().size());
  ASSERT_EQ(a.Factors().size(), b.Factors().size());
  for (std::size_t k = 0; k < a.Poses().size(); ++k) EXPECT_EQ(a.Poses()[k].id, b.Poses()[k].id);
  for (std::size_t k = 0; k < a.Factors().size(); ++k) {
    const auto x = PosesOf(a.Factors()[k].factor), y = PosesOf(b.Factors()[k].factor);
    EXPECT_TRUE(x.first == y.first && x.second == y.second);
  }
}

TYPED_TEST(CompactPoseSlamTest, DroppingNothingIsTheGraphOfAllPosesFewLinks) {
  for (const std::uint64_t seed : testing::Seeds(1, 3)) {
    const auto graph = this->RandomGraph(seed);
    const auto few = RunReplay(graph, Strategy::kFpfl, 0, 0), all = RunReplay(graph, Strategy::kApfl, 0, 0);
    ExpectSameGraph(few.slam->Solver().Graph(), all.slam->Solver().Graph());
    for (std::size_t k = 0; k < few.decisions.size(); ++k) {
      EXPECT_TRUE(few.decisions[k].Kept());
      EXPECT_EQ(few.decisions[k].links_accepted, all.decisions[k].links_accepted);
    }
    EXPECT_EQ(few.slam->Solver().Chi2(), all.slam->Solver().Chi2()) << "the same calls give the same bits";
  }
}

// What the header says of a decision, read off the decision.
template <class Pose>
void ExpectRulesObeyed(const testing::ReplayedRun<Pose>& run, const CompactOptions<Pose>& options) {
  std::set<std::int64_t> kept;
  int links = 0;
  for (const Decision& d : run.decisions) {
    int tried = 0, accepted = 0;
    double least = kInfinity, worst_accepted = kInfinity;
    for (const PoseId id : d.revived) EXPECT_TRUE(kept.insert(id.value).second) << "it had been dropped";
    EXPECT_EQ(d.candidates_found, static_cast<int>(d.candidates.size())) << "none is left out of the record";
    for (const Candidate& c : d.candidates) {
      EXPECT_EQ(kept.count(c.id.value), 1u) << "only kept poses are candidates";
      EXPECT_LE(c.probability, 1);
      if (!c.measured) {
        EXPECT_GT(c.probability, options.thresholds.probability);
        EXPECT_FALSE(c.tried || c.carried_from);
        least = std::min(least, c.gain);
      }
      tried += c.tried ? 1 : 0;
      accepted += c.accepted ? 1 : 0;
      if (c.tried) {
        EXPECT_GT(c.gain, options.thresholds.min_loop_gain);
      }
      EXPECT_EQ(c.accepted, c.measured_gain && *c.measured_gain > options.thresholds.min_loop_gain);
      if (c.measured_gain) {
        EXPECT_TRUE(c.tried);
      }
      if (c.accepted) worst_accepted = std::min(worst_accepted, *c.measured_gain);
    }
    EXPECT_EQ(tried, d.registrations_tried);
    EXPECT_LE(tried, options.max_registrations);
    EXPECT_EQ(accepted, d.links_accepted);
    EXPECT_GT(worst_accepted, options.thresholds.min_loop_gain);
    if (accepted == 0 && d.pose_gain) {
      EXPECT_EQ(*d.pose_gain, least);
    }
    EXPECT_EQ(d.verdict == PoseVerdict::kFirst, kept.empty());
    EXPECT_EQ(d.verdict == PoseVerdict::kLoopClosed, accepted > 0);
    if (d.verdict == PoseVerdict::kNothingInRange) {
      EXPECT_FALSE(d.pose_gain);
    }
    if (d.verdict == PoseVerdict::kInformative) {
      EXPECT_GT(*d.pose_gain, options.thresholds.min_pose_gain);
    }
    if (d.verdict == PoseVerdict::kRedundant) {
      EXPECT_LE(*d.pose_gain, options.thresholds.min_pose_gain);
    }
    links += accepted;
    if (d.Kept()) kept.insert(d.id.value);
  }
  const auto& graph = run.slam->Solver().Graph();
  EXPECT_EQ(graph.Poses().size(), kept.size());
  for (const auto& node : graph.Poses()) EXPECT_EQ(kept.count(node.id.value), 1u);
  EXPECT_EQ(run.slam->LinksKept(), links);
  EXPECT_EQ(graph.Factors().size(), kept.size() - 1 + static_cast<std::size_t>(links));
  EXPECT_EQ(run.slam->PosesSeen(), static_cast<int>(run.decisions.size()));
}

template <class Pose>
void ExpectRulesObeyed(const PoseGraph<Pose>& graph) {
  for (const double loop : {0.0, 1.0, 4.0}) {
    for (const double pose : {0.0, 2.0, 8.0}) {
      GraphReplay<Pose> replay(graph);
      auto options = testing::OptionsFor(replay, Strategy::kFpfl);
      options.thresholds.min_loop_gain = loop;
      options.thresholds.min_pose_gain = pose;
      options.most_recorded = 1 << 20;
      ExpectRulesObeyed(RunReplay(replay, options), options);
    }
  }
}

TYPED_TEST(CompactPoseSlamTest, DecisionsObeyTheRules) {
  for (const std::uint64_t seed : testing::Seeds(1, 3)) ExpectRulesObeyed(this->RandomGraph(seed));
}

TEST(CompactScenes, DecisionsObeyTheRules) {
  ExpectRulesObeyed(testing::MakeScene<SE3>(Scene::kEllipse, 0, 1).graph);
  ExpectRulesObeyed(testing::MakeScene<SE2>(Scene::kManhattan, 300, 1).graph);
}

TEST(CompactScenes, HigherThresholdsKeepLess) {
  const auto scene = testing::MakeScene<SE2>(Scene::kManhattan, 300, 2);
  std::size_t last = scene.graph.Poses().size() + 1;
  for (const double gain : {0.0, 2.0, 4.0, 6.0}) {
    const auto kept = RunReplay(scene.graph, Strategy::kFpfl, 1e9, gain).slam->Solver().Graph().Poses().size();
    EXPECT_LE(kept, last);
    last = kept;
  }
  EXPECT_LT(last, scene.graph.Poses().size() * 3 / 4) << "a threshold of 6 nats drops poses";
  int links = static_cast<int>(scene.graph.Factors().size());
  for (const double gain : {0.0, 2.0, 4.0, 8.0}) {
    const int kept = RunReplay(scene.graph, Strategy::kApfl, gain, 0).slam->LinksKept();
    EXPECT_LE(kept, links);
    links = kept;
  }
}

TYPED_TEST(CompactPoseSlamTest, TwoRunsAreTheSameToTheBit) {
  const auto graph = this->RandomGraph(5);
  auto a = RunReplay(graph, Strategy::kFpfl, 0.5, 3), b = RunReplay(graph, Strategy::kFpfl, 0.5, 3);
  const auto same = [](const TypeParam& x, const TypeParam& y) { return std::memcmp(&x, &y, sizeof(x)) == 0; };
  for (int round = 0; round < 2; ++round) {
    const auto x = a.slam->Trajectory(), y = b.slam->Trajectory();
    ASSERT_EQ(x.size(), y.size());
    for (std::size_t k = 0; k < x.size(); ++k) {
      EXPECT_EQ(x[k].id, y[k].id);
      EXPECT_EQ(x[k].kept, y[k].kept);
      EXPECT_TRUE(same(x[k].T_world_body, y[k].T_world_body));
    }
    EXPECT_EQ(a.slam->Finish().chi2, b.slam->Finish().chi2);
  }
}

// Iterating to the optimum in the middle of a run changes nothing of the problem.
TYPED_TEST(CompactPoseSlamTest, FinishInTheMiddle) {
  const auto graph = this->RandomGraph(8, true);
  GraphReplay<TypeParam> replay(graph);
  CompactPoseSlam<TypeParam> slam(testing::OptionsFor(replay, Strategy::kApal));
  for (const auto& input : replay.Inputs()) {
    slam.AddPose(input);
    if (slam.PosesSeen() % 9 == 0) {
      EXPECT_TRUE(slam.Finish().Converged());
    }
  }
  const auto batch = SolveBatch(graph, ComputeInitialValues(graph, InitialValues::kCompose));
  EXPECT_NEAR(slam.Finish().chi2, batch.chi2, 1e-8 * batch.chi2);
}

// Misuse and failure ---------------------------------------------------------------------------------------------

template <class Pose>
struct Corridor {
  // Poses 1 m apart in x: each in range of those within `metres`.
  explicit Corridor(Strategy strategy = Strategy::kFpfl, double min_pose_gain = 1e-3) {
    options.strategy = strategy;
    options.thresholds.range.setConstant(5.5);
    options.thresholds.probability = 0.5;
    options.thresholds.link_covariance = 1e-4 * Pose::Jacobian::Identity();
    options.thresholds.min_loop_gain = 0.01;
    options.thresholds.min_pose_gain = min_pose_gain;
  }
  static Pose Step(double metres) {
    typename Pose::Tangent d = Pose::Tangent::Zero();
    d[0] = metres;
    return Pose::Exp(d);
  }
  static RelativePoseFactor<Pose> Edge(std::int64_t from, std::int64_t to, double information = 1e4) {
    return {PoseId{from}, PoseId{to}, Step(static_cast<double>(to - from)), information * Pose::Jacobian::Identity()};
  }
  static CompactInput<Pose> Input(std::int64_t id) {
    CompactInput<Pose> input;
    input.id = PoseId{id};
    if (id > 0) input.odometry = Edge(id - 1, id);
    return input;
  }
  static Registration<Pose> None() {
    return [](PoseId, PoseId) { return std::nullopt; };
  }
  static Registration<Pose> Exact() {
    return [](PoseId candidate, PoseId current) { return Edge(candidate.value, current.value); };
  }
  CompactOptions<Pose> options;
};

template <class Pose>
struct State {
  explicit State(const CompactPoseSlam<Pose>& slam)
      : seen(slam.PosesSeen()),
        links(slam.LinksKept()),
        poses(slam.Solver().Graph().Poses().size()),
        factors(slam.Solver().Graph().Factors().size()),
        variables(slam.Solver().Cholesky().Variables()),
        trajectory(slam.Trajectory().size()),
        log_determinant(slam.Solver().LogDeterminant()) {}
  bool operator==(const State& o) const {
    return seen == o.seen && links == o.links && poses == o.poses && factors == o.factors && variables == o.variables &&
           trajectory == o.trajectory && log_determinant == o.log_determinant;
  }
  int seen, links;
  std::size_t poses, factors;
  int variables;
  std::size_t trajectory;
  double log_determinant;
};

TYPED_TEST(CompactPoseSlamTest, DefectiveInputLeavesTheStateAsBefore) {
  using Pose = TypeParam;
  using C = Corridor<Pose>;
  const C corridor;
  CompactPoseSlam<Pose> slam(corridor.options);
  const auto refuse = [&](const CompactInput<Pose>& input, const char* what) {
    const State<Pose> before(slam);
    EXPECT_THROW(slam.AddPose(input, C::None()), std::invalid_argument) << what;
    EXPECT_TRUE(before == State<Pose>(slam)) << what;
  };
  auto first = C::Input(0);
  first.odometry = C::Edge(0, 1);
  refuse(first, "odometry of the first pose");
  first = C::Input(0);
  typename Pose::Tangent broken = Pose::Tangent::Zero();
  broken[0] = kNan;
  first.T_world_body = Pose::Exp(broken);
  refuse(first, "a first pose that is not finite");

  for (int id = 0; id < 8; ++id) slam.AddPose(C::Input(id), C::None());
  auto input = C::Input(8);
  input.odometry.reset();
  refuse(input, "no odometry");
  refuse(C::Input(7), "a pose twice");
  input = C::Input(8);
  input.odometry = C::Edge(99, 8);
  refuse(input, "odometry from an unknown pose");
  input.odometry = C::Edge(6, 7);
  refuse(input, "odometry between others");
  input.odometry = C::Edge(8, 8);
  refuse(input, "odometry to itself");
  input = C::Input(8);
  input.odometry->information(0, 0) = -1;
  refuse(input, "indefinite information");
  input = C::Input(8);
  input.odometry->T_from_to = Pose::Exp(broken);
  refuse(input, "odometry that is not finite");
  input = C::Input(8);
  input.priors.push_back(PosePriorFactor<Pose>{PoseId{3}, Pose(), Pose::Jacobian::Identity()});
  refuse(input, "another pose's prior");
  input.priors = {C::Edge(0, 8)};
  refuse(input, "a link among the priors");
  input.priors = {PosePriorFactor<Pose>{PoseId{8}, Pose(), -Pose::Jacobian::Identity()}};
  refuse(input, "an indefinite prior");
  input = C::Input(8);
  input.fixed = true;
  refuse(input, "a fixed pose without a value");
  input.T_world_body = Pose::Exp(broken);
  refuse(input, "a fixed pose that is not finite");

  slam.AddPose(C::Input(8), C::None());
  EXPECT_EQ(slam.PosesSeen(), 9);
  EXPECT_NEAR(slam.Estimate(PoseId{8}).Translation()[0], 8, 1e-9);
  EXPECT_THROW((void)slam.Estimate(PoseId{99}), std::invalid_argument);
}

TYPED_TEST(CompactPoseSlamTest, ALinkThatWasNotAskedForIsRefused) {
  using Pose = TypeParam;
  using C = Corridor<Pose>;
  for (const Strategy strategy : {Strategy::kApal, Strategy::kApfl, Strategy::kFpfl}) {
    const C corridor(strategy);
    CompactPoseSlam<Pose> slam(corridor.options);
    for (int id = 0; id < 4; ++id) slam.AddPose(C::Input(id), C::None());
    const State<Pose> before(slam);
    const auto defective = [&](RelativePoseFactor<Pose> link) {
      const auto registration = [link](PoseId, PoseId) { return link; };
      EXPECT_THROW(slam.AddPose(C::Input(4), registration), std::invalid_argument);
      EXPECT_TRUE(before == State<Pose>(slam));
    };
    defective(C::Edge(0, 1));
    defective(C::Edge(4, 4));
    defective(C::Edge(77, 4));
    const Registration<Pose> nan_link = [](PoseId a, PoseId b) {
      auto edge = C::Edge(a.value, b.value);
      edge.information(0, 0) = kNan;
      return edge;
    };
    EXPECT_THROW(slam.AddPose(C::Input(4), nan_link), std::invalid_argument);
    EXPECT_TRUE(before == State<Pose>(slam));
    const auto decision = slam.AddPose(C::Input(4), C::Exact());
    EXPECT_EQ(decision.verdict, PoseVerdict::kLoopClosed);
  }
}

// Links accepted before the callback threw stay, with their pose; without any, all is as before. Either way the run
// goes on.
TYPED_TEST(CompactPoseSlamTest, ACallbackThatThrows) {
  using Pose = TypeParam;
  using C = Corridor<Pose>;
  for (int calls = 0; calls < 3; ++calls) {
    const C corridor;
    CompactPoseSlam<Pose> slam(corridor.options);
    for (int id = 0; id < 6; ++id) slam.AddPose(C::Input(id), C::None());
    const State<Pose> before(slam);
    int left = calls;
    const Registration<Pose> registration = [&](PoseId a, PoseId b) -> std::optional<RelativePoseFactor<Pose>> {
      if (left-- == 0) throw std::runtime_error("camera unplugged");
      return C::Edge(a.value, b.value);
    };
    EXPECT_THROW(slam.AddPose(C::Input(6), registration), std::runtime_error);
    if (calls == 0) {
      EXPECT_TRUE(before == State<Pose>(slam));
      slam.AddPose(C::Input(6), C::None());
    } else {
      EXPECT_EQ(slam.PosesSeen(), 7);
      EXPECT_EQ(slam.LinksKept(), before.links + calls);
      EXPECT_EQ(slam.Trajectory().back().id, PoseId{6});
      EXPECT_TRUE(slam.Trajectory().back().kept);
      EXPECT_THROW(slam.AddPose(C::Input(6), C::None()), std::invalid_argument);
    }
    for (int id = 7; id < 12; ++id) slam.AddPose(C::Input(id), C::Exact());
    EXPECT_LT(slam.Finish().chi2, 1e-12);
    EXPECT_NEAR(slam.Estimate(PoseId{11}).Translation()[0], 11, 1e-9);
  }
}

TYPED_TEST(CompactPoseSlamTest, WithoutARegistrationOnlyOdometryIsKept) {
  using C = Corridor<TypeParam>;
  const C corridor(Strategy::kApfl);
  CompactPoseSlam<TypeParam> slam(corridor.options);
  for (int id = 0; id < 6; ++id) EXPECT_TRUE(slam.AddPose(C::Input(id), nullptr).Kept());
  EXPECT_EQ(slam.LinksKept(), 0);
}

// A null registration decides as one that never finds a motion, whatever the strategy asks it for.
TYPED_TEST(CompactPoseSlamTest, ANullRegistrationRegistersNothing) {
  using C = Corridor<TypeParam>;
  for (const Strategy strategy : {Strategy::kApal, Strategy::kApfl, Strategy::kFpfl}) {
    C corridor(strategy, 0.1);
    corridor.options.thresholds.min_loop_gain = 0;
    CompactPoseSlam<TypeParam> null(corridor.options), nothing(corridor.options);
    for (int id = 0; id < 8; ++id) {
      const Decision a = null.AddPose(C::Input(id), nullptr);
      const Decision b = nothing.AddPose(C::Input(id), [](PoseId, PoseId) { return std::nullopt; });
      EXPECT_EQ(a.verdict, b.verdict) << id;
      EXPECT_EQ(a.pose_gain, b.pose_gain) << id;
    }
    EXPECT_EQ(null.LinksKept(), 0);
  }
}

// In a corridor with exact arithmetic the decisions can be foretold.
TYPED_TEST(CompactPoseSlamTest, RedundantPosesAreDroppedUntilTheirLinkInforms) {
  using Pose = TypeParam;
  using C = Corridor<Pose>;
  // Odometry and links have the same covariance, so a displacement over k steps gains at least B/2 ln(1 + k).
  const C corridor(Strategy::kFpfl, Pose::kDof / 2.0 * std::log(1 + 1.5));
  CompactPoseSlam<Pose> slam(corridor.options);
  for (int id = 0; id < 4; ++id) {
    CompactInput<Pose> input = C::Input(id);
    const auto decision = slam.AddPose(input, C::None());
    if (id == 1) {
      EXPECT_NEAR(*decision.pose_gain, Pose::kDof / 2.0 * std::log(2.0), 1e-6);
    }
    EXPECT_EQ(decision.Kept(), id == 0 || id == 2) << id;
  }
  const auto trajectory = slam.Trajectory();
  for (std::size_t k = 0; k < 4; ++k)
    EXPECT_NEAR(trajectory[k].T_world_body.Translation()[0], static_cast<double>(k), 1e-9);
  // A prior or FIX keeps what is redundant otherwise.
  auto input = C::Input(4);
  input.odometry = C::Edge(2, 4, 1e6);
  input.priors.push_back(
      PositionPriorFactor<Pose>{PoseId{4}, C::Step(4).Translation(), Matrix<Pose::kDim, Pose::kDim>::Identity()});
  EXPECT_EQ(slam.AddPose(input, C::None()).verdict, PoseVerdict::kPrior);
  input = C::Input(5);
  input.odometry = C::Edge(4, 5, 1e6);
  input.fixed = true;
  input.T_world_body = C::Step(5);
  EXPECT_EQ(slam.AddPose(input, C::None()).verdict, PoseVerdict::kPrior);
}

TYPED_TEST(CompactPoseSlamTest, OptionsOutOfTheirDomainAreRefused) {
  using Pose = TypeParam;
  const auto refuse = [](auto change) {
    CompactOptions<Pose> options;
    change(options);
    EXPECT_THROW(CompactPoseSlam<Pose>{options}, std::invalid_argument);
  };
  refuse([](auto& o) { o.thresholds.range[0] = 0; });
  refuse([](auto& o) { o.thresholds.range[1] = kNan; });
  refuse([](auto& o) { o.thresholds.range[1] = kInfinity; });
  refuse([](auto& o) { o.thresholds.probability = 1; });
  refuse([](auto& o) { o.thresholds.probability = -0.1; });
  refuse([](auto& o) { o.thresholds.probability = kNan; });
  refuse([](auto& o) { o.thresholds.min_loop_gain = -1; });
  refuse([](auto& o) { o.thresholds.min_pose_gain = kNan; });
  refuse([](auto& o) { o.thresholds.link_covariance.setZero(); });
  refuse([](auto& o) { o.thresholds.link_covariance(0, 0) = kNan; });
  refuse([](auto& o) { o.thresholds.link_covariance(0, 1) = 0.001; });
  refuse([](auto& o) { o.distance.view_axis.setZero(); });
  refuse([](auto& o) { o.distance.view_axis[0] = kInfinity; });
  refuse([](auto& o) { o.solver.relinearize_interval = 0; });
  CompactOptions<Pose> options;
  options.thresholds.min_loop_gain = options.thresholds.min_pose_gain = kInfinity;
  EXPECT_NO_THROW(CompactPoseSlam<Pose>{options});
}

}  // namespace
}  // namespace terse
