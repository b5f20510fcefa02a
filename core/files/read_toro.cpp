// TORO (and HOG-Man): vertices and edges with full information, everything in radians. Information entries in 2D:
// I11 I12 I22 I33 I13 I23; in 3D the upper triangle of (x y z roll pitch yaw).

#include "files/read_graph.h"

namespace terse {

// An error in roll, pitch, yaw about zero is a rotation vector to first order, so the entries are taken as they are.
template <>
Matrix<3, 3> ToroInformation<SE2>(const Fields& fields) {
  const auto entry = [&](int i) { return fields.Number(6 + i, "information"); };
  const double xx = entry(0), xy = entry(1), yy = entry(2), tt = entry(3), xt = entry(4), yt = entry(5);
  Matrix<3, 3> out;
  out << xx, xy, xt, xy, yy, yt, xt, yt, tt;
  return out;
}

template <>
Matrix<6, 6> ToroInformation<SE3>(const Fields& fields) {
  return SymmetricFields<6>(fields, 9);
}

template <class Pose>
GraphFile ReadToro(GraphLines& lines, const ReadOptions& options) {
  GraphBuilder<Pose> builder(options);
  lines.ForEach({TagKind::kVertex, TagKind::kEdge}, [&](const Fields& fields, const TagLayout& layout) {
    if (layout.kind == TagKind::kEdge) return builder.NameEnds(fields, layout);
    ExpectFields(fields, layout);
    builder.AddVertex(fields, EulerPoseFields<Pose>(fields, 2));
  });
  builder.AddNamedPoses();
  lines.ForEach({TagKind::kEdge}, [&](const Fields& fields, const TagLayout& layout) {
    ExpectFields(fields, layout);
    const PoseId from = IdField(fields, 1, "from"), to = IdField(fields, 2, "to");
    const Pose T_from_to = EulerPoseFields<Pose>(fields, 3);
    builder.AddFactor(fields, RelativePoseFactor<Pose>{from, to, T_from_to, ToroInformation<Pose>(fields)});
  });
  return std::move(builder).Finish(lines.Path(), GraphFormat::kToro);
}

template GraphFile ReadToro<SE2>(GraphLines&, const ReadOptions&);
template GraphFile ReadToro<SE3>(GraphLines&, const ReadOptions&);

}  // namespace terse
