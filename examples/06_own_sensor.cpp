// An own sensor as the registration: a laser scanner that sees numbered reflectors, simulated. The map asks for few
// registrations, and each answer comes with the covariance that the scans allow.
//
//     06_own_sensor

#include <terse/compact/compact_pose_slam.h>

#include <cmath>
#include <cstdio>
#include <exception>
#include <map>
#include <random>

using namespace terse;

constexpr double kReach = 6, kSigma = 0.03;  // metres: of the scanner, per coordinate of a reflector
using Scan = std::map<int, Vector<2>>;       // number of the reflector -> where it is in the body frame

// T_a_b that lays b's reflectors over a's, in closed form; nullopt if they have too few in common.
std::optional<RelativePoseFactor<SE2>> Register(PoseId id_a, const Scan& a, PoseId id_b, const Scan& b) {
  std::vector<std::pair<Vector<2>, Vector<2>>> pairs;
  for (const auto& [number, p_a] : a) {
    if (const auto found = b.find(number); found != b.end()) pairs.emplace_back(p_a, found->second);
  }
  if (pairs.size() < 4) return std::nullopt;  // this is how a registration gives up
  Vector<2> mean_a = Vector<2>::Zero(), mean_b = Vector<2>::Zero();
  for (const auto& [p_a, p_b] : pairs) {
    mean_a += p_a / double(pairs.size());
    mean_b += p_b / double(pairs.size());
  }
  double sine = 0, cosine = 0;
  for (const auto& [p_a, p_b] : pairs) {
    const Vector<2> u = p_b - mean_b, v = p_a - mean_a;
    sine += u.x() * v.y() - u.y() * v.x();
    cosine += u.dot(v);
  }
  const double theta = std::atan2(sine, cosine);
  const SE2 T_a_b(mean_a - SE2(0, 0, theta) * mean_b, theta);

  // Body frame of b: p_a = T_a_b Exp(d) p_b moves by R [I, (-y, x)] d, and both scans have noise.
  Matrix<3, 3> information = Matrix<3, 3>::Zero();
  for (const auto& [p_a, p_b] : pairs) {
    Matrix<2, 3> J;
    J << 1, 0, -p_b.y(), 0, 1, p_b.x();
    information += J.transpose() * J / (2 * kSigma * kSigma);
  }
  return RelativePoseFactor<SE2>{id_a, id_b, T_a_b, information};
}

int main() try {
  std::mt19937 random(1);
  std::normal_distribution<double> noise;
  std::uniform_real_distribution<double> place(-4, 14);
  std::vector<Vector<2>> reflectors(150);
  for (auto& p_world : reflectors) p_world = {place(random), place(random)};
  const auto scan_at = [&](const SE2& T_world_body) {
    Scan scan;
    for (int k = 0; k < int(reflectors.size()); ++k) {
      const Vector<2> p_body = T_world_body.Inverse() * reflectors[std::size_t(k)];
      if (p_body.norm() < kReach) scan[k] = p_body + kSigma * Vector<2>(noise(random), noise(random));
    }
    return scan;
  };

  CompactOptions<SE2> options;
  Thresholds<SE2>& thresholds = options.thresholds;
  // A registration is worth a try within 4 m, in any direction: the scanner sees all round.
  thresholds.range = {4, 4, M_PI};
  thresholds.link_covariance = Vector<3>(4e-4, 4e-4, 2e-5).asDiagonal();  // what one is expected to tell: 2 cm, 4 mrad
  thresholds.min_loop_gain = 3;  // nats; with 1 nearly every pose and 199 links stay
  thresholds.min_pose_gain = 4;
  CompactPoseSlam<SE2> slam(options);
  std::map<PoseId, Scan> scans;  // of kept poses, and of the one at hand
  int asked = 0;
  const Registration<SE2> registration = [&](PoseId candidate, PoseId current) {
    ++asked;
    return Register(candidate, scans.at(candidate), current, scans.at(current));
  };

  SE2 truth;
  for (int k = 0; k < 200; ++k) {  // five laps of a square of 10 m
    const PoseId id{k};
    std::optional<RelativePoseFactor<SE2>> odometry;  // the first pose has none
    if (k > 0) {
      const SE2 motion(1, 0, k % 10 == 9 ? M_PI / 2 : 0);
      truth = truth * motion;
      const Vector<3> error(0.02 * noise(random), 0.02 * noise(random), 0.005 * noise(random));
      const Matrix<3, 3> information = Vector<3>(2500, 2500, 4e4).asDiagonal();  // 2 cm, 0.005 rad
      odometry = RelativePoseFactor<SE2>{PoseId{k - 1}, id, motion.Retract(error), information};
    }
    scans[id] = scan_at(truth);
    if (!slam.AddPose(id, odometry, registration).Kept()) scans.erase(id);
    if (k % 40 == 39) {
      std::printf("lap %d: %3zu poses kept, %2d links of %3d registrations, %.3f m off\n", k / 40 + 1, scans.size(),
                  slam.LinksKept(), asked, (slam.Estimate(id).Translation() - truth.Translation()).norm());
    }
  }
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
