#pragma once
// Files of a test: named after it, so that tests can run at once, and removed at its end.

#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

namespace terse {

namespace testing {
// That of the program at hand, for large temporary files: /tmp and /var/tmp may be in memory.
inline std::string DiskFolder() { return std::filesystem::read_symlink("/proc/self/exe").parent_path().string(); }
}  // namespace testing

class TestFile {
 public:
  explicit TestFile(const std::string& name)
      : path_(::testing::TempDir() + "terse_" + std::to_string(::getpid()) + "_" + name) {}
  TestFile(const std::string& name, const std::string& content) : TestFile(name) {
    std::ofstream(path_, std::ios::binary) << content;
  }
  ~TestFile() { std::remove(path_.c_str()); }
  TestFile(const TestFile&) = delete;
  TestFile& operator=(const TestFile&) = delete;
  const std::string& Path() const { return path_; }
  std::string Content() const {
    std::ostringstream out;
    out << std::ifstream(path_, std::ios::binary).rdbuf();
    return out.str();
  }

 private:
  std::string path_;
};

}  // namespace terse
