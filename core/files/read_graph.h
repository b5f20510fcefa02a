#pragma once
// What the readers of graph files share: tags, fields of a line as poses and matrices, the graph under construction.

#include <map>
#include <string>
#include <unordered_set>
#include <vector>

#include "terse/core/graph_file.h"
#include "terse/core/measurement_line.h"
#include "terse/core/text_lines.h"

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
  const TagLayout* layout;
};

// T_body_sensor by parameter id.
using SensorOffsets = std::map<std::int64_t, SE3>;
// Throws unless it is new or the same as before.
void AddSensorOffset(const Fields& fields, const SensorOffsetLine& offset, SensorOffsets* offsets);

// nullptr if the tag is not known.
const TagLayout* FindLayout(std::string_view tag);
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
  // Adds the poses that only edges name. Call between the vertices and the factors.
  void AddPosesOfEdges(const std::string& path, const std::vector<GraphLine>& lines);

  // Throws FileError if the graph is in pieces and the options do not allow that.
  GraphFile Finish(const std::string& path, GraphFormat format) &&;

 private:
  ReadOptions options_;
  PoseGraph<Pose> graph_;
  long repaired_informations_ = 0;
  long skipped_fixes_ = 0;
};

// What a line of the g2o format says, with the information as it stands there but for a prior on a sensor, which
// becomes one on the body.
template <class Pose>
MeasurementLine<Pose> ParseG2oLine(const Fields& fields, const TagLayout& layout, const ReadOptions& options,
                                   const SensorOffsets& offsets);

// One per format. `lines` holds the lines with known tags, of one family and dimension; `other_vertices` the ids of
// vertices with other tags.
template <class Pose>
GraphFile ReadG2o(const std::string& path, const std::vector<GraphLine>& lines,
                  const std::unordered_set<std::int64_t>& other_vertices, const ReadOptions& options);
template <class Pose>
GraphFile ReadToro(const std::string& path, const std::vector<GraphLine>& lines, const ReadOptions& options);
template <class Pose>
GraphFile ReadIsam(const std::string& path, const std::vector<GraphLine>& lines, const ReadOptions& options);

// Whether edges alone (EDGE2, EDGE3) are iSAM's: its entries are an upper triangular square root with a positive
// diagonal, TORO's a positive definite matrix. iSAM if both fit.
template <class Pose>
bool LooksLikeIsam(const std::string& path, const std::vector<GraphLine>& lines);
template <class Pose>
typename Pose::Jacobian ToroInformation(const Fields& fields);

}  // namespace terse
