// The metrics against sums over logarithms, against invariances and against published scores.

#include "terse/core/evaluate.h"

#include <gtest/gtest.h>

#include <cmath>

#include "shared_data.h"
#include "testing_poses.h"

namespace terse {
namespace {

using testing::kPi;
using testing::PoseRandom;

constexpr double kDegrees = 180 / kPi;

struct Pair {
  std::vector<SE3> estimate, reference;
};

// A wandering reference and an estimate whose errors are about `translation_m` and `rotation_rad`, the odd
// quaternion negated.
Pair RandomPair(int poses, double translation_m, double rotation_rad, unsigned seed) {
  PoseRandom random(seed);
  Pair out;
  SE3 T;
  for (int i = 0; i < poses; ++i) {
    SE3::Tangent step, error;
    step << 1, 0.1 * random.NormalVector<2>(), 0.1 * random.NormalVector<3>();
    T = T.Retract(step);
    error << translation_m * random.NormalVector<3>(), rotation_rad * random.NormalVector<3>();
    SE3 estimate = T.Retract(error);
    if (i % 3 == 0) estimate = SE3(SO3(Quaternion(-estimate.Rotation().Unit().coeffs())), estimate.Translation());
    out.reference.push_back(T);
    out.estimate.push_back(estimate);
  }
  return out;
}

SE3 ErrorOf(const Pair& p, std::size_t i, std::size_t j) {
  const SE3 reference = p.reference[i].Inverse() * p.reference[j];
  return reference.Inverse() * (p.estimate[i].Inverse() * p.estimate[j]);
}

// Relative poses over all pairs i < j with j - i <= most, with logarithms.
PoseError BruteForceRpe(const Pair& p, std::size_t most) {
  double translation = 0, rotation = 0;
  long count = 0;
  for (std::size_t i = 0; i < p.estimate.size(); ++i) {
    for (std::size_t j = i + 1; j < p.estimate.size() && j - i <= most; ++j) {
      const SE3 error = ErrorOf(p, i, j);
      translation += error.Translation().squaredNorm();
      rotation += error.Rotation().Log().squaredNorm();
      ++count;
    }
  }
  const double n = static_cast<double>(count);
  return {std::sqrt(translation / n), kDegrees * std::sqrt(rotation / n)};
}

void ExpectNear(const PoseError& a, const PoseError& b, double relative, double absolute) {
  EXPECT_NEAR(a.translation_m, b.translation_m, relative * b.translation_m + absolute);
  EXPECT_NEAR(a.rotation_deg, b.rotation_deg, relative * b.rotation_deg + kDegrees * absolute);
}

TEST(EvaluateTest, RelativeErrorsAreTheSumsOverLogarithms) {
  // From exact to errors of any angle. Lengths around the block sizes of the implementation.
  unsigned seed = 40;
  for (const double rotation : {0.0, 1e-12, 1e-6, 1e-3, 0.1, 0.5, 3.0}) {
    for (const int poses : {2, 3, 33, 200, 513, 514, 700}) {
      const Pair p = RandomPair(poses, rotation, rotation, ++seed);
      const Evaluation out = Evaluate(p.estimate, p.reference);
      EXPECT_EQ(out.poses, poses);
      // Absolute: rounding of positions of some hundred metres and of unit quaternions.
      ExpectNear(out.rpe_all, BruteForceRpe(p, p.estimate.size()), 1e-11, 1e-12);
      ExpectNear(out.rpe, BruteForceRpe(p, 1), 1e-11, 1e-12);
    }
  }
}

TEST(EvaluateTest, HalfTurnsAreMeasuredExactly) {
  for (const double angle : {1e-9, 0.1, 1.0, 2.0, 3.0, kPi - 1e-9, kPi}) {
    const std::vector<SE3> reference(2);
    const std::vector<SE3> estimate = {SE3(), SE3(SO3::Exp(angle * Vector<3>(2, -1, 2) / 3), Vector<3>::Zero())};
    const Evaluation out = Evaluate(estimate, reference);
    EXPECT_NEAR(out.rpe_all.rotation_deg, kDegrees * angle, 1e-15 + 1e-14 * kDegrees * angle) << angle;
    EXPECT_NEAR(out.rpe.rotation_deg, kDegrees * angle, 1e-15 + 1e-14 * kDegrees * angle) << angle;
  }
}

TEST(EvaluateTest, DoesNotDependOnTheNumberOfThreads) {
  const Pair p = RandomPair(1500, 0.3, 0.2, 50);
  EvaluateOptions options;
  options.threads = 1;
  const Evaluation one = Evaluate(p.estimate, p.reference, options);
  for (const int threads : {0, 2, 3, 7, 64}) {
    options.threads = threads;
    const Evaluation many = Evaluate(p.estimate, p.reference, options);
    EXPECT_EQ(many.rpe_all.translation_m, one.rpe_all.translation_m) << threads;
    EXPECT_EQ(many.rpe_all.rotation_deg, one.rpe_all.rotation_deg) << threads;
  }
}

TEST(EvaluateTest, RigidTransformationOfTheEstimateChangesNothing) {
  const Pair p = RandomPair(300, 0.3, 0.2, 51);
  EvaluateOptions options;
  options.kitti = true;
  const Evaluation before = Evaluate(p.estimate, p.reference, options);
  PoseRandom random(52);
  for (int i = 0; i < 20; ++i) {
    const SE3 A = testing::RandomPose<SE3>(random, 100), B = testing::RandomPose<SE3>(random, 100);
    Pair moved = p;
    for (SE3& T : moved.estimate) T = A * T;
    for (SE3& T : moved.reference) T = B * T;
    const Evaluation after = Evaluate(moved.estimate, moved.reference, options);
    // Rounding of positions of some hundred metres against errors of decimetres.
    ExpectNear(after.ate, before.ate, 1e-11, 0);
    ExpectNear(after.rpe, before.rpe, 1e-11, 0);
    ExpectNear(after.rpe_all, before.rpe_all, 1e-11, 0);
    EXPECT_EQ(after.kitti->segments, before.kitti->segments);
    EXPECT_NEAR(after.kitti->t_rel_percent, before.kitti->t_rel_percent, 1e-10);
    EXPECT_NEAR(after.kitti->r_rel_deg_per_100m, before.kitti->r_rel_deg_per_100m, 1e-10);
  }
}

double AteOf(const Pair& p, const SE3& A) {
  double sum = 0;
  for (std::size_t i = 0; i < p.estimate.size(); ++i) {
    sum += (A * p.estimate[i].Translation() - p.reference[i].Translation()).squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(p.estimate.size()));
}

TEST(EvaluateTest, AlignmentRecoversATransformation) {
  Pair p = RandomPair(100, 0, 0, 53);
  PoseRandom random(54);
  const SE3 A = testing::RandomPose<SE3>(random, 10);
  for (SE3& T : p.estimate) T = A * T;
  EXPECT_LT(Evaluate(p.estimate, p.reference).ate.translation_m, 1e-12);
  EXPECT_LT(Evaluate(p.estimate, p.reference).ate.rotation_deg, 1e-12);
  EvaluateOptions none;
  none.alignment = Alignment::kNone;
  EXPECT_NEAR(Evaluate(p.estimate, p.reference, none).ate.translation_m, AteOf(p, SE3()), 1e-12);
  EXPECT_NEAR(Evaluate(p.estimate, p.reference, none).ate.rotation_deg, kDegrees * A.Angle(), 1e-12);
}

// No small rigid motion (of those allowed) of the aligned estimate lowers its ATE.
TEST(EvaluateTest, AlignmentIsTheBestOne) {
  Pair p = RandomPair(100, 0.5, 0.1, 55);
  PoseRandom random(56);
  const SE3 tilted = testing::RandomPose<SE3>(random, 10);
  const SE3 planar = Lift(SE2(3, -4, 2.5));
  for (const Alignment alignment : {Alignment::kSE3, Alignment::kSE2}) {
    Pair moved = p;
    for (SE3& T : moved.estimate) T = (alignment == Alignment::kSE3 ? tilted : planar) * T;
    EvaluateOptions options;
    options.alignment = alignment;
    const double best = Evaluate(moved.estimate, moved.reference, options).ate.translation_m;
    const SE3 nearly = alignment == Alignment::kSE3 ? tilted.Inverse() : planar.Inverse();
    double lowest = 1e9;
    for (int i = 0; i < 20000; ++i) {
      SE3::Tangent d;
      d << random.NormalVector<3>() * 0.05, random.NormalVector<3>() * 0.002;
      if (alignment == Alignment::kSE2) d[2] = d[3] = d[4] = 0;
      const double ate = AteOf(moved, nearly.Retract(d));
      ASSERT_GE(ate, best * (1 - 1e-12));
      lowest = std::min(lowest, ate);
    }
    EXPECT_LT(lowest, 1.02 * best);  // so the search came near
  }
}

TEST(EvaluateTest, PlanarAlignmentLeavesHeightAndTiltAlone) {
  Pair p = RandomPair(50, 0, 0, 57);
  const SE3 lift(SO3(), Vector<3>(0, 0, 2));
  for (SE3& T : p.estimate) T = lift * T;
  EvaluateOptions options;
  options.alignment = Alignment::kSE2;
  EXPECT_NEAR(Evaluate(p.estimate, p.reference, options).ate.translation_m, 2, 1e-12);
  EXPECT_LT(Evaluate(p.estimate, p.reference).ate.translation_m, 1e-12);
}

// Mirrored points: the best orthogonal matrix is a reflection, the best rotation is not.
TEST(EvaluateTest, AlignmentIsNeverAReflection) {
  Pair p = RandomPair(50, 0, 0, 58);
  PoseRandom random(59);
  for (SE3& T : p.reference) T = SE3(T.Rotation(), 10 * random.NormalVector<3>());
  for (std::size_t i = 0; i < p.estimate.size(); ++i) {
    p.estimate[i] = SE3(p.reference[i].Rotation(), -p.reference[i].Translation());
  }
  EXPECT_GT(Evaluate(p.estimate, p.reference).ate.translation_m, 5);
}

TEST(EvaluateTest, KittiMetricOfAConstantDrift) {
  // A straight drive of 1 m a frame whose estimate is 2 % long: every segment of every length is 2 % off.
  Pair p;
  for (int i = 0; i <= 1000; ++i) {
    p.reference.push_back(SE3(SO3(), Vector<3>(i, 0, 0)));
    p.estimate.push_back(SE3(SO3(), Vector<3>(1.02 * i, 0, 0)));
  }
  EvaluateOptions options;
  options.kitti = true;
  const KittiError kitti = *Evaluate(p.estimate, p.reference, options).kitti;
  // A segment ends at the first frame beyond its length, so it is one frame longer.
  double t_rel = 0;
  long segments = 0;
  for (int first = 0; first <= 1000; first += 10) {
    for (int length = 100; length <= 800 && first + length + 1 <= 1000; length += 100) {
      t_rel += 0.02 * (length + 1) / length;
      ++segments;
    }
  }
  EXPECT_EQ(kitti.segments, segments);
  EXPECT_NEAR(kitti.t_rel_percent, 100 * t_rel / static_cast<double>(segments), 1e-10);
  EXPECT_NEAR(kitti.r_rel_deg_per_100m, 0, 1e-12);
  // Too short for any segment.
  p.reference.resize(90);
  p.estimate.resize(90);
  EXPECT_EQ(Evaluate(p.estimate, p.reference, options).kitti->segments, 0);
  EXPECT_FALSE(Evaluate(p.estimate, p.reference).kitti.has_value());
}

TEST(EvaluateTest, RefusesWhatCannotBeCompared) {
  const std::vector<SE3> one(1), two(2), three(3);
  EXPECT_THROW(Evaluate(two, three), std::invalid_argument);
  EXPECT_THROW(Evaluate(one, one), std::invalid_argument);
  EXPECT_THROW(Evaluate({}, {}), std::invalid_argument);
  EXPECT_EQ(Evaluate(two, two).ate.translation_m, 0);  // all poses at one place: alignment is not unique, but finite
}

Trajectory Stamped(TrajectoryFormat format, const std::vector<double>& stamps) {
  Trajectory out;
  out.format = format;
  out.stamps = stamps;
  for (const double stamp : stamps) out.T_world_body.push_back(SE3(SO3(), Vector<3>(stamp, 0, 0)));
  return out;
}

// The stamps that were matched, from the positions.
std::vector<std::pair<double, double>> Matched(const Trajectory& estimate, const Trajectory& reference) {
  const MatchedTrajectories matched = Match(estimate, reference);
  EXPECT_EQ(matched.T_world_estimate.size(), matched.T_world_reference.size());
  std::vector<std::pair<double, double>> out;
  for (std::size_t i = 0; i < matched.T_world_estimate.size(); ++i) {
    out.emplace_back(matched.T_world_estimate[i].Translation().x(), matched.T_world_reference[i].Translation().x());
  }
  return out;
}
using Stamps = std::vector<std::pair<double, double>>;

TEST(MatchTest, SecondsMatchTheNearestWithinTenMilliseconds) {
  const auto kTum = TrajectoryFormat::kTum;
  const Trajectory estimate = Stamped(kTum, {0.0, 0.1, 0.2, 0.3, 0.4});
  const Trajectory reference = Stamped(kTum, {-1, 0.004, 0.0985, 0.104, 0.22, 0.3, 0.395, 0.405, 9});
  EXPECT_EQ(Matched(estimate, reference), (Stamps{{0, 0.004}, {0.1, 0.0985}, {0.3, 0.3}, {0.4, 0.395}}));
  // No stamp serves twice.
  EXPECT_EQ(Matched(Stamped(kTum, {1, 1.001, 1.002, 2}), Stamped(kTum, {1.002, 2})), (Stamps{{1.002, 1.002}, {2, 2}}));
  EXPECT_THROW(Match(estimate, Stamped(kTum, {5, 6})), std::invalid_argument);
  EXPECT_THROW(Match(estimate, Stamped(kTum, {})), std::invalid_argument);
  EXPECT_THROW(Match(Stamped(kTum, {}), Stamped(kTum, {})), std::invalid_argument);
}

TEST(MatchTest, LineNumbersMatchIds) {
  const auto kitti = Stamped(TrajectoryFormat::kKitti, {0, 1, 2, 3, 4});
  const auto graph = Stamped(TrajectoryFormat::kGraph, {0, 3, 4, 8});
  EXPECT_EQ(Matched(graph, kitti), (Stamps{{0, 0}, {3, 3}, {4, 4}}));
  EXPECT_EQ(Matched(kitti, graph), (Stamps{{0, 0}, {3, 3}, {4, 4}}));
  EXPECT_EQ(Matched(kitti, Stamped(TrajectoryFormat::kKitti, {0, 1})), (Stamps{{0, 0}, {1, 1}}));
  EXPECT_THROW(Match(graph, Stamped(TrajectoryFormat::kGraph, {5, 8})), std::invalid_argument);
  EXPECT_THROW(Match(Stamped(TrajectoryFormat::kKitti, {}), Stamped(TrajectoryFormat::kKitti, {})),
               std::invalid_argument);
}

TEST(MatchTest, SecondsMatchLinesIfThereAreAsMany) {
  const auto kitti = Stamped(TrajectoryFormat::kKitti, {0, 1, 2});
  const auto seconds = Stamped(TrajectoryFormat::kTum, {0.5, 0.6, 0.7});
  EXPECT_EQ(Matched(seconds, kitti), (Stamps{{0.5, 0}, {0.6, 1}, {0.7, 2}}));
  EXPECT_EQ(Matched(kitti, seconds), (Stamps{{0, 0.5}, {1, 0.6}, {2, 0.7}}));
  EXPECT_THROW(Match(kitti, Stamped(TrajectoryFormat::kTum, {0.5, 0.6})), std::invalid_argument);
  // Ids written as stamps.
  EXPECT_EQ(Matched(Stamped(TrajectoryFormat::kTum, {0, 2}), kitti), (Stamps{{0, 0}, {2, 2}}));
}

struct Published {
  const char* file;
  double t_rel_percent, r_rel_deg_per_100m, ate_m;
};

// Published for these very files by other programs; to the digits that were published.
TEST(EvaluateTest, ScoresOfPublishedTrajectories) {
  TERSE_NEEDS(reference, "kitti/poses/00.txt");
  const Trajectory truth = ReadTrajectory(reference);
  for (const Published& published : {Published{"kitti/00_ORB_estimate.txt", 0.70, 0.25, 1.30},
                                     Published{"kitti/00_SPTAM_estimate.txt", 1.49, 0.56, 3.74}}) {
    TERSE_NEEDS(path, published.file);
    const MatchedTrajectories matched = Match(ReadTrajectory(path), truth);
    EvaluateOptions options;
    options.kitti = true;
    const Evaluation out = Evaluate(matched.T_world_estimate, matched.T_world_reference, options);
    EXPECT_EQ(out.poses, 4541);
    EXPECT_NEAR(out.kitti->t_rel_percent, published.t_rel_percent, 0.005) << published.file;
    EXPECT_NEAR(out.kitti->r_rel_deg_per_100m, published.r_rel_deg_per_100m, 0.005) << published.file;
    EXPECT_NEAR(out.ate.translation_m, published.ate_m, 0.005) << published.file;
  }
}

}  // namespace
}  // namespace terse
