#include "bindings.h"

namespace py = pybind11;

PYBIND11_MODULE(_terse, module) {
  using namespace terse::python;
  py::options options;
  options.disable_enum_members_docstring();
  module.doc() = "The compiled part of the package terse.";
  module.attr("__version__") = TERSE_VERSION;
  BindErrors(module);
  BindFactors(module);
  BindGraph(module);
  BindFiles(module);
  BindTrajectory(module);
  BindMarginals(module);
  BindSolve(module);
  BindOptions(module);
  BindIncremental(module);
  BindIncrementalMarginals(module);
  BindInformation(module);
  BindDecision(module);
  BindReplay(module);
  BindMapFile(module);
  BindCompact(module);
  BindCompactRun(module);
  BindSparsify(module);
  BindMerge(module);
}
