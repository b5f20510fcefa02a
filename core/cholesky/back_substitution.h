#pragma once
// L' d = y from the roots, as far as it changes: BlockCholesky::Solve.

#include "terse/core/front_tree.h"

namespace terse::internal {

template <int B>
class BackSubstitution {
 public:
  using Clock = std::chrono::steady_clock;
  using SolveReport = typename BlockCholesky<B>::SolveReport;
  std::vector<int> Solve(FrontTree<B>& tree, const BlockSystem<B>& system, double threshold,
                         std::optional<Clock::time_point> deadline, std::vector<double>& solution, SolveReport& report);

 private:
  using Entry = std::pair<double, int>;  // what moved most among the separators, front
  void Visit(Front<B>& front, const BlockSystem<B>& system, double threshold, std::vector<double>& solution,
             std::vector<int>& changed);
  static void Defer(const std::vector<Entry>& stack, FrontTree<B>& tree);

  std::vector<double> moved_;  // by variable: what its change in the Solve at hand is worth
  std::vector<double> x_;      // of the front at hand
};

extern template class BackSubstitution<3>;
extern template class BackSubstitution<6>;

}  // namespace terse::internal
