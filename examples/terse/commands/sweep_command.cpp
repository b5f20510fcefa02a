// What a threshold of compact pose SLAM does (Ila et al. 2017 Fig. 5 top); without one, size against error of maps.

#include <cmath>
#include <iostream>

#include "commands/commands.h"
#include "commands/output_paths.h"
#include "commands/sweep_frontier.h"
#include "commands/verbose.h"
#include "pictures/svg_chart.h"
#include "run/compact_run.h"
#include "run/ground_truth.h"
#include "run/progress.h"
#include "run/run_statistics.h"
#include "run/standard_output.h"
#include "tables/text_table.h"
#include "terse/compact/thresholds_file.h"
#include "terse/core/atomic_file.h"
#include "terse/core/number_text.h"
#include "terse/core/writable.h"

namespace terse {
namespace {

enum class Scaled { kLoop, kPose, kRange };

struct SweepOptions {
  std::string path, ground_truth, thresholds, csv, svg;
  ReadOptions read;
  std::optional<Scaled> scaled;
  std::optional<double> from, to;  // by default as below, or as FrontierOptions
  std::optional<double> sample;
  std::optional<int> steps;
  int random_runs = FrontierOptions().random_runs;
  std::uint64_t seed = 1;
  bool quiet = false;
  LogSink log;
};

const char* Name(Scaled scaled) {
  switch (scaled) {
    case Scaled::kLoop: return "loop";
    case Scaled::kPose: return "pose";
    case Scaled::kRange: return "range";
  }
  return "";
}

constexpr double kFrom = 0.25, kTo = 4;
constexpr int kSteps = 9;

struct SweepRow {
  double scale = 1;
  std::vector<double> range;
  double min_loop_gain = 0, min_pose_gain = 0;
  int poses = 0, links = 0, registrations = 0;
  double seconds = 0;
  PoseError ate;
};

struct Sweep {
  int poses = 0, links = 0;  // offered
  ReferenceKind reference = ReferenceKind::kOptimum;
  std::vector<SweepRow> rows;
};

template <class Pose>
SweepRow RunAt(double scale, const PoseGraph<Pose>& graph, CompactOptions<Pose> settings,
               const Reference<Pose>& reference, const SweepOptions& options) {
  Thresholds<Pose>& thresholds = settings.thresholds;
  if (options.scaled == Scaled::kLoop) thresholds.min_loop_gain *= scale;
  if (options.scaled == Scaled::kPose) thresholds.min_pose_gain *= scale;
  if (options.scaled == Scaled::kRange) thresholds.range *= scale;
  GraphReplay<Pose> replay(graph);
  const std::string label = std::string(Name(*options.scaled)) + " x " + Cell(scale);
  const CompactRun<Pose> run = RunWithProgress(CompactPoseSlam<Pose>(settings), replay, label, options.quiet);
  SweepRow row;
  row.scale = scale;
  row.range.assign(thresholds.range.data(), thresholds.range.data() + thresholds.range.size());
  row.min_loop_gain = thresholds.min_loop_gain;
  row.min_pose_gain = thresholds.min_pose_gain;
  row.poses = run.PosesKept();
  row.links = run.LinksKept();
  row.registrations = run.registrations_tried;
  row.seconds = run.Seconds();
  row.ate = ComputeErrors(graph, reference, run.slam.Trajectory()).ate;
  return row;
}

template <class Pose>
Sweep RunSweep(const PoseGraph<Pose>& graph, const SweepOptions& options) {
  Sweep sweep;
  sweep.poses = static_cast<int>(graph.Poses().size());
  sweep.links = GraphReplay<Pose>(graph).LinksOffered();
  Reference<Pose> reference;
  if (options.ground_truth.empty()) {
    Progress progress("optimum", 0, options.quiet);
    progress.Update(0);
    reference.T_world_body = BatchOptimum(graph).T_world_body;
  } else {
    reference = {ReferenceKind::kFile, ReadTruth(graph, options.ground_truth)};
  }
  sweep.reference = reference.kind;
  // What the scale 1 stands for.
  CompactOptions<Pose> base;
  base.strategy = Strategy::kFpfl;
  base.log = options.log;
  if (options.thresholds.empty()) {
    SampleWithProgress(graph, options.sample, "sample", options.quiet, base);
  } else {
    base.thresholds = ReadThresholds<Pose>(options.thresholds);
  }
  const double from = options.from.value_or(kFrom), to = options.to.value_or(kTo);
  const int steps = options.steps.value_or(kSteps);
  for (int k = 0; k < steps; ++k) {
    const double share = steps > 1 ? static_cast<double>(k) / (steps - 1) : 0;
    const double scale = from * std::pow(to / from, share);
    sweep.rows.push_back(RunAt(scale, graph, base, reference, options));
  }
  return sweep;
}

std::string RangeText(const SweepRow& row) {
  std::string text;
  for (const double v : row.range) text += (text.empty() ? "" : " ") + Cell(v);
  return text;
}

void Print(const Sweep& sweep, const SweepOptions& options) {
  const std::string value = options.scaled == Scaled::kRange  ? "range m, rad"
                            : options.scaled == Scaled::kPose ? "g_pose nats"
                                                              : "g_loop nats";
  TextTable table(
      {"scale", value, "poses", "poses %", "links", "links %", "registrations", "time s", "ATE m", "ATE deg"}, 0);
  for (const SweepRow& row : sweep.rows) {
    table.AddRow({Cell(row.scale),
                  options.scaled == Scaled::kRange  ? RangeText(row)
                  : options.scaled == Scaled::kPose ? Cell(row.min_pose_gain)
                                                    : Cell(row.min_loop_gain),
                  std::to_string(row.poses), FixedCell(Percent(row.poses, sweep.poses), 1), std::to_string(row.links),
                  FixedCell(Percent(row.links, sweep.links), 1), std::to_string(row.registrations), Cell(row.seconds),
                  Cell(row.ate.translation_m, 4), Cell(row.ate.rotation_deg, 4)});
  }
  std::cout << "FPFL of " << sweep.poses << " poses, " << sweep.links << " links; ATE against "
            << (sweep.reference == ReferenceKind::kFile ? "the ground truth" : "the optimum of the full graph") << '\n'
            << table.Text();
  FlushOutput();
}

void WriteCsv(const Sweep& sweep, const std::string& path) {
  AtomicFile file(path);
  std::ostream& out = file.Stream();
  out << "scale,range,min_loop_gain,min_pose_gain,poses,poses_percent,links,links_percent,registrations,seconds,ate_m,"
         "ate_deg\n";
  for (const SweepRow& row : sweep.rows) {
    out << Shortest(row.scale) << ',';
    for (std::size_t k = 0; k < row.range.size(); ++k) out << (k > 0 ? " " : "") << Shortest(row.range[k]);
    for (const double value :
         {row.min_loop_gain, row.min_pose_gain, static_cast<double>(row.poses), Percent(row.poses, sweep.poses),
          static_cast<double>(row.links), Percent(row.links, sweep.links), static_cast<double>(row.registrations),
          row.seconds, row.ate.translation_m, row.ate.rotation_deg}) {
      out << ',' << Shortest(value);
    }
    out << '\n';
  }
  file.Commit();
}

std::string FileName(const SweepOptions& options) { return options.path.substr(options.path.find_last_of('/') + 1); }

void WriteChart(const Sweep& sweep, const SweepOptions& options, const std::string& path) {
  const std::string x_label = std::string(options.scaled == Scaled::kRange ? "sensor range" : "minimum gain of a ") +
                              (options.scaled == Scaled::kRange ? "" : Name(*options.scaled)) +
                              ", times the chosen one";
  const auto panel = [&](const char* title, const char* y_label, const auto& value) {
    ChartLine line{"FPFL", {}, {}, true};
    for (const SweepRow& row : sweep.rows) {
      line.x.push_back(row.scale);
      line.y.push_back(value(row));
    }
    return ChartPanel{title, x_label, y_label, {line}, true};
  };
  const std::string text = DrawCharts(
      "Compact pose SLAM over a threshold: " + FileName(options),
      {panel("Poses kept", "% of all poses", [&](const SweepRow& row) { return Percent(row.poses, sweep.poses); }),
       panel("Links kept", "% of all links", [&](const SweepRow& row) { return Percent(row.links, sweep.links); }),
       panel("Time", "seconds", [](const SweepRow& row) { return row.seconds; }),
       panel("Absolute trajectory error", "metres", [](const SweepRow& row) { return row.ate.translation_m; })});
  WriteText(text, path);
}

FrontierOptions ForFrontier(const SweepOptions& options) {
  FrontierOptions out;
  out.ground_truth = options.ground_truth;
  out.thresholds = options.thresholds;
  out.sample = options.sample;
  out.from = options.from.value_or(out.from);
  out.to = options.to.value_or(out.to);
  out.steps = options.steps.value_or(out.steps);
  out.random_runs = options.random_runs;
  out.seed = options.seed;
  out.quiet = options.quiet;
  out.log = options.log;
  return out;
}

void SweepFile(const SweepOptions& options) {
  CheckOutputPaths(
      {{"--csv", options.csv}, {"--svg", options.svg}},
      {{"FILE", options.path}, {"--thresholds", options.thresholds}, {"--ground-truth", options.ground_truth}});
  const GraphFile file = ReadGraph(options.path, options.read);
  if (!options.quiet) ReportRepairs(file, options.path);
  RequireWritable(options.csv);
  RequireWritable(options.svg);
  AddPathToErrors(options.path, [&] {
    if (!options.scaled) {
      const FrontierOptions settings = ForFrontier(options);
      const Frontier frontier = std::visit([&](const auto& graph) { return RunFrontier(graph, settings); }, file.graph);
      if (!options.csv.empty()) WriteFrontierCsv(frontier, options.csv);
      if (!options.svg.empty()) WriteFrontierChart(frontier, FileName(options), options.svg);
      PrintFrontier(frontier);
      return;
    }
    const Sweep sweep = std::visit([&](const auto& graph) { return RunSweep(graph, options); }, file.graph);
    if (!options.csv.empty()) WriteCsv(sweep, options.csv);
    if (!options.svg.empty()) WriteChart(sweep, options, options.svg);
    Print(sweep, options);
  });
}

}  // namespace

void AddSweepCommand(CLI::App& app) {
  auto options = std::make_shared<SweepOptions>();
  CLI::App* command = app.add_subcommand(
      "sweep",
      "Size against error: maps of fpfl and bounded from large to small, beside random ones of the same size; with "
      "--threshold, what one threshold does to poses, links, time, ATE");
  command->add_option("FILE", options->path, "The graph file (g2o, TORO or iSAM)")->required();
  CLI::Option* threshold = AddChoice<std::optional<Scaled>, Scaled>(
                               *command, "--threshold", options->scaled,
                               {{"loop", Scaled::kLoop}, {"pose", Scaled::kPose}, {"range", Scaled::kRange}},
                               "Scale this one of fpfl alone: minimum gain of a link or of a pose, or the sensor "
                               "range; by default both gains")
                               ->default_str("");
  command->add_option("--from", options->from, "Least scale (0.125; with --threshold 0.25)")
      ->check(PositiveNumber())
      ->type_name("X");
  command->add_option("--to", options->to, "Largest scale (8; with --threshold 4); those between are logarithmic")
      ->check(PositiveNumber())
      ->type_name("X");
  command->add_option("--steps", options->steps, "How many scales (7; with --threshold 9)")
      ->check(CLI::Range(1, 1000).description(""))
      ->type_name("N");
  command->add_option("--random-runs", options->random_runs, "Random maps per size, of which the mean counts; 0: none")
      ->check(CLI::Range(0, 1000).description(""))
      ->type_name("N")
      ->capture_default_str()
      ->excludes(threshold);
  AddSeedOption(*command, options->seed, "Of the random maps");
  CLI::Option* file =
      command->add_option("--thresholds", options->thresholds, "Read the thresholds from a thresholds.json of compact")
          ->type_name("FILE");
  AddSampleOption(*command, options->sample)->excludes(file);
  command
      ->add_option("--ground-truth", options->ground_truth,
                   "What ATE is against (TUM, KITTI or a graph); by default the optimum of the full graph")
      ->type_name("FILE");
  command->add_option("--csv", options->csv, "Write the rows here")->type_name("FILE");
  command->add_option("--svg", options->svg, "Draw them here")->type_name("FILE");
  AddReadOptions(*command, options->read);
  command->add_flag("--quiet", options->quiet, "No progress or warnings on standard error");
  AddVerboseOption(*command, options->log);
  command->footer(
      "Example: terse generate ellipse --output ellipse.g2o &&\n"
      "         terse sweep ellipse.g2o --csv frontier.csv --svg frontier.svg &&\n"
      "         terse sweep ellipse.g2o --threshold pose --steps 3 --csv sweep.csv --svg sweep.svg");
  command->callback([options] { SweepFile(*options); });
}

}  // namespace terse
