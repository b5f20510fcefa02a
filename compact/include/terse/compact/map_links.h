#pragma once
// Links between maps as a text file: lines of g2o, EDGE_SE2 or EDGE_SE3:QUAT, whose two poses say which map they are
// of: "EDGE_SE2 2:17 1:240 dx dy dtheta ..." measures pose 240 of the first map from pose 17 of the second. Maps count
// from 1, in the order in which they are given. A number without a map is the pose of that id in the only map that has
// it. Blank lines and comments (#) are skipped.

#include <string>
#include <vector>

#include "terse/compact/merge.h"
#include "terse/core/graph_file.h"

namespace terse {

// `maps`: what the file is for. Throws FileError with file, line and cause: another line, an unknown map or pose, a
// pose without a map that several have, a link within one map, or what MeasurementLineReader refuses.
template <class Pose>
std::vector<MapLink<Pose>> ReadMapLinks(const std::string& path, const std::vector<MapToMerge<Pose>>& maps,
                                        const ReadOptions& options = {});

}  // namespace terse
