// The tables behind docs/outliers.md: what wrong loops would tell, and what they do to the map.

#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <limits>
#include <set>
#include <thread>

#include "bench_report.h"
#include "outlier_gains.h"
#include "outlier_maps.h"
#include "shared_data.h"
#include "tables/document.h"
#include "terse/core/graph_file.h"

namespace terse::bench {
namespace {

using std::size_t;

// parking-garage's information is no covariance: 1 m and 1/2 rad for links that fit to centimetres. The width of its
// robust kernels.
constexpr double kNarrowWidth = 0.1;

struct Settings {
  std::vector<std::string> graphs = {"sphere2500", "manhattan", "parking-garage"};
  std::vector<double> percents = {0, 10, 30};
  std::uint64_t seed = 1;
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  std::set<std::string> only = {"gains", "batch", "compact"};
  std::string update;
};

struct TablesOfRun {
  std::string gains = GainHeader(), thresholds, maps;
};

std::string ThresholdHeader(const std::vector<double>& percents) {
  std::string header = "| graph | loops of the sample |", rule = "|---|---|";
  for (const double percent : percents) {
    header += " " + (percent == 0 ? "clean" : Format("%g %%", percent)) + ": range, m | rad | g_loop | g_pose |";
    rule += "---:|---:|---:|---:|";
  }
  return header + "\n" + rule + "\n";
}

void Say(const std::string& what) {
  static const auto start = std::chrono::steady_clock::now();
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::fprintf(stderr, "%7.1f s: %s\n", seconds, what.c_str());
}

// All information times a factor: the same optimum, another covariance.
template <class Pose>
PoseGraph<Pose> Scaled(const PoseGraph<Pose>& graph, double factor) {
  PoseGraph<Pose> out;
  for (const auto& pose : graph.Poses()) {
    out.AddPose(pose.id, pose.T_world_body);
    out.SetFixed(pose.id, pose.fixed);
  }
  for (const auto& node : graph.Factors()) {
    Factor<Pose> scaled = node.factor;
    std::visit([&](auto& f) { f.information *= factor; }, scaled);
    out.AddFactor(scaled);
  }
  return out;
}

template <class Pose>
class SceneRun {
 public:
  // All information is multiplied by `factor`, after the wrong loops are in.
  SceneRun(const OutlierScene<Pose>& scene, const Settings& settings, double factor)
      : scene_(scene), settings_(settings) {
    for (const double percent : settings.percents) {
      contaminated_.push_back(scene_.With(percent, settings.seed));
      if (factor != 1) contaminated_.back().graph = Scaled(contaminated_.back().graph, factor);
      Say(scene_.name + ", thresholds, " + Format("%g %%", percent));
      SampleOptions options;
      options.strategy = Strategy::kFpfl;
      thresholds_.push_back(SelectThresholds(contaminated_.back().graph, options).thresholds);
      options.innovation_quantile = kInnovationQuantile;
      tested_.push_back(SelectThresholds(contaminated_.back().graph, options).thresholds);
    }
  }

  // Of the most wrong loops, as those are the most to count.
  void AddGains(TablesOfRun& tables) const {
    Say(scene_.name + ", gains");
    tables.gains += GainRows(scene_.name, contaminated_.back(), thresholds_.front(), thresholds_.back());
  }

  void AddThresholds(TablesOfRun& tables) const {
    for (const bool test : {false, true}) {
      tables.thresholds += "| " + scene_.name + " | " + (test ? "tested" : "all") + " |";
      for (const auto& t : test ? tested_ : thresholds_) {
        tables.thresholds += " " + Format("%.3g", t.range[0]) + " | " + Format("%.3g", t.range[Pose::kDim]) + " | " +
                             Format("%.3g", t.min_loop_gain) + " | " + Format("%.3g", t.min_pose_gain) + " |";
      }
      tables.thresholds += "\n";
    }
  }

  void AddBatch(TablesOfRun& tables) const {
    const MapRuns<Pose> runs(scene_, settings_.threads);
    const std::pair<const char*, RobustKernel> methods[] = {
        {"least squares", RobustKernel::kNone}, {"dcs", RobustKernel::kDcs}, {"gnc", RobustKernel::kGnc}};
    for (const auto& [name, kernel] : methods) {
      MethodRow row{name, {}};
      for (const auto& with : contaminated_) row.results.push_back(runs.Batch(with, kernel));
      Add(row, tables);
    }
    MethodRow steps{"gnc, incremental", {}}, finished{"gnc, incremental, `Finish`", {}};
    for (const auto& with : contaminated_) {
      const auto both = runs.Incremental(with);
      steps.results.push_back(both.first);
      finished.results.push_back(both.second);
    }
    Add(steps, tables);
    Add(finished, tables);
  }

  void AddCompact(TablesOfRun& tables, bool all_variants) const {
    const MapRuns<Pose> runs(scene_, settings_.threads);
    struct Variant {
      const char* name;
      const std::vector<Thresholds<Pose>>& thresholds;
      bool test;
      int consensus;
      bool gnc;
    };
    const int all = std::numeric_limits<int>::max();
    for (const Variant& variant :
         {Variant{"FPFL, no test", thresholds_, false, 3, false}, Variant{"FPFL, tested", thresholds_, true, 3, false},
          Variant{"FPFL, sample tested too", tested_, true, 3, false},
          Variant{"FPFL, sample tested too, no consensus", tested_, true, all, false},
          Variant{"FPFL, sample tested too, gnc", tested_, true, 3, true}}) {
      if (!all_variants && (!variant.test || &variant.thresholds != &thresholds_)) continue;
      MethodRow row{variant.name, {}};
      for (size_t k = 0; k < contaminated_.size(); ++k) {
        row.results.push_back(
            runs.Compact(contaminated_[k], variant.thresholds[k], variant.test, variant.consensus, variant.gnc));
      }
      Add(row, tables);
    }
  }

 private:
  void Add(const MethodRow& row, TablesOfRun& tables) const {
    const std::string text = MapRow(scene_.name, row);
    Say(text.substr(0, text.size() - 1));
    tables.maps += text;
  }

  const OutlierScene<Pose>& scene_;
  const Settings& settings_;
  std::vector<Contaminated<Pose>> contaminated_;
  std::vector<Thresholds<Pose>> thresholds_;  // of the graphs as they are
  std::vector<Thresholds<Pose>> tested_;      // leaving out the loops that the innovation test refuses
};

template <class Pose>
void RunScene(const std::string& name, const std::string& path, const PoseGraph<Pose>& graph, const Settings& settings,
              TablesOfRun& tables) {
  OutlierScene<Pose> scene{name, 0, graph, {}};
  scene.reference = FindReference(graph, path, "");
  if (scene.reference.T_world_body.empty()) scene.reference.T_world_body = BatchOptimum(graph).T_world_body;
  const bool is_no_covariance = name == "parking-garage";
  if (is_no_covariance) scene.width = kNarrowWidth;
  const SceneRun<Pose> run(scene, settings, 1);
  run.AddThresholds(tables);
  if (settings.only.count("gains") != 0) run.AddGains(tables);
  if (settings.only.count("batch") != 0) run.AddBatch(tables);
  if (settings.only.count("compact") != 0) run.AddCompact(tables, !is_no_covariance);
  if (!is_no_covariance) return;
  // The compact run's counterpart of the width: covariances as much smaller.
  const double factor = std::pow(DefaultRobustWidth(RobustKernel::kGnc, Pose::kDof) / kNarrowWidth, 2);
  scene.name += ", scaled";
  scene.width = 0;
  const SceneRun<Pose> calibrated(scene, settings, factor);
  calibrated.AddThresholds(tables);
  if (settings.only.count("gains") != 0) calibrated.AddGains(tables);
  if (settings.only.count("compact") != 0) calibrated.AddCompact(tables, true);
}

}  // namespace

int Main(int argc, char** argv) {
  Settings settings;
  CLI::App app("Wrong loops: their information, and what they do to the map", "outliers");
  app.add_option("--graphs", settings.graphs, "Of ../shared/data/graphs")->delimiter(',');
  app.add_option("--only", settings.only, "gains, batch, compact")->delimiter(',');
  app.add_option("--seed", settings.seed, "Of the wrong loops");
  app.add_option("--threads", settings.threads, "The results do not depend on it")->check(CLI::PositiveNumber);
  app.add_option("--update", settings.update, "Put the tables into this document");
  CLI11_PARSE(app, argc, argv);
  TablesOfRun tables;
  tables.maps = MapHeader(settings.percents);
  tables.thresholds = ThresholdHeader(settings.percents);
  for (const std::string& name : settings.graphs) {
    const std::string file = (name == "manhattan" ? "graphs/2d/" : "graphs/3d/") + name + ".g2o";
    const auto path = SharedData(file);
    if (!path) {
      std::fprintf(stderr, "%s: left out, ../shared/data/%s is not there\n", name.c_str(), file.c_str());
      continue;
    }
    const GraphFile read = ReadGraph(*path);
    std::visit([&](const auto& graph) { RunScene(name, *path, graph, settings, tables); }, read.graph);
  }
  std::cout << tables.gains << '\n' << tables.thresholds << '\n' << tables.maps;
  if (!settings.update.empty()) {
    UpdateDocument(settings.update, tables.gains, "gains");
    UpdateDocument(settings.update, tables.thresholds, "thresholds");
    UpdateDocument(settings.update, tables.maps, "maps");
  }
  return 0;
}

}  // namespace terse::bench
