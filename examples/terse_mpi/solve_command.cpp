#include "terse_mpi/solve_command.h"

#include <algorithm>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include "commands/commands.h"
#include "commands/output_paths.h"
#include "commands/pose_ids.h"
#include "commands/start.h"
#include "run/progress.h"
#include "run/run_statistics.h"
#include "run/standard_output.h"
#include "terse/compact/json_file.h"
#include "terse/core/initial_values.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/writable.h"
#include "terse/covariance/covariance_table.h"
#include "terse/distributed/chordal_start.h"

namespace terse {
namespace {

struct DistributedSolveOptions {
  std::string path, output, trajectory, stats, ids_text, covariance_output = "-";
  std::vector<PoseId> covariance_ids;
  ReadOptions read;
  InitialValues initial = InitialValues::kAuto;
  bool quiet = false;
};

template <class Pose>
class DistributedSolve {
 public:
  DistributedSolve(const DistributedSolveOptions& options, const PetscSession& session)
      : options_(options), session_(session), rank_(RankOf(ranks_)), is_first_(rank_ == 0) {}

  void Execute() {
    const double start = SecondsNow();
    OnEveryRank(ranks_, [&] { share_ = ReadShare<Pose>(options_.path, rank_, RankCount(ranks_), options_.read); });
    seconds_["read"] = SecondsNow() - start;
    if (is_first_ && !options_.quiet) WarnOfSkipped();
    DistributedOptions solve;
    OnEveryRank(ranks_, [&] { solve.covariances_of = IndicesOf(options_.covariance_ids); });
    const double before = SecondsNow();
    MakeStarts();
    seconds_["start"] = SecondsNow() - before;

    Progress progress("iterations", 0, options_.quiet || !is_first_);
    solve.progress = [&](int iteration, double) { progress.Update(iteration); };
    const DistributedResult<Pose> result = SolveDistributed(ranks_, share_, std::move(starts_), solve);
    DescribeStarts(result);
    progress.Clear();
    if (is_first_ && !options_.quiet) Warn(result);
    OnEveryRank(ranks_, [&] {
      if (is_first_) WriteResults(result);
    });
    seconds_["linearise"] = result.seconds.linearise;
    seconds_["factor"] = result.seconds.factor;
    seconds_["solve"] = result.seconds.solve;
    seconds_["total"] = SecondsNow() - start;
    const nlohmann::ordered_json stats = StatsOf(result);  // of all ranks
    OnEveryRank(ranks_, [&] {
      if (!is_first_) return;
      if (!options_.stats.empty()) WriteJson(stats, options_.stats);
      if (!options_.quiet) PrintSummary(result);
    });
  }

 private:
  void WarnOfSkipped() const {
    GraphFile file;
    file.skipped_tags = share_.skipped_tags;
    ReportRepairs(file, options_.path);
  }

  void Warn(const DistributedResult<Pose>& result) const {
    for (const std::string& name : session_.UnusedOptions()) {
      std::cerr << "terse-mpi: warning: PETSc did not use the option " + name + "\n";
    }
    if (result.Converged()) return;
    std::cerr << std::string("terse-mpi: warning: not converged: ") + Name(result.termination) + "\n";
  }

  // The file's values every rank has, chordal ones all make together, and those two are compared unless one is asked
  // for. Others are made by the first, which holds the whole graph for that.
  void MakeStarts() {
    const bool is_automatic = options_.initial == InitialValues::kAuto;
    const bool has_file_values = std::all_of(share_.T_world_body.begin(), share_.T_world_body.end(),
                                             [](const auto& value) { return value.has_value(); });
    if (options_.initial == InitialValues::kFile || (is_automatic && has_file_values)) {
      AddStart(InitialValues::kFile, FileValues());
    }
    if (options_.initial == InitialValues::kChordal || is_automatic) AddChordal();
    if (starts_.empty()) AddStart(options_.initial, ValuesOfFirstRank());
  }

  void AddStart(InitialValues method, std::vector<Pose> values) {
    methods_.push_back(method);
    starts_.push_back(std::move(values));
  }

  void AddChordal() {
    try {
      AddStart(InitialValues::kChordal, DistributedChordalValues(ranks_, share_));
    } catch (const RankError& error) {
      if (starts_.empty() || error.Cause() != RankError::Kind::kNumerical) throw;
      unavailable_.method = InitialValues::kChordal;
      unavailable_.unavailable = error.what();
    }
  }

  std::vector<Pose> FileValues() const {
    std::vector<Pose> values;
    OnEveryRank(ranks_, [&] {
      for (std::size_t k = 0; k < share_.ids.size(); ++k) {
        if (!share_.T_world_body[k]) {
          throw FileError(options_.path, 0, "pose " + std::to_string(share_.ids[k].value) + " has no value");
        }
        values.push_back(*share_.T_world_body[k]);
      }
    });
    return values;
  }

  std::vector<Pose> ValuesOfFirstRank() const {
    std::vector<Pose> values(share_.ids.size());
    OnEveryRank(ranks_, [&] {
      if (!is_first_) return;
      const auto graph = ReadPoseGraph<Pose>(options_.path, options_.read);
      AddPathToErrors(options_.path, [&] { values = ComputeInitialValues(graph, options_.initial); });
    });
    BroadcastPoses(ranks_, values);
    return values;
  }

  void DescribeStarts(const DistributedResult<Pose>& result) {
    const bool is_automatic = options_.initial == InitialValues::kAuto;
    std::vector<StartTrial> trials;
    for (std::size_t k = 0; k < methods_.size() && is_automatic; ++k) {
      trials.push_back(result.trials[k]);
      trials.back().method = methods_[k];
    }
    if (!unavailable_.unavailable.empty()) trials.push_back(unavailable_);
    DescribeStart(methods_[static_cast<std::size_t>(result.start)], is_automatic, trials, start_);
  }

  std::vector<int> IndicesOf(const std::vector<PoseId>& ids) const {
    std::vector<int> out;
    for (const PoseId id : ids) {
      const auto found = std::find(share_.ids.begin(), share_.ids.end(), id);
      if (found == share_.ids.end()) {
        throw FileError(options_.path, 0, "--covariance-ids: there is no pose " + std::to_string(id.value));
      }
      out.push_back(static_cast<int>(found - share_.ids.begin()));
    }
    return out;
  }

  void WriteResults(const DistributedResult<Pose>& result) const {
    if (!options_.output.empty()) CopyG2o(options_.path, share_, result.T_world_body, options_.output);
    if (!options_.trajectory.empty()) {
      WriteTrajectory(MakeTrajectory(share_.ids, result.T_world_body), options_.trajectory);
    }
    if (!options_.covariance_ids.empty()) {
      WriteCovariances<Pose>(options_.covariance_ids, result.covariances,
                             FileOrStandardOutput(options_.covariance_output));
    }
  }

  nlohmann::ordered_json StatsOf(const DistributedResult<Pose>& result) const {
    nlohmann::ordered_json out = {
        {"poses", share_.ids.size()},
        {"edges", share_.edges},
        {"chi2", result.chi2},
        {"normalized_chi2", share_.scalars > 0 ? result.chi2 / static_cast<double>(share_.scalars) : 0},
        {"iterations", result.iterations},
        {"converged", result.Converged()},
        {"termination", Name(result.termination)}};
    out.update(start_);
    out["seconds"] = seconds_;
    const double mine[] = {static_cast<double>(share_.end - share_.begin), static_cast<double>(share_.relative.size()),
                           PeakRssMegabytes()};
    std::vector<double> all(3 * static_cast<std::size_t>(RankCount(ranks_)));
    MPI_Allgather(mine, 3, MPI_DOUBLE, all.data(), 3, MPI_DOUBLE, ranks_);
    for (std::size_t k = 0; k < all.size(); k += 3) {
      out["ranks"].push_back({{"poses", all[k]}, {"edges", all[k + 1]}, {"peak_rss_mb", all[k + 2]}});
    }
    out["version"] = TERSE_VERSION;
    return out;
  }

  void PrintSummary(const DistributedResult<Pose>& result) const {
    const bool is_taken = !options_.covariance_ids.empty() && options_.covariance_output == "-";
    const int count = RankCount(ranks_);
    std::ostream& out = is_taken ? std::cerr : std::cout;
    out << share_.ids.size() << " poses, " << share_.edges << " edges, " << count << (count == 1 ? " rank" : " ranks")
        << "\nchi2 " << result.chi2 << ", " << Name(result.termination) << " after " << result.iterations
        << (result.iterations == 1 ? " iteration" : " iterations") << ", " << seconds_["total"].template get<double>()
        << " s\n";
    FlushOutput();
  }

  const DistributedSolveOptions& options_;
  const PetscSession& session_;
  const MPI_Comm ranks_ = MPI_COMM_WORLD;
  const int rank_;
  const bool is_first_;
  GraphShare<Pose> share_;
  std::vector<InitialValues> methods_;  // of the starts
  std::vector<std::vector<Pose>> starts_;
  StartTrial unavailable_;  // a start that could not be made
  nlohmann::ordered_json start_ = nlohmann::ordered_json::object(), seconds_;
};

void Solve(const DistributedSolveOptions& options, const PetscSession& session) {
  CheckOutputPaths({{"--output", options.output},
                    {"--trajectory", options.trajectory},
                    {"--covariance-output", options.covariance_ids.empty() ? "" : options.covariance_output},
                    {"--stats", options.stats}},
                   {{"FILE", options.path}});
  const MPI_Comm ranks = MPI_COMM_WORLD;
  OnEveryRank(ranks, [&] {
    if (RankOf(ranks) != 0) return;  // the first writes
    for (const auto& path : {options.output, options.trajectory, options.stats}) RequireWritable(path);
    if (options.covariance_output != "-") RequireWritable(options.covariance_output);
  });
  RequireSameFile(ranks, options.path);
  int dimension = 0;
  OnEveryRank(ranks, [&] { dimension = DimensionOfG2o(options.path); });
  if (dimension == 2) return DistributedSolve<SE2>(options, session).Execute();
  DistributedSolve<SE3>(options, session).Execute();
}

}  // namespace

void AddDistributedSolve(CLI::App& app, const PetscSession& session) {
  auto options = std::make_shared<DistributedSolveOptions>();
  CLI::App* command = app.add_subcommand("solve", "Optimise a pose graph over all ranks");
  command->add_option("FILE", options->path, "The graph file (g2o), under this path on every machine")->required();
  AddChoice(
      *command, "--initial", options->initial, Choices<InitialValues>(),
      "Initial values: auto is the better of file and chordal, found by trying; compose and tree are made by rank 0, "
      "which holds the whole graph for that");
  AddRotationInformationOption(*command, options->read);
  command->add_option("--output", options->output, "Write the solved graph (g2o): FILE with other vertices")
      ->type_name("PATH");
  AddTrajectoryOption(*command, options->trajectory);
  command
      ->add_option("--covariance-ids", options->ids_text,
                   "Marginal covariances (metres, radians) of these poses, by one solve per scalar")
      ->type_name("ID,ID,...");
  command->add_option("--covariance-output", options->covariance_output, "Where they go (CSV)")->type_name("PATH");
  command->add_option("--stats", options->stats, "Write statistics (JSON)")->type_name("PATH");
  command->add_flag("--quiet", options->quiet, "Print nothing but errors");
  command->footer(
      "What begins with a single dash goes to PETSc, with all that follows it:\n"
      "  -mat_mumps_icntl_4 2 (MUMPS says what it does), -log_view (time and bytes sent),\n"
      "  -pc_type gamg (conjugate gradients with algebraic multigrid in place of a factor), -ksp_rtol 1e-10\n"
      "Example: mpirun -n 4 terse-mpi solve city.g2o --output solved.g2o --stats stats.json");
  command->callback([options, &session] {
    if (!options->ids_text.empty()) options->covariance_ids = ParseIds(options->ids_text, "--covariance-ids");
    Solve(*options, session);
  });
}

}  // namespace terse
