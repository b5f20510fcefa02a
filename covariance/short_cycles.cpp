#include "terse/covariance/short_cycles.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <tuple>

#include "terse/core/chi_square.h"
#include "terse/core/definite.h"

namespace terse::internal {
namespace {

// Of a cycle, in order of arrival, between the loops' ends at one side.
constexpr int kShort = 10;
constexpr std::size_t kLeastCycles = 8;

// The square of the error over the variance, per what half of right ones exceed.
template <int N>
double Square(const Eigen::Matrix<double, N, 1>& error, const Matrix<N, N>& covariance) {
  return MahalanobisSquared<N>(covariance, error) / ChiSquareQuantile(0.5, N);
}

double RootOfMedian(std::vector<double>& squares) {
  const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2);
  std::nth_element(squares.begin(), middle, squares.end());
  return std::sqrt(*middle);
}

}  // namespace

template <class Pose>
std::vector<ForwardEdge<Pose>> ForwardEdges(const std::vector<ProbeTerm<Pose>>& terms) {
  std::vector<ForwardEdge<Pose>> edges;
  for (std::size_t k = 0; k < terms.size(); ++k) {
    edges.push_back(Forward(k, terms[k].first, terms[k].second, terms[k].factor));
  }
  return edges;
}

template <class Pose>
std::vector<ForwardEdge<Pose>> ForwardEdges(const std::vector<ProbeTerm<Pose>>& terms,
                                            const std::vector<char>& is_asked_for) {
  std::vector<ForwardEdge<Pose>> edges;
  for (std::size_t k = 0; k < terms.size(); ++k) {
    if (is_asked_for[k]) edges.push_back(Forward(k, terms[k].first, terms[k].second, terms[k].factor));
  }
  std::sort(edges.begin(), edges.end(), [](const auto& a, const auto& b) {
    return std::tie(a.last, a.first, a.number) < std::tie(b.last, b.first, b.number);
  });
  return edges;
}

template <class Pose>
std::vector<std::optional<CycleError<Pose>>> ShortCycles(const std::vector<ForwardEdge<Pose>>& loops,
                                                         const OdometryChain<Pose>& odometry) {
  std::vector<std::optional<CycleError<Pose>>> cycles(loops.size());
  for (std::size_t k = 0; k < loops.size(); ++k) {
    for (std::size_t j = k; !cycles[k] && j-- > 0 && loops[k].last - loops[j].last <= kShort;) {
      if (std::abs(loops[j].first - loops[k].first) <= kShort) cycles[k] = CycleOf(loops[j], loops[k], odometry);
    }
  }
  return cycles;
}

template <class Pose>
std::optional<KindScale> ScaleOfShortCycles(const std::vector<std::optional<CycleError<Pose>>>& cycles) {
  constexpr int kDim = Pose::kDim, kTurn = Pose::kDof - kDim;
  std::vector<double> translation, rotation;
  for (const auto& cycle : cycles) {
    if (!cycle) continue;
    translation.push_back(
        Square<kDim>(cycle->error.template head<kDim>(), cycle->covariance.template topLeftCorner<kDim, kDim>()));
    rotation.push_back(Square<kTurn>(cycle->error.template tail<kTurn>(),
                                     cycle->covariance.template bottomRightCorner<kTurn, kTurn>()));
  }
  if (translation.size() < kLeastCycles) return std::nullopt;
  return KindScale{RootOfMedian(translation), RootOfMedian(rotation)};
}

#define TERSE_INSTANTIATE(Pose)                                                                                        \
  template std::vector<ForwardEdge<Pose>> ForwardEdges(const std::vector<ProbeTerm<Pose>>&);                           \
  template std::vector<ForwardEdge<Pose>> ForwardEdges(const std::vector<ProbeTerm<Pose>>&, const std::vector<char>&); \
  template std::vector<std::optional<CycleError<Pose>>> ShortCycles(const std::vector<ForwardEdge<Pose>>&,             \
                                                                    const OdometryChain<Pose>&);                       \
  template std::optional<KindScale> ScaleOfShortCycles<Pose>(const std::vector<std::optional<CycleError<Pose>>>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
