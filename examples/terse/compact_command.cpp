#include <cmath>
#include <iostream>

#include "commands.h"
#include "compact_output.h"
#include "compact_run.h"
#include "covariance_output.h"
#include "report.h"
#include "terse/compact/thresholds.h"
#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/covariance/incremental_marginals.h"
#include "thresholds_file.h"
#include "verbose.h"

namespace terse {
namespace {

struct CompactCommandOptions {
  std::string path, directory;
  ReadOptions read;
  Strategy strategy = Strategy::kFpfl;
  std::vector<double> range;
  std::optional<double> probability;
  std::optional<double> min_pose_gain, min_loop_gain;
  std::string thresholds;  // a file to read them from
  bool auto_thresholds = false;
  std::optional<double> sample;  // share of the poses
  std::optional<double> innovation_quantile = 0.9999;
  CompositionOrder composition = CompositionOrder::kFirst;
  AngleMeasure angle = AngleMeasure::kViewDirection;
  RobustOptions robust;
  std::uint64_t seed = 1;
  Recovery recovery = Recovery::kV2;
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
                                 const CompactCommandOptions& from, Stats& stats) {
  constexpr int kSize = Displacement<Pose>::kSize;
  CompactOptions<Pose> options;
  options.strategy = from.strategy;
  options.distance.angle = from.angle;
  options.composition = from.composition;
  options.innovation_quantile = from.innovation_quantile;
  options.solver.robust = from.robust;
  options.log = from.log;
  options.link_covariance = replay.LinkCovariance();
  options.probability = from.probability.value_or(options.probability);
  const bool complete = !from.range.empty() && from.min_loop_gain && from.min_pose_gain;
  if (!from.thresholds.empty()) {
    ReadThresholds(from.thresholds, options);
  } else if (from.auto_thresholds || (!complete && from.strategy != Strategy::kApal)) {
    const double before = SecondsNow();
    const Thresholds<Pose> chosen = SampleThresholds(graph, from.sample, "sample", from.quiet, options);
    stats.more["sample"] = {{"poses", chosen.sample_poses},
                            {"loop_gain_90", chosen.loop_gain_90},
                            {"pose_gain_90", chosen.pose_gain_90},
                            {"seconds", SecondsNow() - before}};
  }
  if (!from.range.empty()) options.range = Eigen::Map<const Vector<kSize>>(from.range.data());
  options.probability = from.probability.value_or(options.probability);
  options.min_loop_gain = from.min_loop_gain.value_or(options.min_loop_gain);
  options.min_pose_gain = from.min_pose_gain.value_or(options.min_pose_gain);
  return options;
}

template <class Pose>
void WriteResults(const CompactPoseSlam<Pose>& slam, const BatchResult<Pose>& result,
                  const std::vector<Decision>& decisions, const CompactCommandOptions& options, Stats& stats) {
  WriteCompactMap(slam, result, options.recovery, options.read.rotation_information, options.directory);
  WriteDecisions(decisions, options.directory + "/decisions.csv");
  std::vector<PoseId> ids;
  for (const auto& node : slam.Solver().Graph().Poses()) ids.push_back(node.id);
  const double before = SecondsNow();
  // Finish left the solver at the optimum, with the weights of its loops.
  const IncrementalMarginals<Pose> marginals(slam.Solver());
  WriteCovariances<Pose>(ids, marginals.AllMarginals(), options.directory + "/covariances.csv");
  stats.seconds_covariance = SecondsNow() - before;
}

void PrintSummary(const Stats& stats, const CompactCommandOptions& options) {
  const auto percent = [](double part, double whole) { return whole > 0 ? 100 * part / whole : 100.0; };
  const auto number = [&](const char* key) { return stats.more.at(key).get<long>(); };
  char line[256];
  std::snprintf(line, sizeof(line),
                "%s kept %ld of %zu poses (%.1f %%) and %ld of %ld links (%.1f %%); %ld registrations tried, %ld links "
                "refused by the innovation test\n",
                Name(options.strategy), number("poses_kept"), stats.poses,
                percent(static_cast<double>(number("poses_kept")), static_cast<double>(stats.poses)),
                number("links_kept"), number("links_offered"),
                percent(static_cast<double>(number("links_kept")), static_cast<double>(number("links_offered"))),
                number("registrations_tried"), number("links_refused"));
  std::cout << line;
  std::snprintf(line, sizeof(line), "chi2 %g of the kept map, %.2f s; results in %s\n", stats.chi2, stats.seconds_total,
                options.directory.c_str());
  std::cout << line;
  FlushOutput();
}

// The random baseline keeps as many poses and links as a run by information does.
template <class Pose>
void DrawAtRandom(const PoseGraph<Pose>& graph, CompactOptions<Pose> settings, const CompactCommandOptions& options,
                  GraphReplay<Pose>& replay) {
  GraphReplay<Pose> informed(graph);
  settings.strategy = Strategy::kFpfl;
  CompactRunOptions<Pose> run_options;
  run_options.label = "count";
  run_options.quiet = options.quiet;
  const CompactRun<Pose> run = RunCompact(settings, informed, run_options);
  replay.DrawAtRandom(run.PosesKept(), run.slam.LinksKept(), options.seed);
}

template <class Pose>
void CompactGraph(const PoseGraph<Pose>& graph, const CompactCommandOptions& options, Stats stats, double start) {
  GraphReplay<Pose> replay(graph);
  const CompactOptions<Pose> settings = MakeOptions(graph, replay, options, stats);
  if (options.strategy == Strategy::kRfpfl) DrawAtRandom(graph, settings, options, replay);
  CompactRunOptions<Pose> run_options;
  run_options.quiet = options.quiet;
  CompactRun<Pose> run = RunCompact(settings, replay, run_options);
  const CompactPoseSlam<Pose>& slam = run.slam;
  const BatchResult<Pose>& result = run.result;
  stats.step_seconds = std::move(run.step_seconds);
  WriteThresholds(settings, options.directory + "/thresholds.json");
  WriteResults(slam, result, run.decisions, options, stats);
  const EdgeCounts kept = CountEdges(slam.Solver().Graph());
  stats.poses = graph.Poses().size();
  stats.counts = CountEdges(graph);
  stats.chi2 = result.chi2;
  stats.normalized_chi2 = kept.scalars > 0 ? result.chi2 / static_cast<double>(kept.scalars) : 0;
  stats.log_determinant = result.log_determinant;
  stats.iterations = result.iterations;
  stats.converged = result.Converged();
  stats.termination = Name(result.termination);
  stats.phases = slam.Solver().Seconds();
  stats.more["strategy"] = Name(options.strategy);
  stats.more["poses_kept"] = slam.Solver().Graph().Poses().size();
  stats.more["links_kept"] = slam.LinksKept();
  stats.more["links_offered"] = replay.LinksOffered();
  stats.more["registrations_tried"] = run.registrations_tried;
  stats.more["links_refused"] = run.links_refused;
  nlohmann::ordered_json thresholds = ThresholdsToJson(settings);
  thresholds.erase("link_covariance");
  stats.more["thresholds"] = std::move(thresholds);
  stats.seconds_total = SecondsNow() - start;
  WriteJson(ToJson(stats), options.directory + "/stats.json");
  if (!options.quiet) PrintSummary(stats, options);
}

void Compact(const CompactCommandOptions& options) {
  const double start = SecondsNow();
  const GraphFile file = ReadGraph(options.path, options.read);
  Stats stats;
  stats.seconds_read = SecondsNow() - start;
  if (!options.quiet) ReportRepairs(file, options.path);
  std::visit([&](const auto& graph) { CheckRange(graph, options); }, file.graph);
  // Before the long run, not after it.
  RequireFolder(options.directory);
  AddPathToErrors(options.path, [&] {
    std::visit([&](const auto& graph) { CompactGraph(graph, options, std::move(stats), start); }, file.graph);
  });
}

}  // namespace

void AddCompactCommand(CLI::App& app) {
  auto options = std::make_shared<CompactCommandOptions>();
  CLI::App* command = app.add_subcommand("compact", "Keep only the poses and links of a graph that carry information");
  command->add_option("FILE", options->path, "The graph file (g2o, TORO or iSAM)")->required();
  AddChoice(
      *command, "--strategy", options->strategy,
      {{"apal", Strategy::kApal}, {"apfl", Strategy::kApfl}, {"fpfl", Strategy::kFpfl}, {"rfpfl", Strategy::kRfpfl}},
      "All poses all links, all poses few links, few poses few links, or as few at random")
      ->default_str("")
      ->required();
  command
      ->add_option("--range", options->range,
                   "Sensor range in metres and radians; by default chosen from the first 60 % of the file, as are "
                   "the gains")
      ->expected(3, 4)
      ->check(PositiveNumber())
      ->option_text("X Y Z ANGLE (3D) | X Y ANGLE (2D)");
  command
      ->add_option("--probability", options->probability,
                   "Least probability of being in range, per dimension (0.1 unless a file says otherwise)")
      ->check(NumberIn(0, 0.999999))
      ->type_name("S");
  command
      ->add_option("--min-pose-gain", options->min_pose_gain,
                   "A pose is kept above this gain (nats), or if a loop closes at it")
      ->check(NonNegativeNumber())
      ->type_name("G");
  command->add_option("--min-loop-gain", options->min_loop_gain, "A link is kept above this gain (nats)")
      ->check(NonNegativeNumber())
      ->type_name("G");
  CLI::Option* file =
      command
          ->add_option("--thresholds", options->thresholds, "Read them from a thresholds.json; options above override")
          ->type_name("FILE");
  CLI::Option* sampled = command->add_flag("--auto-thresholds", options->auto_thresholds,
                                           "Choose them from the first poses of the file, as if none were given");
  AddSampleOption(*command, options->sample)->excludes(file);
  file->excludes(sampled);
  AddInnovationOptions(*command, options->innovation_quantile);
  AddRobustOptions(*command, options->robust);
  AddChoice(*command, "--composition", options->composition,
            {{"first", CompositionOrder::kFirst}, {"fourth", CompositionOrder::kFourth}},
            "Order of the covariance of chains over dropped poses");
  AddChoice(*command, "--angle", options->angle,
            {{"view", AngleMeasure::kViewDirection}, {"rotation", AngleMeasure::kRotation}},
            "The angle of the sensor range in 3D: between the view directions, or of the rotation");
  AddSeedOption(*command, options->seed, "Of --strategy rfpfl");
  AddChoice(*command, "--recover", options->recovery,
            {{"v0", Recovery::kV0}, {"v1", Recovery::kV1}, {"v2", Recovery::kV2}},
            "How dropped poses come back: as first estimated, chained to the kept pose before them, or fitted between "
            "the kept poses around them");
  AddReadOptions(*command, options->read);
  command->add_option("--output", options->directory, "Folder for the results, made if it is missing")
      ->required()
      ->type_name("DIR");
  command->add_flag("--quiet", options->quiet, "Print nothing but errors");
  AddVerboseOption(*command, options->log);
  command->footer(
      "Example: terse generate ellipse-n --laps 2 --output laps.g2o &&\n"
      "         terse compact laps.g2o --strategy fpfl --output laps_fpfl");
  command->callback([options] { Compact(*options); });
}

}  // namespace terse
