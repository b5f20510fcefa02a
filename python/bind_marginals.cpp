// Covariances of a solved graph and of a growing one.

#include <pybind11/stl.h>

#include "bindings.h"
#include "names.h"
#include "pickling.h"
#include "state_members.h"
#include "terse/core/initial_values.h"
#include "terse/covariance/incremental_marginals.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

// Of a solver that changes; queries take its lock.
struct GrowingMarginals {
  EitherShared<IncrementalMarginals> marginals;
  Solver solver;  // kept alive
};

CovarianceConvention ConventionFrom(const std::string& frame, const std::string& order) {
  return {FromWord<CovarianceFrame>(frame), FromWord<TangentOrder>(order)};
}

py::array ToArray(MatrixX matrix) { return ArrayOwning(std::move(matrix)); }
template <int D>
py::array ToArray(const Matrix<D, D>& block) {
  return ArrayOfMatrix(block);
}
template <int D>
py::array ToArray(std::vector<Matrix<D, D>> blocks) {
  return ArrayOwning<D>(std::move(blocks));
}

template <class Pose>
const PoseMarginals<Pose>& BaseOf(const std::shared_ptr<IncrementalMarginals<Pose>>& marginals) {
  return *marginals;
}
template <class Pose>
const PoseMarginals<Pose>& BaseOf(const std::shared_ptr<const PoseMarginals<Pose>>& marginals) {
  return *marginals;
}

// Calls f with the marginals, without the GIL; its result as an array.
template <class Variant, class F>
py::array Ask(const Variant& marginals, const F& f) {
  return std::visit(
      [&](const auto& held) {
        auto result = [&] {
          const py::gil_scoped_release release;
          return f(*held);
        }();
        return ToArray(std::move(result));
      },
      marginals);
}
// Both kinds answer these, with a PoseMarginals.
template <class F>
py::array Query(const Marginals& m, const F& f) {
  return Ask(m.queries, [&](const auto& held) { return f(held); });
}
template <class F>
py::array Query(const GrowingMarginals& m, const F& f) {
  const Lock lock(*m.solver.guard, Lock::kReading);
  return std::visit(
      [&](const auto& held) {
        const auto& base = BaseOf(held);
        auto result = [&] {
          const py::gil_scoped_release release;
          return f(base);
        }();
        return ToArray(std::move(result));
      },
      m.marginals);
}

Marginals OfGraph(const Graph& graph, const std::optional<Array>& T_world_body) {
  const auto shared = graph.Share();
  return std::visit(
      [&](const auto& g) -> Marginals {
        using Pose = typename std::decay_t<decltype(g.Poses()[0].T_world_body)>::value_type;
        std::vector<Pose> values;
        if (T_world_body) {
          values = PosesFrom<Pose>(*T_world_body, "T_world_body");
        } else {
          values = ComputeInitialValues(g, InitialValues::kFile);
        }
        const py::gil_scoped_release release;
        return {std::make_shared<const terse::Marginals<Pose>>(g, std::move(values)), shared};
      },
      *shared);
}

GrowingMarginals OfSolver(const Solver& solver, double max_drift) {
  CovarianceOptions options;
  options.max_drift = max_drift;
  const Lock lock(*solver.guard, Lock::kReading);
  return std::visit(
      [&](const auto& held) -> GrowingMarginals {
        using Pose = std::decay_t<decltype(held->EstimateAt(0))>;
        return {std::make_shared<IncrementalMarginals<Pose>>(*held, options), solver};
      },
      solver.solver);
}

constexpr const char* kConvention =
    "frame: 'body', of d in T Exp(d), 'world', of e in Exp(e) T, or 'world_axes', of position and rotation along the "
    "world's axes, as ROS has them. order: 'translation_first' or 'rotation_first'.";

using Text = const std::string&;

std::string WithConvention(const std::string& text) { return text + "\n\n" + kConvention; }

// The queries of a class of marginals for covariances of poses each by itself.
template <class Class, class M = typename Class::type>
void BindMarginalsOf(Class& type) {
  type.def(
          "marginal",
          [](const M& m, std::int64_t id, Text frame, Text order) {
            const auto to = ConventionFrom(frame, order);
            return Query(m, [&](const auto& q) { return q.Marginal(PoseId{id}, to); });
          },
          py::arg("pose_id"), py::kw_only(), py::arg("frame") = "body", py::arg("order") = "translation_first",
          WithConvention("(d, d), d = 3 or 6: the covariance of a pose, square metres and square radians.").c_str())
      .def(
          "marginals",
          [](const M& m, const py::object& ids, Text frame, Text order) {
            const auto to = ConventionFrom(frame, order);
            if (ids.is_none()) return Query(m, [&](const auto& q) { return q.AllMarginals(to); });
            const std::vector<PoseId> list = IdsFrom(ids);
            return Query(m, [&](const auto& q) { return q.MarginalsOf(list, to); });
          },
          py::arg("ids") = py::none(), py::kw_only(), py::arg("frame") = "body", py::arg("order") = "translation_first",
          WithConvention(
              "(n, d, d): the covariances of these poses, or of all in the order of ids; the array owns the memory in "
              "which "
              "they were computed, no copy is made.")
              .c_str());
}

// And those for covariances between poses.
template <class Class, class M = typename Class::type>
void BindJointCovariances(Class& type) {
  type.def(
          "cross",
          [](const M& m, std::int64_t a, std::int64_t b, Text frame, Text order) {
            const auto to = ConventionFrom(frame, order);
            return Query(m, [&](const auto& q) { return q.Cross(PoseId{a}, PoseId{b}, to); });
          },
          py::arg("a"), py::arg("b"), py::kw_only(), py::arg("frame") = "body", py::arg("order") = "translation_first",
          WithConvention("(d, d): Cov(d_a, d_b); rows are a's.").c_str())
      .def(
          "column",
          [](const M& m, std::int64_t of, const py::object& ids, Text frame, Text order) {
            const auto to = ConventionFrom(frame, order);
            const std::vector<PoseId> list = IdsFrom(ids);
            return Query(m, [&](const auto& q) { return q.Column(PoseId{of}, list, to); });
          },
          py::arg("of"), py::arg("ids"), py::kw_only(), py::arg("frame") = "body",
          py::arg("order") = "translation_first",
          WithConvention(
              "(n, d, d): Cov(d_id, d_of) for every id; rows are the id's. Owns its memory, no copy is made.")
              .c_str())
      .def(
          "joint",
          [](const M& m, const py::object& ids, Text frame, Text order) {
            const auto to = ConventionFrom(frame, order);
            const std::vector<PoseId> list = IdsFrom(ids);
            return Query(m, [&](const auto& q) { return q.Joint(list, to); });
          },
          py::arg("ids"), py::kw_only(), py::arg("frame") = "body", py::arg("order") = "translation_first",
          WithConvention(
              "(n d, n d): the covariance of the stacked poses, in the order given. Owns its memory, no copy is made.")
              .c_str())
      .def(
          "relative",
          [](const M& m, std::int64_t a, std::int64_t b, Text frame, Text order) {
            const auto to = ConventionFrom(frame, order);
            return Query(m, [&](const auto& q) { return q.Relative(PoseId{a}, PoseId{b}, to); });
          },
          py::arg("a"), py::arg("b"), py::kw_only(), py::arg("frame") = "body", py::arg("order") = "translation_first",
          WithConvention(
              "(d, d): the covariance of T_a_b = T_world_a^-1 T_world_b; 'body' is b's frame, 'world' is a's.")
              .c_str());
}

template <class Class>
void BindQueries(Class& type) {
  BindMarginalsOf(type);
  BindJointCovariances(type);
}

void BindReport(py::module_& module) {
  py::class_<CovarianceReport>(module, "CovarianceReport", "What an update of covariances did.")
      .def_property_readonly(
          "path", [](const CovarianceReport& r) { return Name(r.path); },
          "How they came up to date: none, propagated, downdated or recursion.")
      .def_readonly("columns", &CovarianceReport::columns, "Of the inverse that were solved for.")
      .def_readonly("flops", &CovarianceReport::flops, "Multiplications and additions.")
      .def_readonly("seconds", &CovarianceReport::seconds, "Seconds it took.")
      .def_readonly("drift", &CovarianceReport::drift, "Estimate of the relative error that downdates have left.")
      .def("__repr__",
           [](const CovarianceReport& r) {
             return std::string("<terse.CovarianceReport: ") + Name(r.path) + ", " + Counted(r.columns, "column") +
                    ", " + SixDigits(r.seconds) + " s>";
           })
      .def(PickleOf<CovarianceReport>("pickle CovarianceReport"));
}

void BindGrowing(py::module_& module) {
  py::class_<GrowingMarginals> type(
      module, "IncrementalMarginals",
      "Covariances of a growing map, at the linearisation points of an IncrementalSolver, which it keeps alive.\n\n"
      "Queries are exact at any time. update(), called after a step, keeps the covariances of all poses and the newest "
      "pose's cross-covariances at hand: for who needs them all at every step.");
  type.def(py::init(&OfSolver), py::arg("solver"), py::kw_only(), py::arg("max_drift") = 1e-9,
           "max_drift: kept covariances are computed anew when updates have left a larger relative error.")
      .def(
          "update",
          [](GrowingMarginals& m) {
            const Lock lock(*m.solver.guard, Lock::kChanging);
            const py::gil_scoped_release release;
            return std::visit([](auto& held) { return held->Update(); }, m.marginals);
          },
          "Brings the kept covariances up to date (CovarianceReport). ValueError if the solver has no pose. Without "
          "the GIL.")
      .def(
          "newest",
          [](const GrowingMarginals& m) {
            const Lock lock(*m.solver.guard, Lock::kReading);
            return Ask(m.marginals, [](const auto& held) { return held.Newest(); });
          },
          "(d, d): the covariance of the pose that was added last; body frame, translation first.")
      .def(
          "newest_column",
          [](const GrowingMarginals& m) {
            const Lock lock(*m.solver.guard, Lock::kReading);
            return Ask(m.marginals, [](const auto& held) { return held.NewestColumn(); });
          },
          "(n, d, d): Cov(d_i, d_newest) for every pose i in order of arrival; rows are i's. Owns its memory.")
      .def("__repr__", [](const GrowingMarginals& m) {
        const Lock lock(*m.solver.guard, Lock::kReading);
        return std::visit(
            [&](const auto& held) {
              return "<terse.IncrementalMarginals: " + DimensionText(DimensionOf(m.solver.solver)) + ", " +
                     Counted(held->Graph().Poses().size(), "pose") + ">";
            },
            m.solver.solver);
      });
  BindQueries(type);
}

}  // namespace

void BindMarginals(py::module_& module) {
  py::class_<Marginals, std::shared_ptr<Marginals>> type(
      module, "Marginals",
      "Covariances of a pose graph at given values. Queries run without the GIL, also from several "
      "threads.\n\n"
      "Of d in T Exp(d), d = [translation, rotation], metres and radians, body frame, unless asked "
      "otherwise. Without priors they are relative to the first pose.");
  type.def(py::init(&OfGraph), py::arg("graph"), py::arg("T_world_body") = py::none(),
           "Factors the graph at T_world_body, in the order of graph.ids, or at the graph's own values. "
           "Solution.marginals() uses the factor that is there already. UnobservableError if the system is singular. "
           "Without the GIL.")
      .def_property_readonly(
          "ids", [](const Marginals& m) { return IdsOf(*m.graph); }, "(n,) int64: the order of marginals(). A copy.")
      .def("__repr__", [](const Marginals& m) {
        return "<terse.Marginals: " + DimensionText(DimensionOf(m.queries)) + ", " +
               std::visit([](const auto& g) { return Counted(g.Poses().size(), "pose"); }, *m.graph) + ">";
      });
  BindQueries(type);
  BindReport(module);
}

void BindIncrementalMarginals(py::module_& module) { BindGrowing(module); }

}  // namespace terse::python
