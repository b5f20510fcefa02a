#pragma once
// The runs of `terse table outliers` in a file, a line of JSON each (docs/outputs.md), so that a table of many hours
// goes on where it was stopped.

#include <fstream>
#include <map>
#include <optional>
#include <string>
#include <tuple>

#include "tables/outlier_table.h"

namespace terse {

// What a run is known by: graph, its poses and loops, kind, percent, seed, method.
using OutlierRunKey = std::tuple<std::string, int, int, int, double, std::uint64_t, std::string>;
OutlierRunKey KeyOf(const OutlierGraph& graph, const OutlierRun& run);

class OutlierRunLog {
 public:
  // Reads what is there; of a last line without an end, which a killed run left, nothing stays. Throws FileError.
  explicit OutlierRunLog(const std::string& path);
  // As it was measured; Judge has still to be asked.
  const OutlierRun* Find(const OutlierRunKey& key) const;
  // Appends a line. Throws FileError.
  void Add(const OutlierGraph& graph, const OutlierRun& run);

 private:
  std::string path_;
  std::map<OutlierRunKey, OutlierRun> known_;
  std::ofstream file_;
};

}  // namespace terse
