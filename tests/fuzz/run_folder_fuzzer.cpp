// The folder of a run, as report and plot read it: its files one behind the other, each after a line "=== NAME". What
// was read is drawn and put into a report.

#include <filesystem>

#include "fuzzing.h"
#include "pictures/compared_runs.h"
#include "pictures/map_picture.h"
#include "pictures/run_charts.h"
#include "pictures/run_report.h"
#include "terse/compact/run_folder.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace terse;
  static fuzz::ScratchFolder folder;
  for (const char* name : {"graph.json", "thresholds.json", "stats.json", "trajectory.tum", "decisions.jsonl",
                           "steps.csv", "covariances.csv", "ground_truth.tum"}) {
    std::filesystem::remove(folder.Path(name));
  }
  for (const fuzz::Part& part : fuzz::Parts(fuzz::AsText(data, size))) {
    const bool is_name = part.name.find_first_not_of("abcdefghijklmnopqrstuvwxyz._") == std::string::npos;
    if (is_name && part.name.size() > 4) folder.With(part.name, part.content);
  }
  fuzz::Done([&] {
    const std::vector<RunFolder> runs = ReadRunFolders({folder.Path()});
    ReportToJson(runs).dump(-1, ' ', false,
                            nlohmann::ordered_json::error_handler_t::replace);  // as the page is written
    DrawMaps(runs);
    DrawGains(runs);
    DrawTimings(runs);
  });
  return 0;
}
