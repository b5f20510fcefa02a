#pragma once
// Which of a few loops are in, by truncated least squares on the linearised system.

#include <Eigen/Core>
#include <cstddef>
#include <vector>

namespace terse::internal {

// Loops given everything else and those of them that are in: whitened residuals n and their covariance P, B rows each.
// A flip, a loop coming in or going out, is a step of the information filter on both.
template <int B>
class Contest {
 public:
  using Block = Eigen::Matrix<double, B, B>;
  Contest(Eigen::VectorXd residual, Eigen::MatrixXd covariance, std::vector<char> in, double width);

  // Of some of them, as they are now; its cost starts at zero.
  Contest Among(const std::vector<std::size_t>& some) const;

  std::size_t Size() const { return in_.size(); }
  const std::vector<char>& In() const { return in_; }
  // What the flips so far add to the minimum of truncated least squares.
  double Cost() const { return cost_; }

  // One of them costs so much when it is out, instead of the width squared.
  void SetPrice(std::size_t i, double price) { k_[i] = price; }

  // What a loop would cost with all else as it is: out, n' (I + P)^-1 n of coming in, its innovation; in, the same of
  // staying, n' (I - P)^-1 n. Infinite where it cannot go, because nothing else holds what it holds.
  double Innovation(std::size_t i) const;
  // By what a loop's innovation exceeds its squared residual, at most.
  double Leverage(std::size_t i) const;

  // False, and nothing changes, if it cannot be flipped.
  bool Flip(std::size_t i);
  // By what the cost falls if all of these that are in go at once.
  double WorthOfLeaving(const std::vector<std::size_t>& group) const;

  // Single flips of those from `first` to before `last` while they lower the cost, the best first.
  void Descend(std::size_t first, std::size_t last);
  void Descend() { Descend(0, Size()); }
  // Groups that go while that lowers the cost, the best first.
  void DescendByGroups(const std::vector<std::vector<std::size_t>>& groups);
  // Graduated non-convexity from the residuals that the loops have when none is in. False, and some may have gone, if
  // one of them cannot go.
  bool Graduate(double gnc_step);

 private:
  double Least() const { return 1e-9 * width_ * width_; }  // that is worth a flip
  static Eigen::Index Row(std::size_t i) { return static_cast<Eigen::Index>(i) * B; }
  Block Spread(std::size_t i) const;

  Eigen::VectorXd n_;
  Eigen::MatrixXd P_;
  std::vector<char> in_;
  std::vector<double> k_;
  double width_, cost_ = 0;
};

extern template class Contest<3>;
extern template class Contest<6>;

}  // namespace terse::internal
