// A KITTI sequence is read as it lies on disk, and what is wrong with it is named with its file.

#include "terse/frontend/kitti_sequence.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <opencv2/core.hpp>

#include "shared_data.h"
#include "terse/core/error.h"
#include "terse/frontend/png_file.h"
#include "testing_files.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

constexpr int kFrames = 6, kWidth = 60, kHeight = 20;

std::string Name(int index) { return "00000" + std::to_string(index) + ".png"; }

cv::Mat RandomImage(unsigned seed) {
  cv::Mat image(kHeight, kWidth, CV_8U);
  cv::RNG(seed).fill(image, cv::RNG::UNIFORM, 0, 256);
  return image;
}

constexpr char kP0[] = "P0: 7.070912000000e+02 0 6.018873e+02 0 0 7.070912e+02 1.831104e+02 0 0 0 1 0\n";
constexpr char kP1[] = "P1: 7.070912000000e+02 0 6.018873e+02 -3.798145e+02 0 7.070912e+02 1.831104e+02 0 0 0 1 0\n";
constexpr char kColour[] =
    "P2: 7.188560e+02 0 6.071928e+02 4.538225e+01 0 7.188560e+02 1.852157e+02 -1.130887e-01 0 0 1 3.779761e-03\n"
    "P3: 7.188560e+02 0 6.071928e+02 -3.372877e+02 0 7.188560e+02 1.852157e+02 2.369057e+00 0 0 1 4.915215e-03\n";

// A small sequence of noise in a folder of its own, removed afterwards.
class KittiSequenceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    fs::remove_all(root_);
    for (const char* folder : {"image_0", "image_1"}) fs::create_directories(root_ / folder);
    for (int k = 0; k < kFrames; ++k) {
      WriteImage("image_0/" + Name(k), RandomImage(2 * static_cast<unsigned>(k)));
      WriteImage("image_1/" + Name(k), RandomImage(2 * static_cast<unsigned>(k) + 1));
    }
    Write("calib.txt", std::string(kP0) + kP1 + "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n");
    Write("times.txt", "0\n1.036224e-01\n2.1e-01\n0.3\n0.4\n0.5\n");
  }
  void TearDown() override { fs::remove_all(root_); }

  void Write(const std::string& name, const std::string& text) const { std::ofstream(root_ / name) << text; }
  void WriteImage(const std::string& name, const cv::Mat& image) const { WriteGreyPng((root_ / name).string(), image); }
  KittiSequence Open() const { return KittiSequence(root_.string()); }

  void ExpectError(const std::function<void()>& work, const std::string& file, long line, const std::string& cause) {
    try {
      work();
      ADD_FAILURE() << "no error: " << cause;
    } catch (const FileError& error) {
      EXPECT_EQ(error.path(), (file.empty() ? root_ : root_ / file).string()) << error.what();
      EXPECT_EQ(error.line(), line) << error.what();
      EXPECT_NE(error.cause().find(cause), std::string::npos) << error.what();
    }
  }
  void ExpectOpenFails(const std::string& file, long line, const std::string& cause) {
    ExpectError([&] { Open(); }, file, line, cause);
  }

  const fs::path root_ = TestFile("kitti").Path();
};

bool Same(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() && cv::norm(a, b, cv::NORM_INF) == 0;
}

TEST_F(KittiSequenceTest, ReadsGreyPairs) {
  const KittiSequence sequence = Open();
  ASSERT_EQ(sequence.Size(), kFrames);
  EXPECT_EQ(sequence.Pair(), KittiPair::kGrey);
  EXPECT_EQ(sequence.Camera().width, kWidth);
  EXPECT_EQ(sequence.Camera().height, kHeight);
  EXPECT_EQ(sequence.Camera().fx, 707.0912);
  EXPECT_EQ(sequence.Camera().cy, 183.1104);
  EXPECT_NEAR(sequence.Camera().baseline, 379.8145 / 707.0912, 1e-12);
  EXPECT_EQ(sequence.T_camera0_left().Translation(), Vector<3>::Zero());
  for (int k = 0; k < kFrames; ++k) {
    const StereoFrame frame = sequence.Read(k);
    EXPECT_EQ(frame.index, k);
    EXPECT_TRUE(Same(frame.left, RandomImage(2 * static_cast<unsigned>(k))));
    EXPECT_TRUE(Same(frame.right, RandomImage(2 * static_cast<unsigned>(k) + 1)));
  }
  EXPECT_EQ(sequence.Read(1).time, 0.1036224);
  EXPECT_THROW(sequence.Read(-1), std::invalid_argument);
  EXPECT_THROW(sequence.Read(kFrames), std::invalid_argument);
}

// The colour cameras lie a little off camera 0 along all axes, and the third entry counts in the baseline.
TEST_F(KittiSequenceTest, ReadsThePairOfTheColourCameras) {
  fs::remove_all(root_ / "image_0");
  fs::remove_all(root_ / "image_1");
  const cv::Mat left = RandomImage(1), right = RandomImage(2);
  for (const char* folder : {"image_2", "image_3"}) fs::create_directories(root_ / folder);
  WriteImage("image_2/000000.png", left);
  WriteImage("image_3/000000.png", right);
  Write("calib.txt", std::string(kP0) + kP1 + kColour);
  Write("times.txt", "0\n");
  const KittiSequence sequence = Open();
  EXPECT_EQ(sequence.Pair(), KittiPair::kColour);
  const double left_x = (4.538225e+01 - 6.071928e+02 * 3.779761e-03) / 7.188560e+02;
  const double right_x = (-3.372877e+02 - 6.071928e+02 * 4.915215e-03) / 7.188560e+02;
  EXPECT_NEAR(sequence.Camera().baseline, left_x - right_x, 1e-12);
  EXPECT_NEAR(sequence.T_camera0_left().Translation().x(), -left_x, 1e-12);
  EXPECT_NEAR(sequence.T_camera0_left().Translation().z(), -3.779761e-03, 1e-12);
  EXPECT_TRUE(Same(sequence.Read(0).right, right));
}

TEST_F(KittiSequenceTest, WithoutTimesTheyAreNominal) {
  EXPECT_TRUE(Open().HasTimes());
  fs::remove(root_ / "times.txt");
  const KittiSequence sequence = Open();
  EXPECT_FALSE(sequence.HasTimes());
  EXPECT_DOUBLE_EQ(sequence.Read(3).time, 0.3);
}

TEST_F(KittiSequenceTest, FramesReadAheadAreThoseOfRead) {
  const KittiSequence sequence = Open();
  const std::vector<int> back_and_forth = {0, 2, 4, 5, 3, 1};
  for (const bool all : {true, false}) {
    KittiFrames frames = all ? sequence.Frames(0, kFrames) : sequence.Frames(back_and_forth);
    for (int k = 0; k < kFrames; ++k) {
      const StereoFrame expected = sequence.Read(all ? k : back_and_forth[static_cast<std::size_t>(k)]);
      const std::optional<StereoFrame> frame = frames.Next();
      ASSERT_TRUE(frame);
      EXPECT_EQ(frame->index, expected.index);
      EXPECT_EQ(frame->time, expected.time);
      EXPECT_TRUE(Same(frame->left, expected.left) && Same(frame->right, expected.right));
    }
    EXPECT_FALSE(frames.Next());
    EXPECT_FALSE(frames.Next());
  }
  EXPECT_FALSE(sequence.Frames(3, 3).Next());
  EXPECT_THROW(sequence.Frames(0, kFrames + 1), std::invalid_argument);
  EXPECT_THROW(sequence.Frames({0, -1}), std::invalid_argument);
  sequence.Frames(0, kFrames).Next();  // the rest is not taken
}

// An error comes at its frame, not before, and the frames behind it still come.
TEST_F(KittiSequenceTest, ErrorsReadAheadComeAtTheirFrame) {
  Write("image_1/" + Name(2), "nothing");
  const KittiSequence sequence = Open();
  KittiFrames frames = sequence.Frames(0, kFrames);
  EXPECT_EQ(frames.Next()->index, 0);
  EXPECT_EQ(frames.Next()->index, 1);
  ExpectError([&] { frames.Next(); }, "image_1/" + Name(2), 0, "not a PNG image");
  for (int k = 3; k < kFrames; ++k) EXPECT_EQ(frames.Next()->index, k);
  EXPECT_FALSE(frames.Next());
}

TEST_F(KittiSequenceTest, MissingFoldersAreNamed) {
  EXPECT_THROW(KittiSequence((root_ / "nowhere").string()), FileError);
  EXPECT_THROW(KittiSequence((root_ / "calib.txt").string()), FileError);
  fs::remove_all(root_ / "image_1");
  ExpectOpenFails("image_1", 0, "does not exist");
  fs::remove_all(root_ / "image_0");
  ExpectOpenFails("", 0, "neither image_0");
  fs::create_directories(root_ / "image_1");
  ExpectOpenFails("image_0", 0, "does not exist");
  fs::create_directories(root_ / "image_0");
  ExpectOpenFails("image_0", 0, "no PNG");
}

TEST_F(KittiSequenceTest, UnequalCountsAreNamed) {
  fs::remove(root_ / "image_1" / Name(5));
  ExpectOpenFails("image_1/" + Name(5), 0, "6 left, 5 right");
  fs::remove(root_ / "image_0" / Name(1));
  ExpectOpenFails("image_0/" + Name(1), 0, "5 left, 5 right");
  fs::remove(root_ / "image_1" / Name(1));
  fs::remove(root_ / "image_0" / Name(5));
  ExpectOpenFails("times.txt", 0, "6 times for 4 pairs");
}

TEST_F(KittiSequenceTest, BadTimesAreNamed) {
  Write("times.txt", "0\n0.1\nnoon\n");
  ExpectOpenFails("times.txt", 3, "noon");
  Write("times.txt", "0\n0.2\n0.1\n");
  ExpectOpenFails("times.txt", 3, "backwards");
  Write("times.txt", "0 1\n");
  ExpectOpenFails("times.txt", 1, "one time per line");
}

TEST_F(KittiSequenceTest, BadImagesAreNamed) {
  const KittiSequence sequence = Open();
  const auto expect = [&](int index, const std::string& file, const std::string& cause) {
    ExpectError([&] { sequence.Read(index); }, file, 0, cause);
  };
  fs::resize_file(root_ / "image_0" / Name(1), fs::file_size(root_ / "image_0" / Name(1)) / 2);
  expect(1, "image_0/" + Name(1), "cut off");
  Write("image_1/" + Name(2), "");
  expect(2, "image_1/" + Name(2), "not a PNG");
  Write("image_1/" + Name(3), "\x89PNG\r\n\x1a\n all but an image IEND");
  expect(3, "image_1/" + Name(3), "cut off");
  fs::remove(root_ / "image_1" / Name(3));
  expect(3, "image_1/" + Name(3), "does not exist");
  Write("image_1/" + Name(3), "");
  WriteImage("image_1/" + Name(4), RandomImage(1)(cv::Rect(0, 0, kWidth - 1, kHeight)));
  expect(4, "image_1/" + Name(4), "59x20, the first of the sequence 60x20");
  Write("image_0/" + Name(0), "GIF89a");
  ExpectOpenFails("image_0/" + Name(0), 0, "not a PNG");
}

TEST_F(KittiSequenceTest, BadCalibrationsAreNamed) {
  const auto expect = [&](const std::string& text, long line, const std::string& cause) {
    Write("calib.txt", text);
    ExpectOpenFails("calib.txt", line, cause);
  };
  const std::string p0 = kP0, p1 = kP1;
  expect(p1, 0, "no line P0:");
  expect(p0 + kColour, 0, "no line P1:");
  expect(p0 + "P1: 1 2 3\n", 2, "expected 12 numbers");
  expect(p0 + "P1: 707.0912 0 601.8873 x 0 707.0912 183.1104 0 0 0 1 0\n", 2, "x");
  expect(p0 + "P1: 700 0 601.8873 -379.8145 0 700 183.1104 0 0 0 1 0\n", 2, "focal length 700");
  expect(p0 + "P1: 707.0912 0 600 -379.8145 0 707.0912 183.1104 0 0 0 1 0\n", 2, "principal point");
  expect(p0 + "P1: 707.0912 0 601.8873 379.8145 0 707.0912 183.1104 0 0 0 1 0\n", 2, "baseline");
  expect(p0 + "P1: 707.0912 0 601.8873 0 0 707.0912 183.1104 0 0 0 1 0\n", 2, "baseline");
  expect("P0: 707.0912 1 601.8873 0 0 707.0912 183.1104 0 0 0 1 0\n" + p1, 1, "rectified");
  fs::remove(root_ / "calib.txt");
  ExpectOpenFails("calib.txt", 0, "does not exist");
}

TEST_F(KittiSequenceTest, ACalibrationWrittenReadsBack) {
  const StereoCamera camera = {718.856, 710, 607.1928, 185.2157, 0.5371657, 0, 0};
  WriteKittiCalibration(camera, (root_ / "calib.txt").string());
  const StereoCamera read = ReadKittiCalibration((root_ / "calib.txt").string(), KittiPair::kGrey).camera;
  EXPECT_EQ(read.fx, camera.fx);
  EXPECT_EQ(read.fy, camera.fy);
  EXPECT_EQ(read.cx, camera.cx);
  EXPECT_EQ(read.cy, camera.cy);
  EXPECT_NEAR(read.baseline, camera.baseline, 1e-15);
}

TEST(KittiSequence, ReadsThePublicOne) {
  TERSE_NEEDS(path, "kitti/sequences/06");
  const KittiSequence sequence(path);
  EXPECT_EQ(sequence.Size(), 51);
  EXPECT_EQ(sequence.Camera().width, 1226);
  EXPECT_EQ(sequence.Camera().height, 370);
  EXPECT_NEAR(sequence.Camera().baseline, 0.53715, 1e-5);
  EXPECT_DOUBLE_EQ(sequence.Frames(50, 51).Next()->time, 5);
}

}  // namespace
}  // namespace terse
