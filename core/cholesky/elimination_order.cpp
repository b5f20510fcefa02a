#include "terse/core/elimination_order.h"

#include "cholesky/elimination.h"

namespace terse {

template <class Pose>
std::vector<int> EliminationOrder(const PoseGraph<Pose>& graph) {
  internal::Cliques cliques;
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    cliques.members.push_back(graph.IndexOf(ends.first));
    if (ends.second != ends.first) cliques.members.push_back(graph.IndexOf(ends.second));
    cliques.Close();
  }
  const std::size_t poses = graph.Poses().size();
  std::vector<int> order;
  order.reserve(poses);
  for (const internal::SymbolicFront& front : internal::Eliminate(
           static_cast<int>(poses), cliques, std::vector<char>(poses, 0), internal::OrderFor::kSolving)) {
    order.insert(order.end(), front.pivots.begin(), front.pivots.end());
  }
  return order;
}

template std::vector<int> EliminationOrder<SE2>(const PoseGraph<SE2>&);
template std::vector<int> EliminationOrder<SE3>(const PoseGraph<SE3>&);

}  // namespace terse
