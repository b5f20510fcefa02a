// g2o: https://github.com/RainerKuemmerle/g2o/wiki/File-Format. Rotation entries of 3D information are for the
// vector part of the quaternion. EDGE_PRIOR_SE3_XYZ is ours: a position in the world with its information.

#include <cmath>
#include <set>

#include "read_graph.h"

namespace terse {
namespace {

SE3 SpatialPoseFields(const Fields& fields, int first) {
  const Vector<3> position = PositionFields<3>(fields, first);
  const double x = fields.Number(first + 3, "qx"), y = fields.Number(first + 4, "qy");
  const double z = fields.Number(first + 5, "qz"), w = fields.Number(first + 6, "qw");
  const Quaternion q(w, x, y, z);
  const double norm = q.norm();
  // Files print quaternions with as few as four digits; further off is another field order or a broken line.
  if (!(std::abs(norm - 1) <= 1e-2)) {
    throw fields.Error("the quaternion has norm " + Rounded(norm) + " instead of 1");
  }
  return SE3(SO3(q), position);
}

template <class Pose>
Pose PoseFields(const Fields& fields, int first);
template <>
SE2 PoseFields<SE2>(const Fields& fields, int first) {
  return PlanarPoseFields(fields, first);
}
template <>
SE3 PoseFields<SE3>(const Fields& fields, int first) {
  return SpatialPoseFields(fields, first);
}

constexpr int PoseFieldCount(int dimension) { return dimension == 2 ? 3 : 7; }

template <class Pose>
typename Pose::Jacobian InformationFields(const Fields& fields, int first, RotationInformation meaning) {
  const typename Pose::Jacobian information = SymmetricFields<Pose::kDof>(fields, first);
  if constexpr (Pose::kDim == 3) return InformationFromFile(information, meaning);
  return information;
}

// The sensor offsets that are not the identity: a prior that refers to one does not measure the body.
std::set<std::int64_t> SensorOffsets(const std::string& path, const std::vector<GraphLine>& lines) {
  std::set<std::int64_t> out;
  Fields fields(path);
  for (const GraphLine& line : lines) {
    if (line.layout->kind != TagKind::kOffset) continue;
    fields.Split(line.line);
    ExpectFields(fields, *line.layout);
    const SE3 T_body_sensor = SpatialPoseFields(fields, 2);
    if (T_body_sensor.Log().norm() > 0) out.insert(fields.Integer(1, "id"));
  }
  return out;
}

}  // namespace

template <class Pose>
GraphFile ReadG2o(const std::string& path, const std::vector<GraphLine>& lines, const ReadOptions& options) {
  GraphBuilder<Pose> builder(options);
  Fields fields(path);
  for (const GraphLine& line : lines) {
    if (line.layout->kind != TagKind::kVertex) continue;
    fields.Split(line.line);
    ExpectFields(fields, *line.layout);
    builder.AddVertex(fields, PoseFields<Pose>(fields, 2));
  }
  builder.AddPosesOfEdges(path, lines);

  const auto information = [&](int first) {
    return InformationFields<Pose>(fields, first, options.rotation_information);
  };
  const std::set<std::int64_t> offsets = Pose::kDim == 3 ? SensorOffsets(path, lines) : std::set<std::int64_t>();
  constexpr int kPose = PoseFieldCount(Pose::kDim), kDim = Pose::kDim;
  for (const GraphLine& line : lines) {
    const TagKind kind = line.layout->kind;
    if (kind == TagKind::kVertex || kind == TagKind::kOffset) continue;
    fields.Split(line.line);
    ExpectFields(fields, *line.layout);
    if (kind == TagKind::kEdge) {
      const PoseId from = IdField(fields, 1, "from"), to = IdField(fields, 2, "to");
      builder.AddFactor(fields,
                        RelativePoseFactor<Pose>{from, to, PoseFields<Pose>(fields, 3), information(3 + kPose)});
    } else if (kind == TagKind::kPosePrior) {
      const int first = kDim == 3 ? 3 : 2;
      if (kDim == 3 && offsets.count(fields.Integer(2, "parameter id")) != 0) {
        throw fields.Error("a prior with a sensor offset (PARAMS_SE3OFFSET " + std::string(fields.Text(2)) +
                           " is not the identity): not supported");
      }
      builder.AddFactor(fields, PosePriorFactor<Pose>{IdField(fields, 1), PoseFields<Pose>(fields, first),
                                                      information(first + kPose)});
    } else if (kind == TagKind::kPositionPrior) {
      builder.AddFactor(fields, PositionPriorFactor<Pose>{IdField(fields, 1), PositionFields<kDim>(fields, 2),
                                                          SymmetricFields<kDim>(fields, 2 + kDim)});
    } else {
      builder.Fix(fields);
    }
  }
  return std::move(builder).Finish(path, GraphFormat::kG2o);
}

template GraphFile ReadG2o<SE2>(const std::string&, const std::vector<GraphLine>&, const ReadOptions&);
template GraphFile ReadG2o<SE3>(const std::string&, const std::vector<GraphLine>&, const ReadOptions&);

}  // namespace terse
