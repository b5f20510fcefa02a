#include "online_json.h"

namespace terse {
namespace {

using nlohmann::ordered_json;

ordered_json OrNull(const std::optional<double>& value) { return value ? ordered_json(*value) : ordered_json(); }

std::vector<double> Numbers(const SE2& T) { return {T.Translation().x(), T.Translation().y(), T.Theta()}; }
std::vector<double> Numbers(const SE3& T) {
  const Vector<3>& p = T.Translation();
  const Quaternion& q = T.Rotation().Unit();
  return {p.x(), p.y(), p.z(), q.x(), q.y(), q.z(), q.w()};
}

// A candidate that a measurement came for.
ordered_json LinkJson(const Candidate& c) {
  // With apal nothing is evaluated.
  const std::optional<double> gain = c.measured_gain ? std::optional<double>(c.gain) : std::nullopt;
  ordered_json json = {{"to", c.id.value},
                       {"gain", OrNull(gain)},
                       {"measured_gain", OrNull(c.measured_gain)},
                       {"innovation", OrNull(c.innovation)},
                       {"outlier", c.outlier},
                       {"accepted", c.accepted}};
  if (c.factor) json["factor"] = c.factor->value;
  return json;
}

// What a prior says of the frame is known now.
template <class Pose>
void AddUndetermined(const CompactPoseSlam<Pose>& slam, ordered_json& json) {
  const std::string words = slam.Solver().DescribeUndetermined();
  if (!words.empty()) json["undetermined"] = words;
}

template <class Pose>
ordered_json DecisionJson(const Decision& d, const CompactPoseSlam<Pose>& slam) {
  ordered_json links = ordered_json::array();
  for (const Candidate& c : d.candidates) {
    if (c.measured_gain || c.accepted) links.push_back(LinkJson(c));
  }
  ordered_json json = {{"pose", d.id.value},
                       {"kept", d.Kept()},
                       {"verdict", Name(d.verdict)},
                       {"pose_gain", OrNull(d.pose_gain)},
                       {"links", links},
                       {"estimate", Numbers(slam.Estimate(d.id))}};
  if (d.verdict == PoseVerdict::kPrior) AddUndetermined(slam, json);
  return json;
}

ordered_json LateLinkJson(const LateLink& link) {
  const LinkDecision& d = link.decision;
  ordered_json json = {{"link", {link.from.value, link.to.value}},
                       {"kept", {d.from.value, d.to.value}},
                       {"measured_gain", d.gain},
                       {"innovation", OrNull(d.innovation)},
                       {"outlier", d.outlier},
                       {"accepted", d.accepted}};
  if (d.factor) json["factor"] = d.factor->value;
  return json;
}

}  // namespace

template <class Pose>
ordered_json ToJson(const StreamOutcome& outcome, const CompactPoseSlam<Pose>& slam) {
  if (const auto* decision = std::get_if<Decision>(&outcome)) return DecisionJson(*decision, slam);
  if (const auto* link = std::get_if<LateLink>(&outcome)) return LateLinkJson(*link);
  const auto& prior = std::get<LatePrior>(outcome);
  ordered_json json = {{"prior", prior.pose.value}, {"kept", prior.kept.value}, {"factor", prior.factor.value}};
  AddUndetermined(slam, json);
  return json;
}

std::string OneLine(const ordered_json& json) {
  return json.dump(-1, ' ', false, ordered_json::error_handler_t::replace) + '\n';
}

template ordered_json ToJson<SE2>(const StreamOutcome&, const CompactPoseSlam<SE2>&);
template ordered_json ToJson<SE3>(const StreamOutcome&, const CompactPoseSlam<SE3>&);

}  // namespace terse
