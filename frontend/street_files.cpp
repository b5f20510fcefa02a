#include <algorithm>
#include <atomic>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#include "terse/core/atomic_file.h"
#include "terse/core/number_text.h"
#include "terse/core/trajectory.h"
#include "terse/core/writable.h"
#include "terse/frontend/kitti_calibration.h"
#include "terse/frontend/png_file.h"
#include "terse/frontend/street_sequence.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

void MakeImageFolder(const fs::path& folder) {
  RequireFolder(folder.string(), "000000.png");
  std::error_code unreadable;
  if (fs::directory_iterator(folder, unreadable) != fs::directory_iterator()) {
    throw FileError(folder.string(), 0, "the folder is not empty, expected a new or an empty one");
  }
}

void WriteImage(const fs::path& folder, int index, const cv::Mat& image) {
  char name[32];
  std::snprintf(name, sizeof name, "%06d.png", index);
  WriteGreyPng((folder / name).string(), image);
}

// Runs work(k) for k from 0 to count - 1, each once; the first exception ends it.
template <class Work>
void Share(int count, int threads, const Work& work) {
  std::atomic<int> next{0};
  std::exception_ptr error;
  std::mutex mutex;
  const auto run = [&] {
    try {
      for (int k = next++; k < count; k = next++) work(k);
    } catch (...) {
      next = count;
      const std::lock_guard lock(mutex);
      if (!error) error = std::current_exception();
    }
  };
  std::vector<std::thread> others;
  try {
    for (int k = 1; k < threads; ++k) others.emplace_back(run);
  } catch (const std::system_error&) {  // no more threads to be had: those there are do it
  }
  run();
  for (std::thread& thread : others) thread.join();
  if (error) std::rethrow_exception(error);
}

}  // namespace

void WriteStreet(const StreetSequence& sequence, const std::string& directory, int threads,
                 const std::function<void(int)>& progress) {
  if (threads < 1) throw std::invalid_argument("WriteStreet: at least one thread");
  const fs::path root(directory), left = root / "image_0", right = root / "image_1";
  MakeImageFolder(left);
  MakeImageFolder(right);
  const int frames = sequence.Options().frames;
  std::mutex mutex;
  int done = 0;
  Share(frames, threads, [&](int k) {
    const StereoFrame frame = sequence.Render(k);
    WriteImage(left, k, frame.left);
    WriteImage(right, k, frame.right);
    const std::lock_guard lock(mutex);
    ++done;
    if (progress) progress(done);
  });
  WriteKittiCalibration(sequence.Camera(), (root / "calib.txt").string());
  Trajectory truth{TrajectoryFormat::kKitti, {}, {}};
  AtomicFile times((root / "times.txt").string());
  for (int k = 0; k < frames; ++k) {
    truth.stamps.push_back(k);
    truth.T_world_body.push_back(sequence.T_world_camera(k));
    times.Stream() << Shortest(sequence.Time(k)) << '\n';
  }
  times.Commit();
  WriteKitti(truth, (root / "poses.txt").string());
}

}  // namespace terse
