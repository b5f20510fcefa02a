// graph.json of a compact run; a map that was read is written and read again to an equal one, and a small one
// continued.

#include "fuzzing.h"
#include "terse/compact/compact_pose_slam.h"
#include "terse/compact/map_file.h"

namespace terse::fuzz {
namespace {

constexpr std::size_t kMostContinued = 12;  // poses: continuing costs what solving costs

template <class Pose>
void Continue(const CompactMap<Pose>& map) {
  if (map.poses.size() > kMostContinued || map.edges.size() > 2 * kMostContinued) return;
  Done([&] {
    CompactOptions<Pose> options;
    options.thresholds.range.setConstant(10);
    CompactPoseSlam<Pose> slam = CompactPoseSlam<Pose>::Restore(map, options);
    slam.Export();
  });
}

std::string Written(const CompactMapFile& file, const std::string& path) {
  std::visit(
      [&](const auto& map) {
        WriteCompactMap(map, file.strategy.value_or(Strategy::kFpfl), path, file.information_scale);
      },
      file.map);
  return Content(path);
}

}  // namespace
}  // namespace terse::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace terse;
  static fuzz::InputFile file;
  static fuzz::ScratchFolder folder;
  CompactMapFile graph;
  const std::string& path = file.With(fuzz::AsText(data, size));
  if (!fuzz::Done([&] { graph = ReadCompactMap(path); })) return 0;
  if ((data[size / 2] ^ size) % 4 == 0) {
    const std::string first = fuzz::Written(graph, folder.Path("again.json"));
    const std::string second = fuzz::Written(ReadCompactMap(folder.Path("again.json")), folder.Path("twice.json"));
    // Rotations are made unit again when they are read, which may change their last bit: the length says enough there.
    const bool is_planar = graph.map.index() == 0;
    fuzz::Expect(is_planar ? first == second : !second.empty(), "the same map");
  }
  std::visit([](const auto& map) { fuzz::Continue(map); }, graph.map);
  return 0;
}
