// Lines as `terse online` takes them: parsed one by one, gathered to poses, and the compact map made of them. The first
// byte of an input chooses the dimension and the options.

#include <cstdlib>
#include <string>

#include "fuzzing.h"
#include "terse/compact/measurement_stream.h"
#include "terse/core/measurement_line.h"

namespace terse::fuzz {
namespace {

constexpr int kMostLines = 60;  // a long run is for other tests

// A run, and whether it takes a line; one that it refuses changes nothing.
template <class Pose>
class Run {
 public:
  Run(const CompactOptions<Pose>& options, const ReadOptions& read)
      : slam_(options), stream_(slam_), reader_("input", read) {}

  bool Take(std::string_view line, int number) {
    return Done([&] {
      if (line.empty()) {
        stream_.Flush();
      } else if (line == "DISCARD") {
        stream_.Discard();
      } else if (line.substr(0, 7) == "REMOVE ") {
        slam_.RemoveLink({std::atoi(std::string(line.substr(7)).c_str())});
      } else {
        const MeasurementLine<Pose> parsed = reader_.Read(line, number);
        if (const auto* factor = std::get_if<Factor<Pose>>(&parsed)) stream_.Add(*factor);
        if (const auto* vertex = std::get_if<VertexLine<Pose>>(&parsed))
          stream_.SetValue(vertex->id, vertex->T_world_body);
        if (const auto* fix = std::get_if<FixLine>(&parsed)) stream_.Fix(fix->poses);
      }
    });
  }
  std::string Picture() const {
    std::string out = stream_.Open() ? std::to_string(stream_.Open()->value) : "none";
    for (const auto& pose : slam_.Trajectory()) {
      const auto log = pose.T_world_body.Log().eval();
      out += std::to_string(pose.id.value) + (pose.kept ? "kept" : "dropped");
      out.append(reinterpret_cast<const char*>(log.data()), sizeof(double) * Pose::kDof);
    }
    return out;
  }
  const CompactPoseSlam<Pose>& Slam() const { return slam_; }

 private:
  CompactPoseSlam<Pose> slam_;
  MeasurementStream<Pose> stream_;
  MeasurementLineReader<Pose> reader_;
};

template <class Pose>
void Take(std::string_view text, int choice) {
  CompactOptions<Pose> options;
  options.strategy = choice % 2 == 0 ? Strategy::kFpfl : Strategy::kApal;
  options.thresholds.range.setConstant(10);
  if (choice / 2 % 2 != 0) options.solver.robust.kernel = RobustKernel::kHuber;
  ReadOptions read;
  read.repair_information = choice / 4 % 2 != 0;
  Run<Pose> live(options, read), replayed(options, read);
  for (int number = 1; number <= kMostLines && !text.empty(); ++number) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(text.size(), line.size() + 1));
    DimensionOfLine(line);
    if (live.Take(line, number)) Expect(replayed.Take(line, number), "what was taken is taken again");
  }
  Expect(live.Picture() == replayed.Picture(), "what was refused changed nothing");
  Done([&] { live.Slam().Export(); });
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
