// What may run at the same time: streams and solvers of their own in several threads, each with threads in it, and
// questions to one solver. All of it gives what it gives alone; `make tsan` looks for data races.

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <unistd.h>

#include <filesystem>
#include <functional>
#include <thread>

#include "terse/compact/measurement_stream.h"
#include "terse/core/arrival.h"
#include "terse/core/atomic_file.h"
#include "testing_compact.h"
#include "testing_files.h"
#include "testing_scene.h"

namespace terse {
namespace {

constexpr int kThreads = 4;

// As many where there are fewer processors.
const tbb::global_control kAllowed(tbb::global_control::max_allowed_parallelism, kThreads);

void InThreads(const std::function<void(int)>& work) {
  std::vector<std::thread> threads;
  for (int t = 0; t < kThreads; ++t) threads.emplace_back([&work, t] { work(t); });
  for (std::thread& thread : threads) thread.join();
}

struct StreamEnd {
  std::vector<PoseVerdict> verdicts;
  std::vector<SE2> estimates;
};

// What `terse online` does with its lines.
StreamEnd RunStream(const PoseGraph<SE2>& graph) {
  CompactOptions<SE2> options;
  options.thresholds.range = {5, 5, 3.2};
  options.thresholds.min_loop_gain = options.thresholds.min_pose_gain = 0.5;
  options.solver.threads = 2;
  CompactPoseSlam<SE2> slam(options);
  MeasurementStream<SE2> stream(slam);
  StreamEnd end;
  const auto take = [&](const std::vector<StreamOutcome>& outcomes) {
    for (const StreamOutcome& outcome : outcomes) {
      if (const auto* decision = std::get_if<Decision>(&outcome)) end.verdicts.push_back(decision->verdict);
    }
  };
  stream.SetValue(graph.Poses()[0].id, *graph.Poses()[0].T_world_body);
  for (const ArrivalStep& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
    for (const int k : step.factors) take(stream.Add(graph.Factors()[static_cast<std::size_t>(k)].factor));
  }
  take(stream.Flush());
  end.estimates = slam.Solver().Estimates();
  return end;
}

void ExpectSame(const std::vector<SE2>& a, const std::vector<SE2>& b) {
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t k = 0; k < a.size(); ++k) {
    EXPECT_EQ(a[k].Translation(), b[k].Translation());
    EXPECT_EQ(a[k].Theta(), b[k].Theta());
  }
}

TEST(Concurrency, StreamsBesideEachOther) {
  const PoseGraph<SE2> graph = testing::MakeScene<SE2>(Scene::kManhattan, 150).graph;
  const StreamEnd alone = RunStream(graph);
  std::vector<StreamEnd> ends(kThreads);
  InThreads([&](int t) { ends[static_cast<std::size_t>(t)] = RunStream(graph); });
  for (const StreamEnd& end : ends) {
    EXPECT_EQ(end.verdicts, alone.verdicts);
    ExpectSame(end.estimates, alone.estimates);
  }
}

TEST(Concurrency, OneSolverAskedByMany) {
  const PoseGraph<SE2> graph = testing::MakeScene<SE2>(Scene::kManhattan, 400).graph;
  IncrementalOptions options;
  options.threads = 2;
  IncrementalSolver<SE2> solver(options);
  for (const ArrivalStep& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
    GraphUpdate<SE2> update;
    for (const int pose : step.poses) update.poses.push_back({graph.Poses()[static_cast<std::size_t>(pose)].id});
    for (const int k : step.factors) update.factors.push_back(graph.Factors()[static_cast<std::size_t>(k)].factor);
    solver.Update(update);
  }
  const std::vector<SE2> estimates = solver.Estimates();
  const double chi2 = solver.Chi2();
  InThreads([&](int) {
    ExpectSame(solver.Estimates(), estimates);
    EXPECT_EQ(solver.Chi2(), chi2);
    EXPECT_EQ(solver.Cholesky().System().Gradient().size(), 3 * estimates.size());
  });
}

// The table of files that a signal handler would remove is shared.
TEST(Concurrency, FilesOfManyThreads) {
  const std::string folder = ::testing::TempDir() + "terse_concurrency_" + std::to_string(::getpid());
  std::filesystem::create_directories(folder);
  InThreads([&](int t) {
    for (int k = 0; k < 50; ++k) {
      AtomicFile file(folder + "/file" + std::to_string(t));
      file.Stream() << t << ' ' << k << '\n';
      if (k % 2 == 1) file.Commit();
    }
  });
  long files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    std::ifstream file(entry.path());
    int t = -1, k = -1;
    file >> t >> k;
    EXPECT_EQ(k, 49) << entry.path();
    ++files;
  }
  EXPECT_EQ(files, kThreads);
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace terse
