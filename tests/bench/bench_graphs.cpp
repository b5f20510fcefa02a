#include "bench_graphs.h"

#include <cstdio>

#include "shared_data.h"
#include "testing_scene.h"

namespace terse::bench {

PoseGraph<SE2> GeneratedManhattan(long poses) { return testing::MakeScene<SE2>(Scene::kManhattan, poses).graph; }

std::vector<BenchGraph> BenchGraphs() {
  constexpr auto kQuaternion = RotationInformation::kQuaternion, kRadians = RotationInformation::kRadians;
  // Composed values lead into local minima where the noise is large.
  constexpr auto kCompose = InitialValues::kCompose, kChordal = InitialValues::kChordal;
  struct File {
    const char *name, *path;
    InitialValues start;
    RotationInformation meaning;
  };
  std::vector<BenchGraph> graphs;
  for (const File& file : {File{"parking-garage", "3d/parking-garage.g2o", kCompose, kQuaternion},
                           File{"sphere2500", "3d/sphere2500.g2o", kCompose, kQuaternion},
                           File{"torus3D", "3d/torus3D.g2o", kChordal, kRadians},
                           File{"smallGrid3D", "3d/smallGrid3D.g2o", kChordal, kRadians},
                           File{"kitti00_all_loops", "3d/kitti00_all_loops.g2o", kCompose, kQuaternion},
                           File{"intel", "2d/intel.g2o", kChordal, kQuaternion},
                           File{"manhattan", "2d/manhattan.g2o", kCompose, kQuaternion},
                           File{"city10000", "2d/city10000.g2o", kChordal, kQuaternion},
                           File{"w10000_hogman", "2d/w10000_hogman.graph", kChordal, kQuaternion}}) {
    const auto path = SharedData(std::string("graphs/") + file.path);
    if (!path) {
      std::fprintf(stderr, "%s: left out, ../shared/data/graphs/%s is not there\n", file.name, file.path);
      continue;
    }
    ReadOptions options;
    options.rotation_information = file.meaning;
    graphs.push_back({file.name, file.start, [=] { return ReadGraph(*path, options).graph; }});
  }
  graphs.push_back(
      {"generated sphere 2500", kCompose, [] { return testing::MakeScene<SE3>(Scene::kSphere, 2500).graph; }});
  graphs.push_back({"generated manhattan 10000", kChordal, [] { return GeneratedManhattan(10000); }});
  return graphs;
}

}  // namespace terse::bench
