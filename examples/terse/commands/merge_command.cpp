#include <cmath>
#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>

#include "commands/commands.h"
#include "commands/output_paths.h"
#include "pictures/merge_report.h"
#include "run/merge_output.h"
#include "run/run_statistics.h"
#include "run/standard_output.h"
#include "terse/compact/json_file.h"
#include "terse/compact/map_file.h"
#include "terse/compact/map_links.h"
#include "terse/compact/thresholds_file.h"
#include "terse/core/writable.h"

namespace terse {
namespace {

struct MergeCommandOptions {
  std::vector<std::string> paths;
  std::string links, directory;
  ReadOptions read;
  bool calibrate = true, retire = true, json = false, quiet = false;
  int threads = 1;
};

// A map, and by what its measurements were scaled.
struct Input {
  std::string path;
  AnyCompactMap map;
  InformationScale scale;
};

bool IsRun(const std::string& path) { return std::filesystem::is_directory(path); }

template <class Pose>
Input InputFrom(const PoseGraph<Pose>& file_graph, const std::string& path, const MergeCommandOptions& options) {
  Input input{path, {}, {}};
  AddPathToErrors(path, [&] {
    PoseGraph<Pose> graph = file_graph;
    if (options.calibrate) {
      const InformationCalibration found = CalibrateInformation(graph);
      input.scale = found.scale;
      if (!found.scale.IsOne()) {
        graph = ScaleInformation(graph, found.scale);
        if (!options.quiet) {
          std::cerr << "terse: note: " << path << ": " << found.message
                    << "; scaled to these (--calibrate-information off leaves it)\n";
        }
      }
    }
    input.map = MapOfGraph(graph, options.threads);
  });
  return input;
}

Input ReadInput(const std::string& path, const MergeCommandOptions& options) {
  if (IsRun(path)) {
    CompactMapFile file = ReadCompactMap(path + "/graph.json");
    return {path, std::move(file.map), file.information_scale};
  }
  const GraphFile file = ReadGraph(path, options.read);
  if (!options.quiet) ReportRepairs(file, path);
  return std::visit([&](const auto& graph) { return InputFrom(graph, path, options); }, file.graph);
}

// "runs/a/" -> "a", "maps/b.g2o" -> "b".
std::string NameOf(const std::string& path) {
  std::filesystem::path name = std::filesystem::path(path).lexically_normal();
  if (!name.has_filename()) name = name.parent_path();
  return IsRun(path) ? name.filename().string() : name.stem().string();
}

void WarnOf(const nlohmann::ordered_json& stats) {
  for (const auto& map : stats["maps"]) {
    const std::string name = map["name"].get<std::string>();
    if (map["placement"] == Name(Placement::kApart)) {
      std::cerr << "terse: warning: " << name << " is not in the joint map: neither its " << map["links"]
                << " links nor absolute measurements hold it to the others\n";
    }
    if (map["placement"] == Name(Placement::kUnconfirmed)) {
      std::cerr << "terse: warning: a single link, which nothing confirms, holds " << name << "\n";
    }
  }
}

void PrintMerged(const nlohmann::ordered_json& stats, const std::string& directory) {
  std::cout << "joined " << stats["poses"] << " poses, kept " << stats["poses_kept"] << "; " << stats["links_accepted"]
            << " of " << stats["links"] << " links between maps are in, " << stats["links_inconsistent"]
            << " contradict the others\n";
  char line[200];
  std::snprintf(line, sizeof line, "chi2 %.6g, %.2f s; results in ", stats["chi2"].get<double>(),
                stats["seconds_total"].get<double>());
  std::cout << line << directory << '\n';
  FlushOutput();
}

template <class Pose>
void RunOn(const std::vector<Input>& inputs, const MergeCommandOptions& options, double start) {
  std::vector<MapToMerge<Pose>> maps;
  maps.reserve(inputs.size());
  for (const Input& input : inputs) maps.push_back({NameOf(input.path), std::get<CompactMap<Pose>>(input.map)});
  std::vector<MapLink<Pose>> links;
  if (!options.links.empty()) links = ReadMapLinks<Pose>(options.links, maps, options.read);
  std::vector<InformationScale> scales;
  for (const Input& input : inputs) scales.push_back(input.scale);
  links = ScaleMapLinks(std::move(links), scales);
  MergeOptions<Pose> merge;
  merge.threads = options.threads;
  if (!options.retire) merge.retire_share = 0;
  const std::string thresholds = inputs[0].path + "/thresholds.json";
  if (IsRun(inputs[0].path) && std::filesystem::exists(thresholds)) merge.thresholds = ReadThresholds<Pose>(thresholds);
  const Merged<Pose> merged = Merge(maps, links, merge);
  nlohmann::ordered_json stats = MergeStats(merged);
  WriteMerged(merged, options.read.rotation_information, inputs[0].scale, options.directory);
  WriteMergeReport(maps, merged, stats, options.directory + "/report.html");
  stats["seconds_total"] = SecondsNow() - start;
  WriteJson(stats, options.directory + "/stats.json");
  if (options.json) {
    std::cout << stats.dump(2) << '\n';
    FlushOutput();
  } else if (!options.quiet) {
    PrintMerged(stats, options.directory);
    WarnOf(stats);
  }
}

void RunMerge(const MergeCommandOptions& options) {
  if (options.paths.size() < 2) throw CLI::ValidationError("MAP", "two maps or more are merged");
  std::vector<NamedPath> read = {{"--links", options.links}};
  for (const std::string& path : options.paths) {
    if (IsRun(path)) {
      for (const char* file : {"graph.json", "thresholds.json"}) read.push_back({"MAP", path + "/" + file});
    } else {
      read.push_back({"MAP", path});
    }
  }
  CheckOutputPaths(FilesIn("--output", options.directory, MergeFiles()), read);
  const double start = SecondsNow();
  std::vector<Input> inputs;
  for (const std::string& path : options.paths) {
    inputs.push_back(ReadInput(path, options));
    if (inputs.back().map.index() != inputs[0].map.index()) {
      const auto dimension = [](const Input& input) { return input.map.index() == 0 ? "2D" : "3D"; };
      throw FileError(path, 0,
                      std::string(dimension(inputs.back())) + ", but " + inputs[0].path + " is " +
                          dimension(inputs[0]) + ": maps of one dimension are merged");
    }
  }
  RequireFolder(options.directory, "compact.g2o");
  inputs[0].map.index() == 0 ? RunOn<SE2>(inputs, options, start) : RunOn<SE3>(inputs, options, start);
}

}  // namespace

void AddMergeCommand(CLI::App& app) {
  auto options = std::make_shared<MergeCommandOptions>();
  CLI::App* command = app.add_subcommand(
      "merge", "Join maps of several sessions or robots whose start relative to each other is unknown");
  command
      ->add_option("MAP", options->paths,
                   "Two or more: folders of compact, kitti, sparsify or merge, or graph files (g2o, TORO or iSAM). The "
                   "ids of the "
                   "first stay, and its robot can go on in the joint map")
      ->required()
      ->type_name("MAP...");
  command
      ->add_option("--links", options->links,
                   "Links between the maps, some of which may be wrong: lines of g2o whose poses are MAP:ID, maps "
                   "counted from 1. Without, absolute measurements (GNSS) have to say where the maps are")
      ->type_name("FILE");
  AddChoice<bool, bool>(*command, "--calibrate-information", options->calibrate, {{"auto", true}, {"off", false}},
                        "Whether information of graph files that nobody estimated and that the residuals contradict is "
                        "scaled to agree with them; folders have theirs scaled already");
  command->add_flag("!--no-retire", options->retire, "Keep all poses, however densely the maps cover the same ground");
  command->add_option("--threads", options->threads, "At most; the result is the same for any number")
      ->check(CLI::Range(1, 1024).description(""))
      ->type_name("N")
      ->capture_default_str();
  AddReadOptions(*command, options->read);
  command->add_option("--output", options->directory, "Folder for the results, made if it is missing")
      ->required()
      ->type_name("DIR");
  command->add_flag("--json", options->json, "Print the numbers of stats.json instead of a summary");
  command->add_flag("--quiet", options->quiet, "Print nothing but errors");
  command->footer(
      "Example: terse generate manhattan --robots 2 --poses 1000 --outliers 20 --output team &&\n"
      "         terse merge team/robot_1.g2o team/robot_2.g2o --links team/links.txt --output joint");
  command->callback([options] { RunMerge(*options); });
}

}  // namespace terse
