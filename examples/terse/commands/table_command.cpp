// Tables of published papers, run again.

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iomanip>
#include <iostream>
#include <optional>
#include <sstream>

#include "commands/commands.h"
#include "run/ground_truth.h"
#include "run/progress.h"
#include "run/run_statistics.h"
#include "run/standard_output.h"
#include "terse/core/error.h"
#include "terse/core/linear_factor.h"
#include "terse/core/paper_flops.h"
#include "terse/core/replay.h"

namespace terse {
namespace {

enum class Initial { kFile, kCompose, kBoth };

struct TableOptions {
  std::string folder;
  Initial initial = Initial::kBoth;
  std::vector<std::string> graphs, policies;
  bool json = false, quiet = false;
};

// Settings of Arablouei 2026: Table 1 and, for the gap, the published code.
struct DataSet {
  std::string name;
  double step_tolerance;  // metres and radians
  double information_threshold;
  double loop_gap;
};
const std::vector<DataSet>& DataSets() {
  static const std::vector<DataSet> sets = {{"MIT", 1e-3, 1, 4},      {"FR079", 1e-4, 0.6, 4}, {"CSAIL", 1e-5, 0.95, 4},
                                            {"Intel", 1e-6, 0.72, 4}, {"FRH", 1e-7, 0.45, 1},  {"MIT-P", 1e-3, 1, 4}};
  return sets;
}

struct Row {
  std::string graph, initial, policy;
  int steps = 0, optimised = 0;    // gates that opened
  double chi2 = 0, mean_chi2 = 0;  // per measured scalar
  double ate = 0, mean_ate = 0;    // metres
  std::optional<double> paper_update, paper_solve;
  double update_flops = 0, solve_flops = 0;  // means, as are the paper's
  double seconds = 0;
};

// Root mean square of the distances after the best rigid motion in the plane. O(poses).
double AlignedError(const std::vector<SE2>& estimate, const std::vector<SE2>& reference) {
  const double n = static_cast<double>(estimate.size());
  Vector<2> mean_a = Vector<2>::Zero(), mean_b = Vector<2>::Zero();
  for (std::size_t k = 0; k < estimate.size(); ++k) {
    mean_a += estimate[k].Translation() / n;
    mean_b += reference[k].Translation() / n;
  }
  double squares = 0, dot = 0, cross = 0;
  for (std::size_t k = 0; k < estimate.size(); ++k) {
    const Vector<2> a = estimate[k].Translation() - mean_a, b = reference[k].Translation() - mean_b;
    squares += a.squaredNorm() + b.squaredNorm();
    dot += a.dot(b);
    cross += a.x() * b.y() - a.y() * b.x();
  }
  return std::sqrt(std::max(0.0, squares - 2 * std::hypot(dot, cross)) / n);
}

IncrementalOptions OptionsFor(Policy policy, const DataSet& set) {
  IncrementalOptions options = PolicyOptions(policy);
  if (policy == Policy::kDefault) return options;
  options.step_metres = options.step_radians = set.step_tolerance;
  if (options.gate == Gate::kLogDeterminant) options.gate_threshold = set.information_threshold;
  if (options.gate == Gate::kLoopClosure) options.gate_threshold = set.loop_gap;
  return options;
}

Row RunPolicy(const PoseGraph<SE2>& graph, const std::vector<SE2>& optimum, const DataSet& set, Policy policy,
              bool stored_values, bool quiet) {
  Row row;
  row.graph = set.name;
  row.initial = stored_values ? "file" : "compose";
  row.policy = WordOf(policy);
  const ReplayOptions replay{ArrivalUnit::kEdge, stored_values};
  IncrementalOptions options = OptionsFor(policy, set);
  Progress progress(row.graph + " " + row.initial + " " + row.policy, static_cast<long>(graph.Factors().size()), quiet);
  internal::PaperFlopsMeter<SE2> meter;
  const bool has_model = options.carry == Carry::kPoint;
  if (has_model) options.on_point_work = meter.Sink();
  IncrementalSolver<SE2> solver(options);
  meter.Watch(solver);
  double scalars = 0, paper_update = 0, paper_solve = 0;
  std::vector<SE2> reference;
  Replay<SE2>(graph, replay, solver, [&](const ReplayStep& step) {
    const auto& known = solver.Graph();
    scalars += Dimension(known.Factors().back().factor);
    while (reference.size() < known.Poses().size()) {
      reference.push_back(optimum[static_cast<std::size_t>(graph.IndexOf(known.Poses()[reference.size()].id))]);
    }
    row.chi2 = solver.Chi2() / scalars;
    row.ate = AlignedError(solver.Estimates(), reference);
    row.mean_chi2 += row.chi2 / step.steps;
    row.mean_ate += row.ate / step.steps;
    row.steps = step.steps;
    row.optimised += step.report.gate_open ? 1 : 0;
    paper_update += meter.OfLastStep().update / step.steps;
    paper_solve += meter.OfLastStep().solve / step.steps;
    row.update_flops += step.report.flops / step.steps;
    row.solve_flops += step.report.solve_flops / step.steps;
    row.seconds += step.report.seconds;
    progress.Update(step.index + 1);
    return true;
  });
  if (has_model) row.paper_update = paper_update, row.paper_solve = paper_solve;
  return row;
}

bool IsChosen(const std::string& name, const std::vector<std::string>& chosen) {
  return chosen.empty() || std::find(chosen.begin(), chosen.end(), name) != chosen.end();
}

std::vector<Row> RunGraph(const PoseGraph<SE2>& graph, const DataSet& set, const TableOptions& options) {
  const BatchResult<SE2> optimum = BatchOptimum(graph);
  std::vector<Row> rows;
  for (const bool stored : {true, false}) {
    if (options.initial == (stored ? Initial::kCompose : Initial::kFile)) continue;
    for (const auto& [name, policy] : Words<Policy>::kAll) {
      if (policy == Policy::kDefault && stored) continue;  // has no counterpart in the paper
      if (!IsChosen(name, options.policies)) continue;
      rows.push_back(RunPolicy(graph, optimum.T_world_body, set, policy, stored, options.quiet));
    }
  }
  return rows;
}

void PrintRows(const std::vector<Row>& rows) {
  const auto count = [](const std::optional<double>& value) {
    std::ostringstream text;
    value ? text << std::fixed << std::setprecision(0) << *value : text << '-';
    return text.str();
  };
  for (const Row& row : rows) {
    std::ostringstream line;
    line << std::left << std::setw(6) << row.graph << std::setw(8) << row.initial << std::setw(12) << row.policy
         << std::right << std::setprecision(6) << std::setw(6) << row.optimised << std::setw(13) << row.chi2
         << std::setw(13) << row.mean_chi2 << std::setprecision(4) << std::setw(12) << row.ate << std::setw(12)
         << row.mean_ate << std::setw(11) << count(row.paper_update) << std::setw(10) << count(row.paper_solve)
         << std::setw(11) << count(row.update_flops) << std::setw(10) << count(row.solve_flops) << std::setprecision(3)
         << std::setw(9) << row.seconds;
    std::cout << line.str() << '\n';
  }
  FlushOutput();
}

void PrintHeader() {
  std::cout << "graph initial policy     gates   N-chi2 end  N-chi2 mean     ATE end    ATE mean"
               "     update     solve our update our solve   time s\n";
}

nlohmann::ordered_json ToJson(const Row& row) {
  nlohmann::ordered_json json;
  json["graph"] = row.graph;
  json["initial"] = row.initial;
  json["policy"] = row.policy;
  json["steps"] = row.steps;
  json["gates_opened"] = row.optimised;
  json["normalized_chi2"] = {{"final", row.chi2}, {"mean", row.mean_chi2}};
  json["ate_m"] = {{"final", row.ate}, {"mean", row.mean_ate}};
  json["paper_update_flops"] = row.paper_update ? nlohmann::ordered_json(*row.paper_update) : nullptr;
  json["paper_solve_flops"] = row.paper_solve ? nlohmann::ordered_json(*row.paper_solve) : nullptr;
  json["update_flops"] = row.update_flops;
  json["solve_flops"] = row.solve_flops;
  json["seconds"] = row.seconds;
  return json;
}

void RunIggSpo(const TableOptions& options) {
  std::vector<std::pair<const DataSet*, std::string>> inputs;
  for (const DataSet& set : DataSets()) {
    if (!IsChosen(set.name, options.graphs)) continue;
    inputs.emplace_back(&set, (std::filesystem::path(options.folder) / (set.name + ".g2o")).string());
    // Before the first of many minutes, not after them.
    if (!std::filesystem::exists(inputs.back().second))
      throw FileError(inputs.back().second, 0, "no such file, expected a 2D graph of this name");
  }
  nlohmann::ordered_json json = nlohmann::ordered_json::array();
  bool has_header = options.json;
  for (const auto& [set, path] : inputs) {
    const GraphFile file = ReadGraph(path);
    const auto* graph = std::get_if<PoseGraph<SE2>>(&file.graph);
    if (graph == nullptr) throw FileError(path, 0, "a 3D graph, expected a 2D one");
    AddPathToErrors(path, [&, &data = *set] {
      const std::vector<Row> rows = RunGraph(*graph, data, options);
      if (!has_header) PrintHeader();
      has_header = true;
      if (!options.json) PrintRows(rows);
      for (const Row& row : rows) json.push_back(ToJson(row));
    });
  }
  if (options.json) PrintJson(json);
}

}  // namespace

void AddTableCommand(CLI::App& app) {
  CLI::App* table = app.add_subcommand("table", "Run the tables of published papers again");
  table->require_subcommand(1);
  auto options = std::make_shared<TableOptions>();
  CLI::App* command = table->add_subcommand(
      "igg-spo",
      "Information-guided gating and selective partial optimisation (Arablouei): its seven variants edge by "
      "edge on its six graphs, and the default policy");
  command
      ->add_option("DIR", options->folder, "Folder with MIT.g2o, FR079.g2o, CSAIL.g2o, Intel.g2o, FRH.g2o, MIT-P.g2o")
      ->required();
  AddChoice(*command, "--initial", options->initial,
            {{"file", Initial::kFile}, {"compose", Initial::kCompose}, {"both", Initial::kBoth}},
            "New poses start at the file's values, as in the paper, or composed from the estimate");
  std::vector<std::string> names;
  for (const DataSet& set : DataSets()) names.push_back(set.name);
  command->add_option("--graphs", options->graphs, "Only these graphs")
      ->check(OneOf(names))
      ->delimiter(',')
      ->type_name("NAME,...");
  names.clear();
  for (const auto& [name, policy] : Words<Policy>::kAll) names.emplace_back(name);
  command->add_option("--policies", options->policies, "Only these policies")
      ->check(OneOf(names))
      ->delimiter(',')
      ->type_name("NAME,...");
  command->add_flag("--json", options->json, "Print JSON");
  command->add_flag("--quiet", options->quiet, "No progress on standard error");
  command->footer(
      "N-chi2: chi2 per measured scalar. ATE: metres, against the batch optimum. update, solve: the paper's work "
      "model, "
      "mean per edge; our: floating-point operations of this program.\n"
      "Example: mkdir -p graphs && terse generate manhattan --poses 100 --output graphs/MIT.g2o &&\n"
      "         terse table igg-spo graphs --graphs MIT --policies gni-spo-igg,default --initial file");
  command->callback([options] { RunIggSpo(*options); });
  AddCompactTable(*table);
  AddOutliersTable(*table);
  AddSparsifyTable(*table);
}

}  // namespace terse
