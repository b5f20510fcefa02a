#pragma once
// How large innovations are, against what the stated covariances lead to expect: the variance factor of a survey
// network, found from loops as they come and in spite of wrong ones.
//
// Much information is stated with too much caution (intel and city10000: variances 50 to 80 times those of the
// residuals). A test against such covariances lets wrong loops pass. The median of the innovations that the stated
// covariances allow is hardly moved by wrong loops among them; that of few is taken at its upper confidence bound, so
// that nothing is concluded from them. The limit of a test shrinks to kReserve times what the median says, where that
// is below the stated one, and never grows. What lies between the two limits counts as well: else a run that begins
// with loops that are too good, as of a robot that stands still, would believe no others.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "terse/core/chi_square.h"

namespace terse::internal {

class InnovationScale {
 public:
  // The limit shrinks to this share of the stated one at most.
  explicit InnovationScale(double least_share = kLeast) : least_share_(least_share) {}
  // Those of `count` loops, squared and whitened, `dof` scalars each; none is above the stated limit.
  void Add(double innovation, int count = 1) {
    counts_[BinOf(innovation)] += count;
    total_ += count;
  }

  // Of innovations, out of the stated one: that of chi-square at some quantile.
  double Limit(double stated, int dof) const {
    // Four standard errors above the middle: loops that come together are not independent.
    const double rank = 0.5 * static_cast<double>(total_) + 2 * std::sqrt(static_cast<double>(total_));
    std::int64_t below = 0;
    if (total_ == 0 || rank > static_cast<double>(total_)) return stated;
    for (std::size_t bin = 0; bin < kBins; ++bin) {
      below += counts_[bin];
      if (static_cast<double>(below) < rank) continue;
      const double factor = UpperEdge(bin) / ChiSquareQuantile(0.5, dof);
      return stated * std::clamp(kReserve * factor, least_share_, 1.0);
    }
    return stated;
  }

  template <class Archive>
  void Serialize(Archive& archive) {
    for (auto& count : counts_) archive(count);
    archive(total_);
  }

 private:
  // A true loop may be worse than the median one by more than chance has it: of 19 public graphs, each without its last
  // hundredth of loops, the innovations of two reach beyond this times what the median leads to expect.
  static constexpr double kReserve = 6;
  // Nobody's covariances are too cautious by more; better agreement is that of copies, or of what was computed.
  static constexpr double kLeast = 1e-3;
  // Four to an octave, from 2^-32 on.
  static constexpr std::size_t kBins = 160;
  static constexpr double kPerOctave = 4, kOctavesBelowOne = 32;
  static std::size_t BinOf(double innovation) {
    if (!(innovation > 0)) return 0;
    const double bin = std::floor(kPerOctave * (std::log2(innovation) + kOctavesBelowOne));
    return static_cast<std::size_t>(std::clamp(bin, 0.0, static_cast<double>(kBins - 1)));
  }
  static double UpperEdge(std::size_t bin) {
    return std::exp2((static_cast<double>(bin) + 1) / kPerOctave - kOctavesBelowOne);
  }

  std::array<std::int64_t, kBins> counts_{};
  std::int64_t total_ = 0;
  double least_share_;
};

}  // namespace terse::internal
