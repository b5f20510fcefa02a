#include "pose_recovery.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <stdexcept>

#include "terse/core/at.h"
#include "terse/core/decompositions.h"
#include "terse/core/definite.h"

namespace terse::internal {
namespace {

// P.
template <class Pose>
typename Pose::Jacobian AtBase(const UncertainPose<Pose>& chain) {
  const typename Pose::Jacobian A = chain.T_a_b.Adjoint();
  return A * chain.covariance * A.transpose();
}

// K of what shares P with a chain that ends with P_end.
template <class Jacobian>
Jacobian Share(const Jacobian& P, const Jacobian& P_end) {
  return P_end.llt().solve(P).transpose();
}

// A difference of two covariances, one gathered on the way to the other: none of it is negative. With the fourth order
// it can come out so on steps of some tenths of a radian, for what the order leaves out.
template <class Jacobian>
Jacobian Gathered(const Jacobian& P, const Jacobian& P_older) {
  Jacobian difference = (P - P_older + (P - P_older).transpose()) / 2;
  if (IsDefinite<Jacobian::RowsAtCompileTime>(difference)) return difference;
  const auto eigen = DecomposeSymmetric<Jacobian::RowsAtCompileTime>(difference);
  return eigen.vectors * eigen.values.cwiseMax(0).asDiagonal() * eigen.vectors.transpose();
}

}  // namespace

// The error of a pose, or of one pose seen from another, to first order: the sum of A d over kept poses, and of C l
// over chains from their base to the place `at`: a dropped pose, or the kept one where its chain ends; behind all
// places (PoseHistory::EndedByLink) chains as links have ended them.
template <class Pose>
struct PoseRecovery<Pose>::Error {
  struct Chain {
    int at;
    Jacobian C, P;
  };

  void AddKept(PoseId id, const Jacobian& A) {
    const auto it = std::find_if(kept.begin(), kept.end(), [&](const auto& term) { return term.id == id; });
    it == kept.end() ? kept.push_back({id, A}) : void(it->A += A);
  }
  void AddChain(const Chain& chain) {
    const auto it = std::find_if(chains.begin(), chains.end(), [&](const Chain& c) { return c.at == chain.at; });
    it == chains.end() ? chains.push_back(chain) : void(it->C += chain.C);
  }
  void Add(const Jacobian& factor, const Error& other) {
    for (const auto& term : other.kept) AddKept(term.id, factor * term.A);
    for (const Chain& chain : other.chains) AddChain({chain.at, factor * chain.C, chain.P});
  }

  Pose T_world_body;
  std::vector<typename PoseMarginals<Pose>::Term> kept;
  std::vector<Chain> chains;
};

// How a chain of dropped poses lies between the kept poses that it joins; e and K are zero if it has not ended.
template <class Pose>
struct PoseRecovery<Pose>::Bridge {
  Pose T_world_base, T_base_next;
  typename Pose::Tangent e = Pose::Tangent::Zero();
  typename Pose::Jacobian K = Pose::Jacobian::Zero(), P_next = Pose::Jacobian::Zero();
};

template <class Pose>
typename PoseRecovery<Pose>::Bridge PoseRecovery<Pose>::BridgeOf(PoseId dropped, int ended) const {
  Bridge bridge;
  bridge.T_world_base = map_.Solver().Estimate(history_.Find(dropped).base);
  if (ended < 0) return bridge;
  const auto& shared = history_[ended];
  bridge.T_base_next = bridge.T_world_base.Inverse() * map_.Solver().Estimate(*shared.next_kept);
  bridge.e = (bridge.T_base_next * shared.T_base_next.T_a_b.Inverse()).Log();
  bridge.P_next = AtBase(shared.T_base_next);
  bridge.K = Share(AtBase(shared.T_base_pose), bridge.P_next);
  return bridge;
}

// A dropped pose as kV2.
template <class Pose>
Pose PoseRecovery<Pose>::Recover(PoseId dropped, int ended) const {
  const Bridge bridge = BridgeOf(dropped, ended);
  return bridge.T_world_base * Pose::Exp(bridge.K * bridge.e) * history_.Find(dropped).T_base_pose.T_a_b;
}

template <class Pose>
Pose PoseRecovery<Pose>::Estimate(PoseId id, Recovery recovery) const {
  const auto& seen = history_.Find(id);
  if (seen.kept) return map_.Solver().Estimate(id);
  if (recovery == Recovery::kV0) return seen.T_world_body_when_seen;
  return Recover(id, recovery == Recovery::kV2 ? history_.EndedBefore(id) : -1);
}

template <class Pose>
std::vector<RecoveredPose<Pose>> PoseRecovery<Pose>::Trajectory(Recovery recovery) const {
  std::vector<RecoveredPose<Pose>> out;
  std::vector<int> ended(At(history_.Size()), -1);  // EndedBefore, without walking every chain anew
  for (int k = 0; k < history_.Size(); ++k) {
    const auto& seen = history_[k];
    if (!seen.kept && recovery == Recovery::kV2) {
      ended[At(k)] = seen.next_kept ? k : ended[At(seen.parent)];
      out.push_back({seen.id, false, Recover(seen.id, ended[At(k)])});
    } else {
      out.push_back({seen.id, seen.kept, Estimate(seen.id, recovery)});
    }
  }
  return out;
}

template <class Pose>
typename PoseRecovery<Pose>::Error PoseRecovery<Pose>::ErrorOf(PoseId id) const {
  const Jacobian I = Jacobian::Identity();
  const auto& seen = history_.Find(id);
  Error error;
  if (seen.kept) {
    error.T_world_body = map_.Solver().Estimate(id);
    error.AddKept(id, I);
    return error;
  }
  const int at = history_.IndexOf(id), ended = history_.EndedBefore(id);
  const Bridge bridge = BridgeOf(id, ended);
  const typename Pose::Tangent shared = bridge.K * bridge.e;
  const Pose T_base_pose = Pose::Exp(shared) * seen.T_base_pose.T_a_b;
  const Jacobian A = T_base_pose.Inverse().Adjoint(), J = Pose::LeftJacobian(shared),
                 G = J * bridge.K * Pose::LeftJacobianInverse(bridge.e);
  error.T_world_body = bridge.T_world_base * T_base_pose;
  // e changes by Jl(e)^-1 (Ad(T_base_next) d_next - d_base), and T_base_pose by Exp(Jl(K e) dl) on the left.
  error.AddKept(seen.base, A * (I - G));
  error.AddChain({at, A * J, AtBase(seen.T_base_pose)});
  if (ended >= 0) {
    const PoseId next = *history_[ended].next_kept;
    const int by = history_[ended].ended_by;
    error.AddKept(next, A * G * bridge.T_base_next.Adjoint());
    error.AddChain({by < 0 ? history_.IndexOf(next) : history_.EndedByLink(by), -A * J * bridge.K, bridge.P_next});
  }
  return error;
}

// Of the sum of C l. The chains are walked towards their bases, the newest pose first, so that chains that lead through
// one pose meet there: behind it they are one error with the sum of their C. Each stretch walked adds what the chain
// gathered on it, a difference of two P. No large parts cancel.
template <class Pose>
typename Pose::Jacobian PoseRecovery<Pose>::ChainCovariance(const Error& error) const {
  using Chain = typename Error::Chain;  // P: at the newer end of the stretch
  Jacobian sum = Jacobian::Zero();
  const auto add = [&](const Chain& chain, const Jacobian& P_older_end) {
    sum += chain.C * Gathered<Jacobian>(chain.P, P_older_end) * chain.C.transpose();
  };
  std::vector<Chain> chains = error.chains;
  while (!chains.empty()) {
    const auto newest =
        std::max_element(chains.begin(), chains.end(), [](const Chain& a, const Chain& b) { return a.at < b.at; });
    const int previous = history_.ParentOnChain(newest->at);
    if (previous < 0 || history_[previous].kept) {
      add(*newest, Jacobian::Zero());
      chains.erase(newest);
      continue;
    }
    const auto met = std::find_if(chains.begin(), chains.end(), [&](const Chain& c) { return c.at == previous; });
    newest->at = previous;
    if (met == chains.end()) continue;
    const Jacobian P = AtBase(history_[previous].T_base_pose);
    add(*newest, P);
    add(*met, P);
    met->C += newest->C;
    met->P = P;
    chains.erase(newest);
  }
  return sum;
}

template <class Pose>
typename Pose::Jacobian PoseRecovery<Pose>::CovarianceOf(const Error& error) const {
  const typename Pose::Jacobian sum = map_.Marginals().Combination(error.kept) + ChainCovariance(error);
  return (sum + sum.transpose()) / 2;
}

template <class Pose>
typename Pose::Jacobian PoseRecovery<Pose>::Covariance(PoseId id, const CovarianceConvention& convention) const {
  const Error error = ErrorOf(id);
  return ConvertCovariance<Pose>(CovarianceOf(error), error.T_world_body, convention);
}

template <class Pose>
typename Pose::Jacobian PoseRecovery<Pose>::RelativeCovariance(PoseId a, PoseId b,
                                                               const CovarianceConvention& convention) const {
  const Error of_a = ErrorOf(a);
  Error error = ErrorOf(b);
  if (a == b) throw std::invalid_argument("a relative pose needs two distinct poses");
  const Pose T_a_b = of_a.T_world_body.Inverse() * error.T_world_body;
  // d_ab = d_b - Ad(T_a_b^-1) d_a.
  error.Add(-typename Pose::Jacobian(T_a_b.Inverse().Adjoint()), of_a);
  return ConvertCovariance<Pose>(CovarianceOf(error), T_a_b, convention);
}

template class PoseRecovery<SE2>;
template class PoseRecovery<SE3>;

}  // namespace terse::internal
