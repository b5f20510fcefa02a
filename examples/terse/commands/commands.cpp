#include <algorithm>
#include <charconv>
#include <cmath>
#include <iostream>

#include "commands/commands.h"
#include "run/run_statistics.h"
#include "terse/compact/compact_graph.h"
#include "terse/core/number_text.h"

namespace terse {
namespace {

// Levenshtein's distance.
std::size_t EditDistance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t substituted = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({substituted, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row[b.size()];
}

}  // namespace

void AddRotationInformationOption(CLI::App& subcommand, ReadOptions& options) {
  AddChoice(subcommand, "--rotation-information", options.rotation_information, Choices<RotationInformation>(),
            "What the rotation part of EDGE_SE3:QUAT information in the input means: of the quaternion's vector part "
            "(g2o's definition) or of the rotation vector (as GTSAM and Ceres read it)");
}

void AddReadOptions(CLI::App& subcommand, ReadOptions& options) {
  AddRotationInformationOption(subcommand, options);
  subcommand.add_flag("--repair-information", options.repair_information,
                      "Clamp the eigenvalues of information matrices that are not positive definite");
}

void AddTrajectoryOption(CLI::App& subcommand, std::string& path) {
  subcommand
      .add_option(
          "--trajectory", path,
          "Write the trajectory: PATH.tum (pose ids for stamps) or PATH.kitti (a line per pose, by ascending id)")
      ->check(FindTrajectoryPathDefect)
      ->type_name("PATH");
}

CLI::Option* AddRobustOptions(CLI::App& subcommand, RobustOptions& options) {
  CLI::Option* kernel =
      AddChoice(subcommand, "--robust", options.kernel, Choices<RobustKernel>(),
                "The cost of loops, which may be wrong; gnc leaves the wrong ones out (graduated non-convexity)");
  subcommand
      .add_option(
          "--robust-width", options.width,
          "Where the kernel sets in, in standard deviations: the norm of the whitened residual (by default what "
          "one true loop in a hundred exceeds, with gnc less where loops agree better than their information says)")
      ->check(PositiveNumber())
      ->needs(kernel)
      ->type_name("X");
  return kernel;
}

void AddRobustOptions(CLI::App& subcommand, CompactRobust& robust) {
  CLI::Option* kernel = AddRobustOptions(subcommand, robust.options);
  kernel->default_str("gnc, or none with another strategy than bounded");
  subcommand.get_option("--robust-width")
      ->description(
          "Where the kernel sets in, in standard deviations: the norm of the whitened residual (by default that of gnc "
          "is the limit of the innovation test, less where loops agree better than their information says, of the "
          "others what one true loop in a hundred exceeds)");
  robust.kernel = kernel;
}

RobustKernel CompactRobust::Kernel(Strategy strategy) const {
  return kernel == nullptr || kernel->count() == 0 ? DefaultKernel(strategy) : options.kernel;
}

template <class Pose>
RobustOptions CompactRobust::For(const CompactOptions<Pose>& map) const {
  RobustOptions robust = options;
  robust.kernel = Kernel(map.strategy);
  return MapRobust(robust, map);
}
template RobustOptions CompactRobust::For(const CompactOptions<SE2>&) const;
template RobustOptions CompactRobust::For(const CompactOptions<SE3>&) const;

CLI::Option* AddStepBudgetOption(CLI::App& subcommand, double& milliseconds) {
  return subcommand
      .add_option("--step-budget-ms", milliseconds,
                  "What optimising the map would take longer in a step is spread over the next ones; 0: never. Where "
                  "no step can come near it the result does not depend on it")
      ->check(NonNegativeNumber())
      ->type_name("MS")
      ->capture_default_str();
}

void AddInnovationOptions(CLI::App& subcommand, std::optional<double>& quantile) {
  CLI::Option* option =
      subcommand
          .add_option("--innovation-quantile", quantile,
                      "A link is refused whose innovation a correct one exceeds with less than the remaining "
                      "probability")
          ->check(NumberIn(1e-9, 0.99999999))
          ->type_name("Q")
          ->default_str("0.9999");
  subcommand
      .add_flag_callback(
          "--no-innovation-test", [&quantile] { quantile.reset(); }, "Take every link that is informative")
      ->excludes(option);
}

CLI::Option* AddSampleOption(CLI::App& subcommand, std::optional<double>& share) {
  return subcommand
      .add_option("--sample", share,
                  "Share of the poses that the thresholds are chosen from, instead of 0.6 but 200 poses at most")
      ->check(NumberIn(1e-9, 1))
      ->type_name("SHARE");
}

void AddSeedOption(CLI::App& subcommand, std::uint64_t& seed, const std::string& description) {
  subcommand.add_option("--seed", seed, description)
      ->check([](const std::string& text) -> std::string {
        std::uint64_t value = 0;
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
        if (error == std::errc() && end == text.data() + text.size()) return "";
        return text + " is not a whole number from 0 to 2^64 - 1";
      })
      ->type_name("N")
      ->capture_default_str();
}

CLI::Validator OneOf(const std::vector<std::string>& names, const std::vector<std::string>& also) {
  const std::string list = "{" + CLI::detail::join(names, ",") + "}";
  const auto find_defect = [names, also, list](const std::string& text) -> std::string {
    if (std::find(names.begin(), names.end(), text) != names.end()) return "";
    std::vector<std::string> known = names;
    known.insert(known.end(), also.begin(), also.end());
    const std::string nearest = NearestName(text, known);
    return text + " not in " + list + (nearest.empty() ? "" : "; did you mean " + nearest + "?");
  };
  return CLI::Validator(find_defect, list);
}

CLI::Validator NumberIn(double low, double high) {
  const auto find_defect = [low, high](const std::string& text) -> std::string {
    double value = 0;
    if (CLI::detail::lexical_cast(text, value) && value >= low && value <= high) return "";
    return text + " is not a number from " + Shortest(low) + " to " + Shortest(high);
  };
  return CLI::Validator(find_defect, "");
}

CLI::Validator PositiveNumber() {
  const auto find_defect = [](const std::string& text) -> std::string {
    double value = 0;
    if (CLI::detail::lexical_cast(text, value) && value > 0 && std::isfinite(value)) return "";
    return text + " is not a positive number";
  };
  return CLI::Validator(find_defect, "");
}

CLI::Validator NonNegativeNumber() {
  const auto find_defect = [](const std::string& text) -> std::string {
    double value = 0;
    if (CLI::detail::lexical_cast(text, value) && value >= 0 && std::isfinite(value)) return "";
    return text + " is neither 0 nor a positive number";
  };
  return CLI::Validator(find_defect, "");
}

void ReportRepairs(const GraphFile& file, const std::string& path) {
  const std::string skipped = DescribeSkippedTags(file);
  if (!skipped.empty()) {
    std::cerr << "terse: warning: " << path << ": lines with tags that are not known here were skipped: " << skipped
              << '\n';
  }
  if (file.repaired_informations == 0) return;
  std::cerr << "terse: warning: " << path << ": " << file.repaired_informations
            << " information matrices were not positive definite and have been clamped\n";
}

void AddPathToErrors(const std::string& path, const std::function<void()>& work) {
  try {
    work();
  } catch (const std::invalid_argument& error) {
    throw FileError(path, 0, error.what());
  } catch (const NumericalError& error) {
    throw NumericalError(path + ": " + error.what());
  }
}

std::string NearestName(const std::string& mistyped, const std::vector<std::string>& names) {
  std::string nearest;
  std::size_t best = std::max<std::size_t>(2, mistyped.size() / 3) + 1;
  for (const std::string& name : names) {
    const std::size_t distance = EditDistance(mistyped, name);
    if (distance < best) best = distance, nearest = name;
  }
  return nearest;
}

}  // namespace terse
