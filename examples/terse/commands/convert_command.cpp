#include <algorithm>
#include <filesystem>
#include <fstream>
#include <string_view>

#include "commands/commands.h"
#include "commands/output_paths.h"
#include "run/run_statistics.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/trajectory.h"
#include "terse/covariance/packing.h"

namespace terse {
namespace {

struct ConvertOptions {
  std::string input, output;
  std::optional<double> precision;
  ReadOptions read;
};

// TUM and KITTI files start with a number, graph files with a tag.
bool LooksLikeTrajectory(const std::string& path) {
  if (!std::filesystem::is_regular_file(path)) return false;  // a pipe can be read only once
  std::ifstream file(path);
  bool in_comment = false;
  for (char c = 0; file.get(c);) {  // by characters: a line may be of any length
    in_comment = c != '\n' && (in_comment || c == '#');
    if (in_comment || std::string_view(" \t\r\n").find(c) != std::string_view::npos) continue;
    return std::string_view("+-.0123456789").find(c) != std::string_view::npos;
  }
  return false;
}

template <class Pose>
Trajectory TrajectoryOf(const PoseGraph<Pose>& graph, const std::string& path) {
  std::vector<std::pair<PoseId, SE3>> values;
  for (const auto& pose : graph.Poses()) {
    try {
      RequireStampId(pose.id);
    } catch (const std::invalid_argument& error) {
      throw FileError(path, 0, error.what());
    }
    if (!pose.T_world_body)
      throw FileError(
          path, 0,
          "pose " + std::to_string(pose.id.value) + " has no value, expected a vertex line; solve writes them");
    if constexpr (Pose::kDim == 2) {
      values.emplace_back(pose.id, Lift(*pose.T_world_body));
    } else {
      values.emplace_back(pose.id, *pose.T_world_body);
    }
  }
  std::sort(values.begin(), values.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  Trajectory trajectory;
  trajectory.format = TrajectoryFormat::kGraph;
  for (const auto& [id, T_world_body] : values) {
    trajectory.stamps.push_back(static_cast<double>(id.value));
    trajectory.T_world_body.push_back(T_world_body);
  }
  return trajectory;
}

void Convert(const ConvertOptions& options) {
  CheckOutputPaths({{"OUT", options.output}}, {{"IN", options.input}});
  const std::string extension = std::filesystem::path(options.output).extension().string();
  const bool to_tum = extension == ".tum", to_kitti = extension == ".kitti" || extension == ".txt";
  if (!to_tum && !to_kitti && extension != ".g2o" && extension != ".graph" && extension != ".packed") {
    throw std::invalid_argument(options.output +
                                ": the extension must be .g2o, .graph (TORO), .packed, .tum, .kitti or .txt (KITTI)");
  }
  if (options.precision && extension != ".packed") {
    throw std::invalid_argument("--precision is for a .packed graph, OUT is " + options.output);
  }
  const bool from_trajectory = LooksLikeTrajectory(options.input);
  if (to_tum || to_kitti) {
    const auto values = [&](const auto& graph) { return TrajectoryOf(graph, options.input); };
    ReadOptions read = options.read;
    read.expect_connected = false;  // vertices alone are a trajectory
    const Trajectory trajectory =
        from_trajectory ? ReadTrajectory(options.input) : std::visit(values, ReadGraph(options.input, read).graph);
    to_tum ? WriteTum(trajectory, options.output) : WriteKitti(trajectory, options.output);
    return;
  }
  if (from_trajectory)
    throw FileError(options.input, 0, "a trajectory has no edges to make a graph of, expected a graph");
  const GraphFile file = ReadGraph(options.input, options.read);
  std::visit(
      [&](const auto& graph) {
        if (extension == ".g2o") WriteG2o(graph, options.output);
        if (extension == ".graph") WriteToro(graph, options.output);
        if (extension == ".packed")
          WritePacked(graph, options.output,
                      ChoosePacking(graph, options.precision.value_or(PackedPrecision().translation)));
      },
      file.graph);
}

}  // namespace

void AddConvertCommand(CLI::App& app) {
  auto options = std::make_shared<ConvertOptions>();
  CLI::App* command = app.add_subcommand("convert", "Convert a graph file to another format, or to its trajectory");
  command->add_option("IN", options->input, "g2o, TORO, iSAM or packed graph; or a TUM or KITTI trajectory")
      ->required();
  command
      ->add_option(
          "OUT", options->output,
          "Format by extension: .g2o, .graph (TORO), .packed (a twentieth of a .g2o, for sending), .tum, .kitti "
          "or .txt (KITTI trajectory). The rotation information in a .g2o is written as g2o defines it")
      ->required();
  command
      ->add_option("--precision", options->precision,
                   "Of a packed graph: to what share of their standard deviations measurements are kept; of those that "
                   "residuals show, where these are smaller than stated. Poses that are not fixed have no values there")
      ->check(CLI::Range(1e-6, 1.0));
  AddReadOptions(*command, options->read);
  command->footer(
      "Example: terse generate sphere --poses 400 --output sphere.g2o &&\n"
      "         terse convert sphere.g2o sphere.tum");
  command->callback([options] { Convert(*options); });
}

}  // namespace terse
