#include "terse/core/observability.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <locale>
#include <numeric>
#include <sstream>

#include "terse/core/at.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/decompositions.h"
#include "terse/core/pose_name.h"

namespace terse {
namespace {

using internal::At;
using std::size_t;

constexpr size_t kMaxHeld = 8;  // poses at which the factorisation may fail before the search stops
// Shares of the scale of a direction's information: below the first it is rounding in a sum of squares, below the
// second a direction that the failed factorisation pointed at is free.
constexpr double kRounding = 1e-14;
constexpr double kFree = 1e-11;
constexpr double kNegligible = 1e-6;  // of the largest entry

double Median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Columns with the same span and as many zeros as elimination with full pivoting gives: where coordinate axes lie in
// the span, they come out, in their order.
MatrixX Sparsified(MatrixX basis) {
  std::vector<std::pair<Eigen::Index, Eigen::Index>> order;  // pivot row, column
  for (Eigen::Index k = 0; k < basis.cols(); ++k) {
    Eigen::Index row = 0, column = 0;
    basis.rightCols(basis.cols() - k).cwiseAbs().maxCoeff(&row, &column);
    basis.col(k).swap(basis.col(k + column));
    basis.col(k) /= double{basis(row, k)};
    for (Eigen::Index j = 0; j < basis.cols(); ++j) {
      if (j != k) basis.col(j) -= basis(row, j) * basis.col(k);
    }
    order.emplace_back(row, k);
  }
  std::sort(order.begin(), order.end());
  MatrixX out(basis.rows(), basis.cols());
  for (size_t k = 0; k < order.size(); ++k) out.col(static_cast<Eigen::Index>(k)) = basis.col(order[k].second);
  return out;
}

// Orthonormal, positive in the largest entry, without the dust of rounding. Not a number if they are dependent.
MatrixX Orthonormal(MatrixX columns) {
  for (Eigen::Index k = 0; k < columns.cols(); ++k) {
    auto v = columns.col(k);
    v.normalize();
    for (Eigen::Index j = 0; j < k; ++j) v -= columns.col(j).dot(v) * columns.col(j);
    const double length = v.norm();
    v /= length > kNegligible ? length : std::numeric_limits<double>::quiet_NaN();
    v = (v.array().abs() < kNegligible * kNegligible).select(0, v);
    Eigen::Index largest = 0;
    v.cwiseAbs().maxCoeff(&largest);
    v *= (v[largest] < 0 ? -1 : 1) / v.norm();
  }
  return columns;
}

// Connected components of a linear system.
template <int B>
std::vector<int> ComponentOf(const std::vector<LinearFactor<B>>& system, int variables) {
  std::vector<int> parent(At(variables));
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int i) {
    while (parent[At(i)] != i) i = parent[At(i)] = parent[At(parent[At(i)])];
    return i;
  };
  for (const auto& f : system) {
    if (f.second < 0) continue;
    const int a = root(f.first), b = root(f.second);
    parent[At(std::max(a, b))] = std::min(a, b);
  }
  for (int i = 0; i < variables; ++i) parent[At(i)] = root(i);
  return parent;
}

template <class Pose>
class Search {
 public:
  static constexpr int B = Pose::kDof, D = Pose::kDim;

  Search(std::vector<LinearFactor<B>> system, const std::vector<Pose>& T_world_body, const std::vector<PoseId>& ids)
      : system_(std::move(system)), values_(T_world_body), ids_(ids) {
    for (auto& f : system_) f.residual.setZero();
    SetScales();
  }

  void Run(SingularityReport& report) {
    RigidMotions();
    LooseDirections();
    InnerMotions();
    std::stable_sort(motions_.begin(), motions_.end(), [](const FreeMotion& a, const FreeMotion& b) {
      return a.freedom != b.freedom ? a.freedom < b.freedom : a.pose < b.pose;
    });
    report.motions = std::move(motions_);
    report.complete = complete_;
  }

 private:
  int Variables() const { return static_cast<int>(values_.size()); }

  // The information that counts as ordinary, per direction of each pose: its own, at least the median of the graph's.
  void SetScales() {
    std::vector<Vector<B>> diagonal(values_.size(), Vector<B>::Zero());
    for (const auto& f : system_) {
      diagonal[At(f.first)] += f.A_first.colwise().squaredNorm().transpose();
      if (f.second >= 0) diagonal[At(f.second)] += f.A_second.colwise().squaredNorm().transpose();
    }
    std::vector<double> along, about;
    for (const auto& d : diagonal) {
      for (int k = 0; k < B; ++k) {
        if (d[k] > 0) (k < D ? along : about).push_back(d[k]);
      }
    }
    // Where only one of the two is measured, a radian counts as much as a metre.
    double per_metre = Median(along), per_radian = Median(about);
    if (!(per_metre > 0)) per_metre = per_radian > 0 ? per_radian : 1;
    per_radian = std::max(per_radian, 1e-12 * per_metre);
    lever_ = std::sqrt(per_radian / per_metre);
    for (const auto& d : diagonal) {
      scale_.push_back(d);
      scale_.back().template head<D>() = d.template head<D>().cwiseMax(per_metre);
      scale_.back().template tail<B - D>() = d.template tail<B - D>().cwiseMax(per_radian);
    }
  }

  // The component's rigid motions Exp(xi) T that its absolute measurements leave free; its poses move by Ad(T^-1) xi.
  void RigidMotions() {
    const std::vector<int> component_of = ComponentOf(system_, Variables());
    std::vector<std::vector<int>> members(values_.size());
    std::vector<std::vector<const LinearFactor<B>*>> absolute(values_.size());
    for (int v = 0; v < Variables(); ++v) members[At(component_of[At(v)])].push_back(v);
    for (const auto& f : system_) {
      if (f.second < 0 && !f.A_first.isZero(0)) absolute[At(component_of[At(f.first)])].push_back(&f);
    }
    for (int c = 0; c < Variables(); ++c) {
      if (members[At(c)].empty()) continue;
      if (absolute[At(c)].empty()) {
        Report(Freedom::kFloating, members[At(c)], SmallestId(members[At(c)]), MatrixX::Identity(B, B));
      } else {
        LooselyHeld(members[At(c)], absolute[At(c)]);
      }
    }
    held_ = variable_of_motion_;
  }

  void LooselyHeld(const std::vector<int>& members, const std::vector<const LinearFactor<B>*>& absolute) {
    Vector<D> centre = Vector<D>::Zero();
    for (const auto* f : absolute) centre += values_[At(f->first)].Translation() / static_cast<double>(absolute.size());
    double extent = 0;
    for (const int v : members) extent = std::max(extent, (values_[At(v)].Translation() - centre).norm());
    if (!(extent > 0)) extent = 1;
    Vector<B> shift = Vector<B>::Zero(), unit = Vector<B>::Ones();
    shift.template head<D>() = -centre;
    unit.template tail<B - D>() /= extent;
    const Pose T_centre_world = Pose().Retract(shift);
    const auto moves = [&](int v) {  // by xi about the centre, rotations in metres at the extent
      return typename Pose::Jacobian((T_centre_world * values_[At(v)]).Inverse().Adjoint() * unit.asDiagonal());
    };
    Eigen::Matrix<double, B, B> information = Eigen::Matrix<double, B, B>::Zero();
    for (const auto* f : absolute) {
      const Eigen::Matrix<double, B, B> J = f->A_first * moves(f->first);
      information += J.transpose() * J;
    }
    const SymmetricEigen<B> eigen = DecomposeSymmetric<B>(information);
    Eigen::Index free = 0;
    while (free < B && eigen.values[free] <= kRounding * eigen.values[B - 1]) ++free;
    if (free == 0) return;
    const MatrixX xi = eigen.vectors.leftCols(free);
    // Best seen from the measured pose that it moves least.
    int best = -1;
    double least = 0;
    for (const auto* f : absolute) {
      const double moved = (moves(f->first) * xi).template topRows<D>().norm();
      const bool tie = best >= 0 && std::abs(moved - least) <= kNegligible;
      if (best >= 0 && (tie ? !(ids_[At(f->first)] < ids_[At(best)]) : moved > least)) continue;
      best = f->first;
      least = moved;
    }
    Report(Freedom::kLooselyHeld, members, best, moves(best) * xi);
  }

  // What a pose can do alone, because none of its own factors measures it.
  void LooseDirections() {
    std::vector<Eigen::Matrix<double, B, B>> H(values_.size(), Eigen::Matrix<double, B, B>::Zero());
    for (const auto& f : system_) {
      H[At(f.first)] += f.A_first.transpose() * f.A_first;
      if (f.second >= 0) H[At(f.second)] += f.A_second.transpose() * f.A_second;
    }
    for (const int v : held_) anchors_.push_back(Anchor<B>(v, scale_[At(v)]));
    for (const auto& f : anchors_) H[At(f.first)] += f.A_first.transpose() * f.A_first;
    for (int v = 0; v < Variables(); ++v) {
      const Vector<B> root = scale_[At(v)].cwiseSqrt();
      const Eigen::Matrix<double, B, B> unit = root.cwiseInverse().asDiagonal();
      const SymmetricEigen<B> eigen = DecomposeSymmetric<B>(unit * H[At(v)] * unit);
      Eigen::Index free = 0;
      while (free < B && eigen.values[free] < kRounding) ++free;
      if (free == 0) continue;
      Report(Freedom::kUnmeasured, {v}, v, unit * eigen.vectors.leftCols(free));
      LinearFactor<B> anchor;
      anchor.first = v;
      anchor.A_first.topRows(free) = eigen.vectors.leftCols(free).transpose() * root.asDiagonal();
      anchors_.push_back(anchor);
    }
  }

  // Holds a pose wherever the factorisation fails, until it does not.
  bool HoldWhatFails() {
    double weak = 0;  // with which every pose is held when the search has been given up
    while (true) {
      typename BlockCholesky<B>::Changes all;
      all.new_variables = Variables();
      all.added = system_;
      all.added.insert(all.added.end(), anchors_.begin(), anchors_.end());
      for (const int v : failing_) all.added.push_back(Anchor<B>(v, scale_[At(v)]));
      for (int v = 0; weak > 0 && v < Variables(); ++v) {
        all.added.push_back(Anchor<B>(v, weak * scale_[At(v)]));
      }
      factor_ = BlockCholesky<B>();
      const auto report = factor_.Update(all);
      if (report.ok) {
        const auto first = report.added_slots.begin() + static_cast<std::ptrdiff_t>(system_.size() + anchors_.size());
        slots_.assign(first, first + static_cast<std::ptrdiff_t>(failing_.size()));
        return true;
      }
      if (weak > kFree) return false;
      const bool again = std::count(failing_.begin(), failing_.end(), report.failed_variable) > 0;
      if (weak > 0 || again || failing_.size() == kMaxHeld) {
        weak = std::max(10 * weak, 10 * kRounding);
        complete_ = false;
      } else {
        failing_.push_back(report.failed_variable);
      }
    }
  }

  // Columns x = H_held^-1 E Lambda^(1/2) for the poses F that failed, E their unit vectors, Lambda what holds them. A
  // combination u of them is a null vector of H if what holds F does all the work: Lambda^(1/2) E' x u = u.
  MatrixX Columns() {
    const Eigen::Index count = B * static_cast<Eigen::Index>(failing_.size());
    MatrixX x(B * static_cast<Eigen::Index>(values_.size()), count);
    for (Eigen::Index k = 0; k < count; ++k) {
      const size_t i = static_cast<size_t>(k / B);
      typename BlockCholesky<B>::Changes push;
      auto anchor = Anchor<B>(failing_[i], scale_[At(failing_[i])]);
      if (k % B == 0 && i > 0) {
        push.replaced.emplace_back(slots_[i - 1], Anchor<B>(failing_[i - 1], scale_[At(failing_[i - 1])]));
      }
      anchor.residual[k % B] = -1;
      push.replaced.emplace_back(slots_[i], anchor);
      if (!factor_.Update(push).ok) return MatrixX(x.rows(), 0);
      factor_.Solve();
      x.col(k) = Eigen::Map<const Eigen::VectorXd>(factor_.Solution().data(), x.rows());
    }
    return x;
  }

  void InnerMotions() {
    if (!HoldWhatFails() || failing_.empty()) return;
    const MatrixX x = Columns();
    if (x.cols() == 0) return;
    Eigen::MatrixXd M(x.cols(), x.cols());
    for (size_t i = 0; i < failing_.size(); ++i) {
      M.middleRows<B>(static_cast<Eigen::Index>(i) * B) =
          scale_[At(failing_[i])].cwiseSqrt().asDiagonal() * x.middleRows(Eigen::Index{B} * failing_[i], B);
    }
    const auto eigen = DecomposeSymmetric<Eigen::Dynamic>((M + M.transpose()) / 2);
    Eigen::Index count = 0;
    while (count < M.cols() && eigen.values[M.cols() - 1 - count] > 1 - 1e-6) ++count;
    const MatrixX u = Sparsified(eigen.vectors.rightCols(count));
    for (Eigen::Index k = 0; k < count; ++k) {
      const Eigen::VectorXd v = x * u.col(k);
      if (InformationAbout(v) < kFree * u.col(k).squaredNorm()) AddInnerMotion(v);
    }
  }

  // |A v|^2.
  double InformationAbout(const Eigen::VectorXd& v) const {
    double sum = 0;
    for (const auto& f : system_) sum += ResidualChange(f, v).squaredNorm();
    return sum;
  }

  void AddInnerMotion(const Eigen::VectorXd& v) {
    std::vector<double> along(values_.size()), about(values_.size());
    double most_along = 0, most_about = 0;
    for (size_t i = 0; i < values_.size(); ++i) {
      const Vector<B> d = v.segment<B>(static_cast<Eigen::Index>(i) * B);
      most_along = std::max(most_along, along[i] = d.template head<D>().norm());
      most_about = std::max(most_about, about[i] = lever_ * d.template tail<B - D>().norm());
    }
    const double most = std::max(most_along, most_about);
    const bool turns = most_about > kNegligible * most;
    std::vector<int> members;
    int best = -1;
    for (int i = 0; i < Variables(); ++i) {
      if (std::max(along[At(i)], about[At(i)]) <= kNegligible * most) continue;
      members.push_back(i);
      // A turn is best seen from its axis.
      const auto& moved = turns ? about : along;
      if (moved[At(i)] < (1 - kNegligible) * (turns ? most_about : most_along)) continue;
      const double nearer = !turns || best < 0 ? 0 : along[At(best)] - along[At(i)];
      const bool tie = std::abs(nearer) <= kNegligible * most;
      if (best < 0 || (tie ? ids_[At(i)] < ids_[At(best)] : nearer > 0)) best = i;
    }
    Report(Freedom::kUnmeasured, members, best, v.segment<B>(Eigen::Index{B} * best));
  }

  int SmallestId(const std::vector<int>& members) const {
    return *std::min_element(members.begin(), members.end(), [&](int a, int b) { return ids_[At(a)] < ids_[At(b)]; });
  }

  // Directions of the same pose that move the same poses are one motion.
  void Report(Freedom freedom, const std::vector<int>& members, int variable, const MatrixX& directions) {
    std::vector<PoseId> ids;
    ids.reserve(members.size());
    for (const int v : members) ids.push_back(ids_[At(v)]);
    std::sort(ids.begin(), ids.end());
    const size_t count = ids.size();
    ids.resize(std::min(count, FreeMotion::kIds));
    for (size_t k = 0; k < motions_.size(); ++k) {
      FreeMotion& known = motions_[k];
      if (known.freedom != freedom || variable_of_motion_[k] != variable || members_[k] != members) continue;
      MatrixX both(B, known.directions.cols() + directions.cols());
      both << known.directions, directions;
      if (Orthonormal(both).hasNaN()) continue;
      known.directions = Orthonormal(Sparsified(both));
      return;
    }
    motions_.push_back({freedom, count, std::move(ids), ids_[At(variable)], Orthonormal(Sparsified(directions))});
    variable_of_motion_.push_back(variable);
    members_.push_back(members);
  }

  std::vector<LinearFactor<B>> system_;  // without right-hand sides
  const std::vector<Pose>& values_;
  const std::vector<PoseId>& ids_;
  std::vector<Vector<B>> scale_;          // by variable
  double lever_ = 1;                      // metres that count as much as a radian
  std::vector<int> held_;                 // one pose of every component that moves as a whole
  std::vector<LinearFactor<B>> anchors_;  // on these, and on the loose directions of single poses
  std::vector<int> failing_;              // poses at which the factorisation failed, and the slots of what holds them
  std::vector<int> slots_;
  BlockCholesky<B> factor_;
  std::vector<FreeMotion> motions_;
  std::vector<int> variable_of_motion_;
  std::vector<std::vector<int>> members_;
  bool complete_ = true;
};

std::string Numbers(const VectorX& v) {
  std::ostringstream out;
  out.imbue(std::locale::classic());
  out.precision(3);
  for (Eigen::Index k = 0; k < v.size(); ++k) out << (k == 0 ? "(" : ", ") << v[k];
  return out.str() + ")";
}

std::string Listed(const FreeMotion& motion) {
  std::string out;
  for (const PoseId id : motion.ids) out += (out.empty() ? "" : ", ") + std::to_string(id.value);
  return (motion.poses == 1 ? "pose " : "poses ") + out + (motion.poses > motion.ids.size() ? ", ..." : "");
}

template <int B>
bool IsFinite(const LinearFactor<B>& f) {
  // What overflows when squared is no better.
  return std::isfinite(f.A_first.squaredNorm() + f.A_second.squaredNorm() + f.residual.squaredNorm());
}

}  // namespace

std::string DescribeDirection(const VectorX& direction) {
  const Eigen::Index dim = direction.size() == 3 ? 2 : 3;
  const VectorX rho = direction.head(dim), phi = direction.tail(direction.size() - dim);
  Eigen::Index axis = 0;
  const bool on_axis = direction.cwiseAbs().maxCoeff(&axis) > 1 - kNegligible;
  const std::string name = on_axis ? std::string(1, "xyz"[axis % dim]) : "";
  const bool slides = rho.norm() > kNegligible, turns = phi.norm() > kNegligible;
  if (!turns) return "translation " + (on_axis ? name : "along " + Numbers(rho));
  const std::string turn = dim == 2 ? "rotation" : "rotation about " + (on_axis ? name : Numbers(phi.normalized()));
  return slides ? "translation " + Numbers(rho) + " with rotation " + Numbers(phi) : turn;
}

std::string Describe(const FreeMotion& motion) {
  std::string directions;
  for (Eigen::Index k = 0; k < motion.directions.cols(); ++k) {
    directions += (k == 0 ? "" : ", ") + DescribeDirection(motion.directions.col(k));
  }
  const std::string pose = Name(motion.pose);
  const std::string count = std::to_string(motion.poses) + (motion.poses == 1 ? " pose" : " poses");
  switch (motion.freedom) {
    case Freedom::kFloating:
      return "no absolute measurement holds the component of " + count + " (" + Listed(motion) + ")";
    case Freedom::kLooselyHeld:
      return "the absolute measurements of the component of " + count + " (" + Listed(motion) + ") leave free at " +
             pose + ": " + directions;
    case Freedom::kUnmeasured: break;
  }
  return "no factor measures of " + pose + ": " + directions +
         (motion.poses > 1 ? " (it takes along " + count + ": " + Listed(motion) + ")" : "");
}

template <class Pose>
SingularityReport ExplainSingularity(std::vector<LinearFactor<Pose::kDof>> system,
                                     const std::vector<Pose>& T_world_body, const std::vector<PoseId>& ids,
                                     int failed_variable) {
  SingularityReport report;
  report.message = "the system is singular";
  const std::string failed = " at pose " + std::to_string(ids.at(At(failed_variable)).value);
  if (!std::all_of(system.begin(), system.end(), IsFinite<Pose::kDof>)) {
    report.message = "the system is not finite" + failed;
    return report;
  }
  Search<Pose>(std::move(system), T_world_body, ids).Run(report);
  if (report.motions.empty()) report.message += failed + ", to rounding";
  constexpr size_t kListed = 6;
  for (size_t k = 0; k < std::min(kListed, report.motions.size()); ++k) {
    report.message += (k == 0 ? ": " : "; ") + Describe(report.motions[k]);
  }
  if (report.motions.size() > kListed) {
    report.message += "; and " + std::to_string(report.motions.size() - kListed) + " more";
  }
  if (!report.complete) report.message += "; there may be more";
  return report;
}

void ThrowSingular(SingularityReport report) {
  if (report.motions.empty()) throw NumericalError(report.message);
  throw UnobservableError(report.message, std::move(report.motions));
}

#define TERSE_INSTANTIATE(Pose)                                                                                        \
  template SingularityReport ExplainSingularity<Pose>(std::vector<LinearFactor<Pose::kDof>>, const std::vector<Pose>&, \
                                                      const std::vector<PoseId>&, int);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
