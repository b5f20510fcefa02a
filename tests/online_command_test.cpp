// terse online: answers line by line, journals that survive kill -9.

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <map>
#include <random>
#include <set>

#include "slow_build.h"
#include "terse/compact/measurement_stream.h"
#include "terse/core/measurement_line.h"
#include "testing_command.h"

namespace {

using nlohmann::json;
using terse::testing::CsvRows;
using terse::testing::Outcome;

const std::string kOptions = "online --range 10 10 1.5 --min-loop-gain 0.5 --min-pose-gain 2 --link-deviation 0.1 0.1 ";

// The command with pipes to its standard input and output.
class Child {
 public:
  Child(const std::string& folder, const std::string& arguments) {
    int in[2], out[2];
    if (pipe(in) != 0 || pipe(out) != 0) throw std::runtime_error("no pipe");
    process_ = fork();
    if (process_ == 0) {
      dup2(in[0], STDIN_FILENO);
      dup2(out[1], STDOUT_FILENO);
      for (const int descriptor : {in[0], in[1], out[0], out[1]}) close(descriptor);
      const std::string line = "cd '" + folder + "' && exec '" TERSE_COMMAND "' " + arguments + " 2> .err";
      execl("/bin/sh", "sh", "-c", line.c_str(), nullptr);
      _exit(127);
    }
    close(in[0]);
    close(out[1]);
    input_ = in[1];
    output_ = fdopen(out[0], "r");
  }
  ~Child() {
    if (process_ > 0) Kill();
    std::fclose(output_);
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  void Send(const std::string& text) {
    for (std::size_t done = 0; done < text.size();) {
      const ssize_t count = write(input_, text.data() + done, text.size() - done);
      if (count <= 0) return;
      done += static_cast<std::size_t>(count);
    }
  }
  // Waits for one line; null at the end.
  json Receive() {
    std::string line;
    for (int c = std::fgetc(output_); c != EOF; c = std::fgetc(output_)) {
      if (c == '\n') return json::parse(line);
      line += static_cast<char>(c);
    }
    return nullptr;
  }
  std::vector<json> ReceiveAll() {
    std::vector<json> out;
    for (json line = Receive(); !line.is_null(); line = Receive()) out.push_back(line);
    return out;
  }
  void Kill() {
    kill(process_, SIGKILL);
    Wait();
  }
  // Ends its input and receives what is left.
  std::vector<json> Finish() {
    close(input_);
    input_ = -1;
    const std::vector<json> rest = ReceiveAll();
    EXPECT_EQ(Wait(), 0);
    return rest;
  }

 private:
  int Wait() {
    int status = 0;
    waitpid(process_, &status, 0);
    process_ = -1;
    if (input_ >= 0) close(input_);
    input_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  pid_t process_ = -1;
  int input_ = -1;
  FILE* output_ = nullptr;
};

std::vector<json> ParseLines(const std::string& text) {
  std::vector<json> out;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) out.push_back(json::parse(line));
  return out;
}

std::string Join(const std::vector<std::string>& lines, std::size_t first, std::size_t last) {
  std::string out;
  for (std::size_t k = first; k < std::min(last, lines.size()); ++k) out += lines[k] + '\n';
  return out;
}

json WithoutSeconds(json object) {
  object.erase("seconds");
  return object;
}

class OnlineCommand : public terse::testing::CommandTest {
 protected:
  void SetUp() override {
    CommandTest::SetUp();
    signal(SIGPIPE, SIG_IGN);
  }

  // The edges of a generated scene as a robot measures them: a pose's odometry, then its loops.
  std::vector<std::string> Measurements(int poses, const std::string& scene = "manhattan") const {
    Succeed("generate " + scene + " --poses " + std::to_string(poses) + " --output scene.g2o");
    std::map<std::pair<long, bool>, std::string> in_order;  // {pose, is a loop}
    std::istringstream file(Read("scene.g2o"));
    for (std::string line; std::getline(file, line);) {
      std::istringstream fields(line);
      std::string tag;
      long from = 0, to = 0;
      fields >> tag >> from >> to;
      if (tag.rfind("EDGE_SE", 0) == 0) in_order[{std::max(from, to), std::abs(from - to) > 1}] += line + '\n';
    }
    std::vector<std::string> lines;
    for (const auto& [key, text] : in_order) {
      std::istringstream of_pose(text);
      for (std::string line; std::getline(of_pose, line);) lines.push_back(line);
    }
    return lines;
  }
  std::vector<json> Answers(const std::string& input, const std::string& arguments) const {
    Write("input", input);
    return ParseLines(Succeed(arguments + " < input").out);
  }
  void ExpectSameResults(const std::string& a, const std::string& b) const {
    for (const char* name : {"/compact.g2o", "/trajectory.tum", "/decisions.csv"}) {
      EXPECT_FALSE(Read(a + name).empty()) << a << name;
      EXPECT_EQ(Read(a + name), Read(b + name)) << name;
    }
  }
};

TEST_F(OnlineCommand, AnswersEveryPoseWithOneLine) {
  const auto lines = Measurements(80);
  const auto answers = Answers(Join(lines, 0, lines.size()), kOptions + "--output out");
  std::map<std::string, std::vector<std::string>> rows;
  for (const auto& row : CsvRows(Read("out/decisions.csv"))) rows[row[0]] = row;
  EXPECT_EQ(rows.size(), 80u);
  int poses = 0, accepted = 0;
  for (const json& answer : answers) {
    if (answer.contains("retired_at_end")) continue;
    EXPECT_GE(answer["seconds"].get<double>(), 0);
    if (!answer.contains("pose")) continue;  // a late link
    ++poses;
    const auto& row = rows.at(answer["pose"].dump());
    EXPECT_EQ(answer["kept"].get<bool>(), row[1] == "1");
    EXPECT_EQ(answer["verdict"], row[2]);
    EXPECT_EQ(answer["estimate"].size(), 3u);
    for (const json& link : answer["links"]) {
      EXPECT_EQ(link.contains("factor"), link["accepted"].get<bool>());
      accepted += link["accepted"].get<bool>();
    }
  }
  EXPECT_EQ(poses, 80);
  EXPECT_GT(accepted, 0);
  EXPECT_TRUE(Answers(Join(lines, 0, lines.size()), kOptions + "--quiet").empty());
}

TEST_F(OnlineCommand, AnswersAtOnceAndTakesLinksOut) {
  Child child(folder_.string(), "online --range 10 10 1.5 --strategy apfl --min-loop-gain 0");
  child.Send("VERTEX_SE2 0 5 0 0\nEDGE_SE2 0 1 1 0 0 100 0 0 100 0 100\n");
  const json first = child.Receive();
  EXPECT_EQ(first["verdict"], "first");
  EXPECT_EQ(first["estimate"], json({5.0, 0.0, 0.0}));
  child.Send("# a comment\nFLUSH\n\n");
  EXPECT_EQ(child.Receive()["pose"], 1);
  child.Send("EDGE_SE2 1 2 1 0 0 100 0 0 100 0 100\nEDGE_SE2 0 2 2 0 0 100 0 0 100 0 100\nFLUSH\n");
  const json closed = child.Receive();
  EXPECT_EQ(closed["verdict"], "loop_closed");
  ASSERT_EQ(closed["links"].size(), 1u);
  EXPECT_EQ(closed["links"][0]["to"], 0);
  const std::string factor = closed["links"][0]["factor"].dump();
  child.Send("EDGE_SE2 2 0 -2 0 0 100 0 0 100 0 100\n");
  const json late = child.Receive();
  EXPECT_EQ(late["link"], json({2, 0}));
  EXPECT_TRUE(late["accepted"].get<bool>());
  child.Send("REMOVE " + factor + "\nREMOVE " + factor + "\n");
  EXPECT_EQ(child.Receive()["error"], "stdin:11: factor " + factor + " is not a link of the map");
  child.Send("EDGE_PRIOR_SE2 1 16 0 0 100 0 0 100 0 100\n");
  EXPECT_EQ(child.Receive()["prior"], 1);
  child.Send("EDGE_SE2 2 3 1 0 0 100 0 0 100 0 100\n");
  const std::vector<json> rest = child.Finish();
  ASSERT_EQ(rest.size(), 1u);
  EXPECT_NEAR(rest[0]["estimate"][0].get<double>(), 18, 1e-3);
}

TEST_F(OnlineCommand, ARobustKernelLeavesOutWhatNothingTested) {
  std::string input;
  for (int k = 0; k < 5; ++k) {
    input += "EDGE_SE2 " + std::to_string(k) + ' ' + std::to_string(k + 1) + " 1 0 0 100 0 0 100 0 100\n";
  }
  input += "EDGE_SE2 0 5 3 0 0 100 0 0 100 0 100\n";  // two metres short
  const auto last = [&](const std::string& options) {
    const json answer = Answers(input, "online --range 10 10 1.5 --strategy apfl --min-loop-gain 0 " + options).back();
    EXPECT_EQ(answer["links"].size(), 1u);
    EXPECT_EQ(answer["links"][0]["innovation"].is_null(), options.find("--no-innovation-test") == 0);
    return answer["estimate"][0].get<double>();
  };
  EXPECT_LT(last("--no-innovation-test"), 4);
  EXPECT_NEAR(last("--no-innovation-test --robust gnc"), 5, 1e-6);
  EXPECT_NEAR(last("--innovation-quantile 0.99"), 5, 1e-6);
}

TEST_F(OnlineCommand, BadLinesAreAnsweredAndChangeNothing) {
  const auto lines = Measurements(40);
  const std::string good = Join(lines, 0, lines.size());
  std::string bad = "hello\n";
  for (const std::string& line : lines) bad += line + "\nEDGE_SE2 1 nonsense\nEDGE_SE2 900 901 1 0 0 1 0 0 1 0 1\n";
  const auto expected = Answers(good, kOptions);
  std::vector<json> decisions, errors;
  for (const json& answer : Answers(bad, kOptions)) (answer.contains("error") ? errors : decisions).push_back(answer);
  EXPECT_EQ(errors.size(), 1 + 2 * lines.size());
  EXPECT_EQ(errors[0]["error"], "stdin:1: expected a tag of the g2o format, the line starts with \"hello\"");
  EXPECT_NE(errors[1]["error"].get<std::string>().find("stdin:3: EDGE_SE2 takes 11 fields"), std::string::npos);
  EXPECT_EQ(errors[2]["error"], "stdin:4: edge 900 -> 901: neither pose is known");
  ASSERT_EQ(decisions.size(), expected.size());
  for (std::size_t k = 0; k < expected.size(); ++k)
    EXPECT_EQ(WithoutSeconds(decisions[k]), WithoutSeconds(expected[k]));

  const auto only_error = [&](const std::string& input) { return Answers(input, kOptions).back()["error"]; };
  EXPECT_EQ(only_error("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 17"),
            "stdin:1: the input ends within this line, expected a line end");
  EXPECT_NE(only_error("EDGE_SE3:QUAT 0 1 1\n").get<std::string>().find("in a run in 2D"), std::string::npos);
  EXPECT_NE(only_error("VERTEX2 0 1 1 0\n").get<std::string>().find("VERTEX2"), std::string::npos);
  EXPECT_NE(only_error("EDGE_SE2 0 1 \xff 0 0 1 0 0 1 0 1\n").get<std::string>().find("not a number"),
            std::string::npos);

  Write("bad", bad);
  const Outcome strict = Run(kOptions + "--strict < bad");
  EXPECT_EQ(strict.exit_code, 1);
  EXPECT_EQ(ParseLines(strict.out).size(), 1u);
  EXPECT_EQ(strict.err.rfind("terse: error: stdin:1: ", 0), 0u) << strict.err;
}

TEST_F(OnlineCommand, TakesTheDimensionFromTheFirstMeasurement) {
  Write("input", "FIX 0\nEDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 100 0 0 100 0 100\n");
  const auto answers = ParseLines(Succeed("online --strategy apal < input").out);
  ASSERT_EQ(answers.size(), 2u);
  EXPECT_EQ(answers[1]["estimate"].size(), 7u);
  EXPECT_EQ(answers[1]["verdict"], "all_kept");
  Write("empty", "");
  EXPECT_EQ(Succeed("online --strategy apal < empty").out, "");
  ExpectFailure("online --review off < input", 2, "--range");
  ExpectFailure("online --range 1 1 1 --dimension 3 < input", 2, "X Y Z ANGLE");
  ExpectFailure("online --range 1 1 1 --innovation-quantile nan < input", 2, "--innovation-quantile");
  ExpectFailure("online --range 1 1 1 --innovation-quantile 1 < input", 2, "--innovation-quantile");
  ExpectFailure("online --range 1 1 1 --innovation-quantile 0.5 --no-innovation-test < input", 2, "excludes");
  ExpectFailure("online --range 1 1 1 --min-loop-gain nan < input", 2, "--min-loop-gain");
  ExpectFailure("online --range 1 1 1 --step-budget-ms -1 < input", 2, "--step-budget-ms");
  ExpectFailure("online --range 1 1 1 --step-budget-ms 5 --journal journal < input", 2, "--step-budget-ms");
}

TEST_F(OnlineCommand, ReadsThresholds) {
  const double v = 0.1 * 0.1;
  json thresholds = {{"dimension", 2},     {"range", {10, 10, 1.5}},
                     {"probability", 0.1}, {"min_loop_gain", 0.5},
                     {"min_pose_gain", 2}, {"link_covariance", {{v, 0, 0}, {0, v, 0}, {0, 0, v}}}};
  Write("good.json", thresholds.dump());
  const auto lines = Measurements(40);
  const std::string input = Join(lines, 0, lines.size());
  const auto expected = Answers(input, kOptions), actual = Answers(input, "online --thresholds good.json");
  ASSERT_EQ(actual.size(), expected.size());
  for (std::size_t k = 0; k < expected.size(); ++k) EXPECT_EQ(WithoutSeconds(actual[k]), WithoutSeconds(expected[k]));
  const auto refuse = [&](const char* key, const json& value, const std::string& cause) {
    json wrong = thresholds;
    wrong[key] = value;
    if (value.is_null()) wrong.erase(key);
    Write("wrong.json", wrong.dump());
    ExpectFailure("online --thresholds wrong.json < input", 1, "wrong.json: " + cause);
  };
  refuse("dimension", 4, "key \"dimension\"");
  refuse("range", {1, 2}, "key \"range\"");
  refuse("range", {1, 2, -1}, "key \"range\"");
  refuse("probability", 1, "key \"probability\"");
  refuse("min_loop_gain", nullptr, "key \"min_loop_gain\" is missing");
  refuse("min_pose_gain", "much", "key \"min_pose_gain\"");
  refuse("link_covariance", {{1, 0, 0}, {0, -1, 0}, {0, 0, 1}}, "key \"link_covariance\"");
  Write("wrong.json", "[1, 2");
  ExpectFailure("online --thresholds wrong.json < input", 1, "wrong.json:1: the JSON ends too early");
  Write("wrong.json", "[1, 2]");
  ExpectFailure("online --thresholds wrong.json < input", 1, "wrong.json: expected thresholds");
  ExpectFailure("online --thresholds none.json < input", 1, "none.json: the file does not exist");
  ExpectFailure("online --thresholds good.json --dimension 3 < input", 1, "good.json: thresholds for 2D");
}

// What is not said is bounded, or as the journal has it, which was perhaps begun when the default was another.
TEST_F(OnlineCommand, TheDefaultIsBounded) {
  const auto lines = Measurements(100);
  const std::string input = Join(lines, 0, lines.size());
  const auto run = [&](const std::string& options) {
    std::vector<json> out;
    for (const json& answer : Answers(input, kOptions + options)) out.push_back(WithoutSeconds(answer));
    return out;
  };
  const auto unsaid = run("--journal unsaid"), few = run("--strategy fpfl --journal few");
  EXPECT_EQ(unsaid, run("--strategy bounded"));
  EXPECT_NE(unsaid, few);
  EXPECT_NE(Read("unsaid").find("\"strategy\":\"bounded\""), std::string::npos);
  const std::string begun = Read("few");
  const auto resumed = Answers("", kOptions + "--journal few");
  ASSERT_EQ(resumed.size(), 1u);
  EXPECT_EQ(resumed[0]["lines"], lines.size());
  EXPECT_EQ(Read("few"), begun);
  Write("input", "");
  ExpectFailure(kOptions + "--strategy bounded --journal few < input", 1,
                "strategy is \"fpfl\" there, \"bounded\" now");
}

// Decisions of the strategy bounded say where the robot was found again and what its links made, as those of compact
// do.
TEST_F(OnlineCommand, TellsWhereTheRobotWasFoundAgain) {
  Succeed("generate ellipse-n --laps 3 --output laps.g2o");
  Succeed("compact laps.g2o --strategy bounded --output whole --calibrate-information off --quiet");
  const std::string online = "online --thresholds whole/thresholds.json ";
  const auto answers = ParseLines(Succeed(online + "< laps.g2o").out);
  const auto decisions = ParseLines(Read("whole/decisions.jsonl"));
  ASSERT_EQ(answers.size(), decisions.size());
  int anchored = 0, fused = 0, with_flags = 0;
  std::string edge;
  for (std::size_t k = 0; k < answers.size(); ++k) {
    const json &answer = answers[k], &decision = decisions[k];
    EXPECT_EQ(answer["verdict"], decision["verdict"]);
    EXPECT_EQ(answer["kept"], decision["kept"]);
    EXPECT_EQ(answer.value("anchored_to", json()), decision.value("anchored_to", json()));
    EXPECT_EQ(answer.contains("anchored_to"), answer["verdict"] == "anchored");
    anchored += answer["verdict"] == "anchored";
    const json edges = answer.value("edges", json::array()), expected = decision.value("edges", json::array());
    ASSERT_EQ(edges.size(), expected.size());
    for (std::size_t e = 0; e < edges.size(); ++e) {
      EXPECT_EQ(edges[e]["factor"], expected[e]["id"]);
      for (const char* key : {"from", "to", "fused"}) EXPECT_EQ(edges[e][key], expected[e][key]);
      EXPECT_EQ(edges[e]["gain"], expected[e]["gain_nats"]);
      fused += edges[e]["fused"].get<bool>();
      edge = edges[e]["factor"].dump();
    }
    for (const json& link : answer["links"]) with_flags += link.contains("anchors") || link.contains("composed");
  }
  EXPECT_GT(anchored, 100);
  EXPECT_GT(fused, 0);
  EXPECT_GT(with_flags, anchored);
  ASSERT_FALSE(edge.empty());
  Write("input", Read("laps.g2o") + "FLUSH\nREMOVE " + edge + "\nREMOVE " + edge + "\n");
  const auto after = ParseLines(Succeed(online + "< input").out);
  ASSERT_EQ(after.size(), answers.size() + 1) << "the second time it is not there";
  EXPECT_NE(after.back()["error"].get<std::string>().find("factor " + edge + " is not a link"), std::string::npos);
}

// As decisions.jsonl of compact says it; a journal goes on with the share it was begun with, or not at all.
TEST_F(OnlineCommand, TellsWhichPosesRetire) {
  const auto lines = Measurements(200);
  Write("in.g2o", Join(lines, 0, lines.size()));
  Succeed("compact in.g2o --output whole --calibrate-information off --quiet");
  const std::string online = "online --thresholds whole/thresholds.json --remember all ";
  const auto decisions = ParseLines(Read("whole/decisions.jsonl"));
  const auto ids = [](const std::vector<json>& answers) {
    std::vector<json> out;
    for (const json& line : answers) out.push_back(line.value("retired", json::array()));
    return out;
  };
  const auto told = ids(ParseLines(Succeed(online + "--journal journal < in.g2o").out));
  EXPECT_EQ(told, ids(decisions));
  EXPECT_GT(std::count_if(told.begin(), told.end(), [](const json& list) { return !list.empty(); }), 0);
  EXPECT_EQ(told, ids(ParseLines(Succeed(online + "--retire-share 0.3 < in.g2o").out))) << "the default";
  const auto never = Succeed(online + "--retire-share 0 --journal never < in.g2o").out;
  EXPECT_EQ(never.find("retired"), std::string::npos);
  EXPECT_NE(Read("never").find("\"retire_share\":0.0,"), std::string::npos);
  // Poses that are not in the map any more are still known, and say so.
  json gone;
  for (const json& list : told) {
    if (!list.empty()) gone = list.front();
  }
  Write("ask", "COVARIANCE " + gone.dump() + "\n");
  const auto resumed = ParseLines(Succeed(online + "--journal journal < ask").out);
  ASSERT_EQ(resumed.size(), 2u);
  EXPECT_EQ(resumed[0]["lines"], lines.size());
  EXPECT_EQ(resumed[1]["ids"], json::array({gone}));
  EXPECT_EQ(resumed[1]["kept"], false);
  const std::string begun = Read("journal");
  Write("input", "");
  ExpectFailure(online + "--retire-share 0 --journal journal < input", 1,
                "journal: the journal was begun with other options: retire_share is 0.3 there, 0.0 now");
  ExpectFailure(online + "--journal never < input", 1, "retire_share is 0.0 there, 0.3 now");
  EXPECT_EQ(Read("journal"), begun);
  for (const std::string bad : {"-1", "nan"}) {
    ExpectFailure(online + "--retire-share " + bad + " < input", 2, "--retire-share: " + bad);
  }
}

// The unit matrix for information, a third of the loops wrong: the map is made again, an answer says what is in it, and
// a journal, cut anywhere, with or without a snapshot, leads to the same map.
TEST_F(OnlineCommand, LooksBackAtWhatWasMeasured) {
  Succeed("generate manhattan --poses 300 --seed 5 --outliers 43 --output in.g2o --quiet");
  std::istringstream lines(Read("in.g2o"));
  std::vector<std::pair<std::pair<int, int>, std::string>> edges;  // by arrival: odometry before the loops of a pose
  for (std::string tag, line; std::getline(lines, line);) {
    std::istringstream words(line);
    int from = 0, to = 0;
    std::string x, y, theta;
    if (!(words >> tag >> from >> to >> x >> y >> theta) || tag != "EDGE_SE2") continue;
    edges.push_back({{std::max(from, to), std::abs(from - to) != 1},
                     tag + ' ' + std::to_string(from) + ' ' + std::to_string(to) + ' ' + x + ' ' + y + ' ' + theta +
                         " 1 0 0 1 0 1\n"});
  }
  std::stable_sort(edges.begin(), edges.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  std::string all, half, rest;
  for (std::size_t k = 0; k < edges.size(); ++k) {
    all += edges[k].second;
    (k < edges.size() / 2 ? half : rest) += edges[k].second;
  }
  Write("all", all);
  Write("half", half);
  Write("rest", rest);
  const std::string online = "online --range 6 6 3.2 ";
  const auto answers = ParseLines(Succeed(online + "--output whole < all").out);
  std::size_t made_again = 0;
  for (const json& answer : answers) {
    if (!answer.contains("made_again")) continue;
    ++made_again;
    EXPECT_GT(answer.at("poses_kept").size(), 1u);
    for (const char* key : {"information", "message", "sigma_scale", "loops_left_out", "links_kept"}) {
      EXPECT_TRUE(answer.contains(key)) << key;
    }
  }
  EXPECT_GE(made_again, 1u);
  EXPECT_EQ(CsvRows(Read("whole/decisions.csv")).size(), 300u);
  Succeed(online + "--journal journal < half > answers");
  Succeed(online + "--journal journal --output resumed --quiet < rest");
  EXPECT_EQ(Read("resumed/compact.g2o"), Read("whole/compact.g2o"));
  EXPECT_EQ(Read("resumed/decisions.csv"), Read("whole/decisions.csv"));
  Succeed(online + "--remember all --journal small --journal-size 0.02 --quiet < half");
  EXPECT_NE(Read("small").find("\"snapshot\""), std::string::npos);
  Succeed(online + "--remember all --journal small --output again --quiet < rest");
  EXPECT_EQ(Read("again/compact.g2o"), Read("whole/compact.g2o"));
  for (const json& answer : ParseLines(Succeed(online + "--review off < all").out)) {
    EXPECT_FALSE(answer.contains("made_again"));
  }
  ExpectFailure(online + "--journal journal --review off < all", 1, "review is \"all\" there, null now");

  // With no option: thresholds are chosen by what was measured. A journal without them goes on without.
  Succeed("online --journal free --quiet < half");
  Succeed("online --journal free --output free_resumed --quiet < rest");
  const auto free = ParseLines(Succeed("online --output free_whole < all").out);
  EXPECT_EQ(Read("free_resumed/compact.g2o"), Read("free_whole/compact.g2o"));
  const auto last =
      std::find_if(free.rbegin(), free.rend(), [](auto& answer) { return answer.contains("made_again"); });
  ASSERT_NE(last, free.rend());
  EXPECT_GT(last->at("thresholds").at("range")[0].get<double>(), 1.5);
  ExpectFailure("online --journal free --range 6 6 3.2 < rest", 1, "range is [1.0,1.0,1.0] there, [6.0,6.0,3.2] now");
  ExpectFailure("online --review off < all", 2, "--range is required where no review chooses the range");
  // What the journal was begun with stays given, or chosen.
  const std::string gains = "--min-pose-gain 3 --min-loop-gain 1 ", link = "--link-deviation 0.5 0.5 ";
  Write("most", all.substr(all.find('\n', all.size() / 20) + 1));
  Write("few", all.substr(0, all.find('\n', all.size() / 20) + 1));
  Succeed(online + gains + link + "--journal given --quiet < few");
  int remade = 0;
  for (const json& answer : ParseLines(Succeed(online + link + "--journal given < most").out)) {
    if (!answer.contains("made_again")) continue;
    ++remade;
    EXPECT_EQ(answer.at("thresholds").at("min_pose_gain"), 3.0);
  }
  EXPECT_GE(remade, 1);
  ExpectFailure("online --journal free --min-pose-gain 3 < rest", 1,
                "the journal was begun with other options: chosen");
}

// As compact has it, where results are written; the journal knows nothing of it, so that a run goes on as if it had not
// ended.
TEST_F(OnlineCommand, PosesRetireAtTheEndOfTheInput) {
  const auto lines = Measurements(400);
  Write("in.g2o", Join(lines, 0, lines.size()));
  Succeed("compact in.g2o --output whole --calibrate-information off --quiet");
  const json expected = ParseLines(Read("whole/decisions.jsonl")).back().at("retired_at_end");
  ASSERT_FALSE(expected.empty());
  const std::string online = "online --thresholds whole/thresholds.json --output ";
  const auto answers = ParseLines(Succeed(online + "out < in.g2o").out);
  EXPECT_EQ(answers.back(), json({{"retired_at_end", expected}}));
  EXPECT_EQ(Read("out/trajectory.tum"), Read("whole/trajectory.tum"));
  EXPECT_EQ(Succeed(online + "out --quiet < in.g2o").out, "");
  const std::string without = "online --thresholds whole/thresholds.json --remember all ";
  EXPECT_EQ(Succeed(without + "< in.g2o").out.find("retired_at_end"), std::string::npos) << "it stays on the way";
  // An end in between, where a pose is complete.
  std::size_t half = lines.size() / 2;
  const auto is_odometry = [&](std::size_t line) {
    std::istringstream fields(lines[line]);
    std::string tag;
    long from = 0, to = 0;
    fields >> tag >> from >> to;
    return std::abs(from - to) == 1;
  };
  while (!is_odometry(half)) ++half;
  Write("first.g2o", Join(lines, 0, half));
  Write("rest.g2o", Join(lines, half, lines.size()));
  Succeed(online + "half --journal journal --quiet < first.g2o");
  Succeed(online + "again --journal journal --quiet < rest.g2o");
  ExpectSameResults("again", "out");
}

// The library's run over the same lines with kOptions.
class SameRun {
 public:
  explicit SameRun(const std::vector<std::string>& lines) : slam_(Options()), stream_(slam_) {
    terse::MeasurementLineReader<terse::SE2> reader("lines");
    for (const std::string& line : lines) {
      stream_.Add(std::get<terse::Factor<terse::SE2>>(reader.Read(line, 1)));
    }
    stream_.Flush();
  }
  const terse::CompactPoseSlam<terse::SE2>& Slam() const { return slam_; }

 private:
  static terse::CompactOptions<terse::SE2> Options() {
    terse::CompactOptions<terse::SE2> options;
    options.thresholds.range = {10, 10, 1.5};
    options.thresholds.min_loop_gain = 0.5;
    options.thresholds.min_pose_gain = 2;
    return options;
  }
  terse::CompactPoseSlam<terse::SE2> slam_;
  terse::MeasurementStream<terse::SE2> stream_;
};

void ExpectMatrix(const json& rows, const terse::Matrix<3, 3>& expected) {
  ASSERT_EQ(rows.size(), 3u);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      const double entry = rows.at(std::size_t(r)).at(std::size_t(c));
      EXPECT_NEAR(entry, expected(r, c), 1e-12 * expected.norm());
    }
  }
}

TEST_F(OnlineCommand, TellsHowWellAnyPoseIsKnown) {
  const auto lines = Measurements(80);
  std::string input = Join(lines, 0, lines.size()) + "FLUSH\n";
  for (int k = 0; k < 80; ++k) {
    input += "COVARIANCE " + std::to_string(k) + '\n';
    if (k > 0) input += "COVARIANCE\t" + std::to_string(k / 3) + "  " + std::to_string(k) + '\n';
  }
  const SameRun run(lines);
  const auto& slam = run.Slam();
  const terse::CovarianceConvention conventions[] = {
      {}, {terse::CovarianceFrame::kWorldAxes, terse::TangentOrder::kRotationFirst}};
  for (const auto& convention : conventions) {
    const std::string options = convention.IsNative() ? "" : " --frame world-axes --order rotation-first";
    const auto answers = Answers(input, kOptions + "--quiet" + options);
    ASSERT_EQ(answers.size(), 159u);
    std::size_t next = 0;
    int dropped = 0;
    for (int k = 0; k < 80; ++k) {
      const terse::PoseId id{k}, other{k / 3};
      const json& one = answers[next++];
      EXPECT_EQ(one["ids"], json::array({k}));
      EXPECT_EQ(one["frame"], convention.IsNative() ? "body" : "world-axes");
      EXPECT_EQ(one["order"], convention.IsNative() ? "translation-first" : "rotation-first");
      EXPECT_EQ(one["kept"].get<bool>(), slam.KeptBase(id) == id);
      EXPECT_GE(one["seconds"].get<double>(), 0);
      dropped += !one["kept"].get<bool>();
      const terse::SE2 T = slam.Estimate(id, terse::Recovery::kV2);
      EXPECT_NEAR(one["estimate"][0].get<double>(), T.Translation().x(), 1e-9);
      EXPECT_NEAR(one["estimate"][2].get<double>(), T.Theta(), 1e-9);
      ExpectMatrix(one["covariance"], slam.Covariance(id, convention));
      if (k == 0) continue;
      const json& pair = answers[next++];
      EXPECT_EQ(pair["from"], k / 3);
      EXPECT_EQ(pair["to"], k);
      ExpectMatrix(pair["covariance"], slam.RelativeCovariance(other, id, convention));
    }
    EXPECT_GT(dropped, 10);
  }
}

TEST_F(OnlineCommand, EveryAnswerHasItsCovarianceIfAsked) {
  const auto lines = Measurements(60);
  const std::string input = Join(lines, 0, lines.size());
  const auto plain = Answers(input, kOptions), with = Answers(input, kOptions + "--covariances --frame world-axes");
  ASSERT_EQ(plain.size(), with.size());
  int poses = 0;
  for (std::size_t k = 0; k < with.size(); ++k) {
    json rest = WithoutSeconds(with[k]);
    poses += static_cast<int>(rest.erase("covariance"));
    EXPECT_EQ(rest.contains("pose"), with[k].contains("covariance"));
    EXPECT_EQ(rest, WithoutSeconds(plain[k]));
  }
  EXPECT_EQ(poses, 60);
  // The last answer is about the map as it is at the end.
  ASSERT_TRUE(with.back().contains("pose"));
  ExpectMatrix(with.back()["covariance"],
               SameRun(lines).Slam().Covariance({59}, {terse::CovarianceFrame::kWorldAxes, {}}));
}

TEST_F(OnlineCommand, RequestsChangeNothingAndAreNotInTheJournal) {
  const auto lines = Measurements(60);
  std::string asking;
  for (std::size_t k = 0; k < lines.size(); ++k) {
    asking += lines[k] + '\n';
    if (k > 10) asking += "COVARIANCE 0 1\n";
  }
  const auto expected = Answers(Join(lines, 0, lines.size()), kOptions + "--journal without --output plain");
  std::vector<json> decisions, answers;
  for (const json& answer : Answers(asking, kOptions + "--journal with --output asked")) {
    (answer.contains("covariance") ? answers : decisions).push_back(WithoutSeconds(answer));
  }
  EXPECT_EQ(answers.size(), lines.size() - 11);
  ASSERT_EQ(decisions.size(), expected.size());
  for (std::size_t k = 0; k < expected.size(); ++k) EXPECT_EQ(decisions[k], WithoutSeconds(expected[k]));
  EXPECT_EQ(Read("with"), Read("without"));
  ExpectSameResults("plain", "asked");
  // The run that is resumed gives the same answer.
  const auto resumed = Answers("COVARIANCE 0 1\n", kOptions + "--journal with");
  ASSERT_EQ(resumed.size(), 2u);
  EXPECT_EQ(resumed[0]["lines"], lines.size());
  EXPECT_EQ(Read("with"), Read("without"));
  EXPECT_EQ(resumed[1]["covariance"],
            Answers(Join(lines, 0, lines.size()) + "FLUSH\nCOVARIANCE 0 1\n", kOptions + "--quiet")[0]["covariance"]);
}

TEST_F(OnlineCommand, RequestsThatMakeNoSenseAreNamed) {
  const std::string odometry = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n";
  const auto error = [&](const std::string& request) {
    const auto answers = Answers(odometry + request + "\nFLUSH\n", kOptions);
    EXPECT_EQ(answers.size(), 3u) << request;
    return answers.at(1)["error"];
  };
  EXPECT_EQ(error("COVARIANCE 1"), "stdin:2: pose 1 is not closed yet; a blank line or FLUSH closes it");
  EXPECT_EQ(error("COVARIANCE 0 7"), "stdin:2: pose 7 is unknown");
  EXPECT_EQ(error("COVARIANCE 0 0"), "stdin:2: COVARIANCE of a pose seen from itself, expected two distinct poses");
  EXPECT_EQ(error("COVARIANCE"), "stdin:2: COVARIANCE takes the id of a pose, or of two");
  EXPECT_EQ(error("COVARIANCE 0x"), "stdin:2: COVARIANCE of \"0x\", expected the id of a pose");
  EXPECT_EQ(error("COVARIANCES 0"), "stdin:2: expected a tag of the g2o format, the line starts with \"COVARIANCES\"");
  Write("input", odometry + "COVARIANCE 9\n");
  EXPECT_EQ(Run(kOptions + "--strict < input").exit_code, 1);
}

// Killed again and again, it ends as if it had never been. TERSE_KILLS: how often.
TEST_F(OnlineCommand, SurvivesKills) {
  const char* const asked = std::getenv("TERSE_KILLS");
  const int kills = asked != nullptr ? std::atoi(asked) : terse::kSlowBuild ? 12 : 40;
  const auto lines = Measurements(110 + kills);
  std::map<std::string, json> expected;
  for (const json& answer : Answers(Join(lines, 0, lines.size()), kOptions + "--output whole")) {
    if (answer.contains("pose")) expected[answer["pose"].dump()] = WithoutSeconds(answer);
  }
  std::mt19937 random(7);
  const std::string arguments = kOptions + "--journal journal";
  std::size_t next = 0;
  int seen = 0;
  for (int round = 0; round < kills; ++round) {
    const bool resumes = Exists("journal");
    Child child(folder_.string(), arguments);
    if (resumes) {
      const json resumed = child.Receive();
      ASSERT_TRUE(resumed["resumed"].get<bool>());
      EXPECT_GE(resumed["poses"].get<int>(), seen);
      EXPECT_GE(resumed["lines"].get<std::size_t>(), next);
      next = resumed["lines"];
    }
    child.Send(Join(lines, next, next + 1 + random() % (kills > 100 ? 2 : 20)));
    // A slow start must not end before there is anything to resume.
    while (!Exists("journal") || Read("journal").find('\n') == std::string::npos)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    std::this_thread::sleep_for(std::chrono::microseconds(random() % 8000));
    child.Kill();
    for (const json& answer : child.ReceiveAll()) {
      if (!answer.contains("pose")) continue;
      EXPECT_EQ(WithoutSeconds(answer), expected.at(answer["pose"].dump()));
      seen = std::max(seen, answer["pose"].get<int>() + 1);
    }
  }
  Child child(folder_.string(), arguments + " --output pieces");
  const json resumed = child.Receive();
  child.Send(Join(lines, resumed["lines"], lines.size()));
  EXPECT_FALSE(child.Finish().empty());
  ExpectSameResults("pieces", "whole");
}

// The journal of a run without an end begins anew, beside a snapshot; killed at any moment the run goes on from the
// two.
TEST_F(OnlineCommand, SurvivesKillsWhileTheJournalBeginsAnew) {
  constexpr int kKills = 30;
  const auto lines = Measurements(150);
  std::map<std::string, json> expected;
  for (const json& answer : Answers(Join(lines, 0, lines.size()), kOptions + "--output whole")) {
    if (answer.contains("pose")) expected[answer["pose"].dump()] = WithoutSeconds(answer);
  }
  std::mt19937 random(11);
  const std::string arguments = kOptions + "--remember all --journal journal --journal-size 0.002";
  std::size_t next = 0;
  std::set<std::string> snapshots;
  for (int round = 0; round < kKills; ++round) {
    const bool resumes = Exists("journal");
    Child child(folder_.string(), arguments);
    if (resumes) {
      const json resumed = child.Receive();
      ASSERT_TRUE(resumed["resumed"].get<bool>());
      EXPECT_GE(resumed["lines"].get<std::size_t>(), next);
      next = resumed["lines"];
    }
    // On a slow machine every other child has to get somewhere: it is killed when it has answered the last line.
    const bool waits = round % 2 == 0;
    child.Send(Join(lines, next, next + 1 + random() % 12) + (waits ? "COVARIANCE 0\n" : ""));
    const auto expect = [&](const json& answer) {
      if (answer.contains("pose")) {
        EXPECT_EQ(WithoutSeconds(answer), expected.at(answer["pose"].dump()));
      }
    };
    while (waits) {
      const json answer = child.Receive();
      ASSERT_FALSE(answer.is_null());
      expect(answer);
      if (answer.contains("covariance") || answer.contains("error")) break;
    }
    while (!Exists("journal") || Read("journal").find('\n') == std::string::npos)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    std::this_thread::sleep_for(std::chrono::microseconds(random() % 8000));
    child.Kill();
    for (const json& answer : child.ReceiveAll()) expect(answer);
    // However often it began anew, so much is on the disk: a journal of a few lines and at most two snapshots.
    EXPECT_LT(Read("journal").size(), 20000u);
    const std::string journal = Read("journal");
    if (const std::size_t at = journal.find("\"snapshot\""); at != std::string::npos)
      snapshots.insert(journal.substr(at, journal.find('}', at) - at));
  }
  EXPECT_GT(snapshots.size(), 3u);
  Child child(folder_.string(), arguments + " --output pieces");
  const json resumed = child.Receive();
  child.Send(Join(lines, resumed["lines"], lines.size()));
  EXPECT_FALSE(child.Finish().empty());
  for (const std::string file : {"/compact.g2o", "/trajectory.tum"})
    EXPECT_EQ(Read("pieces" + file), Read("whole" + file));
}

TEST_F(OnlineCommand, SnapshotsOfAnotherJournalAreRefused) {
  const auto lines = Measurements(120);
  const std::string options = kOptions + "--remember 50 --journal journal ";
  Write("input", Join(lines, 0, lines.size()));
  Succeed(options + "--journal-size 0.002 < input > answers");
  ASSERT_NE(Read("journal").find("\"snapshot\""), std::string::npos);
  ASSERT_NE(Exists("journal.snapshot-1"), Exists("journal.snapshot-2"));
  const std::string name = Exists("journal.snapshot-1") ? "journal.snapshot-1" : "journal.snapshot-2";
  const std::string snapshot = Read(name), journal = Read("journal");
  EXPECT_EQ(Answers("", options).at(0)["lines"], lines.size());
  std::string damaged = snapshot;
  damaged[damaged.size() / 2] ^= 4;
  for (const std::string& content : {damaged, snapshot.substr(0, snapshot.size() / 2), std::string()}) {
    Write(name, content);
    ExpectFailure(options + "< input", 1, name + ": not the snapshot that the journal journal goes on from");
    EXPECT_EQ(Read("journal"), journal);
  }
  std::filesystem::remove(folder_ / name);
  ExpectFailure(options + "< input", 1, name);
  Write(name, snapshot);
  EXPECT_EQ(Answers("", options).at(0)["lines"], lines.size());
  ExpectFailure(kOptions + "--journal journal --journal-size 0 < input", 2, "--journal-size");
}

TEST_F(OnlineCommand, CutsATornTailAtAnyByte) {
  const auto lines = Measurements(20);
  const std::size_t last = lines.size() - 1;
  Answers(Join(lines, 0, lines.size()), kOptions + "--journal journal --output whole");
  const std::string whole = Read("journal");
  const std::size_t end = whole.rfind('\n', whole.size() - 2) + 1;  // without the closing FLUSH
  const std::size_t start = whole.rfind('\n', end - 2) + 1;         // of the last measurement
  EXPECT_NE(whole.find("FLUSH", end), std::string::npos);
  Write("input", lines[last] + '\n');
  for (std::size_t cut = start; cut < end; ++cut) {
    Write("journal", whole.substr(0, cut));
    const Outcome outcome = Succeed(kOptions + "--journal journal --output pieces < input");
    EXPECT_EQ(ParseLines(outcome.out)[0]["lines"], last) << cut;
    EXPECT_EQ(outcome.err.find("warning") == std::string::npos, cut == start) << outcome.err;
    EXPECT_EQ(Read("journal"), whole) << cut;
    if ((cut - start) % 16 == 0) ExpectSameResults("pieces", "whole");
  }
}

TEST_F(OnlineCommand, RefusesOtherFilesAndOptions) {
  const auto lines = Measurements(20);
  Write("input", Join(lines, 0, lines.size()));
  const std::string use = kOptions + "--journal journal < input";
  const auto refuse = [&](const std::string& content, const std::string& cause) {
    Write("journal", content);
    ExpectFailure(use, 1, "journal: " + cause);
    EXPECT_EQ(Read("journal"), content);
  };
  refuse("my notes\n", "a file of another kind");
  refuse("t", "a file of another kind");
  refuse("terse online journal 1\n", "a journal of another version of the format, this program reads version 2");
  for (const std::string begun : {"", "terse ", "terse online journal 2"}) {  // hold nothing to lose
    Write("journal", begun);
    Succeed(use);
    EXPECT_EQ(Read("journal").rfind("terse online journal 2\n", 0), 0u) << begun;
  }
  const std::string whole = Read("journal");
  for (const std::size_t at : {whole.size() / 2, whole.size() / 3}) {
    std::string damaged = whole;
    damaged[at] = damaged[at] == '7' ? '8' : '7';
    refuse(damaged, "the journal is damaged at byte");
  }
  Write("journal", whole);
  ExpectFailure(use + " --probability 0.2", 1, "probability is 0.1 there, 0.2 now");
  ExpectFailure(use + " --robust dcs", 1, "robust is \"gnc\" there, \"dcs\" now");
  ExpectFailure(use + " --no-innovation-test", 1, "innovation_quantile is 0.9999 there, null now");
  ExpectFailure("online --range 10 10 10 1.5 --journal journal < input", 1, "dimension is 2 there, 3 now");
  Succeed(kOptions + "--keep-poses 10% --journal other < input");
  ExpectFailure(kOptions + "--journal other < input", 1, "keep_poses is 0.1 there, null now");
  ExpectFailure(kOptions + "--journal . < input", 1, "regular file");
  EXPECT_EQ(Read("journal"), whole);
  Child first(folder_.string(), kOptions + "--journal journal");
  EXPECT_TRUE(first.Receive()["resumed"].get<bool>());
  ExpectFailure(use, 1, "another run is using this journal");
}

// What the solver could not take changed nothing, so the story goes on as if it had not come.
TEST_F(OnlineCommand, WhatFailedIsNotReplayed) {
  const std::string edge = " 1 0 0 100 0 0 100 0 100\n";
  const std::string huge = "EDGE_SE2 1 2 1e300 1e300 0 100 0 0 100 0 100\n";
  Write("input", "EDGE_SE2 0 1" + edge + huge + "EDGE_SE2 0 2 5 0 0 100 0 0 100 0 100\nFLUSH\nEDGE_SE2 1 3" + edge +
                     "DISCARD\nDISCARD\nEDGE_SE2 1 3" + edge);
  const auto answers = ParseLines(Succeed(kOptions + "--journal journal --output whole < input").out);
  ASSERT_EQ(answers.size(), 7u);
  const std::string cause = ": the odometry of pose 2 leads beyond all numbers; DISCARD gives up pose 2";
  EXPECT_EQ(answers[2]["error"], "stdin:4" + cause);
  EXPECT_EQ(answers[3]["error"], "stdin:5" + cause);
  EXPECT_EQ(answers[4]["discarded"], 2);
  EXPECT_EQ(answers[5]["error"], "stdin:7: DISCARD, but no pose is open");
  EXPECT_EQ(answers[6]["pose"], 3);
  const auto resumed = ParseLines(Succeed(kOptions + "--journal journal --output pieces < /dev/null").out);
  ASSERT_EQ(resumed.size(), 1u);
  EXPECT_EQ(resumed[0]["last_pose"], 3);
  EXPECT_TRUE(resumed[0]["open_pose"].is_null());
  ExpectSameResults("pieces", "whole");
}

TEST_F(OnlineCommand, DamageIsNotTakenForATornTail) {
  const auto lines = Measurements(12);
  Write("input", Join(lines, 0, lines.size()));
  Succeed(kOptions + "--journal journal < input");
  const std::string whole = Read("journal");
  std::vector<std::string> records;  // the format and the header too
  for (std::size_t at = 0; at < whole.size(); at = whole.find('\n', at) + 1) {
    records.push_back(whole.substr(at, whole.find('\n', at) + 1 - at));
  }
  const auto refuse = [&](const std::string& content, const std::string& what) {
    Write("journal", content);
    ExpectFailure(kOptions + "--journal journal < input", 1, "journal: the journal is damaged at byte");
    EXPECT_EQ(Read("journal"), content) << what;
  };
  const auto joined = [](const std::vector<std::string>& parts) {
    std::string out;
    for (const std::string& part : parts) out += part;
    return out;
  };
  const std::size_t last = records.size() - 1;
  for (std::size_t k = 2; k <= last; ++k) {
    const std::string at = "record " + std::to_string(k);
    std::vector<std::string> changed = records;
    changed.insert(changed.begin() + long(k), records[k]);
    refuse(joined(changed), at + " doubled");
    if (k == last) break;  // nothing tells that there was a last one
    changed = records;
    changed.erase(changed.begin() + long(k));
    refuse(joined(changed), at + " dropped");
    changed = records;
    std::swap(changed[k], changed[k + 1]);
    refuse(joined(changed), at + " swapped");
  }
  // Every byte of the last record, and of one before.
  for (const std::size_t k : {last, last - 3}) {
    std::size_t start = 0;
    for (std::size_t j = 0; j < k; ++j) start += records[j].size();
    for (std::size_t byte = 0; byte + 1 < records[k].size(); byte += byte < 24 ? 1 : 7) {
      std::string changed = whole;
      changed[start + byte] = changed[start + byte] == '1' ? '2' : '1';
      refuse(changed, "byte changed");
      changed = whole;
      refuse(changed.erase(start + byte, 1), "byte missing");
    }
  }
  refuse(whole + std::string(100, '\0'), "zeros behind the end");
  refuse(whole + whole, "twice");
}

// Both inputs stay open until one run has ended: it is the one that was not let in, however slowly they start.
TEST_F(OnlineCommand, TwoRunsThatBeginAJournalAreNotBothLetIn) {
  for (int round = 0; round < 8; ++round) {
    const std::string n = std::to_string(round);
    const std::string run = "('" TERSE_COMMAND "' " + kOptions + "--journal journal" + n +
                            " > /dev/null 2>&1; echo $? >> codes" + n + ") < input 3<&- & ";
    Write("race.sh", "rm -f input; mkfifo input; exec 3<>input; " + run + run + "tries=600; until [ -s codes" + n +
                         " ] || [ $tries = 0 ]; do sleep 0.05; tries=$((tries - 1)); done; exec 3<&-; wait");
    const std::string line = "cd '" + folder_.string() + "' && sh race.sh";
    ASSERT_EQ(std::system(line.c_str()), 0);
    EXPECT_EQ(Read("codes" + n), "1\n0\n");
  }
}

// What is opened first must not become standard output.
TEST_F(OnlineCommand, ClosedDescriptorsAreNotTakenForOthers) {
  const auto lines = Measurements(12);
  Write("input", Join(lines, 0, lines.size()));
  const auto run = [&](const std::string& redirections) {
    const std::string line =
        "cd '" + folder_.string() + "' && '" TERSE_COMMAND "' " + kOptions + "--journal journal " + redirections;
    const int status = std::system(line.c_str());
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  };
  EXPECT_EQ(run("< input >&- 2> err"), 1);
  EXPECT_EQ(Read("err"), "terse: error: (standard output): cannot write: Bad file descriptor\n");
  const auto resumed = Answers("", kOptions + "--journal journal");
  EXPECT_TRUE(resumed.at(0)["resumed"].get<bool>());
  EXPECT_EQ(run("<&- > /dev/null 2> err"), 1);
  EXPECT_NE(Read("err").find("stdin:1: cannot read: Bad file descriptor"), std::string::npos) << Read("err");
  EXPECT_EQ(run("< input > /dev/null 2>&-"), 0);
  EXPECT_TRUE(Answers("", kOptions + "--journal journal").at(0)["resumed"].get<bool>());
}

TEST_F(OnlineCommand, WhatHasNoEndIsNoLine) {
  const std::string edge = " 1 0 0 100 0 0 100 0 100\n";
  const std::string longest = "# " + std::string((16 << 20) - 2, 'x') + '\n';
  const auto answers = Answers("EDGE_SE2 0 1" + edge + longest + "EDGE_SE2 1 2" + edge, kOptions);
  EXPECT_EQ(answers.size(), 3u);
  Write("input", "FLUSH\nx" + longest + "EDGE_SE2 1 2" + edge);
  ExpectFailure(kOptions + "< input", 1, "stdin:2: longer than 16777216 bytes, expected lines of text");
  ExpectFailure(kOptions + "< /dev/zero", 1, "stdin:1: longer than 16777216 bytes");
  // Nor are lines without a measurement kept without end.
  const std::string half = std::string(9 << 20, 'x') + '\n';
  Write("input", half + half + "EDGE_SE2 1 2" + edge);
  ExpectFailure("online --strategy apal < input", 1, "stdin:2: no measurement among 2 lines; expected one");
}

// What a trajectory cannot hold is told when it comes, not at the end of a long run.
TEST_F(OnlineCommand, StampsThatATrajectoryCannotHoldAreRefused) {
  const std::string edge = " 1 0 0 100 0 0 100 0 100\n", far = "9007199254740993";
  Write("input",
        "EDGE_SE2 0 1" + edge + "EDGE_SE2 1 " + far + edge + "VERTEX_SE2 " + far + " 0 0 0\nFIX " + far + "\n");
  const auto answers = ParseLines(Succeed(kOptions + "--output out < input").out);
  ASSERT_EQ(answers.size(), 5u);
  for (const std::size_t k : {1u, 2u, 3u}) {
    EXPECT_NE(answers[k].value("error", "").find("ids beyond 2^53 do not fit"), std::string::npos) << answers[k];
  }
  EXPECT_EQ(Read("out/trajectory.tum").substr(0, 2), "0 ");
  for (const auto& answer : ParseLines(Succeed(kOptions + "< input").out)) EXPECT_EQ(answer.count("error"), 0u);
}

}  // namespace
