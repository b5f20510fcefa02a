#include "terse/distributed/graph_share.h"

#include <algorithm>
#include <unordered_map>
#include <unordered_set>
#include <utility>

#include "files/read_graph.h"
#include "terse/core/atomic_file.h"
#include "terse/core/disjoint_sets.h"
#include "terse/core/gauge.h"
#include "terse/core/line_stream.h"
#include "terse/core/linear_factor.h"
#include "terse/core/measurement_line.h"
#include "terse/core/pose_name.h"
#include "terse/core/vertex_line.h"

namespace terse {
namespace {

template <class Pose>
class ShareReader {
 public:
  ShareReader(const std::string& path, int rank, int ranks, const ReadOptions& options)
      : path_(path), lines_(path), fields_(path_), reader_(path, options), rank_(rank), ranks_(ranks) {}

  GraphShare<Pose> Read() && {
    ReadPoses();
    ExpectConnected();
    const auto poses = static_cast<std::int64_t>(share_.ids.size());
    share_.begin = static_cast<int>(poses * rank_ / ranks_);
    share_.end = static_cast<int>(poses * (rank_ + 1) / ranks_);
    ReadMeasurements();
    share_.file = lines_.File().Version();
    return std::move(share_);
  }

 private:
  // The layout of the line's tag; nullptr for one that is skipped.
  const TagLayout* Split(const TextLine& line) {
    fields_.Split(line);
    const std::string_view tag = fields_.Text(0);
    const TagLayout* layout = FindLayout(tag);
    if (layout == nullptr) {
      if (!IsTag(tag)) throw fields_.Error("expected a tag, the line starts with " + Quoted(tag));
      return nullptr;
    }
    if (layout->family != TagFamily::kG2o) {
      throw fields_.Error(std::string(tag) + " is of another format, expected g2o; `terse convert` makes it");
    }
    if (layout->dimension != 0 && layout->dimension != Pose::kDim) {
      throw fields_.Error("the file mixes 2D and 3D, expected one kind in a file");
    }
    ExpectFields(fields_, *layout);
    return layout;
  }

  void ReadPoses() {
    for (TextLine line; lines_.Next(line);) {
      const TagLayout* layout = Split(line);
      if (layout == nullptr) {
        ++share_.skipped_tags[std::string(fields_.Text(0))];
        const bool is_vertex = fields_.Text(0).substr(0, 6) == "VERTEX" && fields_.Count() > 1;
        if (is_vertex && IsNumber(fields_.Text(1))) other_vertices_.insert(IdField(fields_, 1).value);
      } else if (layout->kind == TagKind::kVertex) {
        const auto vertex = std::get<VertexLine<Pose>>(reader_.Read(line.text, line.number));
        if (!AddPose(vertex.id, vertex.T_world_body)) {
          throw fields_.Error("a second vertex line of " + Name(vertex.id) + ", expected one at most");
        }
      } else if (layout->kind == TagKind::kOffset) {
        reader_.Read(line.text, line.number);
      } else if (layout->kind == TagKind::kEdge) {
        ends_.emplace_back(IdField(fields_, 1, "from"), IdField(fields_, 2, "to"));
      }
    }
    for (const auto& [from, to] : ends_) {
      AddPose(from, std::nullopt);
      AddPose(to, std::nullopt);
    }
    share_.edges = static_cast<long>(ends_.size());
    share_.scalars = share_.edges * Pose::kDof;
    if (share_.ids.empty()) throw FileError(path_, 0, "the file holds no poses, expected a g2o graph");
  }

  bool AddPose(PoseId id, const std::optional<Pose>& T_world_body) {
    if (!index_.emplace(id.value, static_cast<int>(share_.ids.size())).second) return false;
    share_.ids.push_back(id);
    share_.T_world_body.push_back(T_world_body);
    return true;
  }

  void ExpectConnected() {
    internal::DisjointSets sets(share_.ids.size());
    std::size_t parts = share_.ids.size();
    for (const auto& [from, to] : ends_) {
      parts -=
          sets.Join(static_cast<std::size_t>(index_.at(from.value)), static_cast<std::size_t>(index_.at(to.value)));
    }
    std::vector<std::pair<PoseId, PoseId>>().swap(ends_);
    if (parts == 1) return;
    throw FileError(path_, 0, "the graph falls into " + std::to_string(parts) + " components; expected one");
  }

  // Throws unless a vertex or an edge names the pose.
  int IndexOf(PoseId id, const char* what) const {
    const auto found = index_.find(id.value);
    if (found != index_.end()) return found->second;
    throw fields_.Error(what + Name(id) + ", which no vertex and no edge names; expected a line that does");
  }

  void ReadMeasurements() {
    lines_.Rewind();
    std::vector<char> is_fixed(share_.ids.size(), 0);
    for (TextLine line; lines_.Next(line);) {
      const TagLayout* layout = Split(line);
      if (layout == nullptr || layout->kind == TagKind::kVertex || layout->kind == TagKind::kOffset) continue;
      if (layout->kind == TagKind::kFix) {
        MarkFixed(is_fixed);
      } else if (layout->kind == TagKind::kEdge) {
        const int first = index_.at(IdField(fields_, 1).value), second = index_.at(IdField(fields_, 2).value);
        if (!share_.Owns(first) && !share_.Owns(second)) continue;
        share_.relative.push_back({std::get<Factor<Pose>>(reader_.Read(line.text, line.number)), first, second});
      } else {
        const Factor<Pose> factor = std::get<Factor<Pose>>(reader_.Read(line.text, line.number));
        const int pose = IndexOf(PosesOf(factor).first, "a prior on ");
        share_.absolute.push_back({factor, pose, pose});
        share_.scalars += Dimension(factor);
      }
    }
    for (std::size_t k = 0; k < is_fixed.size(); ++k) {
      if (!is_fixed[k] || !share_.T_world_body[k]) continue;
      const int pose = static_cast<int>(k);
      share_.fixed.push_back({FixedPosePrior<Pose>(share_.ids[k], *share_.T_world_body[k]), pose, pose});
    }
  }

  void MarkFixed(std::vector<char>& is_fixed) {
    for (int i = 1; i < fields_.Count(); ++i) {
      const PoseId id = IdField(fields_, i);
      if (index_.count(id.value) == 0 && other_vertices_.count(id.value) != 0) continue;
      is_fixed[static_cast<std::size_t>(IndexOf(id, "FIX of "))] = 1;
    }
  }

  std::string path_;
  LineStream lines_;
  Fields fields_;
  MeasurementLineReader<Pose> reader_;
  int rank_, ranks_;
  GraphShare<Pose> share_;
  std::unordered_map<std::int64_t, int> index_;
  std::unordered_set<std::int64_t> other_vertices_;  // of kinds that are not read
  std::vector<std::pair<PoseId, PoseId>> ends_;
};

}  // namespace

int DimensionOfG2o(const std::string& path) {
  LineStream lines(path);
  for (TextLine line; lines.Next(line);) {
    const int dimension = DimensionOfLine(line.text);
    if (dimension != 0) return dimension;
  }
  throw FileError(
      path, 0,
      "no line is of the g2o format, expected a graph; `terse convert` makes one of TORO, iSAM and packed ones");
}

template <class Pose>
GraphShare<Pose> ReadShare(const std::string& path, int rank, int ranks, const ReadOptions& options) {
  return ShareReader<Pose>(path, rank, ranks, options).Read();
}

template <class Pose>
std::vector<std::pair<int, int>> NeighboursOf(const GraphShare<Pose>& share) {
  std::vector<std::pair<int, int>> pairs;
  for (const auto& term : share.relative) {
    if (share.Owns(term.first)) pairs.emplace_back(term.first, term.second);
    if (share.Owns(term.second)) pairs.emplace_back(term.second, term.first);
  }
  return pairs;
}

template <class Pose>
void CopyG2o(const std::string& path, const GraphShare<Pose>& share, const std::vector<Pose>& T_world_body,
             const std::string& output) {
  LineStream lines(path);
  lines.File().ExpectUnchanged(share.file);
  AtomicFile file(output);
  for (std::size_t k = 0; k < share.ids.size(); ++k) WriteVertexLine(share.ids[k], T_world_body[k], file.Stream());
  for (TextLine line; lines.Next(line);) {
    const TagLayout* layout = FindLayout(FirstField(line.text));
    if (layout == nullptr || layout->kind != TagKind::kVertex) file.Stream() << line.text << '\n';
  }
  file.Commit();
}

#define TERSE_INSTANTIATE(Pose)                                                                      \
  template GraphShare<Pose> ReadShare<Pose>(const std::string&, int, int, const ReadOptions&);       \
  template std::vector<std::pair<int, int>> NeighboursOf<Pose>(const GraphShare<Pose>&);             \
  template void CopyG2o<Pose>(const std::string&, const GraphShare<Pose>&, const std::vector<Pose>&, \
                              const std::string&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
