// thresholds.json; what was read is written and read again to the same numbers.

#include "fuzzing.h"
#include "terse/compact/compact_json.h"
#include "terse/compact/thresholds_file.h"

namespace terse::fuzz {
namespace {

template <class Pose>
void ReadAs(const std::string& path, const ScratchFolder& folder) {
  Thresholds<Pose> read;
  if (!Done([&] { read = ReadThresholds<Pose>(path); })) return;
  const std::string copy = folder.Path("again.json");
  WriteThresholds(read, copy);
  Expect(ThresholdsToJson(read) == ThresholdsToJson(ReadThresholds<Pose>(copy)), "the same thresholds");
}

}  // namespace
}  // namespace terse::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace terse;
  static fuzz::InputFile file;
  static fuzz::ScratchFolder folder;
  const std::string& path = file.With(fuzz::AsText(data, size));
  fuzz::Done([&] { ReadThresholdsDimension(path); });
  fuzz::ReadAs<SE2>(path, folder);
  fuzz::ReadAs<SE3>(path, folder);
  return 0;
}
