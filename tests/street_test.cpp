// The rendered street: what the images show is where camera model and ground truth say, to a few hundredths of a pixel;
// the same seed gives the same bytes; the drive is one that a tracker can follow.

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "terse/core/error.h"
#include "terse/core/trajectory.h"
#include "terse/frontend/kitti_sequence.h"
#include "terse/frontend/street_sequence.h"
#include "testing_files.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

StreetOptions Options(int width, int height) {
  StreetOptions options;
  options.width = width;
  options.height = height;
  return options;
}

double DegreesBetween(const SE3& a, const SE3& b) { return (a.Inverse() * b).Angle() * 180 / M_PI; }

TEST(Street, TheDriveIsSmoothAndCloses) {
  for (const double metres_per_frame : {0.6, 1.0, 1.2}) {
    for (const int frames : {400, 1000}) {
      StreetOptions options = Options(64, 20);
      options.frames = frames;
      options.metres_per_frame = metres_per_frame;
      const StreetSequence sequence(options);
      EXPECT_LT(sequence.T_world_camera(0).Log().norm(), 1e-12);
      double degrees = 0;
      for (int k = 1; k < frames; ++k) {
        const SE3 T_a_b = sequence.T_world_camera(k - 1).Inverse() * sequence.T_world_camera(k);
        EXPECT_LT(T_a_b.Angle() * 180 / M_PI, 2.5) << "frame " << k;
        EXPECT_NEAR(T_a_b.Translation().norm(), metres_per_frame, 0.08 * metres_per_frame) << "frame " << k;
        EXPECT_GT(T_a_b.Translation().z(), 0.99 * T_a_b.Translation().norm()) << "forward, frame " << k;
        degrees = std::max(degrees, T_a_b.Angle() * 180 / M_PI);
      }
      EXPECT_GT(degrees, 2) << "corners";
      const SE3 T_end = sequence.T_world_camera(frames - 1);
      EXPECT_LT(T_end.Translation().norm(), 3 * metres_per_frame);
    }
  }
}

// Each frame of the second lap is near one of the first, but none is the same.
TEST(Street, TheSecondLapIsAlmostTheFirst) {
  const StreetSequence sequence(Options(64, 20));
  double largest = 0, sum = 0;
  for (int k = 200; k < 400; ++k) {
    double nearest = 1e9;
    for (int i = 0; i < 200; ++i) {
      const SE3 a = sequence.T_world_camera(i), b = sequence.T_world_camera(k);
      const double distance = (a.Translation() - b.Translation()).norm();
      if (distance < nearest) {
        nearest = distance;
        largest = std::max(largest, DegreesBetween(a, b) - 2.5);
      }
    }
    EXPECT_LT(nearest, 1.2) << "frame " << k;
    sum += nearest;
  }
  EXPECT_GT(sum / 200, 0.1);
}

// The shift (pixels, along u and v) that would make `moved` fit `fixed` best, where the pixel p of `fixed` should be at
// at(p) of `moved`. Pixels that are hidden in the other image, or lie on the edge of something, are left out.
cv::Vec2d Misfit(const cv::Mat1f& fixed, const cv::Mat1f& moved, const cv::Mat1f& depth, const cv::Mat2f& at) {
  cv::Mat1f warped, gradient_u, gradient_v, nearest, farthest;
  cv::remap(moved, warped, at, {}, cv::INTER_CUBIC, cv::BORDER_CONSTANT, cv::Scalar(-1000));
  cv::Sobel(fixed, gradient_u, CV_32F, 1, 0, 3, 1.0 / 8);
  cv::Sobel(fixed, gradient_v, CV_32F, 0, 1, 3, 1.0 / 8);
  const cv::Mat around = cv::Mat::ones(7, 7, CV_8U);
  cv::erode(depth, nearest, around);
  cv::dilate(depth, farthest, around);
  cv::Matx22d H = cv::Matx22d::zeros();
  cv::Vec2d b(0, 0);
  int used = 0;
  for (int row = 4; row < fixed.rows - 4; ++row) {
    for (int column = 4; column < fixed.cols - 4; ++column) {
      const double error = warped(row, column) - fixed(row, column);
      const bool smooth = nearest(row, column) > 0 && farthest(row, column) < 1.1f * nearest(row, column);
      if (!smooth || farthest(row, column) > 30 || std::abs(error) > 20) continue;
      const cv::Vec2d g(gradient_u(row, column), gradient_v(row, column));
      H += g * g.t();
      b += error * g;
      ++used;
    }
  }
  EXPECT_GT(used, fixed.rows * fixed.cols / 6) << "too little to compare";
  return H.inv() * b;
}

TEST(Street, DisparitiesAreThoseOfTheCalibrationPlusTheOffset) {
  StreetOptions options = Options(408, 124);
  for (const double offset : {0.0, 0.3}) {
    options.disparity_offset = offset;
    const StreetSequence sequence(options);
    const StereoCamera& camera = sequence.Camera();
    for (const int k : {10, 95}) {
      const StereoFrame frame = sequence.RenderClean(k);
      const cv::Mat1f depth = sequence.RenderDepth(k);
      cv::Mat2f at(depth.size());
      for (int row = 0; row < depth.rows; ++row) {
        for (int column = 0; column < depth.cols; ++column) {
          const double disparity = camera.fx * camera.baseline / depth(row, column) + offset;
          at(row, column) = {static_cast<float>(column - disparity), static_cast<float>(row)};
        }
      }
      const cv::Vec2d shift = Misfit(frame.left, frame.right, depth, at);
      EXPECT_LT(cv::norm(shift), 0.05) << "frame " << k << ", offset " << offset << ": " << cv::Mat(shift).t();
    }
  }
}

// The same points of the street in two frames of one lap, and one lap apart.
TEST(Street, TheGroundTruthIsThatOfTheImages) {
  const StreetSequence sequence(Options(408, 124));
  const StereoCamera& camera = sequence.Camera();
  for (const auto& [a, b] : {std::pair(30, 31), std::pair(90, 92), std::pair(140, 340)}) {
    const cv::Mat1f depth = sequence.RenderDepth(a);
    const SE3 T_b_a = sequence.T_world_camera(b).Inverse() * sequence.T_world_camera(a);
    cv::Mat2f at(depth.size());
    for (int row = 0; row < depth.rows; ++row) {
      for (int column = 0; column < depth.cols; ++column) {
        const double z = depth(row, column);
        const Vector<3> p = {(column - camera.cx) / camera.fx * z, (row - camera.cy) / camera.fy * z, z};
        const Vector<3> uvu = camera.Project(T_b_a * p);
        at(row, column) = {static_cast<float>(uvu.x()), static_cast<float>(uvu.y())};
      }
    }
    const cv::Vec2d shift = Misfit(sequence.RenderClean(a).left, sequence.RenderClean(b).left, depth, at);
    EXPECT_LT(cv::norm(shift), 0.08) << "frames " << a << ", " << b << ": " << cv::Mat(shift).t();
  }
}

TEST(Street, NoiseAndExposureAreAsAsked) {
  StreetOptions options = Options(204, 62);
  options.exposure = 0;
  const StreetSequence steady(options);
  for (const int k : {3, 60}) {
    cv::Mat noisy;
    steady.Render(k).left.convertTo(noisy, CV_32F);
    cv::Scalar mean, deviation;
    cv::meanStdDev(noisy - steady.RenderClean(k).left, mean, deviation);
    EXPECT_NEAR(mean[0], 0, 0.2);
    EXPECT_NEAR(deviation[0], options.noise, 0.2);
  }
  options.exposure = 0.25;
  options.noise = 0;
  const StreetSequence rolling(options);
  double low = 10, high = 0;
  for (int k = 0; k < options.frames; k += 25) {
    const double gain = cv::mean(rolling.Render(k).left)[0] / cv::mean(rolling.RenderClean(k).left)[0];
    low = std::min(low, gain);
    high = std::max(high, gain);
  }
  EXPECT_GT(high - low, 0.2);
}

std::string Bytes(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

class StreetFilesTest : public ::testing::Test {
 protected:
  void TearDown() override { fs::remove_all(root_); }
  std::string Folder(const std::string& name) const { return (root_ / name).string(); }
  static StreetOptions OneLap() {
    StreetOptions options = Options(48, 16);
    options.frames = StreetSequence::LeastFramesPerLap(options.metres_per_frame);
    options.laps = 1;
    return options;
  }
  const fs::path root_ = TestFile("street").Path();
};

TEST_F(StreetFilesTest, SameSeedSameBytesWhateverTheThreads) {
  const StreetOptions options = OneLap();
  WriteStreet(StreetSequence(options), Folder("one"), 1);
  int last = 0;
  WriteStreet(StreetSequence(options), Folder("three"), 3, [&](int done) { EXPECT_EQ(done, ++last); });
  EXPECT_EQ(last, options.frames);
  int files = 0;
  for (const auto& entry : fs::recursive_directory_iterator(root_ / "one")) {
    if (!entry.is_regular_file()) continue;
    const fs::path name = fs::relative(entry.path(), root_ / "one");
    EXPECT_EQ(Bytes(entry.path()), Bytes(root_ / "three" / name)) << name;
    ++files;
  }
  EXPECT_EQ(files, 2 * options.frames + 3);
}

TEST(Street, AnotherSeedIsAnotherStreet) {
  StreetOptions options = Options(64, 20);
  options.noise = 0;
  const cv::Mat first = StreetSequence(options).Render(0).left;
  options.seed = 2;
  EXPECT_GT(cv::norm(first, StreetSequence(options).Render(0).left, cv::NORM_L1),
            2.0 * static_cast<double>(first.total()));
}

TEST_F(StreetFilesTest, WhatIsWrittenReadsBack) {
  const StreetSequence sequence(OneLap());
  WriteStreet(sequence, Folder("a"), 2);
  const KittiSequence read(Folder("a"));
  const StereoCamera &a = sequence.Camera(), &b = read.Camera();
  EXPECT_EQ(a.fx, b.fx);
  EXPECT_EQ(a.cx, b.cx);
  EXPECT_EQ(a.cy, b.cy);
  EXPECT_NEAR(a.baseline, b.baseline, 1e-12);
  EXPECT_EQ(a.width, b.width);
  EXPECT_EQ(a.height, b.height);
  const Trajectory truth = ReadTrajectory(Folder("a") + "/poses.txt");
  ASSERT_EQ(read.Size(), sequence.Options().frames);
  ASSERT_EQ(truth.T_world_body.size(), static_cast<std::size_t>(read.Size()));
  for (int k = 0; k < read.Size(); k += 30) {
    const StereoFrame expected = sequence.Render(k), frame = read.Read(k);
    EXPECT_EQ(cv::norm(frame.left, expected.left, cv::NORM_INF), 0);
    EXPECT_EQ(cv::norm(frame.right, expected.right, cv::NORM_INF), 0);
    EXPECT_EQ(frame.time, expected.time);
    const SE3& T = truth.T_world_body[static_cast<std::size_t>(k)];
    EXPECT_LT((T.Inverse() * sequence.T_world_camera(k)).Log().norm(), 1e-8);
  }
}

TEST_F(StreetFilesTest, AFolderWithImagesIsLeftAlone) {
  const StreetSequence sequence(OneLap());
  fs::create_directories(root_ / "image_1");
  std::ofstream(root_ / "image_1" / "000000.png") << "mine";
  EXPECT_THROW(WriteStreet(sequence, root_.string(), 1), FileError);
  EXPECT_EQ(Bytes(root_ / "image_1" / "000000.png"), "mine");
  std::ofstream(root_ / "file") << "mine";
  EXPECT_THROW(WriteStreet(sequence, (root_ / "file").string(), 1), FileError);
  EXPECT_THROW(WriteStreet(sequence, (root_ / "new").string(), 0), std::invalid_argument);
}

TEST(Street, OptionsThatMakeNoSenseAreMisuse) {
  const auto expect = [](const auto& change) {
    StreetOptions options = Options(64, 20);
    change(options);
    EXPECT_THROW(StreetSequence{options}, std::invalid_argument);
  };
  expect([](StreetOptions& o) { o.frames = 100; });
  expect([](StreetOptions& o) { o.laps = 3; });
  expect([](StreetOptions& o) { o.laps = 0; });
  expect([](StreetOptions& o) { o.width = 8; });
  expect([](StreetOptions& o) { o.noise = -1; });
  expect([](StreetOptions& o) { o.contrast = 2; });
  expect([](StreetOptions& o) { o.metres_per_frame = 0; });
  expect([](StreetOptions& o) { o.disparity_offset = NAN; });
  EXPECT_THROW(StreetSequence(Options(64, 20)).Render(400), std::invalid_argument);
  EXPECT_THROW(StreetSequence(Options(64, 20)).T_world_camera(-1), std::invalid_argument);
}

}  // namespace
}  // namespace terse
