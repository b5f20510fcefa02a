#include <cmath>
#include <filesystem>
#include <iostream>

#include "commands.h"
#include "compact_run.h"
#include "covariance_output.h"
#include "progress.h"
#include "report.h"
#include "terse/compact/thresholds.h"
#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/covariance/marginals.h"

namespace terse {
namespace {

struct CompactCommandOptions {
  std::string path, directory;
  ReadOptions read;
  Strategy strategy = Strategy::kFpfl;
  std::vector<double> range;
  double probability = 0.1;
  std::optional<double> min_pose_gain, min_loop_gain;
  Recovery recovery = Recovery::kV2;
  bool quiet = false;
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

std::string FindRangeDefect(const std::string& text) {
  double value = 0;
  if (CLI::detail::lexical_cast(text, value) && value > 0 && std::isfinite(value)) return "";
  return text + " is not a positive number";
}

// What the user gave; the rest from a sample of the file.
template <class Pose>
CompactOptions<Pose> MakeOptions(const PoseGraph<Pose>& graph, const GraphReplay<Pose>& replay,
                                 const CompactCommandOptions& from) {
  constexpr int kSize = Displacement<Pose>::kSize;
  CompactOptions<Pose> options;
  options.strategy = from.strategy;
  options.probability = from.probability;
  options.link_covariance = replay.LinkCovariance();
  const bool complete = !from.range.empty() && from.min_loop_gain && from.min_pose_gain;
  if (!complete && from.strategy != Strategy::kApal) {
    Progress progress("sample", 0, from.quiet);
    SampleOptions sample;
    sample.probability = from.probability;
    sample.progress = [&](long done, long) { progress.Update(done); };
    const Thresholds<Pose> chosen = SelectThresholds(graph, sample);
    options.range = chosen.range;
    options.min_loop_gain = chosen.min_loop_gain;
    options.min_pose_gain = chosen.min_pose_gain;
  }
  if (!from.range.empty()) options.range = Eigen::Map<const Vector<kSize>>(from.range.data());
  options.min_loop_gain = from.min_loop_gain.value_or(options.min_loop_gain);
  options.min_pose_gain = from.min_pose_gain.value_or(options.min_pose_gain);
  return options;
}

void WriteDecisions(const std::vector<Decision>& decisions, const std::string& path) {
  AtomicFile file(path);
  std::ostream& out = file.Stream();
  out << "pose,kept,verdict,pose_gain_nats,registrations_tried,links_accepted,"
         "candidates,probabilities,gains_nats,measured_gains_nats,accepted\n";
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
    out << '\n';
  }
  file.Commit();
}

template <class Pose>
void WriteResults(const CompactPoseSlam<Pose>& slam, const BatchResult<Pose>& result,
                  const std::vector<Decision>& decisions, const CompactCommandOptions& options, Stats& stats) {
  const std::string folder = options.directory + "/";
  PoseGraph<Pose> kept = slam.Solver().Graph();
  std::vector<PoseId> kept_ids;
  for (std::size_t k = 0; k < result.T_world_body.size(); ++k) {
    kept_ids.push_back(kept.Poses()[k].id);
    kept.SetPose(kept_ids.back(), result.T_world_body[k]);
  }
  WriteG2o(kept, folder + "compact.g2o", options.read.rotation_information);
  std::vector<PoseId> ids;
  std::vector<Pose> values;
  for (const auto& pose : slam.Trajectory(options.recovery)) {
    ids.push_back(pose.id);
    values.push_back(pose.T_world_body);
  }
  WriteTum(MakeTrajectory(ids, values), folder + "trajectory.tum");
  WriteDecisions(decisions, folder + "decisions.csv");
  const double before = SecondsNow();
  const Marginals<Pose> marginals(kept, result.T_world_body, result.factor);
  WriteCovariances<Pose>(kept_ids, marginals.AllMarginals(), folder + "covariances.csv");
  stats.seconds_covariance = SecondsNow() - before;
}

void PrintSummary(const Stats& stats, const CompactCommandOptions& options) {
  const auto percent = [](double part, double whole) { return whole > 0 ? 100 * part / whole : 100.0; };
  const auto number = [&](const char* key) { return stats.more.at(key).get<long>(); };
  char line[256];
  std::snprintf(line, sizeof(line),
                "%s kept %ld of %zu poses (%.1f %%) and %ld of %ld links (%.1f %%); %ld registrations tried\n",
                Name(options.strategy), number("poses_kept"), stats.poses,
                percent(static_cast<double>(number("poses_kept")), static_cast<double>(stats.poses)),
                number("links_kept"), number("links_offered"),
                percent(static_cast<double>(number("links_kept")), static_cast<double>(number("links_offered"))),
                number("registrations_tried"));
  std::cout << line;
  std::snprintf(line, sizeof(line), "chi2 %g of the kept map, %.2f s; results in %s\n", stats.chi2, stats.seconds_total,
                options.directory.c_str());
  std::cout << line;
  FlushOutput();
}

template <class Pose>
nlohmann::ordered_json Thresholds(const CompactOptions<Pose>& options) {
  return {{"range", std::vector<double>(options.range.data(), options.range.data() + options.range.size())},
          {"probability", options.probability},
          {"min_loop_gain", options.min_loop_gain},
          {"min_pose_gain", options.min_pose_gain}};
}

template <class Pose>
void CompactGraph(const PoseGraph<Pose>& graph, const CompactCommandOptions& options, Stats stats, double start) {
  GraphReplay<Pose> replay(graph);
  const CompactOptions<Pose> settings = MakeOptions(graph, replay, options);
  CompactRunOptions<Pose> run_options;
  run_options.quiet = options.quiet;
  CompactRun<Pose> run = RunCompact(settings, replay, run_options);
  const CompactPoseSlam<Pose>& slam = run.slam;
  const BatchResult<Pose>& result = run.result;
  stats.step_seconds = std::move(run.step_seconds);
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
  stats.more["thresholds"] = Thresholds(settings);
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
  std::error_code error;
  std::filesystem::create_directories(options.directory, error);
  if (!std::filesystem::is_directory(options.directory)) {
    const std::string reason =
        std::filesystem::exists(options.directory) ? "a file of this name is in the way" : error.message();
    throw FileError(options.directory, 0, "cannot make this folder: " + reason);
  }
  RequireWritable(options.directory + "/stats.json");
  AddPathToErrors(options.path, [&] {
    std::visit([&](const auto& graph) { CompactGraph(graph, options, std::move(stats), start); }, file.graph);
  });
}

}  // namespace

void AddCompactCommand(CLI::App& app) {
  auto options = std::make_shared<CompactCommandOptions>();
  CLI::App* command = app.add_subcommand("compact", "Keep only the poses and links of a graph that carry information");
  command->add_option("FILE", options->path, "The graph file (g2o, TORO or iSAM)")->required();
  AddChoice(*command, "--strategy", options->strategy,
            {{"apal", Strategy::kApal}, {"apfl", Strategy::kApfl}, {"fpfl", Strategy::kFpfl}},
            "All poses all links, all poses few links, or few poses few links")
      ->default_str("")
      ->required();
  command
      ->add_option("--range", options->range,
                   "Sensor range in metres and radians; by default chosen from the first 60 % of the file, as are "
                   "the gains")
      ->expected(3, 4)
      ->check(FindRangeDefect)
      ->option_text("X Y Z ANGLE (3D) | X Y ANGLE (2D)");
  command->add_option("--probability", options->probability, "Least probability of being in range, per dimension")
      ->check(CLI::Range(0.0, 0.999999).description(""))
      ->type_name("S")
      ->capture_default_str();
  command
      ->add_option("--min-pose-gain", options->min_pose_gain,
                   "A pose is kept above this gain (nats), or if a loop closes at it")
      ->check(CLI::NonNegativeNumber.description(""))
      ->type_name("G");
  command->add_option("--min-loop-gain", options->min_loop_gain, "A link is kept above this gain (nats)")
      ->check(CLI::NonNegativeNumber.description(""))
      ->type_name("G");
  AddChoice(*command, "--recover", options->recovery,
            {{"v0", Recovery::kV0}, {"v1", Recovery::kV1}, {"v2", Recovery::kV2}},
            "How dropped poses come back: as first estimated, chained to the kept pose before them, or fitted between "
            "the kept poses around them");
  AddReadOptions(*command, options->read);
  command->add_option("--output", options->directory, "Folder for the results, made if it is missing")
      ->required()
      ->type_name("DIR");
  command->add_flag("--quiet", options->quiet, "Print nothing but errors");
  command->footer("Example: terse compact sphere2500.g2o --strategy fpfl --output sphere_fpfl");
  command->callback([options] { Compact(*options); });
}

}  // namespace terse
