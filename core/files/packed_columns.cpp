#include "terse/core/packed_columns.h"

#include <zlib.h>

#include <new>
#include <stdexcept>

namespace terse::internal {
namespace {

constexpr std::size_t kCountBytes = 8, kHeaderBytes = kCountBytes + 1;
constexpr int kBits = 8;
// Deflate makes no less of a byte than this share (zlib's technical details: 1032 to 1).
constexpr std::uint64_t kMostRatio = 1032;

std::uint64_t ZigZag(std::int64_t x) {
  return (static_cast<std::uint64_t>(x) << 1) ^ (x < 0 ? ~std::uint64_t{0} : std::uint64_t{0});
}

std::int64_t FromZigZag(std::uint64_t x) {
  const std::uint64_t half = x >> 1;
  return static_cast<std::int64_t>((x & 1) != 0 ? ~half : half);
}

char ByteOf(std::uint64_t x, std::size_t k) {
  return static_cast<char>(static_cast<unsigned char>(x >> (kBits * k) & 0xff));
}

}  // namespace

std::string Deflate(const Column& column) {
  std::uint64_t all = 0;
  for (const std::int64_t x : column) all |= ZigZag(x);
  std::size_t planes = 1;
  while (planes < sizeof(all) && all >> (kBits * planes) != 0) ++planes;
  std::string plain;
  plain.reserve(planes * column.size());
  for (std::size_t k = 0; k < planes; ++k) {
    for (const std::int64_t x : column) plain += ByteOf(ZigZag(x), k);
  }
  std::string out;
  for (std::size_t k = 0; k < kCountBytes; ++k) out += ByteOf(column.size(), k);
  out += static_cast<char>(planes);
  uLongf size = compressBound(static_cast<uLong>(plain.size()));
  out.resize(kHeaderBytes + size);
  const int status =
      compress2(reinterpret_cast<Bytef*>(out.data() + kHeaderBytes), &size,
                reinterpret_cast<const Bytef*>(plain.data()), static_cast<uLong>(plain.size()), Z_BEST_COMPRESSION);
  if (status != Z_OK) throw std::bad_alloc();  // the only way in which it can fail
  out.resize(kHeaderBytes + size);
  return out;
}

std::uint64_t InflatedCount(const std::string& bytes) {
  if (bytes.size() < kHeaderBytes) return 0;
  std::uint64_t count = 0;
  for (std::size_t k = 0; k < kCountBytes; ++k) {
    count |= static_cast<std::uint64_t>(static_cast<unsigned char>(bytes[k])) << (kBits * k);
  }
  const std::uint64_t planes = static_cast<unsigned char>(bytes[kCountBytes]), packed = bytes.size() - kHeaderBytes;
  if (planes < 1 || planes > sizeof(std::uint64_t)) return 0;
  return count <= kMostRatio * packed / planes ? count : 0;
}

Column Inflate(const std::string& bytes) {
  const auto expect = [](bool is_so) {
    if (!is_so) throw std::invalid_argument("a column that is none");
  };
  const std::uint64_t count = InflatedCount(bytes);
  if (count == 0) {
    expect(bytes == Deflate({}));
    return {};
  }
  const std::uint64_t planes = static_cast<unsigned char>(bytes[kCountBytes]), packed = bytes.size() - kHeaderBytes;
  std::string plain(static_cast<std::size_t>(planes * count), '\0');
  uLongf size = static_cast<uLongf>(plain.size());
  const int status =
      uncompress(reinterpret_cast<Bytef*>(plain.data()), &size,
                 reinterpret_cast<const Bytef*>(bytes.data() + kHeaderBytes), static_cast<uLong>(packed));
  expect(status == Z_OK && size == plain.size());
  Column column(static_cast<std::size_t>(count));
  for (std::size_t i = 0; i < column.size(); ++i) {
    std::uint64_t x = 0;
    for (std::size_t k = 0; k < planes; ++k) {
      x |= static_cast<std::uint64_t>(static_cast<unsigned char>(plain[k * column.size() + i])) << (kBits * k);
    }
    column[i] = FromZigZag(x);
  }
  return column;
}

std::int64_t ColumnReader::Next() {
  if (at_ == column_.size()) throw std::invalid_argument("a column that is too short");
  return column_[at_++];
}

void ColumnReader::Finish() const {
  if (at_ != column_.size()) throw std::invalid_argument("a column that is too long");
}

}  // namespace terse::internal
