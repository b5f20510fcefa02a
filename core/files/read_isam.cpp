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
GraphFile ReadIsam(const std::string& path, const std::vector<GraphLine>& lines, const ReadOptions& options) {
  GraphBuilder<Pose> builder(options);
  Fields fields(path);
  builder.AddPosesOfEdges(path, lines);
  for (const GraphLine& line : lines) {
    fields.Split(line.line);
    if (HasInformation<Pose>(fields)) ExpectFields(fields, *line.layout);
    const PoseId from = IdField(fields, 1, "from"), to = IdField(fields, 2, "to");
    const Pose T_from_to = EulerPoseFields<Pose>(fields, 3);
    const typename Pose::Jacobian R = SquareRoot<Pose>(fields);
    const typename Pose::Jacobian product = R.transpose() * R;
    const typename Pose::Jacobian information = product.template selfadjointView<Eigen::Upper>();
    builder.AddFactor(fields, RelativePoseFactor<Pose>{from, to, T_from_to, information});
  }
  return std::move(builder).Finish(path, GraphFormat::kIsam);
}

template <class Pose>
bool LooksLikeIsam(const std::string& path, const std::vector<GraphLine>& lines) {
  long isam_misfits = 0, toro_misfits = 0;
  Fields fields(path);
  for (const GraphLine& line : lines) {
    fields.Split(line.line);
    if (!HasInformation<Pose>(fields)) return true;
    ExpectFields(fields, *line.layout);
    if (!(SquareRoot<Pose>(fields).diagonal().array() > 0).all()) ++isam_misfits;
    const Eigen::Matrix<double, Pose::kDof, Pose::kDof> information = ToroInformation<Pose>(fields);
    if (!IsDefinite(information)) ++toro_misfits;
  }
  return isam_misfits <= toro_misfits;
}

template GraphFile ReadIsam<SE2>(const std::string&, const std::vector<GraphLine>&, const ReadOptions&);
template GraphFile ReadIsam<SE3>(const std::string&, const std::vector<GraphLine>&, const ReadOptions&);
template bool LooksLikeIsam<SE2>(const std::string&, const std::vector<GraphLine>&);
template bool LooksLikeIsam<SE3>(const std::string&, const std::vector<GraphLine>&);

}  // namespace terse
