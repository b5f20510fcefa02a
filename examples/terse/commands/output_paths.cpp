#include "commands/output_paths.h"

#include <sys/stat.h>
#include <unistd.h>

#include <CLI/Error.hpp>
#include <filesystem>
#include <map>
#include <optional>

namespace terse {
namespace {

namespace fs = std::filesystem;

std::string IdentityOf(const struct stat& status) {
  return std::to_string(status.st_dev) + ':' + std::to_string(status.st_ino);
}

bool NamesDescriptor(const std::string& path) {
  return path == "-" || path == "/dev/stdout" || path == "/dev/stderr" || path.rfind("/dev/fd/", 0) == 0;
}

// The same text for two names of one file; absent for what can be written to twice.
std::optional<std::string> IdentityOf(const std::string& path) {
  if (path.empty() || NamesDescriptor(path)) return std::nullopt;
  struct stat status;
  if (::stat(path.c_str(), &status) == 0) {
    if (!S_ISREG(status.st_mode)) return std::nullopt;
    return IdentityOf(status);
  }
  std::error_code error;
  const fs::path place = fs::weakly_canonical(fs::absolute(path, error), error);
  return error ? std::nullopt : std::optional<std::string>(place.string());
}

}  // namespace

void CheckOutputPaths(const std::vector<NamedPath>& outputs, const std::vector<NamedPath>& inputs) {
  std::map<std::string, const NamedPath*> read, written;
  for (const NamedPath& input : inputs) {
    if (const auto identity = IdentityOf(input.path)) read.emplace(*identity, &input);
  }
  // What the command prints, if it goes to a file.
  const NamedPath streams[] = {{"standard output", "what the command prints"}, {"standard error", "its messages"}};
  for (const int descriptor : {STDERR_FILENO, STDOUT_FILENO}) {
    struct stat status;
    if (::fstat(descriptor, &status) != 0 || !S_ISREG(status.st_mode)) continue;
    written[IdentityOf(status)] = &streams[descriptor - STDOUT_FILENO];
  }
  for (const NamedPath& output : outputs) {
    const auto identity = IdentityOf(output.path);
    if (!identity) continue;
    if (const auto it = read.find(*identity); it != read.end()) {
      throw CLI::ValidationError(output.name, output.path + " is the same file as the input " + it->second->path +
                                                  " (" + it->second->name + "), which it would overwrite");
    }
    if (const auto [it, is_new] = written.emplace(*identity, &output); !is_new) {
      throw CLI::ValidationError(output.name, output.path + " is the same file as " + it->second->path + " (" +
                                                  it->second->name + "), expected a place of its own for each output");
    }
  }
}

std::string FileOrStandardOutput(const std::string& path) { return path == "-" ? "/dev/stdout" : path; }

std::vector<NamedPath> FilesIn(const std::string& name, const std::string& folder,
                               const std::vector<std::string>& files) {
  std::vector<NamedPath> out;
  for (const std::string& file : files) out.push_back({name, (fs::path(folder) / file).string()});
  return out;
}

std::vector<NamedPath> RunFiles(const std::string& name, const std::string& folder) {
  return FilesIn(name, folder,
                 {"compact.g2o", "graph.json", "thresholds.json", "stats.json", "trajectory.tum", "ground_truth.tum",
                  "decisions.csv", "decisions.jsonl", "steps.csv", "covariances.csv", "covariances.npz", "loops.csv"});
}

}  // namespace terse
