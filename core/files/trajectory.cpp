#include "terse/core/trajectory.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "terse/core/atomic_file.h"
#include "terse/core/decompositions.h"
#include "terse/core/graph_file.h"
#include "terse/core/number_text.h"
#include "terse/core/pose_name.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/text_lines.h"

namespace terse {
namespace {

constexpr int kTumFields = 8, kKittiFields = 12;
// How far a file's rotation may be from one: four digits are off by less, a wrong column order by far more.
constexpr double kQuaternionTolerance = 1e-2, kMatrixTolerance = 1e-3;

void ExpectFieldCount(const Fields& fields, int expected, const char* format) {
  if (fields.Count() == expected) return;
  throw fields.Error(std::string("a ") + format + " line has " + std::to_string(expected) + " numbers, found " +
                     std::to_string(fields.Count()));
}

SE3 TumPose(const Fields& fields) {
  constexpr std::array<const char*, 7> kNames = {"x", "y", "z", "qx", "qy", "qz", "qw"};
  std::array<double, 7> v;
  for (std::size_t i = 0; i < v.size(); ++i) v[i] = fields.Number(static_cast<int>(i) + 1, kNames[i]);
  const Quaternion q(v[6], v[3], v[4], v[5]);
  const double norm = q.coeffs().stableNorm();
  if (std::abs(norm - 1) > kQuaternionTolerance) {
    throw fields.Error("the quaternion has norm " + SixDigits(norm) + ", expected 1");
  }
  return SE3(SO3(q), Vector<3>(v[0], v[1], v[2]));
}

Trajectory ReadTum(const std::string& path, const std::vector<TextLine>& lines) {
  Trajectory out;
  out.format = TrajectoryFormat::kTum;
  Fields fields(path);
  for (const TextLine& line : lines) {
    fields.Split(line);
    ExpectFieldCount(fields, kTumFields, "TUM");
    const double stamp = fields.Number(0, "stamp");
    if (!out.stamps.empty() && stamp <= out.stamps.back()) {
      const bool repeated = stamp == out.stamps.back();
      throw fields.Error("stamp " + Shortest(stamp) + (repeated ? " is there already" : " is before the last one, ") +
                         (repeated ? "" : Shortest(out.stamps.back())) + ", expected ascending stamps");
    }
    out.T_world_body.push_back(TumPose(fields));
    out.stamps.push_back(stamp);
  }
  return out;
}

SE3 KittiPose(const Fields& fields) {
  constexpr std::array<const char*, kKittiFields> kNames = {"r11", "r12", "r13", "x",   "r21", "r22",
                                                            "r23", "y",   "r31", "r32", "r33", "z"};
  Eigen::Matrix<double, 3, 4> M;
  for (int i = 0; i < kKittiFields; ++i) M(i / 4, i % 4) = fields.Number(i, kNames[static_cast<std::size_t>(i)]);
  const Eigen::Matrix3d R = M.leftCols<3>();
  const double error = (R.transpose() * R - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(error <= kMatrixTolerance)) {
    throw fields.Error("the matrix is not a rotation: R^T R differs from the identity by " + SixDigits(error) +
                       ", expected 0");
  }
  if (R.determinant() < 0) throw fields.Error("the matrix is a reflection, expected a rotation");
  // Files have about seven digits: the nearest rotation in the Frobenius norm.
  return SE3(SO3::FromMatrix(ClosestRotation<3>(R)), M.col(3));
}

Trajectory ReadKitti(const std::string& path, const std::vector<TextLine>& lines) {
  Trajectory out;
  out.format = TrajectoryFormat::kKitti;
  Fields fields(path);
  for (const TextLine& line : lines) {
    fields.Split(line);
    ExpectFieldCount(fields, kKittiFields, "KITTI");
    out.stamps.push_back(static_cast<double>(out.stamps.size()));
    out.T_world_body.push_back(KittiPose(fields));
  }
  return out;
}

template <class Pose>
Trajectory FromGraph(const std::string& path, const PoseGraph<Pose>& graph) {
  std::vector<std::pair<PoseId, SE3>> poses;
  for (const auto& node : graph.Poses()) {
    if (node.T_world_body) poses.emplace_back(node.id, InSpace(*node.T_world_body));
  }
  if (poses.empty())
    throw FileError(path, 0, "the graph has edges but no vertex values, expected a vertex line for every pose");
  std::sort(poses.begin(), poses.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  Trajectory out;
  out.format = TrajectoryFormat::kGraph;
  for (const auto& [id, T_world_body] : poses) {
    const double stamp = static_cast<double>(id.value);
    if (!out.stamps.empty() && stamp <= out.stamps.back()) {
      throw FileError(path, 0, Name(id) + ": ids beyond 2^53 cannot be told apart, expected smaller ones");
    }
    out.stamps.push_back(stamp);
    out.T_world_body.push_back(T_world_body);
  }
  return out;
}

void ExpectWritable(const Trajectory& trajectory) {
  if (trajectory.stamps.size() != trajectory.T_world_body.size()) {
    throw std::invalid_argument("a trajectory takes as many stamps as poses");
  }
}

}  // namespace

SE3 Lift(const SE2& T_a_b) {
  return SE3(SO3::Exp(Vector<3>(0, 0, T_a_b.Theta())), Vector<3>(T_a_b.Translation().x(), T_a_b.Translation().y(), 0));
}

Trajectory ReadTrajectory(const std::string& path) {
  const TextFile file(path);
  const std::vector<TextLine> lines = file.Lines();
  if (lines.empty())
    throw FileError(path, 0,
                    "no poses: the file holds blank lines and comments only, expected a trajectory or a graph");
  if (!IsNumber(FirstField(lines.front().text))) {
    ReadOptions options;
    options.expect_connected = false;
    return std::visit([&](const auto& graph) { return FromGraph(path, graph); }, ReadGraph(path, options).graph);
  }
  Fields fields(path);
  fields.Split(lines.front());
  if (fields.Count() == kTumFields) return ReadTum(path, lines);
  if (fields.Count() == kKittiFields) return ReadKitti(path, lines);
  throw fields.Error(
      "expected 8 numbers (TUM: stamp x y z qx qy qz qw) or 12 (KITTI: the rows of a 3x4 matrix), found " +
      std::to_string(fields.Count()));
}

void WriteTum(const Trajectory& trajectory, const std::string& path) {
  ExpectWritable(trajectory);
  AtomicFile file(path);
  for (std::size_t i = 0; i < trajectory.stamps.size(); ++i) {
    const Vector<3>& p = trajectory.T_world_body[i].Translation();
    const Quaternion& q = trajectory.T_world_body[i].Rotation().Unit();
    file.Stream() << Shortest(trajectory.stamps[i]);
    for (const double value : {p.x(), p.y(), p.z(), q.x(), q.y(), q.z(), q.w()})
      file.Stream() << ' ' << Shortest(value);
    file.Stream() << '\n';
  }
  file.Commit();
}

void WriteKitti(const Trajectory& trajectory, const std::string& path) {
  ExpectWritable(trajectory);
  AtomicFile file(path);
  for (const SE3& T_world_body : trajectory.T_world_body) {
    const Matrix<3, 3> R = T_world_body.Rotation().Rotation();
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column) file.Stream() << Shortest(R(row, column)) << ' ';
      file.Stream() << Shortest(T_world_body.Translation()[row]) << (row < 2 ? ' ' : '\n');
    }
  }
  file.Commit();
}

}  // namespace terse
