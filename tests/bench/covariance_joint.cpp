#include <algorithm>
#include <array>
#include <chrono>

#include "bench_runs.h"
#include "covariance_oracle.h"
#include "terse/core/generate.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse::bench {
namespace {

constexpr std::array<int, 3> kSizes = {2, 10, 50};

// Asks for one joint covariance after each loop closure of the last fifth of the run, so that no query finds warm what
// another one left; the sizes take turns.
template <class Pose>
class JointRun {
 public:
  explicit JointRun(long poses) : poses_(poses) {}

  void Step(const GraphUpdate<Pose>& update) {
    solver_.Update(update);
    const auto& nodes = solver_.Graph().Poses();
    if (update.factors.size() < 2 || 5 * static_cast<long>(nodes.size()) < 4 * poses_) return;
    const std::size_t turn = turn_++ % kSizes.size();
    std::vector<PoseId> ids;
    for (const int i : testing::EvenlySpread(static_cast<int>(nodes.size()), kSizes[turn])) {
      ids.push_back(nodes[static_cast<std::size_t>(i)].id);
    }
    const auto start = std::chrono::steady_clock::now();
    checksum_ += marginals_.Joint(ids)(0, 0);
    seconds_[turn].push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  nlohmann::json Finish() {
    nlohmann::json rows = nlohmann::json::array();
    for (std::size_t k = 0; k < kSizes.size(); ++k) {
      std::vector<double>& s = seconds_[k];
      std::sort(s.begin(), s.end());
      if (s.empty()) continue;
      rows.push_back({{"size", kSizes[k]},
                      {"runs", s.size()},
                      {"median_ms", 1e3 * s[s.size() / 2]},
                      {"worst_ms", 1e3 * s.back()}});
    }
    return {{"poses", solver_.Graph().Poses().size()},
            {"factors", solver_.Graph().Factors().size()},
            {"joint", rows},
            {"checksum", checksum_}};
  }

 private:
  long poses_;
  IncrementalSolver<Pose> solver_;
  IncrementalMarginals<Pose> marginals_{solver_};
  std::array<std::vector<double>, kSizes.size()> seconds_;
  std::size_t turn_ = 0;
  double checksum_ = 0;
};

template <class Pose>
nlohmann::json Run(Scene scene, long poses) {
  JointRun<Pose> run(poses);
  GraphUpdate<Pose> update;
  const auto step = [&] {
    if (!update.poses.empty()) run.Step(update);
    update = {};
  };
  GenerateOptions options;
  options.scene = scene;
  options.poses = poses;
  GenerateSink<Pose> sink;
  sink.pose = [&](PoseId id, const Pose&) {
    step();
    update.poses.push_back({id});
  };
  sink.edge = [&](const RelativePoseFactor<Pose>& edge) { update.factors.push_back(edge); };
  Generate<Pose>(options, sink);
  step();
  return run.Finish();
}

}  // namespace

nlohmann::json RunCovarianceJoint(Scene scene, long poses) {
  return IsPlanar(scene) ? Run<SE2>(scene, poses) : Run<SE3>(scene, poses);
}

}  // namespace terse::bench
