#include "terse/core/graph_file.h"

#include <algorithm>
#include <charconv>

#include "files/packed_graph.h"
#include "files/read_graph.h"

namespace terse {
namespace {

constexpr TagLayout kLayouts[] = {
    // Fields after the tag.
    {"EDGE_SE2", TagFamily::kG2o, 2, TagKind::kEdge, 11},                   // from to x y theta, 6 entries
    {"EDGE_SE3:QUAT", TagFamily::kG2o, 3, TagKind::kEdge, 30},              // from to x y z qx qy qz qw, 21 entries
    {"VERTEX_SE2", TagFamily::kG2o, 2, TagKind::kVertex, 4},                // id x y theta
    {"VERTEX_SE3:QUAT", TagFamily::kG2o, 3, TagKind::kVertex, 8},           // id x y z qx qy qz qw
    {"EDGE2", TagFamily::kToroOrIsam, 2, TagKind::kEdge, 11},               // from to x y theta, 6 entries
    {"EDGE3", TagFamily::kToroOrIsam, 3, TagKind::kEdge, 29},               // from to x y z roll pitch yaw, 21 entries
    {"ODOMETRY", TagFamily::kIsam, 2, TagKind::kEdge, 11},                  // as EDGE2
    {"VERTEX2", TagFamily::kToro, 2, TagKind::kVertex, 4},                  // id x y theta
    {"VERTEX3", TagFamily::kToro, 3, TagKind::kVertex, 7},                  // id x y z roll pitch yaw
    {"FIX", TagFamily::kG2o, 0, TagKind::kFix, 0},                          // id ...
    {"EDGE_PRIOR_SE2", TagFamily::kG2o, 2, TagKind::kPosePrior, 10},        // id x y theta, 6 entries
    {"EDGE_PRIOR_SE2_XY", TagFamily::kG2o, 2, TagKind::kPositionPrior, 6},  // id x y, 3 entries
    {"EDGE_SE3_PRIOR", TagFamily::kG2o, 3, TagKind::kPosePrior, 30},        // id parameter, pose, 21 entries
    {"EDGE_PRIOR_SE3_XYZ", TagFamily::kG2o, 3, TagKind::kPositionPrior, 10},  // id x y z, 6 entries
    {"EDGE_SE3_PRIORXYZ", TagFamily::kG2o, 3, TagKind::kPositionPrior, 10},   // as EDGE_PRIOR_SE3_XYZ
    // The same, and the point of the body in its frame: px py [pz].
    {"EDGE_PRIOR_SE2_XY_LEVER", TagFamily::kG2o, 2, TagKind::kLeverPositionPrior, 8},
    {"EDGE_PRIOR_SE3_XYZ_LEVER", TagFamily::kG2o, 3, TagKind::kLeverPositionPrior, 13},
    {"PARAMS_SE3OFFSET", TagFamily::kG2o, 0, TagKind::kOffset, 8},  // id, pose
};

bool IsTag(std::string_view text) {
  const char c = text.front();
  return (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == '_';
}

struct Classified {
  std::vector<GraphLine> known;
  std::map<std::string, long> skipped_tags;
  std::unordered_set<std::int64_t> other_vertices;  // ids of vertices with tags that are not known
};

// The id of a vertex with a tag that is not known, for all that can be seen.
void AddOtherVertex(const TextFile& file, const TextLine& line, std::unordered_set<std::int64_t>* ids) {
  if (line.text.rfind("VERTEX", 0) != 0) return;
  Fields fields(file.Path());
  fields.Split(line);
  std::int64_t id = 0;
  if (fields.Count() < 2) return;
  const std::string_view text = fields.Text(1);
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), id);
  if (error == std::errc() && end == text.data() + text.size()) ids->insert(id);
}

FileError NotAGraph(const TextFile& file, const std::vector<TextLine>& lines) {
  std::string cause = "expected a g2o, TORO or iSAM graph; ";
  if (lines.empty()) return FileError(file.Path(), 0, cause + "the file holds comments and blank lines only");
  Fields fields(file.Path());
  fields.Split(lines.front());
  cause += "the first line reads " + Quoted(lines.front().text);
  const bool is_row_of_numbers = (fields.Count() == 8 || fields.Count() == 12) && IsNumber(fields.Text(0));
  if (is_row_of_numbers) cause += ", which looks like a trajectory (" + std::to_string(fields.Count()) + " numbers)";
  return fields.Error(cause);
}

Classified Classify(const TextFile& file) {
  const std::vector<TextLine> lines = file.Lines();
  Classified out;
  out.known.reserve(lines.size());
  const TextLine* odd_line = nullptr;
  bool is_graph = false;
  const TagLayout* layout = nullptr;
  for (const TextLine& line : lines) {
    const std::string_view tag = FirstField(line.text);
    if (layout == nullptr || layout->tag != tag) layout = FindLayout(tag);
    if (layout != nullptr) {
      out.known.push_back({line, layout});
      is_graph = is_graph || layout->kind != TagKind::kOffset;
    }
    if (layout == nullptr && !IsTag(tag) && odd_line == nullptr) odd_line = &line;
    if (layout != nullptr) continue;
    ++out.skipped_tags[std::string(tag)];
    AddOtherVertex(file, line, &out.other_vertices);
  }
  if (!is_graph) throw NotAGraph(file, lines);
  if (odd_line != nullptr) {
    throw FileError(file.Path(), odd_line->number,
                    "expected a tag, the line starts with " + Quoted(FirstField(odd_line->text)));
  }
  return out;
}

std::string Describe(const GraphLine& line) {
  return std::string(line.layout->tag) + " (line " + std::to_string(line.line.number) + ")";
}

// 2 or 3. Throws if both occur. FIX alone counts as 2D, and fails later for want of poses.
int Dimension(const std::string& path, const std::vector<GraphLine>& lines) {
  const GraphLine* first = nullptr;
  for (const GraphLine& line : lines) {
    if (line.layout->dimension == 0) continue;
    if (first == nullptr) first = &line;
    if (line.layout->dimension == first->layout->dimension) continue;
    throw FileError(path, line.line.number,
                    "the file mixes 2D and 3D: " + std::string(line.layout->tag) + " after " + Describe(*first) +
                        ", expected one kind in a file");
  }
  return first == nullptr ? 2 : first->layout->dimension;
}

// The family of all lines; kToroOrIsam if there are EDGE2 or EDGE3 lines only. Throws if families are mixed.
TagFamily Family(const std::string& path, const std::vector<GraphLine>& lines) {
  const GraphLine* first = nullptr;
  for (const GraphLine& line : lines) {
    if (line.layout->kind == TagKind::kOffset) continue;
    if (first == nullptr) first = &line;
    const TagFamily a = first->layout->family, b = line.layout->family;
    if (a == b) continue;
    if (a == TagFamily::kG2o || b == TagFamily::kG2o || (a != TagFamily::kToroOrIsam && b != TagFamily::kToroOrIsam)) {
      throw FileError(path, line.line.number,
                      "the file mixes formats: " + std::string(line.layout->tag) + " after " + Describe(*first) +
                          ", expected one kind in a file");
    }
    if (a == TagFamily::kToroOrIsam) first = &line;
  }
  return first->layout->family;
}

template <class Pose>
GraphFile Read(const std::string& path, const Classified& classified, const ReadOptions& options) {
  const std::vector<GraphLine>& lines = classified.known;
  const TagFamily family = Family(path, lines);
  if (family == TagFamily::kG2o) return ReadG2o<Pose>(path, lines, classified.other_vertices, options);
  std::vector<GraphLine> edges_and_vertices = lines;  // without g2o's parameters
  edges_and_vertices.erase(std::remove_if(edges_and_vertices.begin(), edges_and_vertices.end(),
                                          [](const GraphLine& line) { return line.layout->kind == TagKind::kOffset; }),
                           edges_and_vertices.end());
  const bool is_isam =
      family == TagFamily::kIsam || (family == TagFamily::kToroOrIsam && LooksLikeIsam<Pose>(path, edges_and_vertices));
  return is_isam ? ReadIsam<Pose>(path, edges_and_vertices, options)
                 : ReadToro<Pose>(path, edges_and_vertices, options);
}

}  // namespace

const TagLayout* FindLayout(std::string_view tag) {
  const auto* end = std::end(kLayouts);
  const auto* it = std::find_if(std::begin(kLayouts), end, [&](const TagLayout& l) { return l.tag == tag; });
  return it == end ? nullptr : it;
}

const char* Name(GraphFormat format) {
  switch (format) {
    case GraphFormat::kG2o: return "g2o";
    case GraphFormat::kToro: return "TORO";
    case GraphFormat::kIsam: return "iSAM";
    case GraphFormat::kPacked: return "packed";
  }
  return "";
}

std::string DescribeSkippedTags(const GraphFile& file) {
  std::string out;
  for (const auto& [tag, count] : file.skipped_tags) {
    if (tag.rfind("PARAMS_", 0) == 0) continue;
    out += (out.empty() ? "" : ", ") + (tag == "FIX" ? "FIX of such vertices" : tag) + " " + std::to_string(count);
  }
  return out;
}

GraphFile ReadGraph(const std::string& path, const ReadOptions& options) {
  if (LooksPacked(path)) return ReadPacked(path, options);
  const TextFile file(path);
  Classified lines = Classify(file);
  const bool is_planar = Dimension(path, lines.known) == 2;
  GraphFile out = is_planar ? Read<SE2>(path, lines, options) : Read<SE3>(path, lines, options);
  out.skipped_tags.merge(lines.skipped_tags);
  // Sensor offsets are for priors in space.
  const auto is_offset = [](const GraphLine& line) { return line.layout->kind == TagKind::kOffset; };
  const auto offsets = std::count_if(lines.known.begin(), lines.known.end(), is_offset);
  if (offsets > 0 && (is_planar || out.format != GraphFormat::kG2o)) {
    out.skipped_tags["PARAMS_SE3OFFSET"] = static_cast<long>(offsets);
  }
  return out;
}

template <class Pose>
PoseGraph<Pose> ReadPoseGraph(const std::string& path, const ReadOptions& options) {
  GraphFile file = ReadGraph(path, options);
  if (auto* graph = std::get_if<PoseGraph<Pose>>(&file.graph)) return std::move(*graph);
  constexpr bool kIs3D = Pose::kDim == 3;
  throw FileError(
      path, 0,
      std::string(kIs3D ? "holds a 2D" : "holds a 3D") + " graph, expected a " + (kIs3D ? "3D" : "2D") + " one");
}
template PoseGraph<SE2> ReadPoseGraph<SE2>(const std::string&, const ReadOptions&);
template PoseGraph<SE3> ReadPoseGraph<SE3>(const std::string&, const ReadOptions&);

}  // namespace terse
