#include "tables/outlier_table.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <exception>
#include <functional>
#include <limits>
#include <mutex>
#include <thread>
#include <variant>

#include "run/run_statistics.h"
#include "tables/text_table.h"
#include "terse/core/graph_file.h"
#include "terse/core/words.h"

namespace terse {
namespace {

using std::size_t;

constexpr double kMostRatio = 1.2, kLeastPrecision = 0.95;  // of a success
constexpr double kInfinity = std::numeric_limits<double>::infinity();

// The mean of the two in the middle, if there are two. Of at least one.
double Median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const size_t n = values.size();
  return n % 2 == 1 ? values[n / 2] : 0.5 * (values[n / 2 - 1] + values[n / 2]);
}
double Worst(const std::vector<double>& values) { return *std::max_element(values.begin(), values.end()); }

template <class Of>
std::vector<double> Each(const std::vector<OutlierRun>& runs, const Of& of) {
  std::vector<double> out;
  for (const OutlierRun& run : runs) out.push_back(run.failure.empty() ? of(run) : kInfinity);
  return out;
}

// Each body(k) once, in this order but for those that run at the same time. Throws what one of them throws, after those
// under way.
void ForEach(int threads, size_t n, const std::function<void(size_t)>& body) {
  std::atomic<size_t> next{0};
  std::exception_ptr thrown;
  std::mutex mutex;
  const auto work = [&] {
    try {
      for (size_t k = next++; k < n; k = next++) body(k);
    } catch (...) {
      next = n;
      const std::lock_guard<std::mutex> lock(mutex);
      thrown = std::current_exception();
    }
  };
  std::vector<std::thread> others;
  for (int t = 1; t < threads && static_cast<size_t>(t) < n; ++t) others.emplace_back(work);
  work();
  for (std::thread& other : others) other.join();
  if (thrown) std::rethrow_exception(thrown);
}

std::string InWords(const OutlierRow& row) {
  std::string text = row.kind ? std::string(WordOf(*row.kind)) + ' ' + Cell(row.percent) + " %" : "clean";
  text += ' ' + row.method + ": ATE " + Cell(row.median_ate) + " m";
  if (row.kind) {
    text += ", worst " + Cell(row.worst_ate) + " m, precision " + FixedCell(row.precision, 3) + ", recall " +
            FixedCell(row.recall, 3) + ", success " + std::to_string(row.successes) + " of " + std::to_string(row.runs);
  }
  if (row.failed > 0) text += ", failed " + std::to_string(row.failed) + " (" + row.failure + ")";
  return text + ", " + FixedCell(row.seconds, 1) + " s";
}

// All runs of one graph.
template <class Pose>
class GraphRuns {
 public:
  GraphRuns(OutlierScene<Pose> scene, const OutlierTableOptions& options, const OutlierRunStore& store,
            Progress& progress, long& done, OutlierGraph& out)
      : scene_(std::move(scene)), options_(options), store_(store), progress_(progress), done_(done), out_(out) {}

  void Run() {
    for (const std::string& method : options_.methods) {
      clean_.emplace_back();
      clean_.back().method = method;
    }
    // Those that the others are judged by come first.
    RunRows(clean_, 1);
    RunRows(PlanRuns(), static_cast<size_t>(options_.seeds));
  }

 private:
  std::vector<OutlierRun> PlanRuns() const {
    std::vector<OutlierRun> out;
    for (const OutlierKind kind : options_.kinds) {
      for (const std::string& method : options_.methods) {
        for (const double percent : options_.percents) {
          if (percent == 0) continue;
          for (int k = 0; k < options_.seeds; ++k) {
            OutlierRun run;
            run.kind = kind;
            run.percent = percent;
            run.seed = options_.first_seed + static_cast<std::uint64_t>(k);
            run.method = method;
            out.push_back(std::move(run));
          }
        }
      }
    }
    return out;
  }

  // Runs of `per_row` each that make a row of the table.
  void RunRows(std::vector<OutlierRun> runs, size_t per_row) {
    const auto row = [&](size_t k) {
      const auto first = runs.begin() + static_cast<std::ptrdiff_t>(k * per_row);
      return std::vector<OutlierRun>(first, first + static_cast<std::ptrdiff_t>(per_row));
    };
    std::vector<size_t> missing(runs.size() / per_row, per_row);
    ForEach(options_.threads, runs.size(), [&](size_t k) {
      OutlierRun run = Find(runs[k]);
      const std::lock_guard<std::mutex> lock(mutex_);
      progress_.Update(++done_);
      if (!run.kind) CleanOf(run.method) = run;
      Judge(CleanOf(run.method), out_.sigma, run);
      runs[k] = std::move(run);
      if (--missing[k / per_row] == 0) progress_.Say(out_.is.name + ' ' + InWords(Summarise(row(k / per_row))));
    });
    for (size_t k = 0; k < missing.size(); ++k) out_.rows.push_back(Summarise(row(k)));
    out_.runs.insert(out_.runs.end(), runs.begin(), runs.end());
  }

  OutlierRun& CleanOf(const std::string& method) {
    return *std::find_if(clean_.begin(), clean_.end(), [&](const OutlierRun& run) { return run.method == method; });
  }

  // Known, or made and stored.
  OutlierRun Find(const OutlierRun& planned) {
    const OutlierRun* known = store_.find ? store_.find(out_, planned) : nullptr;
    if (known != nullptr) return *known;
    OutlierRun run = planned;
    Make(run);
    const std::lock_guard<std::mutex> lock(mutex_);
    if (store_.add) store_.add(out_, run);
    return run;
  }

  // Everything but what Judge adds.
  void Make(OutlierRun& run) const {
    const double start = SecondsNow();
    try {
      // That many of the true ones are so many of all.
      const double of_true = 100 * run.percent / (100 - run.percent);
      const Contaminated<Pose> with =
          run.kind ? scene_.With(of_true, run.seed, *run.kind) : Contaminated<Pose>{0, scene_.graph, {}, 0};
      const OutlierMap map = RunOutlierMethod(OutlierMethodOf(run.method), scene_, with, options_.most_seconds);
      run.loops = map.loops;
      run.ate = map.ate;
      run.seconds = map.seconds;
      // Runs at the same time slow each other down.
      if (options_.threads == 1 && !map.step_seconds.empty()) run.steps = TimesOf(map.step_seconds);
    } catch (const std::exception& error) {
      run.failure = error.what();
      run.seconds = SecondsNow() - start;
    }
  }

  const OutlierScene<Pose> scene_;
  const OutlierTableOptions& options_;
  const OutlierRunStore& store_;
  Progress& progress_;
  long& done_;
  OutlierGraph& out_;
  std::vector<OutlierRun> clean_;  // by method
  std::mutex mutex_;               // of all that is not const
};

// As CalibrateInformation has it, and besides where it is implausible, though it differs from edge to edge, and too
// cautious by a factor of 3: parking-garage's, a radian for links that fit to a milliradian. Nothing would be wrong
// then.
template <class Pose>
InformationScale ScaleOf(const PoseGraph<Pose>& graph) {
  constexpr double kBand = 3;  // of CalibrateInformation for what nobody measured
  const InformationCalibration found = CalibrateInformation(graph);
  if (!found.scale.IsOne() || !found.stated.IsImplausible()) return found.scale;
  bool is_too_cautious = false;
  const InformationEstimate& estimate = found.estimate;
  for (const KindEstimate* kind : {&estimate.odometry, &estimate.loops}) {
    for (const ScaleEstimate* group : {&kind->translation, &kind->rotation})
      is_too_cautious = is_too_cautious || (group->determined && kBand * group->sigma_factor < 1);
  }
  if (!is_too_cautious || !estimate.failure.empty()) return found.scale;
  return {{estimate.odometry.translation.sigma_factor, estimate.odometry.rotation.sigma_factor},
          {estimate.loops.translation.sigma_factor, estimate.loops.rotation.sigma_factor}};
}

template <class Pose>
OutlierScene<Pose> Prepare(const PoseGraph<Pose>& graph, const std::string& folder, OutlierGraph& out) {
  out.dimension = Pose::kDim;
  out.poses = static_cast<int>(graph.Poses().size());
  out.loops = static_cast<int>(LoopFactors(graph).size());
  if (out.loops == 0) throw std::invalid_argument("it has no loops");
  out.scale = ScaleOf(graph);
  OutlierScene<Pose> scene{out.is.name, 0, out.scale.IsOne() ? graph : ScaleInformation(graph, out.scale), {}};
  scene.reference = FindReference(scene.graph, out.is.path, folder);
  out.reference = scene.reference.kind;
  if (out.reference == ReferenceKind::kOptimum) {
    BatchResult<Pose> optimum = BatchOptimum(scene.graph);
    scene.reference.T_world_body = optimum.T_world_body;
    out.sigma = ExpectedErrorOf(scene.graph, std::move(optimum));
  }
  return scene;
}

}  // namespace

StepTimes TimesOf(std::vector<double> step_seconds) {
  std::sort(step_seconds.begin(), step_seconds.end());
  const double n = static_cast<double>(step_seconds.size());
  const double p99 = step_seconds[static_cast<size_t>(std::ceil(0.99 * n)) - 1];
  return {1e3 * Median(step_seconds), 1e3 * p99, 1e3 * step_seconds.back()};
}

void Judge(const OutlierRun& clean, double sigma, OutlierRun& run) {
  if (!run.failure.empty()) return;
  const LoopCounts& loops = run.loops;
  const auto share = [](int part, int whole) { return whole > 0 ? static_cast<double>(part) / whole : 1.0; };
  const bool is_compact = OutlierMethodOf(run.method).mode == OutlierMethod::Mode::kCompact;
  run.precision = share(loops.true_kept, loops.true_kept + loops.wrong_kept);
  run.recall = share(loops.true_kept, is_compact ? clean.loops.true_kept : loops.true_loops);
  run.error = std::hypot(run.ate, sigma);
  const double clean_error = std::hypot(clean.ate, sigma);
  run.ratio.reset();
  if (clean.failure.empty() && clean_error > 0) run.ratio = run.error / clean_error;
  run.success = clean.failure.empty() && run.error <= kMostRatio * clean_error && run.precision > kLeastPrecision;
}

OutlierRow Summarise(const std::vector<OutlierRun>& runs) {
  OutlierRow row;
  row.kind = runs.front().kind;
  row.percent = runs.front().percent;
  row.method = runs.front().method;
  row.runs = static_cast<int>(runs.size());
  std::vector<double> medians, p99s, worst;
  for (const OutlierRun& run : runs) {
    row.failed += run.failure.empty() ? 0 : 1;
    if (row.failure.empty()) row.failure = run.failure;
    row.successes += run.success ? 1 : 0;
    row.precision += run.precision;
    row.recall += run.recall;
    row.seconds += run.seconds;
    if (!run.steps) continue;
    medians.push_back(run.steps->median_ms);
    p99s.push_back(run.steps->p99_ms);
    worst.push_back(run.steps->worst_ms);
  }
  row.precision /= row.runs - row.failed;
  row.recall /= row.runs - row.failed;
  const std::vector<double> ates = Each(runs, [](const OutlierRun& run) { return run.ate; });
  const std::vector<double> ratios = Each(runs, [](const OutlierRun& run) { return run.ratio.value_or(kInfinity); });
  row.median_ate = Median(ates);
  row.worst_ate = Worst(ates);
  row.median_ratio = Median(ratios);
  row.worst_ratio = Worst(ratios);
  if (!medians.empty()) row.steps = StepTimes{Median(medians), Median(p99s), Worst(worst)};
  return row;
}

long CountRuns(const OutlierTableOptions& options) {
  const auto wrong = std::count_if(options.percents.begin(), options.percents.end(), [](double p) { return p > 0; });
  return static_cast<long>(options.methods.size()) *
         (1 + static_cast<long>(options.kinds.size()) * static_cast<long>(wrong) * options.seeds);
}

OutlierGraph RunOutlierTable(const GraphPath& graph, const std::string& folder, const OutlierTableOptions& options,
                             const OutlierRunStore& store, Progress& progress, long& done) {
  OutlierGraph out;
  out.is = graph;
  const long done_at_end = done + CountRuns(options);
  std::variant<std::monostate, OutlierScene<SE2>, OutlierScene<SE3>> scene;
  try {
    const GraphFile file = ReadGraph(graph.path);
    std::visit([&](const auto& read) { scene = Prepare(read, folder, out); }, file.graph);
  } catch (const std::exception& error) {
    out.failure = error.what();
    progress.Say(graph.name + ": left out, " + out.failure);
  }
  if (auto* plane = std::get_if<OutlierScene<SE2>>(&scene))
    GraphRuns<SE2>(std::move(*plane), options, store, progress, done, out).Run();
  if (auto* space = std::get_if<OutlierScene<SE3>>(&scene))
    GraphRuns<SE3>(std::move(*space), options, store, progress, done, out).Run();
  done = done_at_end;
  return out;
}

std::vector<OutlierSummary> SummariseAll(const std::vector<OutlierGraph>& graphs) {
  std::vector<OutlierSummary> out;
  std::vector<std::vector<std::pair<double, std::vector<double>>>> ratios;  // by summary: percent, one per run
  for (const int dimension : {2, 3}) {
    for (const OutlierGraph& graph : graphs) {
      if (graph.dimension != dimension) continue;
      for (const OutlierRun& run : graph.runs) {
        if (!run.kind) continue;
        const auto same = [&](const OutlierSummary& s) {
          return s.dimension == dimension && s.kind == run.kind && s.method == run.method;
        };
        size_t k = static_cast<size_t>(std::find_if(out.begin(), out.end(), same) - out.begin());
        if (k == out.size()) {
          out.emplace_back();
          out[k].dimension = dimension;
          out[k].kind = run.kind;
          out[k].method = run.method;
          ratios.emplace_back();
        }
        out[k].runs_to_half += run.percent <= 50 ? 1 : 0;
        out[k].successes_to_half += run.percent <= 50 && run.success ? 1 : 0;
        out[k].runs_at_90 += run.percent == 90 ? 1 : 0;
        out[k].successes_at_90 += run.percent == 90 && run.success ? 1 : 0;
        auto at = std::find_if(ratios[k].begin(), ratios[k].end(),
                               [&](const auto& entry) { return entry.first == run.percent; });
        if (at == ratios[k].end()) at = ratios[k].insert(at, {run.percent, {}});
        at->second.push_back(run.ratio.value_or(kInfinity));
      }
    }
  }
  for (size_t k = 0; k < out.size(); ++k) {
    std::sort(ratios[k].begin(), ratios[k].end());
    for (const auto& [percent, values] : ratios[k]) out[k].ratios.push_back({percent, Median(values), Worst(values)});
  }
  return out;
}

}  // namespace terse
