#include "terse/frontend/kitti_sequence.h"

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <exception>
#include <filesystem>
#include <future>
#include <mutex>
#include <numeric>
#include <thread>

#include "terse/core/text_lines.h"
#include "terse/frontend/png_file.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

constexpr double kNominalRate = 10;  // frames per second, KITTI's

std::string Join(const std::string& directory, const std::string& name) {
  return (fs::path(directory) / name).string();
}

const char* Folder(KittiPair pair, bool right) {
  if (pair == KittiPair::kGrey) return right ? "image_1" : "image_0";
  return right ? "image_3" : "image_2";
}

KittiPair FindPair(const std::string& directory) {
  std::error_code error;
  if (!fs::exists(directory, error))
    throw FileError(directory, 0, "the folder does not exist, expected a KITTI sequence");
  if (!fs::is_directory(directory, error)) throw FileError(directory, 0, "not a folder; a KITTI sequence is one");
  for (const KittiPair pair : {KittiPair::kGrey, KittiPair::kColour}) {
    for (const bool right : {false, true}) {
      if (!fs::is_directory(Join(directory, Folder(pair, right)), error)) continue;
      const std::string other = Join(directory, Folder(pair, !right));
      if (!fs::is_directory(other, error))
        throw FileError(other, 0, "the folder does not exist, expected the other camera's images");
      return pair;
    }
  }
  throw FileError(directory, 0, "holds neither image_0 and image_1 nor image_2 and image_3, expected one pair");
}

std::vector<std::string> ListImages(const std::string& folder) {
  std::vector<std::string> names;
  try {
    for (const auto& entry : fs::directory_iterator(folder)) {
      if (entry.path().extension() == ".png") names.push_back(entry.path().filename().string());
    }
  } catch (const fs::filesystem_error& error) {
    throw FileError(folder, 0, error.code().message());
  }
  if (names.empty()) throw FileError(folder, 0, "holds no PNG images, expected 000000.png and so on");
  std::sort(names.begin(), names.end());
  return names;
}

// Both lists are sorted; the first image without a partner is named.
void CheckPartners(const std::vector<std::string>& left, const std::vector<std::string>& right,
                   const std::string& left_folder, const std::string& right_folder) {
  if (left == right) return;
  const auto [l, r] = std::mismatch(left.begin(), left.end(), right.begin(), right.end());
  const bool missing_right = r == right.end() || (l != left.end() && *l < *r);
  const std::string missing = missing_right ? Join(right_folder, *l) : Join(left_folder, *r);
  throw FileError(missing, 0,
                  "the image does not exist, but the other camera's does (" + std::to_string(left.size()) + " left, " +
                      std::to_string(right.size()) + " right images)");
}

std::vector<double> ReadTimes(const std::string& path, std::size_t images) {
  const TextFile file(path);
  Fields fields(path);
  std::vector<double> times;
  for (const TextLine& line : file.Lines()) {
    fields.Split(line);
    if (fields.Count() != 1) throw fields.Error("expected one time per line, in seconds");
    times.push_back(fields.Number(0, "the time"));
    if (times.size() > 1 && times.back() < times[times.size() - 2])
      throw fields.Error("the time runs backwards, expected ascending times");
  }
  if (times.size() != images) {
    throw FileError(
        path, 0,
        std::to_string(times.size()) + " times for " + std::to_string(images) + " pairs of images, expected as many");
  }
  return times;
}

}  // namespace

KittiSequence::KittiSequence(const std::string& directory) : directory_(directory), pair_(FindPair(directory)) {
  const std::string left = Join(directory, Folder(pair_, false)), right = Join(directory, Folder(pair_, true));
  names_ = ListImages(left);
  CheckPartners(names_, ListImages(right), left, right);
  calibration_ = ReadKittiCalibration(Join(directory, "calib.txt"), pair_);
  const std::string times_path = Join(directory, "times.txt");
  has_times_ = fs::exists(times_path);
  if (has_times_) {
    times_ = ReadTimes(times_path, names_.size());
  } else {
    for (std::size_t k = 0; k < names_.size(); ++k) times_.push_back(static_cast<double>(k) / kNominalRate);
  }
  const cv::Mat first = ReadGreyPng(LeftPath(0));
  calibration_.camera.width = first.cols;
  calibration_.camera.height = first.rows;
}

void KittiSequence::CheckIndex(int index) const {
  if (index >= 0 && index < Size()) return;
  throw std::invalid_argument(directory_ + ": no frame " + std::to_string(index) + "; it has frames 0 to " +
                              std::to_string(Size() - 1));
}

double KittiSequence::Time(int index) const {
  CheckIndex(index);
  return times_[static_cast<std::size_t>(index)];
}

std::string KittiSequence::LeftPath(int index) const {
  CheckIndex(index);
  return (fs::path(directory_) / Folder(pair_, false) / names_[static_cast<std::size_t>(index)]).string();
}

std::string KittiSequence::RightPath(int index) const {
  CheckIndex(index);
  return (fs::path(directory_) / Folder(pair_, true) / names_[static_cast<std::size_t>(index)]).string();
}

cv::Mat KittiSequence::ReadImage(const std::string& path) const {
  cv::Mat image = ReadGreyPng(path);
  const StereoCamera& camera = calibration_.camera;
  if (image.cols == camera.width && image.rows == camera.height) return image;
  throw FileError(path, 0,
                  "the image is " + std::to_string(image.cols) + "x" + std::to_string(image.rows) +
                      ", the first of the sequence " + std::to_string(camera.width) + "x" +
                      std::to_string(camera.height));
}

StereoFrame KittiSequence::Read(int index) const {
  const double time = Time(index);
  auto right = std::async(std::launch::async, [&] { return ReadImage(RightPath(index)); });
  cv::Mat left = ReadImage(LeftPath(index));
  return {index, time, std::move(left), right.get()};
}

KittiFrames KittiSequence::Frames(int begin, int end) const {
  if (begin < 0 || begin > end || end > Size()) {
    throw std::invalid_argument(directory_ + ": no frames " + std::to_string(begin) + ":" + std::to_string(end) +
                                "; it has " + std::to_string(Size()));
  }
  std::vector<int> indices(static_cast<std::size_t>(end - begin));
  std::iota(indices.begin(), indices.end(), begin);
  return Frames(std::move(indices));
}

KittiFrames KittiSequence::Frames(std::vector<int> indices) const {
  for (const int index : indices) CheckIndex(index);
  return KittiFrames(*this, std::move(indices));
}

// A bounded queue between the reading thread and the caller.
class KittiFrames::Reader {
 public:
  Reader(KittiSequence sequence, std::vector<int> indices)
      : sequence_(std::move(sequence)), indices_(std::move(indices)), thread_([this] { Run(); }) {}
  ~Reader() {
    {
      const std::lock_guard lock(mutex_);
      stop_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }

  std::optional<StereoFrame> Next() {
    std::unique_lock lock(mutex_);
    if (taken_ == indices_.size()) return std::nullopt;
    changed_.wait(lock, [&] { return !ready_.empty(); });
    Item item = std::move(ready_.front());
    ready_.pop_front();
    ++taken_;
    lock.unlock();
    changed_.notify_all();
    if (item.error) std::rethrow_exception(item.error);
    return std::move(item.frame);
  }

 private:
  static constexpr std::size_t kMostAhead = 3;
  struct Item {
    StereoFrame frame;
    std::exception_ptr error;
  };

  void Run() {
    for (const int index : indices_) {
      Item item;
      try {
        item.frame = sequence_.Read(index);
      } catch (...) {
        item.error = std::current_exception();
      }
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [&] { return stop_ || ready_.size() < kMostAhead; });
      if (stop_) return;
      ready_.push_back(std::move(item));
      lock.unlock();
      changed_.notify_all();
    }
  }

  const KittiSequence sequence_;
  const std::vector<int> indices_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Item> ready_;
  std::size_t taken_ = 0;
  bool stop_ = false;
  std::thread thread_;  // last: it uses the others
};

KittiFrames::KittiFrames(KittiSequence sequence, std::vector<int> indices)
    : reader_(std::make_unique<Reader>(std::move(sequence), std::move(indices))) {}
KittiFrames::~KittiFrames() = default;
KittiFrames::KittiFrames(KittiFrames&&) noexcept = default;
KittiFrames& KittiFrames::operator=(KittiFrames&&) noexcept = default;

std::optional<StereoFrame> KittiFrames::Next() { return reader_->Next(); }

}  // namespace terse
