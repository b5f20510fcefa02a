// PNG images as they are, and with the checksums of their chunks made right, which lets damage past the first check.

#include <zlib.h>

#include <opencv2/core.hpp>

#include "fuzzing.h"
#include "terse/frontend/png_file.h"

namespace terse::fuzz {
namespace {

constexpr std::size_t kSignature = 8, kLength = 4, kName = 4, kChecksum = 4;

void Put(std::string& bytes, std::size_t at, std::uint64_t number) {
  for (std::size_t k = 0; k < 4; ++k) bytes[at + k] = static_cast<char>(number >> (24 - 8 * k));
}

// The chunks with lengths and checksums that fit.
std::string Mended(std::string bytes) {
  for (std::size_t at = kSignature; at + kLength + kName + kChecksum <= bytes.size();) {
    std::size_t length = 0;
    for (std::size_t k = 0; k < kLength; ++k) length = length << 8 | static_cast<unsigned char>(bytes[at + k]);
    const std::size_t most = bytes.size() - at - kLength - kName - kChecksum;
    if (length > most) Put(bytes, at, length = most);
    const auto* begin = reinterpret_cast<const Bytef*>(bytes.data()) + at + kLength;
    const uLong checksum = crc32(crc32(0, nullptr, 0), begin, static_cast<uInt>(kName + length));
    at += kLength + kName + length;
    Put(bytes, at, checksum);
    at += kChecksum;
  }
  return bytes;
}

void Read(const std::string& path) {
  Done([&] {
    const cv::Mat image = ReadGreyPng(path);
    Expect(image.type() == CV_8UC1 && !image.empty(), "a grey image");
    Expect(cv::sum(image)[0] >= 0, "pixels can be read");
  });
}

}  // namespace
}  // namespace terse::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace terse::fuzz;
  static InputFile file;
  const std::string bytes(AsText(data, size));
  Read(file.With(bytes));
  const std::string mended = Mended(bytes);
  if (mended != bytes) Read(file.With(mended));
  return 0;
}
