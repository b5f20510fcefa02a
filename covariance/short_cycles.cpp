#include "terse/covariance/short_cycles.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <tuple>

#include "terse/core/at.h"
#include "terse/core/chi_square.h"

namespace terse::internal {
namespace {

// Of a cycle, in order of arrival, between the loops' ends at one side.
constexpr int kShort = 10;
constexpr std::size_t kLeastCycles = 8;

template <class Pose>
using CovarianceOf = typename Pose::Jacobian;

template <class Pose>
CovarianceOf<Pose> Turned(const Pose& T, const CovarianceOf<Pose>& covariance) {
  const CovarianceOf<Pose> Ad = T.Adjoint();
  return Ad * covariance * Ad.transpose();
}

template <class Pose>
LoopMeasurement<Pose> Forward(std::size_t term, const ProbeTerm<Pose>& t) {
  const Pose& Z = t.factor.T_from_to;
  const CovarianceOf<Pose> covariance = t.factor.information.llt().solve(CovarianceOf<Pose>::Identity());
  if (t.first < t.second) return {term, t.first, t.second, Z, covariance};
  return {term, t.second, t.first, Z.Inverse(), Turned(Z, covariance)};
}

// The square of the error over the variance, per what half of right ones exceed.
template <int N>
double Square(const Eigen::Matrix<double, N, 1>& error, const Matrix<N, N>& covariance) {
  return error.dot(covariance.llt().solve(error)) / ChiSquareQuantile(0.5, N);
}

double RootOfMedian(std::vector<double>& squares) {
  const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2);
  std::nth_element(squares.begin(), middle, squares.end());
  return std::sqrt(*middle);
}

}  // namespace

template <class Pose>
OdometryChain<Pose>::OdometryChain(const std::vector<ProbeTerm<Pose>>& terms, std::size_t poses)
    : T_(poses), covariance_(poses, Covariance::Zero()), stretch_(poses) {
  std::vector<std::optional<LoopMeasurement<Pose>>> steps(poses);  // to each pose from the one before
  for (std::size_t k = 0; k < terms.size(); ++k) {
    auto& step = steps[At(std::max(terms[k].first, terms[k].second))];
    if (std::abs(terms[k].first - terms[k].second) == 1 && !step) step = Forward(k, terms[k]);
  }
  for (std::size_t k = 1; k < poses; ++k) {
    is_whole_ = is_whole_ && steps[k];
    stretch_[k] = stretch_[k - 1] + (steps[k] ? 0 : 1);
    T_[k] = steps[k] ? T_[k - 1] * steps[k]->T_first_last : T_[k - 1];
    covariance_[k] = covariance_[k - 1];
    if (steps[k]) covariance_[k] += Turned(T_[k], steps[k]->covariance);
  }
}

template <class Pose>
bool OdometryChain<Pose>::Joins(int from, int to) const {
  return stretch_[At(from)] == stretch_[At(to)];
}

template <class Pose>
Pose OdometryChain<Pose>::Way(int from, int to) const {
  return T_[At(from)].Inverse() * T_[At(to)];
}

template <class Pose>
typename Pose::Jacobian OdometryChain<Pose>::CovarianceOf(int from, int to) const {
  const auto [earlier, later] = std::minmax(from, to);
  return Turned(T_[At(to)].Inverse(), Covariance(covariance_[At(later)] - covariance_[At(earlier)]));
}

template <class Pose>
std::vector<LoopMeasurement<Pose>> LoopMeasurements(const std::vector<ProbeTerm<Pose>>& terms,
                                                    const std::vector<char>& is_asked_for) {
  std::vector<LoopMeasurement<Pose>> loops;
  for (std::size_t k = 0; k < terms.size(); ++k) {
    if (is_asked_for[k]) loops.push_back(Forward(k, terms[k]));
  }
  std::sort(loops.begin(), loops.end(), [](const auto& a, const auto& b) {
    return std::tie(a.last, a.first, a.term) < std::tie(b.last, b.first, b.term);
  });
  return loops;
}

template <class Pose>
std::vector<std::optional<CycleError<Pose>>> ShortCycles(const std::vector<LoopMeasurement<Pose>>& loops,
                                                         const OdometryChain<Pose>& odometry) {
  std::vector<std::optional<CycleError<Pose>>> cycles(loops.size());
  for (std::size_t k = 0; k < loops.size(); ++k) {
    const LoopMeasurement<Pose>& b = loops[k];
    for (std::size_t j = k; j-- > 0 && b.last - loops[j].last <= kShort;) {
      const LoopMeasurement<Pose>& a = loops[j];
      const bool is_short = std::abs(a.first - b.first) <= kShort;
      if (!is_short || !odometry.Joins(a.first, b.first) || !odometry.Joins(a.last, b.last)) continue;
      // From the second loop's start to the first loop's, along that, and to the second one's end.
      const Pose end = odometry.Way(a.last, b.last), along = a.T_first_last * end;
      const Pose T_first_last = odometry.Way(b.first, a.first) * along;
      cycles[k] =
          CycleError<Pose>{(b.T_first_last.Inverse() * T_first_last).Log(),
                           b.covariance + odometry.CovarianceOf(a.last, b.last) + Turned(end.Inverse(), a.covariance) +
                               Turned(along.Inverse(), odometry.CovarianceOf(b.first, a.first))};
      break;
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

#define TERSE_INSTANTIATE(Pose)                                                                                \
  template class OdometryChain<Pose>;                                                                          \
  template std::vector<LoopMeasurement<Pose>> LoopMeasurements(const std::vector<ProbeTerm<Pose>>&,            \
                                                               const std::vector<char>&);                      \
  template std::vector<std::optional<CycleError<Pose>>> ShortCycles(const std::vector<LoopMeasurement<Pose>>&, \
                                                                    const OdometryChain<Pose>&);               \
  template std::optional<KindScale> ScaleOfShortCycles<Pose>(const std::vector<std::optional<CycleError<Pose>>>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
