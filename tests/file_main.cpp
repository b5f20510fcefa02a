// The main() of tests that are several files in one program: --file=NAME runs those of one file.

#include <gtest/gtest.h>

#include <filesystem>
#include <iostream>
#include <string>

namespace {

// Of all tests of a file, as GoogleTest's filters are written. Empty if there are none.
std::string FilterOf(const std::string& file) {
  std::string out;
  const testing::UnitTest& all = *testing::UnitTest::GetInstance();
  for (int s = 0; s < all.total_test_suite_count(); ++s) {
    const testing::TestSuite& suite = *all.GetTestSuite(s);
    for (int t = 0; t < suite.total_test_count(); ++t) {
      const testing::TestInfo& test = *suite.GetTestInfo(t);
      if (std::filesystem::path(test.file()).filename() != file) continue;
      out += (out.empty() ? "" : ":") + std::string(suite.name()) + '.' + test.name();
    }
  }
  return out;
}

}  // namespace

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  const std::string option = "--file=", given = argc == 2 ? argv[1] : "";
  if (argc > 2 || (argc == 2 && given.rfind(option, 0) != 0)) {
    std::cerr << argv[0] << ": unknown argument " << argv[1] << ", expected --file=NAME\n";
    return 2;
  }
  if (argc == 2) {
    const std::string filter = FilterOf(given.substr(option.size()));
    if (filter.empty()) {
      std::cerr << argv[0] << ": no tests of " << given.substr(option.size()) << '\n';
      return 2;
    }
    // What is to be left out (GTEST_FILTER=-...) stays out; other filters choose among all files and do without --file.
    const std::string before = testing::GTEST_FLAG(filter);
    testing::GTEST_FLAG(filter) = filter + (before.rfind('-', 0) == 0 ? before : "");
  }
  return RUN_ALL_TESTS();
}
