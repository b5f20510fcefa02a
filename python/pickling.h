#pragma once
// Pickles, and copies by the module `copy`, of plain values: the bytes that core/state_file.h makes of them. They are
// exact to the last bit, checked, and for the version of the library that wrote them.

#include <pybind11/pybind11.h>

#include <stdexcept>
#include <string>
#include <utility>

#include "terse/core/error.h"
#include "terse/core/state_members.h"

namespace terse::python {

template <class T>
pybind11::bytes Pickled(const std::string& kind, const T& value) {
  return StateBytes(kind, value);
}

// Throws std::invalid_argument.
template <class T>
T Unpickled(const std::string& kind, const pybind11::bytes& bytes) {
  try {
    return FromStateBytes<T>(bytes, "the pickle", kind);
  } catch (const FileError& error) {
    throw std::invalid_argument("the pickle is of no use here: " + error.cause());
  }
}

// For `type.def(PickleOf<Class>(kind, get, make))`: get(object) is what is stored, make(stored) the object.
template <class Class, class Get, class Make>
auto PickleOf(const std::string& kind, const Get& get, const Make& make) {
  using Stored = std::decay_t<decltype(get(std::declval<const Class&>()))>;
  return pybind11::pickle([kind, get](const Class& object) { return Pickled(kind, get(object)); },
                          [kind, make](const pybind11::bytes& bytes) { return make(Unpickled<Stored>(kind, bytes)); });
}
// Of what is stored as it is.
template <class Class>
auto PickleOf(const std::string& kind) {
  return pybind11::pickle([kind](const Class& object) { return Pickled(kind, object); },
                          [kind](const pybind11::bytes& bytes) { return Unpickled<Class>(kind, bytes); });
}

}  // namespace terse::python
