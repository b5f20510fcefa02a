#include "run/covariance_output.h"

#include <algorithm>

#include "commands/commands.h"
#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/core/number_text.h"

namespace terse {
namespace {

const std::vector<std::pair<std::string, CovarianceFrame>> kFrames = {
    {"body", CovarianceFrame::kBody}, {"world", CovarianceFrame::kWorld}, {"world-axes", CovarianceFrame::kWorldAxes}};
const std::vector<std::pair<std::string, TangentOrder>> kOrders = {
    {"translation-first", TangentOrder::kTranslationFirst}, {"rotation-first", TangentOrder::kRotationFirst}};

template <class Value>
std::string NameOf(Value wanted, const std::vector<std::pair<std::string, Value>>& names) {
  for (const auto& [name, value] : names) {
    if (value == wanted) return name;
  }
  return "";
}

}  // namespace

std::vector<CLI::Option*> AddConventionOptions(CLI::App& subcommand, CovarianceConvention& convention) {
  return {AddChoice(subcommand, "--frame", convention.frame, kFrames,
                    "Of covariances: of d in T Exp(d), of e in Exp(e) T (for a relative pose, the frame of its first "
                    "pose), or of position and rotation along the world's axes, as ROS has them"),
          AddChoice(subcommand, "--order", convention.order, kOrders, "Of rows and columns of covariances")};
}

std::string Name(CovarianceFrame frame) { return NameOf(frame, kFrames); }
std::string Name(TangentOrder order) { return NameOf(order, kOrders); }

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
  AtomicFile file(FileOrStandardOutput(path));
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

std::string FileOrStandardOutput(const std::string& path) { return path == "-" ? "/dev/stdout" : path; }

#define TERSE_INSTANTIATE(Pose)                                                                        \
  template std::vector<std::string> TangentNames<Pose>(TangentOrder);                                  \
  template void WriteCovariances<Pose>(const std::vector<PoseId>&, const std::vector<Pose::Jacobian>&, \
                                       const std::string&, TangentOrder);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
