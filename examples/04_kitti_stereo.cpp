// A stereo sequence in KITTI's layout to a compact map.
//
//     04_kitti_stereo SEQUENCE [TRAJECTORY.txt]      e.g. a folder made by `terse generate stereo`

#include <terse/core/graph_file.h>
#include <terse/core/trajectory.h>
#include <terse/frontend/kitti_sequence.h>
#include <terse/frontend/stereo_slam.h>

#include <cstdio>
#include <exception>

using namespace terse;

int main(int argc, char** argv) try {
  if (argc < 2) {
    std::fprintf(stderr, "usage: 04_kitti_stereo SEQUENCE [TRAJECTORY.txt]\n");
    return 2;
  }
  const KittiSequence sequence(argv[1]);  // what is missing or wrong is an exception that names the file
  const StereoSlamOptions options;        // for a vehicle at ten frames a second
  StereoSlam slam(sequence.Camera(), options);

  auto frames = sequence.Frames(0, sequence.Size());  // decoded ahead on a second thread
  int verified = 0;
  while (const auto frame = frames.Next()) {
    const StereoSlamStep step = slam.AddFrame(*frame);
    if (step.odometry.status == TrackingStatus::kLost) {
      std::printf("frame %d: lost, %s\n", frame->index, step.odometry.reason.c_str());
    }
    for (const LoopAttempt& attempt : step.attempts) {
      if (!attempt.verification.Verified()) continue;
      ++verified;
      std::printf("frame %d sees the place of frame %ld: %d points agree\n", frame->index,
                  static_cast<long>(attempt.candidate.value), attempt.verification.inliers);
    }
  }
  slam.Finish();
  const auto& map = slam.Map();
  std::printf("%d frames: %zu poses kept, %d loops verified, %d links kept\n", map.PosesSeen(),
              map.Solver().Graph().Poses().size(), verified, map.LinksKept());

  if (argc > 2) {
    Trajectory trajectory;
    for (const auto& pose : map.Trajectory()) {  // the dropped ones too
      trajectory.stamps.push_back(sequence.Time(static_cast<int>(pose.id.value)));
      trajectory.T_world_body.push_back(pose.T_world_body);
    }
    WriteKitti(trajectory, argv[2]);
    std::printf("wrote %s\n", argv[2]);
  }
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
