#include "terse/compact/aligned_error.h"

#include <cmath>

#include "terse/compact/rigid_motions.h"
#include "terse/covariance/marginals.h"

namespace terse {

template <class Pose>
std::optional<double> ExpectedAlignedError(const PoseGraph<Pose>& map, const std::vector<Pose>& T_world_body,
                                           std::vector<LinearFactor<Pose::kDof>> factors) {
  constexpr int B = Pose::kDof, D = Pose::kDim;
  BlockCholesky<B> cholesky;
  typename BlockCholesky<B>::Changes changes;
  changes.new_variables = static_cast<int>(T_world_body.size());
  changes.added = std::move(factors);
  if (!cholesky.Update(changes).ok) return std::nullopt;
  const Marginals<Pose> marginals(map, T_world_body, std::move(cholesky));
  double sum = 0;
  for (const typename Pose::Jacobian& Sigma : marginals.AllMarginals()) {
    sum += Sigma.template topLeftCorner<D, D>().trace();  // in the body frame, which a trace does not depend on
  }
  std::vector<PoseId> ids;
  for (const auto& node : map.Poses()) ids.push_back(node.id);
  sum -= marginals.Combination(internal::RigidMotions<Pose>(T_world_body).Terms(ids)).trace();
  return std::isfinite(sum) && sum > 0 ? std::optional<double>(sum) : std::nullopt;
}

template std::optional<double> ExpectedAlignedError<SE2>(const PoseGraph<SE2>&, const std::vector<SE2>&,
                                                         std::vector<LinearFactor<3>>);
template std::optional<double> ExpectedAlignedError<SE3>(const PoseGraph<SE3>&, const std::vector<SE3>&,
                                                         std::vector<LinearFactor<6>>);

}  // namespace terse
