// Graph files.

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <filesystem>

#include "bindings.h"
#include "names.h"
#include "pickling.h"
#include "state_members.h"
#include "terse/covariance/packing.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

using Path = std::filesystem::path;

struct ReadFile {
  Graph graph;
  GraphFile facts;  // without its graph
};

ReadFile ReadGraphFile(const Path& path, const std::string& rotation_information, bool repair_information) {
  ReadOptions options;
  options.rotation_information = FromWord<RotationInformation>(rotation_information);
  options.repair_information = repair_information;
  GraphFile file = [&] {
    const py::gil_scoped_release release;
    return ReadGraph(path.string(), options);
  }();
  const std::string skipped = DescribeSkippedTags(file);
  const std::string warning = path.string() + ": lines with tags that are not known here were skipped: " + skipped;
  // Where warnings are errors this one is raised.
  if (!skipped.empty() && PyErr_WarnEx(PyExc_UserWarning, warning.c_str(), 1) != 0) throw py::error_already_set();
  Graph graph(std::move(file.graph));
  return {std::move(graph), std::move(file)};
}

void Write(const Graph& graph, const Path& path, const std::string& format, const std::string& rotation_information) {
  const auto rotation = FromWord<RotationInformation>(rotation_information);
  if (format != "g2o" && format != "toro" && format != "packed")
    throw std::invalid_argument("format: expected g2o, toro or packed, got '" + format + "'");
  const auto shared = graph.Share();
  const py::gil_scoped_release release;
  std::visit(
      [&](const auto& g) {
        if (format == "g2o") {
          WriteG2o(g, path.string(), rotation);
        } else if (format == "toro") {
          WriteToro(g, path.string());
        } else {
          WritePacked(g, path.string(), ChoosePacking(g));
        }
      },
      *shared);
}

}  // namespace

void BindFiles(py::module_& module) {
  py::class_<ReadFile>(module, "GraphFile", "A graph with what its file was like.")
      .def_readonly("graph", &ReadFile::graph, "The PoseGraph.")
      .def_property_readonly(
          "format", [](const ReadFile& f) { return Name(f.facts.format); }, "g2o, TORO, iSAM or packed.")
      .def_property_readonly(
          "skipped_tags", [](const ReadFile& f) { return f.facts.skipped_tags; },
          "Lines that were skipped, by tag: parameters and tags that are not known; FIX: how many ids of such "
          "vertices.")
      .def_property_readonly(
          "repaired_informations", [](const ReadFile& f) { return f.facts.repaired_informations; },
          "How many information matrices were not positive definite.")
      .def("__repr__",
           [](const ReadFile& f) {
             return std::string("<terse.GraphFile: ") + Name(f.facts.format) + ", " +
                    DimensionText(f.graph.Dimension()) + ", " +
                    std::visit([](auto& g) { return Counted(g.Poses().size(), "pose"); }, f.graph.Get()) + ">";
           })
      .def(PickleOf<ReadFile>(
          "pickle GraphFile",
          [](const ReadFile& f) {
            return GraphFile{f.graph.Get(), f.facts.format, f.facts.skipped_tags, f.facts.repaired_informations};
          },
          [](GraphFile file) {
            Graph graph(std::move(file.graph));
            return ReadFile{std::move(graph), std::move(file)};
          }));
  module.def("read_graph_file", &ReadGraphFile, py::arg("path"), py::kw_only(),
             py::arg("rotation_information") = "quaternion", py::arg("repair_information") = false,
             "As read_graph, with what the file was like (GraphFile).");
  module.def(
      "read_graph",
      [](const Path& path, const std::string& rotation_information, bool repair_information) {
        return ReadGraphFile(path, rotation_information, repair_information).graph;
      },
      py::arg("path"), py::kw_only(), py::arg("rotation_information") = "quaternion",
      py::arg("repair_information") = false,
      "Reads a graph file: g2o in 2D and 3D, TORO or iSAM, told by its content.\n\n"
      "rotation_information: what the rotation part of EDGE_SE3:QUAT information means, of the quaternion's vector "
      "part "
      "('quaternion', g2o's definition) or of the rotation vector ('radians', as GTSAM and Ceres read it).\n"
      "repair_information: clamp the eigenvalues of matrices that are not positive definite instead of refusing them.\n"
      "FileError with path, line and cause for anything wrong; a UserWarning where lines with tags that are not known "
      "were skipped. Without the GIL.");
  module.def(
      "write_graph", &Write, py::arg("graph"), py::arg("path"), py::kw_only(), py::arg("format") = "g2o",
      py::arg("rotation_information") = "quaternion",
      "Writes a PoseGraph; format: 'g2o', 'toro' (no priors, no fixed poses) or 'packed' (a twentieth of g2o, for "
      "sending: measurements to a 32nd of the standard deviation that residuals show, no values of poses that are not "
      "fixed). The file appears whole or not at all. "
      "FileError. Without the GIL.");
}

}  // namespace terse::python
