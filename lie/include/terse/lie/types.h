#pragma once
// Matrix types of the public interface.
//
// Everything that crosses the library boundary is unaligned (Eigen::DontAlign): the size, alignment and
// allocator of these types are the same whatever -march flags the library and its user were compiled with.

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace terse {

template <int Rows, int Cols>
using Matrix = Eigen::Matrix<double, Rows, Cols, Eigen::DontAlign | Eigen::ColMajor>;
template <int Rows>
using Vector = Eigen::Matrix<double, Rows, 1, Eigen::DontAlign | Eigen::ColMajor>;
using MatrixX = Matrix<Eigen::Dynamic, Eigen::Dynamic>;
using VectorX = Vector<Eigen::Dynamic>;
using Quaternion = Eigen::Quaternion<double, Eigen::DontAlign>;

}  // namespace terse
