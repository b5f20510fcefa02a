#pragma once
// No command writes over what it reads, nor writes two results to one place.

#include <string>
#include <vector>

namespace terse {

// What an option or an argument names: ("--stats", "stats.json"). An empty path or "-" names no file.
struct NamedPath {
  std::string name, path;
};

// Called before a command does any work. Throws CLI::ValidationError, which names both options and the path, if an
// output is the same file as an input or as another output, whatever the two are called: links are followed, and files
// that do not exist yet are compared by their place. What is no regular file (/dev/stdout, a pipe) may be named twice.
void CheckOutputPaths(const std::vector<NamedPath>& outputs, const std::vector<NamedPath>& inputs);

// What AtomicFile takes for the path of an option in which "-" is standard output.
std::string FileOrStandardOutput(const std::string& path);

// The files of a run (compact, kitti) in its folder, all named after the option that names the folder.
std::vector<NamedPath> RunFiles(const std::string& name, const std::string& folder);
// These files in the folder.
std::vector<NamedPath> FilesIn(const std::string& name, const std::string& folder,
                               const std::vector<std::string>& files);

}  // namespace terse
