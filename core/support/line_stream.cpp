#include "terse/core/line_stream.h"

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <vector>

#include "terse/core/crc32.h"
#include "terse/core/limits.h"

namespace terse {
namespace {

std::ifstream Open(const std::string& path) {
  std::error_code ignored;
  if (std::filesystem::is_directory(path, ignored)) throw FileError(path, 0, "is a folder, expected a file");
  std::ifstream file(path, std::ios::binary);
  if (!file) throw FileError(path, 0, std::string("cannot open: ") + std::strerror(errno));
  return file;
}

void ExpectNoFailure(const std::ifstream& file, const std::string& path) {
  if (file.bad()) throw FileError(path, 0, std::string("cannot read: ") + std::strerror(errno));
}

}  // namespace

LineStream::LineStream(const std::string& path) : path_(path), file_(Open(path)) {}

bool LineStream::ReadRaw() {
  // In pieces: what has no line end is refused before it fills the memory.
  constexpr std::size_t kPiece = std::size_t{1} << 16;
  char piece[kPiece];
  raw_.clear();
  bool has_end = false;
  while (!has_end && !file_.eof()) {
    file_.getline(piece, kPiece);
    const auto count = static_cast<std::size_t>(file_.gcount());
    ExpectNoFailure(file_, path_);
    has_end = !file_.fail() && !file_.eof();
    raw_.append(piece, has_end ? count - 1 : count);  // the end is counted, but not stored
    if (raw_.size() > kMostLineBytes) {
      throw FileError(path_, number_ + 1,
                      "the line has more than " + std::to_string(kMostLineBytes) + " bytes, expected at most that");
    }
    if (file_.fail() && !file_.eof()) file_.clear();  // a piece that is full
  }
  return has_end || !raw_.empty();
}

bool LineStream::Next(TextLine& line) {
  while (ReadRaw()) {
    ++number_;
    std::string_view text = raw_;
    if (number_ == 1 && text.substr(0, 3) == "\xEF\xBB\xBF") text.remove_prefix(3);  // an editor's byte order mark
    if (text.find('\0') != std::string_view::npos) {
      throw FileError(path_, number_, "the line holds a zero byte, expected text");
    }
    constexpr std::string_view kBlanks = " \t\r\v\f";
    const std::size_t first = text.find_first_not_of(kBlanks);
    if (first == std::string_view::npos) continue;
    text = text.substr(first, text.find_last_not_of(kBlanks) + 1 - first);
    if (text[0] == '#' || text.substr(0, 2) == "//") continue;
    line = {number_, text};
    return true;
  }
  ExpectNoFailure(file_, path_);
  return false;
}

FileFingerprint FingerprintOf(const std::string& path) {
  std::ifstream file = Open(path);
  FileFingerprint out;
  std::vector<char> piece(std::size_t{1} << 20);
  while (file.read(piece.data(), static_cast<std::streamsize>(piece.size())) || file.gcount() > 0) {
    const std::string_view bytes(piece.data(), static_cast<std::size_t>(file.gcount()));
    out.bytes += bytes.size();
    out.crc32 = Crc32(bytes, out.crc32);
  }
  ExpectNoFailure(file, path);
  return out;
}

}  // namespace terse
