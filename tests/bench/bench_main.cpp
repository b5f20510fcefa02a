#include <filesystem>
#include <iostream>

#include "bench_report.h"
#include "terse/core/freed_memory.h"

int main(int argc, char** argv) {
  terse::KeepFreedMemory();  // as the command does; Ceres and CHOLMOD have the same memory
  try {
    return terse::bench::Main(argc, argv);
  } catch (const std::exception& error) {
    std::cerr << std::filesystem::path(argv[0]).filename().string() << ": " << error.what() << '\n';
    return 1;
  }
}
