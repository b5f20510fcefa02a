#include "pictures/compared_runs.h"

#include <filesystem>

namespace terse {

std::vector<RunFolder> ReadRunFolders(const std::vector<std::string>& paths) {
  std::vector<RunFolder> runs;
  for (const std::string& path : paths) runs.push_back(ReadRunFolder(path));
  if (runs.size() < 2 || runs[0].name != runs[1].name) return runs;
  for (RunFolder& run : runs) {  // ellipse/fpfl and sphere/fpfl, or the same one twice
    const std::string parent = std::filesystem::canonical(run.path).parent_path().filename().string();
    run.name = parent + '/' + run.name;
  }
  if (runs[0].name == runs[1].name) runs[1].name += " (2)";
  return runs;
}

}  // namespace terse
