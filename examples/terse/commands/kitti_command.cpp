#include <charconv>
#include <iostream>
#include <numeric>

#include "commands/budget_options.h"
#include "commands/commands.h"
#include "commands/output_paths.h"
#include "commands/stereo_program.h"
#include "commands/verbose.h"
#include "pictures/run_report.h"
#include "run/kitti_output.h"
#include "run/kitti_run.h"
#include "terse/compact/run_writer.h"
#include "terse/compact/thresholds_file.h"
#include "terse/compact/words.h"
#include "terse/core/error.h"
#include "terse/core/writable.h"

namespace terse {
namespace {

enum class Search { kInformation, kAppearance, kBoth };

// A, A + 1 ... B - 1; either may be left out.
struct FrameRange {
  std::optional<int> begin, end;
};

struct KittiCommandOptions {
  std::string path, directory, thresholds, ground_truth, frames, remember = kRememberAll;
  Strategy strategy = StereoCompactOptions().strategy;
  CompactBudget budget;
  CompactRobust robust;
  double step_budget_ms = kFrameMs;
  double min_variance_drop = 0, retire_share = CompactOptions<SE3>().retire_share;
  Search search = Search::kInformation;
  MotionCovariance covariance = MotionCovariance::kSchur;
  bool quiet = false;
  LogSink log;
};

std::optional<int> ParseNumber(const std::string& text) {
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || value < 0) return std::nullopt;
  return value;
}

std::optional<FrameRange> ParseRange(const std::string& text) {
  const auto colon = text.find(':');
  if (colon == std::string::npos) return std::nullopt;
  const std::string first = text.substr(0, colon), last = text.substr(colon + 1);
  FrameRange range{ParseNumber(first), ParseNumber(last)};
  if ((!first.empty() && !range.begin) || (!last.empty() && !range.end)) return std::nullopt;
  if (range.end && range.begin.value_or(0) >= *range.end) return std::nullopt;
  return range;
}

std::vector<int> ChooseFrames(const KittiSequence& sequence, const KittiCommandOptions& options) {
  const FrameRange range = ParseRange(options.frames).value_or(FrameRange{});
  const int begin = range.begin.value_or(0), end = range.end.value_or(sequence.Size());
  if (end > sequence.Size() || begin >= end) {
    throw FileError(options.path, 0,
                    "frames " + options.frames + " are asked for, but there are " + std::to_string(sequence.Size()));
  }
  std::vector<int> out(static_cast<std::size_t>(end - begin));
  std::iota(out.begin(), out.end(), begin);
  return out;
}

struct Outcome {
  KittiRun run;
  std::optional<KittiErrors> errors;
};

Outcome RunOnce(const KittiSequence& sequence, const std::vector<int>& frames, const std::vector<SE3>& truth,
                const KittiCommandOptions& options, bool by_appearance, const std::string& folder) {
  KittiRunOptions how;
  how.slam.compact = StereoCompactOptions(options.strategy);
  if (!options.thresholds.empty()) how.slam.compact.thresholds = ReadThresholds<SE3>(options.thresholds);
  how.slam.compact.budget = options.budget;
  how.slam.compact.min_variance_drop = options.min_variance_drop;
  how.slam.compact.retire_share = options.retire_share;
  how.slam.compact.solver.robust = options.robust.For(how.slam.compact);
  how.slam.compact.solver.budget_seconds = options.step_budget_ms / 1000;
  how.slam.compact.most_dropped = MostDropped(options.remember);
  how.by_appearance = by_appearance;
  how.quiet = options.quiet;
  how.truth = truth;
  how.slam.odometry.covariance = how.slam.verifier.covariance = options.covariance;
  how.slam.log = options.log;
  LoopsFile loops(folder + "/loops.csv");
  how.after_step = [&](const StereoSlamStep& step) { loops.Add(step); };
  Outcome out{RunKitti(sequence, frames, how), std::nullopt};
  loops.Commit();
  if (!out.run.look_back_failure.empty() && !options.quiet) {
    std::cerr << "terse: warning: " << options.path
              << ": loops could not be judged together: " << out.run.look_back_failure << '\n';
  }
  if (const LookedBack& back = out.run.looked_back; !back.why.empty() && !options.quiet) {
    std::cerr << "terse: note: " << options.path << ": " << back.why << ": all were judged together, and "
              << (back.wrong.empty()
                      ? "none is left out for it"
                      : "the map is made without the " + std::to_string(back.wrong.size()) + " that are wrong")
              << '\n';
  }
  if (out.run.truth.size() > 1) out.errors = ComputeKittiErrors(out.run, sequence);
  WriteKittiResults(out.run, sequence, out.errors, folder);
  WriteReport({folder}, folder + "/report.html");
  if (!options.quiet) PrintKittiSummary(out.run, out.errors, folder);
  return out;
}

void Kitti(const KittiCommandOptions& options) {
  CheckOutputPaths(RunFiles("--output", options.directory),
                   {{"--thresholds", options.thresholds}, {"--ground-truth", options.ground_truth}});
  const KittiSequence sequence(options.path);
  const std::vector<int> frames = ChooseFrames(sequence, options);
  // Before the long run, not after it.
  std::vector<SE3> truth;
  if (!options.ground_truth.empty()) truth = ReadKittiTruth(options.ground_truth, sequence, frames);
  RequireFolder(options.directory, "decisions.csv");
  if (options.search != Search::kBoth) {
    RunOnce(sequence, frames, truth, options, options.search == Search::kAppearance, options.directory);
    return;
  }
  const std::string other = options.directory + "/appearance";
  RequireFolder(other, "decisions.csv");
  const Outcome information = RunOnce(sequence, frames, truth, options, false, options.directory);
  const Outcome appearance = RunOnce(sequence, frames, truth, options, true, other);
  WriteReport({options.directory, other}, options.directory + "/comparison.html");
  if (!options.quiet) {
    PrintSearchComparison(information.run, information.errors, appearance.run, appearance.errors);
  }
}

}  // namespace

void AddKittiCommand(CLI::App& app) {
  auto options = std::make_shared<KittiCommandOptions>();
  CLI::App* command = app.add_subcommand("kitti", kKittiDescription);
  command
      ->add_option("DIR", options->path, "Folder with image_0, image_1 (or image_2, image_3), calib.txt and times.txt")
      ->required();
  command->add_option("--output", options->directory, "Folder for the results, made if it is missing")
      ->required()
      ->type_name("DIR");
  AddChoice(*command, "--strategy", options->strategy,
            Choices<Strategy>({Strategy::kApal, Strategy::kApfl, Strategy::kFpfl, Strategy::kBounded}),
            "All poses all links, all poses few links, few poses few links, or as many as the area needs: where a link "
            "finds the camera in known terrain its chain starts anew at a kept pose");
  command
      ->add_option("--thresholds", options->thresholds,
                   "A thresholds.json; by default thresholds for a vehicle at ten frames a second")
      ->type_name("FILE");
  AddBudgetOptions(*command, options->budget);
  AddBoundedOptions(*command, options->min_variance_drop, options->retire_share);
  AddRobustOptions(*command, options->robust);
  AddStepBudgetOption(*command, options->step_budget_ms);
  AddRememberOption(
      *command, options->remember,
      "Dropped poses that are remembered: so many of the newest, and those on the chains of others; older "
      "ones are left out of the trajectory and of the files with a row per pose, loops are not judged together at the "
      "end, and memory grows with the map alone")
      .capture_default_str();
  command->add_option("--frames", options->frames, "Only frames A, A + 1 ... B - 1; either may be left out")
      ->check(
          [](const std::string& text) { return ParseRange(text) ? "" : text + " is no range of frames like 0:100"; })
      ->type_name("A:B");
  command
      ->add_option("--ground-truth", options->ground_truth,
                   "True poses, a KITTI or TUM file: prints t_rel, r_rel, ATE and RPE")
      ->type_name("FILE");
  AddChoice(*command, "--candidates", options->search,
            {{"information", Search::kInformation}, {"appearance", Search::kAppearance}, {"both", Search::kBoth}},
            "Where loop candidates come from: distance and information, or a vocabulary of visual words, which keeps "
            "all poses and verified loops; both: one after the other, and a comparison");
  AddChoice(*command, "--covariance", options->covariance,
            {{"schur", MotionCovariance::kSchur}, {"monte-carlo", MotionCovariance::kMonteCarlo}},
            "Of measured motions, odometry and loops: from the residuals, calibrated; or the paper's, from 100 "
            "estimates with noise of 1 pixel");
  command->add_flag("--quiet", options->quiet, "Print nothing but errors");
  AddVerboseOption(*command, options->log);
  command->footer(
      "Example: terse generate stereo --laps 1 --frames 180 --size 306x92 --output street &&\n"
      "         terse kitti street --frames 0:40 --output street_map --ground-truth street/poses.txt");
  command->callback([options] { Kitti(*options); });
}

}  // namespace terse
