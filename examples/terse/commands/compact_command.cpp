#include <cmath>
#include <iostream>

#include "commands/budget_options.h"
#include "commands/commands.h"
#include "commands/output_paths.h"
#include "commands/verbose.h"
#include "pictures/run_report.h"
#include "run/calibration.h"
#include "run/compact_run.h"
#include "run/compact_stats.h"
#include "run/ground_truth.h"
#include "run/progress.h"
#include "run/run_statistics.h"
#include "run/standard_output.h"
#include "terse/compact/compact_json.h"
#include "terse/compact/compact_map.h"
#include "terse/compact/contradicted_loops.h"
#include "terse/compact/json_file.h"
#include "terse/compact/map_file.h"
#include "terse/compact/random_choice.h"
#include "terse/compact/run_writer.h"
#include "terse/compact/thresholds_file.h"
#include "terse/compact/words.h"
#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/writable.h"

namespace terse {
namespace {

struct CompactCommandOptions {
  std::string path, directory;
  ReadOptions read;
  std::string continued;     // the folder of the run to continue
  std::string ground_truth;  // a file
  std::optional<Strategy> strategy;
  std::vector<double> range;
  std::optional<double> probability;
  std::optional<double> min_pose_gain, min_loop_gain;
  CompactBudget budget;
  double min_variance_drop = 0, retire_share = CompactOptions<SE3>().retire_share;
  std::string thresholds;  // a file to read them from
  bool auto_thresholds = false;
  std::optional<double> sample;  // share of the poses
  std::optional<double> innovation_quantile = kInnovationQuantile;
  CompositionOrder composition = CompositionOrder::kFirst;
  AngleMeasure angle = AngleMeasure::kViewDirection;
  CompactRobust robust;
  std::uint64_t seed = 1;
  Recovery recovery = Recovery::kV2;
  bool calibrate = true;
  int max_registrations = CompactOptions<SE3>().max_registrations;
  Record record = Record::kCandidates;
  std::optional<double> retire;  // nats that the removal of a pose may lose
  bool quiet = false;
  LogSink log;
};

// Usage, though only the file tells how many numbers are right.
template <class Pose>
void CheckRange(const PoseGraph<Pose>&, const CompactCommandOptions& options) {
  constexpr std::size_t kSize = Displacement<Pose>::kSize;
  if (options.range.empty() || options.range.size() == kSize) return;
  throw CLI::ValidationError("--range", std::to_string(options.range.size()) + " numbers given, but a " +
                                            std::to_string(Pose::kDim) + "D graph takes " +
                                            (kSize == 4 ? "X Y Z ANGLE" : "X Y ANGLE"));
}

// What the user gave; the rest from a sample of the file.
template <class Pose>
CompactOptions<Pose> MakeOptions(const PoseGraph<Pose>& graph, const GraphReplay<Pose>& replay,
                                 const CompactCommandOptions& from, nlohmann::ordered_json& sample) {
  constexpr int kSize = Displacement<Pose>::kSize;
  CompactOptions<Pose> options;
  options.strategy = *from.strategy;
  options.distance.angle = from.angle;
  options.composition = from.composition;
  options.innovation_quantile = from.innovation_quantile;
  options.solver.robust = from.robust.For(options);
  options.budget = from.budget;
  options.min_variance_drop = from.min_variance_drop;
  options.retire_share = from.retire_share;
  options.log = from.log;
  options.max_registrations = from.max_registrations;
  options.record = from.record;
  Thresholds<Pose>& thresholds = options.thresholds;
  thresholds.link_covariance = replay.LinkCovariance();
  thresholds.probability = from.probability.value_or(thresholds.probability);
  const bool complete = !from.range.empty() && from.min_loop_gain && from.min_pose_gain;
  if (!from.thresholds.empty()) {
    thresholds = ReadThresholds<Pose>(from.thresholds);
  } else if (from.auto_thresholds || (!complete && from.strategy != Strategy::kApal)) {
    const double before = SecondsNow();
    const SampledThresholds<Pose> chosen = SampleWithProgress(graph, from.sample, "sample", from.quiet, options);
    sample = {{"poses", chosen.sample_poses},
              {"loop_gain_90", chosen.loop_gain_90},
              {"pose_gain_90", chosen.pose_gain_90},
              {"seconds", SecondsNow() - before}};
  }
  if (!from.range.empty()) thresholds.range = Eigen::Map<const Vector<kSize>>(from.range.data());
  thresholds.probability = from.probability.value_or(thresholds.probability);
  thresholds.min_loop_gain = from.min_loop_gain.value_or(thresholds.min_loop_gain);
  thresholds.min_pose_gain = from.min_pose_gain.value_or(thresholds.min_pose_gain);
  return options;
}

// Where the file has loops and next to none of them is in the map, why, and what to change.
void WarnOfLostLoops(const Stats& stats, const CompactCommandOptions& options) {
  const auto number = [&](const char* key) { return stats.more.at(key).get<long>(); };
  const long offered = number("links_offered"), refused = number("links_refused");
  long kept = number("links_kept");
  if (options.strategy == Strategy::kBounded) kept += number("poses_anchored") + number("measurements_composed");
  if (offered == 0 || options.strategy == Strategy::kApal || options.strategy == Strategy::kGiven) return;
  const bool are_rare = 10 * offered <= static_cast<long>(stats.poses);
  const bool distrusted = refused > kept, uninformative = kept == 0 || (are_rare && 5 * kept < offered);
  if (!distrusted && !uninformative) return;
  std::cerr << "terse: warning: " << kept << " of " << offered << " loops are in the map; ";
  if (distrusted) {
    std::cerr << refused
              << " disagree with it by more than the innovation test allows: loops are wrong, or odometry is "
              << "worse than its information says (--innovation-quantile, --no-innovation-test, --robust gnc)\n";
  } else {
    std::cerr << "the others tell less than --min-loop-gain "
              << stats.more.at("thresholds").at("min_loop_gain").get<double>() << " nats\n";
  }
}

void PrintSummary(const Stats& stats, const std::string& composed, const CompactCommandOptions& options) {
  const auto percent = [](double part, double whole) { return whole > 0 ? 100 * part / whole : 100.0; };
  const auto number = [&](const char* key) { return stats.more.at(key).get<long>(); };
  char line[256];
  std::snprintf(line, sizeof(line),
                "%s kept %ld of %zu poses (%.1f %%) and %ld of %ld links (%.1f %%); %ld registrations tried, %ld links "
                "refused by the innovation test\n",
                Name(*options.strategy), number("poses_kept"), stats.poses,
                percent(static_cast<double>(number("poses_kept")), static_cast<double>(stats.poses)),
                number("links_kept"), number("links_offered"),
                percent(static_cast<double>(number("links_kept")), static_cast<double>(number("links_offered"))),
                number("registrations_tried"), number("links_refused"));
  std::cout << line << composed;
  std::snprintf(line, sizeof(line), "chi2 %g of the kept map, %.2f s; results in %s\n", stats.chi2, stats.seconds_total,
                options.directory.c_str());
  std::cout << line;
  if (stats.more.contains("errors")) {
    const auto& errors = stats.more.at("errors");
    std::snprintf(line, sizeof(line), "ATE %.4g m, %.4g deg against %s\n", errors.at("ate_m").get<double>(),
                  errors.at("ate_deg").get<double>(), options.ground_truth.c_str());
    std::cout << line;
  }
  FlushOutput();
}

// The random baseline keeps as many poses and links as a run by information does.
template <class Pose>
void ChooseAtRandom(const PoseGraph<Pose>& graph, CompactOptions<Pose> settings, const CompactCommandOptions& options,
                    GraphReplay<Pose>& replay) {
  GraphReplay<Pose> informed(graph);
  settings.strategy = Strategy::kFpfl;
  const CompactRun<Pose> run = RunWithProgress(CompactPoseSlam<Pose>(settings), informed, "count", options.quiet);
  DrawAtRandom(replay, run.PosesKept(), run.LinksKept(), options.seed);
}

// What there was before; nothing but for --continue.
template <class Pose>
struct Before {
  CompactMap<Pose> map;
  RunRows rows;
  InformationScale information_scale;
};

template <class Pose>
Before<Pose> TakeBefore(const std::optional<CompactMapFile>& file, const CompactCommandOptions& options) {
  if (!file) return {};
  const auto* map = std::get_if<CompactMap<Pose>>(&file->map);
  if (map == nullptr) {
    throw std::invalid_argument(std::to_string(Pose::kDim) + "D, but the map to continue, " + options.continued +
                                "/graph.json, is not");
  }
  return {*map, ReadRunRows(options.continued, map->poses.size()), file->information_scale};
}

template <class Pose>
CompactPoseSlam<Pose> StartFrom(const CompactMap<Pose>& map, const CompactOptions<Pose>& settings,
                                const CompactCommandOptions& options) {
  if (map.poses.empty()) return CompactPoseSlam<Pose>(settings);
  std::optional<CompactPoseSlam<Pose>> slam;
  AddPathToErrors(options.continued + "/graph.json", [&] { slam = CompactPoseSlam<Pose>::Restore(map, settings); });
  return std::move(*slam);
}

template <class Pose>
std::optional<TruePoses> ReadTruthOfAll(const CompactMap<Pose>& before, const GraphReplay<Pose>& replay,
                                        const std::string& path) {
  if (path.empty()) return std::nullopt;
  std::vector<PoseId> ids;
  for (const auto& pose : before.poses) ids.push_back(pose.id);
  for (const auto& input : replay.Inputs()) ids.push_back(input.id);
  return ReadTruePoses<Pose>(ids, path);
}

// What it takes to make the information right, and how that came about.
struct Calibrated {
  InformationCalibration found;
  nlohmann::ordered_json report;  // of stats.json
};

// A map goes on with the scales that it began with.
template <class Pose>
Calibrated Calibrate(const PoseGraph<Pose>& graph, const Before<Pose>& before, const CompactCommandOptions& options) {
  Calibrated out;
  std::string message;
  if (!before.map.poses.empty()) {
    out.found.scale = before.information_scale;
    out.report = {{"verdict", "continued"}, {"sigma_scale", ToJson(out.found.scale)}};
    message = "standard deviations scaled as in " + options.continued;
  } else if (options.calibrate) {
    out.found = CalibrateInformation(graph);
    out.report = ToJson(out.found);
    message = out.found.message + "; scaled to these (--calibrate-information off leaves it)";
  } else {
    out.report = {{"verdict", "off"}, {"sigma_scale", ToJson(out.found.scale)}};
  }
  if (!out.found.scale.IsOne() && !options.quiet)
    std::cerr << "terse: note: " << options.path << ": " << message << '\n';
  return out;
}

// One run over a graph.
template <class Pose>
struct Attempt {
  CompactRun<Pose> run;
  StepRecorder<Pose> recorder;
  nlohmann::ordered_json sample;  // of stats.json
  int links_before;               // of the map that it went on with
};

template <class Pose>
Attempt<Pose> RunOnce(const PoseGraph<Pose>& graph, GraphReplay<Pose>& replay, const CompactMap<Pose>& before,
                      const CompactCommandOptions& options, const TruePoses* known) {
  nlohmann::ordered_json sample;
  const CompactOptions<Pose> settings = MakeOptions(graph, replay, options, sample);
  if (settings.strategy == Strategy::kGiven) ChooseAtRandom(graph, settings, options, replay);
  StepRecorder<Pose> recorder(static_cast<int>(replay.Inputs().size()), known);
  CompactPoseSlam<Pose> slam = StartFrom(before, settings, options);
  const int links_before = slam.LinksKept();
  CompactRun<Pose> run = RunWithProgress<Pose>(
      std::move(slam), replay, "poses", options.quiet,
      [&](const CompactPoseSlam<Pose>& now, const Decision& decision, double s) { recorder.Add(now, decision, s); });
  return {std::move(run), std::move(recorder), std::move(sample), links_before};
}

// Of stats.json: what was judged, and why; nothing if nothing was.
template <class Pose>
nlohmann::ordered_json ToJson(const LoopJury<Pose>& jury, const PoseGraph<Pose>& graph,
                              const std::vector<std::string>& reasons, double seconds) {
  if (reasons.empty()) return nullptr;
  std::vector<std::pair<PoseId, PoseId>> wrong;
  for (const FactorId id : jury.LeftOut()) {
    const FactorPoses ends = PosesOf(graph.FindFactor(id)->factor);
    wrong.emplace_back(ends.first, ends.second);
  }
  nlohmann::ordered_json report = LoopsJudgedJson(LoopFactors(graph).size(), reasons, wrong, seconds);
  report["sigma_scale"] = ToJson(jury.Scale());
  return report;
}

template <class Pose>
GraphReplay<Pose> ReplayOf(const PoseGraph<Pose>& graph, const std::vector<PoseId>& seen) {
  return seen.empty() ? GraphReplay<Pose>(graph) : GraphReplay<Pose>(graph, seen);
}

// The map of the loops that are not judged wrong.
template <class Pose>
struct Judged {
  std::optional<Attempt<Pose>> attempt;
  PoseGraph<Pose> graph;          // that it is of
  InformationScale scale;         // of it
  nlohmann::ordered_json report;  // of stats.json
};

// `seen`: poses of the map that the run goes on with, which stays as it is:
// nothing is judged.
template <class Pose>
Judged<Pose> RunJudged(const PoseGraph<Pose>& graph, const InformationCalibration& information,
                       const CompactMap<Pose>& before, const std::vector<PoseId>& seen,
                       const CompactCommandOptions& options, const TruePoses* known) {
  Progress progress("judging loops, iterations", 0, options.quiet);
  BatchOptions batch;
  batch.log = options.log;
  batch.progress = [&](int iteration, double) {
    progress.Update(iteration);
    return true;
  };
  RobustOptions robust = options.robust.options;
  robust.kernel = seen.empty() ? options.robust.Kernel(*options.strategy) : RobustKernel::kNone;
  LoopJury<Pose> jury(graph, information, robust, batch);
  std::vector<std::string> reasons;
  jury.on_judging = [&](const std::string& why) {
    reasons.push_back(why);
    progress.Say("terse: note: " + options.path + ": " + why +
                 ": all are judged together, and the map is made without those that are wrong then");
  };
  double seconds = 0;
  const auto timed = [&](auto&& judge) {
    const double before = SecondsNow();
    const bool is_other = judge();
    seconds += SecondsNow() - before;
    return is_other;
  };
  Judged<Pose> out;
  const auto run_once = [&] {
    out.attempt.reset();
    GraphReplay<Pose> replay = ReplayOf(jury.Remaining(), seen);
    out.attempt.emplace(RunOnce(jury.Remaining(), replay, before, options, known));
  };
  timed([&] { return jury.JudgeAtFirst(); });
  run_once();
  if (timed([&] { return jury.JudgeBy(out.attempt->run); })) run_once();
  out.graph = jury.Remaining();
  out.scale = jury.Scale();
  out.report = ToJson(jury, graph, reasons, seconds);
  return out;
}

template <class Pose>
void RunOn(const PoseGraph<Pose>& file_graph, const Before<Pose>& before, CompactCommandOptions options,
           double seconds_read, double start) {
  const Calibrated calibrated = Calibrate(file_graph, before, options);
  if (!calibrated.found.scale.IsOne() && options.innovation_quantile == kInnovationQuantile) {
    options.innovation_quantile = kInnovationQuantileOfScaled;
  }
  std::vector<PoseId> seen;
  for (const auto& pose : before.map.poses) seen.push_back(pose.id);
  std::optional<TruePoses> truth;
  {
    const GraphReplay<Pose> replay = ReplayOf(file_graph, seen);
    if (!seen.empty() && replay.Inputs().empty() && !options.quiet) {
      std::cerr << "terse: warning: all poses of " << options.path << " are in " << options.continued
                << " already: the map stays as it is\n";
    }
    // Before the long run, not after it: the trajectory has ids for stamps.
    for (const auto& input : replay.Inputs()) RequireStampId(input.id);
    truth = ReadTruthOfAll(before.map, replay, options.ground_truth);
  }
  const TruePoses* known = truth ? &*truth : nullptr;
  Judged<Pose> judged = RunJudged(file_graph, calibrated.found, before.map, seen, options, known);
  auto& attempt = judged.attempt;
  CompactRun<Pose>& run = attempt->run;
  if (options.retire) RetireFrom(run, *options.retire);
  const RunTrajectories trajectories = MakeRunTrajectories(run.slam, options.recovery, known);
  Stats stats = MakeStats(judged.graph, run, EvaluateRun(trajectories, Pose::kDim));
  stats.more["information"] = calibrated.report;
  if (!judged.report.is_null()) stats.more["loops_judged"] = judged.report;
  if (!attempt->sample.is_null()) stats.more["sample"] = attempt->sample;
  if (!seen.empty()) {
    stats.more["continued"] = {{"poses", seen.size()}, {"links_kept", attempt->links_before}};
    stats.more["links_offered"] = run.links_offered + attempt->links_before;
  }
  stats.seconds_read = seconds_read;
  const RunResults<Pose> results{run.slam,
                                 run.result,
                                 run.decisions,
                                 attempt->recorder.Steps(),
                                 trajectories,
                                 options.recovery,
                                 options.read.rotation_information,
                                 before.rows,
                                 judged.scale,
                                 run.retired};
  stats.seconds_covariance = WriteRun(results, options.directory);
  stats.seconds_total = SecondsNow() - start;
  WriteJson(ToJson(stats), options.directory + "/stats.json");
  if (!options.quiet) {
    PrintSummary(stats, Describe(CountComposed(run.slam)) + Describe(CountRetired(run)), options);
    WarnOfLostLoops(stats, options);
  }
  const std::string undetermined = run.slam.Solver().DescribeUndetermined();
  if (!undetermined.empty() && !options.quiet) std::cerr << "terse: warning: " << undetermined << '\n';
}

// Of --continue: what is not given is as it was.
std::optional<CompactMapFile> ReadContinued(CompactCommandOptions& options) {
  if (options.continued.empty()) return std::nullopt;
  CompactMapFile file = ReadCompactMap(options.continued + "/graph.json");
  if (!options.strategy) options.strategy = file.strategy;
  if (options.strategy == Strategy::kGiven) {
    throw CLI::ValidationError("--continue", "rfpfl draws from all poses beforehand: there is nothing to continue");
  }
  if (options.thresholds.empty() && !options.auto_thresholds)
    options.thresholds = options.continued + "/thresholds.json";
  return file;
}

void Compact(CompactCommandOptions options) {
  // The folder of --continue may be that of --output: the map grows in place.
  CheckOutputPaths(
      RunFiles("--output", options.directory),
      {{"FILE", options.path}, {"--thresholds", options.thresholds}, {"--ground-truth", options.ground_truth}});
  const double start = SecondsNow();
  const std::optional<CompactMapFile> before = ReadContinued(options);
  if (!options.strategy) options.strategy = CompactOptions<SE3>().strategy;
  const GraphFile file = ReadGraph(options.path, options.read);
  const double seconds_read = SecondsNow() - start;
  if (!options.quiet) ReportRepairs(file, options.path);
  std::visit([&](const auto& graph) { CheckRange(graph, options); }, file.graph);
  // Before the long run, not after it.
  RequireFolder(options.directory, "decisions.csv");
  const auto run = [&](const auto& graph) {
    using Pose = std::decay_t<decltype(*graph.Poses().front().T_world_body)>;
    RunOn(graph, TakeBefore<Pose>(before, options), options, seconds_read, start);
  };
  AddPathToErrors(options.path, [&] { std::visit(run, file.graph); });
  // Read back from the files, when the run is no longer in memory.
  WriteReport({options.directory}, options.directory + "/report.html");
}

// What to do with which files.
void AddTaskOptions(CLI::App& command, CompactCommandOptions& options) {
  AddChoice(command, "--strategy", options.strategy, Choices<Strategy>(),
            "All poses all links, all poses few links, few poses few links, as few at random, or as many as the area "
            "needs (bounded: where a link finds the robot in known terrain its chain starts anew at a kept pose); "
            "--continue goes on as before")
      ->default_str(Name(CompactOptions<SE3>().strategy));
  command
      .add_option("--continue", options.continued,
                  "Continue the map in this folder (its graph.json and thresholds.json) with the poses of FILE that it "
                  "has not seen: FILE is the longer graph, or the new part alone, which names poses of the map")
      ->type_name("DIR");
  command
      .add_option("--ground-truth", options.ground_truth,
                  "True poses, a TUM or KITTI file or a graph: writes the errors of the run and of its steps")
      ->type_name("FILE");
}

void AddThresholdOptions(CLI::App& command, CompactCommandOptions& options) {
  AddBudgetOptions(command, options.budget);
  AddBoundedOptions(command, options.min_variance_drop, options.retire_share);
  command
      .add_option("--range", options.range,
                  "Sensor range in metres and radians; by default 1.5 times the longest link of the file, less one in "
                  "a hundred")
      ->expected(3, 4)
      ->check(PositiveNumber())
      ->option_text("X Y Z ANGLE (3D) | X Y ANGLE (2D)");
  command
      .add_option("--probability", options.probability,
                  "Least probability of being in range, per dimension (0.1 unless a file says otherwise)")
      ->check(NumberIn(0, 0.999999))
      ->type_name("S");
  command
      .add_option("--min-pose-gain", options.min_pose_gain,
                  "A pose is kept above this gain (nats), or if a loop closes at it")
      ->check(NonNegativeNumber())
      ->type_name("G");
  command.add_option("--min-loop-gain", options.min_loop_gain, "A link is kept above this gain (nats)")
      ->check(NonNegativeNumber())
      ->type_name("G");
  CLI::Option* file =
      command
          .add_option("--thresholds", options.thresholds, "Read them from a thresholds.json; options above override")
          ->type_name("FILE");
  CLI::Option* sampled = command.add_flag("--auto-thresholds", options.auto_thresholds,
                                          "Choose them from a sample of the file, as if none were given");
  AddSampleOption(command, options.sample)->excludes(file);
  file->excludes(sampled);
}

// How poses and links are judged, and what is kept of that.
void AddMethodOptions(CLI::App& command, CompactCommandOptions& options) {
  command
      .add_option("--max-registrations", options.max_registrations,
                  "Links tried per pose, at most; those that promise the most information come first")
      ->check(CLI::PositiveNumber.description(""))
      ->type_name("N")
      ->capture_default_str();
  AddChoice(
      command, "--record", options.record, Choices<Record>(),
      "What decisions.csv and decisions.jsonl keep of the search at every pose: counts, the links that were tried, "
      "or the best of those not tried too");
  command
      .add_option(
          "--retire", options.retire,
          "After the run poses retire where the map is denser than needed: those are marginalised whose removal "
          "loses no more than this (nats)")
      ->check(NonNegativeNumber())
      ->type_name("NATS");
  AddInnovationOptions(command, options.innovation_quantile);
  AddRobustOptions(command, options.robust);
  AddChoice(command, "--composition", options.composition, Choices<CompositionOrder>(),
            "Order of the covariance of chains over dropped poses");
  AddChoice(command, "--angle", options.angle, Choices<AngleMeasure>(),
            "The angle of the sensor range in 3D: between the view directions, or of the rotation");
  AddSeedOption(command, options.seed, "Of --strategy rfpfl");
  AddChoice(command, "--recover", options.recovery, Choices<Recovery>(),
            "How dropped poses come back: as first estimated, chained to the kept pose before them, or fitted between "
            "the kept poses around them");
  AddChoice(
      command, "--calibrate-information", options.calibrate, {{"auto", true}, {"off", false}},
      "Whether information that nobody estimated (the unit matrix, one constant) and that the residuals contradict "
      "is scaled to agree with them; --continue keeps the scales of its map");
}

}  // namespace

void AddCompactCommand(CLI::App& app) {
  auto options = std::make_shared<CompactCommandOptions>();
  CLI::App* command = app.add_subcommand("compact", "Keep only the poses and links of a graph that carry information");
  command->add_option("FILE", options->path, "The graph file (g2o, TORO or iSAM)")->required();
  AddTaskOptions(*command, *options);
  AddThresholdOptions(*command, *options);
  AddMethodOptions(*command, *options);
  AddReadOptions(*command, options->read);
  command->add_option("--output", options->directory, "Folder for the results, made if it is missing")
      ->required()
      ->type_name("DIR");
  command->add_flag("--quiet", options->quiet, "Print nothing but errors");
  AddVerboseOption(*command, options->log);
  command->footer(
      "Example: terse generate ellipse-n --laps 1 --output laps.g2o --ground-truth laps.tum &&\n"
      "         terse compact laps.g2o --ground-truth laps.tum --output laps_compact &&\n"
      "         terse generate ellipse-n --laps 2 --output longer.g2o &&\n"
      "         terse compact longer.g2o --continue laps_compact --output longer_compact");
  command->callback([options] { Compact(*options); });
}

}  // namespace terse
