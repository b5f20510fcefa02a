// Bags of words on rendered keyframes: a place seen before ranks first, the newest frames are left out.

#include "terse/frontend/appearance_search.h"

#include <gtest/gtest.h>

#include <stdexcept>

#include "terse/frontend/loop_verifier.h"
#include "terse/frontend/street_sequence.h"

namespace terse {
namespace {

AppearanceOptions SmallAppearance() {
  AppearanceOptions options;
  options.words = 150;
  options.most_trained = 1500;
  options.gap = 2;
  options.min_similarity = 0.05;
  return options;
}

class AppearanceSearchTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    if (!features_.empty()) return;
    StreetOptions options;
    options.width = 612;
    options.height = 184;
    const StreetSequence street(options);
    LoopVerifier verifier(street.Camera());
    for (int k = 0; k < 120; k += 20) {
      verifier.SetCurrent(street.Render(k));
      features_.push_back(verifier.CurrentFeatures());
      descriptors_.insert(descriptors_.end(), features_.back().descriptors.begin(), features_.back().descriptors.end());
    }
    verifier.SetCurrent(street.Render(21));
    near_second_ = verifier.CurrentFeatures();
  }
  static inline std::vector<KeyframeFeatures> features_;
  static inline KeyframeFeatures near_second_;  // one frame after features_[1]
  static inline std::vector<BinaryDescriptor> descriptors_;
};

TEST_F(AppearanceSearchTest, RanksThePlaceItselfFirst) {
  AppearanceSearch search(descriptors_, SmallAppearance());
  EXPECT_EQ(search.Words(), 150);
  EXPECT_TRUE(search.Query(near_second_).empty());
  for (std::size_t k = 0; k < features_.size(); ++k) search.Add({static_cast<std::int64_t>(k)}, features_[k]);
  const auto found = search.Query(near_second_);
  ASSERT_FALSE(found.empty());
  EXPECT_EQ(found.front().id, PoseId{1});
  for (std::size_t k = 1; k < found.size(); ++k) EXPECT_LE(found[k].similarity, found[k - 1].similarity);
  for (const auto& match : found) {
    EXPECT_LT(match.id.value, 4) << "the last two are not compared";
    EXPECT_LE(match.similarity, 1 + 1e-12);
  }
  const auto itself = search.Query(features_[2]);
  ASSERT_FALSE(itself.empty());
  EXPECT_EQ(itself.front().id, PoseId{2});
  EXPECT_NEAR(itself.front().similarity, 1, 1e-9);
  EXPECT_TRUE(search.Query(KeyframeFeatures{}).empty());
}

TEST_F(AppearanceSearchTest, RepeatsItself) {
  const auto answers = [&] {
    AppearanceSearch search(descriptors_, SmallAppearance());
    for (std::size_t k = 0; k < features_.size(); ++k) search.Add({static_cast<std::int64_t>(k)}, features_[k]);
    return search.Query(near_second_);
  };
  const auto first = answers(), second = answers();
  ASSERT_EQ(first.size(), second.size());
  for (std::size_t k = 0; k < first.size(); ++k) EXPECT_EQ(first[k].similarity, second[k].similarity);
}

TEST_F(AppearanceSearchTest, RefusesWhatMakesNoSense) {
  AppearanceOptions options = SmallAppearance();
  EXPECT_THROW(AppearanceSearch(std::vector<BinaryDescriptor>(149), options), std::invalid_argument);
  options.words = 0;
  EXPECT_THROW(AppearanceSearch(descriptors_, options), std::invalid_argument);
}

}  // namespace
}  // namespace terse
