#include "terse/core/graph_file.h"

#include <algorithm>
#include <charconv>
#include <optional>

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

// Of tags that are not known: text has no end of words.
constexpr std::size_t kMostSkippedTags = 1000;

// A known tag, and where in the file it comes first.
struct TagUse {
  const TagLayout* layout;
  long line, count;
};

// What a first look at the file says.
struct Classified {
  std::vector<TagUse> tags;  // in the order of the file
  std::map<std::string, long> skipped_tags;
  std::unordered_set<std::int64_t> other_vertices;  // ids of vertices with tags that are not known
};

// The id of a vertex with a tag that is not known, for all that can be seen.
void AddOtherVertex(const std::string& path, const TextLine& line, std::unordered_set<std::int64_t>* ids) {
  if (line.text.rfind("VERTEX", 0) != 0) return;
  Fields fields(path);
  fields.Split(line);
  std::int64_t id = 0;
  if (fields.Count() < 2) return;
  const std::string_view text = fields.Text(1);
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), id);
  if (error == std::errc() && end == text.data() + text.size()) ids->insert(id);
}

FileError NotAGraph(const std::string& path, const TextLine& first_line) {
  Fields fields(path);
  fields.Split(first_line);
  std::string cause = "expected a g2o, TORO or iSAM graph; the first line reads " + Quoted(first_line.text);
  const bool is_row_of_numbers = (fields.Count() == 8 || fields.Count() == 12) && IsNumber(fields.Text(0));
  if (is_row_of_numbers) cause += ", which looks like a trajectory (" + std::to_string(fields.Count()) + " numbers)";
  return fields.Error(cause);
}

FileError NoLines(const LineStream& at_end) {
  const std::string& path = at_end.File().Path();
  if (at_end.LineNumber() == 0) return FileError(path, 0, "the file is empty, expected lines of text");
  return FileError(path, 0, "expected a g2o, TORO or iSAM graph; the file holds comments and blank lines only");
}

void CountTag(const GraphLine& line, std::vector<TagUse>* tags) {
  const auto is_of_line = [&](const TagUse& use) { return use.layout == line.layout; };
  const auto use = std::find_if(tags->begin(), tags->end(), is_of_line);
  if (use == tags->end()) {
    tags->push_back({line.layout, line.line.number, 1});
  } else {
    ++use->count;
  }
}

bool IsOffset(const TagUse& use) { return use.layout->kind == TagKind::kOffset; }

Classified Classify(GraphLines& lines) {
  Classified out;
  // Not thrown before the end: a binary file is to be called that.
  std::optional<FileError> not_a_graph, odd_tag;
  lines.ForEach([&](const GraphLine& line) {
    if (!not_a_graph) not_a_graph = NotAGraph(lines.Path(), line.line);
    if (line.layout != nullptr) return CountTag(line, &out.tags);
    if (odd_tag) return;
    const std::string_view tag = FirstField(line.line.text);
    if (!IsTag(tag)) {
      odd_tag = FileError(lines.Path(), line.line.number, "expected a tag, the line starts with " + Quoted(tag));
      return;
    }
    ++out.skipped_tags[std::string(tag)];
    if (out.skipped_tags.size() > kMostSkippedTags) {
      odd_tag = FileError(lines.Path(), line.line.number,
                          "lines of more than " + std::to_string(kMostSkippedTags) +
                              " kinds that are not known, the last " + Quoted(tag) + "; expected a graph");
    }
    AddOtherVertex(lines.Path(), line.line, &out.other_vertices);
  });
  if (!not_a_graph) throw NoLines(lines.Stream());
  if (std::all_of(out.tags.begin(), out.tags.end(), IsOffset)) throw *not_a_graph;
  if (odd_tag) throw *odd_tag;
  return out;
}

std::string Describe(const TagUse& use) {
  return std::string(use.layout->tag) + " (line " + std::to_string(use.line) + ")";
}

// 2 or 3. Throws if both occur. FIX alone counts as 2D, and fails later for want of poses.
int Dimension(const std::string& path, const std::vector<TagUse>& tags) {
  const TagUse* first = nullptr;
  for (const TagUse& use : tags) {
    if (use.layout->dimension == 0) continue;
    if (first == nullptr) first = &use;
    if (use.layout->dimension == first->layout->dimension) continue;
    throw FileError(path, use.line,
                    "the file mixes 2D and 3D: " + std::string(use.layout->tag) + " after " + Describe(*first) +
                        ", expected one kind in a file");
  }
  return first == nullptr ? 2 : first->layout->dimension;
}

// The family of all lines; kToroOrIsam if there are EDGE2 or EDGE3 lines only. Throws if families are mixed.
TagFamily Family(const std::string& path, const std::vector<TagUse>& tags) {
  const TagUse* first = nullptr;
  for (const TagUse& use : tags) {
    if (IsOffset(use)) continue;
    if (first == nullptr) first = &use;
    const TagFamily a = first->layout->family, b = use.layout->family;
    if (a == b) continue;
    if (a == TagFamily::kG2o || b == TagFamily::kG2o || (a != TagFamily::kToroOrIsam && b != TagFamily::kToroOrIsam)) {
      throw FileError(path, use.line,
                      "the file mixes formats: " + std::string(use.layout->tag) + " after " + Describe(*first) +
                          ", expected one kind in a file");
    }
    if (a == TagFamily::kToroOrIsam) first = &use;
  }
  return first->layout->family;
}

template <class Pose>
GraphFile Read(GraphLines& lines, const Classified& classified, const ReadOptions& options) {
  const TagFamily family = Family(lines.Path(), classified.tags);
  if (family == TagFamily::kG2o) return ReadG2o<Pose>(lines, classified.other_vertices, options);
  const bool is_isam = family == TagFamily::kIsam || (family == TagFamily::kToroOrIsam && LooksLikeIsam<Pose>(lines));
  return is_isam ? ReadIsam<Pose>(lines, options) : ReadToro<Pose>(lines, options);
}

}  // namespace

bool IsTag(std::string_view text) {
  const char c = text.front();
  return (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == '_';
}

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
  GraphLines lines(path);
  const InputFile& file = lines.Stream().File();
  if (file.IsStored() && file.Version().bytes > MostGraphBytes()) throw TooLarge(path, MostGraphBytes());
  Classified classified = Classify(lines);
  const bool is_planar = Dimension(path, classified.tags) == 2;
  GraphFile out = is_planar ? Read<SE2>(lines, classified, options) : Read<SE3>(lines, classified, options);
  out.skipped_tags.merge(classified.skipped_tags);
  // Sensor offsets are for priors in space.
  const auto offsets = std::find_if(classified.tags.begin(), classified.tags.end(), IsOffset);
  if (offsets != classified.tags.end() && (is_planar || out.format != GraphFormat::kG2o)) {
    out.skipped_tags["PARAMS_SE3OFFSET"] = offsets->count;
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
