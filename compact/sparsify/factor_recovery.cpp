#include "factor_recovery.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "terse/compact/log_determinant.h"
#include "terse/core/at.h"
#include "terse/core/decompositions.h"
#include "terse/core/definite.h"
#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse::internal {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// Least share of a pair's information in the target: factors must be positive definite.
constexpr double kFloor = 1e-9;
// The first ones only show which factors the tree needs most besides.
constexpr int kMostSweeps = 30, kFirstSweeps = 2;
constexpr double kLeastFall = 3e-2, kLeastFallNats = 1e-7;  // for one more sweep

// Two poses of a clique, and what a factor between them looks like: d_ij = d_j - A d_i.
template <class Pose>
struct Pair {
  using Jacobian = typename Pose::Jacobian;
  Pair(int from, int to, const Pose& E) : i(from), j(to), E_i_j(E), A(E.Inverse().Adjoint()) {}
  int i, j;
  Pose E_i_j;
  Jacobian A;
  Jacobian root = Jacobian::Zero();  // lower triangular, of the target's covariance of d_ij
  Jacobian information = Jacobian::Zero();
  bool in_tree = false, is_there = false;  // there: an edge of the graph
  bool is_used = false;
  bool says_something = false;  // more than the floor
};

// The displacements of the neighbours but the first, each in its own frame, relative to the first, which stays.
template <class Pose>
class Recovery {
 public:
  static constexpr int B = Pose::kDof;
  using Jacobian = typename Pose::Jacobian;
  using Tangent = typename Pose::Tangent;

  explicit Recovery(const Clique<Pose>& clique)
      : clique_(clique), size_(static_cast<int>(clique.arms.size())), n_(B * (size_ - 1)) {}

  // Absent where the numbers are beyond the arithmetic or the means are not mild.
  std::optional<Tree<Pose>> Run(RecoveredFactors recovered, bool conservative);

 private:
  using Block = Eigen::Matrix<double, B, B>;

  static int Slot(int node) { return B * (node - 1); }
  static void AddInformation(const Pair<Pose>& e, const Jacobian& Omega, MatrixXd& H);
  static void AddVector(const Pair<Pose>& e, const Tangent& v, VectorXd& eta);
  // J_e M and M J_e'.
  static MatrixXd Rows(const MatrixXd& M, const Pair<Pose>& e);
  static MatrixXd Columns(const MatrixXd& M, const Pair<Pose>& e) { return Rows(M.transpose(), e).transpose(); }
  static Jacobian CovarianceOf(const MatrixXd& Sigma, const Pair<Pose>& e) { return Columns(Rows(Sigma, e), e); }

  bool MakeTarget();
  bool MakePairs();
  bool StartFromTree();
  Block OthersShare(const Pair<Pose>& e, const Jacobian& information) const;
  double Gain(const Pair<Pose>& e) const;
  void Improve(Pair<Pose>& e);
  void AddBestPairs(int most);
  bool Descend(int most_sweeps);
  void LeaveOutUseless();
  bool Invert();  // lambda_
  MatrixXd InTargetCoordinates() const;
  double Divergence() const;
  std::optional<Tree<Pose>> Result(bool conservative);

  const Clique<Pose>& clique_;
  int size_, n_;
  MatrixXd target_covariance_, target_root_;  // root: lower triangular
  VectorXd eta_;
  std::vector<Pair<Pose>> pairs_;
  MatrixXd lambda_, sigma_;  // of the recovered factors
};

template <class Pose>
void Recovery<Pose>::AddInformation(const Pair<Pose>& e, const Jacobian& Omega, MatrixXd& H) {
  const int i = Slot(e.i), j = Slot(e.j);
  if (j >= 0) H.block<B, B>(j, j) += Omega;
  if (i >= 0) H.block<B, B>(i, i) += e.A.transpose() * Omega * e.A;
  if (i < 0 || j < 0) return;
  H.block<B, B>(j, i) -= Omega * e.A;
  H.block<B, B>(i, j) -= e.A.transpose() * Omega;
}

template <class Pose>
void Recovery<Pose>::AddVector(const Pair<Pose>& e, const Tangent& v, VectorXd& eta) {
  if (e.j > 0) eta.segment<B>(Slot(e.j)) += v;
  if (e.i > 0) eta.segment<B>(Slot(e.i)) -= e.A.transpose() * v;
}

template <class Pose>
MatrixXd Recovery<Pose>::Rows(const MatrixXd& M, const Pair<Pose>& e) {
  MatrixXd out = MatrixXd::Zero(B, M.cols());
  if (e.j > 0) out += M.middleRows<B>(Slot(e.j));
  if (e.i > 0) out -= e.A * M.middleRows<B>(Slot(e.i));
  return out;
}

// The Schur complement of p, which is numbered after its neighbours.
template <class Pose>
bool Recovery<Pose>::MakeTarget() {
  MatrixXd H = MatrixXd::Zero(n_ + B, n_ + B);
  VectorXd eta = VectorXd::Zero(n_ + B);
  const auto add = [&](int i, int j, const Arm<Pose>& arm) {
    const Pair<Pose> e(i, j, arm.Estimate());
    AddInformation(e, arm.Information(), H);
    AddVector(e, arm.Vector(), eta);
  };
  for (int k = 0; k < size_; ++k) add(size_, k, clique_.arms[At(k)]);
  for (const auto& [ends, arm] : clique_.between) add(ends.first, ends.second, arm);
  const Eigen::LLT<Jacobian> of_p(Jacobian(H.bottomRightCorner<B, B>()));
  if (of_p.info() != Eigen::Success) return false;
  const MatrixXd gain = of_p.solve(H.bottomLeftCorner(B, n_));
  lambda_ = H.topLeftCorner(n_, n_) - H.topRightCorner(n_, B) * gain;
  eta_ = eta.head(n_) - gain.transpose() * eta.tail<B>();
  if (!Invert()) return false;
  target_covariance_ = sigma_;
  const Eigen::LLT<MatrixXd> root(target_covariance_);
  target_root_ = root.matrixL();
  return root.info() == Eigen::Success && eta_.allFinite();
}

template <class Pose>
bool Recovery<Pose>::Invert() {
  const Eigen::LLT<MatrixXd> llt((lambda_ + lambda_.transpose()) / 2);
  if (llt.info() != Eigen::Success) return false;
  sigma_ = llt.solve(MatrixXd::Identity(n_, n_));
  sigma_ = (sigma_ + sigma_.transpose()).eval() / 2;
  return sigma_.allFinite();
}

template <class Pose>
bool Recovery<Pose>::MakePairs() {
  for (int i = 0; i < size_; ++i) {
    const Pose E_i_p = clique_.arms[At(i)].Estimate().Inverse();
    for (int j = i + 1; j < size_; ++j) {
      Pair<Pose> e(i, j, E_i_p * clique_.arms[At(j)].Estimate());
      const Eigen::LLT<Jacobian> llt(CovarianceOf(target_covariance_, e));
      if (llt.info() != Eigen::Success) return false;
      e.root = llt.matrixL();
      const auto there = clique_.between.find({i, j});
      if (there != clique_.between.end()) {
        e.is_there = e.is_used = true;
        e.information = there->second.Information();
      }
      pairs_.push_back(e);
    }
  }
  return true;
}

// Chow-Liu: of p's own factors the spanning tree that loses least, which has the least log-determinants of covariance
// and keeps every edge's covariance. Fused with what is there.
template <class Pose>
bool Recovery<Pose>::StartFromTree() {
  std::vector<Jacobian> R;
  for (const Arm<Pose>& arm : clique_.arms) R.push_back(arm.Covariance());
  const auto covariance = [&](const Pair<Pose>& e) -> Jacobian {
    return R[At(e.j)] + e.A * R[At(e.i)] * e.A.transpose();
  };
  std::vector<std::pair<double, int>> weighted;
  for (int e = 0; e < static_cast<int>(pairs_.size()); ++e) {
    weighted.emplace_back(LogDeterminant(covariance(pairs_[At(e)])), e);
    if (!std::isfinite(weighted.back().first)) return false;
  }
  std::sort(weighted.begin(), weighted.end());
  std::vector<int> part(At(size_));
  std::iota(part.begin(), part.end(), 0);
  for (const auto& [weight, number] : weighted) {
    Pair<Pose>& e = pairs_[At(number)];
    const int from = part[At(e.j)], to = part[At(e.i)];
    if (from == to) continue;
    std::replace(part.begin(), part.end(), from, to);
    e.in_tree = e.is_used = true;
    e.information += InverseOfDefinite<B>(covariance(e));
  }
  lambda_ = MatrixXd::Zero(n_, n_);
  for (Pair<Pose>& e : pairs_) {
    e.says_something = e.is_used;
    if (e.is_used) AddInformation(e, e.information, lambda_);
  }
  return Invert();
}

// What the other factors say of d_ij as a share of what the target does: L' (C_r^-1 - Omega) L with C_t = L L'.
template <class Pose>
typename Recovery<Pose>::Block Recovery<Pose>::OthersShare(const Pair<Pose>& e, const Jacobian& information) const {
  const Block share = e.root.transpose() * (information - e.information) * e.root;
  return (share + share.transpose()) / 2;
}

// By how much a new factor here lowers the divergence, nats.
template <class Pose>
double Recovery<Pose>::Gain(const Pair<Pose>& e) const {
  const Jacobian now = InverseOfDefinite<B>(CovarianceOf(sigma_, e));
  double gain = 0;
  const Tangent shares = SymmetricEigenvalues<Pose::kDof>(OthersShare(e, now));
  for (const double share : shares) {
    if (share < 1) gain += (share - 1 - std::log(share)) / 2;
  }
  return gain;
}

// The least of the divergence over the information of one factor, which is tr X - log det(S + X) of X >= floor in the
// coordinates where the target's C is one: the others' share S is made up to one, and where it is more X is the floor.
template <class Pose>
void Recovery<Pose>::Improve(Pair<Pose>& e) {
  const MatrixXd W = Rows(sigma_, e);
  const Jacobian C = Columns(W, e), now = InverseOfDefinite<B>(C);
  const auto others = DecomposeSymmetric<Pose::kDof>(OthersShare(e, now));
  const Tangent lacking = Tangent::Ones() - others.values;
  const Tangent own = lacking.cwiseMax(kFloor);
  const Jacobian half = e.root.transpose().template triangularView<Eigen::Upper>().solve(others.vectors);
  const Jacobian information = half * own.asDiagonal() * half.transpose();
  const Jacobian change = information - e.information;
  AddInformation(e, change, lambda_);
  // Sigma - Sigma J' change (1 + C change)^-1 J Sigma.
  const Jacobian weight = change * (Jacobian::Identity() + C * change).inverse();
  sigma_ -= W.transpose() * ((weight + weight.transpose()) / 2) * W;
  e.information = information;
  e.is_used = true;
  e.says_something = lacking.maxCoeff() > kFloor;
}

// One after the other those that gain most, to so many in all.
template <class Pose>
void Recovery<Pose>::AddBestPairs(int most) {
  int used = static_cast<int>(std::count_if(pairs_.begin(), pairs_.end(), [](const auto& e) { return e.is_used; }));
  for (; used < most; ++used) {
    Pair<Pose>* best = nullptr;
    double best_gain = kLeastFallNats;
    for (Pair<Pose>& e : pairs_) {
      const double gain = e.is_used ? 0 : Gain(e);
      if (gain > best_gain) {
        best_gain = gain;
        best = &e;
      }
    }
    if (best == nullptr) return;
    Improve(*best);
  }
}

template <class Pose>
bool Recovery<Pose>::Descend(int most_sweeps) {
  double before = Divergence();
  for (int sweep = 0; sweep < most_sweeps; ++sweep) {
    for (Pair<Pose>& e : pairs_) {
      if (e.is_used) Improve(e);
    }
    if (!Invert()) return false;  // rid of what the updates have gathered
    const double now = Divergence();
    if (!(before - now > std::max(kLeastFall * now, kLeastFallNats))) break;
    before = now;
  }
  return true;
}

template <class Pose>
void Recovery<Pose>::LeaveOutUseless() {
  for (Pair<Pose>& e : pairs_) {
    if (!e.is_used || e.says_something || e.in_tree) continue;
    AddInformation(e, -e.information, lambda_);
    e.is_used = false;
  }
}

// L' Lambda_r L with Sigma_t = L L': the identity if nothing is lost.
template <class Pose>
MatrixXd Recovery<Pose>::InTargetCoordinates() const {
  const MatrixXd M = target_root_.transpose() * lambda_ * target_root_;
  return (M + M.transpose()) / 2;
}

template <class Pose>
double Recovery<Pose>::Divergence() const {
  const MatrixXd M = InTargetCoordinates();
  return (M.trace() - n_ - LogDeterminant(M)) / 2;
}

template <class Pose>
std::optional<Tree<Pose>> Recovery<Pose>::Run(RecoveredFactors recovered, bool conservative) {
  if (size_ < 2) return Tree<Pose>();
  if (!MakeTarget() || !MakePairs() || !StartFromTree()) return std::nullopt;
  if (size_ > 2) {
    const bool more = recovered != RecoveredFactors::kTree;
    if (!Descend(more ? kFirstSweeps : kMostSweeps)) return std::nullopt;
    if (more) {
      const int all = static_cast<int>(pairs_.size());
      AddBestPairs(recovered == RecoveredFactors::kDense ? all : std::min(all, 3 * (size_ - 1)));
      if (!Descend(kMostSweeps)) return std::nullopt;
    }
    LeaveOutUseless();
  }
  return Result(conservative);
}

// Lambda_r mu = eta: the gradient is the target's.
template <class Pose>
std::optional<Tree<Pose>> Recovery<Pose>::Result(bool conservative) {
  Tree<Pose> out;
  if (conservative) {
    out.scale = std::max(1.0, SymmetricEigenvalues<Eigen::Dynamic>(InTargetCoordinates())[n_ - 1]);
    lambda_ /= out.scale;
  }
  if (!Invert()) return std::nullopt;
  // One factor between two neighbours is exact.
  if (size_ > 2) out.loss = std::max(0.0, Divergence());
  const MatrixXd mean = sigma_ * eta_;
  if (!std::isfinite(out.loss) || !mean.allFinite()) return std::nullopt;
  for (const Pair<Pose>& e : pairs_) {
    if (!e.is_used) continue;
    const Tangent mean_e = Rows(mean, e);
    const Jacobian information = e.information / out.scale;
    if (!IsMild<Pose>(mean_e, information)) return std::nullopt;
    RelativePoseFactor<Pose> factor = FactorOf<Pose>(e.E_i_j, mean_e, information);
    factor.to = {factor.from.value + 1};
    if (!FindDefect<Pose>(factor).empty()) return std::nullopt;
    out.factors.push_back({e.i, e.j, factor.T_from_to, factor.information});
  }
  return out;
}

}  // namespace

template <class Pose>
std::optional<Tree<Pose>> RecoverFactors(const Clique<Pose>& clique, RecoveredFactors recovered, bool conservative) {
  return Recovery<Pose>(clique).Run(recovered, conservative);
}

#define TERSE_INSTANTIATE(Pose) \
  template std::optional<Tree<Pose>> RecoverFactors(const Clique<Pose>&, RecoveredFactors, bool);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
