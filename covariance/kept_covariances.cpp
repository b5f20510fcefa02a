#include "kept_covariances.h"

#include <Eigen/Dense>
#include <chrono>
#include <cmath>
#include <stdexcept>

#include "terse/core/decompositions.h"
#include "terse/covariance/covariance_blocks.h"

namespace terse {

const char* Name(CovariancePath path) {
  switch (path) {
    case CovariancePath::kNone: return "none";
    case CovariancePath::kPropagated: return "propagated";
    case CovariancePath::kDowndated: return "downdated";
    case CovariancePath::kRecursion: return "recursion";
  }
  return "";
}

namespace internal {
namespace {

// Measured: so many flops of the recursion's products take as long as a flop of substitution with few right-hand
// sides, and of the products with single variables' blocks.
template <int B>
constexpr double kSubstitutionFlop = B == 3 ? 1.2 : 0.8;
template <int B>
constexpr double kBlockFlop = 2 * kSubstitutionFlop<B>;
// Relative error of a block that is computed, and of C Y, which is a difference of such. Tests compare with what is
// found.
constexpr double kRounding = 1e-14, kCoreRounding = 1e-14;
// Downdates after which a block in turn is compared with the factor.
constexpr long kSampled = 16;
// So many updates go by without a try after downdates that had to be refreshed.
constexpr int kLongestPause = 63;
// Appended variables after which the column is solved for again: each one rounds all of it.
constexpr int kMostAppended = 1000;

template <int B>
using RowBlock = Eigen::Map<Eigen::Matrix<double, B, Eigen::Dynamic, Eigen::RowMajor>, 0, Eigen::OuterStride<>>;

template <int B>
RowBlock<B> RowsOf(std::vector<double>& X, int variable, int columns, int stride) {
  return RowBlock<B>(X.data() + At(variable) * B * At(stride), B, columns, Eigen::OuterStride<>(stride));
}

struct TreeCosts {
  double recursion = 0, entries = 0;
};

template <int B>
TreeCosts CostsOf(const BlockCholesky<B>& cholesky) {
  TreeCosts costs;
  cholesky.Tree().ForEach([&](int, const auto& front) {
    const double p = front.Columns(), rows = front.Rows() - 1;
    costs.recursion += RecursionFlops<B>(front);
    costs.entries += p * (rows - p / 2);
  });
  return costs;
}

template <int B>
bool IsInvertible(const Matrix<B, B>& A) {
  const Eigen::FullPivLU<Matrix<B, B>> lu(A);
  return lu.rcond() > 1e-8;
}

}  // namespace

// What can be had without the recursion: every new variable by the factor that joins it to an older one, all other
// changes as a downdate.
template <int B>
typename KeptCovariances<B>::Plan KeptCovariances<B>::MakePlan(const Changes& changes) const {
  Plan plan;
  const int old = static_cast<int>(diagonals_.size()), all = cholesky_->Variables();
  plan.joining.resize(At(all - old));
  std::vector<char> is_joining(changes.size(), 0);
  std::vector<int> joining(plan.joining.size(), -1);
  for (size_t k = 0; k < changes.size(); ++k) {
    const LinearFactor<B>& f = cholesky_->LinearFactorAt(changes[k].slot);
    const int newest = std::max(f.first, f.second);
    if (f.first < 0 || f.second < 0 || newest < old) continue;
    int& known = joining[At(newest - old)];
    // The one from the variable before, whose column is at hand.
    const bool better = known < 0 || std::min(f.first, f.second) == newest - 1;
    if (better && IsInvertible<B>(newest == f.first ? f.A_first : f.A_second)) known = static_cast<int>(k);
  }
  int newest = old - 1;                                         // whose column is at hand
  plan.solve_column = appended_ > kMostAppended - (all - old);  // appended_ may be the largest number
  for (size_t k = 0; k < joining.size(); ++k) {
    if (joining[k] < 0) return plan;
    is_joining[At(joining[k])] = 1;
    plan.joining[k] = cholesky_->LinearFactorAt(changes[At(joining[k])].slot);
    if (std::min(plan.joining[k].first, plan.joining[k].second) != newest++) plan.solve_column = true;
  }
  for (size_t k = 0; k < changes.size(); ++k) {
    const LinearFactor<B>& after = cholesky_->LinearFactorAt(changes[k].slot);
    if (after.first >= 0 && is_joining[k] == 0) plan.changes.push_back({after, 1});
    if (changes[k].before.first >= 0) plan.changes.push_back({changes[k].before, -1});
  }
  plan.possible = true;
  return plan;
}

// A variable that one factor joins to what is known: no older block changes.
template <int B>
void KeptCovariances<B>::Propagate(const Plan& plan) {
  for (const LinearFactor<B>& f : plan.joining) {
    const int n = static_cast<int>(diagonals_.size()), j = std::min(f.first, f.second);
    const Matrix<B, B>& A_n = f.first == n ? f.A_first : f.A_second;
    const Matrix<B, B>& A_j = f.first == n ? f.A_second : f.A_first;
    const Matrix<B, B> inverse = InverseOf<B>(A_n), F = -inverse * A_j;
    const Matrix<B, B> Sigma = F * diagonals_[At(j)] * F.transpose() + inverse * inverse.transpose();
    drift_.push_back(drift_[At(j)] + static_cast<float>(kRounding / ReciprocalCondition<B>(A_n)));
    appended_ = std::min(appended_, kMostAppended) + 1;
    if (!plan.solve_column) {
      // Sigma_.n = Sigma_.j F'.
      Eigen::Matrix<double, B, kStride, Eigen::RowMajor> transform = Eigen::Matrix<double, B, kStride>::Zero();
      transform.template leftCols<B>() = F.transpose();
      if (column_.size() < At(n + 1) * B * kStride) column_.resize(At(n + 1) * B * kStride * 2, 0.0);
      Kernels().transform_rows(column_.data(), kStride, transform.data(), B * n, B);
      RowsOf<B>(column_, n, B, kStride) = Sigma;
    }
    diagonals_.push_back((Sigma + Sigma.transpose()) / 2);
  }
}

// (S - C Y)^-1. For a single factor on the last variable all of I + C Sigma_old C', its equal, is known: a large
// gain of information costs that no digits.
template <int B>
MatrixX KeptCovariances<B>::CoreOf(const Plan& plan, const MatrixX& CY) const {
  const std::vector<Change>& changes = plan.changes;
  const int last = static_cast<int>(diagonals_.size()) - 1;
  const LinearFactor<B>& f = changes.front().factor;
  const bool known = f.second < 0 || (!plan.solve_column && (f.first == last || f.second == last));
  if (changes.size() == 1 && changes.front().sign > 0 && known) {
    Matrix<B, B> U = Matrix<B, B>::Identity() + f.A_first * diagonals_[At(f.first)] * f.A_first.transpose();
    if (f.second >= 0) {
      const Matrix<B, B> cross = f.second == last ? Column(f.first) : Matrix<B, B>(Column(f.second).transpose());
      const Matrix<B, B> product = f.A_first * cross * f.A_second.transpose();
      U += product + product.transpose() + f.A_second * diagonals_[At(f.second)] * f.A_second.transpose();
    }
    return U;
  }
  MatrixX core = -CY;
  for (size_t a = 0; a < changes.size(); ++a) {
    core.diagonal().segment<B>(static_cast<Eigen::Index>(a) * B).array() += changes[a].sign;
  }
  if (!(ReciprocalCondition<Eigen::Dynamic>(core) > 1e-12)) return MatrixX();
  return InverseOf<Eigen::Dynamic>(core);
}

// False if the numbers do not allow it: then the kept blocks are spoilt.
template <int B>
bool KeptCovariances<B>::Downdate(const Plan& plan, CovarianceReport& report) {
  const int n = cholesky_->Variables(), last = n - 1;
  const int k = B * static_cast<int>(plan.changes.size()), columns = k + (plan.solve_column ? B : 0);
  const int stride = Stride(columns);
  std::vector<RightHandSide<B>> E;
  for (size_t a = 0; a < plan.changes.size(); ++a) {
    const LinearFactor<B>& f = plan.changes[a].factor;
    const int column = B * static_cast<int>(a);
    E.push_back({f.first, column, f.A_first.transpose()});
    if (f.second >= 0) E.push_back({f.second, column, f.A_second.transpose()});
  }
  if (plan.solve_column) E.push_back({last, k, Matrix<B, B>::Identity()});
  SolveAll(cholesky_->Tree(), E, X_, stride);
  const auto Y = [&](int v) { return RowsOf<B>(X_, v, k, stride); };
  if (plan.solve_column) {
    if (column_.size() < At(n) * B * kStride) column_.resize(At(n) * B * kStride * 2, 0.0);
    for (int r = 0; r < B * n; ++r) {
      std::copy_n(X_.data() + At(r) * At(stride) + At(k), B, column_.data() + At(r) * kStride);
      std::fill_n(X_.data() + At(r) * At(stride) + At(k), B, 0.0);
    }
  }
  if (plan.solve_column) appended_ = 0;
  if (k == 0) return true;
  MatrixX CY(k, k);
  for (size_t a = 0; a < plan.changes.size(); ++a) {
    const LinearFactor<B>& f = plan.changes[a].factor;
    auto rows = CY.middleRows<B>(static_cast<Eigen::Index>(a) * B);
    rows.noalias() = f.A_first * Y(f.first);
    if (f.second >= 0) rows.noalias() += f.A_second * Y(f.second);
  }
  const MatrixX core = CoreOf(plan, CY);
  if (core.size() == 0 || !core.allFinite()) return false;
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  RowMajor M = RowMajor::Zero(stride, stride);
  M.topLeftCorner(k, k) = (core + core.transpose()) / 2;
  if (!plan.solve_column) {
    // Sigma_.n -= Y M Y_n'.
    RowMajor T = RowMajor::Zero(k, kStride);
    T.leftCols<B>().noalias() = M.topLeftCorner(k, k) * Y(last).transpose();
    Kernels().subtract_rows(column_.data(), kStride, X_.data(), stride, T.data(), kStride, B * n, k, kStride);
  }
  traces_.resize(At(n));
  for (int v = 0; v < n; ++v) traces_[At(v)] = diagonals_[At(v)].trace();
  Kernels().subtract_congruences(diagonals_.front().data(), X_.data(), stride, M.data(), n, B, k);
  const double core_error = plan.changes.size() == 1 ? kRounding : kCoreRounding * M.cwiseAbs().maxCoeff();
  double drift = 0;
  bool is_positive = true;
  for (int v = 0; v < n; ++v) {
    const double shrunk = traces_[At(v)] / diagonals_[At(v)].trace();
    is_positive &= shrunk > 0 && shrunk < 1e12;
    const double bound = (drift_[At(v)] + kRounding) * shrunk + core_error * std::abs(shrunk - 1);
    drift_[At(v)] = static_cast<float>(bound);
    drift = std::max(drift, bound);
  }
  report.drift = drift;
  ++downdates_;
  return is_positive;
}

// Kept blocks against the factor, relative, infinite if not a number: those of the last variable as far as they are in
// Y; the block of a changed factor's other end; and one that takes its turn.
template <int B>
double KeptCovariances<B>::DriftOf(const Plan& plan) const {
  const int last = cholesky_->Variables() - 1;
  const int stride = Stride(B * static_cast<int>(plan.changes.size()) + (plan.solve_column ? B : 0));
  double drift = 0;
  const auto compare = [&](const MatrixX& kept, const MatrixX& found, double scale) {
    const double difference = (kept - found).norm() / scale;
    drift = std::max(drift, difference >= 0 ? difference : std::numeric_limits<double>::infinity());
  };
  const auto compare_block = [&](int v) {
    const MatrixX fresh = JointCovariance(*cholesky_, {v});
    compare(diagonals_[At(v)], fresh, fresh.norm());
  };
  for (size_t a = 0; a < plan.changes.size(); ++a) {
    const LinearFactor<B>& f = plan.changes[a].factor;
    if (f.first != last && f.second != last) continue;
    const bool is_first = f.first == last;
    const int other = is_first ? f.second : f.first;
    const Matrix<B, B> own = diagonals_[At(last)] * (is_first ? f.A_first : f.A_second).transpose();
    Matrix<B, B> kept = own;
    if (other >= 0) kept += Column(other).transpose() * (is_first ? f.A_second : f.A_first).transpose();
    const Eigen::Map<const Eigen::Matrix<double, B, B, Eigen::RowMajor>, 0, Eigen::OuterStride<>> found(
        X_.data() + At(last) * B * At(stride) + a * B, Eigen::OuterStride<>(stride));
    compare(kept, found, own.norm());
  }
  const LinearFactor<B>& first = plan.changes.front().factor;
  compare_block(first.first != last || first.second < 0 ? first.first : first.second);
  if (downdates_ % kSampled == 0) {
    // Steps of the golden ratio: spread evenly over the variables however their number grows.
    const auto round = downdates_ / kSampled;
    const double turn = 0.6180339887498949 * static_cast<double>(round);
    compare_block(std::min(last, static_cast<int>((turn - std::floor(turn)) * (last + 1))));
  }
  return drift;
}

template <int B>
void KeptCovariances<B>::Recursion(CovarianceReport& report) {
  const int n = cholesky_->Variables();
  const ColumnOfAll column{n - 1, &column_};
  ComputeAllDiagonals(*cholesky_, diagonals_, recursion_, &column);
  drift_.assign(At(n), static_cast<float>(kRounding));
  report.path = CovariancePath::kRecursion;
  report.columns = B;
  report.drift = kRounding;
  appended_ = 0;
}

// By propagation and a downdate. False if the drift, or the numbers, do not allow it.
template <int B>
bool KeptCovariances<B>::Follow(const Plan& plan, CovarianceReport& report) {
  Propagate(plan);
  report.path = plan.changes.empty() ? CovariancePath::kPropagated : CovariancePath::kDowndated;
  for (const LinearFactor<B>& f : plan.joining) {
    report.drift = std::max<double>(report.drift, drift_[At(std::max(f.first, f.second))]);
  }
  const bool possible = report.columns == 0 || Downdate(plan, report);
  if (possible && !plan.changes.empty()) report.measured_drift = DriftOf(plan);
  const bool done = possible && std::max(report.drift, report.measured_drift) <= options_.max_drift;
  report.refreshed = !done;
  // Where the factor itself is not exact enough, downdates are refreshed again and again: better not to try.
  if (!plan.changes.empty()) next_pause_ = done ? next_pause_ / 2 : std::min(2 * next_pause_ + 1, kLongestPause);
  if (!done) pause_ = next_pause_;
  return done;
}

template <int B>
CovarianceReport KeptCovariances<B>::Update() {
  const auto start = std::chrono::steady_clock::now();
  if (cholesky_->Variables() == 0) throw std::invalid_argument("there is no pose yet");
  CovarianceReport report;
  if (IsCurrent()) return report;
  const bool same_factor = identity_ == cholesky_->Identity() && !diagonals_.empty();
  const auto changes = same_factor ? cholesky_->ChangesSince(version_) : std::nullopt;
  identity_ = 0;  // of no factor, until all is done
  using Method = CovarianceOptions::Method;
  Plan plan;
  if (changes && options_.method != Method::kRecursion) plan = MakePlan(*changes);
  if (options_.method == Method::kCheapest && pause_ > 0 && !plan.changes.empty()) {
    --pause_;
    plan.possible = false;
  }
  const bool only_appended = plan.possible && plan.changes.empty() && !plan.solve_column;
  const TreeCosts tree = only_appended ? TreeCosts() : CostsOf(*cholesky_);
  report.recursion_cost = tree.recursion;
  bool done = false;
  if (plan.possible) {
    const double n = cholesky_->Variables(), k = B * static_cast<double>(plan.changes.size());
    report.columns = static_cast<int>(k) + (plan.solve_column ? B : 0);
    const double substitution = 2 * tree.entries * report.columns;
    const double blocks = 2 * n * B * k * (k + 2 * B) + (plan.solve_column ? 0 : 2 * n * B * B * B);
    report.downdate_cost = kSubstitutionFlop<B> * substitution + kBlockFlop<B> * blocks;
    const bool is_cheaper = only_appended || report.downdate_cost < report.recursion_cost;
    if (is_cheaper || options_.method == Method::kDowndate) {
      report.flops = substitution + blocks;
      done = Follow(plan, report);
    }
  }
  if (!done) {
    report.flops += tree.recursion;
    Recursion(report);
  }
  identity_ = cholesky_->Identity();
  version_ = cholesky_->Version();
  report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return report;
}

template <int B>
Matrix<B, B> KeptCovariances<B>::Column(int variable) const {
  using RowMajor = Eigen::Matrix<double, B, B, Eigen::RowMajor>;
  return Eigen::Map<const RowMajor, 0, Eigen::OuterStride<>>(column_.data() + At(variable) * B * kStride,
                                                             Eigen::OuterStride<>(kStride));
}

template <int B>
std::size_t KeptCovariances<B>::Bytes() const {
  std::size_t numbers = column_.capacity() + X_.capacity() + traces_.capacity();
  for (const RecursionLevel& level : recursion_.path) numbers += level.covariance.capacity();
  return diagonals_.capacity() * sizeof(diagonals_[0]) + drift_.capacity() * sizeof(float) + numbers * sizeof(double);
}

template class KeptCovariances<3>;
template class KeptCovariances<6>;

}  // namespace internal
}  // namespace terse
