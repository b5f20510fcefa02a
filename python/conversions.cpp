#include "conversions.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <stdexcept>

namespace terse::python {
namespace {

// How far from a rotation a matrix, and from 1 the norm of a quaternion, may be: what single precision leaves.
constexpr double kRotationTolerance = 1e-4;

[[noreturn]] void Refuse(const std::string& what, const std::string& cause) {
  throw std::invalid_argument(what + ": " + cause);
}

template <class Pose>
constexpr int kMatrix = Pose::kDim + 1;

template <class Pose>
std::string ExpectedShapes(const char* many) {
  const std::string m = std::to_string(kMatrix<Pose>);
  return "expected shape (" + std::string(many) + std::to_string(kRow<Pose>) + ") or (" + many + m + ", " + m + ")";
}

// Of a homogeneous matrix, row by row.
template <class Pose>
Pose PoseOfMatrix(const double* data, const std::string& what) {
  constexpr int kN = kMatrix<Pose>;
  using RowMajor = Eigen::Matrix<double, kN, kN, Eigen::RowMajor | Eigen::DontAlign>;
  const RowMajor T = Eigen::Map<const RowMajor>(data);
  const Matrix<Pose::kDim, Pose::kDim> R = T.template topLeftCorner<Pose::kDim, Pose::kDim>();
  const double off = (R.transpose() * R - Matrix<Pose::kDim, Pose::kDim>::Identity()).cwiseAbs().maxCoeff();
  if (!(off < kRotationTolerance) || !(R.determinant() > 0)) Refuse(what, "the matrix holds no rotation");
  Vector<kN> last = Vector<kN>::Zero();
  last[kN - 1] = 1;
  if ((T.row(kN - 1).transpose() - last).cwiseAbs().maxCoeff() > 1e-9) {
    Refuse(what, "the last row of a homogeneous matrix is [0 ... 0 1]");
  }
  if constexpr (Pose::kDim == 2) {
    return SE2(T(0, 2), T(1, 2), std::atan2(T(1, 0), T(0, 0)));
  } else {
    return SE3(SO3::FromMatrix(R), Vector<3>(T(0, 3), T(1, 3), T(2, 3)));
  }
}

template <class Pose>
void CheckRow(const double* row, const std::string& what) {
  if constexpr (Pose::kDim == 3) {
    const double norm = Eigen::Map<const Vector<4>>(row + 3).norm();
    if (!(std::abs(norm - 1) < kRotationTolerance)) {
      Refuse(what, "[qx qy qz qw] is no unit quaternion, its norm is " + std::to_string(norm));
    }
  }
}

template <int D>
Matrix<D, D> Inverse(const Matrix<D, D>& covariance) {
  const Eigen::LLT<Matrix<D, D>> llt(covariance);
  const bool symmetric = (covariance - covariance.transpose()).norm() <= 1e-9 * covariance.norm();
  if (!symmetric || llt.info() != Eigen::Success) Refuse("covariance", "not symmetric positive definite");
  const Matrix<D, D> inverse = llt.solve(Matrix<D, D>::Identity());
  return 0.5 * (inverse + inverse.transpose());
}

// Which of the two was given.
const Array& GivenOf(const std::optional<Array>& information, const std::optional<Array>& covariance) {
  if (information.has_value() == covariance.has_value()) {
    throw std::invalid_argument("give either information or covariance");
  }
  return information ? *information : *covariance;
}

}  // namespace

std::string ShapeOf(const py::array& array) {
  std::string text = "(";
  for (py::ssize_t k = 0; k < array.ndim(); ++k) text += (k > 0 ? ", " : "") + std::to_string(array.shape(k));
  return text + (array.ndim() == 1 ? ",)" : ")");
}

int DimensionOfPose(const Array& array, const std::string& what) {
  const py::ssize_t last = array.ndim() > 0 ? array.shape(array.ndim() - 1) : 0;
  if (last == 7 || last == 4) return 3;
  if (last == 3) return 2;
  throw std::invalid_argument(what + ": expected shape (3,), (7,), (3, 3) or (4, 4), got " + ShapeOf(array));
}

template <>
void WritePose<SE2>(const SE2& T, double* row) {
  row[0] = T.Translation().x();
  row[1] = T.Translation().y();
  row[2] = T.Theta();
}

template <>
void WritePose<SE3>(const SE3& T, double* row) {
  Eigen::Map<Vector<3>>{row} = T.Translation();
  Eigen::Map<Vector<4>>{row + 3} = T.Rotation().Unit().coeffs();  // x y z w
}

template <>
SE2 ReadPose<SE2>(const double* row) {
  return SE2(row[0], row[1], row[2]);
}

template <>
SE3 ReadPose<SE3>(const double* row) {
  return SE3(SO3(Quaternion(row[6], row[3], row[4], row[5])), Vector<3>(row[0], row[1], row[2]));
}

template <class Pose>
Pose PoseFrom(const Array& array, const std::string& what) {
  if (array.ndim() == 1 && array.shape(0) == kRow<Pose>) {
    CheckRow<Pose>(array.data(), what);
    return ReadPose<Pose>(array.data());
  }
  if (array.ndim() == 2 && array.shape(0) == kMatrix<Pose> && array.shape(1) == kMatrix<Pose>) {
    return PoseOfMatrix<Pose>(array.data(), what);
  }
  const std::string m = std::to_string(kMatrix<Pose>);
  Refuse(what, "expected shape (" + std::to_string(kRow<Pose>) + ",) or (" + m + ", " + m + "), got " + ShapeOf(array));
}

template <class Pose>
std::vector<Pose> PosesFrom(const Array& array, const std::string& what) {
  std::vector<Pose> poses;
  const bool rows = array.ndim() == 2 && array.shape(1) == kRow<Pose>;
  const bool matrices = array.ndim() == 3 && array.shape(1) == kMatrix<Pose> && array.shape(2) == kMatrix<Pose>;
  if (!rows && !matrices) Refuse(what, ExpectedShapes<Pose>("n, ") + ", got " + ShapeOf(array));
  const auto n = static_cast<std::size_t>(array.shape(0));
  poses.reserve(n);
  for (std::size_t k = 0; k < n; ++k) {
    const std::string which = what + "[" + std::to_string(k) + "]";
    if (rows) {
      const double* row = array.data() + k * kRow<Pose>;
      CheckRow<Pose>(row, which);
      poses.push_back(ReadPose<Pose>(row));
    } else {
      poses.push_back(PoseOfMatrix<Pose>(array.data() + k * kMatrix<Pose> * kMatrix<Pose>, which));
    }
  }
  return poses;
}

template <class Pose>
py::array ArrayOf(const Pose& T) {
  py::array_t<double> out(kRow<Pose>);
  WritePose(T, out.mutable_data());
  return std::move(out);
}

template <class Pose>
py::array ArrayOf(const std::vector<Pose>& poses) {
  py::array_t<double> out({static_cast<py::ssize_t>(poses.size()), static_cast<py::ssize_t>(kRow<Pose>)});
  double* row = out.mutable_data();
  for (const Pose& T : poses) {
    WritePose(T, row);
    row += kRow<Pose>;
  }
  return std::move(out);
}

template <int D>
Matrix<D, D> MatrixFrom(const Array& array, const std::string& what) {
  if (array.ndim() == 1 && array.shape(0) == D) {
    return Eigen::Map<const Vector<D>>(array.data()).asDiagonal();
  }
  if (array.ndim() == 2 && array.shape(0) == D && array.shape(1) == D) {
    return Eigen::Map<const Eigen::Matrix<double, D, D, Eigen::RowMajor>>(array.data());
  }
  const std::string d = std::to_string(D);
  Refuse(what, "expected shape (" + d + ", " + d + ") or (" + d + ",), got " + ShapeOf(array));
}

template <int D>
Matrix<D, D> InformationFrom(const std::optional<Array>& information, const std::optional<Array>& covariance) {
  const Array& given = GivenOf(information, covariance);
  const Matrix<D, D> matrix = MatrixFrom<D>(given, information ? "information" : "covariance");
  return information ? matrix : Inverse<D>(matrix);
}

template <int D>
std::vector<Matrix<D, D>> InformationsFrom(const std::optional<Array>& information,
                                           const std::optional<Array>& covariance, std::size_t n) {
  const Array& given = GivenOf(information, covariance);
  if (given.ndim() != 3) return std::vector<Matrix<D, D>>(n, InformationFrom<D>(information, covariance));
  const std::string d = std::to_string(D);
  if (given.shape(0) != static_cast<py::ssize_t>(n) || given.shape(1) != D || given.shape(2) != D) {
    Refuse(information ? "information" : "covariance",
           "expected shape (" + std::to_string(n) + ", " + d + ", " + d + "), got " + ShapeOf(given));
  }
  std::vector<Matrix<D, D>> out(n);
  for (std::size_t k = 0; k < n; ++k) {
    const Matrix<D, D> matrix =
        Eigen::Map<const Eigen::Matrix<double, D, D, Eigen::RowMajor>>(given.data() + k * D * D);
    out[k] = information ? matrix : Inverse<D>(matrix);
  }
  return out;
}

std::vector<PoseId> IdsFrom(const py::object& ids) {
  const auto array = py::array::ensure(ids);
  if (!array || array.ndim() != 1 || (array.size() > 0 && array.dtype().kind() != 'i' && array.dtype().kind() != 'u')) {
    PyErr_Clear();
    throw std::invalid_argument("ids: expected whole numbers in a list or an array of shape (n,)");
  }
  const Ids values(array);
  std::vector<PoseId> out;
  out.reserve(static_cast<std::size_t>(values.size()));
  for (py::ssize_t k = 0; k < values.size(); ++k) out.push_back(PoseId{values.at(k)});
  return out;
}

py::array ArrayOwning(MatrixX matrix) {
  constexpr py::ssize_t kDouble = sizeof(double);
  const auto rows = static_cast<py::ssize_t>(matrix.rows()), columns = static_cast<py::ssize_t>(matrix.cols());
  const py::capsule owner = CapsuleOf(std::move(matrix));
  return py::array_t<double>(std::vector<py::ssize_t>{rows, columns}, std::vector<py::ssize_t>{kDouble, rows * kDouble},
                             owner.get_pointer<MatrixX>()->data(), owner);
}

py::array ViewOf(const double* data, std::vector<py::ssize_t> shape, py::handle owner) {
  py::array_t<double> view(std::move(shape), data, owner);
  py::detail::array_proxy(view.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
  return std::move(view);
}

#define TERSE_INSTANTIATE(Pose)                                                 \
  template Pose PoseFrom<Pose>(const Array&, const std::string&);               \
  template std::vector<Pose> PosesFrom<Pose>(const Array&, const std::string&); \
  template py::array ArrayOf<Pose>(const Pose&);                                \
  template py::array ArrayOf<Pose>(const std::vector<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE
#define TERSE_INSTANTIATE(D)                                                                                       \
  template Matrix<D, D> MatrixFrom<D>(const Array&, const std::string&);                                           \
  template Matrix<D, D> InformationFrom<D>(const std::optional<Array>&, const std::optional<Array>&);              \
  template std::vector<Matrix<D, D>> InformationsFrom<D>(const std::optional<Array>&, const std::optional<Array>&, \
                                                         std::size_t);
TERSE_INSTANTIATE(2)
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse::python
