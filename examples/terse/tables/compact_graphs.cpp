#include "tables/compact_graphs.h"

#include <algorithm>
#include <filesystem>

#include "terse/core/error.h"
#include "terse/core/generate.h"
#include "terse/core/graph_file.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

template <class Pose>
NamedGraph<Pose> MakeScene(const CompactGraphName& name, const GenerateOptions& options) {
  NamedGraph<Pose> out{name, {}, {ReferenceKind::kExact, {}}};
  bool is_first = true;
  GenerateSink<Pose> sink;
  sink.pose = [&](PoseId id, const Pose& T_world_body) {
    // The truth is for the comparison: of it only the frame goes in.
    out.graph.AddPose(id, is_first ? std::optional<Pose>(T_world_body) : std::nullopt);
    out.reference.T_world_body.push_back(T_world_body);
    is_first = false;
  };
  sink.edge = [&](const RelativePoseFactor<Pose>& edge) { out.graph.AddFactor(edge); };
  Generate(options, sink);
  return out;
}

}  // namespace

const std::vector<CompactGraphName>& CompactGraphNames() {
  static const std::vector<CompactGraphName> names = {
      {"ellipse", {}, true, {23.5, 2.9, 2.0, {}}},
      {"ellipse-n", {}, true, {{}, {}, {}, 27}},
      {"kitti00_all_loops", {}, false, {7.81, 1.63, 1.02, 33}},
      {"sphere2500", {}, false, {38.4, 16.3, 2.25, {}}},
      {"parking-garage", {}, false, {64.3, 20.9, 3.4, {}}},
      {"w10000_hogman", {"10kHog-man"}, false, {46.8, 7.1, 1.6, {}}},
      {"manhattan100k", {}, true, {}},
  };
  return names;
}

std::string FindGraphFile(const CompactGraphName& name, const std::string& folder) {
  std::error_code error;
  std::vector<std::string> found;
  for (fs::recursive_directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    const std::string stem = it->path().stem().string(), extension = it->path().extension().string();
    const bool is_named = stem == name.name || std::count(name.other_names.begin(), name.other_names.end(), stem) != 0;
    if (is_named && (extension == ".g2o" || extension == ".graph")) found.push_back(it->path().string());
  }
  if (found.empty())
    throw FileError((fs::path(folder) / (name.name + ".g2o")).string(), 0,
                    "no such file, nor below, expected a .g2o or .graph of this name");
  return *std::min_element(found.begin(), found.end());
}

AnyNamedGraph LoadNamedGraph(const CompactGraphName& name, const std::string& folder, int laps) {
  if (name.is_generated) {
    GenerateOptions options;
    options.laps = laps;
    if (name.name == "manhattan100k") {
      options.scene = Scene::kManhattan;
      options.poses = 100000;
      return MakeScene<SE2>(name, options);
    }
    options.scene = name.name == "ellipse" ? Scene::kEllipse : Scene::kEllipseN;
    return MakeScene<SE3>(name, options);
  }
  const std::string path = FindGraphFile(name, folder);
  GraphFile file = ReadGraph(path);
  return std::visit(
      [&](auto& graph) -> AnyNamedGraph {
        using Pose = std::decay_t<decltype(*graph.Poses().front().T_world_body)>;
        Reference<Pose> reference = FindReference(graph, path, folder);
        return NamedGraph<Pose>{name, std::move(graph), std::move(reference)};
      },
      file.graph);
}

}  // namespace terse
