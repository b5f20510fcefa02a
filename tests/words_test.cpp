// The words of enumerations: one for each value, and each value once.

#include "terse/compact/words.h"

#include <gtest/gtest.h>

#include <set>
#include <string>

namespace terse {
namespace {

template <class E>
class WordsTest : public ::testing::Test {};
using Enumerations = ::testing::Types<RotationInformation, InitialValues, ArrivalUnit, OutlierKind, RobustKernel, Gate,
                                      Policy, CholeskyPath, Strategy, Record, AngleMeasure, CompositionOrder, Recovery>;
TYPED_TEST_SUITE(WordsTest, Enumerations);

TYPED_TEST(WordsTest, EveryValueHasOneOfItsOwn) {
  std::set<std::string> words;
  std::set<int> values;
  for (const auto& [word, value] : Words<TypeParam>::kAll) {
    EXPECT_TRUE(words.insert(word).second) << word << " comes twice";
    EXPECT_TRUE(values.insert(static_cast<int>(value)).second) << word << " names a value that has a word already";
    EXPECT_STREQ(WordOf(value), word);
  }
  ASSERT_FALSE(values.empty());
  EXPECT_EQ(*values.begin(), 0);
  EXPECT_EQ(*values.rbegin(), static_cast<int>(values.size()) - 1) << "a value in between has no word";
}

TEST(WordsOfPublicNames, AreTheSame) {
  for (const auto& [word, strategy] : Words<Strategy>::kAll) EXPECT_STREQ(Name(strategy), word);
  for (const auto& [word, method] : Words<InitialValues>::kAll) EXPECT_STREQ(Name(method), word);
}

}  // namespace
}  // namespace terse
