// The benchmark behind docs/benchmarks.md: incremental runs beside CHOLMOD, batch beside Ceres, growth, covariances.
// One thread.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <iostream>

#include "bench_graphs.h"
#include "bench_report.h"
#include "bench_runs.h"
#include "tables/document.h"

namespace terse::bench {
namespace {

bool IsIn(const std::vector<std::string>& list, const std::string& what) {
  return std::find(list.begin(), list.end(), what) != list.end();
}

// What the aims for covariances are stated on; and, at the optimum, some where Ceres ends soon.
std::vector<std::string> CovarianceGraphs(const std::string& part) {
  if (part == "batch") {
    return {"sphere2500", "torus3D", "city10000", "w10000_hogman", "parking-garage", "manhattan", "intel"};
  }
  return {"parking-garage", "sphere2500", "manhattan", "kitti00_all_loops"};
}

struct Options {
  std::vector<std::string> graphs, only = {"incremental", "batch", "growth", "covariance"};
  std::vector<long> growth = {10000}, growth_local = {100000};
  std::vector<long> joint = {5000, 20000}, joint_3d = {2500, 5000};
  int interval = 50, repeats = 3, candidates = 50, ceres_limit = 60;
  std::string json, markdown, update;

  bool Wants(const std::string& what) const { return IsIn(only, what); }
  // A part of "covariance".
  bool WantsCovariance(const std::string& part) const { return Wants("covariance") || Wants("covariance-" + part); }
  bool WantsCovariance(const std::string& part, const std::string& graph) const {
    return WantsCovariance(part) && IsIn(graphs.empty() ? CovarianceGraphs(part) : graphs, graph);
  }
  bool WantsGraph(const std::string& name) const {
    const bool covariances =
        WantsCovariance("kept", name) || WantsCovariance("newest", name) || WantsCovariance("batch", name);
    return covariances || ((Wants("batch") || Wants("incremental")) && (graphs.empty() || IsIn(graphs, name)));
  }
};

template <class Pose>
void MeasureCovariances(const PoseGraph<Pose>& graph, const BenchGraph& source, const Options& options,
                        nlohmann::json& json) {
  if (options.WantsCovariance("kept", source.name)) {
    json["covariance-kept"] = RunCovarianceKept(graph, options.interval);
  }
  if (options.WantsCovariance("newest", source.name)) {
    json["covariance-newest"] = RunCovarianceNewest(graph, options.candidates);
  }
  if (options.WantsCovariance("batch", source.name)) {
    json["covariance-batch"] = RunCovarianceBatch(graph, source.start, options.ceres_limit);
  }
}

nlohmann::json Measure(const BenchGraph& source, const Options& options) {
  nlohmann::json json = {{"name", source.name}};
  const AnyPoseGraph any = source.load();
  std::visit(
      [&](const auto& graph) {
        json["poses"] = graph.Poses().size();
        json["factors"] = graph.Factors().size();
        if (options.Wants("batch")) json["batch"] = RunBatch(graph, source.start, options.repeats);
        if (options.Wants("incremental")) json["incremental"] = RunIncremental(graph, options.interval);
        MeasureCovariances(graph, source, options, json);
      },
      any);
  return json;
}

nlohmann::json MeasureAll(const Options& options) {
  nlohmann::json results = {{"machine", Machine()}, {"graphs", nlohmann::json::array()}};
  if (options.Wants("incremental")) results["roof"] = MeasureRoof();
  for (const BenchGraph& source : BenchGraphs()) {
    if (!options.WantsGraph(source.name)) continue;
    std::fprintf(stderr, "%s ...\n", source.name.c_str());
    results["graphs"].push_back(Measure(source, options));
  }
  if (options.Wants("growth")) {
    const auto run = [&](long poses, long longest_link) {
      std::fprintf(stderr, "growth to %ld poses ...\n", poses);
      results["growth"].push_back(RunGrowth(poses, longest_link));
    };
    for (const long poses : options.growth) run(poses, poses);
    for (const long poses : options.growth_local) run(poses, 100);
  }
  if (options.WantsCovariance("joint")) {
    const auto run = [&](const char* name, Scene scene, long poses) {
      std::fprintf(stderr, "joint covariances, %s of %ld poses ...\n", name, poses);
      results["covariance-joint"].push_back(RunCovarianceJoint(scene, poses));
      results["covariance-joint"].back()["name"] = name;
    };
    for (const long poses : options.joint) run("generated manhattan", Scene::kManhattan, poses);
    for (const long poses : options.joint_3d) run("generated sphere", Scene::kSphere, poses);
  }
  return results;
}

nlohmann::json ReadResults(const std::string& path) {
  std::ifstream in(path);
  if (!in) throw std::runtime_error(path + ": cannot be read");
  return nlohmann::json::parse(in);
}

}  // namespace

int Main(int argc, char** argv) {
  Options options;
  CLI::App app("Benchmarks of pose-graph optimisation", "terse_bench");
  app.add_option("--graphs", options.graphs, "Only these, by name, separated by commas")->delimiter(',');
  app.add_option("--only", options.only,
                 "Only these: incremental, batch, growth, covariance, or a part of it: covariance-kept, "
                 "covariance-newest, covariance-batch, covariance-joint")
      ->delimiter(',');
  app.add_option("--growth", options.growth, "Sizes of the generated world of the growth run")->delimiter(',');
  app.add_option("--growth-local", options.growth_local, "The same with links to the last 100 poses only")
      ->delimiter(',');
  app.add_option("--joint", options.joint, "Sizes of the generated worlds of the joint covariances, 2D")
      ->delimiter(',');
  app.add_option("--joint-3d", options.joint_3d, "The same in 3D")->delimiter(',');
  app.add_option("--candidates", options.candidates, "Poses in the newest one's block column")
      ->check(CLI::PositiveNumber);
  app.add_option("--ceres-limit", options.ceres_limit, "Seconds that Ceres may take for covariances")
      ->check(CLI::PositiveNumber);
  app.add_option("--interval", options.interval, "Steps between comparisons")->check(CLI::PositiveNumber);
  app.add_option("--repeats", options.repeats, "Batch runs, of which the fastest counts")->check(CLI::PositiveNumber);
  app.add_option("--json", options.json, "Write the results here");
  app.add_option("--markdown", options.markdown, "Measure nothing: print the tables of these results");
  app.add_option("--update", options.update, "Put the tables into this document");
  CLI11_PARSE(app, argc, argv);
  const nlohmann::json results = options.markdown.empty() ? MeasureAll(options) : ReadResults(options.markdown);
  if (!options.json.empty()) std::ofstream(options.json) << results.dump(2) << '\n';
  const std::string tables = Tables(results), covariances = CovarianceTables(results);
  std::cout << tables << (tables.empty() || covariances.empty() ? "" : "\n") << covariances;
  if (options.update.empty()) return 0;
  if (!tables.empty()) UpdateDocument(options.update, tables, "bench");
  if (!covariances.empty()) UpdateDocument(options.update, covariances, "covariances");
  const std::string line = HistoryLine(results);
  if (!line.empty()) AppendToDocument(options.update, line, "history");
  return 0;
}

}  // namespace terse::bench
