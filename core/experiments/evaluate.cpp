#include "terse/core/evaluate.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <stdexcept>
#include <system_error>
#include <thread>

#include "terse/core/decompositions.h"

namespace terse {
namespace {

constexpr double kDegrees = 180 / 3.14159265358979323846;

// Sums of squared errors, metres^2 and radians^2.
struct SquaredErrors {
  double translation = 0, rotation = 0;
  void Add(const SE3& error) {
    const double angle = error.Angle();
    translation += error.Translation().squaredNorm();
    rotation += angle * angle;
  }
  PoseError RootMean(double count) const {
    return {std::sqrt(translation / count), kDegrees * std::sqrt(rotation / count)};
  }
};

SE3 RelativeError(const SE3& T_world_ref_i, const SE3& T_world_ref_j, const SE3& T_world_est_i,
                  const SE3& T_world_est_j) {
  return (T_world_ref_i.Inverse() * T_world_ref_j).Inverse() * (T_world_est_i.Inverse() * T_world_est_j);
}

// The rotation, of those allowed, that maximises trace(R^T C) with C = sum of reference * estimate^T.
Matrix<3, 3> BestRotation(const Matrix<3, 3>& C, Alignment alignment) {
  if (alignment != Alignment::kSE2) return ClosestRotation<3>(C);
  const double theta = std::atan2(C(1, 0) - C(0, 1), C(0, 0) + C(1, 1));
  Matrix<3, 3> R = Matrix<3, 3>::Identity();
  R.topLeftCorner<2, 2>() << std::cos(theta), -std::sin(theta), std::sin(theta), std::cos(theta);
  return R;
}

// RPE over all pairs i < j. With E = (R_i^-1 R_j)^-1 (S_i^-1 S_j), reference R and estimate S, and the rotation
// M_k = rot(R_k) rot(S_k)^-1:
//   |translation of E| = |M_i (s_j - s_i) - (r_j - r_i)|,   angle of E = angle between M_i and M_j.
// The second comes from the chord between the quaternions m_i and m_j, |m_i -+ m_j| = 2 sin(angle / 4), and the
// power series of asin^2: no logarithm, no trigonometry, and loops that the compiler can vectorise.
class AllPairs {
 public:
  AllPairs(const std::vector<SE3>& estimate, const std::vector<SE3>& reference) : size_(estimate.size()) {
    for (auto* rows : {&s_, &r_}) {
      for (auto& row : *rows) row.resize(size_);
    }
    for (auto& row : m_) row.resize(size_);
    for (std::size_t i = 0; i < size_; ++i) {
      const SO3 M = reference[i].Rotation() * estimate[i].Rotation().Inverse();
      for (std::size_t k = 0; k < 3; ++k) {
        s_[k][i] = estimate[i].Translation()[static_cast<int>(k)];
        r_[k][i] = reference[i].Translation()[static_cast<int>(k)];
      }
      for (std::size_t k = 0; k < 4; ++k) m_[k][i] = M.Unit().coeffs()[static_cast<int>(k)];
      M_.push_back(M.Rotation());
    }
    // asin^2(x) = sum_n c_n x^2n, c_1 = 1.
    coefficients_[0] = 1;
    for (std::size_t n = 1; n < kTerms; ++n) {
      const double m = static_cast<double>(n);
      coefficients_[n] = coefficients_[n - 1] * 2 * m * m / ((m + 1) * (2 * m + 1));
    }
  }

  // Pairs of the rows first <= i < last, each with all j > i.
  SquaredErrors Rows(std::size_t first, std::size_t last) const {
    SquaredErrors sum;
    for (std::size_t i = first; i < last; ++i) {
      SquaredErrors row;
      for (std::size_t j = i + 1; j < size_; j += kBlock) {
        const std::size_t count = std::min(kBlock, size_ - j);
        row.translation += Translations(i, j, count);
        row.rotation += Rotations(i, j, count);
      }
      sum.translation += row.translation;
      sum.rotation += row.rotation;
    }
    return sum;
  }

 private:
  static constexpr std::size_t kBlock = 512, kTerms = 50;

  double Translations(std::size_t i, std::size_t j, std::size_t count) const {
    const Matrix<3, 3>& M = M_[i];
    std::array<double, kBlock> squares;
    for (std::size_t b = 0; b < count; ++b) {
      const double sx = s_[0][j + b] - s_[0][i], sy = s_[1][j + b] - s_[1][i], sz = s_[2][j + b] - s_[2][i];
      const double x = M(0, 0) * sx + M(0, 1) * sy + M(0, 2) * sz - (r_[0][j + b] - r_[0][i]);
      const double y = M(1, 0) * sx + M(1, 1) * sy + M(1, 2) * sz - (r_[1][j + b] - r_[1][i]);
      const double z = M(2, 0) * sx + M(2, 1) * sy + M(2, 2) * sz - (r_[2][j + b] - r_[2][i]);
      squares[b] = x * x + y * y + z * z;
    }
    double sum = 0;
    for (std::size_t b = 0; b < count; ++b) sum += squares[b];
    return sum;
  }

  double Rotations(std::size_t i, std::size_t j, std::size_t count) const {
    const auto square = [](double x) { return x * x; };
    const double qx = m_[0][i], qy = m_[1][i], qz = m_[2][i], qw = m_[3][i];
    std::array<double, kBlock> sine2, angle2;  // sin^2(angle / 4) <= 1/2, (angle / 4)^2
    for (std::size_t b = 0; b < count; ++b) {
      const double px = m_[0][j + b], py = m_[1][j + b], pz = m_[2][j + b], pw = m_[3][j + b];
      const double minus = square(px - qx) + square(py - qy) + square(pz - qz) + square(pw - qw);
      const double plus = square(px + qx) + square(py + qy) + square(pz + qz) + square(pw + qw);
      sine2[b] = (minus < plus ? minus : plus) / 4;
    }
    double largest = 0;
    for (std::size_t b = 0; b < count; ++b) largest = std::max(largest, sine2[b]);
    // What is left out is below `largest`^terms, relative; fifty terms do for the half turn.
    std::size_t terms = 1;
    for (double power = largest; terms < kTerms && power > 1e-16; power *= largest) ++terms;
    for (std::size_t b = 0; b < count; ++b) angle2[b] = coefficients_[terms - 1];
    for (std::size_t n = terms - 1; n-- > 0;) {
      for (std::size_t b = 0; b < count; ++b) angle2[b] = angle2[b] * sine2[b] + coefficients_[n];
    }
    double sum = 0;
    for (std::size_t b = 0; b < count; ++b) sum += angle2[b] * sine2[b];
    return 16 * sum;
  }

  std::size_t size_;
  std::array<std::vector<double>, 3> s_, r_;  // positions
  std::array<std::vector<double>, 4> m_;      // quaternions x y z w of M
  std::vector<Matrix<3, 3>> M_;
  std::array<double, kTerms> coefficients_;
};

// The rows are cut into chunks whatever the number of threads, and the chunks' sums are added in order.
PoseError EvaluateAllPairs(const std::vector<SE3>& estimate, const std::vector<SE3>& reference, int threads) {
  constexpr std::size_t kChunk = 32;
  const AllPairs pairs(estimate, reference);
  const std::size_t rows = estimate.size(), chunks = (rows + kChunk - 1) / kChunk;
  std::vector<SquaredErrors> sums(chunks);
  std::atomic<std::size_t> next{0};
  const auto work = [&] {
    for (std::size_t c = next++; c < chunks; c = next++) {
      sums[c] = pairs.Rows(c * kChunk, std::min(rows, (c + 1) * kChunk));
    }
  };
  const std::size_t wanted = threads > 0 ? static_cast<std::size_t>(threads) : std::thread::hardware_concurrency();
  std::vector<std::thread> helpers;
  helpers.reserve(chunks);
  try {
    while (helpers.size() + 1 < std::min(wanted, chunks)) helpers.emplace_back(work);
  } catch (const std::system_error&) {
    // The system gives no more threads: those there are do the work.
  }
  work();
  for (std::thread& helper : helpers) helper.join();
  SquaredErrors total;
  for (const SquaredErrors& sum : sums) {
    total.translation += sum.translation;
    total.rotation += sum.rotation;
  }
  const double n = static_cast<double>(rows);
  return total.RootMean(n * (n - 1) / 2);
}

// As evaluate_odometry of KITTI's development kit.
KittiError EvaluateKitti(const std::vector<SE3>& estimate, const std::vector<SE3>& reference) {
  constexpr std::size_t kStep = 10;
  std::vector<double> distance = {0};
  for (std::size_t i = 1; i < reference.size(); ++i) {
    distance.push_back(distance.back() + (reference[i].Translation() - reference[i - 1].Translation()).norm());
  }
  KittiError out;
  double translation = 0, rotation = 0;
  for (std::size_t first = 0; first < reference.size(); first += kStep) {
    for (int length = 100; length <= 800; length += 100) {
      const auto end = std::upper_bound(distance.begin(), distance.end(), distance[first] + length);
      if (end == distance.end()) break;
      const auto last = static_cast<std::size_t>(end - distance.begin());
      const SE3 error = RelativeError(reference[first], reference[last], estimate[first], estimate[last]);
      translation += error.Translation().norm() / length;
      rotation += error.Angle() / length;
      ++out.segments;
    }
  }
  if (out.segments == 0) return out;
  out.t_rel_percent = 100 * translation / static_cast<double>(out.segments);
  out.r_rel_deg_per_100m = 100 * kDegrees * rotation / static_cast<double>(out.segments);
  return out;
}

// Index pairs {estimate, reference} in ascending order.
using Pairs = std::vector<std::pair<std::size_t, std::size_t>>;

// The index of the stamp nearest to `stamp`, the earlier one of two as near.
std::size_t Nearest(const std::vector<double>& stamps, double stamp) {
  const auto after = std::lower_bound(stamps.begin(), stamps.end(), stamp);
  const auto index = static_cast<std::size_t>(after - stamps.begin());
  if (after == stamps.begin()) return 0;
  if (after == stamps.end()) return index - 1;
  return stamp - stamps[index - 1] <= *after - stamp ? index - 1 : index;
}

// Stamps that are each the other's nearest, so that none is used twice.
Pairs MatchStamps(const std::vector<double>& estimate, const std::vector<double>& reference, double tolerance) {
  Pairs pairs;
  if (reference.empty()) return pairs;
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    const std::size_t j = Nearest(reference, estimate[i]);
    if (std::abs(reference[j] - estimate[i]) <= tolerance && Nearest(estimate, reference[j]) == i) {
      pairs.emplace_back(i, j);
    }
  }
  return pairs;
}

bool AreIds(const std::vector<double>& stamps) {
  return std::all_of(stamps.begin(), stamps.end(), [](double stamp) { return stamp == std::floor(stamp); });
}

void ExpectPairs(const std::vector<SE3>& estimate, const std::vector<SE3>& reference) {
  if (estimate.size() != reference.size()) {
    throw std::invalid_argument("the estimate has " + std::to_string(estimate.size()) + " poses, the reference " +
                                std::to_string(reference.size()));
  }
  if (estimate.size() < 2) throw std::invalid_argument("an evaluation takes two poses at least");
}

std::string Count(const Trajectory& trajectory) { return std::to_string(trajectory.stamps.size()); }

}  // namespace

SE3 Align(const std::vector<SE3>& T_world_estimate, const std::vector<SE3>& T_world_reference, Alignment alignment) {
  if (alignment == Alignment::kNone) return SE3();
  Vector<3> mean_estimate = Vector<3>::Zero(), mean_reference = Vector<3>::Zero();
  for (std::size_t i = 0; i < T_world_estimate.size(); ++i) {
    mean_estimate += T_world_estimate[i].Translation();
    mean_reference += T_world_reference[i].Translation();
  }
  mean_estimate /= static_cast<double>(T_world_estimate.size());
  mean_reference /= static_cast<double>(T_world_estimate.size());
  Matrix<3, 3> C = Matrix<3, 3>::Zero();
  for (std::size_t i = 0; i < T_world_estimate.size(); ++i) {
    C += (T_world_reference[i].Translation() - mean_reference) *
         (T_world_estimate[i].Translation() - mean_estimate).transpose();
  }
  const SO3 rotation = SO3::FromMatrix(BestRotation(C, alignment));
  Vector<3> translation = mean_reference - rotation * mean_estimate;
  if (alignment == Alignment::kSE2) translation.z() = 0;
  return SE3(rotation, translation);
}

Evaluation Evaluate(const std::vector<SE3>& T_world_estimate, const std::vector<SE3>& T_world_reference,
                    const EvaluateOptions& options) {
  const std::size_t n = T_world_estimate.size();
  ExpectPairs(T_world_estimate, T_world_reference);
  Evaluation out;
  out.poses = static_cast<int>(n);
  const SE3 T_reference_estimate = Align(T_world_estimate, T_world_reference, options.alignment);
  SquaredErrors absolute, next;
  for (std::size_t i = 0; i < n; ++i) {
    const SE3 aligned = T_reference_estimate * T_world_estimate[i];
    absolute.translation += (aligned.Translation() - T_world_reference[i].Translation()).squaredNorm();
    const double angle = (T_world_reference[i].Inverse() * aligned).Angle();
    absolute.rotation += angle * angle;
    if (i > 0) {
      next.Add(
          RelativeError(T_world_reference[i - 1], T_world_reference[i], T_world_estimate[i - 1], T_world_estimate[i]));
    }
  }
  out.ate = absolute.RootMean(static_cast<double>(n));
  out.rpe = next.RootMean(static_cast<double>(n - 1));
  if (options.all_pairs) out.rpe_all = EvaluateAllPairs(T_world_estimate, T_world_reference, options.threads);
  if (options.kitti) out.kitti = EvaluateKitti(T_world_estimate, T_world_reference);
  return out;
}

double AbsoluteError(const std::vector<SE3>& T_world_estimate, const std::vector<SE3>& T_world_reference,
                     Alignment alignment) {
  ExpectPairs(T_world_estimate, T_world_reference);
  const SE3 T_reference_estimate = Align(T_world_estimate, T_world_reference, alignment);
  double sum = 0;
  for (std::size_t i = 0; i < T_world_estimate.size(); ++i) {
    const Vector<3> aligned = T_reference_estimate * T_world_estimate[i].Translation();
    sum += (aligned - T_world_reference[i].Translation()).squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(T_world_estimate.size()));
}

MatchedTrajectories Match(const Trajectory& estimate, const Trajectory& reference) {
  const bool tum_estimate = estimate.format == TrajectoryFormat::kTum;
  const bool tum_reference = reference.format == TrajectoryFormat::kTum;
  Pairs pairs;
  if (tum_estimate && tum_reference) {
    pairs = MatchStamps(estimate.stamps, reference.stamps, 0.01);
    if (pairs.size() < 2) throw std::invalid_argument("fewer than two stamps agree within 10 ms");
  } else if (tum_estimate != tum_reference && estimate.stamps.size() == reference.stamps.size()) {
    for (std::size_t i = 0; i < estimate.stamps.size(); ++i) pairs.emplace_back(i, i);
    if (pairs.size() < 2) throw std::invalid_argument("an evaluation takes two poses at least");
  } else {
    // A TUM file written from a graph has its ids for stamps.
    const Trajectory& tum = tum_estimate ? estimate : reference;
    if (tum_estimate != tum_reference && !AreIds(tum.stamps)) {
      throw std::invalid_argument(
          "seconds match line numbers or ids only if there are as many poses; the estimate has " + Count(estimate) +
          ", the reference " + Count(reference));
    }
    pairs = MatchStamps(estimate.stamps, reference.stamps, 0);
    if (pairs.size() < 2) throw std::invalid_argument("fewer than two ids or line numbers are in both");
  }
  MatchedTrajectories out;
  for (const auto& [i, j] : pairs) {
    out.T_world_estimate.push_back(estimate.T_world_body[i]);
    out.T_world_reference.push_back(reference.T_world_body[j]);
  }
  return out;
}

}  // namespace terse
