#pragma once
// Columns of integers, small in a file: what lies in a column is alike, so that its bytes compress well.

#include <cstdint>
#include <string>
#include <vector>

namespace terse::internal {

using Column = std::vector<std::int64_t>;

// Near zero, of either sign, become small ones without (zigzag); then the lowest byte of all, the next of all and so on
// as far as one is not zero, deflated by zlib.
std::string Deflate(const Column& column);
// How many there are by what it says, no more than it can hold; 0 if this is none.
std::uint64_t InflatedCount(const std::string& bytes);
// Throws std::invalid_argument if this is none. Memory is bounded by what the bytes can hold, whatever they promise.
Column Inflate(const std::string& bytes);

// A column read from the front. Next and Finish throw std::invalid_argument if there is too little or too much.
class ColumnReader {
 public:
  explicit ColumnReader(const std::string& bytes) : column_(Inflate(bytes)) {}
  std::int64_t Next();
  std::size_t Left() const { return column_.size() - at_; }
  void Finish() const;

 private:
  Column column_;
  std::size_t at_ = 0;
};

}  // namespace terse::internal
