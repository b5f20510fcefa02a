// Trajectories and their errors.

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <algorithm>
#include <filesystem>

#include "bindings.h"
#include "names.h"
#include "pickling.h"
#include "state_members.h"
#include "terse/core/evaluate.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

using Path = std::filesystem::path;

struct HeldTrajectory {
  Trajectory trajectory;
  std::vector<double> rows;
};

HeldTrajectory Hold(Trajectory trajectory) {
  std::vector<double> rows = RowsOf(trajectory.T_world_body);
  return {std::move(trajectory), std::move(rows)};
}

// (n, 3), (n, 7) or (n, 4, 4).
std::vector<SE3> SpacePoses(const Array& array, const std::string& what) {
  if (array.ndim() == 2 && array.shape(1) == 3) {
    std::vector<SE3> out;
    for (const SE2& T : PosesFrom<SE2>(array, what)) out.push_back(Lift(T));
    return out;
  }
  return PosesFrom<SE3>(array, what);
}

HeldTrajectory MakeTrajectory(const Array& stamps, const Array& poses) {
  Trajectory out;
  out.T_world_body = SpacePoses(poses, "poses");
  if (stamps.ndim() != 1 || static_cast<std::size_t>(stamps.size()) != out.T_world_body.size()) {
    throw std::invalid_argument("stamps: expected shape (" + std::to_string(out.T_world_body.size()) + ",), got " +
                                ShapeOf(stamps));
  }
  out.stamps.assign(stamps.data(), stamps.data() + stamps.size());
  if (std::adjacent_find(out.stamps.begin(), out.stamps.end(), [](double a, double b) { return !(a < b); }) !=
      out.stamps.end()) {
    throw std::invalid_argument("stamps: expected ascending numbers");
  }
  return Hold(std::move(out));
}

void Write(const HeldTrajectory& held, const Path& path, const std::string& format) {
  const auto as = FromWord<TrajectoryFormat>(format);
  if (as == TrajectoryFormat::kGraph) throw std::invalid_argument("format: expected tum or kitti");
  const py::gil_scoped_release release;
  as == TrajectoryFormat::kTum ? WriteTum(held.trajectory, path.string()) : WriteKitti(held.trajectory, path.string());
}

MatchedTrajectories MatchAny(const py::object& estimate, const py::object& reference) {
  const bool held = py::isinstance<HeldTrajectory>(estimate);
  if (held != py::isinstance<HeldTrajectory>(reference)) {
    throw py::type_error("expected two Trajectory objects, or two arrays of poses");
  }
  if (held) {
    const auto& a = estimate.cast<const HeldTrajectory&>();
    const auto& b = reference.cast<const HeldTrajectory&>();
    return Match(a.trajectory, b.trajectory);
  }
  return {SpacePoses(estimate.cast<Array>(), "estimate"), SpacePoses(reference.cast<Array>(), "reference")};
}

Evaluation EvaluateAny(const py::object& estimate, const py::object& reference, const std::string& alignment,
                       bool kitti, int threads) {
  EvaluateOptions options;
  options.alignment = FromWord<Alignment>(alignment);
  options.kitti = kitti;
  options.threads = threads;
  const MatchedTrajectories matched = MatchAny(estimate, reference);
  const py::gil_scoped_release release;
  return Evaluate(matched.T_world_estimate, matched.T_world_reference, options);
}

std::string ErrorText(const PoseError& error) {
  return SixDigits(error.translation_m) + " m, " + SixDigits(error.rotation_deg) + " deg";
}

void BindEvaluate(py::module_& module) {
  py::class_<PoseError>(module, "PoseError", "Root mean squares over poses.")
      .def_readonly("translation_m", &PoseError::translation_m, "Metres.")
      .def_readonly("rotation_deg", &PoseError::rotation_deg, "Degrees, of the angle.")
      .def("__repr__", [](const PoseError& e) { return "<terse.PoseError: " + ErrorText(e) + ">"; })
      .def(PickleOf<PoseError>("pickle PoseError"));
  py::class_<KittiError>(module, "KittiError", "KITTI's metric over segments of 100 to 800 m.")
      .def_readonly("t_rel_percent", &KittiError::t_rel_percent, "Per cent of the length.")
      .def_readonly("r_rel_deg_per_100m", &KittiError::r_rel_deg_per_100m, "Degrees per 100 m.")
      .def_readonly("segments", &KittiError::segments, "How many segments there were.")
      .def("__repr__",
           [](const KittiError& e) {
             return "<terse.KittiError: " + SixDigits(e.t_rel_percent) + " %, " + SixDigits(e.r_rel_deg_per_100m) +
                    " deg per 100 m, " + Counted(e.segments, "segment") + ">";
           })
      .def(PickleOf<KittiError>("pickle KittiError"));
  py::class_<Evaluation>(module, "Evaluation", "Errors of a trajectory against a reference.")
      .def_readonly("ate", &Evaluation::ate, "PoseError after alignment, pose by pose.")
      .def_readonly("rpe", &Evaluation::rpe, "PoseError from each matched pose to the next.")
      .def_readonly("rpe_all", &Evaluation::rpe_all, "PoseError of every ordered pair of poses.")
      .def_readonly("poses", &Evaluation::poses, "How many poses matched.")
      .def_readonly("kitti", &Evaluation::kitti,
                    "KittiError; None if not asked for, or if the path is shorter than 100 m.")
      .def("__repr__",
           [](const Evaluation& e) {
             return "<terse.Evaluation: " + Counted(e.poses, "pose") + ", ATE " + ErrorText(e.ate) + ">";
           })
      .def(PickleOf<Evaluation>("pickle Evaluation"));
  module.def("evaluate", &EvaluateAny, py::arg("estimate"), py::arg("reference"), py::kw_only(),
             py::arg("alignment") = "se3", py::arg("kitti") = false, py::arg("threads") = 0,
             "Errors of an estimated trajectory: ATE, RPE and, if asked for, KITTI's metric (Evaluation).\n\n"
             "estimate, reference: two Trajectory objects, matched by stamps (pose ids, line numbers or seconds within "
             "10 ms), or two arrays of T_world_body of the same length, row by row: (n, 3), (n, 7) or (n, 4, 4).\n"
             "alignment: 'se3' by least squares over the positions, 'se2' about the z axis only, 'none'.\n"
             "threads: 0 for all cores; the result does not depend on it. ValueError if fewer than two match. Without "
             "the GIL.");
}

}  // namespace

void BindTrajectory(py::module_& module) {
  py::class_<HeldTrajectory>(module, "Trajectory",
                             "One T_world_body per stamp, in space; poses in the plane are lifted to z = 0.")
      .def(py::init(&MakeTrajectory), py::arg("stamps"), py::arg("poses"),
           "stamps: (n,), ascending: seconds, line numbers or pose ids. poses: (n, 3), (n, 7) or (n, 4, 4).")
      .def_property_readonly(
          "stamps",
          [](const py::object& self) {
            const auto& stamps = self.cast<const HeldTrajectory&>().trajectory.stamps;
            return ViewOf(stamps.data(), {static_cast<py::ssize_t>(stamps.size())}, self);
          },
          "(n,). A read-only view of the object's memory, which it keeps alive.")
      .def_property_readonly(
          "poses",
          [](const py::object& self) {
            const auto& rows = self.cast<const HeldTrajectory&>().rows;
            return ViewOf(rows.data(), {static_cast<py::ssize_t>(rows.size() / 7), 7}, self);
          },
          "(n, 7) [x, y, z, qx, qy, qz, qw], metres. A read-only view of the object's memory, which it keeps alive.")
      .def_property_readonly(
          "format", [](const HeldTrajectory& t) { return WordOf(t.trajectory.format); },
          "What the stamps are: 'tum' (seconds), 'kitti' (line numbers) or 'graph' (pose ids).")
      .def("__len__", [](const HeldTrajectory& t) { return t.trajectory.stamps.size(); })
      .def("__repr__",
           [](const HeldTrajectory& t) {
             const auto& stamps = t.trajectory.stamps;
             const std::string range =
                 stamps.empty() ? "" : ", stamps " + SixDigits(stamps.front()) + " to " + SixDigits(stamps.back());
             return "<terse.Trajectory: " + Counted(stamps.size(), "pose") + range + ">";
           })
      .def(PickleOf<HeldTrajectory>(
          "pickle Trajectory", [](const HeldTrajectory& t) -> const Trajectory& { return t.trajectory; }, &Hold));
  module.def(
      "read_trajectory",
      [](const Path& path) {
        const py::gil_scoped_release release;
        return Hold(ReadTrajectory(path.string()));
      },
      py::arg("path"),
      "Reads a trajectory: TUM, KITTI, or the vertices of a graph file, told by the content. FileError. Without the "
      "GIL.");
  module.def(
      "write_trajectory", &Write, py::arg("trajectory"), py::arg("path"), py::kw_only(), py::arg("format") = "tum",
      "Writes a Trajectory; format: 'tum' (stamp x y z qx qy qz qw) or 'kitti' (three rows of the matrix). FileError. "
      "Without the GIL.");
  BindEvaluate(module);
}

}  // namespace terse::python
