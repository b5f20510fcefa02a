// iSAM text: edges only, everything in radians, Omega = R' R with the upper triangle of R row by row. EDGE3 measures
// x y z roll pitch yaw; without the 21 entries R is the identity. iSAM itself keeps the angles as yaw pitch roll and
// warns that its reordering is wrong for entries off the diagonal; here R is in the order of the fields.

#include "files/read_graph.h"
#include "terse/core/definite.h"

namespace terse {
namespace {

template <class Pose>
constexpr int kFirstInformation = 3 + Pose::kDof;

template <class Pose>
bool HasInformation(const Fields& fields) {
  return !(Pose::kDim == 3 && fields.Count() == kFirstInformation<Pose>);
}

template <class Pose>
typename Pose::Jacobian SquareRoot(const Fields& fields) {
  if (!HasInformation<Pose>(fields)) return Pose::Jacobian::Identity();
  return UpperTriangleFields<Pose::kDof>(fields, kFirstInformation<Pose>);
}

}  // namespace

template <class Pose>
GraphFile ReadIsam(GraphLines& lines, const ReadOptions& options) {
  GraphBuilder<Pose> builder(options);
  lines.ForEach({TagKind::kEdge},
                [&](const Fields& fields, const TagLayout& layout) { builder.NameEnds(fields, layout); });
  builder.AddNamedPoses();
  lines.ForEach({TagKind::kEdge}, [&](const Fields& fields, const TagLayout& layout) {
    if (HasInformation<Pose>(fields)) ExpectFields(fields, layout);
    const PoseId from = IdField(fields, 1, "from"), to = IdField(fields, 2, "to");
    const Pose T_from_to = EulerPoseFields<Pose>(fields, 3);
    const typename Pose::Jacobian R = SquareRoot<Pose>(fields);
    const typename Pose::Jacobian product = R.transpose() * R;
    const typename Pose::Jacobian information = product.template selfadjointView<Eigen::Upper>();
    builder.AddFactor(fields, RelativePoseFactor<Pose>{from, to, T_from_to, information});
  });
  return std::move(builder).Finish(lines.Path(), GraphFormat::kIsam);
}

template <class Pose>
bool LooksLikeIsam(GraphLines& lines) {
  long isam_misfits = 0, toro_misfits = 0;
  bool lacks_information = false;  // which only iSAM's may
  lines.ForEach({TagKind::kEdge}, [&](const Fields& fields, const TagLayout& layout) {
    lacks_information = lacks_information || !HasInformation<Pose>(fields);
    if (lacks_information) return;
    ExpectFields(fields, layout);
    if (!(SquareRoot<Pose>(fields).diagonal().array() > 0).all()) ++isam_misfits;
    const Eigen::Matrix<double, Pose::kDof, Pose::kDof> information = ToroInformation<Pose>(fields);
    if (!IsDefinite(information)) ++toro_misfits;
  });
  return lacks_information || isam_misfits <= toro_misfits;
}

template GraphFile ReadIsam<SE2>(GraphLines&, const ReadOptions&);
template GraphFile ReadIsam<SE3>(GraphLines&, const ReadOptions&);
template bool LooksLikeIsam<SE2>(GraphLines&);
template bool LooksLikeIsam<SE3>(GraphLines&);

}  // namespace terse
