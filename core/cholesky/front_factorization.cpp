#include "cholesky/front_factorization.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <mutex>
#include <utility>

#include "terse/core/dense_kernels.h"
#include "terse/core/parallel.h"
#include "terse/core/state_file.h"

namespace terse::internal {
namespace {

using std::size_t;

constexpr double kSingular = 4e-15;
constexpr double kParallelFlops = 2e7;  // from which it pays to wake other threads

// Sum of the squared column counts.
double FactorFlops(double rows, double pivots) {
  double flops = 0;
  for (double c = 0; c < pivots; ++c) flops += (rows - c) * (rows - c);
  return flops;
}

// Where (row, column) of a front is stored: in the panel, or in the update matrix.
template <int B>
double* Target(Front<B>& front, int row, int column) {
  const int p = front.Columns(), rows = front.Rows();
  if (column < p) return front.panel.Buffer() + At(column) * At(rows) + At(row);
  return front.update.data() + At(column - p) * At(rows - p) + At(row - p);
}

// Adds to the columns of a front, from (row, column) on.
template <int B, class Block>
void AddBlock(Front<B>& front, int row, int column, const Block& block) {
  using Map = Eigen::Map<Eigen::Matrix<double, B, B>, Eigen::Unaligned, Eigen::OuterStride<>>;
  const int p = front.Columns(), rows = front.Rows();
  Map(Target<B>(front, row, column), Eigen::OuterStride<>(column < p ? rows : rows - p)) += block;
}

template <int B>
void AddRightHandSide(Front<B>& front, int column, const double* b, size_t stride) {
  const size_t step = At(column < front.Columns() ? front.Rows() : front.Rows() - front.Columns());
  double* target = Target<B>(front, front.Rows() - 1, column);
  for (size_t k = 0; k < B; ++k) target[k * step] += b[k * stride];
}

// Of a forest given by parents, children by ascending number. Unused: nobody has children.
class ChildLists {
 public:
  ChildLists() = default;
  explicit ChildLists(const std::vector<int>& parents) : first_(parents.size(), -1), next_(parents.size(), -1) {
    for (int k = static_cast<int>(parents.size()) - 1; k >= 0; --k) {
      int& first = parents[At(k)] < 0 ? first_root_ : first_[At(parents[At(k)])];
      next_[At(k)] = std::exchange(first, k);
    }
  }
  bool IsUsed() const { return !first_.empty(); }
  template <class Visit>
  void ForEach(int parent, const Visit& visit) const {
    if (!IsUsed()) return;
    for (int child = first_[At(parent)]; child >= 0; child = next_[At(child)]) visit(child);
  }
  std::vector<int> Postorder() const {
    std::vector<int> order, stack;
    for (int root = first_root_; root >= 0; root = next_[At(root)]) stack.push_back(root);
    while (!stack.empty()) {  // parents first, then turned round
      order.push_back(stack.back());
      stack.pop_back();
      ForEach(order.back(), [&](int child) { stack.push_back(child); });
    }
    std::reverse(order.begin(), order.end());
    return order;
  }

 private:
  std::vector<int> first_, next_;
  int first_root_ = -1;
};

void ClearLower(double* matrix, int rows, int columns) {
  for (int c = 0; c < columns; ++c) std::fill_n(matrix + At(c) * At(rows) + At(c), rows - c, 0.0);
}

// Products are cut into blocks of so many columns, whatever the number of threads, so that the bits are the same.
constexpr size_t kColumnBlock = 48;
constexpr double kParallelProduct = 1e6;  // multiplications from which a cut pays
// Pivots at a time in a large panel, so that most of its work is in products.
constexpr int kPivotBlock = 96;

// do_block(first column, rows from there on, columns).
template <class DoBlock>
void ForEachColumnBlock(int rows, int columns, int depth, bool parallel, const DoBlock& do_block) {
  const bool pays = 1.0 * rows * columns * depth > kParallelProduct;
  ForEachChunk(parallel && pays, At(columns), kColumnBlock, [&](size_t begin, size_t end) {
    do_block(begin, rows - static_cast<int>(begin), static_cast<int>(end - begin));
  });
}

// Lower trapezoid of C (rows x columns, leading dimension ldc) = -A A', A rows x depth with leading dimension ld.
void SetNegativeSquare(double* c, int ldc, const double* a, int ld, int rows, int columns, int depth, bool parallel) {
  ForEachColumnBlock(rows, columns, depth, parallel, [&](size_t begin, int below, int width) {
    Kernels().set_negative_square(c + begin * At(ldc) + begin, ldc, a + begin, ld, below, width, depth);
  });
}
// The same, C -= A A'.
void SubtractSquare(double* c, int ldc, const double* a, int ld, int rows, int columns, int depth, bool parallel) {
  ForEachColumnBlock(rows, columns, depth, parallel, [&](size_t begin, int below, int width) {
    Kernels().subtract_product(c + begin * At(ldc) + begin, ldc, a + begin, a + begin, ld, below, width, depth);
  });
}

// As the kernel of that name, with large panels in blocks.
int FactorPanel(double* panel, int rows, int pivots, bool parallel) {
  for (int k = 0; k < pivots; k += kPivotBlock) {
    const int width = std::min(kPivotBlock, pivots - k), next = k + width;
    double* corner = panel + At(k) * At(rows) + At(k);
    const int failed = Kernels().factor_panel(corner, rows, rows - k, width);
    if (failed >= 0) return k + failed;
    if (next == pivots) break;
    SubtractSquare(panel + At(next) * At(rows) + At(next), rows, corner + width, rows, rows - next, pivots - next,
                   width, parallel);
  }
  return -1;
}

// What is done of the work, told to who wants to know.
class WorkShare {
 public:
  WorkShare(const std::function<void(double)>& tell, double total) : tell_(tell), total_(total) {}
  template <class AnyFront>
  void Add(const AnyFront& front) {
    if (!tell_) return;
    const std::lock_guard<std::mutex> lock(mutex_);
    done_ += FactorFlops(front.Rows(), front.Columns());
    tell_(done_ / total_);
  }

 private:
  const std::function<void(double)>& tell_;
  double total_, done_ = 0;
  std::mutex mutex_;
};

// The blocks of a linear factor that `holds` says of by column.
template <int B, class Holds>
void AssembleFactor(Front<B>& front, const LinearFactor<B>& f, const typename BlockSystem<B>::Normal& normal,
                    const std::vector<int>& row_of, const Holds& holds) {
  const int i = row_of[At(f.first)];
  if (holds(i)) {
    AddBlock<B>(front, i, i, normal.H_first);
    AddRightHandSide<B>(front, i, normal.b_first.data(), 1);
  }
  if (f.second < 0) return;
  const int j = row_of[At(f.second)];
  if (holds(j)) {
    AddBlock<B>(front, j, j, normal.H_second);
    AddRightHandSide<B>(front, j, normal.b_second.data(), 1);
  }
  if (!holds(std::min(i, j))) return;
  if (i > j) {
    AddBlock<B>(front, i, j, normal.H_cross.transpose());
  } else {
    AddBlock<B>(front, j, i, normal.H_cross);
  }
}

// Block by block: a kept child's separator order may be stale, for its ancestors were ordered again since, so that a
// block can land transposed.
template <int B, class Holds>
void AddUnordered(Front<B>& front, const Front<B>& child, const std::vector<int>& at, const Holds& holds) {
  using Source = Eigen::Map<const Eigen::Matrix<double, B, B>, Eigen::Unaligned, Eigen::OuterStride<>>;
  const int blocks = child.update_separators, n = child.UpdateRows();
  for (int j = 0; j < blocks; ++j) {
    const int cj = at[At(j)];
    const double* columns = child.update.data() + At(j * B) * At(n);
    for (int i = j; i < blocks; ++i) {
      const int ci = at[At(i)];
      if (!holds(std::min(ci, cj))) continue;
      const Source source(columns + i * B, Eigen::OuterStride<>(n));
      if (ci < cj) {
        AddBlock<B>(front, cj, ci, source.transpose());
      } else if (i > j) {
        AddBlock<B>(front, ci, cj, source);
      } else {
        AddBlock<B>(front, ci, cj, source.template triangularView<Eigen::Lower>().toDenseMatrix());
      }
    }
    if (holds(cj)) AddRightHandSide<B>(front, cj, columns + At(n - 1), At(n));
  }
}

}  // namespace

// Extend-add of a child's update matrix.
template <int B>
void FrontFactorization<B>::AssembleChild(Part part, Front<B>& front, const Front<B>& child, Scratch& scratch) {
  const int blocks = child.update_separators, p = front.Columns(), rows = front.Rows();
  auto& [row_of, at, run_end, updates, normals] = scratch;
  at.resize(At(blocks));
  run_end.resize(At(blocks));
  bool ascends = true;
  for (int k = 0; k < blocks; ++k) {
    at[At(k)] = row_of[At(child.separators[At(k)])];
    ascends = ascends && (k == 0 || at[At(k)] > at[At(k - 1)]);
  }
  if (!ascends) {
    return AddUnordered<B>(front, child, at, [&](int column) { return (column < p) == (part == Part::kPanel); });
  }
  for (int k = blocks - 1; k >= 0; --k) {
    const bool goes_on = k + 1 < blocks && at[At(k + 1)] == at[At(k)] + B;
    run_end[At(k)] = goes_on ? run_end[At(k + 1)] : k + 1;
  }
  const int split = static_cast<int>(std::lower_bound(at.begin(), at.end(), p) - at.begin());
  if (part == Part::kPanel) {
    Kernels().extend_add(front.panel.Buffer(), rows, child.update.data(), child.UpdateRows(), at.data(), run_end.data(),
                         0, split, blocks, rows - 1, B);
  } else {
    for (int k = split; k < blocks; ++k) at[At(k)] -= p;
    Kernels().extend_add(front.update.data(), rows - p, child.update.data(), child.UpdateRows(), at.data(),
                         run_end.data(), split, blocks, blocks, rows - p - 1, B);
  }
}

// What slots and children add to the panel, or to the update matrix.
template <int B>
void FrontFactorization<B>::Assemble(Part part, Front<B>& front, const Sources& from, Scratch& scratch) {
  const int p = front.Columns();
  const auto holds = [&](int column) { return (column < p) == (part == Part::kPanel); };
  for (size_t k = 0; k < front.slots.size(); ++k) {
    const int slot = front.slots[k];
    const auto* normal = from.system.HasNormals() ? &from.system.NormalAt(slot) : &scratch.normals[k];
    if (from.instead != nullptr) {
      const auto it = from.instead->find(slot);
      if (it != from.instead->end()) normal = &it->second;
    }
    AssembleFactor<B>(front, from.system.LinearFactorAt(slot), *normal, scratch.row_of, holds);
  }
  for (const int child : front.children) {
    AssembleChild(part, front, child < 0 ? from.pending[At(-1 - child)] : from.tree[child], scratch);
  }
}

// The update matrix is set to what the pivots leave of it before anything is added, so that it need not be cleared.
template <int B>
int FrontFactorization<B>::FactorFront(Front<B>& front, const Sources& from, Scratch& scratch, bool parallel) {
  const int rows = front.Rows(), p = front.Columns(), n = rows - p;
  if (front.panel.HasPlace()) {
    std::fill_n(front.panel.Buffer(), At(rows) * At(p), 0.0);  // all of it goes into the file
  } else {
    ClearLower(front.panel.Buffer(), rows, p);
  }
  front.update_separators = static_cast<int>(front.separators.size());
  front.corrections.clear();
  front.ForEachRow([&](int v, int row) { scratch.row_of[At(v)] = row; });
  if (!from.system.HasNormals()) {
    scratch.normals.resize(std::max(scratch.normals.size(), front.slots.size()));
    for (size_t k = 0; k < front.slots.size(); ++k) {
      BlockSystem<B>::SetNormal(from.system.LinearFactorAt(front.slots[k]), scratch.normals[k]);
    }
  }
  Assemble(Part::kPanel, front, from, scratch);
  if (!from.damping.empty()) {
    for (int c = 0; c < p; ++c) *front.Entry(c, c) += from.damping[At(front.pivots[At(c / B)]) * B + At(c % B)];
  }
  const int failed = FactorPanel(front.panel.Buffer(), rows, p, parallel);
  if (failed >= 0) return front.pivots[At(failed / B)];
  SetNegativeSquare(front.update.data(), n, front.panel.Buffer() + p, rows, n, n, p, parallel);
  Assemble(Part::kUpdate, front, from, scratch);
  return SumPivots(front, 0, from.system);
}

template <int B>
void FrontFactorization<B>::PlacePanels(const std::vector<Front<B>*>& fronts, const std::vector<int>& order) const {
  const auto size_of = [](const Front<B>& front) { return At(front.Rows()) * At(front.Columns()); };
  size_t needed = 0;
  for (const Front<B>* front : fronts) needed += front->panel.Size() < size_of(*front) ? size_of(*front) : 0;
  const std::shared_ptr<PanelFile> file = OpenPanelFile(needed, most_bytes_);
  if (!file) return;
  size_t at = 0;
  for (const int k : order) {
    Front<B>& front = *fronts[At(k)];
    if (front.panel.Size() >= size_of(front)) continue;
    front.panel.SetPlace(file, at, size_of(front));
    at += size_of(front);
  }
}

template <int B>
int FrontFactorization<B>::FactorAll(const std::vector<Front<B>*>& fronts, const std::vector<int>& parents,
                                     const std::vector<Front<B>>& pending, const BlockSystem<B>& system,
                                     const FrontTree<B>& tree, const std::vector<double>& damping, double& flops) {
  const Sources from{system, tree, pending, damping};
  double total = 0;
  for (const Front<B>* front : fronts) total += FactorFlops(front->Rows(), front->Columns());
  const int count = static_cast<int>(fronts.size());
  const bool drops = drops_updates_;
  const ChildLists children = drops ? ChildLists(parents) : ChildLists();
  const std::vector<int> postorder = children.Postorder();  // a subtree at a time, so that few update matrices wait
  if (drops) PlacePanels(fronts, postorder);
  has_dropped_ = has_dropped_ || drops;  // if this fails the tree is what it was before, or not usable
  const auto take_buffers = [&](Front<B>& front, Scratch& scratch) {
    const size_t rows = At(front.Rows()), columns = At(front.Columns()), n = rows - columns;
    if (front.panel.HasPlace()) {
      front.panel.BeginStoring(scratch.updates.Take(rows * columns));
    } else if (front.panel.Size() < rows * columns) {
      // The pool is nobody's who works beside others.
      front.panel.SetBuffer(drops ? FrontBuffer(rows * columns) : pool_.Take(rows * columns));
    }
    if (front.update.size() < n * n) front.update = drops ? scratch.updates.Take(n * n) : pool_.Take(n * n);
  };
  std::atomic<int> end(count);  // the first front that failed, or all
  std::vector<int> failed(fronts.size(), -1);
  WorkShare share(progress_, total);
  const auto factor = [&](int k, Scratch& scratch, bool parallel) {
    int seen = end;
    if (k > seen) return;
    if (drops) take_buffers(*fronts[At(k)], scratch);
    failed[At(k)] = FactorFront(*fronts[At(k)], from, scratch, parallel);
    if (fronts[At(k)]->panel.HasPlace()) scratch.updates.Give(fronts[At(k)]->panel.Store());
    children.ForEach(k, [&](int child) {
      FrontBuffer& update = fronts[At(child)]->update;
      if (update.size() >= ShortLivedBuffers::kLeast) scratch.updates.Give(std::move(update));
    });
    while (failed[At(k)] >= 0 && k < seen && !end.compare_exchange_weak(seen, k)) continue;
    share.Add(*fronts[At(k)]);
  };
  if (threads_ > 1 && total > kParallelFlops) {
    for (Front<B>* front : fronts) {
      if (!drops) take_buffers(*front, scratch_);
    }
    thread_scratch_.resize(At(threads_));
    for (Scratch& scratch : thread_scratch_) scratch.row_of.resize(scratch_.row_of.size());
    WithThreads(threads_,
                [&] { ForEachBottomUp(parents, [&](int k) { factor(k, thread_scratch_[ThreadIndex()], true); }); });
  } else if (drops) {
    for (const int k : postorder) factor(k, scratch_, false);
  } else {
    for (int k = 0; k < std::min(count, end + 1); ++k) {
      take_buffers(*fronts[At(k)], scratch_);
      factor(k, scratch_, false);
    }
  }
  for (int k = 0; k < end; ++k) flops += FactorFlops(fronts[At(k)]->Rows(), fronts[At(k)]->Columns());
  if (end < count) return failed[At(end)];
  has_dropped_ = drops;
  return -1;
}

template <int B>
int FrontFactorization<B>::SumPivots(Front<B>& front, int first_column, const BlockSystem<B>& system) {
  const int rows = front.Rows(), p = front.Columns();
  front.log_det = front.y2 = 0;
  for (int c = 0; c < p; ++c) {
    const double* column = front.panel.Buffer() + At(c) * At(rows);
    const double pivot = column[c], y = column[rows - 1];
    // What is left of a direction that nothing measures is rounding of what was assembled.
    if (c >= first_column && !(pivot * pivot > kSingular * system.DiagonalOf(front.pivots[At(c / B)])[c % B])) {
      return front.pivots[At(c / B)];
    }
    front.log_det += 2 * std::log(pivot);
    front.y2 += y * y;
  }
  return std::isfinite(front.y2) ? -1 : front.pivots.front();
}

template <int B>
void FrontFactorization<B>::WorkInCorrections(Front<B>& front) {
  if (front.corrections.empty()) return;
  const int n = B * static_cast<int>(front.separators.size()) + 1, old = front.UpdateRows();
  if (n != old) {
    FrontBuffer wider = pool_.Take(At(n) * At(n));
    ClearLower(wider.data(), n, n);
    for (int c = 0; c < old - 1; ++c) {
      const double* from = front.update.data() + At(c) * At(old);
      double* to = wider.data() + At(c) * At(n);
      std::copy(from + c, from + old - 1, to + c);
      to[n - 1] = from[old - 1];
    }
    front.update.swap(wider);
    front.update_separators = static_cast<int>(front.separators.size());
    pool_.MakeRoom(wider.size());
    pool_.Give(std::move(wider));
  }
  int depth = 0;
  for (const Correction& c : front.corrections) depth += c.columns;
  std::vector<double> W(At(n) * At(depth), 0.0);
  double* column = W.data();
  for (const Correction& c : front.corrections) {
    const int rows = B * c.separators + 1;
    for (int k = 0; k < c.columns; ++k, column += n) {
      const double* from = c.W.data() + At(k) * At(rows);
      std::copy(from, from + rows - 1, column);
      column[n - 1] = from[rows - 1];
    }
  }
  std::vector<double> negative(W);
  for (double& x : negative) x = -x;
  Kernels().subtract_product(front.update.data(), n, W.data(), negative.data(), n, n, n, depth);
  front.corrections.clear();
}

template <int B>
template <class Archive>
void FrontFactorization<B>::Serialize(Archive& archive) {
  // The rest is scratch; a factor without update matrices is not stored.
  auto& [scratch, thread_scratch, pool, threads, drops_updates, has_dropped, most_bytes, progress] = *this;
  archive(threads);
}

#define TERSE_INSTANTIATE(B)                                    \
  template class FrontFactorization<B>;                         \
  template void FrontFactorization<B>::Serialize(StateWriter&); \
  template void FrontFactorization<B>::Serialize(StateReader&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
