// Lines as `terse online` takes them: parsed one by one, gathered to poses, and the compact map made of them. The first
// byte of an input chooses the dimension and the options.

#include "fuzzing.h"
#include "terse/compact/measurement_stream.h"
#include "terse/core/measurement_line.h"

namespace terse::fuzz {
namespace {

constexpr int kMostLines = 60;  // a long run is for other tests

template <class Pose>
void Take(std::string_view text, int choice) {
  CompactOptions<Pose> options;
  options.strategy = choice % 2 == 0 ? Strategy::kFpfl : Strategy::kApal;
  options.range.setConstant(10);
  if (choice / 2 % 2 != 0) options.solver.robust.kernel = RobustKernel::kHuber;
  ReadOptions read;
  read.repair_information = choice / 4 % 2 != 0;
  CompactPoseSlam<Pose> slam(options);
  MeasurementStream<Pose> stream(slam);
  MeasurementLineReader<Pose> reader("input", read);
  for (int number = 1; number <= kMostLines && !text.empty(); ++number) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(text.size(), line.size() + 1));
    DimensionOfLine(line);
    Done([&] {
      if (line.empty()) {
        stream.Flush();
        return;
      }
      const MeasurementLine<Pose> parsed = reader.Read(line, number);
      if (const auto* factor = std::get_if<Factor<Pose>>(&parsed)) stream.Add(*factor);
      if (const auto* vertex = std::get_if<VertexLine<Pose>>(&parsed))
        stream.SetValue(vertex->id, vertex->T_world_body);
      if (const auto* fix = std::get_if<FixLine>(&parsed)) stream.Fix(fix->poses);
    });
  }
  Done([&] { stream.Flush(); });
  Done([&] { slam.Export(); });
}

}  // namespace
}  // namespace terse::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const int choice = data[0] / 2;
  const std::string_view text = terse::fuzz::AsText(data + 1, size - 1);
  if (data[0] % 2 == 0) {
    terse::fuzz::Take<terse::SE2>(text, choice);
  } else {
    terse::fuzz::Take<terse::SE3>(text, choice);
  }
  return 0;
}
