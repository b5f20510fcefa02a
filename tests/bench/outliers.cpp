// The tables behind docs/outliers.md: what wrong loops would tell, and what they do to the map.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <limits>
#include <set>
#include <thread>

#include "bench_report.h"
#include "ground_truth.h"
#include "shared_data.h"
#include "terse/compact/information.h"
#include "terse/compact/innovation.h"
#include "terse/compact/thresholds.h"
#include "terse/core/graph_file.h"
#include "terse/core/initial_values.h"
#include "terse/core/outliers.h"
#include "terse/core/replay.h"

namespace terse::bench {
namespace {

using std::size_t;

constexpr double kQuantile = 0.9999;  // of the innovation test, as CompactOptions has it
// parking-garage's information is no covariance: 1 m and 1/2 rad for links that fit to centimetres. The width of its
// robust kernels.
constexpr double kNarrowWidth = 0.1;

std::string Format(const char* format, double value) {
  char text[64];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

using Pair = std::pair<std::int64_t, std::int64_t>;
Pair PairOf(PoseId a, PoseId b) { return std::minmax(a.value, b.value); }

// A graph with wrong loops or none. No true edge joins the pair of a wrong one.
template <class Pose>
struct Contaminated {
  double percent = 0;
  PoseGraph<Pose> graph;
  std::set<Pair> wrong;
};

template <class Pose>
struct Scene {
  std::string name;
  double width = 0;  // of the robust kernels; 0: the default
  PoseGraph<Pose> graph;
  Reference<Pose> reference;

  Contaminated<Pose> With(double percent, std::uint64_t seed) const {
    Contaminated<Pose> out{percent, graph, {}};
    if (percent == 0) return out;
    auto added = AddWrongLoops(graph, reference.T_world_body, percent, seed);
    for (const FactorId id : added.wrong) {
      const auto& loop = std::get<RelativePoseFactor<Pose>>(added.graph.FindFactor(id)->factor);
      out.wrong.insert(PairOf(loop.from, loop.to));
    }
    out.graph = std::move(added.graph);
    return out;
  }
};

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

// ---- What a loop would tell the clean map when it arrives.

struct LoopValue {
  double gain = 0, innovation = 0;
  bool in_range = false;               // of the thresholds from the clean graph
  bool in_contaminated_range = false;  // of those from the graph with its wrong loops
};
struct LoopValues {
  std::vector<LoopValue> of_true, of_wrong;
};

template <class Pose>
class GainRun {
 public:
  GainRun(const Contaminated<Pose>& with, const Thresholds<Pose>& clean, const Thresholds<Pose>& contaminated)
      : wrong_(with.wrong), clean_(clean), contaminated_(contaminated), replay_(with.graph) {}

  LoopValues Run() {
    const Registration<Pose> registration = replay_.AsRegistration();
    for (const auto& input : replay_.Inputs()) {
      GraphUpdate<Pose> arrival, links;
      arrival.poses.push_back({input.id, input.odometry ? std::nullopt : input.T_world_body, input.fixed});
      if (input.odometry) arrival.factors.push_back(*input.odometry);
      solver_.Update(arrival);
      for (const PoseId id : *input.linkable) {
        const RelativePoseFactor<Pose> link = *registration(id, input.id);
        const bool is_wrong = wrong_.count(PairOf(id, input.id)) != 0;
        (is_wrong ? out_.of_wrong : out_.of_true).push_back(Judge(id, input.id, link));
        if (!is_wrong) links.factors.push_back(link);
      }
      if (!links.factors.empty()) solver_.Update(links);
    }
    return std::move(out_);
  }

 private:
  LoopValue Judge(PoseId id, PoseId current, const RelativePoseFactor<Pose>& link) const {
    const UncertainPose<Pose> known{solver_.Estimate(id).Inverse() * solver_.Estimate(current),
                                    marginals_.Relative(id, current)};
    const UncertainPose<Pose> measured = SeenFrom(id, link);
    const Displacement<Pose> displacement = ComputeDisplacement(known);
    const auto in_range = [&](const Thresholds<Pose>& t) {
      return RangeProbabilities<Pose>(displacement, t.range).minCoeff() > t.probability;
    };
    return {InformationGain<Pose::kDof>(known.covariance, measured.covariance), InnovationDistance(known, measured),
            in_range(clean_), in_range(contaminated_)};
  }

  const std::set<Pair>& wrong_;
  const Thresholds<Pose>&clean_, &contaminated_;
  GraphReplay<Pose> replay_;
  IncrementalSolver<Pose> solver_;
  IncrementalMarginals<Pose> marginals_{solver_};
  LoopValues out_;
};

double Percentile(std::vector<double> values, double share) {
  const auto nth = values.begin() + std::lround(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

std::vector<double> Gains(const std::vector<LoopValue>& loops) {
  std::vector<double> out;
  for (const LoopValue& loop : loops) out.push_back(loop.gain);
  std::sort(out.begin(), out.end());
  return out;
}

// That a wrong loop drawn at random has a higher gain than a true one (the area under the ROC curve).
double ProbabilityOfHigherGain(const LoopValues& values) {
  const std::vector<double> of_true = Gains(values.of_true);
  double sum = 0;
  for (const LoopValue& loop : values.of_wrong) {
    const auto range = std::equal_range(of_true.begin(), of_true.end(), loop.gain);
    sum += static_cast<double>(range.first - of_true.begin()) + 0.5 * static_cast<double>(range.second - range.first);
  }
  return sum / (static_cast<double>(of_true.size()) * static_cast<double>(values.of_wrong.size()));
}

template <class Is>
std::string Share(const std::vector<LoopValue>& loops, const Is& is) {
  const auto count = std::count_if(loops.begin(), loops.end(), is);
  return Format("%.1f", 100 * static_cast<double>(count) / static_cast<double>(loops.size()));
}

constexpr const char* kGainHeader =
    "| graph | loops | number | gain: 10 % | 50 % | 90 % | above a true one | above g_loop, % | refused, % | in range, "
    "% "
    "| in range of contaminated, % | in range, above g_loop, not refused, % |\n"
    "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n";

template <class Pose>
std::string GainRows(const std::string& name, const LoopValues& values, const Thresholds<Pose>& thresholds) {
  const double most = ChiSquareQuantile(kQuantile, Pose::kDof);
  std::string out;
  for (const bool is_wrong : {false, true}) {
    const auto& loops = is_wrong ? values.of_wrong : values.of_true;
    const std::vector<double> gains = Gains(loops);
    const auto informative = [&](const LoopValue& l) { return l.gain > thresholds.min_loop_gain; };
    const auto refused = [&](const LoopValue& l) { return !(l.innovation <= most); };
    out += is_wrong ? "| | wrong | " : "| " + name + " | true | ";
    out += std::to_string(loops.size());
    for (const double share : {0.1, 0.5, 0.9}) out += " | " + Format("%.2f", Percentile(gains, share));
    out += " | " + (is_wrong ? Format("%.3f", ProbabilityOfHigherGain(values)) : std::string());
    out += " | " + Share(loops, informative) + " | " + Share(loops, refused) + " | " +
           Share(loops, [](const LoopValue& l) { return l.in_range; }) + " | " +
           Share(loops, [](const LoopValue& l) { return l.in_contaminated_range; }) + " | " +
           Share(loops, [&](const LoopValue& l) { return l.in_range && informative(l) && !refused(l); }) + " |\n";
  }
  return out;
}

// ---- What the wrong loops do to the map.

struct MapResult {
  std::string failure;   // empty if there is a map
  double ate = 0;        // metres
  int wrong = 0;         // links kept
  int by_consensus = 0;  // of these, refused by the innovation test but for others that agree
  int links = -1;        // true ones among the loops
  int poses = -1;        // where not all are kept
};
using Method = std::string;

template <class Pose>
class MapRuns {
 public:
  MapRuns(const Scene<Pose>& scene, int threads) : scene_(scene), threads_(threads) {}

  MapResult Batch(const Contaminated<Pose>& with, RobustKernel kernel) const {
    BatchOptions options;
    options.threads = threads_;
    options.max_iterations = 50;  // good starts take ten
    options.robust = Robust(kernel);
    const auto result = SolveBatch(with.graph, ComputeInitialValues(with.graph, InitialValues::kCompose), options);
    MapResult out;
    if (result.termination == Termination::kNotPositiveDefinite) out.failure = result.message;
    Count(
        with, [&](size_t k, FactorId) { return result.weights.empty() ? 1 : result.weights[k]; }, out);
    std::vector<RecoveredPose<Pose>> poses;
    for (size_t k = 0; k < result.T_world_body.size(); ++k) {
      poses.push_back({with.graph.Poses()[k].id, true, result.T_world_body[k]});
    }
    out.ate = Ate(poses);
    return out;
  }

  // After the last step, and after Finish.
  std::pair<MapResult, MapResult> Incremental(const Contaminated<Pose>& with) const {
    IncrementalOptions options;
    options.threads = threads_;
    options.robust = Robust(RobustKernel::kGnc);
    IncrementalSolver<Pose> solver(options);
    Replay(with.graph, {}, solver);
    std::pair<MapResult, MapResult> out;
    out.first = Present(solver, with);
    BatchOptions finish;
    finish.threads = threads_;
    solver.Finish(finish);
    out.second = Present(solver, with);
    return out;
  }

  MapResult Compact(const Contaminated<Pose>& with, const Thresholds<Pose>& thresholds, bool test, int consensus,
                    bool gnc) const {
    MapResult out;
    CompactOptions<Pose> settings;
    settings.range = thresholds.range;
    settings.probability = thresholds.probability;
    settings.min_loop_gain = thresholds.min_loop_gain;
    settings.min_pose_gain = thresholds.min_pose_gain;
    settings.link_covariance = thresholds.link_covariance;
    settings.innovation_quantile = test ? std::optional<double>(kQuantile) : std::nullopt;
    settings.consensus = consensus;
    if (gnc) settings.solver.robust = Robust(RobustKernel::kGnc);
    GraphReplay<Pose> replay(with.graph);
    CompactPoseSlam<Pose> slam(settings);
    std::vector<FactorId> wrong;
    try {
      for (const auto& input : replay.Inputs()) {
        const Decision decision = slam.AddPose(input, replay.AsRegistration());
        for (const Candidate& c : decision.candidates) {
          if (!c.accepted || with.wrong.count(PairOf(c.id, decision.id)) == 0) continue;
          wrong.push_back(*c.factor);
          out.by_consensus += c.supported ? 1 : 0;
        }
      }
      slam.Finish();
      out.links = slam.LinksKept() - static_cast<int>(wrong.size());
      out.wrong = static_cast<int>(
          std::count_if(wrong.begin(), wrong.end(), [&](FactorId id) { return slam.Solver().WeightOf(id) >= 0.5; }));
      out.poses = static_cast<int>(slam.Solver().Graph().Poses().size());
      out.ate = Ate(slam.Trajectory());
    } catch (const std::runtime_error& error) {
      out.failure = error.what();
    }
    return out;
  }

 private:
  RobustOptions Robust(RobustKernel kernel) const { return {kernel, scene_.width}; }
  double Ate(const std::vector<RecoveredPose<Pose>>& poses) const {
    return ComputeErrors(scene_.graph, scene_.reference, poses).ate.translation_m;
  }
  // `weight` of the k-th factor.
  template <class WeightOf>
  void Count(const Contaminated<Pose>& with, const WeightOf& weight, MapResult& out) const {
    out.links = 0;
    const std::vector<FactorId> loops = LoopFactors(with.graph);
    size_t k = 0;
    for (const auto& node : with.graph.Factors()) {
      if (std::binary_search(loops.begin(), loops.end(), node.id) && weight(k, node.id) >= 0.5) {
        const FactorPoses ends = PosesOf(node.factor);
        ++(with.wrong.count(PairOf(ends.first, ends.second)) != 0 ? out.wrong : out.links);
      }
      ++k;
    }
  }
  MapResult Present(const IncrementalSolver<Pose>& solver, const Contaminated<Pose>& with) const {
    MapResult out;
    Contaminated<Pose> arrived{with.percent, solver.Graph(), with.wrong};
    Count(
        arrived, [&](size_t, FactorId id) { return solver.WeightOf(id); }, out);
    std::vector<RecoveredPose<Pose>> poses;
    for (const auto& node : solver.Graph().Poses()) poses.push_back({node.id, true, solver.Estimate(node.id)});
    out.ate = Ate(poses);
    return out;
  }

  const Scene<Pose>& scene_;
  int threads_;
};

struct MethodRow {
  std::string name;
  std::vector<MapResult> results;  // clean first
};

std::string MapHeader(const std::vector<double>& percents) {
  std::string header = "| graph | method |", rule = "|---|---|";
  for (const double percent : percents) {
    const std::string name = percent == 0 ? "clean" : Format("%g %%", percent);
    header += " " + name + ": ATE, m |" + (percent == 0 ? "" : " ratio | wrong kept |") + " true kept |";
    rule += percent == 0 ? "---:|---:|" : "---:|---:|---:|---:|";
  }
  return header + "\n" + rule + "\n";
}

std::string ThresholdHeader(const std::vector<double>& percents) {
  std::string header = "| graph | loops of the sample |", rule = "|---|---|";
  for (const double percent : percents) {
    header += " " + (percent == 0 ? "clean" : Format("%g %%", percent)) + ": range, m | rad | g_loop | g_pose |";
    rule += "---:|---:|---:|---:|";
  }
  return header + "\n" + rule + "\n";
}

std::string MapRow(const std::string& graph, const MethodRow& row) {
  std::string out = "| " + graph + " | " + row.name + " |";
  const double clean = row.results[0].ate;
  for (size_t k = 0; k < row.results.size(); ++k) {
    const MapResult& r = row.results[k];
    if (!r.failure.empty()) {
      out += k == 0 ? " failed | |" : " failed | | | |";
      continue;
    }
    out += " " + Format("%.4g", r.ate) + " |";
    if (k > 0)
      out += " " + (clean > 1e-6 ? Format("%.3g", r.ate / clean) : "") + " | " + std::to_string(r.wrong) +
             (r.by_consensus == 0 ? "" : " (" + std::to_string(r.by_consensus) + " by consensus)") + " |";
    out += " " + std::to_string(r.links) + (r.poses < 0 ? "" : " (" + std::to_string(r.poses) + " poses)") + " |";
  }
  return out + "\n";
}

// ---- All of it.

struct Settings {
  std::vector<std::string> graphs = {"sphere2500", "manhattan", "parking-garage"};
  std::vector<double> percents = {0, 10, 30};
  std::uint64_t seed = 1;
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  std::set<std::string> only = {"gains", "batch", "compact"};
  std::string update;
};

struct TablesOfRun {
  std::string gains = kGainHeader, thresholds, maps;
};

void Say(const std::string& what) {
  static const auto start = std::chrono::steady_clock::now();
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::fprintf(stderr, "%7.1f s: %s\n", seconds, what.c_str());
}

template <class Pose>
class SceneRun {
 public:
  // All information is multiplied by `factor`, after the wrong loops are in.
  SceneRun(const Scene<Pose>& scene, const Settings& settings, double factor) : scene_(scene), settings_(settings) {
    for (const double percent : settings.percents) {
      contaminated_.push_back(scene_.With(percent, settings.seed));
      if (factor != 1) contaminated_.back().graph = Scaled(contaminated_.back().graph, factor);
      Say(scene_.name + ", thresholds, " + Format("%g %%", percent));
      SampleOptions options;
      thresholds_.push_back(SelectThresholds(contaminated_.back().graph, options));
      options.innovation_quantile = kQuantile;
      tested_.push_back(SelectThresholds(contaminated_.back().graph, options));
    }
  }

  // Of the most wrong loops, as those are the most to count.
  void AddGains(TablesOfRun& tables) const {
    Say(scene_.name + ", gains");
    const LoopValues values = GainRun<Pose>(contaminated_.back(), thresholds_.front(), thresholds_.back()).Run();
    tables.gains += GainRows(scene_.name, values, thresholds_.front());
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

  const Scene<Pose>& scene_;
  const Settings& settings_;
  std::vector<Contaminated<Pose>> contaminated_;
  std::vector<Thresholds<Pose>> thresholds_;  // of the graphs as they are
  std::vector<Thresholds<Pose>> tested_;      // leaving out the loops that the innovation test refuses
};

template <class Pose>
void RunScene(const std::string& name, const PoseGraph<Pose>& graph, const Settings& settings, TablesOfRun& tables) {
  Scene<Pose> scene{name, 0, graph, {}};
  if constexpr (Pose::kDim == 2) {
    if (auto truth = GridTruth(graph)) scene.reference = {ReferenceKind::kGrid, std::move(*truth)};
  } else {
    if (auto truth = SphereTruth(graph)) scene.reference = {ReferenceKind::kSphere, std::move(*truth)};
  }
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
    std::visit([&](const auto& graph) { RunScene(name, graph, settings, tables); }, read.graph);
  }
  std::cout << tables.gains << '\n' << tables.thresholds << '\n' << tables.maps;
  if (!settings.update.empty()) {
    UpdateDocument(settings.update, tables.gains, "gains");
    UpdateDocument(settings.update, tables.thresholds, "thresholds");
    UpdateDocument(settings.update, tables.maps, "maps");
  }
  return 0;
}

}  // namespace
}  // namespace terse::bench

int main(int argc, char** argv) {
  try {
    return terse::bench::Main(argc, argv);
  } catch (const std::exception& error) {
    std::cerr << "outliers: " << error.what() << '\n';
    return 1;
  }
}
