#pragma once
// The manual page and the shell completion, written from the command's own table of options so that they cannot
// differ from --help. The hidden options --print-man and --print-completion print them when the command is built.

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <string>
#include <vector>

namespace terse {

// --print-man and --print-completion. Call it when all subcommands are there.
void AddReferenceOptions(CLI::App& app);

std::string ManualPage(const CLI::App& app);      // troff with man macros, all subcommands on one page
std::string BashCompletion(const CLI::App& app);  // for a file in share/bash-completion/completions

// What both are made from. Hidden ones are left out.
std::vector<const CLI::App*> Subcommands(const CLI::App& app);
std::vector<const CLI::Option*> Options(const CLI::App& app);
std::vector<const CLI::Option*> Positionals(const CLI::App& app);
std::vector<std::string> ValuesOf(const CLI::Option& option);  // of those that take one of a few names
std::string PathOf(const CLI::App& app);                       // "generate stereo", "" for the command itself

}  // namespace terse
