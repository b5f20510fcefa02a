#include <filesystem>
#include <iostream>

#include "bench_report.h"

int main(int argc, char** argv) {
  try {
    return terse::bench::Main(argc, argv);
  } catch (const std::exception& error) {
    std::cerr << std::filesystem::path(argv[0]).filename().string() << ": " << error.what() << '\n';
    return 1;
  }
}
