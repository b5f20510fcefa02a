#pragma once
// Indices into vectors: ids are int, as Eigen's and the files' are.

#include <cstddef>

namespace terse::internal {

constexpr std::size_t At(int i) { return static_cast<std::size_t>(i); }

}  // namespace terse::internal
