// What compact pose SLAM decided.

#include <pybind11/stl.h>

#include "bindings.h"
#include "pickling.h"
#include "state_members.h"
#include "text.h"
#include "values.h"

namespace terse::python {
namespace {

std::optional<std::int64_t> ValueOf(const std::optional<FactorId>& id) {
  return id ? std::optional<std::int64_t>(id->value) : std::nullopt;
}

void BindCandidate(py::module_& module) {
  py::class_<Candidate>(module, "Candidate", "A kept pose that a new one may be linked to.")
      .def_property_readonly(
          "pose_id", [](const Candidate& c) { return c.id.value; }, "Its id.")
      .def_readonly("probability", &Candidate::probability, "Of being in range, least over the dimensions.")
      .def_readonly("gain", &Candidate::gain,
                    "Nats, with the expected covariance of a link; of a loop that came with the pose with its own.")
      .def_readonly("measured", &Candidate::measured, "It is a loop that came with the pose.")
      .def_readonly("tried", &Candidate::tried, "Whether it was registered or, if it came measured, tested.")
      .def_readonly("measured_gain", &Candidate::measured_gain,
                    "Nats, with the registered covariance; None if registration failed or was not tried.")
      .def_readonly("innovation", &Candidate::innovation,
                    "Squared Mahalanobis distance of the link from what was known; None if it was not tested.")
      .def_readonly("outlier", &Candidate::outlier, "The innovation is too large: refused, whatever its gain.")
      .def_readonly("supported", &Candidate::supported, "It was, but others agree with it.")
      .def_readonly("accepted", &Candidate::accepted, "Whether the link is in the map.")
      .def_property_readonly(
          "carried_from",
          [](const Candidate& c) {
            return c.carried_from ? std::optional<std::int64_t>(c.carried_from->value) : std::nullopt;
          },
          "The dropped pose that the loop was measured at; None if it was measured at this one.")
      .def_property_readonly(
          "factor_id", [](const Candidate& c) { return ValueOf(c.factor); },
          "Of the link if it was accepted, else None; remove_link takes it.")
      .def_readonly("anchors", &Candidate::anchors,
                    "Strategy 'bounded': the chain starts anew with this link, which is no factor of the map.")
      .def_readonly("composed", &Candidate::composed,
                    "Strategy 'bounded': the link is part of an edge between kept poses (Decision.edges).")
      .def("__repr__",
           [](const Candidate& c) {
             const std::string verdict = c.accepted   ? ", accepted"
                                         : c.anchors  ? ", anchors"
                                         : c.composed ? ", composed"
                                         : c.outlier  ? ", refused"
                                         : c.tried    ? ", tried"
                                                      : "";
             return "<terse.Candidate " + std::to_string(c.id.value) + ": gain " +
                    SixDigits(c.measured_gain.value_or(c.gain)) + " nats" + verdict + ">";
           })
      .def(PickleOf<Candidate>("pickle Candidate"));
}

void BindComposedEdge(py::module_& module) {
  py::class_<ComposedEdge>(
      module, "ComposedEdge",
      "A measurement between kept poses, composed of links of a pose that is not kept (strategy 'bounded').")
      .def_property_readonly(
          "id", [](const ComposedEdge& e) { return e.id.value; }, "remove_link takes it; below -1.")
      .def_property_readonly(
          "from_id", [](const ComposedEdge& e) { return e.from.value; }, "A kept pose.")
      .def_property_readonly(
          "to_id", [](const ComposedEdge& e) { return e.to.value; }, "Another one.")
      .def_readonly("gain", &ComposedEdge::gain, "About the map, nats.")
      .def_readonly("fused", &ComposedEdge::fused, "Whether it fused with an edge that joined the two already.")
      .def("__repr__",
           [](const ComposedEdge& e) {
             return "<terse.ComposedEdge " + std::to_string(e.from.value) + " -> " + std::to_string(e.to.value) +
                    ": gain " + SixDigits(e.gain) + " nats" + (e.fused ? ", fused>" : ">");
           })
      .def(PickleOf<ComposedEdge>("pickle ComposedEdge"));
}

void BindRetiredPose(py::module_& module) {
  py::class_<RetiredPose>(module, "RetiredPose",
                          "A pose that was kept, and that the map does without: marginalised into measurements between "
                          "its neighbours.")
      .def_property_readonly(
          "pose_id", [](const RetiredPose& p) { return p.id.value; }, "Its id.")
      .def_readonly("loss", &RetiredPose::loss,
                    "Nats, of what was known of its neighbours' displacements; 0 with one or two neighbours.")
      .def_readonly("neighbours", &RetiredPose::neighbours, "How many it had.")
      .def_readonly("factors_removed", &RetiredPose::factors_removed, "That it had with them.")
      .def_readonly("factors_recovered", &RetiredPose::factors_recovered, "That join them instead.")
      .def("__repr__",
           [](const RetiredPose& p) {
             return "<terse.RetiredPose " + std::to_string(p.id.value) + ": " + Counted(p.neighbours, "neighbour") +
                    ", " + SixDigits(p.loss) + " nats lost>";
           })
      .def(PickleOf<RetiredPose>("pickle RetiredPose"));
}

}  // namespace

void BindDecision(py::module_& module) {
  BindCandidate(module);
  BindComposedEdge(module);
  BindRetiredPose(module);
  py::class_<Decision>(module, "Decision", "What was decided on a pose, and on what grounds.")
      .def_property_readonly(
          "pose_id", [](const Decision& d) { return d.id.value; }, "The pose.")
      .def_property_readonly("kept", &Decision::Kept, "Whether it is in the map.")
      .def_property_readonly(
          "verdict", [](const Decision& d) { return Name(d.verdict); },
          "Why: first, all_kept, loop_closed, prior, nothing_in_range, informative, redundant, drawn or anchored.")
      .def_readonly("pose_gain", &Decision::pose_gain,
                    "Least gain of a possible link, nats; None if nothing was in range.")
      .def_readonly("registrations_tried", &Decision::registrations_tried, "How often the registration was asked.")
      .def_readonly("links_accepted", &Decision::links_accepted, "Links that are in the map.")
      .def_readonly("links_refused", &Decision::links_refused, "Links that the innovation test refused.")
      .def_readonly("loops_forgotten", &Decision::loops_forgotten,
                    "Loops that came with the pose and lead to forgotten ones (CompactOptions.most_dropped).")
      .def_readonly("candidates", &Decision::candidates,
                    "List of Candidate: those tried, in that order, and the best of the others "
                    "(CompactOptions.record). A copy.")
      .def_readonly("candidates_found", &Decision::candidates_found, "How many there were.")
      .def_property_readonly(
          "revived",
          [](const Decision& d) {
            std::vector<std::int64_t> ids;
            for (const PoseId id : d.revived) ids.push_back(id.value);
            return ids;
          },
          "Ids of poses dropped earlier that are kept from now on, because a loop of this pose leads to them.")
      .def_readonly("retired", &Decision::retired,
                    "Strategy 'bounded': list of RetiredPose, poses kept earlier that are dropped ones from now on, "
                    "because the map does without them. A copy.")
      .def_property_readonly(
          "anchored_to",
          [](const Decision& d) {
            return d.anchored_to ? std::optional<std::int64_t>(d.anchored_to->value) : std::nullopt;
          },
          "Strategy 'bounded': the kept pose at which the robot was found again and the chain starts anew, else None.")
      .def_readonly("edges", &Decision::edges,
                    "Strategy 'bounded': list of ComposedEdge, which the pose's links made. A copy.")
      .def("__repr__",
           [](const Decision& d) {
             return "<terse.Decision: pose " + std::to_string(d.id.value) + " " + Name(d.verdict) + ", " +
                    std::to_string(d.links_accepted) + " of " + Counted(d.candidates_found, "candidate") + " linked>";
           })
      .def(PickleOf<Decision>("pickle Decision"));
  py::class_<LinkDecision>(module, "LinkDecision", "What was decided on a link that came late.")
      .def_property_readonly(
          "from_id", [](const LinkDecision& d) { return d.from.value; },
          "The kept pose that its first end was carried to.")
      .def_property_readonly(
          "to_id", [](const LinkDecision& d) { return d.to.value; },
          "The kept pose that its second end was carried to.")
      .def_readonly("gain", &LinkDecision::gain, "Nats, with the measured covariance.")
      .def_readonly("innovation", &LinkDecision::innovation, "Squared Mahalanobis distance; None if it was not tested.")
      .def_readonly("outlier", &LinkDecision::outlier, "The innovation is too large.")
      .def_readonly("accepted", &LinkDecision::accepted, "Whether it is in the map.")
      .def_property_readonly(
          "factor_id", [](const LinkDecision& d) { return ValueOf(d.factor); }, "If accepted, else None.")
      .def("__repr__",
           [](const LinkDecision& d) {
             return "<terse.LinkDecision " + std::to_string(d.from.value) + " -> " + std::to_string(d.to.value) +
                    ": gain " + SixDigits(d.gain) + " nats, " +
                    (d.accepted  ? "accepted>"
                     : d.outlier ? "refused>"
                                 : "not accepted>");
           })
      .def(PickleOf<LinkDecision>("pickle LinkDecision"));
}

}  // namespace terse::python
