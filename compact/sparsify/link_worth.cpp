#include "terse/compact/link_worth.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>

#include "terse/core/error.h"
#include "terse/core/front_paths.h"
#include "terse/core/parallel.h"
#include "terse/covariance/covariance_blocks.h"
#include "terse/covariance/selected_inverse.h"

namespace terse::internal {
namespace {

// A chain of poses is eliminated from its ends, which makes the way to the root as long as the chain. Links of no
// weight, one for so many poses, make it short.
constexpr int kPosesPerFadedLink = 20;

}  // namespace

template <class Pose>
LinkWorth<Pose>::LinkWorth(const LinkSystem<Pose>& system, SparsifyCriterion criterion, const std::vector<char>& kept,
                           bool parallel)
    : system_(system),
      criterion_(criterion),
      parallel_(parallel),
      kept_(kept),
      kept_count_(static_cast<int>(std::count(kept.begin(), kept.end(), 1))),
      slots_(system.links.size(), -1),
      states_(system.links.size()) {
  Refresh();
}

template <class Pose>
double LinkWorth<Pose>::Worth(int link) const {
  const Block& C = states_[At(link)].C;
  const bool is_kept = kept_[At(link)];
  const Eigen::LLT<Block> S(is_kept ? Block(Block::Identity() - C) : Block(Block::Identity() + C));
  if (S.info() != Eigen::Success) return is_kept ? std::numeric_limits<double>::infinity() : 0;
  if (criterion_ == SparsifyCriterion::kPosition) return S.matrixL().solve(MovedOf(link)).squaredNorm();
  return (is_kept ? -1 : 1) * S.matrixLLT().diagonal().array().log().sum();
}

template <class Pose>
auto LinkWorth<Pose>::Covariance(int link) const -> Block {
  const auto& f = system_.links[At(link)];
  return CombinationCovariance<B>(cholesky_, {{f.first, f.A_first}, {f.second, f.A_second}});
}

template <class Pose>
void LinkWorth<Pose>::EvaluateOne(int link) {
  State& state = states_[At(link)];
  const Block C = Covariance(link);
  if (criterion_ == SparsifyCriterion::kPosition && state.change >= 0) {
    const Eigen::LLT<Block> before(state.C);
    if (before.info() == Eigen::Success) MovedOf(link) = (before.solve(C).transpose() * MovedOf(link)).eval();
  }
  state.C = C;
  state.change = changes_;
}

template <class Pose>
void LinkWorth<Pose>::Evaluate(const std::vector<int>& links) {
  ForEachChunk(parallel_, links.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      if (!IsFresh(links[k])) EvaluateOne(links[k]);
    }
  });
}

template <class Pose>
void LinkWorth<Pose>::Propagate(int link, const std::vector<int>& others) {
  constexpr int stride = Stride(B);
  using Rows = Eigen::Map<const Eigen::Matrix<double, B, B, Eigen::RowMajor>, 0, Eigen::OuterStride<>>;
  const auto& c = system_.links[At(link)];
  std::vector<double> u(At(system_.poses) * B * At(stride), 0.0);
  SolveAll<B>(cholesky_.Tree(), {{c.first, 0, c.A_first.transpose()}, {c.second, 0, c.A_second.transpose()}}, u,
              stride);
  const auto times_u = [&](const LinearFactor<B>& f) {
    const auto rows = [&](int v) { return Rows(u.data() + At(v) * B * At(stride), Eigen::OuterStride<>(stride)); };
    return Block(f.A_first * rows(f.first) + f.A_second * rows(f.second));
  };
  const Eigen::LLT<Block> S(Block::Identity() + times_u(c));
  const bool is_position = criterion_ == SparsifyCriterion::kPosition;
  Moved moved = Moved::Zero();
  if (is_position) moved = S.matrixL().solve(MovedOf(link));
  ForEachChunk(parallel_, others.size(), 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const int other = others[k];
      // p L^-T, with S = L L'.
      const Block p = S.matrixL().solve(times_u(system_.links[At(other)]).transpose()).transpose();
      states_[At(other)].C -= p * p.transpose();
      if (is_position) MovedOf(other) -= p * moved;
    }
  });
}

template <class Pose>
void LinkWorth<Pose>::Keep(int link, const std::vector<int>& others) {
  if (!others.empty()) Propagate(link, others);  // with the factor as it was
  typename BlockCholesky<B>::Changes changes;
  const bool has_slot = slots_[At(link)] >= 0;
  if (has_slot) {
    changes.replaced = {{slots_[At(link)], system_.links[At(link)]}};
  } else {
    changes.added = {system_.links[At(link)]};
  }
  const auto report = cholesky_.Update(changes);
  if (!report.ok) throw NumericalError("the information of the kept links is not positive definite");
  if (!has_slot) slots_[At(link)] = report.added_slots.front();
  kept_[At(link)] = 1;
  ++kept_count_;
  ++changes_;
  for (const int other : others) states_[At(other)].change = changes_;
}

// With I + C = L L' and K = L^-T (I + L)^-1 the samples X (I - x' K x), x = A_c X, are those of what is left of Sigma
// (Andrews, 1968).
template <class Pose>
void LinkWorth<Pose>::KeepBySamples(int link, const std::vector<int>& near) {
  const Samples x = SampledOf(link);
  const Block C = states_[At(link)].C;
  const Eigen::LLT<Block> S(Block::Identity() + C);
  const Block I_and_L = Block(S.matrixL()) + Block::Identity();
  const Samples Kx = S.matrixU().solve(I_and_L.template triangularView<Eigen::Lower>().solve(x));
  const bool is_position = criterion_ == SparsifyCriterion::kPosition;
  Moved moved = Moved::Zero();
  if (is_position) moved = S.solve(MovedOf(link));
  for (const int other : near) {
    State& state = states_[At(other)];
    auto y = SampledOf(other);
    Block p = y * x.transpose();
    const double signal = 1 - C.trace() * state.C.trace() / kColumns / p.squaredNorm();
    if (!(signal > 0)) continue;
    p *= signal;
    y -= p * Kx;
    const Block q = S.matrixL().solve(p.transpose());
    state.C -= q.transpose() * q;
    if (is_position) MovedOf(other) -= p * moved;
  }
  kept_[At(link)] = 1;
  ++kept_count_;
}

template <class Pose>
bool LinkWorth<Pose>::Drop(int link) {
  typename BlockCholesky<B>::Changes changes;
  changes.removed = {slots_[At(link)]};
  if (!cholesky_.Update(changes).ok) return false;
  slots_[At(link)] = -1;
  kept_[At(link)] = 0;
  --kept_count_;
  ++changes_;
  return true;
}

template <class Pose>
auto LinkWorth<Pose>::Faded(int link) const -> LinearFactor<B> {
  LinearFactor<B> faded;
  faded.first = system_.links[At(link)].first;
  faded.second = system_.links[At(link)].second;
  return faded;
}

template <class Pose>
void LinkWorth<Pose>::Refresh() {
  typename BlockCholesky<B>::Changes changes;
  changes.new_variables = system_.poses;
  changes.added = system_.fixed;
  const int links = static_cast<int>(system_.links.size());
  const int faded = std::max(0, system_.poses / kPosesPerFadedLink - kept_count_);
  const int every = faded > 0 ? std::max(1, (links - kept_count_) / faded) : 0;
  std::vector<int> entered;
  for (int link = 0, others = 0; link < links; ++link) {
    slots_[At(link)] = -1;
    states_[At(link)].change = -1;
    const bool is_faded = !kept_[At(link)] && every > 0 && others++ % every == 0;
    if (!kept_[At(link)] && !is_faded) continue;
    changes.added.push_back(is_faded ? Faded(link) : system_.links[At(link)]);
    entered.push_back(link);
  }
  cholesky_ = BlockCholesky<B>();
  const auto report = cholesky_.Update(changes);
  if (!report.ok) throw NumericalError("the edges that are kept in any case do not hold every pose");
  for (std::size_t k = 0; k < entered.size(); ++k)
    slots_[At(entered[k])] = report.added_slots[system_.fixed.size() + k];
  ++round_;
  changes_ = 0;
}

template <class Pose>
void LinkWorth<Pose>::Restart(const std::vector<char>& kept) {
  kept_ = kept;
  kept_count_ = static_cast<int>(std::count(kept.begin(), kept.end(), 1));
  Refresh();
}

// Samples are kColumns wide, side by side with as many more.
template <class Pose>
auto LinkWorth<Pose>::RowsOf(std::vector<double>& X, int pose, int column) -> SampleMap {
  constexpr int stride = Stride(2 * kColumns);
  return SampleMap(X.data() + At(pose) * B * At(stride) + At(column), Eigen::OuterStride<>(stride));
}

// Of the positions' rows; all others become zero.
template <class Pose>
void LinkWorth<Pose>::TakeMotionsOut(std::vector<double>& X, int column) const {
  Samples moved = Samples::Zero();
  for (int v = 0; v < system_.poses; ++v)
    moved += system_.motions[At(v)].transpose() * RowsOf(X, v, column).template topRows<D>();
  for (int v = 0; v < system_.poses; ++v) {
    RowsOf(X, v, column).template topRows<D>() -= system_.motions[At(v)] * moved;
    RowsOf(X, v, column).template bottomRows<B - D>().setZero();
  }
}

// Random signs, as many as there are entries: bits of numbers in [0, 1).
template <class Signs>
void DrawSigns(Random& random, Signs&& signs) {
  for (Eigen::Index row = 0; row < signs.rows(); ++row) {
    auto bits = static_cast<std::uint64_t>(random.Uniform() * 0x1p52);
    for (Eigen::Index column = 0; column < signs.cols(); ++column, bits >>= 1)
      signs(row, column) = bits & 1 ? 1.0 : -1.0;
  }
}

// Of N(0, Sigma), by a random residual of every factor, and Sigma K^1/2 z with random signs z.
template <class Pose>
std::vector<double> LinkWorth<Pose>::DrawSamples(Random& random) const {
  constexpr int stride = Stride(2 * kColumns);
  std::vector<double> X(At(system_.poses) * B * At(stride), 0.0);
  Samples residual;
  for (int slot = 0; slot < cholesky_.Slots(); ++slot) {
    const LinearFactor<B>& f = cholesky_.LinearFactorAt(slot);
    if (f.first < 0) continue;
    DrawSigns(random, residual);
    RowsOf(X, f.first, 0) += f.A_first.transpose() * residual;
    if (f.second >= 0) RowsOf(X, f.second, 0) += f.A_second.transpose() * residual;
  }
  for (int v = 0; v < system_.poses; ++v) DrawSigns(random, RowsOf(X, v, kColumns));
  TakeMotionsOut(X, kColumns);
  SolveDense<B>(cholesky_.Tree(), X, stride);
  return X;
}

// Out of what DrawSamples left: Y.
template <class Pose>
void LinkWorth<Pose>::FindDirections(Random& random, std::vector<double>& X) const {
  TakeMotionsOut(X, kColumns);
  Eigen::MatrixXd W(system_.poses * D, kColumns), Z(system_.poses * D, kColumns);
  for (int v = 0; v < system_.poses; ++v) W.middleRows<D>(v * D) = RowsOf(X, v, kColumns).template topRows<D>();
  const Eigen::MatrixXd Q =
      Eigen::HouseholderQR<Eigen::MatrixXd>(W).householderQ() * Eigen::MatrixXd::Identity(W.rows(), kColumns);
  DrawSigns(random, Z);
  Z -= Q * (Q.transpose() * Z);
  Z /= std::sqrt(static_cast<double>(kColumns));
  for (int v = 0; v < system_.poses; ++v) {
    RowsOf(X, v, 0).template topRows<D>() = Q.middleRows<D>(v * D);
    RowsOf(X, v, kColumns).template topRows<D>() = Z.middleRows<D>(v * D);
  }
  TakeMotionsOut(X, 0);
  TakeMotionsOut(X, kColumns);
  SolveDense<B>(cholesky_.Tree(), X, Stride(2 * kColumns));
}

template <class Pose>
void LinkWorth<Pose>::Sample() {
  Random random(static_cast<std::uint64_t>(round_));
  std::vector<double> X = DrawSamples(random);
  const auto for_each_link = [&](const auto& set) {
    ForEachChunk(parallel_, states_.size(), 256, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        const LinearFactor<B>& f = system_.links[k];
        set(k, [&](int column) {
          return Samples(f.A_first * RowsOf(X, f.first, column) + f.A_second * RowsOf(X, f.second, column));
        });
      }
    });
  };
  sampled_.resize(states_.size() * Samples::SizeAtCompileTime);
  for_each_link([&](std::size_t k, const auto& times) {
    auto x = SampledOf(static_cast<int>(k));
    x = times(0) / std::sqrt(static_cast<double>(kColumns));
    states_[k].C = x * x.transpose();
  });
  if (criterion_ != SparsifyCriterion::kPosition) return;
  FindDirections(random, X);
  moved_.resize(states_.size() * Moved::SizeAtCompileTime);
  for_each_link([&](std::size_t k, const auto& times) {
    MovedOf(static_cast<int>(k)).template leftCols<kColumns>() = times(0);
    MovedOf(static_cast<int>(k)).template rightCols<kColumns>() = times(kColumns);
  });
}

template <class Pose>
double LinkWorth<Pose>::PositionTotal() const {
  double total = 0;
  for (const Block& Sigma : SelectedInverse<B>(cholesky_).AllDiagonals())
    total += Sigma.template topLeftCorner<D, D>().trace();
  constexpr int stride = Stride(B);
  using Rows = Eigen::Map<Eigen::Matrix<double, B, B, Eigen::RowMajor>, 0, Eigen::OuterStride<>>;
  std::vector<double> X(At(system_.poses) * B * At(stride), 0.0);
  const auto rows = [&](int v) { return Rows(X.data() + At(v) * B * At(stride), Eigen::OuterStride<>(stride)); };
  for (int v = 0; v < system_.poses; ++v) rows(v).template topRows<D>() = system_.motions[At(v)];
  SolveDense<B>(cholesky_.Tree(), X, stride);
  for (int v = 0; v < system_.poses; ++v)
    total -= rows(v).template topRows<D>().cwiseProduct(system_.motions[At(v)]).sum();
  return std::max(0.0, total);
}

template class LinkWorth<SE2>;
template class LinkWorth<SE3>;

}  // namespace terse::internal
