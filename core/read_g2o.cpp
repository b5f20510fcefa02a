// g2o: https://github.com/RainerKuemmerle/g2o/wiki/File-Format. Rotation entries of 3D information are for the
// vector part of the quaternion. EDGE_PRIOR_SE3_XYZ is ours: a position in the world with its information; so are
// EDGE_PRIOR_SE2_XY_LEVER and EDGE_PRIOR_SE3_XYZ_LEVER, which name the point of the body that was there behind it.

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
  typename Pose::Jacobian information = SymmetricFields<Pose::kDof>(fields, first);
  if constexpr (Pose::kDim == 3) return InformationFromFile(information, meaning);
  return information;
}

template <class Pose>
Factor<Pose> FactorFields(const Fields& fields, TagKind kind, const ReadOptions& options,
                          const std::set<std::int64_t>& offsets) {
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
  const int first = kDim == 3 ? 3 : 2;
  if (kDim == 3 && offsets.count(fields.Integer(2, "parameter id")) != 0) {
    throw fields.Error("a prior with a sensor offset (PARAMS_SE3OFFSET " + std::string(fields.Text(2)) +
                       " is not the identity): not supported, expected the identity");
  }
  return PosePriorFactor<Pose>{IdField(fields, 1), PoseFields<Pose>(fields, first), information(first + kPose)};
}

}  // namespace

template <class Pose>
MeasurementLine<Pose> ParseG2oLine(const Fields& fields, const TagLayout& layout, const ReadOptions& options,
                                   const std::set<std::int64_t>& offsets) {
  ExpectFields(fields, layout);
  switch (layout.kind) {
    case TagKind::kVertex: return VertexLine<Pose>{IdField(fields, 1), PoseFields<Pose>(fields, 2)};
    case TagKind::kFix: {
      FixLine fix;
      for (int i = 1; i < fields.Count(); ++i) fix.poses.push_back(IdField(fields, i));
      return fix;
    }
    case TagKind::kOffset: {
      const SE3 T_body_sensor = SpatialPoseFields(fields, 2);
      return SensorOffsetLine{fields.Integer(1, "id"), !(T_body_sensor.Log().norm() > 0)};
    }
    default: return FactorFields<Pose>(fields, layout.kind, options, offsets);
  }
}

template <class Pose>
GraphFile ReadG2o(const std::string& path, const std::vector<GraphLine>& lines, const ReadOptions& options) {
  GraphBuilder<Pose> builder(options);
  Fields fields(path);
  std::set<std::int64_t> offsets;
  const auto parse = [&](const GraphLine& line) {
    fields.Split(line.line);
    return ParseG2oLine<Pose>(fields, *line.layout, options, offsets);
  };
  for (const GraphLine& line : lines) {
    if (line.layout->kind != TagKind::kVertex) continue;
    builder.AddVertex(fields, std::get<VertexLine<Pose>>(parse(line)).T_world_body);
  }
  builder.AddPosesOfEdges(path, lines);
  for (const GraphLine& line : lines) {
    if (line.layout->kind != TagKind::kOffset || Pose::kDim == 2) continue;
    const auto offset = std::get<SensorOffsetLine>(parse(line));
    if (!offset.is_identity) offsets.insert(offset.id);
  }
  for (const GraphLine& line : lines) {
    const TagKind kind = line.layout->kind;
    if (kind == TagKind::kVertex || kind == TagKind::kOffset) continue;
    const MeasurementLine<Pose> parsed = parse(line);
    if (kind == TagKind::kFix) {
      builder.Fix(fields);
    } else {
      builder.AddFactor(fields, std::get<Factor<Pose>>(parsed));
    }
  }
  return std::move(builder).Finish(path, GraphFormat::kG2o);
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
  MeasurementLine<Pose> line = ParseG2oLine<Pose>(fields, *layout, options_, offsets_);
  if (auto* factor = std::get_if<Factor<Pose>>(&line)) RepairInformation(fields, options_, *factor);
  if (const auto* offset = std::get_if<SensorOffsetLine>(&line)) {
    if (!offset->is_identity) offsets_.insert(offset->id);
  }
  return line;
}

int DimensionOfLine(std::string_view text) {
  const std::string source;
  Fields fields(source);
  fields.Split({0, text});
  const TagLayout* layout = fields.Count() > 0 ? FindLayout(fields.Text(0)) : nullptr;
  return layout != nullptr && layout->family == TagFamily::kG2o ? layout->dimension : 0;
}

#define TERSE_INSTANTIATE(Pose)                                                                            \
  template MeasurementLine<Pose> ParseG2oLine<Pose>(const Fields&, const TagLayout&, const ReadOptions&,   \
                                                    const std::set<std::int64_t>&);                        \
  template GraphFile ReadG2o<Pose>(const std::string&, const std::vector<GraphLine>&, const ReadOptions&); \
  template class MeasurementLineReader<Pose>;
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
