// `terse table outliers`: methods against wrong loops, as the literature has it.

#include <algorithm>
#include <iostream>
#include <thread>

#include "commands/commands.h"
#include "commands/graph_choice.h"
#include "commands/output_paths.h"
#include "run/standard_output.h"
#include "tables/document.h"
#include "tables/outlier_run_log.h"
#include "tables/outlier_table_text.h"
#include "terse/core/error.h"
#include "terse/core/words.h"

namespace terse {
namespace {

constexpr const char* kOutliersMark = "protocol";  // in a document

struct TableOutliersOptions {
  std::string folder, update, runs;
  std::vector<std::string> graphs, kinds = {"random", "grouped"};
  OutlierTableOptions table;
  bool json = false;
};

// Each once, in the order of the words or of size.
void Normalise(TableOutliersOptions& options) {
  OutlierTableOptions& table = options.table;
  std::sort(table.percents.begin(), table.percents.end());
  table.percents.erase(std::unique(table.percents.begin(), table.percents.end()), table.percents.end());
  table.kinds.clear();
  for (const auto& [word, kind] : Words<OutlierKind>::kAll) {
    if (std::count(options.kinds.begin(), options.kinds.end(), word) != 0) table.kinds.push_back(kind);
  }
  std::vector<std::string> methods;
  for (const OutlierMethod& method : OutlierMethods()) {
    if (std::count(table.methods.begin(), table.methods.end(), method.name) != 0) methods.push_back(method.name);
  }
  table.methods = methods;
}

void PrintOutlierTables(TableOutliersOptions options) {
  Normalise(options);
  const std::vector<GraphPath> inputs = ChooseGraphFiles(options.folder, options.graphs);
  std::vector<NamedPath> named;
  for (const GraphPath& input : inputs) named.push_back({"DIR", input.path});
  CheckOutputPaths({{"--update", options.update}, {"--runs", options.runs}}, named);
  if (!options.update.empty()) RequirePlace(options.update, kOutliersMark);
  std::optional<OutlierRunLog> log;
  OutlierRunStore store;
  if (!options.runs.empty()) {
    log.emplace(options.runs);
    store.find = [&](const OutlierGraph& graph, const OutlierRun& run) { return log->Find(KeyOf(graph, run)); };
    store.add = [&](const OutlierGraph& graph, const OutlierRun& run) { log->Add(graph, run); };
  }
  std::vector<OutlierGraph> graphs;
  {
    long done = 0;
    Progress progress("runs", static_cast<long>(inputs.size()) * CountRuns(options.table), options.table.quiet);
    for (const GraphPath& input : inputs) {
      graphs.push_back(RunOutlierTable(input, options.folder, options.table, store, progress, done));
      if (options.json || !graphs.back().failure.empty()) continue;
      progress.Clear();
      std::cout << OutlierGraphText(graphs.back()) << '\n';
      FlushOutput();
    }
  }
  if (std::all_of(graphs.begin(), graphs.end(), [](const OutlierGraph& graph) { return !graph.failure.empty(); }))
    throw FileError(graphs.front().is.path, 0, graphs.front().failure);
  if (!options.update.empty()) UpdateDocument(options.update, OutlierTableText(graphs), kOutliersMark);
  if (options.json) {
    PrintJson(OutlierTableJson(graphs, options.table));
    return;
  }
  for (const OutlierGraph& graph : graphs) {
    if (!graph.failure.empty()) std::cout << OutlierGraphText(graph) << '\n';
  }
  std::cout << OutlierSummaryText(graphs);
  FlushOutput();
}

void AddGridOptions(CLI::App& command, TableOutliersOptions& options) {
  OutlierTableOptions& table = options.table;
  table.percents = {0, 10, 20, 30, 40, 50, 60, 70, 80, 90};
  table.methods = {"batch-gnc", "incremental-gnc", "compact"};
  table.threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  command.add_option("--graphs", options.graphs, "Only these, by the file's name without its ending")
      ->delimiter(',')
      ->type_name("NAME,...");
  command
      .add_option("--percents", table.percents,
                  "Wrong loops in per cent of all loops: 50 is as many wrong ones as true ones. The clean run, 0, is "
                  "made always")
      ->check(NumberIn(0, 99))
      ->delimiter(',')
      ->type_name("P,...")
      ->default_str("0,10,...,90");
  std::vector<std::string> names;
  for (const auto& [word, kind] : Words<OutlierKind>::kAll) names.emplace_back(word);
  command.add_option("--kinds", options.kinds, "Of wrong loops, see terse generate --outlier-kind")
      ->check(OneOf(names))
      ->delimiter(',')
      ->type_name("KIND,...")
      ->default_str("random,grouped");
  names.clear();
  for (const OutlierMethod& method : OutlierMethods()) names.push_back(method.name);
  command
      .add_option(
          "--methods", table.methods,
          "batch and incremental with a robust kernel, the latter after its last step or brought to the "
          "optimum (finish); compact with its defaults (gnc) or --robust none, the same with --strategy fpfl; to be "
          "beaten: the optimum with loops kept by chance, or with odometry alone")
      ->check(OneOf(names))
      ->delimiter(',')
      ->type_name("METHOD,...")
      ->default_str("batch-gnc,incremental-gnc,compact");
  command.add_option("--seeds", table.seeds, "Draws of wrong loops per share and kind")
      ->check(CLI::Range(1, 100000).description(""))
      ->type_name("N")
      ->capture_default_str();
  command.add_option("--first-seed", table.first_seed, "Of these draws; the next ones follow it")
      ->check(CLI::Range(std::uint64_t{0}, std::uint64_t{1} << 62).description(""))
      ->type_name("N")
      ->capture_default_str();
}

}  // namespace

void AddOutliersTable(CLI::App& table) {
  auto options = std::make_shared<TableOutliersOptions>();
  CLI::App* command = table.add_subcommand(
      "outliers",
      "Wrong loops, as the literature tests against them: every graph with 10 to 90 % of them, random and grouped, ten "
      "times each, through batch, incremental and compact");
  command
      ->add_option("DIR", options->folder,
                   "Folder with graphs (.g2o, .graph, .toro, .isam, .txt), at any depth; STEM.tum beside one is its "
                   "ground truth")
      ->required();
  AddGridOptions(*command, *options);
  command
      ->add_option("--threads", options->table.threads,
                   "Runs at a time. But for times the results do not depend on it; times of steps mean something, and "
                   "are given, with 1 only")
      ->check(CLI::Range(1, 1024).description(""))
      ->type_name("N");
  command
      ->add_option("--run-seconds", options->table.most_seconds,
                   "A run that takes longer has failed (by default it may take as long as it needs)")
      ->check(PositiveNumber())
      ->type_name("S");
  command
      ->add_option(
          "--runs", options->runs,
          "Each run as a line of JSON in this file as soon as it is there; those that the file has already are "
          "not made again, so that a table goes on where it was stopped")
      ->type_name("FILE");
  command->add_flag("--json", options->json, "Print JSON, with all runs");
  command->add_option("--update", options->update, "Put the tables into this document, between <!-- protocol --> marks")
      ->type_name("FILE");
  command->add_flag("--quiet", options->table.quiet, "No progress on standard error");
  command->footer(
      "Success: the error is within 1.2 times that of the same method's clean run, and more than 95 % of the loops "
      "that "
      "the map believes are true. Information that the residuals of the clean graph contradict is scaled first.\n"
      "Example: mkdir -p few && terse generate manhattan --poses 60 --output few/walk.g2o &&\n"
      "         terse table outliers few --percents 30 --kinds random --seeds 1");
  command->callback([options] { PrintOutlierTables(*options); });
}

}  // namespace terse
