// A stored graph as the source of a compact run, and thresholds from a sample of it.

#include <pybind11/stl.h>

#include "bindings.h"
#include "names.h"
#include "pickling.h"
#include "state_members.h"
#include "terse/compact/random_choice.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

template <class Pose>
Pose OriginOf(const std::shared_ptr<GraphReplay<Pose>>&) {
  return Pose();
}

Replay MakeReplay(const Graph& graph, const py::object& seen) {
  const auto shared = graph.Share();
  const std::vector<PoseId> before = seen.is_none() ? std::vector<PoseId>() : IdsFrom(seen);
  return std::visit(
      [&](const auto& g) {
        using Pose = typename std::decay_t<decltype(g.Poses()[0].T_world_body)>::value_type;
        const py::gil_scoped_release release;
        return Replay{before.empty() ? std::make_shared<GraphReplay<Pose>>(g)
                                     : std::make_shared<GraphReplay<Pose>>(g, before)};
      },
      *shared);
}

template <class Pose>
Input InputOf(const CompactInput<Pose>& from) {
  Input to;
  to.id = from.id.value;
  if (from.odometry) to.odometry = py::cast(RelativePose{*from.odometry});
  if (from.T_world_body) to.T_world_body = Array(ArrayOf(*from.T_world_body));
  to.fixed = from.fixed;
  py::list priors;
  for (const auto& prior : from.priors) priors.append(ObjectOf<Pose>(prior));
  to.priors = priors;
  if (from.loops) {
    py::list loops;
    for (const auto& loop : *from.loops) loops.append(py::cast(RelativePose{loop}));
    to.loops = loops;
  }
  if (from.linkable) {
    to.linkable.emplace();
    for (const PoseId id : *from.linkable) to.linkable->push_back(id.value);
  }
  to.drawn = from.keep;
  return to;
}

Input InputAt(const Replay& replay, py::ssize_t at) {
  return std::visit(
      [&](const auto& held) {
        const auto n = static_cast<py::ssize_t>(held->Inputs().size());
        if (at < 0) at += n;
        if (at < 0 || at >= n) throw py::index_error("a replay of " + std::to_string(n) + " poses");
        return InputOf(held->Inputs()[static_cast<std::size_t>(at)]);
      },
      replay.replay);
}

py::object Register(const Replay& replay, std::int64_t candidate, std::int64_t current) {
  const Lock lock(*replay.guard, Lock::kReading);
  return std::visit(
      [&](const auto& held) -> py::object {
        const auto link = held->AsRegistration()(PoseId{candidate}, PoseId{current});
        return link ? py::cast(RelativePose{*link}) : py::none();
      },
      replay.replay);
}

std::string DescribeInput(const Input& input) {
  // What was given as an iterator is not counted: that would use it up.
  const auto counted = [](const py::object& list, const std::string& thing) {
    return py::hasattr(list, "__len__") ? Counted(py::len(list), thing) : thing + "s";
  };
  std::string text = "<terse.CompactInput " + std::to_string(input.id) + ": ";
  text += input.odometry.is_none() ? "no odometry" : "odometry";
  if (!input.loops.is_none()) text += ", " + counted(input.loops, "loop");
  if (!py::hasattr(input.priors, "__len__") || py::len(input.priors) > 0) text += ", " + counted(input.priors, "prior");
  return text + (input.fixed ? ", fixed>" : ">");
}

void BindInput(py::module_& module) {
  py::class_<Input>(module, "CompactInput",
                    "A pose as it arrives, with its measurements: CompactPoseSlam.add takes it.")
      .def(py::init([](std::int64_t id, py::object odometry, std::optional<Array> T, bool fixed, py::object priors,
                       std::optional<std::vector<std::int64_t>> linkable, py::object loops, bool drawn) {
             return Input{id,
                          std::move(odometry),
                          std::move(T),
                          fixed,
                          std::move(priors),
                          std::move(linkable),
                          std::move(loops),
                          drawn};
           }),
           py::arg("pose_id"), py::arg("odometry") = py::none(), py::kw_only(), py::arg("T_world_body") = py::none(),
           py::arg("fixed") = false, py::arg("priors") = py::tuple(), py::arg("linkable") = py::none(),
           py::arg("loops") = py::none(), py::arg("drawn") = false,
           "Arguments as the attributes; CompactPoseSlam.add_pose says what they are.")
      .def_readwrite("pose_id", &Input::id, "Id of the pose.")
      .def_readwrite("odometry", &Input::odometry, "RelativePose to an earlier pose; None for the first one.")
      .def_readwrite("T_world_body", &Input::T_world_body, "(3,) or (7,) or None: where the first or a fixed pose is.")
      .def_readwrite("fixed", &Input::fixed, "Keep it, anchored at T_world_body.")
      .def_readwrite("priors", &Input::priors, "PosePrior and PositionPrior objects on this pose.")
      .def_readwrite("linkable", &Input::linkable, "Ids of poses that can be linked, if known ('apal' and 'rfpfl').")
      .def_readwrite("loops", &Input::loops,
                     "RelativePose objects measured already, to earlier poses, kept or dropped: nothing else is "
                     "registered then. Or None.")
      .def_readwrite("drawn", &Input::drawn, "'rfpfl': keep it.")
      .def("__repr__", &DescribeInput)
      .def(py::pickle(
          [](const Input& i) {
            return py::make_tuple(i.id, i.odometry, i.T_world_body, i.fixed, i.priors, i.linkable, i.loops, i.drawn);
          },
          [](const py::tuple& s) {
            return Input{s[0].cast<std::int64_t>(),
                         s[1],
                         s[2].cast<std::optional<Array>>(),
                         s[3].cast<bool>(),
                         s[4],
                         s[5].cast<std::optional<std::vector<std::int64_t>>>(),
                         s[6],
                         s[7].cast<bool>()};
          }));
}

void BindGraphReplay(py::module_& module) {
  py::class_<Replay, std::shared_ptr<Replay>>(
      module, "GraphReplay",
      "A stored PoseGraph as a run: its poses in order of arrival (a sequence of CompactInput) with their loops. It is "
      "also a registration, for inputs without loops: then each edge is given once, so one replay serves one run.")
      .def(py::init(&MakeReplay), py::arg("graph"), py::arg("seen") = py::none(),
           "seen: ids of poses that a run has seen before, in order of arrival (CompactMap.ids): those poses, their "
           "priors and the edges among them are left out. ValueError if the graph is empty or not connected, or if no "
           "edges join its new poses to those seen.")
      .def_property_readonly(
          "dimension", [](const Replay& r) { return DimensionOf(r.replay); }, "2 or 3.")
      .def("__len__",
           [](const Replay& r) { return std::visit([](auto& held) { return held->Inputs().size(); }, r.replay); })
      .def("__iter__", &IterateSequence)
      .def("__getitem__", &InputAt, py::arg("index"), "A pose with its measurements (CompactInput).")
      .def("__call__", &Register, py::arg("candidate_id"), py::arg("current_id"),
           "The edge between two poses (RelativePose), or None: a registration callback.")
      .def_property_readonly(
          "links_offered",
          [](const Replay& r) { return std::visit([](auto& held) { return held->LinksOffered(); }, r.replay); },
          "Edges beside the odometry.")
      .def(
          "draw_at_random",
          [](const Replay& r, int poses, int links, std::uint64_t seed) {
            const Lock lock(*r.guard, Lock::kChanging);
            std::visit([&](auto& held) { DrawAtRandom(*held, poses, links, seed); }, r.replay);
          },
          py::arg("poses"), py::arg("links"), py::arg("seed") = 1,
          "For strategy 'rfpfl': draws so many poses and links. Same seed, same choice.")
      .def(
          "link_range",
          [](const Replay& r) {
            return std::visit([](auto& held) { return ArrayOfVector(held->LinkRange()); }, r.replay);
          },
          "A sensor range that covers the links but for the longest of every hundred, as CompactOptions.range.")
      .def(
          "link_covariance",
          [](const Replay& r) {
            return std::visit([](auto& held) { return ArrayOfMatrix(held->LinkCovariance()); }, r.replay);
          },
          "(d, d): mean covariance of the links, as CompactOptions.link_covariance.")
      .def("__repr__", [](const Replay& r) {
        return std::visit(
            [&](auto& held) {
              return "<terse.GraphReplay: " + DimensionText(DimensionOf(r.replay)) + ", " +
                     Counted(held->Inputs().size(), "pose") + ", " + Counted(held->LinksOffered(), "link") +
                     " offered>";
            },
            r.replay);
      });
}

ChosenThresholds Select(const Graph& graph, double probability, double share, long most_poses, const std::string& angle,
                        const std::optional<Array>& view_axis, const std::string& strategy,
                        std::optional<double> innovation_quantile, const py::object& progress) {
  const Interrupter interrupter(progress);
  SampleOptions options;
  options.probability = probability;
  options.share = share;
  options.most_poses = most_poses;
  options.distance.angle = FromWord<AngleMeasure>(angle);
  if (view_axis) {
    if (view_axis->ndim() != 1 || view_axis->shape(0) != 3)
      throw std::invalid_argument("view_axis: expected shape (3,)");
    options.distance.view_axis = Eigen::Map<const Vector<3>>(view_axis->data());
  }
  options.strategy = FromWord<Strategy>(strategy);
  options.innovation_quantile = innovation_quantile;
  options.progress = [&](long done, long total) { interrupter(done, total); };
  const auto shared = graph.Share();
  const py::gil_scoped_release release;
  return std::visit([&](const auto& g) { return ChosenThresholds{SelectThresholds(g, options)}; }, *shared);
}

template <class F>
decltype(auto) Visit(const ChosenThresholds& chosen, const F& f) {
  return std::visit(f, chosen.thresholds);
}

template <class Pose>
CompactOptions<Pose> OptionsWith(const Thresholds<Pose>& thresholds) {
  CompactOptions<Pose> options;
  options.thresholds = thresholds;
  return options;
}

std::shared_ptr<CompactSettings> OptionsOf(const ChosenThresholds& chosen, const py::kwargs& keywords) {
  const auto settings = Visit(chosen, [](const auto& sampled) {
    return std::make_shared<CompactSettings>(CompactSettings{OptionsWith(sampled.thresholds)});
  });
  SetAttributes(py::cast(settings), keywords);
  return settings;
}

void BindThresholds(py::module_& module) {
  using T = ChosenThresholds;
  py::class_<T>(module, "Thresholds", "Thresholds of compact pose SLAM, chosen from a sample of a run.")
      .def_property_readonly(
          "dimension", [](const T& c) { return DimensionOf(c.thresholds); }, "2 or 3.")
      .def_property_readonly(
          "range", [](const T& c) { return Visit(c, [](auto& t) { return ArrayOfVector(t.thresholds.range); }); },
          "Sensor range [x, y, angle] or [x, y, z, angle], metres and radians. A copy.")
      .def_property_readonly(
          "probability", [](const T& c) { return Visit(c, [](auto& t) { return t.thresholds.probability; }); },
          "Of being in range.")
      .def_property_readonly(
          "min_loop_gain", [](const T& c) { return Visit(c, [](auto& t) { return t.thresholds.min_loop_gain; }); },
          "Nats.")
      .def_property_readonly(
          "min_pose_gain", [](const T& c) { return Visit(c, [](auto& t) { return t.thresholds.min_pose_gain; }); },
          "Nats.")
      .def_property_readonly(
          "link_covariance",
          [](const T& c) { return Visit(c, [](auto& t) { return ArrayOfMatrix(t.thresholds.link_covariance); }); },
          "(d, d): mean of the graph's links; tangent order [translation, rotation], body frame. A copy.")
      .def_property_readonly(
          "loop_gain_90", [](const T& c) { return Visit(c, [](auto& t) { return t.loop_gain_90; }); },
          "90th percentile of the links' gains in the sample, nats.")
      .def_property_readonly(
          "pose_gain_90", [](const T& c) { return Visit(c, [](auto& t) { return t.pose_gain_90; }); },
          "90th percentile of the poses' gains in the sample, nats.")
      .def_property_readonly(
          "sample_poses", [](const T& c) { return Visit(c, [](auto& t) { return t.sample_poses; }); },
          "Poses in the sample.")
      .def("options", &OptionsOf,
           "CompactOptions with these thresholds; any of its attributes can be given by keyword.")
      .def("__repr__",
           [](const T& c) {
             return Visit(c, [](auto& t) {
               return "<terse.Thresholds: range " + NumbersText(t.thresholds.range) + ", loop gain " +
                      SixDigits(t.thresholds.min_loop_gain) + " nats, pose gain " +
                      SixDigits(t.thresholds.min_pose_gain) + " nats>";
             });
           })
      .def(PickleOf<T>(
          "pickle Thresholds", [](const T& c) { return c.thresholds; },
          [](Either<SampledThresholds> thresholds) { return ChosenThresholds{std::move(thresholds)}; }));
  module.def(
      "select_thresholds", &Select, py::arg("graph"), py::kw_only(), py::arg("probability") = 0.1,
      py::arg("share") = 0.6, py::arg("most_poses") = 200, py::arg("angle") = "view", py::arg("view_axis") = py::none(),
      py::arg("strategy") = WordOf(SampleOptions().strategy), py::arg("innovation_quantile") = py::none(),
      py::arg("progress") = py::none(),
      "Chooses the thresholds of compact pose SLAM from poses spread over a PoseGraph (Thresholds).\n\n"
      "share, most_poses: the sample, a share of the poses but no more than so many.\n"
      "angle, view_axis: as in CompactOptions. strategy: that the thresholds are for; Thresholds.options() is told "
      "of another than 'bounded' too. innovation_quantile: leave out loops that the innovation test would "
      "refuse "
      "at this quantile; None takes all for true.\n"
      "progress: called with (done, total). ValueError if the graph is empty or not connected. Without the GIL.");
}

}  // namespace

void BindReplay(py::module_& module) {
  BindInput(module);
  BindGraphReplay(module);
  BindThresholds(module);
}

}  // namespace terse::python
