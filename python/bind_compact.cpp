// Compact pose SLAM.

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <filesystem>

#include "bindings.h"
#include "names.h"
#include "pickling.h"
#include "terse/compact/map_file.h"
#include "terse/compact/state_members.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

using Path = std::filesystem::path;

template <class F>
decltype(auto) Read(const Slam& slam, const F& f) {
  const Lock lock(*slam.guard, Lock::kReading);
  return std::visit([&](const auto& held) -> decltype(auto) { return f(*held); }, slam.slam);
}

template <class Pose>
Slam SlamWith(const CompactOptions<Pose>& options) {
  return Slam{std::make_shared<CompactPoseSlam<Pose>>(options)};
}

Slam MakeSlam(const CompactSettings& settings) {
  return std::visit([](const auto& options) { return SlamWith(options); }, settings.options);
}

Graph MapOf(const Slam& slam) {
  return Read(slam, [](const auto& held) { return Graph(held.Solver().Graph().WithPoses(held.Solver().Estimates())); });
}

// A snapshot: the factor is copied, so that the run can go on.
Marginals MarginalsOf(const Slam& slam) {
  return Read(slam, [](const auto& held) -> Marginals {
    using Pose = std::decay_t<decltype(held.Solver().EstimateAt(0))>;
    auto graph = std::make_shared<const AnyPoseGraph>(held.Solver().Graph());
    const py::gil_scoped_release release;
    auto queries = std::make_shared<const terse::Marginals<Pose>>(
        std::get<PoseGraph<Pose>>(*graph), held.Solver().Estimates(),
        BlockCholesky<Pose::kDof>(held.Solver().Cholesky()), held.Solver().LinearizationPoints());
    return {std::move(queries), std::move(graph)};
  });
}

}  // namespace

Recovered TrajectoryOf(const Slam& slam, const std::string& recovery) {
  const auto how = FromWord<Recovery>(recovery);
  return Read(slam, [&](const auto& held) {
    const auto all = held.Trajectory(how);
    using Pose = std::decay_t<decltype(held.Solver().EstimateAt(0))>;
    std::vector<PoseId> ids;
    std::vector<Pose> poses;
    py::array_t<bool> kept(static_cast<py::ssize_t>(all.size()));
    bool* to = kept.mutable_data();
    for (const auto& pose : all) {
      ids.push_back(pose.id);
      poses.push_back(pose.T_world_body);
      *to++ = pose.kept;
    }
    return Recovered{ArrayOfIds(ids), std::move(kept), ArrayOf(poses)};
  });
}

namespace {

Slam Load(const Path& path) {
  return ForDimension(DimensionOfState(path.string()), [&](auto origin) {
    using Held = CompactPoseSlam<decltype(origin)>;
    const py::gil_scoped_release release;
    return Slam{std::make_shared<Held>(Held::Load(path.string()))};
  });
}

CompactMapFile Export(const Slam& slam, const std::string& recovery) {
  const auto how = FromWord<Recovery>(recovery);
  return Read(slam, [&](const auto& held) {
    const py::gil_scoped_release release;
    return CompactMapFile{held.Export(how), held.Options().strategy, {}};
  });
}

Slam Restore(const CompactMapFile& file, const CompactSettings& settings) {
  return std::visit(
      [&](const auto& map) {
        using Pose = std::decay_t<decltype(map.poses.front().T_world_body)>;
        const auto& options = Expect<CompactOptions<Pose>>(settings.options, "options");
        const py::gil_scoped_release release;
        return Slam{std::make_shared<CompactPoseSlam<Pose>>(CompactPoseSlam<Pose>::Restore(map, options))};
      },
      file.map);
}

using Type = py::class_<Slam>;

void BindCounts(Type& type) {
  type.def_property_readonly(
          "dimension", [](const Slam& s) { return DimensionOf(s.slam); }, "2 or 3.")
      .def_property_readonly(
          "options",
          [](const Slam& s) {
            return Read(
                s, [](const auto& held) { return std::make_shared<CompactSettings>(CompactSettings{held.Options()}); });
          },
          "CompactOptions that it was made with. A copy.")
      .def_property_readonly(
          "poses_seen", [](const Slam& s) { return Read(s, [](const auto& held) { return held.PosesSeen(); }); },
          "Poses added, kept or dropped.")
      .def_property_readonly(
          "poses_kept",
          [](const Slam& s) { return Read(s, [](const auto& held) { return held.Solver().Graph().Poses().size(); }); },
          "Poses in the map.")
      .def_property_readonly(
          "links_kept", [](const Slam& s) { return Read(s, [](const auto& held) { return held.LinksKept(); }); },
          "Links in the map, beside the odometry.")
      .def(
          "undetermined",
          [](const Slam& s) { return Read(s, [](const auto& held) { return held.Solver().DescribeUndetermined(); }); },
          "What the absolute measurements so far leave undetermined of how the map lies, in words, as its heading "
          "after "
          "one position prior; '' if nothing, or if there are none.");
}

void BindEstimates(Type& type) {
  type.def(
          "estimate",
          [](const Slam& s, std::int64_t id, const std::string& recovery) {
            const auto how = FromWord<Recovery>(recovery);
            return Read(s, [&](const auto& held) { return ArrayOf(held.Estimate(PoseId{id}, how)); });
          },
          py::arg("pose_id"), py::arg("recovery") = "v1",
          "T_world_body of any pose seen, (3,) or (7,), kept or dropped. recovery, of a dropped one: as in "
          "trajectory(). "
          "A copy.")
      .def(
          "kept_base",
          [](const Slam& s, std::int64_t id) {
            return Read(s, [&](const auto& held) { return held.KeptBase(PoseId{id}).value; });
          },
          py::arg("pose_id"), "The pose itself if kept, else the kept pose that it hangs on.")
      .def("graph", &MapOf, "The map: kept poses at their estimates and kept links (PoseGraph). A copy.")
      .def("trajectory", &TrajectoryOf, py::arg("recovery") = "v2",
           "All poses in order of arrival (CompactTrajectory). recovery, of dropped ones: 'v0' as estimated when "
           "dropped, "
           "'v1' chained to the kept pose before, 'v2' fitted between the kept poses around.")
      .def("marginals", &MarginalsOf,
           "Covariances of the kept poses as they are now (Marginals): a snapshot, the run can go on. Without the GIL.")
      .def(
          "chi2", [](const Slam& s) { return Read(s, [](const auto& held) { return held.Solver().Chi2(); }); },
          "Sum of r' Omega r over the measurements of the map.");
}

void BindStorage(Type& type) {
  type.def(
          "save",
          [](const Slam& s, const Path& path) {
            Read(s, [&](const auto& held) {
              const py::gil_scoped_release release;
              held.Save(path.string());
            });
          },
          py::arg("path"), "Writes the whole state to a file, whole or not at all. FileError. Without the GIL.")
      .def_static("load", &Load, py::arg("path"),
                  "What was saved; it continues bit for bit as that one would have. FileError. Without the GIL.")
      .def("export", &Export, py::arg("recovery") = "v2",
           "The map as a value (CompactMap), for write_compact_map and restore. recovery, of dropped poses: as in "
           "trajectory(). Without the GIL.")
      .def_static("restore", &Restore, py::arg("map"), py::arg("options"),
                  "A run that continues from a CompactMap, brought to its optimum; options are not part of the map "
                  "(read_thresholds). Factors are numbered anew, in the same order. ValueError if the map contradicts "
                  "itself, NumericalError if its measurements do not hold it. Without the GIL.");
}

void BindCovariances(Type& type) {
  using Text = const std::string&;
  constexpr const char* kConvention =
      "\n\nframe: 'body', of d in T Exp(d), 'world', of e in Exp(e) T, or 'world_axes', of position and rotation along "
      "the world's axes, as ROS has them. order: 'translation_first' or 'rotation_first'. Without the GIL.";
  type.def(
          "covariance",
          [](const Slam& s, std::int64_t id, Text frame, Text order) {
            const CovarianceConvention to{FromWord<CovarianceFrame>(frame), FromWord<TangentOrder>(order)};
            return Read(s, [&](const auto& held) -> py::array {
              return ArrayOfMatrix([&] {
                const py::gil_scoped_release release;
                return held.Covariance(PoseId{id}, to);
              }());
            });
          },
          py::arg("pose_id"), py::kw_only(), py::arg("frame") = "body", py::arg("order") = "translation_first",
          (std::string("(d, d), d = 3 or 6: the covariance of any pose seen, kept or dropped, square metres and square "
                       "radians; of a dropped one where estimate(pose_id, 'v2') is.") +
           kConvention)
              .c_str())
      .def(
          "relative_covariance",
          [](const Slam& s, std::int64_t a, std::int64_t b, Text frame, Text order) {
            const CovarianceConvention to{FromWord<CovarianceFrame>(frame), FromWord<TangentOrder>(order)};
            return Read(s, [&](const auto& held) -> py::array {
              return ArrayOfMatrix([&] {
                const py::gil_scoped_release release;
                return held.RelativeCovariance(PoseId{a}, PoseId{b}, to);
              }());
            });
          },
          py::arg("a"), py::arg("b"), py::kw_only(), py::arg("frame") = "body", py::arg("order") = "translation_first",
          (std::string("(d, d): the covariance of T_a_b = T_world_a^-1 T_world_b, of any two poses seen; 'body' is b's "
                       "frame, 'world' is a's.") +
           kConvention)
              .c_str());
}

}  // namespace

void BindCompact(py::module_& module) {
  py::class_<Recovered>(module, "CompactTrajectory",
                        "All poses of a compact run in order of arrival. The arrays own their memory.")
      .def_readonly("ids", &Recovered::ids, "(n,) int64.")
      .def_readonly("kept", &Recovered::kept, "(n,) bool: whether a pose is in the map.")
      .def_readonly("poses", &Recovered::poses,
                    "(n, 3) [x, y, theta] or (n, 7) [x, y, z, qx, qy, qz, qw]: T_world_body.")
      .def("__len__", [](const Recovered& r) { return py::len(r.ids); })
      .def("__repr__",
           [](const Recovered& r) {
             return "<terse.CompactTrajectory: " + Counted(py::len(r.ids), "pose") + ", " +
                    std::to_string(r.kept.attr("sum")().cast<long>()) + " kept>";
           })
      .def(py::pickle([](const Recovered& r) { return py::make_tuple(r.ids, r.kept, r.poses); },
                      [](const py::tuple& state) {
                        return Recovered{state[0], state[1], state[2]};
                      }));
  Type type(module, "CompactPoseSlam",
            "Keeps the poses and links of a run that carry information; the others come back in trajectory().\n\n"
            "Any thread may call; calls wait for each other, without the GIL.");
  type.def(py::init(&MakeSlam), py::arg("options"), "options: CompactOptions. ValueError if one is out of its domain.");
  BindCompactAdding(type);
  BindCounts(type);
  BindEstimates(type);
  BindStorage(type);
  BindCovariances(type);
  type.def("__repr__",
           [](const Slam& s) {
             return Read(s, [&](const auto& held) {
               return "<terse.CompactPoseSlam: " + DimensionText(DimensionOf(s.slam)) + " " +
                      WordOf(held.Options().strategy) + ", " + std::to_string(held.Solver().Graph().Poses().size()) +
                      " of " + Counted(held.PosesSeen(), "pose") + " kept, " + Counted(held.LinksKept(), "link") + ">";
             });
           })
      .def(py::pickle(
          [](const Slam& s) {
            return Read(s, [&](const auto& held) {
              return py::make_tuple(DimensionOf(s.slam), Pickled("pickle CompactPoseSlam", held));
            });
          },
          [](const py::tuple& state) {
            return ForDimension(state[0].cast<int>(), [&](auto origin) {
              using Held = CompactPoseSlam<decltype(origin)>;
              return Slam{
                  std::make_shared<Held>(Unpickled<Held>("pickle CompactPoseSlam", state[1].cast<py::bytes>()))};
            });
          }));
}

}  // namespace terse::python
