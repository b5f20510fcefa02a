#pragma once
// Graph files: g2o (2D and 3D), TORO and iSAM text, and packed ones. The format is detected from the content.
//
// Strict: anything wrong is a FileError with path, line and cause, and nothing is returned. Numbers are read and
// written independently of the locale; what is written reads back equal to the last bit the format allows.

#include <map>
#include <string>
#include <variant>

#include "terse/core/error.h"
#include "terse/core/pose_graph.h"
#include "terse/core/rotation_information.h"

namespace terse {

enum class GraphFormat { kG2o, kToro, kIsam, kPacked };
const char* Name(GraphFormat format);

using AnyPoseGraph = std::variant<PoseGraph<SE2>, PoseGraph<SE3>>;

struct ReadOptions {
  // What EDGE_SE3:QUAT information means. TORO and iSAM files are in radians always.
  RotationInformation rotation_information = RotationInformation::kQuaternion;
  // Clamps the eigenvalues of an information matrix that is not positive definite instead of refusing it.
  bool repair_information = false;
  // Refuses a graph in pieces, and several poses without an edge. Off: for those who want the poses alone.
  bool expect_connected = true;
};

struct GraphFile {
  AnyPoseGraph graph;
  GraphFormat format = GraphFormat::kG2o;
  // tag -> lines skipped: parameters and tags not known here. FIX: of how many ids that only skipped vertices have.
  std::map<std::string, long> skipped_tags;
  long repaired_informations = 0;
};

// "VERTEX_XY 2, EDGE_SE2_XY 40": what was skipped, for a warning; empty if that was nothing but parameters
// (PARAMS_...), which say nothing about poses.
std::string DescribeSkippedTags(const GraphFile& file);

// Poses appear in the order of their VERTEX lines, then of their first mention in an edge; factors in that of the file.
//
// g2o: VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT, FIX, EDGE_PRIOR_SE2, EDGE_PRIOR_SE2_XY, EDGE_SE3_PRIOR
// with its PARAMS_SE3OFFSET, and a position in the world (id x y z, upper triangle of 3x3) as our own
// EDGE_PRIOR_SE3_XYZ or as hdl_graph_slam's EDGE_SE3_PRIORXYZ. With a lever arm, a position prior is
// EDGE_PRIOR_SE2_XY_LEVER or EDGE_PRIOR_SE3_XYZ_LEVER, our own too: px py [pz] behind.
// EDGE_SE3_PRIOR measures the pose of a sensor on the body, T_world_body T_body_sensor with the parameter's
// T_body_sensor. It is read as the prior on the body that has the same cost to second order in the deviation:
// T_world_body = measured T_body_sensor^-1, information A' Omega A with A = Ad(T_body_sensor^-1).
// FIX of a pose that neither a vertex nor an edge names is refused, unless a vertex of a skipped kind (a landmark) has
// the id.
// TORO: VERTEX2, EDGE2, VERTEX3, EDGE3. iSAM: ODOMETRY, EDGE2, EDGE3, with square-root information.
// Refused besides: a graph in pieces, several poses without an edge, a second vertex line of a pose.
GraphFile ReadGraph(const std::string& path, const ReadOptions& options = {});

// The graph alone, by those who know its dimension: ReadPoseGraph<SE3>(path). FileError if the file has the other one.
template <class Pose>
PoseGraph<Pose> ReadPoseGraph(const std::string& path, const ReadOptions& options = {});

// Written to a temporary file in the same folder, then renamed. Throws FileError. `comment`, if any, stands at the top
// as a line that begins with '#', which g2o skips as we do (not every reader does). Throws std::invalid_argument if it
// is more than one line, NumericalError if a number of the graph is none in the file: information on rotations may
// overflow in g2o's unit.
template <class Pose>
void WriteG2o(const PoseGraph<Pose>& graph, const std::string& path,
              RotationInformation rotation_information = RotationInformation::kQuaternion,
              const std::string& comment = "");
// TORO has no priors and no FIX: FileError if the graph holds any. Its roll, pitch, yaw give a rotation in space back
// to 1e-12, everything else to the last bit.
template <class Pose>
void WriteToro(const PoseGraph<Pose>& graph, const std::string& path);

// To what a packed graph keeps its measurements, in stated standard deviations (of a coordinate given the others, along
// the axes of the residual; of a rotation in space the least of the three). A step of p adds p^2 / 12 to the variance.
// Where the information is far more cautious than the measurements are, as a unit matrix is, that is too coarse:
// ChoosePacking (terse/covariance/packing.h).
struct PackedPrecision {
  double translation = 1.0 / 32, rotation = 1.0 / 32;
};
// Small, for sending: measurements to `precision`, information to half a per cent, ids and order as they are, and no
// values of poses but of fixed ones, as the optimum is found without. A version of this library reads its own files
// only. Throws FileError; std::invalid_argument unless 0 < precision <= 1, NumericalError where a factor cannot be kept
// like this, naming it.
template <class Pose>
void WritePacked(const PoseGraph<Pose>& graph, const std::string& path, const PackedPrecision& precision = {});

}  // namespace terse
