#pragma once
// What the module's classes hold. The dimension, a template parameter of the library, is a value here: a variant.

#include <pybind11/pybind11.h>

#include <functional>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

#include "conversions.h"
#include "guard.h"
#include "terse/compact/compact_graph.h"
#include "terse/compact/compact_pose_slam.h"
#include "terse/compact/thresholds.h"
#include "terse/core/graph_file.h"
#include "terse/covariance/marginals.h"

namespace terse::python {

template <template <class> class T>
using Either = std::variant<T<SE2>, T<SE3>>;
template <template <class> class T>
using EitherShared = std::variant<std::shared_ptr<T<SE2>>, std::shared_ptr<T<SE3>>>;

[[noreturn]] inline void ThrowDimension(const std::string& what, int found, int expected) {
  throw std::invalid_argument(what + ": expected " + std::to_string(expected) + "D, got " + std::to_string(found) +
                              "D");
}
inline void CheckDimension(int dimension) {
  if (dimension != 2 && dimension != 3) throw std::invalid_argument("dimension: expected 2 or 3");
}

// One of the two, by the dimension.
template <class Variant>
int DimensionOf(const Variant& either) {
  return either.index() == 0 ? 2 : 3;
}
template <class Held, class Variant>
const Held& Expect(const Variant& either, const std::string& what) {
  if (const Held* held = std::get_if<Held>(&either)) return *held;
  ThrowDimension(what, DimensionOf(either), 5 - DimensionOf(either));
}
// Calls f with a default-made SE2 or SE3 for its type.
template <class F>
decltype(auto) ForDimension(int dimension, F&& f) {
  CheckDimension(dimension);
  return dimension == 2 ? f(SE2()) : f(SE3());
}

struct RelativePose {
  Either<RelativePoseFactor> factor;
};
struct PosePrior {
  Either<PosePriorFactor> factor;
};
struct PositionPrior {
  Either<PositionPriorFactor> factor;
};
// A RelativePose, PosePrior or PositionPrior. Throws std::invalid_argument for another dimension.
template <class Pose>
Factor<Pose> FactorFrom(py::handle object);
template <class Pose>
std::vector<Factor<Pose>> FactorsFrom(const py::iterable& objects);
template <class Pose>
py::object ObjectOf(const Factor<Pose>& factor);

// A graph with value semantics: whoever works on it without the GIL holds a share, and a change then makes a copy.
class Graph {
 public:
  explicit Graph(AnyPoseGraph graph) : graph_(std::make_shared<AnyPoseGraph>(std::move(graph))) {}
  const AnyPoseGraph& Get() const { return *graph_; }
  std::shared_ptr<const AnyPoseGraph> Share() const { return graph_; }
  AnyPoseGraph& Change() {
    if (graph_.use_count() > 1) graph_ = std::make_shared<AnyPoseGraph>(*graph_);
    return *graph_;
  }
  int Dimension() const { return DimensionOf(*graph_); }

 private:
  std::shared_ptr<AnyPoseGraph> graph_;
};
Ids IdsOf(const AnyPoseGraph& graph);

struct Marginals {
  std::variant<std::shared_ptr<const PoseMarginals<SE2>>, std::shared_ptr<const PoseMarginals<SE3>>> queries;
  std::shared_ptr<const AnyPoseGraph> graph;  // for ids; absent if it grows with a solver
};

struct Solution {
  EitherShared<BatchResult> result;
  std::shared_ptr<const AnyPoseGraph> graph;
  std::vector<double> rows;  // of the poses
  // The result's factor moves in here when it is first asked for.
  std::shared_ptr<Marginals> marginals = nullptr;
};
template <class Pose>
Solution MakeSolution(BatchResult<Pose> result, std::shared_ptr<const AnyPoseGraph> graph) {
  std::vector<double> rows = RowsOf(result.T_world_body);
  return {std::make_shared<BatchResult<Pose>>(std::move(result)), std::move(graph), std::move(rows)};
}

struct Solver {
  EitherShared<IncrementalSolver> solver;
  std::shared_ptr<Guard> guard = std::make_shared<Guard>();
};

struct CompactSettings {
  Either<CompactOptions> options;
};
struct ChosenThresholds {
  Either<SampledThresholds> thresholds;
};
struct Replay {
  EitherShared<GraphReplay> replay;
  std::shared_ptr<Guard> guard = std::make_shared<Guard>();
};

struct Slam {
  EitherShared<CompactPoseSlam> slam;
  std::shared_ptr<Guard> guard = std::make_shared<Guard>();
};
// All poses of a run.
struct Recovered {
  py::object ids, kept, poses;
};
Recovered TrajectoryOf(const Slam& slam, const std::string& recovery);

// A pose as it arrives, of either dimension.
struct Input {
  std::int64_t id = 0;
  py::object odometry = py::none();  // RelativePose
  std::optional<Array> T_world_body;
  bool fixed = false;
  py::object priors = py::tuple();
  std::optional<std::vector<std::int64_t>> linkable;
  py::object loops = py::none();  // RelativePose objects
  bool drawn = false;
};

// Of an object with __getitem__ from 0 on.
inline py::iterator IterateSequence(const py::object& sequence) {
  return py::reinterpret_steal<py::iterator>(PySeqIter_New(sequence.ptr()));
}

// Sets attributes from keyword arguments, as constructors of options do. Throws TypeError for an unknown name.
void SetAttributes(const py::object& object, const py::kwargs& keywords);

// What a long call asks now and then: Ctrl-C and, if there is one, the progress callback, which returns False to stop.
// Without the GIL.
class Interrupter {
 public:
  explicit Interrupter(const py::object& callback) : callback_(callback) {}
  template <class... Arguments>
  bool operator()(Arguments... arguments) const {
    const py::gil_scoped_acquire acquire;
    if (PyErr_CheckSignals() != 0) throw py::error_already_set();
    if (callback_.is_none()) return true;
    return !callback_(arguments...).is(py::bool_(false));
  }

 private:
  const py::object& callback_;
};

// The word of the dimension in the file of a saved state: 2 or 3, 3 where it cannot be told.
int DimensionOfState(const std::string& path);

}  // namespace terse::python
