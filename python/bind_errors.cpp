// The library's errors as Python's.

#include <pybind11/stl.h>

#include <fstream>
#include <map>

#include "bindings.h"
#include "names.h"
#include "pickling.h"
#include "state_members.h"
#include "terse/core/error.h"
#include "terse/core/observability.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

// Live as long as the process: translators may run while the interpreter ends.
PyObject* file_error = nullptr;
PyObject* numerical_error = nullptr;
PyObject* unobservable_error = nullptr;

PyObject* NewError(py::module_& module, const char* name, const char* doc, PyObject* base) {
  PyObject* type = PyErr_NewExceptionWithDoc((std::string("terse.") + name).c_str(), doc, base, nullptr);
  if (type == nullptr) throw py::error_already_set();
  module.attr(name) = py::handle(type);
  return type;
}

// OSError's own names for an attribute. Its message stays the one it is made with.
void SetAliases(PyObject* type, const std::map<std::string, std::string>& names) {
  const py::object property = py::module_::import("builtins").attr("property");
  for (const auto& [alias, name] : names) {
    const py::cpp_function get(
        [name = name](const py::object& error) { return py::getattr(error, name.c_str(), py::none()); });
    py::setattr(type, alias.c_str(), property(get));
  }
}

void Raise(PyObject* type, const py::object& error) { PyErr_SetObject(type, error.ptr()); }

void Translate(std::exception_ptr thrown) {
  try {
    if (thrown) std::rethrow_exception(thrown);
  } catch (const FileError& e) {
    py::object error = py::handle(file_error)(e.what());
    error.attr("path") = e.path();
    error.attr("line") = e.line();
    error.attr("cause") = e.cause();
    Raise(file_error, error);
  } catch (const UnobservableError& e) {
    py::object error = py::handle(unobservable_error)(e.what());
    error.attr("motions") = py::cast(e.motions());
    Raise(unobservable_error, error);
  } catch (const NumericalError& e) {
    PyErr_SetString(numerical_error, e.what());
  }
}

void BindFreeMotion(py::module_& module) {
  py::class_<FreeMotion>(module, "FreeMotion", "Motions of poses that no measurement sees.")
      .def_property_readonly(
          "freedom", [](const FreeMotion& m) { return WordOf(m.freedom); },
          "'floating' (a part of the graph without absolute measurement), 'loosely_held' (absolute measurements leave "
          "some of its rigid motions free) or 'unmeasured' (inside a part).")
      .def_readonly("poses", &FreeMotion::poses, "How many poses it moves.")
      .def_property_readonly(
          "ids", [](const FreeMotion& m) { return ArrayOfIds(m.ids); }, "The smallest of their ids, five at most.")
      .def_property_readonly(
          "pose", [](const FreeMotion& m) { return m.pose.value; }, "The id of one of them.")
      .def_property_readonly(
          "directions", [](const FreeMotion& m) { return ArrayOwning(m.directions); },
          "(d, k): free directions of that pose, orthonormal columns, tangent [translation, rotation], metres and "
          "radians, body frame. A copy.")
      .def("__str__", &Describe, "In words.")
      .def("__repr__", [](const FreeMotion& m) { return "<terse.FreeMotion: " + Describe(m) + ">"; })
      .def(PickleOf<FreeMotion>("pickle FreeMotion"));
}

}  // namespace

void BindErrors(py::module_& module) {
  file_error =
      NewError(module, "FileError",
               "A file that cannot be read or written: an OSError. Attributes: path, line (from 1; 0: the file as a "
               "whole) and cause; filename is path, strerror cause.",
               PyExc_OSError);
  SetAliases(file_error, {{"filename", "path"}, {"strerror", "cause"}});
  numerical_error =
      NewError(module, "NumericalError", "The linear system is singular or not finite.", PyExc_RuntimeError);
  unobservable_error = NewError(module, "UnobservableError",
                                "The linear system is singular; the attribute motions says what is free (list of "
                                "FreeMotion).",
                                numerical_error);
  BindFreeMotion(module);
  py::register_exception_translator(&Translate);
}

void SetAttributes(const py::object& object, const py::kwargs& keywords) {
  for (const auto& [name, value] : keywords) {
    if (!py::hasattr(py::type::of(object), name)) {
      throw py::type_error(py::str(py::type::of(object).attr("__name__")).cast<std::string>() + " has no option '" +
                           name.cast<std::string>() + "'");
    }
    py::setattr(object, name, value);
  }
}

std::string OptionsText(const py::object& options, const py::object& standard, const std::string& first) {
  const py::object type = py::type::of(options), repr = py::module_::import("builtins").attr("repr");
  std::string text = "terse." + type.attr("__name__").cast<std::string>() + "(" + first;
  for (const auto& [name, member] : py::dict(type.attr("__dict__").attr("copy")())) {
    if (!py::hasattr(member, "fset") || member.attr("fset").is_none()) continue;
    const py::object value = py::getattr(options, name), usual = py::getattr(standard, name);
    const auto text_of = [&](const py::object& object) {
      return repr(py::isinstance<py::array>(object) ? object.attr("tolist")() : object).cast<std::string>();
    };
    if (text_of(value) == text_of(usual)) continue;
    if (text.back() != '(') text += ", ";
    text += py::str(name).cast<std::string>() + "=" + text_of(value);
  }
  return text + ")";
}

int DimensionOfState(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  char head[64] = {};
  file.read(head, sizeof head);
  return std::string(head, static_cast<std::size_t>(file.gcount())).find(" SE2") == std::string::npos ? 3 : 2;
}

}  // namespace terse::python
