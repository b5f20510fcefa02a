#include "terse/compact/marginal_divergence.h"

#include <algorithm>
#include <limits>

#include "terse/compact/link_system.h"
#include "terse/core/at.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/error.h"
#include "terse/covariance/covariance_blocks.h"

namespace terse::internal {
namespace {

template <class Pose>
std::vector<LinearFactor<Pose::kDof>> AllFactors(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body) {
  auto system = MakeLinkSystem(graph, T_world_body, FixedEdges::kOdometry);
  std::vector<LinearFactor<Pose::kDof>> all = std::move(system.fixed);
  all.insert(all.end(), system.links.begin(), system.links.end());
  return all;
}

template <int B>
[[nodiscard]] bool Factorise(int variables, const std::vector<LinearFactor<B>>& factors, BlockCholesky<B>& cholesky) {
  typename BlockCholesky<B>::Changes changes;
  changes.new_variables = variables;
  changes.added = factors;
  return cholesky.Update(changes).ok;
}

// What the factors say of the variables with a place, the others held where they are.
template <int B>
std::vector<LinearFactor<B>> Among(const std::vector<LinearFactor<B>>& factors, const std::vector<int>& place) {
  std::vector<LinearFactor<B>> out;
  for (LinearFactor<B> f : factors) {
    f.first = place[At(f.first)];
    if (f.second >= 0) f.second = place[At(f.second)];
    if (f.first < 0 && f.second >= 0) {
      f.first = f.second;
      f.A_first = f.A_second;
      f.second = -1;
    }
    if (f.first >= 0) out.push_back(f);
  }
  return out;
}

}  // namespace

template <class Pose>
double DivergenceFromMarginal(const PoseGraph<Pose>& whole, const std::vector<Pose>& T_world_body,
                              const PoseGraph<Pose>& fewer) {
  constexpr int B = Pose::kDof;
  const int poses = static_cast<int>(whole.Poses().size()), kept = static_cast<int>(fewer.Poses().size());
  std::vector<int> of_kept, place(At(poses), 0);
  std::vector<Pose> T_world_kept;
  for (const auto& node : fewer.Poses()) {
    of_kept.push_back(whole.IndexOf(node.id));
    place[At(of_kept.back())] = -1;
    T_world_kept.push_back(T_world_body[At(of_kept.back())]);
  }
  int dropped = 0;
  for (int& at : place) at = at < 0 ? -1 : dropped++;

  const auto factors = AllFactors(whole, T_world_body);
  const auto recovered = AllFactors(fewer, T_world_kept);
  BlockCholesky<B> exact, held, approximate;
  if (!Factorise(poses, factors, exact) || !Factorise(dropped, Among(factors, place), held))
    throw NumericalError("the graph does not hold every pose");
  if (!Factorise(kept, recovered, approximate)) return std::numeric_limits<double>::infinity();

  double trace = 0;
  for (const LinearFactor<B>& f : recovered) {
    std::vector<CovarianceTerm<B>> terms{{of_kept[At(f.first)], f.A_first}};
    if (f.second >= 0) terms.push_back({of_kept[At(f.second)], f.A_second});
    trace += CombinationCovariance(exact, terms).trace();
  }
  const double lost = trace - B * kept - approximate.LogDeterminant() + exact.LogDeterminant() - held.LogDeterminant();
  return std::max(0.0, lost / 2);  // rounding of what cancels
}

template double DivergenceFromMarginal<SE2>(const PoseGraph<SE2>&, const std::vector<SE2>&, const PoseGraph<SE2>&);
template double DivergenceFromMarginal<SE3>(const PoseGraph<SE3>&, const std::vector<SE3>&, const PoseGraph<SE3>&);

}  // namespace terse::internal
