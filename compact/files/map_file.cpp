#include "terse/compact/map_file.h"

#include <cmath>
#include <nlohmann/json.hpp>

#include "terse/compact/compact_json.h"
#include "terse/compact/json_file.h"
#include "terse/compact/words.h"
#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/core/number_text.h"
#include "terse/core/pose_numbers.h"

namespace terse {
namespace {

constexpr const char* kFormat = "terse-compact-graph-1";

// Writing ---------------------------------------------------------------------------------------------------------

template <class Range>
std::string List(const Range& numbers) {
  std::string out = "[";
  for (const double number : numbers) {
    if (!std::isfinite(number)) throw NumericalError("an estimate of the map is not finite");
    if (out.size() > 1) out += ',';
    out += Shortest(number);
  }
  return out + ']';
}

template <class Pose>
std::string Numbers(const Pose& T) {
  return List(internal::NumbersOf(T));
}

// The upper triangle, row by row.
template <int N>
std::string Triangle(const Matrix<N, N>& M) {
  std::vector<double> numbers;
  for (int r = 0; r < N; ++r) {
    for (int c = r; c < N; ++c) numbers.push_back(M(r, c));
  }
  return List(numbers);
}

std::string Id(PoseId id) { return std::to_string(id.value); }

template <class Pose>
std::string PoseText(const typename CompactMap<Pose>::SeenPose& pose) {
  std::string out = "{\"id\":" + Id(pose.id) + ",\"kept\":" + (pose.kept ? "true" : "false") +
                    ",\"T_world_body\":" + Numbers(pose.T_world_body) +
                    ",\"T_world_body_when_seen\":" + Numbers(pose.T_world_body_when_seen) +
                    ",\"previous\":" + (pose.previous ? Id(*pose.previous) : "null");
  if (pose.anchored_to) out += ",\"anchored_to\":" + Id(*pose.anchored_to);
  if (!pose.kept) {
    out += ",\"base\":" + Id(pose.base) + ",\"T_base_pose\":" + Numbers(pose.T_base_pose.T_a_b) +
           ",\"covariance\":" + Triangle<Pose::kDof>(pose.T_base_pose.covariance) +
           ",\"next_kept\":" + (pose.next_kept ? Id(*pose.next_kept) : "null");
    if (pose.next_kept) {
      out += ",\"T_base_next\":" + Numbers(pose.T_base_next.T_a_b) +
             ",\"covariance_next\":" + Triangle<Pose::kDof>(pose.T_base_next.covariance);
    }
    if (pose.ended_by) out += ",\"ended_by\":" + Id(*pose.ended_by);
    if (pose.carried) out += ",\"carried\":true";
  }
  return out + '}';
}

template <class Pose>
std::string PartText(const typename CompactMap<Pose>::Part& part) {
  std::string out = "{\"id\":" + std::to_string(part.id.value) + ",\"added_at\":" + Id(part.added_at) +
                    ",\"gain_nats\":" + Shortest(part.gain) + ",\"links\":[";
  for (std::size_t k = 0; k < part.links.size(); ++k) out += (k > 0 ? "," : "") + Id(part.links[k]);
  return out + "],\"measurements\":" + std::to_string(part.measurements) +
         ",\"T_from_to\":" + Numbers(part.T_from_to.T_a_b) +
         ",\"covariance\":" + Triangle<Pose::kDof>(part.T_from_to.covariance) + '}';
}

template <class Pose>
std::string EdgeText(const typename CompactMap<Pose>::Edge& edge) {
  std::string out = "{\"factor\":" + std::to_string(edge.factor.value) + ",\"from\":" + Id(edge.measured.from) +
                    ",\"to\":" + Id(edge.measured.to) + ",\"kind\":\"" + (edge.is_loop ? "loop" : "odometry") +
                    "\",\"added_at\":" + Id(edge.added_at) +
                    ",\"gain_nats\":" + (edge.gain && std::isfinite(*edge.gain) ? Shortest(*edge.gain) : "null") +
                    ",\"measurement\":" + Numbers(edge.measured.T_from_to) +
                    ",\"information\":" + Triangle<Pose::kDof>(edge.measured.information);
  if (!edge.composed_of.empty()) {
    out += ",\"composed_of\":[";
    for (std::size_t k = 0; k < edge.composed_of.size(); ++k) out += (k > 0 ? "," : "") + Id(edge.composed_of[k]);
    out += ']';
  }
  if (!edge.parts.empty()) {
    out += ",\"parts\":[";
    for (std::size_t k = 0; k < edge.parts.size(); ++k) out += (k > 0 ? "," : "") + PartText<Pose>(edge.parts[k]);
    out += ']';
  }
  return out + '}';
}

template <class Pose>
std::string PriorText(const typename CompactMap<Pose>::Prior& prior) {
  const auto* pose = std::get_if<PosePriorFactor<Pose>>(&prior.measured);
  const auto* position = std::get_if<PositionPriorFactor<Pose>>(&prior.measured);
  std::string out = "{\"factor\":" + std::to_string(prior.factor.value) +
                    ",\"pose\":" + Id(PosesOf(prior.measured).first) + ",\"kind\":\"";
  if (pose != nullptr) {
    out += "pose\",\"measurement\":" + Numbers(pose->T_world_body) +
           ",\"information\":" + Triangle<Pose::kDof>(pose->information);
  } else {
    const auto& p = position->p_world;
    out += "position\",\"measurement\":" + List(std::vector<double>(p.data(), p.data() + p.size())) +
           ",\"information\":" + Triangle<Pose::kDim>(position->information);
    const auto& lever = position->p_body;
    if (!lever.isZero(0)) out += ",\"lever\":" + List(std::vector<double>(lever.data(), lever.data() + lever.size()));
  }
  return out + '}';
}

template <class Items, class Text>
void WriteList(const char* key, const Items& items, const Text& text, std::ostream& out) {
  out << ",\n\"" << key << "\":[";
  const char* before = "\n";
  for (const auto& item : items) {
    out << before << text(item);
    before = ",\n";
  }
  out << ']';
}

// Reading ---------------------------------------------------------------------------------------------------------

using nlohmann::json;

// A value of the file, and where it is.
class Place {
 public:
  Place(const json& value, std::string where, const std::string& path)
      : value_(value), where_(std::move(where)), path_(path) {}

  [[noreturn]] void Fail(const std::string& cause) const {
    throw FileError(path_, 0, (where_.empty() ? "" : where_ + ": ") + cause);
  }
  [[noreturn]] void FailExpecting(const std::string& expected) const {
    std::string text = value_.dump();
    if (text.size() > 40) text = text.substr(0, 40) + "...";
    Fail(text + ", expected " + expected);
  }
  bool Has(const char* key) const { return value_.is_object() && value_.contains(key) && !value_[key].is_null(); }
  Place At(const char* key, const char* expected) const {
    if (!value_.is_object()) FailExpecting("an object");
    const auto it = value_.find(key);
    const std::string where = (where_.empty() ? "" : where_ + '.') + key;
    if (it == value_.end()) throw FileError(path_, 0, where + ": missing, expected " + expected);
    return {*it, where, path_};
  }
  std::vector<Place> Items() const {
    if (!value_.is_array()) FailExpecting("a list");
    std::vector<Place> out;
    for (std::size_t k = 0; k < value_.size(); ++k) {
      out.emplace_back(value_[k], where_ + '[' + std::to_string(k) + ']', path_);
    }
    return out;
  }
  double Number() const {
    if (!value_.is_number()) FailExpecting("a number");
    const double number = value_.get<double>();
    if (!std::isfinite(number)) FailExpecting("a finite number");
    return number;
  }
  std::vector<double> Numbers(int count) const {
    if (!value_.is_array() || value_.size() != static_cast<std::size_t>(count)) {
      FailExpecting("a list of " + std::to_string(count) + " numbers");
    }
    std::vector<double> out;
    for (const Place& item : Items()) out.push_back(item.Number());
    return out;
  }
  std::int64_t Integer() const {
    const bool fits =
        value_.is_number_unsigned() ? value_.get<std::uint64_t>() <= INT64_MAX : value_.is_number_integer();
    if (!fits) FailExpecting("a whole number");
    return value_.get<std::int64_t>();
  }
  bool Flag() const {
    if (!value_.is_boolean()) FailExpecting("true or false");
    return value_.get<bool>();
  }
  // Which of the names it is.
  std::size_t Choice(const std::vector<std::string>& names) const {
    std::string list;
    for (std::size_t k = 0; k < names.size(); ++k) {
      if (value_.is_string() && value_.get<std::string>() == names[k]) return k;
      list += (list.empty() ? "\"" : "\" or \"") + names[k];
    }
    FailExpecting(list + '"');
  }

 private:
  const json& value_;
  std::string where_;
  const std::string& path_;
};

PoseId ReadId(const Place& parent, const char* key) { return {parent.At(key, "the id of a pose").Integer()}; }
FactorId ReadFactorId(const Place& parent) { return {parent.At("factor", "the number of a factor").Integer()}; }
std::optional<PoseId> ReadOptionalId(const Place& parent, const char* key) {
  return parent.Has(key) ? std::optional<PoseId>(ReadId(parent, key)) : std::nullopt;
}

void Read(const Place& place, SE2& T) {
  const auto v = place.Numbers(3);
  T = SE2(v[0], v[1], v[2]);
}
void Read(const Place& place, SE3& T) {
  constexpr double kTolerance = 1e-2;  // as for TUM files
  const auto v = place.Numbers(7);
  const Quaternion q(v[6], v[3], v[4], v[5]);
  if (std::abs(q.coeffs().stableNorm() - 1) > kTolerance)
    place.FailExpecting("x y z qx qy qz qw, the last four of norm 1");
  T = SE3(SO3(q), Vector<3>(v[0], v[1], v[2]));
}
template <class Pose>
Pose ReadPose(const Place& parent, const char* key) {
  Pose T;
  Read(parent.At(key, Pose::kDim == 2 ? "[x, y, theta]" : "[x, y, z, qx, qy, qz, qw]"), T);
  return T;
}

template <int N>
Matrix<N, N> ReadTriangle(const Place& parent, const char* key) {
  const auto v = parent.At(key, "an upper triangle, row by row").Numbers(N * (N + 1) / 2);
  Matrix<N, N> M;
  std::size_t next = 0;
  for (int r = 0; r < N; ++r) {
    for (int c = r; c < N; ++c) M(r, c) = M(c, r) = v[next++];
  }
  return M;
}

template <class Pose>
UncertainPose<Pose> ReadUncertain(const Place& parent, const char* key, const char* covariance) {
  return {ReadPose<Pose>(parent, key), ReadTriangle<Pose::kDof>(parent, covariance)};
}

template <class Pose>
typename CompactMap<Pose>::SeenPose ReadSeenPose(const Place& place) {
  typename CompactMap<Pose>::SeenPose pose;
  pose.id = pose.base = ReadId(place, "id");
  pose.kept = place.At("kept", "true or false").Flag();
  pose.T_world_body = ReadPose<Pose>(place, "T_world_body");
  pose.T_world_body_when_seen = ReadPose<Pose>(place, "T_world_body_when_seen");
  pose.previous = ReadOptionalId(place, "previous");
  if (place.Has("anchored_to")) pose.anchored_to = ReadId(place, "anchored_to");
  if (pose.kept) return pose;
  pose.base = ReadId(place, "base");
  pose.T_base_pose = ReadUncertain<Pose>(place, "T_base_pose", "covariance");
  pose.next_kept = ReadOptionalId(place, "next_kept");
  if (pose.next_kept) pose.T_base_next = ReadUncertain<Pose>(place, "T_base_next", "covariance_next");
  if (place.Has("ended_by")) pose.ended_by = ReadId(place, "ended_by");
  pose.carried = place.Has("carried") && place.At("carried", "true or false").Flag();
  return pose;
}

template <class Pose>
typename CompactMap<Pose>::Part ReadPart(const Place& place) {
  typename CompactMap<Pose>::Part part;
  part.id = {place.At("id", "a number").Integer()};
  part.added_at = ReadId(place, "added_at");
  part.gain = place.At("gain_nats", "a number").Number();
  for (const Place& id : place.At("links", "a list").Items()) part.links.push_back({id.Integer()});
  part.measurements = place.At("measurements", "a number").Integer();
  part.T_from_to = ReadUncertain<Pose>(place, "T_from_to", "covariance");
  return part;
}

template <class Pose>
typename CompactMap<Pose>::Edge ReadEdge(const Place& place) {
  typename CompactMap<Pose>::Edge edge;
  edge.factor = ReadFactorId(place);
  edge.measured = {ReadId(place, "from"), ReadId(place, "to"), ReadPose<Pose>(place, "measurement"),
                   ReadTriangle<Pose::kDof>(place, "information")};
  edge.is_loop = place.At("kind", "\"odometry\" or \"loop\"").Choice({"odometry", "loop"}) == 1;
  edge.added_at = ReadId(place, "added_at");
  if (place.Has("gain_nats")) edge.gain = place.At("gain_nats", "a number").Number();
  if (place.Has("composed_of")) {
    for (const Place& id : place.At("composed_of", "a list").Items()) edge.composed_of.push_back({id.Integer()});
  }
  if (place.Has("parts")) {
    for (const Place& part : place.At("parts", "a list").Items()) edge.parts.push_back(ReadPart<Pose>(part));
  }
  return edge;
}

template <class Pose>
typename CompactMap<Pose>::Prior ReadPrior(const Place& place) {
  const FactorId factor = ReadFactorId(place);
  const PoseId pose = ReadId(place, "pose");
  if (place.At("kind", "\"pose\" or \"position\"").Choice({"pose", "position"}) == 0) {
    return {factor, PosePriorFactor<Pose>{pose, ReadPose<Pose>(place, "measurement"),
                                          ReadTriangle<Pose::kDof>(place, "information")}};
  }
  const auto p = place.At("measurement", "a position").Numbers(Pose::kDim);
  PositionPriorFactor<Pose> prior{pose, Eigen::Map<const Vector<Pose::kDim>>(p.data()),
                                  ReadTriangle<Pose::kDim>(place, "information")};
  if (place.Has("lever")) {
    const auto lever = place.At("lever", "a point of the body").Numbers(Pose::kDim);
    prior.p_body = Eigen::Map<const Vector<Pose::kDim>>(lever.data());
  }
  return {factor, prior};
}

template <class Pose>
CompactMap<Pose> ReadMap(const Place& root) {
  CompactMap<Pose> map;
  for (const Place& p : root.At("poses", "a list").Items()) map.poses.push_back(ReadSeenPose<Pose>(p));
  for (const Place& p : root.At("edges", "a list").Items()) map.edges.push_back(ReadEdge<Pose>(p));
  for (const Place& p : root.At("priors", "a list").Items()) map.priors.push_back(ReadPrior<Pose>(p));
  for (const Place& p : root.At("fixed", "a list").Items()) {
    map.fixed.push_back({ReadId(p, "pose"), ReadPose<Pose>(p, "T_world_body")});
  }
  for (const Place& p : root.At("refused", "a list").Items()) {
    map.refused.push_back(
        {ReadId(p, "candidate"), ReadId(p, "seen"), ReadUncertain<Pose>(p, "T_candidate_seen", "covariance")});
  }
  if (root.Has("failed")) {  // not in files of earlier versions
    for (const Place& p : root.At("failed", "a list").Items()) {
      map.failed.push_back({ReadId(p, "candidate"), ReadId(p, "seen")});
    }
  }
  if (root.Has("forgotten")) map.forgotten = root.At("forgotten", "a count").Integer();
  const std::string defect = FindDefect(map);
  if (!defect.empty()) root.Fail(defect);
  return map;
}

double ReadFactor(const Place& place, const char* key) {
  const Place at = place.At(key, "a factor above zero");
  const double factor = at.Number();
  if (!(factor > 0)) at.FailExpecting("a factor above zero");
  return factor;
}

KindScale ReadKindScale(const Place& place) {
  return {ReadFactor(place, "translation"), ReadFactor(place, "rotation")};
}

InformationScale ReadScale(const Place& place) {
  return {ReadKindScale(place.At("odometry", "scales")), ReadKindScale(place.At("loops", "scales"))};
}

}  // namespace

CompactMapFile ReadCompactMap(const std::string& path) {
  const json object = ReadJsonObject<json>(path, "a compact map");
  const Place root(object, "", path);
  root.At("format", (std::string("\"") + kFormat + "\"").c_str()).Choice({kFormat});
  CompactMapFile file;
  const Place dimension = root.At("dimension", "2 or 3");
  const std::int64_t d = dimension.Integer();
  if (d != 2 && d != 3) dimension.FailExpecting("2 or 3");
  if (root.Has("strategy")) {
    std::vector<std::string> words;
    for (const auto& [word, strategy] : Words<Strategy>::kAll) words.emplace_back(word);
    file.strategy = Words<Strategy>::kAll[root.At("strategy", "a strategy").Choice(words)].second;
  }
  if (root.Has("sigma_scale")) file.information_scale = ReadScale(root.At("sigma_scale", "scales"));
  if (d == 2) {
    file.map = ReadMap<SE2>(root);
  } else {
    file.map = ReadMap<SE3>(root);
  }
  return file;
}

template <class Pose>
void WriteCompactMap(const CompactMap<Pose>& map, Strategy strategy, const std::string& path,
                     const InformationScale& information_scale) {
  AtomicFile file(path);
  std::ostream& out = file.Stream();
  out << "{\"format\":\"" << kFormat << "\",\"dimension\":" << Pose::kDim << ",\"strategy\":\"" << Name(strategy)
      << '"';
  if (!information_scale.IsOne()) out << ",\"sigma_scale\":" << ToJson(information_scale).dump();
  if (map.forgotten > 0) out << ",\"forgotten\":" << map.forgotten;
  WriteList("poses", map.poses, PoseText<Pose>, out);
  WriteList("edges", map.edges, EdgeText<Pose>, out);
  WriteList("priors", map.priors, PriorText<Pose>, out);
  const auto fixed_text = [](const auto& fixed) {
    return "{\"pose\":" + Id(fixed.pose) + ",\"T_world_body\":" + Numbers(fixed.T_world_body) + '}';
  };
  WriteList("fixed", map.fixed, fixed_text, out);
  const auto refused_text = [](const auto& link) {
    return "{\"candidate\":" + Id(link.candidate) + ",\"seen\":" + Id(link.seen) +
           ",\"T_candidate_seen\":" + Numbers(link.T_candidate_seen.T_a_b) +
           ",\"covariance\":" + Triangle<Pose::kDof>(link.T_candidate_seen.covariance) + '}';
  };
  WriteList("refused", map.refused, refused_text, out);
  const auto failed_text = [](const auto& failed) {
    return "{\"candidate\":" + Id(failed.candidate) + ",\"seen\":" + Id(failed.seen) + '}';
  };
  WriteList("failed", map.failed, failed_text, out);
  out << "}\n";
  file.Commit();
}

template void WriteCompactMap<SE2>(const CompactMap<SE2>&, Strategy, const std::string&, const InformationScale&);
template void WriteCompactMap<SE3>(const CompactMap<SE3>&, Strategy, const std::string&, const InformationScale&);

}  // namespace terse
