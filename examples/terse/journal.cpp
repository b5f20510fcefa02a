#include "journal.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string_view>
#include <system_error>

#include "crc32.h"
#include "terse/core/atomic_file.h"
#include "terse/core/error.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kFormat = "terse online journal 1\n";

FileError Failure(const std::string& path, const std::string& what) {
  return FileError(path, 0, what + ": " + std::system_category().message(errno));
}

std::string Record(const std::string& text) {
  constexpr char kDigits[] = "0123456789abcdef";
  const std::uint32_t crc = Crc32(text);
  std::string out = std::to_string(text.size()) + ' ';
  for (int shift = 28; shift >= 0; shift -= 4) out += kDigits[(crc >> shift) & 15u];
  return out + ' ' + text + '\n';
}

// The text of the record that `rest` begins with, nullopt if that is none.
std::optional<std::string_view> RecordText(std::string_view rest) {
  std::size_t length = 0;
  const std::from_chars_result end = std::from_chars(rest.data(), rest.data() + rest.size(), length);
  const std::size_t start = static_cast<std::size_t>(end.ptr - rest.data()) + 10;  // " CCCCCCCC "
  if (end.ec != std::errc() || start > rest.size() || length >= rest.size() - start) return std::nullopt;
  const std::string_view text = rest.substr(start, length);
  if (rest.substr(0, start + length + 1) != Record(std::string(text))) return std::nullopt;
  return text;
}

// So that the new name lasts too. Some file systems cannot: the journal lasts all the same unless the power fails.
void SyncFolderOf(const std::string& path) {
  const fs::path folder = fs::path(path).parent_path();
  const int descriptor = ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) return;
  ::fsync(descriptor);
  ::close(descriptor);
}

}  // namespace

Journal::Journal(const std::string& path) : path_(path) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (!fs::exists(status)) return;
  if (!fs::is_regular_file(status)) throw FileError(path, 0, "a journal is a regular file");
  if (fs::file_size(path, error) == 0 && !error) return;
  Open();
  try {
    std::ifstream file(path, std::ios::binary);
    const std::string content{std::istreambuf_iterator<char>(file), {}};
    if (!file) throw FileError(path, 0, "cannot read");
    Parse(content);
  } catch (...) {
    ::close(descriptor_);
    throw;
  }
}

Journal::~Journal() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

void Journal::Open() {
  descriptor_ = ::open(path_.c_str(), O_RDWR | O_APPEND | O_CLOEXEC);
  if (descriptor_ < 0) throw Failure(path_, "cannot open the journal");
  if (::flock(descriptor_, LOCK_EX | LOCK_NB) == 0 || errno != EWOULDBLOCK) return;
  ::close(descriptor_);
  throw FileError(path_, 0, "another run is using this journal");
}

void Journal::Parse(const std::string& content) {
  std::string_view rest = content;
  if (rest.substr(0, kFormat.size()) != kFormat) {
    throw FileError(path_, 0, "a file of another kind, no journal of this version; it stays as it is");
  }
  rest.remove_prefix(kFormat.size());
  std::vector<std::string> records;
  while (const auto text = RecordText(rest)) {
    records.emplace_back(*text);
    rest.remove_prefix(Record(records.back()).size());
  }
  if (records.empty()) throw FileError(path_, 0, "the journal is damaged: it has no header");
  size_ = static_cast<long>(content.size());
  whole_ = size_ - static_cast<long>(rest.size());
  for (std::size_t next = rest.find('\n'); next != std::string_view::npos; next = rest.find('\n', next + 1)) {
    if (!RecordText(rest.substr(next + 1))) continue;
    throw FileError(path_, 0,
                    "the journal is damaged at byte " + std::to_string(whole_) + ", with whole records behind it");
  }
  header_ = std::move(records.front());
  lines_.assign(std::make_move_iterator(records.begin() + 1), std::make_move_iterator(records.end()));
}

void Journal::Create(const std::string& header) {
  AtomicFile file(path_);
  file.Stream() << kFormat << Record(header);
  file.Commit();
  SyncFolderOf(path_);
  Open();
  header_ = header;
}

long Journal::CutTail() {
  const long cut = size_ - whole_;
  if (cut > 0 && ::ftruncate(descriptor_, whole_) != 0) throw Failure(path_, "cannot cut the journal");
  size_ = whole_;
  return cut;
}

void Journal::Append(const std::string& text) {
  const std::string record = Record(text);
  for (std::size_t done = 0; done < record.size();) {
    const ssize_t count = ::write(descriptor_, record.data() + done, record.size() - done);
    if (count < 0 && errno != EINTR) throw Failure(path_, "cannot write the journal");
    if (count > 0) done += static_cast<std::size_t>(count);
  }
}

void Journal::Sync() {
  // Some file systems have no fsync.
  if (::fdatasync(descriptor_) != 0 && errno != EINVAL && errno != ENOTSUP) {
    throw Failure(path_, "cannot write the journal");
  }
}

}  // namespace terse
