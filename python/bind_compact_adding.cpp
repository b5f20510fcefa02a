// What brings poses and measurements into compact pose SLAM.

#include <pybind11/stl.h>

#include "bindings.h"
#include "terse/compact/compact_graph.h"
#include "values.h"

namespace terse::python {
namespace {

template <class Pose>
Pose OriginOf(const std::shared_ptr<CompactPoseSlam<Pose>>&) {
  return Pose();
}

template <class Pose>
CompactInput<Pose> InputFrom(const Input& from) {
  CompactInput<Pose> to;
  to.id = PoseId{from.id};
  if (!from.odometry.is_none()) {
    const Factor<Pose> odometry = FactorFrom<Pose>(from.odometry);
    if (!std::holds_alternative<RelativePoseFactor<Pose>>(odometry))
      throw py::type_error("odometry: expected a RelativePose");
    to.odometry = std::get<RelativePoseFactor<Pose>>(odometry);
  }
  if (from.T_world_body) to.T_world_body = PoseFrom<Pose>(*from.T_world_body, "T_world_body");
  to.fixed = from.fixed;
  to.priors = FactorsFrom<Pose>(py::iter(from.priors));
  if (!from.loops.is_none()) {
    to.loops.emplace();
    for (const Factor<Pose>& factor : FactorsFrom<Pose>(py::iter(from.loops))) {
      if (!std::holds_alternative<RelativePoseFactor<Pose>>(factor))
        throw py::type_error("loops: expected RelativePose objects");
      to.loops->push_back(std::get<RelativePoseFactor<Pose>>(factor));
    }
  }
  if (from.linkable) {
    to.linkable.emplace();
    for (const std::int64_t id : *from.linkable) to.linkable->push_back(PoseId{id});
  }
  to.keep = from.drawn;
  return to;
}

// Called without the GIL. The callable outlives it.
template <class Pose>
Registration<Pose> CallbackOf(const py::object& callable) {
  return [&callable](PoseId candidate, PoseId current) -> std::optional<RelativePoseFactor<Pose>> {
    const py::gil_scoped_acquire acquire;
    const py::object link = callable(candidate.value, current.value);
    if (link.is_none()) return std::nullopt;
    if (!py::isinstance<RelativePose>(link)) {
      throw py::type_error("the registration is to return a RelativePose or None, not " +
                           py::repr(py::type::handle_of(link)).cast<std::string>());
    }
    return Expect<RelativePoseFactor<Pose>>(link.cast<const RelativePose&>().factor, "registration");
  };
}

template <class Pose>
Registration<Pose> RegistrationFrom(const py::object& source) {
  if (source.is_none()) return nullptr;
  if (py::isinstance<Replay>(source)) {
    return Expect<std::shared_ptr<GraphReplay<Pose>>>(source.cast<const Replay&>().replay, "registration")
        ->AsRegistration();
  }
  if (PyCallable_Check(source.ptr()) == 0)
    throw py::type_error("registration: expected a function, a GraphReplay or None");
  return CallbackOf<Pose>(source);
}

Decision Add(const Slam& slam, const Input& input, const py::object& registration) {
  const Lock lock(*slam.guard, Lock::kChanging);
  return std::visit(
      [&](const auto& held) {
        using Pose = decltype(OriginOf(held));
        const CompactInput<Pose> pose = InputFrom<Pose>(input);
        const Registration<Pose> source = RegistrationFrom<Pose>(registration);
        const py::gil_scoped_release release;
        return held->AddPose(pose, source);
      },
      slam.slam);
}

std::vector<Decision> Run(const Slam& slam, const Replay& replay, const py::object& progress) {
  const Lock lock(*slam.guard, Lock::kChanging);
  const Lock replay_lock(*replay.guard, Lock::kChanging);
  const Interrupter interrupter(progress);
  return std::visit(
      [&](const auto& held) {
        using Pose = decltype(OriginOf(held));
        const auto& source = *Expect<std::shared_ptr<GraphReplay<Pose>>>(replay.replay, "replay");
        const auto total = static_cast<long>(source.Inputs().size());
        long done = 0;
        const py::gil_scoped_release release;
        return AddPoses(*held, source, [&](const Decision&, double) { return interrupter(++done, total); });
      },
      slam.slam);
}

template <class Pose>
RelativePoseFactor<Pose> LinkFrom(const RelativePose& link) {
  return Expect<RelativePoseFactor<Pose>>(link.factor, "link");
}

Solution Finish(const Slam& slam) {
  const Lock lock(*slam.guard, Lock::kChanging);
  return std::visit(
      [&](const auto& held) {
        const py::gil_scoped_release release;
        auto result = held->Finish();
        return MakeSolution(std::move(result), std::make_shared<const AnyPoseGraph>(held->Solver().Graph()));
      },
      slam.slam);
}

std::vector<RetiredPose> Retire(const Slam& slam, std::optional<double> most_loss) {
  const Lock lock(*slam.guard, Lock::kChanging);
  const py::gil_scoped_release release;
  return std::visit([&](const auto& held) { return most_loss ? held->Retire(*most_loss) : held->Retire(); }, slam.slam);
}

using Type = py::class_<Slam>;

void BindNewPoses(Type& type) {
  type.def(
          "add_pose",
          [](const Slam& slam, std::int64_t id, py::object odometry, const py::object& registration,
             std::optional<Array> T, bool fixed, py::object priors, py::object loops) {
            return Add(slam,
                       Input{id, std::move(odometry), std::move(T), fixed, std::move(priors), std::nullopt,
                             std::move(loops), false},
                       registration);
          },
          py::arg("pose_id"), py::arg("odometry") = py::none(), py::arg("registration") = py::none(), py::kw_only(),
          py::arg("T_world_body") = py::none(), py::arg("fixed") = false, py::arg("priors") = py::tuple(),
          py::arg("loops") = py::none(),
          "Decides on a new pose (Decision).\n\n"
          "odometry: RelativePose between it and an earlier pose, kept or dropped, in either direction; None for the "
          "very "
          "first one only.\n"
          "registration: function (candidate_id, current_id) -> RelativePose between the two, in either direction, or "
          "None "
          "where they do not match; asked for the few candidates that are worth it. A GraphReplay answers without "
          "Python.\n"
          "T_world_body: of the first pose (else the identity) and of a fixed one: (3,), (3, 3), (7,) or (4, 4). "
          "fixed: keep "
          "it, anchored there. priors: PosePrior and PositionPrior objects on it; a pose with priors is kept. "
          "loops: RelativePose objects measured already, from it to earlier poses, kept or dropped; if they are "
          "given, nothing is registered.\n"
          "ValueError or NumericalError, and then nothing has changed. What the registration raises passes through; "
          "links "
          "accepted before it, and the pose with them, stay, and the object can be used on. Without the GIL but in the "
          "registration, which may read this object but not change it.")
      .def("add", &Add, py::arg("input"), py::arg("registration") = py::none(), "As add_pose, from a CompactInput.")
      .def("run", &Run, py::arg("replay"), py::kw_only(), py::arg("progress") = py::none(),
           "Adds all poses of a GraphReplay with their loops: a list of Decision. progress: called with (done, total); "
           "it "
           "returns False to stop. Without the GIL; Ctrl-C works.");
}

void BindLateMeasurements(Type& type) {
  type.def(
          "add_link",
          [](const Slam& slam, const RelativePose& link) {
            const Lock lock(*slam.guard, Lock::kChanging);
            return std::visit(
                [&](const auto& held) {
                  const auto factor = LinkFrom<decltype(OriginOf(held))>(link);
                  const py::gil_scoped_release release;
                  return held->AddLink(factor);
                },
                slam.slam);
          },
          py::arg("link"),
          "A link that comes late, between any two poses seen (LinkDecision): carried to the kept poses, then tested.")
      .def(
          "remove_link",
          [](const Slam& slam, std::int64_t id) {
            const Lock lock(*slam.guard, Lock::kChanging);
            const py::gil_scoped_release release;
            std::visit([&](const auto& held) { held->RemoveLink(FactorId{id}); }, slam.slam);
          },
          py::arg("factor_id"),
          "Takes a link out again that was found wrong. ValueError if there is none, or if it is odometry.")
      .def(
          "add_prior",
          [](const Slam& slam, const py::object& prior) {
            const Lock lock(*slam.guard, Lock::kChanging);
            return std::visit(
                [&](const auto& held) {
                  const auto factor = FactorFrom<decltype(OriginOf(held))>(prior);
                  const py::gil_scoped_release release;
                  return held->AddPrior(factor).value;
                },
                slam.slam);
          },
          py::arg("prior"), "A prior that comes late, on any pose seen, kept or dropped; its id.");
}

}  // namespace

void BindCompactAdding(Type& type) {
  BindNewPoses(type);
  BindLateMeasurements(type);
  type.def(
      "retire", &Retire, py::arg("most_loss") = py::none(),
      "Poses retire from the map: a list of RetiredPose, in the order in which they went. As "
      "CompactOptions.retire_share has it, none where that does not apply; or, with any strategy, those whose "
      "removal loses no more than most_loss nats each. What is left comes to its optimum, and its measurements keep "
      "their ids.\n"
      "ValueError for a negative loss, NumericalError if what is left has no optimum, and then nothing has "
      "changed. Without the GIL.");
  type.def("finish", &Finish, "Iterates the kept graph to its optimum (Solution). Without the GIL.");
}

}  // namespace terse::python
