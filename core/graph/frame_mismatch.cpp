#include "terse/core/frame_mismatch.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <locale>
#include <sstream>

#include "terse/core/decompositions.h"

namespace terse {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr std::size_t kFewestPoses = 10;
constexpr double kLeastBreadth = 0.05;  // of the positions' length: on a line rotations about it are not determined
// What is left of an error that is explained, as a share of it; and deviations that no estimate has by drift alone.
constexpr double kExplained = 0.5, kLeastScale = 1.05;
constexpr double kLeastWorldAngle = kPi / 6, kLeastBodyAngle = kPi / 9;

using Rotation = Matrix<3, 3>;

// The orthogonal matrix R, of determinant `sign`, that maximises trace(R^T C), and that maximum.
struct Fit {
  Rotation R;
  double trace;
};
Fit BestFit(const Rotation& C, double sign) {
  const Rotation R = SingularValues<3>(C).ClosestOrthogonal(sign);
  return {R, (R.transpose() * C).trace()};
}

// Second moments of centred positions.
class Moments {
 public:
  Moments(const std::vector<SE3>& estimate, const std::vector<SE3>& reference)
      : count_(static_cast<double>(estimate.size())) {
    Vector<3> mean_e = Vector<3>::Zero(), mean_r = Vector<3>::Zero();
    for (const SE3& T : estimate) mean_e += T.Translation() / count_;
    for (const SE3& T : reference) mean_r += T.Translation() / count_;
    for (std::size_t i = 0; i < estimate.size(); ++i) {
      const Vector<3> e = estimate[i].Translation() - mean_e, r = reference[i].Translation() - mean_r;
      ee_ += e.squaredNorm();
      rr_ += r.squaredNorm();
      C += r * e.transpose();
      spread_ += r * r.transpose();
    }
  }

  // Root mean squares of what a fit leaves, without and with a scale.
  double Rigid(const Fit& fit) const { return Root(ee_ + rr_ - 2 * fit.trace); }
  double Similar(const Fit& fit) const { return Root(rr_ - fit.trace * fit.trace / ee_); }
  double Scale(const Fit& fit) const { return fit.trace / ee_; }
  bool IsBroad() const {
    const Vector<3> squares = SymmetricEigenvalues<3>(spread_);
    return ee_ > 0 && squares[1] > kLeastBreadth * kLeastBreadth * squares[2];
  }
  double Extent() const { return Root(rr_); }

  Rotation C = Rotation::Zero();  // sum of reference * estimate^T

 private:
  double Root(double sum) const { return std::sqrt(std::max(0.0, sum) / count_); }
  double count_, ee_ = 0, rr_ = 0;
  Rotation spread_ = Rotation::Zero();
};

bool IsScale(double scale) { return scale > 0 && std::abs(std::log(scale)) > std::log(kLeastScale); }

// Sets what explains the positions.
void ExplainPositions(const Moments& moments, const Fit& proper, Alignment alignment, FrameMismatch* out) {
  out->fitted_m = out->ate_m;
  const double rigid = moments.Rigid(proper);
  if (alignment != Alignment::kSE3 && rigid < kExplained * out->ate_m) {
    const SO3 R = SO3::FromMatrix(proper.R);
    const double turned =
        alignment == Alignment::kNone ? R.Log().norm() : std::acos(std::clamp(proper.R(2, 2), -1.0, 1.0));
    if (turned > kLeastWorldAngle) out->R_world = R;
  }
  if (alignment == Alignment::kSE3 || out->R_world) out->fitted_m = rigid;
  double left = rigid;
  const auto explain = [&](const Fit& fit, bool scaled, bool mirrored) {
    const double rest = scaled ? moments.Similar(fit) : moments.Rigid(fit);
    if (!(rest < kExplained * left) || (scaled && !IsScale(moments.Scale(fit)))) return;
    left = out->fitted_m = rest;
    out->mirrored = mirrored;
    if (scaled) out->scale = moments.Scale(fit);
  };
  // What is simpler goes first.
  const Fit improper = BestFit(moments.C, -1);
  explain(proper, true, false);
  if (!out->scale) explain(improper, false, true);
  explain(improper, true, true);
}

// The rotation between the bodies, where it is large and all poses have it.
std::optional<SO3> FindBodyRotation(const std::vector<SE3>& estimate, const std::vector<SE3>& reference,
                                    const SO3& R_reference_estimate) {
  std::vector<SO3> between;
  Rotation sum = Rotation::Zero();
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    between.push_back((R_reference_estimate * estimate[i].Rotation()).Inverse() * reference[i].Rotation());
    sum += between.back().Rotation();
  }
  const SO3 mean = SO3::FromMatrix(BestFit(sum, 1).R);
  double before = 0, after = 0;
  for (const SO3& R : between) {
    before += R.Log().squaredNorm();
    after += (mean.Inverse() * R).Log().squaredNorm();
  }
  const bool is_large = mean.Log().norm() > kLeastBodyAngle;
  return is_large && after < kExplained * kExplained * before ? std::optional<SO3>(mean) : std::nullopt;
}

std::string Short(double value) {
  std::ostringstream out;
  out.imbue(std::locale::classic());
  out.precision(3);
  out << value;
  return out.str();
}

// "-y -z x": what the axes x y z become, where each becomes nearly one axis; else empty.
std::string AxesAfter(const SO3& R) {
  const Rotation matrix = R.Rotation();
  std::string out;
  for (int column = 0; column < 3; ++column) {
    Eigen::Index row = 0;
    if (matrix.col(column).cwiseAbs().maxCoeff(&row) < 0.9) return "";
    out += (column > 0 ? " " : "") + std::string(matrix(row, column) < 0 ? "-" : "") + "xyz"[row];
  }
  return out;
}

std::string Degrees(const SO3& R) { return Short(180 / kPi * R.Log().norm()); }

}  // namespace

std::optional<FrameMismatch> FindFrameMismatch(const std::vector<SE3>& T_world_estimate,
                                               const std::vector<SE3>& T_world_reference, Alignment alignment) {
  if (T_world_estimate.size() < kFewestPoses) return std::nullopt;
  const Moments moments(T_world_estimate, T_world_reference);
  if (!moments.IsBroad()) return std::nullopt;
  FrameMismatch out;
  out.ate_m = AbsoluteError(T_world_estimate, T_world_reference, alignment);
  const Fit proper = BestFit(moments.C, 1);
  // Rounding is no error to explain.
  if (out.ate_m > 1e-6 * moments.Extent()) ExplainPositions(moments, proper, alignment, &out);
  // Orientations can be compared where the positions of the two fit each other.
  if (!out.mirrored && moments.Similar(proper) < 0.3 * moments.Extent()) {
    out.R_body = FindBodyRotation(T_world_estimate, T_world_reference, SO3::FromMatrix(proper.R));
  }
  const bool is_any = out.scale || out.mirrored || out.R_world || out.R_body;
  return is_any ? std::optional<FrameMismatch>(out) : std::nullopt;
}

std::string Describe(const FrameMismatch& mismatch) {
  std::string found;
  const auto add = [&](const std::string& text) { found += (found.empty() ? "" : "; ") + text; };
  if (mismatch.scale) add("lengths of the reference are " + Short(*mismatch.scale) + " times those of the estimate");
  if (mismatch.mirrored) add("one is the mirror image of the other");
  if (mismatch.R_world) {
    const std::string axes = AxesAfter(*mismatch.R_world);
    add("the worlds are turned by " + Degrees(*mismatch.R_world) + " degrees" +
        (axes.empty() ? "" : " (x y z of the estimate are " + axes + " of the reference)") + ", see --align se3");
  }
  if (mismatch.R_body) {
    const std::string axes = AxesAfter(*mismatch.R_body);
    add("the bodies are turned by the same " + Degrees(*mismatch.R_body) + " degrees at all poses" +
        (axes.empty() ? "" : " (x y z of the reference's body are " + axes + " of the estimate's)"));
  }
  std::string effect;
  if (mismatch.fitted_m < mismatch.ate_m) {
    effect =
        "; with that the ATE would be " + Short(mismatch.fitted_m) + " m instead of " + Short(mismatch.ate_m) + " m";
  }
  return "these look like data of different frames: " + found + effect;
}

}  // namespace terse
