#pragma once
// One object, several Python threads. The library works without the GIL, so an object that changes has a lock of its
// own. A callback of a call that is under way may read the object (same thread), but not change it.

#include <pybind11/pybind11.h>

#include <mutex>
#include <stdexcept>

namespace terse::python {

struct Guard {
  std::recursive_mutex mutex;
  int calls = 0;  // under way
};

// Taken with the GIL, which is released while waiting: whoever has the lock may need it.
class Lock {
 public:
  enum For { kReading, kChanging };
  Lock(Guard& guard, For purpose) : guard_(guard) {
    if (!guard.mutex.try_lock()) {
      const pybind11::gil_scoped_release release;
      guard.mutex.lock();
    }
    if (purpose == kChanging && guard.calls > 0) {
      guard.mutex.unlock();
      throw std::runtime_error("a callback cannot change the object whose call it belongs to");
    }
    ++guard.calls;
  }
  ~Lock() {
    --guard_.calls;
    guard_.mutex.unlock();
  }
  Lock(const Lock&) = delete;
  Lock& operator=(const Lock&) = delete;

 private:
  Guard& guard_;
};

}  // namespace terse::python
