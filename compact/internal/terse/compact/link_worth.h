#pragma once
// What links are worth in the presence of those kept so far.
//
// With the information H of what is kept, Sigma = H^-1, and a link's whitened Jacobian A, C = A Sigma A':
//   information: a link tells 1/2 ln |I + C|, and if it goes -1/2 ln |I - C| is lost.
//   position:    with p the positions, Q what rigid motions do to them and K = E'E - QQ' (E picks the positions out of
//                the perturbations), the expected sum of squared errors after the best alignment is V = tr(K Sigma). A
//                link lowers it by tr((I + C)^-1 N), N = A Sigma K Sigma A', and V rises by tr((I - C)^-1 N) if it
//                goes.
//
// C takes substitution along the paths of two poses to the root alone. N would take two block columns of Sigma for
// every link. Instead N = (A Y)(A Y)' with Y = Sigma K^1/2 G and G G' close to the identity: half of G spans the
// directions in which the map is least certain, found by one subspace iteration, the other half is random in what is
// left (Hutch++: Meyer, Musco, Musco, Woodruff, 2021). One Y serves all links.
//
// Keeping a link c takes Sigma A' S^-1 A Sigma, S = I + C_c, from Sigma. Then
//   - Keep brings C and A Y of other links up to date: with p = A Sigma A_c', C <- C - p S^-1 p' and
//     A Y <- A Y - p S^-1 A_c Y. O(poses + links) for p. Meant for the first links, which change the worth of all
//     others.
//   - KeepBySamples does so with what the samples X of N(0, Sigma) say p is, for links near by, and leaves the factor
//     alone: many links in a moment. Of 32 samples (A X)(A_c X)' is mostly noise where links have nothing to do with
//     each other, so it is shrunk by the share that noise has in it (as James and Stein would).
//   - else C is asked for anew when it is needed, and A Y is taken to shrink as that of a measurement of the same
//     displacement would: A Y <- C C_before^-1 A Y. Exact for links that say the same.
// A new Refresh forgets all that.

#include <vector>

#include "terse/compact/link_system.h"
#include "terse/core/at.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/random.h"

namespace terse::internal {

template <class Pose>
class LinkWorth {
 public:
  static constexpr int B = Pose::kDof, D = Pose::kDim;
  using Block = Matrix<B, B>;

  // `system` outlives this. Parallel: inside WithThreads. Throws NumericalError if what is fixed does not hold every
  // pose.
  LinkWorth(const LinkSystem<Pose>& system, SparsifyCriterion criterion, const std::vector<char>& kept, bool parallel);

  const std::vector<char>& Kept() const { return kept_; }
  int KeptCount() const { return kept_count_; }
  // What it tells if it is not kept, what is lost without it if it is; infinite if it holds poses alone. As of the last
  // Evaluate, or Keep that told it; else as of the last Sample.
  double Worth(int link) const;
  // Brings these up to date.
  void Evaluate(const std::vector<int>& links);
  // Whether that was done since the last change.
  bool IsFresh(int link) const { return states_[At(link)].change == changes_; }

  // Brings `others` up to date, if they were before.
  void Keep(int link, const std::vector<int>& others = {});
  // Between Sample and Refresh: brings `near` up to date by the samples alone, and leaves the factor as it is.
  void KeepBySamples(int link, const std::vector<int>& near);
  // False, and nothing changes, if poses would be held by nothing.
  [[nodiscard]] bool Drop(int link);
  // Orders and factors anew, with `kept` instead. All links are out of date.
  void Refresh();
  void Restart(const std::vector<char>& kept);
  // After a Refresh: what all links are worth, to about a fifth.
  void Sample();
  // Exactly: the expected sum of squared position errors V, the log-determinant of the information, and which of them
  // the criterion is about.
  double PositionTotal() const;
  double LogDeterminant() const { return cholesky_.LogDeterminant(); }
  double Total() const { return criterion_ == SparsifyCriterion::kPosition ? PositionTotal() : LogDeterminant(); }

 private:
  static constexpr int kColumns = 32;  // samples, and directions of either kind
  using Samples = Eigen::Matrix<double, B, kColumns, Eigen::RowMajor>;
  using SampleMap = Eigen::Map<Samples, 0, Eigen::OuterStride<>>;
  using Moved = Eigen::Matrix<double, B, 2 * kColumns, Eigen::RowMajor>;
  struct State {
    Block C = Block::Zero();
    int change = -1;  // that C is as of; -1: as sampled
  };
  void EvaluateOne(int link);
  void Propagate(int link, const std::vector<int>& others);
  LinearFactor<B> Faded(int link) const;
  Block Covariance(int link) const;
  Eigen::Map<Moved> MovedOf(int link) {
    return Eigen::Map<Moved>(moved_.data() + static_cast<long>(link) * Moved::SizeAtCompileTime);
  }
  Eigen::Map<const Moved> MovedOf(int link) const {
    return Eigen::Map<const Moved>(moved_.data() + static_cast<long>(link) * Moved::SizeAtCompileTime);
  }
  Eigen::Map<Samples> SampledOf(int link) {
    return Eigen::Map<Samples>(sampled_.data() + static_cast<long>(link) * Samples::SizeAtCompileTime);
  }
  static SampleMap RowsOf(std::vector<double>& X, int pose, int column);
  std::vector<double> DrawSamples(Random& random) const;
  void FindDirections(Random& random, std::vector<double>& X) const;
  void TakeMotionsOut(std::vector<double>& X, int column) const;

  const LinkSystem<Pose>& system_;
  const SparsifyCriterion criterion_;
  const bool parallel_;
  std::vector<char> kept_;
  int kept_count_ = 0;
  std::vector<int> slots_;  // by link; -1: none
  std::vector<State> states_;
  std::vector<double> sampled_, moved_;  // A X and, for positions, A Y by link
  BlockCholesky<B> cholesky_;
  int round_ = 0, changes_ = 0;
};

extern template class LinkWorth<SE2>;
extern template class LinkWorth<SE3>;

}  // namespace terse::internal
