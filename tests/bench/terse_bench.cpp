// The benchmark behind docs/benchmarks.md: incremental runs beside CHOLMOD, batch beside Ceres, growth. One thread.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <iostream>

#include "bench_graphs.h"
#include "bench_report.h"
#include "bench_runs.h"

namespace terse::bench {
namespace {

struct Options {
  std::vector<std::string> graphs, only = {"incremental", "batch", "growth"};
  std::vector<long> growth = {10000}, growth_local = {100000};
  int interval = 50, repeats = 3;
  std::string json, markdown, update;

  bool Wants(const std::string& what) const { return std::find(only.begin(), only.end(), what) != only.end(); }
  bool WantsGraph(const std::string& name) const {
    return graphs.empty() || std::find(graphs.begin(), graphs.end(), name) != graphs.end();
  }
};

nlohmann::json Measure(const BenchGraph& source, const Options& options) {
  nlohmann::json json = {{"name", source.name}};
  const AnyPoseGraph any = source.load();
  std::visit(
      [&](const auto& graph) {
        json["poses"] = graph.Poses().size();
        json["factors"] = graph.Factors().size();
        if (options.Wants("batch")) json["batch"] = RunBatch(graph, source.start, options.repeats);
        if (options.Wants("incremental")) json["incremental"] = RunIncremental(graph, options.interval);
      },
      any);
  return json;
}

nlohmann::json MeasureAll(const Options& options) {
  nlohmann::json results = {{"machine", Machine()}, {"graphs", nlohmann::json::array()}};
  if (options.Wants("batch") || options.Wants("incremental")) {
    for (const BenchGraph& source : BenchGraphs()) {
      if (!options.WantsGraph(source.name)) continue;
      std::fprintf(stderr, "%s ...\n", source.name.c_str());
      results["graphs"].push_back(Measure(source, options));
    }
  }
  if (options.Wants("growth")) {
    const auto run = [&](long poses, long longest_link) {
      std::fprintf(stderr, "growth to %ld poses ...\n", poses);
      results["growth"].push_back(RunGrowth(poses, longest_link));
    };
    for (const long poses : options.growth) run(poses, poses);
    for (const long poses : options.growth_local) run(poses, 100);
  }
  return results;
}

nlohmann::json ReadResults(const std::string& path) {
  std::ifstream in(path);
  if (!in) throw std::runtime_error(path + ": cannot be read");
  return nlohmann::json::parse(in);
}

int Main(int argc, char** argv) {
  Options options;
  CLI::App app("Benchmarks of pose-graph optimisation", "terse_bench");
  app.add_option("--graphs", options.graphs, "Only these, by name, separated by commas")->delimiter(',');
  app.add_option("--only", options.only, "Only these: incremental, batch, growth")->delimiter(',');
  app.add_option("--growth", options.growth, "Sizes of the generated world of the growth run")->delimiter(',');
  app.add_option("--growth-local", options.growth_local, "The same with links to the last 100 poses only")
      ->delimiter(',');
  app.add_option("--interval", options.interval, "Steps between comparisons")->check(CLI::PositiveNumber);
  app.add_option("--repeats", options.repeats, "Batch runs, of which the fastest counts")->check(CLI::PositiveNumber);
  app.add_option("--json", options.json, "Write the results here");
  app.add_option("--markdown", options.markdown, "Measure nothing: print the tables of these results");
  app.add_option("--update", options.update, "Put the tables into this document");
  CLI11_PARSE(app, argc, argv);
  const nlohmann::json results = options.markdown.empty() ? MeasureAll(options) : ReadResults(options.markdown);
  if (!options.json.empty()) std::ofstream(options.json) << results.dump(2) << '\n';
  const std::string tables = Tables(results);
  std::cout << tables;
  if (!options.update.empty()) UpdateDocument(options.update, tables);
  return 0;
}

}  // namespace
}  // namespace terse::bench

int main(int argc, char** argv) {
  try {
    return terse::bench::Main(argc, argv);
  } catch (const std::exception& error) {
    std::cerr << "terse_bench: " << error.what() << '\n';
    return 1;
  }
}
