// A stored graph through compact pose SLAM in one call.

#include <pybind11/stl.h>

#include "bindings.h"
#include "names.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

// CompactRun of the library with objects of this module in it.
struct Compacted {
  Slam slam;
  std::vector<Decision> decisions;
  std::vector<double> step_seconds;
  int links_offered = 0, registrations_tried = 0, links_refused = 0;
  std::vector<RetiredPose> retired;
  Solution solution;
  InformationScale scale;
};

template <class Pose>
Compacted Hold(CompactRun<Pose> run) {
  auto kept = std::make_shared<const AnyPoseGraph>(run.slam.Solver().Graph());
  return {Slam{std::make_shared<CompactPoseSlam<Pose>>(std::move(run.slam))},
          std::move(run.decisions),
          std::move(run.step_seconds),
          run.links_offered,
          run.registrations_tried,
          run.links_refused,
          std::move(run.retired),
          MakeSolution(std::move(run.result), std::move(kept)),
          run.information_scale};
}

template <class Pose>
Pose OriginOf(const PoseGraph<Pose>&) {
  return Pose();
}

Compacted Compact(const Graph& graph, const CompactSettings* options, const std::optional<std::string>& strategy,
                  const py::object& progress) {
  if (options != nullptr && strategy)
    throw std::invalid_argument("give either options, which say the strategy, or strategy");
  const auto chosen = strategy ? FromWord<Strategy>(*strategy) : CompactOptions<SE3>().strategy;
  const Interrupter interrupter(progress);
  const auto shared = graph.Share();
  return std::visit(
      [&](const auto& g) {
        using Pose = decltype(OriginOf(g));
        const auto total = static_cast<long>(g.Poses().size());
        const AfterStep<Pose> after_step = [&](const CompactPoseSlam<Pose>& slam, const Decision&, double) {
          interrupter(static_cast<long>(slam.PosesSeen()), total);
        };
        if (options == nullptr) {
          const py::gil_scoped_release release;
          return Hold(CompactGraph(g, chosen, after_step));
        }
        // A copy: another thread may change the options.
        const auto given = Expect<CompactOptions<Pose>>(options->options, "options");
        const py::gil_scoped_release release;
        return Hold(CompactGraph(g, given, after_step));
      },
      *shared);
}

std::pair<double, double> PairOf(const KindScale& scale) { return {scale.translation, scale.rotation}; }

Graph GraphOf(const Compacted& run) {
  return std::visit(
      [&](const auto& result) {
        using Pose = std::decay_t<decltype(result->T_world_body.front())>;
        return Graph(std::get<PoseGraph<Pose>>(*run.solution.graph).WithPoses(result->T_world_body));
      },
      run.solution.result);
}

std::string Describe(const Compacted& run) {
  return std::visit(
      [&](const auto& slam) {
        return "<terse.CompactRun: " + std::to_string(slam->Solver().Graph().Poses().size()) + " of " +
               Counted(slam->PosesSeen(), "pose") + " and " + std::to_string(slam->LinksKept()) + " of " +
               Counted(run.links_offered, "link") + " kept>";
      },
      run.slam.slam);
}

template <class F>
auto ReadSlam(const Compacted& run, const F& f) {
  const Lock lock(*run.slam.guard, Lock::kReading);
  return std::visit([&](const auto& slam) { return f(*slam); }, run.slam.slam);
}

py::tuple PickledRun(const Compacted& r) {
  return py::make_tuple(r.slam, r.decisions, r.step_seconds, r.links_offered, r.registrations_tried, r.links_refused,
                        r.retired, r.solution, PairOf(r.scale.odometry), PairOf(r.scale.loops));
}

Compacted UnpickledRun(const py::tuple& s) {
  const auto scale = [&](std::size_t k) {
    const auto [translation, rotation] = s[k].cast<std::pair<double, double>>();
    return KindScale{translation, rotation};
  };
  return Compacted{s[0].cast<Slam>(),
                   s[1].cast<std::vector<Decision>>(),
                   s[2].cast<std::vector<double>>(),
                   s[3].cast<int>(),
                   s[4].cast<int>(),
                   s[5].cast<int>(),
                   s[6].cast<std::vector<RetiredPose>>(),
                   s[7].cast<Solution>(),
                   {scale(8), scale(9)}};
}

void BindRun(py::module_& module) {
  py::class_<Compacted> type(module, "CompactRun", "A stored graph after compact pose SLAM (compact).");
  type.def_property_readonly(
          "slam", [](const Compacted& r) { return r.slam; },
          "CompactPoseSlam that has seen the graph; it can go on. Shared, not a copy.")
      .def_readonly("decisions", &Compacted::decisions, "List of Decision, one per pose in order of arrival. A copy.")
      .def_property_readonly(
          "step_seconds",
          [](const Compacted& r) {
            return py::array_t<double>(static_cast<py::ssize_t>(r.step_seconds.size()), r.step_seconds.data());
          },
          "(n,): seconds of each pose's step. A copy.")
      .def_readonly("links_offered", &Compacted::links_offered, "Edges of the graph beside the odometry.")
      .def_readonly("registrations_tried", &Compacted::registrations_tried, "How many of them were tried.")
      .def_readonly("links_refused", &Compacted::links_refused, "How many the innovation test refused.")
      .def_readonly("retired", &Compacted::retired,
                    "List of RetiredPose, those that retired behind the last decision; Decision.retired has the "
                    "others. A copy.")
      .def_readonly("solution", &Compacted::solution, "Solution of the kept graph.")
      .def_property_readonly(
          "odometry_scale", [](const Compacted& r) { return PairOf(r.scale.odometry); },
          "Factors (translation, rotation) by which standard deviations of odometry were scaled, as "
          "InformationCalibration has them; ones with options.")
      .def_property_readonly(
          "loop_scale", [](const Compacted& r) { return PairOf(r.scale.loops); }, "The same of loops.")
      .def_property_readonly(
          "poses_seen", [](const Compacted& r) { return ReadSlam(r, [](auto& s) { return s.PosesSeen(); }); },
          "Poses of the graph.")
      .def_property_readonly(
          "poses_kept",
          [](const Compacted& r) { return ReadSlam(r, [](auto& s) { return s.Solver().Graph().Poses().size(); }); },
          "Poses in the map.")
      .def_property_readonly(
          "links_kept", [](const Compacted& r) { return ReadSlam(r, [](auto& s) { return s.LinksKept(); }); },
          "Links in the map, beside the odometry.")
      .def("graph", &GraphOf, "Kept poses at the solution, and kept links (PoseGraph). A copy.")
      .def(
          "trajectory", [](const Compacted& r, const std::string& recovery) { return TrajectoryOf(r.slam, recovery); },
          py::arg("recovery") = "v2", "All poses in order of arrival (CompactTrajectory), as CompactPoseSlam has it.")
      .def("__repr__", &Describe)
      .def(py::pickle(&PickledRun, &UnpickledRun));
}

}  // namespace

void BindCompactRun(py::module_& module) {
  BindRun(module);
  module.def(
      "compact", &Compact, py::arg("graph"), py::arg("options") = py::none(), py::kw_only(),
      py::arg("strategy") = py::none(), py::arg("progress") = py::none(),
      "Keeps the poses and links of a PoseGraph that carry information (CompactRun).\n\n"
      "Its poses come in order of arrival with their edges, then what is kept is brought to its optimum. Without "
      "options "
      "as the command does: thresholds from a sample of the graph, and information that nobody estimated and that the "
      "residuals contradict is scaled first (calibrate_information).\n"
      "options: CompactOptions, taken as they are, and the information too. strategy, if there are no options: "
      "'bounded' (as many poses and links as the area needs, however often the robot comes back; the default), 'fpfl' "
      "(few poses, few links), 'apfl' (all poses, few links) or 'apal' (all).\n"
      "progress: called with (done, total) after every pose.\n"
      "ValueError if the graph is empty or not connected. Without the GIL; Ctrl-C works.");
}

}  // namespace terse::python
