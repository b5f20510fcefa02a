#include "run/received_maps.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <unordered_map>

#include "run/merge_output.h"
#include "terse/core/gauge.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/text_lines.h"

namespace terse {
namespace {

using nlohmann::ordered_json;

// What ids are moved by: a multiple of a power of ten, by which they come to lie below `lowest`.
template <class Pose>
std::int64_t OffsetBelow(const CompactMap<Pose>& map, std::int64_t lowest) {
  constexpr std::int64_t kMost = std::int64_t{1} << 60;
  std::int64_t highest = -kMost;
  for (const auto& pose : map.poses) {
    highest = std::max(highest, pose.id.value);
    if (pose.id.value > kMost || pose.id.value < -kMost || lowest < -kMost)
      throw std::invalid_argument("pose " + std::to_string(pose.id.value) +
                                  ": ids beyond 2^60 cannot be moved below those of the run");
  }
  const std::int64_t by = highest + 1 - lowest;
  if (by <= 0) return 0;
  std::int64_t step = 1000;
  while (step <= by / 10) step *= 10;
  return -step * ((by + step - 1) / step);
}

// Whether two of the links that are in lie farther apart than a group of wrong ones, which agree with each other
// because one place looks like another: both robots' poses are so many apart.
constexpr long kOnePlace = 10;
template <class Pose>
bool AreOfTwoPlaces(const std::vector<MapToMerge<Pose>>& maps, const std::vector<MergedLink<Pose>>& links) {
  std::unordered_map<std::int64_t, long> order[2];
  for (std::size_t k = 0; k < 2; ++k) {
    for (const auto& pose : maps[k].map.poses) order[k].emplace(pose.id.value, static_cast<long>(order[k].size()));
  }
  std::vector<std::array<long, 2>> places;
  for (const auto& link : links) {
    if (link.verdict != MapLinkVerdict::kAccepted) continue;
    const bool is_from_run = link.link.from_map == 0;
    const auto& measured = link.link.measured;
    places.push_back({order[0].at((is_from_run ? measured.from : measured.to).value),
                      order[1].at((is_from_run ? measured.to : measured.from).value)});
  }
  // Against the least and the most of those far enough before, so that no pairs are gone through.
  std::sort(places.begin(), places.end());
  long least = std::numeric_limits<long>::max(), most = std::numeric_limits<long>::min();
  auto before = places.begin();
  for (const auto& [of_run, of_map] : places) {
    for (; (*before)[0] < of_run - kOnePlace; ++before) {
      least = std::min(least, (*before)[1]);
      most = std::max(most, (*before)[1]);
    }
    if (least <= most && (of_map - least > kOnePlace || most - of_map > kOnePlace)) return true;
  }
  return false;
}

ordered_json ScaleJson(const InformationScale& scale) {
  return {scale.odometry.translation, scale.odometry.rotation, scale.loops.translation, scale.loops.rotation};
}

InformationScale ScaleFrom(const ordered_json& json) {
  return {{json.at(0).get<double>(), json.at(1).get<double>()}, {json.at(2).get<double>(), json.at(3).get<double>()}};
}

}  // namespace

template <class Pose>
int ReceivedMaps<Pose>::IndexOf(std::string_view name) const {
  const auto found = std::find_if(maps_.begin(), maps_.end(), [&](const Received& map) { return map.name == name; });
  return found == maps_.end() ? kRun : static_cast<int>(found - maps_.begin());
}

template <class Pose>
void ReceivedMaps<Pose>::RequireFree(const std::string& name) const {
  constexpr std::string_view kAllowed = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-";
  if (name.empty() || name.find_first_not_of(kAllowed) != std::string::npos)
    throw std::invalid_argument("MAP " + Quoted(name) + ", expected a name of letters, digits and ._-");
  if (IndexOf(name) != kRun) throw std::invalid_argument("there is a map " + name + " already");
}

template <class Pose>
void ReceivedMaps<Pose>::Hold(Received& received, const CompactMapFile& file) const {
  const auto* map = std::get_if<CompactMap<Pose>>(&file.map);
  if (map == nullptr)
    throw std::invalid_argument("the map " + received.name + " is of another dimension, expected " +
                                std::to_string(Pose::kDim) + "D");
  if (map->poses.empty()) throw std::invalid_argument("the map " + received.name + " has no poses");
  received.map = *map;
  received.scale = file.information_scale;
  for (const auto& pose : map->poses) received.ids.insert(pose.id.value);
}

// Of the run and all maps that came, as moved; of a run that has not begun 0.
template <class Pose>
std::int64_t ReceivedMaps<Pose>::LowestId() const {
  std::int64_t lowest = 0;
  for (const auto& pose : slam_.Trajectory(Recovery::kV0)) lowest = std::min(lowest, pose.id.value);
  for (const Received& map : maps_) {
    for (const std::int64_t id : map.ids) lowest = std::min(lowest, id + map.id_offset);
  }
  return stream_.Open() ? std::min(lowest, stream_.Open()->value) : lowest;
}

template <class Pose>
ordered_json ReceivedMaps<Pose>::Receive(const std::string& name, const CompactMapFile& file, bool as_stamps) {
  RequireFree(name);
  Received received;
  received.name = name;
  Hold(received, file);
  received.id_offset = OffsetBelow(received.map, LowestId());
  long kept = 0;
  for (const auto& pose : received.map.poses) {
    if (as_stamps) RequireStampId({pose.id.value + received.id_offset});
    kept += pose.kept;
  }
  ordered_json answer = {{"map", name},
                         {"joined", false},
                         {"id_offset", received.id_offset},
                         {"poses", received.map.poses.size()},
                         {"poses_kept", kept}};
  maps_.push_back(std::move(received));
  return answer;
}

template <class Pose>
bool ReceivedMaps<Pose>::IsLink(const std::string& text) {
  std::istringstream words(text);
  std::string tag, from, to;
  words >> tag >> from >> to;
  return from.find(':') != std::string::npos || to.find(':') != std::string::npos;
}

template <class Pose>
typename ReceivedMaps<Pose>::End ReceivedMaps<Pose>::EndAt(const std::string& word, long number) const {
  const auto fail = [&](const std::string& cause) { throw FileError(source_, number, cause); };
  const std::size_t colon = word.find(':');
  End end;
  if (colon != std::string::npos) {
    const std::string name = word.substr(0, colon);
    end.map = IndexOf(name);
    if (end.map == kRun) fail("there is no map " + Quoted(name) + "; MAP " + name + " PATH brings one");
  }
  const std::string id = colon == std::string::npos ? word : word.substr(colon + 1);
  const auto [last, error] = std::from_chars(id.data(), id.data() + id.size(), end.pose.value);
  if (id.empty() || error != std::errc() || last != id.data() + id.size())
    fail(Quoted(word) + " is no pose, expected ID or MAP:ID");
  if (!IsOfRun(end)) {
    if (At(end.map).ids.count(end.pose.value) == 0) fail("the map " + At(end.map).name + " has no pose " + id);
    return end;
  }
  const PoseId pose = InRun(end);
  if (stream_.Open() != pose && !slam_.HasSeen(pose) && !slam_.HasForgotten(pose))
    fail("pose " + word + " is unknown; its odometry comes first");
  return end;
}

template <class Pose>
typename ReceivedMaps<Pose>::Link ReceivedMaps<Pose>::Parse(const std::string& text, long number) {
  const typename NamedEdgeReader<Pose>::Edge edge = reader_.Read(text, number);
  Link link{EndAt(edge.from, number), EndAt(edge.to, number), edge.measured, text};
  if (link.from.map == link.to.map && !IsOfRun(link.from))
    throw FileError(source_, number, "both poses are of the map " + At(link.from.map).name);
  const auto scale = [&](const End& end) { return end.map == kRun ? stream_.Scale() : At(end.map).scale; };
  link.measured = ScaleMapLinks<Pose>({{0, 1, link.measured}}, {scale(link.from), scale(link.to)}).front().measured;
  return link;
}

template <class Pose>
PoseId ReceivedMaps<Pose>::InRun(const End& end) const {
  return end.map == kRun ? end.pose : PoseId{end.pose.value + At(end.map).id_offset};
}
template <class Pose>
RelativePoseFactor<Pose> ReceivedMaps<Pose>::InRun(const Link& link) const {
  RelativePoseFactor<Pose> measured = link.measured;
  measured.from = InRun(link.from);
  measured.to = InRun(link.to);
  return measured;
}

template <class Pose>
typename ReceivedMaps<Pose>::Outcome ReceivedMaps<Pose>::AddLink(const std::string& text, long number) {
  Link link = Parse(text, number);
  Outcome outcome;
  if (IsOfRun(link.from) && IsOfRun(link.to)) {
    outcome.stream = stream_.Add(InRun(link), true);
    return outcome;
  }
  ordered_json waits_for = ordered_json::array();
  for (const End& end : {link.from, link.to}) {
    if (!IsOfRun(end)) waits_for.push_back(At(end.map).name);
  }
  std::istringstream words(text);
  std::string tag, from, to;
  words >> tag >> from >> to;
  outcome.answers.push_back({{"link", {from, to}}, {"waits_for", std::move(waits_for)}});
  waiting_.push_back(std::move(link));
  return outcome;
}

// From the map to a pose that the run has closed and remembers.
template <class Pose>
bool ReceivedMaps<Pose>::IsReady(const Link& link, int map) const {
  if (link.from.map != map && link.to.map != map) return false;
  const End& other = link.from.map == map ? link.to : link.from;
  return IsOfRun(other) && slam_.HasSeen(InRun(other));
}

// Counted anew when the run has grown by a sixteenth, so that a long run pays little for a map that waits.
template <class Pose>
long ReceivedMaps<Pose>::CountAbsolute(Received& received) const {
  const int poses = slam_.PosesSeen();
  if (poses > received.counted_at + received.counted_at / 16) {
    received.absolute = CountAbsoluteFactors(slam_.Solver().Graph()).Count();
    received.counted_at = poses;
  }
  return received.absolute;
}

template <class Pose>
typename ReceivedMaps<Pose>::Outcome ReceivedMaps<Pose>::Update() {
  Outcome outcome;
  if (slam_.PosesSeen() == 0) return outcome;
  for (int map = 0; map < static_cast<int>(maps_.size()); ++map) {
    Received& received = maps_[static_cast<std::size_t>(map)];
    if (received.is_joined) continue;
    const long needed = received.tried + std::max(1L, received.tried / 16);
    const long absolute = received.map.priors.empty() ? 0 : CountAbsolute(received);
    // All that wait are the most that can be ready: no line goes through them in vain.
    const auto most = static_cast<long>(waiting_.size());
    if ((most < agreeing_ && absolute == 0) || most + absolute < needed) continue;
    const long links = std::count_if(waiting_.begin(), waiting_.end(), [&](const Link& l) { return IsReady(l, map); });
    const long evidence = links + absolute;
    if ((links < agreeing_ && absolute == 0) || evidence < needed) continue;
    received.tried = evidence;
    if (!TryToJoin(map, outcome)) continue;
    PassOn(outcome);
    map = -1;  // links between maps may have become links to the run
  }
  return outcome;
}

template <class Pose>
bool ReceivedMaps<Pose>::TryToJoin(int map, Outcome& outcome) {
  const Received& received = At(map);
  const std::vector<MapToMerge<Pose>> maps = {{"the run", slam_.Export(), 0},
                                              {received.name, received.map, received.id_offset}};
  std::vector<std::size_t> tested;
  std::vector<MapLink<Pose>> links;
  for (std::size_t l = 0; l < waiting_.size(); ++l) {
    const Link& link = waiting_[l];
    if (!IsReady(link, map)) continue;
    const bool is_from = link.from.map == map;
    MapLink<Pose> between{is_from ? 1 : 0, is_from ? 0 : 1, link.measured};
    between.measured.from = is_from ? link.from.pose : InRun(link.from);
    between.measured.to = is_from ? InRun(link.to) : link.to.pose;
    links.push_back(between);
    tested.push_back(l);
  }
  MergeOptions<Pose> options;
  options.thresholds = slam_.Options().thresholds;
  options.retire_share = slam_.Options().strategy == Strategy::kBounded ? slam_.Options().retire_share : 0;
  std::string cause;
  try {
    const Merged<Pose> merged = Merge(maps, links, options);
    const long accepted = std::count_if(merged.links.begin(), merged.links.end(),
                                        [](const auto& link) { return link.verdict == MapLinkVerdict::kAccepted; });
    const bool are_in_world =
        merged.maps[0].placement == Placement::kDatum && merged.maps[1].placement == Placement::kDatum;
    if (are_in_world || (accepted >= agreeing_ && AreOfTwoPlaces(maps, merged.links))) {
      outcome.answers.push_back(Join(map, merged, tested));
      return true;
    }
    cause = std::to_string(accepted) + " links agree, " + std::to_string(agreeing_) +
            " have to (--agreeing-links), of more than one place";
  } catch (const NumericalError& error) {
    cause = error.what();
  } catch (const std::invalid_argument& error) {
    cause = error.what();
  }
  outcome.answers.push_back({{"map", received.name}, {"joined", false}, {"links", links.size()}, {"cause", cause}});
  return false;
}

// The run's map is another one only when all that may fail is done.
template <class Pose>
ordered_json ReceivedMaps<Pose>::Join(int map, const Merged<Pose>& merged, const std::vector<std::size_t>& tested) {
  Received& received = maps_[static_cast<std::size_t>(map)];
  const ordered_json stats = MergeStats(merged);
  ordered_json answer = {{"map", received.name}, {"joined", true}};
  for (const char* key : {"placement", "id_offset", "poses"}) answer[key] = stats["maps"][1][key];
  for (const char* key : {"links", "links_accepted", "links_inconsistent"}) answer[key] = stats[key];
  answer["inconsistent"] = ordered_json::array();
  for (std::size_t k = 0; k < tested.size(); ++k) {
    if (merged.links[k].verdict == MapLinkVerdict::kAccepted) continue;
    std::istringstream words(waiting_[tested[k]].text);
    std::string tag, from, to;
    words >> tag >> from >> to;
    answer["inconsistent"].push_back({from, to});
  }
  answer["T_run_map"] = stats["maps"][1]["T_joint_map"];
  answer["sigma_of_first_pose"] = stats["maps"][1]["sigma_of_first_pose"];
  answer["poses_kept"] = stats["poses_kept"];
  answer["retired"] = ordered_json::array();
  for (const RetiredPose& pose : merged.retired) answer["retired"].push_back(pose.id.value);
  slam_ = CompactPoseSlam<Pose>::Restore(merged.map, slam_.Options());
  received.is_joined = true;
  received.map = {};
  received.ids.clear();
  for (auto l = tested.rbegin(); l != tested.rend(); ++l)
    waiting_.erase(waiting_.begin() + static_cast<std::ptrdiff_t>(*l));
  return answer;
}

// Links both of whose ends are of the run by now: of the pose at hand, to a forgotten one, or between two maps.
template <class Pose>
void ReceivedMaps<Pose>::PassOn(Outcome& outcome) {
  std::vector<Link> still;
  for (Link& link : waiting_) {
    if (!IsOfRun(link.from) || !IsOfRun(link.to)) {
      still.push_back(std::move(link));
      continue;
    }
    try {
      for (StreamOutcome& late : stream_.Add(InRun(link), true)) outcome.stream.push_back(std::move(late));
    } catch (const std::exception& error) {
      outcome.answers.push_back(
          {{"link", {InRun(link.from).value, InRun(link.to).value}}, {"accepted", false}, {"cause", error.what()}});
    }
  }
  waiting_ = std::move(still);
}

template <class Pose>
void ReceivedMaps<Pose>::Discard(PoseId open) {
  const auto is_at = [&](const End& end) { return IsOfRun(end) && InRun(end) == open; };
  waiting_.erase(std::remove_if(waiting_.begin(), waiting_.end(),
                                [&](const Link& link) { return is_at(link.from) || is_at(link.to); }),
                 waiting_.end());
}

template <class Pose>
std::vector<std::string> ReceivedMaps<Pose>::Names(bool joined) const {
  std::vector<std::string> names;
  for (const Received& map : maps_) {
    if (map.is_joined == joined) names.push_back(map.name);
  }
  return names;
}

template <class Pose>
ordered_json ReceivedMaps<Pose>::ToJson() const {
  ordered_json maps = ordered_json::array(), links = ordered_json::array();
  for (const Received& map : maps_) {
    maps.push_back({{"name", map.name},
                    {"id_offset", map.id_offset},
                    {"joined", map.is_joined},
                    {"scale", ScaleJson(map.scale)},
                    {"tried", map.tried}});
  }
  for (const Link& link : waiting_) links.push_back(link.text);
  return {{"maps", std::move(maps)}, {"links", std::move(links)}};
}

template <class Pose>
void ReceivedMaps<Pose>::FromJson(const ordered_json& json,
                                  const std::function<CompactMapFile(const std::string&)>& read) {
  for (const ordered_json& map : json.at("maps")) {
    Received received;
    received.name = map.at("name").get<std::string>();
    received.id_offset = map.at("id_offset").get<std::int64_t>();
    received.is_joined = map.at("joined").get<bool>();
    received.scale = ScaleFrom(map.at("scale"));
    received.tried = map.at("tried").get<long>();
    if (!received.is_joined) Hold(received, read(received.name));
    maps_.push_back(std::move(received));
  }
  for (const ordered_json& text : json.at("links")) waiting_.push_back(Parse(text.get<std::string>(), 0));
}

template class ReceivedMaps<SE2>;
template class ReceivedMaps<SE3>;

}  // namespace terse
