// The edges of a bounded map that several measurements make: what they are, beside the measurements themselves; that
// they can be taken apart; and that a map with them is stored whole.

#include <gtest/gtest.h>

#include <cstdio>

#include "terse/compact/map_file.h"
#include "testing_bounded.h"

namespace terse {
namespace {

using testing::Copy;
using testing::Laps;
using testing::LapsOptions;
using testing::Picture;
using testing::Provenance;
using testing::RelativeError;

template <class Pose>
class CompactBoundedEdgesTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactBoundedEdgesTest, Groups);

template <class Pose>
using Parts = std::vector<typename CompactMap<Pose>::Part>;

// The sum of their information, and the mean weighted by it, about the first: dense, and in no order.
template <class Pose>
UncertainPose<Pose> WeightedSum(const Parts<Pose>& parts) {
  constexpr int B = Pose::kDof;
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(B, B);
  Eigen::VectorXd weighted = Eigen::VectorXd::Zero(B);
  const Pose& T_about = parts.front().T_from_to.T_a_b;
  for (const auto& part : parts) {
    const Eigen::MatrixXd own = testing::Inverse(part.T_from_to.covariance);
    const Eigen::VectorXd away = (T_about.Inverse() * part.T_from_to.T_a_b).Log();
    information += own;
    weighted += own * away;
  }
  const Eigen::MatrixXd covariance = testing::Inverse(information);
  const typename Pose::Tangent mean = covariance * weighted;
  return {T_about * Pose::Exp(mean), covariance};
}

// The factor of an edge, from the smaller id of its ends to the larger, is what its parts make. Their order matters by
// less than a fifth of its standard deviation, as values that were fused in another order are apart.
template <class Pose>
void ExpectIsSum(const typename CompactMap<Pose>::Edge& edge, const Parts<Pose>& parts) {
  const auto expected = WeightedSum<Pose>(parts);
  const auto actual = SeenFrom(std::min(edge.measured.from, edge.measured.to), edge.measured);
  EXPECT_LT(RelativeError(actual.covariance, expected.covariance), 1e-8);
  const Eigen::VectorXd apart = (expected.T_a_b.Inverse() * actual.T_a_b).Log();
  EXPECT_LT(testing::Nees(apart, expected.covariance), 0.04);
}

template <class Pose>
const typename CompactMap<Pose>::Edge* FindEdge(const CompactMap<Pose>& map,
                                                const typename CompactMap<Pose>::Edge& like) {
  const typename CompactMap<Pose>::Edge* found = nullptr;
  for (const auto& edge : map.edges) {
    const bool joins = edge.measured.from == like.measured.from && edge.measured.to == like.measured.to;
    const bool turned = edge.measured.from == like.measured.to && edge.measured.to == like.measured.from;
    if ((joins || turned) && edge.is_loop == like.is_loop && edge.parts.empty() == like.parts.empty()) found = &edge;
  }
  return found;
}

TYPED_TEST(CompactBoundedEdgesTest, AreWhatTheirMeasurementsMake) {
  using Pose = TypeParam;
  int of_chains = 0, of_pairs = 0, fused = 0, odometry = 0, carried = 0;
  for (const std::uint64_t seed : testing::Seeds(1, 5)) {
    SCOPED_TRACE(seed);
    Laps<Pose> laps(seed);
    const Provenance<Pose> provenance(laps.scene.graph, laps.Run().Export());
    EXPECT_EQ(FindDefect(provenance.Map()), "");
    for (const auto& edge : provenance.Map().edges) {
      const auto pair = Provenance<Pose>::Ordered(edge.measured.from, edge.measured.to);
      SCOPED_TRACE(std::to_string(pair.first.value) + " - " + std::to_string(pair.second.value));
      const auto expect_measured = [&](const UncertainPose<Pose>& T_from_to, const std::vector<PoseId>& path) {
        const auto expected = provenance.Along(path);
        EXPECT_LT(testing::Distance(T_from_to.T_a_b, expected.T_a_b), 1e-9);
        EXPECT_LT(RelativeError(T_from_to.covariance, expected.covariance), 1e-7);
      };
      if (!edge.is_loop) {
        auto path = provenance.Back(pair.second, {pair.first});
        std::reverse(path.begin(), path.end());
        ++odometry;
        expect_measured(edge.parts.empty() ? SeenFrom(pair.first, edge.measured) : edge.parts.front().T_from_to, path);
      }
      if (edge.parts.empty()) continue;
      ExpectIsSum<Pose>(edge, edge.parts);
      fused += edge.parts.size() > 1;
      double gain = 0;
      for (const auto& part : edge.parts) {
        gain += part.gain;
        if (part.links.empty()) continue;
        ++(part.links.size() == 1 ? of_chains : of_pairs);
        const auto path = provenance.PathOf(part, pair);
        ASSERT_EQ(path.front(), pair.first);
        ASSERT_EQ(path.back(), pair.second);
        for (const PoseId link : part.links) carried += link != pair.first && link != pair.second;
        expect_measured(part.T_from_to, path);
      }
      if (edge.is_loop) {
        EXPECT_NEAR(edge.gain.value_or(-1), gain, 1e-9 * gain);
      }
    }
  }
  EXPECT_GT(of_chains, 10);
  EXPECT_GT(of_pairs, 0);
  EXPECT_GT(fused, 5);
  EXPECT_GT(odometry, 20);
  EXPECT_GT(carried, 3);
  std::printf("%d of chains, %d of pairs of links, %d carried; %d edges fused\n", of_chains, of_pairs, carried, fused);
}

// Without a part the map is what it would be if the part had never been: as one restored from an edited value.
template <class Pose>
void ExpectWithout(const CompactPoseSlam<Pose>& slam, const CompactOptions<Pose>& options, const CompactMap<Pose>& map,
                   std::size_t e, std::size_t p) {
  const auto& edge = map.edges[e];
  Parts<Pose> others = edge.parts;
  others.erase(others.begin() + static_cast<long>(p));
  auto without = Copy(slam);
  without.RemoveLink(edge.parts[p].id);
  const CompactMap<Pose> after = without.Export();
  const auto* now = FindEdge(after, edge);
  EXPECT_EQ(now == nullptr, others.empty());
  EXPECT_EQ(after.edges.size(), map.edges.size() - (others.empty() ? 1 : 0));
  EXPECT_EQ(without.LinksKept(), slam.LinksKept() - (others.empty() ? 1 : 0));
  EXPECT_THROW(without.RemoveLink(edge.parts[p].id), std::invalid_argument) << "it is gone";
  CompactMap<Pose> edited = map;
  if (others.empty()) {
    edited.edges.erase(edited.edges.begin() + static_cast<long>(e));
  } else {
    ASSERT_NE(now, nullptr);
    ASSERT_EQ(now->parts.size(), others.size());
    ExpectIsSum<Pose>(*now, others);
    EXPECT_EQ(now->is_loop, edge.is_loop);
    edited.edges[e].parts = others;
    edited.edges[e].measured = now->measured;
  }
  auto expected = CompactPoseSlam<Pose>::Restore(edited, options);
  for (int again = 0; again < 3; ++again) {
    expected.Finish();
    without.Finish();
  }
  EXPECT_NEAR(expected.Solver().Chi2(), without.Solver().Chi2(), 1e-7 * (1 + without.Solver().Chi2()));
  for (const auto& pose : expected.Trajectory()) {
    EXPECT_LT(testing::Distance(pose.T_world_body, without.Estimate(pose.id, Recovery::kV2)), 1e-6);
  }
}

TYPED_TEST(CompactBoundedEdgesTest, PartsAreTakenOutOneByOne) {
  using Pose = TypeParam;
  int removed = 0, of_odometry = 0, last = 0, refused = 0;
  for (const std::uint64_t seed : testing::Seeds(1, 2)) {
    SCOPED_TRACE(seed);
    Laps<Pose> laps(seed);
    CompactPoseSlam<Pose> slam = laps.Run();
    slam.Finish();
    const CompactMap<Pose> map = slam.Export();
    const std::string before = Picture(slam);
    for (std::size_t e = 0; e < map.edges.size(); ++e) {
      const auto& edge = map.edges[e];
      for (std::size_t p = 0; p < edge.parts.size(); ++p) {
        SCOPED_TRACE("part " + std::to_string(edge.parts[p].id.value));
        if (!edge.is_loop && p == 0) {
          EXPECT_THROW(slam.RemoveLink(edge.parts[p].id), std::invalid_argument) << "odometry";
          EXPECT_THROW(slam.RemoveLink(edge.factor), std::invalid_argument) << "odometry";
          ++refused;
          continue;
        }
        if (edge.parts[p].id == FactorId()) continue;
        if (kSlowBuild && removed > 4) continue;
        ExpectWithout(slam, laps.options, map, e, p);
        ++removed;
        of_odometry += !edge.is_loop;
        last += edge.parts.size() == 1;
      }
    }
    for (const std::int64_t id : {std::int64_t{-1}, std::int64_t{-2000}, std::int64_t{100000}}) {
      EXPECT_THROW(slam.RemoveLink(FactorId{id}), std::invalid_argument) << id;
    }
    EXPECT_TRUE(Picture(slam) == before) << "what is refused changes nothing";
  }
  EXPECT_GT(removed, 4);
  EXPECT_GT(refused, 1);
  if (!kSlowBuild) {
    EXPECT_GT(of_odometry, 3);
    EXPECT_GT(last, 1);
  }
  std::printf("%d parts, %d fused with odometry, %d alone\n", removed, of_odometry, last);
}

// All of them, one after the other and in any order: what is left are poses, odometry and links of their own.
TYPED_TEST(CompactBoundedEdgesTest, NothingIsLeftOfThem) {
  using Pose = TypeParam;
  LapsOptions many;
  many.laps = 8;
  Laps<Pose> laps(3, many);
  CompactPoseSlam<Pose> slam = laps.Run();
  std::vector<FactorId> ids;
  for (const Decision& decision : laps.decisions) {
    for (const ComposedEdge& edge : decision.edges) ids.push_back(edge.id);
  }
  ASSERT_GT(ids.size(), 10u);
  std::shuffle(ids.begin(), ids.end(), std::mt19937_64(7));
  for (const FactorId id : ids) slam.RemoveLink(id);
  for (const auto& edge : slam.Export().edges) {
    ASSERT_LE(edge.parts.size(), 1u);
    for (const auto& part : edge.parts) EXPECT_TRUE(part.links.empty());
  }
  slam.Finish();
  EXPECT_EQ(slam.PosesSeen(), static_cast<int>(laps.replay.Inputs().size()));
}

void ExpectSame(const Decision& a, const Decision& b, double tolerance) {
  EXPECT_EQ(a.verdict, b.verdict) << a.id.value;
  EXPECT_EQ(a.anchored_to, b.anchored_to) << a.id.value;
  EXPECT_EQ(a.links_accepted, b.links_accepted);
  ASSERT_EQ(a.edges.size(), b.edges.size()) << a.id.value;
  for (std::size_t k = 0; k < a.edges.size(); ++k) {
    EXPECT_EQ(a.edges[k].id, b.edges[k].id);
    EXPECT_EQ(a.edges[k].from, b.edges[k].from);
    EXPECT_EQ(a.edges[k].to, b.edges[k].to);
    EXPECT_EQ(a.edges[k].fused, b.edges[k].fused);
    EXPECT_NEAR(a.edges[k].gain, b.edges[k].gain, tolerance * a.edges[k].gain);
  }
}

TYPED_TEST(CompactBoundedEdgesTest, SavedAndLoadedAfterAnyStepContinueBitByBit) {
  using Pose = TypeParam;
  Laps<Pose> laps(4);
  CompactPoseSlam<Pose> running(laps.options);
  std::optional<CompactPoseSlam<Pose>> resumed;
  std::size_t edges = 0;
  int k = 0;
  for (const auto& input : laps.replay.Inputs()) {
    const Decision decision = running.AddPose(input);
    edges += decision.edges.size();
    if (resumed) ExpectSame(decision, resumed->AddPose(input), 0);
    if (++k % 7 != 0) continue;
    if (resumed) {
      ASSERT_TRUE(Picture(*resumed) == Picture(running)) << k;
    }
    resumed.emplace(Copy(running));
  }
  EXPECT_GT(edges, 10u);
  std::vector<FactorId> ids;
  for (const auto& edge : running.Export().edges) {
    for (const auto& part : edge.parts) {
      if (edge.is_loop || part.id != edge.parts.front().id) ids.push_back(part.id);
    }
  }
  for (const FactorId id : ids) {
    running.RemoveLink(id);
    resumed->RemoveLink(id);
  }
  EXPECT_TRUE(Picture(*resumed) == Picture(running));
}

TYPED_TEST(CompactBoundedEdgesTest, ExportedToAFileAndRestoredTheyDecideTheSame) {
  using Pose = TypeParam;
  Laps<Pose> laps(5);
  CompactPoseSlam<Pose> running(laps.options);
  std::optional<CompactPoseSlam<Pose>> restored;
  std::size_t edges = 0, anchored = 0, k = 0;
  for (const auto& input : laps.replay.Inputs()) {
    SCOPED_TRACE(input.id.value);
    for (int again = 0; restored && again < 4; ++again) {  // What is deferred depends on how long a run has been.
      running.Finish();
      restored->Finish();
    }
    const Decision decision = running.AddPose(input);
    if (restored) {
      ExpectSame(decision, restored->AddPose(input), 1e-5);
      edges += decision.edges.size();
      anchored += decision.anchored_to.has_value();
    }
    if (::testing::Test::HasFailure()) return;
    if (++k % 25 != 0) continue;
    for (int again = 0; again < 4; ++again) running.Finish();
    const TestFile file("graph.json");
    WriteCompactMap(running.Export(), Strategy::kBounded, file.Path());
    const auto read = std::get<CompactMap<Pose>>(ReadCompactMap(file.Path()).map);
    EXPECT_EQ(FindDefect(read), "");
    restored.emplace(CompactPoseSlam<Pose>::Restore(read, laps.options));
    const CompactMap<Pose> a = running.Export(), b = restored->Export();
    ASSERT_EQ(a.edges.size(), b.edges.size());
    for (std::size_t e = 0; e < a.edges.size(); ++e) {
      ASSERT_EQ(a.edges[e].parts.size(), b.edges[e].parts.size());
      for (std::size_t p = 0; p < a.edges[e].parts.size(); ++p) {
        const auto &of_a = a.edges[e].parts[p], &of_b = b.edges[e].parts[p];
        if (of_a.id.value < 0) {
          EXPECT_EQ(of_a.id, of_b.id);
        }
        EXPECT_EQ(of_a.links, of_b.links);
        EXPECT_EQ(of_a.added_at, of_b.added_at);
        EXPECT_EQ(of_a.measurements, of_b.measurements);
        EXPECT_EQ(of_a.T_from_to.covariance, of_b.T_from_to.covariance);
      }
    }
  }
  EXPECT_GT(edges, 5u);
  EXPECT_GT(anchored, 20u);
  for (const auto& edge : restored->Export().edges) {
    for (std::size_t p = edge.is_loop ? 0 : 1; p < edge.parts.size(); ++p) restored->RemoveLink(edge.parts[p].id);
  }
  EXPECT_EQ(restored->PosesSeen(), running.PosesSeen());
}

}  // namespace
}  // namespace terse
