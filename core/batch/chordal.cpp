#include "batch/chordal.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <variant>

#include "batch/chordal_problem.h"
#include "cholesky/elimination.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/elimination_order.h"
#include "terse/core/error.h"
#include "terse/core/front_paths.h"
#include "terse/core/gauge.h"

namespace terse::internal {
namespace {

template <class Pose>
class MeasurementsOf {
 public:
  explicit MeasurementsOf(const PoseGraph<Pose>& graph) : graph_(graph) {
    for (const auto& node : graph.Factors()) {
      if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&node.factor)) Add(*f);
      has_positions_ = has_positions_ || std::holds_alternative<PositionPriorFactor<Pose>>(node.factor);
    }
    // A FIXed pose counts as one, as in the solvers.
    for (const auto& node : graph.Poses()) {
      if (node.fixed && node.T_world_body) Add(FixedPosePrior(node.id, *node.T_world_body));
    }
  }

  std::size_t Poses() const { return graph_.Poses().size(); }
  const std::vector<PriorAt<Pose>>& Priors() const { return priors_; }
  bool HasPositions() const { return has_positions_; }
  template <class Function>
  void ForEachRelative(const Function& function) const {
    ForEach<RelativePoseFactor<Pose>>(
        [&](const auto& f) { function(f, graph_.IndexOf(f.from), graph_.IndexOf(f.to)); });
  }
  template <class Function>
  void ForEachPosition(const Function& function) const {
    ForEach<PositionPriorFactor<Pose>>([&](const auto& f) { function(f, graph_.IndexOf(f.pose)); });
  }

 private:
  template <class Kind, class Function>
  void ForEach(const Function& function) const {
    for (const auto& node : graph_.Factors()) {
      if (const auto* f = std::get_if<Kind>(&node.factor)) function(*f);
    }
  }
  void Add(const PosePriorFactor<Pose>& prior) { priors_.push_back({prior, graph_.IndexOf(prior.pose)}); }

  const PoseGraph<Pose>& graph_;
  std::vector<PriorAt<Pose>> priors_;
  bool has_positions_ = false;
};

// On the block factor of three scalars per variable. In 2D the third one is held at zero.
template <int D>
class LeastSquares {
 public:
  LeastSquares(std::size_t poses, int columns, const StartOptions& options)
      : poses_(poses), columns_(columns), X_(3 * poses * At(Stride(columns)), 0.0) {
    factor_.SetOrder(options.order);
    factor_.SetThreads(options.threads);
    factor_.DropUpdateMatrices(options.most_factor_bytes);
    factor_.SetProgress(options.factor_progress);
  }

  // The unknowns stay in the system, cut off from the others, so that indices need no translation.
  void Pin(int pose, const Columns<D>& X) {
    pinned_ = pose;
    pinned_value_ = X;
  }
  void Add(int i, const Block<D>& A_i, const Columns<D>& R) {
    if (i == pinned_) return;
    LinearFactor<3> f;
    f.first = i;
    f.A_first.template topLeftCorner<D, D>() = A_i;
    factors_.push_back(f);
    RightSide(i) -= A_i.transpose() * R;
  }
  void Add(int i, const Block<D>& A_i, int j, const Block<D>& A_j, const Columns<D>& R) {
    if (i == pinned_) return Add(j, A_j, R + A_i * pinned_value_);
    if (j == pinned_) return Add(i, A_i, R + A_j * pinned_value_);
    Add(i, A_i, R);
    factors_.back().second = j;
    factors_.back().A_second.template topLeftCorner<D, D>() = A_j;
    RightSide(j) -= A_j.transpose() * R;
  }

  std::vector<Columns<D>> Solve() {
    if (pinned_ >= 0) {
      const int pose = std::exchange(pinned_, -1);
      Add(pose, Block<D>::Identity(), -pinned_value_);
    }
    if (D < 3) HoldThird();
    BlockCholesky<3>::Changes everything;
    everything.new_variables = static_cast<int>(poses_);
    everything.added = std::move(factors_);
    if (!factor_.Update(std::move(everything)).ok) {
      throw NumericalError("chordal initial values: the linear system is singular");
    }
    SolveDense(factor_.Tree(), X_, Stride(columns_));
    if (!std::all_of(X_.begin(), X_.end(), [](double x) { return std::isfinite(x); })) {
      throw NumericalError("chordal initial values: the solution is not finite");
    }
    std::vector<Columns<D>> X;
    X.reserve(poses_);
    for (std::size_t k = 0; k < poses_; ++k) X.push_back(RightSide(static_cast<int>(k)));
    return X;
  }

 private:
  using Rows = Eigen::Map<Eigen::Matrix<double, D, Eigen::Dynamic, Eigen::RowMajor>, 0, Eigen::OuterStride<>>;
  Rows RightSide(int pose) {
    return {X_.data() + 3 * At(pose) * At(Stride(columns_)), D, columns_, Eigen::OuterStride<>(Stride(columns_))};
  }
  void HoldThird() {
    for (std::size_t k = 0; k < poses_; ++k) {
      LinearFactor<3> f;
      f.first = static_cast<int>(k);
      f.A_first(2, 2) = 1;
      factors_.push_back(f);
    }
  }

  std::size_t poses_;
  int columns_;
  BlockCholesky<3> factor_;
  std::vector<LinearFactor<3>> factors_;
  std::vector<double> X_;  // the right sides, then what solves them: three rows per pose, as many columns side by side
  int pinned_ = -1;
  Columns<D> pinned_value_;
};

}  // namespace

template <class Pose>
std::vector<Pose> ChordalValues(const PoseGraph<Pose>& graph, int first, const Pose& T_world_first,
                                const StartOptions& given) {
  StartOptions options = given;
  if (options.order.empty()) options.order = EliminationOrder(graph);
  RequireOrder(options.order, graph.Poses().size());
  return ChordalStart(MeasurementsOf<Pose>(graph), first, T_world_first,
                      [&](int columns) { return LeastSquares<Pose::kDim>(graph.Poses().size(), columns, options); });
}

template <class Pose>
std::optional<Pose> AlignToPositionPriors(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_old_body) {
  const PositionPairs<Pose::kDim> pairs = PairPositions(MeasurementsOf<Pose>(graph), T_old_body);
  if (!pairs.DetermineTurn()) return std::nullopt;
  return pairs.template MotionWith<Pose>(pairs.svd.ClosestOrthogonal());
}

#define TERSE_INSTANTIATE(Pose)                                                                                  \
  template std::vector<Pose> ChordalValues<Pose>(const PoseGraph<Pose>&, int, const Pose&, const StartOptions&); \
  template std::optional<Pose> AlignToPositionPriors<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
