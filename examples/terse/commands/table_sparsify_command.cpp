// `terse table sparsify`: graphs made small by every criterion, against chance.

#include <algorithm>
#include <iostream>

#include "commands/commands.h"
#include "commands/graph_choice.h"
#include "commands/output_paths.h"
#include "run/standard_output.h"
#include "tables/document.h"
#include "tables/sparsify_table_text.h"
#include "terse/compact/words.h"
#include "terse/core/error.h"

namespace terse {
namespace {

constexpr const char* kSparsifyMark = "sparsify";  // in a document

struct TableSparsifyOptions {
  std::string folder, update;
  std::vector<std::string> graphs, criteria;
  SparsifyTableOptions table;
  bool json = false;
};

template <class T>
void SortEachOnce(std::vector<T>& values) {
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end()), values.end());
}

void PrintSparsifyTables(TableSparsifyOptions options) {
  SparsifyTableOptions& table = options.table;
  SortEachOnce(table.percents);
  SortEachOnce(table.sparsities);
  for (const auto& [word, criterion] : Words<SparsifyCriterion>::kAll) {
    if (std::count(options.criteria.begin(), options.criteria.end(), word) != 0) table.criteria.push_back(criterion);
  }
  const std::vector<GraphPath> inputs = ChooseGraphFiles(options.folder, options.graphs);
  std::vector<NamedPath> named;
  for (const GraphPath& input : inputs) named.push_back({"DIR", input.path});
  CheckOutputPaths({{"--update", options.update}}, named);
  if (!options.update.empty()) RequirePlace(options.update, kSparsifyMark);
  std::vector<SparsifyTableGraph> graphs;
  {
    long done = 0;
    Progress progress("runs", static_cast<long>(inputs.size()) * CountRuns(table), table.quiet);
    for (const GraphPath& input : inputs) {
      graphs.push_back(RunSparsifyTable(input, table, progress, done));
      if (options.json || !graphs.back().failure.empty()) continue;
      progress.Clear();
      std::cout << SparsifyGraphText(graphs.back()) << '\n';
      FlushOutput();
    }
  }
  const auto failed = [](const SparsifyTableGraph& graph) { return !graph.failure.empty(); };
  if (std::all_of(graphs.begin(), graphs.end(), failed))
    throw FileError(graphs.front().is.path, 0, graphs.front().failure);
  if (!options.update.empty()) UpdateDocument(options.update, SparsifyTableText(graphs), kSparsifyMark);
  if (options.json) {
    PrintJson(SparsifyTableJson(graphs, table));
    return;
  }
  for (const SparsifyTableGraph& graph : graphs) {
    if (failed(graph)) std::cout << SparsifyGraphText(graph) << '\n';
  }
  std::cout << SparsifySummaryText(graphs);
  FlushOutput();
}

}  // namespace

void AddSparsifyTable(CLI::App& app) {
  auto options = std::make_shared<TableSparsifyOptions>();
  SparsifyTableOptions& table = options->table;
  table.percents = {10, 20, 30, 50};
  table.sparsities = {2, 3, 4, 5};
  std::vector<std::string> words;
  for (const auto& [word, criterion] : Words<SparsifyCriterion>::kAll) words.emplace_back(word);
  options->criteria = words;
  CLI::App* command = app.add_subcommand(
      "sparsify",
      "Graphs made small: links kept by every criterion of terse sparsify and at random, and poses dropped, each "
      "against the whole graph");
  command->add_option("DIR", options->folder, "Folder with graphs (.g2o, .graph, .toro, .isam, .txt), at any depth")
      ->required();
  command->add_option("--graphs", options->graphs, "Only these, by the file's name without its ending")
      ->delimiter(',')
      ->type_name("NAME,...");
  command->add_option("--percents", table.percents, "Links kept, in per cent")
      ->check(NumberIn(0, 100))
      ->delimiter(',')
      ->type_name("P,...")
      ->default_str("10,20,30,50");
  command->add_option("--criteria", options->criteria, "See terse sparsify --criterion")
      ->check(OneOf(words))
      ->delimiter(',')
      ->type_name("WORD,...")
      ->default_str("position,information,connectivity,random");
  command->add_option("--draws", table.draws, "Of links at random, of which the mean is given")
      ->check(CLI::Range(1, 100000).description(""))
      ->type_name("N")
      ->capture_default_str();
  command
      ->add_option("--sparsities", table.sparsities,
                   "Of so many poses one is kept, with all links; recovered as a tree, a subgraph and densely")
      ->check(CLI::Range(1, 1000).description(""))
      ->delimiter(',')
      ->type_name("K,...")
      ->default_str("2,3,4,5");
  command->add_option("--threads", table.threads, "At most; but for times the results do not depend on it")
      ->check(CLI::Range(1, 1024).description(""))
      ->type_name("N")
      ->capture_default_str();
  command->add_flag("--json", options->json, "Print JSON");
  command->add_option("--update", options->update, "Put the tables into this document, between <!-- sparsify --> marks")
      ->type_name("FILE");
  command->add_flag("--quiet", table.quiet, "No progress on standard error");
  command->footer(
      "ATE and rotation: the optimum of the small graph against that of the whole one. Connectivity: MAC, the better "
      "of its two roundings by the Fiedler value. Divergence: of the exact marginal of the kept poses from what the "
      "small graph says.\n"
      "Example: mkdir -p few && terse generate manhattan --poses 60 --output few/walk.g2o &&\n"
      "         terse table sparsify few --percents 20 --draws 2 --sparsities 2");
  command->callback([options] { PrintSparsifyTables(*options); });
}

}  // namespace terse
