#include <cmath>
#include <stdexcept>

#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/core/graph_file.h"
#include "terse/core/number_text.h"
#include "terse/core/pose_name.h"
#include "terse/core/vertex_line.h"

namespace terse {
namespace {

// One line of a file, fields separated by single blanks.
class Line {
 public:
  explicit Line(const char* tag) : text_(tag) {}
  Line& Add(double value) {
    is_finite_ = is_finite_ && std::isfinite(value);
    text_ += ' ';
    text_ += Shortest(value);
    return *this;
  }
  Line& Add(PoseId id) {
    text_ += ' ';
    text_ += std::to_string(id.value);
    return *this;
  }
  template <int N>
  Line& AddVector(const Vector<N>& values) {
    for (int i = 0; i < N; ++i) Add(values[i]);
    return *this;
  }
  template <int N>
  Line& AddUpperTriangle(const Matrix<N, N>& matrix) {
    for (int row = 0; row < N; ++row) {
      for (int column = row; column < N; ++column) Add(matrix(row, column));
    }
    return *this;
  }
  // A number that is finite in radians may not be in the format's unit.
  void WriteTo(std::ostream& out) {
    if (!is_finite_) throw NumericalError("a number beyond the range of a double would be in the line " + text_);
    text_ += '\n';
    out.write(text_.data(), static_cast<std::streamsize>(text_.size()));
  }

 private:
  std::string text_;
  bool is_finite_ = true;
};

Line& AddPose(Line& line, const SE2& T) { return line.AddVector<2>(T.Translation()).Add(T.Theta()); }
Line& AddPose(Line& line, const SE3& T) {
  const Quaternion& q = T.Rotation().Unit();
  return line.AddVector<3>(T.Translation()).Add(q.x()).Add(q.y()).Add(q.z()).Add(q.w());
}

Line& AddInformation(Line& line, const Matrix<3, 3>& information, RotationInformation) {
  return line.AddUpperTriangle<3>(information);
}
Line& AddInformation(Line& line, const Matrix<6, 6>& information, RotationInformation meaning) {
  return line.AddUpperTriangle<6>(InformationToFile(information, meaning));
}

template <class Pose>
constexpr bool kIsPlanar = Pose::kDim == 2;

template <class Pose>
bool HasPosePrior(const PoseGraph<Pose>& graph) {
  for (const auto& node : graph.Factors()) {
    if (std::holds_alternative<PosePriorFactor<Pose>>(node.factor)) return true;
  }
  return false;
}

template <class Pose>
void WriteG2oFactor(const Factor<Pose>& factor, RotationInformation meaning, std::ostream& out) {
  if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor)) {
    Line line(kIsPlanar<Pose> ? "EDGE_SE2" : "EDGE_SE3:QUAT");
    line.Add(f->from).Add(f->to);
    AddInformation(AddPose(line, f->T_from_to), f->information, meaning).WriteTo(out);
  } else if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor)) {
    Line line(kIsPlanar<Pose> ? "EDGE_PRIOR_SE2" : "EDGE_SE3_PRIOR");
    line.Add(f->pose);
    if (!kIsPlanar<Pose>) line.Add(PoseId{0});  // the parameter of WriteG2o
    AddInformation(AddPose(line, f->T_world_body), f->information, meaning).WriteTo(out);
  } else {
    const auto& prior = std::get<PositionPriorFactor<Pose>>(factor);
    // A reader that does not know the lever arm must not take it for zero: a tag of its own.
    const std::string tag = kIsPlanar<Pose> ? "EDGE_PRIOR_SE2_XY" : "EDGE_PRIOR_SE3_XYZ";
    const bool has_lever = !prior.p_body.isZero(0);
    Line line((tag + (has_lever ? "_LEVER" : "")).c_str());
    line.Add(prior.pose).template AddVector<Pose::kDim>(prior.p_world);
    line.template AddUpperTriangle<Pose::kDim>(prior.information);
    if (has_lever) line.template AddVector<Pose::kDim>(prior.p_body);
    line.WriteTo(out);
  }
}

Line& AddEulerPose(Line& line, const SE2& T) { return AddPose(line, T); }

// R = Rz(yaw) Ry(pitch) Rx(roll). Roll and pitch come from Rz(-yaw) R, so that the three belong together even at
// pitch = 90 degrees, where yaw itself is arbitrary. Through angles a rotation returns to about 1e-15, not to the bit.
Line& AddEulerPose(Line& line, const SE3& T) {
  const Matrix<3, 3> R = T.Rotation().Rotation();
  const double yaw = std::atan2(R(1, 0), R(0, 0));
  const double c = std::cos(yaw), s = std::sin(yaw);
  const double pitch = std::atan2(-R(2, 0), c * R(0, 0) + s * R(1, 0));
  const double roll = std::atan2(s * R(0, 2) - c * R(1, 2), c * R(1, 1) - s * R(0, 1));
  return line.AddVector<3>(T.Translation()).Add(roll).Add(pitch).Add(yaw);
}

Line& AddToroInformation(Line& line, const Matrix<3, 3>& I) {
  return line.Add(I(0, 0)).Add(I(0, 1)).Add(I(1, 1)).Add(I(2, 2)).Add(I(0, 2)).Add(I(1, 2));
}
Line& AddToroInformation(Line& line, const Matrix<6, 6>& information) { return line.AddUpperTriangle<6>(information); }

}  // namespace

template <class Pose>
void WriteVertexLine(PoseId id, const Pose& T_world_body, std::ostream& out) {
  Line line(kIsPlanar<Pose> ? "VERTEX_SE2" : "VERTEX_SE3:QUAT");
  line.Add(id);
  AddPose(line, T_world_body).WriteTo(out);
}

template <class Pose>
void WriteG2o(const PoseGraph<Pose>& graph, const std::string& path, RotationInformation rotation_information,
              const std::string& comment) {
  if (comment.find_first_of("\r\n") != std::string::npos) {
    throw std::invalid_argument("a comment in a g2o file is one line");
  }
  AtomicFile file(path);
  std::ostream& out = file.Stream();
  if (!comment.empty()) out << "# " << comment << '\n';
  // g2o wants every 3D prior to name a sensor offset; ours is the identity.
  if (!kIsPlanar<Pose> && HasPosePrior(graph)) out << "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n";
  for (const auto& node : graph.Poses()) {
    if (!node.T_world_body) continue;
    WriteVertexLine(node.id, *node.T_world_body, out);
  }
  for (const auto& node : graph.Poses()) {
    if (node.fixed) Line("FIX").Add(node.id).WriteTo(out);
  }
  for (const auto& node : graph.Factors()) WriteG2oFactor<Pose>(node.factor, rotation_information, out);
  file.Commit();
}

template <class Pose>
void WriteToro(const PoseGraph<Pose>& graph, const std::string& path) {
  for (const auto& node : graph.Poses()) {
    if (node.fixed) throw FileError(path, 0, "TORO files have no FIX: " + Name(node.id) + " is fixed");
  }
  for (const auto& node : graph.Factors()) {
    if (std::holds_alternative<RelativePoseFactor<Pose>>(node.factor)) continue;
    throw FileError(path, 0, "TORO files have no priors: there is one on " + Name(PosesOf(node.factor).first));
  }
  AtomicFile file(path);
  for (const auto& node : graph.Poses()) {
    if (!node.T_world_body) continue;
    Line line(kIsPlanar<Pose> ? "VERTEX2" : "VERTEX3");
    line.Add(node.id);
    AddEulerPose(line, *node.T_world_body).WriteTo(file.Stream());
  }
  for (const auto& node : graph.Factors()) {
    const auto& f = std::get<RelativePoseFactor<Pose>>(node.factor);
    Line line(kIsPlanar<Pose> ? "EDGE2" : "EDGE3");
    line.Add(f.from).Add(f.to);
    AddToroInformation(AddEulerPose(line, f.T_from_to), f.information).WriteTo(file.Stream());
  }
  file.Commit();
}

#define TERSE_INSTANTIATE(Pose)                                                                                      \
  template void WriteVertexLine<Pose>(PoseId, const Pose&, std::ostream&);                                           \
  template void WriteG2o<Pose>(const PoseGraph<Pose>&, const std::string&, RotationInformation, const std::string&); \
  template void WriteToro<Pose>(const PoseGraph<Pose>&, const std::string&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
