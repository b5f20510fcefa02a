#pragma once
// The subcommands. Each function adds one to the application; its work runs as the subcommand's callback and throws
// terse::FileError, std::invalid_argument or terse::NumericalError, which main() turns into exit codes.

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>

#include "terse/core/graph_file.h"
#include "terse/core/robust.h"
#include "terse/core/words.h"

namespace terse {

enum class Strategy;
template <class Pose>
struct CompactOptions;

void AddInfoCommand(CLI::App& app);
void AddConvertCommand(CLI::App& app);
void AddEvaluateCommand(CLI::App& app);
void AddGenerateCommand(CLI::App& app);
void AddGenerateStereo(CLI::App& generate);  // a subcommand of generate
void AddSolveCommand(CLI::App& app);
void AddCompactCommand(CLI::App& app);
void AddSparsifyCommand(CLI::App& app);
void AddMergeCommand(CLI::App& app);
void AddOnlineCommand(CLI::App& app);
void AddCovarianceCommand(CLI::App& app);
void AddTableCommand(CLI::App& app);
void AddCompactTable(CLI::App& table);  // subcommands of table
void AddOutliersTable(CLI::App& table);
void AddSparsifyTable(CLI::App& table);
void AddSweepCommand(CLI::App& app);
void AddKittiCommand(CLI::App& app);
void AddReportCommand(CLI::App& app);
void AddPlotCommand(CLI::App& app);

// --rotation-information and --repair-information, for every subcommand that reads a graph.
void AddReadOptions(CLI::App& subcommand, ReadOptions& options);
// The first alone.
void AddRotationInformationOption(CLI::App& subcommand, ReadOptions& options);

// --trajectory, for those that optimise a graph as it is.
void AddTrajectoryOption(CLI::App& subcommand, std::string& path);

// --robust and --robust-width, for every subcommand that optimises.
CLI::Option* AddRobustOptions(CLI::App& subcommand, RobustOptions& options);
// The same for a compact map: its strategy has a kernel of its own (DefaultKernel), and gnc a width (MapRobust).
struct CompactRobust {
  RobustOptions options{RobustKernel::kGnc};
  const CLI::Option* kernel = nullptr;
  template <class Pose>
  RobustOptions For(const CompactOptions<Pose>& map) const;
  RobustKernel Kernel(Strategy strategy) const;
};
void AddRobustOptions(CLI::App& subcommand, CompactRobust& robust);

// --step-budget-ms, for what runs beside a sensor: a step may take a frame's time unless told otherwise; 0: no limit.
inline constexpr double kFrameMs = 33;
CLI::Option* AddStepBudgetOption(CLI::App& subcommand, double& milliseconds);

// --innovation-quantile and --no-innovation-test (absent), for every subcommand that tests links.
void AddInnovationOptions(CLI::App& subcommand, std::optional<double>& quantile);

// --sample: the share of the poses that thresholds are chosen from.
CLI::Option* AddSampleOption(CLI::App& subcommand, std::optional<double>& share);

// --seed.
void AddSeedOption(CLI::App& subcommand, std::uint64_t& seed, const std::string& description);

// One of these names, else the nearest is suggested; of these and `also`, which is suggested only.
CLI::Validator OneOf(const std::vector<std::string>& names, const std::vector<std::string>& also = {});

// Checks of an option's value that refuse nan, which CLI's own let pass.
CLI::Validator NumberIn(double low, double high);
CLI::Validator PositiveNumber();
CLI::Validator NonNegativeNumber();

// Warnings on standard error: lines that were skipped, matrices that --repair-information clamped.
void ReportRepairs(const GraphFile& file, const std::string& path);

// The words of an enumeration (terse/core/words.h) with their values; of these values if any are given.
template <class E>
std::vector<std::pair<std::string, E>> Choices(const std::vector<E>& only = {}) {
  std::vector<std::pair<std::string, E>> out;
  for (const auto& [word, value] : Words<E>::kAll) {
    if (only.empty() || std::find(only.begin(), only.end(), value) != only.end()) out.emplace_back(word, value);
  }
  return out;
}

// An option that takes one of a few names; the present value of `target` is the default.
template <class Value, class Choice = Value>
CLI::Option* AddChoice(CLI::App& subcommand, const std::string& option, Value& target,
                       const std::vector<std::pair<std::string, Choice>>& choices, const std::string& description) {
  std::vector<std::string> names;
  std::string list, preset;
  for (const auto& [name, value] : choices) {
    names.push_back(name);
    list += (list.empty() ? "" : "|") + name;
    if (value == target) preset = name;
  }
  const auto set = [&target, choices](const std::string& name) {
    for (const auto& [known, value] : choices) {
      if (known == name) target = value;
    }
  };
  return subcommand.add_option_function<std::string>(option, set, description)
      ->check(OneOf(names).description(""))  // the type name lists them already
      ->type_name(list)
      ->default_str(preset);
}

// Runs `work`; what it finds wrong with the graph (std::invalid_argument, NumericalError) then starts with the path.
void AddPathToErrors(const std::string& path, const std::function<void()>& work);

// The name nearest to a mistyped one by edit distance, or "" if none is near.
std::string NearestName(const std::string& mistyped, const std::vector<std::string>& names);

}  // namespace terse
