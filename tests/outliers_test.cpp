// Wrong loops: how many, where, how wrong; and that all else stays as it was.

#include "terse/core/outliers.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "terse/core/arrival.h"
#include "terse/core/generate.h"
#include "terse/core/residual.h"
#include "testing.h"

namespace terse {
namespace {

using testing::Random;

template <class Pose>
struct Data {
  std::vector<Pose> truth;
  std::vector<RelativePoseFactor<Pose>> clean, wrong;
  std::vector<std::size_t> clean_before;  // for each wrong loop, the true edges that came before it
};

template <class Pose>
Data<Pose> Collect(Scene scene, double percent, std::uint64_t seed = 1, long poses = 0,
                   OutlierKind kind = OutlierKind::kRandom) {
  GenerateOptions options;
  options.scene = scene;
  options.seed = seed;
  options.poses = poses;
  options.laps = 2;
  options.wrong_loop_percent = percent;
  options.wrong_loop_kind = kind;
  Data<Pose> data;
  GenerateSink<Pose> sink;
  sink.pose = [&](PoseId, const Pose& T) { data.truth.push_back(T); };
  sink.edge = [&](const RelativePoseFactor<Pose>& edge) { data.clean.push_back(edge); };
  sink.wrong_loop = [&](const RelativePoseFactor<Pose>& edge) {
    EXPECT_EQ(std::max(edge.from, edge.to).value, static_cast<std::int64_t>(data.truth.size()) - 1);
    data.wrong.push_back(edge);
    data.clean_before.push_back(data.clean.size());
  };
  Generate(options, sink);
  return data;
}

template <class Pose>
bool Equal(const RelativePoseFactor<Pose>& a, const RelativePoseFactor<Pose>& b) {
  const Pose &S = a.T_from_to, &T = b.T_from_to;
  bool same = a.from == b.from && a.to == b.to && a.information == b.information && S.Translation() == T.Translation();
  if constexpr (Pose::kDim == 2) {
    same = same && S.Theta() == T.Theta();
  } else {
    same = same && S.Rotation().Unit().coeffs() == T.Rotation().Unit().coeffs();
  }
  return same;
}

template <class Pose>
void ExpectEqual(const std::vector<RelativePoseFactor<Pose>>& a, const std::vector<RelativePoseFactor<Pose>>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t k = 0; k < a.size(); ++k) ASSERT_TRUE(Equal(a[k], b[k])) << "edge " << k;
}

using Pair = std::pair<std::int64_t, std::int64_t>;
template <class Pose>
Pair PairOf(const RelativePoseFactor<Pose>& edge) {
  return {std::min(edge.from, edge.to).value, std::max(edge.from, edge.to).value};
}

template <class Pose>
bool IsOdometry(const RelativePoseFactor<Pose>& edge) {
  return PairOf(edge).second - PairOf(edge).first == 1;
}

template <class Pose>
double TrueChi2(const RelativePoseFactor<Pose>& edge, const std::vector<Pose>& truth) {
  return FactorChi2<Pose>(edge, truth[static_cast<std::size_t>(edge.from.value)],
                          truth[static_cast<std::size_t>(edge.to.value)]);
}

// So many of another pair of poses each, none true, with the direction and information of true ones; all else as it
// was.
template <class Pose>
void ExpectWrongLoopsBesideTrueOnes(const Data<Pose>& data, const Data<Pose>& plain, double percent, double reach = 1) {
  EXPECT_TRUE(plain.wrong.empty());
  ExpectEqual(plain.clean, data.clean);

  std::set<Pair> linked;
  double loops = 0, longest = 0;
  for (const auto& edge : data.clean) {
    linked.insert(PairOf(edge));
    if (IsOdometry(edge)) continue;
    ++loops;
    longest = std::max(longest, edge.T_from_to.Translation().norm());
  }
  ASSERT_EQ(data.wrong.size(), static_cast<std::size_t>(std::lround(loops * percent / 100)));
  for (const auto& edge : data.wrong) {
    EXPECT_TRUE(linked.insert(PairOf(edge)).second) << "a pair that has a link";
    EXPECT_EQ(FindDefect<Pose>(edge), "");
    EXPECT_GE(TrueChi2(edge, data.truth), kWrongChi2PerDof * Pose::kDof);
    const auto same = [&](const auto& e) { return e.information == edge.information && !IsOdometry(e); };
    EXPECT_TRUE(std::any_of(data.clean.begin(), data.clean.end(), same));
    // As a true loop, with six deviations of noise on each of the axes at most.
    EXPECT_LT(edge.T_from_to.Translation().norm(), reach * longest + 6 * std::sqrt(3 / edge.information(0, 0)));
  }
}

template <class Pose>
void ExpectSoundWrongLoops(Scene scene, double percent) {
  SCOPED_TRACE(static_cast<int>(scene));
  const Data<Pose> plain = Collect<Pose>(scene, 0), data = Collect<Pose>(scene, percent);
  ExpectWrongLoopsBesideTrueOnes(data, plain, percent);
  double position = 0;
  for (const auto& edge : data.wrong) {
    position += static_cast<double>(PairOf(edge).second) / static_cast<double>(data.truth.size());
  }
  // The larger of two even numbers in [0, 1]: 2/3 on average, with a deviation of 0.236; five of these.
  const double n = static_cast<double>(data.wrong.size());
  EXPECT_NEAR(position / n, 2.0 / 3, 5 * 0.236 / std::sqrt(n) + 2 / static_cast<double>(data.truth.size()));
}

TEST(WrongLoops, AreSoInEveryScene) {
  ExpectSoundWrongLoops<SE2>(Scene::kManhattan, 10);
  ExpectSoundWrongLoops<SE2>(Scene::kManhattan, 150);
  for (const Scene scene : {Scene::kEllipse, Scene::kEllipseN, Scene::kSphere, Scene::kTorus, Scene::kGarage}) {
    ExpectSoundWrongLoops<SE3>(scene, 30);
  }
}

// How far apart in the world two wrong loops say that the same pose is: 0 if the same mistake is behind both.
template <class Pose>
double Disagreement(const RelativePoseFactor<Pose>& a, const RelativePoseFactor<Pose>& b,
                    const std::vector<Pose>& truth) {
  const auto shift = [&](const RelativePoseFactor<Pose>& e) {  // where it says that the later pose is, for where it is
    const auto at = [&](PoseId id) { return truth[static_cast<std::size_t>(id.value)]; };
    return e.from < e.to ? at(e.from) * e.T_from_to * at(e.to).Inverse()
                         : at(e.to) * e.T_from_to.Inverse() * at(e.from).Inverse();
  };
  const Pose T_seen = truth[static_cast<std::size_t>(PairOf(a).second)];
  return ((shift(a) * T_seen).Inverse() * (shift(b) * T_seen)).Translation().norm();
}

template <class Pose>
void ExpectSoundKinds(Scene scene, double noise_m) {
  SCOPED_TRACE(static_cast<int>(scene));
  const Data<Pose> plain = Collect<Pose>(scene, 0, 3);
  for (const OutlierKind kind : {OutlierKind::kLocal, OutlierKind::kGrouped, OutlierKind::kAliased}) {
    SCOPED_TRACE(static_cast<int>(kind));
    const Data<Pose> data = Collect<Pose>(scene, 40, 3, 0, kind), again = Collect<Pose>(scene, 40, 3, 0, kind);
    ExpectEqual(data.wrong, again.wrong);
    // One of a group leads on from where the last one led: up to twice as far as a true one.
    ExpectWrongLoopsBesideTrueOnes(data, plain, 40, kind == OutlierKind::kGrouped ? 2 : 1);
    std::size_t agree = 0;
    for (std::size_t k = 0; k < data.wrong.size(); ++k) {
      const Pair pair = PairOf(data.wrong[k]);
      if (kind == OutlierKind::kLocal) {
        EXPECT_GE(pair.second - pair.first, 20);
        EXPECT_LE(pair.second - pair.first, 50);
      }
      // Of those shortly before, any that agrees.
      bool found = false;
      for (std::size_t j = k - std::min<std::size_t>(k, 30); j < k; ++j) {
        found = found || Disagreement(data.wrong[j], data.wrong[k], data.truth) < noise_m;
      }
      agree += found;
    }
    const double share = static_cast<double>(agree) / static_cast<double>(data.wrong.size());
    if (kind == OutlierKind::kLocal) {
      EXPECT_LT(share, 0.2);
    } else {
      EXPECT_GT(share, 0.6);  // all but the first of each 3 to 10 or 20, as far as noise lets it be seen
    }
  }
}

TEST(WrongLoops, OfOtherKinds) {
  ExpectSoundKinds<SE2>(Scene::kManhattan, 0.6);
  ExpectSoundKinds<SE3>(Scene::kGarage, 0.6);
}

TEST(WrongLoops, SameSeedSameLoops) {
  const auto a = Collect<SE3>(Scene::kSphere, 20, 3, 500), b = Collect<SE3>(Scene::kSphere, 20, 3, 500),
             c = Collect<SE3>(Scene::kSphere, 20, 4, 500);
  ExpectEqual(a.wrong, b.wrong);
  EXPECT_EQ(a.clean_before, b.clean_before);
  ASSERT_EQ(a.wrong.size(), c.wrong.size());
  EXPECT_FALSE(Equal(a.wrong[0], c.wrong[0]));
}

// Their noise is that of the loop they were made of: the measurement differs from it by a residual of that covariance.
TEST(WrongLoops, MeasurementIsATrueOneWithNoise) {
  const auto data = Collect<SE2>(Scene::kManhattan, 100);
  double sum = 0;
  for (const auto& wrong : data.wrong) {
    double least = 1e300;
    for (const auto& edge : data.clean) {
      if (IsOdometry(edge) || edge.information != wrong.information) continue;
      const Vector<3> r = edge.T_from_to.Local(wrong.T_from_to);
      least = std::min(least, r.dot(edge.information * r));
    }
    sum += least / static_cast<double>(data.wrong.size());
  }
  // The nearest one can be another one: less than the three of chi-square, and not nothing.
  EXPECT_LT(sum, 3);
  EXPECT_GT(sum, 0.001);
}

TEST(WrongLoops, WhatCannotBeDoneIsSaid) {
  const auto cause = [](Scene scene, double percent, long poses) -> std::string {
    try {
      Collect<SE3>(scene, percent, 1, poses);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_NE(cause(Scene::kSphere, -1, 100).find("negative"), std::string::npos);
  EXPECT_NE(cause(Scene::kSphere, std::nan(""), 100).find("negative"), std::string::npos);
  EXPECT_NE(cause(Scene::kSphere, 10, 2).find("no loops"), std::string::npos);
  EXPECT_NE(cause(Scene::kSphere, 1e6, 100).find("without a link"), std::string::npos);
}

template <class Pose>
class WrongLoopsInGraph : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(WrongLoopsInGraph, Groups);

// Poses and factors as they were, in online order, which the wrong loops do not change; the wrong ones with their
// later pose.
TYPED_TEST(WrongLoopsInGraph, KeepsWhatIsThere) {
  using Pose = TypeParam;
  for (const std::uint64_t seed : testing::Seeds(1, 5)) {
    Random rng(seed);
    testing::RandomGraphOptions options;
    options.poses = 80;
    options.priors = true;
    options.id_stride = 3;
    auto random = testing::MakeRandomGraph<Pose>(rng, options);
    PoseGraph<Pose>& graph = random.graph;
    graph.SetFixed(graph.Poses()[4].id, true);
    // Low ids that wait for a higher one, and no values.
    graph.AddPose(PoseId{50});
    graph.AddPose(PoseId{-7});
    const auto add = [&](PoseId from, PoseId to) {
      graph.AddFactor(RelativePoseFactor<Pose>{from, to, testing::RandomMotion<Pose>(rng, 1, 0.5),
                                               testing::RandomInformation<Pose::kDof>(rng, 100)});
    };
    add(graph.Poses()[60].id, PoseId{50});
    add(PoseId{50}, PoseId{-7});
    random.truth.resize(graph.Poses().size());
    const auto out = AddWrongLoops(graph, random.truth, 40, seed);

    ASSERT_EQ(out.graph.Poses().size(), graph.Poses().size());
    for (std::size_t k = 0; k < graph.Poses().size(); ++k) {
      const auto &before = graph.Poses()[k], &after = out.graph.Poses()[k];
      EXPECT_EQ(before.id, after.id);
      EXPECT_EQ(before.fixed, after.fixed);
      EXPECT_EQ(before.T_world_body.has_value(), after.T_world_body.has_value());
    }
    EXPECT_GT(out.wrong.size(), 5u);
    ASSERT_EQ(out.graph.Factors().size(), graph.Factors().size() + out.wrong.size());
    const std::set<FactorId> wrong(out.wrong.begin(), out.wrong.end());
    EXPECT_EQ(wrong.size(), out.wrong.size());

    // Both graphs as they come in: the same, wrong loops apart, which never come first.
    const auto steps = ArrivalSteps(graph, ArrivalUnit::kPose), with = ArrivalSteps(out.graph, ArrivalUnit::kPose);
    ASSERT_EQ(steps.size(), with.size());
    std::int64_t last = -1;
    for (std::size_t s = 0; s < steps.size(); ++s) {
      EXPECT_EQ(steps[s].poses, with[s].poses);
      std::size_t next = 0;
      for (const int f : with[s].factors) {
        const auto& node = out.graph.Factors()[static_cast<std::size_t>(f)];
        EXPECT_LT(last, node.id.value) << "stored in online order";
        last = node.id.value;
        if (wrong.count(node.id) != 0) continue;
        ASSERT_LT(next, steps[s].factors.size());
        const auto& factor = graph.Factors()[static_cast<std::size_t>(steps[s].factors[next++])].factor;
        ASSERT_EQ(factor.index(), node.factor.index());
        const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&factor);
        EXPECT_TRUE(edge == nullptr || Equal(*edge, std::get<RelativePoseFactor<Pose>>(node.factor)));
      }
      EXPECT_EQ(next, steps[s].factors.size());
    }
  }
}

TYPED_TEST(WrongLoopsInGraph, RefusesWhatItCannotDo) {
  using Pose = TypeParam;
  Random rng(1);
  testing::RandomGraphOptions options;
  options.loops_per_pose = 0;
  auto random = testing::MakeRandomGraph<Pose>(rng, options);
  EXPECT_THROW(AddWrongLoops(random.graph, random.truth, 10, 1), std::invalid_argument);
  EXPECT_EQ(AddWrongLoops(random.graph, random.truth, 0, 1).wrong.size(), 0u);
  EXPECT_THROW(AddWrongLoops(random.graph, random.truth, -1, 1), std::invalid_argument);
  // Where everything is at one place, no measurement of that is wrong.
  auto& graph = random.graph;
  for (std::size_t k = 5; k < 20; k += 5) {
    graph.AddFactor(
        RelativePoseFactor<Pose>{graph.Poses()[0].id, graph.Poses()[k].id, Pose(), Pose::Jacobian::Identity()});
  }
  const std::vector<Pose> together(graph.Poses().size());
  EXPECT_THROW(AddWrongLoops(graph, together, 50, 1), std::invalid_argument);
  random.truth.pop_back();
  EXPECT_THROW(AddWrongLoops(random.graph, random.truth, 0, 1), std::invalid_argument);
}

}  // namespace
}  // namespace terse
