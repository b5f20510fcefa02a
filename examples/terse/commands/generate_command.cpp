#include <array>
#include <charconv>
#include <cmath>
#include <iostream>
#include <memory>
#include <optional>

#include "commands/commands.h"
#include "commands/output_paths.h"
#include "run/progress.h"
#include "run/standard_output.h"
#include "terse/core/atomic_file.h"
#include "terse/core/batch_solver.h"
#include "terse/core/generate.h"
#include "terse/core/generate_robots.h"
#include "terse/core/number_text.h"
#include "terse/core/outliers.h"
#include "terse/core/pose_numbers.h"
#include "terse/core/require_optimum.h"
#include "terse/core/slips.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/trajectory.h"
#include "terse/core/writable.h"

namespace terse {
namespace {

struct GenerateCommandOptions {
  std::string scene, from, output, ground_truth, outliers_list, slips_list;
  GenerateOptions generate;
  int robots = 1;
  ReadOptions read;
  bool quiet = false;
};

// Edges as CSV, if asked for.
class EdgeList {
 public:
  explicit EdgeList(const std::string& path) {
    if (!path.empty()) file_.emplace(path).Stream() << "from,to\n";
  }
  template <class Pose>
  void Add(const RelativePoseFactor<Pose>& edge) {
    if (file_) file_->Stream() << std::to_string(edge.from.value) << ',' << std::to_string(edge.to.value) << '\n';
  }
  void Commit() {
    if (file_) file_->Commit();
  }

 private:
  std::optional<AtomicFile> file_;
};

// Numbers with a space before each.
void Append(std::string& line, std::initializer_list<double> values) {
  for (const double value : values) (line += ' ') += Shortest(value);
}

template <int N>
void AppendUpperTriangle(std::string& line, const Matrix<N, N>& information) {
  for (int i = 0; i < N; ++i) {
    for (int j = i; j < N; ++j) Append(line, {information(i, j)});
  }
}

template <class Pose>
void AppendPose(std::string& line, const Pose& T) {
  for (const double number : internal::NumbersOf(T)) Append(line, {number});
}

std::string VertexText(PoseId id, const SE2& T) {
  std::string line = "VERTEX_SE2 " + std::to_string(id.value);
  AppendPose(line, T);
  return line += '\n';
}
std::string VertexText(PoseId id, const SE3& T) {
  std::string line = "VERTEX_SE3:QUAT " + std::to_string(id.value);
  AppendPose(line, T);
  return line += '\n';
}

template <class Pose>
std::string EdgeText(const RelativePoseFactor<Pose>& edge) {
  std::string line = Pose::kDim == 2 ? "EDGE_SE2 " : "EDGE_SE3:QUAT ";
  line += std::to_string(edge.from.value) + ' ' + std::to_string(edge.to.value);
  AppendPose(line, edge.T_from_to);
  if constexpr (Pose::kDim == 2) {
    AppendUpperTriangle<3>(line, edge.information);
  } else {
    AppendUpperTriangle<6>(line, InformationToFile(edge.information, RotationInformation::kQuaternion));
  }
  return line += '\n';
}

// The dead-reckoned pose after one more measurement, with nine decimals as all that the generator gives out: rounding
// at every step keeps the last bits, in which machines may differ, from adding up.
double Rounded(double value) { return std::round(value * 1e9) / 1e9; }
SE2 Reckon(const SE2& T_world_from, const SE2& T_from_to) {
  const SE2 T = T_world_from * T_from_to;
  return SE2(Rounded(T.Translation().x()), Rounded(T.Translation().y()), Rounded(T.Theta()));
}
SE3 Reckon(const SE3& T_world_from, const SE3& T_from_to) {
  const SE3 T = T_world_from * T_from_to;
  const Quaternion& q = T.Rotation().Unit();
  const Vector<3>& p = T.Translation();
  return SE3(SO3(Quaternion(Rounded(q.w()), Rounded(q.x()), Rounded(q.y()), Rounded(q.z()))),
             Vector<3>(Rounded(p.x()), Rounded(p.y()), Rounded(p.z())));
}

// Writes each pose and edge as it comes. A vertex gets its dead-reckoned value, as the public sets have it.
template <class Pose>
void Stream(const GenerateCommandOptions& options, std::ostream& graph, std::ostream* ground_truth, EdgeList& outliers,
            EdgeList& slips) {
  Progress progress("generate", options.generate.poses, options.quiet);
  Pose T_world_body_reckoned;
  GenerateSink<Pose> sink;
  sink.pose = [&](PoseId id, const Pose& T_world_body_true) {
    if (id.value == 0) {
      T_world_body_reckoned = T_world_body_true;
      graph << VertexText(id, T_world_body_reckoned);
    }
    if (ground_truth != nullptr) {
      std::string line = std::to_string(id.value);
      AppendPose(line, InSpace(T_world_body_true));
      *ground_truth << line << '\n';
    }
    progress.Update(id.value);
  };
  sink.edge = [&](const RelativePoseFactor<Pose>& edge) {
    if (edge.to.value - edge.from.value == 1) {
      T_world_body_reckoned = Reckon(T_world_body_reckoned, edge.T_from_to);
      graph << VertexText(edge.to, T_world_body_reckoned);
    }
    graph << EdgeText(edge);
  };
  sink.wrong_loop = [&](const RelativePoseFactor<Pose>& edge) {
    graph << EdgeText(edge);
    outliers.Add(edge);
  };
  sink.slip = [&](const RelativePoseFactor<Pose>& edge) { slips.Add(edge); };
  Generate(options.generate, sink);
}

void GenerateScene(const GenerateCommandOptions& options) {
  std::optional<AtomicFile> graph, ground_truth;
  if (!options.output.empty()) graph.emplace(options.output);
  if (!options.ground_truth.empty()) ground_truth.emplace(options.ground_truth);
  EdgeList outliers(options.outliers_list), slips(options.slips_list);
  std::ostream& graph_stream = graph ? graph->Stream() : std::cout;
  std::ostream* ground_truth_stream = ground_truth ? &ground_truth->Stream() : nullptr;
  IsPlanar(options.generate.scene) ? Stream<SE2>(options, graph_stream, ground_truth_stream, outliers, slips)
                                   : Stream<SE3>(options, graph_stream, ground_truth_stream, outliers, slips);
  graph ? graph->Commit() : FlushOutput();
  if (ground_truth) ground_truth->Commit();
  outliers.Commit();
  slips.Commit();
}

// robot_1.g2o, ... in their own frames, robot_1.tum, ... in one world, links.txt between them.
void GenerateTeam(const GenerateCommandOptions& options) {
  RobotsOptions team;
  team.robots = options.robots;
  if (options.generate.poses != 0) team.poses = options.generate.poses;
  team.seed = options.generate.seed;
  team.wrong_link_percent = options.generate.wrong_loop_percent;
  team.wrong_link_kind = options.generate.wrong_loop_kind;
  const RobotsData data = GenerateRobots(team);
  RequireFolder(options.output, "links.txt");
  for (std::size_t r = 0; r < data.graphs.size(); ++r) {
    const std::string stem = options.output + "/robot_" + std::to_string(r + 1);
    WriteG2o(data.graphs[r], stem + ".g2o");
    std::vector<PoseId> ids;
    for (const auto& node : data.graphs[r].Poses()) ids.push_back(node.id);
    WriteTum(MakeTrajectory(ids, data.T_world_body_true[r]), stem + ".tum");
  }
  AtomicFile links(options.output + "/links.txt");
  std::optional<AtomicFile> wrong;
  if (!options.outliers_list.empty()) wrong.emplace(options.outliers_list).Stream() << "from_map,from,to_map,to\n";
  for (const RobotLink& link : data.links) {
    const auto end = [](int robot, PoseId id) { return std::to_string(robot + 1) + ':' + std::to_string(id.value); };
    std::string line =
        "EDGE_SE2 " + end(link.from_robot, link.measured.from) + ' ' + end(link.to_robot, link.measured.to);
    AppendPose(line, link.measured.T_from_to);
    AppendUpperTriangle<3>(line, link.measured.information);
    links.Stream() << line << '\n';
    if (wrong && link.is_wrong) {
      wrong->Stream() << link.from_robot + 1 << ',' << link.measured.from.value << ',' << link.to_robot + 1 << ','
                      << link.measured.to.value << '\n';
    }
  }
  links.Commit();
  if (wrong) wrong->Commit();
}

// A file has no truth; its optimum, without the wrong loops, is the best known.
template <class Pose>
std::vector<Pose> Optimum(const PoseGraph<Pose>& graph) {
  BatchResult<Pose> result = SolveBatch(graph);
  RequireOptimum(result);
  return std::move(result.T_world_body);
}

template <class Pose>
void AddToGraph(const PoseGraph<Pose>& graph, const GenerateCommandOptions& options) {
  EdgeList outliers(options.outliers_list), slips(options.slips_list);
  const GenerateOptions& generate = options.generate;
  PoseGraph<Pose> out = graph;
  const auto list = [&](const std::vector<FactorId>& ids, EdgeList& edges) {
    for (const FactorId id : ids) edges.Add(std::get<RelativePoseFactor<Pose>>(out.FindFactor(id)->factor));
  };
  AddPathToErrors(options.from, [&] {
    if (generate.wrong_loop_percent > 0 || generate.slips == 0) {
      auto with =
          AddWrongLoops(graph, Optimum(graph), generate.wrong_loop_percent, generate.seed, generate.wrong_loop_kind);
      out = std::move(with.graph);
      list(with.wrong, outliers);
    }
    if (generate.slips > 0) {
      auto with = AddSlips(out, generate.slips, generate.seed);
      out = std::move(with.graph);
      list(with.slipped, slips);
    }
  });
  WriteG2o(out, options.output.empty() ? "/dev/stdout" : options.output);
  outliers.Commit();
  slips.Commit();
}

// "40x30".
std::optional<std::array<long, 2>> AreaFromText(const std::string& text) {
  std::array<long, 2> sides;
  const char* at = text.data();
  const char* const end = at + text.size();
  for (std::size_t d = 0; d < 2; ++d) {
    const auto [after, error] = std::from_chars(at, end, sides[d]);
    if (error != std::errc() || sides[d] < 1 || sides[d] > 1000000) return std::nullopt;
    at = after;
    if (d == 0 && (at == end || *at++ != 'x')) return std::nullopt;
  }
  return at == end ? std::optional(sides) : std::nullopt;
}

CLI::Option* AddAreaOption(CLI::App& command, std::optional<std::array<long, 2>>& area_m) {
  return command
      .add_option_function<std::string>(
          "--area", [&area_m](const std::string& text) { area_m = AreaFromText(text); },
          "Of manhattan: never leave a rectangle of W by H metres, blocks of 1 m; --poses may be any number")
      ->check([](const std::string& text) {
        return AreaFromText(text) ? "" : "'" + text + "' is no area, expected two numbers of metres such as 40x30";
      })
      ->type_name("WxH");
}

void RunGenerate(GenerateCommandOptions options) {
  CheckOutputPaths({{"--output", options.output},
                    {"--ground-truth", options.ground_truth},
                    {"--outliers-list", options.outliers_list},
                    {"--slips-list", options.slips_list}},
                   {{"--from", options.from}});
  if (options.robots > 1) {
    if (options.scene != "manhattan") throw CLI::ValidationError("--robots", "robots drive in manhattan only");
    if (options.output.empty()) throw CLI::RequiredError("--robots: --output, a folder");
    const OutlierKind kind = options.generate.wrong_loop_kind;
    if (kind != OutlierKind::kRandom && kind != OutlierKind::kGrouped)
      throw CLI::ValidationError("--outlier-kind", "wrong links between robots are random or grouped");
    GenerateTeam(options);
    return;
  }
  if (options.from.empty()) {
    options.generate.scene = SceneFromName(options.scene).value();
    GenerateScene(options);
    return;
  }
  const GraphFile file = ReadGraph(options.from, options.read);
  ReportRepairs(file, options.from);
  std::visit([&](const auto& graph) { AddToGraph(graph, options); }, file.graph);
}

}  // namespace

void AddGenerateCommand(CLI::App& app) {
  auto options = std::make_shared<GenerateCommandOptions>();
  CLI::App* command = app.add_subcommand(
      "generate", "Make a synthetic data set with exact ground truth, or add wrong loops and slips to a graph file");
  CLI::Option* scene =
      command
          ->add_option("SCENE", options->scene,
                       "ellipse (170 poses), ellipse-n (laps of an ellipse), sphere (2500), torus "
                       "(5000), manhattan (2D, 3500) or garage (1661)")
          ->check(OneOf({"ellipse", "ellipse-n", "sphere", "torus", "manhattan", "garage"}, {"stereo"}))
          ->type_name("NAME");
  CLI::Option* poses =
      command->add_option("--poses", options->generate.poses, "Number of poses instead of the scene's own")
          ->check(CLI::Range(2L, 1000000000L).description(""))
          ->type_name("N");
  CLI::Option* area = AddAreaOption(*command, options->generate.area_m);
  CLI::Option* laps = command->add_option("--laps", options->generate.laps, "Laps of ellipse-n")
                          ->check(CLI::Range(1, 1000000).description(""))
                          ->type_name("N")
                          ->capture_default_str();
  CLI::Option* robots =
      command
          ->add_option("--robots", options->robots,
                       "Of manhattan: so many robots in one world, each in a frame of its own; --output is a folder "
                       "for robot_1.g2o, robot_1.tum (the true poses, in one world) and so on, and links.txt between "
                       "them, which --outliers is of then")
          ->check(CLI::Range(2, 1000).description(""))
          ->type_name("N");
  AddSeedOption(*command, options->generate.seed, "Same seed, same data");
  command->add_option("--output", options->output, "The g2o file, instead of standard output; with --robots a folder")
      ->type_name("FILE");
  CLI::Option* ground_truth =
      command->add_option("--ground-truth", options->ground_truth, "The true trajectory, TUM with pose ids for stamps")
          ->type_name("FILE");
  CLI::Option* outliers =
      command
          ->add_option("--outliers", options->generate.wrong_loop_percent,
                       "Add wrong loops, so many per cent of the true ones; all else stays the same")
          ->check(CLI::Range(0.0, 1e9).description(""))
          ->type_name("P");
  AddChoice(
      *command, "--outlier-kind", options->generate.wrong_loop_kind, Choices<OutlierKind>(),
      "Between any two poses, between poses 20 to 50 apart, in runs of 3 to 10 that agree with each other, or with "
      "one place taken for another, 20 times each")
      ->needs(outliers);
  command->add_option("--outliers-list", options->outliers_list, "The wrong loops as CSV: from,to")
      ->needs(outliers)
      ->type_name("FILE");
  CLI::Option* slips =
      command
          ->add_option("--slips", options->generate.slips,
                       "Let so many odometry edges go wrong, turned by 10 to 60 degrees and displaced by up to five "
                       "times their length")
          ->check(CLI::Range(1L, 1000000L).description(""))
          ->type_name("N");
  command->add_option("--slips-list", options->slips_list, "The edges that went wrong as CSV: from,to")
      ->needs(slips)
      ->type_name("FILE");
  CLI::Option* from =
      command
          ->add_option("--from", options->from,
                       "Add the wrong loops and slips to this graph (g2o, TORO or iSAM) instead of a scene; the g2o "
                       "written has its edges in online order")
          ->type_name("FILE");
  for (CLI::Option* of_scenes : {scene, poses, area, laps, ground_truth, robots}) from->excludes(of_scenes);
  for (CLI::Option* of_one : {area, ground_truth, slips}) robots->excludes(of_one);
  AddReadOptions(*command, options->read);
  command->add_flag("--quiet", options->quiet, "No progress line");
  command->footer(
      "Example: terse generate manhattan --poses 1000 --output city.g2o --ground-truth city.tum &&\n"
      "         terse generate --from city.g2o --outliers 10 --outliers-list wrong.csv --output wrong.g2o");
  AddGenerateStereo(*command);
  command->callback([command, options, outliers, slips] {
    if (!command->get_subcommands().empty()) return;  // its own callback did the work
    if (options->scene.empty() && options->from.empty()) throw CLI::RequiredError("SCENE or --from FILE");
    const bool adds = outliers->count() > 0 || slips->count() > 0;
    if (!options->from.empty() && !adds) throw CLI::RequiredError("--from: what to add, --outliers P or --slips N");
    RunGenerate(*options);
  });
}

}  // namespace terse
