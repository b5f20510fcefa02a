#include "terse/core/atomic_file.h"
#include "terse/core/number_text.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <random>

namespace terse {
namespace {

namespace fs = std::filesystem;

class AtomicFileTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::path(::testing::TempDir()) / ("terse_atomic_" + std::to_string(::getpid()));
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string At(const std::string& name) const { return (folder_ / name).string(); }
  static void Put(const std::string& path, const std::string& text) { std::ofstream(path) << text; }
  static std::string Get(const std::string& path) {
    std::ostringstream out;
    out << std::ifstream(path).rdbuf();
    return out.str();
  }
  std::size_t Files() const {
    return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder_), fs::directory_iterator()));
  }
  static std::string Refusal(const std::string& path) {
    try {
      AtomicFile file(path);
    } catch (const FileError& error) {
      EXPECT_EQ(error.line(), 0);
      return error.what();
    }
    return "accepted";
  }
  fs::path folder_;
};

TEST_F(AtomicFileTest, AppearsOnlyWithCommit) {
  const std::string path = At("out");
  Put(path, "old");
  {
    AtomicFile file(path);
    file.Stream() << "new " << 1234.5;
    file.Stream().flush();
    EXPECT_EQ(Get(path), "old");
    file.Commit();
    EXPECT_EQ(Get(path), "new 1234.5");
  }
  {
    AtomicFile abandoned(path);
    abandoned.Stream() << "half";
  }
  EXPECT_EQ(Get(path), "new 1234.5");
  EXPECT_EQ(Files(), 1u) << "a temporary was left";
}

TEST_F(AtomicFileTest, KeepsPermissionsAndLinks) {
  Put(At("target"), "old");
  fs::permissions(At("target"), fs::perms(0640));
  fs::create_symlink("target", At("link"));
  AtomicFile file(At("link"));
  file.Stream() << "new";
  file.Commit();
  EXPECT_TRUE(fs::is_symlink(At("link")));
  EXPECT_EQ(Get(At("target")), "new");
  EXPECT_EQ(fs::status(At("target")).permissions(), fs::perms(0640));
}

TEST_F(AtomicFileTest, TakesAwayWhatAKilledProcessLeftAndNothingElse) {
  const pid_t child = ::fork();
  if (child == 0) {
    AtomicFile file(At("out"));
    file.Stream() << "half" << std::flush;
    ::raise(SIGKILL);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  ASSERT_EQ(Files(), 1u) << "the killed process left its temporary";
  Put(At("out.tmp-mine"), "a user's");
  Put(At("out2.tmp-0123456789abcdef"), "of another file");
  AtomicFile first(At("out")), second(At("out"));  // the second does not take the first for abandoned
  first.Stream() << "first";
  second.Stream() << "second";
  first.Commit();
  EXPECT_EQ(Get(At("out")), "first");
  second.Commit();
  EXPECT_EQ(Get(At("out")), "second");
  EXPECT_EQ(Files(), 3u);
  EXPECT_EQ(Get(At("out2.tmp-0123456789abcdef")), "of another file");
}

TEST_F(AtomicFileTest, SaysWhyAFileCannotBeWritten) {
  Put(At("file"), "");
  fs::create_symlink("nowhere", At("dangling"));
  EXPECT_NE(Refusal(At("missing/out")).find("the folder " + At("missing") + " does not exist"), std::string::npos);
  EXPECT_NE(Refusal(folder_.string()).find("is a folder"), std::string::npos);
  EXPECT_NE(Refusal(At("file/out")).find("is not a folder"), std::string::npos);
  EXPECT_NE(Refusal(At("dangling")).find("symbolic link"), std::string::npos);
  EXPECT_NE(Refusal("").find("without a name"), std::string::npos);
  EXPECT_EQ(Files(), 2u);
}

TEST_F(AtomicFileTest, AFullDiskIsAnError) {
  ASSERT_TRUE(fs::exists("/dev/full"));
  AtomicFile file("/dev/full");
  file.Stream() << "text";
  EXPECT_THROW(file.Commit(), FileError);
}

TEST_F(AtomicFileTest, APipeIsWrittenDirectly) {
  ASSERT_EQ(::mkfifo(At("pipe").c_str(), 0600), 0);
  const pid_t reader = ::fork();
  if (reader == 0) ::_exit(Get(At("pipe")) == "text" ? 0 : 1);
  {
    AtomicFile file(At("pipe"));
    file.Stream() << "text";
    file.Commit();
  }
  int status = -1;
  ::waitpid(reader, &status, 0);
  EXPECT_EQ(status, 0);
  EXPECT_TRUE(fs::is_fifo(At("pipe")));
}

TEST_F(AtomicFileTest, StandardOutputGoesToItsDescriptor) {
  const pid_t child = ::fork();
  if (child == 0) {
    std::freopen(At("stdout").c_str(), "w", stdout);
    std::printf("before ");
    std::fflush(stdout);
    AtomicFile file("/dev/stdout");
    file.Stream() << "text";
    file.Commit();
    std::printf(" after");
    std::fflush(stdout);
    ::_exit(0);
  }
  int status = -1;
  ::waitpid(child, &status, 0);
  EXPECT_EQ(Get(At("stdout")), "before text after");
}

TEST_F(AtomicFileTest, ASignalHandlerRemovesAllTemporaries) {
  const pid_t child = ::fork();
  if (child == 0) {
    std::vector<std::unique_ptr<AtomicFile>> files;
    for (int i = 0; i < 10; ++i) files.push_back(std::make_unique<AtomicFile>(At("out" + std::to_string(i))));
    files[3]->Stream() << "done";
    files[3]->Commit();
    files[4].reset();
    RemoveUncommittedFiles();
    ::_exit(0);
  }
  int status = -1;
  ::waitpid(child, &status, 0);
  EXPECT_EQ(Files(), 1u);
  EXPECT_EQ(Get(At("out3")), "done");
}

TEST_F(AtomicFileTest, SlotsAreUsedAgain) {
  for (int i = 0; i < 300; ++i) {
    AtomicFile file(At("out"));
    if (i % 2 == 0) file.Commit();
  }
  const pid_t child = ::fork();
  if (child == 0) {
    AtomicFile file(At("other"));
    RemoveUncommittedFiles();
    ::_exit(0);
  }
  int status = -1;
  ::waitpid(child, &status, 0);
  EXPECT_EQ(Files(), 1u) << "the table of temporaries was full";
}

TEST(ShortestTest, ReadsBackToTheBit) {
  std::mt19937_64 random(31);
  for (int i = 0; i < 100000; ++i) {
    const std::uint64_t bits = random();
    double value = 0;
    std::memcpy(&value, &bits, sizeof(value));
    if (!std::isfinite(value)) continue;
    const std::string text = Shortest(value);
    double back = 0;
    std::from_chars(text.data(), text.data() + text.size(), back);
    ASSERT_EQ(std::memcmp(&value, &back, sizeof(value)), 0) << text;
  }
  EXPECT_EQ(Shortest(0.1), "0.1");
  EXPECT_EQ(Shortest(-0.0), "-0");
  EXPECT_EQ(Shortest(1), "1");
  EXPECT_EQ(Shortest(-std::numeric_limits<double>::quiet_NaN()), "nan");
  EXPECT_EQ(Shortest(-std::numeric_limits<double>::infinity()), "-inf");
}

}  // namespace
}  // namespace terse
