#include "terse/compact/link_consistency.h"

#include <algorithm>
#include <bitset>
#include <cstdint>
#include <numeric>
#include <unordered_map>

#include "terse/compact/innovation.h"
#include "terse/core/at.h"
#include "terse/core/chi_square.h"

namespace terse::internal {
namespace {

using std::size_t;

// Of LeastShare: how it goes down, and where it ends. Maps drift by more than noise, so that all links need more room
// than those that are compared.
constexpr double kStep = 4, kReserve = 16, kLeastShare = 1e-5;
constexpr size_t kLeastSet = 4;
// Starts of the greedy search.
constexpr size_t kMostStarts = 64;

// A row of the adjacency matrix.
class Bits {
 public:
  explicit Bits(size_t n) : words_((n + 63) / 64, 0) {}
  void Set(size_t i) { words_[i / 64] |= std::uint64_t{1} << (i % 64); }
  bool Has(size_t i) const { return (words_[i / 64] >> (i % 64) & 1) != 0; }
  void And(const Bits& other) {
    for (size_t w = 0; w < words_.size(); ++w) words_[w] &= other.words_[w];
  }
  int CountCommon(const Bits& other) const {
    int count = 0;
    for (size_t w = 0; w < words_.size(); ++w)
      count += static_cast<int>(std::bitset<64>(words_[w] & other.words_[w]).count());
    return count;
  }

 private:
  std::vector<std::uint64_t> words_;
};

std::vector<int> GrowFrom(int start, const std::vector<Bits>& rows) {
  std::vector<int> clique = {start};
  Bits candidates = rows[At(start)];
  for (;;) {
    int best = -1, most = -1;
    for (size_t i = 0; i < rows.size(); ++i) {
      if (!candidates.Has(i)) continue;
      const int common = rows[i].CountCommon(candidates);
      if (common > most) {
        most = common;
        best = static_cast<int>(i);
      }
    }
    if (best < 0) break;
    clique.push_back(best);
    candidates.And(rows[At(best)]);
  }
  std::sort(clique.begin(), clique.end());
  return clique;
}

// Relative poses within a map, with their covariances: those of the joint marginal of all that are asked for.
template <class Pose>
class RelativePoses {
 public:
  RelativePoses(const std::vector<PoseId>& ids, const MapKnowledge<Pose>& map) {
    std::vector<PoseId> distinct = ids;
    std::sort(distinct.begin(), distinct.end());
    distinct.erase(std::unique(distinct.begin(), distinct.end()), distinct.end());
    for (const PoseId id : distinct) {
      place_.emplace(id.value, static_cast<int>(values_.size()));
      values_.push_back(*map.graph->Poses()[At(map.graph->IndexOf(id))].T_world_body);
    }
    joint_ = map.marginals->Joint(distinct);
  }
  UncertainPose<Pose> Between(PoseId a, PoseId b) const {
    const int i = place_.at(a.value), j = place_.at(b.value);
    UncertainPose<Pose> out;
    if (i == j) return out;
    out.T_a_b = values_[At(i)].Inverse() * values_[At(j)];
    out.covariance = RelativeCovariance<Pose>(out.T_a_b, Block(i, i), Block(i, j), Block(j, j));
    return out;
  }

 private:
  typename Pose::Jacobian Block(int i, int j) const {
    return joint_.template block<Pose::kDof, Pose::kDof>(i * Pose::kDof, j * Pose::kDof);
  }
  std::unordered_map<std::int64_t, int> place_;
  std::vector<Pose> values_;
  MatrixX joint_;
};

using Distances = std::vector<std::vector<double>>;

std::vector<std::vector<char>> AgreeWithin(const Distances& distance, double most) {
  const size_t n = distance.size();
  std::vector<std::vector<char>> agrees(n, std::vector<char>(n, 0));
  for (size_t x = 0; x < n; ++x) {
    for (size_t y = 0; y < n; ++y) agrees[x][y] = x != y && distance[x][y] <= most ? 1 : 0;
  }
  return agrees;
}

// Pairs of right links are normal: within a 16th of the limit as stated no set half as large is left if that is right.
double LeastShare(const Distances& distance, double stated) {
  const std::vector<char> all(distance.size(), 1);
  const auto size_within = [&](double share) { return LargeClique(AgreeWithin(distance, share * stated), all).size(); };
  const size_t least = std::max(kLeastSet, (size_within(1) + 1) / 2);
  double share = 1;
  while (share > kLeastShare && size_within(share / kStep) >= least) share /= kStep;
  return share;
}

}  // namespace

std::vector<int> LargeClique(const std::vector<std::vector<char>>& agrees, const std::vector<char>& allowed) {
  const size_t n = agrees.size();
  std::vector<Bits> rows(n, Bits(n));
  std::vector<int> degree(n, 0), order;
  for (size_t i = 0; i < n; ++i) {
    if (!allowed[i]) continue;
    order.push_back(static_cast<int>(i));
    for (size_t j = 0; j < n; ++j) {
      if (i == j || !allowed[j] || !agrees[i][j]) continue;
      rows[i].Set(j);
      ++degree[i];
    }
  }
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return degree[At(a)] > degree[At(b)]; });
  if (order.size() > kMostStarts) order.resize(kMostStarts);
  std::vector<int> best;
  for (const int start : order) {
    if (static_cast<size_t>(degree[At(start)]) + 1 <= best.size()) break;
    std::vector<int> clique = GrowFrom(start, rows);
    if (clique.size() > best.size()) best = std::move(clique);
  }
  return best;
}

template <class Pose>
AgreeingLinks FindAgreeing(const std::vector<InterMapLink<Pose>>& links, const MapKnowledge<Pose>& a,
                           const MapKnowledge<Pose>& b, double quantile, int most_compared) {
  AgreeingLinks out;
  out.agreeing.assign(links.size(), -1);
  const size_t n = std::min(links.size(), At(most_compared));
  std::vector<int> compared;
  for (size_t k = 0; k < n; ++k) compared.push_back(static_cast<int>(k * links.size() / n));
  std::vector<PoseId> in_a, in_b;
  for (const int l : compared) {
    in_a.push_back(links[At(l)].in_a);
    in_b.push_back(links[At(l)].in_b);
  }
  const RelativePoses<Pose> of_a(in_a, a), of_b(in_b, b);
  Distances distance(n, std::vector<double>(n, 0));
  for (size_t x = 0; x < n; ++x) {
    const InterMapLink<Pose>& first = links[At(compared[x])];
    for (size_t y = 0; y < x; ++y) {
      const InterMapLink<Pose>& second = links[At(compared[y])];
      const UncertainPose<Pose> round =
          Compose(Compose(of_a.Between(first.in_a, second.in_a), second.T_a_b), of_b.Between(second.in_b, first.in_b));
      distance[x][y] = distance[y][x] = InnovationDistance(round, first.T_a_b);
    }
  }
  const double stated = ChiSquareQuantile(quantile, Pose::kDof);
  const double least = LeastShare(distance, stated);
  out.limit_share = std::min(1.0, kReserve * least);
  const std::vector<std::vector<char>> agrees = AgreeWithin(distance, std::min(1.0, kStep * least) * stated);
  std::vector<char> allowed(n, 1);
  const std::vector<int> members = LargeClique(agrees, allowed);
  for (const int m : members) {
    allowed[At(m)] = 0;
    out.members.push_back(compared[At(m)]);
  }
  out.rival = static_cast<int>(LargeClique(agrees, allowed).size());
  for (size_t x = 0; x < n; ++x)
    out.agreeing[At(compared[x])] = static_cast<int>(std::accumulate(agrees[x].begin(), agrees[x].end(), 0));
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                                                          \
  template AgreeingLinks FindAgreeing(const std::vector<InterMapLink<Pose>>&, const MapKnowledge<Pose>&, \
                                      const MapKnowledge<Pose>&, double, int);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
