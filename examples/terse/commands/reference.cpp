#include "commands/reference.h"

#include <iostream>

#include "commands/stereo_program.h"

namespace terse {

std::vector<const CLI::App*> Subcommands(const CLI::App& app) {
  // A filter keeps the order in which they were added.
  return app.get_subcommands([](const CLI::App* subcommand) { return !subcommand->get_group().empty(); });
}

std::vector<const CLI::Option*> Options(const CLI::App& app) {
  return app.get_options(
      [](const CLI::Option* option) { return option->nonpositional() && !option->get_group().empty(); });
}

std::vector<const CLI::Option*> Positionals(const CLI::App& app) {
  return app.get_options([](const CLI::Option* option) { return option->get_positional(); });
}

std::vector<std::string> ValuesOf(const CLI::Option& option) {
  // AddChoice writes a|b|c, OneOf {a,b,c}.
  std::string type = option.get_type_name();
  const std::size_t open = type.find('{'), close = type.find('}');
  const bool in_braces = open != std::string::npos && close != std::string::npos;
  if (in_braces) type = type.substr(open + 1, close - open - 1);
  const char separator = in_braces ? ',' : '|';
  if (!in_braces && type.find(separator) == std::string::npos) return {};
  return CLI::detail::split(type, separator);
}

std::string PathOf(const CLI::App& app) {
  if (app.get_parent() == nullptr) return "";
  const std::string before = PathOf(*app.get_parent());
  return (before.empty() ? "" : before + " ") + app.get_name();
}

void AddReferenceOptions(CLI::App& app) {
  const auto add = [&app](const std::string& name, std::string (*write)(const CLI::App&)) {
    app.add_flag_callback(name,
                          [&app, write] {
                            if (HasStereoProgram()) throw StereoProgramAsked();  // knows all options
                            std::cout << write(app);                             // main flushes it
                            throw CLI::Success();                                // before a subcommand is asked for
                          })
        ->group("");
  };
  add("--print-man", ManualPage);
  add("--print-completion", BashCompletion);
}

}  // namespace terse
