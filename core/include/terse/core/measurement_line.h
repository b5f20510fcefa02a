#pragma once
// Lines of the g2o format one at a time, as a robot sends them. Whole files go through the same parser (graph_file.h
// lists the tags).

#include <map>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "terse/core/graph_file.h"

namespace terse {

template <class Pose>
struct VertexLine {
  PoseId id;
  Pose T_world_body;
};
struct FixLine {
  std::vector<PoseId> poses;
};
// PARAMS_SE3OFFSET: where the sensor sits that priors name by this id (see graph_file.h).
struct SensorOffsetLine {
  std::int64_t id = 0;
  SE3 T_body_sensor;
};

template <class Pose>
using MeasurementLine = std::variant<VertexLine<Pose>, FixLine, SensorOffsetLine, Factor<Pose>>;

// 2 or 3 for a line whose tag says so, else 0.
int DimensionOfLine(std::string_view text);

template <class Pose>
class MeasurementLineReader {
 public:
  // `source`: the name for messages.
  explicit MeasurementLineReader(std::string source, const ReadOptions& options = {})
      : source_(std::move(source)), options_(options) {}

  // Throws FileError with the source, `number` and the cause, and then is as before: an unknown tag, one of another
  // format or dimension, a wrong field, a defective factor, a prior whose sensor offset no line before it gave, a
  // second offset of an id that differs. An information matrix that is not positive definite is clamped if the options
  // say so.
  MeasurementLine<Pose> Read(std::string_view text, long number);

 private:
  std::string source_;
  ReadOptions options_;
  std::map<std::int64_t, SE3> T_body_sensor_;  // by parameter id
};

extern template class MeasurementLineReader<SE2>;
extern template class MeasurementLineReader<SE3>;

}  // namespace terse
