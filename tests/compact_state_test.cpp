// Saved and loaded compact runs against those that were never interrupted, and files that must be refused.

#include <gtest/gtest.h>

#include <array>
#include <deque>

#include "terse/core/error.h"
#include "terse/core/state_file.h"
#include "testing_compact.h"
#include "testing_files.h"
#include "testing_state.h"

namespace terse {
namespace {

using testing::Bits;
using testing::LoadError;
using testing::Random;

template <class Saved>
std::string SavedBytes(const Saved& saved) {
  const TestFile file("bytes.state");
  saved.Save(file.Path());
  return file.Content();
}

template <class Pose>
CompactPoseSlam<Pose> SavedAndLoaded(const CompactPoseSlam<Pose>& slam) {
  const TestFile file("loaded.state");
  slam.Save(file.Path());
  return CompactPoseSlam<Pose>::Load(file.Path());
}

// The whole state but for how long things took: the solver's members are part of it, times last.
template <class Pose>
std::string SavedButTimes(const CompactPoseSlam<Pose>& slam) {
  const std::string kind = StateKind<Pose>("incremental solver"), of_solver = SavedBytes(slam.Solver());
  const std::size_t members = 8 + 4 + 4 + kind.size() + 8;
  const std::string solver = of_solver.substr(members, of_solver.size() - members - testing::kStateChecksum);
  std::string bytes = SavedBytes(slam);
  bytes.resize(bytes.size() - testing::kStateChecksum);
  const std::size_t at = bytes.find(solver);
  EXPECT_NE(at, std::string::npos) << "the solver is stored as it stores itself";
  if (at != std::string::npos) bytes.erase(at + solver.size() - testing::kStateTimes, testing::kStateTimes);
  return bytes;
}

// All fields, so that a new one is not forgotten.
std::string Fields(const Candidate& candidate) {
  const auto& [id, probability, gain, measured, tried, measured_gain, innovation, outlier, supported, accepted, factor,
               carried_from, anchors, composed] = candidate;
  return Bits(id) + Bits(probability) + Bits(gain) + Bits(measured) + Bits(tried) + Bits(measured_gain) +
         Bits(innovation) + Bits(outlier) + Bits(supported) + Bits(accepted) + Bits(factor) + Bits(carried_from) +
         Bits(anchors) + Bits(composed);
}

std::string Fields(const ComposedEdge& edge) {
  const auto& [id, from, to, gain, fused] = edge;
  return Bits(id) + Bits(from) + Bits(to) + Bits(gain) + Bits(fused);
}

std::string Fields(const Decision& decision) {
  const auto& [id, candidates, found, verdict, pose_gain, tried, accepted, refused, forgotten, revived, retired,
               anchored_to, edges, update] = decision;
  EXPECT_EQ(update.has_value(), decision.Kept() || !edges.empty());
  std::string out = (update ? Bits(update->gate_value) + Bits(update->flops) : "") + Bits(id) + Bits(verdict) +
                    Bits(pose_gain) + Bits(tried) + Bits(accepted) + Bits(refused) + Bits(forgotten) +
                    Bits(candidates.size()) + Bits(found) + Bits(anchored_to);
  for (const ComposedEdge& edge : edges) out += Fields(edge);
  for (const PoseId back : revived) out += Bits(back);
  for (const RetiredPose& pose : retired) out += Bits(pose.id) + Bits(pose.loss);
  for (const Candidate& candidate : candidates) out += Fields(candidate);
  return out;
}

std::string Fields(const LinkDecision& decision) {
  const auto& [from, to, gain, innovation, outlier, accepted, factor] = decision;
  return Bits(from) + Bits(to) + Bits(gain) + Bits(innovation) + Bits(outlier) + Bits(accepted) + Bits(factor);
}

template <class Pose>
void ExpectSameBits(const CompactPoseSlam<Pose>& a, const CompactPoseSlam<Pose>& b) {
  for (const Recovery recovery : {Recovery::kV0, Recovery::kV1, Recovery::kV2}) {
    const auto of_a = a.Trajectory(recovery), of_b = b.Trajectory(recovery);
    ASSERT_EQ(of_a.size(), of_b.size());
    for (std::size_t k = 0; k < of_a.size(); ++k) {
      ASSERT_EQ(of_a[k].id, of_b[k].id);
      ASSERT_EQ(of_a[k].kept, of_b[k].kept);
      ASSERT_EQ(Bits(of_a[k].T_world_body), Bits(of_b[k].T_world_body)) << "pose " << k;
    }
  }
  ASSERT_EQ(a.PosesSeen(), b.PosesSeen());
  ASSERT_EQ(a.LinksKept(), b.LinksKept());
  ASSERT_EQ(Bits(a.Solver().Chi2()), Bits(b.Solver().Chi2()));
  ASSERT_EQ(Bits(a.Solver().LogDeterminant()), Bits(b.Solver().LogDeterminant()));
}

struct Setting {
  const char* name;
  Strategy strategy;
  bool linkable = true;  // the poses that can be linked are named
  RobustKernel kernel = RobustKernel::kNone;
  bool priors = false;    // and fixed poses
  bool branches = false;  // odometry from older poses
  bool other = false;     // options other than the default
  bool measured = false;  // loops come with the poses
};

constexpr std::array<Setting, 18> kSettings = {{
    {"fpfl", Strategy::kFpfl},
    {"fpfl, priors", Strategy::kFpfl, true, RobustKernel::kNone, true},
    {"fpfl, branches", Strategy::kFpfl, true, RobustKernel::kNone, false, true},
    {"fpfl, other options", Strategy::kFpfl, true, RobustKernel::kNone, false, false, true},
    {"fpfl, dcs", Strategy::kFpfl, true, RobustKernel::kDcs},
    {"fpfl, gnc, priors", Strategy::kFpfl, true, RobustKernel::kGnc, true},
    {"apfl", Strategy::kApfl},
    {"apfl, gnc", Strategy::kApfl, true, RobustKernel::kGnc},
    {"apal", Strategy::kApal},
    {"apal, dcs, priors", Strategy::kApal, true, RobustKernel::kDcs, true},
    {"apal, searching", Strategy::kApal, false},
    {"apal, searching, gnc, branches", Strategy::kApal, false, RobustKernel::kGnc, false, true},
    {"fpfl, loops", Strategy::kFpfl, true, RobustKernel::kNone, false, false, false, true},
    {"apfl, loops, gnc, branches", Strategy::kApfl, true, RobustKernel::kGnc, false, true, false, true},
    {"bounded", Strategy::kBounded},
    {"bounded, loops", Strategy::kBounded, true, RobustKernel::kNone, false, false, false, true},
    {"bounded, loops, priors, branches", Strategy::kBounded, true, RobustKernel::kNone, true, true, false, true},
    {"bounded, loops, gnc", Strategy::kBounded, true, RobustKernel::kGnc, false, false, false, true},
}};

// A run over a random graph: its inputs, and what happens besides.
template <class Pose>
struct StateCourse {
  StateCourse(const Setting& setting, std::uint64_t seed, int poses) : rng(seed) {
    testing::RandomGraphOptions options;
    options.poses = poses;
    options.id_stride = 3;
    options.noise = 0.05;
    options.priors = setting.priors;
    scene = testing::MakeRandomGraph<Pose>(rng, options);
    if (setting.priors) scene.graph.SetFixed(scene.graph.Poses()[At(poses / 2)].id, true);
    replay.emplace(scene.graph);
    inputs = replay->Inputs();
    for (std::size_t k = 0; k < inputs.size(); ++k) {
      if (!setting.linkable) inputs[k].linkable.reset();
      if (!setting.measured) inputs[k].loops.reset();
      if (setting.branches && k % 7 == 6) inputs[k].odometry = Measure(rng() % k, k);
    }
    slam = testing::OptionsFor(*replay, setting.strategy);
    slam.thresholds.min_loop_gain = 0.3;
    slam.thresholds.min_pose_gain = 2.5;
    slam.thresholds.range *= setting.linkable ? 1 : 0.4;
    slam.failed_neighbourhood = 0.02;  // the random edges of a graph are no places
    slam.solver.robust.kernel = setting.kernel;
    if (!setting.other) return;
    slam.distance.angle = AngleMeasure::kRotation;
    slam.distance.view_axis = {1, 0, 0};
    slam.composition = CompositionOrder::kFourth;
    slam.innovation_quantile = 0.5;
    slam.consensus = 2;
    slam.thresholds.probability = 0.3;
    slam.solver.relinearize_interval = 3;
  }
  static std::size_t At(int i) { return static_cast<std::size_t>(i); }
  RelativePoseFactor<Pose> Measure(std::size_t from, std::size_t to) {
    const Pose T = scene.truth[from].Inverse() * scene.truth[to] * testing::RandomMotion<Pose>(rng, 0.05, 0.05);
    return {inputs[from].id, inputs[to].id, T, testing::RandomInformation<Pose::kDof>(rng, 50)};
  }
  // A link between two poses seen that do not hang on the same one; a wrong one now and then.
  std::optional<RelativePoseFactor<Pose>> LateLink(const CompactPoseSlam<Pose>& running, std::size_t seen) {
    const std::size_t from = rng() % seen, to = rng() % seen;
    if (running.KeptBase(inputs[from].id) == running.KeptBase(inputs[to].id)) return std::nullopt;
    auto link = Measure(from, to);
    if (rng() % 5 == 0) link.T_from_to = link.T_from_to * testing::RandomMotion<Pose>(rng, 3, 1);
    return link;
  }

  Random rng;
  testing::RandomGraph<Pose> scene;
  std::optional<GraphReplay<Pose>> replay;
  std::vector<CompactInput<Pose>> inputs;
  CompactOptions<Pose> slam;
};

template <class Pose>
class Lockstep {
 public:
  Lockstep(const Setting& setting, std::uint64_t seed, std::size_t interval)
      : course_(setting, seed, 50), running_(course_.slam), interval_(interval) {}

  void Run() {
    for (std::size_t k = 0; k < course_.inputs.size(); ++k) {
      SCOPED_TRACE("pose " + std::to_string(k));
      Add(course_.inputs[k]);
      if (k % 4 == 3) AddLate(k + 1);
      if (k % 9 == 8) Remove();
      if (resumed_) ExpectSameBits(running_, *resumed_);
      if (::testing::Test::HasFatalFailure()) return;
      if (k % interval_ != 0) continue;
      if (resumed_) {
        ASSERT_TRUE(SavedButTimes(running_) == SavedButTimes(*resumed_));
      }
      resumed_.emplace(SavedAndLoaded(running_));
      ASSERT_TRUE(SavedBytes(*resumed_) == SavedBytes(running_)) << "saved, loaded, saved";
    }
    const auto a = running_.Finish(), b = resumed_->Finish();
    EXPECT_EQ(Bits(a.chi2), Bits(b.chi2));
    EXPECT_EQ(a.iterations, b.iterations);
    ExpectSameBits(running_, *resumed_);
    EXPECT_TRUE(SavedButTimes(running_) == SavedButTimes(*resumed_));
    resumed_.emplace(SavedAndLoaded(running_));
    ExpectSameBits(running_, *resumed_);
  }
  int links = 0, late = 0, removed = 0, refused = 0, dropped = 0;

 private:
  void Add(const CompactInput<Pose>& input) {
    std::deque<std::optional<RelativePoseFactor<Pose>>> registered;
    std::string asked, asked_again;
    const auto decision = running_.AddPose(input, [&](PoseId candidate, PoseId current) {
      asked += Bits(candidate) + Bits(current);
      return registered.emplace_back(course_.replay->AsRegistration()(candidate, current));
    });
    for (const Candidate& c : decision.candidates) {
      if (c.factor) links_.push_back(*c.factor);
    }
    for (const ComposedEdge& edge : decision.edges) links_.push_back(edge.id);
    links += decision.links_accepted;
    refused += decision.links_refused;
    dropped += decision.Kept() ? 0 : 1;
    if (!resumed_) return;
    const auto again = resumed_->AddPose(input, [&](PoseId candidate, PoseId current) {
      asked_again += Bits(candidate) + Bits(current);
      const auto link = registered.empty() ? std::nullopt : registered.front();
      if (!registered.empty()) registered.pop_front();
      return link;
    });
    ASSERT_EQ(asked, asked_again);
    ASSERT_EQ(Fields(decision), Fields(again));
  }
  void AddLate(std::size_t seen) {
    const auto link = course_.LateLink(running_, seen);
    if (!link) return;
    const LinkDecision decision = running_.AddLink(*link);
    if (decision.factor) links_.push_back(*decision.factor);
    late += decision.accepted ? 1 : 0;
    refused += decision.outlier ? 1 : 0;
    if (resumed_) {
      ASSERT_EQ(Fields(decision), Fields(resumed_->AddLink(*link)));
    }
  }
  void Remove() {
    if (links_.empty()) return;
    const auto victim = links_.begin() + static_cast<long>(course_.rng() % links_.size());
    running_.RemoveLink(*victim);
    if (resumed_) resumed_->RemoveLink(*victim);
    links_.erase(victim);
    ++removed;
  }

  StateCourse<Pose> course_;
  CompactPoseSlam<Pose> running_;
  std::optional<CompactPoseSlam<Pose>> resumed_;
  std::size_t interval_;
  std::vector<FactorId> links_;
};

template <class Pose>
class CompactStateTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactStateTest, Groups);

TYPED_TEST(CompactStateTest, ContinuesBitByBit) {
  for (const Setting& setting : kSettings) {
    int links = 0, late = 0, removed = 0, dropped = 0, refused = 0;
    for (const auto& [seed, interval] : {std::pair(1, 4), std::pair(2, 11), std::pair(3, 23)}) {
      SCOPED_TRACE(std::string(setting.name) + ", seed " + std::to_string(seed));
      Lockstep<TypeParam> run(setting, static_cast<std::uint64_t>(seed), static_cast<std::size_t>(interval));
      run.Run();
      if (this->HasFatalFailure()) return;
      links += run.links;
      late += run.late;
      removed += run.removed;
      dropped += run.dropped;
      refused += run.refused;
    }
    EXPECT_GT(links, 10) << setting.name;
    EXPECT_GT(late, 3) << setting.name;
    EXPECT_GT(removed, 6) << setting.name;
    if (setting.other) {
      EXPECT_GT(refused, 0) << "refused links are part of the state";
    }
    const bool drops = setting.strategy == Strategy::kFpfl || setting.strategy == Strategy::kBounded;
    EXPECT_EQ(dropped > 0, drops) << setting.name;
  }
}

// What was refused before the run was saved supports what comes after.
TEST(CompactStateConsensusTest, ContinuesBitByBit) {
  for (std::size_t saved_at = 20; saved_at < 23; ++saved_at) {
    SCOPED_TRACE(saved_at);
    const testing::SlippingCircle course;
    CompactPoseSlam<SE2> running(course.options);
    std::optional<CompactPoseSlam<SE2>> resumed;
    int refused_before = 0, supported_after = 0;
    for (std::size_t k = 0; k < course.inputs.size(); ++k) {
      if (k == saved_at) resumed.emplace(SavedAndLoaded(running));
      const Decision decision = running.AddPose(course.inputs[k], course.registration);
      if (k < saved_at) refused_before += decision.links_refused;
      if (!resumed) continue;
      ASSERT_EQ(Fields(resumed->AddPose(course.inputs[k], course.registration)), Fields(decision)) << k;
      for (const Candidate& c : decision.candidates) supported_after += c.supported ? 1 : 0;
      ExpectSameBits(running, *resumed);
    }
    EXPECT_EQ(refused_before > 0, saved_at > 20);
    EXPECT_GT(supported_after, 0);
    EXPECT_TRUE(SavedButTimes(running) == SavedButTimes(*resumed));
  }
}

// Options included, and a run without a pose.
TYPED_TEST(CompactStateTest, BeforeTheFirstPose) {
  const StateCourse<TypeParam> course(kSettings[3], 4, 10);
  const CompactPoseSlam<TypeParam> slam(course.slam);
  const auto loaded = SavedAndLoaded(slam);
  EXPECT_EQ(loaded.PosesSeen(), 0);
  EXPECT_EQ(loaded.Options().distance.angle, AngleMeasure::kRotation);
  EXPECT_EQ(loaded.Options().innovation_quantile, course.slam.innovation_quantile);
  EXPECT_EQ(loaded.Options().consensus, 2);
  EXPECT_TRUE(loaded.Options().thresholds.range == course.slam.thresholds.range);
  EXPECT_EQ(SavedBytes(loaded), SavedBytes(slam));
}

// What fails leaves nothing behind that a state would keep.
TYPED_TEST(CompactStateTest, FailuresLeaveTheStateAsItWas) {
  StateCourse<TypeParam> course(kSettings[0], 5, 30);
  CompactPoseSlam<TypeParam> slam(course.slam);
  for (std::size_t k = 0; k < 29; ++k) slam.AddPose(course.inputs[k], course.replay->AsRegistration());
  const std::string before = SavedButTimes(slam);
  auto link = course.Measure(2, 20);
  link.to = PoseId{-1};
  EXPECT_THROW(slam.AddLink(link), std::invalid_argument);
  link = course.Measure(2, 20);
  link.information(0, 0) = -1;
  EXPECT_THROW(slam.AddLink(link), std::invalid_argument);
  EXPECT_THROW(slam.RemoveLink(FactorId{0}), std::invalid_argument);
  EXPECT_THROW(slam.RemoveLink(FactorId{100000}), std::invalid_argument);
  EXPECT_THROW(slam.RemoveLink(FactorId{}), std::invalid_argument);
  EXPECT_THROW(slam.AddPose(course.inputs[3], nullptr), std::invalid_argument);
  EXPECT_TRUE(SavedButTimes(slam) == before);
}

// Files that must be refused -------------------------------------------------------------------------------------

CompactPoseSlam<SE2> SmallRun() {
  StateCourse<SE2> course(kSettings[0], 6, 8);
  CompactPoseSlam<SE2> slam(course.slam);
  for (const auto& input : course.inputs) slam.AddPose(input, course.replay->AsRegistration());
  EXPECT_GT(slam.LinksKept(), 0);
  return slam;
}

TEST(CompactStateErrorTest, TruncatedAtEveryLength) {
  const std::string whole = SavedBytes(SmallRun());
  for (std::size_t length = 0; length < whole.size(); length += length < 100 ? 1 : 5) {
    const TestFile file("truncated.state", whole.substr(0, length));
    const std::string error = LoadError<CompactPoseSlam<SE2>>(file.Path());
    const char* expected = length == 0 ? "empty" : length < 8 ? "not a saved state" : "truncated";
    ASSERT_NE(error.find(expected), std::string::npos) << length << " bytes: " << error;
  }
  const TestFile longer("longer.state", whole + "x");
  EXPECT_NE(LoadError<CompactPoseSlam<SE2>>(longer.Path()).find("too long"), std::string::npos);
}

TEST(CompactStateErrorTest, AFlippedBit) {
  const std::string whole = SavedBytes(SmallRun());
  for (std::size_t at = 0; at < whole.size(); at += at < 100 ? 1 : 3) {
    std::string flipped = whole;
    flipped[at] = static_cast<char>(flipped[at] ^ (1 << (at % 8)));
    const TestFile file("flipped.state", flipped);
    ASSERT_NE(LoadError<CompactPoseSlam<SE2>>(file.Path()), "") << "byte " << at;
  }
}

TEST(CompactStateErrorTest, ForeignFiles) {
  const auto slam = SmallRun();
  const auto expect = [](const std::string& content, const std::string& cause) {
    const TestFile file("foreign.state", content);
    const std::string error = LoadError<CompactPoseSlam<SE3>>(file.Path());
    EXPECT_NE(error.find(cause), std::string::npos) << error;
  };
  const std::string whole = SavedBytes(slam);
  expect("VERTEX_SE2 0 0 0 0\n", "not a saved state");
  expect(whole, "holds a state of kind \"compact pose SLAM SE2\", expected \"compact pose SLAM SE3\"");
  expect(SavedBytes(IncrementalSolver<SE3>()), "holds a state of kind \"incremental solver SE3\"");
  const TestFile file("other.state", whole);
  EXPECT_THROW(IncrementalSolver<SE2>::Load(file.Path()), FileError);
  EXPECT_NE(LoadError<CompactPoseSlam<SE3>>("/no/such/folder/x.state").find("does not exist"), std::string::npos);
  EXPECT_NE(LoadError<CompactPoseSlam<SE3>>(::testing::TempDir()).find("folder"), std::string::npos);
  for (const char* path : {"/no/such/folder/x.state", ""}) EXPECT_THROW(slam.Save(path), FileError) << path;
}

// A right checksum over nonsense: refused, or a run that works on, but no crash and no endless memory.
TEST(CompactStateErrorTest, NonsenseWithTheRightChecksum) {
  const std::string whole = SavedBytes(SmallRun());
  ASSERT_EQ(testing::WithChecksum(whole), whole);
  const std::size_t members = 8 + 4 + 4 + StateKind<SE2>("compact pose SLAM").size() + 8;
  StateCourse<SE2> course(kSettings[0], 6, 10);
  int refused = 0, taken = 0;
  const auto check = [&](const std::string& bytes) {
    const TestFile file("nonsense.state", testing::WithChecksum(bytes));
    try {
      auto slam = CompactPoseSlam<SE2>::Load(file.Path());
      ++taken;
      for (std::size_t k = 8; k < course.inputs.size(); ++k) slam.AddPose(course.inputs[k], nullptr);
      slam.Trajectory();
      if (slam.KeptBase(course.inputs[1].id) != slam.KeptBase(course.inputs[6].id)) slam.AddLink(course.Measure(1, 6));
    } catch (const FileError& error) {
      EXPECT_EQ(error.path(), file.Path());
      ++refused;
    } catch (const std::invalid_argument&) {
    } catch (const NumericalError&) {
    }
  };
  const std::uint64_t numbers[] = {0, ~std::uint64_t{0}, 0x7fffffff7fffffff, std::uint64_t{1} << 40, 3};
  for (std::size_t at = members; at + 8 + testing::kStateChecksum < whole.size(); at += 3) {
    std::string changed = whole;
    changed[at] = static_cast<char>(changed[at] ^ (1 << (at % 8)));
    check(changed);
    changed = whole;
    changed.replace(at, 8, testing::Bytes(numbers[at % 5]));
    check(changed);
  }
  EXPECT_GT(refused, 300);
  EXPECT_GT(taken, 300);
}

// The first pose as a dropped one, which has no chain; and one with more successors than there are.
TEST(CompactStateErrorTest, ChainsEndAtAKeptPose) {
  const auto run = SmallRun();
  const std::string whole = SavedBytes(run);
  const std::int64_t first = run.Solver().Graph().Poses().front().id.value;
  const std::string pose = testing::Bytes(static_cast<std::uint64_t>(run.PosesSeen())) + testing::Bytes(first) +
                           testing::Bytes(first) + std::string(12 * sizeof(double), '\0');
  ASSERT_NE(whole.find(pose), std::string::npos);
  const std::size_t base = whole.find(pose) + sizeof(std::uint64_t) + sizeof(first);
  const std::size_t successors = base + sizeof(first) + 15 * sizeof(double) + 2 * sizeof(int),
                    kept = successors + sizeof(int);
  ASSERT_EQ(whole[kept], 1);
  const auto refused = [&](const std::string& bytes) {
    const TestFile file("chain.state", testing::WithChecksum(bytes));
    return testing::LoadError<CompactPoseSlam<SE2>>(file.Path());
  };
  std::string other;
  for (const auto& [id, T_world_body, fixed] : run.Solver().Graph().Poses()) {
    if (id.value != first) other = testing::Bytes(id.value);
  }
  ASSERT_FALSE(other.empty());
  std::string changed = whole;
  changed.replace(base, other.size(), other);
  changed[kept] = 0;
  EXPECT_NE(refused(changed).find("a pose without its chain"), std::string::npos);
  changed = whole;
  changed.replace(successors, sizeof(int), testing::Bytes(0x7fffffff));
  EXPECT_NE(refused(changed).find("another number of successors"), std::string::npos);
}

}  // namespace
}  // namespace terse
