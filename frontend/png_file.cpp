#include "terse/frontend/png_file.h"

#include <png.h>

#include <cerrno>
#include <csetjmp>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <new>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <string_view>
#include <system_error>
#include <vector>

#include "terse/core/error.h"
#include "terse/core/read_file.h"

namespace terse {
namespace {

constexpr char kCutOff[] = "the PNG image is cut off, expected more bytes";
// For a comment, a colour profile and the like, which take what they claim to be long.
constexpr png_alloc_size_t kMostChunkBytes = 8000000;
constexpr png_uint_32 kMostNotes = 8;  // texts and other chunks beside the pixels
// Deflate makes no more of a byte; a file of n bytes that promises more pixels than this allows cannot hold them.
constexpr std::uint64_t kMostInflation = 1032;

// What libpng calls back with. It leaves by longjmp(), which runs no destructors: the functions below that call
// setjmp() hold nothing that has one.
struct Transfer {
  const png_byte* bytes = nullptr;  // to be decoded
  std::size_t size = 0, left = 0;
  bool cut_off = false;
  char message[128] = "";
};

void Fail(png_structp png, png_const_charp message) {
  auto& transfer = *static_cast<Transfer*>(png_get_error_ptr(png));
  std::snprintf(transfer.message, sizeof transfer.message, "%s", message);
  png_longjmp(png, 1);
}

void Ignore(png_structp, png_const_charp) {}

void TakeBytes(png_structp png, png_bytep out, std::size_t count) {
  auto& transfer = *static_cast<Transfer*>(png_get_io_ptr(png));
  if (count > transfer.left) {
    transfer.cut_off = true;
    png_error(png, "the file ends too early");
  }
  std::memcpy(out, transfer.bytes, count);
  transfer.bytes += count;
  transfer.left -= count;
}

struct Reader {
  Transfer transfer;
  png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &transfer, Fail, Ignore);
  png_infop info = png != nullptr ? png_create_info_struct(png) : nullptr;

  Reader() = default;
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  ~Reader() { png_destroy_read_struct(&png, &info, nullptr); }
};

struct Writer {
  Transfer transfer;
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, &transfer, Fail, Ignore);
  png_infop info = png != nullptr ? png_create_info_struct(png) : nullptr;

  Writer() = default;
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;
  ~Writer() { png_destroy_write_struct(&png, &info); }
};

// The header; rows will be 8-bit grey or BGR.
bool ReadHeader(png_structp png, png_infop info, Transfer& transfer) {
  if (setjmp(png_jmpbuf(png)) != 0) return false;
  png_set_read_fn(png, &transfer, TakeBytes);
  png_set_chunk_malloc_max(png, kMostChunkBytes);
  png_set_chunk_cache_max(png, kMostNotes);
  png_read_info(png, info);
  const std::uint64_t width = png_get_image_width(png, info), height = png_get_image_height(png, info);
  const std::uint64_t decoded = height * png_get_rowbytes(png, info);
  if (width * height > kMostImagePixels) png_error(png, "it is too large, expected at most 2^26 pixels");
  if (decoded > kMostDecodedBytes) png_error(png, "it is too large, expected at most 2^27 bytes of pixels");
  if (decoded > kMostInflation * transfer.size) {
    png_error(png, "it promises more pixels than the file can hold");
  }
  png_set_strip_16(png);
  png_set_expand(png);
  png_set_strip_alpha(png);
  png_set_bgr(png);
  png_set_interlace_handling(png);
  png_read_update_info(png, info);
  return true;
}

bool ReadRows(png_structp png, png_bytepp rows) {
  if (setjmp(png_jmpbuf(png)) != 0) return false;
  png_read_image(png, rows);
  png_read_end(png, nullptr);
  return true;
}

bool WriteRows(png_structp png, png_infop info, std::FILE* file, png_bytepp rows, png_uint_32 width,
               png_uint_32 height) {
  if (setjmp(png_jmpbuf(png)) != 0) return false;
  png_init_io(png, file);
  // Noise does not compress: what costs time for a few per cent is left out.
  png_set_compression_level(png, 1);
  png_set_compression_strategy(png, 2);  // zlib's Z_HUFFMAN_ONLY
  png_set_IHDR(png, info, width, height, 8, PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
               PNG_FILTER_TYPE_DEFAULT);
  png_write_info(png, info);
  png_write_image(png, rows);
  png_write_end(png, info);
  return true;
}

std::vector<png_bytep> Rows(cv::Mat& image) {
  std::vector<png_bytep> rows;
  for (int y = 0; y < image.rows; ++y) rows.push_back(image.ptr(y));
  return rows;
}

// libpng takes memory for what a chunk claims to be long before it finds that the file ends: look first. The signature
// is there.
bool ChunksEndInside(const std::string& bytes) {
  constexpr std::size_t kSignature = 8, kHead = 8, kChecksum = 4;  // head of a chunk: length and name
  std::size_t at = kSignature;
  while (bytes.size() - at >= kHead) {
    std::size_t length = 0;
    for (std::size_t k = 0; k < 4; ++k) length = length << 8 | static_cast<unsigned char>(bytes[at + k]);
    if (bytes.compare(at + 4, 4, "IEND") == 0) return true;
    at += kHead;
    if (length + kChecksum > bytes.size() - at) return false;
    at += length + kChecksum;
  }
  return true;  // libpng says what is missing
}

FileError ReadError(const std::string& path, const Transfer& transfer) {
  if (transfer.cut_off) return FileError(path, 0, kCutOff);
  return FileError(path, 0, std::string("the PNG image cannot be decoded: ") + transfer.message);
}

}  // namespace

cv::Mat ReadGreyPng(const std::string& path) {
  constexpr std::size_t kSignatureSize = 8;
  const auto expect_png = [&](std::string_view start) {
    const auto* signature = reinterpret_cast<const png_byte*>(start.data());
    if (start.size() >= kSignatureSize && png_sig_cmp(signature, 0, kSignatureSize) == 0) return;
    throw FileError(path, 0, "not a PNG image, expected one");
  };
  const std::string bytes = ReadAll(path, {MostFileBytes(kMostImageBytes, 4), expect_png});
  const auto* begin = reinterpret_cast<const png_byte*>(bytes.data());
  if (!ChunksEndInside(bytes)) throw FileError(path, 0, kCutOff);
  Reader reader;
  if (reader.info == nullptr) throw std::bad_alloc();
  reader.transfer.bytes = begin;
  reader.transfer.size = reader.transfer.left = bytes.size();
  if (!ReadHeader(reader.png, reader.info, reader.transfer)) throw ReadError(path, reader.transfer);
  const bool is_grey = png_get_channels(reader.png, reader.info) == 1;
  cv::Mat image(static_cast<int>(png_get_image_height(reader.png, reader.info)),
                static_cast<int>(png_get_image_width(reader.png, reader.info)), is_grey ? CV_8UC1 : CV_8UC3);
  std::vector<png_bytep> rows = Rows(image);
  if (!ReadRows(reader.png, rows.data())) throw ReadError(path, reader.transfer);
  if (is_grey) return image;
  cv::Mat grey;
  cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  return grey;
}

void WriteGreyPng(const std::string& path, const cv::Mat& image) {
  if (image.empty() || image.type() != CV_8U) throw std::invalid_argument("WriteGreyPng: not an 8-bit grey image");
  Writer writer;
  if (writer.info == nullptr) throw std::bad_alloc();
  cv::Mat source = image;  // shares the pixels; libpng wants pointers to non-const
  std::vector<png_bytep> rows = Rows(source);
  const auto fail = [&](int error) {
    return FileError(path, 0, "cannot write: " + std::system_category().message(error != 0 ? error : EIO));
  };
  errno = 0;
  std::FILE* file = std::fopen(path.c_str(), "wb");
  if (file == nullptr) throw fail(errno);
  const bool written = WriteRows(writer.png, writer.info, file, rows.data(), static_cast<png_uint_32>(image.cols),
                                 static_cast<png_uint_32>(image.rows));
  const int error = errno;
  const bool closed = std::fclose(file) == 0;
  if (written && closed) return;
  const int cause = written ? errno : error;
  std::remove(path.c_str());
  throw fail(cause);
}

}  // namespace terse
