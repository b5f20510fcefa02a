#pragma once
// What batch optimisation minimises, and how it moves: shared by the solver and the comparison of starts. Private to
// the library.

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "terse/core/batch_solver.h"
#include "terse/core/disjoint_sets.h"
#include "terse/core/gauge.h"
#include "terse/core/parallel.h"
#include "terse/core/residual.h"

namespace terse::internal {

// The factor may hold so many times the factors that have weight.
inline constexpr double kMostSpare = 1.01;
inline constexpr std::size_t kChunk = 256;  // factors or poses that a thread takes at a time

// The graph's factors by pose index, the fixed poses' priors behind them, and the anchor.
template <class Pose>
class Problem {
 public:
  static constexpr int B = Pose::kDof;

  Problem(const PoseGraph<Pose>& graph, int threads, const BatchOptions* robust = nullptr)
      : graph_(graph), threads_(threads) {
    if (threads < 1) throw std::invalid_argument("at least one thread is needed");
    if (graph.Poses().empty()) throw std::invalid_argument("the graph has no poses");
    terms_.reserve(graph.Factors().size());
    for (const auto& node : graph.Factors()) Add(&node.factor);
    counted_ = terms_.size();
    fixed_.reserve(graph.Poses().size());
    for (const auto& node : graph.Poses()) {
      if (node.fixed && node.T_world_body) fixed_.emplace_back(FixedPosePrior<Pose>(node.id, *node.T_world_body));
    }
    for (const auto& prior : fixed_) Add(&prior);
    if (robust != nullptr && robust->robust.kernel != RobustKernel::kNone) MakeRobust(*robust);
  }
  Problem(const Problem&) = delete;
  Problem& operator=(const Problem&) = delete;

  typename BlockCholesky<B>::Changes Everything(const std::vector<Pose>& values) {
    double cost = 0, chi2 = 0;
    return Everything(values, cost, chi2);
  }
  // The same, and what Cost says, as LinearizeTerms.
  typename BlockCholesky<B>::Changes Everything(const std::vector<Pose>& values, double& cost, double& chi2) {
    Populate();
    if (!has_gauge_) SetGauge(FindGauge(graph_, values));
    typename BlockCholesky<B>::Changes all;
    all.new_variables = static_cast<int>(graph_.Poses().size());
    cost = LinearizeTerms(values, all.added, chi2);
    return all;
  }

  // What the anchor holds depends on where the poses are; it stays until it is set anew.
  const Gauge<Pose>& CurrentGauge() const { return gauge_; }
  void SetGauge(const Gauge<Pose>& gauge) {
    gauge_ = gauge;
    has_gauge_ = true;
  }

  // In the order of Everything() on an empty factor: slots 0, 1, ..., the anchor last.
  std::vector<LinearFactor<B>> LinearizeTerms(const std::vector<Pose>& values) const {
    std::vector<LinearFactor<B>> out;
    double chi2 = 0;
    LinearizeTerms(values, out, chi2);
    return out;
  }
  // The same, and what Cost says, but for rounding: costs that are compared have to come from the same of the two.
  double LinearizeTerms(const std::vector<Pose>& values, std::vector<LinearFactor<B>>& out, double& chi2) const {
    struct Sums {
      double chi2 = 0, cost = 0;
    };
    std::vector<Sums> sums((present_.size() + kChunk - 1) / kChunk);
    out.resize(present_.size() + 1);
    out.back() = Anchor(gauge_);
    SpreadChunks(threads_, present_.size(), kChunk, [&](std::size_t begin, std::size_t end) {
      Sums& sum = sums[begin / kChunk];
      for (std::size_t k = begin; k < end; ++k) {
        const std::size_t term = present_[k];
        out[k] = LinearizeTerm(term, values);
        const double s = out[k].residual.squaredNorm();
        if (term < counted_) sum.chi2 += s;
        sum.cost += TermCost(term, s);
        Weigh(term, s, out[k]);
      }
    });
    double cost = chi2 = 0;
    for (const Sums& sum : sums) chi2 += sum.chi2, cost += sum.cost;
    // Those without weight are in no factor.
    for (std::size_t term = 0, k = 0; term < counted_ && present_.size() < terms_.size(); ++term) {
      if (k < present_.size() && present_[k] == term) {
        ++k;
      } else {
        chi2 += TermChi2(term, values);
      }
    }
    return cost;
  }

  // chi2 of the measurements, and what the fixed poses' priors add; robust factors with their kernel.
  double Cost(const std::vector<Pose>& values, double& chi2) const {
    const auto plain = [](std::size_t, double s) { return s; };
    chi2 = SumOfCosts(values, 0, counted_, plain);
    const double fixed = SumOfCosts(values, counted_, terms_.size(), plain);
    if (!IsRobust()) return chi2 + fixed;
    return SumOfCosts(values, 0, counted_, [&](std::size_t k, double s) { return TermCost(k, s); }) + fixed;
  }

  bool IsRobust() const { return !is_robust_.empty(); }
  // Without fixed poses.
  double RobustCost(const std::vector<Pose>& values) const {
    return SumOfCosts(values, 0, counted_, [&](std::size_t k, double s) {
      return is_robust_[k] ? terse::RobustCost(kernel_, s, width_) : s;
    });
  }
  double LargestRobustChi2(const std::vector<Pose>& values) const {
    double largest = 0;
    for (std::size_t k = 0; k < counted_; ++k) {
      if (is_robust_[k]) largest = std::max(largest, TermChi2(k, values));
    }
    return largest;
  }
  std::vector<double> WeightsAt(const std::vector<Pose>& values) const {
    std::vector<double> weights(counted_, 1.0);
    for (std::size_t k = 0; k < counted_; ++k) {
      if (is_robust_[k]) weights[k] = TermWeight(k, TermChi2(k, values));
    }
    return weights;
  }
  // kGnc: of its surrogate from now on, held until the next call. Returns how many changed by more than rounding.
  int HoldWeights(const std::vector<Pose>& values, double mu) {
    const std::vector<double> before = held_;
    std::vector<std::pair<double, std::size_t>> without_weight;
    for (std::size_t k = 0; k < counted_; ++k) {
      if (!is_robust_[k]) continue;
      const double chi2 = TermChi2(k, values);
      held_[k] = GncWeight(chi2, width_, mu);
      if (held_[k] == 0) without_weight.emplace_back(chi2, k);
    }
    if (may_part_) HoldTogether(std::move(without_weight));
    int changed = 0;
    for (std::size_t k = 0; k < counted_; ++k) changed += std::abs(before[k] - held_[k]) > 1e-9 ? 1 : 0;
    return changed;
  }
  bool HoldsOnlyZerosAndOnes() const {
    return std::all_of(held_.begin(), held_.end(), [](double w) { return w == 0 || w == 1; });
  }
  double Width() const { return width_; }
  // Whether what Everything gave lacks a weighted factor, or has too many without weight, which cost fill-in.
  bool IsOutdated() const {
    std::size_t weighted = 0, missing = 0;
    auto next = present_.begin();
    for (std::size_t k = 0; k < terms_.size(); ++k) {
      const bool present = next != present_.end() && *next == k, has_weight = HasWeight(k);
      if (present) ++next;
      weighted += has_weight;
      missing += has_weight && !present;
    }
    return missing > 0 || static_cast<double>(present_.size()) > kMostSpare * static_cast<double>(weighted);
  }

 private:
  struct Term {
    const Factor<Pose>* factor;
    int first, second;
    Matrix<B, B> W;
  };
  void Add(const Factor<Pose>* factor) {
    const FactorPoses ends = PosesOf(*factor);
    terms_.push_back({factor, graph_.IndexOf(ends.first), graph_.IndexOf(ends.second), SquareRootInformation(*factor)});
  }
  void MakeRobust(const BatchOptions& options) {
    const std::string defect = FindDefect(options.robust);
    if (!defect.empty()) throw std::invalid_argument("robust options: " + defect);
    kernel_ = options.robust.kernel;
    width_ = WidthOf(options.robust, B);
    std::vector<FactorId> loops = options.robust_factors ? *options.robust_factors : LoopFactors(graph_);
    std::sort(loops.begin(), loops.end());
    is_robust_.assign(counted_, 0);
    std::size_t k = 0;
    for (const auto& node : graph_.Factors()) {
      const bool listed = std::binary_search(loops.begin(), loops.end(), node.id);
      is_robust_[k++] = listed && std::holds_alternative<RelativePoseFactor<Pose>>(node.factor);
    }
    if (kernel_ != RobustKernel::kGnc) return;
    held_.assign(counted_, 1.0);
    DisjointSets by_others = HeldTogether([this](std::size_t k) { return is_robust_[k] == 0; });
    for (std::size_t k = 0; k < counted_; ++k) may_part_ = may_part_ || (is_robust_[k] && JoinEnds(k, by_others));
  }
  bool JoinEnds(std::size_t k, DisjointSets& sets) const {
    return sets.Join(static_cast<std::size_t>(terms_[k].first), static_cast<std::size_t>(terms_[k].second));
  }
  // Poses by the relative factors that count, and the world, which is the last number, by absolute ones.
  template <class Counts>
  DisjointSets HeldTogether(const Counts& counts) const {
    const std::size_t n = graph_.Poses().size();
    DisjointSets sets(n + 1);
    for (std::size_t k = 0; k < terms_.size(); ++k) {
      if (std::holds_alternative<PosePriorFactor<Pose>>(*terms_[k].factor)) {
        sets.Join(static_cast<std::size_t>(terms_[k].first), n);
      } else if (std::holds_alternative<RelativePoseFactor<Pose>>(*terms_[k].factor) && counts(k)) {
        JoinEnds(k, sets);
      }
    }
    std::vector<int> fixes(n + 1);
    for (const Term& t : terms_) {
      if (!std::holds_alternative<PositionPriorFactor<Pose>>(*t.factor)) continue;
      const std::size_t root = sets.Root(static_cast<std::size_t>(t.first));
      if (++fixes[root] == Pose::kDim) sets.Join(root, n);
    }
    return sets;
  }
  // Of the factors without weight, with their chi2, those that contradict least count where else poses would be free.
  void HoldTogether(std::vector<std::pair<double, std::size_t>> without_weight) {
    DisjointSets sets = HeldTogether([this](std::size_t k) { return HasWeight(k); });
    std::sort(without_weight.begin(), without_weight.end());
    for (const auto& [chi2, k] : without_weight) {
      if (JoinEnds(k, sets)) held_[k] = 1;
    }
  }
  bool HasWeight(std::size_t k) const { return held_.empty() || k >= counted_ || held_[k] > 0; }
  void Populate() {
    present_.clear();
    for (std::size_t k = 0; k < terms_.size(); ++k) {
      if (HasWeight(k)) present_.push_back(k);
    }
  }
  double TermChi2(std::size_t k, const std::vector<Pose>& values) const {
    const Term& t = terms_[k];
    return FactorChi2(*t.factor, values[static_cast<std::size_t>(t.first)], values[static_cast<std::size_t>(t.second)]);
  }
  double TermWeight(std::size_t k, double s) const {
    if (!IsRobust() || k >= counted_ || !is_robust_[k]) return 1;
    return held_.empty() ? RobustWeight(kernel_, s, width_) : held_[k];
  }
  double TermCost(std::size_t k, double s) const {
    if (!IsRobust() || k >= counted_ || !is_robust_[k]) return s;
    return held_.empty() ? terse::RobustCost(kernel_, s, width_) : held_[k] * s;
  }
  // Of terms [first, last): chunk by chunk, so that the number of threads does not change the sum.
  template <class CostOf>
  double SumOfCosts(const std::vector<Pose>& values, std::size_t first, std::size_t last, const CostOf& cost_of) const {
    std::vector<double> sums((last - first + kChunk - 1) / kChunk, 0.0);
    SpreadChunks(threads_, last - first, kChunk, [&](std::size_t begin, std::size_t end) {
      double sum = 0;
      for (std::size_t k = first + begin; k < first + end; ++k) {
        sum += cost_of(k, TermChi2(k, values));
      }
      sums[begin / kChunk] = sum;
    });
    return std::accumulate(sums.begin(), sums.end(), 0.0);
  }
  // Without a kernel's weight.
  LinearFactor<B> LinearizeTerm(std::size_t k, const std::vector<Pose>& values) const {
    const Term& t = terms_[k];
    return Linearize(*t.factor, t.W, t.first, t.second, values[static_cast<std::size_t>(t.first)],
                     values[static_cast<std::size_t>(t.second)]);
  }
  void Weigh(std::size_t k, double s, LinearFactor<B>& f) const {
    if (!IsRobust()) return;
    const double root = std::sqrt(TermWeight(k, s));
    f.A_first *= root;
    f.A_second *= root;
    f.residual *= root;
  }

  const PoseGraph<Pose>& graph_;
  int threads_;
  std::vector<Term> terms_;
  std::vector<std::size_t> present_;  // terms in the factor, ascending
  std::size_t counted_ = 0;           // terms that make up chi2
  std::vector<Factor<Pose>> fixed_;
  Gauge<Pose> gauge_;
  bool has_gauge_ = false;
  // Of a robust run; else empty.
  RobustKernel kernel_ = RobustKernel::kNone;
  double width_ = 0;
  std::vector<char> is_robust_;  // by term
  std::vector<double> held_;     // kGnc: weights, by term
  bool may_part_ = false;        // kGnc: the factors that are not robust do not hold every pose
};

// Levenberg-Marquardt damping after Nielsen: zero while full steps work.
class Damping {
 public:
  double Lambda() const { return lambda_; }
  void Accept(double gain_ratio) {
    lambda_ *= std::max(1.0 / 3, 1 - std::pow(2 * gain_ratio - 1, 3));
    if (lambda_ < 1e-9) lambda_ = 0;
    growth_ = 2;
  }
  void Reject() {
    lambda_ = std::max(lambda_ * growth_, 1e-6);
    growth_ *= 2;
  }

 private:
  double lambda_ = 0, growth_ = 2;
};

template <class Pose>
std::vector<Pose> Step(const std::vector<Pose>& values, const std::vector<double>& d, int threads) {
  std::vector<Pose> out(values.size());
  SpreadChunks(threads, values.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      out[v] = values[v].Retract(Eigen::Map<const Vector<Pose::kDof>>(d.data() + v * Pose::kDof));
    }
  });
  return out;
}

}  // namespace terse::internal
