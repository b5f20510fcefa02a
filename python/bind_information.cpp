// Information that nobody estimated, scaled to agree with the residuals.

#include <pybind11/stl.h>

#include "bindings.h"
#include "pickling.h"
#include "state_members.h"
#include "terse/covariance/information_scale.h"
#include "values.h"

namespace terse::python {
namespace {

std::pair<Graph, InformationCalibration> Calibrate(const Graph& graph) {
  const auto shared = graph.Share();
  const py::gil_scoped_release release;
  return std::visit(
      [](const auto& g) {
        const InformationCalibration found = CalibrateInformation(g);
        return std::pair(Graph(ScaleInformation(g, found.scale)), found);
      },
      *shared);
}

std::pair<double, double> PairOf(const KindScale& scale) { return {scale.translation, scale.rotation}; }
std::pair<double, double> PairOf(const KindEstimate& found) {
  return {found.translation.sigma_factor, found.rotation.sigma_factor};
}

}  // namespace

void BindInformation(py::module_& module) {
  using C = InformationCalibration;
  py::class_<C>(module, "InformationCalibration",
                "What a graph's residuals say about its information, and the factors it was scaled by. Factors are of "
                "standard deviations, (translation, rotation).")
      .def_property_readonly(
          "verdict", [](const C& c) { return Name(c.verdict); },
          "'consistent', 'contradicted' (then it was scaled) or 'undetermined'.")
      .def_readonly("message", &C::message, "A sentence for people.")
      .def_property_readonly(
          "odometry_scale", [](const C& c) { return PairOf(c.scale.odometry); }, "Of odometry; ones if it was left.")
      .def_property_readonly(
          "loop_scale", [](const C& c) { return PairOf(c.scale.loops); }, "Of loops; ones if they were left.")
      .def_property_readonly(
          "odometry_estimate", [](const C& c) { return PairOf(c.estimate.odometry); },
          "What the residuals of odometry ask for, whatever was done.")
      .def_property_readonly(
          "loop_estimate", [](const C& c) { return PairOf(c.estimate.loops); },
          "What the residuals of loops ask for, whatever was done.")
      .def_property_readonly(
          "is_placeholder", [](const C& c) { return c.stated.IsPlaceholder(); },
          "The unit matrix, or constants with implausible standard deviations: nobody measured them.")
      .def_property_readonly(
          "loops_left_out", [](const C& c) { return c.estimate.loops_left_out; },
          "Loops that the others contradict: they do not count.")
      .def("__repr__",
           [](const C& c) { return std::string("<terse.InformationCalibration: ") + Name(c.verdict) + ">"; })
      .def(PickleOf<C>("pickle InformationCalibration"));
  module.def("calibrate_information", &Calibrate, py::arg("graph"),
             "(graph, InformationCalibration): a PoseGraph as it was, or with the information of its relative "
             "measurements scaled, where it is the unit matrix or another constant that the residuals contradict.\n\n"
             "What the command compact does by default; CompactPoseSlam takes information as it is. Priors are not "
             "scaled. ValueError if the graph is empty or not connected. Without the GIL.");
}

}  // namespace terse::python
