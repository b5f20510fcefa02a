// The completion for bash: the subcommands, their options, and for every option what can follow it.

#include <sstream>

#include "commands/reference.h"

namespace terse {
namespace {

bool TakesFile(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  for (const char* of_files : {"PATH", "FILE", "DIR", "TEXT"}) {
    if (type.rfind(of_files, 0) == 0) return true;
  }
  return false;
}

// All of the application, from the top.
void Collect(const CLI::App& app, std::vector<const CLI::App*>& all) {
  all.push_back(&app);
  for (const CLI::App* subcommand : Subcommands(app)) Collect(*subcommand, all);
}

std::string NamesOf(const CLI::Option& option) {
  std::string out;
  for (const std::string& name : option.get_snames()) out += (out.empty() ? "-" : " -") + name;
  for (const std::string& name : option.get_lnames()) out += (out.empty() ? "--" : " --") + name;
  return out;
}

// A branch of `case "$path:$option"` for each option that takes a value.
void AddValueBranches(const CLI::App& app, std::ostream& out) {
  for (const CLI::Option* option : Options(app)) {
    if (option->get_items_expected_max() == 0) continue;
    std::string pattern;
    for (const std::string& name : CLI::detail::split(NamesOf(*option), ' ')) {
      pattern += (pattern.empty() ? "'" : " | '") + PathOf(app) + ":" + name + "'";
    }
    const std::vector<std::string> values = ValuesOf(*option);
    out << "    " << pattern << ") ";
    if (!values.empty()) {
      out << "words='" << CLI::detail::join(values, " ") << "'";
    } else {
      out << (TakesFile(*option) ? "files=yes" : ":");  // a number cannot be completed
    }
    out << " ;;\n";
  }
}

// A branch of `case "$path"`: what may come where no option waits for its value.
void AddWordsBranch(const CLI::App& app, std::ostream& out) {
  std::string words, options;
  bool files = false;
  for (const CLI::App* subcommand : Subcommands(app)) words += ' ' + subcommand->get_name();
  for (const CLI::Option* positional : Positionals(app)) {
    for (const std::string& value : ValuesOf(*positional)) words += ' ' + value;
    files = files || TakesFile(*positional);
  }
  for (const CLI::Option* option : Options(app)) options += ' ' + NamesOf(*option);
  out << "      '" << PathOf(app) << "') words='" << CLI::detail::trim(words) << "' options='"
      << CLI::detail::trim(options) << "'" << (files ? " files=yes" : "") << " ;;\n";
}

}  // namespace

std::string BashCompletion(const CLI::App& app) {
  std::vector<const CLI::App*> all;
  Collect(app, all);
  std::ostringstream out;
  out << "# Completion of terse " TERSE_VERSION
         " in bash, printed by `terse --print-completion`.\n"
         "_terse() {\n"
         "  local current=${COMP_WORDS[COMP_CWORD]} option=${COMP_WORDS[COMP_CWORD - 1]}\n"
         "  local path='' words='' options='' files='' i\n"
         "  # Bash takes --option=value for three words.\n"
         "  [[ $current == '=' ]] && current=''\n"
         "  [[ $option == '=' ]] && option=${COMP_WORDS[COMP_CWORD - 2]}\n"
         "  for ((i = 1; i < COMP_CWORD; i++)); do\n"
         "    case \"${path:+$path }${COMP_WORDS[i]}\" in\n";
  for (const CLI::App* one : all) {
    if (one != &app) out << "      '" << PathOf(*one) << "') path='" << PathOf(*one) << "' ;;\n";
  }
  out << "    esac\n"
         "  done\n"
         "  case \"$path:$option\" in\n";
  for (const CLI::App* one : all) AddValueBranches(*one, out);
  out << "    *)\n      case \"$path\" in\n";
  for (const CLI::App* one : all) out << "  ", AddWordsBranch(*one, out);
  out << "      esac\n"
         "      if [[ $current == -* ]]; then words=$options files=''; fi ;;\n"
         "  esac\n"
         "  mapfile -t COMPREPLY < <(compgen -W \"$words\" -- \"$current\")\n"
         "  if [[ $files ]]; then\n"
         "    compopt -o filenames 2>/dev/null\n"
         "    mapfile -t -O ${#COMPREPLY[@]} COMPREPLY < <(compgen -f -- \"$current\")\n"
         "  fi\n"
         "}\n"
         "complete -F _terse terse\n";
  return out.str();
}

}  // namespace terse
