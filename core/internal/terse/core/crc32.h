#pragma once
// The checksum of IEEE 802.3, as zip files and the journal have it.

#include <array>
#include <cstdint>
#include <string_view>

namespace terse {

// Of bytes that follow those whose checksum is `before`.
inline std::uint32_t Crc32(std::string_view bytes, std::uint32_t before = 0) {
  static const std::array<std::uint32_t, 256> table = [] {
    std::array<std::uint32_t, 256> out{};
    for (std::uint32_t k = 0; k < out.size(); ++k) {
      std::uint32_t crc = k;
      for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1u) != 0 ? 0xEDB88320u : 0u);
      out[k] = crc;
    }
    return out;
  }();
  std::uint32_t crc = ~before;
  for (const char c : bytes) crc = (crc >> 8) ^ table[(crc ^ static_cast<unsigned char>(c)) & 255u];
  return ~crc;
}

}  // namespace terse
