// Saved states: of solvers and of compact maps, 2D and 3D. The first byte of an input says which, and what the rest is:
// the file; its members, to which a header and a right checksum are added; or changes to the members of a state that
// was saved. What loads must save again, to the same bytes, and answer questions.

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>

#include "fuzzing.h"
#include "terse/compact/compact_pose_slam.h"
#include "terse/core/state_file.h"

namespace terse::fuzz {
namespace {

template <class Pose>
RelativePoseFactor<Pose> Edge(std::int64_t from, std::int64_t to) {
  Vector<Pose::kDof> d = Vector<Pose::kDof>::Constant(0.05);
  d[0] = static_cast<double>(to - from);
  return {{from}, {to}, Pose::Exp(d), 100 * Pose::Jacobian::Identity()};
}

template <class Pose>
void SaveSolver(const std::string& path, bool robust) {
  IncrementalOptions options;
  if (robust) options.robust.kernel = RobustKernel::kHuber;
  IncrementalSolver<Pose> solver(options);
  solver.Update({{{{0}}}, {}, {}});
  for (std::int64_t k = 1; k < 6; ++k) {
    GraphUpdate<Pose> update{{{{k}}}, {Edge<Pose>(k - 1, k)}, {}};
    if (k == 4) update.factors.push_back(Edge<Pose>(0, k));
    if (k == 5) {
      const typename Pose::Position p = Pose::Position::Constant(2);
      update.factors.push_back(PositionPriorFactor<Pose>{{k}, p, Matrix<Pose::kDim, Pose::kDim>::Identity()});
    }
    solver.Update(update);
  }
  solver.Save(path);
}

template <class Pose>
void SaveMap(const std::string& path, Strategy strategy) {
  CompactOptions<Pose> options;
  options.strategy = strategy;
  options.thresholds.range.setConstant(3);
  CompactPoseSlam<Pose> slam(options);
  for (std::int64_t k = 0; k < 8; ++k) {
    CompactInput<Pose> input;
    input.id = {k};
    if (k > 0) input.odometry = Edge<Pose>(k - 1, k);
    if (k == 6) input.loops = std::vector<RelativePoseFactor<Pose>>{Edge<Pose>(6, 1)};
    slam.AddPose(input);
  }
  slam.Save(path);
}

// A question to what was loaded; then it is saved again.
template <class Pose>
void Use(const IncrementalSolver<Pose>& solver) {
  solver.Chi2();
  solver.DescribeUndetermined();
  solver.Estimates();
}
template <class Pose>
void Use(const CompactPoseSlam<Pose>& slam) {
  slam.Export();
  Use(slam.Solver());
}

constexpr std::int64_t kNext = 1000;  // the id of a pose that no state has

template <class Pose>
void GoOn(IncrementalSolver<Pose>& solver) {
  if (solver.Graph().Poses().empty()) return;
  const std::int64_t last = solver.Graph().Poses().back().id.value;
  RelativePoseFactor<Pose> edge = Edge<Pose>(0, 1);
  edge.from = {last};
  edge.to = {kNext};
  solver.Update({{{{kNext}}}, {edge}, {}});
  solver.Finish();
}
template <class Pose>
void GoOn(CompactPoseSlam<Pose>& slam) {
  CompactInput<Pose> input;
  input.id = {kNext};
  input.odometry = Edge<Pose>(7, 8);
  input.odometry->to = {kNext};
  slam.AddPose(input);
  slam.Finish();
}

struct Kind {
  std::string name;
  std::vector<std::string> members;  // of states that were saved
  void (*load)(const std::string& path, const std::string& again);
};

template <class Object>
void Load(const std::string& path, const std::string& again) {
  Done([&] {
    Object loaded = Object::Load(path);
    Use(loaded);
    loaded.Save(again);
    GoOn(loaded);
  });
}

constexpr std::size_t kMagic = sizeof(kStateMagic) - 1;

template <class T>
T NumberAt(const std::string& bytes, std::size_t at) {
  T number;
  std::memcpy(&number, bytes.data() + at, sizeof number);
  return number;
}
template <class T>
void Append(std::string& bytes, T number) {
  bytes.append(reinterpret_cast<const char*>(&number), sizeof number);
}

// As state_file.h describes it.
std::string WithHeader(const std::string& kind, const std::string& members) {
  std::string out(kStateMagic, kMagic);
  Append(out, kStateFormat);
  Append(out, static_cast<std::uint32_t>(kind.size()));
  out += kind;
  Append(out, static_cast<std::uint64_t>(members.size()));
  out += members;
  std::uint64_t hash = 0xcbf29ce484222325;
  for (const char c : out) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3;
  Append(out, hash);
  return out;
}

class Fuzzer {
 public:
  Fuzzer() {
    AddKinds<SE2>();
    AddKinds<SE3>();
  }
  void Run(const std::uint8_t* data, std::size_t size) {
    if (size == 0) return;
    const Kind& kind = kinds_[data[0] % kinds_.size()];
    const std::size_t variant = data[0] / kinds_.size();
    const std::string rest(AsText(data + 1, size - 1));
    std::string bytes = rest;
    if (variant % 4 == 1) bytes = WithHeader(kind.name, rest);
    if (variant % 4 >= 2) bytes = WithHeader(kind.name, Changed(kind.members[variant / 4 % kind.members.size()], rest));
    kind.load(file_.With(bytes), folder_.Path("again.state"));
  }

 private:
  template <class Pose>
  void AddKinds() {
    const std::string path = folder_.Path("seed.state");
    SaveSolver<Pose>(path, false);
    AddKind(path, &Load<IncrementalSolver<Pose>>);
    SaveSolver<Pose>(path, true);
    AddMembers(path);
    SaveMap<Pose>(path, Strategy::kFpfl);
    AddKind(path, &Load<CompactPoseSlam<Pose>>);
    SaveMap<Pose>(path, Strategy::kApal);
    AddMembers(path);
  }
  void AddKind(const std::string& path, void (*load)(const std::string&, const std::string&)) {
    const std::string bytes = Content(path);
    kinds_.push_back({bytes.substr(kMagic + 8, NumberAt<std::uint32_t>(bytes, kMagic + 4)), {}, load});
    AddMembers(path);
  }
  void AddMembers(const std::string& path) {
    const std::string bytes = Content(path);
    const std::size_t begin = kMagic + 8 + kinds_.back().name.size() + 8;
    kinds_.back().members.push_back(bytes.substr(begin, bytes.size() - begin - 8));
    Expect(WithHeader(kinds_.back().name, kinds_.back().members.back()) == bytes, "the layout of state_file.h");
  }
  // Eight bytes per change: what, how much, where (u32), and a number (u16).
  static std::string Changed(std::string bytes, std::string_view changes) {
    constexpr std::size_t kChange = 8;
    for (; changes.size() >= kChange && !bytes.empty(); changes.remove_prefix(kChange)) {
      const std::string change(changes.substr(0, kChange));
      const std::size_t at = NumberAt<std::uint32_t>(change, 2) % bytes.size();
      const auto number = NumberAt<std::int16_t>(change, 6);
      const auto amount = static_cast<unsigned char>(change[1]);
      const std::size_t left = bytes.size() - at;
      switch (static_cast<unsigned char>(change[0]) % 8) {
        case 0: bytes[at] = static_cast<char>(amount); break;
        case 1: Overwrite(bytes, at, static_cast<std::int64_t>(number)); break;
        case 2: Overwrite(bytes, at, static_cast<std::int32_t>(number)); break;
        case 3: Overwrite(bytes, at, Extreme(amount)); break;
        case 4: bytes.erase(at, std::min<std::size_t>(left, amount)); break;
        case 5: bytes.insert(at, std::string(amount, static_cast<char>(number))); break;
        case 6: bytes.insert(at, bytes.substr(at, amount)); break;
        default: Overwrite(bytes, at, static_cast<double>(number)); break;
      }
    }
    return bytes;
  }
  template <class T>
  static void Overwrite(std::string& bytes, std::size_t at, T number) {
    std::memcpy(bytes.data() + at, &number, std::min(sizeof number, bytes.size() - at));
  }
  static double Extreme(unsigned char which) {
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
    constexpr std::array<double, 10> kNumbers = {kInfinity, -kInfinity, kNan,  1e308, -1e308,
                                                 1e-308,    5e-324,     1e160, -0.0,  -1};
    return kNumbers[which % kNumbers.size()];
  }

  InputFile file_;
  ScratchFolder folder_;
  std::vector<Kind> kinds_;
};

}  // namespace
}  // namespace terse::fuzz

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static terse::fuzz::Fuzzer fuzzer;
  fuzzer.Run(data, size);
  return 0;
}
