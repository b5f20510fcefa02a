#include "terse/distributed/chordal_start.h"

#include <memory>
#include <utility>
#include <variant>

#include "batch/chordal_problem.h"
#include "distributed/petsc_system.h"
#include "terse/distributed/distributed_solver.h"

namespace terse {
namespace {

using internal::Block;
using internal::Columns;
using internal::Point;
using std::size_t;

template <class Pose>
class MeasurementsOf {
 public:
  explicit MeasurementsOf(const GraphShare<Pose>& share) : share_(share) {
    for (const auto* terms : {&share.absolute, &share.fixed}) {
      for (const auto& term : *terms) {
        if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&term.factor)) priors_.push_back({*f, term.first});
        if (std::holds_alternative<PositionPriorFactor<Pose>>(term.factor)) has_positions_ = true;
      }
    }
  }

  size_t Poses() const { return share_.ids.size(); }
  const std::vector<internal::PriorAt<Pose>>& Priors() const { return priors_; }
  bool HasPositions() const { return has_positions_; }
  template <class Function>
  void ForEachRelative(const Function& function) const {
    for (const auto& term : share_.relative) {
      function(std::get<RelativePoseFactor<Pose>>(term.factor), term.first, term.second);
    }
  }
  template <class Function>
  void ForEachPosition(const Function& function) const {
    for (const auto& term : share_.absolute) {
      if (const auto* f = std::get_if<PositionPriorFactor<Pose>>(&term.factor)) function(*f, term.first);
    }
  }

 private:
  const GraphShare<Pose>& share_;
  std::vector<internal::PriorAt<Pose>> priors_;
  bool has_positions_ = false;
};

// Into own rows alone, as in the solver.
template <class Pose>
class LeastSquares {
 public:
  static constexpr int D = Pose::kDim;

  LeastSquares(MPI_Comm ranks, const GraphShare<Pose>& share, int columns)
      : ranks_(ranks),
        share_(share),
        columns_(columns),
        system_(std::make_unique<internal::PetscSystem>(ranks, D, share.begin, share.end, NeighboursOf(share))),
        right_(static_cast<size_t>(columns), std::vector<double>(static_cast<size_t>(share.end - share.begin) * D)) {
    system_->SetZero();
  }

  void Pin(int pose, const Columns<D>& X) {
    pinned_ = pose;
    pinned_value_ = X;
  }
  void Add(int i, const Block<D>& A_i, const Columns<D>& R) {
    if (i != pinned_) AddRow(i, A_i, R);
  }
  void Add(int i, const Block<D>& A_i, int j, const Block<D>& A_j, const Columns<D>& R) {
    if (i == pinned_) return Add(j, A_j, R + A_i * pinned_value_);
    if (j == pinned_) return Add(i, A_i, R + A_j * pinned_value_);
    AddRow(i, A_i, R);
    AddRow(j, A_j, R);
    AddSide(i, A_i, j, A_j);
    AddSide(j, A_j, i, A_i);
  }

  std::vector<Columns<D>> Solve() {
    if (pinned_ >= 0) AddRow(pinned_, Block<D>::Identity(), -pinned_value_);
    OnEveryRank(ranks_, [&] {
      if (!is_finite_) throw NumericalError("chordal initial values: the linear system is singular");
    });
    system_->FinishAssembly();
    system_->Factor();
    std::vector<Columns<D>> X(share_.ids.size(), Columns<D>(D, columns_));
    for (int column = 0; column < columns_; ++column) {
      system_->SetRight(right_[static_cast<size_t>(column)]);
      const std::vector<double> x = system_->Solve();
      for (size_t k = 0; k < X.size(); ++k) X[k].col(column) = Eigen::Map<const Point<D>>(x.data() + D * k);
    }
    return X;
  }

 private:
  using RowMajor = Eigen::Matrix<double, D, D, Eigen::RowMajor>;  // as PETSc reads them

  void AddRow(int row, const Block<D>& A, const Columns<D>& R) {
    if (!share_.Owns(row)) return;
    const RowMajor H = A.transpose() * A;
    const Columns<D> b = A.transpose() * R;
    is_finite_ = is_finite_ && H.allFinite() && b.allFinite();
    system_->AddBlock(row, row, H.data());
    for (int column = 0; column < columns_; ++column) {
      double* own = right_[static_cast<size_t>(column)].data() + static_cast<size_t>(row - share_.begin) * D;
      Eigen::Map<Point<D>>(own) -= b.col(column);
    }
  }
  void AddSide(int row, const Block<D>& A_row, int other, const Block<D>& A_other) {
    if (!share_.Owns(row)) return;
    const RowMajor H = A_row.transpose() * A_other;
    system_->AddBlock(row, other, H.data());
  }

  MPI_Comm ranks_;
  const GraphShare<Pose>& share_;
  int columns_;
  std::unique_ptr<internal::PetscSystem> system_;
  std::vector<std::vector<double>> right_;  // by column, own rows
  bool is_finite_ = true;
  int pinned_ = -1;
  Columns<D> pinned_value_;
};

// Its value or that of its first prior.
template <class Pose>
Pose KnownStart(const GraphShare<Pose>& share, int first) {
  if (const auto& value = share.T_world_body[static_cast<size_t>(first)]) return *value;
  for (const auto& term : share.absolute) {
    const auto* prior = std::get_if<PosePriorFactor<Pose>>(&term.factor);
    if (prior != nullptr && term.first == first) return prior->T_world_body;
  }
  return Pose();
}

}  // namespace

template <class Pose>
std::vector<Pose> DistributedChordalValues(MPI_Comm ranks, const GraphShare<Pose>& share) {
  const auto has_lower_id = [&](int a, int b) {
    return share.ids[static_cast<size_t>(a)].value < share.ids[static_cast<size_t>(b)].value;
  };
  int first = 0;
  for (int pose = 1; pose < static_cast<int>(share.ids.size()); ++pose) {
    if (has_lower_id(pose, first)) first = pose;
  }
  std::vector<Pose> values =
      internal::ChordalStart(MeasurementsOf<Pose>(share), first, KnownStart(share, first),
                             [&](int columns) { return LeastSquares<Pose>(ranks, share, columns); });
  // The FIXed pose of lowest id is where it belongs, exactly.
  const auto fixed = std::min_element(share.fixed.begin(), share.fixed.end(),
                                      [&](const auto& a, const auto& b) { return has_lower_id(a.first, b.first); });
  if (fixed != share.fixed.end()) {
    const auto pose = static_cast<size_t>(fixed->first);
    const Pose T_new_old = *share.T_world_body[pose] * values[pose].Inverse();
    for (Pose& value : values) value = T_new_old * value;
    values[pose] = *share.T_world_body[pose];
  }
  for (Pose& value : values) value.Normalize();
  BroadcastPoses(ranks, values);
  return values;
}

template std::vector<SE2> DistributedChordalValues<SE2>(MPI_Comm, const GraphShare<SE2>&);
template std::vector<SE3> DistributedChordalValues<SE3>(MPI_Comm, const GraphShare<SE3>&);

}  // namespace terse
