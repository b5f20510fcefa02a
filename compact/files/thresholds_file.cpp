#include "terse/compact/thresholds_file.h"

#include <cmath>

#include "terse/compact/compact_json.h"
#include "terse/compact/json_file.h"
#include "terse/core/definite.h"
#include "terse/core/error.h"

namespace terse {
namespace {

using nlohmann::json;

FileError KeyError(const std::string& path, const std::string& key, const std::string& cause) {
  return FileError(path, 0, "key \"" + key + "\" " + cause + ", expected as compact writes it to thresholds.json");
}

json ReadObject(const std::string& path) { return ReadJsonObject<json>(path, "thresholds"); }

const json& At(const json& object, const char* key, const std::string& path) {
  const auto it = object.find(key);
  if (it == object.end()) throw KeyError(path, key, "is missing");
  return *it;
}

double Number(const json& value, const std::string& key, const std::string& path) {
  if (!value.is_number() || !std::isfinite(value.get<double>())) throw KeyError(path, key, "holds no number");
  return value.get<double>();
}

double NonNegative(const json& object, const char* key, const std::string& path) {
  const double value = Number(At(object, key, path), key, path);
  if (value < 0) throw KeyError(path, key, "is negative");
  return value;
}

int DimensionIn(const json& object, const std::string& path) {
  const json& dimension = At(object, "dimension", path);
  if (dimension != 2 && dimension != 3) throw KeyError(path, "dimension", "is neither 2 nor 3");
  return dimension == 2 ? 2 : 3;
}

std::vector<double> Numbers(const json& list, std::size_t count, const char* key, const std::string& path) {
  const std::string counted = std::to_string(count) + " numbers";
  if (!list.is_array() || list.size() != count) throw KeyError(path, key, "is to hold " + counted + " in a list");
  std::vector<double> out;
  for (const json& value : list) out.push_back(Number(value, key, path));
  return out;
}

template <class Pose>
typename Pose::Jacobian LinkCovariance(const json& object, const std::string& path) {
  constexpr const char* kKey = "link_covariance";
  constexpr auto kRows = static_cast<std::size_t>(Pose::kDof);
  const json& rows = At(object, kKey, path);
  if (!rows.is_array() || rows.size() != kRows) {
    throw KeyError(path, kKey, "is to hold " + std::to_string(kRows) + " rows in a list");
  }
  typename Pose::Jacobian out;
  for (int i = 0; i < Pose::kDof; ++i) {
    const std::vector<double> row = Numbers(rows[static_cast<std::size_t>(i)], kRows, kKey, path);
    out.row(i) = Eigen::Map<const Vector<Pose::kDof>>(row.data()).transpose();
  }
  const bool symmetric = (out - out.transpose()).norm() <= 1e-9 * out.norm();
  if (!symmetric || !IsDefinite<Pose::kDof>(out)) throw KeyError(path, kKey, "is not positive definite");
  return out;
}

}  // namespace

int ReadThresholdsDimension(const std::string& path) { return DimensionIn(ReadObject(path), path); }

template <class Pose>
Thresholds<Pose> ReadThresholds(const std::string& path) {
  constexpr int kSize = Displacement<Pose>::kSize;
  const json object = ReadObject(path);
  const int dimension = DimensionIn(object, path);
  if (dimension != Pose::kDim) {
    throw FileError(
        path, 0,
        "thresholds for " + std::to_string(dimension) + "D, but the run is " + std::to_string(Pose::kDim) + "D");
  }
  Thresholds<Pose> read;
  const std::vector<double> range = Numbers(At(object, "range", path), kSize, "range", path);
  read.range = Eigen::Map<const Vector<kSize>>(range.data());
  if (!(read.range.array() > 0).all()) throw KeyError(path, "range", "holds a number that is not positive");
  read.probability = NonNegative(object, "probability", path);
  if (read.probability >= 1) throw KeyError(path, "probability", "is not below 1");
  read.min_loop_gain = NonNegative(object, "min_loop_gain", path);
  read.min_pose_gain = NonNegative(object, "min_pose_gain", path);
  read.link_covariance = LinkCovariance<Pose>(object, path);
  return read;
}

template <class Pose>
void WriteThresholds(const Thresholds<Pose>& thresholds, const std::string& path) {
  WriteJson(ThresholdsToJson(thresholds), path);
}

template Thresholds<SE2> ReadThresholds<SE2>(const std::string&);
template Thresholds<SE3> ReadThresholds<SE3>(const std::string&);
template void WriteThresholds<SE2>(const Thresholds<SE2>&, const std::string&);
template void WriteThresholds<SE3>(const Thresholds<SE3>&, const std::string&);

}  // namespace terse
