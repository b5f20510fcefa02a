#include <algorithm>
#include <cmath>
#include <optional>

#include "commands/budget_options.h"
#include "commands/commands.h"
#include "commands/convention_options.h"
#include "commands/output_paths.h"
#include "commands/verbose.h"
#include "run/online_run.h"
#include "terse/compact/compact_json.h"
#include "terse/compact/thresholds_file.h"
#include "terse/compact/words.h"
#include "terse/core/writable.h"

namespace terse {
namespace {

using nlohmann::ordered_json;

struct OnlineCommandOptions {
  int dimension = 0;  // 0: the first measurement tells
  std::string thresholds, journal;
  std::optional<Strategy> strategy;  // absent: as the journal has it, else as CompactOptions
  std::string review;                // of kReviews; empty: as the journal has it, else all
  std::vector<double> range, link_deviation;
  std::optional<double> probability, min_pose_gain, min_loop_gain;
  CompactBudget budget;
  double min_variance_drop = 0, retire_share = CompactOptions<SE3>().retire_share;
  std::string remember;  // a number of dropped poses, "all", or as the journal or the outputs have it
  std::optional<double> innovation_quantile = 0.9999;
  CompactRobust robust;
  double step_budget_ms = kFrameMs;
  LogSink log;
  OnlineRunOptions run;
};

// Of dropped poses, unless a trajectory is to be written.
constexpr int kRemembered = 1000;
constexpr const char *kMostDropped = "most_dropped", *kReview = "review", *kChosen = "chosen";
constexpr const char *kReviewAll = "all", *kReviewLoops = "loops", *kReviewOff = "off";

template <class Pose>
CompactOptions<Pose> MakeOptions(const OnlineCommandOptions& from) {
  constexpr int kSize = Displacement<Pose>::kSize;
  CompactOptions<Pose> options;
  options.strategy = from.strategy.value_or(options.strategy);
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
  options.solver.robust = from.robust.For(options);
  // What a journal brings back has to be the same to the last bit.
  if (from.journal.empty()) options.solver.budget_seconds = from.step_budget_ms / 1000;
  options.budget = from.budget;
  options.min_variance_drop = from.min_variance_drop;
  options.retire_share = from.retire_share;
  if (!from.remember.empty()) options.most_dropped = MostDropped(from.remember);
  options.log = from.log;
  return options;
}

// In the words of thresholds.json.
constexpr std::pair<const char*, bool ThresholdChoice::*> kChoices[] = {
    {"range", &ThresholdChoice::range},
    {"min_loop_gain", &ThresholdChoice::min_loop_gain},
    {"min_pose_gain", &ThresholdChoice::min_pose_gain},
    {"link_covariance", &ThresholdChoice::link_covariance}};

ordered_json ChosenNames(const ThresholdChoice& chosen) {
  ordered_json names = ordered_json::array();
  for (const auto& [name, is_chosen] : kChoices) {
    if (chosen.*is_chosen) names.push_back(name);
  }
  return names;
}

// Those that nobody gave; with a journal, of those that it has.
ThresholdChoice Chosen(const OnlineCommandOptions& options, const ordered_json* begun) {
  ThresholdChoice chosen;
  if (!options.thresholds.empty() || options.strategy == Strategy::kApal) return chosen;
  const ThresholdChoice given{!options.range.empty(), options.min_loop_gain.has_value(),
                              options.min_pose_gain.has_value(), !options.link_deviation.empty()};
  const ordered_json names = begun != nullptr ? begun->value(kChosen, ordered_json::array()) : ordered_json();
  for (const auto& [name, is_chosen] : kChoices) {
    const bool may = begun == nullptr || std::find(names.begin(), names.end(), name) != names.end();
    chosen.*is_chosen = may && !(given.*is_chosen);
  }
  return chosen;
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
  if (settings.strategy == Strategy::kBounded) json["retire_share"] = settings.retire_share;
  if (settings.most_dropped) json[kMostDropped] = *settings.most_dropped;
  if (options.run.agreeing_links != OnlineRunOptions().agreeing_links)
    json["agreeing_links"] = options.run.agreeing_links;
  if (options.run.review) {
    json[kReview] = options.run.review->information ? kReviewAll : kReviewLoops;
    const ordered_json chosen = ChosenNames(options.run.review->chosen);
    if (!chosen.empty()) json[kChosen] = chosen;
  }
  json["innovation_quantile"] = nullptr;
  if (options.innovation_quantile) json["innovation_quantile"] = *options.innovation_quantile;
  json["robust"] = WordOf(settings.solver.robust.kernel);
  json["robust_width"] = settings.solver.robust.width;
  json["rotation_information"] =
      options.run.read.rotation_information == RotationInformation::kRadians ? "radians" : "quaternion";
  json["repair_information"] = options.run.read.repair_information;
  return json;
}

// Unless it is said, as the journal has it, so that a run goes on as it began.
std::string Remembered(const OnlineCommandOptions& options, const Journal* journal) {
  if (!options.remember.empty()) return options.remember;
  if (journal != nullptr && !journal->IsNew()) {
    const ordered_json most_dropped = ParseHeader(*journal).value(kMostDropped, ordered_json());
    return most_dropped.is_number_integer() ? most_dropped.dump() : kRememberAll;
  }
  return options.run.directory.empty() ? std::to_string(kRemembered) : kRememberAll;
}

// Unless it is said, as the journal has it; a word of no strategy is left to the comparison of headers.
std::optional<Strategy> BegunWith(const OnlineCommandOptions& options, const Journal* journal) {
  if (options.strategy || journal == nullptr || journal->IsNew()) return options.strategy;
  const ordered_json begun = ParseHeader(*journal).value("strategy", ordered_json());
  for (const auto& [word, strategy] : Words<Strategy>::kAll) {
    if (begun == word) return strategy;
  }
  return std::nullopt;
}

// The same of reviews, which journals did not know once.
std::optional<ReviewOptions> Reviews(const OnlineCommandOptions& options, const Journal* journal) {
  std::optional<ordered_json> begun;
  if (journal != nullptr && !journal->IsNew()) begun = ParseHeader(*journal);
  std::string word = options.review;
  if (word.empty()) {
    word = begun ? kReviewOff : kReviewAll;
    // Another word is left to the comparison of headers.
    if (begun && begun->contains(kReview)) word = (*begun)[kReview] == kReviewLoops ? kReviewLoops : kReviewAll;
  }
  if (word == kReviewOff) return std::nullopt;
  ReviewOptions review;
  review.information = word == kReviewAll;
  review.chosen = Chosen(options, begun ? &*begun : nullptr);
  return review;
}

template <class Pose>
void Run(const OnlineCommandOptions& options, Journal* journal, LineSource& source) {
  const CompactOptions<Pose> settings = MakeOptions<Pose>(options);
  RunOnline(settings, options.run, JournalHeader(settings, options), journal, source);
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
  std::vector<NamedPath> outputs{{"--journal", options.journal}};
  if (!options.run.directory.empty()) {
    for (NamedPath& file :
         FilesIn("--output", options.run.directory, {"compact.g2o", "trajectory.tum", "decisions.csv"})) {
      outputs.push_back(std::move(file));
    }
  }
  CheckOutputPaths(outputs, {{"standard input", "/dev/stdin"}, {"--thresholds", options.thresholds}});
  if (!options.run.directory.empty()) RequireFolder(options.run.directory, "decisions.csv");
  std::optional<Journal> journal;
  if (!options.journal.empty()) journal.emplace(options.journal);
  Journal* const used = journal ? &*journal : nullptr;
  options.remember = Remembered(options, used);
  options.strategy = BegunWith(options, used);
  options.run.review = Reviews(options, used);
  const bool knows_range = !options.thresholds.empty() || !options.range.empty();
  if (!knows_range && options.strategy != Strategy::kApal &&
      !(options.run.review && options.run.review->chosen.range)) {
    throw CLI::ValidationError("--thresholds", "this or --range is required where no review chooses the range");
  }
  LineSource source;
  int dimension = KnownDimension(options, used);
  if (dimension == 0) dimension = source.FindDimension();
  dimension == 2 ? Run<SE2>(options, used, source) : Run<SE3>(options, used, source);
}

void AddThresholdOptions(CLI::App& command, OnlineCommandOptions& options) {
  command
      .add_option("--thresholds", options.thresholds,
                  "Range, gains and link covariance as compact --auto-thresholds wrote them; the options below "
                  "overrule it. Without it, what they do not give is chosen by what was measured, see --review")
      ->type_name("FILE");
  command.add_option("--range", options.range, "Sensor range in metres and radians [1 each until the first review]")
      ->expected(3, 4)
      ->check(PositiveNumber())
      ->option_text("X Y Z ANGLE (3D) | X Y ANGLE (2D)");
  command.add_option("--probability", options.probability, "Least probability of being in range, per dimension [0.1]")
      ->check(NumberIn(0, 0.999999))
      ->type_name("S");
  command
      .add_option("--min-pose-gain", options.min_pose_gain,
                  "A pose is kept above this gain (nats), or if a loop closes at it [3 until the first review]")
      ->check(NonNegativeNumber())
      ->type_name("G");
  command
      .add_option("--min-loop-gain", options.min_loop_gain,
                  "A link is kept above this gain (nats) [1 until the first review]")
      ->check(NonNegativeNumber())
      ->type_name("G");
  command
      .add_option("--link-deviation", options.link_deviation,
                  "Standard deviations expected of a loop, per direction [0.1 m, 0.1 rad until the first review]")
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
            "finds the robot in known terrain its chain starts anew at a kept pose; a journal goes on as it began")
      ->default_str(Name(CompactOptions<SE2>().strategy));
  AddThresholdOptions(*command, *options);
  AddBudgetOptions(*command, options->budget);
  AddBoundedOptions(*command, options->min_variance_drop, options->retire_share);
  AddRobustOptions(*command, options->robust);
  command
      ->add_option(
          "--review", options->review,
          "From eight loops on, each time that there are twice as many, all that was measured so far is looked "
          "at again, beside the run: information that nobody estimated or that is too certain is scaled to what "
          "residuals say (not with loops), loops that the others contradict are left out (with gnc), and thresholds "
          "that nobody gave are chosen (from 32 poses on). If that changes the map it is made again, and an answer "
          "tells of it (made_again)")
      ->check(CLI::IsMember({kReviewAll, kReviewLoops, kReviewOff}).description(""))
      ->option_text("all|loops|off")
      ->default_str("all; as the journal has it");
  AddReadOptions(*command, options->run.read);
  command
      ->add_option("--journal", options->journal,
                   "Every line taken is on disk before its decision is written; if the file exists, its lines are "
                   "taken again first")
      ->type_name("FILE");
  AddStepBudgetOption(*command, options->step_budget_ms)
      ->excludes("--journal")
      ->default_str("33; none with a journal, which brings a run back to the last bit");
  command
      ->add_option_function<double>(
          "--journal-size", [options](double megabytes) { options->run.journal_bytes = std::lround(megabytes * 1e6); },
          "Beyond so many megabytes the journal begins anew, with a snapshot of the run beside it (FILE.snapshot-1 and "
          "-2, in turn); not with --output [64]")
      ->check(NumberIn(0.001, 1e6))
      ->type_name("MB");
  command
      ->add_option("--agreeing-links", options->run.agreeing_links,
                   "Links to a map received (MAP) that have to agree, not all of one place, before it becomes part of "
                   "the run's for good")
      ->check(CLI::Range(2, 1000).description(""))
      ->type_name("N")
      ->capture_default_str();
  command
      ->add_option("--output", options->run.directory,
                   "Folder for compact.g2o, trajectory.tum and decisions.csv at the end of the input")
      ->type_name("DIR");
  AddChoice(*command, "--recover", options->run.recovery, Choices<Recovery>(),
            "How dropped poses come back, see compact");
  AddRememberOption(*command, options->remember,
                    "Dropped poses that can still be asked for and linked to: so many of the newest, and those on the "
                    "chains of others; loops to older ones are left out, and memory grows with the map alone "
                    "[1000; all with --output]");
  command->add_flag("--covariances", options->run.covariances, "Every answer to a pose has its covariance too");
  AddConventionOptions(*command, options->run.convention);
  command->add_flag("--strict", options->run.strict, "Stop at the first bad line");
  command->add_flag("--quiet", options->run.quiet, "Write errors and what COVARIANCE asks for only, no decisions");
  AddVerboseOption(*command, options->log);
  command->footer(
      "A blank line or FLUSH closes the pose at hand, DISCARD gives it up, REMOVE ID takes a link out, COVARIANCE ID "
      "[ID]\n"
      "answers how well a pose is known (the second seen from the first). MAP NAME PATH brings another robot's compact "
      "map,\n"
      "whose poses are NAME:ID in edges: it becomes part of the run's map when links to it agree.\n"
      "Example: terse generate ellipse --output measurements.g2o &&\n"
      "         terse online --range 10 10 10 1.5 --journal run.journal < measurements.g2o");
  command->callback([options] { Online(*options); });
}

}  // namespace terse
