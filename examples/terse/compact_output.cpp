#include "compact_output.h"

#include <filesystem>

#include "report.h"
#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/core/graph_file.h"

namespace terse {

void RequireFolder(const std::string& path) {
  std::error_code error;
  std::filesystem::create_directories(path, error);
  if (!std::filesystem::is_directory(path)) {
    const std::string reason = std::filesystem::exists(path) ? "a file of this name is in the way" : error.message();
    throw FileError(path, 0, "cannot make this folder: " + reason);
  }
  RequireWritable(path + "/decisions.csv");
}

void WriteDecisions(const std::vector<Decision>& decisions, const std::string& path) {
  AtomicFile file(path);
  std::ostream& out = file.Stream();
  out << "pose,kept,verdict,pose_gain_nats,registrations_tried,links_accepted,"
         "candidates,probabilities,gains_nats,measured_gains_nats,accepted,innovations,links_refused,factors\n";
  for (const Decision& d : decisions) {
    out << d.id.value << ',' << (d.Kept() ? 1 : 0) << ',' << Name(d.verdict) << ','
        << (d.pose_gain ? Shortest(*d.pose_gain) : "") << ',' << d.registrations_tried << ',' << d.links_accepted;
    const auto list = [&](auto&& text) {
      out << ',';
      for (std::size_t k = 0; k < d.candidates.size(); ++k) out << (k > 0 ? " " : "") << text(d.candidates[k]);
    };
    list([](const Candidate& c) { return std::to_string(c.id.value); });
    list([](const Candidate& c) { return Shortest(c.probability); });
    list([](const Candidate& c) { return Shortest(c.gain); });
    list([](const Candidate& c) { return c.measured_gain ? Shortest(*c.measured_gain) : std::string("-"); });
    list([](const Candidate& c) { return std::string(c.accepted ? "1" : "0"); });
    list([](const Candidate& c) { return c.innovation ? Shortest(*c.innovation) : std::string("-"); });
    out << ',' << d.links_refused;
    list([](const Candidate& c) { return c.factor ? std::to_string(c.factor->value) : std::string("-"); });
    out << '\n';
  }
  file.Commit();
}

template <class Pose>
void WriteCompactMap(const CompactPoseSlam<Pose>& slam, const BatchResult<Pose>& result, Recovery recovery,
                     RotationInformation rotation_information, const std::string& folder) {
  PoseGraph<Pose> kept = slam.Solver().Graph();
  for (std::size_t k = 0; k < result.T_world_body.size(); ++k) kept.SetPose(kept.Poses()[k].id, result.T_world_body[k]);
  WriteG2o(kept, folder + "/compact.g2o", rotation_information);
  std::vector<PoseId> ids;
  std::vector<Pose> values;
  for (const auto& pose : slam.Trajectory(recovery)) {
    ids.push_back(pose.id);
    values.push_back(pose.T_world_body);
  }
  WriteTum(MakeTrajectory(ids, values), folder + "/trajectory.tum");
}

#define TERSE_INSTANTIATE(Pose)                                                                         \
  template void WriteCompactMap<Pose>(const CompactPoseSlam<Pose>&, const BatchResult<Pose>&, Recovery, \
                                      RotationInformation, const std::string&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
