#pragma once
// Maps of other robots that a run of `online` has received, and links to them, some of which may be wrong. A map waits
// until enough links agree on how it lies (terse/compact/merge.h), of more than one place, or absolute measurements say
// so; then it becomes part of the run's map, for good. It is tried again when what speaks for it has grown, by a
// sixteenth at least.
//
// A pose of such a map is NAME:ID, before that and afterwards. In the run's map its ids are moved below all others, so
// that ids ascend and dropped poses can be forgotten (CompactOptions::most_dropped).

#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <unordered_set>
#include <vector>

#include "terse/compact/map_file.h"
#include "terse/compact/map_links.h"
#include "terse/compact/measurement_stream.h"
#include "terse/compact/merge.h"

namespace terse {

template <class Pose>
class ReceivedMaps {
 public:
  // What came of a line: of links whose map is part of the run's, and answers about maps.
  struct Outcome {
    std::vector<StreamOutcome> stream;
    std::vector<nlohmann::ordered_json> answers;
  };

  // `slam` and `stream` outlive the maps; `slam` is another one after a map was joined. `agreeing`: so many links have
  // to agree. `source`: the name of the input, for messages.
  ReceivedMaps(CompactPoseSlam<Pose>& slam, MeasurementStream<Pose>& stream, int agreeing, const std::string& source,
               const ReadOptions& options)
      : slam_(slam), stream_(stream), agreeing_(agreeing), source_(source), reader_(source, options) {}

  // Throws std::invalid_argument for a name that is taken, or that is not of letters, digits and ._- alone.
  void RequireFree(const std::string& name) const;
  // Throws std::invalid_argument for a map of another dimension, or whose ids are too large to be moved; with
  // `as_stamps` too large for a trajectory's stamps.
  nlohmann::ordered_json Receive(const std::string& name, const CompactMapFile& file, bool as_stamps);
  // Whether a line is one for AddLink: one of its ends is NAME:ID.
  static bool IsLink(const std::string& text);
  // Throws FileError, or what the stream throws, and is then as before.
  Outcome AddLink(const std::string& text, long number);
  // After a line: maps that can be joined now are.
  Outcome Update();
  // Links of the pose at hand go with it.
  void Discard(PoseId open);
  std::vector<std::string> Names(bool joined) const;

  // For a snapshot, all but the waiting maps themselves, and back: `read` gives one by its name.
  nlohmann::ordered_json ToJson() const;
  void FromJson(const nlohmann::ordered_json& json, const std::function<CompactMapFile(const std::string&)>& read);

 private:
  static constexpr int kRun = -1;
  struct Received {
    std::string name;
    std::int64_t id_offset = 0;
    bool is_joined = false;
    InformationScale scale;
    long tried = 0;                        // what spoke for it when it was last tried
    long absolute = 0;                     // measurements of the run, where the map has some too
    int counted_at = 0;                    // poses of the run then
    CompactMap<Pose> map;                  // while it waits
    std::unordered_set<std::int64_t> ids;  // likewise; its own
  };
  struct End {
    int map = kRun;
    PoseId pose;  // by the id that it has there
  };
  struct Link {
    End from, to;
    RelativePoseFactor<Pose> measured;
    std::string text;
  };

  void Hold(Received& received, const CompactMapFile& file) const;
  std::int64_t LowestId() const;
  int IndexOf(std::string_view name) const;
  End EndAt(const std::string& word, long number) const;
  Link Parse(const std::string& text, long number);
  const Received& At(int map) const { return maps_[static_cast<std::size_t>(map)]; }
  bool IsOfRun(const End& end) const { return end.map == kRun || At(end.map).is_joined; }
  PoseId InRun(const End& end) const;
  RelativePoseFactor<Pose> InRun(const Link& link) const;
  bool IsReady(const Link& link, int map) const;
  long CountAbsolute(Received& received) const;
  void PassOn(Outcome& outcome);
  bool TryToJoin(int map, Outcome& outcome);
  nlohmann::ordered_json Join(int map, const Merged<Pose>& merged, const std::vector<std::size_t>& tested);

  CompactPoseSlam<Pose>& slam_;
  MeasurementStream<Pose>& stream_;
  int agreeing_;
  std::string source_;
  NamedEdgeReader<Pose> reader_;
  std::vector<Received> maps_;
  std::vector<Link> waiting_;
};

}  // namespace terse
