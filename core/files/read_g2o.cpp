// g2o: https://github.com/RainerKuemmerle/g2o/wiki/File-Format. Rotation entries of 3D information are for the
// vector part of the quaternion. EDGE_PRIOR_SE3_XYZ is ours, EDGE_SE3_PRIORXYZ hdl_graph_slam's: a position in the
// world with its information. Ours too are EDGE_PRIOR_SE2_XY_LEVER and EDGE_PRIOR_SE3_XYZ_LEVER, which name the point
// of the body that was there behind it.

#include <cmath>

#include "files/read_graph.h"
#include "terse/core/number_text.h"

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
    throw fields.Error("the quaternion has norm " + SixDigits(norm) + " instead of 1");
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
  typename Pose::Jacobian information = SymmetricFields<Pose::kDof>(fields, first);
  if constexpr (Pose::kDim == 3) return InformationFromFile(information, meaning);
  return information;
}

// g2o's error of Z, the measured T_world_sensor, is the chart of Z^-1 T_world_body O, O = T_body_sensor. With
// T_world_body = (Z O^-1) Exp(d) that is O^-1 Exp(d) O = Exp(Ad(O^-1) d).
Factor<SE3> PriorOnBody(const PosePriorFactor<SE3>& on_sensor, const SE3& T_body_sensor) {
  const SE3 T_sensor_body = T_body_sensor.Inverse();
  const Matrix<6, 6> A = T_sensor_body.Adjoint();
  const Matrix<6, 6> information = A.transpose() * on_sensor.information * A;
  return PosePriorFactor<SE3>{on_sensor.pose, on_sensor.T_world_body * T_sensor_body,
                              0.5 * (information + information.transpose())};
}

template <class Pose>
Factor<Pose> PosePriorFields(const Fields& fields, const ReadOptions& options, const SensorOffsets& offsets) {
  const int first = Pose::kDim == 3 ? 3 : 2;
  const PosePriorFactor<Pose> prior{
      IdField(fields, 1), PoseFields<Pose>(fields, first),
      InformationFields<Pose>(fields, first + PoseFieldCount(Pose::kDim), options.rotation_information)};
  if constexpr (Pose::kDim == 3) {
    const auto offset = offsets.find(fields.Integer(2, "parameter id"));
    if (offset == offsets.end()) {
      const std::string id(fields.Text(2));
      throw fields.Error("a prior on pose " + std::to_string(prior.pose.value) + " names the sensor offset " + id +
                         ", which no line gives; expected PARAMS_SE3OFFSET " + id +
                         " x y z qx qy qz qw (0 0 0 0 0 0 1 for the body itself)");
    }
    if (offset->second.Log().norm() > 0) return PriorOnBody(prior, offset->second);
  }
  return prior;
}

template <class Pose>
Factor<Pose> FactorFields(const Fields& fields, TagKind kind, const ReadOptions& options,
                          const SensorOffsets& offsets) {
  constexpr int kPose = PoseFieldCount(Pose::kDim), kDim = Pose::kDim;
  const auto information = [&](int first) {
    return InformationFields<Pose>(fields, first, options.rotation_information);
  };
  if (kind == TagKind::kEdge) {
    const PoseId from = IdField(fields, 1, "from"), to = IdField(fields, 2, "to");
    return RelativePoseFactor<Pose>{from, to, PoseFields<Pose>(fields, 3), information(3 + kPose)};
  }
  if (kind == TagKind::kPositionPrior || kind == TagKind::kLeverPositionPrior) {
    PositionPriorFactor<Pose> prior{IdField(fields, 1), PositionFields<kDim>(fields, 2),
                                    SymmetricFields<kDim>(fields, 2 + kDim)};
    constexpr int kLever = 2 + kDim + kDim * (kDim + 1) / 2;
    if (kind == TagKind::kLeverPositionPrior) prior.p_body = PositionFields<kDim>(fields, kLever);
    return prior;
  }
  return PosePriorFields<Pose>(fields, options, offsets);
}

}  // namespace

void AddSensorOffset(const Fields& fields, const SensorOffsetLine& offset, SensorOffsets* offsets) {
  const auto [first, is_new] = offsets->emplace(offset.id, offset.T_body_sensor);
  const SE3 &a = first->second, &b = offset.T_body_sensor;
  const bool is_same =
      a.Translation() == b.Translation() && a.Rotation().Unit().coeffs() == b.Rotation().Unit().coeffs();
  if (is_new || is_same) return;
  throw fields.Error("a second PARAMS_SE3OFFSET " + std::to_string(offset.id) + " with other values, expected one");
}

template <class Pose>
MeasurementLine<Pose> ParseG2oLine(const Fields& fields, const TagLayout& layout, const ReadOptions& options,
                                   const SensorOffsets& offsets) {
  ExpectFields(fields, layout);
  switch (layout.kind) {
    case TagKind::kVertex: return VertexLine<Pose>{IdField(fields, 1), PoseFields<Pose>(fields, 2)};
    case TagKind::kFix: {
      FixLine fix;
      for (int i = 1; i < fields.Count(); ++i) fix.poses.push_back(IdField(fields, i));
      return fix;
    }
    case TagKind::kOffset: return SensorOffsetLine{fields.Integer(1, "id"), SpatialPoseFields(fields, 2)};
    default: return FactorFields<Pose>(fields, layout.kind, options, offsets);
  }
}

template <class Pose>
GraphFile ReadG2o(GraphLines& lines, const std::unordered_set<std::int64_t>& other_vertices,
                  const ReadOptions& options) {
  GraphBuilder<Pose> builder(options);
  Fields fields(lines.Path());
  SensorOffsets offsets;
  const auto parse = [&](const TagLayout& layout) { return ParseG2oLine<Pose>(fields, layout, options, offsets); };
  // A measurement may stand before the pose or the parameter that it names.
  lines.ForEach([&](const GraphLine& line) {
    if (line.layout == nullptr) return;
    const TagLayout& layout = *line.layout;
    const bool is_offset = layout.kind == TagKind::kOffset && Pose::kDim == 3;
    if (layout.kind != TagKind::kVertex && layout.kind != TagKind::kEdge && !is_offset) return;
    fields.Split(line.line);
    if (layout.kind == TagKind::kEdge) {
      builder.NameEnds(fields, layout);
    } else if (is_offset) {
      AddSensorOffset(fields, std::get<SensorOffsetLine>(parse(layout)), &offsets);
    } else {
      builder.AddVertex(fields, std::get<VertexLine<Pose>>(parse(layout)).T_world_body);
    }
  });
  builder.AddNamedPoses();
  lines.ForEach([&](const GraphLine& line) {
    if (line.layout == nullptr) return;
    const TagKind kind = line.layout->kind;
    if (kind == TagKind::kVertex || kind == TagKind::kOffset) return;
    fields.Split(line.line);
    const MeasurementLine<Pose> parsed = parse(*line.layout);
    if (kind == TagKind::kFix) {
      builder.Fix(fields, other_vertices);
    } else {
      builder.AddFactor(fields, std::get<Factor<Pose>>(parsed));
    }
  });
  return std::move(builder).Finish(lines.Path(), GraphFormat::kG2o);
}

template <class Pose>
MeasurementLine<Pose> MeasurementLineReader<Pose>::Read(std::string_view text, long number) {
  if (text.find('\0') != std::string_view::npos)
    throw FileError(source_, number, "the line holds a zero byte, expected text");
  Fields fields(source_);
  fields.Split({number, text});
  const std::string_view tag = fields.Count() > 0 ? fields.Text(0) : std::string_view();
  const TagLayout* layout = FindLayout(tag);
  if (layout == nullptr || layout->family != TagFamily::kG2o) {
    throw fields.Error("expected a tag of the g2o format, the line starts with " + Quoted(tag));
  }
  if (layout->dimension != 0 && layout->dimension != Pose::kDim) {
    throw fields.Error(std::string(tag) + " in a run in " + std::to_string(Pose::kDim) +
                       "D, expected tags of that dimension");
  }
  MeasurementLine<Pose> line = ParseG2oLine<Pose>(fields, *layout, options_, T_body_sensor_);
  if (auto* factor = std::get_if<Factor<Pose>>(&line)) RepairInformation(fields, options_, *factor);
  if (const auto* offset = std::get_if<SensorOffsetLine>(&line)) AddSensorOffset(fields, *offset, &T_body_sensor_);
  return line;
}

int DimensionOfLine(std::string_view text) {
  const std::string source;
  Fields fields(source);
  fields.Split({0, text});
  const TagLayout* layout = fields.Count() > 0 ? FindLayout(fields.Text(0)) : nullptr;
  return layout != nullptr && layout->family == TagFamily::kG2o ? layout->dimension : 0;
}

#define TERSE_INSTANTIATE(Pose)                                                                               \
  template MeasurementLine<Pose> ParseG2oLine<Pose>(const Fields&, const TagLayout&, const ReadOptions&,      \
                                                    const SensorOffsets&);                                    \
  template GraphFile ReadG2o<Pose>(GraphLines&, const std::unordered_set<std::int64_t>&, const ReadOptions&); \
  template class MeasurementLineReader<Pose>;
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
