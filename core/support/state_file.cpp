#include "terse/core/state_file.h"

#include <cstddef>
#include <string_view>

#include "terse/core/atomic_file.h"
#include "terse/core/read_file.h"

namespace terse {
namespace {

constexpr std::size_t kMagicLength = sizeof(kStateMagic) - 1;

// Fowler, Noll, Vo: FNV-1a with 64 bits. It tells apart any two files that differ in one byte.
std::uint64_t Hash(const char* bytes, std::size_t count) {
  std::uint64_t hash = 0xcbf29ce484222325;
  for (std::size_t k = 0; k < count; ++k) hash = (hash ^ static_cast<unsigned char>(bytes[k])) * 0x100000001b3;
  return hash;
}

// A name that comes from a file, for a message.
std::string Quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text.substr(0, 60)) out += c >= ' ' && c <= '~' ? c : '?';
  return out + "\"";
}

void CheckStart(std::string_view start, const std::string& path, const std::string& kind) {
  if (start.substr(0, kMagicLength) == std::string_view(kStateMagic, kMagicLength)) return;
  throw FileError(path, 0,
                  start.empty() ? "the file is empty, expected a saved state"
                                : "not a saved state (it does not begin as one), expected one of kind " + Quoted(kind));
}

}  // namespace

StateWriter::StateWriter(const std::string& kind) {
  PutBytes(kStateMagic, kMagicLength);
  Put(kStateFormat);
  Put(static_cast<std::uint32_t>(kind.size()));
  PutBytes(kind.data(), kind.size());
  members_at_ = bytes_.size() + sizeof(std::uint64_t);
  Put(std::uint64_t{0});
}

void StateWriter::PutLongDouble(long double number) {
  for (int part = 0; part < 3; ++part) {
    const double rounded = static_cast<double>(number);
    Put(rounded);
    number -= rounded;
  }
}

std::string StateWriter::Bytes() && {
  StateWriter length("");
  length.bytes_.clear();
  length.Put(static_cast<std::uint64_t>(bytes_.size() - members_at_));
  bytes_.replace(members_at_ - sizeof(std::uint64_t), sizeof(std::uint64_t), length.bytes_);
  Put(Hash(bytes_.data(), bytes_.size()));
  return std::move(bytes_);
}

void StateWriter::Save(const std::string& path) && {
  const std::string bytes = std::move(*this).Bytes();
  AtomicFile file(path);
  file.Stream().write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  file.Commit();
}

StateReader::StateReader(const std::string& path, const std::string& kind) : path_(path) {
  ReadLimits limits;
  limits.check_start = [&](std::string_view start) { CheckStart(start, path, kind); };
  bytes_ = ReadAll(path, limits);
  Open(kind);
}

StateReader::StateReader(std::string bytes, const std::string& name, const std::string& kind)
    : path_(name), bytes_(std::move(bytes)) {
  CheckStart(bytes_, name, kind);
  Open(kind);
}

void StateReader::Open(const std::string& kind) {
  const auto refuse = [&](const std::string& cause) { throw FileError(path_, 0, cause); };
  members_end_ = bytes_.size();
  at_ = kMagicLength;
  const auto cut_off = [&] {
    refuse("the file is truncated: it ends after " + std::to_string(bytes_.size()) + " bytes, within its header");
  };
  std::uint32_t format = 0, kind_length = 0;
  if (bytes_.size() < at_ + 2 * sizeof(std::uint32_t)) cut_off();
  Get(format);
  if (format != kStateFormat) {
    refuse("a state of format version " + std::to_string(format) + ", this program reads version " +
           std::to_string(kStateFormat));
  }
  Get(kind_length);
  if (bytes_.size() - at_ < sizeof(std::uint64_t) || bytes_.size() - at_ - sizeof(std::uint64_t) < kind_length)
    cut_off();
  const std::string found_kind = bytes_.substr(at_, kind_length);
  at_ += kind_length;
  std::uint64_t length = 0;
  Get(length);
  const std::uint64_t left = bytes_.size() - at_;
  if (left < sizeof(std::uint64_t) || left - sizeof(std::uint64_t) != length) {
    const bool is_short = left < sizeof(std::uint64_t) || left - sizeof(std::uint64_t) < length;
    refuse((is_short ? "the file is truncated: " : "the file is too long: ") + std::to_string(left) +
           " bytes follow the header, which promises " + std::to_string(length) + " and a checksum of 8");
  }
  const std::size_t members_at = at_;
  members_end_ = bytes_.size();
  at_ += length;
  std::uint64_t checksum = 0;
  Get(checksum);
  if (checksum != Hash(bytes_.data(), members_at + length)) refuse("the file is damaged: its checksum does not fit");
  if (found_kind != kind) refuse("holds a state of kind " + Quoted(found_kind) + ", expected " + Quoted(kind));
  at_ = members_at;
  members_end_ = members_at + length;
}

void StateReader::GetLongDouble(long double& number) {
  double parts[3];
  for (double& part : parts) Get(part);
  number = static_cast<long double>(parts[0]) + parts[1] + parts[2];
}

void StateReader::Fail(const std::string& cause) const {
  throw FileError(path_, 0, "the saved state makes no sense: " + cause);
}

void StateReader::Finish() const {
  if (at_ != members_end_) Fail(std::to_string(members_end_ - at_) + " bytes are left over");
}

}  // namespace terse
