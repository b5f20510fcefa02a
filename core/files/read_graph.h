#pragma once
// What the readers of graph files share: tags, fields of a line as poses and matrices, the graph under construction.

#include <algorithm>
#include <initializer_list>
#include <map>
#include <string>
#include <unordered_set>
#include <vector>

#include "terse/core/graph_file.h"
#include "terse/core/line_stream.h"
#include "terse/core/measurement_line.h"

namespace terse {

enum class TagFamily { kG2o, kToro, kIsam, kToroOrIsam };
enum class TagKind { kVertex, kEdge, kPosePrior, kPositionPrior, kLeverPositionPrior, kFix, kOffset };

struct TagLayout {
  std::string_view tag;
  TagFamily family;
  int dimension;  // 2, 3 or 0: either
  TagKind kind;
  int fields;  // after the tag; 0: one or more
};

struct GraphLine {
  TextLine line;
  const TagLayout* layout;  // nullptr if the tag is not known
};

// T_body_sensor by parameter id.
using SensorOffsets = std::map<std::int64_t, SE3>;
// Throws unless it is new or the same as before.
void AddSensorOffset(const Fields& fields, const SensorOffsetLine& offset, SensorOffsets* offsets);

// Whether a line may begin like this: a letter or _.
bool IsTag(std::string_view text);
// nullptr if the tag is not known.
const TagLayout* FindLayout(std::string_view tag);

// The lines of a file, as often as they are asked for: it need not fit into memory.
class GraphLines {
 public:
  explicit GraphLines(const std::string& path) : stream_(path) {}
  const std::string& Path() const { return stream_.File().Path(); }
  const LineStream& Stream() const { return stream_; }
  // Calls use(const GraphLine&) for every line.
  template <class Use>
  void ForEach(Use use) {
    stream_.Rewind();
    for (GraphLine line{{}, nullptr}; stream_.Next(line.line);) {
      const std::string_view tag = FirstField(line.line.text);
      if (line.layout == nullptr || line.layout->tag != tag) line.layout = FindLayout(tag);
      use(static_cast<const GraphLine&>(line));
    }
  }
  // Those with tags of these kinds alone, split into fields: use(const Fields&, const TagLayout&).
  template <class Use>
  void ForEach(std::initializer_list<TagKind> kinds, Use use) {
    Fields fields(Path());
    ForEach([&](const GraphLine& line) {
      if (line.layout == nullptr) return;
      if (std::find(kinds.begin(), kinds.end(), line.layout->kind) == kinds.end()) return;
      fields.Split(line.line);
      use(static_cast<const Fields&>(fields), *line.layout);
    });
  }

 private:
  LineStream stream_;
};

// Throws unless the line has as many fields as the layout says.
void ExpectFields(const Fields& fields, const TagLayout& layout);

inline PoseId IdField(const Fields& fields, int i, const char* name = "id") { return {fields.Integer(i, name)}; }

// x y [z] from field `first` on.
template <int N>
Vector<N> PositionFields(const Fields& fields, int first);
// x y theta.
SE2 PlanarPoseFields(const Fields& fields, int first);
// The upper triangle row by row, the rest zero.
template <int N>
Matrix<N, N> UpperTriangleFields(const Fields& fields, int first);
// The same, mirrored.
template <int N>
Matrix<N, N> SymmetricFields(const Fields& fields, int first);

// x y theta, or x y z roll pitch yaw with R = Rz(yaw) Ry(pitch) Rx(roll): TORO and iSAM.
template <class Pose>
Pose EulerPoseFields(const Fields& fields, int first);

// Clamps the information's eigenvalues if it is not positive definite and the options allow it: true then. Throws if
// the factor is defective otherwise.
template <class Pose>
bool RepairInformation(const Fields& fields, const ReadOptions& options, Factor<Pose>& factor);

// Throws FileError if the graph is in pieces, or has poses but no edges.
template <class Pose>
void ExpectConnected(const PoseGraph<Pose>& graph, const std::string& path);

template <class Pose>
class GraphBuilder {
 public:
  explicit GraphBuilder(const ReadOptions& options) : options_(options) {}
  const ReadOptions& Options() const { return options_; }

  // All throw FileError with the line of `fields`.
  void AddVertex(const Fields& fields, const Pose& T_world_body);
  void AddFactor(const Fields& fields, Factor<Pose> factor);
  // Those of `other_vertices` are of kinds that are not read: they are counted and left out.
  void Fix(const Fields& fields, const std::unordered_set<std::int64_t>& other_vertices);
  // The line of an edge, with whatever it measures: its ends are poses, even if no vertex line names them.
  void NameEnds(const Fields& fields, const TagLayout& layout);
  // Adds the poses that only edges name, in the order of their names. Call between the vertices and the factors.
  void AddNamedPoses();

  // Throws FileError if the graph is in pieces and the options do not allow that.
  GraphFile Finish(const std::string& path, GraphFormat format) &&;

 private:
  ReadOptions options_;
  PoseGraph<Pose> graph_;
  std::vector<PoseId> named_;  // by edges before a vertex line did
  std::unordered_set<std::int64_t> is_named_;
  long repaired_informations_ = 0;
  long skipped_fixes_ = 0;
};

// What a line of the g2o format says, with the information as it stands there but for a prior on a sensor, which
// becomes one on the body.
template <class Pose>
MeasurementLine<Pose> ParseG2oLine(const Fields& fields, const TagLayout& layout, const ReadOptions& options,
                                   const SensorOffsets& offsets);

// One per format. The lines with known tags are of one family and dimension; `other_vertices` are the ids of vertices
// with other tags.
template <class Pose>
GraphFile ReadG2o(GraphLines& lines, const std::unordered_set<std::int64_t>& other_vertices,
                  const ReadOptions& options);
template <class Pose>
GraphFile ReadToro(GraphLines& lines, const ReadOptions& options);
template <class Pose>
GraphFile ReadIsam(GraphLines& lines, const ReadOptions& options);

// Whether edges alone (EDGE2, EDGE3) are iSAM's: its entries are an upper triangular square root with a positive
// diagonal, TORO's a positive definite matrix. iSAM if both fit.
template <class Pose>
bool LooksLikeIsam(GraphLines& lines);
template <class Pose>
typename Pose::Jacobian ToroInformation(const Fields& fields);

}  // namespace terse
