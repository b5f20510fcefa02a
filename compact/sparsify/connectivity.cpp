#include "terse/compact/connectivity.h"

#include <Eigen/OrderingMethods>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

#include "terse/core/at.h"
#include "terse/core/decompositions.h"
#include "terse/core/disjoint_sets.h"
#include "terse/core/error.h"
#include "terse/core/random.h"

namespace terse::internal {
namespace {

using Eigen::Index, Eigen::MatrixXd, Eigen::VectorXd;
using Sparse = Eigen::SparseMatrix<double>;

// Vectors that get better with every step, that start the subspace at random, the most it grows to and then shrinks to.
constexpr Index kBlock = 2, kRandom = 2, kMostVectors = 30, kKept = 8;
constexpr double kStir = 1e-2;
constexpr int kPowers = 3, kLeastSteps = 2, kMostSteps = 500;
// The relative residual that the second vector needs for the first one to count as the lowest.
constexpr double kSecond = 0.1;
// Multiplications a factor may take: so many, and per node.
constexpr double kMostWork = 1e7, kMostWorkPerNode = 1e3;
// Keeps rounding from making a pivot negative, and is nothing to a preconditioner.
constexpr double kDamping = 1e-14;
// What is left of a unit vector that is in the span of others.
constexpr double kInSpan = 1e-10;

constexpr int kMostIterations = 20;
constexpr double kGap = 1e-4;

// Relative to the value: of the residual, or of the value's change in two steps in a row.
struct Accuracy {
  double residual, change;
};
constexpr Accuracy kExact{1e-8, 1e-11};
// Within the relaxation: the bound holds whatever the vector is.
constexpr Accuracy kRough{3e-3, 1e-5};

void RemoveMean(Eigen::Ref<MatrixXd> X) { X.rowwise() -= X.colwise().mean().eval(); }

MatrixXd RandomVectors(Index rows, Index columns, Random& random) {
  return MatrixXd::NullaryExpr(rows, columns, [&] { return random.Uniform() - 0.5; });
}

// A permutation: the edges of the heaviest spanning forest, of which there are `in_forest`, then the others, the
// heaviest first. Equal ones come in random order, so that the first ones are everywhere.
std::vector<int> HeaviestFirst(int nodes, const std::vector<WeightedEdge>& edges, int& in_forest) {
  std::vector<int> order(edges.size());
  std::iota(order.begin(), order.end(), 0);
  Random random(1);
  for (std::size_t k = order.size(); k > 1; --k) {
    std::swap(order[k - 1], order[static_cast<std::size_t>(random.Uniform() * static_cast<double>(k))]);
  }
  std::stable_sort(order.begin(), order.end(), [&](int e, int f) { return edges[At(e)].weight > edges[At(f)].weight; });
  DisjointSets components(At(nodes));
  std::vector<char> joins(edges.size());
  for (const int e : order) joins[At(e)] = components.Join(At(edges[At(e)].a), At(edges[At(e)].b)) ? 1 : 0;
  const auto end = std::stable_partition(order.begin(), order.end(), [&](int e) { return joins[At(e)] != 0; });
  in_forest = static_cast<int>(end - order.begin());
  return order;
}

// Whether the factor of a matrix, of which this is the upper triangle, takes at most so many multiplications.
bool IsCheap(const Sparse& upper, double most) {
  const int n = static_cast<int>(upper.cols());
  std::vector<int> parent(At(n), -1), seen(At(n), -1), below(At(n), 0);
  double work = 0;
  for (int column = 0; column < n; ++column) {
    seen[At(column)] = column;
    for (Sparse::InnerIterator it(upper, column); it; ++it) {
      // Row `column` of the factor: the paths up the elimination tree.
      for (int i = static_cast<int>(it.row()); seen[At(i)] != column; i = parent[At(i)]) {
        if (parent[At(i)] < 0) parent[At(i)] = column;
        seen[At(i)] = column;
        work += 2 * below[At(i)]++ + 1;
      }
    }
    if (work > most) return false;
  }
  return true;
}

// Nearly the inverse of a connected graph's Laplacian, on vectors of mean zero: exactly that if the factor is cheap.
class NearInverse {
 public:
  // Does not look at more than `most_others` edges besides a tree, and lowers that if they are still too many.
  NearInverse(int nodes, const std::vector<WeightedEdge>& edges, const std::vector<int>& order, int& most_others)
      : nodes_(nodes) {
    const int all = static_cast<int>(edges.size()), tree = nodes - 1;
    for (int others = std::min(all - tree, most_others);; most_others = others /= 2) {
      if (TryFactor(edges, order, tree + others, others == 0)) return;
    }
  }
  MatrixXd Times(MatrixXd X) const {
    RemoveMean(X);
    MatrixXd Y = MatrixXd::Zero(X.rows(), X.cols());
    Y.topRows(nodes_ - 1) = P_.transpose() * cholesky_.solve(P_ * X.topRows(nodes_ - 1)).eval();
    RemoveMean(Y);
    return Y;
  }

 private:
  // The last node is held.
  Sparse Laplacian(const std::vector<WeightedEdge>& edges, const std::vector<int>& order, int count) const {
    VectorXd diagonal = VectorXd::Zero(nodes_);
    std::vector<Eigen::Triplet<double>> entries;
    for (int k = 0; k < count; ++k) {
      const WeightedEdge& edge = edges[At(order[At(k)])];
      diagonal(edge.a) += edge.weight;
      diagonal(edge.b) += edge.weight;
      if (std::max(edge.a, edge.b) == nodes_ - 1) continue;
      entries.emplace_back(std::min(edge.a, edge.b), std::max(edge.a, edge.b), -edge.weight);
    }
    for (int i = 0; i < nodes_ - 1; ++i) entries.emplace_back(i, i, diagonal(i) * (1 + kDamping));
    Sparse upper(nodes_ - 1, nodes_ - 1);
    upper.setFromTriplets(entries.begin(), entries.end());
    return upper;
  }
  bool TryFactor(const std::vector<WeightedEdge>& edges, const std::vector<int>& order, int count, bool at_any_cost) {
    const Sparse upper = Laplacian(edges, order, count);
    Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> inverse;
    Eigen::AMDOrdering<int>()(upper.selfadjointView<Eigen::Upper>(), inverse);
    P_ = inverse.inverse();
    Sparse permuted(upper.rows(), upper.cols());
    permuted.selfadjointView<Eigen::Upper>() = upper.selfadjointView<Eigen::Upper>().twistedBy(P_);
    if (!at_any_cost && !IsCheap(permuted, kMostWork + kMostWorkPerNode * nodes_)) return false;
    cholesky_.compute(permuted);
    if (cholesky_.info() != Eigen::Success)
      throw NumericalError("connectivity: the Laplacian is singular beyond its constant vector");
    return true;
  }

  int nodes_;
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> P_;
  Eigen::SimplicialLDLT<Sparse, Eigen::Upper, Eigen::NaturalOrdering<int>> cholesky_;
};

// Orthonormal vectors V of mean zero. L = B'B with a row of B for every edge: what is small beside the largest
// eigenvalue, as a long chain's Fiedler value is, comes out of B V to full relative accuracy, and not of L V.
class Subspace {
 public:
  Subspace(int nodes, const std::vector<WeightedEdge>& edges)
      : edges_(edges),
        V_(nodes, kMostVectors),
        BV_(static_cast<Index>(edges.size()), kMostVectors),
        gram_(kMostVectors, kMostVectors) {
    for (const WeightedEdge& edge : edges) roots_.push_back(std::sqrt(edge.weight));
  }
  Index Size() const { return size_; }
  // What is in the span already is left out, and what there is no room for. Returns how many came in.
  Index Add(MatrixXd X) {
    const Index before = size_, most = std::min(kMostVectors, V_.rows() - 1);
    RemoveMean(X);
    for (Index k = 0; k < X.cols() && size_ < most; ++k) AddOne(X.col(k));
    return size_ - before;
  }
  // Ritz vectors in ascending order, as combinations of V.
  void Solve() { ritz_ = DecomposeSymmetric<Eigen::Dynamic>(gram_.topLeftCorner(size_, size_)).vectors; }
  // Those first ones become V.
  void Shrink(Index count) {
    const MatrixXd Y = ritz_.leftCols(count);
    V_.leftCols(count) = (V_.leftCols(size_) * Y).eval();
    BV_.leftCols(count) = (BV_.leftCols(size_) * Y).eval();
    size_ = count;
    gram_.topLeftCorner(size_, size_) = BV_.leftCols(size_).transpose() * BV_.leftCols(size_);
    ritz_ = MatrixXd::Identity(size_, size_);
  }
  MatrixXd RitzVectors(Index count) const { return V_.leftCols(size_) * ritz_.leftCols(std::min(count, size_)); }
  // L X - X diag(values) of the first Ritz vectors X.
  MatrixXd Residuals(Index count, VectorXd& values) const {
    const MatrixXd X = RitzVectors(count), BX = BV_.leftCols(size_) * ritz_.leftCols(X.cols());
    values = BX.colwise().squaredNorm();
    MatrixXd R = -X * values.asDiagonal();
    for (Index k = 0; k < R.cols(); ++k) {
      for (std::size_t e = 0; e < edges_.size(); ++e) {
        const double flow = roots_[e] * BX(static_cast<Index>(e), k);
        R(edges_[e].a, k) += flow;
        R(edges_[e].b, k) -= flow;
      }
    }
    return R;
  }

 private:
  void AddOne(VectorXd x) {
    const auto V = V_.leftCols(size_);
    for (int pass = 0; pass < 2; ++pass) {  // the second one for what rounding leaves
      const double norm = x.norm();
      if (!(norm > 0)) return;
      x /= norm;
      x -= V * (V.transpose() * x).eval();
      if (x.norm() < kInSpan) return;
    }
    x.array() -= x.mean();
    V_.col(size_) = x.normalized();
    for (std::size_t e = 0; e < edges_.size(); ++e) {
      BV_(static_cast<Index>(e), size_) = roots_[e] * (V_(edges_[e].a, size_) - V_(edges_[e].b, size_));
    }
    gram_.col(size_).head(size_ + 1) = BV_.leftCols(size_ + 1).transpose() * BV_.col(size_);
    gram_.row(size_).head(size_) = gram_.col(size_).head(size_).transpose();
    ++size_;
  }

  const std::vector<WeightedEdge>& edges_;
  std::vector<double> roots_;  // of the weights
  MatrixXd V_, BV_, gram_;     // gram_ = V' L V
  Index size_ = 0;
  MatrixXd ritz_;
};

// Pairs of graphs on the same nodes, each of which starts from the one before.
class FiedlerSearch {
 public:
  explicit FiedlerSearch(int nodes) : nodes_(nodes), start_(nodes, 0) {}
  void StartFrom(const MatrixXd& X) {
    start_ = X.leftCols(std::min(X.cols(), kKept));
    is_given_ = X.cols() > 0;
  }

  FiedlerPair Find(const std::vector<WeightedEdge>& edges, const Accuracy& accuracy) {
    if (nodes_ == 1) return {0, VectorXd::Zero(1)};
    int in_forest = 0;
    const std::vector<int> order = HeaviestFirst(nodes_, edges, in_forest);
    if (in_forest < nodes_ - 1) return Disconnected(edges);
    const NearInverse near_inverse(nodes_, edges, order, most_others_);
    Subspace subspace(nodes_, edges);
    Random random(1);
    if (is_given_) {
      // Exact eigenvectors would be left as they are, and count as found although the one sought is not among them.
      start_.colwise().normalize();
      start_ += kStir * near_inverse.Times(RandomVectors(nodes_, start_.cols(), random)).colwise().normalized();
      is_given_ = false;
    }
    subspace.Add(start_);
    MatrixXd X = RandomVectors(nodes_, kRandom, random);
    for (int power = 0; power < kPowers; ++power) subspace.Add(X = near_inverse.Times(X));
    const double value = Improve(subspace, near_inverse, accuracy);
    start_ = subspace.RitzVectors(kKept);
    return {value, Oriented(start_.col(0))};
  }

 private:
  static double Improve(Subspace& subspace, const NearInverse& near_inverse, const Accuracy& accuracy) {
    VectorXd values;
    double last = std::numeric_limits<double>::infinity();
    for (int step = 0, calm = 0;; ++step) {
      subspace.Solve();
      const MatrixXd R = subspace.Residuals(kBlock, values);
      calm = last - values(0) <= accuracy.change * values(0) ? calm + 1 : 0;
      last = values(0);
      const bool is_exact = R.col(0).norm() <= accuracy.residual * values(0) || calm >= 2;
      // What is sought may still be among the others, of which the second then is not exact.
      const bool is_lowest = step >= kLeastSteps && R.rightCols<1>().norm() <= kSecond * values.tail<1>()(0);
      if ((is_exact && is_lowest) || step == kMostSteps) return values(0);
      if (subspace.Size() + kBlock > kMostVectors) subspace.Shrink(kKept);
      if (subspace.Add(near_inverse.Times(R)) == 0) {
        subspace.Solve();
        return values(0);
      }
    }
  }
  static VectorXd Oriented(VectorXd v) {
    for (const double x : v) {
      if (x != 0) return (x < 0 ? -v : v).normalized();
    }
    return v;
  }
  FiedlerPair Disconnected(const std::vector<WeightedEdge>& edges) const {
    DisjointSets components(At(nodes_));
    for (const WeightedEdge& edge : edges) components.Join(At(edge.a), At(edge.b));
    VectorXd v(nodes_);
    for (int i = 0; i < nodes_; ++i) v(i) = components.Root(At(i)) == components.Root(0) ? 1 : 0;
    RemoveMean(v);
    return {0, v.normalized()};
  }

  int nodes_;
  int most_others_ = std::numeric_limits<int>::max();
  MatrixXd start_;
  bool is_given_ = false;  // and not of the graph before
};

void CheckEdges(int nodes, const std::vector<WeightedEdge>& edges) {
  if (nodes < 1) throw std::invalid_argument("connectivity: a graph needs a node");
  for (const WeightedEdge& edge : edges) {
    const bool has_nodes = std::min(edge.a, edge.b) >= 0 && std::max(edge.a, edge.b) < nodes && edge.a != edge.b;
    if (has_nodes && edge.weight > 0 && std::isfinite(edge.weight)) continue;
    throw std::invalid_argument("connectivity: an edge from " + std::to_string(edge.a) + " to " +
                                std::to_string(edge.b) + " of weight " + std::to_string(edge.weight) + " among " +
                                std::to_string(nodes) + " nodes");
  }
}

void CheckConnected(int nodes, const std::vector<WeightedEdge>& fixed) {
  DisjointSets components(At(nodes));
  int joined = 1;
  for (const WeightedEdge& edge : fixed) joined += components.Join(At(edge.a), At(edge.b)) ? 1 : 0;
  if (joined < nodes) throw std::invalid_argument("connectivity: the fixed edges do not connect all nodes");
}

// Ones at the k largest, the first of equal ones.
std::vector<char> Largest(const std::vector<double>& values, int k) {
  std::vector<int> order(values.size());
  std::iota(order.begin(), order.end(), 0);
  const auto is_before = [&](int e, int f) {
    return values[At(e)] != values[At(f)] ? values[At(e)] > values[At(f)] : e < f;
  };
  if (At(k) < order.size()) std::nth_element(order.begin(), order.begin() + k, order.end(), is_before);
  std::vector<char> chosen(values.size(), 0);
  for (int i = 0; i < k; ++i) chosen[At(order[At(i)])] = 1;
  return chosen;
}

// The weights laid end to end: those at u, u + 1, u + 2, ... with u in [0, 1). None is longer than 1.
std::vector<char> Systematic(const std::vector<double>& weights, int k, Random& random) {
  const int m = static_cast<int>(weights.size());
  const double u = random.Uniform(), scale = k / std::accumulate(weights.begin(), weights.end(), 0.0);
  std::vector<char> chosen(weights.size(), 0);
  double end = 0;
  for (int e = 0, count = 0; e < m && count < k; ++e) {
    end += weights[At(e)] * scale;
    // Rounding must not leave fewer than are still to be chosen.
    if (end <= u + count && m - e > k - count) continue;
    chosen[At(e)] = 1;
    ++count;
  }
  return chosen;
}

class Relaxation {
 public:
  Relaxation(int nodes, const std::vector<WeightedEdge>& fixed, const std::vector<WeightedEdge>& candidates, int k)
      : fixed_(fixed),
        candidates_(candidates),
        k_(k),
        search_(nodes),
        weights_(candidates.size(), static_cast<double>(k) / static_cast<double>(candidates.size())) {}

  // Fills in the bound and the iterations.
  void Maximise(ConnectivityChoice& out) {
    out.upper_bound = std::numeric_limits<double>::infinity();
    while (out.iterations < kMostIterations) {
      const FiedlerPair pair = search_.Find(Weighted(), kRough);
      const std::vector<double> gradient = Stretch(candidates_, pair.vector), held = Stretch(fixed_, pair.vector);
      const std::vector<char> towards = Largest(gradient, k_);
      double bound = std::accumulate(held.begin(), held.end(), 0.0);
      for (std::size_t e = 0; e < gradient.size(); ++e) bound += towards[e] ? gradient[e] : 0;
      out.upper_bound = std::min(out.upper_bound, bound);
      if (out.upper_bound - pair.value <= kGap * pair.value) return;
      const double step = 2.0 / (out.iterations++ + 2);
      for (std::size_t e = 0; e < weights_.size(); ++e) weights_[e] += step * ((towards[e] ? 1 : 0) - weights_[e]);
    }
  }
  void Round(Rounding rounding, std::uint64_t seed, ConnectivityChoice& out) {
    out.fiedler = -1;
    if (rounding != Rounding::kMadow) Try(Largest(weights_, k_), out);
    Random random(seed);
    if (rounding != Rounding::kNearest) Try(Systematic(weights_, k_, random), out);
  }

 private:
  void Try(std::vector<char> chosen, ConnectivityChoice& out) {
    std::vector<WeightedEdge> edges = fixed_;
    for (std::size_t e = 0; e < chosen.size(); ++e) {
      if (chosen[e]) edges.push_back(candidates_[e]);
    }
    const double value = search_.Find(edges, kExact).value;
    if (value <= out.fiedler) return;
    out.fiedler = value;
    out.chosen = std::move(chosen);
  }
  std::vector<WeightedEdge> Weighted() const {
    std::vector<WeightedEdge> edges = fixed_;
    for (std::size_t e = 0; e < weights_.size(); ++e) {
      const WeightedEdge& edge = candidates_[e];
      if (weights_[e] > 0) edges.push_back({edge.a, edge.b, weights_[e] * edge.weight});
    }
    return edges;
  }
  // By edge, v' L_e v.
  static std::vector<double> Stretch(const std::vector<WeightedEdge>& edges, const VectorXd& v) {
    std::vector<double> stretch;
    stretch.reserve(edges.size());
    for (const WeightedEdge& edge : edges) {
      const double difference = v(edge.a) - v(edge.b);
      stretch.push_back(edge.weight * difference * difference);
    }
    return stretch;
  }

  const std::vector<WeightedEdge>&fixed_, &candidates_;
  const int k_;
  FiedlerSearch search_;
  std::vector<double> weights_;  // w, by candidate
};

}  // namespace

ConnectivityChoice ChooseByConnectivity(int nodes, const std::vector<WeightedEdge>& fixed,
                                        const std::vector<WeightedEdge>& candidates, int k, Rounding rounding,
                                        std::uint64_t seed) {
  CheckEdges(nodes, fixed);
  CheckEdges(nodes, candidates);
  CheckConnected(nodes, fixed);
  const int m = static_cast<int>(candidates.size());
  if (k < 0 || k > m) {
    throw std::invalid_argument("connectivity: " + std::to_string(k) + " of " + std::to_string(m) + " candidates");
  }
  ConnectivityChoice out;
  if (k == 0 || k == m) {
    std::vector<WeightedEdge> edges = fixed;
    if (k == m) edges.insert(edges.end(), candidates.begin(), candidates.end());
    out.chosen.assign(candidates.size(), k == m ? 1 : 0);
    out.fiedler = out.upper_bound = FindFiedlerPair(nodes, edges).value;
    return out;
  }
  Relaxation relaxation(nodes, fixed, candidates, k);
  relaxation.Maximise(out);
  relaxation.Round(rounding, seed, out);
  out.upper_bound = std::max(out.upper_bound, out.fiedler);  // they may be equal but for rounding
  return out;
}

FiedlerPair FindFiedlerPair(int nodes, const std::vector<WeightedEdge>& edges, const MatrixXd* start) {
  CheckEdges(nodes, edges);
  if (start != nullptr && start->rows() != nodes) {
    throw std::invalid_argument("connectivity: a start of " + std::to_string(start->rows()) + " rows for " +
                                std::to_string(nodes) + " nodes");
  }
  FiedlerSearch search(nodes);
  if (start != nullptr) search.StartFrom(*start);
  return search.Find(edges, kExact);
}

}  // namespace terse::internal
