// The pages of docs/ and README.md: links lead somewhere, and what they tell about the command is so.

#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <map>
#include <regex>
#include <set>

#include "testing_command.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

const fs::path kRoot = TERSE_SOURCE_DIR;

struct Page {
  fs::path path;
  std::vector<std::string> text;                  // lines without code
  std::vector<std::pair<int, std::string>> code;  // line number; blocks line by line, and spans
};

std::vector<fs::path> PagePaths() {
  std::vector<fs::path> paths = {kRoot / "README.md"};
  for (const auto& entry : fs::recursive_directory_iterator(kRoot / "docs")) {
    if (entry.path().extension() == ".md") paths.push_back(entry.path());
  }
  std::sort(paths.begin(), paths.end());
  return paths;
}

// Moves spans of `code` from a line to the page's code; an empty pair of ticks stays.
std::string TakeSpans(const std::string& line, int number, Page& page) {
  static const std::regex span("`([^`]*)`");
  for (auto found = std::sregex_iterator(line.begin(), line.end(), span); found != std::sregex_iterator(); ++found) {
    page.code.emplace_back(number, (*found)[1]);
  }
  return std::regex_replace(line, span, "``");
}

Page ReadPage(const fs::path& path) {
  Page page{path, {}, {}};
  std::ifstream file(path);
  bool fenced = false, blank = true, block = false;
  int number = 0;
  for (std::string line; std::getline(file, line);) {
    ++number;
    page.text.emplace_back();
    if (line.rfind("```", 0) == 0) {
      fenced = !fenced;
    } else if (fenced || (line.rfind("    ", 0) == 0 && (blank || block))) {
      block = true;
      page.code.emplace_back(number, line);
      continue;
    } else {
      page.text.back() = TakeSpans(line, number, page);
    }
    block = false;
    blank = line.empty();
  }
  return page;
}

// GitHub's rule for the anchor of a heading.
std::string Anchor(const std::string& title) {
  std::string anchor;
  for (const char c : title) {
    if (std::isalnum(static_cast<unsigned char>(c)) || c == '-' || c == '_') {
      anchor += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    } else if (c == ' ') {
      anchor += '-';
    }
  }
  return anchor;
}

std::set<std::string> Anchors(const fs::path& path) {
  std::set<std::string> anchors;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    const auto marks = line.find_first_not_of('#');
    if (marks > 0 && marks != std::string::npos && line[marks] == ' ') anchors.insert(Anchor(line.substr(marks + 1)));
  }
  return anchors;
}

TEST(Docs, LinksAndPicturesExist) {
  const std::regex link(R"(\[[^\]]*\]\(([^)#]*)#?([^)]*)\))");  // the text may go over the end of a line
  for (const fs::path& path : PagePaths()) {
    std::string text;
    for (const std::string& line : ReadPage(path).text) text += line + '\n';
    for (auto found = std::sregex_iterator(text.begin(), text.end(), link); found != std::sregex_iterator(); ++found) {
      const std::string target = (*found)[1], anchor = (*found)[2];
      if (target.rfind("http", 0) == 0) continue;
      const auto end = text.begin() + found->position() + found->length();
      const std::string where = path.string() + ":" + std::to_string(1 + std::count(text.begin(), end, '\n'));
      const fs::path file = target.empty() ? path : path.parent_path() / target;
      EXPECT_TRUE(fs::exists(file)) << where << ": " << target << " does not exist";
      if (anchor.empty() || !fs::exists(file)) continue;
      EXPECT_EQ(Anchors(file).count(anchor), 1u) << where << ": " << target << " has no #" << anchor;
    }
  }
}

class DocumentedCommands : public testing::CommandTest {
 protected:
  // Words of the first column of `terse COMMAND --help`: options, and under "Subcommands:" further commands.
  struct Help {
    std::set<std::string> options, subcommands;
  };

  const Help& HelpOf(const std::string& command) {
    const auto known = helps_.find(command);
    if (known != helps_.end()) return known->second;
    Help& help = helps_[command];
    std::istringstream text(Succeed(command + " --help").out);
    static const std::regex option("--[a-z][a-z0-9-]*"), subcommand("^  ([a-z][a-z0-9-]*)(  .*)?$");
    bool in_subcommands = false;
    std::smatch found;
    for (std::string line; std::getline(text, line);) {
      if (!line.empty() && line[0] != ' ') in_subcommands = line == "Subcommands:";
      if (in_subcommands && std::regex_match(line, found, subcommand)) help.subcommands.insert(found[1]);
      if (line.rfind("  -", 0) != 0) continue;
      for (auto name = std::sregex_iterator(line.begin(), line.end(), option); name != std::sregex_iterator(); ++name) {
        help.options.insert(name->str());
      }
    }
    return help;
  }

  // Splits what follows `terse`: the command with its subcommand, and its options up to the end of the shell command.
  void Check(const std::string& line, const std::string& where) {
    std::istringstream words(line.substr(0, line.find_first_of("|&;<>")));
    std::string word, command;
    while (words >> word) {
      if (HelpOf(command).subcommands.count(word) == 0) break;
      command += command.empty() ? word : " " + word;
      word.clear();
    }
    if (command.empty()) {
      // `terse --help`, `terse COMMAND`; not a word of a command that is gone or misspelt.
      EXPECT_TRUE(word.empty() || !std::islower(static_cast<unsigned char>(word[0])))
          << where << ": there is no command " << word;
      return;
    }
    static const std::regex option("--[a-z][a-z0-9-]*");
    do {
      std::smatch found;
      if (word.rfind("--", 0) != 0 || !std::regex_search(word, found, option)) continue;
      EXPECT_EQ(HelpOf(command).options.count(found.str()), 1u)
          << where << ": terse " << command << " has no option " << found.str();
    } while (words >> word);
  }

  std::map<std::string, Help> helps_;
};

TEST_F(DocumentedCommands, AreKnownWithTheirOptions) {
  // After the start of the line or of a shell command, perhaps with a path: `terse compact ...`.
  const std::regex call(R"((^|[|&;(] ?|\$ )\s*(build/bin/)?terse +(.*))");
  int checked = 0;
  for (const fs::path& path : PagePaths()) {
    for (const auto& [number, code] : ReadPage(path).code) {
      const std::string where = path.string() + ":" + std::to_string(number);
      std::smatch found;
      std::string rest = code;
      if (rest.rfind("terse:", 0) == 0) continue;  // a message
      while (std::regex_search(rest, found, call)) {
        Check(found[3], where);
        ++checked;
        rest = found[3].str();
        const auto next = rest.find_first_of("|&;");
        rest = next == std::string::npos ? "" : rest.substr(next);
      }
      // `solve --stats` in prose.
      std::istringstream words(code);
      std::string first, second;
      words >> first >> second;
      if (HelpOf("").subcommands.count(first) != 0 && second.rfind("--", 0) == 0) Check(code, where);
    }
  }
  EXPECT_GT(checked, 50);
}

// `--option` alone in prose: some command has it. Pages about benchmark programs have theirs too, and terse-mpi's is
// held against it in distributed_command_test.
TEST_F(DocumentedCommands, OptionsInProseAreKnown) {
  std::set<std::string> known;
  for (const std::string& command : HelpOf("").subcommands) {
    known.insert(HelpOf(command).options.begin(), HelpOf(command).options.end());
    const std::set<std::string> subcommands = HelpOf(command).subcommands;
    for (const std::string& subcommand : subcommands) {
      const std::set<std::string> options = HelpOf(command + " " + subcommand).options;
      known.insert(options.begin(), options.end());
    }
  }
  const std::regex option("^(--[a-z][a-z0-9-]*)");
  for (const fs::path& path : PagePaths()) {
    const std::string page = path.filename();
    if (page == "benchmarks.md" || page == "consistency.md" || page == "mpi.md") continue;
    for (const auto& [number, code] : ReadPage(path).code) {
      std::smatch found;
      if (!std::regex_search(code, found, option)) continue;
      EXPECT_EQ(known.count(found[1]), 1u) << path << ':' << number << ": no command has " << found[1];
    }
  }
}

}  // namespace
}  // namespace terse
