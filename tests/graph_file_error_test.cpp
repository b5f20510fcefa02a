// What ReadGraph must refuse, with line and cause, and that broken files never crash it.

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <random>
#include <sstream>
#include <vector>

#include "terse/core/graph_file.h"
#include "testing_files.h"

namespace terse {
namespace {

constexpr const char* kUnit3 = " 1 0 0 1 0 1\n";
constexpr const char* kUnit6 = " 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n";

struct Broken {
  std::string name, content;
  long line;
  std::vector<std::string> says;
};

void ExpectRefused(const std::string& path, long line, const std::vector<std::string>& says,
                   const ReadOptions& options = {}) {
  try {
    ReadGraph(path, options);
    ADD_FAILURE() << "accepted";
  } catch (const FileError& error) {
    EXPECT_EQ(error.path(), path);
    EXPECT_EQ(error.line(), line) << error.what();
    for (const std::string& text : says) {
      EXPECT_NE(error.cause().find(text), std::string::npos) << "no \"" << text << "\" in: " << error.what();
    }
  }
}

void ExpectRefused(const std::vector<Broken>& cases, const ReadOptions& options = {}) {
  for (const Broken& broken : cases) {
    SCOPED_TRACE(broken.name);
    const TestFile file("broken.graph", broken.content);
    ExpectRefused(file.Path(), broken.line, broken.says, options);
  }
}

std::string Edge2(const std::string& from, const std::string& to) {
  return "EDGE_SE2 " + from + " " + to + " 1 0 0" + kUnit3;
}

TEST(GraphFileErrorTest, NumbersThatAreNone) {
  const std::string good = "# comment\n\n" + Edge2("0", "1");  // an edge on line 3
  ExpectRefused({
      {"word", good + "EDGE_SE2 1 2 1 abc 0" + kUnit3, 4, {"field 5 (y)", "\"abc\"", "not a number"}},
      {"trailing text", good + "EDGE_SE2 1 2 1 0 0.5rad" + kUnit3, 4, {"field 6 (theta)", "\"0.5rad\""}},
      {"decimal comma", good + "EDGE_SE2 1 2 1,5 0 0" + kUnit3, 4, {"field 4 (x)", "\"1,5\""}},
      {"hexadecimal", good + "EDGE_SE2 1 2 0x10 0 0" + kUnit3, 4, {"\"0x10\""}},
      {"two signs", good + "EDGE_SE2 1 2 +-1 0 0" + kUnit3, 4, {"\"+-1\""}},
      {"sign alone", good + "EDGE_SE2 1 2 + 0 0" + kUnit3, 4, {"\"+\""}},
      {"nan", good + "EDGE_SE2 1 2 nan 0 0" + kUnit3, 4, {"field 4 (x)", "\"nan\"", "not finite"}},
      {"inf", good + "EDGE_SE2 1 2 0 -inf 0" + kUnit3, 4, {"field 5 (y)", "\"-inf\"", "not finite"}},
      {"overflow", good + "EDGE_SE2 1 2 0 1e999 0" + kUnit3, 4, {"\"1e999\"", "range"}},
      {"information", good + "EDGE_SE2 1 2 0 0 0 1 0 0 x 0 1\n", 4, {"field 10 (information)", "\"x\""}},
      {"nan information", good + "EDGE_SE2 1 2 0 0 0 1 0 0 1 0 nan\n", 4, {"field 12 (information)", "not finite"}},
      {"vertex", good + "VERTEX_SE2 0 0 0 nan\n", 4, {"field 5 (theta)", "not finite"}},
      {"quaternion", "VERTEX_SE3:QUAT 0 0 0 0 0 0 q 1\n", 1, {"field 8 (qz)", "\"q\""}},
      {"angle", "VERTEX3 0 0 0 0 0 p 1\n", 1, {"field 7 (pitch)", "\"p\""}},
  });
}

TEST(GraphFileErrorTest, Ids) {
  ExpectRefused({
      {"fraction", Edge2("0", "1.5"), 1, {"field 3 (to)", "\"1.5\"", "integer"}},
      {"point zero", Edge2("0.0", "1"), 1, {"field 2 (from)", "\"0.0\""}},
      {"exponent", Edge2("0", "1e5"), 1, {"\"1e5\""}},
      {"beyond 64 bits", Edge2("0", "9223372036854775808"), 1, {"\"9223372036854775808\"", "64-bit"}},
      {"word", "VERTEX_SE2 a 0 0 0\n", 1, {"field 2 (id)", "\"a\""}},
      {"FIX of a fraction", Edge2("0", "1") + "FIX 0 0.5\n", 2, {"\"0.5\""}},
  });
  const TestFile file("ids.graph", Edge2("9223372036854775807", "-9223372036854775808"));
  EXPECT_NO_THROW(ReadGraph(file.Path()));
}

TEST(GraphFileErrorTest, FieldCounts) {
  ExpectRefused({
      {"too few", "EDGE_SE2 0 1 1 0 0 1 0 0 1 0\n", 1, {"EDGE_SE2", "11 fields", "found 10"}},
      {"too many", "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1 7\n", 1, {"11 fields", "found 12"}},
      {"no ids", "EDGE_SE2\n", 1, {"11 fields", "found 0"}},
      {"one id", Edge2("0", "1") + "EDGE_SE2 1\n", 2, {"11 fields", "found 1"}},
      {"vertex", "VERTEX_SE2 0 0 0\n", 1, {"VERTEX_SE2", "4 fields", "found 3"}},
      {"spatial vertex", "VERTEX_SE3:QUAT 0 0 0 0 0 0 1\n", 1, {"8 fields", "found 7"}},
      {"spatial edge", "EDGE_SE3:QUAT 0 1 0 0 0 0 0 1" + std::string(kUnit6), 1, {"30 fields", "found 29"}},
      {"FIX of nothing", Edge2("0", "1") + "FIX\n", 2, {"FIX", "at least 1", "found 0"}},
      {"position prior", Edge2("0", "1") + "EDGE_PRIOR_SE2_XY 0 1 1 1 0\n", 2, {"6 fields", "found 5"}},
      {"TORO vertex", "VERTEX2 0 0 0\n", 1, {"VERTEX2", "4 fields", "found 3"}},
      {"TORO edge", "VERTEX2 0 0 0 0\nEDGE2 0 1 0 0 0 1 0 1 1 0\n", 2, {"EDGE2", "11 fields", "found 10"}},
      {"iSAM edge", "ODOMETRY 0 1 0 0 0 1 0 0 1 0\n", 1, {"ODOMETRY", "11 fields", "found 10"}},
      {"iSAM edge in space", "EDGE3 0 1 0 0 0 0 0\n", 1, {"EDGE3", "29 fields", "found 7"}},
      {"very long", "EDGE_SE2 0 1" + std::string(2000, '1').replace(0, 1, " ") + kUnit3, 1, {"found 9"}},
      {"many fields",
       Edge2("0", "1") + "VERTEX_SE2" +
           [] {
             std::string ones;
             for (int i = 0; i < 1000; ++i) ones += " 1";
             return ones;
           }() +
           "\n",
       2,
       {"4 fields", "found 1000"}},
  });
}

TEST(GraphFileErrorTest, InformationThatIsNotPositiveDefinite) {
  const std::string hint = "--repair-information";
  ExpectRefused({
      {"negative",
       Edge2("0", "1") + "EDGE_SE2 1 7 1 0 0 1 0 0 -2.5 0 1\n",
       2,
       {"edge 1 -> 7", "eigenvalue is -2.5", hint}},
      {"zero", "EDGE_SE2 0 1 1 0 0 0 0 0 0 0 0\n", 1, {"edge 0 -> 1", "positive definite", hint}},
      {"off the diagonal", "EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\n", 1, {"eigenvalue is -1"}},
      {"prior", Edge2("0", "1") + "EDGE_PRIOR_SE2 1 0 0 0 1 0 0 1 0 -1\n", 2, {"prior on pose 1", "-1", hint}},
      {"position prior", Edge2("0", "1") + "EDGE_PRIOR_SE2_XY 1 0 0 1 0 -3\n", 2, {"position prior on pose 1", "-3"}},
      {"TORO", "VERTEX2 0 0 0 0\nEDGE2 0 1 0 0 0 1 0 0 1 0 1\n", 2, {"edge 0 -> 1", hint}},
      {"iSAM", "ODOMETRY 0 1 0 0 0 1 0 1 1 0 0\nODOMETRY 1 2 0 0 0 1 0 0 1 0 1\n", 1, {"edge 0 -> 1", hint}},
  });
  ReadOptions repair;
  repair.repair_information = true;
  ExpectRefused({{"repair is no licence for a loop", "EDGE_SE2 0 0 1 0 0 -1 0 0 1 0 1\n", 1, {"itself"}}}, repair);
}

TEST(GraphFileErrorTest, Quaternions) {
  const std::string rest = std::string(" 0 0 0") + kUnit6;
  ExpectRefused({
      {"zero", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0\n", 1, {"norm 0 "}},
      {"two", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 2\n", 1, {"norm 2 "}},
      {"slightly off", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1.02\n", 1, {"norm 1.02 "}},
      {"edge", "EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 0.5" + std::string(kUnit6), 1, {"norm 0.5 "}},
      {"huge", "VERTEX_SE3:QUAT 0 0 0 0 1e300 0 0 1\n", 1, {"norm"}},
  });
}

TEST(GraphFileErrorTest, Structure) {
  const std::string edge = Edge2("0", "1");
  ExpectRefused({
      {"loop", edge + Edge2("1", "1"), 2, {"edge 1 -> 1", "itself"}},
      {"second vertex", "VERTEX_SE2 4 0 0 0\n" + edge + "VERTEX_SE2 4 0 0 0\n", 3, {"pose 4", "second vertex"}},
      {"FIX of nobody", edge + "FIX 0 8\n", 2, {"FIX", "pose 8"}},
      {"FIX alone", "FIX 8\n", 1, {"pose 8"}},
      {"prior on nobody", edge + "EDGE_PRIOR_SE2 8 0 0 0" + kUnit3, 2, {"prior", "pose 8"}},
      {"position prior on nobody", edge + "EDGE_PRIOR_SE2_XY 8 0 0 1 0 1\n", 2, {"prior", "pose 8"}},
      {"mixed dimensions",
       edge + "VERTEX_SE3:QUAT 1 0 0 0 0 0 0 1\n",
       2,
       {"2D and 3D", "VERTEX_SE3:QUAT", "EDGE_SE2 (line 1)"}},
      {"mixed formats", edge + "EDGE2 0 1 0 0 0 1 0 0 1 0 1\n", 2, {"formats", "EDGE2", "EDGE_SE2 (line 1)"}},
      {"TORO and iSAM",
       "EDGE2 0 1 0 0 0 1 0 0 1 0 1\nVERTEX2 0 0 0 0\nODOMETRY 0 1 0 0 0 1 0 0 1 0 1\n",
       3,
       {"formats", "ODOMETRY", "VERTEX2 (line 2)"}},
      {"no edges", "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 0 0\n", 0, {"2 poses but no edges"}},
      {"components",
       Edge2("0", "1") + Edge2("1", "2") + Edge2("2", "30") + Edge2("9001", "9000") + "VERTEX_SE2 7 0 0 0\n",
       0,
       {"3 components: 4 poses (0 ... 30), 2 poses (9000, 9001), 1 pose (7)"}},
      {"sensor offset that no line gives",
       "PARAMS_SE3OFFSET 3 0 0 1 0 0 0 1\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nEDGE_SE3_PRIOR 0 2 0 0 0 0 0 0 1" +
           std::string(kUnit6),
       3,
       {"prior on pose 0", "sensor offset 2", "expected PARAMS_SE3OFFSET 2"}},
      {"two sensor offsets",
       "PARAMS_SE3OFFSET 3 0 0 1 0 0 0 1\nPARAMS_SE3OFFSET 3 0 0 1 0 0 0 1\nPARAMS_SE3OFFSET 3 0 0 2 0 0 0 1\n"
       "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n",
       3,
       {"second PARAMS_SE3OFFSET 3"}},
      {"FIX of no skipped vertex", edge + "VERTEX_XY 7 0 0\nFIX 7 8\n", 3, {"FIX", "pose 8"}},
      {"FIX of what an edge alone names", edge + "EDGE_SE2_XY 0 8 1 1 1 0 1\nFIX 8\n", 3, {"FIX", "pose 8"}},
      {"row of numbers", edge + "1 2 3\n", 2, {"expected a tag", "\"1\""}},
  });
}

TEST(GraphFileErrorTest, ManyComponentsAreNotAllListed) {
  std::string content;
  for (int i = 0; i < 1000; ++i) content += Edge2(std::to_string(2 * i), std::to_string(2 * i + 1));
  const TestFile file("pieces.g2o", content);
  try {
    ReadGraph(file.Path());
    FAIL() << "accepted";
  } catch (const FileError& error) {
    EXPECT_NE(error.cause().find("1000 components: 2 poses (0, 1), "), std::string::npos) << error.what();
    EXPECT_LT(error.cause().size(), 200u) << error.what();
  }
}

TEST(GraphFileErrorTest, FilesThatAreNoGraphs) {
  const std::string expected = "expected a g2o, TORO or iSAM graph";
  ExpectRefused({
      {"empty", "", 0, {"empty"}},
      {"comments", "# nothing\n\n", 0, {expected, "comments"}},
      {"TUM trajectory", "# stamp\n0.1 1 2 3 0 0 0 1\n", 2, {expected, "\"0.1 1 2 3 0 0 0 1\"", "trajectory"}},
      {"KITTI trajectory", "1 0 0 0 0 1 0 0 0 0 1 0\n", 1, {expected, "trajectory"}},
      {"prose", "Dear reader,\n", 1, {expected, "\"Dear reader,\""}},
      {"parameters only", "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n", 1, {expected}},
      {"binary", Edge2("0", "1") + std::string("\0\1\2", 3), 2, {"binary"}},
  });
  ExpectRefused(::testing::TempDir(), 0, {"folder"});
  ExpectRefused(::testing::TempDir() + "terse_no_such_file.g2o", 0, {"does not exist"});
  const TestFile file("unreadable.g2o", Edge2("0", "1"));
  ::chmod(file.Path().c_str(), 0);
  if (std::ifstream(file.Path()).is_open()) return;  // root reads everything
  ExpectRefused(file.Path(), 0, {"cannot read", "Permission"});
}

std::string ValidFile(int kind) {
  std::ostringstream out;
  const auto edges = [&](const std::string& tag, const std::string& rest) {
    for (int i = 0; i < 8; ++i) out << tag << " " << i << " " << (i + 4) % 9 << rest;
    for (int i = 0; i < 8; ++i) out << tag << " " << i + 1 << " " << i << rest;
  };
  if (kind == 0) {
    for (int i = 0; i < 9; ++i) out << "VERTEX_SE2 " << i << " 0.5 -1e-3 0.25\n";
    out << "FIX 0 1\n";
    for (int i = 0; i < 8; ++i) out << "EDGE_SE2 " << i << " " << i + 1 << " 1 0.1 -0.5 44.7 0.1 0.2 44.7 0.3 100\n";
    out << "EDGE_PRIOR_SE2 1 0 0 0 1 0 0 1 0 1\nEDGE_PRIOR_SE2_XY 2 0 0 1 0 1\nSKIPPED 1 2\n";
  } else if (kind == 1) {
    out << "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\r\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\r\n";
    edges("EDGE_SE3:QUAT", std::string(" 1 2 3 0.5 0.5 -0.5 0.5") + kUnit6);
    out << "EDGE_SE3_PRIOR 1 0 0 0 0 0 0 0 1" << kUnit6 << "EDGE_PRIOR_SE3_XYZ 2 1 2 3 1 0 0 1 0 1\n";
  } else if (kind == 2) {
    out << "VERTEX3 0 0 0 0 0.1 0.2 0.3\n# comment\n";
    edges("EDGE3", std::string(" 1 2 3 0.1 0.2 0.3") + kUnit6);
  } else {
    edges(kind == 3 ? "ODOMETRY" : "EDGE2", " 1 0 0.5 44.7 0 0 44.7 0 44.7\n");
  }
  return out.str();
}

std::string Mutated(std::string text, std::mt19937& random) {
  const auto below = [&](std::size_t n) { return static_cast<std::size_t>(random()) % n; };
  static const std::string kLikely = "0123456789+-.eE# \n\r\tnaif\"";
  const std::size_t changes = 1 + below(4);
  for (std::size_t k = 0; k < changes && !text.empty(); ++k) {
    const std::size_t at = below(text.size());
    const std::size_t line = text.rfind('\n', at) == std::string::npos ? 0 : text.rfind('\n', at) + 1;
    const std::size_t end = std::min(text.find('\n', line), text.size() - 1) + 1;
    switch (below(8)) {
      case 0: text[at] = static_cast<char>(text[at] ^ (1 << below(8))); break;
      case 1: text[at] = kLikely[below(kLikely.size())]; break;
      case 2: text.insert(at, 1, kLikely[below(kLikely.size())]); break;
      case 3: text.erase(at, 1); break;
      case 4: text.erase(at, 1 + below(30)); break;
      case 5:
        if (end > line) text.erase(line, end - line);
        break;
      case 6:
        if (end > line) text.insert(line, text.substr(line, end - line));
        break;
      default: text.resize(at); break;
    }
  }
  return text;
}

TEST(GraphFileErrorTest, MutatedFilesAreReadOrRefused) {
  std::mt19937 random(41);
  const TestFile file("fuzz.graph");
  long read = 0, refused = 0;
  for (int kind = 0; kind < 5; ++kind) {
    const std::string valid = ValidFile(kind);
    std::ofstream(file.Path(), std::ios::binary | std::ios::trunc) << valid;
    ASSERT_NO_THROW(ReadGraph(file.Path())) << "kind " << kind;
    for (int trial = 0; trial < 2000; ++trial) {
      const std::string text = Mutated(valid, random);
      // A new file each time: cutting one short that is on its way to the disk waits for the disk.
      std::remove(file.Path().c_str());
      std::ofstream(file.Path(), std::ios::binary) << text;
      ReadOptions options;
      options.repair_information = trial % 2 == 0;
      try {
        const GraphFile graph = ReadGraph(file.Path(), options);
        ++read;
      } catch (const FileError& error) {
        ++refused;
        EXPECT_FALSE(error.cause().empty());
      } catch (const std::exception& error) {
        FAIL() << "kind " << kind << " trial " << trial << ": " << error.what() << "\n" << text;
      }
    }
  }
  EXPECT_GT(read, 500) << "hardly a mutation survives: the fuzz does not reach the readers";
  EXPECT_GT(refused, 500);
}

// Of every kind of refusal one: it says what there should have been.
TEST(GraphFileErrorTest, EveryRefusalSaysWhatWasExpected) {
  const std::string good = Edge2("0", "1"), unit = "EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1" + std::string(kUnit6);
  const std::vector<std::string> contents = {
      "",
      "# nothing\n",
      std::string("EDGE_SE2 0 1\0", 13),
      "some words\n",
      "1 2 3\n" + good,
      good + "EDGE_SE2 1 2 x 0 0" + kUnit3,
      good + "EDGE_SE2 1 2 nan 0 0" + kUnit3,
      good + "EDGE_SE2 1 2 1e999 0 0" + kUnit3,
      good + "EDGE_SE2 1 b 0 0 0" + kUnit3,
      good + "EDGE_SE2 1 2\n",
      good + "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 0 0 0 0\n",
      good + "FIX 7\n",
      good + unit,
      "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 0 0\n",
      good + Edge2("5", "6"),
      unit + "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 2\n",
  };
  for (const std::string& content : contents) {
    const TestFile file("broken.graph", content);
    try {
      ReadGraph(file.Path());
      ADD_FAILURE() << "accepted: " << content;
    } catch (const FileError& error) {
      const std::string what = error.what();
      const bool says = what.find("expected") != std::string::npos || what.find("instead of") != std::string::npos ||
                        what.find(" takes ") != std::string::npos;
      EXPECT_TRUE(says) << what;
    }
  }
}

}  // namespace
}  // namespace terse
