// A finished graph made small.

#include <pybind11/stl.h>

#include "bindings.h"
#include "names.h"
#include "terse/compact/map_file.h"
#include "terse/compact/sparsify.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

struct Small {
  std::variant<std::shared_ptr<const Sparsified<SE2>>, std::shared_ptr<const Sparsified<SE3>>> result;
};

template <class F>
decltype(auto) Visit(const Small& small, const F& f) {
  return std::visit([&](const auto& result) -> decltype(auto) { return f(*result); }, small.result);
}

// A float is a share, an int a number.
std::optional<SparsifyBudget> BudgetFrom(const py::object& given, const char* what) {
  if (given.is_none()) return std::nullopt;
  SparsifyBudget budget;
  budget.is_share = PyFloat_Check(given.ptr()) != 0;
  const bool is_number = budget.is_share || (PyIndex_Check(given.ptr()) != 0 && !PyBool_Check(given.ptr()));
  if (is_number) budget.value = py::float_(given).cast<double>();
  if (!is_number || !(budget.value >= 0) || (budget.is_share && budget.value > 1)) {
    throw std::invalid_argument(std::string(what) +
                                ": expected a share, a float from 0 to 1, or a number, an int, got " +
                                py::repr(given).cast<std::string>());
  }
  return budget;
}

Small SparsifyGraph(const Graph& graph, const py::object& links, const py::object& poses,
                    std::optional<double> budget_error, const std::string& criterion, const std::string& fixed,
                    const std::string& recovered, bool conservative, bool recentre, std::uint64_t seed, int threads,
                    const py::object& progress) {
  SparsifyOptions options;
  options.links = BudgetFrom(links, "links");
  options.poses = BudgetFrom(poses, "poses");
  options.budget_error = budget_error;
  if (!options.links && !options.poses && !budget_error)
    throw std::invalid_argument("give a budget: links, poses or budget_error");
  options.criterion = FromWord<SparsifyCriterion>(criterion);
  options.fixed = FromWord<FixedEdges>(fixed);
  options.recovered = FromWord<RecoveredFactors>(recovered);
  options.conservative = conservative;
  options.recentre = recentre;
  options.seed = seed;
  options.threads = threads;
  const Interrupter interrupter(progress);
  options.progress = [&](const std::string& task, double share) { return interrupter(task, share); };
  const auto shared = graph.Share();
  return std::visit(
      [&](const auto& g) {
        using Pose = std::decay_t<decltype(*g.Poses().front().T_world_body)>;
        const py::gil_scoped_release release;
        return Small{std::make_shared<const Sparsified<Pose>>(Sparsify(g, options))};
      },
      *shared);
}

// Of one number for each item of a list.
template <class T, class List, class Of>
py::array_t<T> Each(const List& list, const Of& of) {
  py::array_t<T> out(static_cast<py::ssize_t>(list.size()));
  T* to = out.mutable_data();
  for (const auto& item : list) *to++ = of(item);
  return out;
}
template <class T, class Of>
auto EachLink(const Of& of) {
  return [of](const Small& s) { return Visit(s, [&](const auto& r) { return Each<T>(r.links, of); }); };
}
template <class T, class Of>
auto EachPoint(const Of& of) {
  return [of](const Small& s) { return Visit(s, [&](const auto& r) { return Each<T>(r.course, of); }); };
}
template <class T, class Of>
auto EachDropped(const Of& of) {
  return [of](const Small& s) { return Visit(s, [&](const auto& r) { return Each<T>(r.dropped, of); }); };
}
template <class Of>
auto Value(const Of& of) {
  return [of](const Small& s) { return Visit(s, of); };
}

std::string Text(const Small& small) {
  return Visit(small, [](const auto& r) {
    const auto kept = std::count_if(r.links.begin(), r.links.end(), [](const auto& link) { return link.kept; });
    return "<terse.Sparsified: " + std::to_string(r.graph.Poses().size()) + " of " +
           Counted(r.T_world_body.size(), "pose") + ", " + std::to_string(kept) + " of " +
           Counted(r.links.size(), "link") + ", expected error " + SixDigits(r.expected_error) + " m>";
  });
}

using SmallType = py::class_<Small>;

void BindWhatIsLeft(SmallType& type) {
  type.def_property_readonly(
          "dimension", [](const Small& s) { return DimensionOf(s.result); }, "2 or 3.")
      .def_property_readonly("graph", Value([](const auto& r) { return Graph(r.graph); }),
                             "PoseGraph: the kept poses and factors with the original ids, at the optimum. A copy.")
      .def_property_readonly("map", Value([](const auto& r) {
                               return std::make_shared<CompactMapFile>(CompactMapFile{r.map, Strategy::kBounded, {}});
                             }),
                             "CompactMap: the same and the dropped poses, with where everything comes from. A copy.")
      .def_property_readonly("poses", Value([](const auto& r) { return ArrayOf(r.T_world_body); }),
                             "(n, 3) or (n, 7): T_world_body of all poses, dropped ones too, in the order of the "
                             "graph that came, where the kept links have them. A copy.")
      .def_property_readonly("poses_whole", Value([](const auto& r) { return ArrayOf(r.T_world_body_whole); }),
                             "The same at the optimum of the graph that came.")
      .def("__repr__", &Text);
}

void BindLinks(SmallType& type) {
  type.def_property_readonly("link_ids", EachLink<std::int64_t>([](const auto& link) { return link.id.value; }),
                             "(m,) int64: factor ids of the links that the budget was for, in order of arrival.")
      .def_property_readonly("link_from_ids", EachLink<std::int64_t>([](const auto& link) { return link.from.value; }),
                             "(m,) int64: the pose that each link comes from.")
      .def_property_readonly("link_to_ids", EachLink<std::int64_t>([](const auto& link) { return link.to.value; }),
                             "(m,) int64: the pose that each link goes to.")
      .def_property_readonly("link_kept", EachLink<bool>([](const auto& link) { return link.kept; }),
                             "(m,) bool: whether a link is kept.")
      .def_property_readonly(
          "link_worth", EachLink<double>([](const auto& link) { return link.worth; }),
          "(m,): what a link told at its choice, or would tell beside those kept: square metres off the sum of squared "
          "position errors, to about a fifth ('position'), nats ('information'), else 0.")
      .def_property_readonly("course_links", EachPoint<std::int64_t>([](const auto& point) { return point.links; }),
                             "(k,) int64, ascending: numbers of links on the way to the choice,")
      .def_property_readonly("course_errors", EachPoint<double>([](const auto& point) { return point.expected_error; }),
                             "(k,): and the expected position error with each, metres.")
      .def_property_readonly("exchanges", Value([](const auto& r) { return r.exchanges; }),
                             "Links exchanged at the end.")
      .def_property_readonly("dropped_ids", EachDropped<std::int64_t>([](const auto& pose) { return pose.id.value; }),
                             "(d,) int64: dropped poses, in the order in which they went.")
      .def_property_readonly("dropped_losses", EachDropped<double>([](const auto& pose) { return pose.loss; }),
                             "(d,): what each lost, nats: the divergence of the exact marginal from what replaced it.");
}

void BindFigures(SmallType& type) {
  type.def_property_readonly(
          "expected_error", Value([](const auto& r) { return r.expected_error; }),
          "Root mean square position error over all poses after the best rigid alignment, metres, as "
          "the information of the kept links has it.")
      .def_property_readonly("expected_error_whole", Value([](const auto& r) { return r.expected_error_whole; }),
                             "The same of all links.")
      .def_property_readonly("log_det_lost", Value([](const auto& r) { return r.log_det_lost; }),
                             "Of the information, nats, by the links left out.")
      .def_property_readonly(
          "divergence", Value([](const auto& r) { return r.divergence; }),
          "Of the exact marginal of the kept poses, with the kept links, from what graph says, nats.")
      .def_property_readonly("chi2", Value([](const auto& r) { return r.chi2; }), "At the optimum of graph.")
      .def_property_readonly("chi2_whole", Value([](const auto& r) { return r.chi2_whole; }),
                             "At the optimum of the graph that came.");
}

}  // namespace

void BindSparsify(py::module_& module) {
  SmallType type(module, "Sparsified", "A graph made small, and what that cost.");
  BindWhatIsLeft(type);
  BindLinks(type);
  BindFigures(type);
  module.def(
      "sparsify", &SparsifyGraph, py::arg("graph"), py::kw_only(), py::arg("links") = py::none(),
      py::arg("poses") = py::none(), py::arg("budget_error") = py::none(), py::arg("criterion") = "position",
      py::arg("fixed") = "odometry", py::arg("recovered") = "subgraph", py::arg("conservative") = false,
      py::arg("recentre") = false, py::arg("seed") = 1, py::arg("threads") = 1, py::arg("progress") = py::none(),
      "Makes a finished PoseGraph, which is not changed, small (Sparsified).\n\n"
      "links, poses: to keep; a float is a share from 0 to 1, an int a number. budget_error: instead of links, as few "
      "as leave the expected position error within this factor of the whole graph's. One of them is needed.\n"
      "criterion: links are kept that lower the expected position error most ('position'), that raise the "
      "log-determinant of the information most ('information'), that make the graph well connected ('connectivity', "
      "as MAC), or at random ('random').\n"
      "fixed: edges kept in any case: 'odometry', 'tree' (a spanning tree of the most informative ones) or 'none' (as "
      "many as hold the poses).\n"
      "recovered: the factors that replace those of a dropped pose: 'tree', 'subgraph' or 'dense'; conservative: they "
      "never say more than the exact marginal.\n"
      "recentre: every kept measurement is replaced by what the optimum of the whole graph says in its place.\n"
      "seed: of 'random' and 'connectivity'. The result is the same for any number of threads.\n"
      "progress: called with what is being done and the share that is done; returns False to give up (RuntimeError). "
      "Without the GIL.");
}

}  // namespace terse::python
