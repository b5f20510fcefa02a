#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iostream>
#include <optional>

#include "commands/commands.h"
#include "commands/convention_options.h"
#include "commands/output_paths.h"
#include "commands/start.h"
#include "commands/verbose.h"
#include "run/progress.h"
#include "run/run_statistics.h"
#include "run/standard_output.h"
#include "run/step_covariances.h"
#include "terse/compact/json_file.h"
#include "terse/compact/judged_solve.h"
#include "terse/core/atomic_file.h"
#include "terse/core/certificate.h"
#include "terse/core/error.h"
#include "terse/core/gauge.h"
#include "terse/core/initial_values.h"
#include "terse/core/paper_flops.h"
#include "terse/core/replay.h"
#include "terse/core/require_optimum.h"
#include "terse/core/robust.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/writable.h"
#include "terse/covariance/covariance_table.h"
#include "terse/covariance/marginals.h"

namespace terse {
namespace {

enum class Mode { kBatch, kIncremental };
enum class Covariances { kNone, kLast, kDiagonal, kAllSteps };

struct SolveOptions {
  std::string path, output, trajectory, covariance_output, stats, steps;
  ReadOptions read;
  Mode mode = Mode::kBatch;
  InitialValues initial = InitialValues::kAuto;  // the incremental mode composes
  ArrivalUnit every = ArrivalUnit::kPose;
  Covariances covariances = Covariances::kNone;
  CovarianceConvention convention;
  // Of the incremental mode; what is absent is the policy's.
  Policy policy = Policy::kDefault;
  Gate gate = Gate::kNewtonDecrement;
  bool gate_given = false;
  std::optional<double> gate_threshold;
  std::vector<double> step_tolerance;  // metres, radians
  double step_budget_ms = 0;
  bool paper_flops = false;
  RobustOptions robust;
  int threads = 1;
  std::optional<double> factor_memory;  // GiB
  bool certify = false, quiet = false;
  LogSink log;
};

std::string CovarianceTarget(const SolveOptions& options) {
  return options.covariance_output.empty() ? "-" : options.covariance_output;
}

IncrementalOptions StepOptions(const SolveOptions& options) {
  IncrementalOptions out = PolicyOptions(options.policy);
  if (options.gate_given) {
    // The policy's own gate keeps the policy's threshold.
    if (options.gate != out.gate) out.gate_threshold = DefaultThreshold(options.gate);
    out.gate = options.gate;
  }
  if (options.gate_threshold) out.gate_threshold = *options.gate_threshold;
  if (!options.step_tolerance.empty()) {
    const bool offset = out.carry == Carry::kOffset;
    (offset ? out.relinearize_metres : out.step_metres) = options.step_tolerance[0];
    (offset ? out.relinearize_radians : out.step_radians) = options.step_tolerance[1];
  }
  out.budget_seconds = options.step_budget_ms / 1000;
  out.robust = options.robust;
  out.report_cost = !options.steps.empty();
  out.threads = options.threads;
  out.log = options.log;
  return out;
}

template <class Pose>
BatchResult<Pose> JudgeLoops(const PoseGraph<Pose>& graph, BatchResult<Pose> result, const BatchOptions& batch,
                             const SolveOptions& options, Stats& stats) {
  return JudgedAgain<Pose>(graph, std::move(result), batch, [&](const std::string& why) {
    stats.more["judged_again"] = why;
    if (options.quiet) return;
    std::cerr << "terse: note: " << why
              << ", and residuals contradict the information: loops are judged by what residuals show\n";
  });
}

// 0: by default.
std::uint64_t MostFactorBytes(const SolveOptions& options) {
  if (!options.factor_memory) return 0;
  return static_cast<std::uint64_t>(std::clamp(std::ldexp(*options.factor_memory, 30), 1.0, std::ldexp(1.0, 62)));
}

template <class Pose>
BatchResult<Pose> RunBatch(const PoseGraph<Pose>& graph, const SolveOptions& options, Stats& stats) {
  const double start = SecondsNow();
  BatchProgress progress(options.quiet);
  BatchOptions batch;
  batch.threads = options.threads;
  batch.most_factor_bytes = MostFactorBytes(options);
  batch.robust = options.robust;
  batch.log = options.log;
  batch.progress = [&](int iteration, double) {
    progress.FinishStep(iteration);
    return true;
  };
  batch.factor_progress = [&](double share) { progress.UpdateFactor(share); };
  const std::vector<Pose> initial = StartValues(graph, options.initial, batch, stats.more);
  BatchResult<Pose> result = JudgeLoops(graph, SolveBatch(graph, initial, batch), batch, options, stats);
  stats.step_seconds.push_back(SecondsNow() - start);
  return result;
}

// The graph as it would have come in online; then iterated to its optimum.
template <class Pose>
BatchResult<Pose> RunIncremental(const PoseGraph<Pose>& graph, const SolveOptions& options, Stats& stats) {
  internal::PaperFlopsMeter<Pose> meter;
  IncrementalOptions step_options = StepOptions(options);
  if (options.paper_flops) step_options.on_point_work = meter.Sink();
  IncrementalSolver<Pose> solver(step_options);
  meter.Watch(solver);
  std::optional<AtomicFile> steps_file;
  if (!options.steps.empty()) {
    steps_file.emplace(options.steps == "-" ? "/dev/stdout" : options.steps);
    WriteStepsHeader(steps_file->Stream());
  }
  std::optional<StepCovariances<Pose>> covariances;
  if (options.covariances == Covariances::kAllSteps) {
    covariances.emplace(solver, options.convention, FileOrStandardOutput(CovarianceTarget(options)));
  }
  {
    std::optional<Progress> progress;
    Replay<Pose>(graph, {options.every, options.initial == InitialValues::kFile}, solver, [&](const ReplayStep& step) {
      if (!progress) progress.emplace("steps", step.steps, options.quiet);
      stats.step_seconds.push_back(step.report.seconds);
      if (steps_file) {
        const auto& known = solver.Graph();
        const auto& model = meter.OfLastStep();
        WriteStepsRow(step, known.Poses().size(), known.Factors().size(), {model.update, model.solve},
                      steps_file->Stream());
      }
      if (covariances) covariances->Add(step.index + 1);
      progress->Update(step.index + 1);
      return true;
    });
  }
  if (steps_file) steps_file->Commit();
  if (covariances) {
    covariances->Commit();
    stats.seconds_covariance = covariances->Seconds();
    stats.more["covariance_paths"] = covariances->PathCounts();
  }
  stats.more["chi2_before_finish"] = solver.Chi2();
  BatchOptions finish;
  finish.threads = options.threads;
  finish.most_factor_bytes = MostFactorBytes(options);
  BatchResult<Pose> result = solver.Finish(finish);
  stats.more["restarts"] = solver.Restarts();
  OrderAsIn(graph, options.every, solver.Graph(), result);
  finish.robust = options.robust;
  result = JudgeLoops(graph, std::move(result), finish, options, stats);
  for (const auto phase :
       {&PhaseSeconds::order, &PhaseSeconds::linearise, &PhaseSeconds::factor, &PhaseSeconds::solve}) {
    result.seconds.*phase += solver.Seconds().*phase;
  }
  return result;
}

// What the kernel made of the loops.
template <class Pose>
void AddRobustStats(const PoseGraph<Pose>& graph, const BatchResult<Pose>& result, const RobustOptions& robust,
                    Stats& stats) {
  using Json = nlohmann::ordered_json;
  Json rejected = Json::array(), slips = Json::array();
  const std::vector<FactorId> slipped = SlippedOdometry(graph, result.weights);
  std::size_t k = 0;
  for (const auto& node : graph.Factors()) {
    const double weight = result.weights[k];
    const FactorPoses ends = PosesOf(node.factor);
    const Json edge = {{"factor", k}, {"from", ends.first.value}, {"to", ends.second.value}};
    if (std::binary_search(slipped.begin(), slipped.end(), node.id)) {
      slips.push_back(edge);
    } else if (weight < 0.5) {
      rejected.push_back(edge);
      rejected.back()["weight"] = weight;
    }
    ++k;
  }
  stats.more["robust"] = {{"kernel", WordOf(robust.kernel)}, {"width", result.robust_width},
                          {"cost", result.robust_cost},      {"loops", LoopFactors(graph).size()},
                          {"rejected", rejected.size()},     {"loops_rejected", rejected},
                          {"odometry_slips", slips}};
}

// Of what the kernel leaves in.
template <class Pose>
void AddCertificate(const PoseGraph<Pose>& graph, const BatchResult<Pose>& result, const SolveOptions& options,
                    Stats& stats) {
  const double before = SecondsNow();
  CertifyOptions certify;
  certify.threads = options.threads;
  const Certificate found = Certify(WithWeights(graph, result.weights), result.T_world_body, certify);
  stats.more["certificate"] = {{"global", found.is_global},
                               {"gap", found.gap},
                               {"cost", found.cost},
                               {"bound", found.bound},
                               {"smallest_eigenvalue", found.smallest_eigenvalue},
                               {"largest_turn_rad", found.largest_turn_rad},
                               {"largest_shift_m", found.largest_shift_m},
                               {"absolute_measurements_left_out", found.has_absolute},
                               {"seconds", SecondsNow() - before}};
}

std::string CertificateInWords(const nlohmann::ordered_json& found) {
  char line[300];
  if (found["global"].get<bool>()) {
    std::snprintf(line, sizeof line, "certified: the optimum is global (relative gap %.1e)",
                  found["gap"].get<double>());
  } else {
    std::snprintf(line, sizeof line,
                  "not certified: the optimum may be local, or measurements contradict each other too much to tell; "
                  "at most %.3g %% of the cost could be gained",
                  100 * std::min(1.0, found["gap"].get<double>()));
  }
  std::string text = line;
  if (found["absolute_measurements_left_out"].get<bool>()) text += "; absolute measurements have no part in this";
  return text;
}

template <class Pose>
void WriteCovariances(const PoseGraph<Pose>& graph, const BatchResult<Pose>& result, BlockCholesky<Pose::kDof> cholesky,
                      const SolveOptions& options) {
  std::vector<PoseId> ids;
  for (const auto& node : graph.Poses()) ids.push_back(node.id);
  // The factor of an incremental run numbers its variables in order of arrival: factor again in the graph's order.
  const Marginals<Pose> marginals = options.mode == Mode::kBatch
                                        ? Marginals<Pose>(graph, result.T_world_body, std::move(cholesky))
                                        : Marginals<Pose>(WithWeights(graph, result.weights), result.T_world_body);
  const std::string undetermined = DescribeUndetermined(graph, result.T_world_body);
  if (!undetermined.empty() && !options.quiet) std::cerr << "terse: warning: " << undetermined << '\n';
  std::vector<typename Pose::Jacobian> covariances;
  if (options.covariances == Covariances::kLast) {
    ids = {*std::max_element(ids.begin(), ids.end())};
    covariances = {marginals.Marginal(ids.front(), options.convention)};
  } else {
    covariances = marginals.AllMarginals(options.convention);
  }
  WriteCovariances<Pose>(ids, covariances, FileOrStandardOutput(CovarianceTarget(options)), options.convention.order);
}

// Not among the rows of a table on standard output.
void PrintSummary(const Stats& stats, bool output_taken) {
  std::ostream& out = output_taken ? std::cerr : std::cout;
  const bool robust = stats.more.contains("robust");
  out << stats.poses << " poses, " << stats.counts.edges << " edges (" << stats.counts.loop_edges << " loop edges)\n";
  if (robust) {
    const auto& found = stats.more["robust"];
    out << found["rejected"] << " of " << found["loops"] << " loops rejected; cost with "
        << found["kernel"].get<std::string>() << " weights " << found["cost"].get<double>() << '\n';
  }
  if (robust && !stats.more["robust"]["odometry_slips"].empty()) {
    const auto& slips = stats.more["robust"]["odometry_slips"];
    out << "odometry slips, left out: ";
    for (std::size_t k = 0; k < slips.size(); ++k)
      out << (k > 0 ? ", " : "") << slips[k]["from"] << " - " << slips[k]["to"];
    out << '\n';
  }
  out << (robust ? "chi2 without weights, rejected loops included, " : "chi2 ") << stats.chi2 << ", "
      << stats.termination << " after " << stats.iterations << (stats.iterations == 1 ? " iteration" : " iterations")
      << ", " << stats.seconds_total << " s\n";
  if (stats.more.contains("factor_bytes_in_file")) {
    out << "the factor, " << stats.more["factor_bytes_in_file"].get<double>() / (1 << 20)
        << " MiB, was in a file ($TMPDIR or /var/tmp), not in memory\n";
  }
  if (stats.more.contains("certificate")) out << CertificateInWords(stats.more["certificate"]) << '\n';
  FlushOutput();
}

template <class Pose>
void SolveGraph(PoseGraph<Pose> graph, const SolveOptions& options, Stats stats, double start) {
  BatchResult<Pose> result =
      options.mode == Mode::kBatch ? RunBatch(graph, options, stats) : RunIncremental(graph, options, stats);
  RequireOptimum(result);
  stats.poses = graph.Poses().size();
  stats.counts = CountEdges(graph);
  stats.chi2 = result.chi2;
  stats.normalized_chi2 = stats.counts.scalars > 0 ? result.chi2 / static_cast<double>(stats.counts.scalars) : 0;
  stats.log_determinant = result.log_determinant;
  stats.iterations = result.iterations;
  stats.converged = result.Converged();
  stats.termination = Name(result.termination);
  stats.phases = result.seconds;
  const std::uint64_t in_file = result.cholesky.BytesInFile();
  if (in_file > 0) stats.more["factor_bytes_in_file"] = in_file;
  if (!result.weights.empty()) AddRobustStats(graph, result, options.robust, stats);
  if (options.covariances == Covariances::kLast || options.covariances == Covariances::kDiagonal) {
    const double before = SecondsNow();
    WriteCovariances(graph, result, std::move(result.cholesky), options);
    stats.seconds_covariance = SecondsNow() - before;
  }
  if (options.certify) AddCertificate(graph, result, options, stats);
  graph.SetPoses(result.T_world_body);
  std::vector<PoseId> ids;
  for (const auto& node : graph.Poses()) ids.push_back(node.id);
  if (!options.output.empty()) WriteG2o(graph, options.output, options.read.rotation_information);
  if (!options.trajectory.empty()) WriteTrajectory(MakeTrajectory(ids, result.T_world_body), options.trajectory);
  stats.seconds_total = SecondsNow() - start;
  if (!options.stats.empty()) WriteJson(ToJson(stats), options.stats);
  if (!options.quiet) {
    PrintSummary(stats, options.covariances != Covariances::kNone && options.covariance_output.empty());
  }
  if (!stats.converged && !options.quiet) std::cerr << "terse: warning: not converged: " << result.message << '\n';
  // Good starts take about ten iterations.
  if (options.mode == Mode::kBatch && options.robust.kernel == RobustKernel::kNone &&
      options.initial != InitialValues::kAuto && stats.iterations > 30 && !options.quiet) {
    std::cerr << "terse: warning: so many iterations often end in a local minimum; compare with --initial auto\n";
  }
}

void Solve(const SolveOptions& options) {
  CheckOutputPaths({{"--output", options.output},
                    {"--trajectory", options.trajectory},
                    {"--covariance-output", options.covariance_output},
                    {"--stats", options.stats},
                    {"--steps", options.steps}},
                   {{"FILE", options.path}});
  for (const auto& path :
       {options.output, options.trajectory, options.covariance_output, options.stats, options.steps}) {
    RequireWritable(path);
  }
  const double start = SecondsNow();
  GraphFile file = ReadGraph(options.path, options.read);
  Stats stats;
  stats.threads = options.threads;
  stats.seconds_read = SecondsNow() - start;
  if (!options.quiet) ReportRepairs(file, options.path);
  AddPathToErrors(options.path, [&] {
    std::visit([&](auto& graph) { SolveGraph(std::move(graph), options, std::move(stats), start); }, file.graph);
  });
}

// CLI11's own checks let NaN and infinity pass.
std::string FindSizeDefect(const std::string& text) {
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  return *end == 0 && !text.empty() && std::isfinite(value) && value >= 0 ? "" : text + " is not a number from 0 up";
}
std::string FindPositiveDefect(const std::string& text) {
  return FindSizeDefect(text).empty() && std::strtod(text.c_str(), nullptr) > 0 ? ""
                                                                                : text + " is not a number above 0";
}
std::string FindNumberDefect(const std::string& text) {
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  return *end == 0 && !text.empty() && std::isfinite(value) ? "" : text + " is not a finite number";
}

// Options that only the incremental mode has.
std::vector<CLI::Option*> AddStepOptions(CLI::App& command, SolveOptions& options) {
  std::vector<CLI::Option*> out;
  out.push_back(
      AddChoice(command, "--policy", options.policy, Choices<Policy>(),
                "How much is re-optimised after each step: this program's way, or one of Arablouei's variants"));
  out.push_back(
      AddChoice(command, "--gate", options.gate, Choices<Gate>(),
                "What has to exceed the gate's threshold for a step to be optimised (the policy's by default)"));
  out.push_back(command
                    .add_option("--gate-threshold", options.gate_threshold,
                                "In the gate's unit: share of chi2, nats, nats, poses between the ends of an edge")
                    ->check(FindNumberDefect)
                    ->type_name("X"));
  out.push_back(command
                    .add_option("--step-tolerance", options.step_tolerance,
                                "Steps below both move nothing (default policy: relinearise nothing)")
                    ->expected(2)
                    ->check(FindSizeDefect)
                    ->type_name("METRES RADIANS"));
  out.push_back(command
                    .add_option("--step-budget-ms", options.step_budget_ms,
                                "Time for a step; what does not fit is left to later steps; 0: no limit, the default")
                    ->check(FindSizeDefect)
                    ->type_name("MS"));
  out.push_back(command.add_option("--steps", options.steps, "Write a row per step (CSV)")->type_name("PATH"));
  out.push_back(command.add_flag("--paper-flops", options.paper_flops,
                                 "Fill in Arablouei's work model in --steps, for his variants (slow)"));
  return out;
}

// What can be told without the file; fills in what follows from other options.
void CheckUsage(SolveOptions& options, const std::vector<CLI::Option*>& step_options,
                const std::vector<CLI::Option*>& convention_options) {
  for (const CLI::Option* option : step_options) {
    if (option->count() > 0 && options.mode == Mode::kBatch) {
      throw CLI::ValidationError(option->get_name(), "needs --mode incremental");
    }
  }
  options.gate_given = step_options[1]->count() > 0;
  if (options.paper_flops && (options.policy == Policy::kDefault || options.steps.empty())) {
    throw CLI::ValidationError("--paper-flops", "needs --steps and a --policy other than default");
  }
  const bool relaxed = options.initial == InitialValues::kTree || options.initial == InitialValues::kChordal;
  if (options.mode == Mode::kIncremental && relaxed) {
    throw CLI::ValidationError("--initial", "the incremental mode takes compose or file");
  }
  if (!options.covariance_output.empty() && options.covariances == Covariances::kNone) {
    options.covariances = Covariances::kDiagonal;
  }
  if (options.covariances == Covariances::kAllSteps && options.mode == Mode::kBatch) {
    throw CLI::ValidationError("--covariances", "all-steps needs --mode incremental");
  }
  for (const CLI::Option* option : convention_options) {
    if (option->count() > 0 && options.covariances == Covariances::kNone) {
      throw CLI::ValidationError(option->get_name(), "needs --covariances");
    }
  }
  if (options.steps == "-" && options.covariances != Covariances::kNone && CovarianceTarget(options) == "-") {
    throw CLI::ValidationError("--steps", "standard output takes one table: --covariance-output needs a path");
  }
}

}  // namespace

void AddSolveCommand(CLI::App& app) {
  auto options = std::make_shared<SolveOptions>();
  CLI::App* command = app.add_subcommand("solve", "Optimise a pose graph");
  command->add_option("FILE", options->path, "The graph file (g2o, TORO or iSAM)")->required();
  AddChoice(*command, "--mode", options->mode, {{"batch", Mode::kBatch}, {"incremental", Mode::kIncremental}},
            "All at once, or pose by pose as it would have come in online");
  AddChoice(*command, "--initial", options->initial, Choices<InitialValues>(),
            "Initial values: composed in order of arrival, the file's, along a spanning tree, or by chordal relaxation "
            "(for much noise); auto: the best of composed, file and chordal after a few steps, with --robust composed. "
            "The incremental mode takes compose (which auto is there) or file");
  AddChoice(*command, "--every", options->every, Choices<ArrivalUnit>(),
            "What a step of the incremental mode brings: a pose with all its edges, or a single edge");
  const std::vector<CLI::Option*> step_options = AddStepOptions(*command, *options);
  AddRobustOptions(*command, options->robust);
  AddReadOptions(*command, options->read);
  command->add_option("--output", options->output, "Write the solved graph (g2o)")->type_name("PATH");
  AddTrajectoryOption(*command, options->trajectory);
  AddChoice(*command, "--covariances", options->covariances,
            {{"none", Covariances::kNone},
             {"last", Covariances::kLast},
             {"diagonal", Covariances::kDiagonal},
             {"all-steps", Covariances::kAllSteps}},
            "Marginal covariances (metres, radians): of the last pose, of every pose, or of the newest pose at every "
            "step of the incremental mode");
  const std::vector<CLI::Option*> convention_options = AddConventionOptions(*command, options->convention);
  command
      ->add_option("--covariance-output", options->covariance_output,
                   "Where the covariances go (CSV; standard output by default); alone it means diagonal")
      ->type_name("PATH");
  command->add_flag("--certify", options->certify,
                    "Say whether the optimum is global: a dual certificate of the chordal relaxation, with its gap");
  command->add_option("--stats", options->stats, "Write statistics (JSON)")->type_name("PATH");
  command->add_option("--threads", options->threads, "Upper limit of threads; the result does not depend on it")
      ->check(CLI::PositiveNumber.description(""))
      ->type_name("N");
  command
      ->add_option("--factor-memory", options->factor_memory,
                   "The factor goes to a file in $TMPDIR, or else /var/tmp, if it takes more than so many GiB (by "
                   "default more than half of the memory that is free)")
      ->check(FindPositiveDefect)
      ->type_name("GIB");
  command->add_flag("--quiet", options->quiet, "Print nothing but errors");
  AddVerboseOption(*command, options->log);
  command->footer(
      "Example: terse generate sphere --poses 400 --output sphere.g2o &&\n"
      "         terse solve sphere.g2o --output solved.g2o --stats stats.json");
  command->callback([options, step_options, convention_options] {
    CheckUsage(*options, step_options, convention_options);
    Solve(*options);
  });
}

}  // namespace terse
