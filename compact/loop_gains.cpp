#include "loop_gains.h"
#include "terse/core/at.h"

#include <Eigen/Cholesky>
#include <numeric>
#include <queue>
#include <utility>

namespace terse {
namespace {

using internal::At;
using std::size_t;

}  // namespace

template <class Pose>
LoopGains<Pose>::LoopGains(const IncrementalMarginals<Pose>& marginals, const IncrementalSolver<Pose>& solver,
                           PoseId base, const UncertainPose<Pose>& T_base_n, const std::vector<PoseId>& loops) {
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

template <class Pose>
UncertainPose<Pose> LoopGains<Pose>::Displacement(int k) const {
  const int at = (k + 1) * B;
  return {T_loop_n_[At(k)],
          RelativeCovariance<Pose>(T_loop_n_[At(k)], Sigma_.template block<B, B>(at, at),
                                   Sigma_.template block<B, B>(at, 0), Sigma_.template block<B, B>(0, 0))};
}

template <class Pose>
void LoopGains<Pose>::Keep(const std::vector<int>& loops) {
  std::vector<int> rows(B);
  std::iota(rows.begin(), rows.end(), 0);
  std::vector<Pose> T_loop_n;
  for (const int k : loops) {
    for (int r = 0; r < B; ++r) rows.push_back((k + 1) * B + r);
    T_loop_n.push_back(T_loop_n_[At(k)]);
  }
  const int size = static_cast<int>(rows.size());
  MatrixX Sigma(size, size);
  for (int c = 0; c < size; ++c) {
    for (int r = 0; r < size; ++r) Sigma(r, c) = Sigma_(rows[At(r)], rows[At(c)]);
  }
  Sigma_ = std::move(Sigma);
  T_loop_n_ = std::move(T_loop_n);
}

template <class Pose>
void LoopGains<Pose>::Add(int k, const Jacobian& Sigma_y) {
  // The displacement moves by d_n - A d_k.
  const Jacobian A = T_loop_n_[At(k)].Inverse().Adjoint();
  const MatrixX Sigma_C = Sigma_.leftCols(B) - Sigma_.middleCols((k + 1) * B, B) * A.transpose();
  const Jacobian S = Sigma_C.topRows(B) - A * Sigma_C.middleRows((k + 1) * B, B) + Sigma_y;
  const MatrixX Y = S.llt().matrixL().solve(Sigma_C.transpose());
  Sigma_.noalias() -= Y.transpose() * Y;
}

template <class Pose>
std::vector<double> LoopGains<Pose>::BestFirst(const Jacobian& Sigma_y, double least) {
  struct Entry {
    double gain;
    int k;
    size_t added;  // loops that the gain knows of
    bool operator<(const Entry& other) const { return std::pair(gain, -k) < std::pair(other.gain, -other.k); }
  };
  std::priority_queue<Entry> queue;
  for (int k = 0; k < static_cast<int>(T_loop_n_.size()); ++k) queue.push({Gain(k, Sigma_y), k, 0});
  std::vector<double> gains;
  while (!queue.empty()) {
    Entry best = queue.top();
    queue.pop();
    if (best.added < gains.size()) {
      best.gain = Gain(best.k, Sigma_y);
      best.added = gains.size();
      queue.push(best);
      continue;
    }
    gains.push_back(best.gain);
    if (best.gain < least) break;
    if (!queue.empty()) Add(best.k, Sigma_y);
  }
  return gains;
}

template class LoopGains<SE2>;
template class LoopGains<SE3>;

}  // namespace terse
