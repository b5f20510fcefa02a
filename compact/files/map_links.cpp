#include "terse/compact/map_links.h"

#include <charconv>
#include <cmath>
#include <unordered_map>
#include <unordered_set>

#include "terse/core/at.h"
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
class LinkReader {
 public:
  LinkReader(const std::string& path, const std::vector<MapToMerge<Pose>>& maps, const ReadOptions& options)
      : maps_(maps), path_(path), edges_(path, options), map_of_(MapsOfPoses(maps)) {
    poses_.resize(maps.size());
    for (std::size_t k = 0; k < maps.size(); ++k) {
      for (const auto& pose : maps[k].map.poses) poses_[k].insert(pose.id.value);
    }
  }

  MapLink<Pose> Read(const TextLine& line) {
    line_ = line.number;
    const typename NamedEdgeReader<Pose>::Edge edge = edges_.Read(line.text, line.number);
    const End from = EndAt(edge.from), to = EndAt(edge.to);
    if (from.map == to.map)
      throw Error("both poses are of map " + std::to_string(from.map + 1) + ", expected a link between two maps");
    MapLink<Pose> link{from.map, to.map, edge.measured};
    link.measured.from = from.pose;
    link.measured.to = to.pose;
    return link;
  }

 private:
  struct End {
    int map;
    PoseId pose;
  };
  FileError Error(const std::string& cause) const { return FileError(path_, line_, cause); }
  std::int64_t Number(std::string_view text, std::string_view whole) const {
    std::int64_t value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (text.empty() || error != std::errc() || end != text.data() + text.size())
      throw Error(Quoted(whole) + " is no pose, expected MAP:ID as in 2:17, or ID");
    return value;
  }
  End EndAt(std::string_view text) const {
    const std::size_t colon = text.find(':');
    if (colon == std::string_view::npos) {
      const PoseId id{Number(text, text)};
      const auto found = map_of_.find(id.value);
      const int map = found == map_of_.end() ? kNoMap : found->second;
      if (map == kNoMap) throw Error("no map has a pose " + std::to_string(id.value));
      if (map == kSeveralMaps) {
        throw Error("several maps have a pose " + std::to_string(id.value) +
                    ", expected MAP:ID as in 2:" + std::to_string(id.value));
      }
      return {map, id};
    }
    const std::int64_t map = Number(text.substr(0, colon), text);
    const PoseId id{Number(text.substr(colon + 1), text)};
    if (map < 1 || map > static_cast<std::int64_t>(maps_.size())) {
      throw Error("there is no map " + std::to_string(map) + ", expected 1 to " + std::to_string(maps_.size()) +
                  ", in the order in which they are given");
    }
    const auto k = static_cast<std::size_t>(map - 1);
    if (poses_[k].count(id.value) == 0)
      throw Error("map " + std::to_string(map) + " (" + maps_[k].name + ") has no pose " + std::to_string(id.value));
    return {static_cast<int>(k), id};
  }

  const std::vector<MapToMerge<Pose>>& maps_;
  const std::string& path_;
  long line_ = 0;
  NamedEdgeReader<Pose> edges_;
  std::unordered_map<std::int64_t, int> map_of_;
  std::vector<std::unordered_set<std::int64_t>> poses_;
};

}  // namespace

template <class Pose>
NamedEdgeReader<Pose>::NamedEdgeReader(const std::string& source, const ReadOptions& options)
    : source_(source), lines_(source, options) {}

// Ends of the same number are two poses here, but not for the parser of graphs.
template <class Pose>
typename NamedEdgeReader<Pose>::Edge NamedEdgeReader<Pose>::Read(std::string_view text, long number) {
  Fields fields(source_);
  fields.Split({number, text});
  const char* tag = Pose::kDim == 2 ? "EDGE_SE2" : "EDGE_SE3:QUAT";
  if (fields.Text(0) != tag) {
    throw fields.Error(Quoted(fields.Text(0)) + ", expected " + tag +
                       ": links between maps are edges of their dimension");
  }
  if (fields.Count() < 3) throw fields.Error("expected two poses after the tag, as in '1:17 2:240'");
  constexpr std::string_view kEnds = "0 1", kNamed = "edge 0 -> 1";
  Edge edge{std::string(fields.Text(1)), std::string(fields.Text(2)), {}};
  std::string numbered(tag);
  (numbered += ' ') += kEnds;
  for (int i = 3; i < fields.Count(); ++i) (numbered += ' ') += fields.Text(i);
  try {
    edge.measured = std::get<RelativePoseFactor<Pose>>(std::get<Factor<Pose>>(lines_.Read(numbered, number)));
  } catch (const FileError& error) {
    std::string cause = error.cause();
    const std::size_t at = cause.find(kNamed);
    if (at != std::string::npos) cause.replace(at, kNamed.size(), "edge " + edge.from + " -> " + edge.to);
    throw fields.Error(cause);
  }
  return edge;
}

template class NamedEdgeReader<SE2>;
template class NamedEdgeReader<SE3>;

template <class Pose>
std::vector<MapLink<Pose>> ReadMapLinks(const std::string& path, const std::vector<MapToMerge<Pose>>& maps,
                                        const ReadOptions& options) {
  const TextFile file(path);
  LinkReader<Pose> reader(path, maps, options);
  std::vector<MapLink<Pose>> links;
  for (const TextLine& line : file.Lines()) links.push_back(reader.Read(line));
  return links;
}

template <class Pose>
std::vector<MapLink<Pose>> ScaleMapLinks(std::vector<MapLink<Pose>> links,
                                         const std::vector<InformationScale>& scales) {
  const auto mean = [](double a, double b) { return a == b ? a : std::sqrt((a * a + b * b) / 2); };
  for (MapLink<Pose>& link : links) {
    const InformationScale& from = scales[internal::At(link.from_map)];
    const InformationScale& to = scales[internal::At(link.to_map)];
    if (from.IsOne() && to.IsOne()) continue;  // to the last bit
    link.measured = ScaleInformation(link.measured, {mean(from.loops.translation, to.loops.translation),
                                                     mean(from.loops.rotation, to.loops.rotation)});
  }
  return links;
}

#define TERSE_INSTANTIATE(Pose)                                                                              \
  template std::vector<MapLink<Pose>> ReadMapLinks(const std::string&, const std::vector<MapToMerge<Pose>>&, \
                                                   const ReadOptions&);                                      \
  template std::vector<MapLink<Pose>> ScaleMapLinks(std::vector<MapLink<Pose>>, const std::vector<InformationScale>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
