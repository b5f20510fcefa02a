#pragma once
// Covariances as tables of comma-separated values.

#include <ostream>
#include <string>
#include <vector>

#include "terse/core/pose_graph.h"
#include "terse/covariance/convention.h"

namespace terse {

std::string Name(CovarianceFrame frame);
std::string Name(TangentOrder order);

// x, y, theta, or x, y, z, rx, ry, rz; rotations before positions if so ordered.
template <class Pose>
std::vector<std::string> TangentNames(TangentOrder order);

// Throws NumericalError if it is not.
void RequireFinite(const MatrixX& covariance);
// Cells of a row, each after a comma: x_x, x_y, ...; the entries, row by row, which must be finite.
void WriteEntryNames(const std::vector<std::string>& tangent_names, std::ostream& out);
void WriteEntries(const MatrixX& covariance, std::ostream& out);

// A row per pose: the id, then the covariance. The order only names the columns. Throws FileError.
template <class Pose>
void WriteCovariances(const std::vector<PoseId>& ids, const std::vector<typename Pose::Jacobian>& covariances,
                      const std::string& path, TangentOrder order = TangentOrder::kTranslationFirst);

}  // namespace terse
