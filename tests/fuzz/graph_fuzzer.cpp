// Graph files of all formats and dimensions, read strictly and with repair; a graph that was read is written and read
// again to an equal one.

#include "fuzzing.h"
#include "terse/core/graph_file.h"

namespace terse::fuzz {
namespace {

bool Equal(const SE2& a, const SE2& b) { return a.Translation() == b.Translation() && Near(a.Theta(), b.Theta()); }
bool Equal(const SE3& a, const SE3& b) {
  return a.Translation() == b.Translation() &&
         (a.Rotation().Unit().coeffs() - b.Rotation().Unit().coeffs()).cwiseAbs().maxCoeff() < 1e-12;
}

template <class Pose>
bool Equal(const Factor<Pose>& a, const Factor<Pose>& b) {
  if (a.index() != b.index()) return false;
  return std::visit(
      [&](const auto& x) {
        const auto& y = std::get<std::decay_t<decltype(x)>>(b);
        if (PosesOf(a).first != PosesOf(b).first || x.information != y.information) return false;
        if constexpr (std::is_same_v<std::decay_t<decltype(x)>, RelativePoseFactor<Pose>>) {
          return x.to == y.to && Equal(x.T_from_to, y.T_from_to);
        } else if constexpr (std::is_same_v<std::decay_t<decltype(x)>, PosePriorFactor<Pose>>) {
          return Equal(x.T_world_body, y.T_world_body);
        } else {
          return x.p_world == y.p_world && x.p_body == y.p_body;
        }
      },
      a);
}

template <class Pose>
void ExpectEqual(const PoseGraph<Pose>& a, const PoseGraph<Pose>& b) {
  Expect(a.Poses().size() == b.Poses().size(), "as many poses");
  Expect(a.Factors().size() == b.Factors().size(), "as many factors");
  for (const auto& pose : a.Poses()) {
    Expect(b.HasPose(pose.id), "the same ids");
    const auto& other = b.Poses()[static_cast<std::size_t>(b.IndexOf(pose.id))];
    Expect(pose.fixed == other.fixed && pose.T_world_body.has_value() == other.T_world_body.has_value(), "same poses");
    if (pose.T_world_body) Expect(Equal(*pose.T_world_body, *other.T_world_body), "the same values");
  }
  auto other = b.Factors().begin();
  for (const auto& node : a.Factors()) Expect(Equal<Pose>(node.factor, (*other).factor), "the same factors"), ++other;
}

void WriteAndReadAgain(const AnyPoseGraph& graph, const ScratchFolder& folder) {
  std::visit(
      [&](const auto& a) {
        using Pose = std::decay_t<decltype(a.Poses().front().T_world_body.value())>;
        const std::string path = folder.Path("again.g2o");
        ReadOptions options;
        options.expect_connected = false;
        if (a.Poses().empty()) return;  // of a file with FIX of landmarks alone; nothing is written
        // A number that is finite as radians may not be as the format has it.
        if (!Done([&] { WriteG2o(a, path); })) return;
        ExpectEqual(a, ReadPoseGraph<Pose>(path, options));
      },
      graph);
}

}  // namespace
}  // namespace terse::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace terse;
  static fuzz::InputFile file;
  static fuzz::ScratchFolder folder;
  const std::string& path = file.With(fuzz::AsText(data, size));
  GraphFile graph;
  if (fuzz::Done([&] { graph = ReadGraph(path); })) {
    // Files cost more than the rest: of long ones and of one in some short ones.
    if ((data[size / 2] ^ size) % 8 == 0) fuzz::WriteAndReadAgain(graph.graph, folder);
    return 0;
  }
  ReadOptions lenient;
  lenient.repair_information = true;
  lenient.expect_connected = false;
  lenient.rotation_information = RotationInformation::kRadians;
  fuzz::Done([&] { ReadGraph(path, lenient); });
  return 0;
}
