// For fuzzers of text: every other change is one of text_mutator.h, the others are libFuzzer's own.

#include <algorithm>
#include <cstdint>
#include <cstring>

#include "text_mutator.h"

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t most);

extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t most,
                                               unsigned int seed) {
  if (seed % 2 == 0) return LLVMFuzzerMutate(data, size, most);
  std::mt19937_64 random(seed);
  std::string text(reinterpret_cast<const char*>(data), size);
  for (std::uint64_t k = 1 + random() % 3; k > 0; --k) text = terse::fuzz::MutateText(std::move(text), random);
  const std::size_t out = std::min(text.size(), most);
  std::memcpy(data, text.data(), out);
  return out;
}
