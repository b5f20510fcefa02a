#pragma once
// Links between maps as a text file: lines of g2o, EDGE_SE2 or EDGE_SE3:QUAT, whose two poses say which map they are
// of: "EDGE_SE2 2:17 1:240 dx dy dtheta ..." measures pose 240 of the first map from pose 17 of the second. Maps count
// from 1, in the order in which they are given. A number without a map is the pose of that id in the only map that has
// it. Blank lines and comments (#) are skipped.

#include <string>
#include <string_view>
#include <vector>

#include "terse/compact/merge.h"
#include "terse/core/graph_file.h"
#include "terse/core/measurement_line.h"
#include "terse/covariance/information_scale.h"

namespace terse {

// The lines of such a file one at a time, with the ends as words, whatever they mean.
template <class Pose>
class NamedEdgeReader {
 public:
  struct Edge {
    std::string from, to;
    RelativePoseFactor<Pose> measured;  // but for its ends
  };
  // `source`: the name for messages.
  explicit NamedEdgeReader(const std::string& source, const ReadOptions& options = {});
  // Throws FileError for another line, or what MeasurementLineReader refuses.
  Edge Read(std::string_view text, long number);

 private:
  std::string source_;
  MeasurementLineReader<Pose> lines_;
};

// `maps`: what the file is for. Throws FileError with file, line and cause: another line, an unknown map or pose, a
// pose without a map that several have, a link within one map, or what MeasurementLineReader refuses.
template <class Pose>
std::vector<MapLink<Pose>> ReadMapLinks(const std::string& path, const std::vector<MapToMerge<Pose>>& maps,
                                        const ReadOptions& options = {});

// Where the measurements of maps were scaled, links are to be scaled likewise: sensors of both robots make a link, so
// its variances grow by the mean of the two maps' factors on those of loops. `scales`: by map.
template <class Pose>
std::vector<MapLink<Pose>> ScaleMapLinks(std::vector<MapLink<Pose>> links, const std::vector<InformationScale>& scales);

}  // namespace terse
