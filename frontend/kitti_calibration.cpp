#include "terse/frontend/kitti_calibration.h"

#include <cmath>
#include <optional>

#include "terse/core/atomic_file.h"
#include "terse/core/number_text.h"
#include "terse/core/text_lines.h"

namespace terse {
namespace {

struct Projection {
  long line = 0;
  double fx = 0, fy = 0, cx = 0, cy = 0;  // pixels
  Vector<3> t_camera_camera0;             // metres
};

Projection ParseProjection(const Fields& fields) {
  if (fields.Count() != 13) {
    throw fields.Error("expected 12 numbers after " + Quoted(fields.Text(0)) + ", found " +
                       std::to_string(fields.Count() - 1));
  }
  const auto at = [&](int row, int column) { return fields.Number(1 + 4 * row + column, "of the projection"); };
  Projection p = {fields.LineNumber(), at(0, 0), at(1, 1), at(0, 2), at(1, 2), {}};
  const bool pinhole =
      at(0, 1) == 0 && at(1, 0) == 0 && at(2, 0) == 0 && at(2, 1) == 0 && at(2, 2) == 1 && p.fx > 0 && p.fy > 0;
  if (!pinhole) throw fields.Error("this is not the projection of a rectified camera, [fx 0 cx; 0 fy cy; 0 0 1 | t]");
  const double z = at(2, 3);
  p.t_camera_camera0 = {(at(0, 3) - p.cx * z) / p.fx, (at(1, 3) - p.cy * z) / p.fy, z};
  return p;
}

bool Near(double a, double b) { return std::abs(a - b) <= 1e-6 * std::abs(a); }

}  // namespace

KittiCalibration ReadKittiCalibration(const std::string& path, KittiPair pair) {
  const std::string left_name = pair == KittiPair::kGrey ? "P0" : "P2";
  const std::string right_name = pair == KittiPair::kGrey ? "P1" : "P3";
  const TextFile file(path);
  std::optional<Projection> left, right;
  Fields fields(path);
  for (const TextLine& line : file.Lines()) {
    fields.Split(line);
    std::string_view name = fields.Text(0);
    if (!name.empty() && name.back() == ':') name.remove_suffix(1);
    if (name == left_name) left = ParseProjection(fields);
    if (name == right_name) right = ParseProjection(fields);
  }
  for (const auto& [projection, name] : {std::pair(&left, &left_name), std::pair(&right, &right_name)}) {
    if (!*projection)
      throw FileError(path, 0, "no line " + *name + ": with the projection of a camera, expected 12 numbers");
  }
  const auto fail = [&](const std::string& cause) { throw FileError(path, right->line, cause); };
  if (!Near(left->fx, right->fx) || !Near(left->fy, right->fy)) {
    fail(right_name + " has the focal length " + SixDigits(right->fx) + ", " + left_name + " " + SixDigits(left->fx) +
         "; the images of a rectified pair have the same");
  }
  if (!Near(left->cx, right->cx) || !Near(left->cy, right->cy)) {
    fail(right_name + " has another principal point than " + left_name + "; a rectified pair has the same");
  }
  const double baseline = left->t_camera_camera0.x() - right->t_camera_camera0.x();
  if (!(baseline > 0)) {
    fail("the baseline from " + left_name + " to " + right_name + " is " + SixDigits(baseline) +
         " m; the right camera must be on the right");
  }
  KittiCalibration out;
  out.camera = {left->fx, left->fy, left->cx, left->cy, baseline, 0, 0};
  out.T_camera0_left = SE3(SO3(), -left->t_camera_camera0);
  return out;
}

void WriteKittiCalibration(const StereoCamera& camera, const std::string& path) {
  AtomicFile file(path);
  for (int k = 0; k < 2; ++k) {
    const double offset = k == 0 ? 0.0 : -camera.fx * camera.baseline;
    file.Stream() << 'P' << k << ": " << Shortest(camera.fx) << " 0 " << Shortest(camera.cx) << ' ' << Shortest(offset)
                  << " 0 " << Shortest(camera.fy) << ' ' << Shortest(camera.cy) << " 0 0 0 1 0\n";
  }
  file.Commit();
}

}  // namespace terse
