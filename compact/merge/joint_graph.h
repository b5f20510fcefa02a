#pragma once
// The maps that are joined as one graph, and which of the links between them are in it.

#include <map>
#include <vector>

#include "merge/map_placement.h"
#include "terse/core/batch_solver.h"
#include "terse/core/innovation_scale.h"

namespace terse::internal {

template <class Pose>
class JointGraph {
 public:
  // All three stay where they are meanwhile. stated_limit: of squared innovations.
  JointGraph(const std::vector<OptimalMap<Pose>>& maps, const std::vector<CarriedLink<Pose>>& links,
             const MapPlacement<Pose>& placement, double stated_limit, int threads);

  // Links that agree with the optimum come in, with covariances across maps, and truncated least squares over all that
  // are in has the last word. Returns the optimum of what is left; the reference lies where it did, unless absolute
  // measurements say where. Throws NumericalError if there is none.
  BatchResult<Pose> Decide();

  // The maps one after the other, maps[0] last; then the links that are in.
  PoseGraph<Pose> Graph() const;
  bool IsIn(std::size_t link) const { return states_[link].in; }
  bool AreJoined(std::size_t link) const;  // its two maps
  // Squared Mahalanobis distance of a link from what the joint graph says without it.
  double InnovationOf(std::size_t link, const Marginals<Pose>& marginals) const;
  const Pose& ValueOf(PoseId id) const { return values_[static_cast<std::size_t>(maps_graph_.IndexOf(id))]; }
  // As a map with the same numbers of factors, kept poses at their values.
  CompactMap<Pose> Map() const;

 private:
  struct LinkState {
    bool in = false, holds = false;  // holds: two maps together, whatever the kernel says
    int returns = 0;
  };
  bool KeepsAbsolute(std::size_t map) const;
  void Join();
  BatchResult<Pose> Solve(const PoseGraph<Pose>& graph, BatchOptions options);
  bool LetIn(BatchResult<Pose> result, bool is_first);
  bool ThrowOut(bool graduate);

  const std::vector<OptimalMap<Pose>>& maps_;
  const std::vector<CarriedLink<Pose>>& links_;
  const MapPlacement<Pose>& placement_;
  const double stated_limit_;
  const int threads_;
  InnovationScale scale_;                                   // of what links show
  double limit_;                                            // what that makes of the stated one
  std::vector<LinkState> states_;                           // by link
  std::vector<std::size_t> order_;                          // of the joined maps
  PoseGraph<Pose> maps_graph_;                              // without links
  std::vector<std::map<FactorId, FactorId>> joint_factor_;  // by map: ids in maps_graph_
  std::vector<Pose> values_;                                // of maps_graph_
};

extern template class JointGraph<SE2>;
extern template class JointGraph<SE3>;

}  // namespace terse::internal
