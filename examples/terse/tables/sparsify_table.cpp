#include "tables/sparsify_table.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>

#include "terse/compact/sparsify.h"
#include "terse/compact/words.h"
#include "terse/core/evaluate.h"
#include "terse/core/graph_file.h"

namespace terse {
namespace {

std::vector<SE3> InSpace(const std::vector<SE3>& poses) { return poses; }
std::vector<SE3> InSpace(const std::vector<SE2>& poses) {
  std::vector<SE3> out;
  for (const SE2& pose : poses) out.push_back(Lift(pose));
  return out;
}

template <class Pose>
PoseError ErrorOf(const Sparsified<Pose>& small) {
  EvaluateOptions how;
  how.alignment = Pose::kDim == 2 ? Alignment::kSE2 : Alignment::kSE3;
  how.all_pairs = false;
  return Evaluate(InSpace(small.T_world_body), InSpace(small.T_world_body_whole), how).ate;
}

template <class Pose>
class SparsifyRuns {
 public:
  SparsifyRuns(const PoseGraph<Pose>& graph, const SparsifyTableOptions& options, Progress& progress, long& done,
               SparsifyTableGraph& out)
      : graph_(graph), options_(options), progress_(progress), done_(done), out_(out) {}

  void Run() {
    out_.dimension = Pose::kDim;
    out_.poses = static_cast<int>(graph_.Poses().size());
    for (const double percent : options_.percents) {
      for (const SparsifyCriterion criterion : options_.criteria) AddLinksRow(percent, criterion);
    }
    for (const int sparsity : options_.sparsities) {
      for (const auto recovered : {RecoveredFactors::kTree, RecoveredFactors::kSubgraph, RecoveredFactors::kDense})
        AddPosesRow(sparsity, recovered);
    }
  }

 private:
  Sparsified<Pose> One(const SparsifyOptions& options) {
    const Sparsified<Pose> small = Sparsify(graph_, options);
    out_.links = static_cast<int>(small.links.size());
    out_.expected_error = small.expected_error_whole;
    progress_.Update(++done_);
    return small;
  }
  void AddLinksRow(double percent, SparsifyCriterion criterion) {
    SparsifyOptions options;
    options.links = SparsifyBudget{percent / 100};
    options.criterion = criterion;
    options.threads = options_.threads;
    SparsifyLinksRow row;
    row.percent = percent;
    row.criterion = criterion;
    const int runs = criterion == SparsifyCriterion::kRandom ? options_.draws : 1;
    for (int run = 0; run < runs; ++run) {
      options.seed = static_cast<std::uint64_t>(run + 1);
      const Sparsified<Pose> small = One(options);
      const PoseError error = ErrorOf(small);
      row.links = static_cast<int>(
          std::count_if(small.links.begin(), small.links.end(), [](const auto& link) { return link.kept; }));
      row.ate += error.translation_m / runs;
      row.rotation += error.rotation_deg / runs;
      row.log_det_lost += small.log_det_lost / runs;
      row.expected_error += small.expected_error / runs;
      row.seconds += (small.seconds.optimum + small.seconds.links) / runs;
    }
    out_.link_rows.push_back(row);
  }
  void AddPosesRow(int sparsity, RecoveredFactors recovered) {
    SparsifyOptions options;
    options.poses = SparsifyBudget{1.0 / sparsity};
    options.recovered = recovered;
    options.threads = options_.threads;
    const Sparsified<Pose> small = One(options);
    out_.pose_rows.push_back(
        {sparsity, recovered, static_cast<int>(small.graph.Poses().size()), small.divergence, small.seconds.poses});
  }

  const PoseGraph<Pose>& graph_;
  const SparsifyTableOptions& options_;
  Progress& progress_;
  long& done_;
  SparsifyTableGraph& out_;
};

}  // namespace

long CountRuns(const SparsifyTableOptions& options) {
  long of_percent = 0;
  for (const SparsifyCriterion criterion : options.criteria)
    of_percent += criterion == SparsifyCriterion::kRandom ? options.draws : 1;
  return of_percent * static_cast<long>(options.percents.size()) + 3 * static_cast<long>(options.sparsities.size());
}

SparsifyTableGraph RunSparsifyTable(const GraphPath& graph, const SparsifyTableOptions& options, Progress& progress,
                                    long& done) {
  SparsifyTableGraph out;
  out.is = graph;
  const long done_at_end = done + CountRuns(options);
  try {
    ReadOptions read;
    read.expect_connected = false;
    const GraphFile file = ReadGraph(graph.path, read);
    const auto run = [&](const auto& known) { SparsifyRuns(known, options, progress, done, out).Run(); };
    std::visit(run, file.graph);
  } catch (const std::exception& error) {
    out.failure = error.what();
    progress.Say(graph.name + ": left out, " + out.failure);
  }
  done = done_at_end;
  return out;
}

SparsifySummary Summarise(const std::vector<SparsifyTableGraph>& graphs) {
  SparsifySummary summary;
  double log_ratios = 0;
  for (const SparsifyTableGraph& graph : graphs) {
    std::map<double, std::map<SparsifyCriterion, const SparsifyLinksRow*>> cells;
    for (const SparsifyLinksRow& row : graph.link_rows) {
      if (row.links > 0 && row.links < graph.links) cells[row.percent][row.criterion] = &row;
    }
    for (const auto& [percent, by] : cells) {
      if (by.size() < std::size(Words<SparsifyCriterion>::kAll)) continue;
      const auto ate = [&by = by](SparsifyCriterion criterion) { return by.at(criterion)->ate; };
      const double position = ate(SparsifyCriterion::kPosition);
      const double others = std::min(ate(SparsifyCriterion::kConnectivity), ate(SparsifyCriterion::kRandom));
      const double lost = by.at(SparsifyCriterion::kInformation)->log_det_lost;
      const bool is_least = std::all_of(
          by.begin(), by.end(), [&](const auto& entry) { return lost <= entry.second->log_det_lost * (1 + 1e-9); });
      ++summary.cells;
      summary.position_best += position <= others;
      summary.information_best += is_least;
      log_ratios += std::log(position / others);
    }
  }
  summary.position_ratio = summary.cells > 0 ? std::exp(log_ratios / summary.cells) : 0;
  return summary;
}

}  // namespace terse
