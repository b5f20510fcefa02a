#include "terse/compact/thresholds.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <tuple>

#include "terse/compact/information.h"
#include "terse/compact/innovation.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse {
namespace {

constexpr double kPi = 3.14159265358979323846;

// Per degree of freedom; thresholds.h says why.
constexpr double kLeastLoopGain = 0.5, kMostLoopGain = 1.5, kLeastPoseGain = 0.9;
constexpr double kPoseToLoop = 0.9;

double Raise(double gain, double power) { return std::exp(power * std::log(gain + 1)) - 1; }

double Percentile90(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto nth = values.begin() + static_cast<long>(0.9 * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

// Per dimension the least range with which the displacement passes, by bisection.
template <class Pose>
Vector<Displacement<Pose>::kSize> LeastRange(const Displacement<Pose>& displacement, double probability) {
  using Range = Vector<Displacement<Pose>::kSize>;
  Range low = Range::Constant(1e-6);
  Range high = displacement.mean.cwiseAbs() + 40 * displacement.covariance.diagonal().cwiseMax(0).cwiseSqrt();
  high = high.cwiseMax(1e-3);
  high[Pose::kDim] = kPi;
  for (int k = 0; k < 50; ++k) {
    const Range middle = (low + high) / 2;
    const Range passed = RangeProbabilities<Pose>(displacement, middle);
    for (int i = 0; i < passed.size(); ++i) (passed[i] > probability ? high : low)[i] = middle[i];
  }
  return high;
}

// What is known of pose n and of the poses that its loops lead to, before any loop: conditioned on one loop after the
// other as they are added, at fixed linearisation points.
template <class Pose>
class LoopGains {
 public:
  static constexpr int B = Pose::kDof;
  using Jacobian = typename Pose::Jacobian;

  // `T_base_n`: odometry from the pose `base`.
  LoopGains(const IncrementalMarginals<Pose>& marginals, const IncrementalSolver<Pose>& solver, PoseId base,
            const UncertainPose<Pose>& T_base_n, const std::vector<PoseId>& loops) {
    std::vector<PoseId> ids = {base};
    ids.insert(ids.end(), loops.begin(), loops.end());
    Sigma_ = marginals.Joint(ids);
    // The base gives way to n. (A loop may lead to the base too: it is there a second time.)
    const Jacobian F = T_base_n.T_a_b.Inverse().Adjoint();
    Sigma_.topRows(B) = (F * Sigma_.topRows(B)).eval();
    Sigma_.leftCols(B) = (Sigma_.leftCols(B) * F.transpose()).eval();
    Sigma_.topLeftCorner(B, B) += T_base_n.covariance;
    const Pose T_world_n = solver.Estimate(base) * T_base_n.T_a_b;
    for (const PoseId id : loops) T_loop_n_.push_back(solver.Estimate(id).Inverse() * T_world_n);
  }

  // From loop pose k.
  UncertainPose<Pose> Displacement(int k) const {
    const int at = (k + 1) * B;
    return {T_loop_n_[static_cast<std::size_t>(k)],
            RelativeCovariance<Pose>(T_loop_n_[static_cast<std::size_t>(k)], Sigma_.template block<B, B>(at, at),
                                     Sigma_.template block<B, B>(at, 0), Sigma_.template block<B, B>(0, 0))};
  }

  void Add(int k, const Jacobian& Sigma_y) {
    // The displacement moves by d_n - A d_k.
    const Jacobian A = T_loop_n_[static_cast<std::size_t>(k)].Inverse().Adjoint();
    const MatrixX Sigma_C = Sigma_.leftCols(B) - Sigma_.middleCols((k + 1) * B, B) * A.transpose();
    const Jacobian S = Sigma_C.topRows(B) - A * Sigma_C.middleRows((k + 1) * B, B) + Sigma_y;
    const MatrixX Y = S.llt().matrixL().solve(Sigma_C.transpose());
    Sigma_.noalias() -= Y.transpose() * Y;
  }

 private:
  MatrixX Sigma_;  // of n, then of the loop poses
  std::vector<Pose> T_loop_n_;
};

// Takes out the links that the innovation test refuses, and says whether there are any.
template <class Pose>
bool RemoveRefused(const LoopGains<Pose>& known, double most_innovation, std::vector<PoseId>& linked,
                   std::vector<RelativePoseFactor<Pose>>& links) {
  if (!std::isfinite(most_innovation)) return false;
  std::size_t good = 0;
  for (std::size_t k = 0; k < links.size(); ++k) {
    const UncertainPose<Pose> measured = SeenFrom(linked[k], links[k]);
    if (!(InnovationDistance(known.Displacement(static_cast<int>(k)), measured) <= most_innovation)) continue;
    linked[good] = linked[k];
    links[good++] = links[k];
  }
  if (good == links.size()) return false;
  linked.resize(good);
  links.resize(good);
  return true;
}

// Gains below this are not told apart.
constexpr double kLeastGain = 0.05;

// The gains of the loops of one pose as Algorithm 1 would add them: best first, the rest evaluated again after each.
template <class Pose>
void RecordLoopGains(LoopGains<Pose>& known, int loops, const typename Pose::Jacobian& Sigma_y,
                     std::vector<double>& gains) {
  std::vector<int> left(static_cast<std::size_t>(loops));
  std::iota(left.begin(), left.end(), 0);
  while (!left.empty()) {
    double gain = -1;
    std::size_t best = 0;
    for (std::size_t k = 0; k < left.size(); ++k) {
      const double g = InformationGain<Pose::kDof>(known.Displacement(left[k]).covariance, Sigma_y);
      if (g > gain) std::tie(gain, best) = std::make_pair(g, k);
    }
    if (gain < kLeastGain) {
      gains.insert(gains.end(), left.size(), gain);
      return;
    }
    gains.push_back(gain);
    known.Add(left[best], Sigma_y);
    left.erase(left.begin() + static_cast<long>(best));
  }
}

double MostInnovation(const SampleOptions& options, int dof) {
  return options.innovation_quantile ? ChiSquareQuantile(*options.innovation_quantile, dof)
                                     : std::numeric_limits<double>::infinity();
}

// A run with all poses and links, and what its loops would have told.
template <class Pose>
class Sample {
 public:
  Sample(const SampleOptions& options, GraphReplay<Pose>& replay)
      : options_(options),
        most_innovation_(MostInnovation(options, Pose::kDof)),
        Sigma_y_(replay.LinkCovariance()),
        registration_(replay.AsRegistration()),
        slam_(All()) {}

  void Add(const CompactInput<Pose>& input) {
    std::vector<PoseId> linked = *input.linkable;
    std::vector<RelativePoseFactor<Pose>> links;
    for (const PoseId id : linked) links.push_back(*registration_(id, input.id));
    if (input.odometry) Learn(input, linked, links);
    CompactInput<Pose> agreed = input;
    agreed.loops = links;
    slam_.AddPose(agreed);
  }

  Vector<Displacement<Pose>::kSize> range = Vector<Displacement<Pose>::kSize>::Zero();
  std::vector<double> loop_gains, pose_gains;

 private:
  static CompactOptions<Pose> All() {
    CompactOptions<Pose> options;
    options.strategy = Strategy::kApal;
    return options;
  }

  // Takes out the links that are refused.
  void Learn(const CompactInput<Pose>& input, std::vector<PoseId>& linked,
             std::vector<RelativePoseFactor<Pose>>& links) {
    const PoseId base = input.odometry->from == input.id ? input.odometry->to : input.odometry->from;
    const UncertainPose<Pose> T_base_n = SeenFrom(base, *input.odometry);
    LoopGains<Pose> known(marginals_, slam_.Solver(), base, T_base_n, linked);
    if (RemoveRefused(known, most_innovation_, linked, links)) {
      known = LoopGains<Pose>(marginals_, slam_.Solver(), base, T_base_n, linked);
    }
    const int loops = static_cast<int>(links.size());
    double least = InformationGain<Pose::kDof>(T_base_n.covariance, Sigma_y_);
    for (int i = 0; i < loops; ++i) {
      const UncertainPose<Pose> T_loop_n = known.Displacement(i);
      const auto displacement = ComputeDisplacement<Pose>(T_loop_n, options_.distance);
      range = range.cwiseMax(LeastRange<Pose>(displacement, options_.probability));
      least = std::min(least, InformationGain<Pose::kDof>(T_loop_n.covariance, Sigma_y_));
    }
    pose_gains.push_back(least);
    RecordLoopGains(known, loops, Sigma_y_, loop_gains);
  }

  const SampleOptions& options_;
  const double most_innovation_;
  const typename Pose::Jacobian Sigma_y_;
  Registration<Pose> registration_;
  CompactPoseSlam<Pose> slam_;
  IncrementalMarginals<Pose> marginals_{slam_.Solver()};
};

}  // namespace

template <class Pose>
Thresholds<Pose> SelectThresholds(const PoseGraph<Pose>& graph, const SampleOptions& options) {
  if (!(options.share > 0 && options.share <= 1) || !(options.probability >= 0 && options.probability < 1)) {
    throw std::invalid_argument("sample options: the share must be in (0, 1], the probability in [0, 1)");
  }
  if (options.most_poses < 1) throw std::invalid_argument("sample options: at least one pose is needed");
  GraphReplay<Pose> replay(graph);
  Sample<Pose> sample(options, replay);
  const auto& inputs = replay.Inputs();
  Thresholds<Pose> out;
  out.probability = options.probability;
  out.link_covariance = replay.LinkCovariance();
  out.sample_poses = std::min(options.most_poses, std::lround(options.share * static_cast<double>(inputs.size())));
  for (long k = 0; k < out.sample_poses; ++k) {
    sample.Add(inputs[static_cast<std::size_t>(k)]);
    if (options.progress) options.progress(k + 1, out.sample_poses);
  }
  out.range = sample.range.cwiseMax(replay.LinkRange(options.distance));
  out.range.template head<Pose::kDim>().setConstant(out.range.template head<Pose::kDim>().maxCoeff());
  out.loop_gain_90 = Percentile90(sample.loop_gains);
  out.pose_gain_90 = Percentile90(sample.pose_gains);
  out.min_loop_gain =
      std::clamp(Raise(out.loop_gain_90, 1.36), kLeastLoopGain * Pose::kDof, kMostLoopGain * Pose::kDof);
  out.min_pose_gain =
      std::max({Raise(out.pose_gain_90, 1.7), kLeastPoseGain * Pose::kDof, kPoseToLoop * out.min_loop_gain});
  return out;
}

template Thresholds<SE2> SelectThresholds<SE2>(const PoseGraph<SE2>&, const SampleOptions&);
template Thresholds<SE3> SelectThresholds<SE3>(const PoseGraph<SE3>&, const SampleOptions&);

}  // namespace terse
