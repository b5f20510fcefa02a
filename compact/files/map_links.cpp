#include "terse/compact/map_links.h"

#include <charconv>
#include <unordered_map>
#include <unordered_set>

#include "terse/core/measurement_line.h"
#include "terse/core/text_lines.h"

namespace terse {
namespace {

constexpr int kNoMap = -1, kSeveralMaps = -2;

// By pose id: the map that has it.
template <class Pose>
std::unordered_map<std::int64_t, int> MapsOfPoses(const std::vector<MapToMerge<Pose>>& maps) {
  std::unordered_map<std::int64_t, int> map_of;
  for (std::size_t k = 0; k < maps.size(); ++k) {
    for (const auto& pose : maps[k].map.poses) {
      const auto [it, is_new] = map_of.emplace(pose.id.value, static_cast<int>(k));
      if (!is_new) it->second = kSeveralMaps;
    }
  }
  return map_of;
}

template <class Pose>
class Reader {
 public:
  Reader(const std::string& path, const std::vector<MapToMerge<Pose>>& maps, const ReadOptions& options)
      : maps_(maps), fields_(path), lines_(path, options), map_of_(MapsOfPoses(maps)) {
    poses_.resize(maps.size());
    for (std::size_t k = 0; k < maps.size(); ++k) {
      for (const auto& pose : maps[k].map.poses) poses_[k].insert(pose.id.value);
    }
  }

  MapLink<Pose> Read(const TextLine& line) {
    fields_.Split(line);
    const char* tag = Pose::kDim == 2 ? "EDGE_SE2" : "EDGE_SE3:QUAT";
    if (fields_.Text(0) != tag)
      throw fields_.Error(Quoted(fields_.Text(0)) + ", expected " + tag +
                          ": links between maps are edges of their dimension");
    if (fields_.Count() < 3) throw fields_.Error("expected two poses after the tag, as in '1:17 2:240'");
    const End from = EndAt(1), to = EndAt(2);
    if (from.map == to.map)
      throw fields_.Error("both poses are of map " + std::to_string(from.map + 1) +
                          ", expected a link between two maps");
    MapLink<Pose> link;
    link.measured = Measured(line.number);
    link.from_map = from.map;
    link.to_map = to.map;
    link.measured.from = from.pose;
    link.measured.to = to.pose;
    return link;
  }

 private:
  struct End {
    int map;
    PoseId pose;
  };
  // Ends of the same number are two poses here, but not for the parser of graphs.
  RelativePoseFactor<Pose> Measured(long number) {
    const std::string_view ends = "0 1", named = "edge 0 -> 1";
    std::string text(fields_.Text(0));
    (text += ' ') += ends;
    for (int i = 3; i < fields_.Count(); ++i) (text += ' ') += fields_.Text(i);
    try {
      return std::get<RelativePoseFactor<Pose>>(std::get<Factor<Pose>>(lines_.Read(text, number)));
    } catch (const FileError& error) {
      std::string cause = error.cause();
      const std::size_t at = cause.find(named);
      if (at != std::string::npos) {
        cause.replace(at, named.size(), "edge " + std::string(fields_.Text(1)) + " -> " + std::string(fields_.Text(2)));
      }
      throw fields_.Error(cause);
    }
  }
  std::int64_t Number(std::string_view text, std::string_view whole) const {
    std::int64_t value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (text.empty() || error != std::errc() || end != text.data() + text.size())
      throw fields_.Error(Quoted(whole) + " is no pose, expected MAP:ID as in 2:17, or ID");
    return value;
  }
  End EndAt(int field) const {
    const std::string_view text = fields_.Text(field);
    const std::size_t colon = text.find(':');
    if (colon == std::string_view::npos) {
      const PoseId id{Number(text, text)};
      const auto found = map_of_.find(id.value);
      const int map = found == map_of_.end() ? kNoMap : found->second;
      if (map == kNoMap) throw fields_.Error("no map has a pose " + std::to_string(id.value));
      if (map == kSeveralMaps) {
        throw fields_.Error("several maps have a pose " + std::to_string(id.value) +
                            ", expected MAP:ID as in 2:" + std::to_string(id.value));
      }
      return {map, id};
    }
    const std::int64_t map = Number(text.substr(0, colon), text);
    const PoseId id{Number(text.substr(colon + 1), text)};
    if (map < 1 || map > static_cast<std::int64_t>(maps_.size())) {
      throw fields_.Error("there is no map " + std::to_string(map) + ", expected 1 to " + std::to_string(maps_.size()) +
                          ", in the order in which they are given");
    }
    const auto k = static_cast<std::size_t>(map - 1);
    if (poses_[k].count(id.value) == 0)
      throw fields_.Error("map " + std::to_string(map) + " (" + maps_[k].name + ") has no pose " +
                          std::to_string(id.value));
    return {static_cast<int>(k), id};
  }

  const std::vector<MapToMerge<Pose>>& maps_;
  Fields fields_;
  MeasurementLineReader<Pose> lines_;
  std::unordered_map<std::int64_t, int> map_of_;
  std::vector<std::unordered_set<std::int64_t>> poses_;
};

}  // namespace

template <class Pose>
std::vector<MapLink<Pose>> ReadMapLinks(const std::string& path, const std::vector<MapToMerge<Pose>>& maps,
                                        const ReadOptions& options) {
  const TextFile file(path);
  Reader<Pose> reader(path, maps, options);
  std::vector<MapLink<Pose>> links;
  for (const TextLine& line : file.Lines()) links.push_back(reader.Read(line));
  return links;
}

template std::vector<MapLink<SE2>> ReadMapLinks(const std::string&, const std::vector<MapToMerge<SE2>>&,
                                                const ReadOptions&);
template std::vector<MapLink<SE3>> ReadMapLinks(const std::string&, const std::vector<MapToMerge<SE3>>&,
                                                const ReadOptions&);

}  // namespace terse
