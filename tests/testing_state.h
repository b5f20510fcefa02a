#pragma once
// Bits of what saved states are made of and compared by.

#include <gtest/gtest.h>

#include <optional>
#include <string>

#include "terse/core/error.h"
#include "terse/core/pose_graph.h"

namespace terse::testing {

// At the end of a solver's members: five times in seconds. At the end of a file: the checksum.
constexpr std::size_t kStateTimes = 5 * sizeof(double), kStateChecksum = 8;

template <class T>
std::string Bytes(const T& value) {
  return std::string(reinterpret_cast<const char*>(&value), sizeof(value));
}

// FNV-1a, as the header of state_file.h says, in the place of the last bytes.
inline std::string WithChecksum(std::string bytes) {
  std::uint64_t hash = 0xcbf29ce484222325;
  bytes.resize(bytes.size() - kStateChecksum);
  for (const char c : bytes) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3;
  return bytes + Bytes(hash);
}

// Numbers and poses as bits.
template <class Number>
std::string Bits(Number number) {
  return Bytes(number);
}
inline std::string Bits(FactorId id) { return Bits(id.value); }
inline std::string Bits(PoseId id) { return Bits(id.value); }
inline std::string Bits(const SE2& T) {
  return Bits(T.Translation().x()) + Bits(T.Translation().y()) + Bits(T.Theta());
}
inline std::string Bits(const SE3& T) {
  std::string out;
  for (int i = 0; i < 3; ++i) out += Bits(T.Translation()[i]);
  for (int i = 0; i < 4; ++i) out += Bits(T.Rotation().Unit().coeffs()[i]);
  return out;
}
template <class T>
std::string Bits(const std::optional<T>& value) {
  return value ? "+" + Bits(*value) : "-";
}

// The cause that a file is refused for, "" if it is not.
template <class State>
std::string LoadError(const std::string& path) {
  try {
    State::Load(path);
  } catch (const FileError& error) {
    EXPECT_EQ(error.path(), path);
    EXPECT_EQ(std::string(error.what()).rfind(path + ": ", 0), 0u) << error.what();
    return error.cause();
  }
  return "";
}

}  // namespace terse::testing
