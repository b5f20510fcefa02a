#pragma once
// The most that is taken from outside. What is beyond is refused with a FileError before memory is spent on it;
// docs/reliability.md has the table.

#include <cstddef>
#include <cstdint>

namespace terse {

// A line of a text file or of a stream, in bytes without its end.
inline constexpr std::size_t kMostLineBytes = std::size_t{16} << 20;
// A text file but that of a graph, a saved state or a journal. Less where the machine is small: see MostFileBytes().
inline constexpr std::uint64_t kMostFileBytes = std::uint64_t{4} << 30;
// A JSON file, which takes about 30 times its size in memory at worst.
inline constexpr std::uint64_t kMostJsonBytes = std::uint64_t{1} << 30;
// Lists and objects within each other.
inline constexpr int kMostJsonDepth = 100;
// A compressed image, and its pixels: more than any camera has, and no gigabyte of memory.
inline constexpr std::uint64_t kMostImageBytes = std::uint64_t{256} << 20;
inline constexpr std::uint64_t kMostImagePixels = std::uint64_t{1} << 26;
// Of its pixels as they are stored before compression: 2^26 of 16 bits, or 2^25 in colour with transparency.
inline constexpr std::uint64_t kMostDecodedBytes = std::uint64_t{1} << 27;

// What a process may use: the machine's memory, or less by the limits of its control group and RLIMIT_AS. Bytes.
std::uint64_t UsableMemory();
// What of it is not in use now, but for the system's copies of files.
std::uint64_t FreeMemory();
// The text of a graph, which is read in pieces: twice the usable memory, as the graph takes more than half of its text.
std::uint64_t MostGraphBytes();
// `limit`, or a share of the usable memory if that is less.
std::uint64_t MostFileBytes(std::uint64_t limit, std::uint64_t share_of_memory);

}  // namespace terse
