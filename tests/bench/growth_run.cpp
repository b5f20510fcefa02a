#include <algorithm>
#include <chrono>
#include <fstream>

#include "bench_runs.h"
#include "terse/core/generate.h"
#include "terse/core/incremental_solver.h"

namespace terse::bench {
namespace {

// Peak resident memory of this process.
double PeakMegabytes() {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    if (word != "VmHWM:") continue;
    double kilobytes = 0;
    status >> kilobytes;
    return kilobytes / 1024;
  }
  return 0;
}

// The times of the steps since the last decade ended.
class Decades {
 public:
  void Add(double seconds) {
    seconds_.push_back(seconds);
    total_ += seconds;
    ++steps_;
    if (steps_ == next_) Close();
  }
  nlohmann::json Finish() {
    if (!seconds_.empty()) Close();
    return rows_;
  }

 private:
  void Close() {
    std::sort(seconds_.begin(), seconds_.end());
    rows_.push_back({{"steps", steps_},
                     {"median_ms", 1e3 * seconds_[seconds_.size() / 2]},
                     {"p99_ms", 1e3 * seconds_[seconds_.size() * 99 / 100]},
                     {"worst_ms", 1e3 * seconds_.back()},
                     {"total_seconds", total_},
                     {"peak_megabytes", PeakMegabytes()}});
    seconds_.clear();
    next_ *= 10;
  }
  std::vector<double> seconds_;
  double total_ = 0;
  long steps_ = 0, next_ = 1000;
  nlohmann::json rows_ = nlohmann::json::array();
};

}  // namespace

nlohmann::json RunGrowth(long poses, long longest_link) {
  IncrementalSolver<SE2> solver;
  Decades decades;
  GraphUpdate<SE2> update;
  double checksum = 0;
  const auto step = [&] {
    if (update.poses.empty()) return;
    const auto start = std::chrono::steady_clock::now();
    solver.Update(update);
    checksum += solver.Estimate(update.poses.back().id).Translation()[0];
    decades.Add(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    update = {};
  };
  GenerateOptions options;
  options.scene = Scene::kManhattan;
  options.poses = poses;
  GenerateSink<SE2> sink;
  sink.pose = [&](PoseId id, const SE2&) {
    step();
    update.poses.push_back({id});
  };
  sink.edge = [&](const RelativePoseFactor<SE2>& edge) {
    if (std::abs(edge.to.value - edge.from.value) <= longest_link) update.factors.push_back(edge);
  };
  Generate<SE2>(options, sink);
  step();
  return {{"poses", poses},
          {"longest_link", longest_link < poses ? std::to_string(longest_link) : "any"},
          {"factors", solver.Graph().Factors().size()},
          {"decades", decades.Finish()},
          {"normalized_chi2", solver.Chi2() / (3.0 * static_cast<double>(solver.Graph().Factors().size()))},
          {"checksum", checksum}};
}

}  // namespace terse::bench
