#pragma once
// One rank's share of a pose graph: an unbroken range of the poses, and the measurements that touch them.
//
// The file is read line by line, twice, and never held whole. Every rank knows the ids and values of all poses (some
// 100 bytes each in space) and all absolute measurements, which together fix the gauge; relative ones only where they
// touch the share: those with an end in each of two shares are known to both.

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "terse/core/file_version.h"
#include "terse/core/graph_file.h"

namespace terse {

template <class Pose>
struct ShareTerm {
  Factor<Pose> factor;
  int first = -1, second = -1;  // pose indices; the same for a prior
};

template <class Pose>
struct GraphShare {
  std::vector<PoseId> ids;                        // of the whole graph, in the order of ReadGraph
  std::vector<std::optional<Pose>> T_world_body;  // the file's values
  int begin = 0, end = 0;                         // own poses
  std::vector<ShareTerm<Pose>> relative;          // with an end in the share, in the order of the file
  std::vector<ShareTerm<Pose>> absolute;          // of the whole graph
  std::vector<ShareTerm<Pose>> fixed;             // of the whole graph: FIXed poses as priors, not counted in chi2
  long edges = 0;                                 // of the whole graph
  long scalars = 0;                               // that its measurements measure
  std::map<std::string, long> skipped_tags;
  FileVersion file;  // that it was read from

  bool Owns(int pose) const { return begin <= pose && pose < end; }
};

// 2 or 3, by the first line that tells. Throws FileError if none does.
int DimensionOfG2o(const std::string& path);

// The share of rank `rank` of `ranks`. Throws FileError for what ReadGraph refuses in a g2o file, of relative
// measurements within the share only, and for files of other formats.
template <class Pose>
GraphShare<Pose> ReadShare(const std::string& path, int rank, int ranks, const ReadOptions& options = {});

// For every relative measurement and each of its ends in the share: that end and the other one.
template <class Pose>
std::vector<std::pair<int, int>> NeighboursOf(const GraphShare<Pose>& share);

// A copy of the g2o file that the share was read from, with these values of the poses, by index: vertex lines first,
// the others as they are. Throws FileError, also if the file is another one by now.
template <class Pose>
void CopyG2o(const std::string& path, const GraphShare<Pose>& share, const std::vector<Pose>& T_world_body,
             const std::string& output);

}  // namespace terse
