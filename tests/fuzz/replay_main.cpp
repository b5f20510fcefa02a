// Fuzzers without libFuzzer: the inputs of a folder one after the other, then changes to them by text_mutator.h. It
// finds less than a fuzzer that sees which branches were taken, but runs with every compiler, and the code as it is
// installed.
//
//   replay_NAME FOLDER [INPUTS [SEED]]: so many changed inputs

#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <iostream>

#include "fuzzing.h"
#include "text_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

constexpr std::size_t kMostBytes = 20000, kMostChanges = 4;
constexpr double kMostSeconds = 10;

double slowest = 0;

void Try(const std::string& input) {
  const auto begin = std::chrono::steady_clock::now();
  LLVMFuzzerTestOneInput(reinterpret_cast<const std::uint8_t*>(input.data()), input.size());
  slowest = std::max(slowest, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) return 2;
  std::vector<std::string> paths, inputs;
  for (const auto& entry : std::filesystem::directory_iterator(argv[1])) paths.push_back(entry.path().string());
  std::sort(paths.begin(), paths.end());
  for (const std::string& path : paths) inputs.push_back(terse::fuzz::Content(path));
  if (inputs.empty()) return 2;
  for (const std::string& input : inputs) Try(input);
  const long count = argc > 2 ? std::atol(argv[2]) : 0;
  std::mt19937_64 random(argc > 3 ? std::strtoull(argv[3], nullptr, 10) : 1);
  std::string input;
  for (long k = 0; k < count; ++k) {
    // Damage to a seed, or more damage to what came of it.
    if (random() % kMostChanges == 0 || input.size() > kMostBytes) input = inputs[random() % inputs.size()];
    input = terse::fuzz::MutateText(std::move(input), random);
    Try(input);
  }
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  std::cout << inputs.size() << " inputs and " << count << " changes to them, the slowest took " << slowest
            << " s, memory " << usage.ru_maxrss / 1024 << " MiB\n";
  return slowest < kMostSeconds ? 0 : 1;
}
