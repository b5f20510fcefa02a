#include "files/packed_graph.h"

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <unordered_map>
#include <utility>

#include "files/read_graph.h"
#include "terse/core/definite.h"
#include "terse/core/limits.h"
#include "terse/core/packed_columns.h"
#include "terse/core/pose_name.h"
#include "terse/core/state_file.h"

namespace terse {
namespace {

using internal::Column;
using internal::ColumnReader;

// Of the whitening of an information matrix: a standard deviation is kept to a 512th of an octave, and what couples two
// of them to a 512th of one of them.
constexpr double kRootStep = 1.0 / 512;

std::int64_t ToSteps(double x, double step) {
  const double steps = std::round(x / step);
  if (!(std::abs(steps) < std::ldexp(1.0, std::numeric_limits<double>::digits))) {
    throw std::invalid_argument("a number is more steps of its precision than can be counted");
  }
  return static_cast<std::int64_t>(steps);
}

std::int64_t BitsOf(double x) {
  std::int64_t bits;
  std::memcpy(&bits, &x, sizeof(bits));
  return bits;
}

double OfBits(std::int64_t bits) {
  double x;
  std::memcpy(&x, &bits, sizeof(x));
  return x;
}

// Poses that are not fixed have no values in the file.
enum PoseKind : std::int64_t { kFree, kFixedSomewhere, kFixedAtValue };

// As integers (Column), as they are read (ColumnReader), or as Deflate makes them (std::string). Columns of several
// numbers a row have them one after the other.
template <class T>
struct Columns {
  T ids;                    // of poses, each less the one before
  T pose_kinds;             // see PoseKind
  T values;                 // of fixed poses: bits of the translation, then of the rotation's coordinates
  T kinds;                  // of factors: index of the variant
  T last;                   // index of a factor's later pose, less that of the factor before
  T back;                   // of edges: how much earlier the other pose is; below zero: the later pose is `from`
  T which;                  // information: 0 a new one, k the k-th new one once more
  T scales, couplings;      // of new ones, see RootOf
  T levers;                 // of position priors: bits
  std::vector<T> measured;  // by coordinate, in steps

  template <class Visit>
  void ForEach(const Visit& visit) const {
    for (const T* column : {&ids, &pose_kinds, &values, &kinds, &last, &back, &which, &scales, &couplings, &levers}) {
      visit(*column);
    }
    for (const T& column : measured) visit(column);
  }
  template <class To, class Make>
  Columns<To> As(const Make& make) const {
    std::vector<To> of_measured;
    for (const T& column : measured) of_measured.push_back(make(column));
    return {make(ids),    make(pose_kinds), make(values), make(kinds),           make(last), make(back), make(which),
            make(scales), make(couplings),  make(levers), std::move(of_measured)};
  }
};

struct PackedGraph {
  int dimension = 0;  // 2, 3
  PackedPrecision precision;
  Columns<std::string> columns;

  template <class Archive>
  void Serialize(Archive& archive) {
    auto& [ids, pose_kinds, values, kinds, last, back, which, scales, couplings, levers, measured] = columns;
    archive(dimension, precision.translation, precision.rotation, ids, pose_kinds, values, kinds, last, back, which,
            scales, couplings, levers, measured);
  }
};

// W with information = W' W, upper triangular, row by row from the last one: its diagonal in octaves, the rest in units
// of how well the row's other coordinate is known, so that a step changes what W makes of a likely deviation by
// kRootStep at most. scale(i) and coupling(i, j, unit, diagonal) are the integers.
template <int N, class Scale, class Coupling>
Matrix<N, N> RootOf(const Scale& scale, const Coupling& coupling) {
  Matrix<N, N> W = Matrix<N, N>::Zero(), inverse = Matrix<N, N>::Zero();
  for (int i = N - 1; i >= 0; --i) {
    W(i, i) = std::exp2(kRootStep * static_cast<double>(scale(i)));
    inverse(i, i) = 1;
    for (int j = i + 1; j < N; ++j) {
      const double unit = kRootStep / inverse.row(j).norm();
      W(i, j) = unit * static_cast<double>(coupling(i, j, unit, W(i, i)));
      inverse.row(i) -= W(i, j) * inverse.row(j);
    }
    inverse.row(i) /= W(i, i);
  }
  return W;
}

template <int N>
Matrix<N, N> InformationOf(const Matrix<N, N>& W) {
  const Matrix<N, N> information = W.transpose() * W;
  return 0.5 * (information + information.transpose());
}

// The matrix as it will be read. Where the diagonal of a row is rounded the whole row goes with it.
template <int N>
Matrix<N, N> PackInformation(const Matrix<N, N>& information, Column& scales, Column& couplings) {
  const Matrix<N, N> W = LowerCholesky<N>(information).transpose();
  const auto scale = [&](int i) { return scales.emplace_back(ToSteps(std::log2(W(i, i)), kRootStep)); };
  const auto coupling = [&](int i, int j, double unit, double diagonal) {
    return couplings.emplace_back(ToSteps(W(i, j) / W(i, i) * diagonal, unit));
  };
  return InformationOf<N>(RootOf<N>(scale, coupling));
}

template <int N>
Matrix<N, N> UnpackInformation(ColumnReader& scales, ColumnReader& couplings) {
  const auto scale = [&](int) { return scales.Next(); };
  const auto coupling = [&](int, int, double, double) { return couplings.Next(); };
  return InformationOf<N>(RootOf<N>(scale, coupling));
}

// The rotation's coordinates, then the translation in the axes that the pose turns to: those that residuals have.
Vector<1> RotationOf(const SE2& T) { return Vector<1>(T.Theta()); }
Vector<3> RotationOf(const SE3& T) { return T.Rotation().Log(); }
SE2 TurnedBy(const Vector<1>& theta, const Vector<2>& translation) { return SE2(translation, theta[0]); }
SE3 TurnedBy(const Vector<3>& phi, const Vector<3>& translation) { return SE3(SO3::Exp(phi), translation); }

// Of a tangent-ordered information matrix: the step of each coordinate. In space one for all three of a rotation, the
// least of theirs: the coordinates of a large rotation lie along other axes than its residual's.
template <int D, int N>
Vector<N> StepsOf(const Matrix<N, N>& information, const PackedPrecision& precision) {
  Vector<N> steps = information.diagonal().cwiseSqrt().cwiseInverse();
  steps.template head<D>() *= precision.translation;
  if constexpr (N > D)
    steps.template tail<N - D>().setConstant(precision.rotation * steps.template tail<N - D>().minCoeff());
  return steps;
}

bool IsPrecision(const PackedPrecision& precision) {
  const auto is_share = [](double p) { return p > 0 && p <= 1; };
  return is_share(precision.translation) && is_share(precision.rotation);
}

template <class Pose>
class Packer {
 public:
  static constexpr int D = Pose::kDim, N = Pose::kDof;
  explicit Packer(const PackedPrecision& precision) : precision_(precision) { columns_.measured.resize(Pose::kDof); }

  PackedGraph Pack(const PoseGraph<Pose>& graph) {
    std::int64_t id = 0;
    for (const auto& pose : graph.Poses()) {
      columns_.ids.push_back(Difference(pose.id.value, std::exchange(id, pose.id.value)));
      const PoseKind kind = !pose.fixed ? kFree : pose.T_world_body ? kFixedAtValue : kFixedSomewhere;
      columns_.pose_kinds.push_back(kind);
      if (kind == kFixedAtValue) AddBits(*pose.T_world_body);
    }
    for (const auto& node : graph.Factors()) {
      try {
        std::visit([&](const auto& factor) { Add(factor, graph); }, node.factor);
      } catch (const std::invalid_argument& error) {
        const FactorPoses poses = PosesOf(node.factor);
        throw NumericalError((poses.count == 2 ? "the edge of " + Name(poses.first) + " and " + Name(poses.second)
                                               : "a prior on " + Name(poses.first)) +
                             " cannot be packed: " + error.what());
      }
      columns_.kinds.push_back(static_cast<std::int64_t>(node.factor.index()));
    }
    return {D, precision_, columns_.template As<std::string>(internal::Deflate)};
  }

 private:
  // Of ids, which may be at both ends of their range.
  static std::int64_t Difference(std::int64_t a, std::int64_t b) {
    return static_cast<std::int64_t>(static_cast<std::uint64_t>(a) - static_cast<std::uint64_t>(b));
  }
  void AddBits(const Pose& T) {
    for (int i = 0; i < D; ++i) columns_.values.push_back(BitsOf(T.Translation()[i]));
    const auto rotation = RotationOf(T);
    for (int i = 0; i < N - D; ++i) columns_.values.push_back(BitsOf(rotation[i]));
  }
  void AddLast(int index) { columns_.last.push_back(index - std::exchange(before_, index)); }
  void Add(const RelativePoseFactor<Pose>& factor, const PoseGraph<Pose>& graph) {
    const int from = graph.IndexOf(factor.from), to = graph.IndexOf(factor.to);
    AddLast(std::max(from, to));
    columns_.back.push_back(to - from);
    AddPose(factor.T_from_to, factor.information);
  }
  void Add(const PosePriorFactor<Pose>& factor, const PoseGraph<Pose>& graph) {
    AddLast(graph.IndexOf(factor.pose));
    AddPose(factor.T_world_body, factor.information);
  }
  void Add(const PositionPriorFactor<Pose>& factor, const PoseGraph<Pose>& graph) {
    AddLast(graph.IndexOf(factor.pose));
    const Vector<D> steps = StepsOf<D, D>(AddInformation<D>(factor.information), precision_);
    for (int i = 0; i < D; ++i) {
      columns_.measured[static_cast<std::size_t>(i)].push_back(ToSteps(factor.p_world[i], steps[i]));
      columns_.levers.push_back(BitsOf(factor.p_body[i]));
    }
  }
  void AddPose(const Pose& T, const Matrix<N, N>& information) {
    const Vector<N> steps = StepsOf<D, N>(AddInformation<N>(information), precision_);
    Vector<N - D> turned = RotationOf(T);
    for (int i = D; i < N; ++i) {
      const std::int64_t count = ToSteps(turned[i - D], steps[i]);
      columns_.measured[static_cast<std::size_t>(i)].push_back(count);
      turned[i - D] = static_cast<double>(count) * steps[i];
    }
    const Vector<D> along = TurnedBy(turned, Vector<D>::Zero()).Inverse() * T.Translation();
    for (int i = 0; i < D; ++i) columns_.measured[static_cast<std::size_t>(i)].push_back(ToSteps(along[i], steps[i]));
  }
  // The matrix as it will be read.
  template <int M>
  Matrix<M, M> AddInformation(const Matrix<M, M>& information) {
    static_assert(M == N || M == D);
    const std::string bits(reinterpret_cast<const char*>(information.data()), sizeof(information));
    const auto add = [&](auto& known) {
      const auto [entry, is_new] = known.try_emplace(bits);
      if (is_new) {
        entry->second = {++matrices_, PackInformation<M>(information, columns_.scales, columns_.couplings)};
        if (!IsDefinite<M>(entry->second.second)) {
          throw std::invalid_argument("its information is too near to one that is not positive definite");
        }
      }
      columns_.which.push_back(is_new ? 0 : entry->second.first);
      return entry->second.second;
    };
    if constexpr (M == N) return add(full_);
    if constexpr (M != N) return add(of_positions_);
  }
  template <int M>
  using Numbered = std::unordered_map<std::string, std::pair<std::int64_t, Matrix<M, M>>>;  // by the bits as stated

  PackedPrecision precision_;
  Columns<Column> columns_;
  int before_ = 0;
  std::int64_t matrices_ = 0;
  Numbered<N> full_;
  Numbered<D> of_positions_;
};

// Throws std::invalid_argument where the columns make no graph.
template <class Pose>
class Unpacker {
 public:
  static constexpr int D = Pose::kDim, N = Pose::kDof;
  explicit Unpacker(const PackedGraph& packed)
      : precision_((RequireSize(packed.columns), packed.precision)),
        columns_(
            packed.columns.template As<ColumnReader>([](const std::string& bytes) { return ColumnReader(bytes); })) {
    if (!IsPrecision(precision_)) throw std::invalid_argument("a precision that is none");
  }

  PoseGraph<Pose> Unpack() {
    std::uint64_t id = 0;
    while (columns_.ids.Left() > 0) {
      id += static_cast<std::uint64_t>(columns_.ids.Next());
      const PoseId pose{static_cast<std::int64_t>(id)};
      poses_.push_back(pose);
      const std::int64_t kind = columns_.pose_kinds.Next();
      if (kind < kFree || kind > kFixedAtValue) throw std::invalid_argument("a kind of pose that there is not");
      graph_.AddPose(pose, kind == kFixedAtValue ? std::optional<Pose>(ValueFromBits()) : std::nullopt);
      graph_.SetFixed(pose, kind != kFree);
    }
    while (columns_.kinds.Left() > 0) {
      switch (columns_.kinds.Next()) {
        case 0: graph_.AddFactor(NextEdge()); break;
        case 1: graph_.AddFactor(NextPosePrior()); break;
        case 2: graph_.AddFactor(NextPositionPrior()); break;
        default: throw std::invalid_argument("a kind of factor that there is not");
      }
    }
    columns_.ForEach([](const ColumnReader& column) { column.Finish(); });
    return std::move(graph_);
  }

 private:
  // Before anything is inflated: a few bytes may stand for more than there is memory.
  static void RequireSize(const Columns<std::string>& packed) {
    if (packed.measured.size() != static_cast<std::size_t>(N)) {
      throw std::invalid_argument("too few columns, or too many");
    }
    constexpr std::uint64_t kBytesOfAPose = 256, kBytesOfAFactor = 1024, kShare = 2;  // of the memory, at most
    std::uint64_t total =
        kBytesOfAPose * internal::InflatedCount(packed.ids) + kBytesOfAFactor * internal::InflatedCount(packed.kinds);
    packed.ForEach(
        [&](const std::string& column) { total += 2 * sizeof(std::int64_t) * internal::InflatedCount(column); });
    if (total > UsableMemory() / kShare) throw std::invalid_argument("it is larger than this machine's memory allows");
  }
  Pose ValueFromBits() {
    Vector<D> translation;
    for (int i = 0; i < D; ++i) translation[i] = OfBits(columns_.values.Next());
    Vector<N - D> rotation;
    for (int i = 0; i < N - D; ++i) rotation[i] = OfBits(columns_.values.Next());
    if (!translation.allFinite() || !rotation.allFinite()) throw std::invalid_argument("a pose that is not finite");
    return TurnedBy(rotation, translation);
  }
  PoseId PoseAt(std::int64_t index) const {
    if (index < 0 || index >= static_cast<std::int64_t>(poses_.size())) {
      throw std::invalid_argument("a pose that there is not");
    }
    return poses_[static_cast<std::size_t>(index)];
  }
  // Wraps around instead of overflowing; PoseAt looks at it.
  std::int64_t NextLast() {
    return static_cast<std::int64_t>(before_ += static_cast<std::uint64_t>(columns_.last.Next()));
  }
  RelativePoseFactor<Pose> NextEdge() {
    RelativePoseFactor<Pose> out;
    const std::int64_t last = NextLast(), back = columns_.back.Next();
    const PoseId later = PoseAt(last);
    if (back > last || back < -last) throw std::invalid_argument("a pose that there is not");
    const PoseId earlier = PoseAt(last - std::abs(back));
    out.from = back < 0 ? later : earlier;
    out.to = back < 0 ? earlier : later;
    out.information = NextInformation<N>(full_);
    out.T_from_to = NextPose(out.information);
    return out;
  }
  PosePriorFactor<Pose> NextPosePrior() {
    PosePriorFactor<Pose> out;
    out.pose = PoseAt(NextLast());
    out.information = NextInformation<N>(full_);
    out.T_world_body = NextPose(out.information);
    return out;
  }
  PositionPriorFactor<Pose> NextPositionPrior() {
    PositionPriorFactor<Pose> out;
    out.pose = PoseAt(NextLast());
    out.information = NextInformation<D>(of_positions_);
    const Vector<D> steps = StepsOf<D, D>(out.information, precision_);
    for (int i = 0; i < D; ++i) {
      out.p_world[i] = static_cast<double>(columns_.measured[static_cast<std::size_t>(i)].Next()) * steps[i];
      out.p_body[i] = OfBits(columns_.levers.Next());
    }
    return out;
  }
  Pose NextPose(const Matrix<N, N>& information) {
    const Vector<N> steps = StepsOf<D, N>(information, precision_);
    Vector<N> x;
    for (int i = 0; i < N; ++i)
      x[i] = static_cast<double>(columns_.measured[static_cast<std::size_t>(i)].Next()) * steps[i];
    if (!x.allFinite()) throw std::invalid_argument("a measurement that is not finite");
    const Vector<N - D> rotation = x.template tail<N - D>();
    const Pose turn = TurnedBy(rotation, Vector<D>::Zero());
    return TurnedBy(rotation, turn * Vector<D>(x.template head<D>()));
  }
  template <int M>
  using Matrices = std::unordered_map<std::int64_t, Matrix<M, M>>;  // by number, over both sizes
  template <int M>
  Matrix<M, M> NextInformation(Matrices<M>& known) {
    const std::int64_t number = columns_.which.Next();
    if (number == 0) return known[++matrices_] = UnpackInformation<M>(columns_.scales, columns_.couplings);
    const auto found = known.find(number);
    if (found == known.end()) throw std::invalid_argument("an information matrix that there is not");
    return found->second;
  }

  PackedPrecision precision_;
  Columns<ColumnReader> columns_;
  std::vector<PoseId> poses_;
  std::uint64_t before_ = 0;
  std::int64_t matrices_ = 0;
  Matrices<Pose::kDof> full_;
  Matrices<Pose::kDim> of_positions_;
  PoseGraph<Pose> graph_;
};

constexpr const char* kPackedKind = "packed graph";

template <class Pose>
PoseGraph<Pose> Unpacked(const PackedGraph& packed, const std::string& path, const ReadOptions& options) {
  PoseGraph<Pose> graph;
  try {
    graph = Unpacker<Pose>(packed).Unpack();
  } catch (const std::invalid_argument& error) {
    throw FileError(path, 0, std::string("the packed graph makes no sense: ") + error.what());
  }
  if (options.expect_connected) ExpectConnected(graph, path);
  return graph;
}

}  // namespace

bool LooksPacked(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error)) return false;
  std::ifstream file(path, std::ios::binary);
  std::string start(std::strlen(kStateMagic), '\0');
  return file.read(start.data(), static_cast<std::streamsize>(start.size())) && start == kStateMagic;
}

GraphFile ReadPacked(const std::string& path, const ReadOptions& options) {
  const PackedGraph packed = LoadState<PackedGraph>(path, kPackedKind);
  GraphFile out;
  out.format = GraphFormat::kPacked;
  if (packed.dimension == SE2::kDim) {
    out.graph = Unpacked<SE2>(packed, path, options);
  } else if (packed.dimension == SE3::kDim) {
    out.graph = Unpacked<SE3>(packed, path, options);
  } else {
    throw FileError(path, 0,
                    "the packed graph makes no sense: it has " + std::to_string(packed.dimension) + " dimensions");
  }
  return out;
}

template <class Pose>
void WritePacked(const PoseGraph<Pose>& graph, const std::string& path, const PackedPrecision& precision) {
  if (!IsPrecision(precision)) {
    throw std::invalid_argument(
        "the precision of a packed graph is a share of a standard deviation, above 0 and up to 1");
  }
  SaveState(path, kPackedKind, Packer<Pose>(precision).Pack(graph));
}
template void WritePacked<SE2>(const PoseGraph<SE2>&, const std::string&, const PackedPrecision&);
template void WritePacked<SE3>(const PoseGraph<SE3>&, const std::string&, const PackedPrecision&);

}  // namespace terse
