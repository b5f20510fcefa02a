#pragma once
// Seeded points in front of a stereo camera and what two frames measure of them.

#include <vector>

#include "terse/frontend/stereo_motion.h"
#include "testing_poses.h"

namespace terse::testing {

inline const StereoCamera kKittiLike = {707.1, 707.1, 601.9, 183.1, 0.537, 1226, 370};

// A car's motion from one frame to the next: a metre ahead in a slight curve.
inline SE3 CarMotion() { return SE3(SO3::Exp({0.004, 0.03, -0.002}), {0.02, -0.01, 1.1}); }

// Exact matches of points that both frames see, depths 4 to 60 metres.
inline std::vector<StereoMatch> ExactMatches(const StereoCamera& camera, const SE3& T_a_b, int count, PoseRandom& rng) {
  std::vector<StereoMatch> matches;
  const SE3 T_b_a = T_a_b.Inverse();
  while (static_cast<int>(matches.size()) < count) {
    const double z = rng.LogUniform(4, 60);
    const double u = rng.Uniform(0, camera.width), v = rng.Uniform(0, camera.height);
    const Vector<3> p = {(u - camera.cx) * z / camera.fx, (v - camera.cy) * z / camera.fy, z};
    const Vector<3> q = T_b_a * p;
    if (q.z() > 1) matches.push_back({camera.Project(p), camera.Project(q)});
  }
  return matches;
}

inline void AddNoise(std::vector<StereoMatch>& matches, double sigma, PoseRandom& rng) {
  for (StereoMatch& match : matches) {
    match.a += sigma * rng.NormalVector<3>();
    match.b += sigma * rng.NormalVector<3>();
  }
}

}  // namespace terse::testing
