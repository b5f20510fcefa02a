// Saved and loaded solvers against those that were never interrupted, and files that must be refused.

#include "terse/core/state_file.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstring>
#include <filesystem>
#include <functional>

#include "shared_data.h"
#include "terse/core/error.h"
#include "terse/core/front_tree.h"
#include "terse/core/graph_file.h"
#include "terse/core/replay.h"
#include "terse/covariance/incremental_marginals.h"
#include "testing_files.h"
#include "testing_incremental.h"
#include "testing_state.h"

namespace terse {
namespace {

using testing::Bits;
using testing::Bytes;
using testing::LoadError;
using testing::OnePosePerUpdate;
using testing::Random;
using testing::WithChecksum;
constexpr std::size_t kChecksum = testing::kStateChecksum, kTimes = testing::kStateTimes;

template <class Pose>
std::string SavedBytes(const IncrementalSolver<Pose>& solver) {
  const TestFile file("bytes.state");
  solver.Save(file.Path());
  return file.Content();
}

// The whole state, to the last bit, but for how long things took.
template <class Pose>
std::string SavedButTimes(const IncrementalSolver<Pose>& solver) {
  const std::string bytes = SavedBytes(solver);
  return bytes.substr(0, bytes.size() - kChecksum - kTimes);
}

template <class Pose>
IncrementalSolver<Pose> SavedAndLoaded(const IncrementalSolver<Pose>& solver) {
  const TestFile file("loaded.state");
  solver.Save(file.Path());
  return IncrementalSolver<Pose>::Load(file.Path());
}

std::string Fields(const StepReport& report) {
  // All of them, so that a new one is not forgotten.
  const auto& [factor_ids, path, fronts_updated, fronts_refactored, variables_refactored, gate_open, gate_value,
               iterations, variables_relinearised, variables_moved, predicted_decrease, actual_decrease, gain_nats,
               restarted, deferred_relinearisations, deferred_fronts, flops, solve_flops, seconds] = report;
  std::string out;
  for (const FactorId id : factor_ids) out += Bits(id.value);
  return out + Bits(path) + Bits(fronts_updated) + Bits(fronts_refactored) + Bits(variables_refactored) +
         Bits(gate_open) + Bits(gate_value) + Bits(iterations) + Bits(variables_relinearised) + Bits(variables_moved) +
         Bits(predicted_decrease) + Bits(actual_decrease) + Bits(gain_nats) + Bits(restarted) +
         Bits(deferred_relinearisations) + Bits(deferred_fronts) + Bits(flops) + Bits(solve_flops);
}

template <class Pose>
void ExpectSameBits(const IncrementalSolver<Pose>& a, const IncrementalSolver<Pose>& b) {
  const std::vector<Pose> of_a = a.Estimates(), of_b = b.Estimates();
  ASSERT_EQ(of_a.size(), of_b.size());
  for (std::size_t i = 0; i < of_a.size(); ++i) ASSERT_EQ(Bits(of_a[i]), Bits(of_b[i])) << "pose " << i;
  ASSERT_EQ(Bits(a.LogDeterminant()), Bits(b.LogDeterminant()));
  ASSERT_EQ(Bits(a.Cholesky().NewtonDecrement()), Bits(b.Cholesky().NewtonDecrement()));
  ASSERT_EQ(Bits(a.Chi2()), Bits(b.Chi2()));
  ASSERT_EQ(a.Cholesky().System().Gradient(), b.Cholesky().System().Gradient());
  ASSERT_EQ(a.Cholesky().System().Diagonal(), b.Cholesky().System().Diagonal());
  ASSERT_EQ(a.Cholesky().Nonzeros(), b.Cholesky().Nonzeros());
}

template <class Pose>
void ExpectSameTree(const BlockCholesky<Pose::kDof>& a, const BlockCholesky<Pose::kDof>& b) {
  ASSERT_EQ(a.Tree().Roots(), b.Tree().Roots());
  for (int v = 0; v < a.Variables(); ++v) {
    ASSERT_EQ(a.Tree().FrontOf(v), b.Tree().FrontOf(v));
    ASSERT_EQ(a.SlotsOf(v), b.SlotsOf(v));
    const auto &f = a.Tree()[a.Tree().FrontOf(v)], &g = b.Tree()[b.Tree().FrontOf(v)];
    ASSERT_EQ(f.pivots, g.pivots);
    ASSERT_EQ(f.separators, g.separators);
    const std::size_t rows = static_cast<std::size_t>(f.Rows());
    for (std::size_t c = 0; c < static_cast<std::size_t>(f.Columns()); ++c) {
      for (std::size_t r = c; r < rows; ++r)
        ASSERT_EQ(f.panel.Numbers()[c * rows + r], g.panel.Numbers()[c * rows + r]);
    }
  }
}

struct Setting {
  const char* name;
  std::function<void(IncrementalOptions&)> set;
};

const std::vector<Setting>& Settings() {
  static const std::vector<Setting> settings = {
      {"default", [](IncrementalOptions&) {}},
      {"relinearised often",
       [](IncrementalOptions& o) {
         o.relinearize_interval = 2;
         o.relinearize_tolerance = 1e-9;
         o.propagation_tolerance = 0;
         o.report_cost = true;
       }},
      {"gate mostly closed",
       [](IncrementalOptions& o) {
         o.gate = Gate::kLoopClosure;
         o.gate_threshold = 12;
       }},
      {"information gate and anchor",
       [](IncrementalOptions& o) {
         o.gate = Gate::kMutualInformation;
         o.gate_threshold = 1;
         o.anchor_information = 1;
       }},
      {"points", [](IncrementalOptions& o) { o = PolicyOptions(Policy::kGniSpoIgg); }},
      {"points, guarded",
       [](IncrementalOptions& o) {
         o.carry = Carry::kPoint;
         o.partial = true;
         o.decrease_scale = DecreaseScale::kDof;
       }},
      {"no time", [](IncrementalOptions& o) { o.budget_seconds = 1e-9; }},
      {"robust kernel", [](IncrementalOptions& o) { o.robust.kernel = RobustKernel::kDcs; }},
      {"graduated non-convexity", [](IncrementalOptions& o) { o.robust.kernel = RobustKernel::kGnc; }},
      {"threads", [](IncrementalOptions& o) { o.threads = 2; }},
  };
  return settings;
}

template <class Pose>
class StateFileTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(StateFileTest, Groups);

// Steps that append, update, refactor, remove and fail.
template <class Pose>
std::vector<GraphUpdate<Pose>> RandomUpdates(std::uint64_t seed, int poses) {
  Random rng(seed);
  testing::RandomGraphOptions options;
  options.poses = poses;
  options.noise = 0.05;
  options.priors = seed % 2 == 0;
  options.id_stride = 3;
  const auto random = testing::MakeRandomGraph<Pose>(rng, options);
  auto updates = OnePosePerUpdate(random.graph);
  const std::size_t k = updates.size() / 2;
  if (seed % 3 == 0) updates[k].poses[0] = {random.graph.Poses()[k].id, random.truth[k], true};
  return updates;
}

template <class Pose>
void FailNowAndThen(std::size_t step, IncrementalSolver<Pose>& solver) {
  if (step % 7 != 3) return;
  GraphUpdate<Pose> singular;  // held in its position only
  singular.poses.push_back({PoseId{-5}, Pose()});
  singular.factors.push_back(
      PositionPriorFactor<Pose>{PoseId{-5}, Pose::Position::Zero(), Matrix<Pose::kDim, Pose::kDim>::Identity()});
  EXPECT_THROW(solver.Update(singular), NumericalError);
}

TYPED_TEST(StateFileTest, ContinuesBitByBit) {
  for (const Setting& setting : Settings()) {
    for (std::uint64_t seed = 1; seed <= 3; ++seed) {
      SCOPED_TRACE(std::string(setting.name) + ", seed " + std::to_string(seed));
      Random rng(seed);
      IncrementalOptions options;
      setting.set(options);
      IncrementalSolver<TypeParam> running(options);
      std::optional<IncrementalSolver<TypeParam>> resumed;
      auto updates = RandomUpdates<TypeParam>(seed, 60);
      std::set<CholeskyPath> paths;
      for (std::size_t k = 0; k < updates.size(); ++k) {
        testing::MaybeRemove(rng, running.Graph(), 3, updates[k]);
        const StepReport report = running.Update(updates[k]);
        paths.insert(report.path);
        FailNowAndThen(k, running);
        if (resumed) {
          ASSERT_EQ(Fields(resumed->Update(updates[k])), Fields(report)) << "step " << k;
          FailNowAndThen(k, *resumed);
          ExpectSameBits(running, *resumed);
          if (this->HasFatalFailure()) return;
        }
        if (k % 9 != 0) continue;
        if (resumed) {
          ASSERT_TRUE(SavedButTimes(*resumed) == SavedButTimes(running)) << "step " << k;
        }
        resumed.emplace(SavedAndLoaded(running));
      }
      ExpectSameTree<TypeParam>(running.Cholesky(), resumed->Cholesky());
      EXPECT_GE(paths.size(), 2u);
      const auto finished = running.Finish(), resumed_finished = resumed->Finish();
      EXPECT_EQ(Bits(finished.chi2), Bits(resumed_finished.chi2));
      ExpectSameBits(running, *resumed);
      if (this->HasFatalFailure()) return;
    }
  }
}

TYPED_TEST(StateFileTest, LoadedOneSavesTheSameBytes) {
  IncrementalSolver<TypeParam> solver;
  EXPECT_EQ(SavedBytes(SavedAndLoaded(solver)), SavedBytes(solver));  // without a pose
  for (const auto& update : RandomUpdates<TypeParam>(5, 40)) {
    solver.Update(update);
    if (solver.Graph().Poses().size() % 3 == 1) {
      ASSERT_TRUE(SavedBytes(SavedAndLoaded(solver)) == SavedBytes(solver));
    }
  }
  solver.Finish();
  EXPECT_TRUE(SavedBytes(SavedAndLoaded(solver)) == SavedBytes(solver));
}

TYPED_TEST(StateFileTest, KeepsFactorIds) {
  IncrementalSolver<TypeParam> solver;
  auto updates = RandomUpdates<TypeParam>(7, 20);
  for (const auto& update : updates) solver.Update(update);
  const auto last = solver.Graph().Factors().back().id;
  GraphUpdate<TypeParam> again;
  const auto& f = std::get<RelativePoseFactor<TypeParam>>(updates[4].factors[0]);
  again.factors = {f};
  const FactorId added = solver.Update(again).factor_ids.at(0);
  GraphUpdate<TypeParam> removal;
  removal.removed = {added};
  solver.Update(removal);
  IncrementalSolver<TypeParam> loaded = SavedAndLoaded(solver);
  EXPECT_EQ(loaded.Graph().FindFactor(added), nullptr);
  ASSERT_NE(loaded.Graph().FindFactor(last), nullptr);
  EXPECT_EQ(loaded.Update(again).factor_ids.at(0).value, added.value + 1);
}

// What a measurement counted for goes with it: a stored state in which it does not is refused.
TYPED_TEST(StateFileTest, RemovedMeasurementsLeaveNothing) {
  IncrementalOptions options;
  options.relinearize_interval = 1;
  options.relinearize_tolerance = 1e-2;
  IncrementalSolver<TypeParam> solver(options);
  for (const auto& update : RandomUpdates<TypeParam>(5, 60)) solver.Update(update);
  GraphUpdate<TypeParam> removal;
  for (const auto& node : solver.Graph().Factors()) {
    const auto* f = std::get_if<RelativePoseFactor<TypeParam>>(&node.factor);
    if (f != nullptr && std::abs(f->from.value - f->to.value) > 3) removal.removed.push_back(node.id);
  }
  ASSERT_GT(removal.removed.size(), 10u);
  solver.Update(removal);
  EXPECT_TRUE(SavedBytes(SavedAndLoaded(solver)) == SavedBytes(solver));
}

// Versions, identities and the history of changes are those of a new factor; covariances must not notice otherwise.
TYPED_TEST(StateFileTest, CovariancesAreThoseOfTheRunningSolver) {
  IncrementalSolver<TypeParam> running;
  IncrementalMarginals<TypeParam> kept(running);
  const auto updates = RandomUpdates<TypeParam>(11, 60);
  for (std::size_t k = 0; k < 30; ++k) {
    running.Update(updates[k]);
    kept.Update();
  }
  IncrementalSolver<TypeParam> loaded = SavedAndLoaded(running);
  EXPECT_NE(loaded.Cholesky().Identity(), running.Cholesky().Identity());
  EXPECT_GT(loaded.Cholesky().Version(), running.Cholesky().Version());
  EXPECT_FALSE(loaded.Cholesky().ChangesSince(running.Cholesky().Version()));
  IncrementalMarginals<TypeParam> fresh(running), of_loaded(loaded);
  for (std::size_t k = 30; k < updates.size(); ++k) {
    SCOPED_TRACE("step " + std::to_string(k));
    const std::uint64_t before = loaded.Cholesky().Version();
    running.Update(updates[k]);
    loaded.Update(updates[k]);
    EXPECT_GT(loaded.Cholesky().Version(), before);
    kept.Update();
    fresh.Update();
    of_loaded.Update();
    const auto &a = fresh.KeptMarginals(), &b = of_loaded.KeptMarginals(), &c = kept.KeptMarginals();
    for (std::size_t i = 0; i < a.size(); ++i) {
      ASSERT_TRUE(a[i] == b[i]);
      ASSERT_LT(testing::RelativeError(c[i], b[i]), 1e-7);
    }
    ASSERT_TRUE(fresh.Newest() == of_loaded.Newest());
  }
  // Caches see another object in the place of theirs.
  loaded = SavedAndLoaded(running);
  of_loaded.Update();
  ASSERT_LT(testing::RelativeError(of_loaded.Newest(), kept.Newest()), 1e-7);
}

std::string SmallState() {
  IncrementalSolver<SE2> solver;
  for (const auto& update : RandomUpdates<SE2>(3, 4)) solver.Update(update);
  return SavedBytes(solver);
}

TEST(StateFileErrorTest, TruncatedAtEveryLength) {
  const std::string whole = SmallState();
  for (std::size_t length = 0; length < whole.size(); ++length) {
    const TestFile file("truncated.state", whole.substr(0, length));
    const std::string error = LoadError<IncrementalSolver<SE2>>(file.Path());
    const char* expected = length == 0 ? "empty" : length < 8 ? "not a saved state" : "truncated";
    ASSERT_NE(error.find(expected), std::string::npos) << length << " bytes: " << error;
  }
  const TestFile file("longer.state", whole + "x");
  EXPECT_NE(LoadError<IncrementalSolver<SE2>>(file.Path()).find("too long"), std::string::npos);
}

TEST(StateFileErrorTest, AnyFlippedBit) {
  const std::string whole = SmallState();
  for (std::size_t at = 0; at < whole.size(); ++at) {
    std::string flipped = whole;
    flipped[at] = static_cast<char>(flipped[at] ^ (1 << (at % 8)));
    const TestFile file("flipped.state", flipped);
    ASSERT_NE(LoadError<IncrementalSolver<SE2>>(file.Path()), "") << "byte " << at;
  }
}

// A right checksum over nonsense: refused, or a solver that works on, but no crash and no endless memory.
TEST(StateFileErrorTest, NonsenseWithTheRightChecksum) {
  const std::string whole = SmallState();
  ASSERT_EQ(WithChecksum(whole), whole);
  const std::size_t members = 8 + 4 + 4 + std::string("incremental solver SE2").size() + 8;
  const auto updates = RandomUpdates<SE2>(3, 7);
  int refused = 0, taken = 0;
  const auto check = [&](const std::string& bytes) {
    const TestFile file("nonsense.state", WithChecksum(bytes));
    try {
      IncrementalSolver<SE2> solver = IncrementalSolver<SE2>::Load(file.Path());
      ++taken;
      for (std::size_t k = 4; k < updates.size(); ++k) solver.Update(updates[k]);
    } catch (const FileError& error) {
      EXPECT_EQ(error.path(), file.Path());
      ++refused;
    } catch (const std::invalid_argument&) {
    } catch (const NumericalError&) {
    }
  };
  const std::uint64_t numbers[] = {0, ~std::uint64_t{0}, 0x7fffffff7fffffff, std::uint64_t{1} << 40, 3};
  for (std::size_t at = members; at + 8 + kChecksum < whole.size(); ++at) {
    std::string changed = whole;
    changed[at] = static_cast<char>(changed[at] ^ (1 << (at % 8)));
    check(changed);
    changed = whole;
    changed.replace(at, 8, Bytes(numbers[at % 5]));
    check(changed);
  }
  EXPECT_GT(refused, 500);
  EXPECT_GT(taken, 500);
}

TEST(StateFileErrorTest, ForeignFiles) {
  const auto expect = [](const std::string& content, const std::string& cause) {
    const TestFile file("foreign.state", content);
    const std::string error = LoadError<IncrementalSolver<SE3>>(file.Path());
    EXPECT_NE(error.find(cause), std::string::npos) << error;
  };
  const std::string whole = SmallState();
  expect("", "empty");
  expect("VERTEX_SE2 0 0 0 0\n", "not a saved state");
  expect("TERSE", "not a saved state");
  expect(whole, "holds a state of kind \"incremental solver SE2\", expected \"incremental solver SE3\"");
  std::string newer = whole;
  newer[8] = static_cast<char>(kStateFormat + 1);
  expect(newer, "format version " + std::to_string(kStateFormat + 1) + ", this program reads version " +
                    std::to_string(kStateFormat));
  const TestFile other("other.state");
  SaveState(other.Path(), "numbers", std::vector<int>{1, 2, 3});
  expect(other.Content(), "holds a state of kind \"numbers\"");
  EXPECT_NE(LoadError<IncrementalSolver<SE3>>("/no/such/folder/x.state").find("does not exist"), std::string::npos);
  EXPECT_NE(LoadError<IncrementalSolver<SE3>>(::testing::TempDir()).find("folder"), std::string::npos);
}

TEST(StateFileErrorTest, UnwritablePlaces) {
  const IncrementalSolver<SE2> solver;
  EXPECT_THROW(solver.Save("/no/such/folder/x.state"), FileError);
  EXPECT_THROW(solver.Save(::testing::TempDir()), FileError);
  EXPECT_THROW(solver.Save(""), FileError);
  EXPECT_THROW(solver.Save("/proc/x.state"), FileError);
  if (::geteuid() == 0) return;  // who may write everywhere else
  const TestFile file("protected.state", "old");
  ASSERT_EQ(::chmod(file.Path().c_str(), 0400), 0);
  EXPECT_THROW(solver.Save(file.Path()), FileError);
  EXPECT_EQ(file.Content(), "old");
}

// Every kind of member that a class may list.
struct Sample {
  bool yes = true;
  char letter = 'x';
  long many = -(1L << 40);
  std::size_t size = 7;
  long double precise = 1.0L + 0x1p-63L;
  double odd = -0.0;
  Gate gate = Gate::kNever;
  std::string text = "two\nlines";
  std::vector<bool> flags{true, false, true};
  std::vector<std::vector<int>> nested{{1, 2}, {}, {3}};
  std::map<std::string, double> sorted{{"a", 0.1}, {"b", 1e300}};
  std::unordered_map<std::int64_t, int> unsorted{{5, 1}, {-3, 2}, {100, 3}};
  std::optional<double> nothing, something = 3.5;
  std::variant<int, double, std::string> choice = std::string("third");
  std::pair<int, double> pair{1, 2.5};
};

template <class Archive>
void Serialize(Archive& archive, Sample& sample) {
  auto& [yes, letter, many, size, precise, odd, gate, text, flags, nested, sorted, unsorted, nothing, something, choice,
         pair] = sample;
  archive(yes, letter, many, size, precise, odd, gate, text, flags, nested, sorted, unsorted, nothing, something,
          choice, pair);
}

TEST(StateArchiveTest, EveryKindOfMember) {
  Sample sample;
  const TestFile file("sample.state");
  SaveState(file.Path(), "sample", sample);
  const Sample read = LoadState<Sample>(file.Path(), "sample");
  EXPECT_EQ(read.yes, sample.yes);
  EXPECT_EQ(read.letter, sample.letter);
  EXPECT_EQ(read.many, sample.many);
  EXPECT_EQ(read.size, sample.size);
  EXPECT_EQ(read.precise, sample.precise);
  EXPECT_TRUE(std::signbit(read.odd));
  EXPECT_EQ(read.gate, sample.gate);
  EXPECT_EQ(read.text, sample.text);
  EXPECT_EQ(read.flags, sample.flags);
  EXPECT_EQ(read.nested, sample.nested);
  EXPECT_EQ(read.sorted, sample.sorted);
  EXPECT_EQ(read.unsorted, sample.unsorted);
  EXPECT_EQ(read.nothing, sample.nothing);
  EXPECT_EQ(read.something, sample.something);
  EXPECT_EQ(read.choice, sample.choice);
  EXPECT_EQ(read.pair, sample.pair);
  // An unordered map's history does not show.
  Sample same;
  same.unsorted.clear();
  same.unsorted.rehash(1000);
  for (const std::int64_t key : {100, 5, -3}) same.unsorted[key] = sample.unsorted[key];
  const TestFile again("again.state");
  SaveState(again.Path(), "sample", same);
  EXPECT_EQ(again.Content(), file.Content());
}

TEST(StateArchiveTest, InMemoryAsInAFile) {
  Sample sample;
  sample.text = "in memory";
  const TestFile file("sample.state");
  SaveState(file.Path(), "sample", sample);
  const std::string bytes = StateBytes("sample", sample);
  EXPECT_EQ(bytes, file.Content());
  EXPECT_EQ(FromStateBytes<Sample>(bytes, "here", "sample").text, sample.text);
  for (const std::string& wrong : {std::string(), std::string("no state"), bytes.substr(0, bytes.size() - 1),
                                   bytes.substr(0, bytes.size() - 1) + char(bytes.back() ^ 1)}) {
    try {
      FromStateBytes<Sample>(wrong, "here", "sample");
      ADD_FAILURE() << wrong.size();
    } catch (const FileError& error) {
      EXPECT_EQ(error.path(), "here");
    }
  }
  EXPECT_THROW(FromStateBytes<Sample>(bytes, "here", "another"), FileError);
}

// Over a whole data set: saved and resumed half-way, the same to the end.
template <class Pose>
void ExpectResumes(const std::string& path) {
  const auto graph = std::get<PoseGraph<Pose>>(ReadGraph(path).graph);
  auto updates = OnePosePerUpdate(graph);
  if (kSlowBuild) updates.resize(400);
  IncrementalSolver<Pose> running;
  for (std::size_t k = 0; k < updates.size() / 2; ++k) running.Update(updates[k]);
  IncrementalSolver<Pose> resumed = SavedAndLoaded(running);
  for (std::size_t k = updates.size() / 2; k < updates.size(); ++k) {
    ASSERT_EQ(Fields(running.Update(updates[k])), Fields(resumed.Update(updates[k]))) << "step " << k;
    if (k % 50 != 0) continue;
    ExpectSameBits(running, resumed);
    if (::testing::Test::HasFatalFailure()) return;
  }
  ExpectSameBits(running, resumed);
  ExpectSameTree<Pose>(running.Cholesky(), resumed.Cholesky());
  EXPECT_TRUE(SavedButTimes(running) == SavedButTimes(resumed));
}

TEST(StateFileDataTest, Manhattan) {
  TERSE_NEEDS(file, "graphs/2d/manhattan.g2o");
  ExpectResumes<SE2>(file);
}

TEST(StateFileDataTest, Sphere2500) {
  TERSE_NEEDS(file, "graphs/3d/sphere2500.g2o");
  ExpectResumes<SE3>(file);
}

}  // namespace
}  // namespace terse
