#include "terse/compact/link_choice.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <queue>

#include "terse/compact/connectivity.h"
#include "terse/compact/near_links.h"
#include "terse/core/at.h"
#include "terse/core/error.h"
#include "terse/core/random.h"

namespace terse::internal {
namespace {

// So many are chosen with the worth of all that promise something kept up to date; later ones change little beyond
// their surroundings, and the samples of a round say by how much.
constexpr int kExactUpTo = 256;
// Links are chosen in rounds: so many for each that was chosen before, four at least. The first ones out of so many
// times as many that promise most when the round begins.
constexpr double kExactGrowth = 0.5, kLaterGrowth = 0.25;
constexpr int kLeastStep = 4;
constexpr int kPool = 6, kLeastPool = 1024;
// The surroundings of a link: so many times as many poses as there are for each link chosen before.
constexpr double kReach = 16;
constexpr int kLeastReach = 8;
// Looked at together, so that threads have something to share; a constant, so that they do not change the result.
constexpr int kBatch = 4;
// The total is worked out after so many times as many links, for the course.
constexpr double kNotes = 1.2;
// Times that a share of the links, those worth least, are chosen anew.
constexpr int kSweeps = 2;
constexpr double kSweepShare = 0.05;
// Exchanges tried: a share of the links, so many at least and at most, and at most so many times poses; and in a row
// without success.
constexpr double kExchangeShare = 0.2;
constexpr int kLeastTries = 64, kMostTries = 256, kMostTriesTimesPoses = 2'560'000;
constexpr int kMostFailures = 16;
// Where tries times poses are no more, each is judged by the total, and one is made for so much of a link's worth.
constexpr int kMostTotals = 200'000;
constexpr double kLeastPromise = 0.7;
constexpr double kLeastStepOfTotal = 1e-9;

template <class Pose>
class Greedy {
 public:
  Greedy(const LinkSystem<Pose>& system, const ChoiceOptions& options)
      : system_(system),
        options_(options),
        links_(static_cast<int>(system.links.size())),
        worth_(system, options.criterion, system.in_tree, options.parallel) {
    out_.worth.assign(system.links.size(), 0.0);
    at_start_ = worth_.KeptCount();
    most_ = options.most_total ? links_ : std::min(links_, at_start_ + options.links);
  }

  LinkChoice Run() {
    Choose();
    if (options_.most_total) {
      Trim();
    } else if (worth_.KeptCount() < links_) {
      if (Chosen() > kExactUpTo) Sweep();
      Exchange();
    }
    if (out_.course.back().links >= Chosen()) out_.course.pop_back();
    Note();
    RecordWorth();
    out_.kept = worth_.Kept();
    return std::move(out_);
  }

 private:
  struct Entry {
    double worth;
    int link;
    bool operator<(const Entry& other) const { return worth != other.worth ? worth < other.worth : link > other.link; }
  };
  using Queue = std::priority_queue<Entry>;

  int Chosen() const { return worth_.KeptCount() - at_start_; }
  void Note() {
    out_.course.push_back({Chosen(), worth_.Total()});
    next_note_ = kNotes * Chosen();
  }
  bool IsEnough() const {
    return worth_.KeptCount() >= most_ || (options_.most_total && out_.course.back().total <= *options_.most_total);
  }
  void Tell() {
    if (!options_.progress) return;
    const double share = static_cast<double>(Chosen()) / std::max(1, most_ - at_start_);
    if (!options_.progress(std::min(1.0, share))) throw ChoiceStopped();
  }
  std::vector<int> Others() const {
    std::vector<int> others;
    for (int link = 0; link < links_; ++link) {
      if (!worth_.Kept()[At(link)]) others.push_back(link);
    }
    return others;
  }
  std::vector<Entry> EntriesOf(const std::vector<int>& links) const {
    std::vector<Entry> entries;
    entries.reserve(links.size());
    for (const int link : links) entries.push_back({worth_.Worth(link), link});
    return entries;
  }
  // The one that is taken next, as its worth is now.
  void Record(int link) {
    out_.worth[At(link)] = worth_.Worth(link);
    order_.push_back(link);
    Tell();
  }

  void Choose();
  void ChooseExactly(int step);
  void ChooseBySamples(int step);
  std::vector<int> Promising(int links);
  int PopBest(Queue& queue);
  void Trim();
  void Sweep();
  void Exchange();
  std::vector<int> WorthLeast(int links);
  bool IsBetter(double total, double before) const {
    const double step = options_.criterion == SparsifyCriterion::kPosition ? before - total : total - before;
    return step > kLeastStepOfTotal * std::abs(before);
  }
  bool ExchangeOne(int link, Queue& queue, std::optional<double>& total);
  void RecordWorth();

  const LinkSystem<Pose>& system_;
  const ChoiceOptions& options_;
  const int links_;
  LinkWorth<Pose> worth_;
  LinkChoice out_;
  int at_start_ = 0, most_ = 0;
  double next_note_ = 0;
  std::vector<int> order_;  // in which they were taken
};

template <class Pose>
void Greedy<Pose>::Choose() {
  for (;;) {
    worth_.Refresh();
    if (options_.most_total || Chosen() >= next_note_) Note();
    if (IsEnough()) return;
    worth_.Sample();
    const int before = Chosen();
    const bool is_exact = before < kExactUpTo;
    const int step = std::max(kLeastStep, static_cast<int>((is_exact ? kExactGrowth : kLaterGrowth) * before));
    const int left = std::min(step, most_ - worth_.KeptCount());
    is_exact ? ChooseExactly(left) : ChooseBySamples(left);
    if (Chosen() == before) throw NumericalError("what the links are worth is not finite");
  }
}

template <class Pose>
void Greedy<Pose>::ChooseExactly(int step) {
  const std::vector<int> pool = Promising(kPool * step);
  for (int k = 0; k < step; ++k) {
    int best = -1;
    double most = -1;
    for (const int link : pool) {
      const double worth = worth_.Kept()[At(link)] ? -1 : worth_.Worth(link);
      if (worth > most) most = worth, best = link;
    }
    if (best < 0) return;
    Record(best);
    worth_.Keep(best, pool);
  }
}

template <class Pose>
void Greedy<Pose>::ChooseBySamples(int step) {
  Queue queue(std::less<Entry>(), EntriesOf(Others()));
  NearLinks near(system_, worth_.Kept());
  const int reach = std::max(kLeastReach, static_cast<int>(kReach * system_.poses / Chosen()));
  for (int k = 0; k < step && !queue.empty();) {
    const Entry top = queue.top();
    queue.pop();
    const double now = worth_.Worth(top.link);
    if (now < top.worth) {
      queue.push({now, top.link});
      continue;
    }
    Record(top.link);
    worth_.KeepBySamples(top.link, near.Of(top.link, reach));
    ++k;
  }
}

// So many that promise most by the samples, evaluated.
template <class Pose>
std::vector<int> Greedy<Pose>::Promising(int links) {
  std::vector<int> others = Others();
  const std::size_t most = At(std::max(links, kLeastPool));
  if (most < others.size()) {
    std::vector<Entry> entries = EntriesOf(others);
    std::nth_element(entries.begin(), entries.begin() + static_cast<long>(most), entries.end(),
                     [](const Entry& a, const Entry& b) { return b < a; });
    others.clear();
    for (std::size_t k = 0; k < most; ++k) others.push_back(entries[k].link);
    std::sort(others.begin(), others.end());
  }
  worth_.Evaluate(others);
  return others;
}

// The one of most worth now, by asking anew for those that were worth most when last asked for; -1: there is none.
template <class Pose>
int Greedy<Pose>::PopBest(Queue& queue) {
  std::vector<int> stale;
  while (!queue.empty()) {
    const Entry top = queue.top();
    if (worth_.IsFresh(top.link)) {
      queue.pop();
      return top.link;
    }
    stale.clear();
    while (!queue.empty() && static_cast<int>(stale.size()) < kBatch && !worth_.IsFresh(queue.top().link)) {
      stale.push_back(queue.top().link);
      queue.pop();
    }
    worth_.Evaluate(stale);
    for (const Entry& entry : EntriesOf(stale)) queue.push(entry);
  }
  return -1;
}

// As few of those that were taken as are enough; those of all rounds but the last are not.
template <class Pose>
void Greedy<Pose>::Trim() {
  const auto keep_first = [&](int links) {
    std::vector<char> kept = system_.in_tree;
    for (int k = 0; k < links; ++k) kept[At(order_[At(k)])] = 1;
    worth_.Restart(kept);
  };
  const std::size_t notes = out_.course.size();
  int enough = Chosen();
  for (int too_few = notes > 1 ? out_.course[notes - 2].links : enough; enough - too_few > 1;) {
    const int middle = (too_few + enough) / 2;
    keep_first(middle);
    (worth_.Total() <= *options_.most_total ? enough : too_few) = middle;
    Tell();
  }
  if (enough != Chosen()) keep_first(enough);
  worth_.Sample();
}

// The links that are worth least are chosen anew, all at once; for where there are too many for Exchange.
template <class Pose>
void Greedy<Pose>::Sweep() {
  const int dropped = static_cast<int>(kSweepShare * Chosen());
  double total = worth_.Total();
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    worth_.Sample();
    const std::vector<char> before = worth_.Kept();
    std::vector<char> fewer = before;
    for (const int link : WorthLeast(dropped)) fewer[At(link)] = 0;
    worth_.Restart(fewer);
    worth_.Sample();
    ChooseBySamples(dropped);
    worth_.Refresh();
    const double now = worth_.Total();
    if (!IsBetter(now, total)) return worth_.Restart(before);
    total = now;
    for (std::size_t k = 0; k < before.size(); ++k) out_.exchanges += before[k] && !worth_.Kept()[k];
  }
}

// Of the links kept, but for those that hold poses.
template <class Pose>
std::vector<int> Greedy<Pose>::WorthLeast(int links) {
  std::vector<int> kept;
  for (int link = 0; link < links_; ++link) {
    if (worth_.Kept()[At(link)] && !system_.in_tree[At(link)]) kept.push_back(link);
  }
  std::vector<Entry> entries = EntriesOf(kept);
  const std::size_t count = std::min(At(links), entries.size());
  std::partial_sort(entries.begin(), entries.begin() + static_cast<long>(count), entries.end());
  kept.clear();
  for (std::size_t k = 0; k < count; ++k) kept.push_back(entries[k].link);
  return kept;
}

// Whether another link instead of this one is better. `total`: as it is, and becomes; absent: what links are worth has
// to do.
template <class Pose>
bool Greedy<Pose>::ExchangeOne(int link, Queue& queue, std::optional<double>& total) {
  worth_.Evaluate({link});
  const double loss = worth_.Worth(link);
  Tell();
  if (!std::isfinite(loss) || !worth_.Drop(link)) return false;
  const int best = PopBest(queue);
  const double gain = best < 0 ? 0 : worth_.Worth(best);
  bool is_better = best >= 0 && gain > loss * (total ? kLeastPromise : 1 + 1e-3);
  worth_.Keep(is_better ? best : link);
  if (is_better && total) {
    const double now = worth_.Total();
    is_better = IsBetter(now, *total);
    if (is_better) {
      total = now;
    } else if (worth_.Drop(best)) {
      worth_.Keep(link);
    }
  }
  if (is_better) {
    out_.worth[At(best)] = gain;
    out_.worth[At(link)] = loss;
    queue.push({loss, link});
  } else if (best >= 0) {
    queue.push({gain, best});
  }
  return is_better;
}

// Those that have come to be worth least go for what is worth more now.
template <class Pose>
void Greedy<Pose>::Exchange() {
  worth_.Refresh();
  worth_.Sample();
  const int most = std::min(kMostTries, kMostTriesTimesPoses / system_.poses);
  const int tries = std::min(most, std::max(kLeastTries, static_cast<int>(std::ceil(kExchangeShare * Chosen()))));
  Queue others(std::less<Entry>(), EntriesOf(Promising(tries)));
  std::optional<double> total;
  if (tries * system_.poses <= kMostTotals) total = worth_.Total();
  for (int tried = 0, failures = 0; tried < tries && failures < kMostFailures;) {
    // The samples say which ones to look at.
    worth_.Evaluate(WorthLeast(2 * tries));
    const std::vector<int> least = WorthLeast(tries - tried);
    const int before = out_.exchanges;
    for (std::size_t k = 0; k < least.size() && failures < kMostFailures; ++k, ++tried) {
      const bool is_better = ExchangeOne(least[k], others, total);
      failures = is_better ? 0 : failures + 1;
      out_.exchanges += is_better;
    }
    if (out_.exchanges == before) return;
  }
}

template <class Pose>
void Greedy<Pose>::RecordWorth() {
  for (const int link : Others()) out_.worth[At(link)] = worth_.Worth(link);
}

// For comparison.
template <class Pose>
std::vector<char> Draw(const LinkSystem<Pose>& system, int links, std::uint64_t seed) {
  std::vector<int> others;
  std::vector<char> kept = system.in_tree;
  for (std::size_t k = 0; k < kept.size(); ++k) {
    if (!kept[k]) others.push_back(static_cast<int>(k));
  }
  Random random(seed);
  for (std::size_t k = 0; k < At(links); ++k) {
    const auto left = static_cast<double>(others.size() - k);
    std::swap(others[k], others[k + static_cast<std::size_t>(random.Uniform() * left)]);
    kept[At(others[k])] = 1;
  }
  return kept;
}

template <class Pose>
std::vector<char> Connect(const LinkSystem<Pose>& system, int links, std::uint64_t seed) {
  // The rotation's part, as the literature has it: the mean of the information about the angles.
  const auto weighted = [](const LinearFactor<Pose::kDof>& f) {
    constexpr int R = Pose::kDof - Pose::kDim;
    return WeightedEdge{f.first, f.second, f.A_second.template rightCols<R>().squaredNorm() / R};
  };
  std::vector<WeightedEdge> fixed, others;
  std::vector<int> of_other;
  for (const auto& f : system.fixed) {
    if (f.second >= 0) fixed.push_back(weighted(f));
  }
  std::vector<char> kept = system.in_tree;
  for (std::size_t k = 0; k < kept.size(); ++k) {
    (kept[k] ? fixed : others).push_back(weighted(system.links[k]));
    if (!kept[k]) of_other.push_back(static_cast<int>(k));
  }
  // Parts hang together as well as any two poses do.
  double largest = 0;
  for (const auto* edges : {&fixed, &others}) {
    for (const WeightedEdge& edge : *edges) largest = std::max(largest, edge.weight);
  }
  for (const int root : system.roots) {
    if (root != system.roots.front()) fixed.push_back({system.roots.front(), root, largest});
  }
  const auto choice = ChooseByConnectivity(system.poses, fixed, others, links, Rounding::kBest, seed);
  for (std::size_t k = 0; k < others.size(); ++k) {
    if (choice.chosen[k]) kept[At(of_other[k])] = 1;
  }
  return kept;
}

}  // namespace

template <class Pose>
ChoiceTotals TotalsOf(const LinkSystem<Pose>& system, const std::vector<char>& kept) {
  const LinkWorth<Pose> worth(system, SparsifyCriterion::kPosition, kept, false);
  return {worth.PositionTotal(), worth.LogDeterminant()};
}

template <class Pose>
LinkChoice ChooseLinks(const LinkSystem<Pose>& system, const ChoiceOptions& options) {
  const bool is_greedy =
      options.criterion == SparsifyCriterion::kPosition || options.criterion == SparsifyCriterion::kInformation;
  if (is_greedy) return Greedy<Pose>(system, options).Run();
  LinkChoice out;
  out.worth.assign(system.links.size(), 0.0);
  out.kept = options.criterion == SparsifyCriterion::kRandom ? Draw(system, options.links, options.seed)
                                                             : Connect(system, options.links, options.seed);
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                                      \
  template ChoiceTotals TotalsOf(const LinkSystem<Pose>&, const std::vector<char>&); \
  template LinkChoice ChooseLinks(const LinkSystem<Pose>&, const ChoiceOptions&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
