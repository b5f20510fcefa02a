#pragma once
// Covariances on the command line: in which convention they are asked for, and how they are written.

#include <CLI/App.hpp>
#include <ostream>
#include <string>
#include <vector>

#include "terse/core/pose_graph.h"
#include "terse/covariance/convention.h"

namespace terse {

// --frame and --order.
std::vector<CLI::Option*> AddConventionOptions(CLI::App& subcommand, CovarianceConvention& convention);
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

// A row per pose: the id, then the covariance. The order only names the columns. "-" is standard output.
template <class Pose>
void WriteCovariances(const std::vector<PoseId>& ids, const std::vector<typename Pose::Jacobian>& covariances,
                      const std::string& path, TangentOrder order = TangentOrder::kTranslationFirst);

// What AtomicFile takes for the path of an option in which "-" is standard output.
std::string FileOrStandardOutput(const std::string& path);

}  // namespace terse
