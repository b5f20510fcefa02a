#include <charconv>
#include <cmath>
#include <iostream>

#include "commands/commands.h"
#include "commands/output_paths.h"
#include "pictures/sparsify_report.h"
#include "run/progress.h"
#include "run/run_statistics.h"
#include "run/sparsify_output.h"
#include "run/standard_output.h"
#include "terse/compact/json_file.h"
#include "terse/compact/words.h"
#include "terse/core/chi_square.h"
#include "terse/core/residual.h"
#include "terse/core/writable.h"

namespace terse {
namespace {

constexpr long kLeastFreedom = 30;  // residuals beyond what poses take up, to judge the information by
constexpr double kMostRatio = 3;

struct SparsifyCommandOptions {
  std::string path, directory;
  ReadOptions read;
  SparsifyOptions sparsify;
  bool json = false, quiet = false;
};

// "20%" or "350".
std::optional<SparsifyBudget> ParseBudget(std::string text) {
  SparsifyBudget budget;
  budget.is_share = !text.empty() && text.back() == '%';
  if (budget.is_share) text.pop_back();
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), budget.value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(budget.value)) return std::nullopt;
  if (budget.is_share) budget.value /= 100;
  const bool is_good =
      budget.value >= 0 && (budget.is_share ? budget.value <= 1 : std::floor(budget.value) == budget.value);
  return is_good ? std::optional<SparsifyBudget>(budget) : std::nullopt;
}

CLI::Option* AddBudget(CLI::App& command, const std::string& name, std::optional<SparsifyBudget>& target,
                       const std::string& description) {
  return command
      .add_option_function<std::string>(
          name, [&target](const std::string& text) { target = ParseBudget(text); }, description)
      ->check([](const std::string& text) {
        return ParseBudget(text) ? "" : text + " is neither a share as 20% nor a whole number";
      })
      ->type_name("N|P%");
}

// One bar for each task.
class Bars {
 public:
  explicit Bars(bool quiet) : quiet_(quiet) {}
  void Update(const std::string& task, double share) {
    if (task != task_) {
      task_ = task;
      bar_.emplace(task, 1000, quiet_);
    }
    bar_->Update(std::lround(1000 * share));
  }
  void Clear() { bar_.reset(); }

 private:
  const bool quiet_;
  std::string task_;
  std::optional<Progress> bar_;
};

// A wrong link is the one that tells most: more of them than chance would have are worth a word.
template <class Pose>
void WarnOfWrongLinks(const PoseGraph<Pose>& graph, const Sparsified<Pose>& small) {
  const auto at = graph.WithPoses(small.T_world_body_whole);
  const double limit = ChiSquareQuantile(0.9999, Pose::kDof);
  long wrong = 0;
  for (const ConsideredLink& link : small.links) {
    const auto& edge = std::get<RelativePoseFactor<Pose>>(at.FindFactor(link.id)->factor);
    const auto value = [&](PoseId id) { return *at.Poses()[static_cast<std::size_t>(at.IndexOf(id))].T_world_body; };
    const auto r = edge.T_from_to.Local(value(edge.from).Inverse() * value(edge.to));
    wrong += r.dot(edge.information * r) > 10 * limit;
  }
  if (wrong == 0) return;
  std::cerr << "terse: warning: " << wrong << " of " << small.links.size()
            << " links disagree with the optimum by more than three times what one in ten thousand does; if they are "
            << "wrong, leave them out first (terse solve --robust gnc)\n";
}

// Expected errors are those of the information; where the residuals contradict it, they are off by as much.
template <class Pose>
void WarnOfInformation(const PoseGraph<Pose>& graph, const Sparsified<Pose>& small) {
  long freedom = -Pose::kDof * (static_cast<long>(graph.Poses().size()) - 1);
  for (const auto& node : graph.Factors()) freedom += Dimension(node.factor);
  if (freedom < kLeastFreedom) return;
  const double ratio = std::sqrt(small.chi2_whole / static_cast<double>(freedom));
  if (ratio > 1 / kMostRatio && ratio < kMostRatio) return;
  char line[200];
  std::snprintf(line, sizeof line,
                "terse: warning: residuals are %.3g times %s than the information says, and errors probably as much "
                "%s than expected\n",
                std::max(ratio, 1 / ratio), ratio < 1 ? "smaller" : "larger", ratio < 1 ? "smaller" : "larger");
  std::cerr << line;
}

void PrintSparsified(const nlohmann::ordered_json& stats, const std::string& directory) {
  char line[400];
  std::snprintf(line, sizeof line,
                "kept %ld of %ld poses and %ld of %ld links by %s; expected position error %.4g m, of the whole graph "
                "%.4g m\nlog-determinant lost by links %.4g nats, divergence by dropped poses %.4g nats; %.2f s; "
                "results in %s\n",
                stats["poses_kept"].get<long>(), stats["poses"].get<long>(), stats["links_kept"].get<long>(),
                stats["links"].get<long>(), stats["criterion"].get<std::string>().c_str(),
                stats["expected_error_m"].get<double>(), stats["expected_error_whole_m"].get<double>(),
                stats["log_det_lost_nats"].get<double>(), stats["divergence_nats"].get<double>(),
                stats["seconds_total"].get<double>(), directory.c_str());
  std::cout << line;
  FlushOutput();
}

template <class Pose>
void RunOn(const PoseGraph<Pose>& graph, const SparsifyCommandOptions& options, double start) {
  SparsifyOptions sparsify = options.sparsify;
  Bars bars(options.quiet || options.json);
  sparsify.progress = [&](const std::string& task, double share) {
    bars.Update(task, share);
    return true;
  };
  const Sparsified<Pose> small = Sparsify(graph, sparsify);
  bars.Clear();
  nlohmann::ordered_json stats = SparsifyStats(graph, small, sparsify);
  WriteSparsified(graph, small, options.read.rotation_information, options.directory);
  WriteSparsifyReport(options.path, graph, small, stats, options.directory + "/report.html");
  stats["seconds_total"] = SecondsNow() - start;
  WriteJson(stats, options.directory + "/stats.json");
  if (options.json) {
    std::cout << stats.dump(2) << '\n';
    FlushOutput();
    return;
  }
  if (options.quiet) return;
  PrintSparsified(stats, options.directory);
  WarnOfInformation(graph, small);
  WarnOfWrongLinks(graph, small);
  const int poses = static_cast<int>(graph.Poses().size());
  const int asked = options.sparsify.poses ? options.sparsify.poses->Of(poses) : poses;
  const auto kept = static_cast<int>(small.graph.Poses().size());
  if (kept > asked) {
    std::cerr << "terse: warning: " << kept << " poses are kept although " << asked
              << " were asked for: the others have priors, hold a part of the graph, or have too many neighbours\n";
  }
}

void Sparsify(const SparsifyCommandOptions& options) {
  if (!options.sparsify.links && !options.sparsify.poses && !options.sparsify.budget_error)
    throw CLI::ValidationError("--links", "give a budget: --links, --poses or --budget-error");
  CheckOutputPaths(FilesIn("--output", options.directory, SparsifyFiles()), {{"FILE", options.path}});
  const double start = SecondsNow();
  ReadOptions read = options.read;
  read.expect_connected = false;
  const GraphFile file = ReadGraph(options.path, read);
  if (!options.quiet) ReportRepairs(file, options.path);
  RequireFolder(options.directory, "compact.g2o");
  AddPathToErrors(options.path,
                  [&] { std::visit([&](const auto& graph) { RunOn(graph, options, start); }, file.graph); });
}

}  // namespace

void AddSparsifyCommand(CLI::App& app) {
  auto options = std::make_shared<SparsifyCommandOptions>();
  CLI::App* command = app.add_subcommand(
      "sparsify", "Make a finished graph small: keep the links and poses that say most about the map");
  command->add_option("FILE", options->path, "The graph file (g2o, TORO or iSAM)")->required();
  SparsifyOptions& sparsify = options->sparsify;
  CLI::Option* links = AddBudget(*command, "--links", sparsify.links, "Links to keep, beside the edges of --fixed");
  AddBudget(*command, "--poses", sparsify.poses, "Poses to keep; the others are marginalised");
  command
      ->add_option("--budget-error", sparsify.budget_error,
                   "Keep as few links as leave the expected position error within this factor of the whole graph's")
      ->check(NumberIn(1, 1e9))
      ->excludes(links)
      ->type_name("X");
  AddChoice(*command, "--criterion", sparsify.criterion, Choices<SparsifyCriterion>(),
            "Links are kept that lower the expected position error most, that raise the log-determinant of the "
            "information most, that make the graph well connected (Fiedler value, as MAC does), or at random");
  AddChoice(*command, "--fixed", sparsify.fixed, Choices<FixedEdges>(),
            "Edges that are kept in any case: the odometry, a spanning tree of the most informative ones, or none but "
            "as many as hold the poses");
  AddChoice(*command, "--recover", sparsify.recovered, Choices<RecoveredFactors>(),
            "The factors that replace those of a dropped pose: along a tree of its neighbours, about three for each, "
            "or between all");
  command->add_flag("--conservative", sparsify.conservative,
                    "Recovered factors never say more than the exact marginal");
  command->add_flag("--recentre", sparsify.recentre,
                    "Replace every kept measurement by what the optimum of the whole graph says in its place, so that "
                    "the sparsified graph has the same optimum");
  AddSeedOption(*command, sparsify.seed, "Of --criterion random and connectivity");
  command->add_option("--threads", sparsify.threads, "At most; the result is the same for any number")
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
      "Example: terse generate manhattan --poses 1000 --output manhattan.g2o &&\n"
      "         terse sparsify manhattan.g2o --links 20% --poses 50% --output small");
  command->callback([options] { Sparsify(*options); });
}

}  // namespace terse
