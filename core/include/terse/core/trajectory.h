#pragma once
// Trajectories as KITTI and TUM files and as the vertices of a graph.

#include <string>
#include <vector>

#include "terse/core/error.h"
#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse {

enum class TrajectoryFormat { kTum, kKitti, kGraph };

// One pose T_world_body per stamp, ascending. Stamps are seconds (TUM), line numbers from 0 (KITTI) or
// pose ids (graph). 2D poses lie in the plane z = 0.
struct Trajectory {
  TrajectoryFormat format = TrajectoryFormat::kTum;
  std::vector<double> stamps;
  std::vector<SE3> T_world_body;
};

// [x y theta] as a rigid motion in space about the z axis.
SE3 Lift(const SE2& T_a_b);

// The format is detected from the content: 8 numbers a line (TUM: stamp x y z qx qy qz qw), 12 (KITTI: the
// first three rows of the matrix), or any graph file that ReadGraph accepts and that has vertex values.
// Throws FileError with line and cause.
Trajectory ReadTrajectory(const std::string& path);

// Written to a temporary file in the same folder, then renamed. Throws FileError.
void WriteTum(const Trajectory& trajectory, const std::string& path);
void WriteKitti(const Trajectory& trajectory, const std::string& path);

}  // namespace terse
