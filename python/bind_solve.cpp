// Batch optimisation.

#include <pybind11/stl.h>

#include "bindings.h"
#include "names.h"
#include "pickling.h"
#include "state_members.h"
#include "terse/compact/judged_solve.h"
#include "terse/core/elimination_order.h"
#include "terse/core/start_values.h"
#include "values.h"

namespace terse::python {
namespace {

template <class F>
decltype(auto) Visit(const Solution& solution, F&& f) {
  return std::visit([&](const auto& result) -> decltype(auto) { return f(*result); }, solution.result);
}

// The options get the elimination order, if one was found on the way.
template <class Pose>
std::vector<Pose> InitialFrom(const PoseGraph<Pose>& graph, const py::object& initial, BatchOptions& options) {
  if (!py::isinstance<py::str>(initial)) return PosesFrom<Pose>(initial.cast<Array>(), "initial");
  auto method = FromWord<InitialValues>(initial.cast<std::string>());
  const py::gil_scoped_release release;
  if (method == InitialValues::kChordal) options.order = EliminationOrder(graph);
  if (method != InitialValues::kAuto || graph.Poses().empty()) {
    return ComputeInitialValues(graph, method, {options.threads, {}, {}, options.order});
  }
  StartChoice<Pose> start = StartFor(graph, options);
  options.order = std::move(start.order);
  return std::move(start.T_world_body);
}

Solution Solve(const Graph& graph, const py::object& initial, const std::string& method, int max_iterations,
               double relative_tolerance, const std::string& robust, double robust_width, int threads,
               const py::object& progress) {
  const Interrupter interrupter(progress);
  BatchOptions options;
  options.method = FromWord<Method>(method);
  options.max_iterations = max_iterations;
  options.relative_tolerance = relative_tolerance;
  options.robust.kernel = FromWord<RobustKernel>(robust);
  options.robust.width = robust_width;
  options.threads = threads;
  options.progress = [&](int iteration, double chi2) { return interrupter(iteration, chi2); };
  const auto shared = graph.Share();
  return std::visit(
      [&](const auto& g) {
        const auto start = InitialFrom(g, initial, options);
        const py::gil_scoped_release release;
        return MakeSolution(JudgedAgain(g, SolveBatch(g, start, options), options), shared);
      },
      *shared);
}

py::array InitialOf(const Graph& graph, const std::string& method) {
  const auto shared = graph.Share();
  BatchOptions options;
  return std::visit([&](const auto& g) { return ArrayOf(InitialFrom(g, py::str(method), options)); }, *shared);
}

std::shared_ptr<Marginals> MarginalsOf(Solution& solution) {
  if (solution.marginals) return solution.marginals;
  std::visit(
      [&](auto& result) {
        using Pose = std::decay_t<decltype(result->T_world_body.front())>;
        const auto& g = std::get<PoseGraph<Pose>>(*solution.graph);
        using Queries = terse::Marginals<Pose>;
        std::shared_ptr<const Queries> queries;
        if (result->termination == Termination::kNotPositiveDefinite) {
          queries = std::make_shared<const Queries>(g, *result);  // which says what is free
        } else if (result->cholesky.Variables() == static_cast<int>(g.Poses().size())) {
          queries = std::make_shared<const Queries>(g, result->T_world_body, std::move(result->cholesky));
        } else {  // pickles leave it out
          queries = std::make_shared<const Queries>(WithWeights(g, result->weights), result->T_world_body);
        }
        solution.marginals = std::make_shared<Marginals>(Marginals{std::move(queries), solution.graph});
      },
      solution.result);
  return solution.marginals;
}

Graph GraphOf(const Solution& solution) {
  return std::visit(
      [&](const auto& result) {
        using Pose = std::decay_t<decltype(result->T_world_body.front())>;
        return Graph(std::get<PoseGraph<Pose>>(*solution.graph).WithPoses(result->T_world_body));
      },
      solution.result);
}

// The Cholesky factor is left out; marginals() makes it again.
template <class Pose>
using StoredSolution = std::pair<PoseGraph<Pose>, BatchResult<Pose>>;

py::tuple PickledSolution(const Solution& solution) {
  return std::visit(
      [&](const auto& result) {
        using Pose = std::decay_t<decltype(result->T_world_body.front())>;
        const auto& g = std::get<PoseGraph<Pose>>(*solution.graph);
        return py::make_tuple(
            Pose::kDim,
            Pickled("pickle Solution", std::pair<const PoseGraph<Pose>&, const BatchResult<Pose>&>(g, *result)));
      },
      solution.result);
}

Solution UnpickledSolution(const py::tuple& state) {
  return ForDimension(state[0].cast<int>(), [&](auto origin) {
    using Pose = decltype(origin);
    auto [g, result] = Unpickled<StoredSolution<Pose>>("pickle Solution", state[1].cast<py::bytes>());
    if (result.T_world_body.size() != g.Poses().size()) throw std::invalid_argument("the pickle makes no sense");
    return MakeSolution(std::move(result), std::make_shared<const AnyPoseGraph>(std::move(g)));
  });
}

py::ssize_t RowLength(const Solution& solution) { return DimensionOf(solution.result) == 2 ? 3 : 7; }

py::array PoseOf(const Solution& solution, std::int64_t id) {
  const int index = std::visit([&](const auto& g) { return g.IndexOf(PoseId{id}); }, *solution.graph);
  return Visit(solution, [&](const auto& r) { return ArrayOf(r.T_world_body[static_cast<std::size_t>(index)]); });
}

using Type = py::class_<Solution, std::shared_ptr<Solution>>;

void BindPoses(Type& type) {
  type.def_property_readonly(
          "dimension", [](const Solution& s) { return DimensionOf(s.result); }, "2 or 3.")
      .def_property_readonly(
          "ids", [](const Solution& s) { return IdsOf(*s.graph); },
          "(n,) int64: pose ids in the order of poses. A copy.")
      .def_property_readonly(
          "poses",
          [](const py::object& self) {
            const auto& s = self.cast<const Solution&>();
            const py::ssize_t length = RowLength(s);
            return ViewOf(s.rows.data(), {static_cast<py::ssize_t>(s.rows.size()) / length, length}, self);
          },
          "(n, 3) [x, y, theta] or (n, 7) [x, y, z, qx, qy, qz, qw]: T_world_body, metres and radians. A read-only "
          "view of "
          "the solution's memory, which it keeps alive; poses[:, :dimension] are the positions.")
      .def("pose", &PoseOf, py::arg("pose_id"),
           "T_world_body of one pose, (3,) or (7,). A copy. ValueError if unknown.")
      .def("graph", &GraphOf, "The graph that was solved, with these poses for values.")
      .def("marginals", &MarginalsOf,
           "Covariances at these poses (Marginals), from the factor that the solver made. UnobservableError if the "
           "system "
           "was singular.");
}

void BindOutcome(Type& type) {
  type.def_property_readonly(
          "converged", [](const Solution& s) { return Visit(s, [](auto& r) { return r.Converged(); }); },
          "Whether the optimum was reached.")
      .def_property_readonly(
          "termination",
          [](const Solution& s) { return Visit(s, [](auto& r) { return std::string(Name(r.termination)); }); },
          "How it ended, in a word: converged, ...")
      .def_property_readonly(
          "message", [](const Solution& s) { return Visit(s, [](auto& r) { return r.message; }); },
          "What happened, for people.")
      .def_property_readonly(
          "iterations", [](const Solution& s) { return Visit(s, [](auto& r) { return r.iterations; }); },
          "Iterations taken.")
      .def_property_readonly(
          "chi2", [](const Solution& s) { return Visit(s, [](auto& r) { return r.chi2; }); },
          "Sum of r' Omega r at poses (no 1/2), gauge excluded, without robust weights.")
      .def_property_readonly(
          "robust_cost", [](const Solution& s) { return Visit(s, [](auto& r) { return r.robust_cost; }); },
          "The same with the robust kernel; chi2 if there is none.")
      .def_property_readonly(
          "gradient_norm", [](const Solution& s) { return Visit(s, [](auto& r) { return r.gradient_norm; }); },
          "Largest entry of A'r at poses.")
      .def_property_readonly(
          "log_determinant", [](const Solution& s) { return Visit(s, [](auto& r) { return r.log_determinant; }); },
          "ln det H at poses, gauge anchor included.")
      .def_property_readonly(
          "weights",
          [](const Solution& s) {
            return Visit(s, [](auto& r) {
              return py::array_t<double>(static_cast<py::ssize_t>(r.weights.size()), r.weights.data());
            });
          },
          "With a robust kernel, the weight of each measurement in order of arrival, else empty. A copy.")
      .def_property_readonly(
          "free_motions", [](const Solution& s) { return Visit(s, [](auto& r) { return r.free_motions; }); },
          "What no measurement sees, if the system is singular (list of FreeMotion).")
      .def("__repr__",
           [](const Solution& s) { return Visit(s, [](auto& r) { return "<terse.Solution: " + r.message + ">"; }); })
      .def(py::pickle(&PickledSolution, &UnpickledSolution));
}

}  // namespace

void BindSolve(py::module_& module) {
  Type type(module, "Solution", "What a batch optimisation found.");
  BindPoses(type);
  BindOutcome(type);
  module.def(
      "solve", &Solve, py::arg("graph"), py::kw_only(), py::arg("initial") = "auto",
      py::arg("method") = "levenberg_marquardt", py::arg("max_iterations") = 200, py::arg("relative_tolerance") = 1e-11,
      py::arg("robust") = "none", py::arg("robust_width") = 0.0, py::arg("threads") = 1,
      py::arg("progress") = py::none(),
      "Minimises chi2 over all poses of a PoseGraph, which is not changed (Solution).\n\n"
      "initial: 'compose' (pose by pose, as they would have come in), 'file' (the graph's values), 'tree', 'chordal' "
      "(for much noise), 'auto' (the best of compose, file and chordal after a few steps; with robust, compose), or "
      "T_world_body in the order of graph.ids, (n, 3), (n, 7) or (n, 4, 4).\n"
      "method: 'levenberg_marquardt' or 'gauss_newton'.\n"
      "relative_tolerance: converged when a step lowers the cost by less than this share of it.\n"
      "robust: the cost of loops, which may be wrong: 'none', 'huber', 'cauchy', 'tukey', 'dcs' or 'gnc'; "
      "robust_width: "
      "where it sets in, in standard deviations, 0 for what one true loop in a hundred exceeds, with gnc less where "
      "loops agree better than their information says. With gnc, where many loops are rejected and residuals "
      "contradict "
      "the information, loops are judged once more by what residuals show.\n"
      "threads: at most; the result is the same for any number.\n"
      "progress: called with (iteration, chi2) after every iteration; it returns False to stop.\n"
      "What is numerical is reported, not raised: look at converged. Without the GIL; Ctrl-C works.");
  module.def(
      "initial_values", &InitialOf, py::arg("graph"), py::arg("method") = "compose",
      "(n, 3) or (n, 7): where an optimisation would start, in the order of graph.ids; method as initial of solve. "
      "Without the GIL.");
}

}  // namespace terse::python
