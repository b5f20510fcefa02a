#include "run/online_run.h"

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <iostream>
#include <optional>
#include <sstream>

#include "run/compact_stats.h"
#include "run/online_json.h"
#include "run/received_maps.h"
#include "run/run_statistics.h"
#include "run/standard_output.h"
#include "terse/compact/compact_json.h"
#include "terse/compact/json_file.h"
#include "terse/compact/map_file.h"
#include "terse/compact/run_writer.h"
#include "terse/core/atomic_file.h"
#include "terse/core/crc32.h"
#include "terse/core/measurement_line.h"
#include "terse/core/read_file.h"
#include "terse/core/require_optimum.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/text_lines.h"
#include "terse/covariance/covariance_table.h"

namespace terse {

using nlohmann::ordered_json;

ordered_json ParseHeader(const Journal& journal) {
  ordered_json json = ParseJson<ordered_json>(journal.Header(), journal.Path(), 2);
  if (!json.is_object())
    throw FileError(journal.Path(), 0, "the journal's header is no JSON object, expected the options of its run");
  return json;
}

namespace {

constexpr const char* kSource = LineSource::kName;
constexpr const char *kSnapshot = "snapshot", *kReceivedMaps = "received_maps";  // in a journal's header

template <class Pose>
class OnlineRun {
 public:
  OnlineRun(const CompactOptions<Pose>& settings, const OnlineRunOptions& options, ordered_json header,
            Journal* journal)
      : options_(options),
        slam_(settings),
        stream_(slam_),
        maps_(slam_, stream_, options.agreeing_links, kSource, options.read),
        reader_(kSource, options.read),
        header_(std::move(header)),
        journal_(journal) {
    if (options.review) stream_.StartReviews(*options.review);
  }

  void Resume() {
    TakeSnapshotOf(ParseHeader(*journal_));
    long number = 0;
    while (const std::optional<std::string> line = journal_->ReadLine()) {
      ++number;
      try {
        Note(IsCommand(*line, kReceived) ? TakeReceived(*line) : Apply(*line, number));
        TakeReview(false);
      } catch (const std::exception& error) {
        throw FileError(journal_->Path(), number + 2, std::string("the line does not fit: ") + error.what());
      }
      lines_ += !IsFlush(*line);
    }
    const long cut = journal_->CutTail();
    if (cut > 0 && !options_.quiet) {
      std::cerr << "terse: warning: " << journal_->Path() << ": " << cut << " bytes of a line in flight were cut off\n";
    }
    Print({{"resumed", true},
           {"poses", slam_.PosesSeen()},
           {"last_pose", IdOrNull(last_)},
           {"open_pose", IdOrNull(stream_.Open())},
           {"lines", lines_}});
  }

  void Take(const InputLine& line) {
    const std::string& text = line.text;
    if (line.torn && !text.empty()) {
      return Refuse(FileError(kSource, line.number, "the input ends within this line, expected a line end"));
    }
    if (IsFlush(text) ? !stream_.Open() : IsComment(text)) return;
    if (IsRequest(text)) return Answer(text, line.number);
    const double before = SecondsNow();
    const std::optional<PoseId> open = stream_.Open();
    std::string record = IsFlush(text) ? kFlush : text;
    Outcome outcome;
    try {
      outcome = IsCommand(text, kMap) ? ReceiveMap(text, line.number, record) : Apply(text, line.number);
    } catch (const NumericalError& error) {
      const std::string way_out = open ? "; DISCARD gives up pose " + std::to_string(open->value) : "";
      return Refuse(FileError(kSource, line.number, error.what() + way_out));
    } catch (const FileError& error) {
      return Refuse(error);
    } catch (const std::invalid_argument& error) {
      return Refuse(FileError(kSource, line.number, error.what()));
    }
    if (journal_ != nullptr) journal_->Append(record);
    lines_ += !IsFlush(text);
    Note(outcome);
    if (std::optional<ordered_json> answer = TakeReview(false)) outcome.answers.push_back(std::move(*answer));
    if (text == kDiscard) return Print({{"discarded", IdOrNull(open)}});
    if (outcome.stream.empty() && outcome.answers.empty()) return;
    if (journal_ != nullptr) journal_->Sync();
    if (!options_.quiet) Report(outcome, SecondsNow() - before);
    if (journal_ != nullptr && journal_->Bytes() > most_journal_bytes_) RotateJournal();
  }

  void Refuse(const FileError& error) {
    Print({{"error", error.what()}});
    if (options_.strict) throw error;
  }

  void Finish() {
    Take({kFlush});
    if (journal_ != nullptr) journal_->Sync();
    for (const std::string& name : maps_.Names(false)) {
      if (!options_.quiet)
        std::cerr << "terse: warning: the map " << name
                  << " still waits for links that agree: the run's is without it\n";
    }
    if (options_.directory.empty()) return;
    if (slam_.PosesSeen() == 0) throw FileError(kSource, 0, "no measurement came: there is nothing to write");
    // Not in the journal: a run that goes on from there goes on with the poses.
    if (const std::optional<ordered_json> answer = TakeReview(true); answer && !options_.quiet) Print(*answer);
    RetireAtEnd();
    const BatchResult<Pose> result = slam_.Finish();
    RequireOptimum(result);
    const std::string undetermined = slam_.Solver().DescribeUndetermined();
    if (!undetermined.empty() && !options_.quiet) std::cerr << "terse: warning: " << undetermined << '\n';
    WriteMapAndTrajectory(slam_, result, options_.recovery, options_.read.rotation_information, options_.directory);
    WriteDecisions(decisions_, options_.directory + "/decisions.csv");
    if (!options_.quiet) std::cerr << Describe(CountComposed(slam_));
  }

 private:
  void RetireAtEnd() {
    ordered_json retired = ordered_json::array();
    for (const RetiredPose& pose : slam_.Retire()) retired.push_back(pose.id.value);
    if (!retired.empty() && !options_.quiet) Print({{"retired_at_end", std::move(retired)}});
  }

  // After every line that was taken.
  std::optional<ordered_json> TakeReview(bool at_end) {
    std::optional<Review> found = stream_.TakeReview(at_end);
    if (!found) return std::nullopt;
    std::string how;
    if (!found->scale.IsOne()) how += ", with standard deviations scaled: " + found->information.message;
    if (found->loops_left_out > 0)
      how += ", without " + std::to_string(found->loops_left_out) + " loops that are wrong";
    if (!how.empty() && how != how_made_ && !options_.quiet) {
      std::cerr << "terse: note: " << kSource << ": the map is made again" << how << " (--review off leaves it)\n";
    }
    how_made_ = std::move(how);
    if (!options_.directory.empty()) decisions_ = std::move(found->decisions);
    return ToJson(*found, slam_);
  }

  static constexpr char kFlush[] = "FLUSH", kDiscard[] = "DISCARD";
  using Outcome = typename ReceivedMaps<Pose>::Outcome;

  // A snapshot stands for the lines so far, and the journal begins anew. The two last snapshots take turns, so that the
  // one that the journal on disk names is there whenever the run is killed. One whose trajectory is to be written needs
  // all its lines.
  void RotateJournal() {
    if (!options_.directory.empty()) return;
    ++snapshots_;
    const std::string path = SnapshotPath(snapshots_);
    stream_.Save(path);
    ordered_json header = header_;
    header[kSnapshot] = {{"number", snapshots_}, {"crc32", Crc32(ReadAll(path))}, {"lines", lines_}};
    header[kSnapshot]["last_pose"] = IdOrNull(last_);
    header[kSnapshot][kReceivedMaps] = maps_.ToJson();
    journal_->Restart(header.dump());
    std::error_code ignored;
    std::filesystem::remove(SnapshotPath(snapshots_ + 1), ignored);
    for (const std::string& name : maps_.Names(true)) std::filesystem::remove(CopyPath(name), ignored);
    // A snapshot is as large as the map: so the work is a share of that of the lines.
    most_journal_bytes_ =
        std::max(options_.journal_bytes, 4 * static_cast<long>(std::filesystem::file_size(path, ignored)));
  }
  std::string SnapshotPath(long number) const {
    return journal_->Path() + ".snapshot-" + (number % 2 != 0 ? "1" : "2");
  }

  // What the journal's header says to begin with, if anything.
  void TakeSnapshotOf(const ordered_json& header) {
    if (!header.contains(kSnapshot)) return;
    const ordered_json& snapshot = header[kSnapshot];
    const auto whole_number = [&](const char* key) {
      const ordered_json value = snapshot.is_object() ? snapshot.value(key, ordered_json()) : ordered_json();
      if (!value.is_number_integer())
        throw FileError(journal_->Path(), 2, "the header's snapshot has no " + std::string(key));
      return value.get<long>();
    };
    snapshots_ = whole_number("number");
    lines_ = whole_number("lines");
    const std::string path = SnapshotPath(snapshots_);
    if (static_cast<long>(Crc32(ReadAll(path))) != whole_number("crc32")) {
      throw FileError(path, 0, "not the snapshot that the journal " + journal_->Path() + " goes on from");
    }
    stream_ = MeasurementStream<Pose>::Load(path, slam_);
    if (snapshot.contains(kReceivedMaps)) {
      maps_.FromJson(snapshot[kReceivedMaps], [&](const std::string& name) { return ReadCompactMap(CopyPath(name)); });
    }
    if (const ordered_json last = snapshot.value("last_pose", ordered_json()); last.is_number_integer()) {
      last_ = PoseId{last.get<std::int64_t>()};
    }
    if (!options_.directory.empty() && !options_.quiet) {
      std::cerr << "terse: warning: decisions.csv will lack the poses of the " << lines_
                << " lines before the journal's snapshot\n";
    }
  }

  // MAP NAME PATH: a compact map of another robot, a run's folder or the graph.json of one. A journal has a copy beside
  // it, and says which.
  Outcome ReceiveMap(const std::string& text, long number, std::string& record) {
    std::istringstream words(text);
    std::string command, name, path;
    words >> command >> name >> std::ws;
    std::getline(words, path);
    if (name.empty() || path.empty()) throw FileError(kSource, number, "expected MAP NAME PATH");
    maps_.RequireFree(name);
    if (std::filesystem::is_directory(path)) path += "/graph.json";
    if (journal_ == nullptr) return Receive(name, ReadCompactMap(path));
    const std::string copy = CopyPath(name), bytes = ReadText(path);
    AtomicFile file(copy);
    file.Stream() << bytes;
    file.Commit();
    record = std::string(kReceived) + ' ' + name + ' ' + std::to_string(Crc32(bytes));
    try {
      return Receive(name, ReadCompactMap(copy));
    } catch (const FileError& error) {
      std::filesystem::remove(copy);
      throw FileError(path, error.line(), error.cause());
    } catch (const std::exception&) {
      std::filesystem::remove(copy);
      throw;
    }
  }
  Outcome TakeReceived(const std::string& text) {
    std::istringstream words(text);
    std::string command, name;
    std::uint32_t sum = 0;
    words >> command >> name >> sum;
    const std::string copy = CopyPath(name);
    if (Crc32(ReadText(copy)) != sum)
      throw FileError(copy, 0, "not the map that the journal " + journal_->Path() + " was given");
    return Receive(name, ReadCompactMap(copy));
  }
  Outcome Receive(const std::string& name, const CompactMapFile& file) {
    ordered_json answer = maps_.Receive(name, file, !options_.directory.empty());
    stream_.EndReviews();
    Outcome outcome = maps_.Update();
    outcome.answers.insert(outcome.answers.begin(), std::move(answer));
    return outcome;
  }
  std::string CopyPath(const std::string& name) const { return journal_->Path() + ".map-" + name; }

  static bool IsCommand(const std::string& text, std::string_view command) { return FirstField(text) == command; }
  static bool IsFlush(const std::string& text) { return text.empty() || text == kFlush; }
  static bool IsRequest(const std::string& text) { return IsCommand(text, kCovariance); }
  static bool IsComment(const std::string& text) { return text[0] == '#' || text.compare(0, 2, "//") == 0; }

  Outcome Apply(const std::string& text, long number) {
    Outcome outcome;
    if (text == kDiscard) {
      if (!stream_.Open()) throw FileError(kSource, number, "DISCARD, but no pose is open");
      maps_.Discard(*stream_.Open());
      stream_.Discard();
      return outcome;
    }
    if (IsFlush(text)) {
      outcome.stream = stream_.Flush();
    } else if (ReceivedMaps<Pose>::IsLink(text)) {
      outcome = maps_.AddLink(text, number);
    } else if (text.compare(0, kRemove.size(), kRemove) == 0) {
      RemoveLink(Trimmed(text.substr(kRemove.size())), number);
    } else {
      outcome.stream = Measure(text, number);
    }
    Outcome joined = maps_.Update();
    std::move(joined.stream.begin(), joined.stream.end(), std::back_inserter(outcome.stream));
    std::move(joined.answers.begin(), joined.answers.end(), std::back_inserter(outcome.answers));
    return outcome;
  }

  std::vector<StreamOutcome> Measure(const std::string& text, long number) {
    const MeasurementLine<Pose> line = reader_.Read(text, number);
    if (!options_.directory.empty()) RequireStamps(line);  // not at the end of a long run
    if (const auto* factor = std::get_if<Factor<Pose>>(&line)) return stream_.Add(*factor);
    if (const auto* vertex = std::get_if<VertexLine<Pose>>(&line)) stream_.SetValue(vertex->id, vertex->T_world_body);
    if (const auto* fix = std::get_if<FixLine>(&line)) stream_.Fix(fix->poses);
    return {};
  }

  // Of what trajectory.tum is to hold.
  static void RequireStamps(const MeasurementLine<Pose>& line) {
    if (const auto* vertex = std::get_if<VertexLine<Pose>>(&line)) RequireStampId(vertex->id);
    if (const auto* fix = std::get_if<FixLine>(&line)) {
      for (const PoseId id : fix->poses) RequireStampId(id);
    }
    if (const auto* factor = std::get_if<Factor<Pose>>(&line)) {
      const FactorPoses ends = PosesOf(*factor);
      RequireStampId(ends.first);
      RequireStampId(ends.second);
    }
  }

  void RemoveLink(const std::string& text, long number) {
    FactorId id;
    const std::from_chars_result end = std::from_chars(text.data(), text.data() + text.size(), id.value);
    if (end.ec != std::errc() || end.ptr != text.data() + text.size()) {
      throw FileError(kSource, number, "REMOVE of \"" + text + "\", expected the number of one factor");
    }
    slam_.RemoveLink(id);
    stream_.EndReviews();
  }

  // A request changes nothing, so the journal does not hold it; but what it tells follows from the lines before.
  void Answer(const std::string& text, long number) {
    const double before = SecondsNow();
    ordered_json json;
    try {
      json = CovarianceJson(ParseRequest(text.substr(kCovariance.size()), number), slam_, options_.convention);
    } catch (const FileError& error) {
      return Refuse(error);
    } catch (const NumericalError& error) {
      return Refuse(FileError(kSource, number, error.what()));
    }
    json["seconds"] = SecondsNow() - before;
    if (journal_ != nullptr) journal_->Sync();
    Print(json);
  }

  // One pose, or two.
  std::vector<PoseId> ParseRequest(const std::string& text, long number) const {
    std::vector<PoseId> poses;
    std::istringstream words(text);
    for (std::string word; words >> word;) {
      PoseId id;
      const std::from_chars_result end = std::from_chars(word.data(), word.data() + word.size(), id.value);
      if (end.ec != std::errc() || end.ptr != word.data() + word.size()) {
        throw FileError(kSource, number, "COVARIANCE of \"" + word + "\", expected the id of a pose");
      }
      if (stream_.Open() == id) {
        throw FileError(kSource, number, "pose " + word + " is not closed yet; a blank line or FLUSH closes it");
      }
      if (slam_.HasForgotten(id)) throw FileError(kSource, number, "pose " + word + " is forgotten (--remember)");
      if (!slam_.HasSeen(id)) throw FileError(kSource, number, "pose " + word + " is unknown");
      poses.push_back(id);
    }
    if (poses.empty() || poses.size() > 2) {
      throw FileError(kSource, number, "COVARIANCE takes the id of a pose, or of two");
    }
    if (poses.size() == 2 && poses[0] == poses[1]) {
      throw FileError(kSource, number, "COVARIANCE of a pose seen from itself, expected two distinct poses");
    }
    return poses;
  }

  void Report(const Outcome& outcome, double seconds) {
    for (const StreamOutcome& of_stream : outcome.stream) {
      ordered_json json = ToJson(of_stream, slam_);
      const auto* decision = std::get_if<Decision>(&of_stream);
      if (decision != nullptr && options_.covariances) {
        json["covariance"] = CovarianceOrNull(decision->id);
      }
      json["seconds"] = seconds;
      Print(json);
    }
    for (ordered_json json : outcome.answers) {
      json["seconds"] = seconds;
      Print(json);
    }
  }

  void Note(const Outcome& outcome) {
    for (const StreamOutcome& of_stream : outcome.stream) {
      const auto* decision = std::get_if<Decision>(&of_stream);
      if (decision == nullptr) continue;
      last_ = decision->id;
      if (!options_.directory.empty()) decisions_.push_back(*decision);
    }
  }

  ordered_json CovarianceOrNull(PoseId pose) const {
    try {
      return RowsJson(slam_.Covariance(pose, options_.convention));
    } catch (const NumericalError&) {  // the line is taken and answered all the same
      return nullptr;
    }
  }

  static ordered_json IdOrNull(std::optional<PoseId> pose) { return pose ? ordered_json(pose->value) : ordered_json(); }

  void Print(const ordered_json& json) {
    std::cout << OneLine(json);
    FlushOutput();
  }

  static constexpr std::string_view kRemove = "REMOVE ", kCovariance = "COVARIANCE", kMap = "MAP",
                                    kReceived = "RECEIVED";  // as the journal has MAP

  const OnlineRunOptions& options_;
  CompactPoseSlam<Pose> slam_;
  MeasurementStream<Pose> stream_;
  ReceivedMaps<Pose> maps_;
  MeasurementLineReader<Pose> reader_;
  ordered_json header_;  // what the journal's lines mean depends on
  Journal* journal_;
  long lines_ = 0, snapshots_ = 0;  // taken since the journal was begun, FLUSH aside; made
  long most_journal_bytes_ = options_.journal_bytes;
  std::vector<Decision> decisions_;  // for decisions.csv
  std::string how_made_;             // the map, as the last note told
  std::optional<PoseId> last_;
};

void ExpectSameHeader(const Journal& journal, const ordered_json& now) {
  const ordered_json then = ParseHeader(journal);
  const auto compare = [&](const std::string& key) {
    const ordered_json old = then.value(key, ordered_json()), value = now.value(key, ordered_json());
    if (old == value || key == kSnapshot) return;
    throw FileError(
        journal.Path(), 0,
        "the journal was begun with other options: " + key + " is " + old.dump() + " there, " + value.dump() + " now");
  };
  for (const auto& item : now.items()) compare(item.key());
  for (const auto& item : then.items()) compare(item.key());
}

}  // namespace

template <class Pose>
void RunOnline(const CompactOptions<Pose>& settings, const OnlineRunOptions& options, const ordered_json& header,
               Journal* journal, LineSource& source) {
  OnlineRun<Pose> run(settings, options, header, journal);
  if (journal != nullptr) {
    if (journal->IsNew()) {
      journal->Create(header.dump());
    } else {
      ExpectSameHeader(*journal, header);
      run.Resume();
    }
  }
  for (InputLine line; source.Next(line);) run.Take(line);
  run.Finish();
}

template void RunOnline<SE2>(const CompactOptions<SE2>&, const OnlineRunOptions&, const ordered_json&, Journal*,
                             LineSource&);
template void RunOnline<SE3>(const CompactOptions<SE3>&, const OnlineRunOptions&, const ordered_json&, Journal*,
                             LineSource&);

}  // namespace terse
