// What is written reads back; PNGs of every kind, written by libpng's own simple interface, read as grey; damage at any
// byte is an error.

#include <gtest/gtest.h>
#include <png.h>
#include <sys/resource.h>
#include <zlib.h>

#include <filesystem>
#include <fstream>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "terse/core/error.h"
#include "terse/frontend/png_file.h"
#include "testing_files.h"

namespace terse {
namespace {

cv::Mat RandomImage(int type, cv::Size size = {37, 11}) {
  cv::Mat image(size, type);
  cv::RNG(1).fill(image, cv::RNG::UNIFORM, 0, CV_MAT_DEPTH(type) == CV_8U ? 256 : 65536);
  return image;
}

double MostDifference(const cv::Mat& a, const cv::Mat& b) {
  if (a.size() != b.size() || a.type() != b.type()) return 1e9;
  return cv::norm(a, b, cv::NORM_INF);
}

void WriteByLibpng(const std::string& path, const cv::Mat& image, png_uint_32 format, const cv::Mat& palette = {}) {
  png_image header = {};
  header.version = PNG_IMAGE_VERSION;
  header.width = static_cast<png_uint_32>(image.cols);
  header.height = static_cast<png_uint_32>(image.rows);
  header.format = format;
  header.colormap_entries = static_cast<png_uint_32>(palette.cols);
  ASSERT_NE(png_image_write_to_file(&header, path.c_str(), 0, image.data, 0, palette.data), 0) << header.message;
}

std::string CauseOf(const std::string& path) {
  try {
    ReadGreyPng(path);
  } catch (const FileError& error) {
    EXPECT_EQ(error.path(), path);
    return error.cause();
  }
  return "none";
}

TEST(PngFile, WhatIsWrittenReadsBack) {
  const TestFile file("grey.png"), again("again.png");
  for (const cv::Size size : {cv::Size(1, 1), cv::Size(37, 11), cv::Size(612, 184)}) {
    const cv::Mat image = RandomImage(CV_8U, size);
    WriteGreyPng(file.Path(), image);
    WriteGreyPng(again.Path(), image);
    EXPECT_EQ(MostDifference(ReadGreyPng(file.Path()), image), 0) << size;
    EXPECT_EQ(file.Content(), again.Content()) << size;
  }
  const cv::Mat part = RandomImage(CV_8U)(cv::Rect(3, 2, 20, 5));  // rows apart in memory
  WriteGreyPng(file.Path(), part);
  EXPECT_EQ(MostDifference(ReadGreyPng(file.Path()), part), 0);
}

TEST(PngFile, ColourBecomesGrey) {
  const TestFile file("colour.png");
  const cv::Mat bgr = RandomImage(CV_8UC3), bgra = RandomImage(CV_8UC4);
  cv::Mat grey;
  WriteByLibpng(file.Path(), bgr, PNG_FORMAT_BGR);
  cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
  EXPECT_LE(MostDifference(ReadGreyPng(file.Path()), grey), 1);
  WriteByLibpng(file.Path(), bgra, PNG_FORMAT_BGRA);
  cv::cvtColor(bgra, grey, cv::COLOR_BGRA2GRAY);
  EXPECT_LE(MostDifference(ReadGreyPng(file.Path()), grey), 1);
}

TEST(PngFile, SixteenBitsAreCutToEight) {
  const TestFile file("deep.png");
  const cv::Mat deep = RandomImage(CV_16U);
  WriteByLibpng(file.Path(), deep, PNG_FORMAT_LINEAR_Y);
  cv::Mat expected(deep.size(), CV_8U);
  for (int y = 0; y < deep.rows; ++y) {
    for (int x = 0; x < deep.cols; ++x) expected.at<uchar>(y, x) = static_cast<uchar>(deep.at<ushort>(y, x) >> 8);
  }
  EXPECT_EQ(MostDifference(ReadGreyPng(file.Path()), expected), 0);
}

// 4 colours are stored as 2 bits per pixel.
TEST(PngFile, PalettesAreLookedUp) {
  const TestFile file("palette.png");
  for (const int colours : {4, 256}) {
    const cv::Mat palette = RandomImage(CV_8UC3, {colours, 1});
    cv::Mat index = RandomImage(CV_8U), bgr(index.size(), CV_8UC3), grey;
    for (int y = 0; y < index.rows; ++y) {
      for (int x = 0; x < index.cols; ++x) {
        index.at<uchar>(y, x) = static_cast<uchar>(index.at<uchar>(y, x) % colours);
        bgr.at<cv::Vec3b>(y, x) = palette.at<cv::Vec3b>(0, index.at<uchar>(y, x));
      }
    }
    WriteByLibpng(file.Path(), index, PNG_FORMAT_BGR_COLORMAP, palette);
    cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
    EXPECT_LE(MostDifference(ReadGreyPng(file.Path()), grey), 1) << colours;
  }
}

TEST(PngFile, DamageAtAnyByteIsAnError) {
  const TestFile whole("whole.png");
  WriteGreyPng(whole.Path(), RandomImage(CV_8U));
  const std::string bytes = whole.Content();
  for (std::size_t k = 0; k < bytes.size(); ++k) {
    const TestFile part("part.png", bytes.substr(0, k));
    EXPECT_EQ(CauseOf(part.Path()),
              k < 8 ? "not a PNG image, expected one" : "the PNG image is cut off, expected more bytes")
        << k;
    std::string flipped = bytes;
    flipped[k] = static_cast<char>(flipped[k] ^ 4);
    const TestFile damaged("damaged.png", flipped);
    const std::string cause = CauseOf(damaged.Path());
    EXPECT_TRUE(cause.rfind(k < 8 ? "not a PNG image" : "the PNG image ", 0) == 0) << k << " " << cause;
  }
  EXPECT_NE(CauseOf(whole.Path() + "x").find("does not exist"), std::string::npos);
}

TEST(PngFile, WhatCannotBeWrittenIsNamed) {
  const std::string path = ::testing::TempDir() + "terse_no_such_folder/image.png";
  EXPECT_THROW(WriteGreyPng(path, RandomImage(CV_8U)), FileError);
  EXPECT_THROW(WriteGreyPng(path, RandomImage(CV_8UC3)), std::invalid_argument);
  EXPECT_THROW(WriteGreyPng(path, cv::Mat()), std::invalid_argument);
}

long PeakMegabytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_maxrss / 1024;
}

// 100 compressed texts of 7.9 MB each, which libpng would keep.
TEST(PngFile, TextsBesideThePixelsTakeNoMemory) {
  std::vector<Bytef> packed(compressBound(7900000));
  uLongf size = packed.size();
  const std::vector<Bytef> text(7900000, 'x');
  ASSERT_EQ(compress(packed.data(), &size, text.data(), text.size()), Z_OK);
  std::string chunk = "zTXtnote" + std::string(2, '\0');
  chunk.append(reinterpret_cast<const char*>(packed.data()), size);
  const auto number = [](uLong value) {
    std::string out;
    for (int k = 24; k >= 0; k -= 8) out += static_cast<char>(value >> k);
    return out;
  };
  const uLong crc = crc32(0, reinterpret_cast<const Bytef*>(chunk.data()), static_cast<uInt>(chunk.size()));
  const std::string whole = number(chunk.size() - 4) + chunk + number(crc);
  const TestFile file("texts.png");
  const cv::Mat image = RandomImage(CV_8U, {64, 64});
  WriteGreyPng(file.Path(), image);
  std::string bytes = file.Content(), texts;
  for (int k = 0; k < 100; ++k) texts += whole;
  bytes.insert(33, texts);  // behind the header
  ASSERT_LT(bytes.size(), 1000000u);
  std::ofstream(file.Path(), std::ios::binary) << bytes;
  const long before = PeakMegabytes();
  EXPECT_EQ(cv::norm(ReadGreyPng(file.Path()), image, cv::NORM_INF), 0);
  EXPECT_LT(PeakMegabytes() - before, 250);  // 790 if they were kept
}

// An image of 100 million grey pixels, and one of 16 million, in files that cannot hold them.
TEST(PngFile, MemoryIsTakenForWhatAFileHolds) {
  const TestFile file("claims.png");
  const auto claim = [&](png_uint_32 width, png_uint_32 height) {
    WriteGreyPng(file.Path(), RandomImage(CV_8U, {64, 64}));
    std::string bytes = file.Content();
    for (int k = 0; k < 4; ++k) {
      bytes[static_cast<std::size_t>(16 + k)] = static_cast<char>(width >> (24 - 8 * k));
      bytes[static_cast<std::size_t>(20 + k)] = static_cast<char>(height >> (24 - 8 * k));
    }
    uLong crc = crc32(0, nullptr, 0);
    crc = crc32(crc, reinterpret_cast<const Bytef*>(bytes.data()) + 12, 17);
    for (int k = 0; k < 4; ++k) bytes[static_cast<std::size_t>(29 + k)] = static_cast<char>(crc >> (24 - 8 * k));
    std::ofstream(file.Path(), std::ios::binary) << bytes;
    return CauseOf(file.Path());
  };
  EXPECT_EQ(claim(64, 64), "none");
  EXPECT_NE(claim(10000, 10000).find("too large, expected at most 2^26 pixels"), std::string::npos);
  EXPECT_NE(claim(4000, 4000).find("promises more pixels than the file can hold"), std::string::npos);
  EXPECT_NE(claim(64, 65).find("the PNG image"), std::string::npos);  // could be, but is not
}

}  // namespace
}  // namespace terse
