#pragma once
// All diagonal blocks of H^-1 and the block column of the last variable, kept up to date as the factor changes
// (Ila et al. 2017 section 3.4).
//
// Appended variable n behind j, A_j d_j + A_n d_n = 0 on average with unit covariance: Sigma_.n = -Sigma_.j (A_n^-1
// A_j)', no older block changes. Changed factors: with the rows C of what came (S = 1) and went (S = -1) and
// Y = Sigma_new C' from the new factor,
//   Sigma_new = Sigma_old - Y (S - C Y)^-1 Y',
// which is Ila et al. 2017 Eq. 14 written with the new covariance. Else the recursion.
//
// The choice is made by flops times what a flop was measured to take, so that a run is repeatable.

#include <cstdint>
#include <vector>

#include "front_covariance.h"
#include "terse/core/block_cholesky.h"
#include "terse/covariance/covariance_options.h"

namespace terse::internal {

template <int B>
class KeptCovariances {
 public:
  KeptCovariances(const BlockCholesky<B>& cholesky, const CovarianceOptions& options)
      : cholesky_(&cholesky), options_(options) {}

  CovarianceReport Update();
  bool IsCurrent() const { return version_ == cholesky_->Version() && identity_ == cholesky_->Identity(); }

  const std::vector<Matrix<B, B>>& Diagonals() const { return diagonals_; }
  // Sigma(variable, last).
  Matrix<B, B> Column(int variable) const;
  std::size_t Bytes() const;

  // All that later results depend on. Where the factor was read before, the blocks are current as they were.
  template <class Archive>
  void Serialize(Archive& archive) {
    bool current = IsCurrent();
    archive(diagonals_, column_, drift_, downdates_, pause_, next_pause_, appended_, current);
    if constexpr (Archive::kReads) {
      const std::size_t variables = static_cast<std::size_t>(cholesky_->Variables());
      // The column has room to grow.
      if (drift_.size() != diagonals_.size() || column_.size() < diagonals_.size() * B * kStride ||
          (current && diagonals_.size() != variables)) {
        archive.Fail("kept covariances of another map");
      }
      version_ = current ? cholesky_->Version() : 0;
      identity_ = current ? cholesky_->Identity() : 0;
    }
  }

 private:
  static constexpr int kStride = Stride(B);  // of column_
  using Changes = std::vector<typename BlockCholesky<B>::SlotChange>;
  // Rows that came or went: the difference between the old and the new H is C' S C.
  struct Change {
    LinearFactor<B> factor;
    double sign;
  };
  struct Plan {
    bool possible = false;
    std::vector<LinearFactor<B>> joining;  // one per new variable
    std::vector<Change> changes;           // all others
    bool solve_column = false;
  };
  Plan MakePlan(const Changes& changes) const;
  void Propagate(const Plan& plan);
  bool Downdate(const Plan& plan, CovarianceReport& report);
  bool Follow(const Plan& plan, CovarianceReport& report);
  void Recursion(CovarianceReport& report);
  MatrixX CoreOf(const Plan& plan, const MatrixX& CY) const;
  double DriftOf(const Plan& plan) const;

  const BlockCholesky<B>* cholesky_;
  CovarianceOptions options_;
  std::uint64_t version_ = 0, identity_ = 0;
  std::vector<Matrix<B, B>> diagonals_;
  std::vector<double> column_;  // row-major, B rows of kStride per variable
  std::vector<float> drift_;    // by variable: estimate of the relative error
  long downdates_ = 0;
  int pause_ = 0, next_pause_ = 0;  // updates to take the recursion without trying a downdate
  int appended_ = 0;                // since the column was last solved for
  // Scratch that stays allocated.
  std::vector<double> X_;
  std::vector<double> traces_;
  RecursionScratch recursion_;
};

}  // namespace terse::internal
