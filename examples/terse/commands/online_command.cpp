#include <charconv>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <optional>
#include <sstream>

#include "commands/budget_options.h"
#include "commands/commands.h"
#include "commands/convention_options.h"
#include "commands/output_paths.h"
#include "commands/verbose.h"
#include "run/compact_stats.h"
#include "run/journal.h"
#include "run/line_source.h"
#include "run/online_json.h"
#include "run/run_statistics.h"
#include "run/standard_output.h"
#include "terse/compact/compact_json.h"
#include "terse/compact/json_file.h"
#include "terse/compact/run_writer.h"
#include "terse/compact/thresholds_file.h"
#include "terse/compact/words.h"
#include "terse/core/crc32.h"
#include "terse/core/measurement_line.h"
#include "terse/core/read_file.h"
#include "terse/core/require_optimum.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/core/writable.h"
#include "terse/covariance/covariance_table.h"

namespace terse {
namespace {

using nlohmann::ordered_json;

struct OnlineCommandOptions {
  int dimension = 0;  // 0: the first measurement tells
  std::string thresholds, journal, directory;
  long journal_bytes = 64 * 1000 * 1000;  // beyond which it begins anew
  Strategy strategy = Strategy::kFpfl;
  std::vector<double> range, link_deviation;
  std::optional<double> probability, min_pose_gain, min_loop_gain;
  CompactBudget budget;
  double min_variance_drop = 0;
  std::string remember;  // a number of dropped poses, "all", or as the journal or the outputs have it
  std::optional<double> innovation_quantile = 0.9999;
  RobustOptions robust;
  Recovery recovery = Recovery::kV2;
  ReadOptions read;
  CovarianceConvention convention;
  bool covariances = false, strict = false, quiet = false;
  LogSink log;
};

constexpr const char* kSource = LineSource::kName;

// Of dropped poses, unless a trajectory is to be written.
constexpr const char* kAll = "all";
constexpr int kRemembered = 1000;
constexpr const char* kMostDropped = "most_dropped";

ordered_json ParseHeader(const Journal& journal) {
  ordered_json json = ParseJson<ordered_json>(journal.Header(), journal.Path(), 2);
  if (!json.is_object())
    throw FileError(journal.Path(), 0, "the journal's header is no JSON object, expected the options of its run");
  return json;
}

template <class Pose>
class OnlineRun {
 public:
  OnlineRun(const CompactOptions<Pose>& settings, const OnlineCommandOptions& options, ordered_json header,
            Journal* journal)
      : options_(options),
        slam_(settings),
        stream_(slam_),
        reader_(kSource, options.read),
        header_(std::move(header)),
        journal_(journal) {}

  void Resume() {
    TakeSnapshotOf(ParseHeader(*journal_));
    long number = 0;
    while (const std::optional<std::string> line = journal_->ReadLine()) {
      ++number;
      try {
        Note(Apply(*line, number));
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
    std::vector<StreamOutcome> outcomes;
    try {
      outcomes = Apply(text, line.number);
    } catch (const NumericalError& error) {
      const std::string way_out = open ? "; DISCARD gives up pose " + std::to_string(open->value) : "";
      return Refuse(FileError(kSource, line.number, error.what() + way_out));
    } catch (const FileError& error) {
      return Refuse(error);
    } catch (const std::invalid_argument& error) {
      return Refuse(FileError(kSource, line.number, error.what()));
    }
    if (journal_ != nullptr) journal_->Append(IsFlush(text) ? kFlush : text);
    lines_ += !IsFlush(text);
    Note(outcomes);
    if (text == kDiscard) return Print({{"discarded", IdOrNull(open)}});
    if (outcomes.empty()) return;
    if (journal_ != nullptr) journal_->Sync();
    if (!options_.quiet) Report(outcomes, SecondsNow() - before);
    if (journal_ != nullptr && journal_->Bytes() > most_journal_bytes_) RotateJournal();
  }

  void Refuse(const FileError& error) {
    Print({{"error", error.what()}});
    if (options_.strict) throw error;
  }

  void Finish() {
    Take({kFlush});
    if (journal_ != nullptr) journal_->Sync();
    if (options_.directory.empty()) return;
    if (slam_.PosesSeen() == 0) throw FileError(kSource, 0, "no measurement came: there is nothing to write");
    const BatchResult<Pose> result = slam_.Finish();
    RequireOptimum(result);
    const std::string undetermined = slam_.Solver().DescribeUndetermined();
    if (!undetermined.empty() && !options_.quiet) std::cerr << "terse: warning: " << undetermined << '\n';
    WriteMapAndTrajectory(slam_, result, options_.recovery, options_.read.rotation_information, options_.directory);
    WriteDecisions(decisions_, options_.directory + "/decisions.csv");
    if (!options_.quiet) std::cerr << Describe(CountComposed(slam_));
  }

 private:
  static constexpr char kFlush[] = "FLUSH", kDiscard[] = "DISCARD";

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
    journal_->Restart(header.dump());
    std::error_code ignored;
    std::filesystem::remove(SnapshotPath(snapshots_ + 1), ignored);
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
    if (const ordered_json last = snapshot.value("last_pose", ordered_json()); last.is_number_integer()) {
      last_ = PoseId{last.get<std::int64_t>()};
    }
    if (!options_.directory.empty() && !options_.quiet) {
      std::cerr << "terse: warning: decisions.csv will lack the poses of the " << lines_
                << " lines before the journal's snapshot\n";
    }
  }

  static bool IsFlush(const std::string& text) { return text.empty() || text == kFlush; }
  static bool IsRequest(const std::string& text) {
    const std::size_t size = kCovariance.size();
    if (text.compare(0, size, kCovariance) != 0) return false;
    return text.size() == size || std::string_view(kBlanks).find(text[size]) != std::string_view::npos;
  }
  static bool IsComment(const std::string& text) { return text[0] == '#' || text.compare(0, 2, "//") == 0; }

  std::vector<StreamOutcome> Apply(const std::string& text, long number) {
    if (IsFlush(text)) return stream_.Flush();
    if (text == kDiscard) {
      if (!stream_.Open()) throw FileError(kSource, number, "DISCARD, but no pose is open");
      stream_.Discard();
      return {};
    }
    if (text.compare(0, kRemove.size(), kRemove) == 0) {
      RemoveLink(Trimmed(text.substr(kRemove.size())), number);
      return {};
    }
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

  void Report(const std::vector<StreamOutcome>& outcomes, double seconds) {
    for (const StreamOutcome& outcome : outcomes) {
      ordered_json json = ToJson(outcome, slam_);
      const auto* decision = std::get_if<Decision>(&outcome);
      if (decision != nullptr && options_.covariances) {
        json["covariance"] = CovarianceOrNull(decision->id);
      }
      json["seconds"] = seconds;
      Print(json);
    }
  }

  void Note(const std::vector<StreamOutcome>& outcomes) {
    for (const StreamOutcome& outcome : outcomes) {
      const auto* decision = std::get_if<Decision>(&outcome);
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

  static constexpr std::string_view kRemove = "REMOVE ", kCovariance = "COVARIANCE";
  static constexpr const char* kSnapshot = "snapshot";

  const OnlineCommandOptions& options_;
  CompactPoseSlam<Pose> slam_;
  MeasurementStream<Pose> stream_;
  MeasurementLineReader<Pose> reader_;
  ordered_json header_;  // what the journal's lines mean depends on
  Journal* journal_;
  long lines_ = 0, snapshots_ = 0;  // taken since the journal was begun, FLUSH aside; made
  long most_journal_bytes_ = options_.journal_bytes;
  std::vector<Decision> decisions_;  // for decisions.csv
  std::optional<PoseId> last_;
};

template <class Pose>
CompactOptions<Pose> MakeOptions(const OnlineCommandOptions& from) {
  constexpr int kSize = Displacement<Pose>::kSize;
  CompactOptions<Pose> options;
  options.strategy = from.strategy;
  Thresholds<Pose>& thresholds = options.thresholds;
  if (!from.thresholds.empty()) thresholds = ReadThresholds<Pose>(from.thresholds);
  if (!from.range.empty()) {
    if (from.range.size() != kSize) {
      throw CLI::ValidationError("--range", std::to_string(from.range.size()) + " numbers given, but a " +
                                                std::to_string(Pose::kDim) + "D run takes " +
                                                (kSize == 4 ? "X Y Z ANGLE" : "X Y ANGLE"));
    }
    thresholds.range = Eigen::Map<const Vector<kSize>>(from.range.data());
  }
  if (!from.link_deviation.empty()) {
    Vector<Pose::kDof> deviation;
    deviation.setConstant(from.link_deviation[1]);
    deviation.template head<Pose::kDim>().setConstant(from.link_deviation[0]);
    thresholds.link_covariance = deviation.cwiseAbs2().asDiagonal();
  }
  thresholds.probability = from.probability.value_or(thresholds.probability);
  thresholds.min_loop_gain = from.min_loop_gain.value_or(thresholds.min_loop_gain);
  thresholds.min_pose_gain = from.min_pose_gain.value_or(thresholds.min_pose_gain);
  options.innovation_quantile = from.innovation_quantile;
  options.solver.robust = from.robust;
  options.budget = from.budget;
  options.min_variance_drop = from.min_variance_drop;
  if (!from.remember.empty() && from.remember != kAll) options.most_dropped = std::stoi(from.remember);
  options.log = from.log;
  return options;
}

// What a journal's lines mean depends on these.
template <class Pose>
ordered_json JournalHeader(const CompactOptions<Pose>& settings, const OnlineCommandOptions& options) {
  ordered_json json = ThresholdsToJson(settings.thresholds);
  json["strategy"] = Name(settings.strategy);
  const auto& [keep_poses, keep_links, poses_per_area, error] = settings.budget;
  if (keep_poses) json["keep_poses"] = *keep_poses;
  if (keep_links) json["keep_links"] = *keep_links;
  if (poses_per_area) json["poses_per_area"] = *poses_per_area;
  if (error) json["error"] = *error;
  if (settings.min_variance_drop > 0) json["min_variance_drop"] = settings.min_variance_drop;
  if (settings.most_dropped) json[kMostDropped] = *settings.most_dropped;
  json["innovation_quantile"] = nullptr;
  if (options.innovation_quantile) json["innovation_quantile"] = *options.innovation_quantile;
  json["robust"] = WordOf(options.robust.kernel);
  json["robust_width"] = options.robust.width;
  json["rotation_information"] =
      options.read.rotation_information == RotationInformation::kRadians ? "radians" : "quaternion";
  json["repair_information"] = options.read.repair_information;
  return json;
}

void ExpectSameHeader(const Journal& journal, const ordered_json& now) {
  const ordered_json then = ParseHeader(journal);
  for (const auto& [key, value] : now.items()) {
    const ordered_json old = then.value(key, ordered_json());
    if (old == value) continue;
    throw FileError(
        journal.Path(), 0,
        "the journal was begun with other options: " + key + " is " + old.dump() + " there, " + value.dump() + " now");
  }
}

// Unless it is said, as the journal has it, so that a run goes on as it began.
std::string Remembered(const OnlineCommandOptions& options, const Journal* journal) {
  if (!options.remember.empty()) return options.remember;
  if (journal != nullptr && !journal->IsNew()) {
    const ordered_json most_dropped = ParseHeader(*journal).value(kMostDropped, ordered_json());
    return most_dropped.is_number_integer() ? most_dropped.dump() : kAll;
  }
  return options.directory.empty() ? std::to_string(kRemembered) : kAll;
}

template <class Pose>
void RunOnline(const OnlineCommandOptions& options, Journal* journal, LineSource& source) {
  const CompactOptions<Pose> settings = MakeOptions<Pose>(options);
  const ordered_json header = JournalHeader(settings, options);
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

// 2 or 3; 0 if only the input tells.
int KnownDimension(const OnlineCommandOptions& options, const Journal* journal) {
  if (options.dimension != 0) return options.dimension;
  if (!options.thresholds.empty()) return ReadThresholdsDimension(options.thresholds);
  if (!options.range.empty()) return static_cast<int>(options.range.size()) - 1;
  if (journal == nullptr || journal->IsNew()) return 0;
  const ordered_json dimension = ParseHeader(*journal).value("dimension", ordered_json());
  return dimension == 2 ? 2 : 3;
}

void Online(OnlineCommandOptions options) {
  if (options.strategy != Strategy::kApal && options.thresholds.empty() && options.range.empty()) {
    throw CLI::ValidationError("--thresholds", "this or --range is required");
  }
  std::vector<NamedPath> outputs{{"--journal", options.journal}};
  if (!options.directory.empty()) {
    for (NamedPath& file : FilesIn("--output", options.directory, {"compact.g2o", "trajectory.tum", "decisions.csv"})) {
      outputs.push_back(std::move(file));
    }
  }
  CheckOutputPaths(outputs, {{"standard input", "/dev/stdin"}, {"--thresholds", options.thresholds}});
  if (!options.directory.empty()) RequireFolder(options.directory, "decisions.csv");
  std::optional<Journal> journal;
  if (!options.journal.empty()) journal.emplace(options.journal);
  Journal* const used = journal ? &*journal : nullptr;
  options.remember = Remembered(options, used);
  LineSource source;
  int dimension = KnownDimension(options, used);
  if (dimension == 0) dimension = source.FindDimension();
  dimension == 2 ? RunOnline<SE2>(options, used, source) : RunOnline<SE3>(options, used, source);
}

void AddThresholdOptions(CLI::App& command, OnlineCommandOptions& options) {
  command
      .add_option("--thresholds", options.thresholds,
                  "Range, gains and link covariance as compact --auto-thresholds wrote them; the options below "
                  "overrule it")
      ->type_name("FILE");
  command.add_option("--range", options.range, "Sensor range in metres and radians")
      ->expected(3, 4)
      ->check(PositiveNumber())
      ->option_text("X Y Z ANGLE (3D) | X Y ANGLE (2D)");
  command.add_option("--probability", options.probability, "Least probability of being in range, per dimension [0.1]")
      ->check(NumberIn(0, 0.999999))
      ->type_name("S");
  command
      .add_option("--min-pose-gain", options.min_pose_gain,
                  "A pose is kept above this gain (nats), or if a loop closes at it [3]")
      ->check(NonNegativeNumber())
      ->type_name("G");
  command.add_option("--min-loop-gain", options.min_loop_gain, "A link is kept above this gain (nats) [1]")
      ->check(NonNegativeNumber())
      ->type_name("G");
  command
      .add_option("--link-deviation", options.link_deviation,
                  "Standard deviations expected of a loop, per direction [0.1 m, 0.1 rad]")
      ->expected(2)
      ->check(PositiveNumber())
      ->option_text("METRES RADIANS");
  AddInnovationOptions(command, options.innovation_quantile);
}

}  // namespace

void AddOnlineCommand(CLI::App& app) {
  auto options = std::make_shared<OnlineCommandOptions>();
  CLI::App* command = app.add_subcommand(
      "online", "Compact pose SLAM of measurements as they come: g2o lines on standard input, JSON decisions out");
  AddChoice(*command, "--dimension", options->dimension, {{"2", 2}, {"3", 3}},
            "2D or 3D; by default as the range, or as the first measurement");
  AddChoice(*command, "--strategy", options->strategy,
            Choices<Strategy>({Strategy::kApal, Strategy::kApfl, Strategy::kFpfl, Strategy::kBounded}),
            "All poses all links, all poses few links, few poses few links, or as many as the area needs: where a link "
            "finds the robot in known terrain its chain starts anew at a kept pose");
  AddThresholdOptions(*command, *options);
  AddBudgetOptions(*command, options->budget);
  AddVarianceOption(*command, options->min_variance_drop);
  AddRobustOptions(*command, options->robust);
  AddReadOptions(*command, options->read);
  command
      ->add_option("--journal", options->journal,
                   "Every line taken is on disk before its decision is written; if the file exists, its lines are "
                   "taken again first")
      ->type_name("FILE");
  command
      ->add_option_function<double>(
          "--journal-size", [options](double megabytes) { options->journal_bytes = std::lround(megabytes * 1e6); },
          "Beyond so many megabytes the journal begins anew, with a snapshot of the run beside it (FILE.snapshot-1 and "
          "-2, in turn); not with --output [64]")
      ->check(NumberIn(0.001, 1e6))
      ->type_name("MB");
  command
      ->add_option("--output", options->directory,
                   "Folder for compact.g2o, trajectory.tum and decisions.csv at the end of the input")
      ->type_name("DIR");
  AddChoice(*command, "--recover", options->recovery, Choices<Recovery>(), "How dropped poses come back, see compact");
  command
      ->add_option("--remember", options->remember,
                   "Dropped poses that can still be asked for and linked to: so many of the newest, and those on the "
                   "chains of others; loops to older ones are left out, and memory grows with the map alone "
                   "[1000; all with --output]")
      ->check([](const std::string& text) {
        const bool is_count = !text.empty() && text.size() < 10 && text.find_first_not_of("0123456789") == text.npos &&
                              text.find_first_not_of('0') != text.npos;
        return is_count || text == kAll ? std::string() : text + " is neither a number of poses, 1 or more, nor all";
      })
      ->type_name("N|all");
  command->add_flag("--covariances", options->covariances, "Every answer to a pose has its covariance too");
  AddConventionOptions(*command, options->convention);
  command->add_flag("--strict", options->strict, "Stop at the first bad line");
  command->add_flag("--quiet", options->quiet, "Write errors and what COVARIANCE asks for only, no decisions");
  AddVerboseOption(*command, options->log);
  command->footer(
      "A blank line or FLUSH closes the pose at hand, DISCARD gives it up, REMOVE ID takes a link out, COVARIANCE ID "
      "[ID]\n"
      "answers how well a pose is known (the second seen from the first).\n"
      "Example: terse generate ellipse --output measurements.g2o &&\n"
      "         terse online --range 10 10 10 1.5 --journal run.journal < measurements.g2o");
  command->callback([options] { Online(*options); });
}

}  // namespace terse
