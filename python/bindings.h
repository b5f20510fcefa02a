#pragma once
// The parts of the module, one file each, in the order in which they need each other.

#include <pybind11/pybind11.h>

namespace terse::python {

void BindErrors(pybind11::module_& module);
void BindFactors(pybind11::module_& module);
void BindGraph(pybind11::module_& module);
void BindFiles(pybind11::module_& module);
void BindTrajectory(pybind11::module_& module);
void BindMarginals(pybind11::module_& module);
void BindSolve(pybind11::module_& module);
void BindOptions(pybind11::module_& module);
void BindIncremental(pybind11::module_& module);
void BindIncrementalMarginals(pybind11::module_& module);
void BindInformation(pybind11::module_& module);
void BindDecision(pybind11::module_& module);
void BindReplay(pybind11::module_& module);
void BindMapFile(pybind11::module_& module);
void BindCompact(pybind11::module_& module);
void BindCompactRun(pybind11::module_& module);
void BindSparsify(pybind11::module_& module);
void BindMerge(pybind11::module_& module);

// What makes a part too long for one file: adds to the class that the part has made.
struct Slam;
void BindCompactAdding(pybind11::class_<Slam>& type);

}  // namespace terse::python
