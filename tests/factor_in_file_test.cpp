// A factor whose panels are in a file is the one in memory, to the last bit, and nothing is lost where there is no
// file.

#include <gtest/gtest.h>
#include <linux/magic.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <string>

#include "terse/core/batch_solver.h"
#include "terse/core/error.h"
#include "terse/core/front_paths.h"
#include "terse/core/limits.h"
#include "testing_factor.h"
#include "testing_files.h"
#include "testing_scene.h"

namespace terse {
namespace {

using testing::DiskFolder;
using testing::Random;
using testing::RandomFactor;

// TMPDIR for the life of this.
class TemporaryFolder {
 public:
  explicit TemporaryFolder(const std::string& folder) {
    if (const char* before = std::getenv("TMPDIR")) before_ = before;
    setenv("TMPDIR", folder.c_str(), 1);
  }
  ~TemporaryFolder() { before_ ? setenv("TMPDIR", before_->c_str(), 1) : unsetenv("TMPDIR"); }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

 private:
  std::optional<std::string> before_;
};

class FactorInFile : public ::testing::Test {
  TemporaryFolder on_disk_{DiskFolder()};
};

// A chain with loops, seeded.
template <int B>
typename BlockCholesky<B>::Changes ChainWithLoops(int variables, std::uint64_t seed) {
  Random rng(seed);
  typename BlockCholesky<B>::Changes all;
  all.new_variables = variables;
  for (int v = 0; v < variables; ++v) all.added.push_back(RandomFactor<B>(rng, v, -1));
  for (int v = 1; v < variables; ++v) {
    all.added.push_back(RandomFactor<B>(rng, v - 1, v));
    const int far = static_cast<int>(rng() % static_cast<std::uint64_t>(v));
    if (v % 3 == 0 && far != v) all.added.push_back(RandomFactor<B>(rng, far, v));
  }
  return all;
}

template <int B>
std::vector<double> InverseTimesOnes(const BlockCholesky<B>& factor) {
  std::vector<double> X(static_cast<std::size_t>(factor.Variables() * B * internal::Stride(1)), 1.0);
  internal::SolveDense(factor.Tree(), X, internal::Stride(1));
  return X;
}

template <int B>
void ExpectSameInFile(int threads, std::uint64_t seed) {
  SCOPED_TRACE("B " + std::to_string(B) + ", threads " + std::to_string(threads) + ", seed " + std::to_string(seed));
  const int variables = B == 3 ? 1600 : 800;  // enough for threads to be woken
  const auto all = ChainWithLoops<B>(variables, seed);
  typename BlockCholesky<B>::Changes late;
  Random rng(seed + 1);
  late.added.push_back(RandomFactor<B>(rng, 3, variables - 10));
  const std::vector<double> damping(static_cast<std::size_t>(variables * B), 0.1);
  BlockCholesky<B> in_memory, in_file;
  in_memory.DropUpdateMatrices(std::uint64_t{1} << 40);
  in_file.DropUpdateMatrices(1);
  in_file.SetThreads(threads);
  const auto expect_same = [&] {
    EXPECT_EQ(in_memory.BytesInFile(), 0u);
    EXPECT_GE(in_file.BytesInFile(), sizeof(double) * static_cast<std::uint64_t>(in_file.Nonzeros()));
    in_memory.Solve();
    in_file.Solve();
    EXPECT_EQ(in_file.Solution(), in_memory.Solution());
    EXPECT_EQ(in_file.LogDeterminant(), in_memory.LogDeterminant());
    EXPECT_EQ(InverseTimesOnes(in_file), InverseTimesOnes(in_memory));
  };
  const auto report = in_file.Update(all);
  ASSERT_TRUE(in_memory.Update(all).ok && report.ok);
  EXPECT_GT(report.flops, 4e7);
  expect_same();
  const BlockCholesky<B> copy = in_file;
  const std::vector<double> before = InverseTimesOnes(copy);
  EXPECT_EQ(copy.BytesInFile(), 0u);
  ASSERT_TRUE(in_memory.Refactor(damping) && in_file.Refactor(damping));
  expect_same();
  EXPECT_EQ(InverseTimesOnes(copy), before);
  ASSERT_TRUE(in_memory.Refactor() && in_file.Refactor());
  expect_same();
  EXPECT_EQ(InverseTimesOnes(in_file), before);
  ASSERT_TRUE(in_memory.Update(late).ok && in_file.Update(late).ok);
  expect_same();
}

TEST_F(FactorInFile, IsTheSameToTheLastBit) {
  for (const int threads : {1, 3}) {
    ExpectSameInFile<3>(threads, 5);
    ExpectSameInFile<6>(threads, 6);
  }
}

TEST_F(FactorInFile, AnUpdateThatFailsChangesNothing) {
  BlockCholesky<3> factor;
  factor.DropUpdateMatrices(1);
  ASSERT_TRUE(factor.Update(ChainWithLoops<3>(200, 8)).ok);
  const std::vector<double> before = InverseTimesOnes(factor);
  BlockCholesky<3>::Changes bad;
  bad.new_variables = 1;  // that nothing measures
  EXPECT_FALSE(factor.Update(bad).ok);
  EXPECT_EQ(InverseTimesOnes(factor), before);
  Random rng(9);
  BlockCholesky<3>::Changes good;
  good.added.push_back(RandomFactor<3>(rng, 5, 150));
  {
    const TemporaryFolder missing("/no/such/folder");
    EXPECT_THROW((void)factor.Update(good), FileError);
  }
  EXPECT_EQ(InverseTimesOnes(factor), before);
  ASSERT_TRUE(factor.Update(good).ok);
  EXPECT_NE(InverseTimesOnes(factor), before);
}

// Files of this process may have so many bytes while this lives.
class FileLimit {
 public:
  explicit FileLimit(rlim_t bytes) : handler_(::signal(SIGXFSZ, SIG_IGN)) {
    ::getrlimit(RLIMIT_FSIZE, &before_);
    rlimit small = before_;
    small.rlim_cur = bytes;
    ::setrlimit(RLIMIT_FSIZE, &small);
  }
  ~FileLimit() {
    ::setrlimit(RLIMIT_FSIZE, &before_);
    ::signal(SIGXFSZ, handler_);
  }
  FileLimit(const FileLimit&) = delete;
  FileLimit& operator=(const FileLimit&) = delete;

 private:
  rlimit before_{};
  void (*handler_)(int);
};

template <class Work>
FileError ErrorOf(const Work& work) {
  try {
    work();
  } catch (const FileError& error) {
    return error;
  }
  ADD_FAILURE() << "no error";
  return FileError("", 0, "");
}

TEST_F(FactorInFile, NoRoomIsAnErrorThatSaysWhere) {
  BlockCholesky<6> factor;
  factor.DropUpdateMatrices(1);
  const FileError error = [&] {
    const FileLimit limit(4096);
    return ErrorOf([&] { (void)factor.Update(ChainWithLoops<6>(200, 3)); });
  }();
  EXPECT_EQ(error.path(), DiskFolder());
  for (const char* part : {"cannot store the factor, ", " MiB", "File too large", "TMPDIR"}) {
    EXPECT_NE(error.cause().find(part), std::string::npos) << error.what();
  }
  EXPECT_EQ(factor.Variables(), 0);
}

BlockCholesky<6> StoredFactor(int threads) {
  BlockCholesky<6> factor;
  factor.DropUpdateMatrices(1);
  factor.SetThreads(threads);
  EXPECT_TRUE(factor.Update(ChainWithLoops<6>(800, 3)).ok);
  return factor;
}

// From whichever thread: the next factorisation that succeeds is right again.
TEST_F(FactorInFile, AWriteThatFailsIsAnError) {
  for (const int threads : {1, 3}) {
    BlockCholesky<6> factor = StoredFactor(threads);
    const std::vector<double> before = InverseTimesOnes(factor);
    {
      const FileLimit limit(4096);
      EXPECT_NE(ErrorOf([&] { (void)factor.Refactor(); }).cause().find("File too large"), std::string::npos);
    }
    ASSERT_TRUE(factor.Refactor());
    EXPECT_EQ(InverseTimesOnes(factor), before);
  }
}

// Not positive definite at a leaf: the fronts above it take no memory.
TEST_F(FactorInFile, ARefactorThatFailsAllocatesNoMore) {
  for (const int threads : {1, 3}) {
    BlockCholesky<6> factor = StoredFactor(threads);
    const auto places = [&] {
      std::map<int, const double*> out;
      factor.Tree().ForEach([&](int id, const internal::Front<6>& front) { out[id] = front.panel.Numbers(); });
      return out;
    };
    const auto in_file = places();
    const std::vector<double> before = InverseTimesOnes(factor);
    EXPECT_FALSE(factor.Refactor(std::vector<double>(4800, -1e9)));
    EXPECT_EQ(places(), in_file);
    ASSERT_TRUE(factor.Refactor());
    EXPECT_EQ(InverseTimesOnes(factor), before);
  }
}

long MappingsOfDeletedFiles() {
  std::ifstream maps("/proc/self/maps");
  long count = 0;
  for (std::string line; std::getline(maps, line);) count += line.find("(deleted)") != std::string::npos ? 1 : 0;
  return count;
}

// The file has no name, and goes with the factor.
TEST_F(FactorInFile, LeavesNothingBehind) {
  std::string name = DiskFolder() + "/terse_factor_XXXXXX";
  ASSERT_NE(mkdtemp(name.data()), nullptr);
  const TemporaryFolder chosen(name);
  const long before = MappingsOfDeletedFiles();
  {
    BlockCholesky<3> factor;
    factor.DropUpdateMatrices(1);
    ASSERT_TRUE(factor.Update(ChainWithLoops<3>(200, 4)).ok);
    EXPECT_GT(factor.BytesInFile(), 0u);
    EXPECT_TRUE(std::filesystem::is_empty(name));
    EXPECT_GT(MappingsOfDeletedFiles(), before);
  }
  EXPECT_EQ(MappingsOfDeletedFiles(), before);
  std::filesystem::remove(name);
}

// A folder that is in memory is no place for what memory should not hold.
TEST_F(FactorInFile, AFolderInMemoryIsRefused) {
  struct statfs status {};
  ASSERT_EQ(::statfs("/dev/shm", &status), 0);
  ASSERT_EQ(status.f_type, TMPFS_MAGIC);
  const TemporaryFolder chosen("/dev/shm");
  BlockCholesky<3> factor;
  factor.DropUpdateMatrices(1);
  EXPECT_NE(ErrorOf([&] { (void)factor.Update(ChainWithLoops<3>(200, 4)); }).cause().find("is in memory itself"),
            std::string::npos);
}

// 100 MiB, with nothing asked for.
TEST_F(FactorInFile, ByDefaultWhereMoreThanHalfOfTheFreeMemoryWouldGo) {
  constexpr std::size_t kNumbers = std::size_t{100} << 17;
  const auto free_250 = [] { return std::uint64_t{250} << 20; };
  const auto free_150 = [] { return std::uint64_t{150} << 20; };
  const auto free_50 = [] { return std::uint64_t{50} << 20; };
  EXPECT_EQ(internal::OpenPanelFile(kNumbers, 0, free_250), nullptr);
  EXPECT_NE(internal::OpenPanelFile(kNumbers, 0, free_150), nullptr);
  EXPECT_EQ(internal::OpenPanelFile(kNumbers / 2, 0, free_50), nullptr) << "so little stays in memory";
  const TemporaryFolder missing("/no/such/folder");
  EXPECT_EQ(internal::OpenPanelFile(kNumbers, 0, free_150), nullptr) << "memory has room";
  EXPECT_THROW(internal::OpenPanelFile(kNumbers, 0, free_50), FileError);
  EXPECT_THROW(internal::OpenPanelFile(kNumbers, 1, free_250), FileError) << "it was asked for";
}

TEST_F(FactorInFile, BatchIsTheSame) {
  const PoseGraph<SE3> graph = testing::MakeScene<SE3>(Scene::kSphere, 300).graph;
  BatchOptions in_file;
  in_file.most_factor_bytes = 1;
  const auto found = SolveBatch(graph, in_file), expected = SolveBatch(graph);
  EXPECT_EQ(expected.cholesky.BytesInFile(), 0u);
  EXPECT_GT(found.cholesky.BytesInFile(), 0u);
  EXPECT_EQ(found.chi2, expected.chi2);
  EXPECT_EQ(found.iterations, expected.iterations);
  for (std::size_t k = 0; k < found.T_world_body.size(); ++k) {
    EXPECT_EQ(found.T_world_body[k].Translation(), expected.T_world_body[k].Translation());
  }
}

TEST_F(FactorInFile, FreeMemoryIsWhatIsLeft) {
  constexpr std::uint64_t kMebibyte = std::uint64_t{1} << 20;
  constexpr std::uint64_t kGivenBack = 16 * kMebibyte;  // by the allocator, between two looks
  EXPECT_LT(FreeMemory(), UsableMemory());
  std::ifstream statm("/proc/self/statm");
  std::uint64_t pages = 0;
  statm >> pages;
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_AS, &before), 0);
  rlimit small = before;
  small.rlim_cur = pages * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE)) + 600 * kMebibyte;
  ASSERT_EQ(::setrlimit(RLIMIT_AS, &small), 0);
  const std::uint64_t free = FreeMemory();
  const std::vector<char> taken(200 * kMebibyte, 1);
  const std::uint64_t left = FreeMemory();
  ::setrlimit(RLIMIT_AS, &before);
  EXPECT_LE(free, 600 * kMebibyte + kGivenBack);
  EXPECT_LE(left, 400 * kMebibyte + kGivenBack) << taken.back();
  EXPECT_GT(left, 100 * kMebibyte);
}

}  // namespace
}  // namespace terse
