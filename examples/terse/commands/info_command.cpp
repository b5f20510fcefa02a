#include <filesystem>
#include <iostream>

#include "commands/commands.h"
#include "run/calibration.h"
#include "run/run_statistics.h"
#include "run/standard_output.h"

namespace terse {
namespace {

struct InfoOptions {
  std::string path;
  ReadOptions read;
  bool json = false;
};

template <class Pose>
nlohmann::ordered_json Describe(const PoseGraph<Pose>& graph) {
  long without_value = 0, fixed = 0;
  const EdgeCounts counts = CountEdges(graph);
  for (const auto& pose : graph.Poses()) {
    without_value += !pose.T_world_body;
    fixed += pose.fixed;
  }
  nlohmann::ordered_json json;
  json["dimension"] = Pose::kDim;
  json["poses"] = graph.Poses().size();
  json["edges"] = counts.edges;
  json["loop_edges"] = counts.loop_edges;
  json["duplicates"] = counts.duplicates;
  json["priors"] = static_cast<long>(graph.Factors().size()) - counts.edges;
  json["fixed_poses"] = fixed;
  json["components"] = ConnectedComponents(graph).size();
  json["initial_values"] = without_value == 0;
  json["poses_without_value"] = without_value;
  json["chi2"] = nullptr;
  if (without_value == 0) json["chi2"] = Chi2(graph);
  if (counts.edges > 0 && ConnectedComponents(graph).size() == 1) {
    const InformationCalibration information = CalibrateInformation(graph);
    json["odometry_sigma"] = SigmasInWords(information.stated.odometry);
    json["loops_sigma"] = SigmasInWords(information.stated.loops);
    json["information"] = InformationInWords(information);
    json["information_numbers"] = ToJson(information);
  }
  return json;
}

void PrintTable(const nlohmann::ordered_json& json) {
  for (const auto& [key, value] : json.items()) {
    if (key == "information_numbers") continue;  // the lines above say it
    std::string text = value.is_string() ? value.get<std::string>() : value.dump();
    if (value.is_boolean()) text = value.get<bool>() ? "yes" : "no";
    if (value.is_null()) text = "unknown";
    if (value.is_object()) {
      text.clear();
      for (const auto& [tag, count] : value.items()) text += (text.empty() ? "" : ", ") + tag + " " + count.dump();
      if (text.empty()) text = "none";
    }
    std::string label = key;
    for (char& c : label) c = c == '_' ? ' ' : c;
    std::cout << label << std::string(label.size() < 24 ? 24 - label.size() : 1, ' ') << text << '\n';
  }
  FlushOutput();
}

void Info(const InfoOptions& options) {
  const GraphFile file = ReadGraph(options.path, options.read);
  nlohmann::ordered_json json;
  json["file"] = options.path;
  std::error_code no_size;  // a pipe has none
  const auto bytes = std::filesystem::file_size(options.path, no_size);
  json["file_bytes"] = no_size ? nlohmann::ordered_json() : nlohmann::ordered_json(bytes);
  json["format"] = Name(file.format);
  json.update(std::visit([](const auto& graph) { return Describe(graph); }, file.graph));
  json["repaired_informations"] = file.repaired_informations;
  json["skipped_tags"] = nlohmann::ordered_json::object();
  for (const auto& [tag, count] : file.skipped_tags) json["skipped_tags"][tag] = count;
  options.json ? PrintJson(json) : PrintTable(json);
}

}  // namespace

void AddInfoCommand(CLI::App& app) {
  auto options = std::make_shared<InfoOptions>();
  CLI::App* command = app.add_subcommand("info", "Show what a graph file holds (g2o, TORO or iSAM)");
  command->add_option("FILE", options->path, "The graph file")->required();
  AddReadOptions(*command, options->read);
  command->add_flag("--json", options->json, "Print JSON");
  command->footer(
      "Example: terse generate sphere --poses 400 --output sphere.g2o &&\n"
      "         terse info sphere.g2o --json");
  command->callback([options] { Info(*options); });
}

}  // namespace terse
