// JSON from files: limits, and what is said of files that are none.

#include <gtest/gtest.h>

#include <array>
#include <random>
#include <set>

#include "terse/compact/json_file.h"
#include "terse/core/limits.h"
#include "testing_files.h"

namespace terse {
namespace {

using nlohmann::json;

std::string Nested(int depth) {
  const auto n = static_cast<std::size_t>(depth);
  return std::string(n, '[') + std::string(n, ']');
}

void ExpectRefused(const std::string& text, long line, const std::string& cause) {
  try {
    ParseJson<json>(text, "run.json");
    ADD_FAILURE() << "taken: " << text.substr(0, 40);
  } catch (const FileError& error) {
    EXPECT_EQ(error.path(), "run.json");
    EXPECT_EQ(error.line(), line) << error.what();
    EXPECT_NE(error.cause().find(cause), std::string::npos) << error.what();
  }
}

TEST(JsonFileTest, DepthIsLimited) {
  EXPECT_EQ(ParseJson<json>(Nested(kMostJsonDepth), "run.json").dump(), Nested(kMostJsonDepth));
  ExpectRefused(Nested(kMostJsonDepth + 1), 1, "nested deeper than 100 lists and objects, at byte 101");
  ExpectRefused("\n\n" + Nested(kMostJsonDepth + 1), 3, "at byte 103");
  ExpectRefused(std::string(100000, '['), 1, "nested deeper");
  std::string objects;
  for (int k = 0; k < 100000; ++k) objects += "{\"a\":";
  ExpectRefused(objects, 1, "nested deeper");
  EXPECT_THROW(ParseJson<nlohmann::ordered_json>(objects, "run.json"), FileError);
}

TEST(JsonFileTest, DepthIsThatOfBracketsOutsideOfStrings) {
  const std::string many(1000, '[');
  EXPECT_EQ(ParseJson<json>('"' + many + '"', "").get<std::string>(), many);
  EXPECT_EQ(ParseJson<json>("\"\\\"" + many + "\\\\\"", "").get<std::string>(), '"' + many + '\\');
  std::string wide = "[[]";
  for (int k = 0; k < 1000; ++k) wide += ",[]";
  EXPECT_EQ(ParseJson<json>(wide + ']', "").size(), 1001u);
  ExpectRefused("\"\\\\\"" + many, 1, "nested deeper");  // that string ends
}

TEST(JsonFileTest, MistakesHaveALine) {
  ExpectRefused("{\"a\": 1,\n\"b\": ]}", 2, "not valid JSON");
  ExpectRefused("{\"a\": 1,\n", 2, "ends too early");
  ExpectRefused("", 1, "ends too early");
  ExpectRefused("[1e999]", 0, "too large");
  ExpectRefused("[\"\xff\"]", 1, "not valid JSON");
  EXPECT_THROW(ParseJson<json>("{", "run.json", 7), FileError);
  try {
    ParseJson<json>("{]", "run.json", 7);
  } catch (const FileError& error) {
    EXPECT_EQ(error.line(), 7);
  }
}

TEST(JsonFileTest, FilesHoldObjects) {
  const TestFile list("list.json", "[1]"), object("object.json", "{\"a\": [2]}"),
      zero("zero.json", std::string(9, '\0'));
  EXPECT_EQ(ReadJsonObject<json>(object.Path(), "figures")["a"][0], 2);
  for (const auto& [path, cause] :
       {std::pair(list.Path(), "expected figures as a JSON object, found array"),
        std::pair(zero.Path(), "a binary file"), std::pair(std::string("/dev/zero"), "binary"),
        std::pair(std::string("nowhere.json"), "does not exist")}) {
    try {
      ReadJsonObject<json>(path, "figures");
      ADD_FAILURE() << path;
    } catch (const FileError& error) {
      EXPECT_EQ(error.path(), path);
      EXPECT_NE(error.cause().find(cause), std::string::npos) << error.what();
    }
  }
}

// What is left of a value without what stands behind other keys.
json Part(const json& value, const std::set<std::string>& keys) {
  if (!value.is_structured()) return value;
  json out = value.is_object() ? json::object() : json::array();
  for (const auto& item : value.items()) {
    if (value.is_array()) {
      out.push_back(Part(item.value(), keys));
    } else if (keys.count(item.key()) != 0) {
      out[item.key()] = Part(item.value(), keys);
    }
  }
  return out;
}

json Draw(std::mt19937& random, int depth) {
  const int kind = std::uniform_int_distribution<int>(0, depth > 0 ? 7 : 5)(random);
  const std::array<json, 6> leaves = {nullptr, true, -7, 18446744073709551615u, 0.125, "text \\\" {[,"};
  if (kind < 6) return leaves[static_cast<std::size_t>(kind)];
  json out = kind == 6 ? json::array() : json::object();
  for (const char* key : {"a", "b", "c", "d"}) {
    json item = Draw(random, depth - 1);
    if (kind == 6) {
      out.push_back(std::move(item));
    } else {
      out[key] = std::move(item);
    }
  }
  return out;
}

TEST(JsonFileTest, AnObjectIsReadWithoutWhatNobodyAsksFor) {
  std::mt19937 random(7);
  const std::set<std::string> keys = {"a", "c"};
  std::size_t left = 0, all = 0;
  for (int k = 0; k < 200; ++k) {
    json object;
    for (const char* key : {"a", "b", "c"}) object[key] = Draw(random, 4);
    const TestFile file("object.json", object.dump(k % 3));
    EXPECT_EQ(ReadJsonObject(file.Path(), "figures", keys), Part(object, keys)) << object;
    left += Part(object, keys).dump().size();
    all += object.dump().size();
  }
  EXPECT_LT(left, all);
  EXPECT_GT(left, all / 10);
}

TEST(JsonFileTest, WhatNobodyAsksForIsCheckedToo) {
  for (const auto& [text, cause] :
       {std::pair("{\"b\": [1,]}", "not valid JSON"), std::pair("{\"b\": [1", "ends too early"),
        std::pair("{\"b\": 1e999}", "too large"), std::pair("[{\"a\": 1}]", "found array"),
        std::pair("{\"a\": 1}}", "not valid JSON"), std::pair("", "ends too early")}) {
    const TestFile file("object.json", text);
    try {
      ReadJsonObject(file.Path(), "figures", {"a"});
      ADD_FAILURE() << text;
    } catch (const FileError& error) {
      EXPECT_NE(error.cause().find(cause), std::string::npos) << error.what();
    }
  }
  const TestFile deep("deep.json", "{\"b\": " + Nested(kMostJsonDepth) + '}');
  EXPECT_THROW(ReadJsonObject(deep.Path(), "figures", {"a"}), FileError);
}

TEST(JsonFileTest, WholeNumbersFit) {
  EXPECT_EQ(WholeNumber(json::parse("-9223372036854775808"), ""), INT64_MIN);
  EXPECT_EQ(WholeNumber(json::parse("9223372036854775807"), ""), INT64_MAX);
  for (const char* text : {"9223372036854775808", "1e300", "1.5", "2.0", "null", "\"1\"", "[1]", "true"}) {
    EXPECT_THROW(WholeNumber(json::parse(text), "run.json"), FileError) << text;
  }
}

}  // namespace
}  // namespace terse
