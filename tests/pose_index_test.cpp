// The index of kept poses against looking at all of them, and the bound on what a chain does to an error.

#include <gtest/gtest.h>

#include <limits>

#include "terse/compact/pose_index.h"
#include "terse/compact/uncertain_pose.h"
#include "testing.h"

namespace terse {
namespace {

using testing::NormalVector;
using testing::Random;
using testing::Uniform;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

template <class Pose>
class PoseIndexTest : public ::testing::Test {
 public:
  using Index = PoseIndex<Pose>;
  using Item = typename Index::Item;
  using Position = typename Pose::Position;

  // A walk, as the poses of a run are; some items are known badly, some hardly or not at all.
  static std::vector<Item> RandomItems(Random& rng, int count) {
    std::vector<Item> items;
    Position position = Position::Zero();
    for (int k = 0; k < count; ++k) {
      position += NormalVector<Pose::kDim>(rng);
      Spread spread{Uniform(rng, 0, 0.5), Uniform(rng, 0, 0.1)};
      if (rng() % 20 == 0) spread.metres = rng() % 2 == 0 ? 1e12 : Uniform(rng, 0, 30);
      if (rng() % 50 == 0) spread.radians = rng() % 2 == 0 ? kInfinity : 1e200;
      if (rng() % 50 == 0) spread.metres = kInfinity;
      items.push_back({position, spread});
    }
    return items;
  }
  static std::vector<int> Visited(const Index& index, const Position& from, double range, double length) {
    std::vector<int> out;
    index.VisitNear(from, Reach{range, length}, [&](int i) { out.push_back(i); });
    return out;
  }
  struct Reach {
    double range, length;
    double operator()(const Spread& spread) const { return range + 3 * spread.Behind(length, {0.1, 0.01}).metres; }
  };
};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(PoseIndexTest, Groups);

TYPED_TEST(PoseIndexTest, VisitsAllThatAreNearInOrder) {
  for (const int count : {0, 1, 2, 7, 8, 9, 16, 17, 64, 65, 1000}) {
    for (std::uint64_t seed = 1; seed <= 20; ++seed) {
      SCOPED_TRACE(std::to_string(count) + " items, seed " + std::to_string(seed));
      Random rng(seed);
      const auto items = this->RandomItems(rng, count);
      typename TestFixture::Index index;
      index.Build(items);
      ASSERT_EQ(index.Items().size(), items.size());
      const typename TypeParam::Position from = 20 * NormalVector<TypeParam::kDim>(rng);
      const typename TestFixture::Reach reach{Uniform(rng, 0, 10), Uniform(rng, 0.01, 5)};
      const auto visited = this->Visited(index, from, reach.range, reach.length);
      ASSERT_TRUE(std::is_sorted(visited.begin(), visited.end()));
      ASSERT_TRUE(std::adjacent_find(visited.begin(), visited.end()) == visited.end()) << "each once";
      for (int i = 0; i < count; ++i) {
        const auto& item = items[static_cast<std::size_t>(i)];
        if ((item.position - from).norm() > reach(item.spread)) continue;
        ASSERT_TRUE(std::binary_search(visited.begin(), visited.end(), i)) << "item " << i;
      }
    }
  }
}

// What is far away is left out, but for the few that share a bucket with what is near.
TYPED_TEST(PoseIndexTest, VisitsFewOthers) {
  Random rng(1);
  auto items = this->RandomItems(rng, 1000);
  long visited = 0, near = 0;
  for (auto& item : items) item.spread = {Uniform(rng, 0, 0.2), 0.01};
  typename TestFixture::Index index;
  index.Build(items);
  const typename TestFixture::Reach reach{5, 1};
  for (int k = 0; k < 1000; k += 10) {
    const auto from = items[static_cast<std::size_t>(k)].position;
    visited += static_cast<long>(this->Visited(index, from, reach.range, reach.length).size());
    for (const auto& item : items) near += (item.position - from).norm() <= reach(item.spread) ? 1 : 0;
  }
  EXPECT_GE(visited, near);
  EXPECT_LT(visited, 4 * near);
  EXPECT_LT(visited, 100 * 1000 / 4) << "of all";
}

// Where every displacement is as uncertain as can be, nothing may be left out.
TYPED_TEST(PoseIndexTest, NothingIsFarWhenNothingIsKnown) {
  Random rng(2);
  for (const Spread& spread : {Spread{kInfinity, 0}, Spread{0, kInfinity}, Spread{1e300, 1e300}}) {
    auto items = this->RandomItems(rng, 100);
    for (auto& item : items) item.spread = spread;
    typename TestFixture::Index index;
    index.Build(items);
    const typename TypeParam::Position far = TypeParam::Position::Constant(1e9);
    EXPECT_EQ(this->Visited(index, far, 1, 1).size(), 100u);
  }
}

TYPED_TEST(PoseIndexTest, IsBuiltAgain) {
  Random rng(3);
  typename TestFixture::Index index;
  index.VisitNear(
      TypeParam::Position::Zero(), [](const Spread&) { return kInfinity; },
      [](int) { ADD_FAILURE() << "there is nothing"; });
  for (const int count : {40, 9, 300, 0, 1}) {
    index.Build(this->RandomItems(rng, count));
    EXPECT_EQ(this->Visited(index, TypeParam::Position::Zero(), kInfinity, 1).size(), static_cast<std::size_t>(count));
  }
}

// Against the covariance of the displacement composed with the chain: never less, and reached where an error of
// rotation acts across the chain and in step with that of translation.
TYPED_TEST(PoseIndexTest, SpreadBehindAChainIsABound) {
  using Pose = TypeParam;
  double closest = 0;
  for (std::uint64_t seed = 1; seed <= 2000; ++seed) {
    Random rng(seed);
    const auto random = [&](double metres, double radians) {
      const Vector<Pose::kDof> scale = (Vector<Pose::kDof>() << Vector<Pose::kDim>::Constant(metres),
                                        Vector<Pose::kDof - Pose::kDim>::Constant(radians))
                                           .finished();
      // One direction, or all of them.
      const typename Pose::Tangent d = NormalVector<Pose::kDof>(rng);
      typename Pose::Jacobian S =
          seed % 2 == 0 ? typename Pose::Jacobian(d * d.transpose()) : testing::RandomInformation<Pose::kDof>(rng);
      S = scale.asDiagonal() * S * scale.asDiagonal();
      return S;
    };
    const double metres = std::exp(Uniform(rng, -5, 3)), radians = std::exp(Uniform(rng, -5, 1));
    const UncertainPose<Pose> displacement{testing::RandomMotion<Pose>(rng, 10, 1), random(metres, radians)};
    const UncertainPose<Pose> chain{testing::RandomMotion<Pose>(rng, std::exp(Uniform(rng, -3, 4)), 1),
                                    random(0.1 * metres, 0.1 * radians)};
    const Spread bound = Spread::Of<Pose>(displacement.covariance)
                             .Behind(chain.T_a_b.Translation().norm(), Spread::Of<Pose>(chain.covariance));
    const Spread exact = Spread::Of<Pose>(Compose(displacement, chain).covariance);
    ASSERT_LE(exact.metres, bound.metres * (1 + 1e-9)) << "seed " << seed;
    ASSERT_LE(exact.radians, bound.radians * (1 + 1e-9)) << "seed " << seed;
    ASSERT_NEAR(exact.radians, bound.radians, 1e-9 * bound.radians) << "turns only turn it";
    closest = std::max(closest, exact.metres / bound.metres);
  }
  EXPECT_GT(closest, 0.95);
}

// The trace of a block of the covariance does not depend on the frame that it is written in.
TYPED_TEST(PoseIndexTest, SpreadIsThatOfThePosition) {
  using Pose = TypeParam;
  Random rng(5);
  const UncertainPose<Pose> T{testing::RandomMotion<Pose>(rng, 5, 1),
                              1e-4 * testing::RandomInformation<Pose::kDof>(rng)};
  const typename Pose::Jacobian L = testing::CholeskyFactor(T.covariance);
  double sum = 0;
  constexpr int kSamples = 20000;
  for (int k = 0; k < kSamples; ++k) {
    const typename Pose::Tangent d = L * NormalVector<Pose::kDof>(rng);
    sum += ((T.T_a_b * Pose::Exp(d)).Translation() - T.T_a_b.Translation()).squaredNorm();
  }
  const double metres = Spread::Of<Pose>(T.covariance).metres;
  EXPECT_NEAR(std::sqrt(sum / kSamples), metres, 0.02 * metres);
}

}  // namespace
}  // namespace terse
