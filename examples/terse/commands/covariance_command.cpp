#include <algorithm>
#include <iostream>
#include <set>

#include "commands/commands.h"
#include "commands/convention_options.h"
#include "commands/output_paths.h"
#include "commands/pose_ids.h"
#include "commands/verbose.h"
#include "run/progress.h"
#include "run/run_statistics.h"
#include "terse/core/atomic_file.h"
#include "terse/core/gauge.h"
#include "terse/core/initial_values.h"
#include "terse/core/number_text.h"
#include "terse/core/require_optimum.h"
#include "terse/core/writable.h"
#include "terse/covariance/covariance_table.h"
#include "terse/covariance/marginals.h"

namespace terse {
namespace {

// 72 MB, and three times that as text.
constexpr std::size_t kMaxJointRows = 3000;

struct CovarianceCommandOptions {
  std::string path, ids_text, output = "-";
  std::vector<std::string> relative_texts;
  std::vector<PoseId> ids;       // empty: all
  std::vector<PoseId> relative;  // two or none
  ReadOptions read;
  CovarianceConvention convention;
  bool joint = false, solve = false, json = false, quiet = false;
  LogSink log;
};

// What can be told without the file.
void CheckUsage(const CovarianceCommandOptions& options) {
  if (options.joint && options.ids.empty()) throw CLI::ValidationError("--joint", "needs --ids");
  if (!options.relative.empty()) {
    if (!options.ids.empty()) throw CLI::ValidationError("--relative", "excludes --ids");
    if (options.relative[0] == options.relative[1]) {
      throw CLI::ValidationError("--relative", "needs two distinct poses");
    }
  }
  std::set<PoseId> seen;
  for (const PoseId id : options.ids) {
    if (options.joint && !seen.insert(id).second) {
      throw CLI::ValidationError("--joint", "pose " + std::to_string(id.value) + " is named twice");
    }
  }
}

// Values of the poses, and the factor there.
template <class Pose>
struct Point {
  std::vector<Pose> T_world_body;
  BlockCholesky<Pose::kDof> cholesky;
};

template <class Pose>
Point<Pose> SolvedPoint(const PoseGraph<Pose>& graph, const CovarianceCommandOptions& options) {
  Progress progress("iterations", 0, options.quiet);
  BatchOptions batch;
  batch.log = options.log;
  batch.progress = [&](int iteration, double) {
    progress.Update(iteration);
    return true;
  };
  BatchResult<Pose> result = SolveBatch(graph, batch);
  RequireOptimum(result);
  if (!options.quiet) {
    if (!result.Converged()) std::cerr << "terse: warning: not converged: " << result.message << '\n';
  }
  return {std::move(result.T_world_body), std::move(result.cholesky)};
}

template <class Pose>
Point<Pose> FilePoint(const PoseGraph<Pose>& graph, const CovarianceCommandOptions& options) {
  for (const auto& node : graph.Poses()) {
    if (node.T_world_body) continue;
    throw std::invalid_argument("pose " + std::to_string(node.id.value) +
                                " has no value in the file; --solve computes the values");
  }
  Point<Pose> point{ComputeInitialValues(graph, InitialValues::kFile), {}};
  point.cholesky = CholeskyAt(graph, point.T_world_body);
  // It bounds the squared distance of every pose from the minimum in its own standard deviations.
  const double decrease = point.cholesky.NewtonDecrement();
  if (decrease > 1 && !options.quiet) {
    std::cerr << "terse: warning: " << options.path << ": the values are not at the minimum, chi2 may fall by "
              << decrease << "; --solve optimises first\n";
  }
  return point;
}

// An object with the keys of `head` and the covariance, a row per line.
void WriteObject(const nlohmann::ordered_json& head, const MatrixX& covariance, const std::string& indent,
                 std::ostream& out) {
  RequireFinite(covariance);
  out << indent << "{\n";
  for (const auto& [key, value] : head.items()) out << indent << "  \"" << key << "\": " << value.dump() << ",\n";
  out << indent << "  \"covariance\": [";
  for (Eigen::Index r = 0; r < covariance.rows(); ++r) {
    out << (r > 0 ? ",\n" : "\n") << indent << "    [";
    for (Eigen::Index c = 0; c < covariance.cols(); ++c) {
      out << (c > 0 ? ", " : "") << Shortest(covariance(r, c));
    }
    out << ']';
  }
  out << '\n' << indent << "  ]\n" << indent << '}';
}

void AddConvention(const CovarianceConvention& convention, nlohmann::ordered_json& head) {
  head["frame"] = Name(convention.frame);
  head["order"] = Name(convention.order);
}

template <class Pose>
void WriteRelative(const PoseMarginals<Pose>& marginals, const CovarianceCommandOptions& options, std::ostream& out) {
  const PoseId from = options.relative[0], to = options.relative[1];
  const MatrixX covariance = marginals.Relative(from, to, options.convention);
  if (options.json) {
    nlohmann::ordered_json head = {{"from", from.value}, {"to", to.value}};
    AddConvention(options.convention, head);
    WriteObject(head, covariance, "", out);
    out << '\n';
    return;
  }
  out << "from,to";
  WriteEntryNames(TangentNames<Pose>(options.convention.order), out);
  out << '\n' << from.value << ',' << to.value;
  WriteEntries(covariance, out);
  out << '\n';
}

template <class Pose>
void WriteJoint(const PoseMarginals<Pose>& marginals, const CovarianceCommandOptions& options, std::ostream& out) {
  const MatrixX covariance = marginals.Joint(options.ids, options.convention);
  if (options.json) {
    nlohmann::ordered_json head;
    for (const PoseId id : options.ids) head["ids"].push_back(id.value);
    AddConvention(options.convention, head);
    WriteObject(head, covariance, "", out);
    out << '\n';
    return;
  }
  const std::vector<std::string> names = TangentNames<Pose>(options.convention.order);
  out << "id,component";
  for (const PoseId id : options.ids) {
    for (const std::string& name : names) out << ',' << id.value << '_' << name;
  }
  out << '\n';
  Eigen::Index row = 0;
  for (const PoseId id : options.ids) {
    for (const std::string& name : names) {
      out << id.value << ',' << name;
      WriteEntries(covariance.row(row++), out);
      out << '\n';
    }
  }
}

template <class Pose>
void WriteMarginals(const PoseMarginals<Pose>& marginals, const PoseGraph<Pose>& graph,
                    const CovarianceCommandOptions& options) {
  std::vector<PoseId> ids = options.ids;
  const bool all = ids.empty();
  if (all) {
    for (const auto& node : graph.Poses()) ids.push_back(node.id);
  }
  const auto covariances =
      all ? marginals.AllMarginals(options.convention) : marginals.MarginalsOf(ids, options.convention);
  if (!options.json) {
    WriteCovariances<Pose>(ids, covariances, FileOrStandardOutput(options.output), options.convention.order);
    return;
  }
  AtomicFile file(FileOrStandardOutput(options.output));
  const bool is_list = all || ids.size() > 1;
  if (is_list) file.Stream() << "[\n";
  for (std::size_t k = 0; k < ids.size(); ++k) {
    nlohmann::ordered_json head = {{"ids", {ids[k].value}}};
    AddConvention(options.convention, head);
    if (k > 0) file.Stream() << ",\n";
    WriteObject(head, covariances[k], is_list ? "  " : "", file.Stream());
  }
  file.Stream() << (is_list ? "\n]\n" : "\n");
  file.Commit();
}

template <class Pose>
void WriteCovariance(const PoseGraph<Pose>& graph, const CovarianceCommandOptions& options) {
  for (const auto* ids : {&options.ids, &options.relative}) {
    for (const PoseId id : *ids) graph.IndexOf(id);  // throws if it is unknown
  }
  const std::size_t rows = options.ids.size() * Pose::kDof;
  if (options.joint && rows > kMaxJointRows) {
    throw CLI::ValidationError("--joint", std::to_string(options.ids.size()) + " poses make a matrix of " +
                                              std::to_string(rows) + " rows; at most " +
                                              std::to_string(kMaxJointRows / Pose::kDof) + " poses are possible here");
  }
  Point<Pose> point = options.solve ? SolvedPoint(graph, options) : FilePoint(graph, options);
  // Relative covariances do not depend on it.
  const std::string undetermined = options.relative.empty() ? DescribeUndetermined(graph, point.T_world_body) : "";
  if (!undetermined.empty() && !options.quiet) std::cerr << "terse: warning: " << undetermined << '\n';
  const Marginals<Pose> marginals(graph, std::move(point.T_world_body), std::move(point.cholesky));
  if (!options.joint && options.relative.empty()) {
    WriteMarginals<Pose>(marginals, graph, options);
    return;
  }
  AtomicFile file(FileOrStandardOutput(options.output));
  options.joint ? WriteJoint<Pose>(marginals, options, file.Stream())
                : WriteRelative<Pose>(marginals, options, file.Stream());
  file.Commit();
}

void PrintCovariances(const CovarianceCommandOptions& options) {
  CheckOutputPaths({{"--output", options.output}}, {{"FILE", options.path}});
  if (options.output != "-") RequireWritable(options.output);
  const GraphFile file = ReadGraph(options.path, options.read);
  if (!options.quiet) ReportRepairs(file, options.path);
  AddPathToErrors(options.path,
                  [&] { std::visit([&](const auto& graph) { WriteCovariance(graph, options); }, file.graph); });
}

}  // namespace

void AddCovarianceCommand(CLI::App& app) {
  auto options = std::make_shared<CovarianceCommandOptions>();
  CLI::App* command = app.add_subcommand("covariance", "Covariances of poses, at the values in the file");
  command->add_option("FILE", options->path, "The graph file (g2o, TORO or iSAM)")->required();
  CLI::Option* ids =
      command
          ->add_option("--ids", options->ids_text, "The covariance of each of these poses; without it, of every pose")
          ->type_name("ID,ID,...");
  command->add_flag("--joint", options->joint, "One matrix for all poses of --ids together");
  command->add_option("--relative", options->relative_texts, "The covariance of the pose of B seen from A")
      ->expected(2)
      ->option_text("A B");
  AddConventionOptions(*command, options->convention);
  command->add_flag("--solve", options->solve, "Optimise first, as solve does, instead of taking the file's values");
  AddReadOptions(*command, options->read);
  command->add_flag("--json", options->json, "Write JSON instead of CSV");
  command->add_option("--output", options->output, "Where the covariances go (standard output by default)")
      ->type_name("PATH");
  command->add_flag("--quiet", options->quiet, "Print no warnings");
  AddVerboseOption(*command, options->log);
  command->footer(
      "Example: terse generate ellipse --output ellipse.g2o &&\n"
      "         terse covariance ellipse.g2o --solve --ids 1,5,9 --joint --json");
  command->callback([options, ids] {
    if (ids->count() > 0) options->ids = ParseIds(options->ids_text, "--ids");
    for (const std::string& text : options->relative_texts) options->relative.push_back(ParseId(text, "--relative"));
    CheckUsage(*options);
    PrintCovariances(*options);
  });
}

}  // namespace terse
