#include "terse/core/line_stream.h"

#include <algorithm>
#include <vector>

#include "terse/core/crc32.h"

namespace terse {

bool LineStream::ReadMore() {
  constexpr std::size_t kPiece = std::size_t{1} << 18;
  if (is_at_end_) return false;
  if (file_.IsStored()) {
    buffer_.erase(0, next_);
    next_ = 0;
  }
  const std::size_t old_size = buffer_.size();
  // What has no line end is refused before it fills the memory, and so is what has no end.
  ExpectLineSize(old_size - next_, number_ + 1, file_.Path());
  if (!file_.IsStored() && old_size > ReadLimits().most_bytes) throw TooLarge(file_.Path(), ReadLimits().most_bytes);
  buffer_.resize(old_size + kPiece);
  buffer_.resize(old_size + file_.Read(buffer_.data() + old_size, kPiece));
  const std::string_view unread = std::string_view(buffer_).substr(next_);
  if (buffer_.find('\0', old_size) != std::string::npos) ExpectText(file_.Path(), unread, number_ + 1);
  is_at_end_ = buffer_.size() == old_size;
  if (is_at_end_) file_.ExpectUnchanged();
  return !is_at_end_;
}

bool LineStream::Next(TextLine& line) {
  while (true) {
    std::size_t end = buffer_.find('\n', next_);
    while (end == std::string::npos) {
      const std::size_t seen = buffer_.size() - next_;
      if (!ReadMore()) break;
      end = buffer_.find('\n', next_ + seen);
    }
    if (end == std::string::npos && next_ == buffer_.size()) return false;
    const std::string_view raw = std::string_view(buffer_).substr(next_, std::min(end, buffer_.size()) - next_);
    next_ += raw.size() + (end == std::string::npos ? 0 : 1);
    if (StripLine(raw, ++number_, file_.Path(), &line)) return true;
  }
}

void LineStream::Rewind() {
  if (file_.IsStored()) {
    file_.Rewind();
    buffer_.clear();
    is_at_end_ = false;
  }
  next_ = 0;
  number_ = 0;
}

FileFingerprint FingerprintOf(const std::string& path) {
  InputFile file(path);
  FileFingerprint out;
  std::vector<char> piece(std::size_t{1} << 20);
  while (const std::size_t count = file.Read(piece.data(), piece.size())) {
    out.bytes += count;
    out.crc32 = Crc32({piece.data(), count}, out.crc32);
  }
  file.ExpectUnchanged();
  return out;
}

}  // namespace terse
