#include "terse/compact/link_choice.h"

#include <algorithm>
#include <cmath>
#include <queue>

#include "terse/compact/connectivity.h"
#include "terse/core/at.h"
#include "terse/core/error.h"
#include "terse/core/random.h"

namespace terse::internal {
namespace {

// So many are chosen with the worth of all that promise something kept up to date; later ones change little beyond
// their surroundings.
constexpr int kExact = 256;
// Links are chosen in rounds: so many for each that was chosen before, four at least, out of so many times as many that
// promise most when the round begins.
constexpr double kGrowth = 0.25;
constexpr int kLeastStep = 4;
constexpr int kPool = 6, kLeastPool = 1024;
// Looked at together, so that threads have something to share; a constant, so that they do not change the result.
constexpr int kBatch = 4;
// The total is worked out after so many times as many links, for the course.
constexpr double kNotes = 1.2;
// And after so many times as many where it says when to end.
constexpr double kLooks = 1.02;
// Exchanges tried, as a share of the links; and in a row without success.
constexpr double kExchangeShare = 0.2;
constexpr int kMostFailures = 4;

template <class Pose>
class Greedy {
 public:
  Greedy(const LinkSystem<Pose>& system, const ChoiceOptions& options)
      : options_(options),
        links_(static_cast<int>(system.links.size())),
        worth_(system, options.criterion, system.in_tree, options.parallel) {
    out_.worth.assign(system.links.size(), 0.0);
    at_start_ = worth_.KeptCount();
    most_ = options.most_total ? links_ : std::min(links_, at_start_ + options.links);
  }

  LinkChoice Run() {
    Note();
    Choose();
    if (!options_.most_total && worth_.KeptCount() < links_) Exchange();
    if (out_.exchanges > 0 && out_.course.back().links == Chosen()) out_.course.pop_back();
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
  int Chosen() const { return worth_.KeptCount() - at_start_; }
  void Note() {
    if (!out_.course.empty() && out_.course.back().links == Chosen()) return;
    out_.course.push_back({Chosen(), worth_.Total()});
    next_note_ = kNotes * Chosen();
  }
  bool IsEnough() {
    if (worth_.KeptCount() >= most_) return true;
    if (!options_.most_total) return false;
    if (Chosen() >= next_look_) {
      Note();
      next_look_ = std::max(Chosen() + 1, static_cast<int>(kLooks * Chosen()));
    }
    return out_.course.back().total <= *options_.most_total;
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
  void Take(int link, const std::vector<int>& others = {}) {
    out_.worth[At(link)] = worth_.Worth(link);
    worth_.Keep(link, others);
    Tell();
  }

  void Choose();
  void ChooseExactly(int step);
  void ChooseLazily(int step);
  std::vector<int> Promising(int links);
  std::priority_queue<Entry> Queue(const std::vector<int>& links) const;
  int PopBest(std::priority_queue<Entry>& queue);
  void Exchange();
  bool ExchangeOne(int link, std::priority_queue<Entry>& queue);
  void RecordWorth();

  const ChoiceOptions& options_;
  const int links_;
  LinkWorth<Pose> worth_;
  LinkChoice out_;
  int at_start_ = 0, most_ = 0, next_look_ = 1;
  double next_note_ = 0;
};

template <class Pose>
void Greedy<Pose>::ChooseExactly(int step) {
  const std::vector<int> pool = Promising(kPool * step);
  for (int k = 0; k < step && !IsEnough(); ++k) {
    int best = -1;
    double most = -1;
    for (const int link : pool) {
      const double worth = worth_.Kept()[At(link)] ? -1 : worth_.Worth(link);
      if (worth > most) most = worth, best = link;
    }
    if (best < 0) return;
    Take(best, pool);
  }
}

// The one of most worth now, by asking anew for those that were worth most when last asked for; -1: there is none.
template <class Pose>
int Greedy<Pose>::PopBest(std::priority_queue<Entry>& queue) {
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
    for (const int link : stale) queue.push({worth_.Worth(link), link});
  }
  return -1;
}

template <class Pose>
void Greedy<Pose>::ChooseLazily(int step) {
  std::priority_queue<Entry> queue = Queue(Promising(kPool * step));
  for (int k = 0; k < step && !IsEnough(); ++k) {
    const int best = PopBest(queue);
    if (best < 0) return;
    Take(best);
  }
}

template <class Pose>
void Greedy<Pose>::Choose() {
  while (!IsEnough()) {
    const int step = std::min(most_ - worth_.KeptCount(), std::max(kLeastStep, static_cast<int>(kGrowth * Chosen())));
    const int before = Chosen();
    Chosen() < kExact ? ChooseExactly(step) : ChooseLazily(step);
    if (Chosen() == before) throw NumericalError("what the links are worth is not finite");
    if (Chosen() >= next_note_) Note();
  }
}

// So many that promise most, evaluated.
template <class Pose>
std::vector<int> Greedy<Pose>::Promising(int links) {
  worth_.Refresh();
  worth_.Sample();
  std::vector<int> others = Others();
  links = std::max(links, kLeastPool);
  if (At(links) < others.size()) {
    std::vector<Entry> entries;
    for (const int link : others) entries.push_back({worth_.Worth(link), link});
    std::nth_element(entries.begin(), entries.begin() + links, entries.end(),
                     [](const Entry& a, const Entry& b) { return b < a; });
    others.clear();
    for (int k = 0; k < links; ++k) others.push_back(entries[At(k)].link);
    std::sort(others.begin(), others.end());
  }
  worth_.Evaluate(others);
  return others;
}

template <class Pose>
auto Greedy<Pose>::Queue(const std::vector<int>& links) const -> std::priority_queue<Entry> {
  std::priority_queue<Entry> queue;
  for (const int link : links) queue.push({worth_.Worth(link), link});
  return queue;
}

// Whether another link instead of this one is better.
template <class Pose>
bool Greedy<Pose>::ExchangeOne(int link, std::priority_queue<Entry>& queue) {
  const double loss = worth_.Worth(link);
  if (!std::isfinite(loss) || !worth_.Drop(link)) return false;
  const int best = PopBest(queue);
  const double gain = best < 0 ? 0 : worth_.Worth(best);
  const bool is_better = gain > loss * (1 + 1e-3);
  worth_.Keep(is_better ? best : link);
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
  const int tries = static_cast<int>(std::ceil(kExchangeShare * Chosen()));
  std::priority_queue<Entry> others = Queue(Promising(tries));
  std::vector<int> kept;
  for (int link = 0; link < links_; ++link) {
    if (worth_.Kept()[At(link)]) kept.push_back(link);
  }
  worth_.Evaluate(kept);
  std::sort(kept.begin(), kept.end(),
            [&](int a, int b) { return std::pair(worth_.Worth(a), a) < std::pair(worth_.Worth(b), b); });
  int failures = 0;
  for (int k = 0; k < std::min(tries, static_cast<int>(kept.size())) && failures < kMostFailures; ++k) {
    worth_.Evaluate({kept[At(k)]});
    const bool is_better = ExchangeOne(kept[At(k)], others);
    failures = is_better ? 0 : failures + 1;
    out_.exchanges += is_better;
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
double TotalOfAll(const LinkSystem<Pose>& system, SparsifyCriterion criterion) {
  return LinkWorth<Pose>(system, criterion, std::vector<char>(system.links.size(), 1), false).Total();
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
  for (const auto& kept : {system.in_tree, out.kept}) {
    LinkWorth<Pose> worth(system, SparsifyCriterion::kPosition, kept, options.parallel);
    out.course.push_back({kept == out.kept ? options.links : 0, worth.Total()});
  }
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                           \
  template double TotalOfAll(const LinkSystem<Pose>&, SparsifyCriterion); \
  template LinkChoice ChooseLinks(const LinkSystem<Pose>&, const ChoiceOptions&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
