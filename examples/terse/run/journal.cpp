#include "run/journal.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstdint>
#include <filesystem>

#include "terse/core/crc32.h"
#include "terse/core/descriptor.h"
#include "terse/core/error.h"
#include "terse/core/limits.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kFormat = "terse online journal 2\n", kAnyFormat = "terse online journal ";
// What a file that ends within the format begins with at least; less may be anybody's.
constexpr std::size_t kLeastStart = 6;
constexpr std::size_t kLongestHead = 64;  // two numbers and a sum
constexpr std::size_t kReadAtOnce = 1 << 16;

FileError Failure(const std::string& path, const std::string& what, int error) {
  return FileError(path, 0, what + ": " + SystemReason(error));
}

std::string Sum(std::string_view text) {
  constexpr char kDigits[] = "0123456789abcdef";
  const std::uint32_t crc = Crc32(text);
  std::string out;
  for (int shift = 28; shift >= 0; shift -= 4) out += kDigits[(crc >> shift) & 15u];
  return out;
}

std::string Head(long number, std::size_t length) {
  const std::string head = std::to_string(number) + ' ' + std::to_string(length);
  return head + ' ' + Sum(head) + ' ';
}

std::string RecordOf(long number, const std::string& text) {
  return Head(number, text.size()) + Sum(text) + ' ' + text + '\n';
}

bool IsPrefix(std::string_view text, std::string_view whole) { return whole.substr(0, text.size()) == text; }

// Whether the file may have ended within this head: what is there can still become one of the record.
bool IsTornHead(std::string_view rest, long number) {
  const std::string start = std::to_string(number) + ' ';
  if (rest.size() <= start.size()) return IsPrefix(rest, start);
  if (!IsPrefix(start, rest)) return false;
  const std::size_t end = rest.find(' ', start.size());
  const std::string_view digits = rest.substr(start.size(), end == std::string_view::npos ? end : end - start.size());
  if (digits.find_first_not_of("0123456789") != std::string_view::npos) return false;
  if (end == std::string_view::npos) return true;
  return IsPrefix(rest.substr(end + 1), Sum(rest.substr(0, end)) + ' ');
}

}  // namespace

Journal::Journal(const std::string& path) : path_(path) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (fs::exists(status) && !fs::is_regular_file(status)) throw FileError(path, 0, "a journal is a regular file");
  OpenAndLock();
  try {
    const bool is_whole = FillTo(kFormat.size());
    const std::string_view start = std::string_view(ahead_).substr(0, kFormat.size());
    if (!IsPrefix(start, kFormat) || (!start.empty() && start.size() < kLeastStart)) {
      const bool is_journal = IsPrefix(kAnyFormat, start);
      throw FileError(
          path_, 0,
          is_journal ? "a journal of another version of the format, this program reads version 2; it stays as it is"
                     : "a file of another kind, no journal; it stays as it is");
    }
    if (is_whole) {
      taken_ = kFormat.size();
      whole_ = static_cast<long>(taken_);
      header_ = ReadLine();
    }
  } catch (...) {
    ::close(descriptor_);
    throw;
  }
}

Journal::~Journal() {
  struct stat status;
  if (IsNew() && ::fstat(descriptor_, &status) == 0 && status.st_size == 0) ::unlink(path_.c_str());
  ::close(descriptor_);
}

void Journal::OpenAndLock() {
  while (true) {
    descriptor_ = ::open(path_.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
    if (descriptor_ < 0) throw Failure(path_, "cannot open the journal", errno);
    if (::flock(descriptor_, LOCK_EX | LOCK_NB) != 0) {
      const int error = errno;
      ::close(descriptor_);
      if (error == EINTR) continue;
      if (error == EWOULDBLOCK) throw FileError(path_, 0, "another run is using this journal");
      throw Failure(path_, "cannot lock the journal", error);
    }
    // Between the two another run may have removed it.
    struct stat here, there;
    if (::fstat(descriptor_, &here) == 0 && ::stat(path_.c_str(), &there) == 0 && here.st_ino == there.st_ino &&
        here.st_dev == there.st_dev)
      return;
    ::close(descriptor_);
  }
}

// Whether so many bytes lie ahead; fewer only at the end of the file.
bool Journal::FillTo(std::size_t size) {
  if (ahead_.size() - taken_ >= size) return true;
  ahead_.erase(0, taken_);
  taken_ = 0;
  while (ahead_.size() < size) {
    const std::size_t before = ahead_.size();
    ahead_.resize(before + kReadAtOnce);
    const long count = ReadSome(descriptor_, ahead_.data() + before, kReadAtOnce);
    ahead_.resize(before + static_cast<std::size_t>(std::max(count, 0L)));
    if (count < 0) throw Failure(path_, "cannot read the journal", errno);
    if (count == 0) return false;
  }
  return true;
}

FileError Journal::Damage(const std::string& what) const {
  return FileError(path_, 0,
                   "the journal is damaged at byte " + std::to_string(whole_) + ": " + what + "; it stays as it is. " +
                       std::to_string(std::max(records_ - 1, 0L)) + " lines before that are whole, head -c " +
                       std::to_string(whole_) + " keeps them");
}

// The next record, nullopt at the end of the file or where this cuts the record short.
std::optional<std::string> Journal::ReadLine() {
  FillTo(kLongestHead);
  std::string_view rest = std::string_view(ahead_).substr(taken_);
  if (rest.empty()) return std::nullopt;
  long number = 0;
  std::size_t length = 0;
  const char* const end = rest.data() + rest.size();
  std::from_chars_result parsed = std::from_chars(rest.data(), end, number);
  const bool has_number = parsed.ec == std::errc() && parsed.ptr != end && *parsed.ptr == ' ';
  if (has_number) parsed = std::from_chars(parsed.ptr + 1, end, length);
  const std::string head = has_number && parsed.ec == std::errc() ? Head(number, length) : "";
  if (head.empty() || !IsPrefix(head, rest)) {
    if (rest.size() < kLongestHead && IsTornHead(rest, records_)) return std::nullopt;
    throw Damage("no record begins there");
  }
  if (number != records_) {
    throw Damage("record " + std::to_string(number) + " stands where number " + std::to_string(records_) +
                 " belongs; records are missing, doubled or swapped");
  }
  const std::size_t text_at = head.size() + 9;  // "TEXTSUM "
  if (length > kMostLineBytes) throw Damage("no line is as long as record " + std::to_string(number));
  const bool is_whole = FillTo(text_at + length + 1);
  rest = std::string_view(ahead_).substr(taken_);
  if (!is_whole) {
    // A torn record ends within its line.
    if (rest.find('\n') == std::string_view::npos) return std::nullopt;
    throw Damage("bytes are missing in record " + std::to_string(number));
  }
  std::string text(rest.substr(text_at, length));
  const std::string record = RecordOf(number, text);
  if (!IsPrefix(record, rest))
    throw Damage("the text of record " + std::to_string(number) + " is not what was written");
  taken_ += record.size();
  whole_ += static_cast<long>(record.size());
  ++records_;
  return text;
}

long Journal::CutTail() {
  const long cut = static_cast<long>(ahead_.size() - taken_);
  ahead_.clear();
  taken_ = 0;
  if (cut > 0 && ::ftruncate(descriptor_, whole_) != 0) throw Failure(path_, "cannot cut the journal", errno);
  return cut;
}

void Journal::Create(const std::string& header) {
  // What a run left that was killed while it began.
  if (::ftruncate(descriptor_, 0) != 0) throw Failure(path_, "cannot write the journal", errno);
  whole_ = records_ = 0;
  Write(std::string(kFormat) + RecordOf(0, header));
  header_ = header;
  Sync();
  SyncFolderOf(path_);
}

void Journal::Restart(const std::string& header) {
  const std::string next = path_ + ".next", bytes = std::string(kFormat) + RecordOf(0, header);
  const int descriptor = ::open(next.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_APPEND | O_CLOEXEC, 0666);
  if (descriptor < 0) throw Failure(next, "cannot open the journal", errno);
  int error = ::flock(descriptor, LOCK_EX | LOCK_NB) != 0 ? errno : WriteAll(descriptor, bytes);
  if (error == 0) error = SyncData(descriptor);
  if (error == 0 && ::rename(next.c_str(), path_.c_str()) != 0) error = errno;
  if (error != 0) {
    ::close(descriptor);
    ::unlink(next.c_str());
    throw Failure(path_, "cannot begin the journal anew", error);
  }
  ::close(descriptor_);
  descriptor_ = descriptor;
  header_ = header;
  whole_ = static_cast<long>(bytes.size());
  records_ = 1;
  SyncFolderOf(path_);
}

// A record and what goes before it.
void Journal::Write(const std::string& bytes) {
  if (const int error = WriteAll(descriptor_, bytes); error != 0) {
    // Best effort: what remains is a torn record.
    if (::ftruncate(descriptor_, whole_) != 0) errno = 0;
    throw Failure(path_, "cannot write the journal", error);
  }
  whole_ += static_cast<long>(bytes.size());
  ++records_;
}

void Journal::Append(const std::string& text) { Write(RecordOf(records_, text)); }

void Journal::Sync() {
  if (const int error = SyncData(descriptor_); error != 0) throw Failure(path_, "cannot write the journal", error);
}

}  // namespace terse
