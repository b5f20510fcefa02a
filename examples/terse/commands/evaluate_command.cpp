#include <cstdio>
#include <iostream>

#include "commands/commands.h"
#include "run/standard_output.h"
#include "terse/core/evaluate.h"
#include "terse/core/frame_mismatch.h"

namespace terse {
namespace {

struct EvaluateCommandOptions {
  std::string estimate, reference, alignment = "se3";
  bool kitti = false, json = false;
};

nlohmann::ordered_json ToJson(const PoseError& error) {
  nlohmann::ordered_json json;
  json["translation_m"] = error.translation_m;
  json["rotation_deg"] = error.rotation_deg;
  return json;
}

void PrintJsonResult(const Evaluation& result) {
  nlohmann::ordered_json json;
  json["poses"] = result.poses;
  json["ate"] = ToJson(result.ate);
  json["rpe"] = ToJson(result.rpe);
  json["rpe_all"] = ToJson(result.rpe_all);
  if (result.kitti) {
    json["kitti"]["t_rel_percent"] = result.kitti->t_rel_percent;
    json["kitti"]["r_rel_deg_per_100m"] = result.kitti->r_rel_deg_per_100m;
    json["kitti"]["segments"] = result.kitti->segments;
    if (result.kitti->segments == 0) json["kitti"]["t_rel_percent"] = json["kitti"]["r_rel_deg_per_100m"] = nullptr;
  }
  PrintJson(json);
}

void PrintRow(const char* name, const PoseError& error) {
  char line[128];
  std::snprintf(line, sizeof(line), "%-24s %16.6g %16.6g\n", name, error.translation_m, error.rotation_deg);
  std::cout << line;
}

void PrintTable(const Evaluation& result, const std::string& alignment, std::size_t estimated, std::size_t reference) {
  char line[128];
  std::cout << result.poses << " matched poses";
  const auto matched = static_cast<std::size_t>(result.poses);
  if (estimated != matched || reference != matched) {
    std::cout << " of " << estimated << " estimated and " << reference << " of the reference";
  }
  std::snprintf(line, sizeof(line), "\n%-24s %16s %16s\n", "root mean square", "translation [m]", "rotation [deg]");
  std::cout << line;
  PrintRow(("ATE, alignment " + alignment).c_str(), result.ate);
  PrintRow("RPE, pose to next", result.rpe);
  PrintRow("RPE, all pairs", result.rpe_all);
  if (result.kitti && result.kitti->segments > 0) {
    std::snprintf(line, sizeof(line), "KITTI t_rel %.4f %%, r_rel %.4f deg/100 m (%ld segments)\n",
                  result.kitti->t_rel_percent, result.kitti->r_rel_deg_per_100m, result.kitti->segments);
    std::cout << line;
  } else if (result.kitti) {
    std::cout << "KITTI t_rel, r_rel: the path is shorter than 100 m\n";
  }
  FlushOutput();
}

void RunEvaluate(const EvaluateCommandOptions& options) {
  const Trajectory estimate = ReadTrajectory(options.estimate), reference = ReadTrajectory(options.reference);
  const MatchedTrajectories matched = Match(estimate, reference);
  EvaluateOptions how;
  how.alignment = options.alignment == "se3"   ? Alignment::kSE3
                  : options.alignment == "se2" ? Alignment::kSE2
                                               : Alignment::kNone;
  how.kitti = options.kitti;
  const Evaluation result = Evaluate(matched.T_world_estimate, matched.T_world_reference, how);
  options.json ? PrintJsonResult(result)
               : PrintTable(result, options.alignment, estimate.stamps.size(), reference.stamps.size());
  const auto mismatch = FindFrameMismatch(matched.T_world_estimate, matched.T_world_reference, how.alignment);
  if (mismatch) std::cerr << "terse: hint: " << Describe(*mismatch) << '\n';
}

}  // namespace

void AddEvaluateCommand(CLI::App& app) {
  auto options = std::make_shared<EvaluateCommandOptions>();
  CLI::App* command = app.add_subcommand("evaluate", "Compare a trajectory with a reference: ATE, RPE, KITTI");
  command->add_option("ESTIMATE", options->estimate, "TUM, KITTI or graph file")->required();
  command->add_option("REFERENCE", options->reference, "TUM, KITTI or graph file")->required();
  command->add_option("--align", options->alignment, "How the estimate is laid over the reference for ATE")
      ->check(OneOf({"se3", "se2", "none"}))
      ->type_name("NAME")
      ->capture_default_str();
  command->add_flag("--kitti", options->kitti, "Add KITTI's t_rel and r_rel over 100 to 800 m");
  command->add_flag("--json", options->json, "Print JSON");
  command->footer(
      "Example: terse generate ellipse --output ellipse.g2o --ground-truth truth.tum &&\n"
      "         terse solve ellipse.g2o --trajectory estimate.tum &&\n"
      "         terse evaluate estimate.tum truth.tum --align se3 --json");
  command->callback([options] { RunEvaluate(*options); });
}

}  // namespace terse
