#pragma once
// The graphs of the tables of compact pose SLAM (Ila et al. 2017), each with what it is compared with.

#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "run/ground_truth.h"

namespace terse {

// As the paper has them for FPFL; absent where it is not known here. Times relative to each other.
struct PaperFigures {
  std::optional<double> poses_percent, links_percent, ate_ratio, time_ratio;
};

struct CompactGraphName {
  std::string name;
  std::vector<std::string> other_names;  // accepted, and looked for among the files
  bool is_generated = false;
  PaperFigures paper;
};
// In the order of the tables.
const std::vector<CompactGraphName>& CompactGraphNames();

template <class Pose>
struct NamedGraph {
  CompactGraphName is;
  PoseGraph<Pose> graph;
  Reference<Pose> reference;  // kOptimum: without poses yet
};
using AnyNamedGraph = std::variant<NamedGraph<SE2>, NamedGraph<SE3>>;

// The file of a graph that is not generated, anywhere under the folder. Throws FileError if there is none.
std::string FindGraphFile(const CompactGraphName& name, const std::string& folder);
// Read or generated. `laps`: of ellipse-n.
AnyNamedGraph LoadNamedGraph(const CompactGraphName& name, const std::string& folder, int laps);

}  // namespace terse
