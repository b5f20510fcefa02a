#include "tables/compact_norms.h"

#include <algorithm>

#include <unordered_map>

#include "run/progress.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse {
namespace {

template <class Pose>
void AddTraces(const typename Pose::Jacobian& covariance, double& position, double& rotation) {
  position += covariance.diagonal().template head<Pose::kDim>().sum();
  rotation += covariance.diagonal().template tail<Pose::kDof - Pose::kDim>().sum();
}

// A run with its covariances.
template <class Pose>
class System {
 public:
  System(const PoseGraph<Pose>& graph, const CompactOptions<Pose>& options)
      : replay_(graph), slam_(options), marginals_(slam_.Solver()) {}

  const CompactPoseSlam<Pose>& Slam() const { return slam_; }
  const CompactInput<Pose>& Input(std::size_t k) const { return replay_.Inputs()[k]; }

  void Add(const CompactInput<Pose>& input) {
    const Decision decision = slam_.AddPose(input);
    newest_ = input.id;
    chain_ = UncertainPose<Pose>();
    if (!decision.Kept()) {
      const PoseId previous = input.odometry->from == input.id ? input.odometry->to : input.odometry->from;
      const auto before = chains_.find(previous.value);
      const UncertainPose<Pose> step = SeenFrom(previous, *input.odometry);
      chain_ = before == chains_.end() ? step : Compose(before->second, step);
      chains_[input.id.value] = chain_;
    }
    marginals_.Update();
  }

  // Over the poses of `kept` that are here.
  CovarianceNorms Norms(const PoseGraph<Pose>& kept) const {
    CovarianceNorms norms;
    const PoseGraph<Pose>& graph = slam_.Solver().Graph();
    const auto& blocks = marginals_.KeptMarginals();
    const PoseId base = slam_.KeptBase(newest_);
    const UncertainPose<Pose> at_base{slam_.Solver().Estimate(base),
                                      blocks[static_cast<std::size_t>(graph.IndexOf(base))]};
    AddTraces<Pose>(Compose(at_base, chain_).covariance, norms.newest_position, norms.newest_rotation);
    for (const auto& node : kept.Poses()) {
      const auto& block = blocks[static_cast<std::size_t>(graph.IndexOf(node.id))];
      AddTraces<Pose>(block, norms.kept_position, norms.kept_rotation);
    }
    return norms;
  }

 private:
  GraphReplay<Pose> replay_;
  CompactPoseSlam<Pose> slam_;
  IncrementalMarginals<Pose> marginals_;
  PoseId newest_;
  UncertainPose<Pose> chain_;                                     // from its kept base to the newest pose
  std::unordered_map<std::int64_t, UncertainPose<Pose>> chains_;  // of dropped poses
};

}  // namespace

template <class Pose>
std::vector<NormPoint> ComputeNorms(const PoseGraph<Pose>& graph, const CompactOptions<Pose>& fpfl,
                                    const std::string& label, bool quiet) {
  CompactOptions<Pose> all = fpfl;
  all.strategy = Strategy::kApal;
  System<Pose> apal(graph, all), marginalised(graph, all), few(graph, fpfl);
  std::vector<NormPoint> rows;
  Progress progress(label, static_cast<long>(graph.Poses().size()), quiet);
  for (std::size_t k = 0; k < graph.Poses().size(); ++k) {
    const PoseGraph<Pose>& kept = few.Slam().Solver().Graph();
    CompactInput<Pose> input = marginalised.Input(k);
    const auto is_gone = [&](const RelativePoseFactor<Pose>& loop) {
      return !kept.HasPose(loop.from == input.id ? loop.to : loop.from);
    };
    input.loops->erase(std::remove_if(input.loops->begin(), input.loops->end(), is_gone), input.loops->end());
    marginalised.Add(input);
    apal.Add(apal.Input(k));
    few.Add(few.Input(k));
    rows.push_back({static_cast<int>(k) + 1, apal.Norms(kept), marginalised.Norms(kept), few.Norms(kept)});
    progress.Update(static_cast<long>(k) + 1);
  }
  return rows;
}

template std::vector<NormPoint> ComputeNorms<SE2>(const PoseGraph<SE2>&, const CompactOptions<SE2>&, const std::string&,
                                                  bool);
template std::vector<NormPoint> ComputeNorms<SE3>(const PoseGraph<SE3>&, const CompactOptions<SE3>&, const std::string&,
                                                  bool);

}  // namespace terse
