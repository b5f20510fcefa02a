// Compact maps and thresholds as files: what a run of the command leaves and takes up again.

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <filesystem>

#include "bindings.h"
#include "names.h"
#include "pickling.h"
#include "state_members.h"
#include "terse/compact/map_file.h"
#include "terse/compact/thresholds_file.h"
#include "values.h"

namespace terse::python {
namespace {

using Path = std::filesystem::path;
using Map = CompactMapFile;
using Factors = std::pair<double, double>;

template <class F>
decltype(auto) VisitMap(const Map& map, const F& f) {
  return std::visit(f, map.map);
}

std::size_t CountKept(const Map& map) {
  return VisitMap(map, [](const auto& m) {
    std::size_t kept = 0;
    for (const auto& pose : m.poses) kept += pose.kept;
    return kept;
  });
}

std::size_t CountLinks(const Map& map) {
  return VisitMap(map, [](const auto& m) {
    std::size_t links = 0;
    for (const auto& edge : m.edges) links += edge.is_loop;
    return links;
  });
}

py::object IdsOfMap(const Map& map) {
  return VisitMap(map, [](const auto& m) -> py::object {
    std::vector<PoseId> ids;
    for (const auto& pose : m.poses) ids.push_back(pose.id);
    return ArrayOfIds(ids);
  });
}

py::object KeptOfMap(const Map& map) {
  return VisitMap(map, [](const auto& m) -> py::object {
    py::array_t<bool> kept(static_cast<py::ssize_t>(m.poses.size()));
    bool* to = kept.mutable_data();
    for (const auto& pose : m.poses) *to++ = pose.kept;
    return std::move(kept);
  });
}

py::object PosesOfMap(const Map& map) {
  return VisitMap(map, [](const auto& m) -> py::object {
    std::vector<std::decay_t<decltype(m.poses.front().T_world_body)>> poses;
    for (const auto& pose : m.poses) poses.push_back(pose.T_world_body);
    return ArrayOf(poses);
  });
}

void SetScale(KindScale& scale, const Factors& to) {
  if (!(to.first > 0 && to.second > 0 && std::isfinite(to.first) && std::isfinite(to.second)))
    throw std::invalid_argument("scale: expected two factors above zero, (translation, rotation)");
  scale = {to.first, to.second};
}

Graph Scaled(const Map& map, const Graph& graph) {
  const auto shared = graph.Share();
  const py::gil_scoped_release release;
  return std::visit([&](const auto& g) { return Graph(ScaleInformation(g, map.information_scale)); }, *shared);
}

void Write(const Map& map, const Path& path) {
  if (!map.strategy) throw std::invalid_argument("strategy: None, expected that of the run");
  const py::gil_scoped_release release;
  VisitMap(map, [&](const auto& m) { WriteCompactMap(m, *map.strategy, path.string(), map.information_scale); });
}

std::shared_ptr<CompactSettings> ReadOptions(const Path& path, const py::kwargs& keywords) {
  auto settings = ForDimension(ReadThresholdsDimension(path.string()), [&](auto origin) {
    CompactOptions<decltype(origin)> options;
    options.thresholds = ReadThresholds<decltype(origin)>(path.string());
    return std::make_shared<CompactSettings>(CompactSettings{options});
  });
  SetAttributes(py::cast(settings), keywords);
  return settings;
}

void BindMap(py::module_& module) {
  py::class_<Map, std::shared_ptr<Map>>(
      module, "CompactMap",
      "A compact map as a value: what CompactPoseSlam.export gives and restore takes, graph.json as a file.")
      .def_property_readonly(
          "dimension", [](const Map& m) { return DimensionOf(m.map); }, "2 or 3.")
      .def_property_readonly("ids", &IdsOfMap, "(n,) int64: all poses seen, in order of arrival. A copy.")
      .def_property_readonly("kept", &KeptOfMap, "(n,) bool: whether a pose is in the map. A copy.")
      .def_property_readonly("poses", &PosesOfMap,
                             "(n, 3) or (n, 7): T_world_body of all poses seen, dropped ones recovered. A copy.")
      .def_property_readonly("poses_kept", &CountKept, "Poses in the map.")
      .def_property_readonly("links_kept", &CountLinks, "Links in the map, beside the odometry.")
      .def_property(
          "strategy",
          [](const Map& m) { return m.strategy ? std::optional(std::string(WordOf(*m.strategy))) : std::nullopt; },
          [](Map& m, const std::string& word) { m.strategy = FromWord<Strategy>(word); },
          "Of the run that made it; None if its file does not say.")
      .def_property(
          "odometry_scale",
          [](const Map& m) {
            return Factors(m.information_scale.odometry.translation, m.information_scale.odometry.rotation);
          },
          [](Map& m, const Factors& to) { SetScale(m.information_scale.odometry, to); },
          "By which the standard deviations of odometry, (translation, rotation), differ from those of the input. "
          "Ones if they do not.")
      .def_property(
          "loop_scale",
          [](const Map& m) {
            return Factors(m.information_scale.loops.translation, m.information_scale.loops.rotation);
          },
          [](Map& m, const Factors& to) { SetScale(m.information_scale.loops, to); }, "The same of loops.")
      .def("scaled", &Scaled, py::arg("graph"),
           "A PoseGraph with the information of its relative measurements scaled as that of the map was: what comes "
           "later is to be scaled likewise. Without the GIL.")
      .def(PickleOf<Map>("pickle CompactMap"))
      .def("__len__", [](const Map& m) { return VisitMap(m, [](const auto& map) { return map.poses.size(); }); })
      .def("__repr__", [](const Map& m) {
        const std::size_t seen = VisitMap(m, [](const auto& map) { return map.poses.size(); });
        return "<terse.CompactMap: " + std::to_string(DimensionOf(m.map)) + "D, " + std::to_string(CountKept(m)) +
               " of " + std::to_string(seen) + " poses kept, " + std::to_string(CountLinks(m)) + " links>";
      });
}

}  // namespace

void BindMapFile(py::module_& module) {
  BindMap(module);
  module.def(
      "read_compact_map",
      [](const Path& path) {
        const py::gil_scoped_release release;
        return std::make_shared<Map>(ReadCompactMap(path.string()));
      },
      py::arg("path"),
      "A CompactMap from a file like graph.json of a run's folder; CompactPoseSlam.restore continues it. FileError, "
      "also "
      "for a map that contradicts itself. Without the GIL.");
  module.def("write_compact_map", &Write, py::arg("map"), py::arg("path"),
             "Writes a CompactMap to a file, whole or not at all: as graph.json beside a thresholds.json, the command "
             "compact continues it. Numbers read back to the last bit. FileError; NumericalError if an estimate is not "
             "finite. Without the GIL.");
  module.def(
      "read_thresholds", &ReadOptions, py::arg("path"),
      "CompactOptions with the thresholds in a file like thresholds.json of a run's folder; any of its attributes "
      "can be given by keyword. FileError.");
  module.def(
      "write_thresholds",
      [](const CompactSettings& settings, const Path& path) {
        std::visit([&](const auto& options) { WriteThresholds(options.thresholds, path.string()); }, settings.options);
      },
      py::arg("options"), py::arg("path"),
      "Writes range, probability, gains and link_covariance of CompactOptions to a file, whole or not at all. "
      "FileError.");
}

}  // namespace terse::python
