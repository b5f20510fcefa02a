// calib.txt and times.txt of a KITTI sequence of three frames, parted by a line "=== times".

#include <opencv2/core.hpp>

#include "fuzzing.h"
#include "terse/frontend/kitti_calibration.h"
#include "terse/frontend/kitti_sequence.h"
#include "terse/frontend/png_file.h"

#include <filesystem>

namespace terse::fuzz {
namespace {

class Sequence {
 public:
  Sequence() {
    for (const char* camera : {"image_0", "image_1"}) {
      std::filesystem::create_directory(folder_.Path(camera));
      for (const char* frame : {"/000000.png", "/000001.png", "/000002.png"}) {
        WriteGreyPng(folder_.Path(camera) + frame, cv::Mat(2, 3, CV_8U, cv::Scalar(7)));
      }
    }
  }
  void Read(std::string_view input) const {
    const std::vector<Part> parts = Parts(input);
    const std::string calibration = folder_.With("calib.txt", parts[0].content);
    const std::string path = folder_.Path("times.txt");
    std::filesystem::remove(path);
    for (const Part& part : parts) {
      if (part.name == "times") folder_.With("times.txt", part.content);
    }
    Done([&] {
      const KittiSequence sequence(folder_.Path());
      for (int k = 0; k < sequence.Size(); ++k) sequence.Time(k);
    });
    Done([&] { ReadKittiCalibration(calibration, KittiPair::kColour); });
    KittiCalibration read;
    if (!Done([&] { read = ReadKittiCalibration(calibration, KittiPair::kGrey); })) return;
    WriteKittiCalibration(read.camera, folder_.Path("again.txt"));
    Done([&] { ReadKittiCalibration(folder_.Path("again.txt"), KittiPair::kGrey); });
  }

 private:
  ScratchFolder folder_;
};

}  // namespace
}  // namespace terse::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static terse::fuzz::Sequence sequence;
  sequence.Read(terse::fuzz::AsText(data, size));
  return 0;
}
