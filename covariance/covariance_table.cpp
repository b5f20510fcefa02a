#include "terse/covariance/covariance_table.h"

#include <algorithm>

#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/core/number_text.h"

namespace terse {
std::string Name(CovarianceFrame frame) {
  switch (frame) {
    case CovarianceFrame::kBody: return "body";
    case CovarianceFrame::kWorld: return "world";
    case CovarianceFrame::kWorldAxes: return "world-axes";
  }
  return "";
}

std::string Name(TangentOrder order) {
  return order == TangentOrder::kTranslationFirst ? "translation-first" : "rotation-first";
}

template <class Pose>
std::vector<std::string> TangentNames(TangentOrder order) {
  std::vector<std::string> names = {"x", "y", "theta"};
  if (Pose::kDim == 3) names = {"x", "y", "z", "rx", "ry", "rz"};
  if (order == TangentOrder::kRotationFirst) std::rotate(names.begin(), names.begin() + Pose::kDim, names.end());
  return names;
}

void WriteEntryNames(const std::vector<std::string>& tangent_names, std::ostream& out) {
  for (const std::string& row : tangent_names) {
    for (const std::string& column : tangent_names) out << ',' << row << '_' << column;
  }
}

void RequireFinite(const MatrixX& covariance) {
  if (!covariance.allFinite()) throw NumericalError("a covariance is too large for double precision");
}

void WriteEntries(const MatrixX& covariance, std::ostream& out) {
  RequireFinite(covariance);
  for (Eigen::Index r = 0; r < covariance.rows(); ++r) {
    for (Eigen::Index c = 0; c < covariance.cols(); ++c) out << ',' << Shortest(covariance(r, c));
  }
}

template <class Pose>
void WriteCovariances(const std::vector<PoseId>& ids, const std::vector<typename Pose::Jacobian>& covariances,
                      const std::string& path, TangentOrder order) {
  AtomicFile file(path);
  std::ostream& out = file.Stream();
  out << "id";
  WriteEntryNames(TangentNames<Pose>(order), out);
  out << '\n';
  for (std::size_t k = 0; k < ids.size(); ++k) {
    out << ids[k].value;
    WriteEntries(covariances[k], out);
    out << '\n';
  }
  file.Commit();
}

#define TERSE_INSTANTIATE(Pose)                                                                        \
  template std::vector<std::string> TangentNames<Pose>(TangentOrder);                                  \
  template void WriteCovariances<Pose>(const std::vector<PoseId>&, const std::vector<Pose::Jacobian>&, \
                                       const std::string&, TangentOrder);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
