// Wrong links: the innovation against its distribution, runs that refuse them, links that come late and links that are
// taken out again.

#include "terse/compact/innovation.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "terse/core/batch_solver.h"
#include "terse/core/chi_square.h"
#include "terse/core/outliers.h"
#include "testing_compact.h"

namespace terse {
namespace {

using testing::NormalVector;
using testing::Random;
using testing::RunReplay;

template <class Pose>
class InnovationTest : public ::testing::Test {
 public:
  using Jacobian = typename Pose::Jacobian;
  using Tangent = typename Pose::Tangent;

  // Correlated; metres and radians are the scales of the standard deviations.
  static Jacobian RandomCovariance(Random& rng, double metres, double radians) {
    Tangent scale = Tangent::Constant(radians);
    scale.template head<Pose::kDim>().setConstant(metres);
    return scale.asDiagonal() * testing::RandomInformation<Pose::kDof>(rng) * scale.asDiagonal();
  }
  // T_true with an error of this covariance on the right: an estimate T for which T Exp(d) is the truth.
  static UncertainPose<Pose> Draw(Random& rng, const Pose& T_true, const Jacobian& covariance) {
    const Jacobian L = testing::CholeskyFactor(covariance);
    const Tangent d = L * NormalVector<Pose::kDof>(rng);
    return {T_true * Pose::Exp(d).Inverse(), covariance};
  }
};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(InnovationTest, Groups);

TYPED_TEST(InnovationTest, IsChiSquareForCorrectMeasurements) {
  constexpr int kDof = TypeParam::kDof, kSamples = 4000;
  Random rng(1);
  for (int round = 0; round < 5; ++round) {
    SCOPED_TRACE("round " + std::to_string(round));
    const auto T_true = testing::RandomMotion<TypeParam>(rng, 5, 1);
    const auto of_predicted = this->RandomCovariance(rng, 0.05, 0.02),
               of_measured = this->RandomCovariance(rng, 0.02, 0.03);
    std::vector<double> distances;
    double sum = 0;
    for (int k = 0; k < kSamples; ++k) {
      distances.push_back(
          InnovationDistance(this->Draw(rng, T_true, of_predicted), this->Draw(rng, T_true, of_measured)));
      sum += distances.back();
    }
    // Four standard deviations of the mean, 2 % for what is not linear.
    EXPECT_NEAR(sum / kSamples, kDof, 4 * std::sqrt(2.0 * kDof / kSamples) + 0.02 * kDof);
    for (const double p : {0.1, 0.5, 0.9, 0.99}) {
      const double limit = ChiSquareQuantile(p, kDof);
      const auto within = std::count_if(distances.begin(), distances.end(), [&](double d) { return d <= limit; });
      EXPECT_NEAR(static_cast<double>(within) / kSamples, p, 4 * std::sqrt(p * (1 - p) / kSamples) + 0.005) << p;
    }
  }
}

// Against the definition, with the Jacobians from differences.
TYPED_TEST(InnovationTest, IsAsDefined) {
  using Pose = TypeParam;
  Random rng(2);
  for (int round = 0; round < 200; ++round) {
    const double size = round % 3 == 0 ? 0.01 : 0.6;
    const UncertainPose<Pose> predicted{testing::RandomMotion<Pose>(rng, 5, 1), this->RandomCovariance(rng, 0.1, 0.05)},
        measured{predicted.T_a_b * testing::RandomMotion<Pose>(rng, size, size),
                 this->RandomCovariance(rng, 0.05, 0.1)};
    const auto error = [&](const typename Pose::Tangent& dT, const typename Pose::Tangent& dZ) {
      return ((measured.T_a_b * Pose::Exp(dZ)).Inverse() * (predicted.T_a_b * Pose::Exp(dT))).Log();
    };
    typename Pose::Jacobian of_T, of_Z;
    const typename Pose::Tangent zero = Pose::Tangent::Zero();
    constexpr double kStep = 1e-6;
    for (int i = 0; i < Pose::kDof; ++i) {
      typename Pose::Tangent d = zero;
      d[i] = kStep;
      of_T.col(i) = (error(d, zero) - error(-d, zero)) / (2 * kStep);
      of_Z.col(i) = (error(zero, d) - error(zero, -d)) / (2 * kStep);
    }
    const Eigen::MatrixXd S =
        of_T * predicted.covariance * of_T.transpose() + of_Z * measured.covariance * of_Z.transpose();
    const Eigen::VectorXd e = error(zero, zero);
    const double expected = e.dot(testing::Solve(S, e).col(0));
    ASSERT_NEAR(InnovationDistance(predicted, measured), expected, 1e-6 * expected) << "round " << round;
  }
}

// The factor the other way round, and the displacement with it: the same but for what is not linear.
TYPED_TEST(InnovationTest, DoesNotDependOnTheDirection) {
  using Pose = TypeParam;
  Random rng(3);
  for (const double scale : {1e-4, 1e-3}) {
    for (int round = 0; round < 50; ++round) {
      const auto T_true = testing::RandomMotion<Pose>(rng, 5, 1);
      const auto predicted = this->Draw(rng, T_true, this->RandomCovariance(rng, scale, scale));
      const auto measured = this->Draw(rng, T_true, this->RandomCovariance(rng, scale, scale));
      const double forward = InnovationDistance(predicted, measured);
      EXPECT_NEAR(InnovationDistance(Invert(predicted), Invert(measured)), forward, 100 * scale * (1 + forward));
      // The same link seen from the same pose, whichever way it is stored.
      RelativePoseFactor<Pose> link{PoseId{1}, PoseId{2}, measured.T_a_b, testing::Inverse(measured.covariance)};
      link.information = ((link.information + link.information.transpose()) / 2).eval();
      RelativePoseFactor<Pose> back{PoseId{2}, PoseId{1}, measured.T_a_b.Inverse(),
                                    testing::Inverse(Invert(measured).covariance)};
      back.information = ((back.information + back.information.transpose()) / 2).eval();
      EXPECT_NEAR(InnovationDistance(predicted, SeenFrom(PoseId{1}, back)),
                  InnovationDistance(predicted, SeenFrom(PoseId{1}, link)), 1e-6 * forward);
    }
  }
}

// In a run ---------------------------------------------------------------------------------------------------------

using Link = std::pair<std::int64_t, std::int64_t>;

template <class Pose>
std::set<Link> Accepted(const testing::ReplayedRun<Pose>& run) {
  std::set<Link> out;
  for (const Decision& d : run.decisions) {
    for (const Candidate& c : d.candidates) {
      if (c.accepted) out.insert({c.id.value, d.id.value});
    }
  }
  return out;
}

// As many wrong loops as are asked for, of which many are tried; none is taken, and the true ones are judged as
// without them.
template <class Pose>
void ExpectWrongLoopsRefused(const testing::RandomGraph<Pose>& scene, double percent, Strategy strategy) {
  const auto [graph, wrong_ids] = AddWrongLoops(scene.graph, scene.truth, percent, 7);
  std::set<Link> wrong;
  for (const FactorId id : wrong_ids) {
    const FactorPoses ends = PosesOf(graph.FindFactor(id)->factor);
    wrong.insert(std::minmax(ends.first.value, ends.second.value));
  }
  GraphReplay<Pose> clean(scene.graph), dirty(graph);
  auto options = testing::OptionsFor(clean, strategy);
  options.thresholds.min_loop_gain = 0.5;
  options.thresholds.min_pose_gain = 3;
  options.thresholds.range.setConstant(1000);  // wrong loops come from anywhere
  options.thresholds.link_covariance = clean.LinkCovariance();
  const auto without = RunReplay(clean, options), with = RunReplay(dirty, options);
  const std::set<Link> good = Accepted(without), taken = Accepted(with);
  ASSERT_GT(good.size(), 20u);
  int refused = 0, refused_true = 0;
  for (const Decision& d : with.decisions) {
    int outliers = 0;
    for (const Candidate& c : d.candidates) {
      EXPECT_FALSE(c.supported) << "wrong links do not agree with each other";
      outliers += c.outlier ? 1 : 0;
      if (!c.outlier) continue;
      EXPECT_FALSE(c.accepted);
      EXPECT_TRUE(c.tried && c.innovation && !c.factor);
      EXPECT_GT(*c.innovation, ChiSquareQuantile(0.9999, Pose::kDof));
      refused_true += wrong.count(std::minmax(c.carried_from.value_or(c.id).value, d.id.value)) == 0 ? 1 : 0;
    }
    EXPECT_EQ(outliers, d.links_refused);
    refused += outliers;
  }
  EXPECT_GT(refused, 10) << "wrong loops were tried";
  EXPECT_LE(refused_true, 1 + static_cast<int>(good.size()) / 50);
  for (const Link& link : taken) EXPECT_EQ(wrong.count(std::minmax(link.first, link.second)), 0u) << link.first;
  // Nothing that is refused changes anything.
  EXPECT_EQ(taken, good);
  ASSERT_EQ(with.decisions.size(), without.decisions.size());
  for (std::size_t k = 0; k < with.decisions.size(); ++k) {
    EXPECT_EQ(with.decisions[k].verdict, without.decisions[k].verdict) << k;
  }
  EXPECT_EQ(with.slam->Solver().Chi2(), without.slam->Solver().Chi2());
}

TEST(InnovationScenes, WrongLoopsAreRefused) {
  for (const Strategy strategy : {Strategy::kApfl, Strategy::kFpfl}) {
    ExpectWrongLoopsRefused(testing::MakeScene<SE2>(Scene::kManhattan, 250), 100, strategy);
    ExpectWrongLoopsRefused(testing::MakeScene<SE3>(Scene::kSphere, 250), 30, strategy);
  }
}

TEST(InnovationScenes, WithoutTheTestWrongLoopsAreTaken) {
  const auto scene = testing::MakeScene<SE2>(Scene::kManhattan, 150);
  const auto dirty = AddWrongLoops(scene.graph, scene.truth, 50, 7);
  GraphReplay<SE2> replay(dirty.graph);
  auto options = testing::OptionsFor(replay, Strategy::kApfl);
  options.thresholds.range.setConstant(1000);
  options.innovation_quantile.reset();
  const auto run = RunReplay(replay, options);
  for (const Decision& d : run.decisions) {
    EXPECT_EQ(d.links_refused, 0);
    for (const Candidate& c : d.candidates) EXPECT_FALSE(c.outlier || c.innovation);
  }
  EXPECT_GT(run.slam->Finish().chi2, 1000);
  for (const double quantile : {0.0, 1.0, -0.5, std::numeric_limits<double>::quiet_NaN()}) {
    options.innovation_quantile = quantile;
    EXPECT_THROW(CompactPoseSlam<SE2>{options}, std::invalid_argument) << quantile;
  }
}

// Links that come late, and that go again --------------------------------------------------------------------------

// Poses about 1 m apart on a bent course, of which every third is kept; odometry is exact.
template <class Pose>
struct InnovationCourse {
  explicit InnovationCourse(int poses, std::optional<double> quantile = 0.9999) : slam(Options(quantile)) {
    Random rng(11);
    for (int k = 0; k < poses; ++k) {
      CompactInput<Pose> input;
      input.id = PoseId{10 * k};
      if (k > 0) {
        const Pose step = testing::RandomMotion<Pose>(rng, 0.7, 0.3);
        truth.push_back(truth.back() * step);
        odometry.push_back({PoseId{10 * (k - 1)}, input.id, step, testing::RandomInformation<Pose::kDof>(rng, 2000)});
        // Some are given the other way round.
        input.odometry = odometry.back();
        if (k % 4 == 1) {
          const auto back = SeenFrom(input.id, odometry.back());
          input.odometry = {input.id, PoseId{10 * (k - 1)}, back.T_a_b, Inverse(back.covariance)};
        }
      }
      input.keep = k % 3 == 0;
      slam.AddPose(input, nullptr);
    }
  }
  // Random poses are kept as they are named: no threshold to tune.
  static CompactOptions<Pose> Options(std::optional<double> quantile) {
    CompactOptions<Pose> options;
    options.strategy = Strategy::kGiven;
    options.innovation_quantile = quantile;
    options.thresholds.min_loop_gain = 0.01;
    return options;
  }
  static typename Pose::Jacobian Inverse(const typename Pose::Jacobian& M) {
    const typename Pose::Jacobian inverse = testing::Inverse(M);
    return (inverse + inverse.transpose()) / 2;
  }
  RelativePoseFactor<Pose> Exact(int from, int to) const {
    return {PoseId{10 * from}, PoseId{10 * to}, At(from).Inverse() * At(to), 1000 * Pose::Jacobian::Identity()};
  }
  const Pose& At(int k) const { return truth[static_cast<std::size_t>(k)]; }

  std::vector<Pose> truth{Pose()};
  std::vector<RelativePoseFactor<Pose>> odometry;
  CompactPoseSlam<Pose> slam;
};

// T_kept_kept through the odometry in between, with the errors of every part by differences.
template <class Pose>
UncertainPose<Pose> CarriedByHand(const InnovationCourse<Pose>& course, const RelativePoseFactor<Pose>& link) {
  using Tangent = typename Pose::Tangent;
  const int from = static_cast<int>(link.from.value / 10), to = static_cast<int>(link.to.value / 10);
  std::vector<std::pair<Pose, typename Pose::Jacobian>> parts;
  std::vector<bool> is_inverse;
  const auto add = [&](const RelativePoseFactor<Pose>& f, bool inverse) {
    parts.emplace_back(f.T_from_to, InnovationCourse<Pose>::Inverse(f.information));
    is_inverse.push_back(inverse);
  };
  for (int k = from / 3 * 3; k < from; ++k) add(course.odometry[static_cast<std::size_t>(k)], false);
  add(link, false);
  for (int k = to; k > to / 3 * 3; --k) add(course.odometry[static_cast<std::size_t>(k - 1)], true);
  const auto product = [&](std::size_t which, const Tangent& d) {
    Pose T;
    for (std::size_t k = 0; k < parts.size(); ++k) {
      const Pose part = k == which ? parts[k].first * Pose::Exp(d) : parts[k].first;
      T = T * (is_inverse[k] ? part.Inverse() : part);
    }
    return T;
  };
  UncertainPose<Pose> out;
  out.T_a_b = product(0, Tangent::Zero());
  for (std::size_t k = 0; k < parts.size(); ++k) {
    typename Pose::Jacobian J;
    constexpr double kStep = 1e-6;
    for (int i = 0; i < Pose::kDof; ++i) {
      Tangent d = Tangent::Zero();
      d[i] = kStep;
      J.col(i) =
          ((out.T_a_b.Inverse() * product(k, d)).Log() - (out.T_a_b.Inverse() * product(k, -d)).Log()) / (2 * kStep);
    }
    out.covariance += J * parts[k].second * J.transpose();
  }
  return out;
}

TYPED_TEST(InnovationTest, LinksAreCarriedToKeptPoses) {
  using Pose = TypeParam;
  const InnovationCourse<Pose> course(24);
  for (const auto& [from, to] :
       {std::pair(0, 21), std::pair(4, 15), std::pair(3, 17), std::pair(20, 2), std::pair(23, 23 - 7)}) {
    SCOPED_TRACE(std::to_string(from) + " to " + std::to_string(to));
    EXPECT_EQ(course.slam.KeptBase(PoseId{10 * from}), PoseId{from / 3 * 30});
    const auto link = course.Exact(from, to);
    const auto carried = course.slam.CarryToKept(link);
    EXPECT_EQ(carried.from, PoseId{from / 3 * 30});
    EXPECT_EQ(carried.to, PoseId{to / 3 * 30});
    const auto expected = CarriedByHand(course, link);
    EXPECT_LT(testing::Distance(carried.T_from_to, expected.T_a_b), 1e-9);
    EXPECT_LT(testing::RelativeError(InnovationCourse<Pose>::Inverse(carried.information), expected.covariance), 1e-5);
    if (from % 3 == 0 && to % 3 == 0) {
      EXPECT_EQ(carried.information, link.information) << "nothing to carry";
    }
  }
  auto unknown = course.Exact(1, 5);
  unknown.from = PoseId{5};
  EXPECT_THROW(course.slam.CarryToKept(unknown), std::invalid_argument);
  EXPECT_THROW(course.slam.KeptBase(PoseId{5}), std::invalid_argument);
  EXPECT_FALSE(course.slam.HasSeen(PoseId{5}));
  EXPECT_TRUE(course.slam.HasSeen(PoseId{10}));
}

// Kept poses where the optimum of the slam's graph has them.
template <class Pose>
void ExpectOptimal(const CompactPoseSlam<Pose>& slam, const PoseGraph<Pose>& graph) {
  ASSERT_EQ(slam.Solver().Graph().Poses().size(), graph.Poses().size());
  const auto batch = SolveBatch(graph, slam.Solver().Estimates());
  ASSERT_TRUE(batch.Converged());
  for (std::size_t i = 0; i < graph.Poses().size(); ++i) {
    EXPECT_LT(testing::Distance(slam.Estimate(graph.Poses()[i].id), batch.T_world_body[i]), 1e-5) << i;
  }
}

TYPED_TEST(InnovationTest, LateLinksEnterTheMapAndLeaveIt) {
  using Pose = TypeParam;
  InnovationCourse<Pose> course(30, std::nullopt);
  const PoseGraph<Pose> without = course.slam.Solver().Graph();
  const double log_determinant = course.slam.Solver().LogDeterminant();
  // A good one to a dropped pose, and a wrong one, which nothing tests.
  const auto good = course.Exact(1, 25);
  auto wrong = course.Exact(5, 28);
  wrong.T_from_to = wrong.T_from_to * testing::RandomMotion<Pose>(*std::make_unique<Random>(3), 0.5, 0.2);
  const LinkDecision first = course.slam.AddLink(good), second = course.slam.AddLink(wrong);
  ASSERT_TRUE(first.accepted && second.accepted && first.factor && second.factor);
  EXPECT_FALSE(second.outlier || second.innovation);
  EXPECT_EQ(course.slam.LinksKept(), 2);
  EXPECT_EQ(first.from, PoseId{0});
  EXPECT_EQ(first.to, PoseId{240});
  PoseGraph<Pose> with_good = without;
  with_good.AddFactor(course.slam.CarryToKept(good));
  PoseGraph<Pose> with_both = with_good;
  with_both.AddFactor(course.slam.CarryToKept(wrong));
  course.slam.Finish();
  ExpectOptimal(course.slam, with_both);
  course.slam.RemoveLink(*second.factor);
  EXPECT_EQ(course.slam.LinksKept(), 1);
  course.slam.Finish();
  ExpectOptimal(course.slam, with_good);
  course.slam.RemoveLink(*first.factor);
  EXPECT_EQ(course.slam.LinksKept(), 0);
  course.slam.Finish();
  ExpectOptimal(course.slam, without);
  EXPECT_NEAR(course.slam.Solver().LogDeterminant(), log_determinant, 1e-7 * std::abs(log_determinant));
  EXPECT_LT(course.slam.Solver().Chi2(), 1e-9) << "odometry alone fits";
  EXPECT_THROW(course.slam.RemoveLink(*first.factor), std::invalid_argument) << "gone already";
}

TYPED_TEST(InnovationTest, LateLinksAreTested) {
  using Pose = TypeParam;
  InnovationCourse<Pose> course(30);
  const std::size_t factors = course.slam.Solver().Graph().Factors().size();
  // Off by far more than what odometry over 24 poses can be wrong by.
  auto wrong = course.Exact(0, 24);
  wrong.T_from_to = wrong.T_from_to * testing::RandomMotion<Pose>(*std::make_unique<Random>(4), 20, 0.1);
  const auto refused = course.slam.AddLink(wrong);
  EXPECT_TRUE(refused.outlier);
  EXPECT_FALSE(refused.accepted || refused.factor);
  ASSERT_TRUE(refused.innovation);
  EXPECT_GT(*refused.innovation, ChiSquareQuantile(0.9999, Pose::kDof));
  EXPECT_GT(refused.gain, 1) << "wrong, yet informative";
  auto vague = course.Exact(0, 24);
  vague.information *= 1e-9;
  const auto idle = course.slam.AddLink(vague);
  EXPECT_FALSE(idle.outlier || idle.accepted);
  EXPECT_LT(idle.gain, 0.01);
  EXPECT_EQ(course.slam.Solver().Graph().Factors().size(), factors);
  EXPECT_THROW(course.slam.AddLink(course.Exact(3, 5)), std::invalid_argument) << "the same kept pose";
  EXPECT_THROW(course.slam.AddLink(course.Exact(4, 5)), std::invalid_argument);
  const auto good = course.slam.AddLink(course.Exact(2, 27));
  EXPECT_TRUE(good.accepted);
  EXPECT_NEAR(good.innovation.value(), 0, 1e-6);
}

TYPED_TEST(InnovationTest, WhatIsNoLinkCannotBeRemoved) {
  InnovationCourse<TypeParam> course(12);
  const auto link = course.slam.AddLink(course.Exact(0, 10));
  ASSERT_TRUE(link.accepted);
  const double chi2 = course.slam.Solver().Chi2(), log_determinant = course.slam.Solver().LogDeterminant();
  const auto estimates = course.slam.Solver().Estimates();
  std::vector<FactorId> others{FactorId{}, FactorId{1000}};
  for (const auto& node : course.slam.Solver().Graph().Factors()) {
    if (node.id != *link.factor) others.push_back(node.id);
  }
  ASSERT_GT(others.size(), 4u);
  for (const FactorId id : others) {
    EXPECT_THROW(course.slam.RemoveLink(id), std::invalid_argument) << id.value;
  }
  EXPECT_EQ(course.slam.LinksKept(), 1);
  EXPECT_EQ(course.slam.Solver().Graph().Factors().size(), others.size() - 1);
  EXPECT_EQ(course.slam.Solver().Chi2(), chi2);
  EXPECT_EQ(course.slam.Solver().LogDeterminant(), log_determinant);
  for (std::size_t i = 0; i < estimates.size(); ++i) {
    EXPECT_EQ(testing::Distance(course.slam.Solver().Estimates()[i], estimates[i]), 0);
  }
  course.slam.RemoveLink(*link.factor);
}

// A wrong loop that is found later: the run goes on as if it had never been.
TYPED_TEST(InnovationTest, ARunHealsWhenAWrongLinkIsRemoved) {
  using Pose = TypeParam;
  Random rng(5);
  testing::RandomGraphOptions graph_options;
  graph_options.poses = 60;
  graph_options.loops_per_pose = 0.4;
  const auto scene = testing::MakeRandomGraph<Pose>(rng, graph_options);
  GraphReplay<Pose> a(scene.graph), b(scene.graph);
  auto options = testing::OptionsFor(a, Strategy::kFpfl);
  options.thresholds.min_loop_gain = 0.5;
  options.innovation_quantile.reset();
  CompactPoseSlam<Pose> clean(options), healed(options);
  for (std::size_t k = 0; k < a.Inputs().size(); ++k) {
    const Decision x = clean.AddPose(a.Inputs()[k]), y = healed.AddPose(b.Inputs()[k]);
    EXPECT_EQ(x.verdict, y.verdict) << k;
    EXPECT_EQ(x.links_accepted, y.links_accepted) << k;
    EXPECT_TRUE(x.revived == y.revived) << k;
    if (k % 10 != 5 || k < 15) continue;
    const PoseId from = healed.KeptBase(a.Inputs()[2].id), to = healed.KeptBase(a.Inputs()[k].id);
    const auto link =
        healed.AddLink({from, to, testing::RandomMotion<Pose>(rng, 3, 1), 1e4 * Pose::Jacobian::Identity()});
    ASSERT_TRUE(link.accepted);
    healed.Finish();
    healed.RemoveLink(*link.factor);
    healed.Finish();
    clean.Finish();
    // The frame is free: a wrong link pulls at the first pose too.
    const PoseId first = a.Inputs()[0].id;
    const Pose T_clean_healed = clean.Estimate(first) * healed.Estimate(first).Inverse();
    for (const auto& node : clean.Solver().Graph().Poses()) {
      ASSERT_LT(testing::Distance(T_clean_healed * healed.Estimate(node.id), clean.Estimate(node.id)), 1e-4) << k;
    }
  }
  EXPECT_EQ(healed.LinksKept(), clean.LinksKept());
}

// Odometry that is off by far more than its covariance says makes every true loop fail; they agree with each other.
TEST(ConsensusTest, LetsTrueLoopsInWhenTheMapIsOff) {
  const auto run = [](int consensus) {
    const testing::SlippingCircle course(consensus);
    CompactPoseSlam<SE2> slam(course.options);
    std::pair<int, int> refused_supported{0, 0};
    for (const auto& input : course.inputs) {
      const Decision decision = slam.AddPose(input, course.registration);
      refused_supported.first += decision.links_refused;
      for (const Candidate& c : decision.candidates) refused_supported.second += c.supported ? 1 : 0;
    }
    return refused_supported;
  };
  const auto [refused, supported] = run(3);
  const auto [never_refused, never_supported] = run(100);
  EXPECT_GT(supported, 0);
  EXPECT_EQ(never_supported, 0);
  EXPECT_GE(never_refused, 9) << "without a consensus the map never closes";
  EXPECT_LT(refused, never_refused);
}

}  // namespace
}  // namespace terse
