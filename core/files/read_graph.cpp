#include "files/read_graph.h"

#include <Eigen/Cholesky>
#include <algorithm>

#include "terse/core/decompositions.h"
#include "terse/core/pose_name.h"

namespace terse {
namespace {

template <class Information>
void ClampEigenvalues(Information* information) {
  if (!information->allFinite()) return;
  constexpr double kTiny = 1e-12;  // for a matrix without any information
  const auto eigen = DecomposeSymmetric<Information::RowsAtCompileTime>(*information);
  const double floor = std::max(1e-9 * eigen.values.maxCoeff(), kTiny);
  const Information vectors = eigen.vectors, values = eigen.values.cwiseMax(floor).asDiagonal();
  const Information clamped = vectors * values * vectors.transpose();
  *information = 0.5 * (clamped + clamped.transpose());
}

std::string Describe(const std::vector<PoseId>& ids) {
  std::string out = std::to_string(ids.size()) + (ids.size() == 1 ? " pose (" : " poses (");
  if (ids.size() > 3) return out + std::to_string(ids.front().value) + " ... " + std::to_string(ids.back().value) + ")";
  for (std::size_t i = 0; i < ids.size(); ++i) out += (i > 0 ? ", " : "") + std::to_string(ids[i].value);
  return out + ")";
}

}  // namespace

void ExpectFields(const Fields& fields, const TagLayout& layout) {
  const int found = fields.Count() - 1;
  if (layout.fields > 0 ? found == layout.fields : found >= 1) return;
  const std::string expected = layout.fields > 0 ? std::to_string(layout.fields) : "at least 1";
  throw fields.Error(std::string(layout.tag) + " takes " + expected + " fields after the tag, found " +
                     std::to_string(found));
}

template <int N>
Vector<N> PositionFields(const Fields& fields, int first) {
  constexpr const char* kNames[] = {"x", "y", "z"};
  Vector<N> out;
  for (int i = 0; i < N; ++i) out[i] = fields.Number(first + i, kNames[i]);
  return out;
}

SE2 PlanarPoseFields(const Fields& fields, int first) {
  return SE2(PositionFields<2>(fields, first), fields.Number(first + 2, "theta"));
}

template <int N>
Matrix<N, N> UpperTriangleFields(const Fields& fields, int first) {
  Matrix<N, N> out = Matrix<N, N>::Zero();
  for (int row = 0, i = first; row < N; ++row) {
    for (int column = row; column < N; ++column) out(row, column) = fields.Number(i++, "information");
  }
  return out;
}

template <int N>
Matrix<N, N> SymmetricFields(const Fields& fields, int first) {
  Matrix<N, N> out = UpperTriangleFields<N>(fields, first);
  out.template triangularView<Eigen::StrictlyLower>() = out.transpose();
  return out;
}

template <>
SE2 EulerPoseFields<SE2>(const Fields& fields, int first) {
  return PlanarPoseFields(fields, first);
}

template <>
SE3 EulerPoseFields<SE3>(const Fields& fields, int first) {
  const Vector<3> position = PositionFields<3>(fields, first);
  const double roll = fields.Number(first + 3, "roll");
  const double pitch = fields.Number(first + 4, "pitch");
  const double yaw = fields.Number(first + 5, "yaw");
  const auto about = [](const Vector<3>& axis, double angle) { return Quaternion(Eigen::AngleAxisd(angle, axis)); };
  const Quaternion q =
      about(Vector<3>::UnitZ(), yaw) * about(Vector<3>::UnitY(), pitch) * about(Vector<3>::UnitX(), roll);
  return SE3(SO3(q), position);
}

template <class Pose>
bool RepairInformation(const Fields& fields, const ReadOptions& options, Factor<Pose>& factor) {
  const std::string defect = FindDefect(factor);
  if (defect.empty()) return false;
  std::visit([](auto& f) { ClampEigenvalues(&f.information); }, factor);
  const std::string beyond_repair = FindDefect(factor);
  if (!beyond_repair.empty()) throw fields.Error(beyond_repair);
  if (!options.repair_information) throw fields.Error(defect + "; --repair-information clamps it");
  return true;
}

template <class Pose>
void ExpectConnected(const PoseGraph<Pose>& graph, const std::string& path) {
  const std::size_t poses = graph.Poses().size();
  if (poses > 1 && graph.Factors().empty()) {
    throw FileError(path, 0, "the graph has " + std::to_string(poses) + " poses but no edges, expected at least one");
  }
  const std::vector<std::vector<int>> components = ConnectedComponents(graph);
  if (components.size() <= 1) return;
  constexpr std::size_t kMostListed = 5;
  std::string cause = "the graph falls into " + std::to_string(components.size()) + " components: ";
  for (std::size_t i = 0; i < std::min(components.size(), kMostListed); ++i) {
    std::vector<PoseId> ids;
    for (const int index : components[i]) ids.push_back(graph.Poses()[static_cast<std::size_t>(index)].id);
    std::sort(ids.begin(), ids.end());
    cause += (i > 0 ? ", " : "") + Describe(ids);
  }
  throw FileError(path, 0, cause + (components.size() > kMostListed ? ", ..." : "") + "; expected one");
}

template <class Pose>
void GraphBuilder<Pose>::AddVertex(const Fields& fields, const Pose& T_world_body) {
  const PoseId id = IdField(fields, 1);
  if (graph_.HasPose(id)) throw fields.Error("a second vertex line of " + Name(id) + ", expected one at most");
  graph_.AddPose(id, T_world_body);
}

template <class Pose>
void GraphBuilder<Pose>::NameEnds(const Fields& fields, const TagLayout& layout) {
  if (fields.Count() < 3) ExpectFields(fields, layout);
  const PoseId ends[] = {IdField(fields, 1, "from"), IdField(fields, 2, "to")};
  for (const PoseId id : ends) {
    if (!graph_.HasPose(id) && is_named_.insert(id.value).second) named_.push_back(id);
  }
}

template <class Pose>
void GraphBuilder<Pose>::AddNamedPoses() {
  for (const PoseId id : named_) {
    if (!graph_.HasPose(id)) graph_.AddPose(id);
  }
  std::vector<PoseId>().swap(named_);
  std::unordered_set<std::int64_t>().swap(is_named_);
}

template <class Pose>
void GraphBuilder<Pose>::AddFactor(const Fields& fields, Factor<Pose> factor) {
  const FactorPoses ends = PosesOf(factor);
  if (!graph_.HasPose(ends.first)) {
    throw fields.Error("a prior on " + Name(ends.first) +
                       ", which no vertex and no edge names; expected a line that does");
  }
  if (RepairInformation(fields, options_, factor)) ++repaired_informations_;
  graph_.AddFactor(factor);
}

template <class Pose>
void GraphBuilder<Pose>::Fix(const Fields& fields, const std::unordered_set<std::int64_t>& other_vertices) {
  for (int i = 1; i < fields.Count(); ++i) {
    const PoseId id = IdField(fields, i);
    if (!graph_.HasPose(id) && other_vertices.count(id.value) != 0) {
      ++skipped_fixes_;
      continue;
    }
    if (!graph_.HasPose(id))
      throw fields.Error("FIX of " + Name(id) + ", which no vertex and no edge names; expected a line that does");
    graph_.SetFixed(id, true);
  }
}

template <class Pose>
GraphFile GraphBuilder<Pose>::Finish(const std::string& path, GraphFormat format) && {
  if (options_.expect_connected) ExpectConnected(graph_, path);
  GraphFile out;
  out.graph = std::move(graph_);
  out.format = format;
  out.repaired_informations = repaired_informations_;
  if (skipped_fixes_ > 0) out.skipped_tags["FIX"] = skipped_fixes_;
  return out;
}

template Vector<2> PositionFields<2>(const Fields&, int);
template Vector<3> PositionFields<3>(const Fields&, int);
template Matrix<2, 2> SymmetricFields<2>(const Fields&, int);
template Matrix<3, 3> UpperTriangleFields<3>(const Fields&, int);
template Matrix<6, 6> UpperTriangleFields<6>(const Fields&, int);
template Matrix<3, 3> SymmetricFields<3>(const Fields&, int);
template Matrix<6, 6> SymmetricFields<6>(const Fields&, int);
template bool RepairInformation<SE2>(const Fields&, const ReadOptions&, Factor<SE2>&);
template bool RepairInformation<SE3>(const Fields&, const ReadOptions&, Factor<SE3>&);
template void ExpectConnected<SE2>(const PoseGraph<SE2>&, const std::string&);
template void ExpectConnected<SE3>(const PoseGraph<SE3>&, const std::string&);
template class GraphBuilder<SE2>;
template class GraphBuilder<SE3>;

}  // namespace terse
