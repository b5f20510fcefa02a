#pragma once
// An update that replaces many linear factors, made ready piece by piece beside the tree, which stays in use and may
// change meanwhile: fronts are factored ahead with the new linear factors, those below first. What the tree has changed
// since is factored again.

#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include "cholesky/front_factorization.h"
#include "terse/core/front_paths.h"

namespace terse::internal {

template <int B>
class Preparation {
 public:
  using Clock = std::chrono::steady_clock;
  using Replaced = std::vector<std::pair<int, LinearFactor<B>>>;  // by slot

  // All but how fast this machine is.
  void Forget() {
    const double seconds_per_flop = seconds_per_flop_;
    *this = Preparation();
    seconds_per_flop_ = seconds_per_flop;
  }
  // These slots are to hold these linear factors, on the same variables, besides those of before. `version`: of the
  // Cholesky factor, as below.
  void Replace(const Replaced& replaced, const BlockSystem<B>& system, std::uint64_t version);
  // All those that nothing changed since, by slot.
  Replaced Take(const BlockSystem<B>& system, std::uint64_t version);

  // Factors fronts as long as their predicted time ends before the deadline, one at least of those that did not change
  // since EndStep: the others may well change again before all is ready.
  PreparationProgress Advance(Clock::time_point deadline, const BlockSystem<B>& system, std::uint64_t version,
                              FrontTree<B>& tree, FrontFactorization<B>& numbers);

  void EndStep(const BlockSystem<B>& system, std::uint64_t version) {
    ForgetChanged(system, version);
    step_ended_ = version;
  }
  // As state_file.h says, after EndStep. What is ready is worked out anew from a file, which has to fit the system and
  // the tree.
  template <class Archive>
  void Serialize(Archive& archive, const BlockSystem<B>& system, std::uint64_t version, FrontTree<B>& tree,
                 FrontFactorization<B>& numbers);

  // Whether a front of the tree is ready; its numbers.
  bool IsReady(int front, const FrontTree<B>& tree) const;
  Front<B>& ReadyFront(int front) { return fronts_[At(place_[At(front)])]; }

 private:
  bool Has(int slot) const { return At(slot) < entry_of_.size() && entry_of_[At(slot)] >= 0; }
  std::string FindStateDefect(const std::vector<int>& slots, const std::vector<char>& is_ready,
                              const BlockSystem<B>& system, const FrontTree<B>& tree) const;
  void MakePlaces(const FrontPaths<B>& affected);
  void ForgetChanged(const BlockSystem<B>& system, std::uint64_t version);
  void Invalidate(const LinearFactor<B>& factor);
  int Factor(int front, const FrontPaths<B>& affected, const BlockSystem<B>& system, FrontTree<B>& tree,
             FrontFactorization<B>& numbers);

  Replaced entries_;                   // a slot that is not in entry_of_ was changed since
  std::vector<int> entry_of_;          // by slot: in entries_, or -1
  std::uint64_t seen_ = 0;             // the version up to which changes of slots are known
  std::uint64_t step_ended_ = 0;       // that of EndStep
  std::vector<int> variables_;         // of the entries
  std::vector<char> is_listed_;        // by variable
  std::vector<int> changed_;           // variables whose fronts are not ready any more
  std::vector<Front<B>> fronts_;       // factored ahead
  std::vector<std::uint64_t> stamps_;  // of the tree's fronts then
  std::vector<int> place_;             // by front of the tree: in fronts_, or -1
  double seconds_per_flop_ = 1e-9;     // measured
};

extern template class Preparation<3>;
extern template class Preparation<6>;

}  // namespace terse::internal
