#pragma once
// Between numpy arrays and the library's values.
//
// A pose is a row: [x y theta] in the plane, [x y z qx qy qz qw] in space; on input it may be a homogeneous matrix too,
// (3, 3) or (4, 4). What is wrong with an array is std::invalid_argument, ValueError in Python.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::python {

namespace py = pybind11;

// A C-ordered array of doubles is taken as it is, anything else is copied into one.
using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Ids = py::array_t<std::int64_t, py::array::c_style>;

template <class Pose>
constexpr int kDimension = Pose::kDim;
// Numbers in the row of a pose.
template <class Pose>
constexpr int kRow = Pose::kDim == 2 ? 3 : 7;

std::string ShapeOf(const py::array& array);
// Of one pose; a matrix is told by its size.
int DimensionOfPose(const Array& array, const std::string& what);

template <class Pose>
void WritePose(const Pose& T, double* row);
template <class Pose>
Pose ReadPose(const double* row);

// One pose: a row or a matrix.
template <class Pose>
Pose PoseFrom(const Array& array, const std::string& what);
// Many: (n, kRow) or (n, 3, 3) or (n, 4, 4).
template <class Pose>
std::vector<Pose> PosesFrom(const Array& array, const std::string& what);
template <class Pose>
py::array ArrayOf(const Pose& T);
template <class Pose>
py::array ArrayOf(const std::vector<Pose>& poses);

// Rows of poses, filled once.
template <class Pose>
std::vector<double> RowsOf(const std::vector<Pose>& poses) {
  std::vector<double> rows(poses.size() * kRow<Pose>);
  for (std::size_t k = 0; k < poses.size(); ++k) WritePose(poses[k], rows.data() + k * kRow<Pose>);
  return rows;
}

// The information of a measurement from `information` or `covariance`, of which exactly one is given: (d, d), or (d,)
// for its diagonal.
template <int D>
Matrix<D, D> InformationFrom(const std::optional<Array>& information, const std::optional<Array>& covariance);
// The same for `n` measurements: besides, (n, d, d).
template <int D>
std::vector<Matrix<D, D>> InformationsFrom(const std::optional<Array>& information,
                                           const std::optional<Array>& covariance, std::size_t n);
template <int D>
Matrix<D, D> MatrixFrom(const Array& array, const std::string& what);

std::vector<PoseId> IdsFrom(const py::object& ids);
template <class T>
Ids ArrayOfIds(const std::vector<T>& ids) {
  Ids out(static_cast<py::ssize_t>(ids.size()));
  std::int64_t* to = out.mutable_data();
  for (const T& id : ids) *to++ = id.value;
  return out;
}

// An array that owns the vector, which is not copied.
template <class T>
py::capsule CapsuleOf(T value) {
  return py::capsule(new T(std::move(value)), [](void* owned) { delete static_cast<T*>(owned); });
}
// (n, D, D). The blocks are stored column by column, which the strides say.
template <int D>
py::array ArrayOwning(std::vector<Matrix<D, D>> blocks) {
  constexpr py::ssize_t kDouble = sizeof(double);
  static_assert(sizeof(Matrix<D, D>) == D * D * sizeof(double));
  const auto n = static_cast<py::ssize_t>(blocks.size());
  const py::capsule owner = CapsuleOf(std::move(blocks));
  const auto* held = owner.get_pointer<std::vector<Matrix<D, D>>>();
  const double* data = held->empty() ? nullptr : held->front().data();
  return py::array_t<double>(std::vector<py::ssize_t>{n, D, D},
                             std::vector<py::ssize_t>{D * D * kDouble, kDouble, D * kDouble}, data, owner);
}
py::array ArrayOwning(MatrixX matrix);
template <int R, int C>
py::array ArrayOfMatrix(const Matrix<R, C>& matrix) {
  py::array_t<double> out({R, C});
  for (int r = 0; r < R; ++r) {
    for (int c = 0; c < C; ++c) out.mutable_at(r, c) = matrix(r, c);
  }
  return std::move(out);
}
template <int R>
py::array ArrayOfVector(const Vector<R>& vector) {
  return py::array_t<double>(vector.size(), vector.data());
}
// A read-only array over memory that `owner` holds, for as long as any array on it lives.
py::array ViewOf(const double* data, std::vector<py::ssize_t> shape, py::handle owner);

}  // namespace terse::python
