#include "files/packed_graph.h"

#include <Eigen/Cholesky>
#include <array>
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

// In the file, each as Deflate makes it. Columns of several numbers a row have them one after the other.
struct PackedGraph {
  int dimension = 0;  // 2, 3
  PackedPrecision precision;
  std::string ids;                // of poses, each less the one before
  std::string pose_kinds;         // see PoseKind
  std::string values;             // of fixed poses: bits of the translation, then of the rotation's coordinates
  std::string kinds;              // of factors: index of the variant
  std::string last;               // index of a factor's later pose, less that of the factor before
  std::string back;               // of edges: how much earlier the other pose is; below zero: the later pose is `from`
  std::string which;              // information: 0 a new one, k the k-th new one once more
  std::string scales, couplings;  // of new ones, see RootOf
  std::string levers;             // of position priors: bits
  std::vector<std::string> measured;  // by coordinate, in steps

  template <class Archive>
  void Serialize(Archive& archive) {
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
  const Matrix<N, N> W = information.llt().matrixU();
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
  explicit Packer(const PackedPrecision& precision) : precision_(precision) {}

  PackedGraph Pack(const PoseGraph<Pose>& graph) {
    std::int64_t id = 0;
    for (const auto& pose : graph.Poses()) {
      ids_.push_back(Difference(pose.id.value, std::exchange(id, pose.id.value)));
      const PoseKind kind = !pose.fixed ? kFree : pose.T_world_body ? kFixedAtValue : kFixedSomewhere;
      pose_kinds_.push_back(kind);
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
      kinds_.push_back(static_cast<std::int64_t>(node.factor.index()));
    }
    PackedGraph out;
    out.dimension = D;
    out.precision = precision_;
    const std::pair<std::string*, const Column*> columns[] = {{&out.ids, &ids_},
                                                              {&out.pose_kinds, &pose_kinds_},
                                                              {&out.values, &values_},
                                                              {&out.kinds, &kinds_},
                                                              {&out.last, &last_},
                                                              {&out.back, &back_},
                                                              {&out.which, &which_},
                                                              {&out.scales, &scales_},
                                                              {&out.couplings, &couplings_},
                                                              {&out.levers, &levers_}};
    for (const auto& [bytes, column] : columns) *bytes = internal::Deflate(*column);
    for (const Column& column : measured_) out.measured.push_back(internal::Deflate(column));
    return out;
  }

 private:
  // Of ids, which may be at both ends of their range.
  static std::int64_t Difference(std::int64_t a, std::int64_t b) {
    return static_cast<std::int64_t>(static_cast<std::uint64_t>(a) - static_cast<std::uint64_t>(b));
  }
  void AddBits(const Pose& T) {
    for (int i = 0; i < D; ++i) values_.push_back(BitsOf(T.Translation()[i]));
    const auto rotation = RotationOf(T);
    for (int i = 0; i < N - D; ++i) values_.push_back(BitsOf(rotation[i]));
  }
  void AddLast(int index) { last_.push_back(index - std::exchange(before_, index)); }
  void Add(const RelativePoseFactor<Pose>& factor, const PoseGraph<Pose>& graph) {
    const int from = graph.IndexOf(factor.from), to = graph.IndexOf(factor.to);
    AddLast(std::max(from, to));
    back_.push_back(to - from);
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
      measured_[static_cast<std::size_t>(i)].push_back(ToSteps(factor.p_world[i], steps[i]));
      levers_.push_back(BitsOf(factor.p_body[i]));
    }
  }
  void AddPose(const Pose& T, const Matrix<N, N>& information) {
    const Vector<N> steps = StepsOf<D, N>(AddInformation<N>(information), precision_);
    Vector<N - D> turned = RotationOf(T);
    for (int i = D; i < N; ++i) {
      const std::int64_t count = ToSteps(turned[i - D], steps[i]);
      measured_[static_cast<std::size_t>(i)].push_back(count);
      turned[i - D] = static_cast<double>(count) * steps[i];
    }
    const Vector<D> along = TurnedBy(turned, Vector<D>::Zero()).Inverse() * T.Translation();
    for (int i = 0; i < D; ++i) measured_[static_cast<std::size_t>(i)].push_back(ToSteps(along[i], steps[i]));
  }
  // The matrix as it will be read.
  template <int M>
  Matrix<M, M> AddInformation(const Matrix<M, M>& information) {
    static_assert(M == N || M == D);
    const std::string bits(reinterpret_cast<const char*>(information.data()), sizeof(information));
    const auto add = [&](auto& known) {
      const auto [entry, is_new] = known.try_emplace(bits);
      if (is_new) {
        entry->second = {++matrices_, PackInformation<M>(information, scales_, couplings_)};
        if (!IsDefinite<M>(entry->second.second)) {
          throw std::invalid_argument("its information is too near to one that is not positive definite");
        }
      }
      which_.push_back(is_new ? 0 : entry->second.first);
      return entry->second.second;
    };
    if constexpr (M == N) return add(full_);
    if constexpr (M != N) return add(of_positions_);
  }
  template <int M>
  using Numbered = std::unordered_map<std::string, std::pair<std::int64_t, Matrix<M, M>>>;  // by the bits as stated

  PackedPrecision precision_;
  Column ids_, pose_kinds_, values_, kinds_, last_, back_, which_, scales_, couplings_, levers_;
  std::array<Column, Pose::kDof> measured_;
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
      : precision_((RequireSize(packed), packed.precision)),
        ids_(packed.ids),
        pose_kinds_(packed.pose_kinds),
        values_(packed.values),
        kinds_(packed.kinds),
        last_(packed.last),
        back_(packed.back),
        which_(packed.which),
        scales_(packed.scales),
        couplings_(packed.couplings),
        levers_(packed.levers),
        measured_(packed.measured.begin(), packed.measured.end()) {
    if (!IsPrecision(precision_)) throw std::invalid_argument("a precision that is none");
  }

  PoseGraph<Pose> Unpack() {
    std::uint64_t id = 0;
    while (ids_.Left() > 0) {
      id += static_cast<std::uint64_t>(ids_.Next());
      const PoseId pose{static_cast<std::int64_t>(id)};
      poses_.push_back(pose);
      const std::int64_t kind = pose_kinds_.Next();
      if (kind < kFree || kind > kFixedAtValue) throw std::invalid_argument("a kind of pose that there is not");
      graph_.AddPose(pose, kind == kFixedAtValue ? std::optional<Pose>(ValueFromBits()) : std::nullopt);
      graph_.SetFixed(pose, kind != kFree);
    }
    while (kinds_.Left() > 0) {
      switch (kinds_.Next()) {
        case 0: graph_.AddFactor(NextEdge()); break;
        case 1: graph_.AddFactor(NextPosePrior()); break;
        case 2: graph_.AddFactor(NextPositionPrior()); break;
        default: throw std::invalid_argument("a kind of factor that there is not");
      }
    }
    for (const ColumnReader* column :
         {&pose_kinds_, &values_, &last_, &back_, &which_, &scales_, &couplings_, &levers_}) {
      column->Finish();
    }
    for (const ColumnReader& column : measured_) column.Finish();
    return std::move(graph_);
  }

 private:
  // Before anything is inflated: a few bytes may stand for more than there is memory.
  static void RequireSize(const PackedGraph& packed) {
    if (packed.measured.size() != static_cast<std::size_t>(N)) {
      throw std::invalid_argument("too few columns, or too many");
    }
    constexpr std::uint64_t kBytesOfAPose = 256, kBytesOfAFactor = 1024, kShare = 2;  // of the memory, at most
    const auto bytes = [](const std::string& column, std::uint64_t each) {
      return internal::InflatedCount(column) * (2 * sizeof(std::int64_t) + each);
    };
    std::uint64_t total = bytes(packed.ids, kBytesOfAPose) + bytes(packed.kinds, kBytesOfAFactor);
    for (const std::string* column : {&packed.pose_kinds, &packed.values, &packed.last, &packed.back, &packed.which,
                                      &packed.scales, &packed.couplings, &packed.levers}) {
      total += bytes(*column, 0);
    }
    for (const std::string& column : packed.measured) total += bytes(column, 0);
    if (total > UsableMemory() / kShare) throw std::invalid_argument("it is larger than this machine's memory allows");
  }
  Pose ValueFromBits() {
    Vector<D> translation;
    for (int i = 0; i < D; ++i) translation[i] = OfBits(values_.Next());
    Vector<N - D> rotation;
    for (int i = 0; i < N - D; ++i) rotation[i] = OfBits(values_.Next());
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
  std::int64_t NextLast() { return static_cast<std::int64_t>(before_ += static_cast<std::uint64_t>(last_.Next())); }
  RelativePoseFactor<Pose> NextEdge() {
    RelativePoseFactor<Pose> out;
    const std::int64_t last = NextLast(), back = back_.Next();
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
      out.p_world[i] = static_cast<double>(measured_[static_cast<std::size_t>(i)].Next()) * steps[i];
      out.p_body[i] = OfBits(levers_.Next());
    }
    return out;
  }
  Pose NextPose(const Matrix<N, N>& information) {
    const Vector<N> steps = StepsOf<D, N>(information, precision_);
    Vector<N> x;
    for (int i = 0; i < N; ++i) x[i] = static_cast<double>(measured_[static_cast<std::size_t>(i)].Next()) * steps[i];
    if (!x.allFinite()) throw std::invalid_argument("a measurement that is not finite");
    const Vector<N - D> rotation = x.template tail<N - D>();
    const Pose turn = TurnedBy(rotation, Vector<D>::Zero());
    return TurnedBy(rotation, turn * Vector<D>(x.template head<D>()));
  }
  template <int M>
  using Matrices = std::unordered_map<std::int64_t, Matrix<M, M>>;  // by number, over both sizes
  template <int M>
  Matrix<M, M> NextInformation(Matrices<M>& known) {
    const std::int64_t number = which_.Next();
    if (number == 0) return known[++matrices_] = UnpackInformation<M>(scales_, couplings_);
    const auto found = known.find(number);
    if (found == known.end()) throw std::invalid_argument("an information matrix that there is not");
    return found->second;
  }

  PackedPrecision precision_;
  ColumnReader ids_, pose_kinds_, values_, kinds_, last_, back_, which_, scales_, couplings_, levers_;
  std::vector<ColumnReader> measured_;
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
