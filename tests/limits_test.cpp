// What readers take at most, and that they take no more than a file holds.

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <string>
#include <thread>

#include "terse/core/graph_file.h"
#include "terse/core/measurement_line.h"
#include "terse/core/read_file.h"
#include "terse/core/state_file.h"
#include "terse/core/text_lines.h"
#include "terse/core/trajectory.h"
#include "testing_files.h"

namespace terse {
namespace {

template <class Work>
void ExpectRefused(const Work& work, const std::string& path, long line, const std::string& cause) {
  try {
    work();
    ADD_FAILURE() << path << " was taken, expected: " << cause;
  } catch (const FileError& error) {
    EXPECT_EQ(error.path(), path);
    EXPECT_EQ(error.line(), line) << error.what();
    EXPECT_NE(error.cause().find(cause), std::string::npos) << error.what();
  }
}

std::string Chain(int poses) {
  std::string out;
  for (int k = 0; k + 1 < poses; ++k) {
    out += "EDGE_SE2 " + std::to_string(k) + ' ' + std::to_string(k + 1) + " 1 0 0 1 0 0 1 0 1\n";
  }
  return out;
}

std::string FixOfAll(int poses) {
  std::string out = "FIX";
  for (int k = 0; k < poses; ++k) out += ' ' + std::to_string(k);
  return out;
}

TEST(LimitsTest, FixOfAnyNumberOfPoses) {
  for (const int poses : {39, 40, 41, 60, 5000}) {
    const TestFile file("fix.g2o", Chain(poses) + FixOfAll(poses) + '\n');
    const auto graph = ReadPoseGraph<SE2>(file.Path());
    for (const auto& pose : graph.Poses()) EXPECT_TRUE(pose.fixed) << poses << ": " << pose.id.value;
    MeasurementLineReader<SE2> reader("stream", {});
    const auto fix = std::get<FixLine>(reader.Read(FixOfAll(poses), 1));
    ASSERT_EQ(fix.poses.size(), static_cast<std::size_t>(poses));
    EXPECT_EQ(fix.poses.back().value, poses - 1);
  }
  const TestFile unknown("unknown.g2o", Chain(60) + FixOfAll(60) + " 77\n");
  ExpectRefused([&] { ReadGraph(unknown.Path()); }, unknown.Path(), 60, "FIX of pose 77");
  const TestFile word("word.g2o", Chain(60) + FixOfAll(60) + " abc\n");
  ExpectRefused([&] { ReadGraph(word.Path()); }, word.Path(), 60, "field 62 (id) reads \"abc\"");
}

TEST(LimitsTest, FieldsBeyondTheLineAreNone) {
  const std::string path = "here", text = FixOfAll(50);
  Fields fields(path);
  fields.Split({1, text});
  EXPECT_EQ(fields.Text(50), "49");
  EXPECT_THROW(fields.Text(51), std::out_of_range);
  EXPECT_THROW(fields.Text(-1), std::out_of_range);
  fields.Split({2, "one two"});  // nothing of the longer line is left
  EXPECT_EQ(fields.Text(1), "two");
  EXPECT_THROW(fields.Text(2), std::out_of_range);
  EXPECT_THROW(fields.Text(45), std::out_of_range);
}

TEST(LimitsTest, FilesUpToTheLimit) {
  ReadLimits limits;
  limits.most_bytes = 100000;
  const TestFile file("full", std::string(100000, 'x')), larger("larger", std::string(100001, 'x'));
  EXPECT_EQ(ReadAll(file.Path(), limits), file.Content());
  ExpectRefused([&] { ReadAll(larger.Path(), limits); }, larger.Path(), 0, "expected at most 100000 bytes");
  limits.most_bytes = 100001;
  EXPECT_EQ(ReadAll(larger.Path(), limits).size(), 100001u);
}

// What the file system claims costs neither time nor memory.
TEST(LimitsTest, FileBeyondTheLimitIsRefusedUnread) {
  const TestFile file("sparse", "VERTEX_SE2 0 0 0 0\n");
  // As much as is refused on this machine, and no more: any file system takes it.
  const auto bytes = static_cast<off_t>(std::max(MostGraphBytes(), kMostFileBytes) + 1);
  ASSERT_EQ(truncate(file.Path().c_str(), bytes), 0) << std::strerror(errno);
  ExpectRefused([&] { ReadGraph(file.Path()); }, file.Path(), 0, "too large or has no end");
  ExpectRefused([&] { ReadTrajectory(file.Path()); }, file.Path(), 0, "too large or has no end");
  ExpectRefused([&] { StateReader(file.Path(), "any"); }, file.Path(), 0, "too large or has no end");
}

// A graph file is read in pieces, not whole: what it says takes memory, its text does not.
TEST(LimitsTest, TextBesideAGraphTakesNoMemory) {
  const std::string path = testing::DiskFolder() + "/limits_test_comments.g2o";
  {
    std::ofstream file(path);
    file << Chain(3);
    const std::string line = "# " + std::string(1021, 'x') + '\n';
    for (int k = 0; k < 200 << 10; ++k) file << line;
  }
  const auto peak_mebibytes = [] {
    rusage usage{};
    getrusage(RUSAGE_SELF, &usage);
    return usage.ru_maxrss / 1024;
  };
  const long before = peak_mebibytes();
  const std::size_t poses = ReadPoseGraph<SE2>(path).Poses().size();
  const long growth = peak_mebibytes() - before;
  std::remove(path.c_str());
  EXPECT_EQ(poses, 3u);
  EXPECT_LT(growth, 40) << "MiB, of a file of 200";
}

// As a text that is no graph has.
TEST(LimitsTest, SoManyUnknownTags) {
  const auto with_tags = [](int count) {
    std::string out = Chain(3);
    for (int k = 0; k < count; ++k) out += "TAG_" + std::to_string(k) + " 1\n";
    return out;
  };
  const TestFile most("most.g2o", with_tags(1000)), more("more.g2o", with_tags(1005));
  EXPECT_EQ(ReadGraph(most.Path()).skipped_tags.size(), 1000u);
  ExpectRefused([&] { ReadGraph(more.Path()); }, more.Path(), 1003, "kinds that are not known, the last \"TAG_1000\"");
}

TEST(LimitsTest, EndlessInputsAreRefusedAtTheirStart) {
  for (const std::string path : {"/dev/zero", "/dev/urandom"}) {
    EXPECT_THROW(ReadGraph(path), FileError);
    EXPECT_THROW(ReadTrajectory(path), FileError);
    ExpectRefused([&] { StateReader(path, "any"); }, path, 0, "not a saved state");
  }
  ExpectRefused([] { ReadGraph("/dev/zero"); }, "/dev/zero", 1, "a binary file (it holds a zero byte)");
  ExpectRefused([] { ReadText("/dev/zero"); }, "/dev/zero", 1, "a binary file (it holds a zero byte)");
  ReadLimits limits;
  limits.most_bytes = 1 << 20;
  ExpectRefused([&] { ReadAll("/dev/zero", limits); }, "/dev/zero", 0, "expected at most 1 MiB");
}

TEST(LimitsTest, PipesAreReadToTheirEndOrTheLimit) {
  const TestFile pipe("pipe");
  ASSERT_EQ(mkfifo(pipe.Path().c_str(), 0600), 0);
  for (const std::size_t size : {std::size_t{0}, std::size_t{10}, std::size_t{300000}}) {
    std::thread writer([&] { std::ofstream(pipe.Path()) << std::string(size, 'x'); });
    EXPECT_EQ(ReadAll(pipe.Path()).size(), size);
    writer.join();
  }
}

TEST(LimitsTest, LinesUpToTheLimit) {
  const std::string comment = '#' + std::string(kMostLineBytes - 1, 'x') + '\n';
  const TestFile longest("longest.g2o", Chain(3) + comment), longer("longer.g2o", Chain(3) + 'x' + comment);
  EXPECT_EQ(ReadPoseGraph<SE2>(longest.Path()).Poses().size(), 3u);
  ExpectRefused([&] { ReadGraph(longer.Path()); }, longer.Path(), 3, "expected at most 16777216");
}

TEST(LimitsTest, SmallMachinesTakeLess) {
  EXPECT_GT(UsableMemory(), std::uint64_t{1} << 20);
  EXPECT_EQ(MostFileBytes(5 << 20, 1), std::min<std::uint64_t>(5 << 20, UsableMemory() >> 20 << 20));
  EXPECT_EQ(MostFileBytes(kMostFileBytes, UsableMemory() / (3 << 20)), 3u << 20);
  EXPECT_EQ(MostFileBytes(kMostFileBytes, UsableMemory()), 1u << 20) << "enough for a map all the same";
}

}  // namespace
}  // namespace terse
