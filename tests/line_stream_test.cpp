// Files line by line: the lines that a file read whole has.

#include "terse/core/line_stream.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <fstream>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "terse/core/crc32.h"
#include "terse/core/limits.h"
#include "testing_files.h"

namespace terse {
namespace {

using Line = std::pair<long, std::string>;

std::vector<Line> Rest(LineStream& stream) {
  std::vector<Line> lines;
  for (TextLine line; stream.Next(line);) lines.emplace_back(line.number, line.text);
  return lines;
}

std::vector<Line> Streamed(const std::string& content) {
  const TestFile file("lines.txt", content);
  LineStream stream(file.Path());
  return Rest(stream);
}

std::vector<Line> Whole(const std::string& content) {
  const TestFile stored("lines.txt", content);
  const TextFile file(stored.Path());
  std::vector<Line> lines;
  for (const TextLine& line : file.Lines()) lines.emplace_back(line.number, line.text);
  return lines;
}

FileFingerprint Fingerprint(const std::string& content) { return FingerprintOf(TestFile("bytes", content).Path()); }

TEST(LineStream, GivesTheLinesOfTheWholeFile) {
  for (const char* content : {"a 1\nb 2\n", "a\r\n\r\n  b \t\n", "# no\n// no\nyes",
                              "\xEF\xBB\xBF"
                              "a\nb",
                              "\n\n\n", "x"}) {
    EXPECT_EQ(Streamed(content), Whole(content)) << content;
  }
  // Lines around the size of the pieces that are read at once.
  std::mt19937 random(3);
  std::string content;
  for (int k = 0; k < 60; ++k) {
    const std::size_t length =
        k % 3 == 0 ? random() % 5 : (std::size_t{1} << 18) * (random() % 2 + 1) - 3 + random() % 6;
    content += std::string(length, static_cast<char>('a' + k % 26)) + "\n";
  }
  EXPECT_EQ(Streamed(content), Whole(content));
  content.pop_back();
  EXPECT_EQ(Streamed(content), Whole(content));
}

std::string ManyLines() {
  std::string content;
  for (int k = 0; k < 50000; ++k) content += "line " + std::to_string(k) + (k % 7 == 0 ? "\n\n" : "\n");
  return content;  // of more than one piece
}

TEST(LineStream, StripsBlanksMarksAndComments) {
  const std::vector<Line> wanted = {{1, "a 1"}, {3, "b\t2"}, {6, "c"}};
  EXPECT_EQ(Streamed("\xEF\xBB\xBF a 1 \r\n\r\n\tb\t2\v\n# no\n // no\nc"), wanted);
}

// The end of a line, and of the file, before, at and behind the end of a piece.
TEST(LineStream, PiecesEndAnywhere) {
  for (int shift = -2; shift <= 2; ++shift) {
    const auto length = static_cast<std::size_t>((1 << 18) + shift);
    const std::string first(length, 'x');
    EXPECT_EQ(Streamed(first), (std::vector<Line>{{1, first}}));
    EXPECT_EQ(Streamed(first + "\n"), (std::vector<Line>{{1, first}}));
    EXPECT_EQ(Streamed(first + "\r\ny"), (std::vector<Line>{{1, first}, {2, "y"}}));
  }
}

TEST(LineStream, BeginsAgain) {
  const std::string content = ManyLines();
  const std::vector<Line> wanted = Whole(content);
  const TestFile file("lines.txt", content);
  LineStream stream(file.Path());
  EXPECT_EQ(stream.LineNumber(), 0);
  for (const std::size_t count : {std::size_t{0}, std::size_t{3}, wanted.size() / 2, wanted.size()}) {
    TextLine line;
    for (std::size_t k = 0; k < count; ++k) ASSERT_TRUE(stream.Next(line));
    EXPECT_EQ(stream.LineNumber(), count == 0 ? 0 : wanted[count - 1].first);
    stream.Rewind();
  }
  EXPECT_EQ(Rest(stream), wanted);
}

TEST(LineStream, KeepsWhatAPipeGives) {
  const std::string content = ManyLines();
  const TestFile pipe("pipe");
  ASSERT_EQ(mkfifo(pipe.Path().c_str(), 0600), 0);
  std::thread writer([&] { std::ofstream(pipe.Path()) << content; });
  LineStream stream(pipe.Path());
  TextLine line;
  for (int k = 0; k < 20000; ++k) ASSERT_TRUE(stream.Next(line));
  stream.Rewind();  // before the end has come
  const std::vector<Line> first = Rest(stream);
  writer.join();
  EXPECT_EQ(first, Whole(content));
  stream.Rewind();
  EXPECT_EQ(Rest(stream), first);
}

// Half of the old and half of the new content would be neither.
TEST(LineStream, RefusesAFileThatChangesMeanwhile) {
  for (const bool is_longer : {true, false}) {
    const TestFile file("lines.txt", ManyLines());
    std::filesystem::last_write_time(file.Path(),
                                     std::filesystem::file_time_type::clock::now() - std::chrono::hours(1));
    LineStream stream(file.Path());
    TextLine line;
    ASSERT_TRUE(stream.Next(line));
    if (is_longer) {
      std::ofstream(file.Path(), std::ios::app) << "one more\n";
    } else {
      std::ofstream(file.Path(), std::ios::in | std::ios::out) << "LINE";
    }
    try {
      Rest(stream);
      ADD_FAILURE() << "read as if nothing had happened";
    } catch (const FileError& error) {
      EXPECT_NE(std::string(error.what()).find("was changed while it was read"), std::string::npos) << error.what();
    }
  }
}

TEST(LineStream, RefusesWhatIsNoText) {
  EXPECT_THROW(LineStream{TestFile("absent").Path()}, FileError);
  EXPECT_THROW(LineStream{::testing::TempDir()}, FileError);
  EXPECT_THROW(Streamed(std::string("a\nb\0c\n", 6)), FileError);
  EXPECT_THROW(Streamed(std::string(kMostLineBytes + 10, 'x')), FileError);
}

TEST(LineStream, FingerprintsAreOfAllBytes) {
  std::mt19937 random(4);
  std::string content;
  while (content.size() < (std::size_t{5} << 19)) content += static_cast<char>(random() % 256);
  const FileFingerprint found = Fingerprint(content);
  EXPECT_EQ(found.bytes, content.size());
  EXPECT_EQ(found.crc32, Crc32(content));
  content[content.size() / 2] ^= 1;
  EXPECT_NE(Fingerprint(content).crc32, found.crc32);
}

}  // namespace
}  // namespace terse
