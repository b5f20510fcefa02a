#include "run/online_json.h"

#include "terse/compact/compact_json.h"
#include "terse/core/pose_numbers.h"
#include "terse/core/robust.h"
#include "terse/covariance/covariance_table.h"

namespace terse {
namespace {

using nlohmann::ordered_json;

ordered_json OrNull(const std::optional<double>& value) { return value ? ordered_json(*value) : ordered_json(); }

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
  if (c.anchors) json["anchors"] = true;
  if (c.composed) json["composed"] = true;
  return json;
}

ordered_json EdgesJson(const std::vector<ComposedEdge>& edges) {
  ordered_json json = ordered_json::array();
  for (const ComposedEdge& edge : edges) {
    json.push_back({{"factor", edge.id.value},
                    {"from", edge.from.value},
                    {"to", edge.to.value},
                    {"gain", edge.gain},
                    {"fused", edge.fused}});
  }
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
                       {"estimate", internal::NumbersOf(slam.Estimate(d.id, Recovery::kV2))}};
  if (d.loops_forgotten > 0) json["loops_forgotten"] = d.loops_forgotten;
  if (!d.retired.empty()) {
    json["retired"] = ordered_json::array();
    for (const RetiredPose& pose : d.retired) json["retired"].push_back(pose.id.value);
  }
  if (d.anchored_to) json["anchored_to"] = d.anchored_to->value;
  if (!d.edges.empty()) json["edges"] = EdgesJson(d.edges);
  if (d.verdict == PoseVerdict::kPrior) AddUndetermined(slam, json);
  return json;
}

ordered_json LateLinkJson(const LateLink& link) {
  const LinkDecision& d = link.decision;
  if (link.forgotten) return {{"link", {link.from.value, link.to.value}}, {"accepted", false}, {"forgotten", true}};
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

template <class Pose>
ordered_json ToJson(const Review& review, const CompactPoseSlam<Pose>& slam) {
  const PoseGraph<Pose>& graph = slam.Solver().Graph();
  ordered_json kept = ordered_json::array(), links = ordered_json::array();
  for (const auto& pose : graph.Poses()) kept.push_back(pose.id.value);
  for (const FactorId id : LoopFactors(graph)) {
    const FactorPoses ends = PosesOf(graph.FindFactor(id)->factor);
    links.push_back({{"factor", id.value}, {"from", ends.first.value}, {"to", ends.second.value}});
  }
  return {{"made_again", true},
          {"information", Name(review.information.verdict)},
          {"message", review.information.message},
          {"sigma_scale", ToJson(review.scale)},
          {"thresholds", ThresholdsToJson(slam.Options().thresholds)},
          {"loops_left_out", review.loops_left_out},
          {"poses_kept", std::move(kept)},
          {"links_kept", std::move(links)}};
}

ordered_json RowsJson(const MatrixX& covariance) {
  if (!covariance.allFinite()) return nullptr;
  ordered_json rows = ordered_json::array();
  for (Eigen::Index r = 0; r < covariance.rows(); ++r) {
    ordered_json row = ordered_json::array();
    for (Eigen::Index c = 0; c < covariance.cols(); ++c) row.push_back(covariance(r, c));
    rows.push_back(std::move(row));
  }
  return rows;
}

template <class Pose>
ordered_json CovarianceJson(const std::vector<PoseId>& poses, const CompactPoseSlam<Pose>& slam,
                            const CovarianceConvention& convention) {
  const bool is_pair = poses.size() == 2;
  const PoseId first = poses.front(), last = poses.back();
  const MatrixX covariance =
      is_pair ? slam.RelativeCovariance(first, last, convention) : slam.Covariance(first, convention);
  RequireFinite(covariance);
  const Pose T_world_last = slam.Estimate(last, Recovery::kV2);
  ordered_json json;
  if (is_pair) {
    json = {{"from", first.value},
            {"to", last.value},
            {"estimate", internal::NumbersOf(slam.Estimate(first, Recovery::kV2).Inverse() * T_world_last)}};
  } else {
    json = {{"ids", {first.value}},
            {"kept", slam.KeptBase(first) == first},
            {"estimate", internal::NumbersOf(T_world_last)}};
  }
  json["frame"] = Name(convention.frame);
  json["order"] = Name(convention.order);
  json["covariance"] = RowsJson(covariance);
  return json;
}

std::string OneLine(const ordered_json& json) {
  return json.dump(-1, ' ', false, ordered_json::error_handler_t::replace) + '\n';
}

template ordered_json CovarianceJson<SE2>(const std::vector<PoseId>&, const CompactPoseSlam<SE2>&,
                                          const CovarianceConvention&);
template ordered_json CovarianceJson<SE3>(const std::vector<PoseId>&, const CompactPoseSlam<SE3>&,
                                          const CovarianceConvention&);
template ordered_json ToJson<SE2>(const StreamOutcome&, const CompactPoseSlam<SE2>&);
template ordered_json ToJson<SE3>(const StreamOutcome&, const CompactPoseSlam<SE3>&);
template ordered_json ToJson<SE2>(const Review&, const CompactPoseSlam<SE2>&);
template ordered_json ToJson<SE3>(const Review&, const CompactPoseSlam<SE3>&);

}  // namespace terse
