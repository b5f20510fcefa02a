#include "terse/core/generate.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <map>
#include <stdexcept>
#include <vector>

#include "terse/core/residual.h"

namespace terse {
namespace {

template <class Pose>
struct Data {
  std::vector<Pose> poses;
  std::vector<RelativePoseFactor<Pose>> edges;
};

template <class Pose>
Data<Pose> Collect(const GenerateOptions& options) {
  Data<Pose> data;
  GenerateSink<Pose> sink;
  sink.pose = [&](PoseId id, const Pose& T) {
    EXPECT_EQ(id.value, static_cast<std::int64_t>(data.poses.size()));
    data.poses.push_back(T);
  };
  sink.edge = [&](const RelativePoseFactor<Pose>& edge) {
    EXPECT_EQ(edge.to.value, static_cast<std::int64_t>(data.poses.size()) - 1) << "edges follow their newest pose";
    EXPECT_LT(edge.from, edge.to);
    data.edges.push_back(edge);
  };
  Generate(options, sink);
  return data;
}

Data<SE3> Collect3(Scene scene, long poses = 0, std::uint64_t seed = 1) {
  GenerateOptions options;
  options.scene = scene;
  options.poses = poses;
  options.seed = seed;
  return Collect<SE3>(options);
}

Data<SE2> CollectManhattan(long poses = 0, std::uint64_t seed = 1) {
  GenerateOptions options;
  options.scene = Scene::kManhattan;
  options.poses = poses;
  options.seed = seed;
  return Collect<SE2>(options);
}

// FNV-1a over the bits of every number.
class Hash {
 public:
  void Add(double value) {
    std::uint64_t bits;
    std::memcpy(&bits, &value, sizeof(bits));
    for (int byte = 0; byte < 8; ++byte) value_ = (value_ ^ ((bits >> (8 * byte)) & 0xff)) * 0x100000001b3u;
  }
  void Add(const SE2& T) { Add(T.Translation().x()), Add(T.Translation().y()), Add(T.Theta()); }
  void Add(const SE3& T) {
    for (int d = 0; d < 3; ++d) Add(T.Translation()[d]);
    for (int d = 0; d < 4; ++d) Add(T.Rotation().Unit().coeffs()[d]);
  }
  template <class Pose>
  static std::uint64_t Of(const Data<Pose>& data) {
    Hash hash;
    for (const Pose& T : data.poses) hash.Add(T);
    for (const auto& edge : data.edges) {
      hash.Add(static_cast<double>(edge.from.value)), hash.Add(static_cast<double>(edge.to.value));
      hash.Add(edge.T_from_to);
      for (int i = 0; i < edge.information.size(); ++i) hash.Add(edge.information.data()[i]);
    }
    return hash.value_;
  }

 private:
  std::uint64_t value_ = 0xcbf29ce484222325u;
};

constexpr Scene kSpatialScenes[] = {Scene::kEllipse, Scene::kEllipseN, Scene::kSphere, Scene::kTorus, Scene::kGarage};

TEST(Generate, SameSeedSameBytes) {
  for (const Scene scene : kSpatialScenes) {
    EXPECT_EQ(Hash::Of(Collect3(scene, 400, 7)), Hash::Of(Collect3(scene, 400, 7)));
    EXPECT_NE(Hash::Of(Collect3(scene, 400, 7)), Hash::Of(Collect3(scene, 400, 8)));
  }
  EXPECT_EQ(Hash::Of(CollectManhattan(400, 7)), Hash::Of(CollectManhattan(400, 7)));
  EXPECT_NE(Hash::Of(CollectManhattan(400, 7)), Hash::Of(CollectManhattan(400, 8)));
}

// Recorded once. Another compiler, library or processor must give the same bits; a deliberate change of a scene
// records them anew.
TEST(Generate, SameBytesOnEveryMachine) {
  EXPECT_EQ(Hash::Of(Collect3(Scene::kEllipse)), 5165921203312396023u);
  EXPECT_EQ(Hash::Of(CollectManhattan(1000)), 15444096706225440779u);
}

TEST(Generate, EllipseIsAsPublished) {
  const auto data = Collect3(Scene::kEllipse);
  ASSERT_EQ(data.poses.size(), 170u);
  double length = 0, min_z = 1e9, max_z = -1e9;
  for (std::size_t k = 0; k < data.poses.size(); ++k) {
    const SE3& T = data.poses[k];
    min_z = std::min(min_z, T.Translation().z()), max_z = std::max(max_z, T.Translation().z());
    if (k == 0) continue;
    const Vector<3> step = T.Translation() - data.poses[k - 1].Translation();
    length += step.norm();
    // The view axis is tangent to the path: half a step's turn (0.43 m at a radius of 3.6 m, the sharpest bend,
    // turns by 0.12 rad) away from the chord.
    EXPECT_GT((T.Rotation() * Vector<3>(0, 0, 1)).dot(step.normalized()), std::cos(0.07)) << "pose " << k;
    EXPECT_LT((T.Rotation() * Vector<3>(0, 1, 0)).z(), 0) << "body y points down";
  }
  EXPECT_NEAR(length, 72.29, 0.7229);
  EXPECT_GT(max_z - min_z, 0.5) << "not planar";
}

TEST(Generate, EllipseLinksObeyTheLimits) {
  for (const Scene scene : {Scene::kEllipse, Scene::kEllipseN}) {
    GenerateOptions options;
    options.scene = scene;
    options.laps = 2;
    const auto data = Collect<SE3>(options);
    std::map<std::pair<std::int64_t, std::int64_t>, int> linked;
    for (const auto& edge : data.edges) ++linked[{edge.from.value, edge.to.value}];
    long loops = 0;
    for (long k = 0; k < static_cast<long>(data.poses.size()); ++k) {
      for (long j = 0; j < k; ++j) {
        const SE3& T_j = data.poses[static_cast<std::size_t>(j)];
        const SE3& T_k = data.poses[static_cast<std::size_t>(k)];
        const double distance = (T_j.Translation() - T_k.Translation()).norm();
        const Vector<3> z(0, 0, 1), a = T_j.Rotation() * z, b = T_k.Rotation() * z;
        const double angle = std::atan2(a.cross(b).norm(), a.dot(b));
        const bool expected = j == k - 1 || (k - j >= 5 && distance < 3 && angle < 0.2);
        const auto found = linked.find({j, k});
        EXPECT_EQ(found == linked.end() ? 0 : found->second, expected ? 1 : 0) << j << " -> " << k;
        loops += expected && k - j > 50;
      }
    }
    EXPECT_GT(loops, 20) << "revisits";
  }
}

TEST(Generate, LapsLengthenThePath) {
  GenerateOptions options;
  options.scene = Scene::kEllipseN;
  options.laps = 1;
  const auto one = Collect<SE3>(options);
  options.laps = 3;
  const auto three = Collect<SE3>(options);
  EXPECT_NEAR(static_cast<double>(three.poses.size() - 1), 3.0 * static_cast<double>(one.poses.size() - 1), 3);
  EXPECT_LT((three.poses.back().Translation() - three.poses.front().Translation()).norm(), 1e-6) << "whole laps close";
}

// Of the earlier poses in range, by looking at all of them: the 80 oldest and the 80 newest.
TEST(Generate, ManyLapsKeepTheOldestAndTheNewestLinks) {
  GenerateOptions options;
  options.scene = Scene::kEllipseN;
  options.laps = 40;
  std::vector<SE3> poses;
  std::map<long, std::vector<long>> links;
  constexpr long kEvery = 61;
  GenerateSink<SE3> sink;
  sink.pose = [&](PoseId, const SE3& T) { poses.push_back(T); };
  sink.edge = [&](const RelativePoseFactor<SE3>& edge) {
    const long to = edge.to.value;
    if (to % kEvery == 0 && edge.from.value < to - 1) links[to].push_back(edge.from.value);
  };
  Generate(options, sink);
  long full = 0;
  for (long k = kEvery; k < static_cast<long>(poses.size()); k += kEvery) {
    const SE3& T_k = poses[static_cast<std::size_t>(k)];
    std::vector<long> expected;
    for (long j = 0; j <= k - 5; ++j) {
      const SE3& T_j = poses[static_cast<std::size_t>(j)];
      const Vector<3> z(0, 0, 1), a = T_j.Rotation() * z, b = T_k.Rotation() * z;
      const bool in_range = (T_j.Translation() - T_k.Translation()).norm() < 3;
      if (in_range && std::atan2(a.cross(b).norm(), a.dot(b)) < 0.2) expected.push_back(j);
    }
    if (expected.size() > 160) {
      ++full;
      expected.erase(expected.begin() + 80, expected.end() - 80);
    }
    EXPECT_EQ(links[k], expected) << "pose " << k;
  }
  EXPECT_GT(full, 50) << "the cap is met";
  EXPECT_LT(full, static_cast<long>(poses.size()) / kEvery) << "and at first it is not";
}

template <class Pose>
void ExpectOdometryAtEveryPose(const Data<Pose>& data) {
  std::size_t next = 0;
  for (long k = 1; k < static_cast<long>(data.poses.size()); ++k) {
    ASSERT_LT(next, data.edges.size());
    ASSERT_EQ(data.edges[next].from.value, k - 1) << "the odometry edge comes first";
    ASSERT_EQ(data.edges[next].to.value, k);
    for (++next; next < data.edges.size() && data.edges[next].to.value == k; ++next) {
      ASSERT_LT(data.edges[next].from.value, k - 1);
    }
  }
  EXPECT_EQ(next, data.edges.size());
}

// The residuals at the truth, weighted: chi-square distributed with `dof` degrees of freedom per edge. For so many
// edges the mean over them is normal with standard deviation sqrt(2 dof / n); 2.58 of those are the 99 % interval.
template <class Pose>
void ExpectNoiseAsStated(const Data<Pose>& data) {
  double sum = 0;
  Eigen::VectorXd per_axis = Eigen::VectorXd::Zero(Pose::kDof);
  for (const auto& edge : data.edges) {
    const Pose& from = data.poses[static_cast<std::size_t>(edge.from.value)];
    const Pose& to = data.poses[static_cast<std::size_t>(edge.to.value)];
    ASSERT_EQ(FindDefect<Pose>(edge), "");
    sum += FactorChi2<Pose>(edge, from, to);
    const auto r = EvaluateRelative(edge.T_from_to, from, to).residual;
    for (int d = 0; d < Pose::kDof; ++d) per_axis[d] += r[d] * r[d] * edge.information(d, d);
  }
  const double n = static_cast<double>(data.edges.size());
  EXPECT_NEAR(sum / n, Pose::kDof, 2.58 * std::sqrt(2.0 * Pose::kDof / n));
  // Each axis on its own, at four standard deviations since there are many of them.
  for (int d = 0; d < Pose::kDof; ++d) EXPECT_NEAR(per_axis[d] / n, 1, 4 * std::sqrt(2 / n)) << "axis " << d;
}

TEST(Generate, NoiseMatchesInformation) {
  for (const Scene scene : kSpatialScenes) {
    SCOPED_TRACE(static_cast<int>(scene));
    ExpectNoiseAsStated(Collect3(scene));
  }
  ExpectNoiseAsStated(CollectManhattan());
}

TEST(Generate, EveryPoseHasOdometry) {
  for (const Scene scene : kSpatialScenes) ExpectOdometryAtEveryPose(Collect3(scene));
  ExpectOdometryAtEveryPose(CollectManhattan());
}

TEST(Generate, SizesOfThePublicSets) {
  const auto sphere = Collect3(Scene::kSphere);
  EXPECT_EQ(sphere.poses.size(), 2500u);
  EXPECT_EQ(sphere.edges.size(), 2499u + 2450u);
  for (const SE3& T : sphere.poses) ASSERT_NEAR(T.Translation().norm(), 50, 1e-8);
  const auto torus = Collect3(Scene::kTorus);
  EXPECT_EQ(torus.poses.size(), 5000u);
  EXPECT_EQ(torus.edges.size(), 4999u + 4900u + 100u) << "the previous winding, and the seam";
  const auto garage = Collect3(Scene::kGarage);
  EXPECT_EQ(garage.poses.size(), 1661u);
  EXPECT_GT(garage.edges.size(), 4000u);
  const auto manhattan = CollectManhattan();
  EXPECT_EQ(manhattan.poses.size(), 3500u);
  EXPECT_GT(manhattan.edges.size(), 5000u);
}

TEST(Generate, LinksJoinNearPoses) {
  // The longest allowed link of each scene; neighbours on the torus are a winding apart: 2 pi 7.5 m / 50.
  const std::pair<Scene, double> limits[] = {{Scene::kSphere, 3.3}, {Scene::kTorus, 0.95}, {Scene::kGarage, 5}};
  for (const auto& [scene, limit] : limits) {
    const auto data = Collect3(scene);
    for (const auto& edge : data.edges) {
      if (edge.to.value - edge.from.value == 1) continue;
      const double distance = (data.poses[static_cast<std::size_t>(edge.from.value)].Translation() -
                               data.poses[static_cast<std::size_t>(edge.to.value)].Translation())
                                  .norm();
      ASSERT_LT(distance, limit) << edge.from.value << " -> " << edge.to.value;
    }
  }
}

TEST(Generate, GarageHasFourLevelsThatAreLinked) {
  const auto data = Collect3(Scene::kGarage);
  double bottom = 1e9, top = -1e9;
  for (const SE3& T : data.poses) {
    bottom = std::min(bottom, T.Translation().z());
    top = std::max(top, T.Translation().z());
  }
  EXPECT_NEAR(top - bottom, 9, 1e-6) << "four levels, 3 m apart";
  long stacked = 0;
  for (const auto& edge : data.edges) {
    const double rise = data.poses[static_cast<std::size_t>(edge.to.value)].Translation().z() -
                        data.poses[static_cast<std::size_t>(edge.from.value)].Translation().z();
    stacked += rise > 1.5;
  }
  EXPECT_GT(stacked, 50);
}

TEST(Generate, ManhattanWalksOnTheGrid) {
  const auto data = CollectManhattan(2000);
  for (std::size_t k = 1; k < data.poses.size(); ++k) {
    const auto& p = data.poses[k].Translation();
    ASSERT_EQ(p.x(), std::round(p.x()));
    ASSERT_EQ(p.y(), std::round(p.y()));
    ASSERT_EQ((p - data.poses[k - 1].Translation()).norm(), 1);
    ASSERT_LE(p.cwiseAbs().maxCoeff(), 0.36 * std::sqrt(2000.0) + 1);
  }
  std::map<std::int64_t, int> links;
  for (const auto& edge : data.edges) {
    if (edge.to.value - edge.from.value > 1) ++links[edge.to.value];
  }
  for (const auto& [id, count] : links) EXPECT_LE(count, 2) << "pose " << id;
}

// The robot stays, comes everywhere, and each pose has at most the oldest and the newest link in range.
TEST(Generate, AManhattanOfAnAreaIsNotLeft) {
  GenerateOptions options;
  options.scene = Scene::kManhattan;
  options.poses = 6000;
  options.area_m = {{12, 7}};
  const auto data = Collect<SE2>(options);
  ASSERT_EQ(data.poses.size(), 6000u);
  std::map<std::pair<double, double>, int> visits;
  for (std::size_t k = 0; k < data.poses.size(); ++k) {
    const auto& p = data.poses[k].Translation();
    ++visits[{p.x(), p.y()}];
    ASSERT_EQ(p.x(), std::round(p.x()));
    ASSERT_EQ(p.y(), std::round(p.y()));
    if (k == 0) continue;
    ASSERT_EQ((p - data.poses[k - 1].Translation()).norm(), 1);
  }
  EXPECT_EQ(visits.size(), 13u * 8u) << "corners of 12 x 7 blocks";
  EXPECT_EQ(visits.rbegin()->first.first - visits.begin()->first.first, 12);
  ExpectOdometryAtEveryPose(data);
  ExpectNoiseAsStated(data);
  std::map<long, std::vector<long>> links;
  for (const auto& edge : data.edges) {
    if (edge.to.value - edge.from.value > 1) links[edge.to.value].push_back(edge.from.value);
  }
  for (long k = 0; k < 6000; k += 7) {
    std::vector<long> expected;
    for (long j = 0; j <= k - 10; ++j) {
      const double distance = (data.poses[static_cast<std::size_t>(j)].Translation() -
                               data.poses[static_cast<std::size_t>(k)].Translation())
                                  .norm();
      if (distance < 1.1) expected.push_back(j);
    }
    if (expected.size() > 2) expected.erase(expected.begin() + 1, expected.end() - 1);
    EXPECT_EQ(links[k], expected) << "pose " << k;
  }
}

TEST(Generate, TheSmallestAreaIsOneBlock) {
  GenerateOptions options;
  options.scene = Scene::kManhattan;
  options.poses = 50;
  options.area_m = {{1, 1}};
  for (const SE2& T : Collect<SE2>(options).poses) {
    EXPECT_TRUE(T.Translation().minCoeff() >= 0 && T.Translation().maxCoeff() <= 1);
  }
}

TEST(Generate, ALargeManhattanStreams) {
  GenerateOptions options;
  options.scene = Scene::kManhattan;
  options.poses = 200000;
  long poses = 0, edges = 0;
  GenerateSink<SE2> sink;
  sink.pose = [&](PoseId, const SE2&) { ++poses; };
  sink.edge = [&](const RelativePoseFactor<SE2>&) { ++edges; };
  Generate(options, sink);
  EXPECT_EQ(poses, 200000);
  EXPECT_GT(edges, 200000);
  EXPECT_LE(edges, 3 * 200000);
}

TEST(Generate, RefusesWhatItCannotDo) {
  GenerateOptions options;
  options.scene = Scene::kManhattan;
  EXPECT_THROW(Generate(options, GenerateSink<SE3>()), std::invalid_argument);
  options.scene = Scene::kSphere;
  EXPECT_THROW(Generate(options, GenerateSink<SE2>()), std::invalid_argument);
  options.poses = 1;
  EXPECT_THROW(Generate(options, GenerateSink<SE3>()), std::invalid_argument);
  options.poses = -5;
  EXPECT_THROW(Generate(options, GenerateSink<SE3>()), std::invalid_argument);
  options.scene = Scene::kEllipseN;
  options.poses = 0;
  options.laps = 0;
  EXPECT_THROW(Generate(options, GenerateSink<SE3>()), std::invalid_argument);
  options.laps = 1;
  options.area_m = {{5, 5}};
  EXPECT_THROW(Generate(options, GenerateSink<SE3>()), std::invalid_argument);
  options.scene = Scene::kManhattan;
  options.area_m = {{5, 0}};
  EXPECT_THROW(Generate(options, GenerateSink<SE2>()), std::invalid_argument);
  EXPECT_FALSE(SceneFromName("circle"));
  EXPECT_EQ(SceneFromName("ellipse-n"), Scene::kEllipseN);
}

TEST(Generate, TwoPosesAreEnough) {
  for (const Scene scene : kSpatialScenes) EXPECT_EQ(Collect3(scene, 2).edges.size(), 1u);
  EXPECT_EQ(CollectManhattan(2).edges.size(), 1u);
}

}  // namespace
}  // namespace terse
