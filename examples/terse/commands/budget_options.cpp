#include "commands/budget_options.h"

#include <charconv>
#include <string>

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

void AddShareOption(CLI::App& command, const char* name, std::optional<double>& share, const char* help) {
  command
      .add_option_function<std::string>(
          name, [&share](const std::string& text) { share = ParseShare(text); }, help)
      ->check([](const std::string& text) {
        return ParseShare(text) ? std::string() : text + " is no share like 10% or 0.1, above 0 and at most 1";
      })
      ->type_name("SHARE");
}

}  // namespace

void AddBudgetOptions(CLI::App& command, CompactBudget& budget) {
  AddShareOption(
      command, "--keep-poses", budget.keep_poses,
      "Keep this share of the poses in the long run (10% or 0.1): the thresholds follow, from the given ones "
      "on; less where there is nothing to say");
  AddShareOption(command, "--keep-links", budget.keep_links, "The same of the loops that are measured or registered");
}

}  // namespace terse
