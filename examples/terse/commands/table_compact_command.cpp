// `terse table compact`: the tables and figures of Ila et al. 2017.

#include <algorithm>
#include <filesystem>
#include <iostream>

#include "commands/commands.h"
#include "commands/output_paths.h"
#include "pictures/run_report.h"
#include "run/run_statistics.h"
#include "run/standard_output.h"
#include "tables/compact_figures.h"
#include "tables/compact_table.h"
#include "tables/compact_table_text.h"
#include "tables/document.h"
#include "tables/text_table.h"
#include "terse/compact/json_file.h"
#include "terse/core/error.h"
#include "terse/core/writable.h"

namespace terse {
namespace {

constexpr const char* kCompactMark = "tables";  // in a document

struct TableCompactOptions {
  std::string folder, output, update;
  std::vector<std::string> graphs;
  CompactTableOptions table;
  int laps = 10;
  bool json = false;
};

std::vector<CompactGraphName> Chosen(const std::vector<std::string>& graphs) {
  std::vector<CompactGraphName> out;
  for (const CompactGraphName& name : CompactGraphNames()) {
    const bool is_chosen = std::any_of(graphs.begin(), graphs.end(), [&](const std::string& graph) {
      return graph == name.name || std::count(name.other_names.begin(), name.other_names.end(), graph) != 0;
    });
    if (graphs.empty() || is_chosen) out.push_back(name);
  }
  return out;
}

CompactTableRow RunGraph(const CompactGraphName& name, const TableCompactOptions& options) {
  const AnyNamedGraph graph = LoadNamedGraph(name, options.folder, options.laps);
  CompactTableOptions table = options.table;
  table.folder = options.output;
  table.norms = !options.output.empty() && name.name == "ellipse";
  return std::visit([&](const auto& named) { return RunCompactTable(named, table); }, graph);
}

nlohmann::ordered_json AllJson(const std::vector<CompactTableRow>& rows, const std::vector<std::string>& files,
                               const TableCompactOptions& options) {
  nlohmann::ordered_json json;
  json["sample"] = options.table.sample ? nlohmann::ordered_json(*options.table.sample) : nullptr;
  json["seed"] = options.table.seed;
  json["random_runs"] = options.table.random_runs;
  json["laps"] = options.laps;
  json["graphs"] = nlohmann::ordered_json::array();
  for (const CompactTableRow& row : rows) json["graphs"].push_back(ToJson(row));
  json["files"] = files;
  return json;
}

void PrintCompactTables(const TableCompactOptions& options) {
  const std::vector<CompactGraphName> names = Chosen(options.graphs);
  // Before the first of many minutes, not after them.
  std::vector<NamedPath> inputs;
  for (const CompactGraphName& name : names) {
    if (!name.is_generated) inputs.push_back({"DIR", FindGraphFile(name, options.folder)});
  }
  std::vector<NamedPath> outputs{{"--update", options.update}};
  if (!options.output.empty()) outputs.push_back({"--output", options.output + "/tables.json"});
  CheckOutputPaths(outputs, inputs);
  if (!options.output.empty()) RequireFolder(options.output, "tables.json");
  if (!options.update.empty()) RequirePlace(options.update, kCompactMark);
  std::vector<CompactTableRow> rows;
  std::vector<std::string> files;
  for (const CompactGraphName& name : names) {
    AddPathToErrors(name.name, [&] { rows.push_back(RunGraph(name, options)); });
    if (options.output.empty()) continue;
    const int laps = name.name == "ellipse-n" ? options.laps : 0;
    for (const std::string& file : WriteFigures(rows.back(), laps, options.output)) {
      files.push_back(options.output + '/' + file);
    }
    const std::string folder = options.output + '/' + rows.back().graph;
    if (std::filesystem::exists(folder + "/apal")) {
      WriteReport({folder + "/apal", folder + "/fpfl"}, folder + "/comparison.html");
    }
    // Graph by graph: what stops a later one costs the earlier ones nothing.
    WriteJson(AllJson(rows, files, options), options.output + "/tables.json");
  }
  if (!options.update.empty()) UpdateDocument(options.update, CompactTablesText(rows), kCompactMark);
  if (options.json) {
    PrintJson(AllJson(rows, files, options));
    return;
  }
  std::cout << CompactTablesText(rows);
  if (!files.empty()) std::cout << '\n' << files.size() << " files of figures in " << options.output << '\n';
  FlushOutput();
}

}  // namespace

void AddCompactTable(CLI::App& table) {
  auto options = std::make_shared<TableCompactOptions>();
  CLI::App* command = table.add_subcommand("compact",
                                           "Compact pose SLAM (Ila et al. 2017): recovery, thresholds, times and "
                                           "errors of its strategies, Tables 1-4, "
                                           "and its Figs. 6, 8, 9");
  command
      ->add_option("DIR", options->folder,
                   "Folder with kitti00_all_loops.g2o, sphere2500.g2o, parking-garage.g2o, w10000_hogman.graph, at any "
                   "depth; kitti/poses/00.txt in it or beside it is the ground truth of the first")
      ->required();
  std::vector<std::string> names, accepted;
  for (const CompactGraphName& name : CompactGraphNames()) {
    accepted.push_back(name.name);
    accepted.insert(accepted.end(), name.other_names.begin(), name.other_names.end());
  }
  command->add_option("--graphs", options->graphs, "Only these graphs; ellipse, ellipse-n, manhattan100k are generated")
      ->check(OneOf(accepted))
      ->delimiter(',')
      ->type_name("NAME,...");
  command
      ->add_option("--output", options->output,
                   "Folder for the figures (CSV, SVG), made if it is missing; the files of each run, as compact writes "
                   "them, in GRAPH/STRATEGY in it")
      ->type_name("DIR");
  AddSampleOption(*command, options->table.sample);
  AddSeedOption(*command, options->table.seed, "Of the first random run");
  command->add_option("--random-runs", options->table.random_runs, "How many of RFPFL the errors are the mean of")
      ->check(CLI::Range(0, 1000).description(""))
      ->type_name("N")
      ->capture_default_str();
  command->add_option("--laps", options->laps, "Of ellipse-n")
      ->check(CLI::Range(1, 1000).description(""))
      ->type_name("N")
      ->capture_default_str();
  command
      ->add_option("--most-poses", options->table.most_poses,
                   "Of larger graphs APAL is the batch optimum, without times, and ATE and RPE of all pairs take every "
                   "so manieth pose")
      ->check(CLI::Range(2, 100000000).description(""))
      ->type_name("N")
      ->capture_default_str();
  command->add_flag("--apfl", options->table.apfl, "Run all poses, few links too");
  command->add_flag("--json", options->json, "Print JSON");
  command->add_option("--update", options->update, "Put the tables into this document, between <!-- tables --> marks")
      ->type_name("FILE");
  command->add_flag("--quiet", options->table.quiet, "No progress on standard error");
  command->footer("Example: terse table compact . --graphs ellipse --random-runs 1 --output figures");
  command->callback([options] { PrintCompactTables(*options); });
}

}  // namespace terse
