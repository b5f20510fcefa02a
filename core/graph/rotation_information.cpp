#include "terse/core/rotation_information.h"

namespace terse {
namespace {

// Powers of two only, so that converting there and back changes no bit.
Matrix<6, 6> Scaled(const Matrix<6, 6>& information, double rotation_scale) {
  Matrix<6, 6> out = information;
  out.topRightCorner<3, 3>() *= rotation_scale;
  out.bottomLeftCorner<3, 3>() *= rotation_scale;
  out.bottomRightCorner<3, 3>() *= rotation_scale * rotation_scale;
  return out;
}

}  // namespace

Matrix<6, 6> InformationFromFile(const Matrix<6, 6>& information_file, RotationInformation meaning) {
  return meaning == RotationInformation::kQuaternion ? Scaled(information_file, 0.5) : information_file;
}

Matrix<6, 6> InformationToFile(const Matrix<6, 6>& information, RotationInformation meaning) {
  return meaning == RotationInformation::kQuaternion ? Scaled(information, 2.0) : information;
}

}  // namespace terse
