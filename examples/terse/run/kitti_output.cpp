#include "run/kitti_output.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>

#include "run/compact_stats.h"
#include "run/run_statistics.h"
#include "run/standard_output.h"
#include "terse/compact/json_file.h"
#include "terse/compact/run_writer.h"
#include "terse/core/number_text.h"

namespace terse {
namespace {

using Json = nlohmann::ordered_json;

Json ToJson(const Evaluation& e) {
  Json json;
  json["ate_m"] = e.ate.translation_m;
  json["ate_deg"] = e.ate.rotation_deg;
  json["rpe_m"] = e.rpe.translation_m;
  json["rpe_deg"] = e.rpe.rotation_deg;
  const bool long_enough = e.kitti && e.kitti->segments > 0;
  json["t_rel_percent"] = long_enough ? Json(e.kitti->t_rel_percent) : Json(nullptr);
  json["r_rel_deg_per_100m"] = long_enough ? Json(e.kitti->r_rel_deg_per_100m) : Json(nullptr);
  return json;
}

// Means per frame.
Json StagesToJson(const KittiTotals& t) {
  const double n = std::max(1, t.frames);
  Json json;
  json["waiting_for_images"] = t.waiting / n;
  json["odometry"] = t.times.odometry / n;
  json["odometry_pyramids"] = t.odometry.pyramids / n;
  json["odometry_corners"] = t.odometry.corners / n;
  json["odometry_tracking"] = t.odometry.tracking / n;
  json["odometry_stereo"] = t.odometry.stereo / n;
  json["odometry_motion"] = t.odometry.motion / n;
  json["odometry_window"] = t.odometry.window / n;
  json["features"] = t.times.features / n;
  json["verification"] = t.times.verification / n;
  json["appearance_search"] = t.times.search / n;
  json["map"] = t.times.map / n;
  return json;
}

const char* Name(MotionCovariance covariance) {
  return covariance == MotionCovariance::kSchur ? "schur" : "monte-carlo";
}

Json StatsToJson(const KittiRun& run, const KittiSequence& sequence, const std::optional<KittiErrors>& errors) {
  const KittiTotals& t = run.totals;
  const StereoSlam& slam = run.slam;
  Json json;
  json["frames"] = t.frames;
  json["frames_lost"] = t.lost;
  json["odd_frames"] = Json::array();
  for (const OddFrame& odd : run.odd) {
    json["odd_frames"].push_back({{"frame", odd.frame}, {"status", ToString(odd.status)}, {"reason", odd.reason}});
  }
  json["pair"] = sequence.Pair() == KittiPair::kGrey ? "grey" : "colour";
  json["strategy"] = Name(slam.Map().Options().strategy);
  json["covariance"] = Name(slam.Options().odometry.covariance);
  json["fps"] = t.FramesPerSecond();
  json["seconds"] = t.seconds;
  json["milliseconds_per_frame"] = StagesToJson(t);
  if (t.vocabulary > 0) json["vocabulary_seconds"] = t.vocabulary / 1000;
  json["candidates"] = t.candidates;
  json["compared"] = t.compared;
  json["verified"] = t.verified;
  json["accepted"] = t.accepted;
  json["refused_by_innovation"] = t.refused;
  json["poses_kept"] = slam.Map().Solver().Graph().Poses().size();
  json["links_kept"] = slam.Map().LinksKept();
  if (const LookedBack& back = run.looked_back; !back.why.empty()) {
    json["loops_judged"] =
        LoopsJudgedJson(static_cast<std::size_t>(t.verified), {back.why}, back.wrong, t.look_back / 1000);
  }
  AddTo(json, CountComposed(slam.Map()));
  AddTo(json, ToTell(t.retired, slam.Map().Options().strategy));
  if (slam.Map().PosesForgotten() > 0) json["frames_forgotten"] = slam.Map().PosesForgotten();
  json["keyframes_stored"] = slam.Verifier().Kept();
  json["feature_bytes"] = slam.Verifier().Bytes();
  json["chi2"] = run.result.chi2;
  json["converged"] = run.result.Converged();
  if (errors) {
    json["errors"] = ToJson(errors->map);
    json["odometry_errors"] = ToJson(errors->odometry);
  }
  return json;
}

Trajectory Stamped(TrajectoryFormat format, const std::vector<SE3>& poses, const KittiRun& run,
                   const KittiSequence& sequence) {
  Trajectory out;
  out.format = format;
  out.T_world_body = poses;
  for (const int frame : run.frames) {
    out.stamps.push_back(format == TrajectoryFormat::kTum ? sequence.Time(frame) : frame);
  }
  return out;
}

void PrintErrors(const char* name, const Evaluation& e) {
  char line[200];
  if (e.kitti && e.kitti->segments > 0) {
    std::snprintf(line, sizeof(line), "%-10s t_rel %.3f %%, r_rel %.3f deg/100 m, ", name, e.kitti->t_rel_percent,
                  e.kitti->r_rel_deg_per_100m);
  } else {
    std::snprintf(line, sizeof(line), "%-10s t_rel, r_rel: the path is shorter than 100 m; ", name);
  }
  std::cout << line;
  std::snprintf(line, sizeof(line), "ATE %.3f m %.3f deg, RPE %.4f m %.4f deg\n", e.ate.translation_m,
                e.ate.rotation_deg, e.rpe.translation_m, e.rpe.rotation_deg);
  std::cout << line;
}

}  // namespace

LoopsFile::LoopsFile(const std::string& path) : file_(path) {
  file_.Stream() << "current,candidate,outcome,matches,agreeing,inliers,confirmed,coverage,residual_scale_px,"
                    "x,y,z,rx,ry,rz,sigma_x,sigma_y,sigma_z,sigma_rx,sigma_ry,sigma_rz,milliseconds,"
                    "gain_nats,measured_gain_nats,innovation,accepted\n";
}

void LoopsFile::Add(const StereoSlamStep& step) {
  std::ostream& out = file_.Stream();
  for (const LoopAttempt& attempt : step.attempts) {
    const LoopVerification& v = attempt.verification;
    out << attempt.current.value << ',' << attempt.candidate.value << ',' << Name(v.outcome) << ',' << v.matches << ','
        << v.agreeing << ',' << v.inliers << ',' << Shortest(v.confirmed) << ',' << Shortest(v.coverage) << ','
        << Shortest(v.residual_scale);
    const Vector<3> rotation = v.T_candidate_current.Rotation().Log();
    for (int k = 0; k < 3; ++k) out << ',' << Shortest(v.T_candidate_current.Translation()[k]);
    for (int k = 0; k < 3; ++k) out << ',' << Shortest(rotation[k]);
    for (int k = 0; k < 6; ++k) out << ',' << Shortest(std::sqrt(v.covariance(k, k)));
    out << ',' << Shortest(attempt.milliseconds);
    const auto& candidates = step.decision.candidates;
    const auto it = std::find_if(candidates.begin(), candidates.end(),
                                 [&](const Candidate& c) { return c.id == attempt.candidate; });
    const Candidate known = it != candidates.end() ? *it : Candidate{};
    // Without a search (apal, appearance) nothing is foretold.
    out << ',' << (known.probability > 0 ? Shortest(known.gain) : "-") << ','
        << (known.measured_gain ? Shortest(*known.measured_gain) : "-") << ','
        << (known.innovation ? Shortest(*known.innovation) : "-") << ',' << (known.accepted ? 1 : 0) << '\n';
  }
}

KittiErrors ComputeKittiErrors(const KittiRun& run, const KittiSequence& sequence) {
  EvaluateOptions how;
  how.kitti = true;
  return {Evaluate(MapTrajectory(run, sequence), run.truth, how),
          Evaluate(OdometryTrajectory(run, sequence), run.truth, how)};
}

void WriteKittiResults(const KittiRun& run, const KittiSequence& sequence, const std::optional<KittiErrors>& errors,
                       const std::string& folder) {
  const std::vector<SE3> poses = MapTrajectory(run, sequence);
  RunTrajectories trajectories{Stamped(TrajectoryFormat::kTum, poses, run, sequence), std::nullopt};
  if (!run.truth.empty()) trajectories.truth = Stamped(TrajectoryFormat::kTum, run.truth, run, sequence);
  RunResults<SE3> results{run.slam.Map(), run.result, run.decisions, run.steps, trajectories};
  results.retired_at_end = run.retired_at_end;
  WriteRun<SE3>(results, folder);
  const std::string of_map = folder + "/trajectory.kitti.txt", of_odometry = folder + "/odometry.kitti.txt";
  if (run.slam.Map().PosesForgotten() == 0) {
    WriteKitti(Stamped(TrajectoryFormat::kKitti, poses, run, sequence), of_map);
    WriteKitti(Stamped(TrajectoryFormat::kKitti, OdometryTrajectory(run, sequence), run, sequence), of_odometry);
  } else {
    // Those of an earlier run into the same folder are not of this one.
    std::error_code ignored;
    for (const std::string& path : {of_map, of_odometry}) std::filesystem::remove(path, ignored);
  }
  WriteJson(StatsToJson(run, sequence, errors), folder + "/stats.json");
}

void PrintKittiSummary(const KittiRun& run, const std::optional<KittiErrors>& errors, const std::string& folder) {
  const KittiTotals& t = run.totals;
  const auto kept = run.slam.Map().Solver().Graph().Poses().size();
  char line[300];
  std::snprintf(line, sizeof(line), "%d frames, %d lost, %.1f frames per second; results in %s\n", t.frames, t.lost,
                t.FramesPerSecond(), folder.c_str());
  std::cout << line;
  std::snprintf(line, sizeof(line),
                "%s kept %zu poses (%.1f %%) and %d loops: %ld candidates, %ld compared, %ld verified, %ld refused\n",
                Name(run.slam.Map().Options().strategy), kept,
                100.0 * static_cast<double>(kept) / std::max(1, t.frames), run.slam.Map().LinksKept(), t.candidates,
                t.compared, t.verified, t.refused);
  std::cout << line << Describe(CountComposed(run.slam.Map()))
            << Describe(ToTell(t.retired, run.slam.Map().Options().strategy));
  if (const long forgotten = run.slam.Map().PosesForgotten(); forgotten > 0) {
    std::cout << forgotten << " frames are forgotten (--remember): trajectories and errors are those of the others\n";
  }
  if (errors) {
    PrintErrors("map", errors->map);
    PrintErrors("odometry", errors->odometry);
  }
  FlushOutput();
}

void PrintSearchComparison(const KittiRun& information, const std::optional<KittiErrors>& information_errors,
                           const KittiRun& appearance, const std::optional<KittiErrors>& appearance_errors) {
  std::cout << "candidates by   poses  candidates  compared  verified  links  search+map [s]  features [s]  "
               "verification [s]  ATE [m]\n";
  const auto row = [](const char* name, const KittiRun& run, const std::optional<KittiErrors>& errors) {
    const KittiTotals& t = run.totals;
    char line[300], ate[32] = "-";
    if (errors) std::snprintf(ate, sizeof(ate), "%.3f", errors->map.ate.translation_m);
    std::snprintf(line, sizeof(line), "%-14s %6zu  %10ld  %8ld  %8ld  %5d  %14.2f  %12.2f  %16.2f  %7s\n", name,
                  run.slam.Map().Solver().Graph().Poses().size(), t.candidates, t.compared, t.verified,
                  run.slam.Map().LinksKept(), (t.times.search + t.times.map + t.look_back + t.vocabulary) / 1000,
                  t.times.features / 1000, t.times.verification / 1000, ate);
    std::cout << line;
  };
  row("information", information, information_errors);
  row("appearance", appearance, appearance_errors);
  FlushOutput();
}

}  // namespace terse
