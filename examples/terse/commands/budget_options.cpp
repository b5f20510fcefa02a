#include "commands/budget_options.h"

#include <charconv>
#include <cmath>
#include <string>

#include "commands/commands.h"

namespace terse {
namespace {

// "10%" or "0.1"; above 0 and at most 1.
std::optional<double> ParseShare(std::string text) {
  const bool is_percent = !text.empty() && text.back() == '%';
  if (is_percent) text.pop_back();
  double share = 0;
  const char* end = text.data() + text.size();
  const std::from_chars_result read = std::from_chars(text.data(), end, share);  // whatever the locale
  if (read.ec != std::errc() || read.ptr != end) return std::nullopt;
  if (is_percent) share /= 100;
  return share > 0 && share <= 1 ? std::optional<double>(share) : std::nullopt;
}

CLI::Option* AddShareOption(CLI::App& command, const char* name, std::optional<double>& share, const char* help) {
  return command
      .add_option_function<std::string>(
          name, [&share](const std::string& text) { share = ParseShare(text); }, help)
      ->check([](const std::string& text) {
        return ParseShare(text) ? std::string() : text + " is no share like 10% or 0.1, above 0 and at most 1";
      })
      ->type_name("SHARE");
}

// Refuses nan too.
std::string NeedsGrowth(const std::string& text) {
  double growth = 0;
  const char* end = text.data() + text.size();
  const std::from_chars_result read = std::from_chars(text.data(), end, growth);
  const bool is_number = read.ec == std::errc() && read.ptr == end;
  return is_number && growth > 1 && std::isfinite(growth) ? "" : text + " is no growth of the error, a number above 1";
}

}  // namespace

void AddBudgetOptions(CLI::App& command, CompactBudget& budget) {
  CLI::Option* poses = AddShareOption(
      command, "--keep-poses", budget.keep_poses,
      "Keep this share of the poses in the long run (10% or 0.1): the thresholds follow, from the given ones "
      "on; less where there is nothing to say");
  CLI::Option* links = AddShareOption(command, "--keep-links", budget.keep_links,
                                      "The same of the loops that are measured or registered");
  CLI::Option* density =
      command
          .add_option(
              "--poses-per-area", budget.poses_per_area,
              "Keep so many poses per square as wide as the sensor's greatest range that the robot has been in: "
              "the map grows with the area, not with time")
          ->check(PositiveNumber())
          ->type_name("N")
          ->excludes(poses);
  command
      .add_option(
          "--error", budget.error,
          "Keep what it takes for the position error to be so many times that of a map with all loops (1.2), as "
          "far as covariances tell")
      ->check(NeedsGrowth)
      ->type_name("GROWTH")
      ->excludes(poses)
      ->excludes(links)
      ->excludes(density);
}

void AddBoundedOptions(CLI::App& command, double& min_variance_drop, double& retire_share) {
  command
      .add_option(
          "--min-variance-drop", min_variance_drop,
          "Strategy bounded: a link or an edge is kept only if it also takes this share of the expected squared "
          "position error from the map [0: not asked]")
      ->check(NumberIn(0, 0.999999))
      ->type_name("SHARE");
  command
      .add_option("--retire-share", retire_share,
                  "Strategy bounded: as the map grows kept poses retire (are marginalised) whose removal loses no more "
                  "than this share of what a link must tell; 0: none")
      ->check(NonNegativeNumber())
      ->capture_default_str()
      ->type_name("SHARE");
}

CLI::Option& AddRememberOption(CLI::App& command, std::string& remember, const std::string& help) {
  return *command.add_option("--remember", remember, help)
              ->check([](const std::string& text) {
                const bool is_count = !text.empty() && text.size() < 10 &&
                                      text.find_first_not_of("0123456789") == text.npos &&
                                      text.find_first_not_of('0') != text.npos;
                return is_count || text == kRememberAll ? std::string()
                                                        : text + " is neither a number of poses, 1 or more, nor all";
              })
              ->type_name("N|all");
}

std::optional<int> MostDropped(const std::string& remember) {
  if (remember == kRememberAll) return std::nullopt;
  return std::stoi(remember);
}

}  // namespace terse
