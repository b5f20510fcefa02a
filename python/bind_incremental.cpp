// The incremental solver.

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <filesystem>
#include <set>

#include "bindings.h"
#include "names.h"
#include "pickling.h"
#include "state_members.h"
#include "terse/core/replay.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

using Path = std::filesystem::path;

Solver MakeSolver(int dimension, const IncrementalOptions* options) {
  const IncrementalOptions chosen = options != nullptr ? *options : IncrementalOptions();
  return ForDimension(
      dimension, [&](auto origin) { return Solver{std::make_shared<IncrementalSolver<decltype(origin)>>(chosen)}; });
}

// The pose type of a solver that is held.
template <class Pose>
Pose OriginOf(const std::shared_ptr<IncrementalSolver<Pose>>&) {
  return Pose();
}

// f with the solver, reading.
template <class F>
decltype(auto) Read(const Solver& solver, const F& f) {
  const Lock lock(*solver.guard, Lock::kReading);
  return std::visit([&](const auto& held) -> decltype(auto) { return f(*held); }, solver.solver);
}

// New poses: ids, or ids with values.
template <class Pose>
std::vector<typename GraphUpdate<Pose>::NewPose> NewPosesFrom(const py::object& poses, const py::object& fixed) {
  std::set<std::int64_t> anchored;
  for (const py::handle id : fixed) anchored.insert(id.cast<std::int64_t>());
  std::vector<typename GraphUpdate<Pose>::NewPose> out;
  const auto add = [&](py::handle id, py::handle value) {
    typename GraphUpdate<Pose>::NewPose pose{PoseId{id.cast<std::int64_t>()}};
    if (!value.is_none()) pose.T_world_body = PoseFrom<Pose>(value.cast<Array>(), "poses");
    pose.fixed = anchored.erase(pose.id.value) > 0;
    out.push_back(std::move(pose));
  };
  if (py::isinstance<py::dict>(poses)) {
    for (const auto& [id, value] : poses.cast<py::dict>()) add(id, value);
  } else {
    for (const py::handle id : poses) add(id, py::none());
  }
  if (!anchored.empty()) throw std::invalid_argument("fixed: these are no new poses");
  return out;
}

StepReport Update(const Solver& solver, const py::object& poses, const py::iterable& factors,
                  const std::vector<std::int64_t>& removed, const py::object& fixed) {
  const Lock lock(*solver.guard, Lock::kChanging);
  return std::visit(
      [&](const auto& held) {
        using Pose = decltype(OriginOf(held));
        GraphUpdate<Pose> update;
        update.poses = NewPosesFrom<Pose>(poses, fixed);
        update.factors = FactorsFrom<Pose>(factors);
        for (const std::int64_t id : removed) update.removed.push_back(FactorId{id});
        const py::gil_scoped_release release;
        return held->Update(update);
      },
      solver.solver);
}

Solution Finish(const Solver& solver, const std::string& method, int max_iterations, const py::object& progress) {
  const Lock lock(*solver.guard, Lock::kChanging);
  const Interrupter interrupter(progress);
  BatchOptions options;
  options.method = FromWord<Method>(method);
  options.max_iterations = max_iterations;
  options.progress = [&](int iteration, double chi2) { return interrupter(iteration, chi2); };
  return std::visit(
      [&](const auto& held) {
        const py::gil_scoped_release release;
        auto result = held->Finish(options);
        return MakeSolution(std::move(result), std::make_shared<const AnyPoseGraph>(held->Graph()));
      },
      solver.solver);
}

Solver Load(const Path& path) {
  return ForDimension(DimensionOfState(path.string()), [&](auto origin) {
    using Held = IncrementalSolver<decltype(origin)>;
    const py::gil_scoped_release release;
    return Solver{std::make_shared<Held>(Held::Load(path.string()))};
  });
}

void ReplayGraph(const Graph& graph, const Solver& solver, const std::string& every, bool stored_values,
                 const py::object& after_step) {
  const Lock lock(*solver.guard, Lock::kChanging);
  const Interrupter interrupter(after_step);
  ReplayOptions options;
  options.every = FromWord<ArrivalUnit>(every);
  options.stored_values = stored_values;
  const auto shared = graph.Share();
  std::visit(
      [&](const auto& held) {
        using Pose = decltype(OriginOf(held));
        const auto& g = Expect<PoseGraph<Pose>>(*shared, "graph");
        const py::gil_scoped_release release;
        terse::Replay(g, options, *held,
                      [&](const ReplayStep& step) { return interrupter(step.index, step.steps, step.report); });
      },
      solver.solver);
}

void BindStepReport(py::module_& module) {
  py::class_<StepReport>(module, "StepReport", "What a step of the incremental solver did.")
      .def_property_readonly(
          "factor_ids", [](const StepReport& r) { return ArrayOfIds(r.factor_ids); },
          "(k,) int64: ids of the added measurements, in the order given.")
      .def_property_readonly(
          "path", [](const StepReport& r) { return WordOf(r.path); },
          "How they came into the factor: none, appended, rank_update or refactored.")
      .def_readonly("gate_open", &StepReport::gate_open, "Whether the map was optimised.")
      .def_readonly("gate_value", &StepReport::gate_value, "In the gate's unit.")
      .def_readonly("iterations", &StepReport::iterations, "Gauss-Newton steps taken.")
      .def_readonly("variables_refactored", &StepReport::variables_refactored,
                    "Poses in the part that was factored again.")
      .def_readonly("variables_relinearised", &StepReport::variables_relinearised, "Poses.")
      .def_readonly("variables_moved", &StepReport::variables_moved, "Poses whose estimate changed.")
      .def_readonly("predicted_decrease", &StepReport::predicted_decrease, "Of chi2 by this step, linearised.")
      .def_readonly("actual_decrease", &StepReport::actual_decrease,
                    "Of chi2; filled in if IncrementalOptions.report_cost, and always with carry 'point'.")
      .def_readonly("gain_nats", &StepReport::gain_nats,
                    "What the new measurements tell about the poses known before, nats.")
      .def_readonly("restarted", &StepReport::restarted,
                    "The map left a wrong minimum for a lower one (IncrementalOptions.restart).")
      .def_readonly("deferred_relinearisations", &StepReport::deferred_relinearisations, "Poses left to later steps.")
      .def_readonly("deferred_fronts", &StepReport::deferred_fronts, "Subtrees left to later steps.")
      .def_readonly("flops", &StepReport::flops, "Of the factorisation.")
      .def_readonly("solve_flops", &StepReport::solve_flops, "Of the back-substitution.")
      .def_readonly("seconds", &StepReport::seconds, "Of the update.")
      .def("__repr__",
           [](const StepReport& r) {
             return "<terse.StepReport: " + Counted(r.factor_ids.size(), "factor") + " " + WordOf(r.path) + ", gate " +
                    (r.gate_open ? "open" : "closed") + ", " + Counted(r.iterations, "iteration") + ", " +
                    Counted(r.variables_moved, "pose") + " moved>";
           })
      .def(PickleOf<StepReport>("pickle StepReport"));
}

using Type = py::class_<Solver>;

void BindSteps(Type& type) {
  type.def(py::init(&MakeSolver), py::arg("dimension"), py::arg("options") = py::none(),
           "dimension: 2 or 3. options: IncrementalOptions.")
      .def("update", &Update, py::kw_only(), py::arg("poses") = py::tuple(), py::arg("factors") = py::tuple(),
           py::arg("removed") = std::vector<std::int64_t>(), py::arg("fixed") = py::tuple(),
           "Takes one step (StepReport).\n\n"
           "poses: ids of new poses, or a dict from ids to T_world_body ((3,), (3, 3), (7,), (4, 4) or None).\n"
           "factors: RelativePose, PosePrior and PositionPrior objects. removed: ids of measurements that go.\n"
           "fixed: ids of those new poses that are anchored at their values.\n"
           "ValueError, UnobservableError or NumericalError, and then nothing has changed. Without the GIL.")
      .def("finish", &Finish, py::kw_only(), py::arg("method") = "levenberg_marquardt", py::arg("max_iterations") = 200,
           py::arg("progress") = py::none(),
           "Iterates to the batch optimum (Solution), which becomes the linearisation point; arguments as of solve. "
           "Without "
           "the GIL.");
}

void BindEstimates(Type& type) {
  type.def_property_readonly(
          "dimension", [](const Solver& s) { return DimensionOf(s.solver); }, "2 or 3.")
      .def_property_readonly(
          "ids",
          [](const Solver& s) {
            return Read(s, [](const auto& held) {
              std::vector<PoseId> ids;
              for (const auto& pose : held.Graph().Poses()) ids.push_back(pose.id);
              return ArrayOfIds(ids);
            });
          },
          "(n,) int64: pose ids in order of arrival. A copy.")
      .def("__len__",
           [](const Solver& s) { return Read(s, [](const auto& held) { return held.Graph().Poses().size(); }); })
      .def(
          "estimate",
          [](const Solver& s, std::int64_t id) {
            return Read(s, [&](const auto& held) { return ArrayOf(held.Estimate(PoseId{id})); });
          },
          py::arg("pose_id"), "T_world_body of one pose, (3,) or (7,). A copy. ValueError if it is unknown.")
      .def(
          "estimates",
          [](const Solver& s) { return Read(s, [](const auto& held) { return ArrayOf(held.Estimates()); }); },
          "(n, 3) [x, y, theta] or (n, 7) [x, y, z, qx, qy, qz, qw]: T_world_body in the order of ids, metres and "
          "radians. "
          "A copy.")
      .def(
          "linearization_points",
          [](const Solver& s) { return Read(s, [](const auto& held) { return ArrayOf(held.LinearizationPoints()); }); },
          "Where the measurements are linearised, as estimates. A copy.")
      .def(
          "graph", [](const Solver& s) { return Read(s, [](const auto& held) { return Graph(held.Graph()); }); },
          "Poses and measurements so far; the values in it are the poses' initial ones. A copy.");
}

void BindCosts(Type& type) {
  type.def(
          "chi2", [](const Solver& s) { return Read(s, [](const auto& held) { return held.Chi2(); }); },
          "Sum of r' Omega r at the estimate, without robust weights.")
      .def(
          "robust_chi2", [](const Solver& s) { return Read(s, [](const auto& held) { return held.RobustChi2(); }); },
          "The same with the robust kernel.")
      .def(
          "weight_of",
          [](const Solver& s, std::int64_t id) {
            return Read(s, [&](const auto& held) { return held.WeightOf(FactorId{id}); });
          },
          py::arg("factor_id"), "With which a measurement takes part now, in [0, 1].")
      .def(
          "undetermined",
          [](const Solver& s) { return Read(s, [](const auto& held) { return held.DescribeUndetermined(); }); },
          "What the absolute measurements so far leave undetermined of how the map lies, in words, as its heading "
          "after "
          "one position prior; '' if nothing, or if there are none.")
      .def(
          "log_determinant",
          [](const Solver& s) { return Read(s, [](const auto& held) { return held.LogDeterminant(); }); },
          "ln det H at the linearisation points.");
}

void BindStorage(Type& type) {
  type.def(
          "save",
          [](const Solver& s, const Path& path) {
            Read(s, [&](const auto& held) {
              const py::gil_scoped_release release;
              held.Save(path.string());
            });
          },
          py::arg("path"), "Writes the whole state to a file, whole or not at all. FileError. Without the GIL.")
      .def_static(
          "load", &Load, py::arg("path"),
          "The solver that was saved; it continues bit for bit as that one would have. FileError. Without the GIL.")
      .def(py::pickle(
          [](const Solver& s) {
            return Read(s, [&](const auto& held) {
              return py::make_tuple(DimensionOf(s.solver), Pickled("pickle IncrementalSolver", held));
            });
          },
          [](const py::tuple& state) {
            return ForDimension(state[0].cast<int>(), [&](auto origin) {
              using Held = IncrementalSolver<decltype(origin)>;
              return Solver{
                  std::make_shared<Held>(Unpickled<Held>("pickle IncrementalSolver", state[1].cast<py::bytes>()))};
            });
          }));
}

}  // namespace

void BindIncremental(py::module_& module) {
  BindStepReport(module);
  Type type(module, "IncrementalSolver",
            "Optimisation of a growing pose graph.\n\n"
            "A new pose starts at the value given with it, else at that of its prior, else at the end of its first "
            "measurement "
            "from a known pose. A failed call changes nothing. Any thread may call; calls wait for each other, without "
            "the GIL.");
  BindSteps(type);
  BindEstimates(type);
  BindCosts(type);
  BindStorage(type);
  type.def("__repr__", [](const Solver& s) {
    return Read(s, [&](const auto& held) {
      return "<terse.IncrementalSolver: " + DimensionText(DimensionOf(s.solver)) + ", " +
             Counted(held.Graph().Poses().size(), "pose") + ", " + Counted(held.Graph().Factors().size(), "factor") +
             ">";
    });
  });
  module.def("replay", &ReplayGraph, py::arg("graph"), py::arg("solver"), py::kw_only(), py::arg("every") = "pose",
             py::arg("stored_values") = false, py::arg("after_step") = py::none(),
             "Feeds a stored PoseGraph to an IncrementalSolver as it would have come in online.\n\n"
             "every: what a step brings, a 'pose' with its measurements or an 'edge'.\n"
             "stored_values: new poses start at the graph's values instead of being composed.\n"
             "after_step: called with (index, steps, StepReport); it returns False to stop and may read the solver.\n"
             "ValueError if the graph is not connected, and what update raises. Without the GIL; Ctrl-C works.");
}

}  // namespace terse::python
