// The paths, noises and link rules of the scenes.

#include <algorithm>
#include <stdexcept>

#include "experiments/generate_scene.h"

namespace terse::internal {
namespace {

constexpr double kPi = 3.141592653589793;

// Camera convention: x right, y down, z forward. `up` need not be normal to `forward`.
SE3 LookAlong(const Vector<3>& position, const Vector<3>& forward, const Vector<3>& up) {
  const Vector<3> z = forward.normalized();
  const Vector<3> x = z.cross(up).normalized();
  Matrix<3, 3> R;
  R << x, z.cross(x), z;
  return SE3(SO3::FromMatrix(R), position);
}

std::function<SE3::Tangent(const SE3&)> ConstantSigma(double x_m, double y_m, double z_m, double x_rad, double y_rad,
                                                      double z_rad) {
  SE3::Tangent sigma;
  sigma << x_m, y_m, z_m, x_rad, y_rad, z_rad;
  return [sigma](const SE3&) { return sigma; };
}

// ---- ellipses ----

constexpr double kInnerAxis = 10, kOuterAxis = 20, kMinorAxis = 6;  // m, semi-axes
constexpr double kHeight = 1;                                       // m, amplitude of z
constexpr double kEllipseLength = 72.29;                            // m
constexpr long kEllipsePoses = 170;
constexpr double kEllipseSpacing = kEllipseLength / (kEllipsePoses - 1);

struct CurvePoint {
  Vector<3> position, derivative;  // by the parameter u
};

// u = 0 is the end of the minor axis, which both ellipses share. There the height has slope 0, so that a path
// can change from one ellipse to the other without a kink.
CurvePoint OnEllipse(double major_axis, double u) {
  return {{-major_axis * std::sin(u), kMinorAxis * std::cos(u), kHeight * std::cos(2 * u)},
          {-major_axis * std::cos(u), -kMinorAxis * std::sin(u), -2 * kHeight * std::sin(2 * u)}};
}

// Arc length along a curve, tabulated over u in [0, u_end].
class ArcLength {
 public:
  ArcLength(const std::function<CurvePoint(double)>& curve, double u_end) : step_(u_end / kSteps), lengths_{0} {
    for (int i = 0; i < kSteps; ++i) {  // midpoint rule
      lengths_.push_back(lengths_.back() + step_ * curve((i + 0.5) * step_).derivative.norm());
    }
  }
  double Total() const { return lengths_.back(); }
  // The parameter at a length in [0, Total()]. Rounded coarsely, so that the summed up last bits vanish.
  double At(double length) const {
    const auto above = std::upper_bound(lengths_.begin() + 1, lengths_.end() - 1, length);
    const double u =
        step_ * (static_cast<double>(above - lengths_.begin()) - 1 + (length - above[-1]) / (above[0] - above[-1]));
    return std::round(u * 1e7) / 1e7;
  }

 private:
  static constexpr int kSteps = 20000;
  double step_;
  std::vector<double> lengths_;
};

// 5 % of the motion's length and angle, on each axis (Ila et al. 2017 section 6); the floors keep a zero motion
// uncertain.
SE3::Tangent FivePercent(const SE3& T_from_to) {
  const double sigma_m = std::max(0.05 * T_from_to.Translation().norm(), 0.002);
  const double sigma_rad = std::max(0.05 * T_from_to.Angle(), 0.001);
  SE3::Tangent sigma;
  sigma << Vector<3>::Constant(sigma_m), Vector<3>::Constant(sigma_rad);
  return sigma;
}

ScenePlan<SE3> EllipsePlan(const std::function<CurvePoint(double)>& curve, double u_end, double laps, double length,
                           long poses) {
  const ArcLength arc(curve, u_end);
  ScenePlan<SE3> plan;
  const double total = length > 0 ? length : laps * arc.Total();
  plan.poses = poses != 0 ? poses : std::lround(total / kEllipseSpacing) + 1;
  const double spacing = total / static_cast<double>(plan.poses - 1);
  plan.T_world_body = [curve, arc, spacing](long k) {
    const CurvePoint point = curve(arc.At(std::fmod(static_cast<double>(k) * spacing, arc.Total())));
    return LookAlong(point.position, point.derivative, Vector<3>(0, 0, 1));
  };
  plan.sigma = FivePercent;
  plan.links.radius_m = 3;
  plan.links.max_view_angle_rad = 0.2;
  plan.links.min_gap = 5;
  // Ten laps have 139 at most. Of more a robot would not match them all: those of its map, and those that are new.
  plan.links.max_links = 160;
  plan.links.oldest_links = 80;
  return plan;
}

}  // namespace

// One lap of the inner ellipse, then the outer one for the rest of the length: the lap closes, and for a while
// the path runs beside its own beginning.
ScenePlan<SE3> PlanEllipse(const GenerateOptions& options) {
  const auto curve = [](double u) { return OnEllipse(u < 2 * kPi ? kInnerAxis : kOuterAxis, u); };
  return EllipsePlan(curve, 4 * kPi, 0, kEllipseLength, options.poses);
}

ScenePlan<SE3> PlanEllipseLaps(const GenerateOptions& options) {
  if (options.laps < 1) throw std::invalid_argument("the number of laps must be at least 1");
  return EllipsePlan([](double u) { return OnEllipse(kOuterAxis, u); }, 2 * kPi, options.laps, 0, options.poses);
}

// A spiral from pole to pole; each pose sees the one below it on the previous turn.
ScenePlan<SE3> PlanSphere(const GenerateOptions& options) {
  constexpr double kRadius = 50;  // m
  ScenePlan<SE3> plan;
  plan.poses = options.poses != 0 ? options.poses : 2500;
  const double total = static_cast<double>(plan.poses);
  const long per_slice = std::max(3L, std::lround(std::sqrt(total)));
  plan.T_world_body = [=](long k) {
    const double latitude_rate = kPi / total, longitude_rate = 2 * kPi / static_cast<double>(per_slice);
    const double latitude = -kPi / 2 + latitude_rate * (static_cast<double>(k) + 0.5);
    const double longitude = longitude_rate * static_cast<double>(k % per_slice);
    const Vector<3> east(-std::sin(longitude), std::cos(longitude), 0);
    const Vector<3> outward(std::cos(latitude) * std::cos(longitude), std::cos(latitude) * std::sin(longitude),
                            std::sin(latitude));
    const Vector<3> north = outward.cross(east);
    return LookAlong(kRadius * outward, longitude_rate * std::cos(latitude) * east + latitude_rate * north, outward);
  };
  plan.sigma = ConstantSigma(0.1, 0.1, 0.1, 0.02, 0.02, 0.02);
  plan.links.offsets = {per_slice};
  return plan;
}

// A winding line around a torus; the last winding also meets the first.
ScenePlan<SE3> PlanTorus(const GenerateOptions& options) {
  constexpr double kMajor = 5, kMinor = 2.5;  // m
  ScenePlan<SE3> plan;
  plan.poses = options.poses != 0 ? options.poses : 5000;
  const double total = static_cast<double>(plan.poses);
  const long per_winding = std::max(3L, std::lround(std::sqrt(2 * total)));
  plan.T_world_body = [=](long k) {
    const double around_rate = 2 * kPi / total, winding_rate = 2 * kPi / static_cast<double>(per_winding);
    const double around = around_rate * static_cast<double>(k);
    const double winding = winding_rate * static_cast<double>(k % per_winding);
    const Vector<3> radial(std::cos(around), std::sin(around), 0), tangential(-std::sin(around), std::cos(around), 0);
    const Vector<3> outward = std::cos(winding) * radial + std::sin(winding) * Vector<3>(0, 0, 1);
    const Vector<3> along = -std::sin(winding) * radial + std::cos(winding) * Vector<3>(0, 0, 1);
    const Vector<3> forward =
        around_rate * (kMajor + kMinor * std::cos(winding)) * tangential + winding_rate * kMinor * along;
    return LookAlong(kMajor * radial + kMinor * outward, forward, outward);
  };
  plan.sigma = ConstantSigma(0.1, 0.1, 0.1, 0.05, 0.05, 0.05);
  plan.links.offsets = {per_winding, (plan.poses - 1) / per_winding * per_winding};
  return plan;
}

// A stadium-shaped lane driven six times on each of four levels; the last lap of a level is the ramp to the next.
ScenePlan<SE3> PlanGarage(const GenerateOptions& options) {
  constexpr double kStraight = 100, kRadius = 15, kStep = 4.24, kLevelHeight = 3;  // m
  constexpr double kWander = 0.8, kWanderLength = 37;                              // m, across and along the lane
  constexpr int kLevels = 4, kLapsPerLevel = 6;
  constexpr double kLap = 2 * kStraight + 2 * kPi * kRadius;
  ScenePlan<SE3> plan;
  plan.poses = options.poses != 0 ? options.poses : 1661;
  const double level_length = std::max(kStep * static_cast<double>(plan.poses) / kLevels, kLapsPerLevel * kLap);
  plan.T_world_body = [=](long k) {
    const double s = kStep * static_cast<double>(k);
    const double on_level = std::fmod(s, level_length);
    const double level = std::floor(s / level_length);
    const double climb = std::max(0.0, on_level - (level_length - kLap)) / kLap;
    double z = kLevelHeight * (level + climb), z_rate = climb > 0 ? kLevelHeight / kLap : 0;
    if (level + climb >= kLevels - 1) z = kLevelHeight * (kLevels - 1), z_rate = 0;

    // Two straights and two half circles; the second half of the lap is the first, turned by pi.
    const double on_lap = std::fmod(s, kLap), on_half = std::fmod(on_lap, kLap / 2);
    const double side = on_lap < kLap / 2 ? 1 : -1;
    const double turn = std::max(0.0, on_half - kStraight) / kRadius;
    const Vector<3> tangent = side * Vector<3>(std::cos(turn), std::sin(turn), 0);
    const Vector<3> left(-tangent.y(), tangent.x(), 0);
    const Vector<3> lane =
        side * Vector<3>(std::min(on_half, kStraight) - kStraight / 2, -kRadius, 0) +
        (turn > 0 ? side * kRadius * Vector<3>(std::sin(turn), 1 - std::cos(turn), 0) : Vector<3>(0, 0, 0));
    const double offset = kWander * std::sin(s / kWanderLength);
    const double offset_rate = kWander / kWanderLength * std::cos(s / kWanderLength);
    const double shrink = turn > 0 ? 1 - offset / kRadius : 1;
    return LookAlong(lane + offset * left + Vector<3>(0, 0, z),
                     shrink * tangent + offset_rate * left + Vector<3>(0, 0, z_rate), Vector<3>(0, 0, 1));
  };
  // The vertical is body y: the heading is the rotation that wheels measure well.
  plan.sigma = ConstantSigma(0.03, 0.03, 0.05, 0.005, 0.001, 0.005);
  plan.links.radius_m = 5;
  plan.links.max_view_angle_rad = 0.2;
  plan.links.min_gap = 10;
  plan.links.max_links = 3;
  return plan;
}

// Unit steps on a grid, with a quarter turn now and then, in a square whose area grows with the number of poses, or in
// a rectangle that stays.
ScenePlan<SE2> PlanManhattan(const GenerateOptions& options, Random& random) {
  static constexpr long kDx[] = {1, 0, -1, 0}, kDy[] = {0, 1, 0, -1};
  struct Walker {
    long x = 0, y = 0, heading = 0;  // heading in quarter turns
  };
  ScenePlan<SE2> plan;
  plan.poses = options.poses != 0 ? options.poses : 3500;
  const long half_side = std::max(3L, std::lround(0.35 * std::sqrt(static_cast<double>(plan.poses))));
  std::array<long, 2> low{-half_side, -half_side}, high{half_side, half_side};
  if (options.area_m) {
    for (std::size_t d = 0; d < 2; ++d) {
      const long side = (*options.area_m)[d];
      if (side < 1) throw std::invalid_argument("the sides of the area must be at least 1 m");
      low[d] = -(side / 2);
      high[d] = low[d] + side;
    }
  }
  plan.T_world_body = [walker = Walker(), low, high, &random](long k) mutable {
    if (k > 0) {
      Walker next;
      do {
        const double choice = random.Uniform();
        next.heading = (walker.heading + (choice < 0.25 ? 1 : choice < 0.5 ? 3 : 0)) % 4;
        next.x = walker.x + kDx[next.heading];
        next.y = walker.y + kDy[next.heading];
      } while (next.x < low[0] || next.x > high[0] || next.y < low[1] || next.y > high[1]);
      walker = next;
    }
    return SE2(static_cast<double>(walker.x), static_cast<double>(walker.y),
               static_cast<double>(walker.heading) * kPi / 2);
  };
  plan.sigma = [](const SE2&) { return SE2::Tangent(0.03, 0.03, 0.02); };
  plan.links.radius_m = 1.1;
  plan.links.min_gap = 10;
  plan.links.max_links = 2;
  // A robot that comes back for ever matches against its map.
  if (options.area_m) plan.links.oldest_links = 1;
  return plan;
}

}  // namespace terse::internal
