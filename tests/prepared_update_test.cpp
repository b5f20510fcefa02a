// An update that is made ready in pieces while others go on, against dense linear algebra.

#include <gtest/gtest.h>

#include "terse/core/block_cholesky.h"
#include "testing_factor.h"

namespace terse {
namespace {

using testing::ExpectEqualsDense;
using testing::ExpectSoundTree;
using testing::MirroredFactor;
using testing::Random;
using testing::RandomFactor;

template <int B>
using Changes = typename BlockCholesky<B>::Changes;

// A chain of poses with loops.
template <int B>
Changes<B> Grow(Random& rng, int variables, int more) {
  Changes<B> changes;
  changes.new_variables = more;
  for (int v = variables; v < variables + more; ++v) {
    changes.added.push_back(RandomFactor<B>(rng, v, -1));
    if (v > 0) changes.added.push_back(RandomFactor<B>(rng, v - 1, v));
    if (v > 2 && rng() % 3 == 0) {
      changes.added.push_back(RandomFactor<B>(rng, static_cast<int>(rng() % static_cast<std::uint64_t>(v - 1)), v));
    }
  }
  return changes;
}

// New linear factors for some slots.
template <int B>
std::map<int, LinearFactor<B>> Some(Random& rng, const std::map<int, LinearFactor<B>>& by_slot, unsigned one_of) {
  std::map<int, LinearFactor<B>> out;
  for (const auto& [slot, f] : by_slot) {
    if (rng() % one_of == 0) out.emplace(slot, RandomFactor<B>(rng, f.first, f.second));
  }
  return out;
}

// What another update does meanwhile; takes the slots that it changes out of what is expected to be prepared.
template <int B>
void Disturb(Random& rng, MirroredFactor<B>& run, std::map<int, LinearFactor<B>>& prepared) {
  Changes<B> changes;
  if (rng() % 3 != 0) changes = Grow<B>(rng, run.mirror.variables, 1 + static_cast<int>(rng() % 2));
  if (rng() % 3 == 0) {
    for (const auto& [slot, f] : Some<B>(rng, run.mirror.by_slot, 30)) {
      const bool goes = f.second > f.first + 1 && rng() % 2 == 0;
      if (goes) changes.removed.push_back(slot);
      if (!goes) changes.replaced.emplace_back(slot, f);
      prepared.erase(slot);
    }
  }
  ASSERT_TRUE(run.Apply(changes).ok);
}

template <int B>
void RunInterleaved(std::uint64_t seed, long& ready) {
  SCOPED_TRACE("seed " + std::to_string(seed) + ", block size " + std::to_string(B));
  using Clock = typename BlockCholesky<B>::Clock;
  Random rng(seed);
  MirroredFactor<B> run;
  ASSERT_TRUE(run.Apply(Grow<B>(rng, 0, 25)).ok);
  for (int round = 0; round < 5; ++round) {
    std::map<int, LinearFactor<B>> prepared = Some<B>(rng, run.mirror.by_slot, 1 + rng() % 4);
    run.factor.Prepare({prepared.begin(), prepared.end()});
    const int pieces = static_cast<int>(rng() % 8);
    for (int k = 0; k < pieces; ++k) {
      Disturb(rng, run, prepared);
      if (rng() % 4 == 0) {
        const auto more = Some<B>(rng, run.mirror.by_slot, 20);
        run.factor.Prepare({more.begin(), more.end()});
        for (const auto& [slot, f] : more) prepared[slot] = f;
      }
      const bool at_once = rng() % 5 == 0;
      const auto progress = run.factor.Advance(at_once ? Clock::now() + std::chrono::hours(1) : Clock::now());
      ASSERT_EQ(progress.failed_variable, -1);
      if (at_once) {
        ASSERT_EQ(progress.fronts_left, 0);
      }
      ready += progress.fronts_left == 0;
      // Nothing of it is in what is in use.
      ExpectEqualsDense(run.factor, run.mirror);
      if (::testing::Test::HasFatalFailure()) return;
    }
    Changes<B> changes = run.factor.PreparedChanges();
    ASSERT_EQ(changes.replaced.size(), prepared.size());
    for (const auto& [slot, f] : changes.replaced) {
      ASSERT_EQ(f.residual, prepared.at(slot).residual);
      run.mirror.by_slot[slot] = f;
    }
    ASSERT_TRUE(run.factor.UpdatePrepared(std::move(changes)).ok);
    ExpectEqualsDense(run.factor, run.mirror);
    ExpectSoundTree(run.factor);
    ASSERT_TRUE(run.factor.PreparedChanges().replaced.empty());
    if (::testing::Test::HasFatalFailure()) return;
  }
}

TEST(PreparedUpdate, EqualsDenseWhateverComesBetween) {
  long ready = 0;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    RunInterleaved<3>(seed, ready);
    RunInterleaved<6>(seed, ready);
    if (HasFatalFailure()) return;
  }
  EXPECT_GT(ready, 50);
}

// Each call gets on by a front, even where the deadline has passed, and what is ready is not done again.
TEST(PreparedUpdate, GetsOnByAFrontAtATime) {
  Random rng(3);
  MirroredFactor<3> run;
  ASSERT_TRUE(run.Apply(Grow<3>(rng, 0, 60)).ok);
  const auto all = Some<3>(rng, run.mirror.by_slot, 1);
  run.factor.Prepare({all.begin(), all.end()});
  auto progress = run.factor.Advance(BlockCholesky<3>::Clock::now());
  for (int left = progress.fronts_left; left > 0; --left) {
    ASSERT_EQ(progress.fronts_left, left);
    ASSERT_GT(progress.seconds_left, 0);
    progress = run.factor.Advance(BlockCholesky<3>::Clock::now());
  }
  EXPECT_EQ(progress.fronts_left, 0);
  EXPECT_EQ(progress.seconds_left, 0);
}

TEST(PreparedUpdate, SingularOneChangesNothing) {
  for (const bool ahead : {false, true}) {
    Random rng(5);
    MirroredFactor<6> run;
    ASSERT_TRUE(run.Apply(Grow<6>(rng, 0, 20)).ok);
    std::map<int, LinearFactor<6>> bad;
    for (const auto& [slot, f] : run.mirror.by_slot) {
      LinearFactor<6> nothing;
      nothing.first = f.first;
      nothing.second = f.second;
      const bool is_on = f.first == 7 || f.second == 7;
      bad[slot] = is_on ? nothing : RandomFactor<6>(rng, f.first, f.second);
    }
    run.factor.Prepare({bad.begin(), bad.end()});
    const auto progress = run.factor.Advance(BlockCholesky<6>::Clock::now() + std::chrono::hours(ahead ? 1 : 0));
    if (ahead) {
      EXPECT_EQ(progress.failed_variable, 7);
    }
    const auto report = run.factor.UpdatePrepared(run.factor.PreparedChanges());
    EXPECT_FALSE(report.ok);
    EXPECT_EQ(report.failed_variable, 7);
    ExpectEqualsDense(run.factor, run.mirror);
    ExpectSoundTree(run.factor);
    ASSERT_TRUE(run.Apply(Grow<6>(rng, 20, 3)).ok);
    ExpectEqualsDense(run.factor, run.mirror);
  }
}

}  // namespace
}  // namespace terse
