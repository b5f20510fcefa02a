// What a threshold of compact pose SLAM does (Ila et al. 2017 Fig. 5 top).

#include <cmath>
#include <iostream>

#include "commands/commands.h"
#include "commands/output_paths.h"
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
  Scaled scaled = Scaled::kLoop;
  double from = 0.25, to = 4;
  std::optional<double> sample;
  int steps = 9;
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
  const std::string label = std::string(Name(options.scaled)) + " x " + Cell(scale);
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
  base.log = options.log;
  if (options.thresholds.empty()) {
    SampleWithProgress(graph, options.sample, "sample", options.quiet, base);
  } else {
    base.thresholds = ReadThresholds<Pose>(options.thresholds);
  }
  for (int k = 0; k < options.steps; ++k) {
    const double share = options.steps > 1 ? static_cast<double>(k) / (options.steps - 1) : 0;
    const double scale = options.from * std::pow(options.to / options.from, share);
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

void WriteChart(const Sweep& sweep, const SweepOptions& options, const std::string& path) {
  const std::string x_label = std::string(options.scaled == Scaled::kRange ? "sensor range" : "minimum gain of a ") +
                              (options.scaled == Scaled::kRange ? "" : Name(options.scaled)) + ", times the chosen one";
  const auto panel = [&](const char* title, const char* y_label, const auto& value) {
    ChartLine line{"FPFL", {}, {}, true};
    for (const SweepRow& row : sweep.rows) {
      line.x.push_back(row.scale);
      line.y.push_back(value(row));
    }
    return ChartPanel{title, x_label, y_label, {line}, true};
  };
  const std::string text = DrawCharts(
      "Compact pose SLAM over a threshold: " + options.path.substr(options.path.find_last_of('/') + 1),
      {panel("Poses kept", "% of all poses", [&](const SweepRow& row) { return Percent(row.poses, sweep.poses); }),
       panel("Links kept", "% of all links", [&](const SweepRow& row) { return Percent(row.links, sweep.links); }),
       panel("Time", "seconds", [](const SweepRow& row) { return row.seconds; }),
       panel("Absolute trajectory error", "metres", [](const SweepRow& row) { return row.ate.translation_m; })});
  WriteText(text, path);
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
    const Sweep sweep = std::visit([&](const auto& graph) { return RunSweep(graph, options); }, file.graph);
    if (!options.csv.empty()) WriteCsv(sweep, options.csv);
    if (!options.svg.empty()) WriteChart(sweep, options, options.svg);
    Print(sweep, options);
  });
}

}  // namespace

void AddSweepCommand(CLI::App& app) {
  auto options = std::make_shared<SweepOptions>();
  CLI::App* command = app.add_subcommand("sweep", "Scale a threshold of compact over a range: poses, links, time, ATE");
  command->add_option("FILE", options->path, "The graph file (g2o, TORO or iSAM)")->required();
  AddChoice(*command, "--threshold", options->scaled,
            {{"loop", Scaled::kLoop}, {"pose", Scaled::kPose}, {"range", Scaled::kRange}},
            "Minimum gain of a link or of a pose, or the sensor range")
      ->default_str("")
      ->required();
  command->add_option("--from", options->from, "Least scale")
      ->check(PositiveNumber())
      ->type_name("X")
      ->capture_default_str();
  command->add_option("--to", options->to, "Largest scale; those between are logarithmic")
      ->check(PositiveNumber())
      ->type_name("X")
      ->capture_default_str();
  command->add_option("--steps", options->steps, "How many scales")
      ->check(CLI::Range(1, 1000).description(""))
      ->type_name("N")
      ->capture_default_str();
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
      "         terse sweep ellipse.g2o --threshold pose --steps 3 --csv sweep.csv --svg sweep.svg");
  command->callback([options] { SweepFile(*options); });
}

}  // namespace terse
