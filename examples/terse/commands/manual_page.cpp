// The manual page, in the man macros that groff and mandoc know.

#include <algorithm>
#include <sstream>

#include "commands/reference.h"

namespace terse {
namespace {

// Text that troff shows as it is. A line of it must not start with a control character.
std::string Escape(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '\\') {
      out += "\\e";
    } else if (c == '-') {
      out += "\\-";  // a minus that can be copied, not a hyphen
    } else {
      if ((out.empty() || out.back() == '\n') && (c == '.' || c == '\'')) out += "\\&";
      out += c;
      if (c == '|') out += "\\:";  // a line may end here
    }
  }
  return out;
}

std::string Bold(const std::string& text) { return "\\fB" + Escape(text) + "\\fR"; }
std::string Italic(const std::string& text) { return "\\fI" + Escape(text) + "\\fR"; }

// A block whose line ends and indentation stay.
std::string Literal(const std::string& text) { return ".EX\n" + Escape(text) + "\n.EE\n"; }

std::string Names(const std::vector<const CLI::Option*>& options) {
  std::vector<std::string> names;
  for (const CLI::Option* option : options) names.push_back(option->get_name());
  std::sort(names.begin(), names.end());  // CLI keeps them by address
  return CLI::detail::join(names, ", ");
}

void AddOption(const CLI::Option& option, std::ostream& out) {
  out << ".TP\n";
  if (option.get_positional()) {
    out << Italic(option.get_name(true));
  } else {
    std::string names;
    for (const std::string& name : option.get_snames()) names += (names.empty() ? "" : ", ") + Bold("-" + name);
    for (const std::string& name : option.get_lnames()) names += (names.empty() ? "" : ", ") + Bold("--" + name);
    out << names;
    if (option.get_items_expected_max() > 0) {
      const std::vector<std::string> values = ValuesOf(option);
      const std::string& own = option.get_option_text();
      out << ' '
          << Italic(!own.empty()     ? own
                    : values.empty() ? option.get_type_name()
                                     : CLI::detail::join(values, "|"));
    }
  }
  out << '\n' << Escape(option.get_description()) << '\n';
  if (option.get_positional() && !ValuesOf(option).empty()) {
    out << "One of " << Escape(CLI::detail::join(ValuesOf(option), ", ")) << ".\n";
  }
  if (!option.get_default_str().empty()) out << "(default " << Escape(option.get_default_str()) << ")\n";
  const auto needs = option.get_needs();
  if (!needs.empty()) out << "Needs " << Escape(Names({needs.begin(), needs.end()})) << ".\n";
  const auto excludes = option.get_excludes();
  if (!excludes.empty()) out << "Not with " << Escape(Names({excludes.begin(), excludes.end()})) << ".\n";
}

void AddSubcommand(const CLI::App& subcommand, std::ostream& out) {
  out << ".SS " << Escape("terse " + PathOf(subcommand)) << '\n';
  out << Escape(subcommand.get_description()) << "\n.PP\n" << Bold("terse " + PathOf(subcommand)) << " [OPTIONS]";
  for (const CLI::Option* positional : Positionals(subcommand)) {
    const std::string name = Italic(positional->get_name(true));
    out << ' ' << (positional->get_required() ? name : "[" + name + "]");
  }
  if (!Subcommands(subcommand).empty()) {
    out << (subcommand.get_require_subcommand_min() > 0 ? " SUBCOMMAND" : " [SUBCOMMAND]");
  }
  out << '\n';
  for (const CLI::Option* positional : Positionals(subcommand)) AddOption(*positional, out);
  for (const CLI::Option* option : Options(subcommand)) {
    if (option != subcommand.get_help_ptr()) AddOption(*option, out);
  }
  if (!subcommand.get_footer().empty()) out << ".PP\n" << Literal(subcommand.get_footer());
  for (const CLI::App* below : Subcommands(subcommand)) AddSubcommand(*below, out);
}

}  // namespace

std::string ManualPage(const CLI::App& app) {
  std::ostringstream out;
  out << ".TH TERSE 1 \"\" \"terse " TERSE_VERSION "\" \"User Commands\"\n.ad l\n.nh\n";
  out << ".SH NAME\nterse \\- " << Escape(app.get_description()) << '\n';
  out << ".SH SYNOPSIS\n" << Bold("terse") << ' ' << Italic("SUBCOMMAND") << " [OPTIONS] [ARGUMENTS]\n";
  out << ".SH DESCRIPTION\nSubcommands:\n";
  for (const CLI::App* subcommand : Subcommands(app)) {
    out << ".TP\n" << Bold(subcommand->get_name()) << '\n' << Escape(subcommand->get_description()) << '\n';
  }
  out << ".PP\n" << Literal(app.get_footer());
  out << ".SH OPTIONS\n";
  for (const CLI::Option* option : Options(app)) AddOption(*option, out);
  out << ".SH SUBCOMMANDS\n";
  for (const CLI::App* subcommand : Subcommands(app)) AddSubcommand(*subcommand, out);
  return out.str();
}

}  // namespace terse
