// A robot's loop: one pose at a time, an own registration, a wrong link taken out again, the state saved and resumed.
//
//     05_online_loop [STATE]      default: no state is saved

#include <terse/compact/compact_pose_slam.h>

#include <cmath>
#include <cstdio>
#include <exception>
#include <random>

using namespace terse;

// The world, which only the sensors see: a square of 10 m, 40 steps a lap.
SE2 TrueMotion(int k) { return SE2(1, 0, k % 10 == 9 ? M_PI / 2 : 0); }

int main(int argc, char** argv) try {
  std::mt19937 random(1);
  std::normal_distribution<double> noise;
  // Zero-mean with the covariance that the factors state: 5 cm and 0.01 rad.
  const Matrix<3, 3> covariance = Vector<3>(0.05 * 0.05, 0.05 * 0.05, 0.01 * 0.01).asDiagonal();
  const Matrix<3, 3> information = Vector<3>(400, 400, 1e4).asDiagonal();
  const auto measure = [&](PoseId from, PoseId to, const SE2& T_from_to) {
    const Vector<3> error(0.05 * noise(random), 0.05 * noise(random), 0.01 * noise(random));
    return RelativePoseFactor<SE2>{from, to, T_from_to.Retract(error), information};
  };

  CompactOptions<SE2> options;
  options.thresholds.range = {3, 3, 0.5};  // the registration reaches 3 m and half a radian
  options.thresholds.link_covariance = covariance;
  CompactPoseSlam<SE2> slam(options);

  std::vector<SE2> truth = {SE2()};
  // Called for the few candidates that are worth it. A real one would match scans or images, and give up at times.
  const auto registration = [&](PoseId candidate, PoseId current) -> std::optional<RelativePoseFactor<SE2>> {
    const SE2 T = truth[std::size_t(candidate.value)].Inverse() * truth[std::size_t(current.value)];
    if (T.Translation().norm() > 3) return std::nullopt;
    return measure(candidate, current, T);
  };

  std::optional<FactorId> last_link;
  for (int k = 0; k < 200; ++k) {
    std::optional<RelativePoseFactor<SE2>> odometry;  // the first pose has none
    if (k > 0) {
      truth.push_back(truth.back() * TrueMotion(k));
      odometry = measure(PoseId{k - 1}, PoseId{k}, TrueMotion(k));
    }
    const Decision decision = slam.AddPose(PoseId{k}, odometry, registration);
    for (const Candidate& candidate : decision.candidates) {
      if (candidate.accepted) last_link = candidate.factor;
    }
    if (k % 40 == 39) {  // where is the robot now?
      const SE2 T = slam.Estimate(PoseId{k});
      // The root mean square error to expect.
      const double known = std::sqrt(slam.Covariance(PoseId{k}).topLeftCorner<2, 2>().trace());
      std::printf("lap %d: %3zu poses kept, %2d links, %.3f m off, known to %.3f m\n", k / 40 + 1,
                  slam.Solver().Graph().Poses().size(), slam.LinksKept(),
                  (T.Translation() - truth.back().Translation()).norm(), known);
    }
  }

  if (last_link) slam.RemoveLink(*last_link);  // say it was found to be wrong
  slam.Finish();
  std::printf("without the last link: %d links\n", slam.LinksKept());
  if (argc > 1) {
    slam.Save(argv[1]);
    std::printf("resumed with %d poses seen\n", CompactPoseSlam<SE2>::Load(argv[1]).PosesSeen());
  }
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
