#include "terse/core/block_cholesky.h"

#include <limits>
#include <stdexcept>

#include "cholesky/back_substitution.h"
#include "cholesky/preparation.h"
#include "cholesky/rank_update.h"
#include "cholesky/region.h"
#include "support/version.h"
#include "terse/core/graph_members.h"

namespace terse {

using internal::At;
using std::size_t;

std::uint64_t internal::Identity::Next() { return NextVersion(); }

template <int B>
struct BlockCholesky<B>::Parts {
  internal::FrontTree<B> tree;
  internal::FrontFactorization<B> numbers;
  internal::Region<B> region;
  internal::RankUpdate<B> rank_update;
  internal::BackSubstitution<B> substitution;
  internal::Preparation<B> prepared;
};

template <int B>
BlockCholesky<B>::BlockCholesky() : parts_(std::make_unique<Parts>()) {}

template <int B>
BlockCholesky<B>::~BlockCholesky() = default;

template <int B>
BlockCholesky<B>::BlockCholesky(const BlockCholesky& other)
    : system_(other.system_),
      parts_(std::make_unique<Parts>(*other.parts_)),
      solution_(other.solution_),
      last_solve_(other.last_solve_),
      method_(other.method_),
      version_(other.version_),
      next_version_(other.next_version_) {
  SetProgress({});
}

template <int B>
BlockCholesky<B>::BlockCholesky(BlockCholesky&& other) : BlockCholesky() {
  Swap(other);
}

template <int B>
BlockCholesky<B>& BlockCholesky<B>::operator=(const BlockCholesky& other) {
  if (this == &other) return *this;
  BlockCholesky copy(other);
  Swap(copy);
  return *this;
}

template <int B>
BlockCholesky<B>& BlockCholesky<B>::operator=(BlockCholesky&& other) {
  if (this == &other) return *this;
  BlockCholesky moved(std::move(other));
  Swap(moved);
  return *this;
}

// Identities are new on both sides.
template <int B>
void BlockCholesky<B>::Swap(BlockCholesky& other) noexcept {
  std::swap(system_, other.system_);
  parts_.swap(other.parts_);
  solution_.swap(other.solution_);
  std::swap(last_solve_, other.last_solve_);
  std::swap(method_, other.method_);
  identity_ = std::move(other.identity_);
  std::swap(version_, other.version_);
  std::swap(next_version_, other.next_version_);
}

template <int B>
void BlockCholesky<B>::SetThreads(int threads) {
  if (threads < 1) throw std::invalid_argument("at least one thread is needed");
  parts_->numbers.SetThreads(threads);
}

template <int B>
void BlockCholesky<B>::SetOrder(std::vector<int> order) {
  std::vector<char> seen(order.size(), 0);
  for (const int v : order) {
    if (v < 0 || At(v) >= seen.size() || std::exchange(seen[At(v)], 1) != 0) {
      throw std::invalid_argument("an elimination order has to name every variable once");
    }
  }
  parts_->region.SetFirstOrder(std::move(order));
}

template <int B>
void BlockCholesky<B>::LimitReordering(double flops) {
  parts_->region.LimitLooks(flops);
}

template <int B>
void BlockCholesky<B>::DropUpdateMatrices(std::uint64_t most_bytes_of_L) {
  parts_->numbers.DropUpdates(most_bytes_of_L);
  system_.DropNormals();
}

template <int B>
void BlockCholesky<B>::SetProgress(std::function<void(double share)> progress) {
  parts_->numbers.SetProgress(std::move(progress));
}

template <int B>
void BlockCholesky<B>::SetLinearFactors(const std::vector<LinearFactor<B>>& factors) {
  system_.SetLinearFactors(factors, parts_->numbers.Threads());
}

template <int B>
void BlockCholesky<B>::ExchangeLinearFactors(std::vector<LinearFactor<B>>& factors) {
  system_.ExchangeLinearFactors(factors, parts_->numbers.Threads());
}

template <int B>
bool BlockCholesky<B>::Refactor(const std::vector<double>& damping) {
  version_ = internal::NextVersion();
  system_.ForgetChanges();
  internal::FrontTree<B>& tree = parts_->tree;
  const std::vector<int> order = tree.TopDown();
  std::vector<int> place_of(At(tree.Size()), 0);
  std::vector<internal::Front<B>*> fronts;
  std::vector<int> parents(order.size(), -1);
  for (auto it = order.rbegin(); it != order.rend(); ++it) {
    place_of[At(*it)] = static_cast<int>(fronts.size());
    fronts.push_back(&tree[*it]);
  }
  for (size_t k = 0; k < fronts.size(); ++k) {
    if (fronts[k]->parent >= 0) parents[k] = place_of[At(fronts[k]->parent)];
  }
  double flops = 0;
  if (parts_->numbers.FactorAll(fronts, parents, {}, system_, tree, damping, flops) >= 0) return false;
  tree.NoteRefactored(order, version_);
  return true;
}

template <int B>
void BlockCholesky<B>::Resize(int variables) {
  parts_->tree.Resize(variables);
  parts_->numbers.Resize(variables);
  solution_.resize(At(variables) * B, 0.0);
}

// Of what the region has taken.
template <int B>
int BlockCholesky<B>::RefactorRegion(internal::UpdateContext<B>& update) {
  auto& [tree, numbers, region, rank_update, substitution, prepared] = *parts_;
  const bool only_replaces =
      update.undo.added.empty() && update.undo.removed.empty() && update.undo.variables == Variables();
  if (method_ == Method::kCheapest && only_replaces && !region.IsOutOfOrder(tree))
    return region.RefactorAsOrdered(update);
  const int failed = region.Refactor(update);
  if (failed < 0) rank_update.ForgetDebt();
  return failed;
}

// The cheapest way that the method allows. Returns the variable at which the matrix was found not to be positive
// definite, or -1.
template <int B>
int BlockCholesky<B>::UpdateTree(const typename BlockSystem<B>::Undo& undo, UpdateReport& report) {
  auto& [tree, numbers, region, rank_update, substitution, prepared] = *parts_;
  internal::UpdateContext<B> update{system_, undo, tree, numbers, next_version_, report};
  if (numbers.HasDropped()) {
    region.TakeAll(tree);
  } else if (!region.TakeAllIfDrifted(update)) {
    if (method_ != Method::kRefactor && CanAppend(update)) return Append(update);
    region.TakeAffected(update);
    typename internal::RankUpdate<B>::Path path;
    if (method_ != Method::kRefactor && rank_update.Plan(update, region.Fronts(), path) &&
        (method_ == Method::kRankUpdateWherePossible || rank_update.IsCheaper(tree, path))) {
      return rank_update.Update(path, update);
    }
  }
  return RefactorRegion(update);
}

// The same with the fronts that were prepared; the others are ordered and factored again.
template <int B>
int BlockCholesky<B>::UpdateTreePrepared(const typename BlockSystem<B>::Undo& undo, UpdateReport& report) {
  auto& [tree, numbers, region, rank_update, substitution, prepared] = *parts_;
  internal::UpdateContext<B> update{system_, undo, tree, numbers, next_version_, report};
  const std::vector<int> ready = region.TakeAffectedBut(update, prepared);
  const auto exchange = [&, &tree = tree, &prepared = prepared] {
    for (const int f : ready) tree.ExchangeNumbers(f, prepared.ReadyFront(f), next_version_);
  };
  exchange();
  int failed = -1;
  try {
    failed = RefactorRegion(update);
  } catch (...) {
    exchange();
    throw;
  }
  if (failed >= 0) {
    exchange();
    return failed;
  }
  report.fronts += static_cast<int>(ready.size());
  for (const int f : ready) report.variables += static_cast<int>(tree[f].pivots.size());
  if (!ready.empty()) report.path = CholeskyPath::kRefactored;
  return -1;
}

template <int B>
void BlockCholesky<B>::Prepare(const std::vector<std::pair<int, LinearFactor<B>>>& replaced) {
  if (parts_->numbers.HasDropped()) throw std::logic_error("without update matrices nothing is made ready in pieces");
  parts_->prepared.Replace(replaced, system_, version_);
}

template <int B>
PreparationProgress BlockCholesky<B>::Advance(Clock::time_point deadline) {
  return parts_->prepared.Advance(deadline, system_, version_, parts_->tree, parts_->numbers);
}

template <int B>
void BlockCholesky<B>::EndPreparedStep() {
  parts_->prepared.EndStep(system_, version_);
}

template <int B>
void BlockCholesky<B>::ForgetPrepared() {
  parts_->prepared.Forget();
}

template <int B>
typename BlockCholesky<B>::Changes BlockCholesky<B>::PreparedChanges() {
  Changes changes;
  changes.replaced = parts_->prepared.Take(system_, version_);
  return changes;
}

template <int B>
typename BlockCholesky<B>::UpdateReport BlockCholesky<B>::UpdatePrepared(Changes&& changes) {
  system_.Check(changes);
  UpdateReport report = BringIn(changes, std::move(changes.replaced), true);
  parts_->prepared.Forget();
  return report;
}

template <int B>
typename BlockCholesky<B>::UpdateReport BlockCholesky<B>::Update(const Changes& changes) {
  system_.Check(changes);
  return BringIn(changes, changes.replaced, false);
}

template <int B>
typename BlockCholesky<B>::UpdateReport BlockCholesky<B>::Update(Changes&& changes) {
  system_.Check(changes);
  return BringIn(changes, std::move(changes.replaced), false);
}

// Of changes that were checked; what is replaced comes apart.
template <int B>
typename BlockCholesky<B>::UpdateReport BlockCholesky<B>::BringIn(const Changes& changes,
                                                                  typename BlockSystem<B>::Replaced replaced,
                                                                  bool is_prepared) {
  UpdateReport report;
  next_version_ = internal::NextVersion();
  typename BlockSystem<B>::Undo undo;
  const auto watch = parts_->region.Watch();
  const auto take_back = [&] {
    parts_->region.Clear();
    parts_->region.SetWatch(watch);
    system_.Revert(undo);
    Resize(undo.variables);
    report.added_slots.clear();
  };
  try {
    system_.Apply(changes, std::move(replaced), undo);
    Resize(Variables());
    report.added_slots = undo.added;
    report.failed_variable = is_prepared ? UpdateTreePrepared(undo, report) : UpdateTree(undo, report);
  } catch (...) {
    take_back();
    throw;
  }
  if (report.failed_variable >= 0) {
    take_back();
    return report;
  }
  parts_->region.Clear();
  parts_->region.NoteWork(report.flops);
  report.ok = true;
  if (report.fronts == 0 && report.fronts_updated == 0) {
    report.path = CholeskyPath::kNone;
    return report;
  }
  system_.Commit(undo, version_);
  version_ = next_version_;
  return report;
}

template <int B>
std::vector<int> BlockCholesky<B>::Solve(double threshold, std::optional<Clock::time_point> deadline) {
  return parts_->substitution.Solve(parts_->tree, system_, threshold, deadline, solution_, last_solve_);
}

template <int B>
void BlockCholesky<B>::SetSolution(int variable, const Vector<B>& d) {
  std::copy_n(d.data(), B, solution_.begin() + static_cast<long>(variable) * B);
}

template <int B>
double BlockCholesky<B>::LogDeterminant() const {
  return parts_->tree.LogDeterminant();
}

template <int B>
double BlockCholesky<B>::NewtonDecrement() const {
  return parts_->tree.SquaredY();
}

template <int B>
std::int64_t BlockCholesky<B>::Nonzeros() const {
  return parts_->tree.Nonzeros();
}

template <int B>
std::uint64_t BlockCholesky<B>::BytesInFile() const {
  std::uint64_t sum = 0;
  parts_->tree.ForEach([&](int, const internal::Front<B>& front) {
    if (front.panel.HasPlace()) sum += front.panel.Size() * sizeof(double);
  });
  return sum;
}

template <int B>
const internal::FrontTree<B>& BlockCholesky<B>::Tree() const {
  return parts_->tree;
}

// Nobody has covariances of a version of before: the version is drawn anew, and the identity is that of a new object.
// The shape of the tree comes first, because the fronts, which are most of it, are checked against it as they come.
template <int B>
template <class Archive>
void BlockCholesky<B>::Serialize(Archive& archive) {
  auto& [system, parts, solution, last_solve, method, identity, version, next_version] = *this;
  auto& [tree, numbers, region, rank_update, substitution, prepared] = *parts;
  archive(system);
  tree.SerializeShape(archive);
  archive(solution, last_solve.flops, last_solve.deferred, method, numbers, region, rank_update);
  const size_t n = At(tree.Variables());
  if constexpr (Archive::kReads) {
    if (n > At(std::numeric_limits<int>::max() / B - 1)) archive.Fail("too many variables");
    for (const std::string& defect : {numbers.FindStateDefect(), region.FindStateDefect()}) {
      if (!defect.empty()) archive.Fail(defect);
    }
    version = next_version = internal::NextVersion();
  }
  tree.SerializeFronts(archive, version);
  if constexpr (Archive::kReads) {
    std::string defect = solution.size() == n * B ? tree.FindDefect() : "the parts of the factor have different sizes";
    if (defect.empty()) defect = system.FindDefect(n);
    if (defect.empty()) defect = tree.FindSlotDefect(system);
    if (!defect.empty()) archive.Fail(defect);
    system.Rebuild(n);
    numbers.Resize(static_cast<int>(n));
  }
  prepared.Serialize(archive, system, version, tree, numbers);
}

#define TERSE_INSTANTIATE(B)                               \
  template class BlockCholesky<B>;                         \
  template void BlockCholesky<B>::Serialize(StateWriter&); \
  template void BlockCholesky<B>::Serialize(StateReader&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse
