// TUM and KITTI trajectories, and graphs taken as such; what was read is written in both formats, read again to an
// equal one, and compared with itself.

#include <algorithm>

#include "fuzzing.h"
#include "terse/core/evaluate.h"
#include "terse/core/trajectory.h"

namespace terse::fuzz {
namespace {

void ExpectEqual(const Trajectory& a, const Trajectory& b, double tolerance) {
  Expect(a.T_world_body.size() == b.T_world_body.size(), "as many poses");
  for (std::size_t k = 0; k < a.T_world_body.size(); ++k) {
    const SE3 &x = a.T_world_body[k], &y = b.T_world_body[k];
    Expect(x.Translation() == y.Translation(), "the same positions");
    const Matrix<3, 3> difference = x.Rotation().Rotation() - y.Rotation().Rotation();
    Expect(difference.cwiseAbs().maxCoeff() <= tolerance, "the same rotations");
  }
}

}  // namespace
}  // namespace terse::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace terse;
  static fuzz::InputFile file;
  static fuzz::ScratchFolder folder;
  const std::string& path = file.With(fuzz::AsText(data, size));
  Trajectory trajectory;
  if (!fuzz::Done([&] { trajectory = ReadTrajectory(path); })) return 0;
  fuzz::Done([&] {
    const MatchedTrajectories matched = Match(trajectory, trajectory);
    EvaluateOptions options;
    options.kitti = true;
    options.threads = 1;
    Evaluate(matched.T_world_estimate, matched.T_world_reference, options);
  });
  if ((data[size / 2] ^ size) % 8 != 0) return 0;
  const std::string tum = folder.Path("again.tum"), kitti = folder.Path("again.kitti");
  WriteTum(trajectory, tum);
  const Trajectory again = ReadTrajectory(tum);
  fuzz::Expect(again.stamps == trajectory.stamps, "the same stamps");
  fuzz::ExpectEqual(trajectory, again, 1e-12);
  WriteKitti(trajectory, kitti);
  fuzz::ExpectEqual(trajectory, ReadTrajectory(kitti), 1e-12);
  return 0;
}
