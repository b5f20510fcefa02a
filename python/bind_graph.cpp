// PoseGraph: one class for both dimensions.

#include <pybind11/stl.h>

#include <limits>

#include "bindings.h"
#include "pickling.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

// Edges of a graph as arrays.
struct Edges {
  py::object factor_ids, from_ids, to_ids, T_from_to, information;
  std::shared_ptr<const AnyPoseGraph> graph;
};

template <class F>
decltype(auto) Visit(const Graph& graph, F&& f) {
  return std::visit(f, graph.Get());
}

// The pose type of a graph.
template <class G>
struct PoseOfGraph;
template <class Pose>
struct PoseOfGraph<PoseGraph<Pose>> {
  using Type = Pose;
};
template <class G>
using PoseOf = typename PoseOfGraph<std::decay_t<G>>::Type;

Graph MakeGraph(int dimension) {
  return ForDimension(dimension, [](auto origin) { return Graph(PoseGraph<decltype(origin)>()); });
}

void AddPose(Graph& graph, std::int64_t id, const std::optional<Array>& T, bool fixed) {
  std::visit(
      [&](auto& g) {
        using Pose = PoseOf<decltype(g)>;
        std::optional<Pose> value;
        if (T) value = PoseFrom<Pose>(*T, "T_world_body");
        if (fixed && !value) throw std::invalid_argument("a fixed pose needs a value");
        g.AddPose(PoseId{id}, value);
        if (fixed) g.SetFixed(PoseId{id}, true);
      },
      graph.Change());
}

// All or none: the graph is copied where that is not sure beforehand.
void AddPoses(Graph& graph, const py::object& ids, const std::optional<Array>& T) {
  const std::vector<PoseId> list = IdsFrom(ids);
  std::visit(
      [&](auto& g) {
        using Pose = PoseOf<decltype(g)>;
        std::vector<Pose> values;
        if (T) values = PosesFrom<Pose>(*T, "T_world_body");
        if (T && values.size() != list.size()) throw std::invalid_argument("as many poses as ids are needed");
        auto grown = g;
        for (std::size_t k = 0; k < list.size(); ++k) {
          grown.AddPose(list[k], T ? std::optional<Pose>(values[k]) : std::nullopt);
        }
        g = std::move(grown);
      },
      graph.Change());
}

void SetPoses(Graph& graph, const Array& T) {
  std::visit(
      [&](auto& g) {
        using Pose = PoseOf<decltype(g)>;
        g.SetPoses(PosesFrom<Pose>(T, "T_world_body"));
      },
      graph.Change());
}

py::array PosesOfGraph(const Graph& graph) {
  return Visit(graph, [](const auto& g) -> py::array {
    using Pose = PoseOf<decltype(g)>;
    py::array_t<double> out({static_cast<py::ssize_t>(g.Poses().size()), static_cast<py::ssize_t>(kRow<Pose>)});
    double* row = out.mutable_data();
    for (const auto& pose : g.Poses()) {
      std::fill_n(row, kRow<Pose>, std::numeric_limits<double>::quiet_NaN());
      if (pose.T_world_body) WritePose(*pose.T_world_body, row);
      row += kRow<Pose>;
    }
    return std::move(out);
  });
}

py::array_t<bool> FixedOf(const Graph& graph) {
  return Visit(graph, [](const auto& g) {
    py::array_t<bool> out(static_cast<py::ssize_t>(g.Poses().size()));
    bool* to = out.mutable_data();
    for (const auto& pose : g.Poses()) *to++ = pose.fixed;
    return out;
  });
}

std::int64_t AddFactor(Graph& graph, py::handle factor) {
  return std::visit([&](auto& g) { return g.AddFactor(FactorFrom<PoseOf<decltype(g)>>(factor)).value; },
                    graph.Change());
}

Ids AddEdges(Graph& graph, const py::object& from_ids, const py::object& to_ids, const Array& T,
             const std::optional<Array>& information, const std::optional<Array>& covariance) {
  const std::vector<PoseId> from = IdsFrom(from_ids), to = IdsFrom(to_ids);
  return std::visit(
      [&](auto& g) {
        using Pose = PoseOf<decltype(g)>;
        const std::vector<Pose> measured = PosesFrom<Pose>(T, "T_from_to");
        if (from.size() != measured.size() || to.size() != measured.size()) {
          throw std::invalid_argument("from_ids, to_ids and T_from_to are not of the same length");
        }
        const auto omega = InformationsFrom<Pose::kDof>(information, covariance, measured.size());
        auto grown = g;
        std::vector<FactorId> ids;
        for (std::size_t k = 0; k < measured.size(); ++k) {
          try {
            ids.push_back(grown.AddFactor(RelativePoseFactor<Pose>{from[k], to[k], measured[k], omega[k]}));
          } catch (const std::invalid_argument& e) {
            throw std::invalid_argument("edge " + std::to_string(k) + ": " + e.what());
          }
        }
        g = std::move(grown);
        return ArrayOfIds(ids);
      },
      graph.Change());
}

Edges EdgesOf(const Graph& graph) {
  return Visit(graph, [&](const auto& g) {
    using Pose = PoseOf<decltype(g)>;
    std::vector<FactorId> ids;
    std::vector<PoseId> from, to;
    std::vector<Pose> T;
    std::vector<typename Pose::Jacobian> information;
    for (const auto& node : g.Factors()) {
      const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
      if (edge == nullptr) continue;
      ids.push_back(node.id);
      from.push_back(edge->from);
      to.push_back(edge->to);
      T.push_back(edge->T_from_to);
      information.push_back(edge->information);
    }
    return Edges{
        ArrayOfIds(ids), ArrayOfIds(from), ArrayOfIds(to), ArrayOf(T), ArrayOwning<Pose::kDof>(std::move(information)),
        graph.Share()};
  });
}

py::dict PriorsOf(const Graph& graph) {
  return Visit(graph, [](const auto& g) {
    using Pose = PoseOf<decltype(g)>;
    py::dict out;
    for (const auto& node : g.Factors()) {
      if (std::holds_alternative<RelativePoseFactor<Pose>>(node.factor)) continue;
      out[py::int_(node.id.value)] = ObjectOf<Pose>(node.factor);
    }
    return out;
  });
}

py::dict FactorsOf(const Graph& graph) {
  return Visit(graph, [](const auto& g) {
    py::dict out;
    for (const auto& node : g.Factors()) out[py::int_(node.id.value)] = ObjectOf<PoseOf<decltype(g)>>(node.factor);
    return out;
  });
}

// None if it has no value.
template <class Node>
py::object ValueOf(const Node& pose) {
  return pose.T_world_body ? py::object(ArrayOf(*pose.T_world_body)) : py::object(py::none());
}

py::object PoseAt(const Graph& graph, std::int64_t id) {
  return Visit(graph, [&](const auto& g) {
    if (!g.HasPose(PoseId{id})) throw py::key_error("pose " + std::to_string(id) + " is not in the graph");
    return ValueOf(g.Poses()[static_cast<std::size_t>(g.IndexOf(PoseId{id}))]);
  });
}

// As of a dict from ids to poses.
py::list ItemsOf(const Graph& graph) {
  return Visit(graph, [](const auto& g) {
    py::list out;
    for (const auto& pose : g.Poses()) out.append(py::make_tuple(pose.id.value, ValueOf(pose)));
    return out;
  });
}

py::object FactorOf(const Graph& graph, std::int64_t id) {
  return Visit(graph, [&](const auto& g) {
    const auto* node = g.FindFactor(FactorId{id});
    if (node == nullptr) throw std::invalid_argument("there is no factor " + std::to_string(id));
    return ObjectOf<PoseOf<decltype(g)>>(node->factor);
  });
}

std::string Describe(const Graph& graph) {
  return Visit(graph, [&](const auto& g) {
    return "<terse.PoseGraph: " + std::to_string(graph.Dimension()) + "D, " + std::to_string(g.Poses().size()) +
           " poses, " + std::to_string(g.Factors().size()) + " factors>";
  });
}

void BindPoses(py::class_<Graph>& type) {
  type.def_property_readonly("dimension", &Graph::Dimension, "2 or 3.")
      .def_property_readonly(
          "ids", [](const Graph& g) { return IdsOf(g.Get()); }, "(n,) int64: pose ids in order of insertion. A copy.")
      .def_property_readonly(
          "poses", &PosesOfGraph,
          "(n, 3) [x, y, theta] or (n, 7) [x, y, z, qx, qy, qz, qw]: T_world_body in the order of ids, "
          "metres and radians; NaN where a pose has no value. A copy; set_poses writes.")
      .def_property_readonly("fixed", &FixedOf, "(n,) bool: poses that are anchored at their values. A copy.")
      .def("__len__", [](const Graph& g) { return Visit(g, [](auto& any) { return any.Poses().size(); }); })
      .def("__contains__",
           [](const Graph& g, std::int64_t id) { return Visit(g, [&](auto& any) { return any.HasPose(PoseId{id}); }); })
      .def("__iter__", [](const Graph& g) { return py::iter(IdsOf(g.Get()).attr("tolist")()); })
      .def("__getitem__", &PoseAt, py::arg("pose_id"),
           "T_world_body of a pose, (3,) or (7,), None if it has no value. A copy. KeyError if it is unknown.")
      .def("items", &ItemsOf,
           "List of (pose id, T_world_body or None) in order of insertion; iterating over the graph gives the ids.")
      .def(
          "index_of",
          [](const Graph& g, std::int64_t id) { return Visit(g, [&](auto& any) { return any.IndexOf(PoseId{id}); }); },
          py::arg("pose_id"), "The row of a pose in ids and poses. ValueError if it is unknown.")
      .def("add_pose", &AddPose, py::arg("pose_id"), py::arg("T_world_body") = py::none(), py::kw_only(),
           py::arg("fixed") = false,
           "Adds a pose. T_world_body: [x, y, theta] or (3, 3) in the plane, [x, y, z, qx, qy, qz, qw] or (4, 4) in "
           "space; "
           "None leaves it to the initial values of solve. A fixed one is anchored at its value.")
      .def("add_poses", &AddPoses, py::arg("ids"), py::arg("T_world_body") = py::none(),
           "Adds poses, all or none. ids: (n,) whole numbers; T_world_body: (n, 3), (n, 3, 3), (n, 7) or (n, 4, 4).")
      .def(
          "set_pose",
          [](Graph& g, std::int64_t id, const Array& T) {
            std::visit([&](auto& any) { any.SetPose(PoseId{id}, PoseFrom<PoseOf<decltype(any)>>(T, "T_world_body")); },
                       g.Change());
          },
          py::arg("pose_id"), py::arg("T_world_body"), "Gives a pose a value: (3,), (3, 3), (7,) or (4, 4).")
      .def("set_poses", &SetPoses, py::arg("T_world_body"),
           "Gives all poses values, in the order of ids: (n, 3), (n, 3, 3), (n, 7) or (n, 4, 4).")
      .def(
          "set_fixed",
          [](Graph& g, std::int64_t id, bool fixed) {
            std::visit([&](auto& any) { any.SetFixed(PoseId{id}, fixed); }, g.Change());
          },
          py::arg("pose_id"), py::arg("fixed") = true, "Anchors a pose at its value, or lets it go.");
}

void BindMeasurements(py::class_<Graph>& type) {
  type.def("add_factor", &AddFactor, py::arg("factor"),
           "Adds a RelativePose, PosePrior or PositionPrior; returns its id. ValueError, and no change, if a pose is "
           "unknown or the information is not positive definite.")
      .def("add_edges", &AddEdges, py::arg("from_ids"), py::arg("to_ids"), py::arg("T_from_to"), py::kw_only(),
           py::arg("information") = py::none(), py::arg("covariance") = py::none(),
           "Adds relative poses, all or none; returns their ids, (m,).\n\n"
           "from_ids, to_ids: (m,). T_from_to: (m, 3), (m, 3, 3), (m, 7) or (m, 4, 4), metres and radians.\n"
           "information, covariance: exactly one of them; (m, d, d), or (d, d) or a diagonal (d,) for all, d = 3 or 6; "
           "tangent order [translation, rotation], in the body frame of to_ids.")
      .def(
          "remove_factor",
          [](Graph& g, std::int64_t id) {
            return std::visit([&](auto& any) { return any.RemoveFactor(FactorId{id}); }, g.Change());
          },
          py::arg("factor_id"), "Takes a measurement out. False if there is none of this id (any more).")
      .def("factor", &FactorOf, py::arg("factor_id"), "The measurement of this id. ValueError if there is none.")
      .def_property_readonly(
          "num_factors", [](const Graph& g) { return Visit(g, [](auto& any) { return any.Factors().size(); }); },
          "How many measurements there are, priors included.")
      .def("edges", &EdgesOf, "All relative poses as arrays, in order of arrival (Edges). Copies.")
      .def("factors", &FactorsOf, "All measurements by factor id, in order of arrival: a dict. Copies.")
      .def("priors", &PriorsOf, "All pose and position priors by factor id, in order of arrival. Copies.")
      .def(
          "chi2", [](const Graph& g) { return Visit(g, [](auto& any) { return Chi2(any); }); },
          "Sum of r' Omega r over all measurements at the poses' values, without 1/2. ValueError if a pose has none.")
      .def(
          "components",
          [](const Graph& g) {
            return Visit(g, [](auto& any) {
              py::list out;
              for (const auto& part : ConnectedComponents(any)) {
                std::vector<PoseId> ids;
                for (const int k : part) ids.push_back(any.Poses()[static_cast<std::size_t>(k)].id);
                out.append(ArrayOfIds(ids));
              }
              return out;
            });
          },
          "The connected parts, largest first: a list of arrays of pose ids.");
}

RelativePose EdgeAt(const Edges& edges, py::ssize_t at) {
  const auto n = static_cast<py::ssize_t>(py::len(edges.factor_ids));
  if (at < 0) at += n;
  if (at < 0 || at >= n) throw py::index_error(Counted(n, "edge"));
  return std::visit(
      [&](const auto& g) {
        return RelativePose{std::get<RelativePoseFactor<PoseOf<decltype(g)>>>(
            g.FindFactor(FactorId{edges.factor_ids.attr("item")(at).template cast<std::int64_t>()})->factor)};
      },
      *edges.graph);
}

void BindEdges(py::module_& module) {
  py::class_<Edges>(module, "Edges",
                    "Relative poses of a graph as arrays of the same length m, which own their memory; and one by one, "
                    "as a sequence of RelativePose.")
      .def_readonly("factor_ids", &Edges::factor_ids, "(m,) int64.")
      .def_readonly("from_ids", &Edges::from_ids, "(m,) int64: poses that are seen from.")
      .def_readonly("to_ids", &Edges::to_ids, "(m,) int64: poses that are seen.")
      .def_readonly("T_from_to", &Edges::T_from_to, "(m, 3) or (m, 7): measurements, metres and radians.")
      .def_readonly("information", &Edges::information,
                    "(m, d, d), d = 3 or 6; tangent order [translation, rotation], body frame of to_ids.")
      .def("__len__", [](const Edges& e) { return py::len(e.factor_ids); })
      .def("__iter__", &IterateSequence)
      .def("__getitem__", &EdgeAt, py::arg("index"), "An edge as it is in the graph (RelativePose). A copy.")
      .def("__repr__",
           [](const Edges& e) {
             return "<terse.Edges: " + DimensionText(DimensionOf(*e.graph)) + ", " +
                    Counted(py::len(e.factor_ids), "relative pose") + ">";
           })
      .def(PickleOf<Edges>(
          "pickle Edges", [](const Edges& e) -> const AnyPoseGraph& { return *e.graph; },
          [](AnyPoseGraph graph) { return EdgesOf(Graph(std::move(graph))); }));
}

}  // namespace

Ids IdsOf(const AnyPoseGraph& graph) {
  return std::visit(
      [](const auto& g) {
        Ids out(static_cast<py::ssize_t>(g.Poses().size()));
        std::int64_t* to = out.mutable_data();
        for (const auto& pose : g.Poses()) *to++ = pose.id.value;
        return out;
      },
      graph);
}

void BindGraph(py::module_& module) {
  BindEdges(module);
  py::class_<Graph> type(
      module, "PoseGraph",
      "Poses and measurements, in the plane (dimension 2) or in space (3).\n\n"
      "Poses have ids of the user's choice and keep their order of insertion; measurements get ids from "
      "the graph. Poses are T_world_body, metres and radians: rows [x, y, theta] or [x, y, z, qx, qy, qz, "
      "qw]. Information matrices are in the tangent order [translation, rotation], perturbation on the "
      "right, body frame. A failed call changes nothing.");
  type.def(py::init(&MakeGraph), py::arg("dimension"), "An empty graph; dimension: 2 or 3.");
  BindPoses(type);
  BindMeasurements(type);
  type.def(
          "copy", [](const Graph& g) { return Graph(g); }, "A copy; memory is shared until one of the two changes.")
      .def("__copy__", [](const Graph& g) { return Graph(g); })
      .def(
          "__deepcopy__", [](const Graph& g, const py::dict&) { return Graph(g); }, py::arg("memo"))
      .def("__repr__", &Describe)
      .def(PickleOf<Graph>(
          "pickle PoseGraph", [](const Graph& g) -> const AnyPoseGraph& { return g.Get(); },
          [](AnyPoseGraph graph) { return Graph(std::move(graph)); }));
}

}  // namespace terse::python
